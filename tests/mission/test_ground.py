"""Two companions of one vehicle: the one that came second takes no command of it."""

from collections.abc import Callable

import pytest
from made_up import EACH, MISSION, Craft, flying, moving, preparing, two_legs_away, warnings
from wild import Wild

from companion.mavlink.autopilots import ALL
from companion.mission import checkpoint
from companion.mission.events import Arm, Command, DuplicateId, End, Mode, Outcome, TakeOff
from companion.mission.state import Phase, Reason
from companion.mission.tables import is_under_control
from companion.mission.vehicle_traits import VehicleTraits


def beat(it: Craft | Wild, number: int) -> DuplicateId:
    """As they come from the wire, one a second: the third is certain."""
    return DuplicateId(time_s=it.now_s, certain=number >= 2, news=number == 2)


def hears(craft: Craft, seconds: int = 3) -> Craft:
    """Another companion, each second."""
    for number in range(seconds):
        craft.take(beat(craft, number))
        craft.run_for(1.0)
    return craft


def shared(it: Wild, seconds: int) -> list[Command]:
    """What it does while another companion says each second that it is there."""
    count = len(it.said_to)
    for number in range(seconds):
        it.take(beat(it, number))
        it.run_for(1.0)
    return it.said_to[count:]


# --- on the ground


def arming() -> Craft:
    craft = Craft().fly_to(Phase.ARMING)
    craft.arms = False
    return craft.run_for(2.0)


@pytest.mark.parametrize("made", [preparing, arming])
def test_on_the_ground_both_refuse(made: Callable[[], Craft]) -> None:
    """Before anything was said to the vehicle; and one that is to be armed is not."""
    craft = made()
    craft.fix = True
    end = hears(craft).end()
    assert end.outcome is Outcome.FAILED
    assert (end.reason, end.remedy) == (Reason.NOT_ALONE.text, Reason.NOT_ALONE.remedy)
    assert not craft.sent(TakeOff)
    assert made is arming or not moving(craft.commands)


def test_while_it_is_not_certain_nothing_is_begun_and_then_it_goes_on() -> None:
    craft = preparing()
    craft.fix = True
    craft.take(beat(craft, 0))
    craft.run_for(2.0)
    assert craft.phase is Phase.PREPARING
    assert not moving(craft.commands)
    craft.run_for(2.0)
    assert craft.phase is not Phase.PREPARING
    assert not craft.sent(End)


# --- in the air


@EACH
def test_the_one_that_flies_flies_on_and_says_so_once(traits: VehicleTraits) -> None:
    it = Wild.calmly(traits).run_until(lambda it: it.state.leg is not None)
    said = shared(it, 20)
    assert warnings(said) == [f"{Reason.NOT_ALONE.text}: end it"]
    end = it.fly_to(Phase.DONE).said_to[-1]
    assert isinstance(end, End)
    assert end.outcome is Outcome.ARRIVED


@EACH
@pytest.mark.parametrize("mode", [Mode.GUIDED, Mode.HOLD, Mode.OTHER])
def test_the_one_that_comes_second_ends_without_a_command(
    traits: VehicleTraits, mode: Mode
) -> None:
    """The first streams, so in guided mode there is no second in which it is not heard."""
    it = Wild.calmly(traits).aloft(mode)
    said = shared(it, 6)
    assert it.state.phase is Phase.DONE
    assert it.sent(End)[0].reason == Reason.NOT_ALONE.text
    assert not moving(said)
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
    for number in range(3):
        count = len(it.said_to)
        it.take(beat(it, number))
        if it.over:
            break
        it.run_for(0.75)
    assert it.sent(End)[0].reason == Reason.NOT_ALONE.text
    assert not moving(it.said_to[count:])
    assert it.mode is Mode.GUIDED  # the first has it


def test_one_that_was_silent_with_its_vehicle_is_still_the_first() -> None:
    craft = hears(flying(two_legs_away()).run_for(10.0)).run_for(0.5)
    assert craft.phase is Phase.FLYING
    assert not craft.sent(End)


def test_a_shadow_says_so_and_watches_on() -> None:
    it = Wild.calmly(ALL[0].traits, shadow=True).aloft(Mode.GUIDED)
    said = shared(it, 10)
    assert it.state.phase is Phase.SHADOW
    assert [text for text in warnings(said) if "another" in text]
    assert not moving(it.said_to)


# --- a flight of which nothing can be read any more


@EACH
def test_without_its_memory_it_takes_over_in_flight_and_arrives(traits: VehicleTraits) -> None:
    it = Wild.calmly(traits).run_until(lambda it: it.state.leg is not None).run_for(8.0)
    count, number = len(it.said_to), it.state.flight.plan_id
    torn = checkpoint.without_checkpoint("torn", system_id=1, time_s=it.now_s, plan_id=number)
    it.resumes(torn)
    end = it.fly_to(Phase.DONE).said_to[-1]
    later = it.said_to[count:]
    assert isinstance(end, End)
    assert end.outcome is Outcome.ARRIVED
    assert [text for text in warnings(later) if "without memory" in text and "torn" in text]
    assert not [command for command in later if isinstance(command, Arm | TakeOff)]


def test_without_its_memory_it_never_arms() -> None:
    values = checkpoint.without_checkpoint("torn", system_id=1, time_s=100.0)
    craft = Craft()
    craft.state = checkpoint.initial_state(MISSION, (values, None))
    craft.now_s = 100.0
    craft.run_until(lambda craft: bool(craft.sent(End)))
    assert craft.end().reason == Reason.GROUNDED.text
    assert not moving(craft.commands)
