"""Logs of MAVLink frames, of anybody's: against pymavlink's own reader, and as files are."""

import hashlib
import os
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from log_files import counts, messages_of
from recordings import NAMES, recording

from companion.errors import InputError
from companion.mavlink.dialect import wire
from companion.mavlink.signing import strip_signature
from companion.telemetry.logs import Log, Odd, open_log

LOGS = [recording(name) for name in NAMES if name.endswith(".tlog")]
EPOCH_US = 1_700_000_000_000_000


PYMAVLINK = """
import hashlib, sys
from pymavlink import mavutil
mavutil.set_dialect("all")
digest, count = hashlib.sha256(), 0
log = mavutil.mavlink_connection(sys.argv[1])
while (message := log.recv_msg()) is not None:
    digest.update(round(message._timestamp * 1e6).to_bytes(8, "big") + message.get_msgbuf())
    count += 1
print(count, digest.hexdigest())
"""
"""In a process of its own: mavutil keeps global state."""


def heartbeat(*, mav_type: int = 2, autopilot: int = 3) -> wire.MAVLink_message:
    return wire.MAVLink_heartbeat_message(mav_type, autopilot, 81, 4, 4, 3)


class Writer:
    """A file of records, as somebody writes it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.content = b""

    def add(
        self,
        message: wire.MAVLink_message,
        stamp: bytes | int | None,
        *,
        system: int = 1,
        component: int = 1,
        first: bool = False,
        key: bytes | None = None,
    ) -> bytes:
        codec = wire.MAVLink(None, srcSystem=system, srcComponent=component)
        if key is not None:
            codec.signing.sign_outgoing, codec.signing.secret_key = True, key
        frame = bytes(message.pack(codec, force_mavlink1=first))
        before = struct.pack(">Q", stamp) if isinstance(stamp, int) else stamp or b""
        self.content += before + frame
        return frame

    def open(self, system_id: int | None = None) -> Log:
        self.path.write_bytes(self.content)
        return open_log(self.path, system_id=system_id)


@pytest.fixture
def writer(tmp_path: Path) -> Writer:
    return Writer(tmp_path / "flight.tlog")


def attitude(boot_ms: int) -> wire.MAVLink_message:
    return wire.MAVLink_attitude_message(boot_ms, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("path", LOGS[::2], ids=lambda path: path.stem)
@pytest.mark.sample(2)
def test_a_recorded_log_is_read_as_pymavlink_reads_it(path: Path) -> None:
    environment = {**os.environ, "MAVLINK20": "1"}
    command = [sys.executable, "-c", PYMAVLINK, str(path)]
    theirs = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    log, digest, count = open_log(path), hashlib.sha256(), 0
    for record in log.records():
        digest.update(record.time_us.to_bytes(8, "big") + record.frame)
        count += 1
    assert f"{count} {digest.hexdigest()}" == theirs.stdout.strip()
    assert log.read_bytes == log.size_bytes == path.stat().st_size
    assert (log.kind, log.systems, log.system_id) == ("tlog", (1,), 1)
    # The dialect lacks some of PX4's newest messages, nothing else is odd.
    assert set(counts(log)) <= {Odd.UNKNOWN}


def test_reading_again_begins_again(writer: Writer) -> None:
    writer.add(heartbeat(), EPOCH_US)
    writer.add(attitude(10), EPOCH_US + 1, first=True)
    log = writer.open()
    once, found = list(log.records()), log.findings
    assert [record.time_us for record in once] == [EPOCH_US, EPOCH_US + 1]
    assert (list(log.records()), log.findings) == (once, found)


@pytest.mark.parametrize("stamp", [b"", b"\0" * 8, b"\xee" * 8, struct.pack(">Q", 5_000_000)])
def test_without_dates_for_stamps_time_is_the_vehicles(writer: Writer, stamp: bytes) -> None:
    for k in range(20):
        writer.add(heartbeat(), stamp)
        writer.add(attitude(10_000 + 100 * k), stamp)
        writer.add(heartbeat(), stamp, system=255, component=190)
    log = writer.open()
    expected = [0, *(t for k in range(20) for t in [10_000_000 + 100_000 * k] * 3)][:-1]
    assert [record.time_us for record in log.records()] == expected
    assert set(counts(log)) == {Odd.NO_STAMPS}


HOUR = 3_600_000_000
SENSELESS = 1 << 63


@pytest.mark.parametrize(
    ("stamps", "times", "found"),
    [
        (  # nonsense gets the time before
            [1, 2, -EPOCH_US, 3, SENSELESS, 4, -400_000_000, 5, 900_000_000_000, 6],
            [1, 2, 2, 3, 3, 4, 4, 5, 5, 6],
            {Odd.WRONG_STAMP: 4},
        ),
        (  # a clock that was set back: the first stamp after that is doubted
            [0, 1000, 2000, 2000 - HOUR, 3000 - HOUR, 4000 - HOUR, 5000 - HOUR],
            [0, 1000, 2000, 2000, 2000, 3000, 4000],
            {Odd.TIME_BACK: 1},
        ),
        # a first stamp that nothing agrees with
        ([500_000_000_000_000, 0, 1000, 2000], [0, 0, 1000, 2000], {Odd.WRONG_STAMP: 1}),
        (  # a pause, and steps back of more and of less than a millisecond
            [0, 1000, 990, 500_000, 400_000, HOUR, HOUR + 5, HOUR + 10],
            [0, 1000, 1000, 500_000, 500_000, 500_000, HOUR + 5, HOUR + 10],
            {Odd.TIME_JITTER: 1, Odd.TIME_GAP: 1},
        ),
    ],
)
def test_time_never_falls_and_what_is_odd_about_it_is_counted(
    writer: Writer, stamps: list[int], times: list[int], found: dict[Odd, int]
) -> None:
    for stamp in stamps:
        writer.add(heartbeat(), stamp if stamp == SENSELESS else EPOCH_US + stamp)
    log = writer.open()
    assert [record.time_us - EPOCH_US for record in log.records()] == times
    assert counts(log) == found


def test_garbage_is_passed_over_and_counted(writer: Writer) -> None:
    writer.content = b"Telemetry log, v1\r\n\xfd\x09\xfe\xfe"
    kept = [writer.add(heartbeat(), EPOCH_US)]
    writer.content += b"\xfd" * 300
    kept.append(writer.add(attitude(5), EPOCH_US + 1))
    writer.content += b"abc"
    kept.append(writer.add(attitude(6), EPOCH_US + 2))
    writer.content += b"abc"
    kept.append(writer.add(attitude(7), None))  # without its stamp
    log = writer.open()
    assert [record.frame for record in log.records()] == kept
    assert [record.time_us - EPOCH_US for record in log.records()] == [0, 1, 2, 2]
    assert counts(log) == {Odd.GARBAGE: 23 + 300 + 3 + 3, Odd.NO_STAMP: 1}


@pytest.mark.parametrize("cut", range(1, 29))
def test_a_log_may_begin_and_end_in_the_middle_of_a_record(writer: Writer, cut: int) -> None:
    frames = [writer.add(heartbeat(), EPOCH_US + k) for k in range(5)]
    size = len(writer.content) // 5
    assert size == 29
    writer.content = writer.content[cut:-cut]
    log = writer.open()
    begun = cut <= 8  # then the first frame is whole, though its stamp is not
    assert [record.frame for record in log.records()] == frames[: 3 + begun]
    found = counts(log)
    assert found[Odd.CUT_SHORT] == size - cut
    assert found.get(Odd.GARBAGE, 0) == (8 - cut if begun else size - cut)


def test_a_wrong_checksum_costs_one_message(writer: Writer) -> None:
    for k in range(10):
        writer.add(heartbeat(), EPOCH_US + k)
    content = bytearray(writer.content)
    content[3 * 29 + 8 + 12] ^= 0x10
    writer.content = bytes(content)
    log = writer.open()
    assert [record.time_us - EPOCH_US for record in log.records()] == [0, 1, 2, 4, 5, 6, 7, 8, 9]
    assert counts(log) == {Odd.CHECKSUM: 1}
    assert log.findings == ("1 messages with a wrong checksum were left out",)


def test_both_protocols_signed_or_not_are_told_apart(writer: Writer) -> None:
    writer.add(heartbeat(), EPOCH_US)
    writer.add(attitude(1), EPOCH_US, first=True)
    signed = writer.add(attitude(1), EPOCH_US, key=bytes(32))
    plain = writer.add(attitude(1), EPOCH_US)
    log = writer.open()
    records = list(log.records())
    assert counts(log) == {Odd.MAVLINK_1: 1, Odd.SIGNED: 1}
    assert records[2].frame == signed
    assert strip_signature(records[2].frame) == plain
    assert [m.get_type() for _, m in messages_of(records)] == ["HEARTBEAT"] + ["ATTITUDE"] * 3


def test_keys_and_passwords_do_not_come_out(writer: Writer) -> None:
    writer.add(heartbeat(), EPOCH_US)
    writer.add(wire.MAVLink_setup_signing_message(1, 1, list(range(32)), 5), EPOCH_US)
    log = writer.open()
    assert len(list(log.records())) == 1
    assert counts(log) == {Odd.SECRET: 1}


def _two_vehicles(writer: Writer) -> None:
    for k in range(10):
        writer.add(heartbeat(), EPOCH_US + k, system=1)
        writer.add(heartbeat(mav_type=6, autopilot=8), EPOCH_US + k, system=255, component=190)
        writer.add(attitude(k), EPOCH_US + k, system=1)
        if k == 7:
            writer.add(heartbeat(autopilot=12), EPOCH_US + k, system=3)
        writer.add(attitude(k), EPOCH_US + k, system=3)
        writer.add(heartbeat(mav_type=18, autopilot=8), EPOCH_US + k, system=4)


def test_of_several_vehicles_one_must_be_chosen(writer: Writer) -> None:
    _two_vehicles(writer)
    with pytest.raises(InputError, match=r"several vehicles are in it, systems 1, 3\. Choose one"):
        writer.open()
    with pytest.raises(InputError, match=r"--system = 9: there is no such vehicle.*are 1, 3\."):
        writer.open(9)
    log = writer.open(3)
    senders = {m.get_srcSystem() for _, m in messages_of(log.records())}
    assert senders == {3, 4, 255}
    assert counts(log) == {Odd.OTHER_VEHICLE: 20}
    assert (log.systems, log.system_id) == ((1, 3), 3)


def test_a_log_without_a_vehicle_can_be_read(writer: Writer) -> None:
    writer.add(attitude(1), EPOCH_US)
    log = writer.open()
    assert (log.systems, log.system_id, len(list(log.records()))) == ((), None, 1)
    names = [each.message for each in log.missing()]
    assert names[:2] == ["HEARTBEAT", "GLOBAL_POSITION_INT"]
    assert {"EKF_STATUS_REPORT", "ESTIMATOR_STATUS"} <= set(names)
    with pytest.raises(InputError, match="leave --system out"):
        writer.open(1)


def test_what_is_missing_is_told_with_how_to_have_it(writer: Writer) -> None:
    writer.add(heartbeat(), EPOCH_US)
    writer.add(wire.MAVLink_gps_raw_int_message(1, 3, 1, 1, 1, 1, 1, 1, 1, 1), EPOCH_US)
    log = writer.open()
    list(log.records())
    missing = {each.message: each for each in log.missing()}
    assert "HEARTBEAT" not in missing
    assert "GPS_RAW_INT" not in missing
    assert "ESTIMATOR_STATUS" not in missing  # PX4's
    assert missing["GLOBAL_POSITION_INT"].vital
    assert not missing["HOME_POSITION"].vital
    assert str(missing["HOME_POSITION"]).endswith("What to record, and how: docs/logs.md")


def test_a_px4_flight_lacks_only_what_px4_does_not_send() -> None:
    log = open_log(recording("px4-gps-loss.tlog"))
    list(log.records())
    assert [each.message for each in log.missing()] == ["STATUSTEXT"]
