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
    preparing,
    tell,
    texts,
    warnings,
)
from wild import Wild

from companion.mavlink.autopilots import ARDUCOPTER
from companion.mission import changes, checkpoint, events
from companion.mission.changes import OrderResult
from companion.mission.decisions import Context
from companion.mission.events import Command, End, Item, Mode, OrderKind, Outcome
from companion.mission.phases import Phase, Reason
from companion.mission.tables import is_under_control
from companion.mission.vehicle_traits import VehicleTraits
from companion.world.zones import CircleZone

# --- go


def ready(traits: VehicleTraits = ARDUCOPTER.traits) -> Craft:
    return Craft(NEAR, traits=traits, go=False).fly_to(Phase.READY)


@EACH
def test_a_vehicle_that_is_ready_waits_for_as_long_as_it_takes(traits: VehicleTraits) -> None:
    craft = ready(traits).run_for(200.0)
    assert craft.phase is Phase.READY
    assert not moving(craft.commands)
    assert sum("waits for go" in text for text in texts(craft.commands)) == 1
    assert tell(craft, OrderKind.START) is OrderResult.ACCEPTED
    assert craft.fly_to(Phase.TAKING_OFF).sent(events.Arm)


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


def test_who_arms_it_after_a_reboot_on_the_ground_keeps_it() -> None:
    it = Wild.calmly(ARDUCOPTER.traits)
    it.fly_to(Phase.ARMING).run_until(lambda it: it.state.armed_by_us)
    it.take(events.Rebooted(time_s=it.now_s))
    it.armed, it.mode = True, Mode.OTHER
    count = len(it.said_to)
    it.run_until(lambda it: it.over, 30.0)
    assert it.state.reason is Reason.ARMED_ALREADY
    assert not moving(it.said_to[count:])


# --- two companions of one vehicle


def beat(it: Craft | Wild, number: int) -> None:
    """Another companion is heard, as from the wire: the third time is certain."""
    it.take(events.DuplicateId(time_s=it.now_s, certain=number >= 2, news=number == 2))


def shared(it: Craft | Wild, seconds: int, every_s: float = 1.0) -> list[Command]:
    """What it does while another companion is heard each second."""
    count = len(it.said_to)
    for number in range(seconds):
        beat(it, number)
        it.run_for(every_s)
    return it.said_to[count:]


def arming() -> Craft:
    craft = Craft().fly_to(Phase.ARMING)
    craft.arms = False
    return craft.run_for(2.0)


@pytest.mark.parametrize("made", [preparing, arming])
def test_on_the_ground_both_refuse(made: Callable[[], Craft]) -> None:
    """Before anything was said to the vehicle; and one that is to be armed is not."""
    craft = made()
    craft.fix = True
    shared(craft, 3)
    end = craft.end()
    assert end.outcome is Outcome.FAILED
    assert (end.reason, end.remedy) == (Reason.NOT_ALONE.text, Reason.NOT_ALONE.remedy)
    assert not craft.sent(events.TakeOff)
    assert made is arming or not moving(craft.commands)


@EACH
def test_the_one_that_flies_flies_on_and_says_so_once(traits: VehicleTraits) -> None:
    it = Wild.calmly(traits).run_until(lambda it: it.state.leg is not None)
    assert warnings(shared(it, 20)) == [f"{Reason.NOT_ALONE.text}: end it"]
    assert it.fly_to(Phase.DONE).said_to[-1].outcome is Outcome.ARRIVED


@EACH
@pytest.mark.parametrize("mode", [Mode.GUIDED, Mode.HOLD, Mode.OTHER])
def test_the_one_that_comes_second_ends_without_a_command(
    traits: VehicleTraits, mode: Mode
) -> None:
    """The first streams, so in guided mode there is no second in which it is not heard."""
    it = Wild.calmly(traits).aloft(mode)
    shared(it, 6)
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
    shared(it, 2, every_s=0.75)
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


def test_without_its_memory_it_never_arms() -> None:
    values = checkpoint.without_checkpoint("torn", system_id=1, time_s=100.0)
    craft = Craft()
    craft.state = checkpoint.initial_state(mission(), (values, None))
    craft.now_s = 100.0
    craft.run_until(lambda craft: bool(craft.sent(End)))
    assert craft.end().reason == Reason.GROUNDED.text
    assert not moving(craft.commands)


def test_what_was_armed_before_a_restart_is_put_down_and_not_left_armed() -> None:
    it = Wild.calmly(ARDUCOPTER.traits)
    it.fly_to(Phase.ARMING).run_until(lambda it: it.armed)
    it.watch.context = it.context = Context(mission=it.mission, seed=1, go=False)
    it.resumes(checkpoint.values_of(it.state))
    it.run_until(lambda it: it.over, 30.0)
    assert it.state.reason is Reason.NOT_READY
    assert it.sent(events.Disarm)
    assert not it.sent(events.TakeOff)
