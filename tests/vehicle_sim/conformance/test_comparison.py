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
Change = Callable[[Heard], Iterable[Heard]]
COPTER, PX4, PLANE = (
    "arducopter-gps-loss.tlog",
    "px4-gps-loss.tlog",
    "arduplane-guided-reposition.tlog",
)


def rows_of(recording: Recording, said: Side) -> list[Row]:
    return compare(recording, flight_of(recording.name), said)


def failing(rows: Iterable[Row]) -> set[str]:
    return {row.kind for row in rows if not row.agrees}


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


def with_fields(h: Heard, **fields: Any) -> Heard:
    """The same frame but for these fields."""
    message = copy.copy(h.message)
    for name, value in fields.items():
        setattr(message, name, value)
    return Heard(h.at_s, bytes(message.pack(mavlink.MAVLink(None, *h.source))))


def at(number: int, begin_s: float, end_s: float, change: Change) -> Change:
    """The change to messages of this number between these times."""

    def changed(h: Heard) -> Iterable[Heard]:
        return change(h) if h.number == number and begin_s <= h.at_s < end_s else (h,)

    return changed


def setting(**fields: Any) -> Change:
    return lambda h: (with_fields(h, **fields),)


def adding(**steps: Any) -> Change:
    return lambda h: (with_fields(h, **{n: getattr(h.message, n) + s for n, s in steps.items()}),)


def lost(h: Heard) -> Iterable[Heard]:  # noqa: ARG001
    return ()


ALL = (-math.inf, math.inf)
CHANGES: list[tuple[str, str, Change]] = [
    # kind of row, recording, and what is done to what it said
    ("ack", COPTER, at(77, 200, 204, setting(result=1))),
    ("ack", PLANE, at(77, 100, 100.3, lost)),
    ("exchange", PX4, at(47, *ALL, setting(type=13))),
    ("said once", PX4, at(148, *ALL, setting(capabilities=1))),
    ("said once", COPTER, at(242, *ALL, adding(altitude=5000))),
    ("mode", COPTER, at(0, 150, 160, setting(custom_mode=5))),
    ("armed", COPTER, at(0, 150, 160, setting(base_mode=89))),
    ("base mode", COPTER, at(0, 100, 110, setting(base_mode=145))),
    ("system status", COPTER, at(0, 150, 160, setting(system_status=5))),
    ("vehicle", COPTER, at(0, *ALL, setting(type=13))),
    ("landed", COPTER, at(245, 60, 70, setting(landed_state=3))),
    ("vtol", COPTER, at(245, *ALL, setting(vtol_state=4))),
    ("fix", COPTER, at(24, 160, 190, setting(fix_type=6))),
    ("estimator", COPTER, at(193, 170, 176, setting(flags=831))),
    ("estimator", PX4, at(230, 80, 110, setting(flags=0x37F))),
    ("current mode", PX4, at(436, 80, 100, setting(custom_mode=0x03040000))),
    ("intended mode", PX4, at(436, 80, 100, setting(intended_custom_mode=0))),
    ("mission", PX4, at(42, 80, 100, setting(mission_mode=1))),
    ("echo", COPTER, at(85, 100, 110, setting(type_mask=0))),
    ("count", COPTER, at(30, 100, 110, lost)),
    ("first", COPTER, at(32, 0, 45, lost)),
    ("longest silence", COPTER, at(24, 200, 203, lost)),
    ("filling", COPTER, at(24, *ALL, setting(satellites_visible=11))),
    ("track", COPTER, at(33, 90, 92, adding(lat=300))),
    ("motion", COPTER, at(33, 70, 110, adding(vz=100))),
    ("motion", PX4, at(33, 90, 100, setting(hdg=0))),
    ("target", COPTER, at(85, 90, 100, adding(vx=2.0))),
    ("target", PLANE, at(87, 90, 100, adding(alt=20.0))),
    ("battery", COPTER, at(147, 150, 200, setting(battery_remaining=99))),
]


@pytest.mark.parametrize("name_of", [COPTER, PX4, pytest.param(PLANE, marks=pytest.mark.nightly)])
def test_all_kinds_of_rows_fail_when_all_that_they_look_at_is_changed(
    recorded: Recorded, name_of: str
) -> None:
    flight = recorded(name_of)
    said, kinds = list(flight.said), set()
    for kind, name, change in CHANGES:
        if name == name_of:
            said = [changed for h in said for changed in change(h)]
            kinds.add(kind)
    assert kinds <= failing(rows_of(flight, Side(sorted(said, key=lambda h: h.at_s))))


def test_every_kind_of_row_has_been_made_to_fail(recorded: Recorded) -> None:
    flights = [recorded(name) for name in (COPTER, PX4)]
    kinds = {row.kind for flight in flights for row in rows_of(flight, flight.side)}
    assert kinds == {kind for kind, *_ in CHANGES}
