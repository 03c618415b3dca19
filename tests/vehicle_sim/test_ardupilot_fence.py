"""The fence: its shapes against brute force, and what flying into it does."""

import math

import pytest
from harness import COPTER_HOME, GUIDED, LAND, Vector, item
from hypothesis import given
from hypothesis import strategies as st
from rigs import ArduCopter, hovering

from vehicle_sim.autopilot.earth import FlatEarth
from vehicle_sim.autopilot.guards import Fence
from vehicle_sim.autopilot.values import Place
from vehicle_sim.plans import PlanItem, PlanKind, Zone

HOME = Place(*COPTER_HOME)
EARTH = FlatEarth(HOME)
BELOW, OUTSIDE = "Min Alt fence breached", "Polygon fence breached"


def circle(north_m: float, east_m: float, radius_m: float, command: int = 5004) -> PlanItem:
    return item(HOME, command, north_m, east_m, 0.0, radius_m, frame=0)


def fenced(*items: PlanItem, kinds: float = 4.0, **parameters: float) -> ArduCopter:
    """At 30 m, with a fence of polygons and circles."""
    it = hovering(FENCE_ENABLE=1.0, FENCE_TYPE=kinds, **parameters)
    it.plan(PlanKind.FENCE, *items)
    return it


@given(
    angles=st.lists(st.floats(0.0, 6.28), min_size=3, max_size=8, unique=True),
    north=st.floats(-1.5, 1.5),
    east=st.floats(-1.5, 1.5),
)
def test_inside_is_a_winding_number_that_is_not_zero_for_convex_polygons(
    angles: list[float], north: float, east: float
) -> None:
    corners, turned = [(math.cos(a), math.sin(a)) for a in sorted(angles)], 0.0
    for (n0, e0), (n1, e1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        before = math.atan2(e0 - east, n0 - north)
        turned += math.remainder(math.atan2(e1 - east, n1 - north) - before, math.tau)
        if abs((n1 - n0) * (east - e0) - (e1 - e0) * (north - n0)) < 1e-6:
            return  # on the line of an edge: either answer will do
    fence = Zone(keeps_in=True, corners=tuple(corners))
    assert fence.surrounds((north, east)) == (abs(turned) > math.pi)


TWO_CIRCLES = (circle(0.0, 0.0, 10.0, 5003), circle(50.0, 0.0, 10.0, 5003))
ONE_CIRCLE = (circle(100.0, 0.0, 10.0),)


@pytest.mark.parametrize(
    ("kinds", "items", "options", "place", "found"),
    [
        *((1, ONE_CIRCLE, 0, (0.0, 0.0, 99.0), 0), (1, ONE_CIRCLE, 0, (0.0, 0.0, 101.0), 1)),
        *((2, ONE_CIRCLE, 0, (149.0, 0.0, 0.0), 0), (2, ONE_CIRCLE, 0, (151.0, 0.0, 0.0), 2)),
        (7, ONE_CIRCLE, 0, (151.0, 0.0, 101.0), 3),
        *((4, ONE_CIRCLE, 0, (100.0, 0.0, 0.0), 4), (4, ONE_CIRCLE, 0, (110.5, 0.0, 0.0), 0)),
        # of two inclusions it stays in both, or by an option in either
        *((4, TWO_CIRCLES, 0, (50.0, 0.0, 9.0), 4), (4, TWO_CIRCLES, 2, (50.0, 0.0, 9.0), 0)),
        (4, TWO_CIRCLES, 2, (25.0, 0.0, 9.0), 4),
    ],
)
def test_each_kind_of_fence_is_where_its_parameters_say(
    kinds: int, items: tuple[PlanItem, ...], options: int, place: Vector, found: int
) -> None:
    it = ArduCopter(FENCE_ENABLE=1.0, FENCE_TYPE=float(kinds), FENCE_OPTIONS=float(options))
    it.plans[PlanKind.FENCE] = items
    fence = Fence(it.autopilot.parameters, it.autopilot.plans)
    there = EARTH.place(place[0], place[1], -place[2])
    assert fence.outside(there, HOME, EARTH) == found


@pytest.mark.parametrize(("action", "mode"), [(0, "GUIDED"), (1, "RTL"), (2, "LAND"), (4, "BRAKE")])
def test_outside_of_an_inclusion_the_action_is_a_parameter(action: int, mode: str) -> None:
    it = fenced(circle(70.0, 0.0, 20.0, 5003), FENCE_ACTION=float(action))
    begun_s = it.now_s
    assert it.run(1.0).mode == mode
    assert it.when(OUTSIDE) == [pytest.approx(begun_s + 0.1, abs=0.1)]
    assert it.set_mode(GUIDED) == 0  # it can be had again
    assert (it.run(1.0).mode, it.status.fence[0]) == ("GUIDED", 1)
    it.command(207, 0)  # off
    assert not it.run(0.2).status.fence[0]


def test_the_floor_comes_with_the_height_is_breached_from_above_and_goes_with_the_landing() -> None:
    it = fenced(kinds=8.0, FENCE_ALT_MIN=15.0)
    lands = it.copy()
    while it.height_m > 15.0:
        assert not it.status.fence[0]
        it.aim(None, (0.0, 0.0, 1.5))
        it.step()
    status = it.run(0.2).status
    assert (status.fence[0], status.fence[2]) == (1, 1)
    assert (len(it.when(BELOW)), it.mode) == (1, "RTL")
    lands.set_mode(LAND)
    lands.until(lambda: lands.landed, 60.0)
    lands.airborne(12.0)  # not yet 2 m above it
    assert lands.when(BELOW) == []


def test_a_target_beyond_it_is_dropped_without_a_word() -> None:
    it = fenced(circle(80.0, 0.0, 15.0))
    texts = len(it.texts)
    for place in ((40.0, 0.0, -30.0), (80.0, 0.0, -30.0)):
        it.aim(place)
        taken = it.autopilot.target_echo().position_ned_m
        assert taken == pytest.approx((40.0, 0.0, -30.0), abs=0.1)
    assert len(it.texts) == texts


@pytest.mark.parametrize(("east_m", "deep_m"), [(0.0, 14.5), (16.0, -1.0)])
def test_streaming_at_8_m_s_through_an_exclusion_ends_14_5_m_deep_and_beside_it_does_not(
    east_m: float, deep_m: float
) -> None:
    it, deepest_m = fenced(circle(80.0, east_m, 15.0)), -math.inf
    for k in range(2200):
        if k % 10 == 0:
            north_m = 0.8 * (k * 0.01) ** 2 if k < 500 else 20.0 + 8.0 * (k * 0.01 - 5.0)
            it.aim((north_m, 0.0, -30.0), (min(1.6 * k * 0.01, 8.0), 0.0, 0.0), (0.0, 0.0, 0.0))
        it.step()
        deepest_m = max(deepest_m, 15.0 - math.dist(it.ne_m, (80.0, east_m)))
    assert deepest_m == pytest.approx(deep_m, abs=1.5 if deep_m > 0.0 else 0.1)
    assert it.mode == ("RTL" if deep_m > 0.0 else "GUIDED")
