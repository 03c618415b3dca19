import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planning import LARGE as LIMITS

from companion.path.envelope import ending_m_s, slowing_m
from companion.planner.settings import PlannerSettings, Task
from companion.profiles import FLIGHT, PAPER

ENVIRONMENT_1 = Task(
    limits=LIMITS,
    settings=PlannerSettings(
        scan_range_m=20_000.0, safety_distance_m=500.0, planning_time_s=5.0, scan_time_s=4.0
    ),
)


def test_the_profile_of_the_paper_is_the_papers() -> None:
    papers = replace(ENVIRONMENT_1, settings=replace(ENVIRONMENT_1.settings, profile=PAPER))
    assert papers.cell_m == 250.0  # R / 80
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


@given(
    task=tasks, share=st.floats(0.05, 1.5), loiter_m=st.sampled_from([0.0, 900.0]),
    amsl_m=st.floats(2_000.0, 5_000.0),
)  # fmt: skip
def test_a_slower_leg_turns_with_the_same_lateral_acceleration_and_planes_are_never_slower(
    task: Task, share: float, loiter_m: float, amsl_m: float
) -> None:
    """A floor may be raised and is never lowered."""
    low, high = task.band_amsl_m
    assert task.no_lower_than(amsl_m).band_amsl_m == pytest.approx((max(low, amsl_m), high))
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


@given(task=tasks)
def test_who_is_left_alone_near_the_end_of_sight_stays_over_ground_that_was_scanned(
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
