"""How both planes are flown: towards circles and lines by L1, towards heights, at airspeeds.

Vectors in the plane are complex numbers: north + east j, metres and metres a second.  L1 is the law
of Park, Deyst and How (A new nonlinear guidance logic for trajectory tracking, AIAA 2004-4900) with
ArduPilot's period and damping, and ArduPilot's PD law about circles (ardupilot.md 7).  Near a
straight line it is a damped oscillator of that period and damping in the distance off it, and so
is PX4's own law (NPFG), which is not imitated further.
"""

import cmath
import math
from collections.abc import Callable
from typing import ClassVar, Final, NamedTuple, final

from vehicle_sim.autopilot.core import Autopilot, Boot
from vehicle_sim.autopilot.earth import way_m
from vehicle_sim.autopilot.legs import Does, Leg
from vehicle_sim.autopilot.values import Place
from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.dynamics.plane import Plane


def eas_to_tas(altitude_amsl_m: float) -> float:
    """True over equivalent airspeed in the standard atmosphere, troposphere."""
    altitude_amsl_m = min(max(altitude_amsl_m, -1000.0), 11000.0)
    ratio: float = (1.0 - 2.25577e-5 * altitude_amsl_m) ** -2.12794
    return ratio


# --- where to: lateral accelerations --------------------------------------------------------------

_UNDECIDED_RAD: Final = 0.9 * math.pi


@final
class L1:
    """Of right-positive lateral acceleration; remembers what it tells of the last step."""

    def __init__(self) -> None:
        self.period_s, self.damping = 15.0, 0.75
        self.circling = False
        """On the circle, and not on the way to it."""
        self.cross_track_m = self.bearing_rad = 0.0
        self._before_rad = 0.0

    def length_m(self, speed_m_s: float) -> float:
        """How far ahead it looks."""
        return self.damping * self.period_s * speed_m_s / math.pi

    def line(self, off_m: complex, way: complex, velocity: complex) -> float:
        """Onto a line in a direction (of unit length), from so far off some point of it.

        From afar it approaches at a right angle, as PX4 does (npfg: bearing).
        """
        self.circling = False
        self.cross_track_m = (off_m.conjugate() * way).imag  # positive: left of it
        sine = self.cross_track_m / self.length_m(abs(velocity))
        share = min(abs(sine) / math.pi, 1.0)
        towards_rad = math.copysign(0.5 * math.pi * (2.0 - share) * share, sine)
        self.bearing_rad = cmath.phase(way) + towards_rad
        return self._turn(towards_rad + cmath.phase(way / velocity), abs(velocity))

    def circle(self, off_m: complex, radius_m: float, velocity: complex) -> float:
        """To and around a circle, clockwise; with a negative radius the other way.

        What is missing of the bank in a steady turn is made up for by the PD law, so that the
        circle flown by an airframe that slips is wider than this radius.
        """
        away_m, way = abs(off_m), math.copysign(1.0, radius_m)
        out = off_m / away_m if away_m > 1e-6 else velocity / abs(velocity)
        outward_m_s, across_m_s = (velocity / out).real, (velocity / out).imag
        capture = self._turn(math.atan2(across_m_s, -outward_m_s), abs(velocity))
        omega, tangential_m_s = math.tau / self.period_s, across_m_s * way
        self.cross_track_m = outside_m = away_m - abs(radius_m)
        pd = outside_m * omega * omega + outward_m_s * 2.0 * self.damping * omega
        if outward_m_s > 0.0 and tangential_m_s < 0.0 and pd < 0.0:
            pd = 0.0
        centripetal = tangential_m_s * tangential_m_s / max(0.5 * abs(radius_m), away_m, 1e-3)
        circle = way * (pd + centripetal)
        self.bearing_rad = cmath.phase(-out)
        self.circling = not (outside_m > 0.0 and way * capture < way * circle)
        return circle if self.circling else capture

    def _turn(self, angle_rad: float, speed_m_s: float) -> float:
        """Towards a direction so far to the right; right behind it goes on as it turns."""
        angle_rad = math.remainder(angle_rad, math.tau)
        both = min(abs(angle_rad), abs(self._before_rad)) > _UNDECIDED_RAD
        if both and angle_rad * self._before_rad < 0.0:
            angle_rad = self._before_rad
        self._before_rad = angle_rad
        sine = math.sin(min(max(angle_rad, -0.5 * math.pi), 0.5 * math.pi))
        return 4.0 * self.damping**2 * speed_m_s**2 / self.length_m(speed_m_s) * sine


# --- how high -------------------------------------------------------------------------------------
# Constants are fitted to arduplane-guided-reposition.tlog: two steps of 10 m are followed to 0.2 m
# rms, the climb while points are streamed to 1.3 m.

_DEMAND_S = 3.5  # time constant of the demanded height
_ERROR_S = 5.0


@final
class HeightControl:
    """From a wanted height to a climb rate: limited in rate, then smoothed, then followed."""

    def __init__(self) -> None:
        self.climb_most_m_s = self.sink_most_m_s = 5.0
        self._limited_m = self._smooth_m = 0.0

    def begin(self, height_m: float) -> None:
        """Start from this height."""
        self._limited_m = self._smooth_m = height_m

    def climb_m_s(self, wanted_m: float, height_m: float, dt_s: float) -> float:
        """Climb rate for this step."""
        change_m = wanted_m - self._limited_m
        self._limited_m += min(
            max(change_m, -self.sink_most_m_s * dt_s), self.climb_most_m_s * dt_s
        )
        rate_m_s = (self._limited_m - self._smooth_m) / _DEMAND_S
        self._smooth_m += rate_m_s * dt_s
        return rate_m_s + (self._smooth_m - height_m) / _ERROR_S


# --- in the air -----------------------------------------------------------------------------------

_ON_CIRCLE_M: Final = 20.0  # circles may be flown wider than they were asked for


@final
class Circle(NamedTuple):
    """About a place, at its height; clockwise, or the other way with a negative radius."""

    place: Place
    radius_m: float


@final
class Line(NamedTuple):
    """Through a place in a direction (of unit length), or bent there (positive: to the right)."""

    place: Place
    way: complex
    curvature_1_m: float = 0.0


class FixedWing(Autopilot):
    """A plane: on its wheels until it is fast enough, then along its aim, at heights and speeds."""

    # What differs between airframes; speeds over the ground.
    full_m_s2: ClassVar[float]  # acceleration at full throttle, standing
    drag_1_s: ClassVar[float]  # of it, what each metre a second of airspeed takes away
    opens_s: ClassVar[float]  # how long the throttle takes to open
    flying_m_s: ClassVar[float]  # taken to fly from here on
    brakes_m_s2: ClassVar[float]
    climbs_m_s: ClassVar[float]
    lands_m_s: ClassVar[float]  # climb and sink rate of take-off and landing
    circle: Callable[[Place], None]  # aim there, with the usual radius
    land_at: Callable[[Place], None]  # fly to where a mission lands

    def __init__(self, boot: Boot) -> None:
        super().__init__(boot)
        assert isinstance(boot.vehicle, Plane)
        self.plane = boot.vehicle
        self.l1, self.heights = L1(), HeightControl()
        self.aim: Circle | Line | None = None  # none: the bank stays
        self.leg: Leg | None = None  # that it flies
        self.passes_m = math.inf  # how near to a way point it turns to the next one, at most
        self.rotates_m_s = math.inf  # true airspeed at which it leaves the ground
        self.wanted_height_m, self.wanted_airspeed_m_s = 0.0, 0.0
        """Above the sea; and a true airspeed."""
        self.wanted_climb_m_s: float | None = None
        """Instead of going to the height."""
        self.bank_rad, self.bank_most_rad = 0.0, 1.0
        self._waited_s = 0.0  # when it was not yet to take off

    # --- where to -----------------------------------------------------------------------------

    @property
    def velocity(self) -> complex:
        """Over the ground; who stands is about to go where the nose points."""
        velocity = self.estimate.velocity_m_s
        return velocity if abs(velocity) > 1.0 else cmath.rect(1.0, self.plane.heading_rad)

    def off_m(self, place: Place) -> complex:
        """How far it is from a place."""
        return way_m(place, self.estimate.place)

    def straight_to(self, place: Place, start: Place | None = None) -> None:
        """Along the line from a start, or from here; if that is the place, on as it flies."""
        way = way_m(start or self.estimate.place, place)
        way = way if abs(way) > 1.0 else self.velocity
        self.aim = Line(place, way / abs(way))

    def lateral_m_s2(self, aim: Circle | Line) -> float:
        """What it turns with for its aim."""
        off_m = self.off_m(aim.place)
        if isinstance(aim, Circle):
            return self.l1.circle(off_m, aim.radius_m, self.velocity)
        return self.l1.line(off_m, aim.way, self.velocity)

    def bank(self) -> None:
        """For its aim."""
        if self.aim is not None:
            lateral_g = self.lateral_m_s2(self.aim) / GRAVITY_M_S2
            self.bank_rad = math.atan(lateral_g / math.cos(self.plane.pitch_rad))

    # --- legs ---------------------------------------------------------------------------------

    def fly_legs(self) -> None:
        """Where to, and whether to climb out or to land there."""
        if self.route.leg is not self.leg:
            self.fly_leg()
        self.follow_route()
        leg, self.wanted_climb_m_s = self.route.leg, None
        if self.route.lands:
            self.wanted_climb_m_s = -self.lands_m_s
        elif leg is not None and leg.does is Does.CLIMB and not self._is_up(leg):
            self.wanted_climb_m_s = self.climbs_m_s

    def fly_leg(self) -> None:
        """Straight to the leg's place from the one before, or about it."""
        before, leg, place = self.leg, self.route.leg, self.estimate.place
        self.leg = leg
        if leg is None:
            self.circle(place)
        elif leg.does is Does.LAND:
            self.land_at(leg.place)
        elif leg.hold_s and leg.does is Does.GO:
            self.circle(leg.place)
        else:
            goes_on = before is not None and before.does is leg.does is Does.GO
            self.straight_to(leg.place, before.place if before and goes_on else place)

    def _is_up(self, leg: Leg) -> bool:
        return self.estimate.altitude_amsl_m >= leg.place.altitude_amsl_m

    def is_there(self, leg: Leg) -> bool:
        """At its height, on its circle, or near enough or past."""
        aim, off_m = self.aim, self.off_m(leg.place)
        if leg.does is Does.CLIMB:
            return self._is_up(leg)
        if not isinstance(aim, Line):
            return aim is None or abs(off_m) < abs(aim.radius_m) + _ON_CIRCLE_M
        near_m = min(self.passes_m, self.l1.length_m(abs(self.velocity)))
        near_m = leg.acceptance_m if leg.acceptance_m == leg.acceptance_m else near_m
        return abs(off_m) <= near_m or (off_m.conjugate() * aim.way).real >= 0.0

    # --- in the air, and on its wheels --------------------------------------------------------

    def wants_up(self) -> bool:
        """A take-off, by mode or by a mission."""
        return self.armed and self.is_at(Does.CLIMB)

    def lifts_off(self) -> bool:
        """Fast enough on the runway."""
        return self.wants_up() and self.plane.airspeed_m_s >= self.rotates_m_s

    def move(self) -> None:
        """In the air, as it was steered."""
        plane, height_m, climb = self.plane, self.estimate.altitude_amsl_m, self.wanted_climb_m_s
        if climb is None:
            climb = self.heights.climb_m_s(self.wanted_height_m, height_m, self.step_s)
        else:
            self.heights.begin(height_m)
        bank_rad = min(max(self.bank_rad, -self.bank_most_rad), self.bank_most_rad)
        plane.advance(bank_rad, climb, self.wanted_airspeed_m_s, self.step_s)
        if self.wanted_climb_m_s is not None:
            plane.throttle = 1.0 if self.wanted_climb_m_s > 0.0 else 0.0

    def stand(self) -> None:
        """On the runway: up to speed, or to a halt."""
        plane = self.plane
        plane.altitude_amsl_m = self.ground_m
        self._waited_s = self._waited_s if self.wants_up() else self.now_s
        plane.throttle = min((self.now_s - self._waited_s) / self.opens_s, 1.0)
        push_m_s2 = -self.brakes_m_s2
        if plane.throttle > 0.0:
            push_m_s2 = self.full_m_s2 * plane.throttle - self.drag_1_s * plane.airspeed_m_s
            if abs(plane.velocity_m_s) >= self.flying_m_s:
                self.take_to_the_air()
        plane.roll_on_ground(push_m_s2, self.step_s)

    def touch_down(self) -> None:
        """Wheels or nose on the ground."""
        self.plane.touch_down(self.ground_m)
        self._waited_s = self.now_s
