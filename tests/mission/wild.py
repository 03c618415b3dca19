"""A vehicle, a planner, people and a link to which anything at all happens, over and over.

A program is one random mission: which vehicle, which mission, what goes wrong and how often.  It
goes through the mission machine event by event; `watch.Watch` sees every step.
"""

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from made_up import MISSION, certificate, not_planned, planned, scan, straight, within_band
from renewed import replace
from watch import Watch

from companion.mavlink.autopilots import ALL, PX4_FIXED_WING
from companion.mission import changes, checkpoint, events, machine
from companion.mission.decisions import Context
from companion.mission.events import Command, Event, Item, Landed, Mode, OrderKind, Position, Vector
from companion.mission.mission import EndAction, Fallback, Mission
from companion.mission.state import Phase, State
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits
from companion.path.limits import Limits
from companion.path.subpath import Subpath
from companion.planner.request import Backtrack, Planned, PlanOutcome, PlanRequest
from companion.planner.settings import PlannerSettings, Task
from companion.world.known_map import empty_map
from companion.world.zones import CircleZone, PolygonZone, Zone

HOME_AMSL_M = 3000.0
LEG_M = 300.0
_COPTER = Limits(
    speed_m_s=10.0,
    acceleration_m_s2=2.5,
    climb_rate_m_s=3.0,
    turn_radius_m=40.0,
    climb_angle_rad=0.3,
    dive_angle_rad=0.3,
    floor_amsl_m=3010.0,
    ceiling_amsl_m=3120.0,
    north_m=(-1000.0, 1000.0),
    east_m=(-1000.0, 1000.0),
    tracking_error_m=3.0,
    navigation_error_m=2.0,
)
_PLANE = replace(
    _COPTER, speed_m_s=20.0, turn_radius_m=150.0, tracking_error_m=10.0, loiter_radius_m=80.0
)
_SETTINGS = PlannerSettings(
    scan_range_m=800.0, safety_distance_m=12.0, planning_time_s=1.0, scan_time_s=1.0
)
_TARGETS = ((400.0, 300.0), (-500.0, 200.0), (-300.0, -600.0))


def mission_for(traits: VehicleTraits, rng: np.random.Generator) -> Mission:
    """Any end, any fallback, one to three targets."""
    return replace(
        MISSION,
        name="wild",
        task=Task(limits=_COPTER if traits.hovers else _PLANE, settings=_SETTINGS),
        targets_ne_m=_TARGETS[: int(rng.integers(1, 4))],
        end_action=list(EndAction)[rng.integers(3)],
        fallback=list(Fallback)[rng.integers(3)],
        endurance_s=[None, 400.0][rng.integers(2)],
        yaw_rad=[None, 1.0][rng.integers(2)],
    )


class Wild:
    """One program: a vehicle that mostly does what it is told, in a world that mostly does not."""

    def __init__(self, seed: int, step: Callable[..., Any] | None = None) -> None:
        self.rng = rng = np.random.default_rng(seed)
        self.machine_step = step or machine.step
        self.traits = ALL[seed % len(ALL)].traits
        self.mission = mission_for(self.traits, rng)
        shadow = bool(rng.random() < 0.08)
        self.context = Context(mission=self.mission, seed=1, shadow=shadow, go=seed % 3 > 0)
        limits = self.mission.task.limits
        known = empty_map(self.mission.task.cell_m, limits.north_m, limits.east_m)
        self.state = State.of(self.mission, known)
        self.watch = Watch(self.mission, self.traits, ALL[seed % len(ALL)], self.context)
        self.trouble = float(
            rng.choice([0.0, 0.003, 0.02, 0.1, 0.4], p=[0.05, 0.2, 0.4, 0.25, 0.1])
        )
        self.tick_s = float(rng.choice([0.05, 0.1, 0.2, 0.25]))
        self.bad_plans = float(rng.choice([0.0, 0.2, 0.6]))
        self.now_s = float(rng.choice([0.0, 5000.0]))
        self.lasting_in: Phase | None = None
        if rng.random() < 0.3:  # one thing that lasts, long enough for every deadline
            self.trouble, self.tick_s = 0.002, 0.25
            self.lasting = float(rng.uniform(60.0, 300.0)), str(rng.choice((*_TROUBLES, "no plan")))
            self.lasting_in = _KEPT[int(rng.integers(len(_KEPT)))]
        else:
            self.lasting = math.inf, ""
        self.busy = bool(rng.random() < 0.25)
        """Whether a person orders something all the time, with little else going wrong."""
        if self.busy:
            self.trouble, self.lasting_in = min(self.trouble, 0.003), None
        self.calm = False
        self.said_to: list[Command] = []
        self.events = 0
        self.began_s = self.now_s
        self.mode, self.armed, self.landed = Mode.OTHER, False, Landed.ON_GROUND
        self.here: Vector = (0.0, 0.0, HOME_AMSL_M)
        self.velocity: Vector = (0.0, 0.0, 0.0)
        self.goal: Vector | None = None
        self.climb_to_m: float | None = None
        self.streamed_at_s = -math.inf
        self.battery = float(rng.choice([1.0, 0.22], p=[0.8, 0.2]))
        self.course_rad = 0.0
        self.wrong: dict[str, float] = {}
        """What is wrong now, and until when."""
        self.later: list[tuple[float, Event]] = []
        self.old: list[events.PlanReady] = []
        self.zones: tuple[Zone, ...] = ()
        if rng.random() < 0.25:  # it flies already
            self.mode = list(Mode)[rng.integers(len(Mode))]
            self.armed, self.landed = True, Landed.IN_AIR
            self.here = (float(rng.normal(0, 50)), 0.0, HOME_AMSL_M + float(rng.uniform(2, 60)))

    @staticmethod
    def calmly(traits: VehicleTraits, *, shadow: bool = False, **changes: Any) -> "Wild":
        """The same without any trouble, on the ground: a mission with one target."""
        number = next(k for k, each in enumerate(ALL) if each.traits is traits)
        made = Wild(number)
        defaults = {
            "targets_ne_m": _TARGETS[:1],
            "end_action": EndAction.HOLD,
            "fallback": Fallback.HOLD,
            "endurance_s": None,
            "yaw_rad": None,
        }
        made.mission = replace(made.mission, **{**defaults, **changes})
        made.context = Context(mission=made.mission, seed=1, shadow=shadow, go=True)
        made.state = State.of(made.mission, made.state.flight.known)
        made.watch = Watch(made.mission, traits, ALL[number], made.context)
        made.lasting, made.lasting_in = (math.inf, ""), None
        made.busy, made.battery = False, 1.0
        made.calm, made.trouble, made.bad_plans, made.now_s = True, 0.0, 0.0, 0.0
        made.tick_s = 0.2 if traits.hovers else 0.1  # 2 m either way
        made.mode, made.armed, made.landed = Mode.OTHER, False, Landed.ON_GROUND
        made.here = (0.0, 0.0, HOME_AMSL_M)
        return made

    def aloft(self, mode: Mode, height_m: float = 20.0) -> "Wild":
        """In the air already, in some mode."""
        self.mode, self.armed, self.landed = mode, True, Landed.IN_AIR
        self.here = (0.0, 0.0, HOME_AMSL_M + height_m)
        return self

    # --- the loop

    @property
    def over(self) -> bool:
        return self.state.phase in (Phase.DONE, Phase.FAULTED)

    def run(self, events: int) -> None:
        """At least so many events, or until some are seen to do nothing after the end."""
        after = 0
        while self.events < events and after < 8:
            self.tick()
            after += self.over

    def run_until(self, done: Callable[["Wild"], bool], limit_s: float = 900.0) -> "Wild":
        deadline_s = self.now_s + limit_s
        while not done(self):
            assert self.now_s < deadline_s, f"nothing after {limit_s} s: {self.state.phase}"
            self.tick()
        return self

    def fly_to(self, phase: Phase) -> "Wild":
        return self.run_until(lambda wild: wild.state.phase is phase)

    def run_for(self, seconds: float) -> "Wild":
        for _ in range(round(seconds / self.tick_s)):
            self.tick()
        return self

    def sent(self, kind: type[Any]) -> list[Any]:
        return [command for command in self.said_to if isinstance(command, kind)]

    def take(self, event: Event) -> None:
        """One event: the machine decides, the watch sees it, the vehicle obeys."""
        self.events += 1
        before = self.state
        self.state, commands = self.machine_step(before, event, self.context)
        self.watch.saw(before, event, self.state, commands)
        if self.calm:
            self.said_to += commands
        for command in commands:
            self.obey(command)

    def is_wrong(self, what: str) -> bool:
        return self.wrong.get(what, -1.0) > self.now_s

    def tick(self) -> None:
        """The clock goes on, the vehicle moves and says so; something may happen."""
        rng = self.rng
        self.now_s = round(self.now_s + self.tick_s, 6)
        self.move()
        phase = self.state.phase
        if self.now_s > self.began_s + self.lasting[0] or phase is self.lasting_in:
            self.lasts(self.lasting[1])
        if rng.random() < self.trouble:
            self.happen()
        if self.busy and rng.random() < _ORDERS_1_S * self.tick_s:
            self._order()
        if phase is Phase.READY and rng.random() < 0.1 * self.tick_s:
            self.take(events.Order(time_s=self.now_s, kind=OrderKind.START, sender="255/190"))
        if self.is_wrong("silent"):
            for silent_s in (3.0, 30.0):
                since_s = self.now_s - self.silent_since_s
                if since_s - self.tick_s < silent_s <= since_s:
                    self.take(events.LinkLost(time_s=self.now_s, silent_s=silent_s))
            return
        for event in self.said():
            self.take(event)

    def lasts(self, what: str) -> None:
        """From now on this stays wrong."""
        self.lasting, self.lasting_in = (math.inf, ""), None
        self.wrong[what] = math.inf
        self.frozen_at = self.here
        self.bad_plans = 1.0 if what == "no plan" else self.bad_plans

    # --- what it says

    def said(self) -> list[Event]:
        now, said = self.now_s, [events.Tick(time_s=self.now_s)]
        if self.state.phase is Phase.WAITING:
            name = self.traits.name
            said.append(events.VehicleFound(time_s=now, system_id=1, traits=self.traits, name=name))
        beat = round(now / self.tick_s) % max(round(1.0 / self.tick_s), 1)
        if beat == 0:
            failsafe = self.is_wrong("failsafe")
            said.append(
                events.VehicleStatus(
                    time_s=now, mode=self.mode, armed=self.armed, failsafe=failsafe
                )
            )
            said.append(events.Home(time_s=now, position_nea_m=(0.0, 0.0, HOME_AMSL_M)))
            self.battery = max(self.battery - (0.02 if self.is_wrong("drain") else 0.0002), 0.0)
            said.append(events.Battery(time_s=now, remaining=round(self.battery, 2)))
        if beat % 4 == 1:
            said.append(events.LandedState(time_s=now, landed=self.landed))
            said.append(events.GpsFix(time_s=now, good=not self.is_wrong("fix")))
            said.append(
                events.Estimator(time_s=now, good=not self.is_wrong("estimator"), error_m=1.0)
            )
        if self.traits is not PX4_FIXED_WING.traits and self.mode is Mode.GUIDED and beat % 2 == 0:
            echo = self.goal or self.here
            if self.is_wrong("echo"):
                echo = (echo[0] + 900.0, echo[1], echo[2])
            if not self.is_wrong("no echo"):
                said.append(events.Echo(time_s=now, position_nea_m=echo))
        due = [event for at_s, event in self.later if at_s <= now]
        self.later = [(at_s, event) for at_s, event in self.later if at_s > now]
        said += [replace(event, time_s=now) for event in due]
        if not self.is_wrong("position"):
            said.append(self.position())
        return said

    def position(self) -> Position:
        here = self.here
        if self.is_wrong("frozen"):
            here = self.frozen_at
        if self.is_wrong("jump"):
            here = (here[0] + 150.0, here[1], here[2])
        at_s = self.now_s - (0.8 if self.is_wrong("lag") else 0.0)
        return Position(time_s=at_s, position_nea_m=here, velocity_nea_m_s=self.velocity)

    # --- what it does

    def obey(self, command: Command) -> None:
        now = self.now_s
        if self.is_wrong("deaf"):
            return
        match command:
            case events.RequestStreams():
                for item in Item if not self.calm else ():
                    delay_s = float(self.rng.choice([0.5, 3.0, 500.0], p=[0.6, 0.35, 0.05]))
                    refusal = "made up" if self.rng.random() < 0.02 else ""
                    ready = events.Prepared(time_s=now, item=item, refusal=refusal)
                    self.later.append((now + delay_s, ready))
                if self.calm:
                    self.later += [
                        (now + 0.5, events.Prepared(time_s=now, item=item)) for item in Item
                    ]
            case events.SetMode(mode=mode):
                streams = (
                    now - self.streamed_at_s < 1.0
                    or not self.traits.needs_setpoints_before_offboard
                )
                if mode is not Mode.GUIDED or streams:
                    self.mode, self.goal = mode, None
            case events.Arm():
                self.armed = self.landed is Landed.ON_GROUND or self.armed
            case events.TakeOff(altitude_amsl_m=altitude):
                by_itself = self.traits.take_off is not TakeoffSequence.GUIDED_THEN_CLIMB
                self.mode = Mode.TAKE_OFF if by_itself else self.mode
                self.climb_to_m = altitude
                self.later.append((now + 0.2, events.TakeOffTaken(time_s=now)))
            case events.StartScan():
                answered = 9 if self.calm else int(self.rng.choice([0, 4, 9], p=[0.1, 0.2, 0.7]))
                done = events.ScanDone(time_s=now, scan=_SCAN, asked=9, answered=answered)
                self.later.append((now + float(self.rng.uniform(0.0, 1.2)), done))
            case events.Plan(request=request, due_s=due_s):
                self.plan(request, due_s)
            case events.Setpoint(position_nea_m=there):
                self.streamed_at_s = now
                if self.mode is Mode.GUIDED:
                    self.goal = there
            case _:
                pass

    def plan(self, request: PlanRequest, due_s: float) -> None:
        """An answer in time, late or never; safe, not proven, or none."""
        draw = self.rng.random()
        late_s = 0.0
        if draw < 0.1 * (self.bad_plans > 0) and not self.calm:
            late_s = float(self.rng.choice([0.5, 5.0, 30.0, 1e9]))
            self.later.append((due_s, events.PlanLate(time_s=due_s, plan_id=request.plan_id)))
        outcome = self.answer(request)
        ready = events.PlanReady(time_s=due_s, outcome=outcome)
        self.watch.answered(request, outcome)
        if self.old and self.trouble and self.rng.random() < 0.2:  # an older answer comes first
            self.later.append((self.now_s + 0.5, self.old[-1]))
        self.old = [*self.old[-3:], ready]
        self.later.append((due_s + late_s, ready))

    def answer(self, request: PlanRequest) -> PlanOutcome:
        if request.flown is not None:
            return self.way_back(request)
        if self.rng.random() < self.bad_plans:
            if self.rng.random() < 0.5:
                return not_planned(request)
            broken = replace(certificate(), broken=("floor",))
            return replace(self.towards(request), certificate=broken)
        return self.towards(request)

    def towards(self, request: PlanRequest) -> Planned:
        """Up or down a little, within the band."""
        low_m, high_m = request.task.band_amsl_m
        height_m = float(request.start.position_nea_m[2])
        climbs_to_m = height_m + float(self.rng.uniform(-3, 3))
        return planned(request, LEG_M, climb_m=min(max(climbs_to_m, low_m), high_m) - height_m)

    def way_back(self, request: PlanRequest) -> Backtrack:
        subpaths: list[Subpath] = []
        for stretch in reversed(request.flown or ()):
            flown = Subpath(control_nea_m=stretch.control_nea_m)
            a, b = flown.pose(stretch.until_m), flown.pose(stretch.from_m)
            back = straight(a.position_nea_m, b.position_nea_m)
            if not within_band(back, request.task):  # under another ceiling than it was flown
                break
            if stretch.until_m - stretch.from_m > 1.0:
                subpaths.append(back)
        if not self.calm and self.rng.random() < 0.2 + 0.5 * self.bad_plans:
            subpaths = subpaths[: len(subpaths) // 2]
        return Backtrack(
            plan_id=request.plan_id,
            subpaths=tuple(subpaths),
            through=tuple(bool(self.rng.random() < 0.5) for _ in subpaths),
            reaches_start=True,
        )

    def move(self) -> None:
        """Where it is a tick later: climbing, landing, flying to its goal, circling, drifting."""
        limits, tick_s = self.mission.task.limits, self.tick_s
        north, east, height = self.here
        velocity = (0.0, 0.0, 0.0)
        self.course_rad += 0.25 * tick_s
        aloft = self.landed is not Landed.ON_GROUND
        if self.mode is Mode.TAKE_OFF and self.armed and self.climb_to_m is None and not aloft:
            self.climb_to_m = HOME_AMSL_M + 40.0
        if self.climb_to_m is not None and self.armed and not self.is_wrong("weak"):
            self.landed = Landed.TAKING_OFF
            velocity = (0.0, 0.0, 3.0)
            if height >= self.climb_to_m:
                self.landed, self.climb_to_m = Landed.IN_AIR, None
                self.mode = Mode.HOLD if self.mode is Mode.TAKE_OFF else self.mode
        elif self.mode is Mode.LAND and aloft:
            velocity = (0.0, 0.0, 0.0 if self.is_wrong("weak") else -2.0)
            if height <= HOME_AMSL_M:
                self.landed, self.armed = Landed.ON_GROUND, False
        elif self.mode is Mode.GUIDED and self.goal is not None and aloft:
            apart_m = math.dist(self.goal, self.here)
            most = limits.speed_m_s / max(apart_m, 1e-6)
            if not self.is_wrong("weak"):
                share = min(most, 1.0 / tick_s)
                d = [share * (b - a) for a, b in zip(self.here, self.goal, strict=True)]
                velocity = (d[0], d[1], d[2])
        if not self.traits.hovers and aloft and math.hypot(*velocity[:2]) < 5.0:
            speed = limits.speed_m_s
            north, east = (at + v for at, v in zip((north, east), velocity[:2], strict=True))
            velocity = (
                speed * math.cos(self.course_rad),
                speed * math.sin(self.course_rad),
                velocity[2],
            )
            north, east = self.here[:2]
        elif self.is_wrong("drift"):
            velocity = (velocity[0] + 1.5, velocity[1], velocity[2])
        self.velocity = velocity
        self.here = (
            north + tick_s * velocity[0],
            east + tick_s * velocity[1],
            max(height + tick_s * velocity[2], HOME_AMSL_M),
        )

    # --- what happens

    def happen(self) -> None:
        """One thing, lasting or not."""
        rng = self.rng
        kind = _HAPPENINGS[int(rng.choice(len(_HAPPENINGS), p=_WEIGHTS))]
        getattr(self, f"_{kind}")()

    def _something_wrong(self) -> None:
        what = str(self.rng.choice(_TROUBLES))
        lasts_s = float(self.rng.choice([0.3, 0.8, 1.5, 4.0, 20.0, 100.0, 400.0]))
        self.wrong[what] = self.now_s + lasts_s
        self.frozen_at = self.here
        if what == "failsafe":
            modes = (Mode.HOLD, Mode.RETURN, Mode.LAND)
            self.mode, self.goal = modes[self.rng.integers(3)], None

    def _silence(self) -> None:
        if not self.is_wrong("silent"):
            self.silent_since_s = self.now_s
            lasts_s = float(self.rng.choice([0.4, 2.0, 4.0, 20.0, 40.0]))
            self.wrong["silent"] = self.now_s + lasts_s

    def _mode(self) -> None:
        """Somebody changes it: a person, or the autopilot for its fence."""
        if self.now_s % 1.0 < 0.5:
            self.take(events.FenceBreach(time_s=self.now_s))
        self.mode, self.goal = list(Mode)[self.rng.integers(len(Mode))], None

    def _give_back(self) -> None:
        self.mode, self.goal = Mode.GUIDED, None

    def _teleport(self) -> None:
        at = self.rng.uniform(-900.0, 900.0, 2)
        self.here = (float(at[0]), float(at[1]), HOME_AMSL_M + float(self.rng.uniform(0, 110)))

    def _garbage(self) -> None:
        """An event that contradicts everything."""
        rng, now = self.rng, self.now_s
        landed = list(Landed)[rng.integers(len(Landed))]
        mode = list(Mode)[rng.integers(len(Mode))]
        far = tuple(float(value) for value in rng.normal(0.0, 2000.0, 3))
        early_s = float(rng.choice([0.0, 0.2, 0.6, 3.0]))
        choices: list[Event] = [
            events.LandedState(time_s=now, landed=landed),
            events.VehicleStatus(time_s=now, mode=mode, armed=bool(rng.random() < 0.8)),
            Position(time_s=now - early_s, position_nea_m=far, velocity_nea_m_s=self.velocity),
            Position(time_s=now - early_s, position_nea_m=self.here, velocity_nea_m_s=far),
            events.GpsFix(time_s=now, good=False),
            events.Estimator(
                time_s=now, good=bool(rng.random() < 0.5), error_m=float(rng.uniform(0, 9))
            ),
            events.Home(time_s=now, position_nea_m=(0.0, 0.0, float(rng.uniform(2900, 3040)))),
            events.Origin(time_s=now, position_nea_m=far),
            events.Echo(time_s=now, position_nea_m=far),
            events.LinkDelay(time_s=now, round_trip_s=float(rng.choice([0.0, 0.2, 3.0]))),
            events.Battery(time_s=now, remaining=float(rng.random())),
            events.Prepared(time_s=now, item=Item.PLANS, refusal="made up"),
            events.PlanLate(time_s=now, plan_id=int(rng.integers(0, 9))),
            events.ScanDone(time_s=now, scan=_SCAN, asked=9, answered=int(rng.integers(0, 10))),
            events.VehicleFound(time_s=now, system_id=1, traits=self.traits, name="again"),
        ]
        self.take(choices[rng.integers(len(choices))])

    def _old_plan(self) -> None:
        if self.old:
            self.take(replace(self.old[self.rng.integers(len(self.old))], time_s=self.now_s))

    def _late_clock(self) -> None:
        late_s = float(self.rng.choice([0.0, 0.4, 0.6, 1.1, 2.5]))
        self.now_s += late_s
        self.take(events.Tick(time_s=self.now_s))

    def _order(self) -> None:
        rng = self.rng
        kind = list(OrderKind)[rng.integers(len(OrderKind))]
        at = tuple(float(value) for value in rng.uniform(-1100.0, 1100.0, 2))
        target_ne_m = (at[0], at[1]) if kind is OrderKind.REPOSITION else None
        order = events.Order(time_s=self.now_s, kind=kind, target_ne_m=target_ne_m)
        if changes.order_result(self.state, order) is changes.OrderResult.ACCEPTED:
            self.take(order)

    def _fence(self) -> None:
        rng = self.rng
        north, east = (float(value) for value in rng.uniform(-600.0, 600.0, 2))
        zones: list[tuple[Zone, ...]] = [
            (),
            (CircleZone(name="a", north_m=north, east_m=east, radius_m=60.0),),
            (CircleZone(name="b", north_m=0.0, east_m=0.0, radius_m=900.0, keep_in=True),),
            (
                PolygonZone(
                    name="c",
                    vertices_ne_m=((north, east), (north + 80.0, east), (north, east + 80.0)),
                ),
            ),
            (CircleZone(name="d", north_m=self.here[0], east_m=self.here[1], radius_m=20.0),),
        ]
        self.take(
            events.FenceChanged(
                time_s=self.now_s,
                zones=zones[rng.integers(len(zones))],
                ceiling_amsl_m=[None, 3100.0][rng.integers(2)],
            )
        )

    def _targets(self) -> None:
        count = int(self.rng.integers(0, 3))
        at = self.rng.uniform(-900.0, 900.0, (count, 2))
        targets = tuple((float(north), float(east)) for north, east in at)
        self.take(events.TargetsChanged(time_s=self.now_s, targets_ne_m=targets))

    def _reboot(self) -> None:
        """As the session does it: the clock begins again."""
        if self.over:
            return
        self.now_s = 1.0
        self.wrong, self.later, self.streamed_at_s = {}, [], -math.inf
        self.watch.rebooted(self.now_s)
        self.state = replace(self.state, now_s=self.now_s, since_s=self.now_s)
        self.take(events.Rebooted(time_s=self.now_s))

    def _restart(self) -> None:
        """The companion dies and is started again from its checkpoint."""
        if self.over or self.context.shadow or self.state.phase not in _KEPT:
            return
        values = json.loads(json.dumps(checkpoint.values_of(self.state)))
        if not self.calm and self.rng.random() < 0.2:  # it cannot be read
            number = self.state.flight.plan_id
            values = checkpoint.without_checkpoint("torn", time_s=self.now_s, plan_id=number)
        self.resumes(values)

    def resumes(self, values: checkpoint.Values) -> None:
        """Another companion goes on from that."""
        self.state = checkpoint.initial_state(self.mission, (values, self.state.flight.known))
        self.state = replace(self.state, now_s=self.now_s, since_s=self.now_s)
        self.later = []
        self.watch.restarted(self.now_s, forgotten="lost" in values)

    def _namesake(self) -> None:
        """Somebody with our ids, for certain or perhaps."""
        certain = bool(self.rng.random() < 0.3)
        self.take(events.DuplicateId(time_s=self.now_s, certain=certain, news=certain))

    def _death(self) -> None:
        if self.rng.random() < 0.5:
            self.take(events.PlannerDied(time_s=self.now_s, error="made up"))

    def _stop(self) -> None:
        if self.rng.random() < 0.1:
            self.take(events.StopAsked(time_s=self.now_s))


_ORDERS_1_S = 0.1
_KEPT = (
    Phase.PREPARING,
    Phase.TAKING_OFF,
    Phase.FLYING,
    Phase.HOLDING,
    Phase.ARRIVED,
    Phase.RETURNING,
    Phase.LANDING,
)
_SCAN = replace(scan(0.0), row=0, column=0, radar_nea_m=np.zeros((1, 1, 3)), range_m=800.0)
_TROUBLES = (
    "fix",
    "estimator",
    "position",
    "frozen",
    "jump",
    "deaf",
    "weak",
    "drift",
    "echo",
    "no echo",
    "drain",
    "lag",
    "failsafe",
)
_CHANCES = {
    "something_wrong": 10.0,
    "garbage": 6.0,
    "mode": 2.0,
    "give_back": 2.0,
    "order": 8.0,
    "fence": 4.0,
    "late_clock": 2.0,
    "old_plan": 4.0,
    "silence": 1.5,
    "teleport": 0.7,
    "targets": 1.5,
    "reboot": 0.6,
    "restart": 2.0,
    "namesake": 1.0,
    "death": 0.5,
    "stop": 0.3,
}
_HAPPENINGS = tuple(_CHANCES)
_WEIGHTS = np.array(list(_CHANCES.values())) / sum(_CHANCES.values())
