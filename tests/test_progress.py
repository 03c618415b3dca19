"""A mission ends: design 6, and the argument in `planner.progress`."""

from dataclasses import replace

import planning
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.campaign import families
from companion.planner.progress import SLACK, Progress
from companion.world.simulated import true_map

R_M, ALLOWED_M = 1_000.0, 300.0


@given(st.lists(st.tuples(st.floats(200.0, 900.0), st.floats(0.0, 400.0)), min_size=20))
def test_between_records_no_more_is_paid_than_way_is_gained_and_a_stop_costs(
    legs: list[tuple[float, float]],
) -> None:
    progress, left_m, paid_m, records, least_m = Progress(), 1e5, 0.0, 0, 1e9
    for cost_m, excess_m in legs:
        records, least_m = records + (left_m < least_m), min(left_m, least_m)
        progress = progress.at(left_m, 0.0, seen=1, few=0.0)
        if (owed_m := progress.owing(excess_m, R_M)) > ALLOWED_M:
            break  # it stops
        left_m, paid_m = left_m - cost_m + excess_m, paid_m + cost_m
        progress = replace(progress, owed_m=owed_m, expected_m=left_m)
    assert paid_m <= 1e5 - left_m + len(legs) * SLACK * R_M + records * ALLOWED_M + 1e-6


@pytest.mark.parametrize(("seed", "index", "most"), [(555001, 7, 30), (20261128, 24, 20)])
def test_no_loop_is_flown_again_and_again(seed: int, index: int, most: int) -> None:
    """Legs: 33 before excess was counted, then 18; 29 before guesses were given up, then 11."""
    world = families.world("gathered", seed, index)
    truth = true_map(world.terrain, families.unseen(world))
    flight = planning.fly(world.task, truth, world.start_nea_m, *world.targets_ne_m)
    assert flight.failure is None
    assert len(flight.legs) <= most
