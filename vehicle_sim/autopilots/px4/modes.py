"""PX4's flight modes, and how they are written in custom_mode and asked for (px4.md 3)."""

import enum
from typing import Final


class Mode(enum.Enum):
    """What is flown: its name, and main and sub mode.  DESCEND is a failsafe only."""

    MANUAL = "Manual", 1, 0
    ALTCTL = "Altitude", 2, 0
    POSCTL = "Position", 3, 0
    ACRO = "Acro", 5, 0
    STABILIZED = "Stabilized", 7, 0
    OFFBOARD = "Offboard", 6, 0
    TAKEOFF = "Takeoff", 4, 2
    LOITER = "Hold", 4, 3
    MISSION = "Mission", 4, 4
    RTL = "Return", 4, 5
    LAND = "Land", 4, 6
    DESCEND = "Descend", 4, 6
    """Told as AUTO:LAND."""


CUSTOM_MODES: Final = {mode: mode.value[1] << 16 | mode.value[2] << 24 for mode in Mode}
"""custom_mode of the heartbeat."""
NAMES: Final = {mode: mode.value[0] for mode in Mode}
"""As users call them."""
MANUAL_MODES: Final = frozenset({Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.ACRO, Mode.STABILIZED})
NAVIGATED: Final = frozenset({Mode.TAKEOFF, Mode.LOITER, Mode.MISSION, Mode.RTL, Mode.LAND})
"""Modes in which the navigator has a place to go to."""
AUTO_MODES: Final = NAVIGATED | {Mode.DESCEND}
NEED_POSITION: Final = NAVIGATED | {Mode.POSCTL}
"""Modes that cannot run without a horizontal position (OFFBOARD: it depends on the setpoint)."""

_BY_NUMBERS: Final = {mode.value[1:]: mode for mode in Mode if mode is not Mode.DESCEND}
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
    Mode.ALTCTL: 4,
    Mode.RTL: 5,
    Mode.MISSION: 6,
    Mode.LAND: 7,
    Mode.TAKEOFF: 8,
}
