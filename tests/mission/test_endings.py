"""How a flight ends that cannot go on: never in the air, unless the mission or a person says so."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from made_up import (
    AWAY,
    COPTERS,
    Craft,
    flying,
    holding_without_fix,
    mission,
    not_planned,
    only_the_first,
    planned,
    straight,
    texts,
    warnings,
)

from companion.mission.events import Mode, OrderKind, Outcome, SetMode
from companion.mission.mission import Fallback, Mission
from companion.mission.phases import Phase, Reason
from companion.mission.vehicle_traits import VehicleTraits
from companion.planner.request import Backtrack, NotPlanned, PlanOutcome, PlanRequest, Refusal

HANDED, LANDS = "its autopilot returns by itself", "landed"


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


FAILURES = [no_plan, radar_silent, battery_empty, does_not_follow, holding_without_fix]


def modes(craft: Craft) -> list[Mode]:
    """What it was told at last, without what was repeated."""
    told = [command.mode for command in craft.sent(SetMode)]
    return [mode for mode, before in zip(told, [None, *told], strict=False) if mode is not before]


@pytest.mark.parametrize("failure", FAILURES)
@pytest.mark.parametrize("fallback", Fallback)
def test_a_flight_that_fails_ends_by_its_fallback_and_that_is_said_before_it_is_done(
    failure: Callable[[Mission], Craft], fallback: Fallback
) -> None:
    """No way back is proven: its autopilot returns; but what does not know where it is lands."""
    craft = failure(replace(AWAY, fallback=fallback)).fly_to(Phase.DONE)
    assert craft.end().outcome is Outcome.FAILED
    if fallback is Fallback.HOLD:
        assert (craft.mode, craft.armed) == (Mode.HOLD, True)
        assert not {Mode.RETURN, Mode.LAND} & set(modes(craft))
        return
    why = craft.state.flight.fallen_back.text + ": it broke floor" * (failure is no_plan)
    hands_over = fallback is Fallback.RETURN and failure is not holding_without_fix
    mode, how, end = Mode.LAND, "landing here", LANDS
    if hands_over:
        mode, how, end = Mode.RETURN, "its autopilot is told to return", HANDED
    assert f"{why}: {how}" in texts(craft.commands[: craft.commands.index(SetMode(mode=mode))])
    handed = (Phase.HANDING_OVER in craft.phases, Mode.RETURN in modes(craft), craft.armed)
    assert handed == (hands_over,) * 3
    assert craft.mode is mode
    assert craft.end().reason == f"{end}: {why}"


@pytest.mark.parametrize("obeys", [True, False])
@pytest.mark.parametrize("how", [Fallback.RETURN, Fallback.LAND])
def test_what_does_not_take_the_one_is_asked_for_the_other_or_to_hold_and_a_person_to_take_over(
    how: Fallback, obeys: bool
) -> None:
    phases = [(Phase.HANDING_OVER, Mode.RETURN), (Phase.LANDING, Mode.LAND)]
    first, second = phases if how is Fallback.RETURN else reversed(phases)
    craft = does_not_follow(replace(AWAY, fallback=how)).fly_to(first[0])
    craft.obeys_modes = False
    craft.fly_to(second[0])
    craft.obeys_modes = obeys
    end = craft.fly_to(Phase.DONE).end()
    if obeys:
        assert craft.mode is second[1]
        assert end.reason.partition(": ")[0] in (LANDS, HANDED)
    else:
        assert modes(craft)[-3:] == [first[1], second[1], Mode.HOLD]
        assert end.reason == Reason.NOT_OBEYING.text
        assert "by hand" in end.remedy


@COPTERS
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_an_accepted_return_that_cannot_be_flown_is_left_to_the_autopilots_own(
    traits: VehicleTraits, share: float
) -> None:
    """So much of the way back is proven, and no way home from there."""

    def plan(request: PlanRequest) -> PlanOutcome:
        if request.flown is None:
            is_home = math.hypot(*request.target_ne_m) < 10.0
            return not_planned(request) if is_home else planned(request)
        here = request.scan_nea_m
        end = ((1.0 - share) * here[0], (1.0 - share) * here[1], here[2])
        back = (straight(here, end),) if share else ()
        some = {"subpaths": back, "through": (False,) * len(back), "reaches_start": False}
        return Backtrack(plan_id=request.plan_id, **some)

    craft = flying(AWAY, plan=plan, traits=traits).run_for(20.0).order(OrderKind.RETURN)
    craft.run_until(lambda craft: craft.over)
    assert (Phase.RETURNING in craft.phases) is (share > 0.0)
    assert craft.mode is craft.sent(SetMode)[-1].mode is Mode.RETURN
    assert craft.end().outcome is Outcome.STOPPED
    assert craft.end().reason == "its autopilot returns by itself: told to return"


# --- why there is no plan is said in the planner's own words, with its own remedy


def refused(request: PlanRequest, refusal: Refusal = Refusal.TARGET_IN_KEEP_OUT) -> NotPlanned:
    return NotPlanned(plan_id=request.plan_id, refusal=refusal)


@pytest.mark.parametrize("restarts", [False, True])
@pytest.mark.parametrize("refusal", Refusal)
def test_a_hold_for_want_of_a_plan_says_why_and_the_end_what_helps(
    refusal: Refusal, restarts: bool
) -> None:
    """Also if the companion is started again in the landing."""
    land = mission(fallback=Fallback.LAND)
    craft = Craft(land, plan=lambda request: refused(request, refusal)).fly_to(Phase.LANDING)
    end = (craft.restart() if restarts else craft).fly_to(Phase.DONE).end()
    why, _, remedy = refusal.value.partition("; ")
    said = Reason.NO_PLAN.text + (f": {why}" if refusal is not Refusal.NOTHING_SAFE else "")
    assert f"hold: {said}" in warnings(craft.commands)
    assert (end.outcome, end.reason) == (Outcome.FAILED, f"landed: {said}")
    assert end.remedy.lower() == f"{remedy}.".lower() != Reason.NO_PLAN.remedy.lower()
