"""Messages into payloads: what can be looked up about a type of message is looked up once."""

import math
import re
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Final, final

from pymavlink.dialects.v20 import all as mavlink

_LARGEST_FLOAT: Final = 3.4028234663852886e38
_WHOLE: Final = "bBhHiIqQ"
"""Codes of struct for integers; the capital ones are unsigned."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Form:
    """How one type of message is packed."""

    number: int
    extra: bytes
    """What goes into its checksum besides the frame."""
    payload: Callable[[Any], bytes]
    """All of it; zeros at its end may be left off."""


_forms: dict[type, Form] = {}


def form_of(kind: Any) -> Form | None:
    """Of this class of messages; None for one that the dialect lacks: it packs itself."""
    form = _forms.get(kind)
    if form is None:
        if not (getattr(kind, "ordered_fieldnames", None) and kind.id in mavlink.mavlink_map):
            return None
        form = Form(number=kind.id, extra=bytes([kind.crc_extra]), payload=_payload(kind))
        _forms[kind] = form
    return form


def _payload(kind: Any) -> Callable[[Any], bytes]:
    pack, values_of = kind.unpacker.pack, _values(kind)
    codes = [
        code
        for count, code in re.findall(r"(\d*)([a-zA-Z])", kind.unpacker.format)
        for _ in range(1 if code == "s" else int(count or 1))
    ]

    def payload(message: Any) -> bytes:
        values = values_of(message)
        try:
            return pack(*values)
        except (struct.error, OverflowError):
            return pack(*map(_fitted, values, codes))

    return payload


def _values(kind: Any) -> Callable[[Any], Sequence[Any]]:
    """The values of such a message in the order of its payload."""
    lengths = kind.lengths
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    names = [
        f"_{name}_raw" if length and types[name] == "char" else name  # as bytes
        for name, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True)
    ]
    get = attrgetter(*names)

    def flat(fields: Sequence[Any]) -> Iterator[Any]:
        for value, length in zip(fields, lengths, strict=True):
            if length == 1:
                yield value
            else:
                yield from value

    if any(length > 1 for length in lengths):
        if len(names) == 1:
            return get
        return lambda message: list(flat(get(message)))
    return get if len(names) > 1 else lambda message: (get(message),)


def _fitted(value: Any, code: str) -> Any:
    """The nearest value that this field can carry; zero for what is not a number.

    A real autopilot casts, and sends something; nobody asked it not to.
    """
    if isinstance(value, bytes):
        return value
    if code in _WHOLE:
        if not math.isfinite(value):
            return 0
        bits = 8 * struct.calcsize("<" + code)
        least = 0 if code.isupper() else -(1 << bits - 1)
        return min(max(int(value), least), least + (1 << bits) - 1)
    if code == "f" and math.isfinite(value):
        return min(max(value, -_LARGEST_FLOAT), _LARGEST_FLOAT)
    return value
