"""A flight agrees with itself, not with another one, and each kind of row can fail."""

import copy
import math
from collections.abc import Callable, Iterable
from typing import Any

import pytest
from harness import Heard
from pymavlink.dialects.v20 import all as mavlink

from conformance import compare
from conformance.flights import Recording, Side, flight_of
from conformance.rows import Row

Recorded = Callable[[str], Recording]
COPTER, PX4 = "arducopter-gps-loss.tlog", "px4-gps-loss.tlog"


def rows_of(recording: Recording, said: Side) -> list[Row]:
    return compare(recording, flight_of(recording.name), said)


@pytest.mark.sample(9)
def test_a_flight_agrees_with_itself_not_with_another_one_and_silence_with_nothing(
    recorded: Recorded, name: str
) -> None:
    flight = recorded(name)
    for reason in flight_of(flight.name).reasons:  # they are narrow, and say something
        assert len(reason.why) > 20
        assert not reason.names == reason.shown == ".*"
    rows = rows_of(flight, flight.side)
    assert [row for row in rows if not row.agrees] == []
    assert max(row.difference for row in rows) == 0.0
    assert len(rows) > 150
    other = recorded(COPTER if name != COPTER else "arducopter-guided-10mps.tlog")
    rows = rows_of(flight, other.side)
    assert sum(row.agrees for row in rows) < 0.75 * len(rows)
    assert not any(row.agrees for row in rows_of(flight, Side(())))


# --- each kind of row can fail --------------------------------------------------------------------

ALL = (-math.inf, math.inf)
Fields = dict[str, float] | None
CHANGES: list[tuple[str, str, int, tuple[float, float], Fields]] = [
    # kind of row, recording, and fields of the messages of this number between these times; or none
    ("ack", COPTER, 77, (200, 204), {"result": 1}),
    ("exchange", PX4, 47, ALL, {"type": 13}),
    ("said once", PX4, 148, ALL, {"capabilities": 1}),
    ("said once", COPTER, 242, ALL, {"altitude": 0}),
    ("mode", COPTER, 0, (150, 160), {"custom_mode": 5}),
    ("armed", COPTER, 0, (150, 160), {"base_mode": 89}),
    ("base mode", COPTER, 0, (100, 110), {"base_mode": 145}),
    ("system status", COPTER, 0, (150, 160), {"system_status": 5}),
    ("vehicle", COPTER, 0, ALL, {"type": 13}),
    ("landed", COPTER, 245, (60, 70), {"landed_state": 3}),
    ("vtol", COPTER, 245, ALL, {"vtol_state": 4}),
    ("fix", COPTER, 24, (160, 190), {"fix_type": 6}),
    ("estimator", COPTER, 193, (170, 176), {"flags": 831}),
    ("estimator", PX4, 230, (80, 110), {"flags": 0x37F}),
    ("current mode", PX4, 436, (80, 100), {"custom_mode": 0x03040000}),
    ("intended mode", PX4, 436, (80, 100), {"intended_custom_mode": 0}),
    ("mission", PX4, 42, (80, 100), {"mission_mode": 1}),
    ("echo", COPTER, 85, (100, 110), {"type_mask": 0}),
    ("count", COPTER, 30, (100, 110), None),
    ("first", COPTER, 32, (0, 45), None),
    ("longest silence", COPTER, 24, (200, 203), None),
    ("filling", COPTER, 24, ALL, {"satellites_visible": 11}),
    ("track", COPTER, 33, (90, 92), {"lat": 0}),
    ("motion", COPTER, 33, (70, 110), {"vz": 500}),
    ("motion", PX4, 33, (90, 100), {"hdg": 0}),
    ("target", COPTER, 85, (90, 100), {"vx": 50.0}),
    ("battery", COPTER, 147, (150, 200), {"battery_remaining": 99}),
]


def changed(
    said: Iterable[Heard], number: int, begin_s: float, end_s: float, fields: Fields
) -> Any:
    """With these fields instead; None: without these messages."""
    for h in said:
        if h.number != number or not begin_s <= h.at_s < end_s:
            yield h
        elif fields is not None:
            message = copy.copy(h.message)
            for name, value in fields.items():
                setattr(message, name, value)
            yield Heard(h.at_s, bytes(message.pack(mavlink.MAVLink(None, *h.source))))


@pytest.mark.parametrize("name_of", [COPTER, PX4])
def test_all_kinds_of_rows_fail_when_all_that_they_look_at_is_changed(
    recorded: Recorded, name_of: str
) -> None:
    flight = recorded(name_of)
    said, kinds = list(flight.said), set()
    for kind, name, number, span, fields in CHANGES:
        if name == name_of:
            said = list(changed(said, number, *span, fields))
            kinds.add(kind)
    assert kinds <= {row.kind for row in rows_of(flight, Side(said)) if not row.agrees}


def test_every_kind_of_row_has_been_made_to_fail(recorded: Recorded) -> None:
    flights = [recorded(name) for name in (COPTER, PX4)]
    kinds = {row.kind for flight in flights for row in rows_of(flight, flight.side)}
    assert kinds == {kind for kind, *_ in CHANGES}
