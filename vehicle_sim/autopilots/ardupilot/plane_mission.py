"""ArduPlane's AUTO: the mission's items one after the other.

Times were not measured (ardupilot.md 8).  A landing's place is flown to at the height before it;
from there on the plane sinks wings level.
"""

import math
from typing import final

from vehicle_sim.autopilots import FRAMES_AMSL, Place
from vehicle_sim.autopilots.ardupilot.autopilot import ArduPilot
from vehicle_sim.autopilots.ardupilot.flat_earth import bearing_rad, offset
from vehicle_sim.autopilots.ardupilot.plane_navigation import Navigation
from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.parameters import Parameters
from vehicle_sim.plans import Jumps, PlanItem, PlanKind

# --- What ArduPlane was told besides a point: speed and, in GUIDED, heading
# All of it is forgotten when the mode changes.  Source: ardupilot.md 7.

HEADING_GAIN = math.radians(50.0)
"""Bank for each radian of heading error: GUIDED_P 5000 hundredths of a degree."""
ERROR_FILTER_S = 1.0 / (math.tau * 5.0)
_AT_ONCE = 1000.0
_LATERAL_LEAST_M_S2 = 0.05


@final
class Guided:
    """DO_CHANGE_SPEED, GUIDED_CHANGE_SPEED and GUIDED_CHANGE_HEADING."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self.cruise_m_s: float | None = None
        """Airspeed of DO_CHANGE_SPEED, in AUTO too."""
        self.holds_heading = False
        """For ever: there is no time-out."""
        self.of_course = True
        """The heading is that of the way over the ground."""
        self._heading_rad = 0.0
        self._bank_most_rad = 0.0
        self._error_rad = 0.0
        self._airspeed_m_s: float | None = None
        self._acceleration_m_s2 = _AT_ONCE

    def forget(self) -> None:
        """The mode has changed."""
        self.holds_heading = False
        self._airspeed_m_s = self.cruise_m_s = None

    # --- what it is told ----------------------------------------------------------------------

    def change_speed(self, kind: float, speed_m_s: float) -> bool:
        """DO_CHANGE_SPEED: airspeed (0) within the limits; -2 restores the cruising speed."""
        parameters = self._parameters
        if kind != 0.0:
            return kind == 1.0
        if speed_m_s == -2.0:
            self.cruise_m_s = None
            return True
        if not parameters["AIRSPEED_MIN"] <= speed_m_s <= parameters["AIRSPEED_MAX"]:
            return False
        self.cruise_m_s = speed_m_s
        return True

    def set_speed(self, airspeed_m_s: float, acceleration_m_s2: float) -> None:
        """GUIDED_CHANGE_SPEED; 0: as fast as it can."""
        self._airspeed_m_s = airspeed_m_s
        self._acceleration_m_s2 = abs(acceleration_m_s2) or _AT_ONCE

    def set_heading(self, heading_rad: float, lateral_m_s2: float, *, course: bool) -> None:
        """GUIDED_CHANGE_HEADING."""
        if not self.holds_heading:
            self._error_rad = 0.0
        self.holds_heading, self.of_course = True, course
        self._heading_rad = heading_rad
        self._bank_most_rad = math.atan(max(lateral_m_s2, _LATERAL_LEAST_M_S2) / GRAVITY_M_S2)

    # --- what comes of it -----------------------------------------------------------------------

    def airspeed_m_s(self, before_m_s: float, dt_s: float) -> float | None:
        """The airspeed to hold now; None: the usual one."""
        if self._airspeed_m_s is None:
            return None
        most = self._acceleration_m_s2 * dt_s
        return before_m_s + min(max(self._airspeed_m_s - before_m_s, -most), most)

    def bank_rad(self, actual_rad: float, dt_s: float) -> float:
        """Proportional to the error, up to the bank of the lateral acceleration given."""
        error_rad = math.remainder(self._heading_rad - actual_rad, math.tau)
        change = math.remainder(error_rad - self._error_rad, math.tau)
        self._error_rad += change * dt_s / (ERROR_FILTER_S + dt_s)
        bank, most = HEADING_GAIN * self._error_rad, self._bank_most_rad
        return -most if bank < -most else most if bank > most else bank


WAYPOINT, UNLIMITED, _, TIME, RETURN, LAND, TAKEOFF = range(16, 23)
CHANGE_SPEED = 178
_CIRCLES = frozenset({UNLIMITED, TIME, RETURN})
_HAS_PLACE = frozenset({WAYPOINT, UNLIMITED, TIME, LAND})
_NAVIGATES = _HAS_PLACE | {RETURN, TAKEOFF}
_JUMPS_MOST = 32
"""In a row, so that a mission of jumps alone ends."""


@final
class Mission:
    """Which item is flown, and whether it is done."""

    def __init__(
        self, host: ArduPilot, plane: Plane, navigation: Navigation, guided: Guided
    ) -> None:
        self._host = host
        self._plane = plane
        self._navigation = navigation
        self._guided = guided
        self.item: PlanItem | None = None
        """What is flown now; None: the mission is over, or has not begun."""
        self._jumps = Jumps(1)
        self._since_us: int | None = None
        self._accept_m = 0.0

    @property
    def runs(self) -> bool:
        """Whether something is flown."""
        return self.item is not None

    @property
    def takes_off(self) -> bool:
        """Whether this item is a take-off."""
        return self.item is not None and self.item.command == TAKEOFF

    @property
    def lands(self) -> bool:
        """Whether this item is a landing."""
        return self.item is not None and self.item.command == LAND

    def stop(self) -> None:
        """Fly something else; the number is kept."""
        self.item = None

    def begin(self, number: int | None = None) -> None:
        """Fly from this item on, or from where it was; the leg begins here."""
        self._jumps.forget()
        number = self._host.mission_current if number is None else number
        self._go_to(max(number, 1), None)

    def _items(self) -> tuple[PlanItem, ...]:
        return self._host.plans[PlanKind.MISSION]

    def _go_to(self, number: int, before: Place | None) -> None:
        """The next item that navigates, from this one on; the others are done on the way."""
        items = self._items()
        for at, item in self._jumps.walk(items, number, len(items) + _JUMPS_MOST):
            if item.command in _NAVIGATES:
                self._fly(at, item, before)
                return
            if item.command == CHANGE_SPEED:
                self._guided.change_speed(item.parameters[0], item.parameters[1])
        self.item = None
        if items:
            self._host.mission_current = len(items) - 1

    def place_of(self, item: PlanItem) -> Place:
        """Where the item is; of 0, 0 where the vehicle is."""
        here, home = self._host.estimate.place, self._host.home
        altitude_m = item.z_m if math.isfinite(item.z_m) else 0.0
        if item.frame not in FRAMES_AMSL and home is not None:
            altitude_m += home.altitude_amsl_m
        if item.command not in _HAS_PLACE or (item.x == 0 and item.y == 0):
            latitude_deg, longitude_deg = here.latitude_deg, here.longitude_deg
        else:
            latitude_deg, longitude_deg = item.x * 1e-7, item.y * 1e-7
        return Place(latitude_deg, longitude_deg, altitude_m)

    def _fly(self, number: int, item: PlanItem, before: Place | None) -> None:
        host, navigation = self._host, self._navigation
        host.mission_current, self.item = number, item
        self._since_us = None
        here, target = host.estimate.place, self.place_of(item)
        if item.command == RETURN:
            navigation.return_home(host.home)
            return
        if item.command == TAKEOFF:
            nose_rad, above = self._plane.heading_rad, here.at(target.altitude_amsl_m)
            target = offset(above, 1000.0 * math.cos(nose_rad), 1000.0 * math.sin(nose_rad))
        elif item.command == LAND:
            target = target.at(here.altitude_amsl_m)
        navigation.start(before or here, target)
        navigation.active_radius_m = 0.0
        navigation.l1.forget()
        navigation.slope(descend_only=False)
        self._accept_m = self._acceptance_m(number, target)

    def _acceptance_m(self, number: int, target: Place) -> float:
        """How near the point is near enough, by the turn that follows it."""
        before = self._navigation.before
        following = next((i for i in self._items()[number + 1 :] if i.command in _HAS_PLACE), None)
        if before is None or following is None:
            return 0.0
        turn_rad = bearing_rad(target, self.place_of(following)) - bearing_rad(before, target)
        turn_rad = math.remainder(turn_rad, math.tau)
        return self._navigation.acceptance_m(turn_rad)

    def bank_rad(self) -> float:
        """Ten times a second: go on with the item, and how to bank for it."""
        host, navigation, item = self._host, self._navigation, self.item
        if item is None:
            return 0.0
        if self._done(item):
            number, before = host.mission_current, navigation.next
            host.reached(number)
            carries = item.command in (WAYPOINT, LAND)
            self._go_to(number + 1, before if carries else None)
            if self.item is None:
                return 0.0
            item = self.item
        if item.command in _CIRCLES and navigation.distance_m < 3.0 * navigation.radius_m(0.0):
            return navigation.circle(0.0)
        return navigation.leg()

    def _done(self, item: PlanItem) -> bool:
        host, navigation = self._host, self._navigation
        if item.command == WAYPOINT:
            return self._passed(item)
        if item.command == TAKEOFF:
            wanted, here = navigation.next, host.estimate.place
            return wanted is not None and here.altitude_amsl_m >= wanted.altitude_amsl_m
        return self._circled(item)

    def _passed(self, item: PlanItem) -> bool:
        """Near a waypoint, or beyond it."""
        asked_m = item.parameters[1]
        accept_m = asked_m if math.isfinite(asked_m) and asked_m > 0.0 else self._accept_m
        return self._navigation.distance_m <= accept_m or self._navigation.along >= 1.0

    def _circled(self, item: PlanItem) -> bool:
        """Long enough about the point."""
        if item.command != TIME:
            return False
        if self._since_us is None:
            if self._navigation.l1.circling:
                self._since_us = self._host.now_us
            return False
        return self._host.now_us - self._since_us >= item.parameters[0] * 1e6
