"""ArduCopter's AUTO: the mission, item by item, each a goal for the position controller."""

import enum
import math
from dataclasses import dataclass
from typing import final

from vehicle_sim.autopilots import Place
from vehicle_sim.autopilots.ardupilot.copter_guided import Guided
from vehicle_sim.autopilots.ardupilot.copter_motion import Motion, Yaw
from vehicle_sim.autopilots.ardupilot.flat_earth import Vector, bearing_rad, distance_m, offset
from vehicle_sim.autopilots.jumps import DO_JUMP, Jumps
from vehicle_sim.plans import PlanItem, PlanKind

_WALKS_MOST = 1000
"""Items at once, so that a mission of jumps alone ends."""
WAYPOINT, LOITER_UNLIM, LOITER_TURNS, LOITER_TIME, RETURN, LAND, TAKEOFF = range(16, 23)
SPLINE, DELAY = 82, 93
CONDITION_DELAY, CONDITION_YAW, DO_CHANGE_SPEED = 112, 115, 178
_LEGS = frozenset((*range(16, 23), SPLINE, DELAY))
"""Items that are flown to, and not just done."""
_NAMES = {
    WAYPOINT: "WP",
    LOITER_UNLIM: "LoitUnlim",
    LOITER_TURNS: "LoitTurns",
    LOITER_TIME: "LoitTime",
    RETURN: "RTL",
    LAND: "Land",
    TAKEOFF: "Takeoff",
    SPLINE: "SplineWP",
    DELAY: "Delay",
    CONDITION_DELAY: "CondDelay",
    CONDITION_YAW: "CondYaw",
    DO_JUMP: "Jump",
    DO_CHANGE_SPEED: "ChangeSpeed",
}
_ABOVE_HOME_FRAMES = (3, 6)
"""10 and 11 are above terrain, which is at sea level without terrain data."""


class Leg(enum.Enum):
    """What kind of flying an item asks for."""

    TAKEOFF = enum.auto()
    GO = enum.auto()
    CIRCLE = enum.auto()
    LAND = enum.auto()
    RETURN = enum.auto()
    WAIT = enum.auto()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """Where to, and for how long to stay."""

    number: int
    leg: Leg
    place: Place
    hold_s: float = 0.0
    """Infinite: for ever."""
    turns: float = 0.0
    radius_m: float = 0.0


def _finite(value: float, otherwise: float = 0.0) -> float:
    return value if math.isfinite(value) else otherwise


def place_of(item: PlanItem, here: Place, home: Place) -> Place:
    """Where an item is; without coordinates it is here."""
    altitude_m = min(max(_finite(item.z_m), -1e5), 1e5)
    if item.frame in _ABOVE_HOME_FRAMES:
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
    p1 = _finite(item.parameters[0])
    match item.command:
        case _ if item.command == TAKEOFF:
            above = here.at(max(place.altitude_amsl_m, here.altitude_amsl_m))
            return Goal(number=number, leg=Leg.TAKEOFF, place=above)
        case _ if item.command == LAND:
            there = place.at(here.altitude_amsl_m)
            return Goal(number=number, leg=Leg.LAND, place=there)
        case _ if item.command == RETURN:
            return Goal(number=number, leg=Leg.RETURN, place=home)
        case _ if item.command == LOITER_UNLIM:
            return Goal(number=number, leg=Leg.GO, place=place, hold_s=math.inf)
        case _ if item.command == LOITER_TURNS:
            radius_m = min(max(abs(_finite(item.parameters[2])) or 10.0, 1.0), 1e4)
            return Goal(number=number, leg=Leg.CIRCLE, place=place, turns=p1, radius_m=radius_m)
        case _ if item.command == DELAY:
            return Goal(number=number, leg=Leg.WAIT, place=here, hold_s=max(p1, 0.0))
        case _:
            return Goal(number=number, leg=Leg.GO, place=place, hold_s=max(p1, 0.0))


@final
class Auto:
    """The mission as it is being flown."""

    def __init__(self, motion: Motion, guided: Guided, yaw: Yaw) -> None:
        self._motion = motion
        self._guided = guided
        self._yaw = yaw
        self._host = motion.host
        self._items: tuple[PlanItem, ...] = ()
        self._jumps = Jumps(1)
        self.goal: Goal | None = None
        self.complete = False
        self.paused = False
        self._arrived_us: int | None = None
        self._angle_rad = 0.0
        self._swept_rad = 0.0

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
            if item.command != DO_JUMP:
                self._do(at, item)
        self.goal, self.complete = None, True
        self._guided.stop()

    def _begin_leg(self, number: int, item: PlanItem) -> None:
        host, motion = self._host, self._motion
        host.mission_current = number
        self._announce(number, item)
        home = host.home or host.estimate.place
        goal = self.goal = goal_of(number, item, host.estimate.place, home)
        if goal.leg is Leg.TAKEOFF:
            motion.takeoff_us = host.now_us
        elif goal.leg is Leg.RETURN:
            motion.begin_return(climb=True)
        elif goal.leg is Leg.CIRCLE:
            self._angle_rad = bearing_rad(goal.place, host.estimate.place)
            self._swept_rad = 0.0
        motion.control.start_vertical()

    def _announce(self, number: int, item: PlanItem) -> None:
        self._host.say(6, f"Mission: {number} {_NAMES.get(item.command, str(item.command))}")

    def _do(self, number: int, item: PlanItem) -> None:
        """Things that take no time."""
        motion, p = self._motion, item.parameters
        self._announce(number, item)
        if item.command == DO_CHANGE_SPEED and 0.0 < p[1] < math.inf:
            motion.control.speed_m_s = p[1]
        elif item.command == CONDITION_YAW and math.isfinite(p[0]):
            heading_rad = motion.copter.heading_rad
            self._yaw.fix(heading_rad, math.radians(p[0]), p[2], relative=p[3] == 1.0)

    def _reached(self) -> None:
        goal = self.goal
        assert goal is not None
        self._host.say(6, f"Reached command #{goal.number}")
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
                    self._reached()
                return wanted
            case Leg.RETURN:
                return motion.run_return(dt_s)
            case Leg.LAND:
                return self._land(goal, dt_s)
            case Leg.CIRCLE:
                return self._circle(goal, dt_s)
            case Leg.WAIT:
                if self._waited(goal.hold_s):
                    self._reached()
                return motion.go(goal.place, dt_s)
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

    def _circle(self, goal: Goal, dt_s: float) -> Vector:
        motion = self._motion
        speed = min(motion.control.speed_m_s, math.sqrt(2.5 * goal.radius_m))
        edge = offset(
            goal.place,
            goal.radius_m * math.cos(self._angle_rad),
            goal.radius_m * math.sin(self._angle_rad),
        )
        if self._arrived_us is None:
            if distance_m(self._host.estimate.place, edge) > 2.0:
                return motion.go(edge.at(goal.place.altitude_amsl_m), dt_s)
            self._arrived_us = self._host.now_us
        rate = speed / goal.radius_m
        self._angle_rad += rate * dt_s
        self._swept_rad += rate * dt_s
        if self._swept_rad >= goal.turns * math.tau:
            self._reached()
        up_m = goal.place.altitude_amsl_m - self._host.estimate.altitude_amsl_m
        climb_m_s = min(max(up_m, -1.5), 2.5)
        return motion.circle(goal.place, goal.radius_m, self._angle_rad, rate, climb_m_s, dt_s)
