"""Where a plane is sent to circle: our own vehicle flies there, not what the search thinks."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from planning import PLANE_TASK, circle, jagged, zones_distance_m

from companion.geodesy import FloatArray
from companion.planner import loiter_search
from companion.planner.loiter_search import Vector, loiter_point
from companion.world.known_map import KnownMap, empty_map
from companion.world.zones import PolygonZone, Zone, gaps_m

Motion = tuple[Vector, Vector]  # where a plane is, and its velocity
V, TURN_M, LOITER_M = 18.0, 100.0, 80.0
TASK = PLANE_TASK
LIMITS = TASK.limits
REQUIRED_M = TASK.required_clearance_m
HEIGHT_M = 120.0
STEP_S = 0.1


def flat() -> KnownMap:
    """All of the map, seen."""
    blank = empty_map(20.0, LIMITS.north_m, LIMITS.east_m)
    return replace(blank, upper_m=np.zeros_like(blank.upper_m), seen=np.ones_like(blank.seen))


def gap_m(zones: tuple[Zone, ...], *place_ne_m: float) -> float:
    return float(zones_distance_m(zones, np.array([place_ne_m]))[0])


def flown_m(zones: tuple[Zone, ...], circler: Motion, to: Vector, radius_m: float) -> list[float]:
    """Distances to zones of a plane that always turns its nose towards the point, step by step."""
    (north, east, _), velocity = circler
    course = math.atan2(velocity[1], velocity[0])
    gaps = []
    for _ in range(1_000):
        if math.dist((north, east), to[:2]) < LOITER_M:
            break
        gaps.append(gap_m(zones, north, east))
        error = math.remainder(math.atan2(to[1] - east, to[0] - north) - course, math.tau)
        most = V / radius_m * STEP_S
        course += min(max(error, -most), most)
        north += V * STEP_S * math.cos(course)
        east += V * STEP_S * math.sin(course)
    return gaps


def sent_to(known: KnownMap, circler: Motion, *zones: Zone) -> Vector | None:
    """One that would rather stay where it is."""
    return loiter_point(known, replace(TASK, zones=zones), *circler, circler[0])


def heading(course_deg: float, north_m: float = 0.0, altitude_m: float = HEIGHT_M) -> Motion:
    course = math.radians(course_deg)
    velocity = V * math.cos(course), V * math.sin(course), 0.0
    return (north_m, 0.0, altitude_m), velocity


def a_circle(rng: np.random.Generator) -> tuple[Zone, ...]:
    return (circle(*rng.uniform(-250.0, 250.0, 2).tolist(), rng.uniform(50.0, 150.0)),)


def polygons(rng: np.random.Generator, count: int = 10, corners: int = 60) -> tuple[Zone, ...]:
    """The first is about the vehicle."""
    middles = rng.uniform(-900.0, 900.0, (count, 2)) * (np.arange(count) > 0)[:, None]
    middles += rng.uniform(-120.0, 120.0, (count, 2))
    shapes = (jagged(rng, (n, e), 90.0, corners) for n, e in middles.tolist())
    return tuple(PolygonZone(name=f"{k}", vertices_ne_m=each) for k, each in enumerate(shapes))


@pytest.mark.parametrize("radius_m", [0.5 * TURN_M, TURN_M])
@pytest.mark.parametrize(("draw", "scenes", "most"), [(a_circle, 60, 40), (polygons, 20, 8)])
def test_the_circle_is_clear_and_the_way_there_never_comes_nearer_than_staying(
    draw: Callable[[np.random.Generator], tuple[Zone, ...]], scenes: int, most: int, radius_m: float
) -> None:
    rng, reached = np.random.default_rng(9), 0
    for _ in range(scenes):
        zones, circler = draw(rng), heading(float(rng.uniform(0, 360)))
        point = sent_to(flat(), circler, *zones)
        if point is None:
            continue
        assert gap_m(zones, *point[:2]) - LOITER_M >= TASK.error_m
        gaps = flown_m(zones, circler, point, radius_m)
        now_m = gap_m(zones, 0.0, 0.0)
        assert min(gaps, default=math.inf) >= min(TASK.error_m, now_m) - 3.0
        reached += 1
    assert reached > most


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("course_deg", range(0, 360, 51))
def test_it_stays_only_where_it_can_turn_to_either_side(course_deg: int, side: float) -> None:
    """The circle about where it is would be clear; the turn that brings it there is not."""
    course, circler = math.radians(course_deg), heading(course_deg)
    north, east = (2.0 * TURN_M * side * x for x in (-math.sin(course), math.cos(course)))
    zone = circle(north, east, 20.0)
    assert gap_m((zone,), 0.0, 0.0) - LOITER_M > REQUIRED_M
    assert sent_to(flat(), circler, zone) != circler[0]


def test_nothing_is_clear_where_ground_is_not_known_or_higher_than_the_plane_on_its_way() -> None:
    """A climb takes longer than the way: a place beyond the hill is none for a plane below it."""
    zone, half, hill = circle(0.0, 0.0, 70.0), flat(), flat()
    north_m = half.middles_m()[0][:, 0]
    half.upper_m[north_m > 150.0] = np.inf
    assert sent_to(replace(half, upper_m=half.upper_m + np.inf), heading(0.0, 103.0), zone) is None
    point = sent_to(half, heading(180.0, -103.0), zone)
    assert point is not None
    assert point[0] + LOITER_M + REQUIRED_M <= 160.0
    assert sent_to(half, heading(0.0, 103.0), zone) is None  # no room to turn
    corners = ((-900.0, -900.0), (-900.0, 900.0), (20.0, 900.0), (20.0, -900.0))
    hill.upper_m[(north_m > 150.0) & (north_m < 250.0)] = 60.0
    land = PolygonZone(name="land", vertices_ne_m=corners)
    assert sent_to(hill, heading(0.0, 0.0, 65.0), land) is None
    assert sent_to(hill, heading(0.0), land) is not None


def test_among_fifty_zones_of_a_hundred_corners_it_looks_at_no_more_than_it_can(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Counted are points: some 10 us each.  The watchdog allows 0.2 s."""
    looked_at = list[int]()

    def counted(zones: tuple[Zone, ...], north_m: FloatArray, *other: Any) -> FloatArray:
        looked_at.append(np.size(north_m))
        return gaps_m(zones, north_m, *other)

    monkeypatch.setattr(loiter_search, "gaps_m", counted)
    sent_to(flat(), heading(90.0, 100.0), *polygons(np.random.default_rng(3), 50, 100))
    assert 0 < sum(looked_at) < 20_000
