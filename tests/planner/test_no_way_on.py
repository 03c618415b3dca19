"""A mission that gets nowhere ends: a ridge whose gap the map shows, and no proof does.

The ridge is 6 km high, in cells of 250 m.  Through a gap of 2,332 m a path can be proven just below
the ceiling, through one of 2,282 m none; guidance, which knows no turns, leads through both.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from planning import LARGE, ask, hills
from planning import TASK as SMALL
from planning import TRUTH as KNOWN

from companion.planner.plan import plan
from companion.planner.progress import Progress
from companion.planner.request import NotPlanned, Planned, PlanRequest, Refusal
from companion.planner.settings import PlannerSettings, Task
from companion.world.known_map import empty_map
from companion.world.simulated import true_map

LIMITS = replace(
    LARGE, north_m=(30e3, 100e3), east_m=(10e3, 50e3), tracking_error_m=15.0,
    floor_amsl_m=2_978.0, ceiling_amsl_m=5_022.0, climb_angle_rad=math.radians(10.0),
)  # fmt: skip
SETTINGS = PlannerSettings(scan_range_m=20e3, safety_distance_m=480.0, planning_time_s=5.0)
TASK = Task(limits=LIMITS, settings=SETTINGS)
RANGE_M = SETTINGS.scan_range_m
MOUTH = (49_375.0, 30_000.0, 4_710.0)  # as high as it comes in front of the gap


def at_the_mouth(
    gap_m: float, *, owed_m: float, start_nea_m: tuple[float, float, float] = MOUTH
) -> PlanRequest:
    """The question of a vehicle that hovers there, sees all and believes no guesses any more."""
    aside = np.arange(0.5 * gap_m, 20e3, 398.55)
    rows = [(50e3, 30e3 + east, 6_000.0, 800.0, 800.0) for east in (*aside, *-aside)]
    blank = empty_map(TASK.cell_m, LIMITS.north_m, LIMITS.east_m)
    seen = np.ones(blank.shape, dtype=bool)
    known = replace(blank, upper_m=true_map(hills(*rows), blank).upper_m, seen=seen, given=seen)
    owes = Progress(record_m=0.0, owed_m=owed_m, seen=seen.size, believed_below_m=0.0)
    return ask(TASK, known, start_nea_m, target_ne_m=(90e3, 30e3), progress=owes)


def test_who_owes_more_than_a_way_round_all_in_sight_is_told_that_no_way_on_was_found() -> None:
    """With less it looks elsewhere first, for far more than was promised."""
    looks = plan(at_the_mouth(2_282.0, owed_m=0.0))
    assert isinstance(looks, Planned)
    assert looks.progress.owed_m > RANGE_M
    told = plan(at_the_mouth(2_282.0, owed_m=math.tau * RANGE_M - looks.progress.owed_m + 1.0))
    assert isinstance(told, NotPlanned)
    assert told.refusal is Refusal.NO_WAY_PROVEN


def test_who_gets_on_flies_on_whatever_it_owes() -> None:
    owed_m = 2.0 * math.tau * RANGE_M
    through = plan(at_the_mouth(2_332.0, owed_m=owed_m))
    assert isinstance(through, Planned)
    assert through.subpath.control_nea_m[-1, 0] > MOUTH[0]
    assert through.progress.owed_m <= owed_m


@pytest.mark.parametrize("owed_m", [0.0, 300.0])
def test_a_way_out_of_what_is_too_near_pays_nothing_back(owed_m: float) -> None:
    """Else a mission that begins each round with one would go round for ever."""
    owes = Progress(record_m=5_000.0, owed_m=owed_m, expected_m=6_000.0, believed_below_m=4_000.0)
    out = plan(ask(SMALL, KNOWN, (2_300.0, 4_600.0, 600.0), progress=owes))
    assert isinstance(out, Planned)
    assert out.is_escape
    assert out.progress == owes
