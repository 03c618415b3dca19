"""A vehicle in flight is given a fence across its path, and goes round it."""

import events
import pytest

from companion.mission.state import Phase


@pytest.mark.parametrize(  # a plane: the golden flight plane-meets-new-fence
    "vehicle", ["ardupilot-copter", pytest.param("ardupilot-plane", marks=pytest.mark.nightly)]
)
def test_a_fence_that_is_drawn_in_flight_is_read_drawn_and_flown_round(vehicle: str) -> None:
    times, pair = events.fly(vehicle, 4, 100, limit_s=90.0)
    flown = pair.flown
    assert flown.died == ""
    assert {"FenceChanged", "Position", "checkpoint", "whole turn"} <= set(times)
    told = [e for e in flown.journal if e["kind"] == "fence" and len(e["zones"]) == 4]
    assert told
    at_s = told[0]["at_s"]
    assert any(e["kind"] == "plan ready" and e["at_s"] > at_s for e in flown.journal)
    later = [s for s in flown.samples if s.t_s > at_s]
    assert any(s.phase == Phase.FLYING.value for s in later)
    ((_, zones),) = flown.fences
    times_s, track = flown.track()
    after = track[times_s > at_s]
    for zone in zones:
        assert zone.distance_m(after[:, 0], after[:, 1]).min() > 0.0
