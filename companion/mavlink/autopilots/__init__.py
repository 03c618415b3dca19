"""One strategy per autopilot and vehicle type: commands, setpoints, decoding (design 4)."""

from collections.abc import Mapping

from companion.mavlink.autopilots.arducopter import ARDUCOPTER
from companion.mavlink.autopilots.arduplane import ARDUPLANE
from companion.mavlink.autopilots.common import ROTORCRAFT, Autopilot, LaunchPose
from companion.mavlink.autopilots.messages import heading_rad
from companion.mavlink.autopilots.px4_fixed_wing import PX4_FIXED_WING
from companion.mavlink.autopilots.px4_multicopter import PX4_MULTICOPTER
from companion.mavlink.dialect import Message, wire

ALL: tuple[Autopilot, ...] = (ARDUCOPTER, ARDUPLANE, PX4_MULTICOPTER, PX4_FIXED_WING)
NAMES = tuple(autopilot.name for autopilot in ALL)
"""What the companion flies, for people."""

_HOVERING: Mapping[int, Autopilot] = {
    wire.MAV_AUTOPILOT_ARDUPILOTMEGA: ARDUCOPTER,
    wire.MAV_AUTOPILOT_PX4: PX4_MULTICOPTER,
}
_WINGED: Mapping[int, Autopilot] = {
    wire.MAV_AUTOPILOT_ARDUPILOTMEGA: ARDUPLANE,
    wire.MAV_AUTOPILOT_PX4: PX4_FIXED_WING,
}


def autopilot_of(heartbeat: Message) -> Autopilot | None:
    """The strategy for the sender of this; None: not supported (VTOL, rover, ...)."""
    if heartbeat.type in ROTORCRAFT:
        return _HOVERING.get(heartbeat.autopilot)
    if heartbeat.type == wire.MAV_TYPE_FIXED_WING:
        return _WINGED.get(heartbeat.autopilot)
    return None


def described(heartbeat: Message) -> str:
    """Autopilot and vehicle type of a heartbeat as text: "PX4, VTOL tiltrotor"."""
    autopilot = autopilot_of(heartbeat)
    if autopilot is not None:
        return autopilot.name
    return f"{_word('MAV_AUTOPILOT', heartbeat.autopilot)}, {_word('MAV_TYPE', heartbeat.type)}"


def _word(enum: str, number: int) -> str:
    entry = wire.enums[enum].get(number)
    return f"{enum} {number}" if entry is None else entry.name.removeprefix(f"{enum}_").lower()


__all__ = [
    "ALL",
    "ARDUCOPTER",
    "ARDUPLANE",
    "NAMES",
    "PX4_FIXED_WING",
    "PX4_MULTICOPTER",
    "Autopilot",
    "LaunchPose",
    "autopilot_of",
    "described",
    "heading_rad",
]
