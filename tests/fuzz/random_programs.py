"""Bytes read as programs: intact frames with any payload, and numbers that nobody should send.

What the fuzzers of both programs share.
"""

import math
import re
import struct
from collections.abc import Sequence
from typing import Any

from pymavlink.dialects.v20 import all as mavlink
from pymavlink.generator.mavcrc import x25crc

from vehicle_sim.plans import PlanItem

MESSAGES = sorted(mavlink.mavlink_map)
COMMANDS = (
    *(16, 17, 20, 21, 22, 84, 115, 176, 178, 179, 192, 193, 207, 211, 224, 241, 245, 246, 252, 300),
    *(400, 401, 410, 420, 510, 511, 512, 519, 520, 3000, 42428, 43000, 43001, 43002),
)
VALUES = (
    *(0.0, 1.0, -1.0, 4.0, 6.0, 9.0, 13.0, 15.0, 20.0, 33.0, 50.0, 21196.0, 47.4, 8.5, 500.0),
    *(1e-30, 1e9, -1e9, 3e38, math.nan, math.inf, -math.inf),
)

FAULTS = ("for 1 s: gps_off", "for 2 s: gps_glitch 30 m up", "pilot", "origin_move 300 m north")
FAULTS += ("estimator_reset 300 m west", "for 2 s: wind 20 m/s from 90 deg turbulence 5")
FRAMES = (0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 12, 21, 255)
EDGES_E7 = (0, 474_000_000, 85_000_000, -(2**31), 2**31 - 1)
PLACE = {"latitude_deg": 47.4, "longitude_deg": 8.5}
"""Where the vehicles stand."""
_ITEMS = (16, 17, 18, 19, 20, 21, 22, 82, 177, 178, 201, *range(5000, 5005), 5100, 0, 65535)


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


def any_frame(
    number: int,
    reader: Reader,
    senders: Sequence[tuple[int, int]],
    target: tuple[int, int],
    *,
    now_s: float = 0.0,
) -> bytes:
    """Of anybody, with any payload; often at this time, and with numbers that nobody sends."""
    kind: Any = mavlink.mavlink_map[number]
    size = kind.unpacker.size
    payload, how = reader.bytes(reader.byte() % (size + 1)).ljust(size, b"\0"), reader.byte()
    values: dict[str, float] = {}
    if how & 1:
        names = zip(kind.fieldnames, kind.fieldtypes, strict=True)
        values = {name: reader.value() for name, form in names if form == "float"}
    if how & 2:
        values["time_boot_ms"] = (max(round(now_s * 1e3), 0) + reader.byte()) % 2**32
    sender = senders[reader.byte() % len(senders)]
    return intact(number, payload, sender, target=target if how & 12 else None, values=values)


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
    return bytes(message.pack(codec))


def plan_items(reader: Reader) -> tuple[PlanItem, ...]:
    """Shapes of a fence near that place, places to fly to, or anything, of sense or none."""
    items = []
    for _ in range(reader.byte() % 5):
        number = _ITEMS[reader.byte() % len(_ITEMS)]
        corners = 3 + reader.byte() % 4 if number in (5001, 5002) else 1
        size = float(corners) if corners > 1 else (20.0, 60.0, 300.0, *VALUES)[reader.byte() % 25]
        rest, frame = (reader.value(), reader.value(), reader.value()), reader.byte()
        for _ in range(corners):
            x, y = (round(deg * 1e7) + (reader.byte() - 128) * 250 for deg in PLACE.values())
            if reader.byte() % 8 == 0:
                x = EDGES_E7[reader.byte() % len(EDGES_E7)]
            items.append(
                PlanItem(
                    frame=FRAMES[frame % len(FRAMES)], command=number, parameters=(size, *rest),
                    x=x, y=y, z_m=(0.0, 20.0, *VALUES)[reader.byte() % 24],
                )
            )  # fmt: skip
    return tuple(items)


def _place(kind: Any, field: str) -> tuple[str, int] | None:
    """Format and offset of a field in the payload; None if there is no such single number."""
    if field not in kind.ordered_fieldnames:
        return None
    parts = re.findall(r"\d*\D", kind.unpacker.format[1:])
    at = kind.ordered_fieldnames.index(field)
    if len(parts[at]) > 1:
        return None
    return "<" + parts[at], struct.calcsize("<" + "".join(parts[:at]))
