"""Vehicles that cannot stop: they hold on circles, and are sent to points ahead of them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planning import TERRAIN, ask, column_distance_m, fly, leg_of, limits, spline

from companion.planner.offline import OfflineFlight
from companion.planner.plan import plan
from companion.planner.procedure import Leg, Reference, follow, may_leave, off_path_m, sent_pose
from companion.planner.request import Planned
from companion.planner.settings import PlannerSettings, Task
from companion.world.known_map import KnownMap, empty_map
from companion.world.simulated import true_map
from companion.world.zones import CircleZone, PolygonZone, Zone

V, LOITER = 20.0, 80.0
LIMITS = limits(
    speed_m_s=V, acceleration_m_s2=2.0, climb_rate_m_s=2.5, turn_radius_m=110.0,
    climb_angle_rad=math.radians(6.0), dive_angle_rad=math.radians(7.0), floor_amsl_m=250.0,
    tracking_error_m=12.0, loiter_radius_m=LOITER,
)  # fmt: skip
SETTINGS = PlannerSettings(
    scan_range_m=2_400.0, safety_distance_m=50.0, planning_time_s=2.0, scan_time_s=1.0,
    evaluations=250,
)  # fmt: skip
CORNERS = ((200.0, 200.0), (200.0, 7_800.0), (7_800.0, 7_800.0), (7_800.0, 200.0))
ZONES: tuple[Zone, ...] = (
    PolygonZone(name="area", vertices_ne_m=CORNERS, keep_in=True),
    CircleZone(name="c", north_m=3_300.0, east_m=4_300.0, radius_m=350.0),
)
TASK = Task(limits=LIMITS, settings=SETTINGS, zones=ZONES)
REQUIRED_M = 67.0  # d_s 50 m, tracking 12 m, navigation 5 m


@pytest.fixture(scope="module")
def truth() -> KnownMap:
    return true_map(TERRAIN, empty_map(TASK.cell_m, LIMITS.north_m, LIMITS.east_m))


@pytest.fixture(scope="module")
def flight(truth: KnownMap) -> OfflineFlight:
    return fly(TASK, truth, (1_000.0, 1_200.0, 500.0), (6_500.0, 6_300.0), seed=3)


def test_a_plane_arrives_and_may_circle_anywhere_on_its_way(
    flight: OfflineFlight, truth: KnownMap
) -> None:
    assert flight.failure is None
    assert flight.legs[-1].reaches_target
    turn, radii = np.linspace(0.0, math.tau, 48), LOITER * np.array([[0.0], [0.5], [1.0]])
    ring = np.stack([radii * np.cos(turn), radii * np.sin(turn), 0.0 * radii * turn], axis=-1)
    for planned in flight.plans:
        assert planned.certificate.proven
        for at in spline(planned.subpath.control_nea_m)(np.linspace(0.0, 1.0, 13)):
            circle = at + ring.reshape(-1, 3)
            assert column_distance_m(truth, circle, 300.0).min() >= REQUIRED_M
            assert math.dist(at[:2], (3_300.0, 4_300.0)) >= 350.0 + REQUIRED_M + LOITER - 1e-6
            inside_m = min(at[0] - 200.0, 7_800.0 - at[0], at[1] - 200.0, 7_800.0 - at[1])
            assert inside_m >= REQUIRED_M + LOITER - 1e-6


@pytest.mark.parametrize("aside_m", [0.0, 350.0, 450.0])
def test_the_way_out_of_a_new_zone_ends_where_the_whole_circle_is_clear(
    truth: KnownMap, aside_m: float
) -> None:
    zone = CircleZone(name="new", north_m=1_500.0, east_m=3_000.0, radius_m=400.0)
    outcome = plan(ask(replace(TASK, zones=(zone,)), truth, (1_500.0 + aside_m, 3_000.0, 600.0)))
    assert isinstance(outcome, Planned)
    assert outcome.evaluations == 0
    end = outcome.subpath.control_nea_m[-1]
    assert math.dist(end[:2], (1_500.0, 3_000.0)) >= 400.0 + LOITER + REQUIRED_M


# --- where the plane is on its path


def a_leg(turn_rad: float = 1.2) -> Leg:
    """1,500 m that turn so far to the right."""
    bearing = turn_rad * np.linspace(0.25, 1.0, 4)
    steps = np.stack([np.cos(bearing), np.sin(bearing), np.full(4, 0.02)], axis=-1)
    control = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]) * 375.0
    return leg_of(control + np.array([1_000.0, 1_000.0, 400.0]), rules=TASK)


@given(at=st.floats(0.05, 0.95), aside_m=st.floats(-90.0, 90.0), turn=st.floats(-2.0, 2.0))
def test_the_reference_is_the_nearest_point_of_the_path(
    at: float, aside_m: float, turn: float
) -> None:
    leg = a_leg(turn)
    length_m = at * leg.subpath.length_m
    pose = leg.subpath.pose(length_m)
    across = np.array([-pose.tangent_nea[1], pose.tangent_nea[0], 0.0])
    vehicle = pose.position_nea_m + aside_m * across / np.linalg.norm(across)
    reference = follow(Reference(length_m=max(length_m - 40.0, 0.0)), leg, vehicle)
    assert reference.length_m == pytest.approx(length_m, abs=0.5)
    assert off_path_m(reference, leg, vehicle) == pytest.approx(abs(aside_m), abs=0.5)


def test_the_reference_never_goes_back_nor_jumps_and_comes_to_the_end() -> None:
    leg, reference, rng = a_leg(), Reference(), np.random.default_rng(3)
    length_m = leg.subpath.length_m
    for at_m in np.arange(-30.0, length_m + 60.0, 4.0):
        pose, on_leg_m, last_m = leg.subpath.pose(at_m), np.clip(at_m, 0.0, length_m), reference
        beyond = (at_m - on_leg_m) * pose.tangent_nea + rng.normal(0.0, 6.0, 3)
        reference = follow(reference, leg, pose.position_nea_m + beyond)
        assert reference.length_m >= last_m.length_m
        assert reference.length_m == pytest.approx(on_leg_m, abs=45.0)
        assert reference.speed_m_s == V
    assert reference.length_m == length_m
    control = [[0, 0, 400.0], [1_500, 0, 400], [1_500, 60, 400], [0, 60, 400]]
    hairpin = leg_of(control, rules=TASK)
    reference = Reference(length_m=200.0)
    for at_m in np.arange(200.0, 700.0, 2.0):  # where the path comes near to itself
        other_side = hairpin.subpath.pose(at_m).position_nea_m + np.array([0.0, 35.0, 0.0])
        reference = follow(reference, hairpin, other_side)
        assert reference.length_m <= at_m + LIMITS.turn_radius_m + 5.0 * V


def test_the_point_that_is_sent_runs_over_onto_the_next_leg_and_stays_at_an_end() -> None:
    leg = a_leg()
    over_m, end_m = leg.successor_at_m, leg.subpath.length_m
    over = leg.subpath.pose(over_m)
    control = over.position_nea_m + np.outer([0.0, 0.3, 0.6, 1.0], 900.0 * over.tangent_nea)
    next_leg = leg_of(control, number=2, rules=TASK)
    for from_m, then, lead_m, place in (
        (over_m - 60.0, next_leg, 110.0, next_leg.subpath.pose(50.0)),
        (over_m - 60.0, next_leg, 40.0, leg.subpath.pose(over_m - 20.0)),
        (end_m - 20.0, None, 110.0, leg.subpath.pose(end_m)),
    ):
        sent = sent_pose(Reference(length_m=from_m), leg, then, lead_m)
        assert sent.point_nea_m == pytest.approx(place.point_nea_m)


@pytest.mark.parametrize("share", [0.0, 0.5])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_plane_leaves_its_circle_once_in_a_turn_and_joins_the_path_within_its_circle(
    share: float, sense: float
) -> None:
    """A point mass that turns at most at LOITER / 2 flies to the point ahead of it (L1's aim).

    About the start of a leg, or, taken over late, about any other point of it.
    """
    leg = a_leg(turn_rad=0.6)
    for first in np.linspace(0.0, math.tau, 3, endpoint=False).tolist():
        widest = widest_m(leg, share * leg.subpath.length_m, sense, first)
        assert widest <= LOITER + LIMITS.tracking_error_m


def widest_m(leg: Leg, at_m: float, sense: float, angle: float) -> float:
    """How far off the path the plane comes once it has left the circle."""
    start, step_s = leg.subpath.pose(at_m).position_nea_m, 0.1
    for _ in range(math.ceil(2.2 * math.pi * LOITER / V / step_s)):
        angle += sense * V / LOITER * step_s
        here = start + LOITER * np.array([math.cos(angle), math.sin(angle), 0.0])
        course = angle + sense * math.pi / 2.0
        velocity = (V * math.cos(course), V * math.sin(course), 0.0)
        if may_leave(leg, at_m, (here[0], here[1], here[2]), velocity):
            break
    else:
        pytest.fail("it never left its circle")
    reference, widest = Reference(length_m=at_m), 0.0
    for _ in range(400):
        reference = follow(reference, leg, here)
        if leg.subpath.length_m - reference.length_m < 1.2 * LOITER:
            break  # it circles the end
        aim = sent_pose(reference, leg, None, TASK.envelope.lead_m).position_nea_m - here
        error = math.remainder(math.atan2(aim[1], aim[0]) - course, math.tau)
        most = V / (LOITER / 2.0) * step_s
        course += min(max(error, -most), most)
        here = here + V * step_s * np.array([math.cos(course), math.sin(course), 0.0])
        nearest = leg.subpath.pose(reference.length_m).point_nea_m
        widest = max(widest, math.dist(nearest[:2], here[:2]))
    return widest


@pytest.mark.parametrize(("off_m", "leaves"), [(0.5 * LOITER, True), (91.0, True), (93.0, False)])
def test_a_plane_that_is_not_on_its_circle_does_not_leave_it(off_m: float, leaves: bool) -> None:
    """It would be off its path at once; the way it flies does not matter."""
    leg = a_leg()
    pose = leg.subpath.pose(0.0)
    (north, east, _), (n, e, up) = pose.tangent_nea.tolist(), pose.point_nea_m
    place, velocity = (n - off_m * east, e + off_m * north, up), (V * north, V * east, 0.0)
    assert may_leave(leg, 0.0, place, velocity) is leaves
