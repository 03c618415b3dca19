"""What the mission does when its sensor of near things, or of the ground, sees something or not."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from made_up import AWAY, Craft, Step, flying, hears, home_or_on, now, says, told
from renewed import deep, replace
from watch import off_m

from companion.mission import following
from companion.mission.decisions import Turn
from companion.mission.events import GroundSeen, NearSeen, Setpoint
from companion.mission.mission import Fallback
from companion.mission.phases import Phase, Reason
from companion.planner.request import NotPlanned, Refusal
from companion.world.known_map import Lattice
from companion.world.near_map import NearMap, NearSensor, Sight

SENSOR = NearSensor(kind="obstacle_distance", component_id=196, range_m=20_000.0)
MISSION = replace(AWAY, near=SENSOR, rangefinder_error_m=2.0, fallback=Fallback.RETURN)
LIMITS, SETTINGS = MISSION.task.limits, MISSION.task.settings
CELL_M = 100.0
PLACE = Lattice(cell_m=CELL_M, north_min_m=-1000.0, east_min_m=-1000.0, shape=(300, 300))
ASIDE_M = SETTINGS.safety_distance_m + LIMITS.tracking_error_m + 2.0 * CELL_M


def sees(sight: Sight = Sight.SEES, *things_m: tuple[float, float], **fields: float) -> Step:
    """Things so far ahead of it, and to the right."""

    def see(craft: Craft) -> None:
        near, path = NearMap(PLACE), craft.state.path
        for ahead_m, aside_m in things_m:
            north, east, _ = path.leg.subpath.pose(path.reference.length_m + ahead_m).point_nea_m
            cell = round((north - aside_m) / CELL_M) + 10, round((east + aside_m) / CELL_M) + 10
            near.met_since_s[cell] = near.met_s[cell] = 1.0
        hears(NearSeen, sight=sight, near=near, **fields)(craft)

    return see


def is_to_stop(reason: Reason | None) -> Callable[[Craft], bool]:
    return lambda craft: getattr(craft.state.path.stop, "reason", None) is reason


WELL, DEAD, NEVER = sees(), sees(Sight.DEAD), sees(Sight.NEVER_HEARD)
NEARER, AS_MAPPED = hears(GroundSeen, above_m=5.0), hears(GroundSeen, above_m=0.0)


@pytest.mark.parametrize(
    ("wrong", "well", "reason"),
    [
        (DEAD, WELL, Reason.SENSOR_SILENT),
        (NEVER, WELL, Reason.SENSOR_SILENT),
        (NEARER, AS_MAPPED, Reason.GROUND_NEARER),
    ],
    ids=["dead", "never heard", "nearer"],
)
def test_what_is_not_seen_or_nearer_stops_it_on_its_path_until_that_is_over(
    wrong: Step, well: Step, reason: Reason
) -> None:
    craft = told(flying(MISSION), well, is_to_stop(None), wrong, wrong, says(reason.text, 1))
    path, reference, before = craft.state.path, craft.state.reference, len(craft.sent(Setpoint))
    told(craft, Phase.HOLDING, reason)
    brakes_m = 0.5 * reference.speed_m_s**2 / LIMITS.acceleration_m_s2
    stop = path.leg.subpath.pose(reference.length_m + brakes_m).point_nea_m
    assert math.dist(craft.here, stop) < 15.0 + 0.01 * brakes_m
    places = [setpoint.position_nea_m for setpoint in craft.sent(Setpoint)[before:]]
    assert len(places) > 20
    assert max(off_m(path.leg.subpath, place) for place in places) < 0.1  # on its path
    told(craft, 5.0, lambda it: it.phase is Phase.HOLDING, well, Phase.FLYING, Phase.ARRIVED)


@pytest.mark.parametrize(("wrong", "after_s"), [(DEAD, (30.0, 300.0)), (NEARER, (50.0, 80.0))])
def test_what_stays_wrong_is_waited_for_a_while_and_then_it_flies_back(
    wrong: Step, after_s: tuple[float, float]
) -> None:
    """And that stops no way back: what was flown before is flown again."""
    craft = flying(MISSION, plan=home_or_on)
    since_s = told(craft, now(answered=int(wrong is NEARER)), wrong, Phase.HOLDING).now_s
    craft.run_until(lambda craft: craft.phase is Phase.RETURNING, limit_s=300.0)
    assert after_s[0] < craft.now_s - since_s < after_s[1]
    told(craft, wrong, is_to_stop(None), Phase.LANDING)
    assert math.hypot(*craft.here[:2]) < 100.0


THING = sees(Sight.SEES, (6000.0, 0.0))
SEEN: dict[str, tuple[Step, ...]] = {
    "beside it": (sees(Sight.SEES, (6000.0, ASIDE_M)), is_to_stop(None)),
    "behind it": (20.0, sees(Sight.SEES, (-1000.0, 0.0)), is_to_stop(None)),
    "nothing any more": (sees(Sight.NOTHING_THERE), is_to_stop(None)),
    "in its way": (THING, is_to_stop(Reason.NEW_THREAT), THING, Phase.HOLDING, Reason.NEW_THREAT),
    "in its way, stopping blind": (DEAD, is_to_stop(Reason.SENSOR_SILENT), THING,
        is_to_stop(Reason.NEW_THREAT), says(Reason.SENSOR_SILENT.text, 1), Phase.HOLDING),
    "less than R": (*(sees(sees_m=sees_m) for sees_m in (10_000.0, 20_000.0, 10_000.0)),
        says("sensor sees 10000 m of R = 20000 m", 1)),
}  # fmt: skip


@pytest.mark.parametrize("seen", SEEN)
def test_something_in_its_way_stops_it_at_once_and_what_is_elsewhere_does_not(seen: str) -> None:
    told(flying(MISSION), *SEEN[seen])


def test_where_it_is_better_to_turn_back_it_stops_on_its_leg_and_plans_from_there() -> None:
    """Once, and that counts as a stop."""
    turns = NotPlanned(plan_id=2, refusal=Refusal.BETTER_TO_TURN)
    craft = flying(MISSION, plan=lambda asked: turns if asked.plan_id == 2 else home_or_on(asked))
    leg = craft.state.leg
    stop_m = craft.run_until(is_to_stop(Reason.NO_PLAN)).state.path.stop.at_m
    assert stop_m < leg.subpath.length_m - 100.0
    told(craft, Phase.HOLDING, Reason.NO_PLAN, lambda it: it.state.flight.stops == 1)
    assert math.dist(craft.here, leg.subpath.pose(stop_m).point_nea_m) < 15.0
    told(craft, Phase.FLYING, Phase.ARRIVED)


def test_a_copter_behind_its_reference_stops_as_far_from_where_it_is_itself() -> None:
    """An old position is where it was: it has flown on since."""
    craft = flying(MISSION)
    path, vehicle = craft.state.path, craft.state.vehicle
    at_m = 0.6 * path.reference.length_m
    behind = replace(vehicle, position_nea_m=path.leg.subpath.pose(at_m).point_nea_m)
    for age_s in (0.0, 1.0):
        stopped = deep(replace(craft.state, now_s=craft.state.now_s + age_s, vehicle=behind))
        following.stop(stopped, Reason.NEW_THREAT, Turn(stopped, craft.context))
        flown_m = at_m + age_s * np.linalg.norm(vehicle.velocity_nea_m_s)
        brakes_m = path.reference.speed_m_s**2 / (2.0 * LIMITS.acceleration_m_s2)
        stops_at_m = max(flown_m + brakes_m, path.reference.length_m)
        assert stopped.path.stop.at_m == pytest.approx(stops_at_m, rel=1e-3)
