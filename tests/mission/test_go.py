"""Somebody says go: a vehicle that is ready waits, and what is not ready does not go."""

from collections.abc import Callable

import pytest
from made_up import EACH, HOME_AMSL_M, Craft, mission, moving, near_target, order_of, status, texts
from wild import Wild

from companion.mavlink.autopilots import ARDUCOPTER
from companion.mission import changes, checkpoint, events
from companion.mission.changes import OrderResult
from companion.mission.decisions import Context
from companion.mission.events import (
    Arm,
    Disarm,
    FenceChanged,
    Item,
    Mode,
    OrderKind,
    Prepared,
    Rebooted,
    TakeOff,
)
from companion.mission.state import Phase, Reason
from companion.mission.vehicle_traits import VehicleTraits
from companion.world.zones import CircleZone


def ready(traits: VehicleTraits = ARDUCOPTER.traits) -> Craft:
    return Craft(near_target(), traits=traits, go=False).fly_to(Phase.READY)


def says_go(craft: Craft) -> OrderResult:
    order = order_of(craft, OrderKind.START)
    result = changes.order_result(craft.state, order)
    if result is OrderResult.ACCEPTED:
        craft.obey(craft.take(order))
    return result


@EACH
def test_a_vehicle_that_is_ready_waits_for_as_long_as_it_takes(traits: VehicleTraits) -> None:
    craft = ready(traits).run_for(600.0)
    assert craft.phase is Phase.READY
    assert not moving(craft.commands)
    assert sum("waits for go" in text for text in texts(craft.commands)) == 1
    assert says_go(craft) is OrderResult.ACCEPTED
    assert craft.phase is Phase.ARMING
    assert craft.fly_to(Phase.TAKING_OFF).sent(Arm)


def test_a_go_that_was_said_beforehand_is_not_waited_for() -> None:
    craft = Craft(near_target(), go=True).fly_to(Phase.ARMING)
    assert "waits for go" not in " ".join(texts(craft.commands))
    order = order_of(Craft(go=True).fly_to(Phase.PREPARING), OrderKind.START)
    assert changes.order_result(Craft().state, order, go=True) is OrderResult.ACCEPTED


def test_what_waits_is_told_by_a_go_alone() -> None:
    craft = ready()
    for kind in OrderKind:
        if kind is not OrderKind.START:
            order = order_of(craft, kind)
            assert changes.order_result(craft.state, order) is not OrderResult.ACCEPTED, kind
    assert craft.run_for(5.0).phase is Phase.READY


def taking(made: Callable[[float], events.Event]) -> Callable[[Craft], object]:
    return lambda craft: craft.take(made(craft.now_s))


def drains(craft: Craft) -> None:
    short = mission(endurance_s=600.0, targets_ne_m=near_target().targets_ne_m)
    craft.context = Context(mission=short, seed=1)
    craft.battery = 0.1


AROUND = CircleZone(name="z", north_m=0.0, east_m=0.0, radius_m=100.0)
CHECK = {"item": Item.CHECKS, "refusal": "signing: none", "remedy": "x"}
PARAMETER = {"item": Item.PARAMETERS, "refusal": "GUID_OPTIONS = 16"}
LOSSES: dict[str, Callable[[Craft], object]] = {
    Reason.NO_FIX.text: lambda craft: setattr(craft, "fix", False),
    Reason.LINK_LOST.text: taking(lambda now_s: events.LinkLost(time_s=now_s, silent_s=3.0)),
    Reason.BATTERY_SHORT.text: drains,
    Reason.POSITION_JUMPED.text: lambda it: setattr(it, "here", (1e6, 0.0, HOME_AMSL_M)),
    Reason.OUTSIDE.text: taking(lambda now_s: FenceChanged(time_s=now_s, zones=(AROUND,))),
    "signing: none": taking(lambda now_s: Prepared(time_s=now_s, **CHECK)),
    "GUID_OPTIONS = 16": taking(lambda now_s: Prepared(time_s=now_s, **PARAMETER)),
    Reason.NO_TARGETS.text: taking(lambda s: events.TargetsChanged(time_s=s, targets_ne_m=())),
}


@pytest.mark.parametrize("why", LOSSES)
def test_a_check_that_fails_while_it_waits_is_told_and_a_go_refused_with_it(why: str) -> None:
    craft = ready()
    LOSSES[why](craft)
    craft.run_until(lambda craft: craft.phase is Phase.PREPARING, 5.0)
    assert f"not ready any more: {why}" in texts(craft.commands)
    assert says_go(craft) is OrderResult.NOT_NOW
    assert why in changes.why_not(craft.state, order_of(craft, OrderKind.START))
    craft.run_for(300.0)
    assert craft.phase is Phase.PREPARING, "it has ended, and nobody can mend it"
    assert not moving(craft.commands)
    assert len(craft.sent(events.RequestStreams)) == 1


def test_what_is_mended_is_ready_again_and_waits_again() -> None:
    craft = ready()
    craft.fix = False
    craft.run_for(200.0)
    craft.fix = True
    craft.run_for(2.0)
    assert craft.phase is Phase.PREPARING  # the checks are not over yet
    craft.take(Prepared(time_s=craft.now_s, item=Item.CHECKS))
    craft.run_for(2.0)
    assert craft.phase is Phase.READY
    assert sum("waits for go" in text for text in texts(craft.commands)) == 2
    assert says_go(craft) is OrderResult.ACCEPTED


def test_a_go_is_not_kept_over_a_reboot() -> None:
    craft = ready()
    craft.obeys_modes = False
    assert says_go(craft) is OrderResult.ACCEPTED
    craft.obey(craft.take(Rebooted(time_s=craft.now_s)))
    craft.fly_to(Phase.READY).run_for(30.0).fix = False
    craft.obey(craft.take(Rebooted(time_s=craft.now_s)))
    assert craft.run_for(150.0).phase is Phase.PREPARING  # a person waits with it


@pytest.mark.parametrize("is_ready", [True, False])
def test_a_vehicle_that_somebody_else_arms_meanwhile_is_left_alone(is_ready: bool) -> None:
    craft = ready()
    craft.fix = is_ready
    craft.run_for(3.0)
    craft.armed, craft.mode = True, Mode.GUIDED
    assert craft.fly_to(Phase.DONE).end().reason == Reason.ARMED_ALREADY.text
    assert not moving(craft.commands)


def test_what_was_armed_before_a_restart_is_put_down_and_not_left_armed() -> None:
    it = Wild.calmly(ARDUCOPTER.traits)
    it.fly_to(Phase.ARMING).run_until(lambda it: it.armed)
    it.context = Context(mission=it.mission, seed=1, go=False)
    it.watch.context = it.context
    it.resumes(checkpoint.values_of(it.state))
    it.run_until(lambda it: it.over, 30.0)
    assert it.state.reason is Reason.NOT_READY
    assert it.sent(Disarm)
    assert not it.sent(TakeOff)


def test_who_arms_it_after_a_reboot_on_the_ground_keeps_it() -> None:
    it = Wild.calmly(ARDUCOPTER.traits)
    it.fly_to(Phase.ARMING).run_until(lambda it: it.state.armed_by_us)
    it.take(Rebooted(time_s=it.now_s))
    it.armed, it.mode = True, Mode.OTHER
    count = len(it.said_to)
    it.run_until(lambda it: it.over, 30.0)
    assert it.state.reason is Reason.ARMED_ALREADY
    assert not moving(it.said_to[count:])


def test_a_mode_of_somebody_else_is_left_alone_when_a_take_off_is_broken_off() -> None:
    """Random programs found it: told before the next heartbeat, it was asked to hold again."""
    craft = Craft(near_target(), go=True).fly_to(Phase.ARMING)
    craft.take(order_of(craft, OrderKind.LAND))
    assert craft.state.reason is Reason.BROKEN_OFF
    craft.take(status(craft.now_s, Mode.OTHER, armed=False))
    ticks = [events.Tick(time_s=craft.now_s + seconds) for seconds in (1.0, 2.0, 3.0)]
    assert not moving(craft.take(*ticks))
