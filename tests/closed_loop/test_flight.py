"""Whole flights, and what ends one."""

from typing import Any

import pytest
import true_track
from flights import (
    EACH_SCENE,
    HILLS,
    HILLS_MISSION,
    flown_as,
    folder_of,
)

pytestmark = pytest.mark.closed_loop


@EACH_SCENE
def test_a_flight_arrives_and_its_true_track_keeps_every_bound(flown: Any, name: str) -> None:
    """Along legs that the compiled kernel has proven, all of them."""
    flight, folder = flown(*flown_as(name)), folder_of(name)
    flight.ended_well()
    legs = [entry for entry in flight.journal if entry.get("kind") == "plan ready"]
    assert len(legs) == flight.kinds.count("leg") > 2
    assert all(leg["certificate"]["broken"] == [] for leg in legs)
    assert {leg["kernel"].split()[0] for leg in legs} == {"numba"}
    truth = flight.folder / "truth.jsonl"
    track = true_track.judge_files(folder / "world.toml", folder / "mission.toml", truth)
    assert track.ok, [str(check) for check in track.violations]
    assert flight.truth[-1]["mode"] == "BRAKE"


@pytest.mark.nightly
def test_the_paper_profile_flies_too(flown: Any) -> None:
    flight = flown(HILLS, HILLS_MISSION, "--profile", "paper")
    flight.ended_well()
    assert flight.journal[0]["profile"] == "paper"
