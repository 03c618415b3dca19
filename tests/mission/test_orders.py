"""What a person has ordered, and was told is done, is done: no older plan or order undoes it."""

import math
from collections.abc import Callable

import pytest
from made_up import (
    COPTERS,
    EACH,
    HOME_AMSL_M,
    MISSION,
    Craft,
    arrived,
    flying,
    holding_without_fix,
    holding_without_plan,
    home_or_on,
    not_planned,
    planned,
    straight,
    texts,
    two_legs_away,
)
from renewed import replace
from wild import Wild

from companion.mission import changes, events
from companion.mission.changes import OrderResult
from companion.mission.events import Mode, Order, OrderKind, Outcome, Plan, SetMode, Setpoint
from companion.mission.mission import Fallback, Mission
from companion.mission.state import Phase, Reason
from companion.mission.vehicle_traits import VehicleTraits
from companion.planner.request import Backtrack, PlanOutcome, PlanRequest

OTHER_NE_M = (2_000.0, 2_000.0)
FALLS_BACK = replace(two_legs_away(), fallback=Fallback.RETURN)
PAUSE, CONTINUE, RETURN = OrderKind.PAUSE, OrderKind.CONTINUE, OrderKind.RETURN
LAND, REPOSITION = OrderKind.LAND, OrderKind.REPOSITION
HOLDING, RETURNING, LANDING = Phase.HOLDING, Phase.RETURNING, Phase.LANDING


def tell(craft: Craft | Wild, kind: OrderKind) -> OrderResult:
    """An order, as the session gives it: obeyed if it is accepted."""
    target_ne_m = OTHER_NE_M if kind is REPOSITION else None
    order = Order(time_s=craft.now_s, kind=kind, target_ne_m=target_ne_m)
    verdict = changes.order_result(craft.state, order)
    if verdict is not OrderResult.ACCEPTED:
        return verdict
    if isinstance(craft, Wild):
        craft.take(order)
    else:
        craft.obey(craft.take(order))
    return verdict


def told(craft: Craft, *script: OrderKind | Phase | float) -> Craft:
    """Orders, each accepted, and how long it then flies on, or until which phase."""
    for step in script:
        if isinstance(step, OrderKind):
            assert tell(craft, step) is OrderResult.ACCEPTED, step
        elif isinstance(step, Phase):
            craft.fly_to(step)
        else:
            craft.run_for(step)
    return craft


def under_way(of: Mission | None = None) -> Craft:
    return flying(of or two_legs_away(), plan=home_or_on)


def asking_for_the_way_back() -> Craft:
    """Held, told to return: the planner has been asked, and has not answered."""
    craft = told(under_way(), RETURN)
    craft.plan = lambda _: None
    return craft.run_until(lambda craft: getattr(craft.state.stage, "backtrack", None))


def answer(craft: Craft) -> Craft:
    """The planner answers what it was asked last."""
    request = craft.sent(Plan)[-1].request
    craft.obey(craft.take(events.PlanReady(time_s=craft.now_s, outcome=home_or_on(request))))
    return craft


# --- one order after another


@pytest.mark.parametrize(
    ("script", "ends", "never"),
    [
        ((RETURN, RETURNING, 10.0, PAUSE, HOLDING, 10.0, RETURN, 1.0), RETURNING, Phase.FLYING),
        ((5.0, RETURN, RETURNING, 3.0, LAND, 1.0, RETURN, 1.0), RETURNING, LANDING),
        ((5.0, LAND, 1.0, RETURN), RETURNING, LANDING),
        ((5.0, LAND, 1.0, REPOSITION), Phase.ARRIVED, LANDING),
        ((5.0, RETURN, RETURNING, REPOSITION), Phase.ARRIVED, LANDING),
        ((5.0, LAND, 0.5, PAUSE, 0.5, CONTINUE), LANDING, RETURNING),
        ((5.0, LAND, 0.5, PAUSE, 60.0, CONTINUE), LANDING, RETURNING),
    ],
    ids=lambda value: value.value if isinstance(value, Phase) else None,
)
def test_the_last_order_counts_and_a_pause_gives_back_what_it_broke_off(
    script: tuple[OrderKind | Phase | float, ...], ends: Phase, never: Phase
) -> None:
    """Also the very target that it came from, and another order after a landing."""
    craft = told(under_way(replace(two_legs_away(), targets_ne_m=(OTHER_NE_M,))), *script)
    count = len(craft.steps)
    craft.run_until(lambda craft: craft.phase is ends, 120.0)
    assert never not in {after.phase for *_, after, _ in craft.steps[count:]}
    assert craft.state.flight.returning is (ends is RETURNING)


@pytest.mark.parametrize("pauses_s", [0.0, 1.0, 20.0])
@pytest.mark.parametrize("continues_s", [0.0, 2.0, 30.0])
def test_a_return_that_is_paused_is_a_return_again(pauses_s: float, continues_s: float) -> None:
    """While it brakes, while the way back is asked for, on the way back; and as soon as after."""
    craft = told(under_way(), RETURN, pauses_s, PAUSE, continues_s)
    plans = len(craft.sent(Plan))
    told(craft, CONTINUE, Phase.DONE)
    assert craft.here[:2] == pytest.approx((0.0, 0.0), abs=1.0)
    assert all(plan.request.flown is not None for plan in craft.sent(Plan)[plans:])
    assert craft.end().reason == f"landed: {Reason.RETURN_ASKED.text}"


@pytest.mark.parametrize("again", [answer, Craft.restart, Craft.reboot])
def test_a_pause_on_a_return_outlives_an_old_plan_the_companion_and_the_autopilot(
    again: Callable[[Craft], Craft],
) -> None:
    craft = told(asking_for_the_way_back(), PAUSE)
    craft.plan = home_or_on
    later = again(craft.run_for(5.0)).during(300.0)
    assert (craft.phase, craft.state.reason) == (HOLDING, Reason.PAUSED)
    assert not [c for c in later if isinstance(c, Setpoint) and not c.stay]
    told(craft, CONTINUE, RETURNING)


@pytest.mark.parametrize("pauses", [True, False])
def test_a_landing_that_was_broken_off_is_a_landing_again_when_told_to_go_on(pauses: bool) -> None:
    """By a pause, and a companion that was started again in it; by who selects guided mode."""
    craft = told(under_way(), 5.0, LAND, 0.5)
    if pauses:
        told(craft, PAUSE, 60.0).restart()
    else:
        craft.run_until(lambda craft: craft.phase is LANDING and craft.state.stage.obeyed)
        craft.mode = Mode.GUIDED
        craft.fly_to(HOLDING)
    assert craft.run_for(30.0).phase is HOLDING
    told(craft, CONTINUE if pauses else OrderKind.START, LANDING)


def test_told_to_return_twice_it_is_accepted_twice() -> None:
    craft = told(asking_for_the_way_back(), RETURN)
    assert craft.state.reason is Reason.RETURN_ASKED
    assert answer(craft).phase is RETURNING


@pytest.mark.parametrize("found_in", [Mode.GUIDED, Mode.HOLD])
def test_a_companion_started_again_in_flight_knows_the_whole_way_back(found_in: Mode) -> None:
    craft = under_way().run_for(30.0).restart()
    craft.mode = found_in
    told(craft, 20.0, RETURN)
    craft.run_until(lambda craft: getattr(craft.state.stage, "backtrack", None))
    flown = craft.sent(Plan)[-1].request.flown
    assert flown is not None
    away_m = math.hypot(*craft.here[:2])
    assert sum(each.until_m - each.from_m for each in flown) == pytest.approx(away_m, rel=0.01)


def on_its_way_back(traits: VehicleTraits) -> Wild:
    """Along what it flew: more than one stretch."""
    wild = Wild.calmly(traits, targets_ne_m=((400.0, 300.0), (-500.0, 200.0)))
    wild.run_until(lambda wild: wild.state.flight.target == 1).run_for(12.0)
    tell(wild, RETURN)
    wild.fly_to(RETURNING).run_for(3.0)
    assert len(ways_left(wild)) > 1
    return wild


def ways_left(wild: Wild) -> list[bytes]:
    """The stretches that are still to be flown."""
    path, back = wild.state.path, wild.state.flight.back
    legs = back if path is None else (path.leg, path.next_leg, *back)
    return [leg.subpath.control_nea_m.tobytes() for leg in legs if leg is not None]


@pytest.mark.sample(3)
@EACH
@pytest.mark.parametrize("what", ["pause", "pause and at once on", "restart", "paused restart"])
def test_no_stretch_of_the_way_back_is_lost_in_a_pause_or_a_restart(
    traits: VehicleTraits, what: str
) -> None:
    """A plane circles at once; a copter brakes first, and flies it to its end, never on."""
    wild = on_its_way_back(traits)
    left, plans = ways_left(wild), len(wild.sent(Plan))
    if "pause" in what:
        tell(wild, PAUSE)
    if "restart" in what:
        wild._restart()
    if "at once" in what:
        wild.run_for(1.0)
    else:
        wild.fly_to(HOLDING)
        assert ways_left(wild) == left
        wild.run_until(lambda wild: "pause" not in what or wild.state.reason is Reason.PAUSED)
        wild.run_for(40.0 if "pause" in what else 0.0)
    if "pause" in what:
        tell(wild, CONTINUE)
    wild.run_until(lambda wild: wild.state.phase not in (HOLDING, Phase.PREPARING))
    assert wild.state.phase is RETURNING or wild.state.flight.homeward
    if traits.hovers:
        wild.run_until(lambda wild: wild.over)
        assert len(wild.sent(Plan)) == plans
        assert wild.here == pytest.approx((0.0, 0.0, HOME_AMSL_M), abs=1.0)
        assert f"hold: {Reason.OFF_PATH.text}" not in texts(wild.said_to)


def test_a_return_for_want_of_plans_goes_on_after_a_pause() -> None:
    """All attempts are used up then, and that is no reason to give up the way back."""
    craft = under_way(FALLS_BACK)
    craft.plan = lambda request: (
        not_planned(request) if request.flown is None else home_or_on(request)
    )
    told(craft, RETURNING, 10.0, PAUSE, 1.0, CONTINUE, Phase.DONE)
    assert craft.here[:2] == pytest.approx((0.0, 0.0), abs=1.0)


# --- an order, and what was planned before it


def test_a_new_target_is_not_overruled_by_the_way_back_that_was_asked_for_before() -> None:
    craft = answer(told(asking_for_the_way_back(), REPOSITION))
    craft.plan = home_or_on
    assert craft.phase is HOLDING
    craft.fly_to(Phase.DONE)
    assert craft.here[:2] == pytest.approx(OTHER_NE_M, abs=1.0)
    assert RETURNING not in craft.phases


def test_a_pause_is_not_overruled_by_the_fallback_that_was_planned_before() -> None:
    craft = under_way(FALLS_BACK)
    craft.plan = lambda request: not_planned(request) if request.flown is None else None
    craft.run_until(lambda craft: craft.state.flight.fallen_back is Reason.NO_PLAN)
    answer(told(craft, PAUSE)).run_for(60.0)
    assert (craft.phase, craft.state.reason) == (HOLDING, Reason.PAUSED)
    craft.plan = home_or_on
    assert told(craft, CONTINUE, Phase.DONE).end().outcome is Outcome.ARRIVED


# --- a return that cannot be flown


def proven(share: float) -> Callable[[PlanRequest], PlanOutcome]:
    """A planner that proves so much of the way back, and finds no way home from there."""

    def plan(request: PlanRequest) -> PlanOutcome:
        if request.flown is None:
            is_home = math.hypot(*request.target_ne_m) < 10.0
            return not_planned(request) if is_home else planned(request)
        north, east, up = request.scan_nea_m
        back = straight((north, east, up), ((1.0 - share) * north, (1.0 - share) * east, up))
        return Backtrack(
            plan_id=request.plan_id,
            subpaths=(back,) if share else (),
            through=(False,) if share else (),
            reaches_start=False,
        )

    return plan


@COPTERS
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_an_accepted_return_that_cannot_be_flown_is_left_to_the_autopilots_own(
    traits: VehicleTraits, share: float
) -> None:
    craft = flying(two_legs_away(), plan=proven(share), traits=traits)
    told(craft, 20.0, RETURN).run_until(lambda craft: craft.over)
    assert (RETURNING in craft.phases) is (share > 0.0)
    assert craft.mode is craft.sent(SetMode)[-1].mode is Mode.RETURN
    assert craft.end().outcome is Outcome.STOPPED
    assert craft.end().reason == "its autopilot returns by itself: told to return"


def test_a_vehicle_that_is_not_where_it_believes_to_be_lands_and_is_not_sent_home() -> None:
    craft = told(flying(two_legs_away(), plan=proven(0.0)), RETURN, HOLDING)
    craft.fix = False
    craft.run_until(lambda craft: craft.over)
    asked = [command.mode for command in craft.sent(SetMode)]
    assert Mode.LAND in asked
    assert Mode.RETURN not in asked


def test_what_is_over_and_what_only_watches_obeys_no_order() -> None:
    over, shadow = under_way(), Craft(shadow=True)
    over.take(events.StopAsked(time_s=over.now_s))
    shadow.run_until(lambda craft: craft.phase is Phase.SHADOW)
    for craft in (over, shadow):
        assert {tell(craft, kind) for kind in OrderKind} == {OrderResult.NOT_NOW}


@pytest.mark.parametrize("obeys", [True, False])
def test_told_to_return_after_its_hold_was_asked_for_it_returns(obeys: bool) -> None:
    """Its own hold may show in the next heartbeat: nobody has taken the vehicle."""
    craft = arrived(replace(MISSION, targets_ne_m=((5_000.0, 5_000.0),)))
    craft.plan = home_or_on
    craft.obeys_modes = obeys
    craft.run_until(lambda craft: any(c.mode is Mode.HOLD for c in craft.sent(SetMode)))
    assert craft.phase is Phase.ARRIVED
    told(craft, RETURN)
    craft.mode, craft.obeys_modes = Mode.HOLD, True
    craft.run_until(lambda craft: craft.phase in (RETURNING, Phase.DONE), 60.0)
    assert craft.phase is RETURNING
    assert Reason.MODE_TAKEN not in {after.reason for _, _, after, _ in craft.steps}


def test_a_word_to_go_on_changes_nothing_where_nothing_was_paused() -> None:
    craft = holding_without_plan()
    before = craft.state
    told(craft, CONTINUE)
    assert craft.state == replace(before, now_s=craft.state.now_s)


def test_its_own_hold_after_a_restart_is_not_taken_for_a_persons() -> None:
    """Asked for while the position was bad, and good again before the heartbeat tells of it."""
    craft = flying(two_legs_away()).restart()
    frozen = craft.velocity  # it says that it flies, and where it is does not change
    craft.run_until(lambda craft: craft.mode is Mode.HOLD)
    craft.velocity = (0.0, 0.0, 0.0)
    assert frozen != craft.velocity
    assert craft.fly_to(Phase.DONE).end().outcome is Outcome.ARRIVED


# --- a landing


@EACH
def test_only_who_can_land_is_told_to_and_the_others_say_why(traits: VehicleTraits) -> None:
    wild = on_its_way_back(traits)
    order = Order(time_s=wild.now_s, kind=LAND)
    if traits.lands:
        assert tell(wild, LAND) is OrderResult.ACCEPTED
    else:
        assert tell(wild, LAND) is OrderResult.INVALID
        assert traits.name in changes.why_not(wild.state, order)


def test_it_has_stopped_before_it_lands_and_that_is_how_the_flight_ends() -> None:
    craft = told(under_way(), 5.0, LAND)
    assert craft.phase is Phase.FLYING  # it brakes on the path
    craft.fly_to(LANDING)
    assert craft.state.hold is None
    assert craft.sent(Setpoint)[-1].velocity_nea_m_s == (0.0, 0.0, 0.0)
    end = craft.run_until(lambda craft: craft.over).end()
    assert (end.outcome, end.reason) == (Outcome.STOPPED, "landed: told to land")
    assert SetMode(mode=Mode.RETURN) not in craft.sent(SetMode)


def test_without_a_position_it_lands_once_its_autopilot_has_stopped_it() -> None:
    told(holding_without_fix(), LAND).run_until(lambda craft: craft.phase is LANDING, 60.0)
