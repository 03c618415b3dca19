"""Fences, as ardupilot.md 4 and px4.md 7 say that they hold, and do not."""

import cmath
import math
from collections.abc import Sequence

import pytest
from harness import COPTER_HOME, GCS, PLACE, Rig, Vector, circling, heartbeat, hover, hovering, item

from vehicle_sim.autopilot.earth import FlatEarth
from vehicle_sim.autopilot.guards import Fence
from vehicle_sim.autopilot.values import Place
from vehicle_sim.plans import PlanItem, PlanKind

ACCEPTED, _, DENIED, _, FAILED = range(5)
HOME = Place(*COPTER_HOME)
EARTH = FlatEarth(HOME)
approx = pytest.approx

# --- ArduPilot's ----------------------------------------------------------------------------------


def circle(north_m: float, radius_m: float, command: int = 5004) -> PlanItem:
    return item(HOME, command, north_m, 0.0, 0.0, radius_m, frame=0)


def polygon(*corners: complex) -> list[PlanItem]:
    """To stay in: north + east j."""
    count = float(len(corners))
    return [item(HOME, 5001, at.real, at.imag, 0.0, count, frame=0) for at in corners]


def fenced(*items: PlanItem, kinds: float = 4.0, **parameters: float) -> Rig:
    """At 30 m, with a fence of polygons and circles."""
    it = hovering(FENCE_ENABLE=1.0, FENCE_TYPE=kinds, **parameters)
    it.plan(PlanKind.FENCE, *items)
    return it


STAR = polygon(*(cmath.rect(20.0, 0.8 * math.pi * k) for k in range(5)))
"""It crosses itself: its middle is a hole."""
TWO_CIRCLES = (circle(0.0, 10.0, 5003), circle(50.0, 10.0, 5003))
ONE_CIRCLE = (circle(100.0, 10.0),)


@pytest.mark.parametrize(
    ("kinds", "items", "options", "place", "found"),
    [
        *((1, ONE_CIRCLE, 0, (0.0, 0.0, 99.0), 0), (1, ONE_CIRCLE, 0, (0.0, 0.0, 101.0), 1)),
        *((2, ONE_CIRCLE, 0, (149.0, 0.0, 0.0), 0), (2, ONE_CIRCLE, 0, (151.0, 0.0, 0.0), 2)),
        (7, ONE_CIRCLE, 0, (151.0, 0.0, 101.0), 3),
        *((4, ONE_CIRCLE, 0, (100.0, 0.0, 0.0), 4), (4, ONE_CIRCLE, 0, (110.5, 0.0, 0.0), 0)),
        # of two inclusions it stays in both, or by an option in either
        *((4, TWO_CIRCLES, 0, (50.0, 0.0, 9.0), 4), (4, TWO_CIRCLES, 2, (50.0, 0.0, 9.0), 0)),
        *((4, TWO_CIRCLES, 2, (25.0, 0.0, 9.0), 4), (4, STAR, 0, (0.0, 0.0, 9.0), 4)),
        *((4, STAR, 0, (14.0, 0.0, 9.0), 0), (4, STAR, 0, (0.0, 19.0, 9.0), 4)),
    ],
)
def test_each_kind_of_fence_is_where_its_parameters_say(
    kinds: int, items: Sequence[PlanItem], options: int, place: Vector, found: int
) -> None:
    it = Rig(FENCE_ENABLE=1.0, FENCE_TYPE=float(kinds), FENCE_OPTIONS=float(options))
    it.simulation.plans[PlanKind.FENCE] = tuple(items)
    fence = Fence(it.autopilot.parameters, it.autopilot.plans)
    there = EARTH.place(place[0], place[1], -place[2])
    assert fence.outside(there, HOME, EARTH) == found


@pytest.mark.parametrize(("action", "mode"), [(0, "GUIDED"), (1, "RTL"), (2, "LAND"), (4, "BRAKE")])
def test_outside_of_an_inclusion_the_action_is_a_parameter(action: int, mode: str) -> None:
    it = fenced(*polygon(50.0, 90.0, 90.0 + 40.0j), FENCE_ACTION=action)
    begun_s = it.now_s
    assert it.run(1.0).mode == mode
    assert it.when("Polygon fence breached") == [approx(begun_s + 0.1, abs=0.1)]
    assert it.set_mode("GUIDED") == ACCEPTED  # it can be had again
    assert (it.run(1.0).mode, it.status.fence[0]) == ("GUIDED", 1)
    it.command(207, 0)  # off
    assert not it.run(0.2).status.fence[0]
    it.command(207, 1)
    assert it.run(0.2).status.fence == (1, 2)  # counted once each time that it begins


def test_outside_of_its_fence_or_in_a_mode_for_the_air_it_is_not_armed_and_says_why() -> None:
    it = Rig(FENCE_ENABLE=1.0, FENCE_TYPE=4.0).armable()
    for mode in ("RTL", "LAND", "BRAKE"):
        assert [it.set_mode(mode), it.arm()] == [ACCEPTED, FAILED]
        assert it.texts()[-1] == f"Arm: {mode} mode not armable"
    it.simulation.plans[PlanKind.FENCE] = (circle(0.0, 50.0),)
    assert [it.set_mode("GUIDED"), it.arm()] == [ACCEPTED, FAILED]
    assert it.texts()[-1] == "Arm: Vehicle breaching Polygon"
    it.command(207, 0)  # off
    assert it.arm() == ACCEPTED


def test_the_floor_comes_with_the_height_is_breached_from_above_and_goes_with_the_landing() -> None:
    it = fenced(kinds=8.0, FENCE_ALT_MIN=15.0)
    lands = it.copy()
    while it.height_m > 15.0:
        assert not it.status.fence[0]
        it.aim(None, (0.0, 0.0, 1.5))
        it.step()
    assert (it.run(0.2).mode, len(it.when("Min Alt fence breached"))) == ("RTL", 1)
    lands.set_mode("LAND")
    lands.until(lambda: lands.landed, 60.0)
    lands.take_off(12.0)  # not yet 2 m above it
    assert lands.when("Min Alt fence breached") == []


def test_a_target_beyond_it_is_dropped_without_a_word_and_a_planes_denied() -> None:
    it = fenced(circle(80.0, 15.0))
    texts = len(it.texts())
    for north_m in (40.0, 80.0):
        it.aim((north_m, 0.0, -30.0))
        assert it.autopilot.target_echo().position == approx((40.0, 0.0, -30.0), abs=0.1)
    assert len(it.texts()) == texts
    rig = circling(FENCE_ENABLE=1.0, FENCE_TYPE=2.0, FENCE_RADIUS=400.0)
    assert rig.reposition(900.0, 0.0, 80.0) == DENIED
    assert rig.command(43002, 0.0, 0.0, 3.0) == ACCEPTED  # a course
    rig.until(lambda: rig.mode == "RTL")
    assert math.hypot(*rig.ne_m) == approx(400.0, abs=5.0)


# --- PX4's ----------------------------------------------------------------------------------------

OUTSIDE = "Geofence: approaching or outside geofence\t"


def px4_fenced(**parameters: float) -> Rig:
    """With an exclusion of 20 m, 60 m to the north."""
    rig = hover(**parameters)
    rig.send(heartbeat(6), source=GCS)
    rig.simulation.plans[PlanKind.FENCE] = (item(PLACE, 5004, 60.0, 0.0, 0.0, 20.0, frame=6),)
    return rig


@pytest.mark.parametrize(
    ("limit", "velocity"),
    [("GF_MAX_HOR_DIST", (3.0, 0.0, 0.0)), ("GF_MAX_VER_DIST", (0.0, 0.0, -1.5))],
)
def test_beyond_the_cylinder_about_home_it_does_what_gf_action_says(
    limit: str, velocity: Vector
) -> None:
    rig = px4_fenced(GF_ACTION=3.0, **{limit: 20.0})
    assert rig.stream(3.0, (0.0, 0.0, -15.0)).mode == "Offboard"
    assert rig.stream(8.0, None, velocity).mode == "Return"
    assert rig.texts().count(OUTSIDE) == 1


def test_a_breach_holds_until_another_command_and_a_place_in_it_is_refused() -> None:
    rig, stream = px4_fenced(), (None, (4.0, 0.0, 0.0))
    assert rig.reposition(60.0, 0.0, 15.0) == DENIED
    rig.until(lambda: rig.stream(0.05, *stream).ned_m[0] > 40.0)
    for seconds in (1.0, 8.0):
        assert rig.stream(seconds, *stream).mode == "Hold"
        assert rig.texts().count(OUTSIDE) == 1
    inside_m = rig.ned_m[0] - 40.0
    assert inside_m == approx(5.0, abs=1.5)
    assert rig.set_mode("Offboard") == ACCEPTED
    rig.stream(3.0, None, (8.0, 0.0, 0.0))
    assert 8.0 < rig.ned_m[0] - 40.0 - inside_m < 24.0
