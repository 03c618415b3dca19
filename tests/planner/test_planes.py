"""Vehicles that cannot stop: they hold on circles, and are sent to points ahead of them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planning import leg_of, limits

from companion.planner.procedure import Leg, Reference, follow, may_leave, sent_pose
from companion.planner.settings import PlannerSettings, Task

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
TASK = Task(limits=LIMITS, settings=SETTINGS)


# --- where the plane is on its path


def a_leg(turn_rad: float = 1.2) -> Leg:
    """1,500 m that turn so far to the right."""
    bearing = turn_rad * np.linspace(0.25, 1.0, 4)
    steps = np.stack([np.cos(bearing), np.sin(bearing), np.full(4, 0.02)], axis=-1)
    control = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]) * 375.0
    return leg_of(control + np.array([1_000.0, 1_000.0, 400.0]), rules=TASK)


@given(seed=st.integers(0, 10**6), turn=st.floats(-2.0, 2.0), aside_m=st.floats(-80.0, 80.0))
def test_the_reference_is_the_nearest_point_of_the_path_never_goes_back_and_comes_to_its_end(
    seed: int, turn: float, aside_m: float
) -> None:
    """Of a plane that flies so far beside it, from before its start to beyond its end."""
    leg, reference, rng = a_leg(turn), Reference(), np.random.default_rng(seed)
    length_m = leg.subpath.length_m
    for at_m in np.arange(-30.0, length_m + 60.0, 20.0):
        pose, last_m = leg.subpath.pose(at_m), reference.length_m
        across = np.array([-pose.tangent_nea[1], pose.tangent_nea[0], rng.normal(0.0, 0.05)])
        beyond = (at_m - np.clip(at_m, 0.0, length_m)) * pose.tangent_nea
        vehicle = pose.position_nea_m + beyond + aside_m * across
        reference = follow(reference, leg, vehicle)
        assert reference.length_m >= last_m
        assert reference.length_m == pytest.approx(np.clip(at_m, 0.0, length_m), abs=3.0)
        assert reference.speed_m_s == V
    assert reference.length_m == length_m


def test_where_a_path_comes_near_to_itself_it_is_not_cut_short() -> None:
    control = [[0, 0, 400.0], [1_500, 0, 400], [1_500, 60, 400], [0, 60, 400]]
    hairpin, reference = leg_of(control, rules=TASK), Reference(length_m=200.0)
    for at_m in np.arange(200.0, 700.0, 2.0):
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
