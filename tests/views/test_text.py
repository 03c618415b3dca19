import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from rich.table import Table

from companion.config import load_mission
from companion.mission.events import End, Outcome
from companion.path.certificate import Certificate
from companion.path.subpath import Subpath
from companion.planner.request import Planned
from companion.session import Session
from companion.telemetry.flight_summary import FlightSummary
from companion.views.page import at_least
from companion.views.text import clearance_text, flight_table, mission_summary, plans_table
from companion.views.words import metres_at_least
from companion.world.known_map import empty_map

PROVEN = Certificate(
    clearance_m=612.4,
    keep_out_m=math.inf,
    dead_man_m=150.0,
    required_clearance_m=515.0,
    required_contact_m=15.0,
    speed_m_s=150.0,
    turn_radius_m=2_600.0,
    climb_angle_rad=0.01,
    dive_angle_rad=0.0,
    lowest_amsl_m=3_022.0,
    highest_amsl_m=3_040.0,
    off_map_m=0.0,
    radar_m=250.0,
    detection=0.1,
    pieces=90,
    broken=(),
)
UNPROVEN = replace(PROVEN, broken=("turn radius",))


def planned(certificate: Certificate, cost: float) -> Planned:
    start, end = np.array([0.0, 0.0, 3030.0]), np.array([9_000.0, 12_000.0, 3030.0])
    return Planned(
        plan_id=1,
        kernel="numpy",
        subpath=Subpath(control_nea_m=np.linspace(start, end, 4)),
        reaches_target=False,
        cost=cost,
        to_go=20.0,
        terms={},
        certificate=certificate,
        guide_rad=0.0,
        route_ne_m=(),
        evaluations=3000,
        rank=0,
        tries=1,
    )


def shown(table: Table) -> str:
    console = Console(width=200)
    with console.capture() as captured:
        console.print(table)
    return captured.get()


def flown(*plans: Planned) -> FlightSummary:
    flight = FlightSummary(session=Session(load_mission("environment-1"), seed=1, lockstep=True))
    flight.plans += plans
    flight.end = End(outcome=Outcome.ARRIVED, reason="target reached", remedy="")
    return flight


def test_targets_are_told_by_their_distances_from_the_origin_to_a_metre_in_10_km() -> None:
    mission = replace(load_mission("environment-1"), targets_ne_m=((-3_000.0, -2_000.0),))
    words = mission_summary(mission)
    assert "3 km south, 2 km west of the origin (3.606 km straight from there)" in words
    assert "100 km north, 100 km east" in mission_summary(load_mission("environment-1"))


@pytest.mark.parametrize(
    ("holes", "share"), [(0, "100%"), (1, "99.9%"), (6, "99.9%"), (120, "98.8%"), (9_999, "0%")]
)
def test_a_map_with_a_hole_is_not_known_whole(holes: int, share: str) -> None:
    mission = load_mission("sitl-arducopter")
    known = empty_map(50.0, (0.0, 5_000.0), (0.0, 5_000.0))
    upper_m = np.full(known.upper_m.shape, 100.0)
    assert upper_m.size == 10_000
    upper_m.flat[:holes] = np.inf
    words = mission_summary(replace(mission, known=replace(known, upper_m=upper_m)))
    assert f"Terrain of {share} of the map" in words
    hectares = math.ceil(holes * 50.0**2 / 1e4)
    assert (f"(all but {hectares:,} ha)" in words) == (holes > 0)
    assert ("all but" in words) == (holes > 0)


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


def test_a_clearance_is_told_only_of_what_is_proven() -> None:
    assert clearance_text(PROVEN) == "612 m"
    assert clearance_text(UNPROVEN) == "not proven"


def test_a_flight_is_as_near_to_the_terrain_as_its_nearest_leg_and_costs_the_sum_of_all() -> None:
    near, far = planned(PROVEN, 3.25), planned(replace(PROVEN, clearance_m=1_040.0), 3.5)
    for order in ((near, far), (far, near)):
        table = shown(flight_table(flown(*order)))
        assert "612 m" in table
        assert "1,040 m" not in table
        assert "6.8" in table  # 3.25 + 3.5
        assert "500 m" in table  # 250 m within radar ranges, twice
        assert "arrived" in table


def test_times_of_a_flight_that_was_resumed_are_said_to_be_those_since_then() -> None:
    flight = flown()
    flight.session.clock.read(900.0, 0.0)
    flight.session.clock.read(1_020.0, 120.0)
    flight.elapsed_s = 60.0
    lines = shown(flight_table(flight)).splitlines()
    assert [line.split()[-3] for line in lines if " time " in line][:2] == ["120.0", "60.0"]
    assert "resumed" not in "".join(lines)
    flight.resumed = True
    rows = [line for line in shown(flight_table(flight)).splitlines() if "since it was" in line]
    assert len(rows) == 2


def test_plans_that_time_has_cut_are_told_with_the_remedy() -> None:
    flight = flown()
    assert "cut by time" not in shown(flight_table(flight))
    flight.out_of_time = 93
    [row] = [line for line in shown(flight_table(flight)).splitlines() if "cut by time" in line]
    assert "93: raise planner.planning_time_s, or use a faster computer" in row


def test_a_flight_without_a_plan_has_a_table_without_costs() -> None:
    table = shown(flight_table(flown()))
    assert "arrived" in table
    assert "cost" not in table


def test_every_plan_has_a_row_with_its_length_its_clearance_and_its_tightest_turn() -> None:
    straight = replace(PROVEN, turn_radius_m=math.inf)
    table = shown(
        plans_table((planned(PROVEN, 3.25), planned(straight, 1.0), planned(UNPROVEN, 2.0)))
    )
    rows = [line for line in table.splitlines() if "15.0 km" in line]
    assert len(rows) == 3
    for row, words in zip(rows, ("612 m", "straight", "not proven"), strict=True):
        assert words in row
    assert "2.6 km" in rows[0]


@pytest.mark.parametrize(
    ("profile", "words"),
    [("flight", "proven safe before it is flown"), ("paper", "flown unproven")],
)
def test_a_mission_in_words_says_whether_paths_are_proven(profile: str, words: str) -> None:
    assert words in mission_summary(load_mission("environment-1", profile))


def test_a_mission_in_words_says_what_an_incomplete_radar_proves() -> None:
    mission = load_mission("environment-1")
    assert "may miss ground" not in " ".join(mission_summary(mission).split())
    told = replace(mission, scanner_complete=False)
    assert "nothing bounds" in " ".join(mission_summary(told).split())


def test_of_a_plane_that_has_arrived_the_table_says_what_it_passed_its_target_at() -> None:
    session = Session(load_mission("sitl-arduplane"), seed=1, lockstep=True)
    flight = FlightSummary(session=session, passed_m=9.8)
    flight.end = End(outcome=Outcome.ARRIVED, reason="target reached", remedy="")
    [row] = [line for line in shown(flight_table(flight)).splitlines() if "target" in line]
    assert "passed the target at" in row
    assert "9.8 m" in row
