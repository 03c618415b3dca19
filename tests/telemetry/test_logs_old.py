"""Logs of other versions: old ones are refused, and PX4s whose clock is a date are read."""

import math
import re
import struct
from pathlib import Path

import pytest
from log_files import counts, entry, fmt_entries, messages_of, opened
from test_logs_ulg import message, status, text

from companion.errors import InputError
from companion.mavlink.dialect import Message, wire
from companion.replay.shadow import watch
from companion.telemetry.logs import Log

FIXES = 60
DATE_US = 1_710_773_350_346_000


TOPICS = (
    b"vehicle_status:uint64_t timestamp;uint8_t nav_state;uint8_t arming_state;bool failsafe;"
    b"uint8_t system_type;uint8_t[4] _padding0;",
    b"vehicle_global_position:uint64_t timestamp;double lat;double lon;float alt;",
    b"vehicle_local_position:uint64_t timestamp;double ref_lat;double ref_lon;float ref_alt;"
    b"float x;float y;float z;float vx;float vy;float vz;float heading;float eph;float epv;"
    b"bool xy_valid;bool z_valid;bool v_xy_valid;bool v_z_valid;bool xy_global;bool z_global;"
    b"bool dist_bottom_valid;",
)


def copter(greeting: bytes) -> bytes:
    """A .bin that greets so, with fixes of a GPS."""
    out = fmt_entries() + entry("MSG", 900_000, greeting) + entry("MODE", 950_000, 0, 0, 1)
    for k in range(FIXES):
        fix = (3, 109_206_800 + 200 * k, 1774, 9, 2.42, -394_950_300, 1_767_483_511)
        out += entry("GPS", 1_000_000 + 200_000 * k, 0, *fix, 46.82, 0.0, 0.0, 0.0, 0.0, 1)
    return out


def px4(clock_us: int, header_us: int, release: int = 0x010D00FF) -> bytes:
    """A PX4 whose clock begins there, and says something else in the header."""
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", header_us)
    out += message(b"I", b"\x17uint32_t ver_sw_release" + struct.pack("<I", release))
    out += b"".join(message(b"F", topic) for topic in TOPICS)
    for k, topic in enumerate(TOPICS):
        out += message(b"A", struct.pack("<BH", 0, 3 + k) + topic.split(b":")[0])
    for k in range(FIXES):
        time_us = clock_us + 100_000 * k
        local = (47.0, 8.0, 500.0, 0.1 * k, *([0.0] * 6), 0.5, 0.5, *([True] * 6), False)
        out += status(time_us, 4, 2)
        out += message(b"D", struct.pack("<HQdd10f7?", 5, time_us, *local))
        out += message(b"D", struct.pack("<HQddf", 4, time_us, 47.0 + 1e-6 * k, 8.0, 500.0))
    return out + text(clock_us + 100_000 * FIXES, b"Armed")


def positions(log: Log) -> list[tuple[int, Message]]:
    return [pair for pair in messages_of(log.records()) if pair[1].id == 33]


GREETINGS = {
    b"ArduCopter V3.1 (5c6503e2)": "3.1",
    b"APM:Copter V3.3.3 (acf1e7f2)": "3.3",
    b"APMrover2 V3.5.0": "3.5",
    b"ArduPlane V3.9.11": "3.9",
}


@pytest.mark.parametrize("greeting", GREETINGS)
def test_a_bin_of_old_firmware_is_refused_and_its_version_named(
    tmp_path: Path, greeting: bytes
) -> None:
    rule = f"it is of ArduPilot {GREETINGS[greeting]}, and logs are read from 4.0 on. Fly newer"
    with pytest.raises(InputError, match=re.escape(rule)):
        opened(tmp_path, copter(greeting))


@pytest.mark.parametrize("greeting", [b"ArduCopter V4.0.0 (0bb18a15)", b"ArduCopter V10.1.0"])
def test_a_bin_of_newer_firmware_is_read(tmp_path: Path, greeting: bytes) -> None:
    assert opened(tmp_path, copter(greeting)).autopilot == wire.MAV_AUTOPILOT_ARDUPILOTMEGA


def test_who_nobody_knows_is_refused_with_what_was_looked_for(tmp_path: Path) -> None:
    log = opened(tmp_path, copter(b"HomeBrew 1.0"))
    with pytest.raises(InputError, match=r"no HEARTBEAT: .*; no entry \(VER, MSG\) tells"):
        watch(log.path, None)


@pytest.mark.parametrize(
    ("release", "named"), [(0x010C03FF, "1.12"), (0x010400FF, "1.4"), (0x00090000, ""), (0, "")]
)
def test_a_ulg_of_old_firmware_is_refused_and_its_version_named(
    tmp_path: Path, release: int, named: str
) -> None:
    """Whoever builds it from no release has a version of 0: that one is read."""
    content = px4(1_000_000, 1_000_000, release)
    if named:
        with pytest.raises(InputError, match=f"of PX4 {named}, and logs are read from 1.13 on"):
            opened(tmp_path, content)
    else:
        assert len(positions(opened(tmp_path, content))) == FIXES


@pytest.mark.parametrize("header_us", [DATE_US, DATE_US - 5_000_000, 0, 112_000_000])
def test_a_clock_that_is_a_date_is_told_from_the_logs_beginning(
    tmp_path: Path, header_us: int
) -> None:
    """As PX4's simulation with Gazebo writes it: microseconds since 1970."""
    log = opened(tmp_path, px4(DATE_US, header_us))
    told = positions(log)
    assert len(told) == FIXES
    assert [time_us for time_us, _ in told] == [DATE_US + 100_000 * k for k in range(FIXES)]
    assert told[-1][1].time_boot_ms - told[0][1].time_boot_ms == 100 * (FIXES - 1)
    assert told[0][1].time_boot_ms < 10_000
    assert not counts(log)
    assert any("clock is a date" in finding for finding in log.findings)


def test_a_vehicle_that_is_up_for_months_is_read(tmp_path: Path) -> None:
    boot_us = 100 * 86_400 * 1_000_000
    log = opened(tmp_path, px4(boot_us, boot_us))
    told = positions(log)
    assert len(told) == FIXES
    assert told[0][1].time_boot_ms == boot_us // 1000 % (1 << 32)


def test_what_was_thrown_away_is_told_with_what_is_missing(tmp_path: Path) -> None:
    """Positions that are no numbers: a log of which nothing is left says why."""
    content = px4(1_000_000, 1_000_000).replace(struct.pack("<d", 8.0), struct.pack("<d", math.nan))
    log = opened(tmp_path, content)
    with pytest.raises(InputError, match=r"no GLOBAL_POSITION_INT: .*; [\d,]+ entries that cannot"):
        watch(log.path, None)
