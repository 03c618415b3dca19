"""Recordings are read as they were made.  That they are played into a vehicle as they were flown is
seen by test_recordings.py: else they would not agree."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conformance.flights import Clock, Recording, decoded, flight_of

Recorded = Callable[[str], Recording]


@pytest.mark.sample(3)
def test_a_recording_says_who_flew_and_who_said_what_at_which_vehicle_time(
    recorded: Recorded, name: str
) -> None:
    flight = recorded(name)
    assert flight.firmware == ("px4" if name.startswith("px4") else "ardupilot")
    assert flight.kind == ("plane" if "plane" in name or "fixedwing" in name else "copter")
    assert {one[2:4] for one in flight.said} == {(1, 1)}
    assert {one[2:4] for one in flight.sent} <= {(1, 191), (1, 195), (255, 190)}
    for half in (flight.sent, flight.said):
        times = [flight.begin_s, *(one.time_s for one in half), flight.end_s]
        assert times == sorted(times)
    late = [
        one.time_s - decoded(one).time_boot_ms / 1000.0
        for one in flight.said
        if one.number in (30, 33) and one.time_s > flight.begin_s + 3.0
    ]
    assert np.median(late) < 0.02  # a stamp is as old as the way took
    assert np.quantile(late, 0.001) > -0.03
    assert np.quantile(late, 0.9) < 0.1
    for reason in flight_of(flight).reasons:  # they are narrow, and say something
        assert len(reason.why) > 20
        assert not reason.names == reason.shown == ".*"


@given(
    rate=st.floats(0.95, 1.05),
    offset_s=st.floats(-5.0, 5.0),
    late_s=st.lists(st.floats(0.0, 0.3), min_size=50, max_size=50),
)
def test_the_clock_finds_rate_and_offset_whatever_waited(
    rate: float, offset_s: float, late_s: list[float]
) -> None:
    """One stamp in five did not wait."""
    stamps = []
    for i, wait_s in enumerate(late_s):
        log_s = 0.2 * i
        stamps.append((log_s + (0.0 if i % 5 == 0 else wait_s), offset_s + rate * log_s))
    clock = Clock(stamps)
    for log_s in np.linspace(0.0, 9.0, 19):
        assert clock.vehicle_s(log_s) == pytest.approx(offset_s + rate * log_s, abs=0.31 * rate)
