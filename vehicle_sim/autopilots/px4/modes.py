"""PX4's flight modes, and how they are written in custom_mode and asked for (px4.md 3)."""

import enum
from typing import Final


class Mode(enum.Enum):
    """What is flown.  DESCEND is a failsafe only, and is told as AUTO:LAND."""

    MANUAL = enum.auto()
    ALTCTL = enum.auto()
    POSCTL = enum.auto()
    ACRO = enum.auto()
    STABILIZED = enum.auto()
    OFFBOARD = enum.auto()
    TAKEOFF = enum.auto()
    LOITER = enum.auto()
    MISSION = enum.auto()
    RTL = enum.auto()
    LAND = enum.auto()
    ORBIT = enum.auto()
    DESCEND = enum.auto()


CUSTOM_MODES: Final = {
    Mode.MANUAL: 0x00010000,
    Mode.ALTCTL: 0x00020000,
    Mode.POSCTL: 0x00030000,
    Mode.ACRO: 0x00050000,
    Mode.OFFBOARD: 0x00060000,
    Mode.STABILIZED: 0x00070000,
    Mode.TAKEOFF: 0x02040000,
    Mode.LOITER: 0x03040000,
    Mode.MISSION: 0x04040000,
    Mode.RTL: 0x05040000,
    Mode.LAND: 0x06040000,
    Mode.ORBIT: 0x01030000,
    Mode.DESCEND: 0x06040000,
}
"""custom_mode of the heartbeat: main mode << 16 | sub mode << 24."""

MANUAL_MODES: Final = frozenset({Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.ACRO, Mode.STABILIZED})
AUTO_MODES: Final = frozenset(
    {Mode.TAKEOFF, Mode.LOITER, Mode.MISSION, Mode.RTL, Mode.LAND, Mode.ORBIT, Mode.DESCEND}
)
NAVIGATED: Final = AUTO_MODES - {Mode.DESCEND}
"""Modes in which the navigator has a place to go to."""
NEED_POSITION: Final = frozenset(
    {Mode.POSCTL, Mode.TAKEOFF, Mode.LOITER, Mode.MISSION, Mode.RTL, Mode.LAND, Mode.ORBIT}
)
"""Modes that cannot run without a horizontal position (OFFBOARD: it depends on the setpoint)."""
NAMES: Final = {
    Mode.MANUAL: "Manual",
    Mode.ALTCTL: "Altitude",
    Mode.POSCTL: "Position",
    Mode.ACRO: "Acro",
    Mode.STABILIZED: "Stabilized",
    Mode.OFFBOARD: "Offboard",
    Mode.TAKEOFF: "Takeoff",
    Mode.LOITER: "Hold",
    Mode.MISSION: "Mission",
    Mode.RTL: "Return",
    Mode.LAND: "Land",
    Mode.ORBIT: "Orbit",
    Mode.DESCEND: "Descend",
}
"""As users call them."""

_BY_NUMBERS: Final = {
    (custom >> 16 & 0xFF, custom >> 24): mode
    for mode, custom in CUSTOM_MODES.items()
    if mode is not Mode.DESCEND
}
MAIN_AUTO: Final = 4


def mode_of(main: int, sub: int) -> Mode | None:
    """The mode that DO_SET_MODE's second and third parameter name; None: there is none."""
    mode = _BY_NUMBERS.get((main, sub))
    return mode if mode is not None or main == MAIN_AUTO else _BY_NUMBERS.get((main, 0))


def base_mode(mode: Mode, *, armed: bool) -> int:
    """base_mode of the heartbeat, recorded: 29 in AUTO, 17 in OFFBOARD; armed 128 more."""
    flags = 1 | 16 | (128 if armed else 0)
    if mode in AUTO_MODES:
        return flags | 4 | 8
    return flags | 64 if mode in MANUAL_MODES else flags


def standard_mode(mode: Mode) -> int:
    """MAV_STANDARD_MODE of CURRENT_MODE: 7 and 8 as recorded, the others from the source."""
    return _STANDARD_MODES.get(mode, 0)


_STANDARD_MODES: Final = {
    Mode.POSCTL: 1,
    Mode.ORBIT: 2,
    Mode.ALTCTL: 4,
    Mode.RTL: 5,
    Mode.MISSION: 6,
    Mode.LAND: 7,
    Mode.TAKEOFF: 8,
}
