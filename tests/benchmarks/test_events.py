"""A vehicle in flight is given a fence across its path: it holds, and goes round it."""

import events
import pytest

from companion.mission.state import Phase


@pytest.mark.parametrize("vehicle", ["ardupilot-plane", "ardupilot-copter"])
def test_a_fence_that_is_drawn_in_flight_is_read_drawn_and_flown_round(vehicle: str) -> None:
    times, pair = events.fly(vehicle, 4, 100, limit_s=110.0)
    flown = pair.flown
    assert flown.died == ""
    told = [e for e in flown.journal if e["kind"] == "fence" and len(e["zones"]) == 4]
    assert told
    at_s = told[0]["at_s"]
    assert {"FenceChanged", "Position", "checkpoint", "whole turn"} <= set(times)
    stopped = [e for e in flown.journal if e.get("code") == "NEW_THREAT" and e["kind"] == "phase"]
    assert stopped
    assert at_s <= stopped[0]["at_s"] <= at_s + 5.0
    later = [s for s in flown.samples if s.t_s > stopped[0]["at_s"]]
    assert any(s.phase == Phase.FLYING.value for s in later)
