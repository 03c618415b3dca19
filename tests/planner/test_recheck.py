from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from planning import leg_of, zone_distance_m

from companion.planner.procedure import Leg
from companion.planner.recheck import comes_too_near, is_touched
from companion.planner.settings import Task
from companion.world.zones import CircleZone, PolygonZone, Zone

FloatArray = NDArray[np.float64]


def a_leg(rng: np.random.Generator, length_m: float = 20_000.0) -> Leg:
    points = int(rng.integers(4, 7))
    turn = np.cumsum(rng.normal(0.0, 0.5, points - 1))
    steps = np.stack([np.cos(turn), np.sin(turn), 0.05 + 0.0 * turn], axis=-1)
    control = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]) * length_m / (points - 1)
    return leg_of(control)


def straight_leg() -> Leg:
    return leg_of(np.outer([0.0, 0.25, 0.5, 1.0], [20_000.0, 0.0, 0.0]))


def zones_along(rng: np.random.Generator, leg: Leg) -> tuple[Zone, ...]:
    zones: list[Zone] = []
    for _ in range(rng.integers(1, 5)):
        at_m = rng.uniform(0.0, leg.subpath.length_m)
        n, e = leg.subpath.pose(at_m).position_nea_m[:2] + rng.normal(0.0, 900.0, 2)
        corners = np.array([n, e]) + rng.normal(0.0, 500.0, (5, 2))
        circle = CircleZone(name="c", north_m=n, east_m=e, radius_m=rng.uniform(50.0, 800.0))
        polygon = PolygonZone(name="p", vertices_ne_m=tuple((a, b) for a, b in corners.tolist()))
        zones.append(circle if rng.random() < 0.5 else polygon)
    if rng.random() < 0.3:
        zones.append(CircleZone(name="k", north_m=0.0, east_m=0.0, radius_m=15_000.0, keep_in=True))
    return tuple(zones)


@given(seed=st.integers(0, 10**6), required_m=st.floats(20.0, 600.0))
def test_a_leg_comes_too_near_where_dense_samples_do(seed: int, required_m: float) -> None:
    rng = np.random.default_rng(seed)
    leg = a_leg(rng)
    zones, from_m = zones_along(rng, leg), rng.uniform(0.0, 0.5) * leg.subpath.length_m
    lengths = np.linspace(from_m, leg.subpath.length_m, 8_001)  # about 2.5 m apart
    n, e, _ = leg.subpath.points_nea_m(lengths).T
    gap = np.min([zone_distance_m(zone, n, e) for zone in zones], axis=0)
    if comes_too_near(leg, from_m, zones, required_m):
        assert gap.min() < required_m + 2.0
    else:
        assert gap.min() >= 0.998 * required_m - 0.01


@pytest.mark.parametrize("off", [-1.5, -1.1, 0.0, 1.0])
def test_a_leg_beside_a_fence_at_just_the_required_distance_is_none(off: float) -> None:
    edge = 515.0 + off
    corners = ((-1e4, edge), (3e4, edge), (3e4, 5e3), (-1e4, 5e3))
    fence = (PolygonZone(name="p", vertices_ne_m=corners),)
    assert comes_too_near(straight_leg(), 100.0, fence, 515.0) == (off < -1.04)


def test_what_is_behind_does_not_matter() -> None:
    zone = (CircleZone(name="c", north_m=5_000.0, east_m=0.0, radius_m=500.0),)
    assert comes_too_near(straight_leg(), 5_599.0, zone, 100.0)
    assert not comes_too_near(straight_leg(), 5_600.5, zone, 100.0)


@pytest.mark.parametrize("deep_m", [0.0, 3.0])
def test_a_corner_between_two_samples_is_met(deep_m: float) -> None:
    """A needle whose tip comes near to the path, off the middles of its pieces."""
    tip = 101.0 - deep_m
    needle = ((7_010.0, tip), (7_009.0, 400.0), (7_011.0, 400.0))
    fence = (PolygonZone(name="n", vertices_ne_m=needle),)
    assert comes_too_near(straight_leg(), 0.0, fence, 100.0) == (deep_m > 1.5)


# --- rules that have changed

LOW_M = 300.0 + 10.0  # of the floor, and tracking and navigation error


def low_leg(rules: Task | None, below_m: float = 0.0) -> Leg:
    """Across the map, as low as it is proven, or lower."""
    control = np.linspace((1_000.0, 500.0, LOW_M - below_m), (7_000.0, 500.0, LOW_M + 90.0), 4)
    return leg_of(control, rules=rules)


ACROSS = CircleZone(name="new", north_m=4_000.0, east_m=500.0, radius_m=100.0)


def with_limits(task: Task, **changes: float) -> Task:
    return replace(task, limits=replace(task.limits, **changes))


def with_zones(task: Task, *zones: Zone) -> Task:
    return replace(task, zones=(*task.zones, *zones))


@pytest.mark.parametrize("below_m", [0.0, 0.7, 50.0])
def test_what_was_proven_stays_proven_while_the_rules_are_the_same_or_less(
    task: Task, below_m: float
) -> None:
    """However it was proven: `paper` proves nothing, a way out leads through its zone."""
    same = replace(task, zones=(*task.zones,))
    bounded = with_zones(task, ACROSS)
    less = with_limits(task, floor_amsl_m=250.0, ceiling_amsl_m=800.0)
    above = with_limits(task, ceiling_amsl_m=350.0)
    pairs = (task, same), (bounded, bounded), (bounded, task), (task, less), (above, above)
    for before, now in pairs:
        assert not is_touched(low_leg(before, below_m), 0.0, now)


def test_a_rule_that_is_new_is_held_against_what_is_left_of_a_leg(task: Task) -> None:
    leg = low_leg(task)
    assert is_touched(leg, 0.0, with_zones(task, ACROSS))
    assert not is_touched(leg, 4_000.0, with_zones(task, ACROSS))
    assert is_touched(leg, 0.0, with_limits(task, floor_amsl_m=301.0))
    assert not is_touched(leg, 0.0, with_limits(task, floor_amsl_m=300.4))  # home moves so far
    assert not is_touched(leg, 1_000.0, with_limits(task, floor_amsl_m=301.0))
    assert is_touched(leg, 0.0, with_limits(task, ceiling_amsl_m=LOW_M + 90.0))


def test_of_a_leg_whose_rules_nobody_knows_all_rules_count(task: Task) -> None:
    assert not is_touched(low_leg(None), 0.0, task)
    assert is_touched(low_leg(None, below_m=0.7), 0.0, task)
    assert is_touched(low_leg(None), 0.0, with_zones(task, ACROSS))
