"""The companion's own messages: its heartbeat, and its version on request.

It identifies as an onboard controller, never as autopilot or ground station, and its heartbeat
stops when it is faulted (mavlink.md 2.1, C11).
"""

import math
import re
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


_BEAT_S = 1.0


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
        self._beat_at_s = -math.inf
        self._asked: set[int] = set()

    def ask(self, message_id: int) -> bool:
        """Send a message once, with the next on_time(); False if it is not one of ours."""
        is_ours = message_id in (HEARTBEAT, AUTOPILOT_VERSION)
        if is_ours:
            self._asked.add(message_id)
        return is_ours

    def on_time(self, now_s: float, status: int | None) -> list[Message]:
        """What is due now; status: MAV_STATE, None while faulted (no heartbeat)."""
        messages, asked = list[Message](), self._asked
        is_due = not 0.0 <= now_s - self._beat_at_s < _BEAT_S
        if status is not None and (is_due or HEARTBEAT in asked):
            self._beat_at_s = now_s
            messages.append(heartbeat(status))
        if AUTOPILOT_VERSION in asked:
            messages.append(autopilot_version(self._version))
        self._asked = set() if status is not None else asked & {HEARTBEAT}
        return messages

    @property
    def due_s(self) -> float:
        """When something is due, at the latest."""
        return -math.inf if self._asked else self._beat_at_s + _BEAT_S
