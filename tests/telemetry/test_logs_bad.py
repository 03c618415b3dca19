"""What is no log, what is damaged, logs of any size: no crash, no hang, nothing silent."""

import gzip
import os
import random
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from fuzz_logs import bases, case, read
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recordings import recording

from companion.errors import InputError
from companion.mavlink.dialect import wire
from companion.telemetry.logs import Odd, open_log
from companion.telemetry.logs.log import YEAR_2000_US, YEAR_2100_US, Clock

EPOCH_US = 1_700_000_000_000_000
HEADS = {".tlog": b"", ".bin": b"\xa3\x95\x80", ".ulg": b"ULog\x01\x12\x35\x01" + bytes(8)}
IN_ONE_FOLDER = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
MEMORY = """
import sys
from pathlib import Path
from companion.telemetry.logs import open_log
def peak_mb():  # ru_maxrss would begin with the parent's
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024
before = peak_mb()
log = open_log(Path(sys.argv[1]))
count = sum(1 for _ in log.records())
print(count, peak_mb() - before)
"""


@pytest.fixture(scope="module")
def logs() -> dict[str, bytes]:
    """Whole logs of each kind, small, by suffix."""
    return bases()


def refused(path: Path, rule: str) -> None:
    with pytest.raises(InputError, match=rule) as caught:
        open_log(path)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


NOTHING = "nothing that can be read is in it"
NO_LOGS = {
    "empty.tlog": (b"", NOTHING),
    "noise.tlog": (random.Random(1).randbytes(50_000), NOTHING),
    "zeros.bin": (bytes(100_000), NOTHING),
    "starts.tlog": (b"\xfe" * 100_000, NOTHING),
    "header.ulg": (HEADS[".ulg"], NOTHING),
    "notes.txt": (b"nothing flies here\n" * 10, NOTHING),
    "text.log": (b"FMT, 128, 89, FMT, BBnNZ, Type\n", "an ArduPilot log as text"),
    "log.tlog.gz": (gzip.compress(b"0" * 99, mtime=0), "it is compressed. Unpack it with gunzip"),
    "logs.zip": (b"PK\x03\x04" + bytes(1000), "it is a zip archive"),
}


@pytest.mark.parametrize("name", NO_LOGS)
def test_what_is_no_log_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    content, rule = NO_LOGS[name]
    (tmp_path / name).write_bytes(content)
    refused(tmp_path / name, rule)


def test_what_is_no_file_is_refused_in_one_line(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for none in (tmp_path / "nowhere.tlog", tmp_path, tmp_path / "pipe"):
        refused(none, r"there is no file of that name\. Give a \.tlog")
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    for impossible in (tmp_path / ("x" * 400), Path("a\0b"), loop):
        refused(impossible, "it cannot be read|there is no file of that name")  # by version


def test_a_log_goes_by_what_is_in_it_not_by_its_name(
    tmp_path: Path, logs: dict[str, bytes]
) -> None:
    """And of a .tlog also with its beginning cut off: long enough for chance to strike."""
    long = recording("arducopter-gps-loss.tlog").read_bytes()[:400_000]
    kinds = {"tlog": [long, long[1:], long[300:]]}
    kinds |= {"bin": [logs[".bin"]], "ulg": [logs[".ulg"]]}
    for kind, contents in kinds.items():
        for content in contents:
            for name in ("log", "log.tlog", "log.ulg", "log.BIN"):
                (tmp_path / name).write_bytes(content)
                assert open_log(tmp_path / name).kind == kind, name


@pytest.mark.parametrize(
    "number", [*range(20), *(pytest.param(k, marks=pytest.mark.nightly) for k in range(20, 60))]
)
def test_no_damage_crashes_or_hangs(number: int, tmp_path: Path, logs: dict[str, bytes]) -> None:
    """Ten thousand of them: python tests/fuzz/fuzz_logs.py."""
    case(number, 7, logs, tmp_path)


@IN_ONE_FOLDER
@given(data=st.data(), put=st.binary(max_size=3000))
def test_any_bytes_may_stand_anywhere(
    data: st.DataObject, put: bytes, tmp_path: Path, logs: dict[str, bytes]
) -> None:
    """In a log, or after nothing but its head."""
    suffix = data.draw(st.sampled_from(sorted(logs)))
    content = data.draw(st.sampled_from([logs[suffix][:6000], HEADS.get(suffix, b"")]))
    at, removed = data.draw(st.integers(0, len(content))), data.draw(st.integers(0, 20))
    path = tmp_path / f"case{suffix}"
    path.write_bytes(content[:at] + put + content[at + removed :])
    read(path)


STAMPS = st.one_of(
    st.integers(0, (1 << 64) - 1),
    st.integers(EPOCH_US, EPOCH_US + 10_000_000),
    st.sampled_from([0, 1, YEAR_2000_US, YEAR_2100_US - 1, EPOCH_US - 3_600_000_000]),
)


@given(stamps=st.lists(STAMPS, max_size=60))
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


def test_memory_does_not_grow_with_a_tlog(tmp_path: Path, logs: dict[str, bytes]) -> None:
    """Of 40 MB: a few windows of a megabyte, not the file."""
    message = wire.MAVLink_file_transfer_protocol_message(0, 1, 1, [7] * 251)
    frame = bytes(message.pack(wire.MAVLink(None, srcSystem=1, srcComponent=1)))
    record = (1_795_227_700_000_000).to_bytes(8, "big") + frame
    path = tmp_path / "log.tlog"
    path.write_bytes(logs[".tlog"] + record * (40_000_000 // len(record)))
    command = [sys.executable, "-c", MEMORY, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    count, grown_mb = done.stdout.split()
    assert int(count) > 200
    assert float(grown_mb) < 16.0


def test_a_log_that_is_gone_by_then_says_so(tmp_path: Path, logs: dict[str, bytes]) -> None:
    path = tmp_path / "log.tlog"
    path.write_bytes(logs[".tlog"])
    log = open_log(path)
    path.unlink()
    assert list(log.records()) == []
    assert log.odd[Odd.UNREADABLE] == 1
