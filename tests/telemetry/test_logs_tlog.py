"""Logs of MAVLink frames, of anybody's: against pymavlink's own reader, and as files are."""

import hashlib
import os
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from log_files import counts, messages_of, opened
from recordings import NAMES, recording

from companion.errors import InputError
from companion.mavlink.dialect import wire
from companion.telemetry.logs import Odd, open_log

LOGS = [recording(name) for name in NAMES if name.endswith(".tlog")]
EPOCH_US = 1_700_000_000_000_000
HOUR = 3_600_000_000
STATION = (255, 190)
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


def attitude(boot_ms: int) -> wire.MAVLink_message:
    return wire.MAVLink_attitude_message(boot_ms, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)


def frame(
    message: wire.MAVLink_message,
    sender: tuple[int, int] = (1, 1),
) -> bytes:
    return bytes(message.pack(wire.MAVLink(None, srcSystem=sender[0], srcComponent=sender[1])))


def stamped(at_us: int, content: bytes) -> bytes:
    """A record: microseconds after the epoch, and a frame."""
    return struct.pack(">Q", EPOCH_US + at_us) + content


BEAT = frame(heartbeat())
BEATS = [stamped(k, BEAT) for k in range(10)]


@pytest.mark.parametrize("path", LOGS[::2], ids=lambda path: path.stem)
@pytest.mark.sample(2)
def test_a_recorded_log_is_read_as_pymavlink_reads_it(path: Path) -> None:
    """And each time that it is read."""
    environment = {**os.environ, "MAVLINK20": "1"}
    command = [sys.executable, "-c", PYMAVLINK, str(path)]
    theirs = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    log = open_log(path)
    for _ in range(2):
        digest, count = hashlib.sha256(), 0
        for record in log.records():
            digest.update(record.time_us.to_bytes(8, "big") + record.frame)
            count += 1
        assert f"{count} {digest.hexdigest()}" == theirs.stdout.strip()
    assert (log.kind, log.systems, log.system_id) == ("tlog", (1,), 1)
    # The dialect lacks some of PX4's newest messages, nothing else is odd.
    assert set(counts(log)) <= {Odd.UNKNOWN}


def test_without_stamps_a_log_is_refused(tmp_path: Path) -> None:
    """As MAVProxy's .raw and Mission Planner's .rlog."""
    with pytest.raises(InputError, match=r"no time stamps\. Give the \.tlog that was written"):
        opened(tmp_path, BEAT * 20)


CLOCKS: dict[str, tuple[list[int], list[int], dict[Odd, int]]] = {
    "nonsense gets the time before": (
        [1, 2, -EPOCH_US, 3, (1 << 63) - EPOCH_US, 4, -400_000_000, 5, 900_000_000_000, 6],
        [1, 2, 2, 3, 3, 4, 4, 5, 5, 6],
        {Odd.WRONG_STAMP: 4},
    ),
    "a clock that is set back is doubted once": (
        [0, 1000, 2000, 2000 - HOUR, 3000 - HOUR, 4000 - HOUR, 5000 - HOUR],
        [0, 1000, 2000, 2000, 2000, 3000, 4000],
        {Odd.TIME_BACK: 1},
    ),
    "a first stamp that nothing agrees with": (
        [500_000_000_000_000, 0, 1000, 2000],
        [0, 0, 1000, 2000],
        {Odd.WRONG_STAMP: 1},
    ),
    "a pause, and steps back of less than a second": (
        [0, 1000, 990, 500_000, 400_000, HOUR, HOUR + 5, HOUR + 10],
        [0, 1000, 1000, 500_000, 500_000, 500_000, HOUR + 5, HOUR + 10],
        {Odd.TIME_GAP: 1},
    ),
}


@pytest.mark.parametrize("clock", CLOCKS)
def test_time_never_falls_and_what_is_odd_about_it_is_counted(tmp_path: Path, clock: str) -> None:
    stamps, times, found = CLOCKS[clock]
    log = opened(tmp_path, b"".join(stamped(at_us, BEAT) for at_us in stamps))
    assert [record.time_us - EPOCH_US for record in log.records()] == times
    assert counts(log) == found


def flipped(content: bytes, place: int) -> bytes:
    """With a wrong bit there."""
    return content[:place] + bytes([content[place] ^ 0x10]) + content[place + 1 :]


NOISY = b"".join(
    (
        *(b"Telemetry log, v1\r\n\xfd\x09\xfe\xfe", BEATS[0], b"\xfd" * 300, BEATS[1]),
        *(b"abc", BEATS[2], b"abc", BEAT),  # the last one without its stamp
    )
)
SECRET = frame(wire.MAVLink_setup_signing_message(1, 1, list(range(32)), 5))
DAMAGES: dict[str, tuple[bytes, list[int], dict[Odd, int]]] = {
    "garbage": (NOISY, [0, 1, 2, 2], {Odd.GARBAGE: 23 + 300 + 3 + 3, Odd.NO_STAMP: 1}),
    "a wrong checksum costs one message": (
        flipped(b"".join(BEATS), 3 * len(BEATS[0]) + 20),
        [0, 1, 2, 4, 5, 6, 7, 8, 9],
        {Odd.CHECKSUM: 1},
    ),
    "keys do not come out": (BEATS[0] + stamped(1, SECRET), [0], {Odd.SECRET: 1}),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_no_message_is_passed_over_and_counted(tmp_path: Path, damage: str) -> None:
    content, times, found = DAMAGES[damage]
    log = opened(tmp_path, content)
    assert [record.time_us - EPOCH_US for record in log.records()] == times
    assert counts(log) == found
    if found == {Odd.CHECKSUM: 1}:
        assert log.findings == ("1 messages with a wrong checksum were left out",)


def test_a_log_may_begin_and_end_in_the_middle_of_a_record(tmp_path: Path) -> None:
    size = len(BEATS[0])
    for cut in range(1, size):
        log = opened(tmp_path, b"".join(BEATS[:5])[cut:-cut])
        begun = cut <= 8  # then the first frame is whole, though its stamp is not
        assert [record.frame for record in log.records()] == [BEAT] * (3 + begun)
        found = counts(log)
        assert found[Odd.CUT_SHORT] == size - cut
        assert found.get(Odd.GARBAGE, 0) == (8 - cut if begun else size - cut)


def test_both_protocols_signed_or_not_are_told_apart(tmp_path: Path) -> None:
    codec = wire.MAVLink(None, srcSystem=1, srcComponent=1)
    frames = [BEAT, frame(attitude(1)), bytes(attitude(1).pack(codec, force_mavlink1=True))]
    codec.signing.sign_outgoing, codec.signing.secret_key = True, bytes(32)
    frames.append(bytes(attitude(1).pack(codec)))
    log = opened(tmp_path, b"".join(stamped(0, each) for each in frames))
    records = list(log.records())
    assert counts(log) == {Odd.SIGNED: 1}
    assert [record.frame for record in records] == frames
    assert [m.get_type() for _, m in messages_of(records)] == ["HEARTBEAT"] + ["ATTITUDE"] * 3


def test_of_several_vehicles_one_must_be_chosen(tmp_path: Path) -> None:
    content = b""
    for k in range(10):
        station = frame(heartbeat(mav_type=6, autopilot=8), STATION)
        other, companion = heartbeat(autopilot=12), heartbeat(mav_type=18, autopilot=8)
        content += stamped(k, BEAT) + stamped(k, station) + stamped(k, frame(attitude(k)))
        content += stamped(k, frame(other, (3, 1))) if k == 7 else b""
        content += stamped(k, frame(attitude(k), (3, 1))) + stamped(k, frame(companion, (4, 1)))
    for asked, rule in {
        None: r"several vehicles are in it, systems 1, 3\. Choose one",
        9: r"--system = 9: there is no such vehicle.*Its vehicles: 1, 3\.",
    }.items():
        with pytest.raises(InputError, match=rule):
            opened(tmp_path, content, system_id=asked)
    log = opened(tmp_path, content, system_id=3)
    assert {m.get_srcSystem() for _, m in messages_of(log.records())} == {3, 4, 255}
    assert counts(log) == {Odd.OTHER_VEHICLE: 20}
    assert (log.systems, log.system_id) == ((1, 3), 3)


def test_what_is_missing_is_told_with_how_to_have_it(tmp_path: Path) -> None:
    gps = wire.MAVLink_gps_raw_int_message(1, 3, *[1] * 8)
    log = opened(tmp_path, BEATS[0] + stamped(0, frame(gps)))
    list(log.records())
    missing = log.missing()
    assert not {"HEARTBEAT", "GPS_RAW_INT", "ESTIMATOR_STATUS"} & missing.keys()  # the last: PX4's
    assert "GLOBAL_POSITION_INT" in missing
    assert missing["HOME_POSITION"] == "where home is, and how high"
    alone = opened(tmp_path, stamped(0, frame(attitude(1))))  # nobody's
    assert (alone.systems, alone.system_id, len(list(alone.records()))) == ((), None, 1)
    assert list(alone.missing())[:2] == ["HEARTBEAT", "GLOBAL_POSITION_INT"]
    flight = open_log(recording("px4-gps-loss.tlog"))
    list(flight.records())
    assert list(flight.missing()) == ["STATUSTEXT"]  # PX4 sends none
