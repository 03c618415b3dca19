"""PX4's .ulg, told as MAVLink, against the .tlog of the same flight."""

import math
import struct
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from log_files import counts, messages_of, of, opened, told
from recordings import recording

from companion.errors import InputError
from companion.mavlink.dialect import Message, wire
from companion.mavlink.parameter_client import decoded
from companion.telemetry.logs import Log, Odd, open_log
from companion.telemetry.logs.made import direction

SHORT = recording("px4-offboard-short.ulg")
HEADER = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000)


def message(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<H", len(content)) + kind + content


STATUS = "vehicle_status:uint64_t timestamp;uint8_t nav_state;uint8_t arming_state;bool failsafe;"
START = (
    HEADER
    + message(b"F", STATUS.encode() + b"uint8_t system_type;uint8_t[4] _padding0;")
    + message(b"P", b"\x12int32_t MAV_SYS_ID" + struct.pack("<i", 42))
    + message(b"A", b"\x00\x03\x00vehicle_status")
)


def status(time_us: int, nav_state: int, arming_state: int, failsafe: int = 0) -> bytes:
    content = struct.pack("<HQBBBB", 3, time_us, nav_state, arming_state, failsafe, 13)
    return message(b"D", content)


def text(time_us: int, said: bytes, level: bytes = b"4") -> bytes:
    return message(b"L", level + struct.pack("<Q", time_us) + said)


@pytest.fixture(scope="module")
def both() -> tuple[list[tuple[int, Message]], list[tuple[int, Message]], Log]:
    """The flight as it was sent, as it is told, and the log."""
    sent = messages_of(open_log(SHORT.with_suffix(".tlog")).records())
    log = open_log(SHORT)
    return (
        [pair for pair in sent if pair[1].get_srcComponent() == 1],
        messages_of(log.records()),
        log,
    )


Both = tuple[list[tuple[int, Message]], list[tuple[int, Message]], Log]


def _table(pairs: list[tuple[int, Message]], kind: str, time: str, fields: list[str]) -> np.ndarray:
    """Time since boot, then the fields, a line for each message; (M, 1 + F)."""
    messages = [m for _, m in pairs if m.get_type() == kind]
    return np.array([[getattr(m, f) for f in (time, *fields)] for m in messages], dtype=float)


@pytest.mark.parametrize(
    ("kind", "time", "fields", "tolerance", "least"),
    [
        ("GLOBAL_POSITION_INT", "time_boot_ms", ["lat", "lon", "alt", "vx", "vy", "vz"], 2, 900),
        (
            "GPS_RAW_INT",
            "time_usec",
            ["fix_type", "lat", "lon", "alt", "eph", "epv", "vel", "satellites_visible", "h_acc"],
            1,
            50,
        ),
    ],
)
def test_positions_and_fixes_of_the_same_moment_are_those_that_were_sent(
    both: Both, kind: str, time: str, fields: list[str], tolerance: float, least: int
) -> None:
    sent, ours, _ = both
    theirs, mine = _table(sent, kind, time, fields), _table(ours, kind, time, fields)
    moments, i, j = np.intersect1d(theirs[:, 0], mine[:, 0], return_indices=True)
    assert len(moments) >= least
    assert np.abs(theirs[i, 1:] - mine[j, 1:]).max() <= tolerance


def _changes(pairs: list[tuple[int, Message]], kind: str, fields: list[str]) -> list[list[float]]:
    """Times in seconds and values, each time that they change."""
    changes: list[list[float]] = []
    for time_us, m in pairs:
        if m.get_type() != kind:
            continue
        now = [getattr(m, f) & (128 if f == "base_mode" else ~0) for f in fields]
        if not changes or changes[-1][1:] != now:
            changes.append([time_us * 1e-6, *now])
    return changes


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("HEARTBEAT", ["type", "autopilot", "custom_mode", "base_mode"]),
        ("EXTENDED_SYS_STATE", ["landed_state"]),
    ],
)
def test_modes_arming_and_ground_change_as_they_were_sent(
    both: Both, kind: str, fields: list[str]
) -> None:
    """The .tlog has a heartbeat a second: two changes within one are one there."""
    sent, ours, _ = both
    theirs, mine = _changes(sent, kind, fields), _changes(ours, kind, fields)
    merged = [
        here
        for here, later in zip(mine, [*mine[1:], [math.inf]], strict=True)
        if later[0] - here[0] > 0.5
    ]
    assert [each[1:] for each in merged] == [each[1:] for each in theirs]
    late_s = [b[0] - a[0] for a, b in zip(merged[1:], theirs[1:], strict=True)]
    assert min(late_s) > -0.1 and max(late_s) < 1.7  # noqa: PT018 - a range


def test_the_failsafe_is_told_as_it_was_sent(both: Both) -> None:
    for pairs in both[:2]:
        critical = [t for t, m in pairs if m.get_type() == "HEARTBEAT" and m.system_status == 5]
        assert len(critical) >= 3


def test_the_estimator_made_of_other_topics_agrees_with_the_one_that_was_sent(both: Both) -> None:
    sent, ours, log = both
    theirs = _table(sent, "ESTIMATOR_STATUS", "time_usec", ["flags", "pos_horiz_accuracy"])
    mine = _table(ours, "ESTIMATOR_STATUS", "time_usec", ["flags", "pos_horiz_accuracy"])
    needed = (
        wire.ESTIMATOR_ATTITUDE
        | wire.ESTIMATOR_VELOCITY_HORIZ
        | wire.ESTIMATOR_POS_HORIZ_REL
        | wire.ESTIMATOR_POS_HORIZ_ABS
        | wire.ESTIMATOR_POS_VERT_ABS
        | wire.ESTIMATOR_ACCEL_ERROR
    )
    compared = 0
    for time_us, flags, accuracy_m in theirs:
        k = int(np.abs(mine[:, 0] - time_us).argmin())
        if abs(mine[k, 0] - time_us) < 150_000 and time_us > 3e6:
            assert int(mine[k, 1]) & needed == int(flags) & needed
            assert mine[k, 2] == pytest.approx(accuracy_m, abs=0.05)
            compared += 1
    assert compared > 50
    assert [str(each) for each in log.findings] == [
        "ESTIMATOR_STATUS is made of vehicle_local_position and estimator_status_flags: "
        "there is no estimator_status"
    ]
    assert log.missing() == ()


def test_parameters_are_those_that_were_sent(both: Both) -> None:
    sent, ours, _ = both
    mine: dict[str, list[float]] = defaultdict(list)
    for _, m in ours:
        if m.get_type() == "PARAM_VALUE":
            mine[m.param_id].append(decoded(m, bytewise=True))
    for _, m in sent:
        if m.get_type() == "PARAM_VALUE" and m.param_id != "EKF2_MAG_DECL":  # set before the log
            assert decoded(m, bytewise=True) in mine[m.param_id]


def test_the_date_is_that_of_the_log(both: Both) -> None:
    sent, ours, _ = both
    begun = {m.time_boot_ms: t for t, m in sent if m.get_type() == "GLOBAL_POSITION_INT"}
    late_s = [
        (begun[m.time_boot_ms] - t) * 1e-6
        for t, m in ours
        if m.get_type() == "GLOBAL_POSITION_INT" and m.time_boot_ms in begun
    ]
    assert min(late_s) > -0.05
    assert max(late_s) < 0.7  # the simulation ran at 0.99 of real time


def test_a_small_log_is_told(tmp_path: Path) -> None:
    log = opened(
        tmp_path,
        START
        + status(900_000, 4, 1)  # published before the log began
        + status(2_000_000, 14, 2)
        + text(2_500_000, b"\x1b[32mReady\x1b[0m\t")
        + status(3_000_000, 4, 2, failsafe=1)
        + message(b"O", struct.pack("<H", 250))
        + text(4_000_000, b"x" * 120, b"9"),
    )
    pairs = messages_of(log.records())
    beats = [(t, m) for t, m in pairs if m.get_type() == "HEARTBEAT"]
    assert log.system_id == 42
    assert [(t, m.custom_mode, m.system_status) for t, m in beats[:1]] == [
        (1_000_000, 4 << 16 | 3 << 24, wire.MAV_STATE_STANDBY)
    ]
    assert {m.get_srcSystem() for _, m in beats} == {42}
    assert beats[-1][1].system_status == wire.MAV_STATE_CRITICAL
    texts = of([m for _, m in pairs], "STATUSTEXT")
    assert [(m.text, m.severity) for m in texts[:1]] == [("Ready", 4)]
    assert "".join(m.text for m in texts[1:]) == "x" * 120
    assert [m.chunk_seq for m in texts[1:]] == [0, 1, 2]
    assert counts(log) == {Odd.NO_DATE: 1, Odd.LOST_TIME: 250}
    assert "ESTIMATOR_STATUS" in {each.message for each in log.missing()}


def test_a_mode_that_is_none_costs_the_heartbeat_alone(tmp_path: Path) -> None:
    said = [text(2_000_000 + k * 500_000, b"%d" % k) for k in range(8)]
    log = opened(tmp_path, START + status(1_900_000, 99, 2) + b"".join(said))
    messages = told(log)
    assert [m.text for m in of(messages, "STATUSTEXT")] == [str(k) for k in range(8)]
    assert of(messages, "SYSTEM_TIME")
    assert not of(messages, "HEARTBEAT")
    assert counts(log)[Odd.DAMAGED] == 1


def test_a_receiver_without_a_course_still_tells_of_its_fix() -> None:
    """As MAVLink has it: hundredths of a degree, 65535 if there is none."""
    assert [direction(a) for a in (0, 90, -90, 359.996)] == [0, 9000, 27000, 0]
    assert direction(math.nan) == 65535


def test_damage_costs_what_comes_before_a_mark(tmp_path: Path) -> None:
    """PX4 writes one each half second; a wrong length costs as many bytes, 64 kB at most."""
    mark = message(b"S", b"\x2f\x73\x13\x20\x25\x0c\xbb\x12")
    content = START + status(2_000_000, 14, 2) + text(2_000_000, b"before")
    for k, damage in enumerate((text(0, b"one")[:-2], b"noise that is no message", bytes(99))):
        content += damage + (mark + text(2_100_000 + k, b"after %d" % k)) * 4000
    log = opened(tmp_path, content + text(2_500_000, b"five")[:-1])
    texts = {m.text for m in of(told(log), "STATUSTEXT")}
    assert {"before", "after 0", "after 1", "after 2"} <= texts
    assert counts(log)[Odd.CORRUPT] == 1
    assert log.read_bytes == log.size_bytes


def test_a_log_of_a_later_format_is_refused(tmp_path: Path) -> None:
    flags = bytes(8) + b"\x02" + bytes(7) + bytes(24)
    with pytest.raises(InputError, match="its flags say that it must not be read"):
        opened(tmp_path, HEADER + message(b"B", flags) + START[len(HEADER) :])
    appended = bytes(8) + b"\x01" + bytes(7) + bytes(24)
    log = opened(tmp_path, HEADER + message(b"B", appended) + START[16:] + status(2_000_000, 4, 1))
    assert of(told(log), "HEARTBEAT")


def test_a_wrong_start_is_not_believed(tmp_path: Path) -> None:
    content = HEADER[:8] + b"\xff" * 8 + START[16:] + status(2_000_000, 4, 1)
    log = opened(tmp_path, content)
    assert [t for t, _ in messages_of(log.records())][-1] == 2_000_000
