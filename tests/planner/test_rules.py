import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planning import limits

from companion.errors import InputError
from companion.path.limits import Limits
from companion.planner import rules
from companion.planner.settings import PlannerSettings, Task
from companion.world.zones import CircleZone

COPTER = limits(
    speed_m_s=8.0, acceleration_m_s2=2.0, climb_rate_m_s=2.5, turn_radius_m=25.0,
    climb_angle_rad=0.3, dive_angle_rad=0.3, floor_amsl_m=500.0, ceiling_amsl_m=660.0,
    north_m=(-5000.0, 5000.0), east_m=(-5000.0, 5000.0),
)  # fmt: skip
PLANE = replace(COPTER, speed_m_s=18.0, turn_radius_m=80.0, loiter_radius_m=80.0)
SETTINGS = PlannerSettings(scan_range_m=2000.0, safety_distance_m=40.0, planning_time_s=3.0)


def refused(of: Limits, settings: PlannerSettings = SETTINGS, where: str = "") -> InputError:
    with pytest.raises(InputError) as caught:
        rules.refuse(rules.of_task(Task(limits=of, settings=settings)), where)
    assert len(str(caught.value).splitlines()) == 1
    return caught.value


def test_tasks_that_can_be_flown_pass() -> None:
    for each in (COPTER, PLANE):
        assert not list(rules.of_task(Task(limits=each, settings=SETTINGS)))


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"north_m": (1.0, 1.0)}, "area.north_max_m"),
        ({"east_m": (1.0, -1.0)}, "area.east_max_m"),
        ({"ceiling_amsl_m": 540.0}, "altitude.ceiling_amsl_m"),
        ({"north_m": (-9e5, 9e5), "east_m": (-9e5, 9e5)}, "planner.scan_range_m"),
        ({"speed_m_s": 200.0}, "planner.planning_time_s"),
        ({"turn_radius_m": 3.1}, "vehicle.turn_radius_m"),
        ({"turn_radius_m": 1001.0}, "vehicle.turn_radius_m"),
    ],
)
def test_a_broken_rule_is_told_by_the_field_of_a_mission_file(
    changes: dict[str, float], field: str
) -> None:
    error = refused(replace(COPTER, **changes))  # type: ignore[arg-type]
    assert error.field == field
    assert refused(replace(COPTER, **changes), where="x: ").field == f"x: {field}"  # type: ignore[arg-type]


def test_a_scan_distance_and_a_scan_time_that_are_too_short_are_refused() -> None:
    least = Task(limits=COPTER, settings=SETTINGS).shortest_scan_distance_m
    assert not list(
        rules.of_task(Task(limits=COPTER, settings=replace(SETTINGS, scan_distance_m=least)))
    )
    short = replace(SETTINGS, scan_distance_m=least - 0.1)
    assert refused(COPTER, short).field == "planner.scan_distance_m"
    assert refused(COPTER, replace(SETTINGS, scan_time_s=3.2)).field == "planner.scan_time_s"


@pytest.mark.parametrize("key", ["turn_radius_m", "loiter_radius_m"])
def test_a_plane_is_not_asked_to_bank_by_more_than_45_degrees(key: str) -> None:
    tightest = 18.0**2 / 9.81  # tan(45 degrees) = 1
    assert not list(
        rules.of_task(Task(limits=replace(PLANE, **{key: tightest + 0.01}), settings=SETTINGS))
    )
    error = refused(replace(PLANE, **{key: tightest - 0.01}))
    assert error.field == f"vehicle.{key}"
    assert "45 degrees of bank" in str(error)


def test_a_circle_that_sight_cannot_hold_is_refused() -> None:
    """R = 2 km less what is kept beyond its end: see `end_radius_m`."""
    error = refused(replace(PLANE, loiter_radius_m=800.0))
    assert error.field == "vehicle.loiter_radius_m"
    assert "a plane holds on circles" in str(error)
    task = Task(limits=replace(PLANE, loiter_radius_m=500.0), settings=SETTINGS)
    assert not list(rules.of_task(task))
    room = task.zone_search_clearance_m + 18.0 * task.limits.lead_s + 2.0 * 80.0
    assert room < task.end_radius_m


def test_a_target_must_lie_on_the_map_outside_keep_outs_and_inside_keep_ins() -> None:
    zones = (
        CircleZone(name="out", north_m=1000.0, east_m=0.0, radius_m=300.0),
        CircleZone(name="in", north_m=0.0, east_m=0.0, radius_m=3000.0, keep_in=True),
    )
    task = Task(limits=COPTER, settings=SETTINGS, zones=zones)
    rules.refuse(rules.of_target(task, (0.0, 0.0), "target"))
    for place, words in (
        ((6000.0, 0.0), "outside the map"),
        ((4990.0, 0.0), "to the edge of the map"),
        ((1000.0, 0.0), "inside keep-out 'out'"),
        ((1320.0, 0.0), "to keep-out 'out'"),
        ((0.0, 3100.0), "outside keep-in 'in'"),
        ((0.0, -2990.0), "to the edge of keep-in 'in'"),
    ):
        with pytest.raises(InputError, match=words):
            rules.refuse(rules.of_target(task, place, "target"))


# --- polygons


@given(st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=4, max_size=9))
def test_edges_that_cross_are_found_as_a_search_of_all_pairs_finds_them(
    places: list[tuple[int, int]],
) -> None:
    corners = np.array(places, dtype=float)
    assert (rules.first_crossing(corners) is not None) == any_crossing(places)


def any_crossing(places: list[tuple[int, int]]) -> bool:
    """Of integers, so that nothing is rounded: do two edges cross at an inner point of both?"""
    edges = list(zip(places, places[1:] + places[:1], strict=True))
    return any(
        turn(*first, second[0]) * turn(*first, second[1]) < 0
        and turn(*second, first[0]) * turn(*second, first[1]) < 0
        for first in edges
        for second in edges
    )


def turn(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> int:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@pytest.mark.parametrize(
    ("corners", "words"),
    [
        (((0.0, 0.0), (1.0, 1.0)), "three or more"),
        (((0.0, 0.0), (9.0, 9.0), (0.0, 0.0)), "three or more"),
        (((0.0, 0.0), (50.0, 0.0), (100.0, 0.0)), "no area"),
        (((0.0, 0.0), (9.0, 9.0), (9.0, 0.0), (0.0, 9.0)), "corners 0 and 2"),
    ],
)
def test_a_polygon_without_a_clear_inside_is_refused(
    corners: tuple[tuple[float, float], ...], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        rules.refuse(rules.of_polygon(corners, "keep_outs[0]", "zone"))


def test_a_polygon_of_2000_corners_passes_and_one_of_more_does_not() -> None:
    angle = np.linspace(0.0, 2.0 * math.pi, 2001, endpoint=False)
    corners = tuple((1e3 * math.cos(a), 1e3 * math.sin(a)) for a in angle)
    rules.refuse(rules.of_polygon(corners[:-1], "keep_outs[0]", "ring"))
    with pytest.raises(InputError, match="more than 2000 corners"):
        rules.refuse(rules.of_polygon(corners, "keep_outs[0]", "ring"))
