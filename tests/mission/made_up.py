"""A made-up vehicle for tests of the mission: events in, commands out, no bytes and no planner."""

import copy
import functools
import json
import math
from collections.abc import Callable, Sequence
from typing import Any, Self, TypeVar

import numpy as np
import planning
import pytest
from made_up_plans import certificate as certificate
from made_up_plans import not_planned, straight, within_band
from made_up_plans import planned as planned
from renewed import replace
from watch import Watch
from watch import moving as moving

from companion.config import load_mission
from companion.mavlink.autopilots import ALL, ARDUCOPTER
from companion.mission import changes, checkpoint, events, machine
from companion.mission.changes import OrderResult
from companion.mission.decisions import Context
from companion.mission.events import Command, Event, Landed, Mode, SetMode, Setpoint, Vector
from companion.mission.mission import EndAction, Fallback, Mission
from companion.mission.phases import OVER
from companion.mission.state import Phase, Reason, State
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits
from companion.path.subpath import Subpath
from companion.planner.request import Backtrack, PlanOutcome, PlanRequest
from companion.planner.settings import Task
from companion.world.known_map import NO_ANSWER, Scan, empty_map

HOME_AMSL_M = 3000.0
TICK_S = 0.1
Kind = TypeVar("Kind", bound=Command)
Taken = tuple[State, Event, State, list[Command]]

# --- missions: a fast copter between mountains, and short ones for every kind of vehicle

MISSION = load_mission("environment-1")
SPEED_M_S = 150.0
NEAR = replace(MISSION, targets_ne_m=((5_000.0, 5_000.0),))
"""One leg reaches its target."""
AWAY = replace(MISSION, targets_ne_m=((20_000.0, 20_000.0),))
"""Two legs away."""
LAND = replace(NEAR, end_action=EndAction.LAND)
SHORT_LEG_M = 300.0
_PLACE: dict[str, Any] = {
    "floor_amsl_m": 3010.0,
    "ceiling_amsl_m": 3120.0,
    "north_m": (-1000.0, 1000.0),
    "east_m": (-1000.0, 1000.0),
}
_COPTER = planning.limits(
    speed_m_s=10.0, turn_radius_m=40.0, tracking_error_m=3.0, navigation_error_m=2.0, **_PLACE
)
_PLANE = replace(planning.PLANE_TASK.limits, navigation_error_m=2.0, **_PLACE)
_SETTINGS = replace(planning.PLANE_TASK.settings, scan_range_m=800.0, safety_distance_m=12.0)


def short(traits: VehicleTraits, **changes: Any) -> Mission:
    """A mission of two legs for such a vehicle."""
    mission = replace(
        MISSION,
        name="short",
        task=Task(limits=_COPTER if traits.hovers else _PLANE, settings=_SETTINGS),
        targets_ne_m=((400.0, 300.0),),
        end_action=EndAction.HOLD,
        fallback=Fallback.HOLD,
    )
    return replace(mission, **changes)


def of_each(counts: Callable[[VehicleTraits], bool]) -> pytest.MarkDecorator:
    """A test of each of these vehicles."""
    traits = [each.traits for each in ALL if counts(each.traits)]
    return pytest.mark.parametrize("traits", traits, ids=lambda each: each.name)


EACH = of_each(lambda _: True)
PLANES = of_each(lambda traits: not traits.hovers)

# --- what was said


def texts(commands: Sequence[Command]) -> list[str]:
    return [each.text for each in commands if isinstance(each, events.StatusText)]


# --- events


def scan_done(time_s: float, *, answered: int = 1, asked: int = 1) -> events.ScanDone:
    scan = Scan(
        row=0,
        column=0,
        heights_m=np.full((1, 1), 0.0 if answered else NO_ANSWER),
        radar_nea_m=np.zeros((1, 1, 3)),
        range_m=20_000.0,
        drift_m=0.0,
        registration_m=0.0,
    )
    return events.ScanDone(time_s=time_s, scan=scan, asked=asked, answered=answered)


def position(
    time_s: float, at: Vector = (0.0, 0.0, 3030.0), velocity: Vector = (0.0, 0.0, 0.0)
) -> events.Position:
    return events.Position(time_s=time_s, position_nea_m=at, velocity_nea_m_s=velocity)


# --- planners

Planner = Callable[[PlanRequest], PlanOutcome | None]
"""None: no answer."""


def backtrack(request: PlanRequest, *subpaths: Subpath, reaches_start: bool = True) -> Backtrack:
    return Backtrack(
        plan_id=request.plan_id,
        subpaths=subpaths,
        through=(False,) * len(subpaths),
        reaches_start=reaches_start,
    )


def home_or_on(request: PlanRequest) -> PlanOutcome:
    """Every way, and straight to where the flown path begins for the way back."""
    if request.flown is None:
        return planned(request)
    return backtrack(request, straight(request.scan_nea_m, request.flown[0].control_nea_m[0]))


def only_the_first(request: PlanRequest) -> PlanOutcome:
    """A first leg; then neither a way on nor, as that is no way back, one back."""
    return planned(request) if request.plan_id == 1 else not_planned(request)


def short_legs(request: PlanRequest) -> PlanOutcome:
    """Legs of 300 m, and back along what was flown."""
    return planned(request, SHORT_LEG_M) if request.flown is None else retraced(request)


def retraced(request: PlanRequest) -> Backtrack:
    """Back along what was flown, as far as that lies in the altitude band by now."""
    back: list[Subpath] = []
    for stretch in reversed(request.flown or ()):
        flown = Subpath(control_nea_m=stretch.control_nea_m)
        begins, ends = flown.pose(stretch.until_m), flown.pose(stretch.from_m)
        subpath = straight(begins.position_nea_m, ends.position_nea_m)
        if not within_band(subpath, request.task):  # under another ceiling than it was flown
            break
        if stretch.until_m - stretch.from_m > 1.0:
            back.append(subpath)
    return backtrack(request, *back)


# --- the vehicle


class Craft:
    """A mission that is flown tick by tick, and a vehicle that does as it is told.

    It flies to its setpoints at the mission's speed; a plane that is sent nowhere circles.
    """

    mode, armed, landed = Mode.OTHER, False, Landed.ON_GROUND
    here: Vector = (0.0, 0.0, HOME_AMSL_M)
    home_nea_m: Vector | None = here
    velocity: Vector = (0.0, 0.0, 0.0)
    goal: Vector | None = None
    """Its last setpoint."""
    climb_to_m: float | None = None
    course_rad, streamed_at_s = 0.0, -math.inf
    obeys_modes = follows = climbs = fix = estimator = arms = takes_off = True
    accepts = failsafe = echoes = False
    """Whether it accepts a take-off that it does not begin; what its autopilot does and says."""
    answered = asked = 1
    """Of the radar's blocks."""
    battery: float | None = None
    tick_s, health_s = TICK_S, 1.0

    def __init__(
        self,
        of: Mission = MISSION,
        plan: Planner = planned,
        traits: VehicleTraits = ARDUCOPTER.traits,
        shadow: bool = False,
        go: bool = True,
    ) -> None:
        self.context = Context(mission=of, seed=1, shadow=shadow, go=go)
        limits = of.task.limits
        self.state = State.of(of, empty_map(of.task.cell_m, limits.north_m, limits.east_m))
        self.now_s, self.traits, self.plan = 0.0, traits, plan
        self.later: list[tuple[float, Event]] = []
        """What it says, from when on."""
        self.steps: list[Taken] = []
        self.watch = Watch(traits, self.context)

    def aloft(self, mode: Mode, height_m: float = 20.0) -> Self:
        """In the air already, in some mode."""
        self.mode, self.armed, self.landed = mode, True, Landed.IN_AIR
        self.here = (0.0, 0.0, HOME_AMSL_M + height_m)
        return self

    # --- what has happened

    @property
    def phase(self) -> Phase:
        return self.state.phase

    @property
    def over(self) -> bool:
        return self.state.phase in OVER

    @property
    def phases(self) -> set[Phase]:
        """All that it has come through."""
        return {*self.watch.phases}

    @property
    def commands(self) -> list[Command]:
        """All that the vehicle was told."""
        return [command for *_, commands in self.steps for command in commands]

    def sent(self, kind: type[Kind]) -> list[Kind]:
        return [command for command in self.commands if isinstance(command, kind)]

    def end(self) -> events.End:
        [end] = self.sent(events.End)
        return end

    # --- how it goes on

    def take(self, *events: Event) -> list[Command]:
        """Events in, commands out; the vehicle does not hear of them."""
        out: list[Command] = []
        for event in events:
            before = self.state
            self.state, commands = machine.step(before, event, self.context)
            self.steps.append((before, event, self.state, commands))
            self.watch.context = self.context
            self.watch.saw(before, event, self.state, commands)
            out += commands
        return out

    def hear(self, *events: Event) -> list[Command]:
        """Events in; the vehicle obeys at once."""
        commands = self.take(*events)
        for command in commands:
            self.obey(command)
        return commands

    def tick(self) -> list[Command]:
        """A tick later: the vehicle has moved and said so, and was answered."""
        self.now_s = round(self.now_s + self.tick_s, 6)
        self.move()
        return [command for event in self.says() for command in self.hear(event)]

    def run_until(self, done: Callable[[Self], Any], limit_s: float = 3600.0) -> Self:
        deadline_s = self.now_s + limit_s
        while not done(self):
            assert self.now_s < deadline_s, f"nothing after {limit_s} s: {self.state.phase}"
            self.tick()
        return self

    def fly_to(self, phase: Phase) -> Self:
        return self.run_until(lambda it: it.state.phase is phase)

    def run_for(self, seconds: float) -> Self:
        for _ in range(round(seconds / self.tick_s)):
            self.tick()
        return self

    def during(self, seconds: float) -> list[Command]:
        """What is said while it flies on for so long."""
        count = len(self.commands)
        return self.run_for(seconds).commands[count:]

    def copy(self) -> Self:
        """Another one that has come as far, and flies on by itself."""
        other = copy.copy(self)
        other.watch = copy.copy(self.watch)
        other.steps, other.later = [*self.steps], [*self.later]
        return other

    def restart(self, *, torn: bool = False) -> Self:
        """The companion dies and is started again from its checkpoint.

        torn: of which nothing can be read.
        """
        self.watch.restarted(self.now_s, forgotten=torn)
        was, kept = self.state, checkpoint.values_of(self.state)
        values = json.loads(json.dumps(kept))
        if torn:
            told = {"time_s": self.now_s, "plan_id": was.flight.plan_id}
            values = checkpoint.without_checkpoint("torn", system_id=1, **told)
        state = checkpoint.initial_state(self.context.mission, (values, was.flight.known))
        if not torn:
            assert checkpoint.values_of(state) == {
                **kept,
                "phase": Phase.WAITING.name,
                "sank": False,
            }
            assert (state.task, leaves(state)) == (was.task, leaves(was))
        self.state, self.later = replace(state, now_s=self.now_s, since_s=self.now_s), []
        return self

    def reboot(self) -> Self:
        """The autopilot's clock begins again, as the session tells it."""
        self.now_s, self.later, self.streamed_at_s = 1.0, [], -math.inf
        self.state = replace(self.state, now_s=1.0, since_s=1.0)
        self.watch.forget(1.0)
        self.hear(events.Rebooted(time_s=1.0))
        return self

    # --- what it does

    def obey(self, command: Command) -> None:
        match command:
            case events.RequestStreams():
                for item in events.Item:
                    self.will_say(events.Prepared(time_s=self.now_s, item=item))
            case SetMode(mode=Mode.HOLD, at_nea_m=(_, _, _) as there) if (
                self.traits.holds_in_guided and self.mode is Mode.GUIDED
            ):
                self.goal = there
            case SetMode(mode=mode) if self.obeys_modes and self._may_be(mode):
                self.mode, self.goal, self.climb_to_m = mode, None, None
                if self.landed is Landed.TAKING_OFF:
                    on_ground = self.here[2] <= HOME_AMSL_M
                    self.landed = Landed.ON_GROUND if on_ground else Landed.IN_AIR
            case events.Disarm():
                self.armed = self.armed and self.landed is not Landed.ON_GROUND
            case events.Arm() if self.arms:
                self.armed = True
            case events.TakeOff(altitude_amsl_m=altitude):
                if self.takes_off or self.accepts:
                    self.will_say(events.TakeOffTaken(time_s=self.now_s))
                if self.takes_off:
                    if self.traits.take_off is not TakeoffSequence.GUIDED_THEN_CLIMB:
                        self.mode = Mode.TAKE_OFF
                    self.climb_to_m = altitude
                    self.landed = Landed.TAKING_OFF if self.armed else self.landed
            case events.StartScan():
                self.will_say(scan_done(self.now_s, answered=self.answered, asked=self.asked))
            case events.Plan(request=request, due_s=due_s):
                if (outcome := self.plan(request)) is not None:
                    self.will_say(events.PlanReady(time_s=due_s, outcome=outcome), due_s)
            case Setpoint(position_nea_m=there):
                self.streamed_at_s = self.now_s
                self.goal = there if self.mode is Mode.GUIDED else self.goal
            case _:
                pass

    def _may_be(self, mode: Mode) -> bool:
        """Some take guided mode only while setpoints come."""
        needs_stream = mode is Mode.GUIDED and self.traits.needs_setpoints_before_offboard
        return not needs_stream or self.now_s - self.streamed_at_s < 1.0

    def move(self) -> None:
        """Where it is a tick later: climbing, landing, flying to its goal, circling."""
        tick_s, limits, height = self.tick_s, self.context.mission.task.limits, self.here[2]
        aloft, led = self.landed is not Landed.ON_GROUND, (0.0, 0.0, 0.0)
        if self.mode is not Mode.GUIDED:
            self.goal = None
        elif self.traits.hovers and not self.follows:
            return  # it is where somebody says that it is
        if self.mode is Mode.TAKE_OFF and self.armed and self.climb_to_m is None and not aloft:
            self.climb_to_m = HOME_AMSL_M + 50.0
        if self.climb_to_m is not None and self.armed:
            left_m = self.climb_to_m - height if self.climbs else math.inf
            self.landed = Landed.TAKING_OFF
            if left_m < 1e-6:
                self.landed, self.climb_to_m = Landed.IN_AIR, None
                self.mode = Mode.HOLD if self.mode is Mode.TAKE_OFF else self.mode
            elif self.climbs:
                led = (0.0, 0.0, min(limits.climb_rate_m_s, left_m / tick_s))
        elif self.mode is Mode.LAND and aloft:
            led = (0.0, 0.0, -2.5 if self.climbs else 0.0)
        elif self.goal is not None and aloft and self.follows:
            away = [b - a for a, b in zip(self.here, self.goal, strict=True)]
            share_1_s = min(limits.speed_m_s / max(math.hypot(*away), 1e-6), 1.0 / tick_s)
            led = (share_1_s * away[0], share_1_s * away[1], share_1_s * away[2])
        self.course_rad += tick_s * limits.speed_m_s / max(limits.loiter_radius_m, 1.0)
        if not self.traits.hovers and aloft and math.hypot(*led[:2]) < 5.0:  # it circles
            north, east = math.cos(self.course_rad), math.sin(self.course_rad)
            led = (limits.speed_m_s * north, limits.speed_m_s * east, led[2])
        self.drift(led)
        if self.mode is Mode.LAND and self.here[2] <= HOME_AMSL_M:
            self.landed, self.armed = Landed.ON_GROUND, False

    def drift(self, led: Vector) -> None:
        """With that velocity for a tick; no deeper than the ground."""
        north, east, up = (at + self.tick_s * by for at, by in zip(self.here, led, strict=True))
        self.velocity, self.here = led, (north, east, max(up, HOME_AMSL_M))

    # --- what it says

    def will_say(self, event: Event, from_s: float = -math.inf) -> None:
        self.later.append((from_s, event))

    def is_due(self, every_s: float) -> bool:
        """Of what is said all so many seconds."""
        return round(self.now_s / self.tick_s) % max(round(every_s / self.tick_s), 1) == 0

    def says(self) -> list[Event]:
        """What the vehicle says at this tick of its clock."""
        now, said = self.now_s, list[Event]([events.Tick(time_s=self.now_s)])
        if self.phase is Phase.WAITING:
            name = self.traits.name
            found = events.VehicleFound(time_s=now, system_id=1, traits=self.traits, name=name)
            said.append(found)
        if self.is_due(1.0):
            is_in = {"mode": self.mode, "armed": self.armed, "failsafe": self.failsafe}
            said.append(events.VehicleStatus(time_s=now, **is_in))
            if self.home_nea_m is not None:
                said.append(events.Home(time_s=now, position_nea_m=self.home_nea_m))
            if self.battery is not None:
                said.append(events.Battery(time_s=now, remaining=round(self.battery, 2)))
        if self.is_due(self.health_s):
            said += [
                events.LandedState(time_s=now, landed=self.landed),
                events.GpsFix(time_s=now, good=self.fix),
                events.Estimator(time_s=now, good=self.estimator),
            ]
        if self.echoes and self.mode is Mode.GUIDED and self.is_due(2.0 * self.tick_s):
            said.append(events.Echo(time_s=now, position_nea_m=self.led_to))
        said += [replace(event, time_s=now) for from_s, event in self.later if from_s <= now]
        self.later = [(from_s, event) for from_s, event in self.later if from_s > now]
        return [*said, *self.says_where()]

    @property
    def led_to(self) -> Vector:
        return self.goal or self.here

    def says_where(self) -> list[Event]:
        return [position(self.now_s, self.here, self.velocity)]


def leaves(state: State) -> float | None:
    """Where its leg is left for the next."""
    return None if state.leg is None else state.leg.successor_at_m


_STEP = machine.step


def once(fly: Callable[..., Craft]) -> Callable[..., Craft]:
    """What begins with the same flight flies it once, without a nudge; each gets its own."""

    @functools.lru_cache(maxsize=16)
    def flown(*arguments: Any, **keywords: Any) -> Craft:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(machine, "step", _STEP)
            return fly(*arguments, **keywords)

    return lambda *arguments, **keywords: flown(*arguments, **keywords).copy()


# --- what happens to it, a step of a story each

Step = events.OrderKind | Phase | Reason | float | Callable[[Craft], object]


def order_of(craft: Craft, kind: events.OrderKind) -> events.Order:
    """An order by a ground station, with a place if it is one that needs it."""
    target_ne_m = (6_000.0, 2_000.0) if kind is events.OrderKind.REPOSITION else None
    return events.Order(time_s=craft.now_s, kind=kind, target_ne_m=target_ne_m, sender="255/190")


def tell(craft: Craft, kind: events.OrderKind) -> OrderResult:
    """An order, as the session gives it: obeyed if it is accepted."""
    order = order_of(craft, kind)
    verdict = changes.order_result(craft.state, order)
    if verdict is OrderResult.ACCEPTED:
        craft.hear(order)
    return verdict


def now(**changes: object) -> Callable[[Craft], None]:
    """From now on the vehicle, or its planner, is like that."""

    def change(craft: Craft) -> None:
        for name, value in changes.items():
            setattr(craft, name, value)

    return change


def hears(kind: Callable[..., Event], **fields: object) -> Callable[[Craft], object]:
    """The mission hears of this, too."""
    return lambda craft: craft.hear(kind(time_s=craft.now_s, **fields))


def told(craft: Craft, *script: Step) -> Craft:
    """Orders, each accepted; how long it flies on, or until which phase or reason; what else.

    What says no has found a law that is broken.
    """
    for step in script:
        if isinstance(step, events.OrderKind):
            assert tell(craft, step) is OrderResult.ACCEPTED, step
        elif isinstance(step, Phase):
            craft.fly_to(step)
        elif isinstance(step, Reason):
            craft.run_until(lambda craft, reason=step: craft.state.reason is reason)
        elif isinstance(step, float):
            craft.run_for(step)
        else:
            assert step(craft) is not False, (step, craft.phase, craft.state.reason)
    return craft


def says(words: str, times: int | None = None) -> Callable[[Craft], bool]:
    """Whether it has said so, so often, or at all."""

    def said(craft: Craft) -> int:
        return sum(words in text for text in texts(craft.commands))

    return lambda craft: said(craft) > 0 if times is None else said(craft) == times


# --- how a test begins


def calm(traits: VehicleTraits, plan: Planner = short_legs, **changes: Any) -> Craft:
    """A short mission of such a vehicle, on the ground."""
    return Craft(short(traits, **changes), plan=plan, traits=traits)


@once
def led(traits: VehicleTraits, **changes: Any) -> Craft:
    """The same some way along its first leg."""
    return calm(traits, **changes).run_until(lambda it: it.state.reference.length_m > 60.0)


@once
def flying(of: Mission = MISSION, **keywords: Any) -> Craft:
    """On its first leg, at speed."""
    craft = Craft(of, **keywords).fly_to(Phase.FLYING)
    return craft.run_until(lambda craft: craft.state.reference.speed_m_s > 100.0)


def holding_without_fix(of: Mission = MISSION) -> Craft:
    return told(flying(of), now(fix=False), Phase.HOLDING)


@once
def arrived(of: Mission = NEAR) -> Craft:
    return Craft(of).fly_to(Phase.ARRIVED)


TAKEN = now(mode=Mode.OTHER, obeys_modes=False)
SITUATIONS: dict[str, Callable[[], Craft]] = {
    "waiting": Craft,
    "preparing": lambda: told(Craft(), now(fix=False), Phase.PREPARING),
    "ready": lambda: Craft(NEAR, go=False).fly_to(Phase.READY),
    "arming": lambda: Craft().fly_to(Phase.ARMING),
    "taking off": lambda: Craft().fly_to(Phase.TAKING_OFF),
    "flying": lambda: flying(AWAY),
    "no plan": lambda: Craft(plan=not_planned).fly_to(Phase.HOLDING),
    "taken": lambda: told(flying(), TAKEN, Phase.HOLDING),
    "no fix": holding_without_fix,
    "arrived": arrived,
    "landing": lambda: arrived(LAND).fly_to(Phase.LANDING),
}
