"""The fence: its shapes against brute force, and what flying into it does."""

import math

import pytest
from harness import item
from hypothesis import given
from hypothesis import strategies as st
from tracked import ArduCopter as Flown

from vehicle_sim.autopilot.earth import FlatEarth
from vehicle_sim.autopilot.guards import Fence
from vehicle_sim.autopilot.values import Place
from vehicle_sim.plans import PlanItem, PlanKind, Zone

HOME = Place(latitude_deg=47.0, longitude_deg=8.0, altitude_amsl_m=500.0)
EARTH = FlatEarth(HOME)


def circle(north_m: float, east_m: float, radius_m: float, command: int = 5004) -> PlanItem:
    return item(HOME[:2], command, north_m, east_m, 0.0, radius_m, frame=0)


def polygon(command: int, *corners_m: tuple[float, float]) -> tuple[PlanItem, ...]:
    n = float(len(corners_m))
    return tuple(item(HOME[:2], command, *corner, 0.0, n, frame=0) for corner in corners_m)


def fenced(*items: PlanItem, **parameters: float) -> Flown:
    it = Flown(**{"ANGLE_MAX": 4500.0, "FENCE_ENABLE": 1.0, "FENCE_TYPE": 4.0} | parameters)
    it.autopilot.plans[PlanKind.FENCE] = items
    it.autopilot.on_plan(PlanKind.FENCE)
    return it.airborne(30.0)


@given(
    angles=st.lists(st.floats(0.0, 6.28), min_size=3, max_size=8, unique=True),
    north=st.floats(-1.5, 1.5),
    east=st.floats(-1.5, 1.5),
)
def test_inside_is_a_winding_number_that_is_not_zero_for_convex_polygons(
    angles: list[float], north: float, east: float
) -> None:
    corners = [(math.cos(a), math.sin(a)) for a in sorted(angles)]
    fence = Zone(keeps_in=True, corners=tuple(corners))
    turned = 0.0
    for (n0, e0), (n1, e1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        before = math.atan2(e0 - east, n0 - north)
        turned += math.remainder(math.atan2(e1 - east, n1 - north) - before, math.tau)
        if abs((n1 - n0) * (east - e0) - (e1 - e0) * (north - n0)) < 1e-6:
            return  # on the line of an edge: either answer will do
    assert fence.surrounds((north, east)) == (abs(turned) > math.pi)


@pytest.mark.parametrize(
    ("kinds", "place", "found"),
    [
        (1, (0.0, 0.0, 99.0), 0),
        (1, (0.0, 0.0, 101.0), 1),
        (2, (149.0, 0.0, 0.0), 0),
        (2, (151.0, 0.0, 0.0), 2),
        (7, (151.0, 0.0, 101.0), 3),
        (4, (100.0, 0.0, 0.0), 4),
        (4, (110.5, 0.0, 0.0), 0),
        (4, (0.0, 0.0, 0.0), 0),
    ],
)
def test_each_kind_of_fence_is_where_its_parameters_say(
    kinds: int, place: tuple[float, float, float], found: int
) -> None:
    it = Flown(FENCE_ENABLE=1.0, FENCE_TYPE=float(kinds))
    it.autopilot.plans[PlanKind.FENCE] = (circle(100.0, 0.0, 10.0),)
    fence = Fence(it.autopilot.parameters, it.autopilot.plans)
    north_m, east_m, up_m = place
    assert fence.outside(EARTH.place(north_m, east_m, -up_m), HOME, EARTH) == found


@pytest.mark.parametrize(("union", "found"), [(0.0, 4), (2.0, 0)])
def test_of_two_inclusions_it_stays_in_both_or_by_an_option_in_either(
    union: float, found: int
) -> None:
    it = Flown(FENCE_ENABLE=1.0, FENCE_TYPE=4.0, FENCE_OPTIONS=union)
    it.autopilot.plans[PlanKind.FENCE] = tuple(circle(n, 0.0, 10.0, 5003) for n in (0.0, 50.0))
    fence = Fence(it.autopilot.parameters, it.autopilot.plans)
    assert fence.outside(EARTH.place(50.0, 0.0, -9.0), HOME, EARTH) == found
    assert fence.outside(EARTH.place(25.0, 0.0, -9.0), HOME, EARTH) == 4


@pytest.mark.parametrize(("action", "mode"), [(0, "GUIDED"), (1, "RTL"), (2, "LAND")])
def test_the_action_is_a_parameter(action: int, mode: str) -> None:
    it = fenced(FENCE_ACTION=float(action))
    it.autopilot.plans[PlanKind.FENCE] = polygon(5001, (50.0, 0.0), (90.0, 0.0), (90.0, 40.0))
    it.autopilot.on_plan(PlanKind.FENCE)
    it.run(0.5)
    assert it.autopilot.mode_name == mode
    assert it.autopilot.status().fence_breached


FLOOR = {"FENCE_TYPE": 8.0, "FENCE_ALT_MIN": 15.0}


@pytest.mark.parametrize(("action", "mode"), [(0, "GUIDED"), (1, "RTL"), (4, "BRAKE")])
def test_below_the_floor_is_a_breach(action: int, mode: str) -> None:
    it = fenced(FENCE_ACTION=float(action), **FLOOR)  # through it, up to 30 m: no breach
    assert it.when("Min Alt fence breached") == []
    while it.height_m > 15.0:
        assert not it.autopilot.status().fence_breached
        it.setpoint((0.0, 0.0, 0.0), (0.0, 0.0, 1.5), kind="velocity")
        it.step()
    it.run(0.2)
    status = it.autopilot.status()
    assert (status.fence_breached, status.fence_breach_type) == (True, 1)
    assert len(it.when("Min Alt fence breached")) == 1
    assert it.autopilot.mode_name == mode


def test_the_floor_comes_with_the_height_and_goes_with_the_landing() -> None:
    it = fenced(**FLOOR)
    # a target below it is dropped, one above is not
    for down_m, taken in ((-10.0, False), (-20.0, True)):
        it.setpoint((0.0, 0.0, down_m), kind="position")
        echo = it.autopilot.target_echo()
        assert echo is not None
        assert echo.position_ned_m is not None
        assert (echo.position_ned_m[2] == pytest.approx(down_m)) is taken
    it.command(176, 1, 9)  # LAND
    it.run_until(lambda: it.autopilot.landed, 60.0)
    assert it.when("Min Alt fence breached") == []
    it.airborne(12.0)  # not yet 2 m above it
    assert not it.autopilot.status().fence_breached


def test_autoenable_3_is_a_fence_while_armed() -> None:
    it = fenced(FENCE_ENABLE=0.0, FENCE_AUTOENABLE=3.0, **FLOOR)
    assert it.autopilot.fence.enabled
    it.command(176, 1, 9)
    it.run_until(lambda: not it.autopilot.armed, 60.0)
    assert not it.autopilot.fence.enabled


@pytest.mark.parametrize("value", [1.0, 2.0])
def test_autoenable_1_and_2_are_a_fence_once_it_has_taken_off(value: float) -> None:
    it = fenced(FENCE_ENABLE=0.0, FENCE_AUTOENABLE=value, FENCE_ACTION=0.0, **FLOOR)
    it.run(5.0)
    assert it.autopilot.fence.enabled
    assert it.autopilot.fence.has_floor
    it.command(176, 1, 9)
    it.run(1.0)
    assert it.autopilot.fence.enabled is (value == 2.0)  # of 2 only the floor ends
    it.run_until(lambda: not it.autopilot.armed, 60.0)
    assert it.when("Min Alt fence breached") == []


def test_a_take_off_that_ends_below_the_floor_is_a_breach_then() -> None:
    it = fenced(FENCE_ENABLE=0.0, FENCE_AUTOENABLE=2.0, FENCE_TYPE=8.0, FENCE_ALT_MIN=50.0)
    it.run_until(lambda: it.autopilot.mode_name == "RTL", 10.0)
    assert len(it.when("Min Alt fence breached")) == 1


def test_one_uploaded_around_it_is_breached_after_half_a_second_unless_it_is_off() -> None:
    it = fenced()
    it.autopilot.plans[PlanKind.FENCE] = polygon(5001, (50.0, 0.0), (90.0, 0.0), (90.0, 40.0))
    it.autopilot.on_plan(PlanKind.FENCE)
    begun_s = it.now_s
    it.run(1.0)
    assert it.when("Polygon fence breached") == [pytest.approx(begun_s + 0.5, abs=0.15)]
    assert it.autopilot.mode_name == "RTL"
    assert it.command(176, 1, 4) == 0  # GUIDED can be had again
    it.run(1.0)
    assert (it.autopilot.mode_name, it.autopilot.status().fence_breached) == ("GUIDED", True)
    it.command(207, 0)
    it.run(0.2)
    assert not it.autopilot.status().fence_breached


@pytest.mark.parametrize(
    ("kinds", "items", "beyond"),
    [
        (7.0, (), (200.0, 0.0, -30.0)),
        (7.0, (), (0.0, 0.0, -110.0)),
        (4.0, (circle(80.0, 0.0, 15.0),), (80.0, 0.0, -30.0)),
        (4.0, (circle(0.0, 0.0, 60.0, 5003),), (80.0, 0.0, -30.0)),
    ],
)
def test_a_target_beyond_it_is_dropped_without_a_word(
    kinds: float, items: tuple[PlanItem, ...], beyond: tuple[float, float, float]
) -> None:
    it = fenced(*items, FENCE_TYPE=kinds)
    texts = len(it.texts)
    for place in ((40.0, 0.0, -30.0), beyond):
        it.setpoint(place, kind="position")
        echo = it.autopilot.target_echo()
        assert echo is not None
        assert echo.position_ned_m == pytest.approx((40.0, 0.0, -30.0), abs=0.1)
    assert len(it.texts) == texts


@pytest.mark.parametrize(
    ("east_m", "enabled", "deep_m"), [(0.0, True, 14.5), (16.0, True, -1.0), (0.0, False, 15.0)]
)
def test_streaming_at_8_m_s_through_an_exclusion_ends_14_5_m_deep_and_beside_it_does_not(
    east_m: float, enabled: bool, deep_m: float
) -> None:
    it = fenced(circle(80.0, east_m, 15.0), FENCE_ENABLE=float(enabled))
    deepest_m = -math.inf
    for k in range(2200):
        if k % 10 == 0:
            north_m = 0.8 * (k * 0.01) ** 2 if k < 500 else 20.0 + 8.0 * (k * 0.01 - 5.0)
            v = min(1.6 * k * 0.01, 8.0)
            it.setpoint((north_m, 0.0, -30.0), (v, 0.0, 0.0), kind="pos+vel+acc")
        it.step()
        here_m = it.local_m()
        deepest_m = max(deepest_m, 15.0 - math.dist(here_m[:2], (80.0, east_m)))
    assert deepest_m == pytest.approx(deep_m, abs=1.5 if deep_m > 0.0 else 0.1)
    breached = enabled and deep_m > 0.0
    assert bool(it.when("Polygon fence breached")) is breached
    assert it.autopilot.mode_name == ("RTL" if breached else "GUIDED")
