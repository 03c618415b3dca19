"""The planner as researchers call it: docs/library.md runs, and what it returns was flown."""

import math
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion import library
from companion.campaign import drawn_world, truth
from companion.config import load_mission
from companion.errors import InputError
from companion.library import Flown, NearScene, Task, Thing, fly
from companion.path.envelope import stopping_m
from companion.planner.plan import plan
from companion.planner.request import NotPlanned, PlanOutcome, PlanRequest, Refusal
from companion.world.known_map import KnownMap, Scan

PAGE = Path(__file__).parents[1] / "docs" / "library.md"
WHERE: dict[str, Any] = {
    "spacing_m": 50.0,
    "start_nea_m": (500.0, 500.0, 260.0),
    "targets_ne_m": [(7_300.0, 7_300.0)],
}


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    """What the names of the page are after all of its code has run."""
    names: dict[str, Any] = {}
    code = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    assert len(code) == 5
    exec("\n".join(code), names)
    return names


def test_every_flight_of_the_page_arrives_proven_along_points_that_keep_their_distance(
    page: dict[str, Any],
) -> None:
    terrain = library.ArrayTerrain(heights_m=page["heights"], spacing_m=50.0)
    need_m = page["task"].required_clearance_m
    for name in ("flown", "short_sighted", "half_blind", "swarm", "random", "among", "quick"):
        flown: Flown = page[name]
        assert (flown.arrived, flown.why) == (True, ""), name
        assert [each.proven for each in flown.certificates] == [True] * len(flown.details.legs)
        if name in ("flown", "short_sighted", "half_blind"):
            points = flown.points_nea_m
            assert points[0] == pytest.approx(WHERE["start_nea_m"])
            assert points[-1, :2] == pytest.approx(WHERE["targets_ne_m"][0])
            steps = np.linalg.norm(np.diff(points, axis=0), axis=-1)
            assert steps.max() <= 1.001 * 2_500.0 / 400.0
            assert steps.sum() == pytest.approx(flown.length_m, rel=1e-5)
            assert truth.terrain_distance_m(points, terrain, 2.0 * need_m).min() >= need_m
    among: Flown = page["among"]
    assert among.length_m > 1.3 * math.dist((0.0, 0.0), (42.0, 42.0))  # round the wall
    gaps_m = NearScene(page["things"]).gaps_m(among.points_nea_m[:, :2])
    assert gaps_m.min() >= among.task.required_clearance_m
    assert page["asked"] == list(range(1, len(page["quick"].details.legs) + 1))
    for name, optimiser in (("swarm", "pso"), ("random", page["RandomSearch"])):
        assert page[name].task.settings.optimiser == optimiser


def test_the_cost_is_that_of_the_benchmarks(page: dict[str, Any]) -> None:
    task, flown = drawn_world.bundled("environment-1").task, page["swarm"]
    whole = 0.0
    for leg, far_m in zip(flown.details.legs, flown.details.flown_m, strict=True):
        curve = truth.sampled(leg.subpath.control_nea_m, 1.0)
        part_nea_m = curve.points_nea_m[curve.length_m <= far_m]
        whole += sum(library.route_terms(part_nea_m, task).values())
    assert flown.cost == pytest.approx(whole, rel=1e-4)
    assert set(flown.terms) == {"length", "height", "radar"}


def test_a_scanner_is_asked_once_for_each_scan_and_nothing_else_is_seen(
    page: dict[str, Any],
) -> None:
    asked = []

    def blind(there: KnownMap, at: tuple[float, float, float], range_m: float) -> Scan:
        asked.append((at, range_m))
        scan = library.simulated_scan(there, at, range_m)
        return replace(scan, heights_m=np.full_like(scan.heights_m, library.NO_ANSWER))

    flown = fly(page["heights"], page["task"], scanner=blind, **WHERE)
    assert asked == [(at, 2_500.0) for at in flown.details.scans_nea_m]
    assert not flown.arrived
    assert flown.why.startswith(("START_NEAR_UNKNOWN", "NOTHING_SEEN"))
    assert len(flown.points_nea_m) == 1
    assert flown.length_m == flown.cost == 0.0


def test_a_lidar_finds_the_way_through_a_maze() -> None:
    """Of which it knows nothing, and it touches nothing."""
    walls = (  # between cells of 8 m, in cells
        *([(0, 0), (0, 4), (4, 4), (4, 0), (0, 0)], [(2, 0), (2, 3)], [(3, 3), (3, 4)]),
        *([(0, 2), (1, 2)], [(0, 3), (1, 3)], [(1, 1), (3, 1)], [(2, 2), (3, 2)]),
    )
    corners_ne_m = ([(8.0 * north, 8.0 * east) for north, east in wall] for wall in walls)
    scene = NearScene([Thing(corners_ne_m=each, half_width_m=0.15) for each in corners_ne_m])
    task = load_mission("forest").task
    start_nea_m, target_ne_m = (4.0, 4.0, task.take_off_amsl_m), (28.0, 28.0)
    flown = fly(
        "forest", "forest", scene=scene, start_nea_m=start_nea_m, targets_ne_m=[target_ne_m]
    )
    assert flown.arrived, flown.why
    nearest_m = scene.gaps_m(flown.points_nea_m[:, :2]).min()
    assert nearest_m > task.settings.safety_distance_m


def test_what_has_flown_into_a_pocket_turns_back_at_once() -> None:
    """20 m deep, of which a lidar of 16 m shows the end when it is in; the target is beyond."""
    walls_ne_m = [(10.0, 15.0), (30.0, 15.0), (30.0, 25.0), (10.0, 25.0)]
    scene = NearScene([Thing(corners_ne_m=walls_ne_m, half_width_m=0.15)])
    task, answers = load_mission("forest").task, list[tuple[PlanRequest, PlanOutcome]]()

    def noted(request: PlanRequest) -> PlanOutcome:
        answers.append((request, plan(request)))
        return answers[-1][1]

    flown = fly(
        "forest", "forest", scene=scene, planner=noted,
        start_nea_m=(4.0, 20.0, task.take_off_amsl_m), targets_ne_m=[(38.0, 20.0)],
    )  # fmt: skip
    assert flown.arrived, flown.why
    turns = 0
    for (asked, answer), (after, _) in pairwise(answers):
        (north, east, _), rest = asked.start.point_nea_m, asked.rest
        is_inside = 12.0 < north < 30.0 and 15.0 < east < 25.0
        if not is_inside or not isinstance(answer, NotPlanned) or rest is None:
            continue
        if answer.refusal is Refusal.BETTER_TO_TURN:
            assert rest.end_nea_m[0] > north  # farther in
            assert after.from_rest
            brakes_m = stopping_m(task.envelope, task.limits.speed_m_s)
            assert math.dist(asked.scan_nea_m, after.scan_nea_m) <= brakes_m
            turns += rest.length_m > 2.0 * brakes_m
    assert turns > 0  # of legs that it would have flown much farther


def test_the_time_is_that_of_legs_no_faster_than_proven_and_of_each_stop(
    page: dict[str, Any],
) -> None:
    for name in ("among", "flown"):
        flown: Flown = page[name]
        flight, task = flown.details, flown.task
        legs = zip(flight.legs, flight.flown_m, strict=True)
        least_s = sum(m / (leg.speed_m_s or task.limits.speed_m_s) for leg, m in legs)
        rests_s = flight.holds * (task.settings.scan_time_s + task.settings.planning_time_s)
        assert flown.seconds >= least_s + rests_s
    stops_s = (flight.holds + 1) * task.stop_m / task.limits.speed_m_s
    assert flown.seconds <= least_s + stops_s + 2.0  # over terrain no leg is flown more slowly


@pytest.mark.parametrize(("settings", "changes", "field"), [
    ({}, {"start_nea_m": None}, "start_nea_m"), ({}, {"targets_ne_m": ()}, "targets_ne_m"),
    ({}, {"spacing_m": None}, "spacing_m"), ({}, {"optimiser": "hope"}, "optimiser"),
    ({}, {"start_nea_m": (500.0, 500.0)}, "start_nea_m"),
    ({}, {"targets_ne_m": [(math.nan, 500.0)]}, "targets_ne_m"),
    ({}, {"seed": -1}, "seed, most_legs"), ({}, {"mission": "forest"}, "scene"),
    ({}, {"scene": NearScene([])}, "scene"),
    ({}, {"world": np.array([[1.0, math.nan]])}, "world"),
    ({"scan_range_m": -5.0}, {}, "settings: scan_range_m"),
    ({"planning_time_s": math.nan}, {}, "settings: planning_time_s"),
    ({"planning_time_s": 500.0}, {}, "planner.planning_time_s"),
    ({"optimiser": "hope"}, {}, "settings.optimiser"),
])  # fmt: skip
def test_what_is_not_understood_or_breaks_a_rule_of_mission_files_is_named(
    page: dict[str, Any], settings: dict[str, Any], changes: dict[str, Any], field: str
) -> None:
    task: Task = page["task"]
    task = replace(task, settings=replace(task.settings, **settings))
    with pytest.raises(InputError) as refused:
        fly(**{"world": page["heights"], "mission": task} | WHERE | changes)
    assert refused.value.field == field


def test_the_same_arguments_fly_the_same_flight_and_another_seed_another(
    page: dict[str, Any],
) -> None:
    """As far as the first leg goes; the limit of legs is told."""
    keywords = WHERE | {"most_legs": 1}
    one, same, other = (fly(page["heights"], page["task"], seed=s, **keywords) for s in (1, 1, 2))
    assert one.points_nea_m.tobytes() == same.points_nea_m.tobytes()
    assert one.points_nea_m.tobytes() != other.points_nea_m.tobytes()
    assert one.why.startswith("TOO_MANY_LEGS: ")
