"""A fence that is changed in flight is kept to from then on; while it is read: `test_stories`."""

import json
import math

import pytest
from made_up import EACH, MISSION, Craft, flying
from renewed import deep, replace
from wild import Wild

from companion.mission import checkpoint, events
from companion.mission.events import FenceChanged, FenceReading, OrderKind, Plan, Setpoint
from companion.mission.phases import Phase, Reason
from companion.mission.state import Way
from companion.mission.vehicle_traits import VehicleTraits
from companion.world.zones import CircleZone

AHEAD_M = 10_000.0 * math.sqrt(0.5)
"""To the north and the east: on the first leg."""


def fence(craft: Craft, north_m: float, east_m: float, radius_m: float) -> FenceChanged:
    zone = CircleZone(name="drawn", north_m=north_m, east_m=east_m, radius_m=radius_m)
    return FenceChanged(time_s=craft.now_s, zones=(zone,))


def test_a_fence_that_does_not_touch_the_path_changes_the_next_plan_only() -> None:
    craft = flying()
    before = craft.state.flight
    commands = craft.take(fence(craft, 4_000.0, -4_000.0, 500.0))
    assert craft.state.flight == before
    assert [type(command) for command in commands] == [events.StatusText]
    craft.run_until(lambda craft: len(craft.sent(Plan)) == 2)
    assert "drawn" in {zone.name for zone in craft.sent(Plan)[-1].request.task.zones}


@pytest.mark.parametrize("is_ahead", [True, False])
def test_a_fence_across_the_path_or_around_it_stops_the_vehicle_and_plans_anew(
    is_ahead: bool,
) -> None:
    """Clear of the one ahead, and out of the one around it."""
    craft = flying()
    place, radius_m = ((AHEAD_M, AHEAD_M), 500.0) if is_ahead else (craft.here[:2], 200.0)
    craft.obey(craft.take(fence(craft, *place, radius_m)))
    assert craft.fly_to(Phase.HOLDING).state.reason is Reason.NEW_THREAT
    clear_m = radius_m + MISSION.task.zone_clearance_m
    assert not is_ahead or math.dist(craft.here[:2], place) > clear_m
    craft.run_until(lambda craft: len(craft.sent(Plan)) == 2)
    assert craft.sent(Plan)[-1].request.from_rest


def test_a_fence_on_the_way_back_of_a_vehicle_that_is_paused_leaves_it_led() -> None:
    """In guided mode silence is a lost stream, whatever has become of the way back."""
    craft = flying()
    leg = craft.state.leg
    craft.order(OrderKind.PAUSE).fly_to(Phase.HOLDING)
    flight = craft.state.flight
    assert flight.hover_nea_m is not None
    craft.state = replace(craft.state, flight=replace(flight, way=Way.BACK, back=(leg,)))
    craft.take(fence(craft, AHEAD_M, AHEAD_M, 500.0))
    assert craft.state.flight.hover_nea_m == flight.hover_nea_m
    assert any(isinstance(command, Setpoint) for command in craft.during(2.0))
    assert craft.state.reason is Reason.PAUSED


def on_its_way_out() -> tuple[Craft, FenceChanged]:
    """On a leg that was proven with a zone around its start, and leads out of that."""
    craft = flying()
    around = fence(craft, *craft.here[:2], 200.0)
    state = deep(craft.state)
    state.take_fence(craft.context.mission.task, around)
    leg = replace(state.leg, rules=state.task)
    craft.state = replace(state, path=replace(state.path, leg=leg))
    return craft, around


def test_the_same_fence_told_again_is_no_other_and_stops_nobody() -> None:
    craft, around = on_its_way_out()
    before = craft.state
    craft.take(replace(around, time_s=craft.now_s + 1.0))
    assert craft.state.task is before.task
    assert (craft.state.stage, craft.state.flight) == (before.stage, before.flight)
    craft.take(FenceChanged(time_s=craft.now_s, zones=(*around.zones, *around.zones)))
    assert craft.state.path.stop is None


def test_what_a_path_was_proven_under_outlives_the_companion_and_no_other_mission() -> None:
    craft, _ = on_its_way_out()
    values = json.loads(json.dumps(checkpoint.values_of(craft.state)))
    known, stricter = craft.state.flight.known, replace(MISSION.task.limits, dead_man_s=9.0)
    again = checkpoint.restored(MISSION, known, values)
    assert again.leg.rules == again.task == craft.state.task
    other = replace(MISSION, task=replace(MISSION.task, limits=stricter))
    assert checkpoint.restored(other, known, values).leg.rules == other.task.unruled()


def test_the_ceiling_of_the_fence_lowers_the_band() -> None:
    craft = flying()
    craft.take(FenceChanged(time_s=craft.now_s, zones=(), ceiling_amsl_m=4_000.0))
    assert craft.state.task.limits.ceiling_amsl_m == 4_000.0
    craft.take(FenceChanged(time_s=craft.now_s, zones=()))
    assert craft.state.task.limits == MISSION.task.limits


@EACH
def test_copters_hold_and_planes_circle_while_it_is_read(traits: VehicleTraits) -> None:
    it = Wild.calmly(traits).run_until(lambda it: it.state.leg is not None)
    it.run_for(2.0)
    it.take(FenceReading(time_s=it.now_s, items=400))
    it.run_for(60.0)
    assert (it.state.phase, it.state.reason) == (Phase.HOLDING, Reason.FENCE_UNREAD)
    it.take(FenceReading(time_s=it.now_s, items=0))
    assert it.fly_to(Phase.DONE).sent(events.End)[0].outcome is events.Outcome.ARRIVED
