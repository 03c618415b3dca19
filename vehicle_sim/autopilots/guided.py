"""GUIDED: the target that runs on between setpoints, and the laws that steer for it.

Position and velocity streamed: the vehicle accelerates by the errors in both,

    a = KP (p_target - p) + KV (v_target - v),

without a feed-forward of acceleration, which ArduCopter drops from SET_POSITION_TARGET_GLOBAL_INT:
in a steady turn it is a / KP to the outside.  Everything else (stopping, flying to a position, the
end of a stream) goes through the Shaper, whose acceleration and jerk are limited as WPNAV_ACCEL and
PSC_JERK_XY say.
"""

import enum
import math
from dataclasses import dataclass
from typing import final

from vehicle_sim.autopilots import Place
from vehicle_sim.autopilots.setpoints import Target, Vector
from vehicle_sim.dynamics import Copter
from vehicle_sim.geodesy import metres_per_degree

KP_1_S2 = 0.75
KV_1_S = 4.0
"""Well damped (2.3): the vehicle's acceleration overshoots a step of the path's by 4 %."""
_APPROACH_1_S = 0.5
_APPROACH_BRAKING = 0.54
"""Share of WPNAV_ACCEL used on the way to a position: it trails a stream by 35 m at 10 m/s."""
_STREAM_GAP_S = 0.5


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Tuning:
    """The autopilot's parameters in SI units."""

    timeout_s: float
    speed_m_s: float
    acceleration_m_s2: float
    jerk_m_s3: float
    speed_up_m_s: float
    speed_down_m_s: float
    land_speed_m_s: float


class Submode(enum.Enum):
    """What GUIDED steers for."""

    STOP = enum.auto()
    POSITION = enum.auto()
    VELOCITY = enum.auto()
    POSITION_VELOCITY = enum.auto()


@final
class Shaper:
    """Horizontal acceleration towards a velocity, limited in size and in jerk."""

    __slots__ = ("east_m_s2", "north_m_s2")

    def __init__(self) -> None:
        self.north_m_s2 = self.east_m_s2 = 0.0

    def follow(self, copter: Copter) -> None:
        """Start from what the vehicle does now."""
        self.north_m_s2 = copter.acceleration_north_m_s2
        self.east_m_s2 = copter.acceleration_east_m_s2

    def towards(
        self,
        copter: Copter,
        velocity_m_s: tuple[float, float],
        *,
        most_m_s2: float,
        jerk_m_s3: float,
        dt_s: float,
    ) -> tuple[float, float]:
        """North and east acceleration, one step on."""
        # A gain above jerk / acceleration could not let go in time and would swing back.
        gain = min(KV_1_S, jerk_m_s3 / most_m_s2)
        north_m_s, east_m_s = velocity_m_s
        north = gain * (north_m_s - copter.velocity_north_m_s)
        east = gain * (east_m_s - copter.velocity_east_m_s)
        north, east = _clipped(north, east, most_m_s2)
        most_step = jerk_m_s3 * dt_s
        north, east = _clipped(north - self.north_m_s2, east - self.east_m_s2, most_step)
        self.north_m_s2 += north
        self.east_m_s2 += east
        return self.north_m_s2, self.east_m_s2


def _clipped(north: float, east: float, most: float) -> tuple[float, float]:
    size = math.hypot(north, east)
    return (north, east) if size <= most else (north * most / size, east * most / size)


def climb_m_s(up_m: float, tuning: Tuning, most_m_s2: float) -> float:
    """Vertical speed that comes to rest up_m above (negative: below) here."""
    speed = min(abs(up_m), math.sqrt(most_m_s2 * abs(up_m)))  # brakes with half of what it has
    return min(speed, tuning.speed_up_m_s) if up_m > 0.0 else -min(speed, tuning.speed_down_m_s)


@final
class Guided:
    """The target, and the acceleration that steers for it."""

    __slots__ = (
        "_interval_s",
        "_slope",
        "acceleration",
        "altitude_amsl_m",
        "latitude_deg",
        "longitude_deg",
        "received_us",
        "shaper",
        "submode",
        "tuning",
        "velocity",
        "yaw_rad",
    )

    def __init__(self, tuning: Tuning, shaper: Shaper) -> None:
        self.tuning = tuning
        self.shaper = shaper
        self.latitude_deg = self.longitude_deg = self.altitude_amsl_m = 0.0
        self.received_us = 0
        self.stop()

    def stop(self) -> None:
        """Steer for a standstill."""
        self.submode = Submode.STOP
        self.velocity: Vector = (0.0, 0.0, 0.0)
        self.acceleration: Vector = (0.0, 0.0, 0.0)
        self.yaw_rad: float | None = None
        self._slope: Vector = (0.0, 0.0, 0.0)
        self._interval_s = 0.0

    def take(self, target: Target, now_us: int, copter: Copter) -> None:
        """Steer for this from now on."""
        submode = (
            Submode.VELOCITY
            if target.place is None
            else Submode.POSITION
            if target.velocity_neu_m_s is None
            else Submode.POSITION_VELOCITY
        )
        velocity = target.velocity_neu_m_s or (0.0, 0.0, 0.0)
        if any(target.acceleration_neu_m_s2):
            self._slope = (0.0, 0.0, 0.0)  # it says by itself how its velocity changes
        else:
            self._learn_slope(velocity, submode, now_us, copter)
        self.submode = submode
        if target.place is not None:
            self.hold(target.place)
        self.velocity, self.acceleration = velocity, target.acceleration_neu_m_s2
        self.yaw_rad = target.yaw_rad
        self.received_us = now_us

    def hold(self, place: Place) -> None:
        """Put the target here."""
        self.latitude_deg, self.longitude_deg = place.latitude_deg, place.longitude_deg
        self.altitude_amsl_m = place.altitude_amsl_m

    def _learn_slope(self, velocity: Vector, submode: Submode, now_us: int, copter: Copter) -> None:
        """How fast the stream's velocity changes.

        Between setpoints the velocity error is taken against a velocity that goes on changing like
        this: held still, it would saw the acceleration up and down at the rate of the stream.
        """
        gap_s = (now_us - self.received_us) * 1e-6
        if gap_s < 1e-3:
            return
        before, most_m_s2 = self.velocity, copter.limits.acceleration_m_s2
        slope = tuple((new - old) / gap_s for new, old in zip(velocity, before, strict=True))
        streams = submode is self.submode is Submode.POSITION_VELOCITY and gap_s <= _STREAM_GAP_S
        smooth = math.hypot(slope[0], slope[1]) <= most_m_s2 and (
            abs(slope[2]) <= copter.limits.acceleration_vertical_m_s2
        )
        learnt = streams and smooth
        self._slope = (slope[0], slope[1], slope[2]) if learnt else (0.0, 0.0, 0.0)
        self._interval_s = gap_s if learnt else 0.0

    def lapsed(self, now_us: int) -> bool:
        """Whether the stream has ended: nothing for GUID_TIMEOUT."""
        return now_us - self.received_us > max(self.tuning.timeout_s, 0.1) * 1e6

    def run(self, now_us: int, dt_s: float) -> None:
        """Let the target run on with its velocity."""
        if self.submode in (Submode.STOP, Submode.POSITION):
            return
        if self.lapsed(now_us):
            self.velocity = self.acceleration = self._slope = (0.0, 0.0, 0.0)
            return
        north, east, up = self.velocity
        if self.submode is Submode.POSITION_VELOCITY:
            metres_north, metres_east = metres_per_degree(self.latitude_deg)
            self.latitude_deg += north * dt_s / metres_north
            self.longitude_deg += east * dt_s / metres_east
            self.altitude_amsl_m += up * dt_s
        a_n, a_e, a_u = self.acceleration
        self.velocity = (north + a_n * dt_s, east + a_e * dt_s, up + a_u * dt_s)

    def wanted(self, copter: Copter, now_us: int, dt_s: float) -> Vector:
        """Acceleration north, east and up, in m/s^2."""
        if self.submode is Submode.POSITION_VELOCITY and not self.lapsed(now_us):
            self.shaper.follow(copter)
            return self._track(copter, now_us)
        north, east, up = self.velocity
        if self.submode in (Submode.POSITION, Submode.POSITION_VELOCITY):
            north, east, up = self._approach(copter)
        tuning = self.tuning
        most_m_s2 = min(tuning.acceleration_m_s2, copter.limits.acceleration_m_s2)
        a_n, a_e = self.shaper.towards(
            copter, (north, east), most_m_s2=most_m_s2, jerk_m_s3=tuning.jerk_m_s3, dt_s=dt_s
        )
        return a_n, a_e, KV_1_S * (up - copter.velocity_up_m_s)

    def _errors_m(self, copter: Copter) -> Vector:
        """From the vehicle to the target."""
        metres_north, metres_east = metres_per_degree(copter.latitude_deg)
        east_deg = self.longitude_deg - copter.longitude_deg
        if abs(east_deg) > 180.0:
            east_deg -= math.copysign(360.0, east_deg)
        return (
            (self.latitude_deg - copter.latitude_deg) * metres_north,
            east_deg * metres_east,
            self.altitude_amsl_m - copter.altitude_amsl_m,
        )

    def _track(self, copter: Copter, now_us: int) -> Vector:
        """Position and velocity."""
        north_m, east_m, up_m = self._errors_m(copter)
        north, east = _clipped(north_m * KP_1_S2, east_m * KP_1_S2, KV_1_S * self.tuning.speed_m_s)
        most_up = KV_1_S * self.tuning.speed_up_m_s
        up = min(max(up_m * KP_1_S2, -most_up), most_up)
        age_s = (now_us - self.received_us) * 1e-6
        ahead_s = age_s if age_s <= 2.0 * self._interval_s else 0.0
        v_n, v_e, v_u = self.velocity
        s_n, s_e, s_u = self._slope
        a_n, a_e, a_u = self.acceleration
        return (
            north + KV_1_S * (v_n + s_n * ahead_s - copter.velocity_north_m_s) + a_n,
            east + KV_1_S * (v_e + s_e * ahead_s - copter.velocity_east_m_s) + a_e,
            up + KV_1_S * (v_u + s_u * ahead_s - copter.velocity_up_m_s) + a_u,
        )

    def _approach(self, copter: Copter) -> Vector:
        """Velocity that comes to rest at the target's position."""
        north_m, east_m, up_m = self._errors_m(copter)
        away_m = math.hypot(north_m, east_m)
        braking_m_s2 = _APPROACH_BRAKING * self.tuning.acceleration_m_s2
        speed = min(_APPROACH_1_S * away_m, math.sqrt(2.0 * braking_m_s2 * away_m))
        share = min(speed, self.tuning.speed_m_s) / away_m if away_m > 1e-6 else 0.0
        climb = climb_m_s(up_m, self.tuning, copter.limits.acceleration_vertical_m_s2)
        return north_m * share, east_m * share, climb
