"""How PX4 guides a fixed wing along a path: NPFG, from where it is to a bank angle.

Pure functions; places, velocities and directions in the plane are complex numbers, north + east j;
curvature and lateral acceleration are positive to the right.

The law is PX4's own (src/lib/npfg: DirectionalGuidance, CourseToAirspeedRefMapper,
AirspeedDirectionController) without its adaptation of the period to curvature in wind, which the
default gains never reach.  Near a straight path it is a damped oscillator of period NPFG_PERIOD and
damping NPFG_DAMPING in the distance off the path; a path of curvature k that it is told to be
straight is flown V^2 k (period / 2 pi)^2 outside of it: 4.9 m at 13.9 m/s and a radius of 100 m.
"""

import math
from typing import NamedTuple, final

from vehicle_sim.dynamics.copter import GRAVITY_M_S2

AIRSPEED_BUFFER_M_S = 1.5
"""A bearing that leaves less airspeed than this across the wind is only partly feasible."""
LEAST_RADIUS_M = 0.5
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
    here = curvature / max(1.0 - curvature * error_m, abs(curvature) * LEAST_RADIUS_M)
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
