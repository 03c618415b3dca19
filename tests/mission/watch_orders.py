"""Laws about what people order and what the battery leaves, checked at each step as in `watch`.

A pause is kept until a word ends it, or the battery; told to return, it flies to no target any
more, told to land, nowhere; what was planned before an order is not flown after it; and with
a battery below its reserve it leads to no target, whatever it is told.
"""

import math

from companion.mission import events
from companion.mission.events import Command, Event, Order, OrderKind, Plan, PlanReady, Setpoint
from companion.mission.mission import Mission
from companion.mission.state import Goal, Phase, Reason, State

SETS_OUT = (Phase.FLYING, Phase.RETURNING)
SHORT_S, AT_ONCE_S = 3.0, 2.0
STOPS_S = 45.0  # braking, with a vehicle that may be stuck for 30 s


class WatchOrders:
    """Sees every step of one program; AssertionError where a law is broken."""

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self.goals = set(mission.targets_ne_m)
        """Where anybody ever wanted it to fly to; home is not among them."""
        self.kept = 0
        """How often there was something to keep."""
        self.forgotten()

    def forgotten(self) -> None:
        """A companion that knows nothing of it goes on."""
        self.paused = self.returns = self.lands = False
        self.orders = self.orders_when_asked = 0
        self.short_at_s, self.battery_at_s = math.inf, 0.0

    def restarted(self) -> None:
        """Another companion goes on from the checkpoint: the battery it has yet to hear of."""
        self.short_at_s = math.inf

    def saw(self, before: State, event: Event, after: State, commands: list[Command]) -> None:
        """One step."""
        self._hear(before, event)
        if after.goal is Goal.DOWN or after.reason is Reason.BATTERY_LOW:
            self.paused = False
        self.kept += self.paused or self.returns or self.lands or self._low_s > SHORT_S
        target = after.targets_ne_m[after.flight.target] if after.targets_ne_m else None
        if after.phase is not before.phase and after.phase in SETS_OUT:
            assert not self.paused, f"set out in a pause: {before.reason} -> {after.phase}"
            assert not self.lands, f"told to land, and sets out: {before.reason}"
            outward = after.phase is Phase.FLYING and target in self.goals
            assert not (self.returns and outward), "told to return, and flies to a target"
        held = after.phase is Phase.HOLDING and before.phase is not Phase.HOLDING
        old = isinstance(event, PlanReady) and self.orders != self.orders_when_asked
        if old and not held:
            legs = [(p.leg, p.next_leg) if (p := each.path) else None for each in (before, after)]
            assert legs[0] == legs[1], "a plan from before the order"
            assert after.phase is not Phase.RETURNING or before.phase is Phase.RETURNING, (
                "a way back from before the order"
            )
        for command in commands:
            if isinstance(command, Plan):
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

    def _hear(self, before: State, event: Event) -> None:
        match event:
            case events.Battery(remaining=left):
                self.battery_at_s = event.time_s
                since_s = min(self.short_at_s, event.time_s)
                self.short_at_s = since_s if left < self.mission.reserve else math.inf
            case events.Rebooted():
                self.short_at_s = math.inf
            case events.TargetsChanged(targets_ne_m=targets):
                self.goals |= set(targets)
                self.short_at_s = math.inf
            case Order(kind=OrderKind.REPOSITION, target_ne_m=target) if target is not None:
                self.goals.add(target)
                self.paused = self.returns = self.lands = False
                self.short_at_s, self.orders = math.inf, self.orders + 1
            case Order(kind=OrderKind.PAUSE):
                self.paused, self.orders = True, self.orders + 1
            case Order(kind=OrderKind.START | OrderKind.CONTINUE):
                self.paused = False
            case Order(kind=OrderKind.RETURN):
                self.paused, self.returns = False, not before.flight.returning
                self.lands = False
            case Order(kind=OrderKind.LAND) if before.phase is not Phase.LANDING:
                self.paused, self.lands = False, True
            case _:
                pass
