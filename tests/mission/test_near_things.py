"""What the mission does when its sensor of near things, or of the ground, sees something or not."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from made_up import AWAY, SPEED_M_S, Craft, flying, home_or_on, texts
from renewed import deep, replace
from watch import off_m

from companion.mission import following
from companion.mission.decisions import Turn
from companion.mission.events import Event, GroundSeen, NearSeen, Setpoint
from companion.mission.mission import Fallback
from companion.mission.phases import Phase, Reason
from companion.planner.procedure import Reference
from companion.planner.request import NotPlanned, PlanOutcome, PlanRequest, Refusal
from companion.world.known_map import Lattice
from companion.world.near_map import NearMap, NearSensor, Sight

SENSOR = NearSensor(kind="obstacle_distance", component_id=196, range_m=20_000.0)
MISSION = replace(AWAY, near=SENSOR, rangefinder_error_m=2.0, fallback=Fallback.RETURN)
LIMITS, SETTINGS = MISSION.task.limits, MISSION.task.settings
CELL_M = 100.0
PLACE = Lattice(cell_m=CELL_M, north_min_m=-1000.0, east_min_m=-1000.0, shape=(300, 300))
Sees = Callable[[Craft], Event]


def seen(craft: Craft, sight: Sight = Sight.SEES, *things_ne_m: tuple[float, float]) -> NearSeen:
    near = NearMap(PLACE)
    for north, east in things_ne_m:
        cell = round(north / CELL_M) + 10, round(east / CELL_M) + 10
        near.met_since_s[cell] = near.met_s[cell] = 1.0
    return NearSeen(time_s=craft.now_s, sight=sight, near=near)


def dead(craft: Craft) -> Event:
    return seen(craft, Sight.DEAD)


def ground(craft: Craft, above_m: float = 5.0) -> Event:
    """So much higher than the map says."""
    return GroundSeen(time_s=craft.now_s, above_m=above_m)


WRONG: dict[str, tuple[Sees, Sees, Reason]] = {
    "dead": (dead, seen, Reason.SENSOR_SILENT),
    "never heard": (lambda it: seen(it, Sight.NEVER_HEARD), seen, Reason.SENSOR_SILENT),
    "nearer": (ground, lambda it: ground(it, 0.0), Reason.GROUND_NEARER),
}
"""What is wrong, that it is over, and what is said of it."""


def on_path(craft: Craft, ahead_m: float) -> tuple[float, float]:
    """A place so far ahead of it."""
    path = craft.state.path
    north, east, _ = path.leg.subpath.pose(path.reference.length_m + ahead_m).point_nea_m
    return north, east


def said(craft: Craft, words: str) -> int:
    """How often."""
    return sum(text.startswith(words) for text in texts(craft.commands))


@pytest.mark.parametrize(("wrong", "well", "reason"), WRONG.values(), ids=[*WRONG])
def test_what_is_not_seen_or_nearer_stops_it_on_its_path_until_that_is_over(
    wrong: Sees, well: Sees, reason: Reason
) -> None:
    craft = flying(MISSION)
    leg, reference = craft.state.leg, craft.state.reference
    craft.take(well(craft))
    assert craft.state.path.stop is None
    craft.take(*3 * [wrong(craft)])
    assert said(craft, reason.text) == 1
    before = len(craft.sent(Setpoint))
    assert craft.fly_to(Phase.HOLDING).state.reason is reason
    brakes_m = 0.5 * reference.speed_m_s**2 / LIMITS.acceleration_m_s2
    stop = leg.subpath.pose(reference.length_m + brakes_m).point_nea_m
    assert np.linalg.norm(np.subtract(craft.here, stop)) < 15.0 + 0.01 * brakes_m
    places = [setpoint.position_nea_m for setpoint in craft.sent(Setpoint)[before:]]
    assert len(places) > 20
    assert max(off_m(leg.subpath, place) for place in places) < 0.1  # on its path
    assert craft.run_for(5.0).phase is Phase.HOLDING
    craft.take(well(craft))
    craft.fly_to(Phase.FLYING).fly_to(Phase.ARRIVED)


@pytest.mark.parametrize(("wrong", "after_s"), [(dead, (30.0, 300.0)), (ground, (50.0, 80.0))])
def test_what_stays_wrong_is_waited_for_a_while_and_then_it_flies_back(
    wrong: Sees, after_s: tuple[float, float]
) -> None:
    """And that stops no way back: what was flown before is flown again."""
    craft = flying(MISSION, plan=home_or_on)
    craft.answered = int(wrong is ground)
    craft.take(wrong(craft))
    since_s = craft.fly_to(Phase.HOLDING).now_s
    craft.run_until(lambda craft: craft.phase is Phase.RETURNING, limit_s=300.0)
    assert after_s[0] < craft.now_s - since_s < after_s[1]
    craft.take(wrong(craft))
    assert craft.state.path.stop is None
    craft.fly_to(Phase.LANDING)
    assert np.hypot(*craft.here[:2]) < 100.0


def test_something_in_its_way_stops_it_at_once_and_what_is_beside_behind_or_gone_stops_nobody() -> (
    None
):
    """Also if it stops for want of sight already: it is planned anew from there, and told once."""
    craft = flying(MISSION).run_for(10.0)
    north, east = on_path(craft, 6000.0)
    aside_m = SETTINGS.safety_distance_m + LIMITS.tracking_error_m + 2.0 * CELL_M
    behind = on_path(craft, -craft.state.reference.length_m)
    assert np.hypot(*np.subtract(on_path(craft, 0.0), behind)) > aside_m
    craft.take(seen(craft, Sight.SEES, (north - aside_m, east + aside_m), behind))
    craft.take(seen(craft, Sight.NOTHING_THERE))
    assert craft.state.path.stop is None
    craft.take(dead(craft))
    meets = seen(craft, Sight.SEES, (north, east))
    craft.take(meets)
    stop = craft.state.path.stop
    assert stop.reason is Reason.NEW_THREAT
    craft.take(meets)
    assert craft.state.path.stop is stop
    assert said(craft, Reason.SENSOR_SILENT.text) == 1
    assert craft.fly_to(Phase.HOLDING).state.reason is Reason.NEW_THREAT


def test_a_sensor_that_comes_to_see_less_in_flight_is_told_of_once() -> None:
    craft = flying(MISSION)
    for sees_m in (10_000.0, 20_000.0, 10_000.0):
        craft.take(replace(seen(craft), sees_m=sees_m))
    assert said(craft, "sensor sees 10000 m of R = 20000 m") == 1


def test_where_it_is_better_to_turn_back_it_stops_on_its_leg_and_plans_from_there() -> None:
    """Once, and that counts as a stop."""

    def turns(request: PlanRequest) -> PlanOutcome:
        if request.plan_id == 2:
            return NotPlanned(plan_id=2, refusal=Refusal.BETTER_TO_TURN)
        return home_or_on(request)

    craft = flying(MISSION, plan=turns)
    leg = craft.state.leg
    craft.run_until(lambda craft: craft.state.path.stop is not None)
    stop = craft.state.path.stop
    assert stop.reason is Reason.NO_PLAN
    assert stop.at_m < leg.subpath.length_m - 100.0
    craft.fly_to(Phase.HOLDING)
    assert math.dist(craft.here, leg.subpath.pose(stop.at_m).point_nea_m) < 15.0
    assert (craft.state.reason, craft.state.flight.stops) == (Reason.NO_PLAN, 1)
    craft.fly_to(Phase.FLYING).fly_to(Phase.ARRIVED)


def test_where_its_leg_is_left_is_known_after_a_restart() -> None:
    """Also if that is earlier than it would be without asking so soon."""
    craft = flying(MISSION)
    path = craft.state.path
    asked = Reference(length_m=0.4 * path.leg.successor_at_m, speed_m_s=0.6 * SPEED_M_S)
    path.leg = replace(path.leg, p_prog=asked)
    leg = craft.restart().state.leg
    assert (leg.p_prog, leg.successor_at_m) == (asked, asked.length_m)


def test_a_copter_behind_its_reference_stops_as_far_from_where_it_is_itself() -> None:
    """An old position is where it was: it has flown on since."""
    craft = flying(MISSION)
    path, vehicle = craft.state.path, craft.state.vehicle
    at_m = 0.6 * path.reference.length_m
    place = path.leg.subpath.pose(at_m).point_nea_m
    for age_s in (0.0, 1.0):
        at_s, behind = craft.state.now_s + age_s, replace(vehicle, position_nea_m=place)
        stopped = deep(replace(craft.state, now_s=at_s, vehicle=behind))
        following.stop(stopped, Reason.NEW_THREAT, Turn(stopped, craft.context))
        flown_m = at_m + age_s * np.linalg.norm(vehicle.velocity_nea_m_s)
        brakes_m = path.reference.speed_m_s**2 / (2.0 * LIMITS.acceleration_m_s2)
        stops_at_m = max(flown_m + brakes_m, path.reference.length_m)
        assert stopped.path.stop.at_m == pytest.approx(stops_at_m, rel=1e-3)
