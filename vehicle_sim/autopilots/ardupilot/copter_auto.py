"""ArduCopter's AUTO: the mission, item by item, each a goal for the position controller."""

import enum
import math
from dataclasses import dataclass
from typing import final

from vehicle_sim.autopilots import FRAMES_ABOVE_HOME, Place
from vehicle_sim.autopilots.ardupilot.autopilot import ArduPilot
from vehicle_sim.autopilots.ardupilot.copter_control import PositionControl, Tuning, sqrt_controller
from vehicle_sim.autopilots.ardupilot.copter_guided import Guided
from vehicle_sim.autopilots.ardupilot.flat_earth import Vector, distance_m
from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.parameters import Parameters
from vehicle_sim.plans import Jumps, PlanItem, PlanKind

# --- What ArduCopter's modes are made of: stopping, going to a place, circling, landing, returning
# Source: ardupilot.md 2 and the recorded flights.  The autopilot steers by its estimate; only the
# height above the ground that a rangefinder would measure for landing is true.

SLEW_RAD_S = math.radians(60.0)
"""ATC_SLEW_YAW."""
GAIN_1_S = 4.5
"""ATC_ANG_YAW_P."""
_MOVING_SHARE = 0.05
"""Of WPNAV_SPEED: slower, the way has no direction."""
RETURN_STAGE_US = 1_550_000
"""The least that each of climbing and going home takes (stream-faults, 286.2 to 294.7 s)."""


def tuning_of(parameters: Parameters, copter: Copter) -> Tuning:
    """ArduPilot's parameters in SI units, within what the airframe can do."""
    limits = copter.limits
    lean_rad = math.radians(min(max(parameters["ANGLE_MAX"] / 100.0, 10.0), 85.0))
    most_up = limits.speed_vertical_m_s
    return Tuning(
        speed_m_s=max(parameters["WPNAV_SPEED"], 10.0) / 100.0,
        acceleration_m_s2=min(
            max(parameters["WPNAV_ACCEL"], 10.0) / 100.0, limits.acceleration_m_s2
        ),
        jerk_m_s3=max(parameters["PSC_JERK_XY"], 1.0),
        speed_up_m_s=min(max(parameters["WPNAV_SPEED_UP"], 10.0) / 100.0, most_up),
        speed_down_m_s=min(max(parameters["WPNAV_SPEED_DN"], 10.0) / 100.0, most_up),
        acceleration_up_m_s2=min(
            max(parameters["WPNAV_ACCEL_Z"], 10.0) / 100.0, limits.acceleration_vertical_m_s2
        ),
        jerk_up_m_s3=max(parameters["PSC_JERK_Z"], 1.0),
        lean_m_s2=min(GRAVITY_M_S2 * math.tan(lean_rad), limits.acceleration_m_s2),
    )


class Return(enum.Enum):
    """Stages of RTL."""

    CLIMB = enum.auto()
    GO = enum.auto()
    WAIT = enum.auto()
    LAND = enum.auto()


@final
class Yaw:
    """Where the nose points: along the way, to a commanded yaw, or turning at a rate."""

    def __init__(self) -> None:
        self.angle_rad: float | None = None
        self.rate_rad_s: float | None = None

    def look_ahead(self) -> None:
        """Forget what was commanded."""
        self.angle_rad = self.rate_rad_s = None

    def command(self, angle_rad: float | None, rate_rad_s: float | None) -> None:
        """As a setpoint says; nothing means ahead."""
        self.angle_rad, self.rate_rad_s = angle_rad, rate_rad_s

    def fix(
        self, heading_rad: float, angle_rad: float, direction: float, *, relative: bool
    ) -> None:
        """CONDITION_YAW: to an angle, or by one."""
        if relative:
            angle_rad = heading_rad + (angle_rad if direction >= 0.0 else -angle_rad)
        self.command(angle_rad, None)

    def turned(
        self,
        heading_rad: float,
        way_m_s: tuple[float, float],
        speed_m_s: float,
        dt_s: float,
        *,
        ahead: bool,
    ) -> float:
        """The heading one step on, from 0 to 2 pi."""
        if self.angle_rad is None and self.rate_rad_s is not None:
            return (heading_rad + self.rate_rad_s * dt_s) % math.tau
        wanted_rad = self.angle_rad
        if wanted_rad is None:
            north, east = way_m_s
            least = _MOVING_SHARE * speed_m_s
            if not ahead or north * north + east * east < least * least:
                return heading_rad
            wanted_rad = math.atan2(east, north)
        rate = GAIN_1_S * math.remainder(wanted_rad - heading_rad, math.tau)
        rate = -SLEW_RAD_S if rate < -SLEW_RAD_S else SLEW_RAD_S if rate > SLEW_RAD_S else rate
        return (heading_rad + rate * dt_s) % math.tau


@final
class Motion:
    """A copter in the air, by its position controller."""

    def __init__(self, host: ArduPilot, copter: Copter) -> None:
        self.host = host
        self.copter = copter
        self.control = PositionControl(copter, host.estimate, tuning_of(host.parameters, copter))
        self.ground_amsl_m = 0.0
        self.takeoff_us: int | None = None
        """When the take-off that is going on was commanded."""
        self.lands_with_position = True
        self.pauses_until_us = 0
        """A failsafe's landing waits before it goes down."""
        self._returning = Return.CLIMB
        self._stage_us = 0
        self._return_amsl_m = 0.0

    def stop_level(self, climb_m_s: float, dt_s: float) -> Vector:
        """Come to a standstill, climbing at this rate."""
        control = self.control
        control.moved(dt_s)
        control.towards_velocity(0.0, 0.0, 0.0, 0.0, dt_s)
        control.towards_climb(climb_m_s, 0.0, dt_s)
        return control.wanted(dt_s)

    def level_out(self, climb_m_s: float, dt_s: float) -> Vector:
        """Without a position there is nothing to hold: only the lean goes."""
        control = self.control
        control.towards_climb(climb_m_s, 0.0, dt_s)
        return control.levelled(dt_s)

    def go(self, place: Place, dt_s: float) -> Vector:
        """Fly to a place that does not move."""
        control = self.control
        control.moved(dt_s)
        control.fly_to(place.latitude_deg, place.longitude_deg, place.altitude_amsl_m, dt_s)
        return control.wanted(dt_s)

    def run_landing(self, dt_s: float) -> Vector:
        """Down at WPNAV_SPEED_DN, the last LAND_ALT_LOW at LAND_SPEED."""
        parameters, tuning = self.host.parameters, self.control.tuning
        low_m = max(parameters["LAND_ALT_LOW"], 100.0) / 100.0
        height_m = self.copter.altitude_amsl_m - self.ground_amsl_m
        slow = max(parameters["LAND_SPEED"], 20.0) / 100.0
        fast = max(tuning.speed_down_m_s, slow)
        rate = sqrt_controller(low_m - height_m, 1.0, tuning.acceleration_up_m_s2, dt_s)
        rate = min(max(rate, -fast), -slow)
        if self.host.now_us < self.pauses_until_us:
            rate = 0.0
        if self.lands_with_position and self.host.ekf.aiding:
            return self.stop_level(rate, dt_s)
        self.lands_with_position = False
        return self.level_out(rate, dt_s)

    # --- returning ----------------------------------------------------------------------------

    def begin_return(self, *, climb: bool) -> None:
        """Go home, first up to RTL_ALT."""
        host = self.host
        here = host.estimate.place
        home_amsl_m = host.home.altitude_amsl_m if host.home is not None else 0.0
        wanted_m = home_amsl_m + host.parameters["RTL_ALT"] / 100.0
        self._return_amsl_m = max(here.altitude_amsl_m, wanted_m if climb else -math.inf)
        self._returning, self._stage_us = Return.CLIMB, host.now_us
        self._return_from = here
        self.lands_with_position = True

    def run_return(self, dt_s: float) -> Vector:
        """Climb, go, wait above home, land."""
        host, home = self.host, self.host.home
        if not host.ekf.aiding or home is None:
            return self.level_out(0.0, dt_s)
        here = host.estimate.place
        waited_us = host.now_us - self._stage_us
        above = home.at(self._return_amsl_m)
        match self._returning:
            case Return.CLIMB:
                there = abs(here.altitude_amsl_m - self._return_amsl_m) < 2.0
                self._stage(Return.GO, reached=there and waited_us >= RETURN_STAGE_US)
                return self.go(self._return_from.at(self._return_amsl_m), dt_s)
            case Return.GO:
                there = distance_m(here, home) < host.parameters["WPNAV_RADIUS"] / 100.0
                self._stage(Return.WAIT, reached=there and waited_us >= RETURN_STAGE_US)
                return self.go(above, dt_s)
            case Return.WAIT:
                waits_us = host.parameters["RTL_LOIT_TIME"] * 1e3
                self._stage(Return.LAND, reached=waited_us >= waits_us)
                return self.go(above, dt_s)
            case Return.LAND:
                return self.run_landing(dt_s)

    def _stage(self, stage: Return, *, reached: bool) -> None:
        if reached:
            self._returning, self._stage_us = stage, self.host.now_us

    @property
    def returned(self) -> bool:
        """RTL has come to landing."""
        return self._returning is Return.LAND

    @property
    def return_place(self) -> Place | None:
        """Where RTL flies to, until it lands."""
        home = self.host.home
        return None if home is None or self.returned else home.at(self._return_amsl_m)


_WALKS_MOST = 1000
"""Items at once, so that a mission of jumps alone ends."""
WAYPOINT, LOITER_UNLIM, _, LOITER_TIME, RETURN, LAND, TAKEOFF = range(16, 23)
DO_CHANGE_SPEED = 178
_LEGS = frozenset({WAYPOINT, LOITER_UNLIM, LOITER_TIME, RETURN, LAND, TAKEOFF})
"""Items that are flown to, and not just done."""


class Leg(enum.Enum):
    """What kind of flying an item asks for."""

    TAKEOFF = enum.auto()
    GO = enum.auto()
    LAND = enum.auto()
    RETURN = enum.auto()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """Where to, and for how long to stay."""

    number: int
    leg: Leg
    place: Place
    hold_s: float = 0.0
    """Infinite: for ever."""


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def place_of(item: PlanItem, here: Place, home: Place) -> Place:
    """Where an item is; without coordinates it is here."""
    altitude_m = min(max(_finite(item.z_m), -1e5), 1e5)
    if item.frame in FRAMES_ABOVE_HOME:  # the ground is at sea level without terrain data
        altitude_m += home.altitude_amsl_m
    somewhere = (item.x != 0 or item.y != 0) and abs(item.x) <= 900_000_000
    return Place(
        item.x * 1e-7 if somewhere else here.latitude_deg,
        item.y * 1e-7 if somewhere else here.longitude_deg,
        altitude_m,
    )


def goal_of(number: int, item: PlanItem, here: Place, home: Place) -> Goal:
    """What a navigation item asks for."""
    place = place_of(item, here, home)
    if item.command == TAKEOFF:
        above = here.at(max(place.altitude_amsl_m, here.altitude_amsl_m))
        return Goal(number=number, leg=Leg.TAKEOFF, place=above)
    if item.command == LAND:
        return Goal(number=number, leg=Leg.LAND, place=place.at(here.altitude_amsl_m))
    if item.command == RETURN:
        return Goal(number=number, leg=Leg.RETURN, place=home)
    hold_s = math.inf if item.command == LOITER_UNLIM else max(_finite(item.parameters[0]), 0.0)
    return Goal(number=number, leg=Leg.GO, place=place, hold_s=hold_s)


@final
class Auto:
    """The mission as it is being flown."""

    def __init__(self, motion: Motion, guided: Guided) -> None:
        self._motion = motion
        self._guided = guided
        self._host = motion.host
        self._items: tuple[PlanItem, ...] = ()
        self._jumps = Jumps(1)
        self.goal: Goal | None = None
        self.complete = False
        self.paused = False
        self._arrived_us: int | None = None

    def can_begin(self) -> bool:
        """Whether there is a mission; on the ground, one that begins with a take-off."""
        return len(self._host.plans[PlanKind.MISSION]) > 1

    def begin(self) -> None:
        """From the first item, or after the last one that was flown (MIS_RESTART 0)."""
        host = self._host
        self.complete = self.paused = False
        current, count = host.mission_current, len(host.plans[PlanKind.MISSION])
        if host.parameters["MIS_RESTART"] or not 1 <= current < count:
            current = 1
        self.jump_to(current)

    def jump_to(self, number: int) -> None:
        """Fly this item next."""
        self._items = self._host.plans[PlanKind.MISSION]
        self._jumps.forget()
        self._advance(number)

    def _advance(self, number: int) -> None:
        """The next leg from this item on; the others are done on the way."""
        self._arrived_us = None
        for at, item in self._jumps.walk(self._items, number, _WALKS_MOST):
            if item.command in _LEGS:
                self._begin_leg(at, item)
                return
            if item.command == DO_CHANGE_SPEED and 0.0 < item.parameters[1] < math.inf:
                self._motion.control.speed_m_s = item.parameters[1]
        self.goal, self.complete = None, True
        self._guided.stop()

    def _begin_leg(self, number: int, item: PlanItem) -> None:
        host, motion = self._host, self._motion
        host.mission_current = number
        home = host.home or host.estimate.place
        goal = self.goal = goal_of(number, item, host.estimate.place, home)
        if goal.leg is Leg.TAKEOFF:
            motion.takeoff_us = host.now_us
        elif goal.leg is Leg.RETURN:
            motion.begin_return(climb=True)
        motion.control.start_vertical()

    def _reached(self) -> None:
        goal = self.goal
        assert goal is not None
        self._host.reached(goal.number)
        self._advance(goal.number + 1)

    @property
    def landing(self) -> bool:
        """Whether the item is a landing, or an RTL that lands."""
        goal = self.goal
        if goal is None:
            return False
        going = self._motion.return_place is not None
        return (goal.leg is Leg.LAND and self._arrived_us is not None) or (
            goal.leg is Leg.RETURN and not going
        )

    @property
    def taking_off(self) -> bool:
        """Whether the item is a take-off."""
        return self.goal is not None and self.goal.leg is Leg.TAKEOFF

    def on_ground(self) -> None:
        """Armed and standing: a take-off may begin."""
        if self.taking_off and self._motion.takeoff_us is None:
            self._motion.takeoff_us = self._host.now_us

    # --- flying -------------------------------------------------------------------------------

    def run(self, dt_s: float) -> Vector:
        """Fly the item for one step."""
        motion, goal = self._motion, self.goal
        if not self._host.ekf.aiding or goal is None or self.paused:
            return motion.stop_level(0.0, dt_s)
        match goal.leg:
            case Leg.TAKEOFF:
                wanted = motion.go(goal.place, dt_s)
                here_m = self._host.estimate.altitude_amsl_m
                if here_m > goal.place.altitude_amsl_m - 0.3 and self._waited(0.7):
                    motion.takeoff_us = None
                    self._host.took_off()
                    self._reached()
                return wanted
            case Leg.RETURN:
                return motion.run_return(dt_s)
            case Leg.LAND:
                return self._land(goal, dt_s)
            case Leg.GO:
                return self._go(goal, dt_s)

    def _waited(self, seconds: float) -> bool:
        now_us = self._host.now_us
        if self._arrived_us is None:
            self._arrived_us = now_us
        return now_us - self._arrived_us >= seconds * 1e6

    def _go(self, goal: Goal, dt_s: float) -> Vector:
        motion = self._motion
        here = self._host.estimate.place
        radius_m = self._host.parameters["WPNAV_RADIUS"] / 100.0
        level_m = distance_m(here, goal.place)
        away_m = math.hypot(level_m, here.altitude_amsl_m - goal.place.altitude_amsl_m)
        wanted = motion.go(goal.place, dt_s)
        if (away_m < radius_m or self._arrived_us is not None) and self._waited(goal.hold_s):
            self._reached()
        return wanted

    def _land(self, goal: Goal, dt_s: float) -> Vector:
        motion = self._motion
        if self._arrived_us is None:
            if distance_m(self._host.estimate.place, goal.place) < 1.0:
                self._arrived_us = self._host.now_us
                motion.lands_with_position = True
            return motion.go(goal.place, dt_s)
        return motion.run_landing(dt_s)
