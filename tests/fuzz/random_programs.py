"""Bytes read as programs: intact frames with any payload, and numbers that nobody should send.

What the fuzzers of both programs share.
"""

import math
import re
import struct
from typing import Any

from pymavlink.dialects.v20 import all as mavlink
from pymavlink.generator.mavcrc import x25crc

MESSAGES = sorted(mavlink.mavlink_map)
COMMANDS = (
    *(16, 17, 20, 21, 22, 84, 115, 176, 178, 179, 192, 193, 207, 211, 224, 241, 245, 246, 252, 300),
    *(400, 401, 410, 420, 510, 511, 512, 519, 520, 3000, 42428, 43000, 43001, 43002),
)
VALUES = (
    *(0.0, 1.0, -1.0, 4.0, 6.0, 9.0, 13.0, 15.0, 20.0, 33.0, 50.0, 21196.0, 47.4, 8.5, 500.0),
    *(1e-30, 1e9, -1e9, 3e38, math.nan, math.inf, -math.inf),
)


def message_numbers(names: str) -> tuple[int, ...]:
    """Of the messages with these names."""
    return tuple(getattr(mavlink, f"MAVLINK_MSG_ID_{name}") for name in names.split())


class Reader:
    """The input, from the front; zeros after its end."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    @property
    def left(self) -> bool:
        return self._at < len(self._data)

    def byte(self) -> int:
        self._at += 1
        return self._data[self._at - 1] if self._at <= len(self._data) else 0

    def value(self) -> float:
        """A number that somebody might send; one of those that nobody should in a third."""
        return VALUES[self.byte() % len(VALUES)]

    def bytes(self, size: int) -> bytes:
        self._at += size
        return self._data[self._at - size : self._at]


def intact(
    number: int,
    payload: bytes,
    sender: tuple[int, int] = (1, 191),
    *,
    target: tuple[int, int] | None = (1, 1),
    values: dict[str, float] | None = None,
) -> bytes:
    """A MAVLink 2 frame with this payload, addressed to the target if it has an address.

    values: of other fields that are single numbers, if the message has them.
    """
    kind: Any = mavlink.mavlink_map[number]
    content = bytearray(payload)
    fields = dict(values or {})
    if target is not None:
        fields |= {"target_system": target[0], "target_component": target[1]}
    for field, value in fields.items():
        place = _place(kind, field)
        if place is not None:
            form, offset = place
            written = float(value) if form in ("<f", "<d") else int(value)
            struct.pack_into(form, content, offset, written)
    body = bytes([len(content), 0, 0, 0, *sender]) + number.to_bytes(3, "little") + content
    crc = x25crc(body + bytes([kind.crc_extra])).crc
    return b"\xfd" + body + crc.to_bytes(2, "little")


def command(reader: Reader, numbers: tuple[int, ...], codec: Any, target: tuple[int, int]) -> bytes:
    """A command, with any numbers in it."""
    number = numbers[reader.byte() % len(numbers)]
    values = [reader.value() for _ in range(7)]
    message: Any = mavlink.MAVLink_command_long_message(*target, number, 0, *values)
    if reader.byte() % 2:
        place = [reader.byte() * 4_000_000, reader.byte() * 1_000_000]
        frame = reader.byte() % 22
        message = mavlink.MAVLink_command_int_message(
            *target, frame, number, 0, 0, *values[:4], *place, values[6]
        )
    packed: bytes = message.pack(codec)
    return packed


def _place(kind: Any, field: str) -> tuple[str, int] | None:
    """Format and offset of a field in the payload; None if there is no such single number."""
    if field not in kind.ordered_fieldnames:
        return None
    parts = re.findall(r"\d*\D", kind.unpacker.format[1:])
    at = kind.ordered_fieldnames.index(field)
    if len(parts[at]) > 1:
        return None
    return "<" + parts[at], struct.calcsize("<" + "".join(parts[:at]))
