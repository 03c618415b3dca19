"""`replace` for both kinds of values that the companion is made of."""

import dataclasses
from copy import copy
from typing import TypeVar

import msgspec

from companion.mission.state import State

Value = TypeVar("Value")


def deep(state: State) -> State:
    """A copy of a state, all of which that a step changes may be changed."""
    state = copy(state)
    state.vehicle, state.flight = copy(state.vehicle), copy(state.flight)
    state.flight.path = copy(state.flight.path)
    return state


def replace(value: Value, /, **changes: object) -> Value:
    """A copy of a state (msgspec's) or of any other value (a dataclass) with some other fields."""
    if isinstance(value, msgspec.Struct):
        return msgspec.structs.replace(value, **changes)
    return dataclasses.replace(value, **changes)  # type: ignore[type-var]
