"""Whole flights, and what ends one."""

import math
from pathlib import Path
from typing import Any

import pytest
import true_track
from flights import (
    EACH_SCENE,
    HILLS,
    HILLS_MISSION,
    edited,
    flown_as,
    flown_here,
    folder_of,
)

pytestmark = pytest.mark.closed_loop


@EACH_SCENE
def test_a_flight_arrives_and_its_true_track_keeps_every_bound(flown: Any, name: str) -> None:
    flight, folder = flown(*flown_as(name)), folder_of(name)
    flight.ended_well()
    truth = flight.folder / "truth.jsonl"
    track = true_track.judge_files(folder / "world.toml", folder / "mission.toml", truth)
    assert track.ok, [str(check) for check in track.violations]
    assert flight.truth[-1]["mode"] == "BRAKE"


@pytest.mark.nightly
def test_the_paper_profile_flies_too(flown: Any) -> None:
    flight = flown(HILLS, HILLS_MISSION, "--profile", "paper")
    flight.ended_well()
    assert flight.journal[0]["profile"] == "paper"


def test_nothing_is_flown_on_sight_that_the_radar_does_not_have(tmp_path: Path) -> None:
    """What lies beyond the radar's own range is unknown, not sheltered."""
    short = ("range_m = 20000.0", "range_m = 8000.0")
    quick = ("planning_time_s = 5.0", "planning_time_s = 5.0\nevaluations = 300")
    world = edited(HILLS, tmp_path / "short.toml", short)
    mission = edited(HILLS_MISSION, tmp_path / "mission.toml", quick)
    flight = flown_here(tmp_path / "run", world, mission, limit_s=180.0)
    assert "radar sees 8.0 km of R = 20.0 km" in flight.says
    scanned: list[tuple[float, float]] = []
    for entry in flight.journal:
        if entry.get("kind") == "scan":
            scanned.append(entry["centre_nea_m"][:2])
        elif entry.get("kind") == "plan ready":
            end = entry["control_nea_m"][-1][:2]
            assert min(math.dist(end, centre) for centre in scanned) < 8_000.0
    assert scanned
