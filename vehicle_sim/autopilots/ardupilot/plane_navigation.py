"""Where ArduPlane goes: the last and the next point, the circle about it, the height to be at.

Source: ardupilot.md 7 and the recorded flight.  Run ten times a second, as on the real one.
"""

import bisect
import enum
import math
from typing import final

from vehicle_sim.autopilots import Estimate, Place, Waypoint
from vehicle_sim.autopilots.ardupilot.flat_earth import longitude_scale
from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.geodesy import ARDUPILOT_M_PER_DEG, degrees_east
from vehicle_sim.parameters import Parameters

# --- ArduPlane's modes: numbers, names, and which of them do what by themselves -------------------


class Mode(enum.IntEnum):
    """custom_mode of the heartbeat."""

    MANUAL = 0
    CIRCLE = 1
    STABILIZE = 2
    TRAINING = 3
    ACRO = 4
    FBWA = 5
    FBWB = 6
    CRUISE = 7
    AUTOTUNE = 8
    AUTO = 10
    RTL = 11
    LOITER = 12
    TAKEOFF = 13
    GUIDED = 15
    INITIALISING = 16
    THERMAL = 24
    AUTOLAND = 26


NAMES: dict[int, str] = {mode.value: mode.name for mode in Mode}
"""The Q modes (17 to 23, 25) are refused: the airframe is no quadplane."""
GLIDES = frozenset(
    {Mode.MANUAL, Mode.STABILIZE, Mode.TRAINING, Mode.ACRO, Mode.FBWA, Mode.AUTOTUNE}
)
"""Manual throttle without stick input: the motor is off."""
SLOW = frozenset({Mode.FBWB, Mode.CRUISE})
"""The pilot's throttle is the airspeed, which is the least, and height is held."""
LOITERS = frozenset({Mode.GUIDED, Mode.RTL, Mode.LOITER, Mode.THERMAL})
"""They circle the next point."""
AUTONOMOUS = LOITERS | {Mode.AUTO, Mode.TAKEOFF, Mode.CIRCLE, Mode.AUTOLAND}
BY_ITSELF = frozenset(Mode) - {Mode.MANUAL, Mode.INITIALISING}
"""What it navigates to is told in these."""


# --- ArduPlane's hold of height, and its airspeeds: what TECS looks like from outside -------------
# Constants are fitted to the recorded flight arduplane-guided-reposition.tlog: two steps of 10 m
# are followed to 0.2 m rms, the climb while points are streamed to 1.3 m.

DEMAND_S = 3.5
"""Time constant of the demanded height."""
ERROR_S = 5.0
DEMANDED_M_S = (10.0, 20.0, 22.0, 25.0, 30.0)
HELD_M_S = (10.17, 20.34, 22.70, 26.83, 33.0)
"""What is flown at these demands, at sea level: 18 m/s demanded is flown at 18.9, 20 at 21, 22 at
23.5 and 25 at 27.7 m/s, all at 600 m above the sea (ardupilot.md 7), and thin air adds 3 %."""


def _interpolated(x: float, xs: tuple[float, ...], ys: tuple[float, ...]) -> float:
    """Linear between the points, and beyond them in the ratio of the last one."""
    if x <= xs[0]:
        return x * ys[0] / xs[0]
    if x >= xs[-1]:
        return x * ys[-1] / xs[-1]
    k = bisect.bisect_right(xs, x)
    share = (x - xs[k - 1]) / (xs[k] - xs[k - 1])
    return ys[k - 1] + share * (ys[k] - ys[k - 1])


def eas_to_tas(altitude_amsl_m: float) -> float:
    """True over equivalent airspeed in the standard atmosphere, troposphere."""
    if not -1000.0 <= altitude_amsl_m <= 11000.0:
        altitude_amsl_m = min(max(altitude_amsl_m, -1000.0), 11000.0)
    share = 1.0 - 2.25577e-5 * altitude_amsl_m
    ratio: float = share**-2.12794
    return ratio


def true_airspeed_m_s(demanded_m_s: float, altitude_amsl_m: float) -> float:
    """What is flown when this airspeed is asked for."""
    return _interpolated(demanded_m_s, DEMANDED_M_S, HELD_M_S) * eas_to_tas(altitude_amsl_m)


def indicated_airspeed_m_s(true_m_s: float, altitude_amsl_m: float) -> float:
    """What the pitot tube says: the inverse."""
    return _interpolated(true_m_s / eas_to_tas(altitude_amsl_m), HELD_M_S, DEMANDED_M_S)


@final
class HeightControl:
    """From a wanted height to a climb rate: limited in rate, then smoothed, then followed."""

    def __init__(self, *, climb_max_m_s: float, sink_max_m_s: float) -> None:
        self.climb_max_m_s = climb_max_m_s
        self.sink_max_m_s = sink_max_m_s
        self._limited_m = self._smooth_m = 0.0

    def begin(self, height_m: float) -> None:
        """Start from this height."""
        self._limited_m = self._smooth_m = height_m

    def climb_m_s(self, wanted_m: float, height_m: float, dt_s: float) -> float:
        """Climb rate for this step."""
        change = wanted_m - self._limited_m
        most, least = self.climb_max_m_s * dt_s, -self.sink_max_m_s * dt_s
        self._limited_m += most if change > most else least if change < least else change
        rate = (self._limited_m - self._smooth_m) / DEMAND_S
        self._smooth_m += rate * dt_s
        return rate + (self._smooth_m - height_m) / ERROR_S


# --- L1 guidance as ArduPlane flies it: lateral acceleration towards a leg or around a circle -----
# Metres north and east in a flat earth about some point.  The law is that of Park, Deyst and How
# (A new nonlinear guidance logic for trajectory tracking, AIAA 2004-4900) with ArduPilot's period
# and damping, and its PD law about circles (ardupilot.md 7).

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
        """Reset for another leg or mode."""
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


NAVIGATION_S = 0.1
_USUAL_RADIUS_M = 60.0


@final
class Navigation:
    """One plane's way; the estimate that it is made with is live."""

    def __init__(self, estimate: Estimate, plane: Plane, parameters: Parameters) -> None:
        self._estimate = estimate
        self._plane = plane
        self._parameters = parameters
        self.l1 = L1(period_s=15.0, damping=0.75, integral_gain=0.0)
        self.before: Place | None = None
        self.next: Place | None = None
        self.active_radius_m = 0.0
        """0: WP_LOITER_RAD."""
        self.direction = 1.0
        self.counter_clockwise = False
        """As the next point was given."""
        self.target_amsl_m = 0.0
        self.distance_m = 0.0
        self.along = 0.0
        """Share of the way from the last to the next point; may be over 1."""
        self.eas2tas = 1.0
        self._slope_m = 0.0
        """Next height less the one that the way began at, where that is followed as a slope."""
        self.arrived = False
        """The circle about the next point has been reached since it was set."""
        self.read_parameters()

    def read_parameters(self) -> None:
        """Take NAVL1_* as they are now."""
        self.l1.period_s = max(self._parameters["NAVL1_PERIOD"], 1.0)
        self.l1.damping = max(self._parameters["NAVL1_DAMPING"], 0.1)
        self.l1.integral_gain = self._parameters["NAVL1_XTRACK_I"]

    def start(self, before: Place, target: Place, *, counter_clockwise: bool = False) -> None:
        """Go from there to this point; there is a height at either end."""
        self.before, self.next = before, target
        self.counter_clockwise = counter_clockwise
        reverse = counter_clockwise or self._parameters["WP_LOITER_RAD"] < 0.0
        self.direction = -1.0 if reverse else 1.0
        self.arrived = False
        self._slope_m = 0.0
        self.measure()

    def slope(self, *, descend_only: bool) -> None:
        """Change height along the way, if it is enough to matter."""
        if self.before is None or self.next is None:
            return
        change_m = self.next.altitude_amsl_m - self.before.altitude_amsl_m
        steep = abs(change_m) >= self._parameters["GLIDE_SLOPE_MIN"]
        self._slope_m = change_m if steep and not (descend_only and change_m > 0.0) else 0.0

    def set_altitude(self, altitude_amsl_m: float) -> None:
        """Keep the point, change its height."""
        if self.next is not None:
            self.next = self.next.at(altitude_amsl_m)
            self._slope_m = 0.0

    def return_home(self, home: Place | None) -> None:
        """To the height RTL_ALTITUDE above home, at once where it is below."""
        here, parameters = self._estimate.place, self._parameters
        if home is None:
            return
        above_m, radius_m = parameters["RTL_ALTITUDE"], parameters["RTL_RADIUS"]
        altitude_m = here.altitude_amsl_m if above_m < 0.0 else home.altitude_amsl_m + above_m
        self.start(here, home.at(altitude_m))
        self.slope(descend_only=True)
        self.active_radius_m = abs(radius_m)
        if radius_m < 0.0:
            self.direction = -1.0

    @property
    def course_rad(self) -> float:
        """Where it moves over the ground; standing, where the nose points."""
        e = self._estimate
        if abs(e.velocity_north_m_s) + abs(e.velocity_east_m_s) < 0.5:
            return self._plane.heading_rad
        return math.atan2(e.velocity_east_m_s, e.velocity_north_m_s)

    def _ne_m(self, origin: Place) -> tuple[float, float]:
        """Where the vehicle is, from there."""
        e = self._estimate
        scale = longitude_scale(0.5 * (origin.latitude_deg + e.latitude_deg))
        east_deg = degrees_east(origin.longitude_deg, e.longitude_deg)
        return (
            (e.latitude_deg - origin.latitude_deg) * ARDUPILOT_M_PER_DEG,
            east_deg * ARDUPILOT_M_PER_DEG * scale,
        )

    def measure(self) -> None:
        """Distance to the next point and share of the way."""
        before, following = self.before, self.next
        if before is None or following is None:
            return
        to_north, to_east = self._ne_m(following)
        self.distance_m = math.hypot(to_north, to_east)
        north, east = self._ne_m(before)
        leg_n, leg_e = north - to_north, east - to_east
        square = leg_n * leg_n + leg_e * leg_e
        self.along = 1.0 if square < 1e-3 else (north * leg_n + east * leg_e) / square

    def update_altitude(self) -> None:
        """The height to be at now."""
        following = self.next
        if following is None:
            return
        wanted_m = following.altitude_amsl_m
        if self._slope_m != 0.0 and not (self.arrived and self.l1.circling) and self.along < 1.0:
            wanted_m -= self._slope_m * (1.0 - max(self.along, 0.0))
        self.target_amsl_m = wanted_m

    def radius_m(self, asked_m: float) -> float:
        """The radius of a circle that is asked for; too small a one is WP_LOITER_RAD."""
        if asked_m > 1.0:
            return asked_m
        usual_m = abs(self._parameters["WP_LOITER_RAD"])
        return usual_m if usual_m > 1.0 else _USUAL_RADIUS_M

    def circle(self, asked_m: float) -> float:
        """Bank to and around the next point."""
        following = self.next
        if following is None:
            return 0.0
        e, parameters = self._estimate, self._parameters
        if asked_m <= 1.0:
            reverse = self.counter_clockwise or parameters["WP_LOITER_RAD"] < 0.0
            self.direction = -1.0 if reverse else 1.0
        self.eas2tas = eas_to_tas(e.altitude_amsl_m)
        radius_m = scaled_radius_m(
            self.radius_m(asked_m),
            self.eas2tas,
            bank_limit_rad=math.radians(parameters["NAVL1_LIM_BANK"]),
            airspeed_m_s=parameters["AIRSPEED_CRUISE"],
        )
        lateral = self.l1.around(
            self._ne_m(following),
            radius_m,
            self.direction,
            (e.velocity_north_m_s, e.velocity_east_m_s),
            self._plane.heading_rad,
        )
        return bank_rad(lateral, self._plane.pitch_rad)

    def leg(self) -> float:
        """Bank to follow the straight way from the last point to the next."""
        before, following = self.before, self.next
        if before is None or following is None:
            return 0.0
        e = self._estimate
        here, there = self._ne_m(before), self._ne_m(following)
        self.eas2tas = eas_to_tas(e.altitude_amsl_m)
        lateral = self.l1.along_leg(
            here,
            (here[0] - there[0], here[1] - there[1]),
            (e.velocity_north_m_s, e.velocity_east_m_s),
            self._plane.heading_rad,
            NAVIGATION_S,
        )
        return bank_rad(lateral, self._plane.pitch_rad)

    def acceptance_m(self, turn_rad: float) -> float:
        """How near a waypoint counts as reached, with this turn to come."""
        distance_m: float = self._parameters["WP_RADIUS"] * self.eas2tas * self.eas2tas
        distance_m = min(distance_m, self.l1.length_m)
        return distance_m * min(abs(turn_rad) / (0.5 * math.pi), 1.0)

    def waypoint(self, airspeed_error_m_s: float) -> Waypoint | None:
        """To tell: POSITION_TARGET_GLOBAL_INT and NAV_CONTROLLER_OUTPUT."""
        if self.next is None:
            return None
        return Waypoint(
            place=self.next,
            distance_m=self.distance_m,
            bearing_rad=self.l1.nav_bearing_rad,
            altitude_error_m=self.target_amsl_m - self._estimate.altitude_amsl_m,
            cross_track_m=self.l1.cross_track_m,
            radius_m=self.direction * self.radius_m(self.active_radius_m),
            airspeed_error_m_s=airspeed_error_m_s,
        )
