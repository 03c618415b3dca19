"""pymavlink's dialect `all`, what it lacks, and how each type of message lies in its frames."""

import math
import re
import struct
from collections.abc import Sequence
from functools import cache
from itertools import accumulate
from typing import Any, Final, NamedTuple, final

from pymavlink.dialects.v20 import all as mavlink

_LARGEST_FLOAT: Final = 3.4028234663852886e38
_WHOLE: Final = "bBhHiIqQ"
"""Codes of struct for integers; the capital ones are unsigned."""


@final
class Layout:
    """How the messages of one kind are read and packed: found out once for each."""

    def __init__(
        self, number: int, crc_extra: int, names: Sequence[str], form: str, kind: Any = None
    ) -> None:
        self.number, self.crc_extra = number, bytes([crc_extra])
        self._names, self._struct, self._kind = names, struct.Struct(form), kind
        shapes = re.findall(r"(\d*)([a-zA-Z])", form)  # one for each field
        self._lengths = [0 if code == "s" else int(count or 0) for count, code in shapes]
        """Of arrays; 0 of a single value or a text."""
        starts = accumulate((max(length, 1) for length in self._lengths[:-1]), initial=0)
        self._places = [*zip(starts, self._lengths, strict=True)]
        """Where each field begins among the values of the struct."""
        self._order = [] if kind is None else [names.index(name) for name in kind.fieldnames]
        """Of the fields in a call of the kind."""
        self._is_plain = not any(self._lengths) and "s" not in form
        self._codes = "".join(
            code * (length or 1) for (_, code), length in zip(shapes, self._lengths, strict=True)
        )
        self.empty: dict[str, Any] = {
            name: b"" if code == "s" else [0] * length if length else 0
            for name, (_, code), length in zip(names, shapes, self._lengths, strict=True)
        }
        """Zero for each field, in the order of the payload."""
        self._attributes = [
            f"_{name}_raw" if isinstance(zero, bytes) else name for name, zero in self.empty.items()
        ]

    def message(self, payload: bytes) -> Any:
        """The message that this payload carries; what was left off at its end is zero."""
        values: Sequence[Any] = self._struct.unpack_from(payload.ljust(self._struct.size, b"\0"))
        if not self._is_plain:
            values = [
                list(values[start : start + length]) if length else _no_zeros(values[start])
                for start, length in self._places
            ]
        return self._kind(*[values[place] for place in self._order])

    def payload(self, message: Any) -> bytes:
        """All of the payload of a message; zeros at its end may be left off."""
        return self.pack([getattr(message, name) for name in self._attributes])

    def pack(self, values: Sequence[Any]) -> bytes:
        """The values of all fields, in the order of the payload."""
        if not self._is_plain:
            values = [
                value
                for field, length in zip(values, self._lengths, strict=True)
                for value in (field if length else (field,))
            ]
        try:
            return self._struct.pack(*values)
        except (struct.error, OverflowError):
            return self._struct.pack(*map(_fitted, values, self._codes))


@final
class Prepared(NamedTuple):
    """A message that is only to be sent: of these no object needs to be made."""

    layout: Layout
    payload: bytes
    """All of it."""


@cache
def layout_of(kind: Any) -> Layout:
    """The layout of this class of pymavlink's messages."""
    return Layout(kind.id, kind.crc_extra, kind.ordered_fieldnames, kind.unpacker.format, kind)


@cache
def layout_named(name: str) -> Layout:
    """The layout of the messages of this name, with what the dialect lacks."""
    if name in _DECLARED:
        return _DECLARED[name]
    return layout_of(getattr(mavlink, f"MAVLink_{name.lower()}_message"))


def make(name: str, **fields: Any) -> Prepared:
    """A message of this name, to be sent; texts as bytes.  What is not given is zero."""
    layout = layout_named(name)
    filled = layout.empty | fields
    if len(filled) > len(layout.empty):
        raise TypeError(f"{name} has no {fields.keys() - layout.empty.keys()}")
    return Prepared(layout, layout.pack([*filled.values()]))


# --- what the dialect lacks -----------------------------------------------------------------------


def _declared(number: int, extra: int, layout: str) -> Layout:
    """By number, CRC_EXTRA and fields: codes of struct and names.

    Of a message that the dialect knows, the fields come after its own, if it does not have them.
    """
    fields = {name: code for code, name in (each.split() for each in layout.split(", "))}
    form, known = "".join(fields.values()), mavlink.mavlink_map.get(number)
    if known is None:
        return Layout(number, extra, [*fields], "<" + form)
    if set(fields) <= set(known.fieldnames):
        return layout_of(known)
    names = [*known.ordered_fieldnames, *fields]
    return Layout(number, extra, names, known.unpacker.format + form)


_DECLARED: Final = {
    # added later, at the end of the payload: clients that do not know them read the rest
    "MISSION_COUNT": _declared(44, 221, "I opaque_id"),
    "MISSION_ACK": _declared(47, 153, "I opaque_id"),
    "TIMESYNC": _declared(111, 34, "B target_system, B target_component"),
    # of PX4's dialect `development`, checked against recorded frames
    "PROTOCOL_VERSION": _declared(
        *(300, 217),
        "H version, H min_version, H max_version, 8B spec_version_hash, 8B library_version_hash",
    ),
}


# --- values that do not fit -----------------------------------------------------------------------


def _no_zeros(value: Any) -> Any:
    """A text without the zeros that fill its field up."""
    return value.rstrip(b"\0") if isinstance(value, bytes) else value


def _fitted(value: Any, code: str) -> Any:
    """The nearest value that this field can carry; zero for NaN.

    A real autopilot casts, and sends some value.
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
