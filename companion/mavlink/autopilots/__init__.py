"""One strategy per autopilot and vehicle type: commands, setpoints, decoding (design 4).

Each stands in one file, and in `ALL`: one for each firmware and kind of vehicle.
"""

from companion.mavlink.autopilots.arducopter import ARDUCOPTER as ARDUCOPTER
from companion.mavlink.autopilots.arduplane import ARDUPLANE as ARDUPLANE
from companion.mavlink.autopilots.common import KINDS
from companion.mavlink.autopilots.common import Autopilot as Autopilot
from companion.mavlink.autopilots.px4_fixed_wing import PX4_FIXED_WING as PX4_FIXED_WING
from companion.mavlink.autopilots.px4_multicopter import PX4_MULTICOPTER as PX4_MULTICOPTER
from companion.mavlink.dialect import Message, enum_word

ALL: tuple[Autopilot, ...] = (ARDUCOPTER, ARDUPLANE, PX4_MULTICOPTER, PX4_FIXED_WING)
NAMES = tuple(autopilot.name for autopilot in ALL)
"""What the companion flies, for people."""

FIRMWARES = tuple(dict.fromkeys(autopilot.firmware for autopilot in ALL))


def autopilot_of(heartbeat: Message) -> Autopilot | None:
    """The strategy for the sender of this; None: not supported (VTOL, rover, ...)."""
    wanted = heartbeat.autopilot, KINDS.get(heartbeat.type)
    return next((way for way in ALL if (way.firmware.number, way.traits.kind) == wanted), None)


def named(firmware: str, kind: str) -> Autopilot:
    """The strategy for a mission's `autopilot` and `kind`."""
    return next(way for way in ALL if (way.firmware.name, way.traits.kind) == (firmware, kind))


def described(heartbeat: Message) -> str:
    """Autopilot and vehicle type of a heartbeat as text: "PX4, VTOL tiltrotor"."""
    autopilot = autopilot_of(heartbeat)
    if autopilot is not None:
        return autopilot.name
    both = {"MAV_AUTOPILOT": heartbeat.autopilot, "MAV_TYPE": heartbeat.type}
    return ", ".join(enum_word(e, n).lower() or f"{e} {n}" for e, n in both.items())
