"""How PX4 guides a fixed wing along a path: NPFG, from where it is to a bank angle.

Pure functions on plain floats (the inner loop calls them a hundred times a second); north and east
in metres, bearings as unit vectors, curvature and lateral acceleration positive to the right.

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
    """The nearest point of a path, its direction there and its curvature, 1/m."""

    north_m: float
    east_m: float
    along_north: float
    along_east: float
    curvature_1_m: float = 0.0


def towards(
    north_m: float, east_m: float, point_north_m: float, point_east_m: float
) -> Path | None:
    """Straight at a point, from here; None while standing on it."""
    north, east = point_north_m - north_m, point_east_m - east_m
    away_m = math.hypot(north, east)
    if away_m < 1e-3:
        return None
    return Path(point_north_m, point_east_m, north / away_m, east / away_m)


def along(
    point_north_m: float, point_east_m: float, v_north: float, v_east: float, curvature_1_m: float
) -> Path | None:
    """A point on the path and its tangent, of any size but none; None for none."""
    size = math.hypot(v_north, v_east)
    if size < 1e-6:
        return None
    return Path(point_north_m, point_east_m, v_north / size, v_east / size, curvature_1_m)


def line(
    north_m: float,
    east_m: float,
    start_north_m: float,
    start_east_m: float,
    along_north: float,
    along_east: float,
) -> Path:
    """The straight line through a point in a direction (of unit length)."""
    done_m = (north_m - start_north_m) * along_north + (east_m - start_east_m) * along_east
    return Path(
        start_north_m + done_m * along_north,
        start_east_m + done_m * along_east,
        along_north,
        along_east,
    )


def leg(
    north_m: float,
    east_m: float,
    start_north_m: float,
    start_east_m: float,
    end_north_m: float,
    end_east_m: float,
    switch_m: float,
) -> Path | None:
    """From waypoint to waypoint: first to the start if that lies ahead, back if past the end."""
    leg_n, leg_e = end_north_m - start_north_m, end_east_m - start_east_m
    size = math.hypot(leg_n, leg_e)
    if size < 1e-3:
        return towards(north_m, east_m, end_north_m, end_east_m)
    from_n, from_e = north_m - start_north_m, east_m - start_east_m
    if leg_n * from_n + leg_e * from_e < 0.0 and math.hypot(from_n, from_e) > switch_m:
        return towards(north_m, east_m, start_north_m, start_east_m)
    if leg_n * (north_m - end_north_m) + leg_e * (east_m - end_east_m) > 0.0:
        return towards(north_m, east_m, end_north_m, end_east_m)
    return line(north_m, east_m, start_north_m, start_east_m, leg_n / size, leg_e / size)


def circle(
    north_m: float,
    east_m: float,
    centre_north_m: float,
    centre_east_m: float,
    radius_m: float,
    v_north: float,
    v_east: float,
) -> Path:
    """About a centre, clockwise, or anticlockwise with a negative radius; never a radius of 0."""
    out_n, out_e = north_m - centre_north_m, east_m - centre_east_m
    away_m = math.hypot(out_n, out_e)
    if away_m < 0.1:
        out_n, out_e = v_north, v_east
        away_m = math.hypot(out_n, out_e)
        if away_m < 0.1:
            out_n, out_e, away_m = 1.0, 0.0, 1.0
    out_n, out_e = out_n / away_m, out_e / away_m
    size_m, way = abs(radius_m), math.copysign(1.0, radius_m)
    return Path(
        centre_north_m + out_n * size_m,
        centre_east_m + out_e * size_m,
        -way * out_e,
        way * out_n,
        way / size_m,
    )


def _feasible(across: float, along: float, airspeed: float, wind: float) -> float:
    """1 for a bearing that this wind lets be flown, 0 for one that it does not, and between."""
    across = wind if along < 0.0 else abs(across)
    share = min(max((airspeed - across) / AIRSPEED_BUFFER_M_S, 0.0), 1.0)
    return math.sin(0.5 * math.pi * share) ** 2


def bearing(
    path: Path,
    north_m: float,
    east_m: float,
    v_north: float,
    v_east: float,
    wind_north: float,
    wind_east: float,
    gains: Gains,
) -> tuple[float, float, float]:
    """Course to fly (unit vector), and the lateral acceleration that the path's curvature takes.

    Position, velocity over ground and wind, in metres and m/s.
    """
    tn, te = path.along_north, path.along_east
    off_n, off_e = north_m - path.north_m, east_m - path.east_m
    error_m = tn * off_e - te * off_n  # positive: right of the path
    share = min(abs(error_m) / gains.pull_m(math.hypot(v_north, v_east)), 1.0)
    ahead_rad = 0.5 * math.pi * (share - 1.0) * (share - 1.0)
    sine, cosine = math.sin(ahead_rad), math.cos(ahead_rad)
    side = 1.0 if error_m < 0.0 else -1.0  # to the right, or left
    course_n = sine * tn - cosine * side * te
    course_e = sine * te + cosine * side * tn
    curvature = path.curvature_1_m
    if curvature == 0.0:
        return course_n, course_e, 0.0

    air_n, air_e = v_north - wind_north, v_east - wind_east
    airspeed, wind = math.hypot(air_n, air_e), math.hypot(wind_north, wind_east)
    across = wind_north * te - wind_east * tn
    tail = wind_north * tn + wind_east * te
    feasible = _feasible(across, tail, airspeed, wind) * _feasible(
        wind_north * course_e - wind_east * course_n,
        wind_north * course_n + wind_east * course_e,
        airspeed,
        wind,
    )
    here = curvature / max(1.0 - curvature * error_m, abs(curvature) * LEAST_RADIUS_M)
    rate_rad_s = here * max(v_north * tn + v_east * te, 0.0)
    through_air = math.sqrt(max(airspeed * airspeed - across * across, 0.0))
    ratio = 1.0 + tail / max(through_air, 1e-6)
    return course_n, course_e, airspeed * ratio * rate_rad_s * feasible * sine * sine


def heading_for(
    course_n: float, course_e: float, wind_north: float, wind_east: float, airspeed: float
) -> tuple[float, float]:
    """Direction of the nose (unit vector) that flies this course in this wind."""
    across = wind_north * course_e - wind_east * course_n
    tail = wind_north * course_n + wind_east * course_e
    wind = math.hypot(wind_north, wind_east)
    if abs(across) < airspeed and (tail > 0.0 or wind < airspeed):
        through = math.sqrt(airspeed * airspeed - across * across)
        north = through * course_n - across * course_e
        east = across * course_n + through * course_e
    else:
        push = math.sqrt(max(wind * wind - airspeed * airspeed, 0.0))
        north, east = push * course_n - wind_north, push * course_e - wind_east
    size = math.hypot(north, east)
    return (north / size, east / size) if size > 1e-9 else (course_n, course_e)


def turn_m_s2(
    heading_n: float,
    heading_e: float,
    wanted_n: float,
    wanted_e: float,
    airspeed: float,
    gain: float,
) -> float:
    """Lateral acceleration that turns the nose to a direction: the most beyond a right angle."""
    across = heading_n * wanted_e - heading_e * wanted_n
    if heading_n * wanted_n + heading_e * wanted_e < 0.0:
        across = -1.0 if across < 0.0 else 1.0
    return gain * airspeed * across


def bank_rad(lateral_m_s2: float, most_rad: float) -> float:
    """The bank of a level turn with this acceleration, within a limit (FW_R_LIM)."""
    return min(max(math.atan(lateral_m_s2 / GRAVITY_M_S2), -most_rad), most_rad)
