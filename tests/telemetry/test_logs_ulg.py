"""PX4's .ulg, told as MAVLink, against the .tlog of the same flight."""

import math
import struct
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from log_files import counts, messages_of, of, opened, told
from recordings import recording
from told_alike import Told, both_at, changes, late_s, of_kind, table

from companion.errors import InputError
from companion.mavlink.dialect import wire
from companion.mavlink.parameter_client import decoded
from companion.replay.shadow import watch
from companion.telemetry.logs import Log, Odd, open_log

SHORT = recording("px4-offboard-short.ulg")
MAGIC = b"ULog\x01\x12\x35\x01"
DAY_US = 86_400 * 1_000_000
DATE_US = 1_710_773_350_346_000
FIXES = 60
Both = tuple[Told, Told, Log]


def message(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<H", len(content)) + kind + content


HEADER = MAGIC + struct.pack("<Q", 1_000_000)
TOPICS = (
    b"vehicle_status:uint64_t timestamp;uint8_t nav_state;uint8_t arming_state;bool failsafe;"
    b"uint8_t system_type;uint8_t[4] _padding0;",
    b"vehicle_global_position:uint64_t timestamp;double lat;double lon;float alt;",
    b"vehicle_local_position:uint64_t timestamp;double ref_lat;double ref_lon;float ref_alt;"
    b"float x;float y;float z;float vx;float vy;float vz;float heading;float eph;float epv;"
    b"bool xy_valid;bool z_valid;bool v_xy_valid;bool v_z_valid;bool xy_global;bool z_global;"
    b"bool dist_bottom_valid;",
)
STATUS, GLOBAL, LOCAL = range(3, 6)  # numbers of the topics, as they are subscribed to
START = (
    HEADER
    + message(b"F", TOPICS[0])
    + message(b"P", b"\x12int32_t MAV_SYS_ID" + struct.pack("<i", 42))
    + message(b"A", b"\x00\x03\x00vehicle_status")
)


def status(time_us: int, nav_state: int, arming_state: int, failsafe: int = 0) -> bytes:
    values = (time_us, nav_state, arming_state, failsafe, 13)
    return message(b"D", struct.pack("<HQBBBB", STATUS, *values))


def text(time_us: int, said: bytes, level: bytes = b"4") -> bytes:
    return message(b"L", level + struct.pack("<Q", time_us) + said)


def px4(clock_us: int, header_us: int, release: int = 0x010D00FF) -> bytes:
    """A PX4 whose clock begins there, and says something else in the header, with positions."""
    out = MAGIC + struct.pack("<Q", header_us)
    out += message(b"I", b"\x17uint32_t ver_sw_release" + struct.pack("<I", release))
    out += b"".join(message(b"F", topic) for topic in TOPICS)
    for number, topic in enumerate(TOPICS, start=STATUS):
        out += message(b"A", struct.pack("<BH", 0, number) + topic.split(b":")[0])
    for k in range(FIXES):
        time_us = clock_us + 100_000 * k
        local = (47.0, 8.0, 500.0, 0.1 * k, *([0.0] * 6), 0.5, 0.5, *([True] * 6), False)
        out += status(time_us, 4, 2)
        out += message(b"D", struct.pack("<HQdd10f7?", LOCAL, time_us, *local))
        out += message(b"D", struct.pack("<HQddf", GLOBAL, time_us, 47.0 + 1e-6 * k, 8.0, 500.0))
    return out + text(clock_us + 100_000 * FIXES, b"Armed")


def positions(log: Log) -> Told:
    return of_kind(messages_of(log.records()), "GLOBAL_POSITION_INT")


# --- against what was sent in the same flight


@pytest.fixture(scope="module")
def both() -> Both:
    """The flight as it was sent, as it is told, and the log."""
    sent = messages_of(open_log(SHORT.with_suffix(".tlog")).records())
    log = open_log(SHORT)
    sent = [pair for pair in sent if pair[1].get_srcComponent() == 1]
    return sent, messages_of(log.records()), log


FIX = "time_usec fix_type lat lon alt eph epv vel satellites_visible h_acc"


@pytest.mark.parametrize(
    ("kind", "fields", "tolerance", "least"),
    [
        ("GLOBAL_POSITION_INT", "time_boot_ms lat lon alt vx vy vz", 2, 900),
        ("GPS_RAW_INT", FIX, 1, 50),
    ],
)
def test_positions_and_fixes_of_the_same_moment_are_those_that_were_sent(
    both: Both, kind: str, fields: str, tolerance: float, least: int
) -> None:
    theirs, mine = both_at(both[0], both[1], kind, fields)
    assert len(theirs) >= least
    assert np.abs(theirs - mine).max() <= tolerance


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("HEARTBEAT", "type autopilot custom_mode base_mode"),
        ("EXTENDED_SYS_STATE", "landed_state"),
    ],
)
def test_modes_arming_and_ground_change_as_sent(both: Both, kind: str, fields: str) -> None:
    """The .tlog has a heartbeat a second: two changes within one are one there."""
    theirs, mine = (changes(each, kind, fields) for each in both[:2])
    ends = [*mine[1:], [math.inf]]
    merged = [here for here, after in zip(mine, ends, strict=True) if after[0] - here[0] > 0.5]
    assert [each[1:] for each in merged] == [each[1:] for each in theirs]
    late = [b[0] - a[0] for a, b in zip(merged[1:], theirs[1:], strict=True)]
    assert -0.1 < min(late) <= max(late) < 1.7
    for pairs in both[:2]:
        beats = [m for _, m in of_kind(pairs, "HEARTBEAT")]
        assert sum(m.system_status == wire.MAV_STATE_CRITICAL for m in beats) >= 3  # its failsafe


def test_the_estimator_made_of_other_topics_agrees_with_the_one_that_was_sent(both: Both) -> None:
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
    assert [str(each) for each in both[2].findings] == [
        "ESTIMATOR_STATUS is made of vehicle_local_position and estimator_status_flags: "
        "there is no estimator_status"
    ]
    assert both[2].missing() == {}


def test_parameters_and_the_date_are_those_that_were_sent(both: Both) -> None:
    sent, ours, _ = both
    mine: dict[str, list[float]] = defaultdict(list)
    for _, m in of_kind(ours, "PARAM_VALUE"):
        mine[m.param_id].append(decoded(m, bytewise=True))
    for _, m in of_kind(sent, "PARAM_VALUE"):
        if m.param_id != "EKF2_MAG_DECL":  # set before the log
            assert decoded(m, bytewise=True) in mine[m.param_id]
    late = late_s(sent, ours)
    assert -0.05 < late.min() <= late.max() < 0.7  # the simulation ran at 0.99 of real time


# --- small logs


def test_a_small_log_is_told(tmp_path: Path) -> None:
    log = opened(
        tmp_path,
        START
        + status(900_000, 4, 1)  # published before the log began
        + status(2_000_000, 14, 2)
        + text(2_500_000, b"\x1b[32mReady\x1b[0m\t")
        + status(3_000_000, 4, 2, failsafe=1)
        + message(b"O", struct.pack("<H", 250))
        + status(3_900_000, 99, 2)  # no mode: it costs the heartbeat alone
        + text(6_000_000, b"x" * 120, b"9"),
    )
    pairs = messages_of(log.records())
    beats = of_kind(pairs, "HEARTBEAT")
    assert (log.system_id, {m.get_srcSystem() for _, m in beats}) == (42, {42})
    first_us, first = beats[0]
    loiter = 4 << 16 | 3 << 24
    assert (first_us, first.custom_mode) == (1_000_000, loiter)
    assert first.system_status == wire.MAV_STATE_STANDBY
    assert beats[-1][1].system_status == wire.MAV_STATE_CRITICAL
    ready, *long = [m for _, m in of_kind(pairs, "STATUSTEXT")]
    assert (ready.text, ready.severity) == ("Ready", 4)
    assert "".join(m.text for m in long) == "x" * 120
    assert [m.chunk_seq for m in long] == [0, 1, 2]
    assert counts(log) == {Odd.NO_DATE: 1, Odd.LOST_TIME: 250, Odd.DAMAGED: 1}
    assert "ESTIMATOR_STATUS" in log.missing()


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


def test_a_log_of_a_later_format_is_refused_and_one_that_was_appended_to_is_read(
    tmp_path: Path,
) -> None:
    for flag, is_read in ((b"\x02", False), (b"\x01", True)):
        flags = message(b"B", bytes(8) + flag + bytes(31))
        content = HEADER + flags + START[len(HEADER) :] + status(2_000_000, 4, 1)
        if is_read:
            assert of(told(opened(tmp_path, content)), "HEARTBEAT")
        else:
            with pytest.raises(InputError, match="its flags say that it must not be read"):
                opened(tmp_path, content)


@pytest.mark.parametrize(
    ("release", "refused"), [(0x010C03FF, "1.12"), (0x010400FF, "1.4"), (0x00090000, ""), (0, "")]
)
def test_firmware_before_1_13_is_refused_by_its_version(
    tmp_path: Path, release: int, refused: str
) -> None:
    """Whoever builds it from no release has a version of 0: that one is read."""
    content = px4(1_000_000, 1_000_000, release)
    if refused:
        with pytest.raises(InputError, match=f"of PX4 {refused}, and logs are read from 1.13 on"):
            opened(tmp_path, content)
    else:
        assert len(positions(opened(tmp_path, content))) == FIXES


# --- clocks


@pytest.mark.parametrize("header_us", [DATE_US, 0, 112_000_000])
def test_a_clock_that_is_a_date_is_told_from_the_logs_beginning(
    tmp_path: Path, header_us: int
) -> None:
    """As PX4's simulation with Gazebo writes it: microseconds since 1970."""
    log = opened(tmp_path, px4(DATE_US, header_us))
    found = positions(log)
    assert [time_us for time_us, _ in found] == [DATE_US + 100_000 * k for k in range(FIXES)]
    assert found[-1][1].time_boot_ms - found[0][1].time_boot_ms == 100 * (FIXES - 1)
    assert found[0][1].time_boot_ms < 10_000
    assert counts(log) == {Odd.CLOCK_IS_DATE: 1, Odd.MADE_ESTIMATOR: 1}


def test_a_vehicle_that_is_up_for_months_is_read_and_a_wrong_start_not_believed(
    tmp_path: Path,
) -> None:
    boot_us = 100 * DAY_US
    found = positions(opened(tmp_path, px4(boot_us, boot_us)))
    assert len(found) == FIXES
    assert found[0][1].time_boot_ms == boot_us // 1000 % (1 << 32)
    wrong = MAGIC + b"\xff" * 8 + START[len(HEADER) :] + status(2_000_000, 4, 1)
    assert messages_of(opened(tmp_path, wrong).records())[-1][0] == 2_000_000


def test_what_was_thrown_away_is_told_with_what_is_missing(tmp_path: Path) -> None:
    """Positions that are no numbers: a log of which nothing is left says why."""
    content = px4(1_000_000, 1_000_000).replace(struct.pack("<d", 8.0), struct.pack("<d", math.nan))
    log = opened(tmp_path, content)
    with pytest.raises(InputError, match=r"no GLOBAL_POSITION_INT: .*; [\d,]+ entries that cannot"):
        watch(log.path, None)
