"""Whole flights of both programs, over UDP."""

from typing import Any

import pytest
import true_track
from flights import EACH_SCENE, flown_as, folder_of

from companion.mission.journal import PlanReady
from companion.telemetry.journal import Journal

pytestmark = pytest.mark.closed_loop


@EACH_SCENE
def test_a_flight_arrives_and_its_true_track_keeps_every_bound(flown: Any, name: str) -> None:
    """Along legs that the compiled kernel has proven; its journal is as documented."""
    flight, folder = flown(*flown_as(name)), folder_of(name)
    flight.ended_well()
    journal = Journal(flight.folder / "journal.jsonl")
    entries = list(journal.entries())
    assert journal.findings == ()
    legs = [entry for entry in entries if isinstance(entry, PlanReady)]
    assert len(legs) == sum(entry.kind == "leg" for entry in entries) > 2
    assert all(leg.certificate.broken == () for leg in legs)
    assert {leg.kernel.split()[0] for leg in legs} == {"numba"}
    truth = flight.folder / "truth.jsonl"
    track = true_track.judge_files(folder / "world.toml", folder / "mission.toml", truth)
    assert track.ok, [str(check) for check in track.violations]
    assert flight.truth[-1]["mode"] == "BRAKE"
