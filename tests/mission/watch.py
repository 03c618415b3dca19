"""Laws of the mission machine, checked at each step by one who only sees events and commands.

There is no setpoint from a position that is not to be trusted, nor beside a path that is proven and
the newest, nor with a value that is not finite or out of range, nor on the ground, nor in a mode
that is not ours; no silence in guided mode and no phase beyond its deadline; no arming and no
take-off after a flight.  Nobody else's vehicle is told anything, and nothing after the end.  A
pause is kept until a word ends it, or the battery; told to return, it flies to no target any more,
told to land, nowhere; what was planned before an order is not flown after it; and with a battery
below its reserve it leads to no target.
The watch believes nothing that the machine says of itself: all that it works out by its own,
simpler, means.
"""

import math
import operator
from collections.abc import Sequence
from typing import Any

import numpy as np

from companion.mavlink.autopilots import ALL
from companion.mavlink.autopilots.messages import To
from companion.mission import events
from companion.mission.decisions import Context
from companion.mission.events import Command, Event, Landed, Mode, OrderKind, Position, Setpoint
from companion.mission.phases import OVER, Phase, Reason, Trigger
from companion.mission.state import Goal, State
from companion.mission.vehicle_traits import VehicleTraits
from companion.path.subpath import Subpath
from companion.planner.procedure import Leg
from companion.planner.request import Backtrack, Planned

MOVING = (events.Arm, events.Disarm, events.TakeOff, events.SetMode, Setpoint, events.SetSpeed)
STREAMS = (Phase.FLYING, Phase.HOLDING, Phase.ARRIVED, Phase.RETURNING)
ARROWS = {(phase, trigger.after) for trigger in Trigger for phase in trigger.origins}
TAKEN = (Reason.MODE_TAKEN, Reason.FAILSAFE, Reason.FENCE_BREACHED)
WITH_A_PERSON = (*TAKEN, Reason.PAUSED)
"""What a vehicle may be held for as long as it takes: somebody else has the say."""
NOT_OURS = (*TAKEN, Reason.LINK_LOST, Reason.DISARMED, Reason.GROUNDED)
SETTLES_S, HOLD_S, FENCE_S, SLACK_S, TOUCHES_S = 30.0, 300.0, 300.0, 5.0, 1.5
SETS_OUT = (Phase.FLYING, Phase.RETURNING)
SHORT_S, AT_ONCE_S = 3.0, 2.0
STOPS_S = 45.0  # braking, with a vehicle that may be stuck for 30 s
ON_SETPOINTS = (
    *(Reason.NO_PLAN, Reason.PLAN_LATE, Reason.RADAR_SILENT, Reason.NEW_THREAT, Reason.NEW_TARGET),
    *(Reason.CONTINUED, Reason.RETURN_ASKED, Reason.LAND_ASKED, Reason.BATTERY_LOW),
)
PROGRESS = (Phase.FLYING, Phase.RETURNING, Phase.LANDING)
"""They may last for as long as something moves."""


def moving(commands: Sequence[Command]) -> list[Command]:
    """What moves a vehicle."""
    return [command for command in commands if isinstance(command, MOVING)]


class Watch:
    """Sees every step of one flight; AssertionError where a law is broken."""

    def __init__(self, traits: VehicleTraits, context: Context) -> None:
        [self.autopilot] = (each for each in ALL if each.traits is traits)
        self.traits, self.context, self.mission = traits, context, context.mission
        self.limits = self.mission.task.limits
        self.phases = frozenset[Phase]()
        self.proven = frozenset[bytes]()
        """Control points of the paths that may be flown."""
        self.newest = 0
        self.flown = False
        """Whether it was ever heard to be armed and in the air."""
        self.setpoints = self.kept = 0
        """How many were seen, and how often there was an order to keep to."""
        self.goals = frozenset(self.mission.targets_ne_m)
        """Where anybody ever wanted it to fly to; home is not among them."""
        self.restarted(0.0, forgotten=True)

    def forget(self, now_s: float) -> None:
        """Nothing is known of the vehicle (any more)."""
        self.mode: Mode | None = None
        self.armed, self.landed, self.landed_at_s = False, Landed.UNKNOWN, -math.inf
        self.fix = self.estimator = False
        self.estimator_failed_at_s, self.error_m = -math.inf, None
        self.position: Position | None = None
        self.moved_at_s = self.jumped_at_s = -math.inf
        self.told_by_person = self.said_go = False
        self.fence_unread_until_s = -math.inf
        self.spoke_at_s = self.since_s = self.progress_at_s = now_s
        self.streamed_at_s = -math.inf
        self.not_guided_at_s = now_s
        self.key: Any = None
        self.last: Setpoint | None = None
        self.circled: events.Vector | None = None

    def restarted(self, now_s: float, *, forgotten: bool = False) -> None:
        """Another companion goes on from the checkpoint: it has yet to hear everything.

        forgotten: without even that.
        """
        self.forget(now_s)
        self.short_at_s = math.inf
        if forgotten:
            self.paused = self.returns = self.lands = False
            self.orders = self.orders_when_asked = 0
            self.battery_at_s = 0.0

    # --- one step

    def saw(self, before: State, event: Event, after: State, commands: list[Command]) -> None:
        if before.phase in OVER:
            assert after is before, "something changed after the end"
            assert not commands, "something was said after the end"
            return
        new = self._hear(event)
        now = after.now_s
        assert now == max(before.now_s, event.time_s), "time went back"
        self.phases |= {after.phase}
        if isinstance(event, Position) and not new:
            assert not commands, "an old position was answered"
            assert after.vehicle == before.vehicle, "an old position was taken"
        self._moves(before, after, commands)
        if Phase.LANDING in (before.phase, after.phase):
            self.circled = None
        for command in commands:
            if isinstance(command, MOVING):
                assert not self.context.shadow, f"told a vehicle it only watches: {command}"
                self._whose(before, after, command)
            if isinstance(command, Setpoint):
                assert new, "a setpoint without a position"
                assert command.time_s == event.time_s
                self._setpoint(before, after, command)
            elif isinstance(command, events.Arm | events.TakeOff):
                self._up(before, command)
            elif isinstance(command, events.StartScan) and new:
                self._looks(after)
            elif isinstance(command, events.Plan):
                assert command.request.plan_id > self.newest, "an old number for a new plan"
                self.newest = command.request.plan_id
        assert sum(isinstance(command, Setpoint) for command in commands) <= 1
        self._legs(before, event, after)
        if not self.context.shadow:
            self._orders(before, event, after, commands)
            self._asks_to_hold(before, after, commands)
        self._deadlines(before, event, after, commands)

    def _hear(self, event: Event) -> bool:
        """What the vehicle said; whether it was a position newer than any before."""
        now = event.time_s
        match event:
            case events.VehicleStatus(mode=mode, armed=armed):
                self.mode, self.armed = mode, armed
            case events.LandedState(landed=landed):
                if landed is not self.landed:
                    self.landed_at_s = now
                self.landed = landed
            case events.GpsFix(good=good):
                self.fix = good
            case events.Estimator(good=good, error_m=error_m):
                if self.estimator and not good:
                    self.estimator_failed_at_s = now
                self.estimator, self.error_m = good, error_m
            case events.Order(kind=OrderKind.START | OrderKind.CONTINUE):
                self.told_by_person = True
                self.said_go |= event.kind is OrderKind.START
            case events.FenceReading(items=items):
                self.fence_unread_until_s = math.inf if items else now
            case events.PlanReady(outcome=Planned(plan_id=self.newest) as way):
                if way.certificate.proven:
                    self.proven |= {_name(way.subpath)}
            case events.PlanReady(outcome=Backtrack(plan_id=self.newest, subpaths=subpaths)):
                self.proven |= {*map(_name, subpaths)}
            case Position() if self.position is None or now > self.position.time_s:
                self._hear_position(event)
                return True
            case _:
                pass
        self.flown |= self.armed and self.landed is Landed.IN_AIR
        if self.mode is not Mode.GUIDED:
            self.not_guided_at_s = max(now, self.not_guided_at_s)
        return False

    def _hear_position(self, event: Position) -> None:
        last, now = self.position, event.time_s
        self.position = event
        if last is None:
            self.moved_at_s = now
            return
        top = math.hypot(self.limits.speed_m_s, self.limits.climb_rate_m_s)
        most_m = 1.5 * top * (now - last.time_s) + 20.0
        if math.dist(last.position_nea_m, event.position_nea_m) > most_m:
            self.jumped_at_s = now
        moves = last.position_nea_m[:2] != event.position_nea_m[:2]
        if moves or math.hypot(*event.velocity_nea_m_s[:2]) <= 1.0:
            self.moved_at_s = now

    def trusts(self, now_s: float) -> bool:
        """Whether the position may be believed: design 7, second row."""
        if self.position is None or now_s - self.position.time_s > 0.5:
            return False
        if now_s - self.moved_at_s > 1.0 or now_s - self.jumped_at_s < 0.5:
            return False
        vouched = self.estimator or now_s - self.estimator_failed_at_s <= 1.0
        accurate = self.error_m is None or self.error_m <= self.limits.navigation_error_m
        return self.fix and vouched and accurate

    def is_down(self, now_s: float) -> bool:
        """Whether it has said for a while that it is on the ground: it may touch it in passing."""
        return self.landed is Landed.ON_GROUND and now_s - self.landed_at_s > TOUCHES_S

    # --- laws

    def _moves(self, before: State, after: State, commands: list[Command]) -> None:
        if after.phase is not before.phase:
            assert (before.phase, after.phase) in ARROWS, f"{before.phase} -> {after.phase}"
            if after.phase in PROGRESS:
                self.told_by_person = False
        ends = [command for command in commands if isinstance(command, events.End)]
        assert len(ends) == (after.phase in OVER), "an end is said once, when it is over"
        for end in ends:
            assert end.reason
            assert end.remedy or end.outcome is events.Outcome.ARRIVED, "no remedy"
            if end.reason == Reason.NOT_ALONE.text:
                assert not moving(commands), "another companion's vehicle was told something"

    def _asks_to_hold(self, before: State, after: State, commands: list[Command]) -> None:
        """Whom its autopilot is to hold is told so at once; who holds already is not told again.

        PX4 would hold where it wrongly believes to be by then, which may be far away.
        """
        why = after.held_for
        asked = any(isinstance(it, events.SetMode) and it.mode is Mode.HOLD for it in commands)
        if why is not None and why is not before.held_for and why.asks_to_hold:
            assert asked or self.mode is not Mode.GUIDED, f"not told to hold: {why}"
        holds = before.held_for is not None and self.mode is Mode.HOLD
        if why is not None and holds and after.vehicle.distrust is not None:
            assert not asked, f"told to hold where it believes to be: {why}"

    def _whose(self, before: State, after: State, command: Command) -> None:
        """Nobody else's vehicle is told anything: modes that are not ours, and let-go holds."""
        said = f"{command} in {before.phase} ({before.reason}), mode {self.mode}"
        if before.phase is Phase.ARMING or after.phase in (Phase.ARMING, Phase.TAKING_OFF):
            return
        taken = before.phase is Phase.HOLDING and before.reason in TAKEN
        ours = (Mode.GUIDED,) if taken else (Mode.GUIDED, Mode.HOLD, Mode.TAKE_OFF)
        if before.phase is Phase.LANDING and before.stage.obeyed:
            ours = (*ours, Mode.LAND)
        assert self.mode in ours or self.told_by_person, f"fought for the vehicle: {said}"

    def _setpoint(self, before: State, after: State, sent: Setpoint) -> None:
        self.setpoints += 1
        now = after.now_s
        assert before.phase in STREAMS, f"a setpoint in {before.phase}"
        assert self.trusts(now), "a setpoint from a position that is not to be trusted"
        assert self.armed
        assert not self.is_down(now), "a setpoint on the ground"
        if self.mode is not Mode.GUIDED:
            assert sent.stay, f"led in mode {self.mode}"
            assert before.phase is Phase.HOLDING
        values = (*sent.position_nea_m, *sent.velocity_nea_m_s, sent.yaw_rad)
        assert all(map(math.isfinite, values)), "a value that is not finite"
        speed = math.hypot(*sent.velocity_nea_m_s)
        assert speed <= self.limits.speed_m_s + self._joining(after, 1), f"{speed} m/s"
        if self.setpoints % 7 == 0:
            told = self.autopilot.setpoint(sent, To(1, self.mission.frame), 80.0)
            assert told, "out of range"
        at, here, limits = sent.position_nea_m, self.position.position_nea_m, self.limits
        elsewhere = after.path is not None or after.task.zones  # a leg's start, or clear of a fence
        if sent.stay and self.circled is not None and not elsewhere:
            # a plane on a circle stays on it, or comes back to it: nobody has proven one beside it
            here_m, apart_m = (math.dist(self.circled[:2], p[:2]) for p in (here, at))
            is_near = here_m <= 2.0 * limits.loiter_radius_m
            assert apart_m <= 0.5 or not is_near, f"led to a circle {apart_m:.0f} m beside its own"
        if not sent.stay:
            self._on_path(before, after, sent)
            ahead_m = math.dist(at, here) - 3.0 * limits.tracking_error_m
            waits = ahead_m <= 1.3 * limits.speed_m_s or not self.traits.hovers
            assert waits, f"led {ahead_m:.0f} m ahead of a vehicle that does not follow"
        elif now - self.streamed_at_s > 1.5 or self.not_guided_at_s > self.streamed_at_s:
            led_m = limits.speed_m_s + 5.0
            if not self.traits.hovers:
                led_m = 1.3 * limits.speed_m_s * limits.lead_s + 2.0 * limits.loiter_radius_m
            apart_m = math.dist(at[:2], here[:2]) - 3.0 * limits.tracking_error_m
            assert apart_m <= led_m, f"first led to a place {apart_m:.0f} m away"
        self.streamed_at_s, self.last = now, sent
        led = self.mode is Mode.GUIDED and not self.traits.hovers
        self.circled = at if led and sent.stay else None

    def _joining(self, state: State, order: int) -> float:
        """What a join adds to position (0) or velocity (1), and a rounding error."""
        offset = None if state.path is None else state.path.offset
        if offset is None:
            return 1e-6
        aside = offset.velocity_nea_m_s if order else offset.position_nea_m
        return float(np.linalg.norm(aside)) + 1e-6

    def _on_path(self, before: State, after: State, sent: Setpoint) -> None:
        """A setpoint that leads lies on a path that is proven, and the newest.

        The leg is that of the state before, too: this step may have ended it.
        """
        legs = [*_flown_by(before), *_flown_by(after)]
        beside_m = [off_m(leg.subpath, sent.position_nea_m) for leg in legs if leg is not None]
        allowed_m = max(self._joining(before, 0), self._joining(after, 0))
        if after.path is None:  # ended in this step, and with it the join
            allowed_m += 0.3 * self._joining(before, 1)
        if any(leg is not None and leg.reaches_target for leg in legs):
            settings, radius_m = before.task.settings, before.task.limits.loiter_radius_m
            allowed_m += min(settings.safety_distance_m, 0.25 * radius_m)  # a plane passes it
        assert min(beside_m, default=math.inf) <= allowed_m, "led beside every proven path"

    def _legs(self, before: State, event: Event, after: State) -> None:
        flight = after.flight
        held = after.phase is Phase.HOLDING and before.phase is not Phase.HOLDING
        old = isinstance(event, events.PlanReady) and (
            event.outcome.plan_id != self.newest or self.orders != self.orders_when_asked
        )
        if old and not held:
            same = map(operator.is_, _flown_by(after), _flown_by(before))
            same = (*same, flight.back is before.flight.back, flight.way is before.flight.way)
            assert all(same), "took the answer to an old question, or one from before an order"
        for leg in (*_flown_by(after), *flight.back):
            if leg is not None:
                name = _name(leg.subpath)
                assert name in self.proven, "a leg that nobody has proven, or for an old question"

    def _looks(self, after: State) -> None:
        """No leg is planned from where the vehicle was sent to stay before it is there."""
        if after.path is not None or self.last is None or self.context.shadow:
            return
        apart_m = math.dist(self.position.position_nea_m[:2], self.last.position_nea_m[:2])
        on_circle_m = self.limits.loiter_radius_m + self.limits.tracking_error_m
        near_m = min(5.0, self.limits.tracking_error_m) if self.traits.hovers else on_circle_m
        assert apart_m <= near_m + 1e-5, f"looks for a leg from a place {apart_m:.0f} m away"

    def _up(self, before: State, command: events.Arm | events.TakeOff) -> None:
        assert self.landed is Landed.ON_GROUND, f"{command} in the air"
        assert not self.flown, f"{command} after a flight"
        assert before.phase in (Phase.ARMING, Phase.TAKING_OFF)
        assert self.context.go or self.said_go, "nobody has said go"
        assert isinstance(command, events.Arm) or command.above_home_m > 0.0, "up to below home"

    def _deadlines(
        self, before: State, event: Event, after: State, commands: list[Command]
    ) -> None:
        now = after.now_s
        reason = after.reason if after.phase is Phase.HOLDING else None
        key = (after.phase, reason)
        was, stage = before.stage, after.stage
        if key != self.key or stage.phase is not was.phase or stage.since_s != was.since_s:
            self.key, self.since_s, self.spoke_at_s = key, now, now
            self.progress_at_s = now
        if after.reference != before.reference or after.leg is not before.leg:
            self.progress_at_s = now
        if isinstance(event, Position) and abs(event.velocity_nea_m_s[2]) > 0.1:
            self.progress_at_s = now
        if moving(commands):
            self.spoke_at_s = now
        elif now - before.now_s > 0.5:  # no event, no word
            self.spoke_at_s = min(self.spoke_at_s + now - before.now_s, now)
        limit_s = self._limit_s(after)
        waited_s = now - (self.progress_at_s if after.phase in PROGRESS else self.since_s)
        if isinstance(event, Position):
            assert waited_s <= limit_s + SLACK_S, f"{key}: {waited_s:.0f} s without an end"
            self._stream(event, after)

    def _stream(self, event: Position, after: State) -> None:
        """A vehicle that flies where it is told is told something all the time."""
        ours = after.phase in STREAMS and after.reason not in NOT_OURS
        ours = ours and self.mode is Mode.GUIDED and self.armed
        ours = ours and not self.is_down(after.now_s) and self.position is event
        ours = ours and not (self.traits.holds_in_guided and self.circled)  # it goes on circling
        if not ours:
            self.spoke_at_s = max(self.spoke_at_s, after.now_s)
            return
        silent_s = after.now_s - self.spoke_at_s
        assert silent_s <= 2.5 + self.traits.setpoint_period_s, (
            f"{self.key}: said nothing for {silent_s:.1f} s in guided mode"
        )

    def _limit_s(self, state: State) -> float:
        """The longest that a phase may last, or go without progress; the documented deadlines."""
        limits, settings = self.limits, state.task.settings
        answers_s = settings.planning_time_s + 60.0
        turns_s = 3.0 * 2.0 * math.pi * limits.loiter_radius_m / limits.speed_m_s
        held_s = SETTLES_S + answers_s if state.reason in ON_SETPOINTS else HOLD_S
        held_s += FENCE_S * (self.fence_unread_until_s > self.since_s)
        longest_s = {
            Phase.PREPARING: math.inf if state.unready else 120.0,  # a person waits with it
            Phase.ARMING: 60.0,
            Phase.TAKING_OFF: 2.0 * 150.0 / limits.climb_rate_m_s + 60.0,
            Phase.ARRIVED: 90.0,
            Phase.LANDING: 60.0,
            **dict.fromkeys(SETS_OUT, turns_s + settings.scan_time_s + answers_s),
            Phase.HOLDING: math.inf if state.reason in WITH_A_PERSON else held_s,
        }
        return longest_s.get(state.phase, math.inf)

    # --- what people order, and the battery

    def _orders(self, before: State, event: Event, after: State, commands: list[Command]) -> None:
        self._hear_order(before, event)
        if after.goal is Goal.DOWN or after.reason is Reason.BATTERY_LOW:
            self.paused = False
        self.kept += self.paused or self.returns or self.lands or self._low_s > SHORT_S
        target = after.targets_ne_m[after.flight.target] if after.targets_ne_m else None
        if after.phase is not before.phase and after.phase in SETS_OUT:
            assert not self.paused, f"set out in a pause: {before.reason} -> {after.phase}"
            assert not self.lands, f"told to land, and sets out: {before.reason}"
            outward = after.phase is Phase.FLYING and target in self.goals
            assert not (self.returns and outward), "told to return, and flies to a target"
        for command in commands:
            if isinstance(command, events.Plan):
                self.orders_when_asked = self.orders
                assert not self.lands or after.phase is Phase.SHADOW, "told to land, and plans"
                if command.request.flown is None and command.request.target_ne_m in self.goals:
                    assert not self.paused, "plans in a pause"
                    assert not self.returns, "told to return, and plans to a target"
                    assert self._low_s <= SHORT_S + AT_ONCE_S, "plans to a target with no battery"
            elif isinstance(command, Setpoint) and not command.stay and target in self.goals:
                low = after.phase is Phase.FLYING and self._low_s > SHORT_S + STOPS_S
                assert not low, "led to a target with no battery"

    @property
    def _low_s(self) -> float:
        """For how long all that was heard of the battery was below its reserve."""
        return self.battery_at_s - self.short_at_s

    def _hear_order(self, before: State, event: Event) -> None:
        match event:
            case events.Battery(remaining=left):
                self.battery_at_s = event.time_s
                since_s = min(self.short_at_s, event.time_s)
                self.short_at_s = since_s if left < self.mission.reserve else math.inf
            case events.Rebooted():
                self.short_at_s = math.inf
            case events.TargetsChanged(targets_ne_m=targets):
                self.goals |= {*targets}
                self.short_at_s = math.inf
            case events.Order(kind=OrderKind.REPOSITION, target_ne_m=target) if target is not None:
                self.goals |= {target}
                self.paused = self.returns = self.lands = False
                self.short_at_s, self.orders = math.inf, self.orders + 1
            case events.Order(kind=OrderKind.PAUSE):
                self.paused, self.orders = True, self.orders + 1
            case events.Order(kind=OrderKind.START | OrderKind.CONTINUE):
                self.paused = False
            case events.Order(kind=OrderKind.RETURN):
                self.paused, self.returns = False, not before.flight.returning
                self.lands = False
            case events.Order(kind=OrderKind.LAND) if before.phase is not Phase.LANDING:
                self.paused, self.lands = False, True
            case _:
                pass


def _flown_by(state: State) -> tuple[Leg | None, Leg | None]:
    """The leg that it flies, and the next one."""
    return (None, None) if state.path is None else (state.path.leg, state.path.next_leg)


def _name(subpath: Subpath) -> bytes:
    return subpath.control_nea_m.tobytes()


def off_m(path: Subpath, point: tuple[float, float, float]) -> float:
    """Distance from a straight path."""
    start, along = path.control_nea_m[0], path.control_nea_m[-1] - path.control_nea_m[0]
    aside = np.asarray(point) - start
    share = min(max(along @ aside / max(along @ along, 1e-12), 0.0), 1.0)
    return float(np.linalg.norm(aside - share * along))
