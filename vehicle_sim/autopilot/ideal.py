"""The law of fictional copters, `ideal`: what follows a path that is streamed to one without drag.

ArduCopter's controller was never tuned for such airframes.  The bundled worlds fly a copter at
150 m/s with 9 m/s2 of lateral acceleration: no such vehicle exists, no autopilot has this law, and
WPNAV_ACCEL would not let the real controller correct so hard.
"""

from typing import Final, final

from vehicle_sim.autopilot.copter_control import Tuning, bounded, clipped
from vehicle_sim.dynamics.copter import Limits

KP_1_S2: Final = 0.75
KV_1_S: Final = 4.0
"""Well damped (2.3): the vehicle's acceleration overshoots a step of the path's by 4 %."""
_STREAM_GAP_S: Final = 0.5
Spatial = tuple[complex, float]
"""Level, north + east j, and up."""


@final
class Ideal:
    """With a position and a velocity streamed it accelerates by the errors in both.

        a = KP (p_target - p) + KV (v_target - v),

    without a feed-forward of acceleration where ArduCopter drops it: in a steady turn it is a / KP
    to the outside.
    Between setpoints the velocity error is taken against a velocity that goes on changing as it
    has: held still, it would saw the acceleration up and down at the rate of the stream.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.tracks = False
        """It has flown the last step."""
        self.forget()

    def forget(self) -> None:
        """The stream has ended."""
        self._slope: Spatial = (0j, 0.0)
        self._interval_s = 0.0

    def learn(self, before: Spatial, velocity: Spatial, gap_s: float, *, streams: bool) -> None:
        """A setpoint with this velocity, so long after one with that."""
        if gap_s < 1e-3:
            return
        slope = ((velocity[0] - before[0]) / gap_s, (velocity[1] - before[1]) / gap_s)
        level_ok = abs(slope[0]) <= self._limits.acceleration_m_s2
        if (
            streams
            and gap_s <= _STREAM_GAP_S
            and level_ok
            and abs(slope[1]) <= self._limits.acceleration_vertical_m_s2
        ):
            self._slope, self._interval_s = slope, gap_s
        else:
            self.forget()

    def order(
        self, off_m: Spatial, late_m_s: Spatial, feed: Spatial, age_s: float, tuning: Tuning
    ) -> Spatial:
        """Acceleration by the errors of position and velocity, of a target so old."""
        ahead_s = age_s if age_s <= 2.0 * self._interval_s else 0.0
        level = clipped(off_m[0] * KP_1_S2, KV_1_S * tuning.speed_m_s)
        most_up = KV_1_S * tuning.speed_up_m_s
        up = bounded(off_m[1] * KP_1_S2, -most_up, most_up)
        return (
            level + KV_1_S * (late_m_s[0] + self._slope[0] * ahead_s) + feed[0],
            up + KV_1_S * (late_m_s[1] + self._slope[1] * ahead_s) + feed[1],
        )
