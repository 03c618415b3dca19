"""Missions, flights and plans in words: nothing looks safer, or better known, than it is."""

import math
from dataclasses import replace

import made_up
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import certificate
from planning import ask
from rich.console import Console
from rich.table import Table

from companion.config import load_mission
from companion.mission.events import End, Outcome
from companion.mission.mission import Mission
from companion.path.certificate import Certificate
from companion.planner.request import Planned
from companion.session import Session
from companion.telemetry.flight_summary import FlightSummary
from companion.views.page import at_least
from companion.views.text import clearance_text, flight_table, mission_summary, plans_table
from companion.views.words import metres_at_least
from companion.world.known_map import empty_map

HILLS = load_mission("environment-1")
NOTHING_KNOWN = empty_map(HILLS.task.cell_m, HILLS.task.limits.north_m, HILLS.task.limits.east_m)
PROVEN = replace(certificate(), clearance_m=612.4, turn_radius_m=2_600.0, radar_m=250.0)
UNPROVEN = replace(PROVEN, broken=("turn radius",))
START_NEA_M, TARGET_NE_M, LENGTH_M = (0.0, 0.0, 3030.0), (9_000.0, 12_000.0), 15_000.0


def planned(proof: Certificate, cost: float) -> Planned:
    """A straight plan, 15 km long."""
    request = ask(HILLS.task, NOTHING_KNOWN, START_NEA_M, target_ne_m=TARGET_NE_M)
    return replace(made_up.planned(request, LENGTH_M), certificate=proof, cost=cost)


def rows(table: Table) -> list[str]:
    """The lines of a table as printed, with single spaces."""
    console = Console(width=200)
    with console.capture() as captured:
        console.print(table)
    return [" ".join(line.split()) for line in captured.get().splitlines()]


def flown(*plans: Planned, mission: str = "environment-1") -> FlightSummary:
    flight = FlightSummary(session=Session(load_mission(mission), seed=1, lockstep=True))
    flight.plans += plans
    flight.end = End(outcome=Outcome.ARRIVED, reason="target reached", remedy="")
    return flight


@pytest.mark.parametrize(
    ("mission", "words"),
    [
        (HILLS, "100.0 km north, 100.0 km east"),
        (
            replace(HILLS, targets_ne_m=((-3_000.0, -2_000.0),)),
            "3,000 m south, 2,000 m west of the origin (3,606 m straight from there)",
        ),
        (HILLS, "proven safe before it is flown"),
        (load_mission("environment-1", "paper"), "flown unproven"),
        (replace(HILLS, scanner_complete=False), "nothing bounds"),
    ],
)
def test_a_mission_in_words_says_where_it_goes_and_what_is_proven(
    mission: Mission, words: str
) -> None:
    assert words in " ".join(mission_summary(mission).split())
    assert "nothing bounds" not in mission_summary(HILLS)


@pytest.mark.parametrize(("holes", "share"), [(0, "100%"), (1, "99.9%"), (9_999, "0%")])
def test_a_map_with_a_hole_is_not_known_whole(holes: int, share: str) -> None:
    known = empty_map(50.0, (0.0, 5_000.0), (0.0, 5_000.0))
    upper_m = np.full(known.upper_m.shape, 100.0)
    assert upper_m.size == 10_000
    upper_m.flat[:holes] = np.inf
    mission = replace(load_mission("sitl-arducopter"), known=replace(known, upper_m=upper_m))
    words = mission_summary(mission)
    assert f"Terrain of {share} of the map" in words


@given(st.floats(0.0, 30_000.0))
def test_no_clearance_looks_larger_than_it_is(clear_m: float) -> None:
    for said in (
        clearance_text(replace(PROVEN, clearance_m=clear_m)),
        metres_at_least(clear_m),
        f"{at_least(clear_m, 1)} m",
    ):
        number, unit = said.replace(",", "").split()
        told_m = float(number) * {"m": 1.0, "km": 1000.0}[unit]
        assert told_m <= clear_m + 1e-5
        assert told_m == pytest.approx(clear_m, rel=0.02, abs=1.0)


def test_a_flight_is_as_near_to_the_terrain_as_its_nearest_leg_and_costs_the_sum_of_all() -> None:
    near, far = planned(PROVEN, 3.25), planned(replace(PROVEN, clearance_m=1_040.0), 3.5)
    for order in ((near, far), (far, near)):
        table = " ".join(rows(flight_table(flown(*order))))
        assert "1,040 m" not in table
        for words in ("612 m", "6.8", "500 m", "arrived"):  # 3.25 + 3.5; 250 m in range, twice
            assert words in table


def test_times_since_a_restart_plans_cut_by_time_and_a_plane_that_passes_have_rows() -> None:
    flight = flown(mission="sitl-arduplane")
    assert not [row for row in rows(flight_table(flight)) if "cost" in row or "cut by" in row]
    flight.session.clock.read(900.0, 0.0)
    flight.session.clock.read(1_020.0, 120.0)
    flight.elapsed_s, flight.resumed, flight.out_of_time, flight.passed_m = 60.0, True, 93, 9.8
    told = rows(flight_table(flight))
    assert [row.split()[-3] for row in told if "since it was" in row] == ["120.0", "60.0"]
    [cut] = [row for row in told if "cut by time" in row]
    assert "93: raise planner.planning_time_s, or use a faster computer" in cut
    [passed] = [row for row in told if "passed the target at" in row]
    assert "9.8 m" in passed


def test_every_plan_has_a_row_with_its_clearance_if_it_is_proven() -> None:
    plans = planned(replace(PROVEN, turn_radius_m=math.inf), 1.0), planned(UNPROVEN, 2.0)
    first, second = (row for row in rows(plans_table(plans)) if "15.0 km" in row)
    assert "612 m" in first
    assert "straight" in first
    assert "not proven" in second
