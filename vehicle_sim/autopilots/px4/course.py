"""What a fixed wing of PX4 flies at the moment, and the commands that fly it.

Modes put in where to go (Course.loiter, follow, aim_at, ...) and how high; Course.steer turns that
into a bank, a climb and an airspeed, by the guidance and the energy control.  What it
knows of itself is the estimate, its heading and its airspeed.

Energy is PX4's total energy control (TECS) as far as it can be seen from outside: height and speed
are one account.  An aeroplane that cannot reach the airspeed that it is told (PX4's simulated one
flies 13.9 m/s at full throttle, FW_AIRSPD_TRIM is 15) stands low by what the missing speed is
worth, about 2 m; and after a climb it takes most of a minute to get to its speed, because only an
integrator finds the last of the throttle.
"""

import enum
import math
from typing import NamedTuple, final

from vehicle_sim.autopilots import Estimate
from vehicle_sim.autopilots.px4.setpoints import Vector
from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.parameters import Parameters

# --- How PX4 guides a fixed wing along a path: NPFG, from where it is to a bank angle -------------
# Pure functions; places, velocities and directions in the plane are complex numbers, north + east
# j; curvature and lateral acceleration are positive to the right. The law is PX4's own
# (src/lib/npfg: DirectionalGuidance, CourseToAirspeedRefMapper, AirspeedDirectionController)
# without its adaptation of the period to curvature in wind, which the default gains never reach.
# Near a straight path it is a damped oscillator of period NPFG_PERIOD and damping NPFG_DAMPING in
# the distance off the path; a path of curvature k that it is told to be straight is flown V^2 k
# (period / 2 pi)^2 outside of it: 4.9 m at 13.9 m/s and a radius of 100 m.

AIRSPEED_BUFFER_M_S = 1.5
"""A bearing that leaves less airspeed than this across the wind is only partly feasible."""
MIN_RADIUS_M = 0.5
SWITCH_DISTANCE = 0.32
"""NPFG_SW_DST_MLT: share of the distance at which a path begins to pull."""
PERIOD_SAFETY = 1.5
"""NPFG_PERIOD_SF."""
WAYPOINT_MOST_M = 500.0


@final
class Gains(NamedTuple):
    """NPFG_PERIOD, bounded from below by what the roll response allows, and NPFG_DAMPING."""

    period_s: float
    damping: float

    @property
    def turn_1_s(self) -> float:
        """Lateral acceleration for each m/s of velocity across the wanted direction."""
        return 4.0 * math.pi * self.damping / self.period_s

    def pull_m(self, ground_speed_m_s: float) -> float:
        """Distance off the path from which it is approached at a right angle."""
        speed = ground_speed_m_s
        if speed <= 1.0:
            speed = 0.5 * (speed * speed + 1.0)
        return speed * self.period_s * self.damping

    def switch_m(self, ground_speed_m_s: float) -> float:
        """Distance at which a waypoint counts as reached (31 m at 13.9 m/s)."""
        return min(WAYPOINT_MOST_M, SWITCH_DISTANCE * self.pull_m(ground_speed_m_s))


def gains_of(period_s: float, damping: float, roll_response_s: float) -> Gains:
    """The gains that these parameters give."""
    damping = min(max(damping, 0.01), 1.0)
    least_s = PERIOD_SAFETY * math.pi * roll_response_s / damping
    return Gains(period_s=max(period_s, least_s, 0.1), damping=damping)


@final
class Path(NamedTuple):
    """The nearest point of a path, its direction there (of unit length) and its curvature, 1/m."""

    point_m: complex
    along: complex
    curvature_1_m: float = 0.0


def size(vector: complex) -> float:
    """Its length."""
    return math.hypot(vector.real, vector.imag)


def dot(one: complex, other: complex) -> float:
    """Inner product."""
    return one.real * other.real + one.imag * other.imag


def cross(one: complex, other: complex) -> float:
    """Positive where the other one lies to the right."""
    return one.real * other.imag - one.imag * other.real


def towards(here_m: complex, point_m: complex) -> Path | None:
    """Straight at a point, from here; None while standing on it."""
    away_m = size(point_m - here_m)
    return None if away_m < 1e-3 else Path(point_m, (point_m - here_m) / away_m)


def along(point_m: complex, velocity_m_s: complex, curvature_1_m: float) -> Path | None:
    """A point on the path and its tangent, of any size but none; None for none."""
    speed = size(velocity_m_s)
    return None if speed < 1e-6 else Path(point_m, velocity_m_s / speed, curvature_1_m)


def line(here_m: complex, start_m: complex, direction: complex) -> Path:
    """The straight line through a point in a direction (of unit length)."""
    return Path(start_m + dot(here_m - start_m, direction) * direction, direction)


def leg(here_m: complex, start_m: complex, end_m: complex, switch_m: float) -> Path | None:
    """From waypoint to waypoint: first to the start if that lies ahead, back if past the end."""
    way_m, from_m = end_m - start_m, here_m - start_m
    length_m = size(way_m)
    if length_m < 1e-3:
        return towards(here_m, end_m)
    if dot(way_m, from_m) < 0.0 and size(from_m) > switch_m:
        return towards(here_m, start_m)
    if dot(way_m, here_m - end_m) > 0.0:
        return towards(here_m, end_m)
    return line(here_m, start_m, way_m / length_m)


def circle(here_m: complex, centre_m: complex, radius_m: float, velocity_m_s: complex) -> Path:
    """About a centre, clockwise, or anticlockwise with a negative radius; never a radius of 0."""
    out = here_m - centre_m
    away_m = size(out)
    if away_m < 0.1:
        out, away_m = velocity_m_s, size(velocity_m_s)
        if away_m < 0.1:
            out, away_m = 1.0 + 0.0j, 1.0
    out /= away_m
    radius_size_m, way = abs(radius_m), math.copysign(1.0, radius_m)
    return Path(centre_m + out * radius_size_m, way * (1j * out), way / radius_size_m)


def _feasible(across: float, along: float, airspeed: float, wind: float) -> float:
    """1 for a bearing that this wind lets be flown, 0 for one that it does not, and between."""
    across = wind if along < 0.0 else abs(across)
    share = min(max((airspeed - across) / AIRSPEED_BUFFER_M_S, 0.0), 1.0)
    return math.sin(0.5 * math.pi * share) ** 2


def bearing(
    path: Path, here_m: complex, velocity_m_s: complex, wind_m_s: complex, gains: Gains
) -> tuple[complex, float]:
    """Course to fly (unit vector), and the lateral acceleration that the path's curvature takes.

    Of position, velocity over ground and wind.
    """
    tangent, curvature = path.along, path.curvature_1_m
    error_m = cross(tangent, here_m - path.point_m)  # positive: right of the path
    share = min(abs(error_m) / gains.pull_m(size(velocity_m_s)), 1.0)
    ahead_rad = 0.5 * math.pi * (share - 1.0) * (share - 1.0)
    sine, cosine = math.sin(ahead_rad), math.cos(ahead_rad)
    side = 1.0 if error_m < 0.0 else -1.0  # to the right, or left
    course = sine * tangent + cosine * side * (1j * tangent)
    if curvature == 0.0:
        return course, 0.0

    airspeed, wind = size(velocity_m_s - wind_m_s), size(wind_m_s)
    across, tail = cross(wind_m_s, tangent), dot(wind_m_s, tangent)
    feasible = _feasible(across, tail, airspeed, wind) * _feasible(
        cross(wind_m_s, course), dot(wind_m_s, course), airspeed, wind
    )
    here = curvature / max(1.0 - curvature * error_m, abs(curvature) * MIN_RADIUS_M)
    rate_rad_s = here * max(dot(velocity_m_s, tangent), 0.0)
    through_air = math.sqrt(max(airspeed * airspeed - across * across, 0.0))
    ratio = 1.0 + tail / max(through_air, 1e-6)
    return course, airspeed * ratio * rate_rad_s * feasible * sine * sine


def heading_for(course: complex, wind_m_s: complex, airspeed: float) -> complex:
    """Direction of the nose (unit vector) that flies this course in this wind."""
    across, tail, wind = cross(wind_m_s, course), dot(wind_m_s, course), size(wind_m_s)
    if abs(across) < airspeed and (tail > 0.0 or wind < airspeed):
        nose = math.sqrt(airspeed * airspeed - across * across) * course + across * (1j * course)
    else:
        nose = math.sqrt(max(wind * wind - airspeed * airspeed, 0.0)) * course - wind_m_s
    length = size(nose)
    return nose / length if length > 1e-9 else course


def turn_m_s2(heading: complex, wanted: complex, airspeed: float, gain: float) -> float:
    """Lateral acceleration that turns the nose to a direction: the most beyond a right angle."""
    across = cross(heading, wanted)
    if dot(heading, wanted) < 0.0:
        across = -1.0 if across < 0.0 else 1.0
    return gain * airspeed * across


def bank_rad(lateral_m_s2: float, most_rad: float) -> float:
    """The bank of a level turn with this acceleration, within a limit (FW_R_LIM)."""
    return min(max(math.atan(lateral_m_s2 / GRAVITY_M_S2), -most_rad), most_rad)


CLIMB_COSTS = 0.45
"""Airspeed lost for each m/s of climb at full throttle: 12.8 m/s at 2.5 m/s of climb, 13.95 level
(px4-fixedwing-offboard.tlog, 6-25 s and 230-355 s)."""
RECOVERY_M_S2 = 0.033
"""The integrator's speed: 12.3 m/s at 175 s, 14.0 at 230 s of that log."""
RECOVERS_AT_ONCE_M_S = 1.6
"""What is further off than this is found without the integrator."""
AHEAD_M_S = 0.05
"""What is told is no more than this above what is flown."""
SLOWS_DOWN_S = 2.0
"""Time constant: 13.8 to 11.5 m/s in 4.5 s when the landing begins."""
MAX_TRADED_M = 15.0


def true_airspeed_m_s(equivalent_m_s: float, altitude_amsl_m: float) -> float:
    """Airspeed parameters are equivalent ones: in the standard atmosphere, at this height."""
    return equivalent_m_s / math.sqrt(max(1.0 - 2.25577e-5 * altitude_amsl_m, 0.1) ** 4.2559)


_WIND_S = 5.0
"""Time constant of the wind estimate."""
_LEVEL_THROTTLE_S_M, _CLIMB_THROTTLE_S_M = 0.0875, 0.1
"""Throttle for each m/s of airspeed and of climb: 86 % at 12.3 m/s, 100 % at 13.9, 64 % at 10.7
and 0.85 m/s of sink (px4-fixedwing-offboard.tlog)."""
_ON_CIRCLE_M = 15.0


@final
class Limits(NamedTuple):
    """Parameters, in SI units and within sense."""

    gains: Gains
    bank_most_rad: float
    bank_rate_rad_s: float
    altitude_response_s: float
    climb_most_m_s: float
    sink_most_m_s: float
    altitude_reached_m: float

    @classmethod
    def of(cls, parameters: Parameters) -> "Limits":
        """As they are set now."""
        rate = parameters["FW_PN_R_SLEW_MAX"]
        return cls(
            gains=gains_of(
                parameters["NPFG_PERIOD"],
                parameters["NPFG_DAMPING"],
                parameters["NPFG_ROLL_TC"] if parameters["NPFG_LB_PERIOD"] else 0.0,
            ),
            bank_most_rad=math.radians(parameters["FW_R_LIM"]),
            bank_rate_rad_s=math.radians(rate) if rate > 0.0 else math.inf,
            altitude_response_s=parameters["FW_T_ALT_TC"],
            climb_most_m_s=min(parameters["FW_T_CLMB_R_SP"], parameters["FW_T_CLMB_MAX"]),
            sink_most_m_s=min(parameters["FW_T_SINK_R_SP"], parameters["FW_T_SINK_MAX"]),
            altitude_reached_m=parameters["NAV_FW_ALT_RAD"],
        )


class _Kind(enum.Enum):
    STAY = enum.auto()
    BLIND = enum.auto()
    LINE = enum.auto()
    CIRCLE = enum.auto()
    POINT = enum.auto()
    LEG = enum.auto()
    PATH = enum.auto()


@final
class Course:
    """Where to, how high, how fast; and the commands of the moment.  Mutable."""

    def __init__(self, plane: Plane, limits: Limits) -> None:
        self._plane = plane
        self.limits = limits
        self._kind = _Kind.STAY
        self._a = self._b = 0j
        """Centre, target or end of the leg; tangent, direction or start of the leg."""
        self._altitude_m = 0.0
        self._bank_wanted_rad = 0.0
        self._settling = False
        """At its point but not at its height: circles until it is."""
        self._wind_m_s = 0j
        self._at_once = False
        self.climb_rate_m_s = math.nan
        """What to climb; NaN: what leads to the altitude."""
        self.curvature_1_m = 0.0
        self.radius_m = 80.0
        self.airspeed_m_s = 0.0
        """True airspeed to aim at."""
        self.bank_most_rad = math.pi
        """Near the ground."""
        self.bank_rad = self.climb_m_s = self.commanded_m_s = 0.0
        """To command; the last is the airspeed."""
        self.throttle = 0.0
        self.nearest_m = 0j
        """Of the path, in the local frame."""
        self.landing = False

    # --- where to -----------------------------------------------------------------------------

    def stay(self) -> None:
        """Keep the last commands."""
        self._kind = _Kind.STAY

    def circle_blindly(self, bank_rad: float) -> None:
        """At this bank, wherever that leads."""
        self._kind, self._bank_wanted_rad = _Kind.BLIND, bank_rad

    def straight(self, from_m: Vector, way_rad: float) -> None:
        """Along the line through a point."""
        self._kind = _Kind.LINE
        self._a = complex(from_m[0], from_m[1])
        self._b = complex(math.cos(way_rad), math.sin(way_rad))

    def loiter(self, centre_m: complex, radius_m: float) -> None:
        """About a place; a negative radius: to the left."""
        self._kind, self.landing = _Kind.CIRCLE, False
        self._a, self.radius_m = centre_m, radius_m

    def aim_at(self, point_m: complex, radius_m: float) -> None:
        """Straight at a point; about it if there but not at its height."""
        if self._kind is not _Kind.POINT:
            self._settling = False
        self._kind = _Kind.POINT
        self._a, self.radius_m = point_m, radius_m

    def fly_leg(self, start_m: complex, end_m: complex, radius_m: float) -> None:
        """From one waypoint to the next; about that if there but not at its height."""
        self._kind, self._settling = _Kind.LEG, False
        self._a, self._b = end_m, start_m
        self.radius_m = radius_m

    def follow(self, point_m: complex, velocity_m_s: complex, curvature_1_m: float) -> None:
        """A path: a point of it, its tangent there and its curvature."""
        self._kind = _Kind.PATH
        self._a, self._b, self.curvature_1_m = point_m, velocity_m_s, curvature_1_m

    # --- how high -----------------------------------------------------------------------------

    def hold_altitude(self, altitude_amsl_m: float) -> None:
        """Climb or sink to this height."""
        self._altitude_m, self.climb_rate_m_s = altitude_amsl_m, math.nan
        self._at_once = False

    def climb(self, rate_m_s: float) -> None:
        """Climb at this rate, independent of height; negative: sink."""
        self.climb_rate_m_s, self._at_once = rate_m_s, False

    def climb_out(self, rate_m_s: float) -> None:
        """At this rate and full throttle after take-off."""
        self.climb_rate_m_s, self._at_once = rate_m_s, True

    # --- what of it is told -------------------------------------------------------------------

    @property
    def circling(self) -> bool:
        """It flies about a place."""
        return self._kind is _Kind.CIRCLE

    @property
    def holds_altitude(self) -> bool:
        """And not a climb rate."""
        return self.climb_rate_m_s != self.climb_rate_m_s

    @property
    def told_altitude_m(self) -> float:
        """The navigator's altitude; 0 in a landing, as recorded."""
        return self._altitude_m if self.holds_altitude or not self.circling else 0.0

    @property
    def centre_m(self) -> complex:
        """Of the circle, or the place to fly to."""
        return self._a

    def distance_m(self, local_m: Vector) -> float:
        """To the place."""
        return size(self._a - complex(local_m[0], local_m[1]))

    def on_circle(self, local_m: Vector) -> bool:
        """It circles, and is where the circle is."""
        off_m = abs(self.distance_m(local_m) - abs(self.radius_m))
        return self.circling and off_m < _ON_CIRCLE_M

    def switch_m(self, estimate: Estimate) -> float:
        """Distance at which a waypoint is reached."""
        return self.limits.gains.switch_m(
            math.hypot(estimate.velocity_north_m_s, estimate.velocity_east_m_s)
        )

    # --- commands -----------------------------------------------------------------------------

    def start(self, airspeed_m_s: float) -> None:
        """It has left the ground at this airspeed."""
        self.commanded_m_s = airspeed_m_s
        self.bank_rad = self._bank_wanted_rad = 0.0
        self._wind_m_s = 0j

    def steer(self, local_m: Vector, estimate: Estimate, dt_s: float) -> None:
        """New commands."""
        plane, limits = self._plane, self.limits
        airspeed = max(plane.airspeed_m_s, 1.0)
        heading = complex(math.cos(plane.heading_rad), math.sin(plane.heading_rad))
        velocity = complex(estimate.velocity_north_m_s, estimate.velocity_east_m_s)
        here, gains = complex(local_m[0], local_m[1]), limits.gains
        self._wind_m_s += (velocity - airspeed * heading - self._wind_m_s) * (dt_s / _WIND_S)
        wind = self._wind_m_s

        path = self._path(here, velocity, estimate.altitude_amsl_m)
        if path is not None:
            self.nearest_m = path.point_m
            course, lateral = bearing(path, here, velocity, wind, gains)
            nose = heading_for(course, wind, airspeed)
            lateral += turn_m_s2(heading, nose, airspeed, gains.turn_1_s)
            self._bank_wanted_rad = bank_rad(lateral, limits.bank_most_rad)
        most = self.bank_most_rad
        wanted = min(max(self._bank_wanted_rad, -most), most)
        step = limits.bank_rate_rad_s * dt_s
        self.bank_rad += min(max(wanted - self.bank_rad, -step), step)
        if self._kind is not _Kind.STAY:
            self._balance(estimate.altitude_amsl_m, airspeed, dt_s)

    def _balance(self, altitude_m: float, airspeed: float, dt_s: float) -> None:
        """Climb, airspeed and throttle."""
        level_m_s = self._plane.limits.airspeed_max_m_s
        rate_m_s = self.climb_rate_m_s
        self.climb_m_s = rate_m_s if rate_m_s == rate_m_s else self._climb(altitude_m, airspeed)
        self._speed_up(airspeed, dt_s)
        effort = (airspeed - level_m_s) * _LEVEL_THROTTLE_S_M
        effort += 1.0 + self.climb_m_s * _CLIMB_THROTTLE_S_M
        self.throttle = min(max(effort, 0.0), 1.0)

    def _climb(self, altitude_m: float, airspeed: float) -> float:
        """Towards the height, less what the airspeed lacks of the wanted one."""
        limits, wanted_m_s = self.limits, self.airspeed_m_s
        lacking_m = (wanted_m_s * wanted_m_s - airspeed * airspeed) / (2.0 * GRAVITY_M_S2)
        lacking_m = min(max(lacking_m, -MAX_TRADED_M), MAX_TRADED_M)
        climb = (self._altitude_m - lacking_m - altitude_m) / limits.altitude_response_s
        most_m_s = min(limits.climb_most_m_s, self._plane.limits.climb_max_m_s)
        return min(max(climb, -limits.sink_most_m_s), most_m_s)

    def _speed_up(self, airspeed: float, dt_s: float) -> None:
        """Towards the wanted airspeed, with what the climb leaves of the level flight's.

        At once: full throttle or none, not what the integrator finds.
        """
        reach = self._plane.limits.airspeed_max_m_s - CLIMB_COSTS * max(self.climb_m_s, 0.0)
        reach = min(self.airspeed_m_s, reach)
        speed = min(self.commanded_m_s, airspeed + AHEAD_M_S)
        if self._at_once:
            speed = reach
        elif speed > reach:
            speed += (reach - speed) * min(dt_s / SLOWS_DOWN_S, 1.0)
        else:
            speed += RECOVERY_M_S2 * dt_s
            speed = min(max(speed, reach - RECOVERS_AT_ONCE_M_S), reach)
        self.commanded_m_s = speed

    def _path(self, here: complex, velocity: complex, altitude_m: float) -> Path | None:
        """The path at this place; None: keep the bank."""
        kind = self._kind
        if kind is _Kind.PATH:
            return along(self._a, self._b, self.curvature_1_m)
        if kind is _Kind.LINE:
            return line(here, self._a, self._b)
        if kind in (_Kind.STAY, _Kind.BLIND):
            return None
        if kind is _Kind.CIRCLE:
            return circle(here, self._a, self.radius_m, velocity)
        switch_m = self.limits.gains.switch_m(size(velocity))
        if self._settles(size(self._a - here) < switch_m, altitude_m):
            return circle(here, self._a, self.radius_m, velocity)
        if kind is _Kind.POINT:
            return towards(here, self._a)
        return leg(here, self._b, self._a, switch_m)

    def _settles(self, near: bool, altitude_m: float) -> bool:
        """At its point but off its height by more than NAV_FW_ALT_RAD: circle until it is not."""
        off_m = abs(altitude_m - self._altitude_m) if self.holds_altitude else 0.0
        self._settling = off_m > self.limits.altitude_reached_m and (self._settling or near)
        return self._settling
