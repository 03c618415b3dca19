"""Who may begin: somebody says go to what is ready, and a second companion yields to the first."""

from collections.abc import Callable

import pytest
from made_up import (
    EACH,
    HOME_AMSL_M,
    NEAR,
    Craft,
    hears,
    mission,
    moving,
    now,
    order_of,
    ready,
    tell,
    texts,
    warnings,
)
from wild import Wild

from companion.mavlink.autopilots import ARDUCOPTER
from companion.mission import changes, checkpoint, events
from companion.mission.changes import OrderResult
from companion.mission.decisions import Context
from companion.mission.events import End, Item, Mode, OrderKind, Outcome
from companion.mission.phases import Phase, Reason
from companion.mission.tables import is_under_control
from companion.mission.vehicle_traits import VehicleTraits
from companion.world.zones import CircleZone

# --- go


def drains(craft: Craft) -> None:
    short = mission(endurance_s=600.0, targets_ne_m=NEAR.targets_ne_m)
    craft.context = Context(mission=short, seed=1)
    craft.battery = 0.1


AROUND = CircleZone(name="z", north_m=0.0, east_m=0.0, radius_m=100.0)
CHECK = {"item": Item.CHECKS, "refusal": "signing: none", "remedy": "x"}
PARAMETER = {"item": Item.PARAMETERS, "refusal": "GUID_OPTIONS = 16"}
LOSSES: dict[str, Callable[[Craft], object]] = {
    Reason.NO_FIX.text: now(fix=False),
    Reason.LINK_LOST.text: hears(events.LinkLost, silent_s=3.0),
    Reason.BATTERY_SHORT.text: drains,
    Reason.POSITION_JUMPED.text: now(here=(1e6, 0.0, HOME_AMSL_M)),
    Reason.OUTSIDE.text: hears(events.FenceChanged, zones=(AROUND,)),
    "signing: none": hears(events.Prepared, **CHECK),
    "GUID_OPTIONS = 16": hears(events.Prepared, **PARAMETER),
    Reason.NO_TARGETS.text: hears(events.TargetsChanged, targets_ne_m=()),
}


@pytest.mark.parametrize("why", LOSSES)
def test_a_check_that_fails_while_it_waits_is_told_and_a_go_refused_with_it(why: str) -> None:
    """It does not end: somebody can mend it."""
    craft = ready()
    LOSSES[why](craft)
    craft.run_until(lambda craft: craft.phase is Phase.PREPARING, 5.0)
    assert f"not ready any more: {why}" in texts(craft.commands)
    assert tell(craft, OrderKind.START) is OrderResult.NOT_NOW
    assert why in changes.why_not(craft.state, order_of(craft, OrderKind.START))
    assert craft.run_for(200.0).phase is Phase.PREPARING
    assert not moving(craft.commands)
    assert len(craft.sent(events.RequestStreams)) == 1


# --- two companions of one vehicle


def beat(it: Wild, number: int) -> None:
    """Another companion is heard, as from the wire: the third time is certain."""
    it.take(events.DuplicateId(time_s=it.now_s, certain=number >= 2, news=number == 2))


@EACH
@pytest.mark.parametrize("mode", [Mode.GUIDED, Mode.HOLD, Mode.OTHER])
def test_the_one_that_comes_second_ends_without_a_command(
    traits: VehicleTraits, mode: Mode
) -> None:
    """The first streams, so in guided mode there is no second in which it is not heard."""
    it = Wild.calmly(traits).aloft(mode)
    for number in range(6):
        beat(it, number)
        it.run_for(1.0)
    assert it.state.phase is Phase.DONE
    assert it.sent(End)[0].reason == Reason.NOT_ALONE.text
    assert not moving(it.said_to)
    assert not is_under_control(it.state)


@EACH
@pytest.mark.parametrize("first_heard_s", [0.5, 1.5, 2.5])
def test_one_that_hears_of_the_first_just_after_it_took_over_yields(
    traits: VehicleTraits, first_heard_s: float
) -> None:
    """With the path of the companion before it, it takes over at once: that may be too soon."""
    it = Wild.calmly(traits).run_until(lambda it: it.state.leg is not None).run_for(5.0)
    it._restart()
    it.run_for(first_heard_s)
    for number in range(2):
        beat(it, number)
        it.run_for(0.75)
    count = len(it.said_to)
    beat(it, 2)
    assert not moving(it.said_to[count:])
    assert it.sent(End)[0].reason == Reason.NOT_ALONE.text
    assert it.mode is Mode.GUIDED  # the first has it


# --- a flight of which nothing can be read any more, or that falls in its restart


@EACH
def test_without_its_memory_it_takes_over_in_flight_and_arrives(traits: VehicleTraits) -> None:
    it = Wild.calmly(traits).run_until(lambda it: it.state.leg is not None).run_for(8.0)
    count, number = len(it.said_to), it.state.flight.plan_id
    it.resumes(checkpoint.without_checkpoint("torn", system_id=1, time_s=it.now_s, plan_id=number))
    assert it.fly_to(Phase.DONE).said_to[-1].outcome is Outcome.ARRIVED
    said = warnings(it.said_to[count:])
    assert [text for text in said if "without memory" in text and "torn" in text]


def test_without_its_memory_it_never_arms_and_what_was_armed_before_is_put_down() -> None:
    it = Wild.calmly(ARDUCOPTER.traits).fly_to(Phase.ARMING).run_until(lambda it: it.armed)
    it.watch.context = it.context = Context(mission=it.mission, seed=1, go=False)
    it.resumes(checkpoint.values_of(it.state))
    it.run_until(lambda it: it.over, 30.0)
    assert it.state.reason is Reason.NOT_READY
    assert it.sent(events.Disarm)
    assert not it.sent(events.TakeOff)
    craft = Craft()
    torn = checkpoint.without_checkpoint("torn", system_id=1, time_s=0.0)
    craft.state = checkpoint.initial_state(craft.context.mission, (torn, None))
    assert craft.fly_to(Phase.DONE).end().reason == Reason.GROUNDED.text
    assert not moving(craft.commands)
