"""A fixed wing of PX4 on its wheels, and in the seconds before and after (px4.md 10).

Times, speeds and events are those of px4-fixedwing-offboard.tlog: armed at 8.08 s, 2.9 m/s a second
later, 9.2 m/s and off the ground after two, 50 m high after 22; in the landing the flare at 434.9,
contact at 436.0, 0.9 m/s and "landing detected" at 438.7 s after boot.
"""

import math
from typing import Final

from vehicle_sim.autopilots import Event

ON_RUNWAY: Final = Event(number=18146901, log_levels=0x66)
"""Takeoff on runway."""
ROTATING: Final = Event(number=27229571, log_levels=0x66)
"""Takeoff airspeed reached, climbout."""
CLEARED: Final = Event(number=26123793, log_levels=0x66)
"""Reached clearance altitude."""
FLARING: Final = Event(number=33124855, log_levels=0x66)
"""Landing, flaring."""

TAKEOFF_SEEN_M_S: Final = 6.6
"""The land detector believes in a take-off from here on, still on the wheels."""
CLIMB_OUT_M_S: Final = 2.63
"""Climb rate at FW_TKO_PITCH_MIN 10 degrees and full throttle."""
ROTATES_AT: Final = 0.9
"""Share of the take-off airspeed (RunwayTakeoff.cpp)."""
LIFTS_OFF_AT: Final = 1.1
"""And where it leaves the ground: at 11.3 m/s, 0.3 s later."""
LANDING_SEEN_M_S: Final = 3.2
"""From here on the landing detector counts its 1.8 s: 0.9 m/s when it is done."""
LANDS_FASTER_M_S: Final = 0.5
"""Flown 10.8 m/s through the air where FW_AIRSPD_MIN is 10.3."""
SLOPE_FLOWN: Final = 0.98
"""Share of the sink of FW_LND_ANG that is flown: 0.85 m/s in the mean of the recorded landing."""
FLARE_SINKS_M_S: Final = 0.6
"""At least, whatever FW_LND_FL_SINK (0.25) says: a second from the flare to contact."""
SINKS_FASTER_1_S: Final = 0.15
"""Sink for each m/s of airspeed too much: 1.3 m/s at first, 0.87 when it is slow."""
FLARE_BRAKES_M_S: Final = 4.0
"""Airspeed that the flare is told to fly: 10.8 to 6.8 m/s in the second before contact."""
_ROLL_OUT_S: Final = 1.33
"""Time constant of the speed on the wheels without throttle: 5.45 m/s at 437 s, 0.87 at 439.5."""
_FULL_M_S2: Final = 6.4
_RAMP_M_S3: Final = 5.7
"""Acceleration while RWTO_RAMP_TIME (2 s) opens the throttle."""


def take_off_m_s2(since_s: float, ramp_s: float) -> float:
    """Acceleration on the runway so long after arming."""
    return min(_RAMP_M_S3 * 2.0 / max(ramp_s, 0.1) * since_s, _FULL_M_S2)


def roll_out_m_s2(ground_speed_m_s: float) -> float:
    """Deceleration on the wheels (negative)."""
    return -max(ground_speed_m_s / _ROLL_OUT_S, 0.05)


def bank_near_ground_rad(height_m: float, wing_height_m: float, wing_span_m: float) -> float:
    """The bank that keeps the wing tips off the ground (getMaxRollAngleNearGround)."""
    return min(max(2.0 * (height_m - wing_height_m) / wing_span_m, 0.0), 0.5 * math.pi)


def flare_sink_m_s(since_s: float, flare_s: float, from_m_s: float, to_m_s: float) -> float:
    """Sink rate so long after the flare began: from one to the other with the root of time."""
    share = math.sqrt(min(max(since_s / flare_s, 0.0), 1.0))
    return share * to_m_s + (1.0 - share) * from_m_s
