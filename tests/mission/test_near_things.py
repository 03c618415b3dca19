"""What the mission does when its sensor of near things, or of the ground, sees something or not."""

from collections.abc import Callable

import numpy as np
import pytest
from made_up import Craft, flying, home_or_on, mission, texts, two_legs_away
from renewed import deep, replace

from companion.mission import following
from companion.mission.decisions import Turn
from companion.mission.events import Event, GroundSeen, NearSeen, Setpoint
from companion.mission.mission import Fallback
from companion.mission.state import Phase, Reason
from companion.planner.procedure import Reference
from companion.world.known_map import Lattice
from companion.world.near_map import NearMap, NearSensor, Sight

SENSOR = NearSensor(kind="obstacle_distance", component_id=196, range_m=20_000.0)
MISSION = two_legs_away(mission(near=SENSOR, rangefinder_error_m=2.0, fallback=Fallback.RETURN))
CELL_M = 100.0
PLACE = Lattice(cell_m=CELL_M, north_min_m=-1000.0, east_min_m=-1000.0, shape=(300, 300))


def near(*things_ne_m: tuple[float, float]) -> NearMap:
    result = NearMap(PLACE)
    for north, east in things_ne_m:
        cell = round(north / CELL_M) + 10, round(east / CELL_M) + 10
        result.met_since_s[cell] = result.met_s[cell] = 1.0
    return result


def seen(craft: Craft, sight: Sight = Sight.SEES, *things_ne_m: tuple[float, float]) -> NearSeen:
    return NearSeen(time_s=craft.now_s, sight=sight, near=near(*things_ne_m))


def ground(craft: Craft, above_m: float = 5.0) -> GroundSeen:
    """So much higher than the map says."""
    return GroundSeen(time_s=craft.now_s, above_m=above_m)


def told(craft: Craft, reason: Reason) -> int:
    return sum(text.startswith(reason.text) for text in texts(craft.commands))


def ahead(craft: Craft, by_m: float) -> tuple[float, float]:
    """A place on the path."""
    path = craft.state.path
    north, east, _ = path.leg.subpath.pose(path.reference.length_m + by_m).point_nea_m
    return north, east


@pytest.mark.parametrize("sight", [Sight.DEAD, Sight.NEVER_HEARD])
def test_a_sensor_that_falls_silent_stops_it_on_its_path_until_it_sees_again(sight: Sight) -> None:
    craft = flying(MISSION)
    leg, at_m = craft.state.leg, craft.state.reference.length_m
    assert leg is not None
    speed_m_s = craft.state.reference.speed_m_s
    brakes_m = 0.5 * speed_m_s**2 / MISSION.task.limits.acceleration_m_s2
    for _ in range(3):
        craft.take(seen(craft, sight))
    assert told(craft, Reason.SENSOR_SILENT) == 1
    before = len(craft.sent(Setpoint))
    craft.fly_to(Phase.HOLDING)
    assert craft.state.reason is Reason.SENSOR_SILENT
    stop = leg.subpath.pose(at_m + brakes_m).point_nea_m
    assert np.linalg.norm(np.subtract(craft.here, stop)) < 15.0 + 0.01 * brakes_m
    assert len(craft.sent(Setpoint)) - before > 20
    for place in [setpoint.position_nea_m for setpoint in craft.sent(Setpoint)[before:]]:
        line = leg.subpath.control_nea_m
        along = (line[-1] - line[0]) / np.linalg.norm(line[-1] - line[0])
        apart = np.subtract(place, line[0])
        assert np.linalg.norm(apart - (apart @ along) * along) < 0.1  # on its path
    craft.run_for(5.0)
    assert craft.phase is Phase.HOLDING
    craft.take(seen(craft))
    craft.fly_to(Phase.FLYING)
    craft.fly_to(Phase.ARRIVED)


def test_ground_that_is_nearer_stops_it_on_its_path_until_the_two_agree() -> None:
    craft = flying(MISSION)
    craft.take(ground(craft, 0.0))
    assert craft.state.path.stop is None
    for _ in range(3):
        craft.take(ground(craft))
    craft.fly_to(Phase.HOLDING)
    assert craft.state.reason is Reason.GROUND_NEARER
    assert told(craft, Reason.GROUND_NEARER) == 1
    assert craft.run_for(20.0).phase is Phase.HOLDING
    craft.take(ground(craft, 0.0))
    craft.fly_to(Phase.FLYING).fly_to(Phase.ARRIVED)


@pytest.mark.parametrize(
    ("sees", "after_s"),
    [(lambda craft: seen(craft, Sight.DEAD), (30.0, 300.0)), (ground, (50.0, 80.0))],
    ids=["dead sensor", "ground"],
)
def test_what_stays_wrong_is_waited_for_a_while_and_then_it_flies_back(
    sees: Callable[[Craft], Event], after_s: tuple[float, float]
) -> None:
    """And that stops no way back: what was flown before is flown again."""
    craft = flying(MISSION, plan=home_or_on)
    craft.answered = 0 if sees is not ground else 1
    craft.take(sees(craft))
    craft.fly_to(Phase.HOLDING)
    since_s = craft.now_s
    craft.run_until(lambda craft: craft.phase is Phase.RETURNING, limit_s=300.0)
    assert after_s[0] < craft.now_s - since_s < after_s[1]
    craft.take(sees(craft))
    assert craft.state.path.stop is None
    craft.run_until(lambda craft: craft.phase is Phase.LANDING or craft.over)
    assert craft.phase is Phase.LANDING
    assert np.hypot(*craft.here[:2]) < 100.0


@pytest.mark.parametrize("blind", [False, True])
def test_something_in_its_way_stops_it_at_once(blind: bool) -> None:
    """Also if it stops for want of sight already: it is planned anew from there."""
    craft = flying(MISSION)
    if blind:
        craft.take(seen(craft, Sight.DEAD))
    craft.take(seen(craft, Sight.SEES, ahead(craft, 6000.0)))
    stop = craft.state.path.stop
    assert stop.reason is Reason.NEW_THREAT
    assert told(craft, Reason.SENSOR_SILENT) == blind
    craft.take(seen(craft, Sight.SEES, ahead(craft, 6000.0)))
    assert craft.state.path.stop is stop  # it is told once
    craft.fly_to(Phase.HOLDING)
    assert craft.state.reason is Reason.NEW_THREAT


def test_something_beside_behind_or_gone_stops_nobody() -> None:
    craft = flying(MISSION)
    north, east = ahead(craft, 6000.0)
    kept_m = MISSION.task.settings.safety_distance_m + MISSION.task.limits.tracking_error_m
    aside_m = kept_m + 2.0 * CELL_M
    leg = craft.state.leg
    behind = tuple(leg.subpath.pose(0.0).point_nea_m[:2])
    if np.hypot(*np.subtract(ahead(craft, 0.0), behind)) < aside_m:
        craft.run_for(10.0)
    craft.take(seen(craft, Sight.SEES, (north - aside_m, east + aside_m), behind))
    assert craft.state.path.stop is None
    craft.take(seen(craft, Sight.NOTHING_THERE))
    assert craft.state.path.stop is None


def test_a_vehicle_that_swings_through_after_its_stop_is_waited_for() -> None:
    """It would have left its next path at once: that begins where it is told to hold."""
    craft = flying(MISSION)
    craft.take(seen(craft, Sight.SEES, ahead(craft, 6000.0)))
    craft.fly_to(Phase.HOLDING)
    off_m, speed_m_s = 2.5 * MISSION.task.limits.tracking_error_m, 5.0
    craft.follows, craft.velocity = False, (speed_m_s, 0.0, 0.0)
    craft.by_hand = craft.velocity
    craft.run_for(off_m / speed_m_s)
    craft.velocity = craft.by_hand = (0.0, 0.0, 0.0)
    settings = MISSION.task.settings
    craft.run_for(settings.planning_time_s + 10.0)
    assert craft.phase is Phase.HOLDING
    craft.follows = True
    craft.fly_to(Phase.FLYING)
    craft.run_for(settings.planning_time_s + 10.0)
    assert craft.phase is Phase.FLYING
    assert craft.state.flight.departures == 0


def test_a_copter_behind_its_reference_stops_as_far_from_where_it_is_itself() -> None:
    craft = flying(MISSION)
    path, vehicle = craft.state.path, craft.state.vehicle
    leg, at_m = path.leg, path.reference.length_m
    behind_m = 0.4 * at_m
    place = leg.subpath.pose(at_m - behind_m).point_nea_m
    behind = replace(craft.state, vehicle=replace(vehicle, position_nea_m=place))
    stopped = deep(behind)
    following.stop(stopped, Reason.NEW_THREAT, Turn(stopped, craft.context))
    brakes_m = path.reference.speed_m_s**2 / (2.0 * MISSION.task.limits.acceleration_m_s2)
    stops_at_m = max(at_m - behind_m + brakes_m, at_m)
    assert stopped.path.stop.at_m == pytest.approx(stops_at_m, rel=1e-3)
    age_s = 1.0  # of the position: it has flown on since
    later = replace(behind, now_s=behind.now_s + age_s)
    gained_m = following.vehicle_at_m(later, path) - following.vehicle_at_m(behind, path)
    assert gained_m == pytest.approx(np.linalg.norm(vehicle.velocity_nea_m_s) * age_s, rel=1e-3)


def test_what_stands_between_a_copter_and_its_reference_stops_it() -> None:
    craft = flying(MISSION)
    vehicle, path, leg = craft.state.vehicle, craft.state.path, craft.state.leg
    ahead_of_it = Reference(length_m=0.8 * leg.subpath.length_m)
    north, east, _ = leg.subpath.pose(0.5 * leg.subpath.length_m).point_nea_m
    thing = seen(craft, Sight.SEES, (north, east))
    for at_m, stops in ((0.0, True), (ahead_of_it.length_m, False)):
        there = replace(vehicle, position_nea_m=leg.subpath.pose(at_m).point_nea_m)
        led = replace(path, reference=ahead_of_it)
        craft.state = replace(craft.state, vehicle=there, path=led)
        craft.take(thing)
        assert (craft.state.path.stop is not None) == stops
