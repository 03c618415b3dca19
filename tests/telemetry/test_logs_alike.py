"""Recorded flights in logs of each kind: as pymavlink reads them, and as it was sent in flight."""

import hashlib
import struct
from pathlib import Path

import numpy as np
import pytest
from log_files import bin_of, counts, messages_of
from recordings import NAMES, recording
from tlog import read_by_pymavlink

from companion.geodesy import FloatArray
from companion.mavlink.dialect import Message
from companion.telemetry.logs import Odd, open_log

LOGS = [recording(name) for name in NAMES if name.endswith(".tlog")]
COPTER, PLANE = "arducopter-gps-loss", "arduplane-guided-reposition"
PX4 = "px4-offboard-short"  # the .ulg was recorded beside the .tlog, a .bin is made of that
FIX = "time_usec fix_type lat lon alt eph epv vel satellites_visible h_acc"
Told = list[tuple[int, Message]]
"""What a log tells: microseconds, and message."""
STREAMS = {COPTER: "6ddbd24b1b6ae86b", PLANE: "85e43dd8af8660c8", PX4: "80be3f0d694a21ba"}
"""The beginning of the hash of all records of the other log, stamps and frames."""


@pytest.mark.parametrize("path", LOGS[::2], ids=lambda path: path.stem)
@pytest.mark.sample(2)
def test_a_recorded_log_is_read_as_pymavlink_reads_it(path: Path) -> None:
    """And each time that it is read."""
    log, theirs = open_log(path), read_by_pymavlink(path)
    for _ in range(2):
        assert list(log.records()) == theirs
    assert (log.kind, log.systems, log.system_id) == ("tlog", (1,), 1)
    # The dialect lacks some of PX4's newest messages, nothing else is odd.
    assert set(counts(log)) <= {Odd.UNKNOWN}
    assert ("STATUSTEXT" in log.missing()) == path.name.startswith("px4")  # PX4 sends none


# --- one flight in two logs


def table(pairs: Told, kind: str, fields: str) -> FloatArray:
    """A line for each message of a kind, its time in seconds and its fields.  (M, 1 + F)."""
    rows = [
        [time_us * 1e-6, *(getattr(m, name) for name in fields.split())]
        for time_us, m in pairs
        if m.get_type() == kind
    ]
    return np.array(rows, dtype=float)


def apart(sent: Told, ours: Told, kind: str, fields: str) -> FloatArray:
    """How far messages of the same moment, by the first field, are from each other.  (M, 1 + F).

    And how much later ours is, in seconds, in the first column.
    """
    tables = [table(each, kind, fields) for each in (sent, ours)]
    _, *places = np.intersect1d(*(each[:, 1] for each in tables), return_indices=True)
    theirs, mine = (each[at] for each, at in zip(tables, places, strict=True))
    return np.column_stack([mine[:, 0] - theirs[:, 0], np.abs(theirs - mine)[:, 2:]])


@pytest.mark.parametrize("name", [COPTER, pytest.param(PLANE, marks=pytest.mark.nightly), PX4])
def test_the_other_log_of_a_flight_tells_it_as_it_was_sent(name: str, tmp_path: Path) -> None:
    """Positions and fixes of the same moment; and to the last byte as it was when that was seen.

    So are modes, arming, ground, estimator, parameters, texts, battery and date.
    """
    path = recording(f"{name}.ulg") if name == PX4 else tmp_path / "flight.bin"
    if name != PX4:
        path.write_bytes(bin_of(recording(f"{name}.tlog")))
    heard = messages_of(open_log(recording(f"{name}.tlog")).records())
    sent = [each for each in heard if each[1].get_srcComponent() == 1]
    log = open_log(path)
    records = list(log.records())
    stream = b"".join(struct.pack(">Q", time_us) + frame for time_us, frame in records)
    ours = messages_of(records)
    fields = "time_boot_ms lat lon alt vx vy vz" + " relative_alt hdg" * (name != PX4)
    off = apart(sent, ours, "GLOBAL_POSITION_INT", fields)
    assert len(off) > 900
    assert off[:, 0].max() < 0.05  # the .tlog has the time of arrival
    assert np.ptp(off[:, 0]) < 0.75
    if name == PX4:
        assert off[:, 1:].max() <= 2
        fixes = apart(sent, ours, "GPS_RAW_INT", FIX)
        assert len(fixes) >= 50
        assert fixes[:, 1:].max() <= 1
    else:
        off[:, -1] = np.minimum(off[:, -1], 36_000 - off[:, -1])  # a heading goes round
        assert off[:, 1:].max() <= 1  # the last digit of the wire
    assert (log.systems, log.system_id, log.missing()) == ((1,), 1, {})
    assert counts(log) == ({Odd.MADE_ESTIMATOR: 1} if name == PX4 else {})
    assert hashlib.sha256(stream).hexdigest()[:16] == STREAMS[name]
