"""ArduPilot's .bin, told as MAVLink, against the .tlog of the same flight."""

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from log_files import (
    FORMATS,
    bin_of,
    counts,
    entry,
    fmt_entries,
    messages_of,
    of,
    opened,
    told,
)
from recordings import recording

from companion.errors import InputError
from companion.mavlink.dialect import Message, wire
from companion.telemetry.logs import Odd, open_log

COPTER, PLANE = "arducopter-gps-loss", "arduplane-guided-reposition"
COPTER_START = b"".join(
    (
        fmt_entries(),
        entry("MSG", 1000, b"ArduCopter V4.5.7"),
        entry("PARM", 1000, b"SYSID_THISMAV", 7, 1),
        entry("PARM", 1000, b"FRAME_CLASS", 2, 1),
        entry("MODE", 2000, 4, 4, 1),
    )
)


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    folder = tmp_path_factory.mktemp("bin")

    @cache
    def file_of(name: str) -> Path:
        (folder / f"{name}.bin").write_bytes(bin_of(recording(f"{name}.tlog")))
        return folder / f"{name}.bin"

    return file_of


@pytest.mark.parametrize("name", [COPTER, PLANE])
@pytest.mark.sample(2)
def test_the_same_flight_is_told_as_in_its_tlog(name: str, flights: Callable[[str], Path]) -> None:
    theirs = messages_of(open_log(recording(f"{name}.tlog")).records())
    theirs = [pair for pair in theirs if pair[1].get_srcComponent() == 1]
    log = open_log(flights(name))
    ours = messages_of(log.records())
    assert not log.findings
    assert (log.kind, log.systems, log.system_id) == ("bin", (1,), 1)
    _same_positions(theirs, ours)
    for kind, fields in {
        "GPS_RAW_INT": ("fix_type", "lat", "lon", "alt", "satellites_visible", "vel", "cog"),
        "EKF_STATUS_REPORT": ("flags",),
        "HOME_POSITION": ("latitude", "longitude", "altitude"),
        "GPS_GLOBAL_ORIGIN": ("latitude", "longitude", "altitude"),
        "PARAM_VALUE": ("param_id", "param_value"),
    }.items():
        assert _values(ours, kind, fields) == pytest.approx(_values(theirs, kind, fields), abs=10)
    dates_ms = [
        {m.time_unix_usec // 1000 - m.time_boot_ms for m in of([m for _, m in each], "SYSTEM_TIME")}
        for each in (theirs, ours)
    ]
    assert max(dates_ms[1]) == pytest.approx(max(dates_ms[0]), abs=100)
    percents = {m.battery_remaining for m in of([m for _, m in ours], "SYS_STATUS")}
    assert percents <= {m.battery_remaining for m in of([m for _, m in theirs], "SYS_STATUS")}
    for seen, fields in (("HEARTBEAT", ("type", "custom_mode", "armed")),):
        assert _changes(ours, seen, fields) == _changes(theirs, seen, fields)
    texts = [m.text for m in of([m for _, m in theirs], "STATUSTEXT")]
    mine = [m.text for m in of([m for _, m in ours], "STATUSTEXT")]
    assert [text for text in mine if "V4.5.7 (" not in text] == texts  # that one is the writer's


def _same_positions(theirs: list[tuple[int, Message]], ours: list[tuple[int, Message]]) -> None:
    """The same at the same time since boot, to the last digit of the wire."""
    fields = ("lat", "lon", "alt", "relative_alt", "vx", "vy", "vz", "hdg")
    table = {m.time_boot_ms: m for _, m in theirs if m.get_type() == "GLOBAL_POSITION_INT"}
    positions = [(t, m) for t, m in ours if m.get_type() == "GLOBAL_POSITION_INT"]
    assert len(positions) > 0.95 * len(table)
    for _, mine in positions:
        other = table[mine.time_boot_ms]
        for field in fields:
            off = abs(getattr(mine, field) - getattr(other, field))
            assert min(off, abs(off - 36_000) if field == "hdg" else off) <= 1, field
    stamps = {m.time_boot_ms: t for t, m in theirs if m.get_type() == "GLOBAL_POSITION_INT"}
    late_s = np.array([stamps[m.time_boot_ms] - t for t, m in positions]) * 1e-6
    assert np.ptp(late_s) < 0.5  # the .tlog has the time of arrival, by another clock


def _values(pairs: list[tuple[int, Message]], kind: str, fields: tuple[str, ...]) -> list[float]:
    """All numbers of all messages of a kind, texts by their hash."""
    values = [getattr(m, f) for _, m in pairs if m.get_type() == kind for f in fields]
    return [hash(v) % 1000 if isinstance(v, str) else v for v in values]


def _changes(pairs: list[tuple[int, Message]], kind: str, fields: tuple[str, ...]) -> list[object]:
    """What follows what, without repetitions."""
    seen: list[object] = []
    for _, m in pairs:
        if m.get_type() != kind:
            continue
        armed = bool(m.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED)
        now = [armed if f == "armed" else getattr(m, f) for f in fields]
        if not seen or seen[-1] != now:
            seen.append(now)
    return seen


def test_a_failsafe_and_the_ground_are_told(flights: Callable[[str], Path]) -> None:
    messages = told(open_log(flights(COPTER)))
    states = [m.system_status for m in of(messages, "HEARTBEAT")]
    assert wire.MAV_STATE_CRITICAL in states
    assert states[0] == states[-1] == wire.MAV_STATE_STANDBY
    ground = [m.landed_state for m in of(messages, "EXTENDED_SYS_STATE")]
    assert ground[0] == ground[-1] == wire.MAV_LANDED_STATE_ON_GROUND
    assert wire.MAV_LANDED_STATE_IN_AIR in ground


def test_whose_log_it_is_stands_in_its_parameters(tmp_path: Path) -> None:
    log = opened(tmp_path, COPTER_START)
    (beat,) = of(told(log), "HEARTBEAT")
    assert (beat.get_srcSystem(), log.system_id) == (7, 7)
    assert beat.type == wire.MAV_TYPE_HEXAROTOR
    assert not beat.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED
    with pytest.raises(InputError, match=r"--system = 3: there is no such vehicle.*is system 7"):
        opened(tmp_path, COPTER_START, system_id=3)


def test_an_unknown_date_unknown_arming_and_what_is_missing_are_told(tmp_path: Path) -> None:
    log = opened(tmp_path, COPTER_START)
    told(log)
    assert set(counts(log)) == {Odd.NO_DATE}
    assert any("taken for disarmed" in each for each in log.findings)
    missing = {each.message: each for each in log.missing()}
    assert missing["EKF_STATUS_REPORT"].vital
    assert {"HEARTBEAT", "PARAM_VALUE", "STATUSTEXT", "ESTIMATOR_STATUS"}.isdisjoint(missing)


def test_without_an_estimator_the_gps_is_told_and_said_so(tmp_path: Path) -> None:
    content = bin_of(recording(f"{COPTER}.tlog"), without=("POS", "XKF1", "XKF4"))
    log = opened(tmp_path, content)
    messages = told(log)
    fixes = [m for m in of(messages, "GPS_RAW_INT") if m.fix_type >= 3]
    positions = of(messages, "GLOBAL_POSITION_INT")
    assert [(m.lat, m.lon, m.alt) for m in positions] == [(m.lat, m.lon, m.alt) for m in fixes]
    (home, *_) = of(messages, "HOME_POSITION")
    assert positions[-1].relative_alt == pytest.approx(positions[-1].alt - home.altitude, abs=20)
    for mine, fix in zip(positions, fixes, strict=True):
        assert math.hypot(mine.vx, mine.vy) == pytest.approx(fix.vel, abs=1.5)
    said = "\n".join(str(each) for each in log.findings)
    assert "positions are those of the GPS" in said
    assert "velocities are those of the GPS" in said
    assert "EKF_STATUS_REPORT" in [each.message for each in log.missing()]


def test_a_position_without_a_velocity_is_not_told(tmp_path: Path) -> None:
    place = (471_000_000, 85_000_000, 500, 0, 0)
    estimate = (0, 0, 0, 90, 3, 4, 0, *([0] * 8))
    content = (
        COPTER_START
        + entry("POS", 1_000_000, *place)
        + entry("XKF1", 2_000_000, *estimate)
        + entry("POS", 2_100_000, *place)
        + entry("POS", 3_900_000, *place)
    )
    (position,) = of(told(opened(tmp_path, content)), "GLOBAL_POSITION_INT")
    assert (position.time_boot_ms, position.vx, position.vy) == (2100, 300, 400)


@pytest.mark.parametrize(("capacity_mah", "percents"), [(4000, [75, 50, 0]), (0, [-1, -1, -1])])
def test_what_is_left_in_a_battery_of_4_0_is_reckoned_as_ardupilot_does(
    capacity_mah: float, percents: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its BAT has no RemPct yet."""
    columns = "TimeUS,Instance,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res"
    monkeypatch.setitem(FORMATS, "BAT", (76, "QBfffffcf", columns))
    content = fmt_entries() + entry("PARM", 2000, b"BATT_CAPACITY", capacity_mah, 1)
    for k, used_mah in enumerate((1000, 2000, 5000), start=1):
        content += entry("BAT", 1_000_000 * k, 0, 16, 16, 10, used_mah, 0, 20, 0)
    batteries = of(told(opened(tmp_path, content)), "SYS_STATUS")
    assert [m.battery_remaining for m in batteries] == percents


def test_positions_are_thinned_to_fifty_a_second(tmp_path: Path) -> None:
    content = COPTER_START + entry("XKF1", 5000, 0, 0, 0, 90, 3, 4, 0, *([0] * 8))
    for k in range(400):
        content += entry("POS", 10_000 + 2500 * k, 471_000_000, 85_000_000, 500, 0, 0)
    positions = of(told(opened(tmp_path, content)), "GLOBAL_POSITION_INT")
    assert len(positions) == 50


def test_an_entry_that_is_damaged_is_left_out_and_the_rest_is_kept(tmp_path: Path) -> None:
    rest = [entry("MSG", 3_000_000 + k * 1000, b"text %d" % k) for k in range(6)]
    content = COPTER_START + rest[0] + rest[1][:20] + rest[2] + b"noise" + rest[3] + rest[4]
    log = opened(tmp_path, content + rest[5][:30])
    texts = [m.text for m in of(told(log), "STATUSTEXT")]
    assert texts == ["ArduCopter V4.5.7", "text 0", "text 3", "text 4"]
    found = counts(log)
    assert found[Odd.DAMAGED] == 2  # what noise follows, too
    assert found[Odd.GARBAGE] == 20 + len(rest[2]) + len(b"noise") - 2 * len(b"\xa3\x95")
    assert found[Odd.CUT_SHORT] == 30
    assert log.read_bytes == log.size_bytes


def test_numbers_that_fit_into_no_message_are_damage(tmp_path: Path) -> None:
    nan = math.nan
    content = COPTER_START + b"".join(
        (
            entry("XKF1", 3000, 0, 0, 0, 90, nan, 1e30, 0, *([0] * 8)),
            entry("POS", 4000, 1, 1, 500, 0, 0),
            entry("POS", 900_000, 1, 1, math.inf, 0, 0),
            entry("BAT", 5000, 0, nan, nan, nan, nan, 0, 0, 0, 0, 0, 0),
            entry("MODE", 6000, 200, 200, 1),
            entry("MSG", 7000, b"\xff\xfe\x00"),
        )
    )
    log = opened(tmp_path, content)
    assert of(told(log), "GLOBAL_POSITION_INT") == []
    assert counts(log)[Odd.DAMAGED] == 3


def test_a_time_that_leaps_is_not_believed_once(tmp_path: Path) -> None:
    times = [3_000_000, 4_000_000, 1 << 60, 5_000_000, 4_000_000_000, 6_000_000]
    content = COPTER_START + b"".join(entry("MSG", t, b"at %d" % t) for t in times)
    log = opened(tmp_path, content)
    texts = [m.text for m in of(told(log), "STATUSTEXT")][1:]
    assert texts == ["at 3000000", "at 4000000", "at 5000000", "at 6000000"]
    assert counts(log)[Odd.WRONG_STAMP] == 2


def test_what_the_vehicle_could_not_write_is_told(tmp_path: Path) -> None:
    lost = b"".join(entry("DSF", 3000 + k, each, *([0] * 5)) for k, each in enumerate((0, 40, 42)))
    log = opened(tmp_path, COPTER_START + lost)
    told(log)
    assert counts(log)[Odd.LOST_ENTRIES] == 42
