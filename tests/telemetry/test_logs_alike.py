"""Recorded flights in logs of each kind: as pymavlink reads them, and as it was sent in flight."""

import math
from pathlib import Path

import numpy as np
import pytest
from log_files import bin_of, counts, messages_of, opened
from recordings import NAMES, recording
from tlog import read_by_pymavlink

from companion.geodesy import FloatArray
from companion.mavlink.dialect import Message, wire
from companion.mavlink.parameter_client import decoded
from companion.telemetry.logs import Log, Odd, open_log

LOGS = [recording(name) for name in NAMES if name.endswith(".tlog")]
COPTER, PLANE = "arducopter-gps-loss.tlog", "arduplane-guided-reposition.tlog"
ULG = recording("px4-offboard-short.ulg")
Told = list[tuple[int, Message]]
"""What a log tells: microseconds, and message."""


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


def sent_by_autopilot(path: Path) -> Told:
    told = messages_of(open_log(path).records())
    return [pair for pair in told if pair[1].get_srcComponent() == 1]


def of_kind(pairs: Told, kind: str) -> Told:
    return [pair for pair in pairs if pair[1].get_type() == kind]


def table(pairs: Told, kind: str, fields: str) -> FloatArray:
    """A line for each message of a kind, a column for each field.  (M, F)."""
    rows = [[getattr(m, name) for name in fields.split()] for _, m in of_kind(pairs, kind)]
    return np.array(rows, dtype=float)


def apart(sent: Told, ours: Told, kind: str, fields: str) -> FloatArray:
    """How far messages of the same moment, by the first field, are from each other.  (M, F - 1)."""
    tables = [table(each, kind, fields) for each in (sent, ours)]
    _, *places = np.intersect1d(*(each[:, 0] for each in tables), return_indices=True)
    theirs, mine = (each[at, 1:] for each, at in zip(tables, places, strict=True))
    return np.abs(theirs - mine)


def late_s(sent: Told, ours: Told) -> FloatArray:
    """By how much positions of the same moment since boot are later in our log."""
    kind = "GLOBAL_POSITION_INT"
    begun = {m.time_boot_ms: t for t, m in of_kind(sent, kind)}
    pairs = [(begun.get(m.time_boot_ms), t) for t, m in of_kind(ours, kind)]
    return np.array([(at_us - t) * 1e-6 for at_us, t in pairs if at_us is not None])


def changes(pairs: Told, kind: str, fields: str) -> list[list[float]]:
    """Time in seconds and values, each time that these change; of a heartbeat's mode the arming."""
    found: list[list[float]] = []
    for time_us, message in of_kind(pairs, kind):
        armed = wire.MAV_MODE_FLAG_SAFETY_ARMED
        values = {name: getattr(message, name) for name in fields.split()}
        now = [value & armed if name == "base_mode" else value for name, value in values.items()]
        if not found or found[-1][1:] != now:
            found.append([time_us * 1e-6, *now])
    return found


@pytest.mark.parametrize("name", [COPTER, PLANE])
@pytest.mark.sample(2)
def test_a_bin_tells_the_flight_as_its_tlog(name: str, tmp_path: Path) -> None:
    sent = sent_by_autopilot(recording(name))
    log = opened(tmp_path, bin_of(recording(name)))
    ours = messages_of(log.records())
    assert not log.findings
    assert (log.kind, log.systems, log.system_id) == ("bin", (1,), 1)
    positions = "time_boot_ms lat lon alt relative_alt vx vy vz hdg"
    off = apart(sent, ours, "GLOBAL_POSITION_INT", positions)
    assert len(off) > 0.95 * len(of_kind(sent, "GLOBAL_POSITION_INT"))
    off[:, -1] = np.minimum(off[:, -1], 36_000 - off[:, -1])  # a heading goes round
    assert off.max() <= 1  # the last digit of the wire
    assert np.ptp(late_s(sent, ours)) < 0.5  # the .tlog has the time of arrival
    for kind, fields in {
        "GPS_RAW_INT": "fix_type lat lon alt satellites_visible vel cog",
        "EKF_STATUS_REPORT": "flags",
        "HOME_POSITION": "latitude longitude altitude",
        "GPS_GLOBAL_ORIGIN": "latitude longitude altitude",
        "PARAM_VALUE": "param_value",
    }.items():
        mine, theirs = (table(each, kind, fields) for each in (ours, sent))
        np.testing.assert_allclose(mine, theirs, rtol=1e-6, atol=10.0)  # of the wire's units
    dates = [
        (table(each, "SYSTEM_TIME", "time_unix_usec time_boot_ms") @ [1e-3, -1.0]).max()
        for each in (sent, ours)
    ]
    assert dates[1] == pytest.approx(dates[0], abs=100.0)
    left, same = (set(table(p, "SYS_STATUS", "battery_remaining").flat) for p in (ours, sent))
    assert left <= same
    modes = [changes(each, "HEARTBEAT", "type custom_mode base_mode") for each in (sent, ours)]
    assert [each[1:] for each in modes[0]] == [each[1:] for each in modes[1]]
    for kind, field in (("PARAM_VALUE", "param_id"), ("STATUSTEXT", "text")):
        words = [[getattr(m, field) for _, m in of_kind(each, kind)] for each in (sent, ours)]
        assert words[0] == [each for each in words[1] if "V4.5.7 (" not in each]  # the writer's
    states = table(ours, "HEARTBEAT", "system_status")
    assert (wire.MAV_STATE_CRITICAL in states) == (name == COPTER)  # its failsafe
    ground = table(ours, "EXTENDED_SYS_STATE", "landed_state").ravel()
    assert ground[0] == wire.MAV_LANDED_STATE_ON_GROUND
    assert wire.MAV_LANDED_STATE_IN_AIR in ground
    if name == COPTER:  # the plane's log ends in the air
        assert ground[-1] == wire.MAV_LANDED_STATE_ON_GROUND


Both = tuple[Told, Told, Log]


@pytest.fixture(scope="module")
def both() -> Both:
    """PX4's flight as it was sent, as its .ulg is told, and that log."""
    log = open_log(ULG)
    return sent_by_autopilot(ULG.with_suffix(".tlog")), messages_of(log.records()), log


FIX = "time_usec fix_type lat lon alt eph epv vel satellites_visible h_acc"


@pytest.mark.parametrize(
    ("kind", "fields", "tolerance", "least"),
    [
        ("GLOBAL_POSITION_INT", "time_boot_ms lat lon alt vx vy vz", 2, 900),
        ("GPS_RAW_INT", FIX, 1, 50),
    ],
)
def test_a_ulg_tells_positions_and_fixes_of_the_same_moment_as_they_were_sent(
    both: Both, kind: str, fields: str, tolerance: float, least: int
) -> None:
    off = apart(both[0], both[1], kind, fields)
    assert len(off) >= least
    assert off.max() <= tolerance


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("HEARTBEAT", "type autopilot custom_mode base_mode"),
        ("EXTENDED_SYS_STATE", "landed_state"),
    ],
)
def test_a_ulg_tells_modes_arming_and_ground_as_they_were_sent(
    both: Both, kind: str, fields: str
) -> None:
    """The .tlog has a heartbeat a second: two changes within one are one there."""
    theirs, mine = (changes(each, kind, fields) for each in both[:2])
    ends = [*mine[1:], [math.inf]]
    merged = [here for here, after in zip(mine, ends, strict=True) if after[0] - here[0] > 0.5]
    assert [each[1:] for each in merged] == [each[1:] for each in theirs]
    late = [b[0] - a[0] for a, b in zip(merged[1:], theirs[1:], strict=True)]
    assert -0.1 < min(late) <= max(late) < 1.7
    for pairs in both[:2]:
        states = table(pairs, "HEARTBEAT", "system_status")
        assert (states == wire.MAV_STATE_CRITICAL).sum() >= 3  # its failsafe


def test_an_estimator_made_of_other_topics_agrees_with_the_one_that_was_sent(both: Both) -> None:
    fields = "time_usec flags pos_horiz_accuracy"
    theirs, mine = (table(each, "ESTIMATOR_STATUS", fields) for each in both[:2])
    needed = (
        *(wire.ESTIMATOR_ATTITUDE, wire.ESTIMATOR_VELOCITY_HORIZ, wire.ESTIMATOR_POS_HORIZ_REL),
        *(wire.ESTIMATOR_POS_HORIZ_ABS, wire.ESTIMATOR_POS_VERT_ABS, wire.ESTIMATOR_ACCEL_ERROR),
    )
    mask, compared = sum(needed), 0
    for time_us, flags, accuracy_m in theirs:
        k = int(np.abs(mine[:, 0] - time_us).argmin())
        if abs(mine[k, 0] - time_us) < 150_000 and time_us > 3e6:
            assert int(mine[k, 1]) & mask == int(flags) & mask
            assert mine[k, 2] == pytest.approx(accuracy_m, abs=0.05)
            compared += 1
    assert compared > 50
    assert counts(both[2]) == {Odd.MADE_ESTIMATOR: 1}
    assert both[2].missing() == {}


def test_a_ulg_tells_parameters_and_the_date_as_they_were_sent(both: Both) -> None:
    sent, ours = (
        {(m.param_id, decoded(m, bytewise=True)) for _, m in of_kind(each, "PARAM_VALUE")}
        for each in both[:2]
    )
    assert {name for name, _ in sent - ours} <= {"EKF2_MAG_DECL"}  # set before the log
    late = late_s(*both[:2])
    assert -0.05 < late.min() <= late.max() < 0.7  # the simulation ran at 0.99 of real time
