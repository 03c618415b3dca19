"""`replace` for both kinds of values that the companion is made of."""

import dataclasses
from typing import TypeVar

import msgspec

Value = TypeVar("Value")


def replace(value: Value, /, **changes: object) -> Value:
    """A copy of a state (msgspec's) or of any other value (a dataclass) with some other fields."""
    if isinstance(value, msgspec.Struct):
        return msgspec.structs.replace(value, **changes)
    return dataclasses.replace(value, **changes)  # type: ignore[type-var]
