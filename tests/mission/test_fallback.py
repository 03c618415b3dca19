"""How a flight ends that cannot go on: never in the air, unless the mission or a person says so."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from made_up import (
    HOME_AMSL_M,
    Craft,
    flying,
    holding_mode_taken,
    holding_without_fix,
    mission,
    moving,
    not_planned,
    planned,
    straight,
    texts,
    two_legs_away,
    warnings,
)
from wild import Wild

from companion.config import load_mission
from companion.mavlink.autopilots import ALL, Autopilot
from companion.mission import events
from companion.mission.events import Landed, Mode, Order, OrderKind, Outcome, SetMode
from companion.mission.mission import EndAction, Fallback, Mission
from companion.mission.phases import Hold, Phase, Reason
from companion.planner.request import Backtrack, NotPlanned, PlanOutcome, PlanRequest, Refusal

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


def test_what_a_mission_falls_back_on_by_itself_ends_on_the_ground() -> None:
    assert load_mission("environment-1").fallback is Fallback.RETURN


@pytest.mark.parametrize("failure", FAILURES)
@pytest.mark.parametrize("how", [Fallback.LAND, Fallback.HOLD])
def test_a_flight_that_fails_lands_or_hovers_where_the_mission_says_so(
    failure: Callable[[Mission], Craft], how: Fallback
) -> None:
    craft = failure(replace(AWAY, fallback=how)).fly_to(Phase.DONE)
    assert Mode.RETURN not in modes(craft)
    if how is Fallback.LAND:
        assert not craft.armed
        assert craft.end().reason.startswith("landed: ")
    else:
        assert (craft.mode, craft.armed) == (Mode.HOLD, True)


@pytest.mark.parametrize("failure", FAILURES)
def test_where_no_way_back_is_proven_its_autopilot_returns_and_that_is_said_before_it_is_done(
    failure: Callable[[Mission], Craft],
) -> None:
    """But what does not know where it is lands."""
    craft = failure(AWAY).fly_to(Phase.DONE)
    reason = craft.state.flight.fallen_back
    why = f"{reason.text}{broke(failure)}"
    mode, how, end = (
        Mode.RETURN,
        "its autopilot is told to return",
        "its autopilot returns by itself",
    )
    if failure is no_position:
        mode, how, end = Mode.LAND, "landing here", "landed"
    assert f"{why}: {how}" in texts(craft.commands[: craft.commands.index(SetMode(mode=mode))])
    returns = mode is Mode.RETURN
    handed = (Phase.HANDING_OVER in craft.phases, Mode.RETURN in modes(craft), craft.armed)
    assert handed == (returns, returns, returns)
    assert craft.mode is mode
    assert (craft.end().outcome, craft.end().reason) == (Outcome.FAILED, f"{end}: {why}")


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
    craft.fly_to(Phase.DONE)
    if obeys:
        assert craft.mode is second[1]
        assert craft.end().reason.partition(": ")[0] in (
            "landed",
            "its autopilot returns by itself",
        )
    else:
        assert modes(craft)[-3:] == [first[1], second[1], Mode.HOLD]
        assert craft.end().reason == Reason.NOT_OBEYING.text
        assert "by hand" in craft.end().remedy


def test_who_takes_the_vehicle_while_it_is_handed_over_has_it() -> None:
    craft = does_not_follow(AWAY).fly_to(Phase.HANDING_OVER).is_taken(Mode.OTHER)
    begun = len(craft.steps)
    craft.fly_to(Phase.DONE)
    later = [c for *_, commands in craft.steps[begun + 1 :] for c in commands]
    assert [c for c in later if isinstance(c, SetMode)][1:] == []
    assert craft.end().reason == Reason.MODE_TAKEN.text
    held = holding_mode_taken()
    assert not moving(held.during(700.0))
    assert held.phase is Phase.HOLDING


# --- home is where the vehicle has it


OUT_NEA_M = (3_000.0, -2_000.0, HOME_AMSL_M + 100.0)
"""Where a pilot has flown it before the companion was started."""
FAR = mission(targets_ne_m=((20_000.0, 20_000.0),))


def back_as_flown(request: PlanRequest) -> PlanOutcome:
    """A planner that finds every way; the way back ends where the flown path begins."""
    if request.flown is None:
        return planned(request)
    begins = request.flown[0].control_nea_m[0]
    return Backtrack(
        plan_id=request.plan_id,
        subpaths=(straight(request.scan_nea_m, begins),),
        through=(False,),
        reaches_start=True,
    )


def taken_over(of: Mission = FAR) -> Craft:
    """Started in the air, 3.6 km from home."""
    craft = Craft(of, plan=back_as_flown)
    craft.armed, craft.mode, craft.landed, craft.here = True, Mode.GUIDED, Landed.IN_AIR, OUT_NEA_M
    return craft


def under_way(craft: Craft) -> Craft:
    """On its first leg, some kilometres on."""
    return craft.run_until(lambda craft: craft.state.reference.length_m > 2_000.0)


def told(craft: Craft) -> None:
    craft.order(OrderKind.RETURN)


def low(craft: Craft) -> None:
    craft.battery = 0.1


def no_way_on(craft: Craft) -> None:
    """To the target; home there is one."""
    plan = craft.plan
    craft.plan = lambda request: (
        not_planned(request) if request.target_ne_m == FAR.targets_ne_m[0] else plan(request)
    )


def is_home(craft: Craft) -> bool:
    """Landed there; or its autopilot flies there by itself."""
    return math.dist(craft.here[:2], craft.home_nea_m[:2]) < 100.0 and not craft.armed


@pytest.mark.parametrize("why", [told, low, no_way_on])
def test_taken_over_in_flight_it_returns_home_and_not_to_where_it_was_taken_over(
    why: Callable[[Craft], None],
) -> None:
    craft = under_way(taken_over())
    why(craft)
    craft.fly_to(Phase.DONE)
    assert is_home(craft)
    assert [text for text in warnings(craft.commands) if text.endswith(": flying back, then home")]


@pytest.mark.parametrize("autopilot", ALL, ids=lambda each: each.name)
def test_so_does_each_autopilot(autopilot: Autopilot) -> None:
    """One that has no mode to land is led home, and then left to its own return."""
    it = Wild.calmly(autopilot.traits, fallback=Fallback.RETURN).aloft(Mode.GUIDED)
    it.here = (-250.0, 200.0, it.here[2])
    it.run_until(lambda it: it.state.reference.length_m > 60.0)
    it.take(Order(time_s=it.now_s, kind=OrderKind.RETURN))
    it.fly_to(Phase.DONE)
    limits = it.mission.task.limits
    assert math.hypot(*it.here[:2]) < limits.tracking_error_m + 2.5 * limits.loiter_radius_m
    assert it.mode is Mode.RETURN or not it.armed
    assert (it.mode is Mode.RETURN) == (not autopilot.traits.lands)


@pytest.mark.parametrize("why", [told, no_way_on])
def test_with_nothing_flown_yet_it_plans_home_from_where_it_is(
    why: Callable[[Craft], None],
) -> None:
    """As after a restart without memory, told to return at once."""
    craft = taken_over()
    if why is no_way_on:
        why(craft)
    craft.run_until(lambda craft: craft.state.hold in (Hold.TAKE_OVER, Hold.REPLAN))
    if why is told:
        why(craft)
    craft.fly_to(Phase.DONE)
    assert is_home(craft)
    assert [text for text in warnings(craft.commands) if text.endswith(": planning a way home")]


def test_at_the_last_target_too_and_that_is_an_arrival() -> None:
    target = (8_000.0, -2_000.0)
    craft = taken_over(replace(FAR, targets_ne_m=(target,), end_action=EndAction.RETURN))
    craft.fly_to(Phase.DONE)
    assert is_home(craft)
    assert craft.end().outcome is Outcome.ARRIVED


def test_from_where_nothing_leads_away_no_way_home_is_looked_for() -> None:
    """What is too near to the terrain does not stay there for as many attempts again."""
    craft = under_way(taken_over())
    craft.plan = lambda request: replace(
        not_planned(request), refusal=Refusal.START_NEAR_TERRAIN, broken=()
    )
    craft.fly_to(Phase.DONE)
    assert craft.mode is Mode.RETURN
    assert {request.target_ne_m for request in requests(craft)} == {FAR.targets_ne_m[0]}


@pytest.mark.parametrize(
    ("home_nea_m", "why"),
    [(None, "home is not known"), ((0.0, 1e6, HOME_AMSL_M), "home: it lies outside the map")],
    ids=["unknown", "off the map"],
)
def test_where_no_way_home_can_be_asked_for_its_autopilot_returns_and_that_is_said_before(
    home_nea_m: events.Vector | None, why: str
) -> None:
    """The origin of the map is nobody's home."""
    craft = taken_over()
    craft.home_nea_m = home_nea_m
    under_way(craft)
    told(craft)
    craft.fly_to(Phase.DONE)
    assert craft.mode is Mode.RETURN
    assert math.dist(craft.here[:2], OUT_NEA_M[:2]) < 1.0  # so far a way was proven
    said = texts(craft.commands[: craft.commands.index(SetMode(mode=Mode.RETURN))])
    assert [text for text in said if text.startswith(why)]
    assert "told to return: its autopilot is told to return" in said
    assert all(request.target_ne_m != (0.0, 0.0) for request in requests(craft))


def requests(craft: Craft) -> list[PlanRequest]:
    """Of ways to somewhere."""
    asked = [plan.request for plan in craft.sent(events.Plan)]
    return [request for request in asked if request.flown is None]


def test_what_an_autopilot_calls_home_after_a_reboot_in_the_air_is_not_flown_to() -> None:
    craft = flying(two_legs_away(), plan=back_as_flown).run_for(20.0)
    craft.obey(craft.take(events.Rebooted(time_s=craft.now_s)))
    craft.home_nea_m = craft.here
    craft.run_until(lambda craft: craft.phase is Phase.FLYING)
    told(craft)
    craft.fly_to(Phase.DONE)
    assert math.dist(craft.here[:2], (0.0, 0.0)) < 1.0


def test_told_to_return_on_its_planned_way_home_it_flies_on() -> None:
    craft = taken_over()
    craft.run_until(lambda craft: craft.state.hold is Hold.TAKE_OVER)
    told(craft)
    craft.run_until(lambda craft: craft.state.flight.homeward and craft.velocity[0] != 0.0)
    told(craft)
    assert is_home(craft.fly_to(Phase.DONE))


# --- why there is no plan is said in the planner's own words, with its own remedy


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
