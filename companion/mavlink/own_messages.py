"""The companion's own messages: heartbeat, version and others on request.

It identifies as an onboard controller, never as autopilot or ground station, and its heartbeat
stops when it is faulted (mavlink.md 2.1, C11).  Periodic messages and those sent on request are the
rows of one table.
"""

import math
import re
from dataclasses import dataclass
from typing import final

from companion.mavlink.dialect import Message, wire

HEARTBEAT = wire.MAVLINK_MSG_ID_HEARTBEAT
AUTOPILOT_VERSION = wire.MAVLINK_MSG_ID_AUTOPILOT_VERSION

CAPABILITIES = wire.MAV_PROTOCOL_CAPABILITY_MAVLINK2 | wire.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
"""No parameters, mission, fence or rally points: those are the autopilot's; no files."""

_KINDS = {
    "a": wire.FIRMWARE_VERSION_TYPE_ALPHA,
    "b": wire.FIRMWARE_VERSION_TYPE_BETA,
    "rc": wire.FIRMWARE_VERSION_TYPE_RC,
    "": wire.FIRMWARE_VERSION_TYPE_OFFICIAL,
}


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Row:
    """How a message of ours is sent."""

    default_us: int | None
    """Its period; None: on request only."""
    fastest_us: int
    fixed: bool = False


_ROWS = {
    HEARTBEAT: _Row(default_us=1_000_000, fastest_us=1_000_000, fixed=True),
    AUTOPILOT_VERSION: _Row(default_us=None, fastest_us=1_000_000),
}
_SLOWEST_US = 2_000_000_000  # of an int32


def heartbeat(system_status: int) -> Message:
    """HEARTBEAT with this MAV_STATE: an onboard controller without modes (minimal.xml)."""
    return wire.MAVLink_heartbeat_message(
        wire.MAV_TYPE_ONBOARD_CONTROLLER, wire.MAV_AUTOPILOT_INVALID, 0, 0, system_status, 3
    )


def autopilot_version(version: str) -> Message:
    """AUTOPILOT_VERSION of the companion: its version as Python's packages write it ("1.2.3")."""
    return wire.MAVLink_autopilot_version_message(
        capabilities=CAPABILITIES,
        flight_sw_version=version_number(version),
        middleware_sw_version=0,
        os_sw_version=0,
        board_version=0,
        flight_custom_version=[0] * 8,
        middleware_custom_version=[0] * 8,
        os_custom_version=[0] * 8,
        vendor_id=0,
        product_id=0,
        uid=0,
    )


def version_number(version: str) -> int:
    """Major << 24 | minor << 16 | patch << 8 | kind of release (FIRMWARE_VERSION_TYPE)."""
    found = re.match(r"(\d+)(?:\.(\d+))?(?:\.(\d+))?(.*)", version)
    if found is None:
        return int(wire.FIRMWARE_VERSION_TYPE_DEV)
    *numbers, rest = found.groups()
    release = re.match(r"\.?(rc|a|b)\d*$", rest)
    kind = _KINDS.get(release.group(1) if release else rest, wire.FIRMWARE_VERSION_TYPE_DEV)
    major, minor, patch = (min(int(number or 0), 255) for number in numbers)
    return int(major << 24 | minor << 16 | patch << 8 | kind)


@final
class OwnMessages:
    """Schedules the companion's own messages.  Pure: time is an argument.

    version: the companion's.
    """

    def __init__(self, version: str) -> None:
        self._version = version
        self._period_us = {number: row.default_us for number, row in _ROWS.items()}
        self._sent_at_s: dict[int, float] = {}
        self._asked: set[int] = set()

    def ask(self, message_id: int) -> bool:
        """Send a message once, with the next on_time(); False if it is not one of ours."""
        if message_id in _ROWS:
            self._asked.add(message_id)
        return message_id in _ROWS

    def set_interval(self, message_id: int, interval_us: float) -> bool:
        """Set the interval of a message: microseconds, 0: default, -1: off.

        False, without effect, for a message that is not ours or an unsupported interval.
        """
        row = _ROWS.get(message_id)
        if row is None:
            return False
        slowest_us = row.fastest_us if row.fixed else _SLOWEST_US
        if interval_us == 0.0:
            self._period_us[message_id] = row.default_us
        elif interval_us == -1.0 and not row.fixed:
            self._period_us[message_id] = None
        elif row.fastest_us <= interval_us <= slowest_us:
            self._period_us[message_id] = round(interval_us)
        else:
            return False
        return True

    def interval_us(self, message_id: int) -> int:
        """For MESSAGE_INTERVAL: microseconds, -1: off, 0: not one of ours."""
        if message_id not in _ROWS:
            return 0
        period_us = self._period_us[message_id]
        return -1 if period_us is None else period_us

    def on_time(self, now_s: float, status: int | None) -> list[Message]:
        """What is due now; status: MAV_STATE, None while faulted (no heartbeat)."""
        messages = list[Message]()
        if status is not None and self._is_due(HEARTBEAT, now_s):
            messages.append(heartbeat(status))
        if self._is_due(AUTOPILOT_VERSION, now_s):
            messages.append(autopilot_version(self._version))
        return messages

    @property
    def due_s(self) -> float:
        """When something is due, at the latest."""
        if self._asked:
            return -math.inf
        periods_us = self._period_us.items()
        return min(
            self._sent_at_s.get(number, -math.inf) + period_us * 1e-6
            for number, period_us in periods_us
            if period_us is not None
        )

    def _is_due(self, number: int, now_s: float) -> bool:
        """Whether to send it now; if so, it is marked as sent."""
        period_us, sent_at_s = self._period_us.get(number), self._sent_at_s.get(number, -math.inf)
        by_itself = period_us is not None and not 0.0 <= now_s - sent_at_s < period_us * 1e-6
        if not by_itself and number not in self._asked:
            return False
        self._asked.discard(number)
        self._sent_at_s[number] = now_s
        return True
