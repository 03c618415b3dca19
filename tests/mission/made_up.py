"""A made-up vehicle for tests of the mission: events in, commands out, no bytes and no planner."""

import abc
import copy
import functools
import json
import math
from collections.abc import Callable, Sequence
from typing import Any, Self, TypeVar

import numpy as np
import pytest
from made_up_plans import certificate as certificate
from made_up_plans import not_planned, straight
from made_up_plans import planned as planned
from renewed import replace

from companion.config import load_mission
from companion.mavlink.autopilots import ALL, ARDUCOPTER
from companion.mission import changes, checkpoint, events, machine
from companion.mission.changes import OrderResult
from companion.mission.decisions import Context
from companion.mission.events import Command, Event, Landed, Mode, ScanDone, Vector, VehicleStatus
from companion.mission.mission import EndAction, Mission
from companion.mission.state import Phase, Reason, State
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits
from companion.planner.request import Backtrack, PlanOutcome, PlanRequest
from companion.world.known_map import NO_ANSWER, Scan, empty_map

MISSION = load_mission("environment-1")
HOME_AMSL_M = 3000.0
TAKE_OFF_AMSL_M = 3030.0  # floor 3000 m and twice the tracking error of 15 m
TICK_S = 0.1
SPEED_M_S = 150.0
Kind = TypeVar("Kind", bound=Command)
Taken = tuple[State, Event, State, list[Command]]


def mission(**changes: Any) -> Mission:
    return replace(MISSION, **changes)


NEAR = mission(targets_ne_m=((5_000.0, 5_000.0),))
"""One leg reaches its target."""
AWAY = mission(targets_ne_m=((20_000.0, 20_000.0),))
"""Two legs away."""
LAND = replace(NEAR, end_action=EndAction.LAND)


def each_of(*traits: VehicleTraits) -> pytest.MarkDecorator:
    """A test of each of these vehicles."""
    return pytest.mark.parametrize("traits", traits, ids=lambda each: each.name)


TRAITS = [each.traits for each in ALL]
EACH = each_of(*TRAITS)
COPTERS = each_of(*(each for each in TRAITS if each.hovers))
PLANES = each_of(*(each for each in TRAITS if not each.hovers))
HOLDS_FOR_SETPOINTS = each_of(*(each for each in TRAITS if each.needs_setpoints_before_offboard))
MOVING = (
    events.Arm,
    events.Disarm,
    events.TakeOff,
    events.SetMode,
    events.Setpoint,
    events.SetSpeed,
)
OVER = (Phase.DONE, Phase.FAULTED)


def moving(commands: Sequence[Command]) -> list[Command]:
    """What moves a vehicle."""
    return [command for command in commands if isinstance(command, MOVING)]


def texts(commands: Sequence[Command]) -> list[str]:
    return [each.text for each in commands if isinstance(each, events.StatusText)]


def warnings(commands: Sequence[Command]) -> list[str]:
    return [c.text for c in commands if isinstance(c, events.StatusText) and c.warning]


def fresh(of: Mission = MISSION) -> State:
    limits = of.task.limits
    return State.of(of, empty_map(of.task.cell_m, limits.north_m, limits.east_m))


def home_or_on(request: PlanRequest) -> PlanOutcome:
    """A planner that finds every way, the way back too."""
    if request.flown is None:
        return planned(request)
    here = request.scan_nea_m
    return Backtrack(
        plan_id=request.plan_id,
        subpaths=(straight(here, (0.0, 0.0, here[2])),),
        through=(False,),
        reaches_start=True,
    )


def only_the_first(request: PlanRequest) -> PlanOutcome:
    """A first leg; then neither a way on nor, as that is no way back, one back."""
    return planned(request) if request.plan_id == 1 else not_planned(request)


def scan(height_m: float = NO_ANSWER) -> Scan:
    return Scan(
        row=0,
        column=0,
        heights_m=np.full((1, 1), height_m),
        radar_nea_m=np.zeros((1, 1, 3)),
        range_m=20_000.0,
        drift_m=0.0,
        registration_m=0.0,
    )


def scan_done(time_s: float, *, answered: int = 1, asked: int = 1) -> ScanDone:
    return ScanDone(
        time_s=time_s, scan=scan(0.0 if answered else NO_ANSWER), asked=asked, answered=answered
    )


def status(time_s: float, mode: Mode = Mode.GUIDED, *, armed: bool = True) -> VehicleStatus:
    return VehicleStatus(time_s=time_s, mode=mode, armed=armed)


def position(
    time_s: float, at: Vector = (0.0, 0.0, TAKE_OFF_AMSL_M), velocity: Vector = (0.0, 0.0, 0.0)
) -> events.Position:
    return events.Position(time_s=time_s, position_nea_m=at, velocity_nea_m_s=velocity)


class Program(abc.ABC):
    """A mission that is flown tick by tick, with a vehicle that somebody makes up."""

    state: State
    now_s: float
    tick_s = TICK_S
    said_to: Sequence[Command]
    """All that the vehicle was told."""

    @abc.abstractmethod
    def tick(self) -> object:
        """A tick later: the vehicle has moved and said so, and was answered."""

    @property
    def over(self) -> bool:
        return self.state.phase in OVER

    def sent(self, kind: type[Kind]) -> list[Kind]:
        return [command for command in self.said_to if isinstance(command, kind)]

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


class Craft(Program):
    """A mission in flight, and a vehicle that does exactly what it is told."""

    mode, armed, landed = Mode.OTHER, False, Landed.ON_GROUND
    here: Vector = (0.0, 0.0, HOME_AMSL_M)
    home_nea_m: Vector | None = here
    velocity: Vector = (0.0, 0.0, 0.0)
    climb_to_m: float | None = None
    obeys_modes = follows = fix = estimator = arms = takes_off = True
    accepts = failsafe = scan_asked = False
    """Whether it accepts a take-off that it does not begin; and what its autopilot does."""
    answered = asked = 1
    """Of the radar's blocks."""
    battery: float | None = None
    pending: tuple[float, PlanOutcome] | None = None

    def __init__(
        self,
        of: Mission = MISSION,
        plan: Callable[[PlanRequest], PlanOutcome | None] = planned,
        traits: VehicleTraits = ARDUCOPTER.traits,
        shadow: bool = False,
        go: bool = True,
    ) -> None:
        self.context = Context(mission=of, seed=1, shadow=shadow, go=go)
        self.state, self.now_s, self.traits, self.plan = fresh(of), 0.0, traits, plan
        self.told: list[Event] = []
        """What it says at the next tick."""
        self.steps: list[Taken] = []

    @property
    def phase(self) -> Phase:
        return self.state.phase

    @property
    def commands(self) -> list[Command]:
        return [command for *_, commands in self.steps for command in commands]

    said_to = commands

    def take(self, *events: Event) -> list[Command]:
        """Events in, commands out; the vehicle does not hear of them."""
        out: list[Command] = []
        for event in events:
            before = self.state
            self.state, commands = machine.step(before, event, self.context)
            self.steps.append((before, event, self.state, commands))
            out += commands
        return out

    def obey(self, commands: Sequence[Command]) -> None:
        for command in commands:
            match command:
                case events.RequestStreams():
                    self.told += [
                        events.Prepared(time_s=self.now_s, item=item) for item in events.Item
                    ]
                case events.SetMode(mode=mode) if self.obeys_modes:
                    self.mode, self.climb_to_m = mode, None
                    if self.landed is Landed.TAKING_OFF:
                        on_ground = self.here[2] <= HOME_AMSL_M
                        self.landed = Landed.ON_GROUND if on_ground else Landed.IN_AIR
                case events.Disarm():
                    self.armed = self.armed and self.landed is not Landed.ON_GROUND
                case events.Arm() if self.arms:
                    self.armed = True
                case events.TakeOff() if not self.takes_off and self.accepts:
                    self.told.append(events.TakeOffTaken(time_s=self.now_s))
                case events.TakeOff(above_home_m=height) if self.takes_off:
                    self.told.append(events.TakeOffTaken(time_s=self.now_s))
                    self.mode = Mode.TAKE_OFF if self._by_itself else self.mode
                    self.climb_to_m = HOME_AMSL_M + height
                    self.landed = Landed.TAKING_OFF if self.armed else self.landed
                case events.StartScan():
                    self.scan_asked = True
                case events.Plan(request=request, due_s=due_s):
                    outcome = self.plan(request)
                    self.pending = None if outcome is None else (due_s, outcome)
                case events.Setpoint() if self.follows and self.mode is Mode.GUIDED:
                    self._follow(command)
                case _:
                    pass

    @property
    def _by_itself(self) -> bool:
        return self.traits.take_off is not TakeoffSequence.GUIDED_THEN_CLIMB

    def _follow(self, setpoint: events.Setpoint) -> None:
        """Be there; what cannot hover flies towards it at the mission's speed."""
        there = setpoint.position_nea_m
        if self.traits.hovers:
            self.here, self.velocity = there, setpoint.velocity_nea_m_s
            return
        apart, step = math.dist(there, self.here), self.context.mission.task.limits.speed_m_s
        share = min(step * TICK_S / max(apart, 1e-6), 1.0)
        north, east, up = (share * (b - a) for a, b in zip(self.here, there, strict=True))
        self.here = (self.here[0] + north, self.here[1] + east, self.here[2] + up)
        self.velocity = (north / TICK_S, east / TICK_S, up / TICK_S)

    def _move(self) -> None:
        """Climb, sink or stand; what setpoints say was done when they came."""
        height = self.here[2]
        if self._by_itself and self.mode is Mode.TAKE_OFF and self.armed:
            self.climb_to_m = self.climb_to_m or HOME_AMSL_M + 50.0
            self.landed = Landed.TAKING_OFF
        if self.climb_to_m is not None and self.armed:
            height = min(height + 25.0 * TICK_S, self.climb_to_m)
            if height == self.climb_to_m:
                self.landed, self.climb_to_m = Landed.IN_AIR, None
                self.mode = Mode.HOLD if self._by_itself else self.mode
        elif self.mode is Mode.LAND and self.landed is not Landed.ON_GROUND:
            height = max(height - 2.5 * TICK_S, HOME_AMSL_M)
            if height == HOME_AMSL_M:
                self.landed, self.armed = Landed.ON_GROUND, False
        if self.mode is not Mode.GUIDED:
            self.velocity = (0.0, 0.0, 0.0)
        self.here = (*self.here[:2], height)

    def says(self) -> list[Event]:
        """What the vehicle says at the next tick of its clock."""
        self.now_s = now = round(self.now_s + TICK_S, 6)
        self._move()
        said: list[Event] = [events.Tick(time_s=now)]
        if round(now / TICK_S) % 10 == 0:
            said += [
                VehicleStatus(time_s=now, mode=self.mode, armed=self.armed, failsafe=self.failsafe),
                events.LandedState(time_s=now, landed=self.landed),
                events.GpsFix(time_s=now, good=self.fix),
                events.Estimator(time_s=now, good=self.estimator),
            ]
            if self.home_nea_m is not None:
                said.append(events.Home(time_s=now, position_nea_m=self.home_nea_m))
            if self.battery is not None:
                said.append(events.Battery(time_s=now, remaining=self.battery))
        if self.phase is Phase.WAITING:
            found = events.VehicleFound(time_s=now, system_id=1, traits=self.traits, name="made up")
            said.append(found)
        said, self.told = [*said, *self.told], []
        if self.scan_asked:
            self.scan_asked = False
            said.append(scan_done(now, answered=self.answered, asked=self.asked))
        if self.pending is not None and now >= self.pending[0]:
            said.append(events.PlanReady(time_s=now, outcome=self.pending[1]))
            self.pending = None
        return [*said, position(now, self.here, self.velocity)]

    def tick(self) -> list[Command]:
        out: list[Command] = []
        for event in self.says():
            commands = self.take(event)
            self.obey(commands)
            out += commands
        return out

    def during(self, seconds: float) -> list[Command]:
        """What is said while it flies on for so long."""
        count = len(self.commands)
        return self.run_for(seconds).commands[count:]

    def is_taken(self, mode: Mode, *, failsafe: bool = False) -> "Craft":
        """From now on another has it, in that mode."""
        self.mode, self.failsafe, self.obeys_modes = mode, failsafe, False
        return self

    @property
    def phases(self) -> set[Phase]:
        """All that it has come through."""
        return {after.phase for *_, after, _ in self.steps}

    def copy(self) -> "Craft":
        """Another one that has come as far, and flies on by itself."""
        other = copy.copy(self)
        other.steps, other.told = [*self.steps], [*self.told]
        return other

    def order(self, kind: events.OrderKind) -> "Craft":
        """A person's order, obeyed at once."""
        self.obey(self.take(order_of(self, kind)))
        return self

    def restart(self) -> "Craft":
        """The companion dies and is started again from its checkpoint."""
        values = json.loads(json.dumps(checkpoint.values_of(self.state)))
        self.state = checkpoint.restored(self.context.mission, self.state.flight.known, values)
        return self

    def reboot(self) -> "Craft":
        """The autopilot's clock begins again, as the session tells it."""
        self.now_s = 1.0
        self.state = replace(self.state, now_s=1.0, since_s=1.0)
        self.obey(self.take(events.Rebooted(time_s=1.0)))
        return self

    def end(self) -> events.End:
        ends = self.sent(events.End)
        assert len(ends) == 1, ends
        return ends[0]


_STEP = machine.step
_FLIGHTS = 16


def once(fly: Callable[..., Craft]) -> Callable[..., Craft]:
    """What begins with the same flight flies it once, without a nudge; each gets its own."""
    flown: dict[tuple[Any, ...], tuple[Craft, Any]] = {}

    @functools.wraps(fly)
    def again(*arguments: Any, **keywords: Any) -> Craft:
        key = (*map(id, arguments), *((name, id(value)) for name, value in keywords.items()))
        if key not in flown:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(machine, "step", _STEP)
                flown[key] = fly(*arguments, **keywords), (arguments, keywords)
        craft, _ = flown[key]
        if len(flown) > _FLIGHTS:
            del flown[next(iter(flown))]
        return craft.copy()

    return again


@once
def preparing() -> Craft:
    """Waiting for a fix on the ground."""
    craft = Craft()
    craft.fix = False
    return craft.fly_to(Phase.PREPARING)


def ready() -> Craft:
    """It waits for somebody who says go."""
    return Craft(NEAR, go=False).fly_to(Phase.READY)


@once
def flying(of: Mission = MISSION, **keywords: Any) -> Craft:
    """On its first leg, at speed."""
    craft = Craft(of, **keywords).fly_to(Phase.FLYING)
    return craft.run_until(lambda craft: craft.state.reference.speed_m_s > 100.0)


@once
def holding_without_plan() -> Craft:
    return Craft(plan=not_planned).fly_to(Phase.HOLDING)


@once
def holding_mode_taken() -> Craft:
    craft = flying()
    craft.mode, craft.obeys_modes = Mode.OTHER, False
    return craft.fly_to(Phase.HOLDING)


@once
def holding_without_fix(of: Mission = MISSION) -> Craft:
    craft = flying(of)
    craft.fix = False
    return craft.fly_to(Phase.HOLDING)


@once
def arrived(of: Mission = NEAR) -> Craft:
    return Craft(of).fly_to(Phase.ARRIVED)


@once
def landing() -> Craft:
    return arrived(LAND).fly_to(Phase.LANDING)


SITUATIONS: dict[str, Callable[[], Craft]] = {
    "waiting": Craft,
    "preparing": preparing,
    "ready": ready,
    "arming": lambda: Craft().fly_to(Phase.ARMING),
    "taking off": lambda: Craft().fly_to(Phase.TAKING_OFF),
    "flying": lambda: flying(AWAY),
    "no plan": holding_without_plan,
    "taken": holding_mode_taken,
    "no fix": holding_without_fix,
    "arrived": arrived,
    "landing": landing,
}


def order_of(craft: Any, kind: events.OrderKind) -> events.Order:
    """An order by a ground station, with a place if it is one that needs it."""
    target_ne_m = (6_000.0, 2_000.0) if kind is events.OrderKind.REPOSITION else None
    return events.Order(time_s=craft.now_s, kind=kind, target_ne_m=target_ne_m, sender="255/190")


Step = events.OrderKind | Phase | Reason | float | Callable[[Craft], object]


def tell(it: Any, kind: events.OrderKind) -> OrderResult:
    """An order, as the session gives it: obeyed if it is accepted."""
    order = order_of(it, kind)
    verdict = changes.order_result(it.state, order)
    if verdict is OrderResult.ACCEPTED:
        commands = it.take(order)
        if isinstance(it, Craft):
            it.obey(commands)
    return verdict


def now(**changes: object) -> Callable[[Craft], None]:
    """From now on the vehicle, or its planner, is like that."""

    def change(craft: Craft) -> None:
        for name, value in changes.items():
            setattr(craft, name, value)

    return change


def hears(kind: Callable[..., Event], **fields: object) -> Callable[[Craft], None]:
    """The mission hears of this, too."""
    return lambda craft: craft.obey(craft.take(kind(time_s=craft.now_s, **fields)))


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
