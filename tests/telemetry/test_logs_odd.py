"""Logs of anybody: what is no log, what is odd about one, and any damage.  Nothing is silent."""

import gzip
import math
import os
import random
import struct
from collections import Counter
from pathlib import Path

import pytest
from fuzz_logs import bases, case
from hypothesis import given
from hypothesis import strategies as st
from log_files import counts, entry, fmt_entries, of, opened, told
from recordings import recording

from companion.errors import InputError
from companion.mavlink.dialect import Message, wire
from companion.replay.shadow import watch
from companion.telemetry.logs import Odd, open_log
from companion.telemetry.logs.log import YEAR_2000_US, YEAR_2100_US, Clock

# --- .tlog: stamps and frames

EPOCH_US = 1_700_000_000_000_000
HOUR = 3_600_000_000
COPTER, STATION, COMPANION = (2, 3), (6, 8), (18, 8)


def frame(
    message: Message,
    sender: tuple[int, int] = (1, 1),
    *,
    v1: bool = False,
    key: bytes | None = None,
) -> bytes:
    codec = wire.MAVLink(None, srcSystem=sender[0], srcComponent=sender[1])
    codec.signing.sign_outgoing, codec.signing.secret_key = key is not None, key
    return bytes(message.pack(codec, force_mavlink1=v1))


def beat(mav_type: int, autopilot: int, sender: tuple[int, int] = (1, 1)) -> bytes:
    return frame(wire.MAVLink_heartbeat_message(mav_type, autopilot, 81, 4, 4, 3), sender)


def stamped(at_us: int, content: bytes) -> bytes:
    """A record: microseconds after the epoch, and a frame."""
    return struct.pack(">Q", EPOCH_US + at_us) + content


def beats(*at_us: int) -> bytes:
    return b"".join(stamped(each, BEAT) for each in at_us)


ATTITUDE = wire.MAVLink_attitude_message(1, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)
BEAT = beat(*COPTER)
SECRET = frame(wire.MAVLink_setup_signing_message(1, 1, list(range(32)), 5))
GARBAGE = b"Telemetry log, v1\r\n\xfd\x09\xfe\xfe"
NOISY = GARBAGE + beats(0) + b"\xfd" * 300 + beats(1) + b"abc" + beats(2) + b"abc" + BEAT
WRONG = bytearray(beats(3))
WRONG[20] ^= 0x10  # a bit of its payload
FLIPPED = beats(0, 1, 2) + bytes(WRONG) + beats(4, 5)
KINDS = stamped(0, frame(ATTITUDE, v1=True)) + stamped(0, frame(ATTITUDE))
KINDS += stamped(0, frame(ATTITUDE, key=bytes(32)))
TWO = b"".join(
    beats(k) + stamped(k, frame(ATTITUDE, (3, 1))) + stamped(k, beat(*STATION, (255, 190)))
    for k in range(10)
)
TWO += stamped(10, beat(2, 12, (3, 1))) + stamped(10, beat(*COMPANION, (4, 1)))

# --- .bin: entries after their formats

BIN = fmt_entries() + entry("MSG", 1000, b"ArduCopter V4.5.7")
BIN += entry("PARM", 1000, b"SYSID_THISMAV", 7, 1) + entry("MODE", 2000, 4, 4, 1)
TEXTS = [entry("MSG", 3_000_000 + k * 1000, b"%d" % k) for k in range(6)]
DAMAGED = BIN + TEXTS[0] + TEXTS[1][:20] + TEXTS[2] + b"noise" + TEXTS[3] + TEXTS[4] + TEXTS[5][:30]
LEAPS = [3_000_000, 4_000_000, 1 << 60, 5_000_000, 4_000_000_000, 6_000_000]
PLACE = (471_000_000, 85_000_000, 500, 0, 0)
VELOCITY = (0, 0, 0, 90, 3, 4, 0, *([0] * 8))  # of the estimator: 3 m/s north, 4 m/s east
SENSELESS = (
    entry("XKF1", 3000, 0, 0, 0, 90, math.nan, 1e30, 0, *([0] * 8)),
    entry("POS", 4000, 1, 1, 500, 0, 0),
    entry("POS", 900_000, 1, 1, math.inf, 0, 0),
    entry("BAT", 5000, 0, *([math.nan] * 4), *([0] * 6)),
    entry("MODE", 6000, 200, 200, 1),
    entry("MSG", 7000, b"\xff\xfe\x00"),
)


def greeted(words: bytes) -> bytes:
    return fmt_entries() + entry("MSG", 900_000, words)


# --- .ulg: messages after their formats

MAGIC = b"ULog\x01\x12\x35\x01"
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
DAY_US, DATE_US = 86_400 * 1_000_000, 1_710_773_350_346_000
FIXES = 60


def message(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<H", len(content)) + kind + content


def status(time_us: int, nav_state: int) -> bytes:
    return message(b"D", struct.pack("<HQBBBB", STATUS, time_us, nav_state, 2, 0, 13))


def text(time_us: int, said: bytes, level: bytes = b"4") -> bytes:
    return message(b"L", level + struct.pack("<Q", time_us) + said)


def ulg(
    clock_us: int = 1_000_000,
    begins_us: int = 1_000_000,
    *,
    fixes: int = 0,
    flags: bytes = b"\0",
    release: int = 0x010D00FF,
    east_deg: float = 8.0,
) -> bytes:
    """Of a PX4 whose clock begins there, and says something else in the header."""
    out = MAGIC + struct.pack("<Q", begins_us) + message(b"B", bytes(8) + flags + bytes(31))
    out += message(b"I", b"\x17uint32_t ver_sw_release" + struct.pack("<I", release))
    out += b"".join(message(b"F", topic) for topic in TOPICS)
    for number, topic in enumerate(TOPICS, start=STATUS):
        out += message(b"A", struct.pack("<BH", 0, number) + topic.split(b":")[0])
    for k in range(fixes):
        at_us = clock_us + 100_000 * k
        local = (47.0, east_deg, 500.0, 0.1 * k, *([0.0] * 6), 0.5, 0.5, *([True] * 6), False)
        place = (47.0 + 1e-6 * k, east_deg, 500.0)
        out += status(at_us, 4)
        out += message(b"D", struct.pack("<HQdd10f7?", LOCAL, at_us, *local))
        out += message(b"D", struct.pack("<HQddf", GLOBAL, at_us, *place))
    return out + text(clock_us + 100_000 * fixes, b"Armed")


MARK = message(b"S", b"\x2f\x73\x13\x20\x25\x0c\xbb\x12")  # PX4 writes one each half second

# --- what is refused

NOTHING = "nothing that can be read is in it"
REFUSED: dict[str, tuple[bytes, str]] = {
    "empty": (b"", NOTHING),
    "noise": (random.Random(1).randbytes(50_000), NOTHING),
    "zeros": (bytes(100_000), NOTHING),
    "notes": (b"nothing flies here\n" * 10, NOTHING),
    "as text": (b"FMT, 128, 89, FMT, BBnNZ, Type\n", "an ArduPilot log as text"),
    "packed": (gzip.compress(b"0" * 99, mtime=0), "it is compressed. Unpack it with gunzip"),
    "zipped": (b"PK\x03\x04" + bytes(1000), "it is a zip archive"),
    "a .raw of MAVProxy": (BEAT * 20, r"no time stamps\. Give the \.tlog that was written"),
    "two vehicles": (TWO, r"several vehicles are in it, systems 1, 3\. Choose one"),
    "an old plane": (greeted(b"ArduPlane V3.9.11"), "of ArduPilot 3.9, and logs are read from 4.0"),
    "PX4 1.12": (ulg(release=0x010C03FF), "of PX4 1.12, and logs are read from 1.13 on"),
    "a later format": (ulg(flags=b"\x02"), "its flags say that it must not be read"),
    # whose log this is, nobody knows; and why nothing is left of that one
    "no firmware's": (greeted(b"HomeBrew 1.0"), r"no HEARTBEAT: .*; no entry \(VER, MSG\) tells"),
    "nowhere": (
        ulg(fixes=FIXES, east_deg=math.nan),
        r"no GLOBAL_POSITION_INT: .*; [\d,]+ entries that cannot",
    ),
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


def test_what_is_no_file_is_refused_in_one_line(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    nothing = [tmp_path / name for name in ("nowhere.tlog", ".", "pipe", "loop", "x" * 400)]
    for path in [*nothing, Path("a\0b")]:
        rule = r"there is no file of that name\. Give a \.tlog|it cannot be read"  # by version
        with pytest.raises(InputError, match=rule) as caught:
            open_log(path)
        assert "\n" not in str(caught.value)


# --- what is read


SMALL = (
    ulg()
    + text(2_500_000, b"\x1b[32mReady\x1b[0m\t")
    + message(b"O", struct.pack("<H", 250))
    + status(3_900_000, 99)
    + text(6_000_000, b"x" * 120, b"9")
)
LONG = ["x" * 50, "x" * 50, "x" * 20]
LOST = {Odd.LOST_TIME: 250, Odd.DAMAGED: 1}
NO_DATE, ON = {Odd.NO_DATE: 1}, ["ArduCopter V4.5.7"]
CUT = {Odd.DAMAGED: 2, Odd.GARBAGE: 20 + len(TEXTS[2]) + len(b"noise") - 2 * 2, Odd.CUT_SHORT: 30}
FULL = [entry("DSF", 3000 + k, lost, *([0] * 5)) for k, lost in enumerate((0, 40, 42))]
STAMPS = {
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
ODD: dict[str, tuple[bytes, list[int] | list[str], dict[Odd, int]]] = {
    **{name: (beats(*stamps), told, odd) for name, (stamps, told, odd) in STAMPS.items()},
    "garbage, and no stamp": (NOISY, [0, 1, 2, 2], {Odd.GARBAGE: 329, Odd.NO_STAMP: 1}),
    "a wrong checksum costs one message": (FLIPPED, [0, 1, 2, 4, 5], {Odd.CHECKSUM: 1}),
    "keys do not come out": (beats(0) + stamped(1, SECRET), [0], {Odd.SECRET: 1}),
    "both protocols, and signed": (KINDS, [0, 0, 0], {Odd.SIGNED: 1}),
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
    "ArduPilot 10.1": (greeted(b"ArduCopter V10.1"), ["ArduCopter V10.1"], NO_DATE),
    "PX4 built of no release": (ulg(release=0x00090000), ["Armed"], NO_DATE),
    "appended to": (ulg(flags=b"\x01") + text(2_000_000, b"on"), ["Armed", "on"], NO_DATE),
    # a mode that is none costs the heartbeat alone; a long text comes in parts
    "a small .ulg": (SMALL, ["Armed", "Ready", *LONG], LOST | NO_DATE),
}


@pytest.mark.parametrize("what", ODD)
def test_time_never_falls_and_what_is_odd_is_counted_and_the_rest_is_kept(
    tmp_path: Path, what: str
) -> None:
    """By the times of a .tlog's records, and the texts in another."""
    content, expected, odd = ODD[what]
    log = opened(tmp_path, content)
    times_us = [record.time_us - EPOCH_US for record in log.records()]
    messages = told(log)
    assert expected == (
        times_us if log.kind == "tlog" else [m.text for m in of(messages, "STATUSTEXT")]
    )
    assert counts(log) == odd
    assert len(log.findings) == len(odd)
    assert not of(messages, "GLOBAL_POSITION_INT")


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
    for content, number, those in ((TWO, 9, r"1, 3\."), (BIN, 3, "7")):
        rule = f"--system = {number}: there is no such vehicle.*Its vehicles: {those}"
        with pytest.raises(InputError, match=rule):
            opened(tmp_path, content, system_id=number)


def test_a_bin_tells_whose_it_is_and_no_position_without_a_velocity_of_its_last_second(
    tmp_path: Path,
) -> None:
    content = BIN + entry("POS", 1_000_000, *PLACE) + entry("XKF1", 2_000_000, *VELOCITY)
    content += entry("POS", 2_100_000, *PLACE) + entry("POS", 3_900_000, *PLACE)
    log = opened(tmp_path, content)
    messages = told(log)
    heartbeat = of(messages, "HEARTBEAT")[0]
    assert (heartbeat.get_srcSystem(), log.system_id) == (7, 7)
    assert heartbeat.type == wire.MAV_TYPE_QUADROTOR
    (position,) = of(messages, "GLOBAL_POSITION_INT")
    assert (position.time_boot_ms, position.vx, position.vy) == (2100, 300, 400)
    missing = log.missing()
    assert missing["EKF_STATUS_REPORT"] == "whether its estimator may be believed"
    assert not {"HEARTBEAT", "PARAM_VALUE", "ESTIMATOR_STATUS"} & missing.keys()  # the last: PX4's


def test_damage_of_a_ulg_costs_what_comes_before_a_mark(tmp_path: Path) -> None:
    """A wrong length costs as many bytes, 64 kB at most."""
    content = ulg() + text(2_000_000, b"before")
    for k, damage in enumerate((text(0, b"one")[:-2], b"noise that is no message", bytes(99))):
        content += damage + (MARK + text(2_100_000 + k, b"after %d" % k)) * 4000
    log = opened(tmp_path, content + text(2_500_000, b"five")[:-1])
    texts = {m.text for m in of(told(log), "STATUSTEXT")}
    assert {"before", "after 0", "after 1", "after 2"} <= texts
    assert counts(log)[Odd.CORRUPT] == 1


@pytest.mark.parametrize(
    ("clock_us", "begins_us", "boot_ms", "odd"),
    [
        # PX4's simulation with Gazebo: microseconds since 1970, told from the log's beginning
        *((DATE_US, us, range(10_000), {Odd.CLOCK_IS_DATE}) for us in (DATE_US, 0, 112_000_000)),
        # one that is up for months
        (100 * DAY_US, 100 * DAY_US, [100 * DAY_US // 1000 % (1 << 32)], {Odd.NO_DATE}),
        (1_000_000, (1 << 64) - 1, [1_000], {Odd.NO_DATE}),  # no beginning of any log
    ],
)
def test_a_clock_of_px4_may_be_a_date(
    tmp_path: Path, clock_us: int, begins_us: int, boot_ms: list[int], odd: set[Odd]
) -> None:
    log = opened(tmp_path, ulg(clock_us, begins_us, fixes=FIXES))
    found = of(told(log), "GLOBAL_POSITION_INT")
    since_ms = [m.time_boot_ms - found[0].time_boot_ms for m in found]
    assert since_ms == [100 * k for k in range(FIXES)]
    assert found[0].time_boot_ms in boot_ms
    assert counts(log).keys() == {Odd.MADE_ESTIMATOR, *odd}
    *_, last = log.records()
    assert last.time_us == clock_us + 100_000 * FIXES


# --- any damage

ANY_STAMP = st.one_of(
    st.integers(0, (1 << 64) - 1),
    st.integers(EPOCH_US, EPOCH_US + 10_000_000),
    st.sampled_from([0, 1, YEAR_2000_US, YEAR_2100_US - 1, EPOCH_US - HOUR]),
)


@pytest.fixture(scope="module")
def logs() -> dict[str, bytes]:
    """Whole logs of each kind, small, by suffix."""
    return bases()


def test_a_log_goes_by_what_is_in_it_not_by_its_name(
    tmp_path: Path, logs: dict[str, bytes]
) -> None:
    """And of a .tlog also with its beginning cut off: long enough for chance to strike."""
    long = recording("arducopter-gps-loss.tlog").read_bytes()[:400_000]
    kinds = {long: "tlog", long[1:]: "tlog", long[300:]: "tlog"}
    for content, kind in (kinds | {logs[".bin"]: "bin", logs[".ulg"]: "ulg"}).items():
        for name in ("log", "log.tlog", "log.ulg", "log.BIN"):
            (tmp_path / name).write_bytes(content)
            assert open_log(tmp_path / name).kind == kind, name


@pytest.mark.parametrize(
    "number", [*range(20), *(pytest.param(k, marks=pytest.mark.nightly) for k in range(20, 60))]
)
def test_no_damage_crashes_or_hangs(number: int, tmp_path: Path, logs: dict[str, bytes]) -> None:
    """Ten thousand of them: python tests/fuzz/fuzz_logs.py."""
    case(number, 7, logs, tmp_path)


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


def test_a_log_that_is_gone_by_then_says_so(tmp_path: Path) -> None:
    log = opened(tmp_path, beats(0))
    for leave in (log.path.write_bytes, lambda _: log.path.unlink()):
        leave(b"")
        assert list(log.records()) == []
        assert log.odd[Odd.UNREADABLE] == 1


def test_a_log_that_is_cut_while_it_is_read_ends_there(tmp_path: Path) -> None:
    log = opened(tmp_path, beats(*range(60_000)))  # 1.7 MB
    records = log.records()
    next(records)
    os.truncate(log.path, 100)
    assert 10_000 < sum(1 for _ in records) < 59_999
