"""Logs of other versions: old ArduCopters, and PX4s whose clock is a date.

The entries are those that these versions describe in their own FMT entries: 3.1 as in ArduPilot's
Tools/LogAnalyzer/examples/mechanical_fail.log (columns of ATT by their later names), 3.3 as in its
LogStructure.h.
"""

import math
import struct
from pathlib import Path

import pytest
from log_files import Formats, entry, fmt_entries, messages_of, opened
from test_logs_ulg import message, status, text

from companion.errors import InputError
from companion.mavlink.dialect import Message, wire
from companion.replay.shadow import watch
from companion.telemetry.logs import Anomaly, Log

V3_1: Formats = {
    "FMT": (128, "BBnNZ", "Type,Length,Name,Format"),  # one name less than letters
    "PARM": (129, "Nf", "Name,Value"),
    "GPS": (
        130,
        "BIHBcLLeeEefI",
        "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T",
    ),
    "MSG": (132, "Z", "Message"),
    "CURR": (9, "hIhhhf", "ThrOut,ThrInt,Volt,Curr,Vcc,CurrTot"),
    "ATT": (1, "cccccCC", "DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,NavYaw"),
    "MODE": (3, "Mh", "Mode,ThrCrs"),
    "STRT": (10, "", ""),
    "EV": (13, "B", "Id"),
}
V3_3: Formats = {
    "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"),
    "PARM": (129, "QNf", "TimeUS,Name,Value"),
    "GPS": (
        130,
        "QBIHBcLLeeEefB",
        "TimeUS,Status,GMS,GWk,NSats,HDop,Lat,Lng,RAlt,Alt,Spd,GCrs,VZ,U",
    ),
    "MSG": (134, "QZ", "TimeUS,Message"),
    "MODE": (4, "QMB", "TimeUS,Mode,ModeNum"),
    "EV": (13, "QB", "TimeUS,Id"),
}
WEEK, OF_WEEK_MS, BOOT_MS = 1774, 109_206_800, 66_937
PLACE = (-394_950_300, 1_767_483_511)
FIXES = 60
DATE_US = 1_710_773_350_346_000


def old_copter() -> bytes:
    """ArduCopter 3.1: TimeMS is the GPS's, T the vehicle's; nothing else has a time."""
    out = fmt_entries(V3_1, V3_1)
    out += entry("MSG", b"ArduCopter V3.1 (5c6503e2)", formats=V3_1)
    out += entry("PARM", b"FRAME", 1, formats=V3_1)
    out += entry("MODE", 0, 352, formats=V3_1) + entry("EV", 10, formats=V3_1)
    for k in range(FIXES):
        ms = 200 * k
        place = (PLACE[0] + 20 * k, PLACE[1], 0.05, 46.82)
        fix = (3, OF_WEEK_MS + ms, WEEK, 9, 2.42, *place, 1.1, 0.0, 0.08, BOOT_MS + ms)
        out += entry("GPS", *fix, formats=V3_1)
        out += entry("ATT", 0, -0.3, 0, -4.66, 0, 358.89, 358.89, formats=V3_1)
    return out


def copter_of_3_3(greeting: bytes) -> bytes:
    """Of 3.3 and 3.4: the same GPS, by a clock in microseconds."""
    out = fmt_entries(V3_3, V3_3) + entry("MSG", 900_000, greeting, formats=V3_3)
    out += entry("MODE", 950_000, 0, 0, formats=V3_3)
    for k in range(FIXES):
        place = (*PLACE, 0.05, 46.82)
        fix = (3, OF_WEEK_MS + 200 * k, WEEK, 9, 2.42, *place, 0.0, 0.0, 0.0, 1)
        out += entry("GPS", 1_000_000 + 200_000 * k, *fix, formats=V3_3)
    return out


TOPICS = (
    b"vehicle_status:uint64_t timestamp;uint8_t nav_state;uint8_t arming_state;bool failsafe;"
    b"uint8_t system_type;uint8_t[4] _padding0;",
    b"vehicle_global_position:uint64_t timestamp;double lat;double lon;float alt;",
    b"vehicle_local_position:uint64_t timestamp;double ref_lat;double ref_lon;float ref_alt;"
    b"float x;float y;float z;float vx;float vy;float vz;float heading;float eph;float epv;"
    b"bool xy_valid;bool z_valid;bool v_xy_valid;bool v_z_valid;bool xy_global;bool z_global;"
    b"bool dist_bottom_valid;",
)


def px4(clock_us: int, header_us: int) -> bytes:
    """A PX4 whose clock begins there, and says something else in the header."""
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", header_us)
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


def test_an_old_logs_time_is_the_vehicles_and_not_that_of_the_gps_week(tmp_path: Path) -> None:
    log = opened(tmp_path, old_copter())
    told = positions(log)
    assert [m.time_boot_ms for _, m in told] == [BOOT_MS + 200 * k for k in range(FIXES)]
    assert [(m.lat, m.relative_alt) for _, m in told] == [
        (PLACE[0] + 20 * k, 50) for k in range(FIXES)
    ]
    gps_s = WEEK * 604_800 + OF_WEEK_MS * 1e-3
    assert told[0][0] * 1e-6 == pytest.approx(315_964_800 + gps_s - 18, abs=1e-3)
    odd = {finding.oddity for finding in log.findings}
    assert odd == {Anomaly.SUBSTITUTED}  # nothing is damaged, and no stamp disbelieved
    report = watch(log.path, None, plans=False)
    assert report.vehicle == "ArduCopter"
    assert report.watched_from_s is not None
    assert report.length_s == pytest.approx(0.2 * (FIXES - 1), abs=0.01)


@pytest.mark.parametrize(
    "greeting", [b"APM:Copter V3.3.3 (acf1e7f2)", b"APM:Copter V3.4.6", b"ArduCopter V3.6"]
)
def test_every_copters_greeting_is_known(tmp_path: Path, greeting: bytes) -> None:
    log = opened(tmp_path, copter_of_3_3(greeting))
    beats = [m for _, m in messages_of(log.records()) if m.get_type() == "HEARTBEAT"]
    assert {m.type for m in beats} == {wire.MAV_TYPE_QUADROTOR}
    assert watch(log.path, None, plans=False).watched_from_s is not None


def test_who_nobody_knows_is_refused_with_what_was_looked_for(tmp_path: Path) -> None:
    log = opened(tmp_path, copter_of_3_3(b"HomeBrew 1.0"))
    with pytest.raises(InputError, match=r"no HEARTBEAT: .*; no entry \(VER, MSG\) tells"):
        watch(log.path, None, plans=False)


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
    odd = {finding.oddity for finding in log.findings}
    assert odd == {Anomaly.SUBSTITUTED}
    assert any("clock is a date" in str(finding) for finding in log.findings)


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
        watch(log.path, None, plans=False)
