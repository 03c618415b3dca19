"""Makes of the entries of an autopilot's own log the MAVLink messages that it would have sent.

Made is what the companion reads (docs/reference/log-messages.md), no more.
"""

import math
import struct
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NamedTuple, Protocol

from companion.errors import InputError
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.telemetry.logs.log import Clock, Log, Odd, Record

LONGEST_US: Final = 366 * 86_400 * 1_000_000
"""No vehicle is up for longer than a year."""
_TEXT_BYTES: Final = 50
_MAX_CHUNKS: Final = 6
_HEARTBEAT, _CLOCK = wire.MAVLINK_MSG_ID_HEARTBEAT, wire.MAVLINK_MSG_ID_SYSTEM_TIME
_PERIODS_US: Final = {
    _HEARTBEAT: 1_000_000,
    _CLOCK: 95_000,  # as often as the companion looks whether a position is late
    wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 19_000,  # 50 a second are enough
    wire.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 95_000,
    wire.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 95_000,
    wire.MAVLINK_MSG_ID_SYS_STATUS: 490_000,
}
"""The least between two messages of a kind, microseconds: a link has no more."""
_NO_DIRECTION: Final = 65535

Values = Mapping[str, Any]


class Row(NamedTuple):
    """One entry of a log."""

    name: str
    """Of its kind: GPS, vehicle_status."""
    time_us: int | None
    """Microseconds since boot; None: that of the entry before."""
    values: Values


class Vehicle(Protocol):
    """An autopilot, as far as its own log has told of it.

    ValueError, KeyError, TypeError, ArithmeticError or struct.error if an entry cannot be so.
    """

    epoch_us: int | None
    """When it booted, microseconds since 1970; None: nothing tells."""

    def messages(self, row: Row, boot_us: int) -> Iterable[Message]:
        """What it would have sent of an entry; boot_us: microseconds since boot."""

    def shown(self) -> tuple[Any, ...]:
        """What is told at once when it changes; empty while nothing is known."""

    def state(self) -> Iterable[Message]:
        """HEARTBEAT and EXTENDED_SYS_STATE."""


def made(log: Log, rows: Iterable[Row], vehicle: Vehicle, start_us: int) -> Iterator[Record]:
    """What the vehicle would have sent; start_us: when the log begins, microseconds since boot."""
    log.odd[Odd.NO_DATE] = int(vehicle.epoch_us is None)
    zero_us = vehicle.epoch_us or 0
    clock = Clock(log.odd, start_us=zero_us + start_us, last_us=zero_us + LONGEST_US)
    codec = wire.MAVLink(None, srcSystem=log.system_id, srcComponent=AUTOPILOT_COMPONENT)
    sent_us = dict[int, int]()

    def is_due(number: int, boot_us: int) -> bool:
        """Whether the period of such a message has passed; then it counts as sent now."""
        before_us = sent_us.get(number)
        if before_us is not None and 0 <= boot_us - before_us < _PERIODS_US.get(number, 0):
            return False
        sent_us[number] = boot_us
        return True

    def sent(row: Row, boot_us: int) -> Iterator[Message]:
        """The messages of an entry that a link has room for."""
        before = vehicle.shown()
        for message in vehicle.messages(row, boot_us):
            if is_due(message.get_msgId(), boot_us):
                yield message
        if shown := vehicle.shown():
            if is_due(_HEARTBEAT, boot_us) or shown != before:
                yield from vehicle.state()
            if is_due(_CLOCK, boot_us):
                unix_us = 0 if vehicle.epoch_us is None else zero_us + boot_us
                yield wire.MAVLink_system_time_message(unix_us, boot_ms(boot_us))

    for row in rows:
        if row.time_us is not None and not clock.read(zero_us + row.time_us):
            continue
        try:
            messages = list(sent(row, clock.now_us - zero_us))
            frames = [bytes(message.pack(codec)) for message in messages]
        except (ArithmeticError, KeyError, TypeError, ValueError, struct.error):
            # nothing protects an entry: damaged, its numbers fit into no message, or it is no text
            log.odd[Odd.DAMAGED] += 1
            continue
        log.heard.update(message.get_msgId() for message in messages)
        yield from (Record(clock.now_us, frame) for frame in frames)


@contextmanager
def silent(library: ModuleType) -> Iterator[None]:
    """Have a library not print what it takes for damage, meanwhile."""
    vars(library)["print"] = lambda *_, **__: None
    try:
        yield
    finally:
        vars(library).pop("print", None)


def refuse_older(
    path: Path, firmware: str, version: tuple[int, int], oldest: tuple[int, int]
) -> None:
    """InputError if a log is of a version before the oldest that is known."""
    if version < oldest:
        rule = f"it is of {firmware} {version[0]}.{version[1]}"
        rule += f", and logs are read from {oldest[0]}.{oldest[1]} on"
        remedy = "Fly newer firmware, or use companion 0.2.0 for it."
        raise InputError("log", str(path), rule, remedy)


# --- messages


def parameter(name: str, value: float, kind: int = wire.MAV_PARAM_TYPE_REAL32) -> Message:
    """PARAM_VALUE, without its place among the others."""
    content = name.encode("ascii", "replace")[:16]
    return wire.MAVLink_param_value_message(content, value, kind, 0, 65535)


def texts(text: str, severity: int, identity: int) -> list[Message]:
    """STATUSTEXTs of a text of any length; identity: of its parts, if there are several."""
    content = "".join(c for c in text if c.isprintable()).encode("ascii", "replace")
    content = content[: _MAX_CHUNKS * _TEXT_BYTES - 1]
    if len(content) <= _TEXT_BYTES:
        return [wire.MAVLink_statustext_message(severity, content)] if content else []
    return [
        wire.MAVLink_statustext_message(severity, content[at : at + _TEXT_BYTES], identity, number)
        for number, at in enumerate(range(0, len(content) + 1, _TEXT_BYTES))
    ]


def battery(volts: float, amperes: float, percent: int) -> Message:
    """SYS_STATUS, of which the sensor bits are 0; -1 A or %: not known."""
    milli_v, centi_a = whole(volts * 1e3, 0, 65534), whole(amperes * 100, -1, 32767)
    return wire.MAVLink_sys_status_message(0, 0, 0, 0, milli_v, centi_a, percent, *[0] * 6)


def ground(landed: int) -> Message:
    """EXTENDED_SYS_STATE; landed: MAV_LANDED_STATE."""
    return wire.MAVLink_extended_sys_state_message(wire.MAV_VTOL_STATE_UNDEFINED, landed)


def boot_ms(boot_us: int) -> int:
    """As MAVLink has it: 32 bits, which begin again after 49.7 days."""
    return boot_us // 1000 & 0xFFFFFFFF


def wired(place: tuple[float, float, float]) -> tuple[int, int, int]:
    """Latitude, longitude (degrees) and altitude (m), as on the wire."""
    return round(place[0] * 1e7), round(place[1] * 1e7), round(place[2] * 1e3)


def direction(angle_deg: float) -> int:
    """In hundredths of a degree; receivers that stand still may have none."""
    return round(angle_deg * 100) % 36000 if math.isfinite(angle_deg) else _NO_DIRECTION


def whole(value: float, least: int, most: int) -> int:
    """Rounded, for a field that says only so much.  ValueError if it is not finite."""
    return min(max(round(value), least), most)
