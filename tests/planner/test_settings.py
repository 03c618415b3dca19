import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning import LARGE as LIMITS

from companion.path.envelope import ending_m_s, slowing_m
from companion.planner.settings import PlannerSettings, Task
from companion.profiles import FLIGHT, PAPER
from companion.world.columns import safe_surface
from companion.world.known_map import empty_map
from companion.world.radars import Radar

ENVIRONMENT_1 = Task(
    limits=LIMITS,
    settings=PlannerSettings(
        scan_range_m=20_000.0, safety_distance_m=500.0, planning_time_s=5.0, scan_time_s=4.0
    ),
)


def test_the_distances_of_environment_1_are_those_of_the_design_and_of_the_paper() -> None:
    task = ENVIRONMENT_1
    assert task.cell_m == 250.0  # R / 80
    motion = task.envelope
    stops_m = 150.0 * motion.settling_s + 150.0**2 / (2.0 * motion.braking_m_s2)
    assert stops_m + 500.0 < 3_000.0
    assert task.tail_m == 3_000.0  # 0.15 R
    assert task.shortest_scan_distance_m == 150.0 * (9.0 + 3 * 0.1) + 3_000.0
    assert task.scan_distance_m == task.shortest_scan_distance_m
    assert task.error_m == 15.0  # tracking 10 m, navigation 5 m
    assert task.required_clearance_m == 515.0  # d_s, and both
    papers = replace(task, settings=replace(task.settings, profile=PAPER))
    assert (PAPER.samples, PAPER.margin, PAPER.optimiser) == (10, 1.0, "improved-de")
    assert papers.tail_m == papers.search_clearance_m == 500.0
    assert papers.end_radius_m == 20_000.0  # on the range of the scan
    assert papers.band_amsl_m == (3_000.0, 5_000.0)


def changed(profile: Any, limits: dict[str, float], settings: dict[str, float]) -> Task:
    settled = replace(ENVIRONMENT_1.settings, profile=profile, **settings)
    return replace(ENVIRONMENT_1, limits=replace(LIMITS, **limits), settings=settled)


tasks = st.builds(
    changed,
    st.sampled_from([FLIGHT, PAPER]),
    st.fixed_dictionaries({
        "speed_m_s": st.floats(1.0, 300.0), "acceleration_m_s2": st.floats(0.5, 20.0),
        "dead_man_s": st.floats(0.0, 10.0), "tracking_error_m": st.floats(0.0, 60.0),
        "navigation_error_m": st.floats(0.0, 60.0),
    }),
    st.fixed_dictionaries({
        "scan_range_m": st.floats(100.0, 50_000.0), "safety_distance_m": st.floats(1.0, 600.0),
        "planning_time_s": st.floats(0.1, 20.0),
    }),
)  # fmt: skip


@given(task=tasks)
def test_the_scan_distance_keeps_equation_4_and_the_tail_holds_a_stop(task: Task) -> None:
    """And the search aims at more than the certificate asks for."""
    limits, settled = task.limits, task.settings
    d_s, speed = settled.safety_distance_m, limits.speed_m_s
    assert task.scan_distance_m >= speed * settled.planning_time_s + d_s
    assert task.tail_m >= d_s
    assert task.cell_m == int(task.cell_m) >= 1.0
    assert abs(task.cell_m - settled.scan_range_m / 80.0) <= 0.5 or task.cell_m == 1.0
    if settled.profile is FLIGHT:
        brakes_m = 0.5 * speed**2 / limits.acceleration_m_s2
        assert task.tail_m >= brakes_m + d_s - 1e-9
        # flying on for the dead man's time, and then braking
        assert task.tail_m >= speed * limits.dead_man_s + brakes_m - 1e-9
        error = limits.tracking_error_m + limits.navigation_error_m
        assert task.search_clearance_m >= task.required_clearance_m >= d_s
        assert 3_000.0 + error <= task.band_amsl_m[0]
        assert task.band_amsl_m[1] <= 5_000.0 - error


@given(task=tasks, amsl_m=st.floats(2_000.0, 5_000.0), reach_m=st.floats(0.0, 40e3))
def test_a_floor_is_raised_and_never_lowered_and_radars_within_reach_are_near(
    task: Task, amsl_m: float, reach_m: float
) -> None:
    low, high = task.band_amsl_m
    assert task.no_lower_than(amsl_m).band_amsl_m == pytest.approx((max(low, amsl_m), high))
    radar = Radar(name="r", centre_nea_m=(10e3, 5e3, 7e3), range_m=6e3)
    near = replace(task, radars=(radar,)).radars_near((1e3, -2e3), reach_m)
    assert near == ((radar,) if math.hypot(9e3, 7e3) - 6e3 <= reach_m else ())


@given(task=tasks, share=st.floats(0.05, 1.5), loiter_m=st.sampled_from([0.0, 900.0]))
def test_a_slower_leg_turns_with_the_same_lateral_acceleration_and_planes_are_never_slower(
    task: Task, share: float, loiter_m: float
) -> None:
    task = replace(task, limits=replace(task.limits, loiter_radius_m=loiter_m))
    limits, speed_m_s = task.limits, share * task.limits.speed_m_s
    slow = task.at_speed(speed_m_s)
    assert task.at_speed(None) is task
    if share >= 1.0 or loiter_m:
        assert slow is task
        return
    assert slow.limits.speed_m_s == speed_m_s
    sideways_m_s2 = limits.speed_m_s**2 / limits.turn_radius_m
    assert speed_m_s**2 / slow.limits.turn_radius_m == pytest.approx(sideways_m_s2)


@pytest.mark.parametrize("d_s", [20.0, 90.0])
@pytest.mark.parametrize("tracking", [2.0, 40.0])
@settings(max_examples=8)
@given(n=st.floats(-13.0, 13.0), e=st.floats(-13.0, 13.0), turn=st.floats(0.0, 1.0))
def test_at_the_end_of_a_subpath_the_ground_within_the_clearance_has_been_scanned(
    d_s: float, tracking: float, n: float, e: float, turn: float
) -> None:
    planner = PlannerSettings(scan_range_m=2_000.0, safety_distance_m=d_s, planning_time_s=2.0)
    task = Task(limits=replace(LIMITS, tracking_error_m=tracking), settings=planner)
    known = empty_map(25.0, (-3_000.0, 3_000.0), (-3_000.0, 3_000.0))
    north, east = known.middles_m()
    known.upper_m[np.hypot(north - n, east - e) <= 2_000.0] = 0.0  # as the radar answers
    clearance = max(task.required_clearance_m, d_s * FLIGHT.margin)
    surface = safe_surface(
        known, centre_ne_m=(n, e), reach_m=2_200.0, clearance_m=clearance, unknown_m=5_000.0
    )
    angle = np.linspace(0.0, 2.0 * math.pi, 50) + turn
    end_n, end_e = n + task.end_radius_m * np.cos(angle), e + task.end_radius_m * np.sin(angle)
    assert (surface.altitude_m(end_n, end_e) < 5_000.0).all()


@given(task=tasks)
def test_a_vehicle_that_is_left_alone_near_the_end_of_sight_stays_over_ground_that_was_scanned(
    task: Task,
) -> None:
    planner = replace(ENVIRONMENT_1.settings, safety_distance_m=task.settings.safety_distance_m)
    task = replace(task, settings=planner)
    speed, limits = min(task.limits.speed_m_s, 200.0), task.limits
    task = replace(task, limits=replace(limits, speed_m_s=speed))
    before_end_m = slowing_m(task.envelope, speed) * np.linspace(0.0, 1.0, 400) ** 2
    slowing = np.array([ending_m_s(task.envelope, left_m) for left_m in before_end_m.tolist()])
    brakes_m = slowing**2 / (2.0 * limits.acceleration_m_s2)
    beyond_m = slowing * limits.dead_man_s + brakes_m - before_end_m
    farthest_m = task.end_radius_m + beyond_m.max() + task.error_m
    cell_diagonal_m = math.hypot(task.cell_m, task.cell_m)  # a cell is seen by its middle
    assert farthest_m <= task.settings.scan_range_m - cell_diagonal_m
    assert task.end_radius_m + task.required_clearance_m <= 20_000.0 - cell_diagonal_m
