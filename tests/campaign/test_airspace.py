"""Several copters in one airspace: the real sessions and simulations, with lost messages."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from companion.campaign.airspace import separation
from companion.campaign.file import Place, Run
from companion.campaign.flight import Flight
from companion.campaign.run import fly_run
from companion.config import load_mission
from companion.mission.mission import TrafficRules

RULES = TrafficRules(separation_m=20.0, vertical_separation_m=10.0)


def run_of(vehicles: int, **keywords: Any) -> Run:
    place = Place(label="", world="sitl-arducopter", mission="sitl-arducopter", vehicles=vehicles)
    values = {"number": 0, "key": "", "seed": 1, "place": place, "over": "process"}
    return Run(**values | {"keep": "none", "limit_s": 600.0} | keywords)


@pytest.mark.closed_loop
def test_two_that_meet_head_on_keep_apart_arrive_and_say_to_whom_they_give_way(
    tmp_path: Path,
) -> None:
    row = fly_run(run_of(2, keep="all"), tmp_path)
    assert (row.error, row.arrived, row.vehicles_arrived, row.violations) == (None, True, 2, 0)
    assert row.separation_kept is not None
    assert row.separation_kept >= 1.0
    folders = sorted((tmp_path / str(row.folder)).glob("vehicle-*"))
    says = [
        entry["text"]
        for folder in folders
        for entry in map(json.loads, (folder / "journal.jsonl").read_text().splitlines())
        if entry.get("kind") == "say"
    ]
    assert len(folders) == 2
    assert any("giving way to others in the air: system" in text for text in says)


@pytest.mark.closed_loop
@pytest.mark.nightly  # how they are judged: `test_faults`
def test_faults_are_judged_among_several_and_killed_companions_go_on(tmp_path: Path) -> None:
    """Each by the positions that it was told itself: the others lie hundreds of metres off."""
    row = fly_run(run_of(2, timeline="at 45 s for 3 s: companion_off"), tmp_path)
    assert (row.error, row.arrived, row.vehicles_arrived, row.violations) == (None, True, 2, 0)
    assert row.ending in ("arrived", "held and resumed")
    assert row.timeline == "at 45 s for 3 s: companion_off"
    assert row.position_off_m is not None
    assert row.position_off_m < 3.0


@pytest.mark.closed_loop
@pytest.mark.nightly  # of one vehicle: `test_running`
def test_the_same_seed_flies_two_the_same(tmp_path: Path) -> None:
    once, again = (fly_run(run_of(2), tmp_path).deterministic() for _ in range(2))
    assert once == again


def at(t_s: float, north_m: float, up_m: float, *, landed: bool = False) -> dict[str, Any]:
    place = {"north_m": north_m, "east_m": 0.0, "altitude_amsl_m": up_m}
    return {"t_s": t_s, "landed": landed} | place


def flown(*truth: dict[str, Any]) -> Flight:
    mission = replace(load_mission("sitl-arducopter"), traffic=RULES)
    return Flight(mission=mission, journal=[], truth=list(truth), plans_s=[], folder=Path())


def test_separation_is_the_least_share_kept_of_any_two_at_the_same_time_in_the_air() -> None:
    first = flown(at(1.0, 0.0, 50.0), at(2.0, 0.0, 50.0), at(3.0, 0.0, 50.0))
    second = flown(
        at(1.0, 1.0, 40.0, landed=True), at(2.0, 5.0, 58.0), at(3.0, 30.0, 50.0), at(4.0, 0.0, 50.0)
    )
    found = separation([first, second])
    assert found["separation_kept"] == pytest.approx(0.8)  # 8 m of 10 m, above each other
    assert found["apart_least_m"] == pytest.approx((5.0**2 + 8.0**2) ** 0.5)
    assert separation([first]) == {"separation_kept": None, "apart_least_m": None}
