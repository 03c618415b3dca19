"""Where ArduPlane goes: the last and the next point, the circle about it, the height to be at.

Source: ardupilot.md 7 and the recorded flight.  Run ten times a second, as on the real one.
"""

import math
from typing import final

from vehicle_sim.autopilots import Estimate, Place, Waypoint
from vehicle_sim.autopilots.ardupilot.flat_earth import FLAT_EARTH_M_PER_DEG, longitude_scale
from vehicle_sim.autopilots.ardupilot.plane_heights import eas_to_tas
from vehicle_sim.autopilots.ardupilot.plane_l1 import L1, bank_rad, scaled_radius_m
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.parameters import Parameters

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
        east_deg = math.remainder(e.longitude_deg - origin.longitude_deg, 360.0)
        return (
            (e.latitude_deg - origin.latitude_deg) * FLAT_EARTH_M_PER_DEG,
            east_deg * FLAT_EARTH_M_PER_DEG * scale,
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
