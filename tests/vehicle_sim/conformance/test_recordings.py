"""Each recorded flight, flown by the simulator: at least 95 % agree, the others have reasons."""

from collections.abc import Callable

import pytest

from conformance.compare import compare
from conformance.flights import flight_of, play
from conformance.log import Recording, Side
from conformance.report import Summary

Recorded = Callable[[str], Recording]
LEAST_SHARE = 0.95


@pytest.mark.sample(3)
def test_the_simulated_autopilot_is_like_the_recorded_one(recorded: Recorded, name: str) -> None:
    recording = recorded(name)
    flight = flight_of(recording)
    rows = compare(recording, flight, Side(play(recording, flight)))
    unexplained = [row for row in rows if not row.agrees and row.reason is None]
    assert unexplained == []
    summary = Summary.of(rows)
    assert summary.share >= LEAST_SHARE, summary
    disagreeing = [row for row in rows if not row.agrees]
    stale = [r for r in flight.reasons if not any(row.is_explained_by(r) for row in disagreeing)]
    assert stale == []
