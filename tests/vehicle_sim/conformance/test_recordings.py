"""Each recorded flight, flown by the simulator: no fewer rows agree than did, each other is known.

A reason that no row needs fails too.
"""

from collections.abc import Callable

import pytest

from conformance import AGREED, compare
from conformance.flights import Recording, Side, flight_of, play

Recorded = Callable[[str], Recording]


@pytest.mark.sample(3)
def test_the_simulated_autopilot_is_like_the_recorded_one(recorded: Recorded, name: str) -> None:
    recording = recorded(name)
    flight = flight_of(recording.name)
    rows = compare(recording, flight, Side(play(recording, flight)))
    disagreeing = [row for row in rows if not row.agrees]
    assert [row for row in disagreeing if row.reason is None] == []
    agreed, before = AGREED[name]
    assert len(rows) - len(disagreeing) >= agreed
    assert len(disagreeing) <= before - agreed
    stale = [r for r in flight.reasons if not any(r.explains(row) for row in disagreeing)]
    assert stale == []
