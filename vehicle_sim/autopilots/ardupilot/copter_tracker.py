"""A tracking law for airframes without drag, which ArduCopter's controller was never tuned for.

The bundled worlds fly a copter at 150 m/s with 9 m/s2 of lateral acceleration: no such vehicle
exists, and WPNAV_ACCEL would not let the real controller correct so hard.  With a position and a
velocity streamed it accelerates by the errors in both,

    a = KP (p_target - p) + KV (v_target - v),

without a feed-forward of acceleration where ArduCopter drops it: in a steady turn it is a / KP to
the outside.
"""

import math
from typing import final

from vehicle_sim.autopilots import Estimate
from vehicle_sim.autopilots.ardupilot.copter_control import clipped
from vehicle_sim.dynamics.copter import Limits
from vehicle_sim.geodesy import metres_per_degree

Vector = tuple[float, float, float]

KP_1_S2 = 0.75
KV_1_S = 4.0
"""Well damped (2.3): the vehicle's acceleration overshoots a step of the path's by 4 %."""
_STREAM_GAP_S = 0.5


@final
class Tracker:
    """How fast the stream's velocity changes, and the law.

    Between setpoints the velocity error is taken against a velocity that goes on changing as it
    has: held still, it would saw the acceleration up and down at the rate of the stream.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.received_us = 0
        self.forget()

    def forget(self) -> None:
        """Whatever comes next is no stream."""
        self._slope: Vector = (0.0, 0.0, 0.0)
        self._interval_s = 0.0

    def learn(self, before: Vector, velocity: Vector, now_us: int, *, streams: bool) -> None:
        """A setpoint with this velocity, after one with that."""
        gap_s = (now_us - self.received_us) * 1e-6
        self.received_us = now_us
        if gap_s < 1e-3:
            return
        limits = self._limits
        slope = tuple((new - old) / gap_s for new, old in zip(velocity, before, strict=True))
        smooth = math.hypot(slope[0], slope[1]) <= limits.acceleration_m_s2 and (
            abs(slope[2]) <= limits.acceleration_vertical_m_s2
        )
        if streams and gap_s <= _STREAM_GAP_S and smooth:
            self._slope, self._interval_s = (slope[0], slope[1], slope[2]), gap_s
        else:
            self.forget()

    def wanted(
        self,
        estimate: Estimate,
        place: Vector,
        velocity: Vector,
        acceleration: Vector,
        speeds_m_s: tuple[float, float],
        now_us: int,
    ) -> Vector:
        """Acceleration north, east, up towards a place (degrees, degrees, metres) that moves."""
        metres_north, metres_east = metres_per_degree(estimate.latitude_deg)
        north_m = (place[0] - estimate.latitude_deg) * metres_north
        east_m = (place[1] - estimate.longitude_deg) * metres_east
        up_m = place[2] - estimate.altitude_amsl_m
        north, east = clipped(north_m * KP_1_S2, east_m * KP_1_S2, KV_1_S * speeds_m_s[0])
        most_up = KV_1_S * speeds_m_s[1]
        up = min(max(up_m * KP_1_S2, -most_up), most_up)
        age_s = (now_us - self.received_us) * 1e-6
        ahead_s = age_s if age_s <= 2.0 * self._interval_s else 0.0
        v_n, v_e, v_u = velocity
        s_n, s_e, s_u = self._slope
        a_n, a_e, a_u = acceleration
        return (
            north + KV_1_S * (v_n + s_n * ahead_s - estimate.velocity_north_m_s) + a_n,
            east + KV_1_S * (v_e + s_e * ahead_s - estimate.velocity_east_m_s) + a_e,
            up + KV_1_S * (v_u + s_u * ahead_s - estimate.velocity_up_m_s) + a_u,
        )
