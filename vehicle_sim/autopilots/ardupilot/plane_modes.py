"""ArduPlane's modes: numbers, names, and which of them do what by themselves."""

import enum


class Mode(enum.IntEnum):
    """custom_mode of the heartbeat."""

    MANUAL = 0
    CIRCLE = 1
    STABILIZE = 2
    TRAINING = 3
    ACRO = 4
    FBWA = 5
    FBWB = 6
    CRUISE = 7
    AUTOTUNE = 8
    AUTO = 10
    RTL = 11
    LOITER = 12
    TAKEOFF = 13
    AVOID_ADSB = 14
    GUIDED = 15
    INITIALISING = 16
    THERMAL = 24
    AUTOLAND = 26


NAMES: dict[int, str] = {mode.value: mode.name for mode in Mode}
"""The Q modes (17 to 23, 25) are refused: the airframe is no quadplane."""
GLIDES = frozenset(
    {Mode.MANUAL, Mode.STABILIZE, Mode.TRAINING, Mode.ACRO, Mode.FBWA, Mode.AUTOTUNE}
)
"""The pilot's throttle, which nobody holds: the motor stands still."""
SLOW = frozenset({Mode.FBWB, Mode.CRUISE})
"""The pilot's throttle is the airspeed, which is the least, and height is held."""
LOITERS = frozenset({Mode.GUIDED, Mode.RTL, Mode.LOITER, Mode.AVOID_ADSB, Mode.THERMAL})
"""They circle the next point."""
AUTONOMOUS = LOITERS | {Mode.AUTO, Mode.TAKEOFF, Mode.CIRCLE, Mode.AUTOLAND}
BY_ITSELF = frozenset(Mode) - {Mode.MANUAL, Mode.INITIALISING}
"""What it navigates to is told in these."""
