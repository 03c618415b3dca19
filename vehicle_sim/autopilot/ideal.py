"""A fictional copter: an ArduCopter that follows a streamed path by a law that no autopilot has.

ArduCopter's controller was never tuned for such airframes.  The bundled worlds fly a copter at
150 m/s with 9 m/s2 of lateral acceleration: no such vehicle exists, and WPNAV_ACCEL would not let
the real controller correct so hard.
"""

from typing import Final, final

from vehicle_sim.autopilot.arducopter import ArduCopter, Kind
from vehicle_sim.autopilot.copter_control import STILL, Order, clipped
from vehicle_sim.autopilot.setpoints import Target
from vehicle_sim.autopilot.values import Place

KP_1_S2: Final = 0.75
KV_1_S: Final = 4.0
"""Well damped (2.3): the vehicle's acceleration overshoots a step of the path's by 4 %."""
_STREAM_GAP_S: Final = 0.5


@final
class Ideal(ArduCopter):
    """With a position and a velocity streamed it accelerates by the errors in both.

        a = KP (p_target - p) + KV (v_target - v),

    without a feed-forward of acceleration where ArduCopter drops it: in a steady turn it is a / KP
    to the outside.
    Between setpoints the velocity error is taken against a velocity that goes on changing as it
    has: held still, it would saw the acceleration up and down at the rate of the stream.
    """

    nose_follows_motion = True
    _slope = STILL
    """How the streamed velocity changes, and the interval that it was seen over; 0: not known."""
    _interval_s = 0.0
    _tracks = False  # it has flown the last step by this law

    def _restart(self, kind: Kind) -> None:
        """Another submode: level, with the acceleration that there is."""
        super()._restart(kind)
        self.control.follow(self.copter.acceleration_m_s2)

    def take(self, target: Target, place: Place | None) -> bool:
        """Steer for it, and see how the velocity has changed since the one before."""
        kind, gap_s, (velocity, climb_m_s) = self.kind, self.now_s - self._heard_s, self._moves
        if not super().take(target, place):
            return False
        if gap_s >= 1e-3:
            limits, (now, now_up) = self.copter.limits, self._moves
            slope, slope_up = (now - velocity) / gap_s, (now_up - climb_m_s) / gap_s
            knows = kind is self.kind is Kind.PATH and gap_s <= _STREAM_GAP_S
            knows = knows and not any(self._feed) and abs(slope) <= limits.acceleration_m_s2
            knows = knows and abs(slope_up) <= limits.acceleration_vertical_m_s2
            self._slope = (slope, slope_up) if knows else STILL
            self._interval_s = gap_s if knows else 0.0
        return True

    def fly_target(self) -> Order:
        """GUIDED."""
        if self.estimate.aiding:
            target, age_s = self._target, self.now_s - self._heard_s
            if target is not None and self.kind is Kind.PATH and age_s <= self._timeout_s:
                return self._track(target, age_s)
            if self._tracks:
                self._tracks = False
                self.control.start_climb()
                self.control.follow(self.copter.acceleration_m_s2)
        return super().fly_target()

    def _track(self, target: Place, age_s: float) -> Order:
        """Acceleration by the errors of position and velocity."""
        estimate, (speed_m_s, up_m_s, _) = self.estimate, self.tuning.speeds_m_s
        self._tracks = True
        ahead_s = age_s if age_s <= 2.0 * self._interval_s else 0.0
        off_m = self.control.off_m(target)
        rise_m = target.altitude_amsl_m - estimate.altitude_amsl_m
        (velocity, climb_m_s), (feed, feed_up) = self._moves, self._feed
        late, late_up = velocity - estimate.velocity_m_s, climb_m_s - estimate.velocity_up_m_s
        level, most_up = clipped(off_m * KP_1_S2, KV_1_S * speed_m_s), KV_1_S * up_m_s
        up = min(max(rise_m * KP_1_S2, -most_up), most_up)
        return (
            level + KV_1_S * (late + self._slope[0] * ahead_s) + feed,
            up + KV_1_S * (late_up + self._slope[1] * ahead_s) + feed_up,
        )
