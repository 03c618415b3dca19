"""Logs of anybody: what is no log, what is odd about one, and any damage.  Nothing is silent."""

import gzip
import math
import os
import random
import struct
import time
import tracemalloc
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from log_files import (
    bin_of,
    counts,
    damaged,
    entry,
    fmt_entries,
    of,
    opened,
    told,
    ulg_messages,
    ulg_of,
)
from recordings import recording

from companion.errors import InputError
from companion.mavlink.dialect import Message, wire
from companion.mavlink.frames import intact_end, number_of
from companion.replay.shadow import watch
from companion.telemetry.logs import Odd, open_log
from companion.telemetry.logs.log import YEAR_2000_US, YEAR_2100_US, Clock

LOGS = {
    ".tlog": recording("arducopter-gps-loss.tlog").read_bytes()[:20_000],
    "-px4.tlog": recording("px4-offboard-short.tlog").read_bytes()[:20_000],
    ".bin": bin_of(recording("arducopter-gps-loss.tlog"), most=900),
    ".ulg": ulg_of(recording("px4-offboard-short.ulg"), most=2_200),
}
"""Whole logs of each kind, small, by suffix."""

# --- .tlog: stamps and frames

EPOCH_US = 1_700_000_000_000_000
HOUR = 3_600_000_000


def frame(message: Message, sender: tuple[int, int] = (1, 1), **signed_or_v1: Any) -> bytes:
    codec = wire.MAVLink(None, *sender)
    key = signed_or_v1.pop("key", None)
    codec.signing.sign_outgoing, codec.signing.secret_key = key is not None, key
    return bytes(message.pack(codec, **signed_or_v1))


def beat(mav_type: int, autopilot: int, sender: tuple[int, int] = (1, 1)) -> bytes:
    return frame(wire.MAVLink_heartbeat_message(mav_type, autopilot, 81, 4, 4, 3), sender)


def records(content: bytes, *at_us: int) -> bytes:
    """A frame at each of these times: microseconds after the epoch."""
    return b"".join(struct.pack(">Q", EPOCH_US + each) + content for each in at_us)


ATTITUDE = wire.MAVLink_attitude_message(1, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)
BEAT = beat(2, 3)
SECRET = frame(wire.MAVLink_setup_signing_message(1, 1, list(range(32)), 5))


def beats(*at_us: int) -> bytes:
    return records(BEAT, *at_us)


GARBAGE = b"Telemetry log, v1\r\n\xfd\x09\xfe\xfe"
NOISY = GARBAGE + beats(0) + b"\xfd" * 300 + beats(1) + b"abc" + beats(2) + b"abc" + BEAT
WRONG = bytearray(beats(3))
WRONG[20] ^= 0x10  # a bit of its payload
KINDS = (frame(ATTITUDE, force_mavlink1=True), frame(ATTITUDE), frame(ATTITUDE, key=bytes(32)))
STATION, COMPANION = beat(6, 8, (255, 190)), beat(18, 8, (4, 1))
TWO = b"".join(
    beats(k) + records(frame(ATTITUDE, (3, 1)), k) + records(STATION, k) for k in range(10)
)
TWO += records(beat(2, 12, (3, 1)), 10) + records(COMPANION, 10)

# --- .bin: entries after their formats

BIN = fmt_entries() + entry("MSG", 1000, b"ArduCopter V4.5.7")
BIN += entry("PARM", 1000, b"SYSID_THISMAV", 7, 1) + entry("MODE", 2000, 4, 4, 1)
TEXTS = [entry("MSG", 3_000_000 + k * 1000, b"%d" % k) for k in range(6)]
DAMAGED = BIN + TEXTS[0] + TEXTS[1][:20] + TEXTS[2] + b"noise" + TEXTS[3] + TEXTS[4] + TEXTS[5][:30]
LEAPS = [3_000_000, 4_000_000, 1 << 60, 5_000_000, 4_000_000_000, 6_000_000]
SENSELESS = (
    entry("XKF1", 3000, 0, 0, 0, 90, math.nan, 1e30, 0, *([0] * 8)),
    entry("POS", 4000, 1, 1, 500, 0, 0),
    entry("POS", 900_000, 1, 1, math.inf, 0, 0),
    entry("BAT", 5000, 0, *([math.nan] * 4), *([0] * 6)),
    entry("MODE", 6000, 200, 200, 1),
    entry("MSG", 7000, b"\xff\xfe\x00"),
)
FULL = [entry("DSF", 3000 + k, lost, *([0] * 5)) for k, lost in enumerate((0, 40, 42))]


def greeted(words: bytes) -> bytes:
    return fmt_entries() + entry("MSG", 900_000, words)


# --- .ulg: messages after their formats; recorded, and more after its header or at its end


def message(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<H", len(content)) + kind + content


def text(said: bytes, level: bytes = b"4") -> bytes:
    return message(b"L", level + struct.pack("<Q", 100_000_000) + said)


def ulg(*, flags: int = 0, release: int = 0x010D00FF) -> bytes:
    """Of another release; flags: what a reader has to know to read it."""
    head = message(b"B", bytes(8) + bytes([flags]) + bytes(31))
    head += message(b"I", b"\x17uint32_t ver_sw_release" + struct.pack("<I", release))
    return LOGS[".ulg"][:16] + head + LOGS[".ulg"][16:]


def shifted(content: bytes, by_us: int) -> bytes:
    """The same of a PX4 whose clock has another beginning."""
    out = content[:16]
    for one in map(bytearray, ulg_messages(content)):
        if place := {ord("D"): 5, ord("L"): 4}.get(one[2]):
            (stamp_us,) = struct.unpack_from("<Q", one, place)
            struct.pack_into("<Q", one, place, stamp_us + by_us)
        out += one
    return out


# --- what is refused

NOTHING = "nothing that can be read is in it"
REFUSED: dict[str, tuple[bytes, str]] = {
    "empty": (b"", NOTHING),
    "noise": (random.Random(1).randbytes(50_000), NOTHING),
    "as text": (b"FMT, 128, 89, FMT, BBnNZ, Type\n", "an ArduPilot log as text"),
    "packed": (gzip.compress(b"0" * 99, mtime=0), "it is compressed. Unpack it with gunzip"),
    "zipped": (b"PK\x03\x04" + bytes(1000), "it is a zip archive"),
    "a .raw of MAVProxy": (BEAT * 20, r"no time stamps\. Give the \.tlog that was written"),
    "two vehicles": (TWO, r"several vehicles are in it, systems 1, 3\. Choose one"),
    "an old plane": (greeted(b"ArduPlane V3.9.11"), "of ArduPilot 3.9, and logs are read from 4.0"),
    "PX4 1.12": (ulg(release=0x010C03FF), "of PX4 1.12, and logs are read from 1.13 on"),
    "a later format": (ulg(flags=2), "its flags say that it must not be read"),
    # whose log this is, nobody knows
    "no firmware's": (greeted(b"HomeBrew 1.0"), r"no HEARTBEAT: .*; no entry \(VER, MSG\) tells"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_log_that_can_be_watched_is_refused_in_one_line(
    tmp_path: Path, what: str
) -> None:
    content, rule = REFUSED[what]
    (tmp_path / "log").write_bytes(content)
    with pytest.raises(InputError, match=rule) as caught:
        watch(tmp_path / "log", None)
    assert "\n" not in str(caught.value)


def test_what_is_no_file_or_vehicle_is_refused_in_one_line(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    nothing = [tmp_path / name for name in ("nowhere.tlog", ".", "pipe", "loop", "x" * 400)]
    for path in [*nothing, Path("a\0b")]:
        rule = r"there is no file of that name\. Give a \.tlog|it cannot be read"  # by version
        with pytest.raises(InputError, match=rule) as caught:
            open_log(path)
        assert "\n" not in str(caught.value)
    for content, number, those in ((TWO, 9, r"1, 3\."), (BIN, 3, "7")):
        rule = f"--system = {number}: there is no such vehicle.*Its vehicles: {those}"
        with pytest.raises(InputError, match=rule):
            opened(tmp_path, content, system_id=number)


# --- what is read

NO_DATE, ON = {Odd.NO_DATE: 1}, ["ArduCopter V4.5.7"]
CUT = {Odd.DAMAGED: 2, Odd.GARBAGE: 20 + len(TEXTS[2]) + len(b"noise") - 2 * 2, Odd.CUT_SHORT: 30}
ODD: dict[str, tuple[bytes, list[int] | list[str], dict[Odd, int]]] = {
    "nonsense gets the time before": (
        beats(1, 2, -EPOCH_US, 3, (1 << 63) - EPOCH_US, 4, -400_000_000, 5, 900_000_000_000, 6),
        [1, 2, 2, 3, 3, 4, 4, 5, 5, 6],
        {Odd.WRONG_STAMP: 4},
    ),
    "a clock that is set back is doubted once": (
        beats(0, 1000, 2000, 2000 - HOUR, 3000 - HOUR, 4000 - HOUR, 5000 - HOUR),
        [0, 1000, 2000, 2000, 2000, 3000, 4000],
        {Odd.TIME_BACK: 1},
    ),
    "a first stamp that nothing agrees with": (
        beats(500_000_000_000_000, 0, 1000, 2000),
        [0, 0, 1000, 2000],
        {Odd.WRONG_STAMP: 1},
    ),
    "a pause, and steps back of less than a second": (
        beats(0, 1000, 990, 500_000, 400_000, HOUR, HOUR + 5, HOUR + 10),
        [0, 1000, 1000, 500_000, 500_000, 500_000, HOUR + 5, HOUR + 10],
        {Odd.TIME_GAP: 1},
    ),
    "garbage, and no stamp": (NOISY, [0, 1, 2, 2], {Odd.GARBAGE: 329, Odd.NO_STAMP: 1}),
    "a wrong checksum costs one message": (
        beats(0, 1, 2) + bytes(WRONG) + beats(4, 5),
        [0, 1, 2, 4, 5],
        {Odd.CHECKSUM: 1},
    ),
    "keys do not come out": (beats(0) + records(SECRET, 1), [0], {Odd.SECRET: 1}),
    "both protocols, and signed": (
        b"".join(records(each, 0) for each in KINDS),
        [0, 0, 0],
        {Odd.SIGNED: 1},
    ),
    # what noise follows is left out, too
    "a .bin, cut, with noise, without its end": (DAMAGED, [*ON, "0", "3", "4"], CUT | NO_DATE),
    "a time that leaps is not believed once": (
        BIN + b"".join(entry("MSG", time_us, b"%d" % k) for k, time_us in enumerate(LEAPS)),
        [*ON, "0", "1", "3", "5"],
        {Odd.WRONG_STAMP: 2} | NO_DATE,
    ),
    "numbers that fit into no message": (
        BIN + b"".join(SENSELESS),
        [*ON, "??"],
        {Odd.DAMAGED: 3} | NO_DATE,
    ),
    "a full disk": (BIN + b"".join(FULL), ON, {Odd.LOST_ENTRIES: 42} | NO_DATE),
    "ArduPilot 4.0": (greeted(b"ArduCopter V4.0.0"), ["ArduCopter V4.0.0"], NO_DATE),
}


@pytest.mark.parametrize("what", ODD)
def test_time_never_falls_and_what_is_odd_is_counted_and_the_rest_is_kept(
    tmp_path: Path, what: str
) -> None:
    """By the times of a .tlog's records, and the texts in a .bin."""
    content, expected, odd = ODD[what]
    log = opened(tmp_path, content)
    times_us = [record.time_us - EPOCH_US for record in log.records()]
    messages = told(log)
    texts = [m.text for m in of(messages, "STATUSTEXT")]
    assert expected == (times_us if log.kind == "tlog" else texts)
    assert counts(log) == odd
    assert len(log.findings) == len(odd)
    assert not of(messages, "GLOBAL_POSITION_INT")


def test_a_ulg_tells_its_texts_in_parts_and_counts_what_was_not_written(tmp_path: Path) -> None:
    """Colours do not come out."""
    more = text(b"\x1b[32mReady\x1b[0m\t") + text(b"x" * 120, b"9")
    log = opened(tmp_path, ulg(release=0x00090000) + message(b"O", struct.pack("<H", 250)) + more)
    said = [m.text for m in of(told(log), "STATUSTEXT")]
    assert said[-4:] == ["Ready", "x" * 50, "x" * 50, "x" * 20]
    assert counts(log)[Odd.LOST_TIME] >= 250


DAY_US, DATE_US = 86_400 * 1_000_000, 1_710_773_350_346_000


@pytest.mark.parametrize("by_us", [DATE_US, 100 * DAY_US])
def test_a_clock_of_px4_may_be_a_date(tmp_path: Path, by_us: int) -> None:
    """As in its simulation with Gazebo; one that is up for months is none."""
    plain = of(told(opened(tmp_path, LOGS[".ulg"])), "GLOBAL_POSITION_INT")
    log = opened(tmp_path, shifted(LOGS[".ulg"], by_us))
    other = of(told(log), "GLOBAL_POSITION_INT")
    assert len(plain) > 5
    since_ms, as_before_ms = (
        [(m.time_boot_ms - each[0].time_boot_ms) % (1 << 32) for m in each]
        for each in (other, plain)
    )
    assert since_ms == as_before_ms
    of_boot_ms = (plain[0].time_boot_ms + by_us // 1000) % (1 << 32)
    assert other[0].time_boot_ms in (range(10_000) if by_us == DATE_US else [of_boot_ms])
    assert (Odd.CLOCK_IS_DATE in counts(log)) == (by_us == DATE_US)


def test_a_tlog_may_begin_and_end_in_the_middle_of_a_record(tmp_path: Path) -> None:
    size = len(beats(0))
    for cut in range(1, size):
        log = opened(tmp_path, beats(*range(5))[cut:-cut])
        begun = cut <= 8  # then the first frame is whole, though its stamp is not
        assert [record.frame for record in log.records()] == [BEAT] * (3 + begun)
        found = counts(log)
        assert found[Odd.CUT_SHORT] == size - cut
        assert found.get(Odd.GARBAGE, 0) == (8 - cut if begun else size - cut)


def test_of_several_vehicles_the_chosen_one_is_told_with_whoever_is_none(tmp_path: Path) -> None:
    log = opened(tmp_path, TWO, system_id=3)
    assert {m.get_srcSystem() for m in told(log)} == {3, 4, 255}
    assert counts(log) == {Odd.OTHER_VEHICLE: 10}
    assert (log.systems, log.system_id) == ((1, 3), 3)


def test_a_log_goes_by_what_is_in_it_not_by_its_name(tmp_path: Path) -> None:
    """And of a .tlog also with its beginning cut off: long enough for chance to strike."""
    long = recording("arducopter-gps-loss.tlog").read_bytes()[:400_000]
    kinds = {long: "tlog", long[1:]: "tlog", long[300:]: "tlog"}
    for content, kind in (kinds | {LOGS[".bin"]: "bin", LOGS[".ulg"]: "ulg"}).items():
        for name in ("log", "log.tlog", "log.ulg", "log.BIN"):
            (tmp_path / name).write_bytes(content)
            assert open_log(tmp_path / name).kind == kind, name


# --- any damage

ANY_STAMP = st.one_of(
    st.integers(0, (1 << 64) - 1),
    st.integers(EPOCH_US, EPOCH_US + 10_000_000),
    st.sampled_from([0, 1, YEAR_2000_US, YEAR_2100_US - 1, EPOCH_US - HOUR]),
)
SLOWEST_S = 2.0
"""A log that takes longer, by the time of this process alone, and a millisecond for each ten of its
bytes, is called a hang: honest ones take 3 microseconds a byte at most."""


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.nightly) for k in range(1, 50))]
)
def test_no_damage_crashes_or_hangs_or_lets_time_fall(seed: int, tmp_path: Path) -> None:
    chance = random.Random(seed)
    for suffix, whole in [*LOGS.items()] * 5:
        path = tmp_path / f"log{suffix}"
        path.write_bytes(damaged(whole, chance))
        began_s, before_us = time.process_time(), 0
        try:
            log = open_log(path)
            for record in log.records():
                assert record.time_us >= before_us
                before_us = record.time_us
                is_known = number_of(record.frame) in wire.mavlink_map
                assert not is_known or intact_end(record.frame, 0) == len(record.frame)
            assert min(log.odd.values(), default=0) >= 0
            said = [*log.findings, *log.missing()]
        except InputError as refused:
            said = [str(refused)]
        assert "\n" not in "".join(said)
        took_s = time.process_time() - began_s
        assert took_s < SLOWEST_S + 1e-4 * path.stat().st_size


@given(stamps=st.lists(ANY_STAMP, max_size=60))
def test_time_never_falls_whatever_the_stamps(stamps: list[int]) -> None:
    odd = Counter[Odd]()
    clock = Clock(odd, start_us=EPOCH_US, last_us=YEAR_2100_US)
    before_us = clock.now_us
    for stamp in stamps:
        believed = clock.read(stamp)
        assert before_us <= clock.now_us <= YEAR_2100_US + len(stamps) * 600_000_000
        assert not believed or stamp < YEAR_2100_US
        before_us = clock.now_us
    assert min(odd.values(), default=0) >= 0


def test_a_log_that_is_gone_or_cut_while_it_is_read_ends_there(tmp_path: Path) -> None:
    log = opened(tmp_path, beats(*range(60_000)))  # 1.7 MB
    reading = log.records()
    next(reading)
    os.truncate(log.path, 100)
    assert 10_000 < sum(1 for _ in reading) < 59_999
    log.path.unlink()
    assert list(log.records()) == []
    assert log.odd[Odd.UNREADABLE] == 1


def test_memory_does_not_grow_with_a_tlog(tmp_path: Path) -> None:
    long = frame(wire.MAVLink_file_transfer_protocol_message(0, 1, 1, [7] * 251))
    log = opened(tmp_path, beats(0) + records(long, 0) * 40_000)  # 11 MB
    tracemalloc.start()
    try:
        assert sum(1 for _ in log.records()) == 40_001
        assert tracemalloc.get_traced_memory()[1] < 7_000_000
    finally:
        tracemalloc.stop()
