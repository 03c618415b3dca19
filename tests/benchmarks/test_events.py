"""A vehicle in flight is given a fence across its path, and goes round it."""

import events
import pytest


@pytest.mark.parametrize(  # a plane: the golden flight plane-meets-new-fence
    "vehicle", ["ardupilot-copter", pytest.param("ardupilot-plane", marks=pytest.mark.nightly)]
)
def test_a_fence_that_is_drawn_in_flight_is_read_drawn_and_flown_round(vehicle: str) -> None:
    times, flight, zones = events.fly(vehicle, 4, 100, limit_s=45.0)
    assert {"FenceChanged", "Position", "checkpoint", "whole turn"} <= set(times)
    told = [e for e in flight.journal if e["kind"] == "fence" and len(e["zones"]) == 4]
    assert told
    at_s = told[0]["t_s"]
    assert any(e["kind"] == "leg" and e["t_s"] > at_s for e in flight.journal)
    after = [row for row in flight.truth if row["t_s"] > at_s]
    assert len(after) > 100
    for zone in zones:
        for row in after:
            assert zone.distance_m(row["north_m"], row["east_m"]) > 0.0
