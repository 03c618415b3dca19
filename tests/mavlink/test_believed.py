"""When the recorded flights' positions are believed, against the times of their faults.

Times are seconds after the first record (README of the recordings).
"""

import functools
import math

import pytest
from held import recorded

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import Autopilot, autopilot_of
from companion.mission.events import Estimator, Event, GpsFix, Origin, Position, VehicleStatus

ARDUPILOT_HOME, PX4_HOME = (-35.363262, 149.165237), (47.397742, 8.545594)
HOMES = {
    "arducopter-gps-loss.tlog": ARDUPILOT_HOME,
    "arducopter-guided-10mps.tlog": ARDUPILOT_HOME,
    "arducopter-guided-global-stream-faults.tlog": PX4_HOME,
    "arduplane-guided-reposition.tlog": ARDUPILOT_HOME,
    "px4-fixedwing-offboard.tlog": PX4_HOME,
    "px4-gps-loss.tlog": PX4_HOME,
    "px4-offboard-8mps.tlog": PX4_HOME,
    "px4-offboard-short.tlog": PX4_HOME,
}
FAULTS = {  # when, how soon it is seen, and the jumps of the estimate before which it is
    # a step of 50 m until "Glitch cleared"; GPS off
    "arducopter-gps-loss.tlog": ([(113.1, 148.3), (163.2, 188.2)], 0.6, [123.3, 138.3]),
    "px4-gps-loss.tlog": ([(76.3, 106.6)], 0.2, []),
}


@functools.cache
def told(name: str) -> tuple[list[tuple[float, Event]], set[str]]:
    """What the autopilot of a recording said, by the recording's clock, and its modes' names."""
    latitude, longitude = HOMES[name]
    frame = LocalFrame(latitude_deg=latitude, longitude_deg=longitude)
    autopilot: Autopilot | None = None
    origin, found, modes = None, list[tuple[float, Event]](), set[str]()
    for at_s, message in recorded(name):
        if (message.get_srcSystem(), message.get_srcComponent()) != (1, 1):
            continue
        is_heartbeat = message.get_type() == "HEARTBEAT"
        if autopilot is None:
            autopilot = autopilot_of(message) if is_heartbeat else None
        if autopilot is None:
            continue
        if is_heartbeat:
            modes.add(autopilot.modes.name_of(message.custom_mode))
        event = autopilot.event_of(message, at_s, frame, origin)
        if isinstance(event, Origin):
            origin = event.position_nea_m
        if event is not None:
            found.append((at_s, event))
    return found, modes


def doubted(name: str) -> list[tuple[float, float]]:
    """From when to when the position was not to be believed, once it had been."""
    good: dict[type, bool] = {}
    spans, since_s = list[tuple[float, float]](), None
    for at_s, event in told(name)[0]:
        if not isinstance(event, GpsFix | Estimator):
            continue
        before = len(good) == 2 and all(good.values())
        good[type(event)] = event.good
        believed = len(good) == 2 and all(good.values())
        if before and not believed:
            since_s = at_s
        elif believed and since_s is not None:
            spans.append((since_s, at_s))
            since_s = None
    return spans if since_s is None else [*spans, (since_s, math.inf)]


@pytest.mark.parametrize("name", HOMES)
def test_a_fault_is_seen_at_once_before_the_estimate_jumps_and_nothing_else(name: str) -> None:
    """A healthy flight is believed from beginning to end, to be where it was."""
    spans, (faults, seen_within_s, jumps_s) = doubted(name), FAULTS.get(name, ([], 0.0, []))
    assert len(spans) == len(faults)
    for (since_s, until_s), (fault_s, over_s) in zip(spans, faults, strict=True):
        assert fault_s < since_s < fault_s + seen_within_s
        assert over_s <= until_s < over_s + 2.0
    for jump_s in jumps_s:
        assert any(since_s < jump_s - 5.0 and jump_s < until_s for since_s, until_s in spans)
    said, modes = told(name)
    places = [event.position_nea_m for _, event in said if isinstance(event, Position)]
    assert len(places) > 500
    assert max(math.hypot(*place[:2]) for place in places) < 3000.0
    assert any(event.armed for _, event in said if isinstance(event, VehicleStatus))
    assert modes
    assert not any(mode.startswith("mode ") for mode in modes)
