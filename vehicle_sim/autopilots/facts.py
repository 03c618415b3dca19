"""ArduCopter's numbers: what was measured on the real one, and MAVLink's enumerations."""

import enum
import math

STANDBY_US = 1_000_000
GPS_US = 10_000_000
ORIGIN_US = 20_000_000
HEALTHY_US = 23_500_000
POSITION_US = 41_500_000
"""Time since boot at which the estimator's position is there, and arming in GUIDED with it."""
EKF_WITHOUT_GPS, EKF_WITH_GPS = 0x0A7, 0x33F
SPOOL_UP_US = 2_000_000
REACHED_US = 1_000_000
"""From reaching the height to the end of the take-off."""
DISARM_US = 2_000_000
"""From touching down to disarming."""
BRAKE_M_S2, BRAKE_JERK_M_S3 = 7.5, 40.0
SLOW_LANDING_M = 10.0
CRASH_M_S = 3.0
YAW_RATE_RAD_S = math.radians(60.0)
FORCE_DISARM = 21196.0
ABOVE_HOME_FRAME = 3

HEARTBEAT, HOME_POSITION, GPS_GLOBAL_ORIGIN = 0, 242, 49
STREAMABLE = frozenset(
    {HEARTBEAT, 1, 2, 24, 30, 32, 33, GPS_GLOBAL_ORIGIN, 74, 85, 148, 193, HOME_POSITION, 245}
)
"""The message numbers that can be asked for: what the simulator has something to say about."""


class Mode(enum.IntEnum):
    """ArduCopter's numbers of the modes that are simulated."""

    STABILIZE = 0
    GUIDED = 4
    LAND = 9
    BRAKE = 17


class Result(enum.IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class Landed(enum.IntEnum):
    """MAV_LANDED_STATE."""

    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


class CommandNumber(enum.IntEnum):
    """MAV_CMD."""

    NAV_TAKEOFF = 22
    DO_SET_MODE = 176
    COMPONENT_ARM_DISARM = 400
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512
