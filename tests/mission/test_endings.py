"""How a flight ends that cannot go on: never in the air, unless the mission or a person says so."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from made_up import (
    COPTERS,
    HOME_AMSL_M,
    Craft,
    flying,
    holding_without_fix,
    mission,
    not_planned,
    only_the_first,
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
from companion.mission.events import Landed, Mode, OrderKind, Outcome, SetMode
from companion.mission.mission import EndAction, Fallback, Mission
from companion.mission.phases import Hold, Phase, Reason
from companion.mission.vehicle_traits import VehicleTraits
from companion.planner.request import Backtrack, NotPlanned, PlanOutcome, PlanRequest, Refusal

AWAY = two_legs_away()
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


# --- home is where the vehicle has it


OUT_NEA_M = (3_000.0, -2_000.0, HOME_AMSL_M + 100.0)
"""Where a pilot has flown it before the companion was started."""


def back_as_flown(request: PlanRequest) -> PlanOutcome:
    """A planner that finds every way; the way back ends where the flown path begins."""
    if request.flown is None:
        return planned(request)
    back = straight(request.scan_nea_m, request.flown[0].control_nea_m[0])
    return Backtrack(
        plan_id=request.plan_id, subpaths=(back,), through=(False,), reaches_start=True
    )


def taken_over(of: Mission = AWAY) -> Craft:
    """Started in the air, 3.6 km from home."""
    craft = Craft(of, plan=back_as_flown)
    craft.armed, craft.mode, craft.landed, craft.here = True, Mode.GUIDED, Landed.IN_AIR, OUT_NEA_M
    return craft


def led_on(craft: Craft) -> Craft:
    """On its first leg, some kilometres on."""
    return craft.run_until(lambda craft: craft.state.reference.length_m > 2_000.0)


def told(craft: Craft) -> None:
    craft.order(OrderKind.RETURN)


def low(craft: Craft) -> None:
    craft.battery = 0.1


def no_way_on(craft: Craft) -> None:
    """To the target; home there is one."""
    there, plan = AWAY.targets_ne_m[0], craft.plan
    craft.plan = lambda r: not_planned(r) if r.target_ne_m == there else plan(r)


def is_home(craft: Craft) -> bool:
    """Landed there; or its autopilot flies there by itself."""
    return math.dist(craft.here[:2], craft.home_nea_m[:2]) < 100.0 and not craft.armed


def ways_asked(craft: Craft) -> set[tuple[float, float]]:
    """Where ways were asked for to, but for the way back."""
    requests = [plan.request for plan in craft.sent(events.Plan)]
    return {request.target_ne_m for request in requests if request.flown is None}


@pytest.mark.parametrize(
    ("why", "flown", "way"),
    [
        (told, True, "flying back, then home"),
        (low, True, "flying back, then home"),
        (no_way_on, True, "flying back, then home"),
        (told, False, "planning a way home"),
        (no_way_on, False, "planning a way home"),
    ],
)
def test_taken_over_in_flight_it_returns_home_and_not_to_where_it_was_taken_over(
    why: Callable[[Craft], None], flown: bool, way: str
) -> None:
    """With nothing flown yet, as after a restart without memory, from where it is."""
    craft = taken_over()
    if flown:
        led_on(craft)
    elif why is told:
        craft.run_until(lambda craft: craft.state.hold in (Hold.TAKE_OVER, Hold.REPLAN))
    why(craft)
    assert is_home(craft.fly_to(Phase.DONE))
    assert [text for text in warnings(craft.commands) if text.endswith(f": {way}")]


@pytest.mark.parametrize("autopilot", ALL, ids=lambda each: each.name)
def test_so_does_each_autopilot(autopilot: Autopilot) -> None:
    """One that has no mode to land is led home, and then left to its own return."""
    it = Wild.calmly(autopilot.traits, fallback=Fallback.RETURN).aloft(Mode.GUIDED)
    it.here = (-250.0, 200.0, it.here[2])
    it.run_until(lambda it: it.state.reference.length_m > 60.0)
    it.take(events.Order(time_s=it.now_s, kind=OrderKind.RETURN))
    it.fly_to(Phase.DONE)
    limits = it.mission.task.limits
    assert math.hypot(*it.here[:2]) < limits.tracking_error_m + 2.5 * limits.loiter_radius_m
    assert it.mode is Mode.RETURN or not it.armed
    assert (it.mode is Mode.RETURN) == (not autopilot.traits.lands)


def test_at_the_last_target_too_and_that_is_an_arrival() -> None:
    near = replace(AWAY, targets_ne_m=((8_000.0, -2_000.0),), end_action=EndAction.RETURN)
    craft = taken_over(near).fly_to(Phase.DONE)
    assert is_home(craft)
    assert craft.end().outcome is Outcome.ARRIVED


def test_from_where_nothing_leads_away_no_way_home_is_looked_for() -> None:
    """What is too near to the terrain does not stay there for as many attempts again."""
    craft = led_on(taken_over())
    craft.plan = lambda r: refused(r, Refusal.START_NEAR_TERRAIN)
    assert craft.fly_to(Phase.DONE).mode is Mode.RETURN
    assert ways_asked(craft) == set(AWAY.targets_ne_m)


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
    told(led_on(craft))
    assert craft.fly_to(Phase.DONE).mode is Mode.RETURN
    assert math.dist(craft.here[:2], OUT_NEA_M[:2]) < 1.0  # so far a way was proven
    said = texts(craft.commands[: craft.commands.index(SetMode(mode=Mode.RETURN))])
    assert [text for text in said if text.startswith(why)]
    assert "told to return: its autopilot is told to return" in said
    assert (0.0, 0.0) not in ways_asked(craft)


def test_what_an_autopilot_calls_home_after_a_reboot_in_the_air_is_not_flown_to() -> None:
    craft = flying(AWAY, plan=back_as_flown).run_for(20.0)
    craft.obey(craft.take(events.Rebooted(time_s=craft.now_s)))
    craft.home_nea_m = craft.here
    told(craft.fly_to(Phase.FLYING))
    assert math.dist(craft.fly_to(Phase.DONE).here[:2], (0.0, 0.0)) < 1.0


def test_told_to_return_on_its_planned_way_home_it_flies_on() -> None:
    craft = taken_over().run_until(lambda craft: craft.state.hold is Hold.TAKE_OVER)
    told(craft)
    craft.run_until(lambda craft: craft.state.flight.homeward and craft.velocity[0] != 0.0)
    told(craft)
    assert is_home(craft.fly_to(Phase.DONE))


# --- why there is no plan is said in the planner's own words, with its own remedy


def refused(request: PlanRequest, refusal: Refusal = Refusal.TARGET_IN_KEEP_OUT) -> NotPlanned:
    return NotPlanned(plan_id=request.plan_id, refusal=refusal)


IN_ZONE = Refusal.TARGET_IN_KEEP_OUT.value.partition("; ")[0]


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


def test_a_target_in_a_fence_is_said_to_be_in_it_while_the_leg_before_it_is_flown() -> None:
    craft = flying(AWAY)
    craft.plan = refused
    craft.run_until(lambda craft: any(IN_ZONE in text for text in warnings(craft.commands)))
    assert craft.phase is Phase.FLYING
    craft.fly_to(Phase.HOLDING)
    assert any(text.startswith("hold: ") and IN_ZONE in text for text in warnings(craft.commands))


def test_what_the_planner_said_of_an_old_target_explains_no_new_one_and_no_other_hold() -> None:
    blind = Craft(plan=refused).fly_to(Phase.HOLDING)
    craft = blind.copy()
    blind.fix = False
    blind.run_until(lambda craft: craft.state.reason is Reason.NO_FIX)
    assert IN_ZONE not in " ".join(warnings(blind.during(30.0)))
    craft.plan = planned
    craft.order(OrderKind.REPOSITION)
    assert craft.state.flight.refusal is None
    craft.fly_to(Phase.FLYING).plan = lambda r: refused(r, Refusal.NOTHING_SAFE)
    assert IN_ZONE not in " ".join(warnings(craft.during(60.0)))


def test_why_it_fell_back_does_not_explain_the_end_that_a_person_wants_then() -> None:
    craft = Craft(mission(fallback=Fallback.LAND), plan=refused).fly_to(Phase.LANDING)
    craft.obey(craft.take(events.StopAsked(time_s=craft.now_s)))
    assert (craft.end().reason, craft.end().remedy) == (Reason.STOPPED.text, Reason.STOPPED.remedy)


def test_what_a_mission_falls_back_on_by_itself_is_to_return() -> None:
    assert load_mission("environment-1").fallback is Fallback.RETURN
