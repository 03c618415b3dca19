"""A vehicle, a planner, people and a link to which anything at all happens, over and over.

A program is one random mission: which vehicle, which mission, what goes wrong and how often.
Vehicles lie, jump, freeze, reboot, fall silent or do not obey; people take over, give back, order
and draw fences; plans are late, refused, not proven or old; companions die and start again.
It goes through the mission machine event by event; `watch.Watch` sees every step.
"""

import math
from typing import Any

import numpy as np
from made_up import HOME_AMSL_M, SHORT_LEG_M, Craft, position, retraced, scan_done, short
from made_up_plans import certificate, not_planned, planned
from renewed import replace

from companion.mavlink.autopilots import ALL, PX4_FIXED_WING
from companion.mission import changes, events
from companion.mission.events import Command, Event, Item, Landed, Mode, OrderKind, Vector
from companion.mission.mission import EndAction, Fallback
from companion.mission.phases import Phase
from companion.planner.request import Planned, PlanOutcome, PlanRequest
from companion.world.zones import CircleZone, PolygonZone, Zone

_TARGETS = ((400.0, 300.0), (-500.0, 200.0), (-300.0, -600.0))
_KEPT = (Phase.PREPARING, Phase.TAKING_OFF, Phase.FLYING, Phase.HOLDING, Phase.ARRIVED)
_KEPT = (*_KEPT, Phase.RETURNING, Phase.LANDING)
"""Phases in which a companion leaves something to go on with."""
_TROUBLES = (
    *("fix", "estimator", "position", "frozen", "jump", "lag"),  # of the position
    *("deaf", "weak", "drift", "echo", "no echo", "drain", "failsafe"),
)
_CHANCES = {
    "something_wrong": 10.0, "order": 8.0, "garbage": 6.0, "fence": 4.0, "old_plan": 4.0,
    "mode": 2.0, "give_back": 2.0, "late_clock": 2.0, "restart": 2.0, "silence": 1.5,
    "targets": 1.5, "namesake": 1.0, "teleport": 0.7, "reboot": 0.6, "death": 0.5, "stop": 0.3,
}  # fmt: skip
"""What happens to a program, `_name`, and how often beside the others."""
_SHARES = np.array([*_CHANCES.values()]) / sum(_CHANCES.values())
_ORDERS_1_S = 0.1
_SILENCES_S = (3.0, 30.0)
"""When a silence is told of."""


class Wild(Craft):
    """One program: a vehicle that mostly does what it is told, in a world that mostly does not."""

    health_s = 0.25

    def __init__(self, seed: int) -> None:
        self.rng = rng = np.random.default_rng(seed)
        traits = ALL[seed % len(ALL)].traits
        mission = short(
            traits,
            targets_ne_m=_TARGETS[: int(rng.integers(1, 4))],
            end_action=list(EndAction)[rng.integers(3)],
            fallback=list(Fallback)[rng.integers(3)],
            endurance_s=[None, 400.0][rng.integers(2)],
            yaw_rad=[None, 1.0][rng.integers(2)],
        )
        shadow, go = bool(rng.random() < 0.08), seed % 3 > 0
        super().__init__(mission, self.answer, traits, shadow=shadow, go=go)
        often = rng.choice([0.0, 0.003, 0.02, 0.1, 0.4], p=[0.05, 0.2, 0.4, 0.25, 0.1])
        self.trouble = float(often)
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
        self.battery = float(rng.choice([1.0, 0.22], p=[0.8, 0.2]))
        self.wrong: dict[str, float] = {}
        """What is wrong now, and until when."""
        self.old: list[events.PlanReady] = []
        if rng.random() < 0.25:
            self.aloft(list(Mode)[rng.integers(len(Mode))], float(rng.uniform(2, 60)))

    def run(self, events: int) -> None:
        """At least so many events, or until some are seen to do nothing after the end."""
        after = 0
        while len(self.steps) < events and after < 8:
            self.tick()
            after += self.over

    def is_wrong(self, what: str) -> bool:
        return self.wrong.get(what, -1.0) > self.now_s

    def drawn(self, values: Any) -> Any:
        """One of these."""
        return values[int(self.rng.integers(len(values)))]

    def happens(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def tick(self) -> list[Command]:
        """The clock goes on, the vehicle moves and says so; something may happen."""
        rng, phase = self.rng, self.state.phase
        self.now_s = round(self.now_s + self.tick_s, 6)
        if self.now_s > self.began_s + self.lasting[0] or phase is self.lasting_in:
            self.wrong[self.lasting[1]], self.frozen_at = math.inf, self.here
            self.bad_plans = 1.0 if self.lasting[1] == "no plan" else self.bad_plans
            self.lasting, self.lasting_in = (math.inf, ""), None
        self.feels()
        self.move()
        if self.happens(self.trouble):
            getattr(self, f"_{[*_CHANCES][int(rng.choice(len(_SHARES), p=_SHARES))]}")()
        if self.busy and self.happens(_ORDERS_1_S * self.tick_s):
            self._order()
        if phase is Phase.READY and self.happens(0.1 * self.tick_s):
            self.hear(events.Order(time_s=self.now_s, kind=OrderKind.START, sender="255/190"))
        if not self.is_wrong("silent"):
            return [command for event in self.says() for command in self.hear(event)]
        since_s = self.now_s - self.silent_since_s
        for silent_s in _SILENCES_S:
            if since_s - self.tick_s < silent_s <= since_s:
                self.hear(events.LinkLost(time_s=self.now_s, silent_s=silent_s))
        return []

    def feels(self) -> None:
        """What is wrong with it by now."""
        weak, drains = self.is_wrong("weak"), self.is_wrong("drain")
        self.fix, self.estimator = not self.is_wrong("fix"), not self.is_wrong("estimator")
        self.failsafe, self.follows, self.climbs = self.is_wrong("failsafe"), not weak, not weak
        self.echoes = self.traits is not PX4_FIXED_WING.traits and not self.is_wrong("no echo")
        if weak:
            self.velocity = (0.0, 0.0, 0.0)
        self.battery = max(self.battery - self.tick_s * (0.02 if drains else 0.0002), 0.0)

    # --- what it says and does

    @property
    def led_to(self) -> Vector:
        north, east, up = super().led_to
        return north + 900.0 * self.is_wrong("echo"), east, up

    def says_where(self) -> list[Event]:
        if self.is_wrong("position"):
            return []
        north, east, up = self.frozen_at if self.is_wrong("frozen") else self.here
        here = (north + 150.0 * self.is_wrong("jump"), east, up)
        return [position(self.now_s - 0.8 * self.is_wrong("lag"), here, self.velocity)]

    def obey(self, command: Command) -> None:
        now, rng = self.now_s, self.rng
        if self.is_wrong("deaf"):
            return
        match command:
            case events.RequestStreams():
                for item in Item:
                    delay_s = float(rng.choice([0.5, 3.0, 500.0], p=[0.6, 0.35, 0.05]))
                    refusal = "made up" if self.happens(0.02) else ""
                    ready = events.Prepared(time_s=now, item=item, refusal=refusal)
                    self.will_say(ready, now + delay_s)
            case events.StartScan():
                answered = int(rng.choice([0, 4, 9], p=[0.1, 0.2, 0.7]))
                done = scan_done(now, answered=answered, asked=9)
                self.will_say(done, now + float(rng.uniform(0.0, 1.2)))
            case events.Plan(request=request, due_s=due_s):
                self._plan(request, due_s)
            case _:
                super().obey(command)

    def drift(self, led: tuple[float, float, float]) -> None:
        super().drift((led[0] + 1.5 * self.is_wrong("drift"), *led[1:]))

    def _plan(self, request: PlanRequest, due_s: float) -> None:
        """An answer in time, late or never; safe, not proven, or none."""
        late_s = 0.0
        if self.happens(0.1 * (self.bad_plans > 0)):
            late_s = float(self.rng.choice([0.5, 5.0, 30.0, 1e9]))
            self.will_say(events.PlanLate(time_s=due_s, plan_id=request.plan_id), due_s)
        ready = events.PlanReady(time_s=due_s, outcome=self.answer(request))
        if self.old and self.trouble and self.happens(0.2):  # an older answer comes first
            self.will_say(self.old[-1], self.now_s + 0.5)
        self.old = [*self.old[-3:], ready]
        self.will_say(ready, due_s + late_s)

    def answer(self, request: PlanRequest) -> PlanOutcome:
        if request.flown is not None:  # perhaps half of it
            back = retraced(request)
            count = len(back.subpaths) // (2 if self.happens(0.2 + 0.5 * self.bad_plans) else 1)
            through = tuple(self.happens(0.5) for _ in range(count))
            return replace(back, subpaths=back.subpaths[:count], through=through)
        if not self.happens(self.bad_plans):
            return self._towards(request)
        if self.happens(0.5):
            return not_planned(request)
        return replace(self._towards(request), certificate=certificate(broken=("floor",)))

    def _towards(self, request: PlanRequest) -> Planned:
        """Up or down a little, within the band."""
        low_m, high_m = request.task.band_amsl_m
        height_m = float(request.start.position_nea_m[2])
        climbs_to_m = height_m + float(self.rng.uniform(-3, 3))
        return planned(request, SHORT_LEG_M, min(max(climbs_to_m, low_m), high_m) - height_m)

    # --- what happens

    def _something_wrong(self) -> None:
        what = str(self.rng.choice(_TROUBLES))
        self.wrong[what] = self.now_s + self.drawn((0.3, 0.8, 1.5, 4.0, 20.0, 100.0, 400.0))
        self.frozen_at = self.here
        if what == "failsafe":
            self.mode = self.drawn((Mode.HOLD, Mode.RETURN, Mode.LAND))

    def _silence(self) -> None:
        if not self.is_wrong("silent"):
            self.silent_since_s = self.now_s
            self.wrong["silent"] = self.now_s + self.drawn((0.4, 2.0, 4.0, 20.0, 40.0))

    def _mode(self) -> None:
        """Somebody changes it: a person, or the autopilot for its fence."""
        if self.now_s % 1.0 < 0.5:
            self.hear(events.FenceBreach(time_s=self.now_s))
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
        early_s, armed = self.drawn((0.0, 0.2, 0.6, 3.0)), self.happens(0.8)
        error_m, home = float(rng.uniform(0, 9)), (0.0, 0.0, float(rng.uniform(2900, 3040)))
        good, answered = self.happens(0.5), self.drawn(range(10))
        said = [
            events.LandedState(time_s=now, landed=self.drawn([*Landed])),
            events.VehicleStatus(time_s=now, mode=self.drawn([*Mode]), armed=armed),
            position(now - early_s, far, moves),
            position(now - early_s, here, far),
            events.GpsFix(time_s=now, good=False),
            events.Estimator(time_s=now, good=good, error_m=error_m),
            events.Home(time_s=now, position_nea_m=home),
            events.Origin(time_s=now, position_nea_m=far),
            events.Echo(time_s=now, position_nea_m=far),
            events.Battery(time_s=now, remaining=float(rng.random())),
            events.Prepared(time_s=now, item=Item.PLANS, refusal="made up"),
            events.PlanLate(time_s=now, plan_id=self.drawn(range(9))),
            scan_done(now, answered=answered, asked=9),
            events.VehicleFound(time_s=now, system_id=1, traits=self.traits, name="again"),
        ]
        self.hear(self.drawn(said))

    def _old_plan(self) -> None:
        if self.old:
            self.hear(replace(self.drawn(self.old), time_s=self.now_s))

    def _late_clock(self) -> None:
        self.now_s += self.drawn((0.0, 0.4, 0.6, 1.1, 2.5))
        self.hear(events.Tick(time_s=self.now_s))

    def _order(self) -> None:
        kind, (north, east) = self.drawn([*OrderKind]), self.rng.uniform(-1100.0, 1100.0, 2)
        target_ne_m = (float(north), float(east)) if kind is OrderKind.REPOSITION else None
        order = events.Order(time_s=self.now_s, kind=kind, target_ne_m=target_ne_m)
        if changes.order_result(self.state, order) is changes.OrderResult.ACCEPTED:
            self.hear(order)

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
        self.hear(events.FenceChanged(time_s=self.now_s, zones=drawn, ceiling_amsl_m=ceiling_m))

    def _targets(self) -> None:
        at = self.rng.uniform(-900.0, 900.0, (int(self.rng.integers(0, 3)), 2))
        targets = tuple((north, east) for north, east in at.tolist())
        self.hear(events.TargetsChanged(time_s=self.now_s, targets_ne_m=targets))

    def _reboot(self) -> None:
        """As the session does it: the clock begins again."""
        if not self.over:
            self.wrong = {}
            self.reboot()

    def _restart(self) -> None:
        """The companion dies and is started again from its checkpoint, which may be torn."""
        if self.over or self.context.shadow or self.state.phase not in _KEPT:
            return
        self.restart(torn=self.happens(0.2))

    def _namesake(self) -> None:
        """Somebody with our ids, for certain or perhaps."""
        certain = self.happens(0.3)
        self.hear(events.DuplicateId(time_s=self.now_s, certain=certain, news=certain))

    def _death(self) -> None:
        if self.happens(0.5):
            self.hear(events.PlannerDied(time_s=self.now_s, error="made up"))

    def _stop(self) -> None:
        if self.happens(0.1):
            self.hear(events.StopAsked(time_s=self.now_s))
