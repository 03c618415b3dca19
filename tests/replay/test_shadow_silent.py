"""Vehicles that fall silent, reboot, or write only while they are armed: what is known ends there.

Times are seconds after the first record.
"""

import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from cut_logs import (
    STATION,
    alone,
    changed,
    mission,
    packed,
    recorded,
    thinned,
    written,
)
from log_files import bin_of, fmt_entries
from recordings import recording

from companion.mavlink.dialect import Message, wire
from companion.replay.shadow import watch
from companion.replay.shadow_report import Observed, ShadowReport, renderables
from companion.telemetry.logs import Record

HEALTHY, PX4 = "px4-offboard-8mps.tlog", "px4-gps-loss.tlog"
COPTER = "arducopter-guided-10mps.tlog"
HEARTBEAT = wire.MAVLINK_MSG_ID_HEARTBEAT
POSITION = wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
GPS = wire.MAVLINK_MSG_ID_GPS_RAW_INT


def of(report: ShadowReport, kind: str) -> list[Observed]:
    return [each for each in report.health if each.kind == kind]


def station(last: Record, seconds: int) -> Iterator[Record]:
    """A ground station that goes on recording its own heartbeats."""
    beat = wire.MAVLink_heartbeat_message(wire.MAV_TYPE_GCS, wire.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3)
    for k in range(1, seconds + 1):
        yield Record(last.time_us + k * 1_000_000, packed(beat, STATION))


def later(records: Iterator[Record], by_us: int) -> Iterator[Record]:
    """By the log's clock."""
    for record in records:
        yield Record(record.time_us + by_us, record.frame)


def test_of_a_vehicle_that_falls_silent_nothing_is_told_beyond_its_last_word(
    tmp_path: Path,
) -> None:
    """In the midst of its failsafe, in the air; the ground station records for 5 minutes more."""
    flown = list(recorded(PX4, until_s=90.0))
    path = written(tmp_path / "silent.tlog", [*flown, *station(flown[-1], 300)])
    whole, report = alone(written(tmp_path / "flown.tlog", flown)), alone(path)
    last_s = (flown[-1].time_us - flown[0].time_us) * 1e-6
    assert report.length_s == pytest.approx(last_s + 300.0)
    [failsafe] = of(report, "the autopilot's own failsafe")
    assert of(whole, "the autopilot's own failsafe")[0].until_s is None
    assert failsafe.until_s == pytest.approx(last_s, abs=0.1)
    [silence] = of(report, "silence")
    assert silence.from_s == pytest.approx(last_s, abs=0.1)
    assert silence.until_s is None
    assert report.in_air_s == pytest.approx(whole.in_air_s, abs=0.1)
    assert all(each.at_s <= last_s for each in report.said)


@pytest.mark.parametrize("silent_s", [1, 15, 700])
def test_a_reboot_is_told_however_long_it_takes(tmp_path: Path, silent_s: int) -> None:
    """Before it the GPS has no fix; and while it boots it does not say what it is."""

    def blind(message: Message) -> None:
        message.fix_type = 1

    beats = iter(range(3))

    def unborn(message: Message) -> None:
        if next(beats, None) is not None:
            message.type = wire.MAV_TYPE_GENERIC

    first = list(
        changed(
            changed(recorded(HEALTHY, until_s=20.0), GPS, blind),
            HEARTBEAT,
            unborn,
        )
    )
    gap_us = first[-1].time_us - first[0].time_us + silent_s * 1_000_000
    again = list(later(recorded(HEALTHY, until_s=25.0), gap_us))
    report = alone(written(tmp_path / "reboot.tlog", [*first, *again]))
    [reboot] = of(report, "the autopilot has rebooted")
    assert reboot.from_s == pytest.approx(20.0 + silent_s, abs=1.0)
    no_fix = of(report, "no GPS fix yet")[0]
    assert no_fix.from_s < 5.0
    assert no_fix.until_s == pytest.approx(20.0, abs=1.5)
    assert report.watched_from_s is not None
    assert report.watched_from_s > 20.0 + silent_s
    assert report.holds == []
    assert not [note for note in report.notes if "gave up" in note]
    said = "\n".join(str(each) for each in renderables(report))
    assert "this mission is for" not in said


@pytest.mark.sample(2)
@pytest.mark.parametrize("every", [6, 12])
def test_a_mission_adds_no_holds_to_those_of_the_vehicle(tmp_path: Path, every: int) -> None:
    """Positions 0.6 s and 1.2 s apart are no loss of them, whenever a plan comes."""
    records = thinned(recorded(HEALTHY, from_s=20.0, until_s=70.0), POSITION, every)
    path = written(tmp_path / "few.tlog", records)
    report = watch(path, mission("copter-zurich", evaluations=100))
    assert len([each for each in report.plans if each.outcome == "ready"]) > 5
    assert [each.let_go_s for each in report.holds] == [each.let_go_s for each in alone(path).holds]
    assert len(report.holds) <= 1


# --- on the vehicle's own card


def again(content: bytes, by_us: int) -> bytes:
    """The entries of a .bin once more, later by the vehicle's clock."""
    described = fmt_entries()
    sizes = {described[at + 3]: described[at + 4] for at in range(0, len(described), 89)}
    out, at = bytearray(content), 0
    while at < len(out):
        (time_us,) = struct.unpack_from("<Q", out, at + 3)
        struct.pack_into("<Q", out, at + 3, time_us + by_us)
        at += sizes[out[at + 2]]
    return bytes(out)


def test_a_bin_that_records_only_while_armed_is_not_silent_in_between(tmp_path: Path) -> None:
    """Two flights in one file, five minutes apart."""
    whole = bin_of(recording(COPTER), most=5000)
    head = len(fmt_entries())
    path, once = tmp_path / "armed.bin", tmp_path / "once.bin"
    once.write_bytes(whole)
    one = alone(once)
    gap_us = round((one.length_s + 300.0) * 1e6)
    path.write_bytes(whole + again(whole[head:], gap_us))
    report = alone(path)
    assert report.kind == "bin"
    assert of(report, "silence") == []
    ends = [(each.from_s, each.until_s or 0.0) for each in of(report, "not recorded")]
    gaps = [end for end in ends if end[1] - end[0] > 60.0]  # the log that was made has one of 3 s
    assert gaps == [pytest.approx((one.length_s, gap_us * 1e-6), abs=1.0)]
    assert "LINK_LOST" not in {why.code for hold in report.holds for why in hold.why}
    assert len(report.holds) == 2 * len(one.holds)
    assert report.in_air_s == pytest.approx(2 * one.in_air_s, abs=2.0)
    assert not [note for note in report.notes if "gave up" in note]
