"""Why there is no plan reaches the person in the planner's own words, with its own remedy."""

from dataclasses import replace

import pytest
from made_up import Craft, flying, mission, planned, two_legs_away, warnings

from companion.mission.events import Order, OrderKind, Outcome
from companion.mission.mission import Fallback
from companion.mission.state import Phase, Reason
from companion.planner.request import NotPlanned, PlanRequest, Refusal

IN_ZONE = "the target is where a zone forbids to be (inside a keep-out, outside a keep-in)"


def refused(request: PlanRequest, refusal: Refusal = Refusal.TARGET_IN_KEEP_OUT) -> NotPlanned:
    return NotPlanned(plan_id=request.plan_id, refusal=refusal)


@pytest.mark.parametrize("refusal", Refusal)
def test_a_hold_for_want_of_a_plan_says_why_and_the_end_what_helps(refusal: Refusal) -> None:
    craft = Craft(plan=lambda request: refused(request, refusal)).fly_to(Phase.DONE)
    why, _, remedy = refusal.value.partition("; ")
    said = Reason.NO_PLAN.text
    if refusal is not Refusal.NOTHING_SAFE:
        said = f"{said}: {why}"
    assert f"hold: {said}" in warnings(craft.commands)
    assert craft.end().reason == f"landed: {said}"
    assert craft.end().remedy.lower() == f"{remedy}.".lower()
    assert craft.end().remedy != Reason.NO_PLAN.remedy


def test_a_target_in_a_fence_is_said_to_be_in_it_while_the_leg_before_it_is_flown() -> None:
    craft = flying(two_legs_away())
    craft.plan = refused
    craft.run_until(lambda craft: any(IN_ZONE in text for text in warnings(craft.commands)))
    assert craft.phase is Phase.FLYING
    craft.fly_to(Phase.HOLDING)
    assert any(text.startswith("hold: ") and IN_ZONE in text for text in warnings(craft.commands))


@pytest.mark.parametrize("restarts", [False, True])
def test_a_landing_for_want_of_a_plan_ends_with_the_planners_remedy(restarts: bool) -> None:
    craft = Craft(mission(fallback=Fallback.LAND), plan=refused).fly_to(Phase.LANDING)
    if restarts:
        craft.restart()
    end = craft.fly_to(Phase.DONE).end()
    assert end.outcome is Outcome.FAILED
    assert IN_ZONE in end.reason
    assert end.remedy == "Move the target, or remove the zone."


def test_what_the_planner_said_of_an_old_target_is_not_said_of_a_new_one() -> None:
    craft = Craft(plan=refused).fly_to(Phase.HOLDING)
    craft.plan = planned
    order = Order(time_s=craft.now_s, kind=OrderKind.REPOSITION, target_ne_m=(9_000.0, 9_000.0))
    craft.obey(craft.take(order))
    assert craft.state.flight.refusal is None
    craft.fly_to(Phase.FLYING)
    craft.plan = lambda request: replace(refused(request), refusal=Refusal.NOTHING_SAFE)
    assert IN_ZONE not in " ".join(warnings(craft.during(60.0)))


def test_another_reason_to_hold_is_not_explained_by_an_old_refusal() -> None:
    craft = Craft(plan=refused).fly_to(Phase.HOLDING)
    craft.fix = False
    craft.run_until(lambda craft: craft.state.reason is Reason.NO_FIX)
    assert IN_ZONE not in " ".join(warnings(craft.during(30.0)))
