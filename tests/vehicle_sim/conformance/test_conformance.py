"""Each recorded flight, flown by the simulator: no fewer rows agree than did, each other is known.

And the comparison itself can fail.
"""

import functools
import itertools
import struct

import pytest
from harness import Heard
from pymavlink.dialects.v20 import all as mavlink
from recordings import recording

from conformance import AGREED, compare
from conformance.flights import Recording, Side, flight_of, play, read_recording
from conformance.rows import Row

COPTER, PX4 = "arducopter-gps-loss.tlog", "px4-gps-loss.tlog"
LONG = {"arducopter-guided-10mps.tlog", "arducopter-lidar.tlog", "px4-offboard-8mps.tlog"}
"""With --all alone."""
FLIGHTS = [
    pytest.param(
        name, marks=[pytest.mark.xdist_group(name), *[pytest.mark.nightly] * (name in LONG)]
    )
    for name in AGREED
]


@functools.cache
def recorded(name: str) -> Recording:
    return read_recording(recording(name))


def rows_of(flight: Recording, said: Side) -> list[Row]:
    return compare(flight, flight_of(flight.name), said)


@pytest.mark.parametrize("name", FLIGHTS)
def test_the_simulated_autopilot_is_like_the_recorded_one(name: str) -> None:
    """A reason that no row needs fails too, and one that says nothing."""
    reasons = flight_of(name).reasons
    rows = rows_of(recorded(name), Side(play(recorded(name), flight_of(name))))
    disagreeing = [row for row in rows if not row.agrees]
    assert [row for row in disagreeing if row.reason is None] == []
    agreed, before = AGREED[name]
    assert len(rows) - len(disagreeing) >= agreed
    assert len(disagreeing) <= before - agreed
    assert [r for r in reasons if not any(r.explains(row) for row in disagreeing)] == []
    assert not any(len(r.why) <= 20 or r.names == r.shown == ".*" for r in reasons)


def spoilt(heard: Heard) -> Heard:
    """The same message with other values in all of its fields."""
    kind = mavlink.mavlink_map[heard.number]
    payload = b"\x55" * kind.unpacker.size
    body = bytes([253, len(payload)]) + heard.frame[2:10] + payload
    crc = mavlink.x25crc(body[1:] + bytes([kind.crc_extra])).crc
    return Heard(heard.at_s, body + struct.pack("<H", crc))


def test_a_flight_agrees_with_itself_not_with_another_and_each_kind_of_row_can_fail() -> None:
    """Of a side that says something else, a ninth as often."""
    kinds, fail = set[str](), set[str]()
    for flight, other in itertools.permutations(map(recorded, (COPTER, PX4))):
        rows = rows_of(flight, flight.side)
        assert len(rows) > 150
        assert {row.difference for row in rows} == {0.0}
        assert sum(row.agrees for row in rows_of(flight, other.side)) < 0.75 * len(rows)
        assert not any(row.agrees for row in rows_of(flight, Side(())))
        known = flight.side.numbers & mavlink.mavlink_map.keys()
        late = (heard for n in known for heard in flight.side.heard(n)[::9] if heard.at_s > 60.0)
        kinds |= {row.kind for row in rows}
        fail |= {row.kind for row in rows_of(flight, Side(map(spoilt, late))) if not row.agrees}
    assert kinds == fail
