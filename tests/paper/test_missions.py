import numpy as np
import pytest

from companion.paper.compare.missions import Run, bundled_case, fly, planned_with
from companion.profiles import PAPER


@pytest.fixture(scope="module")
def flown() -> Run:
    case = bundled_case("environment-1")
    return fly(
        planned_with(case, optimiser="improved-de", planning_time_s=3.0, evaluations=600, seed=1)
    )


@pytest.mark.parametrize("planning_time_s", [3.0, 5.0])
def test_a_scan_is_taken_l_before_the_end_by_equation_4(planning_time_s: float) -> None:
    case = planned_with(
        bundled_case("environment-1"),
        optimiser="pso",
        planning_time_s=planning_time_s,
        evaluations=100,
        seed=3,
    )
    task = case.task
    assert task.settings.profile is PAPER
    # L = V T + d_s, with V = 150 m/s and d_s = 500 m
    assert task.scan_distance_m == pytest.approx(150.0 * planning_time_s + 500.0)
    assert task.tail_m == 500.0
    assert (task.settings.optimiser, task.settings.evaluations, case.seed) == ("pso", 100, 3)


def test_a_route_leads_from_the_start_to_the_target_without_a_gap(flown: Run) -> None:
    assert flown.arrived
    route = flown.route_nea_m
    assert route[0] == pytest.approx(bundled_case("environment-1").start_nea_m)
    assert route[-1, :2] == pytest.approx([100_000.0, 100_000.0])
    steps = np.linalg.norm(np.diff(route, axis=0), axis=1)
    assert steps.max() < 110.0
    assert steps.sum() == pytest.approx(flown.length_m, rel=1e-3)
    assert flown.length_m > np.hypot(1e5, 1e5)
    assert len(flown.scans_nea_m) == flown.legs


def test_the_fitness_from_start_to_target_holds_at_least_the_length_of_the_route(
    flown: Run,
) -> None:
    # a1 f1 = 0.1 x 100 for 2.4 R of control polygon, which is no shorter than its curve
    least = 0.1 * 100.0 * flown.length_m / (2.4 * 20_000.0)
    assert least < flown.cost < 2.0 * least
