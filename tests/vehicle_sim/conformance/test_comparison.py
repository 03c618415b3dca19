"""A flight agrees with itself, not with another one, and each kind of row can fail."""

import struct
from collections.abc import Callable

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


def spoilt(heard: Heard) -> Heard:
    """The same message with other values in all of its fields."""
    kind = mavlink.mavlink_map[heard.number]
    payload = b"\x55" * kind.unpacker.size
    body = bytes([253, len(payload)]) + heard.frame[2:10] + payload
    crc = mavlink.x25crc(body[1:] + bytes([kind.crc_extra])).crc
    return Heard(heard.at_s, body + struct.pack("<H", crc))


def test_each_kind_of_row_fails_of_a_side_that_says_something_else_half_as_often(
    recorded: Recorded,
) -> None:
    kinds, fail = set[str](), set[str]()
    for flight in map(recorded, (COPTER, PX4)):
        late = (heard for heard in flight.said[::2] if heard.at_s > 60.0)
        said = [spoilt(heard) for heard in late if heard.number in mavlink.mavlink_map]
        rows = rows_of(flight, Side(said))
        kinds |= {row.kind for row in rows_of(flight, flight.side)}
        fail |= {row.kind for row in rows if not row.agrees}
    assert kinds == fail
