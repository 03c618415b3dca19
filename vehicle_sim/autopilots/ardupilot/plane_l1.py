"""L1 guidance as ArduPlane flies it: lateral acceleration towards a leg or around a circle.

Metres north and east in a flat earth about some point.  The law is that of Park, Deyst and How
(A new nonlinear guidance logic for trajectory tracking, AIAA 2004-4900) with ArduPilot's period
and damping, and its PD law about circles (ardupilot.md 7).
"""

import math
from typing import final

from vehicle_sim.dynamics.copter import GRAVITY_M_S2

_HALF_PI = 0.5 * math.pi
_UNDECIDED_RAD = 0.9 * math.pi
_PITCH_MOST_RAD = math.radians(60.0)
_INTEGRATES_RAD = math.radians(5.0)
_INTEGRAL_MOST_RAD = 0.1
_PAST_S = 3.0
"""Beyond the end of the leg by so much flight: back to its end."""


@final
class L1:
    """The controller; remembers what it told of the last step."""

    def __init__(self, *, period_s: float, damping: float, integral_gain: float) -> None:
        self.period_s = period_s
        self.damping = damping
        self.integral_gain = integral_gain
        self.circling = False
        """On the circle, and not on the way to it."""
        self.cross_track_m = 0.0
        self.nav_bearing_rad = 0.0
        self.target_bearing_rad = 0.0
        self.length_m = 0.0
        self._before_rad = 0.0
        self._integral_rad = 0.0

    def forget(self) -> None:
        """Begin anew: another leg, another mode."""
        self._integral_rad = 0.0
        self.circling = False

    def _decided(self, nu_rad: float, heading_rad: float) -> float:
        """Go on turning the way it turns when the target is right behind."""
        if (
            abs(nu_rad) > _UNDECIDED_RAD
            and abs(self._before_rad) > _UNDECIDED_RAD
            and nu_rad * self._before_rad < 0.0
            and abs(math.remainder(self.target_bearing_rad - heading_rad, math.tau)) > 2.0944
        ):
            nu_rad = self._before_rad
        self._before_rad = nu_rad
        return min(max(nu_rad, -_HALF_PI), _HALF_PI)

    def _set_length(self, speed_m_s: float) -> None:
        self.length_m = self.damping * self.period_s * speed_m_s / math.pi

    def along_leg(
        self,
        here_ne_m: tuple[float, float],
        leg_ne_m: tuple[float, float],
        velocity_ne_m_s: tuple[float, float],
        heading_rad: float,
        dt_s: float,
    ) -> float:
        """Lateral acceleration, right positive, to follow a leg; both places from its start."""
        north, east = here_ne_m
        leg_n, leg_e = leg_ne_m
        v_n, v_e, speed = _moving(velocity_ne_m_s, heading_rad, 0.1)
        self.circling = False
        self._set_length(speed)
        to_n, to_e = leg_n - north, leg_e - east
        self.target_bearing_rad = math.atan2(to_e, to_n)
        length_m = math.hypot(leg_n, leg_e)
        if length_m < 1e-6:
            unit_n, unit_e = _unit(to_n, to_e, heading_rad)
        else:
            unit_n, unit_e = leg_n / length_m, leg_e / length_m
        self.cross_track_m = north * unit_e - east * unit_n
        along_m = north * unit_n + east * unit_e
        from_start_m = math.hypot(north, east)
        nu1_rad = 0.0
        if from_start_m > self.length_m and along_m < -0.7071 * max(from_start_m, 1.0):
            unit_n, unit_e = -north / from_start_m, -east / from_start_m  # to the start first
        elif along_m > length_m + _PAST_S * speed:
            unit_n, unit_e = _unit(to_n, to_e, heading_rad)
        else:
            sine = self.cross_track_m / max(self.length_m, 0.1)
            nu1_rad = math.asin(min(max(sine, -0.7071), 0.7071)) + self._integrated(sine, dt_s)
        nu_rad = nu1_rad + math.atan2(v_n * unit_e - v_e * unit_n, v_n * unit_n + v_e * unit_e)
        self.nav_bearing_rad = math.atan2(unit_e, unit_n) + nu1_rad
        nu_rad = self._decided(math.remainder(nu_rad, math.tau), heading_rad)
        gain = 4.0 * self.damping * self.damping
        return gain * speed * speed / self.length_m * math.sin(nu_rad)

    def _integrated(self, sine: float, dt_s: float) -> float:
        """The integral of a small cross-track angle, which takes out a steady one."""
        if self.integral_gain <= 0.0:
            self._integral_rad = 0.0
        elif abs(sine) < _INTEGRATES_RAD:
            grown = self._integral_rad + sine * self.integral_gain * dt_s
            self._integral_rad = min(max(grown, -_INTEGRAL_MOST_RAD), _INTEGRAL_MOST_RAD)
        return self._integral_rad

    def around(
        self,
        here_ne_m: tuple[float, float],
        radius_m: float,
        direction: float,
        velocity_ne_m_s: tuple[float, float],
        heading_rad: float,
    ) -> float:
        """Lateral acceleration, right positive, to and around a circle about 0, 0.

        direction: 1 clockwise, -1 the other way.  What is missing of the bank in a steady turn is
        made up for by the PD law, so that the circle flown is wider than this radius.
        """
        north, east = here_ne_m
        v_n, v_e, speed = _moving(velocity_ne_m_s, heading_rad, 1.0)
        self._set_length(speed)
        distance_m = math.hypot(north, east)
        self.target_bearing_rad = math.atan2(-east, -north)
        unit_n, unit_e = _unit(north, east, math.atan2(v_e, v_n))
        across_m_s = unit_n * v_e - unit_e * v_n
        inward_m_s = -(v_n * unit_n + v_e * unit_e)
        nu_rad = self._decided(math.atan2(across_m_s, inward_m_s), heading_rad)
        capture = 4.0 * self.damping**2 * speed * speed / self.length_m * math.sin(nu_rad)

        omega = math.tau / self.period_s
        self.cross_track_m = outside_m = distance_m - radius_m
        pd = outside_m * omega * omega - inward_m_s * 2.0 * self.damping * omega
        tangential_m_s = across_m_s * direction
        if inward_m_s < 0.0 and tangential_m_s < 0.0 and pd < 0.0:
            pd = 0.0
        centripetal = tangential_m_s * tangential_m_s / max(0.5 * radius_m, distance_m, 1e-3)
        circle = direction * (pd + centripetal)
        self.nav_bearing_rad = self.target_bearing_rad
        self.circling = not (outside_m > 0.0 and direction * capture < direction * circle)
        return circle if self.circling else capture


def _moving(
    velocity_ne_m_s: tuple[float, float], heading_rad: float, least_m_s: float
) -> tuple[float, float, float]:
    """Velocity and its size; standing still counts as creeping ahead."""
    v_n, v_e = velocity_ne_m_s
    speed = math.hypot(v_n, v_e)
    if speed < least_m_s:
        return least_m_s * math.cos(heading_rad), least_m_s * math.sin(heading_rad), least_m_s
    return v_n, v_e, speed


def _unit(north: float, east: float, otherwise_rad: float) -> tuple[float, float]:
    """The direction of a vector; of none, this one."""
    size = math.hypot(north, east)
    if size < 1e-6:
        return math.cos(otherwise_rad), math.sin(otherwise_rad)
    return north / size, east / size


def bank_rad(lateral_m_s2: float, pitch_rad: float) -> float:
    """The bank that would turn so in a coordinated turn."""
    pitch_rad = min(max(pitch_rad, -_PITCH_MOST_RAD), _PITCH_MOST_RAD)
    return math.atan(lateral_m_s2 / (GRAVITY_M_S2 * math.cos(pitch_rad)))


def scaled_radius_m(
    radius_m: float, eas2tas: float, *, bank_limit_rad: float, airspeed_m_s: float
) -> float:
    """The radius that is flown where the air is thin: ArduPilot's NAVL1_LIM_BANK rule.

    Without a limit it grows with the square of true over equivalent airspeed; with one, only as far
    as the bank at sea level needs.
    """
    sea_level = math.tan(min(max(bank_limit_rad, 0.0), math.radians(89.0))) * GRAVITY_M_S2
    if sea_level <= 0.0 or airspeed_m_s <= 0.0:
        return radius_m * eas2tas * eas2tas
    least_m = airspeed_m_s * airspeed_m_s / sea_level
    if least_m > radius_m:
        return radius_m * eas2tas * eas2tas
    return max(least_m * eas2tas * eas2tas, radius_m)
