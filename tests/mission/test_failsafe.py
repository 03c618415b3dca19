"""The autopilot's own failsafe takes the vehicle: it is called that, and not taken back unasked."""

import pytest
from made_up import EACH, LAND, TICK_S, Craft, arrived, flying, moving, status, texts, two_legs_away
from renewed import replace

from companion.mavlink.autopilots import ARDUCOPTER, PX4_MULTICOPTER
from companion.mission import events
from companion.mission.events import Mode, OrderKind, Outcome
from companion.mission.state import Phase, Reason
from companion.mission.stopped import FAILSAFE_OVER
from companion.mission.vehicle_traits import VehicleTraits
from companion.planner.request import NotPlanned, Refusal


def under_way(traits: VehicleTraits = ARDUCOPTER.traits) -> Craft:
    """A copter at speed; a plane about to set out (made-up ones only fly where they are told)."""
    if traits.hovers:
        return flying(two_legs_away(), traits=traits)
    return Craft(two_legs_away(), traits=traits).fly_to(Phase.FLYING)


def taken(traits: VehicleTraits = ARDUCOPTER.traits, mode: Mode = Mode.RETURN) -> Craft:
    """Its failsafe has begun, in the air, and changed the mode."""
    craft = under_way(traits)
    craft.is_taken(mode, failsafe=True)
    return craft.run_until(lambda craft: craft.state.reason is not None).run_for(0.5)


@EACH
@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.RETURN, Mode.LAND])
def test_a_mode_that_goes_in_a_failsafe_is_the_failsafes(traits: VehicleTraits, mode: Mode) -> None:
    craft = taken(traits, mode)
    if traits.needs_setpoints_before_offboard and mode is Mode.HOLD:
        assert craft.state.reason is Reason.STREAM_LOST  # it may have lost them: that goes first
        craft.run_for(40.0)
    assert craft.state.reason is Reason.FAILSAFE
    assert craft.state.taken
    assert texts(craft.commands).count(f"hold: {Reason.FAILSAFE.text}") == 1
    assert f"hold: {Reason.MODE_TAKEN.text}" not in texts(craft.commands)


@EACH
@pytest.mark.parametrize(("mode", "failsafe"), [(Mode.OTHER, True), (Mode.RETURN, False)])
def test_a_pilots_mode_and_one_without_a_failsafe_are_somebody_elses(
    traits: VehicleTraits, mode: Mode, failsafe: bool
) -> None:
    craft = under_way(traits).is_taken(mode, failsafe=failsafe).fly_to(Phase.HOLDING)
    assert craft.state.reason is Reason.MODE_TAKEN


def test_a_failsafe_that_takes_a_vehicle_held_for_its_position_is_said_so_too() -> None:
    """As PX4 does without GPS: first our hold, then its own descent."""
    craft = flying(two_legs_away(), traits=PX4_MULTICOPTER.traits)
    craft.fix = False
    craft.fly_to(Phase.HOLDING).run_for(2.0)
    assert craft.state.reason is Reason.NO_FIX
    said = craft.is_taken(Mode.LAND, failsafe=True).during(2.0)
    assert craft.state.reason is Reason.FAILSAFE
    assert texts(said) == [f"hold: {Reason.FAILSAFE.text}"]


@EACH
def test_when_it_is_over_it_says_once_how_to_go_on_and_goes_on_only_then(
    traits: VehicleTraits,
) -> None:
    """That its autopilot holds again does not mean that nobody else flies it."""
    craft = taken(traits)
    craft.fix = False
    craft.run_for(5.0)
    craft.failsafe, craft.mode = False, Mode.HOLD
    count = len(craft.commands)
    craft.run_for(5.0)
    assert FAILSAFE_OVER not in texts(craft.commands)  # its position is not trusted yet
    craft.fix = True
    craft.run_for(300.0)
    later = craft.commands[count:]
    assert texts(later) == [FAILSAFE_OVER]
    assert not moving(later)
    assert (craft.phase, craft.state.reason) == (Phase.HOLDING, Reason.FAILSAFE)
    craft.obeys_modes = True
    craft.order(OrderKind.START)
    if traits.hovers:
        assert craft.fly_to(Phase.DONE).end().outcome is Outcome.ARRIVED
    else:
        craft.fly_to(Phase.FLYING)


def test_guided_mode_gives_it_back_as_well() -> None:
    craft = taken()
    craft.failsafe, craft.mode, craft.obeys_modes = False, Mode.GUIDED, True
    assert craft.fly_to(Phase.DONE).end().outcome is Outcome.ARRIVED
    assert FAILSAFE_OVER not in texts(craft.commands)


def test_it_stays_let_go_for_a_companion_that_is_started_again() -> None:
    craft = taken()
    craft.restart()
    said = craft.during(20.0)
    assert (craft.phase, craft.state.reason) == (Phase.HOLDING, Reason.FAILSAFE)
    craft.failsafe, craft.mode = False, Mode.HOLD
    said += craft.during(60.0)
    assert not moving(said)
    assert FAILSAFE_OVER in texts(said)


def test_a_landing_that_a_failsafe_takes_is_not_begun_again_unasked() -> None:
    craft = arrived(LAND).fly_to(Phase.LANDING).run_until(lambda craft: craft.mode is Mode.LAND)
    craft.run_for(3.0)
    craft.failsafe, craft.mode = True, Mode.RETURN
    craft.run_for(5.0)
    assert (craft.phase, craft.state.reason) == (Phase.HOLDING, Reason.FAILSAFE)
    assert craft.state.orders.active is Reason.PAUSED
    assert [text for text in texts(craft.commands) if text.startswith("landing broken off")]


# --- the battery of a vehicle that somebody else flies


@pytest.mark.parametrize("reason", [Reason.MODE_TAKEN, Reason.FAILSAFE])
def test_whoever_flies_it_is_warned_of_the_battery_at_this_rate_and_at_the_reserve(
    reason: Reason,
) -> None:
    craft = taken()
    if reason is Reason.MODE_TAKEN:
        craft = flying(two_legs_away())
        craft.is_taken(Mode.OTHER).fly_to(Phase.HOLDING)
    assert craft.state.reason is reason
    count = len(craft.commands)
    for second in range(200):
        left = max(0.9 - 0.005 * second, 0.0)
        craft.take(events.Battery(time_s=craft.now_s, remaining=left))
        craft.run_for(1.0)
    assert texts(craft.commands[count:]) == [Reason.BATTERY_LOW.text] * 2
    assert not moving(craft.commands[count:])
    assert craft.state.reason is reason


def test_given_back_below_the_reserve_it_does_not_fly_on() -> None:
    craft = flying(replace(two_legs_away(), fallback=LAND.fallback))
    craft.is_taken(Mode.OTHER).fly_to(Phase.HOLDING)
    craft.battery = 0.1
    craft.run_for(10.0)
    craft.mode = Mode.GUIDED
    craft.take(status(craft.now_s + TICK_S, Mode.GUIDED))
    craft.fly_to(Phase.DONE)
    assert craft.here[:2] == pytest.approx((0.0, 0.0), abs=1.0)  # home, by a planned way
    assert craft.state.flight.fallen_back is Reason.BATTERY_LOW


# --- a hold after a hold


def given_back(craft: Craft) -> Craft:
    """By a word, to a vehicle that was told to return: it stops first, for a moment."""
    craft.failsafe, craft.mode, craft.obeys_modes = False, Mode.HOLD, True
    craft.run_for(10.0)
    craft.order(OrderKind.START)
    return craft.run_until(lambda craft: craft.state.reason is Reason.RETURN_ASKED)


def told_to_return_and_taken(mode: Mode, *, failsafe: bool) -> Craft:
    craft = flying(two_legs_away())
    craft.order(OrderKind.RETURN)
    craft.fly_to(Phase.HOLDING)
    craft.is_taken(mode, failsafe=failsafe)
    return craft.run_for(3.0)


def test_a_word_to_go_on_counts_for_the_hold_that_it_was_given_in() -> None:
    craft = given_back(told_to_return_and_taken(Mode.HOLD, failsafe=False))
    craft.mode, craft.obeys_modes = Mode.HOLD, False
    craft.run_until(lambda craft: craft.state.reason is Reason.MODE_TAKEN)
    assert not moving(craft.during(60.0))


def test_the_end_of_a_second_failsafe_is_said_too() -> None:
    craft = given_back(told_to_return_and_taken(Mode.RETURN, failsafe=True))
    craft.is_taken(Mode.RETURN, failsafe=True)
    craft.run_until(lambda craft: craft.state.reason is Reason.FAILSAFE)
    craft.failsafe = False
    craft.run_for(10.0)
    assert texts(craft.commands).count(FAILSAFE_OVER) == 2


def test_what_was_given_back_is_ours_to_bring_home() -> None:
    """Told to return, taken, given back: without a way back its autopilot's own return is left."""
    craft = told_to_return_and_taken(Mode.HOLD, failsafe=False)
    craft.plan = lambda request: NotPlanned(plan_id=request.plan_id, refusal=Refusal.NOTHING_SAFE)
    given_back(craft).fly_to(Phase.HANDING_OVER)
