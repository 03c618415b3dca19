"""A vehicle, a planner, people and a link to which anything at all happens, over and over.

A program is one random mission: which vehicle, which mission, what goes wrong and how often.  It
goes through the mission machine event by event; `watch.Watch` sees every step.
"""

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from made_up import HOME_AMSL_M as HOME_AMSL_M
from made_up import MISSION, Program, scan
from made_up_plans import certificate, not_planned, planned, straight, within_band
from renewed import replace
from watch import Watch

from companion.mavlink.autopilots import ALL, PX4_FIXED_WING
from companion.mission import changes, checkpoint, events, machine
from companion.mission.decisions import Context
from companion.mission.events import Command, Event, Item, Landed, Mode, OrderKind, Position, Vector
from companion.mission.mission import EndAction, Fallback, Mission
from companion.mission.phases import Phase
from companion.mission.state import State
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits
from companion.path.limits import Limits
from companion.path.subpath import Subpath
from companion.planner.request import Backtrack, Planned, PlanOutcome, PlanRequest
from companion.planner.settings import PlannerSettings, Task
from companion.world.known_map import empty_map
from companion.world.zones import CircleZone, PolygonZone, Zone

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
_SCAN = replace(scan(0.0), radar_nea_m=np.zeros((1, 1, 3)), range_m=800.0)
_CALM: dict[str, Any] = {
    "targets_ne_m": _TARGETS[:1],
    "end_action": EndAction.HOLD,
    "fallback": Fallback.HOLD,
    "endurance_s": None,
    "yaw_rad": None,
}
"""Of a mission to which nothing happens."""
_KEPT = (Phase.PREPARING, Phase.TAKING_OFF, Phase.FLYING, Phase.HOLDING, Phase.ARRIVED)
_KEPT = (*_KEPT, Phase.RETURNING, Phase.LANDING)
"""Phases in which a companion leaves something to go on with."""
_TROUBLES = (
    *("fix", "estimator", "position", "frozen", "jump", "lag"),  # of the position
    *("deaf", "weak", "drift", "echo", "no echo", "drain", "failsafe"),
)
_CHANCES = {
    "something_wrong": 10.0,
    "order": 8.0,
    "garbage": 6.0,
    "fence": 4.0,
    "old_plan": 4.0,
    "mode": 2.0,
    "give_back": 2.0,
    "late_clock": 2.0,
    "restart": 2.0,
    "silence": 1.5,
    "targets": 1.5,
    "namesake": 1.0,
    "teleport": 0.7,
    "reboot": 0.6,
    "death": 0.5,
    "stop": 0.3,
}
"""What happens to a program, `_name`, and how often beside the others."""
_SHARES = np.array([*_CHANCES.values()]) / sum(_CHANCES.values())
_ORDERS_1_S = 0.1
_SILENCES_S = (3.0, 30.0)
"""When a silence is told of."""


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


class Wild(Program):
    """One program: a vehicle that mostly does what it is told, in a world that mostly does not."""

    def __init__(self, seed: int, step: Callable[..., Any] | None = None) -> None:
        self.rng = rng = np.random.default_rng(seed)
        self.machine_step = step or machine.step
        self.autopilot = ALL[seed % len(ALL)]
        self.traits = self.autopilot.traits
        mission, shadow = mission_for(self.traits, rng), bool(rng.random() < 0.08)
        self.begins(mission, shadow=shadow, go=seed % 3 > 0)
        often = rng.choice([0.0, 0.003, 0.02, 0.1, 0.4], p=[0.05, 0.2, 0.4, 0.25, 0.1])
        self.trouble, self.calm = float(often), False
        self.tick_s = float(rng.choice([0.05, 0.1, 0.2, 0.25]))
        self.bad_plans = float(rng.choice([0.0, 0.2, 0.6]))
        self.now_s = self.began_s = float(rng.choice([0.0, 5000.0]))
        self.lasting: tuple[float, str] = (math.inf, "")
        """One thing that lasts, long enough for every deadline, and when it begins."""
        self.lasting_in: Phase | None = None
        if rng.random() < 0.3:
            self.trouble, self.tick_s = 0.002, 0.25
            self.lasting = float(rng.uniform(60.0, 300.0)), str(rng.choice((*_TROUBLES, "no plan")))
            self.lasting_in = _KEPT[int(rng.integers(len(_KEPT)))]
        self.busy = bool(rng.random() < 0.25)
        """Whether a person orders something all the time, with little else going wrong."""
        if self.busy:
            self.trouble, self.lasting_in = min(self.trouble, 0.003), None
        self.said_to: list[Command] = []
        self.events = 0
        self.mode, self.armed, self.landed = Mode.OTHER, False, Landed.ON_GROUND
        self.here: Vector = (0.0, 0.0, HOME_AMSL_M)
        self.velocity: Vector = (0.0, 0.0, 0.0)
        self.goal: Vector | None = None
        self.climb_to_m: float | None = None
        self.streamed_at_s, self.course_rad = -math.inf, 0.0
        self.battery = float(rng.choice([1.0, 0.22], p=[0.8, 0.2]))
        self.wrong: dict[str, float] = {}
        """What is wrong now, and until when."""
        self.later: list[tuple[float, Event]] = []
        self.old: list[events.PlanReady] = []
        if rng.random() < 0.25:
            self.aloft(list(Mode)[rng.integers(len(Mode))], float(rng.uniform(2, 60)))

    def begins(self, mission: Mission, *, shadow: bool, go: bool) -> None:
        """A mission that has not begun, and who watches it."""
        self.mission = mission
        self.context = Context(mission=mission, seed=1, shadow=shadow, go=go)
        limits = mission.task.limits
        known = empty_map(mission.task.cell_m, limits.north_m, limits.east_m)
        self.state = State.of(mission, known)
        self.watch = Watch(mission, self.traits, self.autopilot, self.context)

    @staticmethod
    def calmly(traits: VehicleTraits, *, shadow: bool = False, **changes: Any) -> "Wild":
        """The same without any trouble, on the ground: a mission with one target."""
        made = Wild(next(k for k, each in enumerate(ALL) if each.traits is traits))
        made.begins(replace(made.mission, **_CALM | changes), shadow=shadow, go=True)
        made.lasting, made.lasting_in, made.busy = (math.inf, ""), None, False
        made.calm, made.trouble, made.bad_plans, made.battery = True, 0.0, 0.0, 1.0
        made.now_s, made.tick_s = 0.0, 0.2 if traits.hovers else 0.1  # 2 m either way
        made.mode, made.armed, made.landed = Mode.OTHER, False, Landed.ON_GROUND
        made.here = (0.0, 0.0, HOME_AMSL_M)
        return made

    def aloft(self, mode: Mode, height_m: float = 20.0) -> "Wild":
        """In the air already, in some mode."""
        self.mode, self.armed, self.landed = mode, True, Landed.IN_AIR
        self.here = (0.0, 0.0, HOME_AMSL_M + height_m)
        return self

    # --- the loop

    def run(self, events: int) -> None:
        """At least so many events, or until some are seen to do nothing after the end."""
        after = 0
        while self.events < events and after < 8:
            self.tick()
            after += self.over

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

    def drawn(self, values: Any) -> Any:
        """One of these."""
        return values[int(self.rng.integers(len(values)))]

    def tick(self) -> None:
        """The clock goes on, the vehicle moves and says so; something may happen."""
        rng = self.rng
        self.now_s = round(self.now_s + self.tick_s, 6)
        self.move()
        phase = self.state.phase
        if self.now_s > self.began_s + self.lasting[0] or phase is self.lasting_in:
            self.wrong[self.lasting[1]], self.frozen_at = math.inf, self.here
            self.bad_plans = 1.0 if self.lasting[1] == "no plan" else self.bad_plans
            self.lasting, self.lasting_in = (math.inf, ""), None
        if rng.random() < self.trouble:
            getattr(self, f"_{[*_CHANCES][int(rng.choice(len(_SHARES), p=_SHARES))]}")()
        if self.busy and rng.random() < _ORDERS_1_S * self.tick_s:
            self._order()
        if phase is Phase.READY and rng.random() < 0.1 * self.tick_s:
            self.take(events.Order(time_s=self.now_s, kind=OrderKind.START, sender="255/190"))
        if not self.is_wrong("silent"):
            for event in self.said():
                self.take(event)
            return
        since_s = self.now_s - self.silent_since_s
        for silent_s in _SILENCES_S:
            if since_s - self.tick_s < silent_s <= since_s:
                self.take(events.LinkLost(time_s=self.now_s, silent_s=silent_s))

    # --- what it says

    def said(self) -> list[Event]:
        now, traits, said = self.now_s, self.traits, [events.Tick(time_s=self.now_s)]
        if self.state.phase is Phase.WAITING:
            said.append(
                events.VehicleFound(time_s=now, system_id=1, traits=traits, name=traits.name)
            )
        beat = round(now / self.tick_s) % max(round(1.0 / self.tick_s), 1)
        if beat == 0:
            self.battery = max(self.battery - (0.02 if self.is_wrong("drain") else 0.0002), 0.0)
            fails = self.is_wrong("failsafe")
            said += [
                events.VehicleStatus(time_s=now, mode=self.mode, armed=self.armed, failsafe=fails),
                events.Home(time_s=now, position_nea_m=(0.0, 0.0, HOME_AMSL_M)),
                events.Battery(time_s=now, remaining=round(self.battery, 2)),
            ]
        if beat % 4 == 1:
            good = not self.is_wrong("estimator")
            said += [
                events.LandedState(time_s=now, landed=self.landed),
                events.GpsFix(time_s=now, good=not self.is_wrong("fix")),
                events.Estimator(time_s=now, good=good, error_m=1.0),
            ]
        echoes = traits is not PX4_FIXED_WING.traits and not self.is_wrong("no echo")
        if echoes and self.mode is Mode.GUIDED and beat % 2 == 0:
            north, east, up = self.goal or self.here
            north += 900.0 * self.is_wrong("echo")
            said.append(events.Echo(time_s=now, position_nea_m=(north, east, up)))
        said += [replace(event, time_s=now) for at_s, event in self.later if at_s <= now]
        self.later = [(at_s, event) for at_s, event in self.later if at_s > now]
        if not self.is_wrong("position"):
            north, east, up = self.frozen_at if self.is_wrong("frozen") else self.here
            here = (north + 150.0 * self.is_wrong("jump"), east, up)
            at_s = now - 0.8 * self.is_wrong("lag")
            said.append(Position(time_s=at_s, position_nea_m=here, velocity_nea_m_s=self.velocity))
        return said

    # --- what it does

    def obey(self, command: Command) -> None:
        now = self.now_s
        if self.is_wrong("deaf"):
            return
        match command:
            case events.RequestStreams():
                for item in Item:
                    delay_s, refusal = 0.5, ""
                    if not self.calm:
                        delay_s = float(self.rng.choice([0.5, 3.0, 500.0], p=[0.6, 0.35, 0.05]))
                        refusal = "made up" if self.rng.random() < 0.02 else ""
                    ready = events.Prepared(time_s=now, item=item, refusal=refusal)
                    self.later.append((now + delay_s, ready))
            case events.SetMode(mode=mode):
                streams = now - self.streamed_at_s < 1.0
                if (
                    mode is not Mode.GUIDED
                    or streams
                    or not self.traits.needs_setpoints_before_offboard
                ):
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
                self.goal = there if self.mode is Mode.GUIDED else self.goal
            case _:
                pass

    def plan(self, request: PlanRequest, due_s: float) -> None:
        """An answer in time, late or never; safe, not proven, or none."""
        late_s = 0.0
        if not self.calm and self.rng.random() < 0.1 * (self.bad_plans > 0):
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
        if self.rng.random() >= self.bad_plans:
            return self.towards(request)
        if self.rng.random() < 0.5:
            return not_planned(request)
        return replace(self.towards(request), certificate=certificate(broken=("floor",)))

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
        tick_s, (north, east, height) = self.tick_s, self.here
        speed_m_s, aloft = self.mission.task.limits.speed_m_s, self.landed is not Landed.ON_GROUND
        weak, led = self.is_wrong("weak"), (0.0, 0.0, 0.0)
        self.course_rad += 0.25 * tick_s
        if self.mode is Mode.TAKE_OFF and self.armed and self.climb_to_m is None and not aloft:
            self.climb_to_m = HOME_AMSL_M + 40.0
        if self.climb_to_m is not None and self.armed and not weak:
            self.landed, led = Landed.TAKING_OFF, (0.0, 0.0, 3.0)
            if height >= self.climb_to_m:
                self.landed, self.climb_to_m = Landed.IN_AIR, None
                self.mode = Mode.HOLD if self.mode is Mode.TAKE_OFF else self.mode
        elif self.mode is Mode.LAND and aloft:
            led = (0.0, 0.0, 0.0 if weak else -2.0)
            if height <= HOME_AMSL_M:
                self.landed, self.armed = Landed.ON_GROUND, False
        elif self.mode is Mode.GUIDED and self.goal is not None and aloft and not weak:
            away = [b - a for a, b in zip(self.here, self.goal, strict=True)]
            share_1_s = min(speed_m_s / max(math.hypot(*away), 1e-6), 1.0 / tick_s)
            led = (share_1_s * away[0], share_1_s * away[1], share_1_s * away[2])
        if not self.traits.hovers and aloft and math.hypot(*led[:2]) < 5.0:  # it circles
            course = math.cos(self.course_rad), math.sin(self.course_rad)
            led = (speed_m_s * course[0], speed_m_s * course[1], led[2])
        elif self.is_wrong("drift"):
            led = (led[0] + 1.5, led[1], led[2])
        self.velocity = led
        height = max(height + tick_s * led[2], HOME_AMSL_M)
        self.here = (north + tick_s * led[0], east + tick_s * led[1], height)

    # --- what happens

    def _something_wrong(self) -> None:
        what = str(self.rng.choice(_TROUBLES))
        self.wrong[what] = self.now_s + self.drawn((0.3, 0.8, 1.5, 4.0, 20.0, 100.0, 400.0))
        self.frozen_at = self.here
        if what == "failsafe":
            self.mode, self.goal = self.drawn((Mode.HOLD, Mode.RETURN, Mode.LAND)), None

    def _silence(self) -> None:
        if not self.is_wrong("silent"):
            self.silent_since_s = self.now_s
            self.wrong["silent"] = self.now_s + self.drawn((0.4, 2.0, 4.0, 20.0, 40.0))

    def _mode(self) -> None:
        """Somebody changes it: a person, or the autopilot for its fence."""
        if self.now_s % 1.0 < 0.5:
            self.take(events.FenceBreach(time_s=self.now_s))
        self.mode, self.goal = self.drawn([*Mode]), None

    def _give_back(self) -> None:
        self.mode, self.goal = Mode.GUIDED, None

    def _teleport(self) -> None:
        north, east = self.rng.uniform(-900.0, 900.0, 2).tolist()
        self.here = (north, east, HOME_AMSL_M + float(self.rng.uniform(0, 110)))

    def _garbage(self) -> None:
        """An event that contradicts everything."""
        rng, now, here, moves = self.rng, self.now_s, self.here, self.velocity
        far = tuple(float(value) for value in rng.normal(0.0, 2000.0, 3))
        early_s, armed, good = (
            self.drawn((0.0, 0.2, 0.6, 3.0)),
            rng.random() < 0.8,
            self.drawn((True, False)),
        )
        error_m, home = float(rng.uniform(0, 9)), (0.0, 0.0, float(rng.uniform(2900, 3040)))
        self.take(
            self.drawn(
                [
                    events.LandedState(time_s=now, landed=self.drawn([*Landed])),
                    events.VehicleStatus(time_s=now, mode=self.drawn([*Mode]), armed=armed),
                    Position(time_s=now - early_s, position_nea_m=far, velocity_nea_m_s=moves),
                    Position(time_s=now - early_s, position_nea_m=here, velocity_nea_m_s=far),
                    events.GpsFix(time_s=now, good=False),
                    events.Estimator(time_s=now, good=good, error_m=error_m),
                    events.Home(time_s=now, position_nea_m=home),
                    events.Origin(time_s=now, position_nea_m=far),
                    events.Echo(time_s=now, position_nea_m=far),
                    events.Battery(time_s=now, remaining=float(rng.random())),
                    events.Prepared(time_s=now, item=Item.PLANS, refusal="made up"),
                    events.PlanLate(time_s=now, plan_id=self.drawn(range(9))),
                    events.ScanDone(
                        time_s=now, scan=_SCAN, asked=9, answered=self.drawn(range(10))
                    ),
                    events.VehicleFound(time_s=now, system_id=1, traits=self.traits, name="again"),
                ]
            )
        )

    def _old_plan(self) -> None:
        if self.old:
            self.take(replace(self.drawn(self.old), time_s=self.now_s))

    def _late_clock(self) -> None:
        self.now_s += self.drawn((0.0, 0.4, 0.6, 1.1, 2.5))
        self.take(events.Tick(time_s=self.now_s))

    def _order(self) -> None:
        kind, (north, east) = (
            self.drawn([*OrderKind]),
            self.rng.uniform(-1100.0, 1100.0, 2).tolist(),
        )
        target_ne_m = (north, east) if kind is OrderKind.REPOSITION else None
        order = events.Order(time_s=self.now_s, kind=kind, target_ne_m=target_ne_m)
        if changes.order_result(self.state, order) is changes.OrderResult.ACCEPTED:
            self.take(order)

    def _fence(self) -> None:
        north, east = self.rng.uniform(-600.0, 600.0, 2).tolist()
        corners = ((north, east), (north + 80.0, east), (north, east + 80.0))
        zones: list[tuple[Zone, ...]] = [
            (),
            (CircleZone(name="a", north_m=north, east_m=east, radius_m=60.0),),
            (CircleZone(name="b", north_m=0.0, east_m=0.0, radius_m=900.0, keep_in=True),),
            (PolygonZone(name="c", vertices_ne_m=corners),),
            (CircleZone(name="d", north_m=self.here[0], east_m=self.here[1], radius_m=20.0),),
        ]
        drawn, ceiling_m = self.drawn(zones), self.drawn((None, 3100.0))
        self.take(events.FenceChanged(time_s=self.now_s, zones=drawn, ceiling_amsl_m=ceiling_m))

    def _targets(self) -> None:
        at = self.rng.uniform(-900.0, 900.0, (int(self.rng.integers(0, 3)), 2))
        targets = tuple((north, east) for north, east in at.tolist())
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
