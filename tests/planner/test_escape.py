"""The way out of where no certificate can begin: short, no nearer to anything, and clear."""

import math
from dataclasses import replace

import numpy as np
import planning
import pytest
from brute_force import violations
from planning import TASK, TRUTH, ask, circle, column_distance_m, planned, spline, zone_distance_m

from companion.geodesy import FloatArray
from companion.planner.request import Planned, Refusal
from companion.planner.settings import Task
from companion.world.zones import PolygonZone, Zone

REQUIRED_M = 70.0  # d_s 60 m, tracking 5 m, navigation 5 m
HERE = (6_500.0, 1_500.0, 600.0)  # over the plain


def escaped(task: Task, start: tuple[float, float, float]) -> tuple[Planned, FloatArray]:
    """The plan and points of it, none nearer to the ground than its start, the last one clear."""
    outcome = planned(ask(task, TRUTH, start))
    assert outcome.certificate.proven
    assert not outcome.reaches_target
    points = np.asarray(spline(outcome.subpath.control_nea_m)(np.linspace(0.0, 1.0, 500)))
    assert points[0] == pytest.approx(start)
    away_m = column_distance_m(TRUTH, points, 200.0)
    assert away_m.min() >= min(away_m[0], REQUIRED_M) - 1.0
    assert away_m[-1] >= REQUIRED_M
    return outcome, points


@pytest.mark.parametrize("bearing_deg", [0, 70, 200])
@pytest.mark.parametrize("now_m", [3.0, 65.0])
def test_from_beside_a_slope_it_comes_no_nearer_and_where_it_ends_a_plan_begins(
    bearing_deg: int, now_m: float
) -> None:
    far, turn = np.arange(0.0, 900.0), math.radians(bearing_deg)  # from the peak of the hill
    line = np.array([3_000.0, 2_600.0, 450.0]) + far[:, None] * [math.cos(turn), math.sin(turn), 0]
    start = line[column_distance_m(TRUTH, line, 200.0) >= now_m][0].tolist()
    _, points = escaped(TASK, tuple(start))
    after = planned(ask(TASK, TRUTH, tuple(points[-1].tolist())))
    assert after.evaluations > 0
    assert violations(after.subpath.control_nea_m, TASK, TRUTH, from_rest=True) == []


def test_where_there_is_no_way_out_the_reason_is_what_is_around() -> None:
    pit = replace(TRUTH, upper_m=np.full_like(TRUTH.upper_m, 5_000.0))
    for floor in (slice(40, 42), slice(290, 310)):  # where it is, and where the target is
        pit.upper_m[floor, floor] = 100.0
    is_floor = pit.upper_m < 5_000.0
    hidden = replace(pit, upper_m=np.where(is_floor, 100.0, np.inf), seen=is_floor)
    near = replace(TASK, settings=replace(TASK.settings, cell_m=TRUTH.cell_m))
    for task, known, refusal in (
        (TASK, pit, Refusal.START_NEAR_TERRAIN),
        (TASK, hidden, Refusal.START_NEAR_UNKNOWN),
        (near, pit, Refusal.START_NEAR_THINGS),
    ):
        assert planning.refused(ask(task, known, (1_025.0, 1_025.0, 450.0))).refusal is refusal


def bar(south: float, north: float, west: float = 700.0, east: float = 2_300.0) -> PolygonZone:
    corners = (south, west), (south, east), (north, east), (north, west)
    return PolygonZone(name="b", vertices_ne_m=corners)


@pytest.mark.parametrize(("zones", "shortest_m", "deeper"), [
    ((circle(6_500.0, 1_500.0, 350.0),), 420.0, False),
    ((circle(6_200.0, 1_500.0, 350.0),), 120.0, False),
    ((bar(6_300.0, 6_700.0, 1_450.0, 1_850.0),), 120.0, False),
    ((circle(6_300.0, 1_500.0, 300.0), circle(6_700.0, 1_500.0, 300.0)), 312.0, False),
    ((circle(6_450.0, 1_400.0, 150.0), circle(6_600.0, 1_600.0, 500.0)), 429.0, True),
    *(
        ((circle(4_500.0 - beyond_m, 1_500.0, 2_000.0, keep_in=True),), beyond_m + 70.0, False)
        for beyond_m in (-40.0, 0.0, 700.0)
    ),
    # 50 m from an edge, 70 m before a wall
    ((bar(6_620.0, 6_700.0, 900.0, 2_100.0), circle(6_350.0, 1_500.0, 200.0)), 600.0, False),
    # a little south of the middle of a bar that lies on a wide one: north is the way
    ((bar(6_400.0, 6_620.0), bar(5_000.0, 6_550.0)), 190.0, True),
])  # fmt: skip
def test_out_of_zones_the_way_is_short_and_leads_deeper_into_none_unless_it_is_much_shorter(
    zones: tuple[Zone, ...], shortest_m: float, deeper: bool
) -> None:
    outcome, points = escaped(replace(TASK, zones=zones), HERE)
    assert outcome.subpath.length_m <= 1.1 * shortest_m + 70.0
    for zone in zones:
        gap_m = zone_distance_m(zone, *points[:, :2].T)
        assert gap_m[-1] >= REQUIRED_M
        if gap_m[0] > 0.5:  # it is clear of it
            assert gap_m.min() >= min(gap_m[0], REQUIRED_M) - 1.0
        elif not deeper:
            assert (np.diff(np.minimum(gap_m, 0.0)) >= -1e-6).all()


def test_out_of_a_zone_that_is_larger_than_sight_it_flies_on_towards_the_edge() -> None:
    """And from beside the edge of the map away from it."""
    zone, here = circle(4_000.0, 1_500.0, 5_500.0), (4_200.0, 1_500.0, 600.0)
    _, points = escaped(replace(TASK, zones=(zone,)), here)
    depths_m = zone_distance_m(zone, *points[:, :2].T)
    assert depths_m[-1] >= depths_m[0] + 1_000.0
    assert (np.diff(depths_m) >= -1e-6).all()
    _, points = escaped(replace(TASK, zones=()), (7_970.0, 1_500.0, 600.0))
    assert points[-1, 0] <= 8_000.0 - REQUIRED_M


@pytest.mark.parametrize("aside_m", [0.0, 350.0, 450.0])
def test_for_a_plane_it_ends_where_the_whole_circle_is_clear(aside_m: float) -> None:
    zone = circle(6_500.0, 1_500.0, 400.0)
    plane = replace(TASK, zones=(zone,), limits=replace(TASK.limits, loiter_radius_m=80.0))
    outcome, points = escaped(plane, (6_500.0 + aside_m, 1_500.0, 600.0))
    assert outcome.evaluations == 0
    assert zone_distance_m(zone, *points[-1:, :2].T)[0] >= 80.0 + REQUIRED_M
