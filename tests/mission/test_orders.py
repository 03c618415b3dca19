"""What a person has ordered, and was told is done, is done: no older plan or order undoes it."""

import math
import operator
from collections.abc import Callable

import pytest
from made_up import (
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
    two_legs_away,
)
from renewed import replace
from wild import Wild

from companion.mavlink.autopilots import ALL
from companion.mission import changes, events
from companion.mission.changes import OrderResult
from companion.mission.events import End, Mode, Order, OrderKind, Outcome, Plan, SetMode, Setpoint
from companion.mission.mission import Fallback, Mission
from companion.mission.state import Phase, Reason
from companion.mission.vehicle_traits import VehicleTraits
from companion.planner.request import Backtrack, PlanOutcome, PlanRequest

OTHER_NE_M = (2_000.0, 2_000.0)
DRIVINGS, NAME = [each.traits for each in ALL], operator.attrgetter("name")
EVERY_DRIVING = pytest.mark.parametrize("traits", DRIVINGS, ids=NAME)


def tell(craft: Craft, kind: OrderKind) -> OrderResult:
    """An order, as the session gives it: obeyed if it is accepted."""
    target_ne_m = OTHER_NE_M if kind is OrderKind.REPOSITION else None
    return give(craft, Order(time_s=craft.now_s, kind=kind, target_ne_m=target_ne_m))


def give(craft: Craft, order: Order) -> OrderResult:
    verdict = changes.order_result(craft.state, order)
    if verdict is OrderResult.ACCEPTED:
        craft.obey(craft.take(order))
    return verdict


def under_way(of: Mission | None = None) -> Craft:
    return flying(of or two_legs_away(), plan=home_or_on)


def no_answer(_request: PlanRequest) -> None:
    """A planner that is still busy."""


def asking_for_the_way_back() -> Craft:
    """Held, told to return: the planner has been asked, and has not answered."""
    craft = under_way()
    tell(craft, OrderKind.RETURN)
    craft.plan = no_answer
    return craft.run_until(lambda craft: craft.state.flight.planning_backtrack is not None)


HOLDING = Phase.HOLDING


def answer(craft: Craft) -> None:
    """The planner answers what it was asked last."""
    request = craft.sent(Plan)[-1].request
    craft.obey(craft.take(events.PlanReady(time_s=craft.now_s, outcome=home_or_on(request))))


def led_towards(craft: Craft, count: int) -> list[Setpoint]:
    """The setpoints since then that lead somewhere."""
    return [c for c in craft.commands[count:] if isinstance(c, Setpoint) and not c.stay]


# --- a return, and a pause in it


@pytest.mark.parametrize("pauses_s", [0.0, 1.0, 20.0])
@pytest.mark.parametrize("continues_s", [0.0, 2.0, 30.0])
def test_a_return_that_is_paused_is_a_return_again(pauses_s: float, continues_s: float) -> None:
    """While it brakes, while the way back is asked for, on the way back; and as soon as after."""
    craft = under_way()
    tell(craft, OrderKind.RETURN)
    craft.run_for(pauses_s)
    assert tell(craft, OrderKind.PAUSE) is OrderResult.ACCEPTED
    craft.run_for(continues_s)
    plans = len(craft.sent(Plan))
    assert tell(craft, OrderKind.CONTINUE) is OrderResult.ACCEPTED
    assert craft.fly_to(Phase.DONE).here[:2] == pytest.approx((0.0, 0.0), abs=1.0)
    assert all(plan.request.flown is not None for plan in craft.sent(Plan)[plans:])
    assert craft.end().reason == f"landed: {Reason.RETURN_ASKED.text}"


@pytest.mark.parametrize("found_in", [Mode.GUIDED, Mode.HOLD])
def test_a_companion_started_again_in_flight_knows_the_whole_way_back(found_in: Mode) -> None:
    craft = under_way().run_for(30.0)
    craft.restart()
    craft.mode = found_in
    craft.run_for(20.0)
    tell(craft, OrderKind.RETURN)
    craft.run_until(lambda craft: craft.state.flight.planning_backtrack is not None)
    flown = craft.sent(Plan)[-1].request.flown
    assert flown is not None
    away_m = math.hypot(*craft.here[:2])
    assert sum(each.until_m - each.from_m for each in flown) == pytest.approx(away_m, rel=0.01)


def test_a_pause_while_the_way_back_is_planned_waits_for_a_word() -> None:
    craft = asking_for_the_way_back()
    assert tell(craft, OrderKind.PAUSE) is OrderResult.ACCEPTED
    answer(craft)
    craft.plan = home_or_on
    count = len(craft.commands)
    craft.run_for(300.0)
    assert (craft.phase, craft.state.reason) == (HOLDING, Reason.PAUSED)
    assert not led_towards(craft, count)
    tell(craft, OrderKind.CONTINUE)
    craft.fly_to(Phase.RETURNING)


@pytest.mark.parametrize("again", [Craft.restart, Craft.reboot])
def test_a_pause_on_a_return_outlives_the_companion_and_the_autopilot(
    again: Callable[[Craft], Craft],
) -> None:
    craft = asking_for_the_way_back()
    tell(craft, OrderKind.PAUSE)
    craft.plan = home_or_on
    craft.run_for(5.0)
    again(craft)
    count = len(craft.commands)
    craft.run_for(60.0)
    assert (craft.phase, craft.state.reason) == (HOLDING, Reason.PAUSED)
    assert not led_towards(craft, count)
    tell(craft, OrderKind.CONTINUE)
    craft.fly_to(Phase.RETURNING)


def test_told_to_return_out_of_a_pause_on_the_way_back_it_returns() -> None:
    craft = under_way()
    tell(craft, OrderKind.RETURN)
    craft.fly_to(Phase.RETURNING).run_for(10.0)
    tell(craft, OrderKind.PAUSE)
    craft.fly_to(HOLDING).run_for(10.0)
    assert tell(craft, OrderKind.RETURN) is OrderResult.ACCEPTED
    craft.run_for(1.0)
    assert craft.phase is Phase.RETURNING


def on_its_way_back(traits: VehicleTraits) -> Wild:
    """Along what it flew: more than one stretch."""
    wild = Wild.calmly(traits, targets_ne_m=((400.0, 300.0), (-500.0, 200.0)))
    wild.run_until(lambda wild: wild.state.flight.target == 1).run_for(12.0)
    wild.take(Order(time_s=wild.now_s, kind=OrderKind.RETURN))
    wild.fly_to(Phase.RETURNING).run_for(3.0)
    assert len(ways_left(wild)) > 1
    return wild


@pytest.mark.sample(5)
@EVERY_DRIVING
@pytest.mark.parametrize("what", ["pause", "restart", "paused restart"])
def test_no_stretch_of_the_way_back_is_lost_in_a_pause_or_a_restart(
    traits: VehicleTraits, what: str
) -> None:
    """A plane circles at once, a copter brakes first."""
    wild = on_its_way_back(traits)
    left = ways_left(wild)
    if "pause" in what:
        wild.take(Order(time_s=wild.now_s, kind=OrderKind.PAUSE))
    if "restart" in what:
        wild._restart()
    wild.fly_to(Phase.HOLDING)
    assert ways_left(wild) == left
    if "pause" in what:
        wild.run_until(lambda wild: wild.state.reason is Reason.PAUSED)
        wild.take(Order(time_s=wild.now_s, kind=OrderKind.CONTINUE))
    wild.run_until(lambda wild: wild.state.phase not in (Phase.HOLDING, Phase.PREPARING))
    assert wild.state.phase is Phase.RETURNING or wild.state.flight.homeward


@pytest.mark.sample(3)
@pytest.mark.parametrize("traits", [each for each in DRIVINGS if each.hovers], ids=NAME)
@pytest.mark.parametrize("what", ["pause", "pause and at once on", "restart", "paused restart"])
def test_the_way_back_is_the_flown_one_after_a_pause_or_a_restart_on_it(
    traits: VehicleTraits, what: str
) -> None:
    """To its end, and never on to the targets."""
    wild = on_its_way_back(traits)
    plans = len(wild.sent(Plan))
    if "pause" in what:
        wild.take(Order(time_s=wild.now_s, kind=OrderKind.PAUSE))
        wild.run_for(1.0 if "on" in what else 40.0)
    if "restart" in what:
        wild._restart()
        wild.run_for(30.0)
    if "pause" in what:
        wild.take(Order(time_s=wild.now_s, kind=OrderKind.CONTINUE))
    wild.run_until(lambda wild: wild.over)
    assert len(wild.sent(Plan)) == plans
    assert wild.here == pytest.approx((0.0, 0.0, HOME_AMSL_M), abs=1.0)
    assert f"hold: {Reason.OFF_PATH.text}" not in [say.text for say in wild.sent(events.StatusText)]


def ways_left(wild: Wild) -> list[bytes]:
    """The stretches that are still to be flown."""
    flight = wild.state.flight
    legs = [leg for leg in (flight.leg, flight.next_leg, *flight.back) if leg is not None]
    return [leg.subpath.control_nea_m.tobytes() for leg in legs]


def test_a_return_for_want_of_plans_goes_on_after_a_pause() -> None:
    """All attempts are used up then, and that is no reason to give up the way back."""
    craft = under_way(replace(two_legs_away(), fallback=Fallback.RETURN))
    craft.plan = lambda request: (
        not_planned(request) if request.flown is None else home_or_on(request)
    )
    craft.fly_to(Phase.RETURNING).run_for(10.0)
    tell(craft, OrderKind.PAUSE)
    craft.run_for(1.0)
    tell(craft, OrderKind.CONTINUE)
    assert craft.fly_to(Phase.DONE).here[:2] == pytest.approx((0.0, 0.0), abs=1.0)


# --- a new target


def test_a_new_target_is_not_overruled_by_the_way_back_that_was_asked_for_before() -> None:
    craft = asking_for_the_way_back()
    assert tell(craft, OrderKind.REPOSITION) is OrderResult.ACCEPTED
    answer(craft)
    craft.plan = home_or_on
    assert craft.phase is HOLDING
    craft.fly_to(Phase.DONE)
    assert craft.here[:2] == pytest.approx(OTHER_NE_M, abs=1.0)
    assert Phase.RETURNING not in {after.phase for _, _, after, _ in craft.steps}


def test_a_pause_is_not_overruled_by_the_fallback_that_was_planned_before() -> None:
    craft = under_way(replace(two_legs_away(), fallback=Fallback.RETURN))
    craft.plan = lambda request: not_planned(request) if request.flown is None else None
    craft.run_until(lambda craft: craft.state.flight.fallen_back is Reason.NO_PLAN)
    assert tell(craft, OrderKind.PAUSE) is OrderResult.ACCEPTED
    answer(craft)
    craft.run_for(60.0)
    assert (craft.phase, craft.state.reason) == (HOLDING, Reason.PAUSED)
    craft.plan = home_or_on
    tell(craft, OrderKind.CONTINUE)
    assert craft.fly_to(Phase.DONE).end().outcome is Outcome.ARRIVED


# --- at the target


def is_home(request: PlanRequest) -> bool:
    """Whether it is asked for a way home."""
    return math.hypot(*request.target_ne_m) < 10.0


def no_way_back(request: PlanRequest) -> PlanOutcome:
    """A planner that proves nothing of the way back, and finds none home either."""
    if request.flown is None:
        return not_planned(request) if is_home(request) else planned(request)
    return Backtrack(plan_id=request.plan_id, subpaths=(), through=(), reaches_start=False)


def ended(craft: Craft) -> bool:
    return craft.phase in (Phase.DONE, Phase.FAULTED)


@pytest.mark.parametrize("traits", [each for each in DRIVINGS if each.hovers], ids=NAME)
def test_an_accepted_return_that_cannot_be_flown_is_left_to_the_autopilots_own(
    traits: VehicleTraits,
) -> None:
    craft = flying(two_legs_away(), plan=no_way_back, traits=traits)
    craft.run_for(20.0)
    assert tell(craft, OrderKind.RETURN) is OrderResult.ACCEPTED
    craft.run_until(ended)
    assert craft.sent(SetMode)[-1].mode is Mode.RETURN
    assert craft.mode is Mode.RETURN
    [end] = craft.sent(End)
    assert end.outcome is Outcome.STOPPED
    assert end.reason == "its autopilot returns by itself: told to return"


def test_so_is_one_that_finds_no_way_home_from_where_the_proven_one_ends() -> None:
    def half_way(request: PlanRequest) -> PlanOutcome:
        if request.flown is None:
            return not_planned(request) if is_home(request) else planned(request)
        north, east, up = request.scan_nea_m
        return Backtrack(
            plan_id=request.plan_id,
            subpaths=(straight((north, east, up), (0.5 * north, 0.5 * east, up)),),
            through=(False,),
            reaches_start=False,
        )

    craft = flying(two_legs_away(), plan=half_way)
    craft.run_for(20.0)
    tell(craft, OrderKind.RETURN)
    craft.run_until(ended)
    assert Phase.RETURNING in {after.phase for *_, after, _ in craft.steps}
    assert craft.mode is Mode.RETURN


def test_a_vehicle_that_is_not_where_it_believes_to_be_lands_and_is_not_sent_home() -> None:
    craft = flying(two_legs_away(), plan=no_way_back)
    tell(craft, OrderKind.RETURN)
    craft.run_until(lambda craft: craft.phase is HOLDING)
    craft.fix = False
    craft.run_until(ended)
    asked = [command.mode for command in craft.sent(SetMode)]
    assert Mode.LAND in asked
    assert Mode.RETURN not in asked


def test_told_to_return_twice_it_is_accepted_twice() -> None:
    craft = asking_for_the_way_back()
    assert tell(craft, OrderKind.RETURN) is OrderResult.ACCEPTED
    assert craft.state.reason is Reason.RETURN_ASKED
    answer(craft)
    assert craft.phase is Phase.RETURNING


def test_on_its_way_back_it_can_be_told_to_the_very_target_that_it_came_from() -> None:
    craft = under_way(replace(two_legs_away(), targets_ne_m=(OTHER_NE_M,)))
    craft.run_for(5.0)
    tell(craft, OrderKind.RETURN)
    craft.run_until(lambda craft: craft.phase is Phase.RETURNING)
    assert tell(craft, OrderKind.REPOSITION) is OrderResult.ACCEPTED
    assert not craft.state.flight.returning
    craft.run_until(lambda craft: craft.phase is Phase.ARRIVED)


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
    assert tell(craft, OrderKind.RETURN) is OrderResult.ACCEPTED
    craft.mode, craft.obeys_modes = Mode.HOLD, True
    craft.run_until(lambda craft: craft.phase in (Phase.RETURNING, Phase.DONE), 60.0)
    assert craft.phase is Phase.RETURNING
    reasons = {after.reason for _, _, after, _ in craft.steps}
    assert Reason.MODE_TAKEN not in reasons


def test_a_word_to_go_on_changes_nothing_where_nothing_was_paused() -> None:
    craft = holding_without_plan()
    before = craft.state
    assert tell(craft, OrderKind.CONTINUE) is OrderResult.ACCEPTED
    assert craft.state == replace(before, now_s=craft.state.now_s)


# --- what the companion itself has asked for


def test_its_own_hold_after_a_restart_is_not_taken_for_a_persons() -> None:
    """Asked for while the position was bad, and good again before the heartbeat tells of it."""
    craft = flying(two_legs_away())
    craft.restart()
    frozen = craft.velocity  # it says that it flies, and where it is does not change
    craft.run_until(lambda craft: craft.mode is Mode.HOLD)
    craft.velocity = (0.0, 0.0, 0.0)
    assert frozen != craft.velocity
    assert craft.fly_to(Phase.DONE).end().outcome is Outcome.ARRIVED


def lands(craft: Craft) -> bool:
    return craft.phase is Phase.LANDING


@pytest.mark.parametrize("traits", DRIVINGS, ids=NAME)
def test_told_to_land_it_stops_on_its_path_and_lands_there(traits: VehicleTraits) -> None:
    wild = on_its_way_back(traits)
    told = tell(wild, OrderKind.LAND)
    assert told is (OrderResult.ACCEPTED if traits.lands else OrderResult.INVALID)
    if not traits.lands:
        assert traits.name in changes.why_not(
            wild.state, Order(time_s=wild.now_s, kind=OrderKind.LAND)
        )


def test_it_has_stopped_before_it_lands_and_that_is_how_the_flight_ends() -> None:
    craft = under_way()
    craft.run_for(5.0)
    assert tell(craft, OrderKind.LAND) is OrderResult.ACCEPTED
    assert craft.phase is Phase.FLYING  # it brakes on the path
    craft.run_until(lands)
    assert craft.state.hold is None
    [setpoint] = craft.sent(Setpoint)[-1:]
    assert setpoint.velocity_nea_m_s == (0.0, 0.0, 0.0)
    craft.run_until(ended)
    [end] = craft.sent(End)
    assert (end.outcome, end.reason) == (Outcome.STOPPED, "landed: told to land")
    assert SetMode(mode=Mode.RETURN) not in craft.sent(SetMode)


@pytest.mark.parametrize("when", ["braking", "standing"])
def test_a_landing_that_is_paused_is_a_landing_again(when: str) -> None:
    craft = under_way()
    craft.run_for(5.0)
    tell(craft, OrderKind.LAND)
    craft.run_for(0.5)
    assert tell(craft, OrderKind.PAUSE) is OrderResult.ACCEPTED
    craft.run_for(0.5 if when == "braking" else 60.0)
    assert not lands(craft)
    craft.restart()
    craft.run_for(30.0)
    assert not lands(craft)
    tell(craft, OrderKind.CONTINUE)
    craft.run_until(lands)


@pytest.mark.parametrize("kind", [OrderKind.REPOSITION, OrderKind.RETURN])
def test_another_order_takes_the_place_of_a_landing(kind: OrderKind) -> None:
    craft = under_way()
    craft.run_for(5.0)
    tell(craft, OrderKind.LAND)
    craft.run_for(1.0)
    assert tell(craft, kind) is OrderResult.ACCEPTED
    craft.run_until(lambda craft: craft.phase in (Phase.RETURNING, Phase.ARRIVED, Phase.LANDING))
    wanted = Phase.RETURNING if kind is OrderKind.RETURN else Phase.ARRIVED
    assert craft.phase is wanted


def test_a_return_goes_on_that_was_told_to_land_and_then_to_return() -> None:
    craft = under_way()
    craft.run_for(5.0)
    tell(craft, OrderKind.RETURN)
    craft.run_until(lambda craft: craft.phase is Phase.RETURNING)
    craft.run_for(3.0)
    tell(craft, OrderKind.LAND)
    craft.run_for(1.0)
    assert tell(craft, OrderKind.RETURN) is OrderResult.ACCEPTED
    craft.run_for(1.0)
    craft.run_until(lambda craft: craft.phase is Phase.RETURNING)
    assert Phase.LANDING not in {after.phase for _, _, after, _ in craft.steps}


def test_without_a_position_it_lands_once_its_autopilot_has_stopped_it() -> None:
    craft = holding_without_fix()
    assert tell(craft, OrderKind.LAND) is OrderResult.ACCEPTED
    craft.run_until(lands, 60.0)


def test_a_landing_that_a_person_broke_off_is_a_landing_again_when_told_to_go_on() -> None:
    craft = under_way()
    craft.run_for(5.0)
    tell(craft, OrderKind.LAND)
    craft.run_until(lambda craft: lands(craft) and craft.state.obeyed)
    craft.mode = Mode.GUIDED
    craft.run_until(lambda craft: craft.phase is Phase.HOLDING)
    craft.run_for(20.0)
    assert craft.phase is Phase.HOLDING
    tell(craft, OrderKind.START)
    craft.run_until(lands)
