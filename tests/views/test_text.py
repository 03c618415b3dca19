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
from companion.views.text import clearance_text, flight_table, mission_summary, plans_table
from companion.views.words import at_least, at_most, counted, metres_at_least, number
from companion.world.known_map import empty_map

HILLS = load_mission("environment-1")
PROVEN = replace(certificate(), clearance_m=612.4, turn_radius_m=math.inf, radar_m=250.0)
UNPROVEN = replace(PROVEN, broken=("turn radius",))


def planned(proof: Certificate, cost: float) -> Planned:
    """A straight plan, 15 km long."""
    limits = HILLS.task.limits
    unknown = empty_map(HILLS.task.cell_m, limits.north_m, limits.east_m)
    request = ask(HILLS.task, unknown, (0.0, 0.0, 3030.0), target_ne_m=(9_000.0, 12_000.0))
    return replace(made_up.planned(request, 15_000.0), certificate=proof, cost=cost)


def rows(table: Table) -> list[str]:
    """The lines of a table as printed, with single spaces."""
    console = Console(width=200)
    with console.capture() as captured:
        console.print(table)
    return [" ".join(line.split()) for line in captured.get().splitlines()]


def flown(*plans: Planned) -> FlightSummary:
    flight = FlightSummary(session=Session(HILLS, seed=1, lockstep=True))
    flight.plans += plans
    flight.end = End(outcome=Outcome.ARRIVED, reason="target reached", remedy="")
    return flight


def known_but_for(cells: int) -> Mission:
    """Of ten thousand."""
    known = empty_map(50.0, (0.0, 5_000.0), (0.0, 5_000.0))
    upper_m = np.full(known.upper_m.shape, 100.0)
    upper_m.flat[:cells] = np.inf
    return replace(load_mission("sitl-arducopter"), known=replace(known, upper_m=upper_m))


SOUTH = "3,000 m south, 2,000 m west of the origin (3,606 m straight from there)"


@pytest.mark.parametrize(
    ("mission", "words"),
    [
        (HILLS, "100.0 km north, 100.0 km east"),
        (replace(HILLS, targets_ne_m=((-3_000.0, -2_000.0),)), SOUTH),
        (HILLS, "proven safe before it is flown"),
        (load_mission("environment-1", "paper"), "flown unproven"),
        (replace(HILLS, scanner_complete=False), "nothing bounds"),
        (known_but_for(0), "Terrain of 100.0% of the map"),
        (known_but_for(1), "Terrain of 99.9% of the map"),
        (known_but_for(9_999), "Terrain of 0.0% of the map"),
    ],
)
def test_a_mission_in_words_says_where_it_goes_and_what_is_known_and_proven(
    mission: Mission, words: str
) -> None:
    assert words in " ".join(mission_summary(mission).split())
    assert "nothing bounds" not in mission_summary(HILLS)


@given(st.floats(0.0, 30_000.0))
def test_no_clearance_looks_larger_than_it_is_nor_much_smaller(clear_m: float) -> None:
    for said in (
        clearance_text(replace(PROVEN, clearance_m=clear_m)),
        metres_at_least(clear_m),
        f"{at_least(clear_m, 1)} m",
    ):
        number, unit = said.replace(",", "").split()
        told_m = float(number) * {"m": 1.0, "km": 1000.0}[unit]
        assert 0.98 * clear_m - 0.1 <= told_m <= clear_m + 1e-5
        assert told_m == pytest.approx(clear_m, rel=0.02, abs=1.0)


def test_what_is_not_known_or_has_no_bound_is_a_dash_and_one_thing_is_no_several() -> None:
    assert [number(each) for each in (None, math.inf, math.nan, -0.2, 1234.6)] == [
        *("–", "–", "–", "0", "1,235")
    ]
    assert [at_most(each) for each in (0.0, 0.1, 99.0)] == ["0", "1", "99"]
    assert [counted(each, "radar") for each in (0, 1, 2)] == ["0 radars", "1 radar", "2 radars"]


def test_a_flight_is_as_near_to_the_terrain_as_its_nearest_leg_and_costs_the_sum_of_all() -> None:
    near, far = planned(PROVEN, 3.25), planned(replace(PROVEN, clearance_m=1_040.0), 3.5)
    for order in ((near, far), (far, near)):
        table = " ".join(rows(flight_table(flown(*order))))
        assert "1,040 m" not in table
        for words in ("612 m", "6.8", "500 m", "arrived"):  # 3.25 + 3.5; 250 m in range, twice
            assert words in table


@pytest.mark.parametrize(
    ("name", "outcome", "passed"),
    [
        ("sitl-arduplane", Outcome.ARRIVED, True),
        ("sitl-arduplane", Outcome.FAILED, False),
        ("sitl-arducopter", Outcome.ARRIVED, False),
    ],
)
def test_a_plane_that_has_arrived_has_passed_its_target(
    name: str, outcome: Outcome, passed: bool
) -> None:
    session = Session(load_mission(name), seed=1, lockstep=True)
    flight = FlightSummary(session=session, passed_m=12.34)
    flight.end = End(outcome=outcome, reason="", remedy="")
    assert ("passed the target at │ 12.3 m" in " ".join(rows(flight_table(flight)))) is passed


def test_every_plan_has_a_row_with_its_clearance_if_it_is_proven() -> None:
    table = plans_table((planned(PROVEN, 1.0), planned(UNPROVEN, 2.0)))
    first, second = (line for line in rows(table) if "15.0 km" in line)
    assert "612 m" in first
    assert "straight" in first
    assert "not proven" in second
