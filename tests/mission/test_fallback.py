"""How a flight ends that cannot go on: never in the air, unless the mission or a person says so."""

from collections.abc import Callable
from dataclasses import replace

import pytest
from made_up import (
    Craft,
    flying,
    holding_mode_taken,
    holding_without_fix,
    not_planned,
    once,
    planned,
    two_legs_away,
)

from companion.config import load_mission
from companion.mission.events import Mode, Outcome, SetMode, StatusText
from companion.mission.mission import Fallback, Mission
from companion.mission.state import Phase, Reason
from companion.planner.request import PlanOutcome, PlanRequest

AWAY = two_legs_away()


def only_the_first(request: PlanRequest) -> PlanOutcome:
    """A first leg; then neither a way on nor, as that is no way back, one back."""
    return planned(request) if request.plan_id == 1 else not_planned(request)


def no_plan(of: Mission) -> Craft:
    return flying(of, plan=only_the_first)


def radar_silent(of: Mission) -> Craft:
    craft = no_plan(of)
    craft.answered = 0
    return craft


def battery_empty(of: Mission) -> Craft:
    craft = no_plan(of)
    craft.battery = 0.1
    return craft


def does_not_follow(of: Mission) -> Craft:
    craft = flying(of)
    craft.follows = False
    return craft


def no_position(of: Mission) -> Craft:
    return holding_without_fix(of)


def broke(failure: Callable[[Mission], Craft]) -> str:
    """What is said of plans: the bounds that the best candidate broke (`made_up.not_planned`)."""
    return ": it broke floor" if failure is no_plan else ""


FAILURES = [no_plan, radar_silent, battery_empty, does_not_follow, no_position]


def modes(craft: Craft) -> list[Mode]:
    """What it was told at last, without what was repeated."""
    told = [command.mode for command in craft.sent(SetMode)]
    return [mode for mode, before in zip(told, [None, *told], strict=False) if mode is not before]


def warnings(craft: Craft) -> list[str]:
    return [said.text for said in craft.sent(StatusText) if said.warning]


@once
def over(failure: Callable[[Mission], Craft]) -> Craft:
    return failure(AWAY).fly_to(Phase.DONE)


def test_what_a_mission_falls_back_on_by_itself_ends_on_the_ground() -> None:
    assert load_mission("environment-1").fallback is Fallback.RETURN


@pytest.mark.parametrize("failure", [each for each in FAILURES if each is not no_position])
def test_a_flight_that_fails_is_left_to_its_autopilots_return_where_no_way_back_is_proven(
    failure: Callable[[Mission], Craft],
) -> None:
    craft = over(failure)
    assert Phase.HANDING_OVER in {after.phase for _, _, after, _ in craft.steps}
    assert craft.mode is Mode.RETURN
    assert craft.end().outcome is Outcome.FAILED
    reason = craft.state.flight.fallen_back
    assert reason is not None
    assert craft.end().reason == f"its autopilot returns by itself: {reason.text}{broke(failure)}"


@pytest.mark.parametrize("failure", FAILURES)
def test_a_flight_that_fails_lands_where_the_mission_says_so(
    failure: Callable[[Mission], Craft],
) -> None:
    craft = failure(replace(AWAY, fallback=Fallback.LAND)).fly_to(Phase.DONE)
    assert not craft.armed
    assert craft.end().reason.startswith("landed: ")
    assert Mode.RETURN not in modes(craft)


@pytest.mark.parametrize("failure", FAILURES)
def test_it_hovers_in_the_end_only_where_the_mission_says_hold(
    failure: Callable[[Mission], Craft],
) -> None:
    craft = failure(replace(AWAY, fallback=Fallback.HOLD)).fly_to(Phase.DONE)
    assert craft.mode is Mode.HOLD
    assert craft.armed


def test_a_vehicle_that_does_not_know_where_it_is_lands_and_is_not_sent_home() -> None:
    craft = over(no_position)
    assert not craft.armed
    assert Mode.RETURN not in modes(craft)


@pytest.mark.parametrize("failure", FAILURES)
def test_what_will_be_done_and_why_is_said_before_it_is_done(
    failure: Callable[[Mission], Craft],
) -> None:
    craft = over(failure)
    reason = craft.state.flight.fallen_back
    assert reason is not None
    mode, how = Mode.RETURN, "its autopilot is told to return"
    if failure is no_position:
        mode, how = Mode.LAND, "landing here"
    said = f"{reason.text}{broke(failure)}: {how}"
    assert said in warnings(craft)
    order = [c for c in craft.commands if c == SetMode(mode=mode) or isinstance(c, StatusText)]
    told = next(k for k, each in enumerate(order) if isinstance(each, SetMode))
    assert any(isinstance(each, StatusText) and each.text == said for each in order[:told])


def test_what_does_not_take_the_return_lands() -> None:
    craft = does_not_follow(AWAY).fly_to(Phase.HANDING_OVER)
    craft.obeys_modes = False
    craft.fly_to(Phase.LANDING)
    craft.obeys_modes = True
    assert craft.fly_to(Phase.DONE).end().reason.startswith("landed: ")


def test_what_takes_no_mode_at_all_is_told_to_hold_and_a_person_to_take_over() -> None:
    craft = does_not_follow(AWAY).fly_to(Phase.HANDING_OVER)
    craft.obeys_modes = False
    craft.fly_to(Phase.DONE)
    assert modes(craft)[-3:] == [Mode.RETURN, Mode.LAND, Mode.HOLD]
    assert craft.end().reason == Reason.NOT_OBEYING.text
    assert "by hand" in craft.end().remedy


def test_who_takes_the_vehicle_while_it_is_handed_over_has_it() -> None:
    craft = does_not_follow(AWAY).fly_to(Phase.HANDING_OVER)
    craft.mode, craft.obeys_modes = Mode.OTHER, False
    begun = len(craft.steps)
    craft.fly_to(Phase.DONE)
    later = [c for *_, commands in craft.steps[begun + 1 :] for c in commands]
    assert [c for c in later if isinstance(c, SetMode)][1:] == []
    assert craft.end().reason == Reason.MODE_TAKEN.text


def test_a_vehicle_that_somebody_else_has_is_told_nothing() -> None:
    craft = holding_mode_taken()
    begun = len(craft.commands)
    craft.run_for(700.0)
    assert [c for c in craft.commands[begun:] if isinstance(c, SetMode)] == []
    assert craft.phase is Phase.HOLDING
