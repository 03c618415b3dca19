import json
import math
import random
import shutil
import struct
import subprocess
import sys
import threading
import tracemalloc
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import mavutil  # noqa: TID251 - the reader that users have is the oracle
from pymavlink.dialects.v20 import all as wire
from tlog import recorded_frames

from companion.errors import InputError
from companion.mission.journal import VERSION
from companion.mission.start import Resume
from companion.telemetry.inputs import InputsFile
from companion.telemetry.run_folder import RunFolder, resume_head, whole_records
from companion.telemetry.run_folder import known_map as read_known_map
from companion.world.known_map import KnownMap, empty_map

EPOCH_US = 1_700_000_000_000_000  # 2023-11-14 22:13:20 UTC


def frames() -> list[tuple[float, bytes]]:
    """Heartbeats and positions of 20 s, both components."""
    vehicle = wire.MAVLink(None, srcSystem=1, srcComponent=1)
    companion = wire.MAVLink(None, srcSystem=1, srcComponent=195)
    stamped = []
    for tick in range(200):
        at = wire.MAVLink_global_position_int_message(tick * 100, 470000000, 80000000, *[0] * 6)
        stamped.append((tick / 10, at.pack(vehicle)))
        beat = wire.MAVLink_heartbeat_message(18, 8, 0, 0, tick % 8, 3)
        stamped.append((tick / 10, beat.pack(companion)))
    return stamped


def strict(line: str) -> Any:
    """JSON as the standard has it: no NaN, no Infinity."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is not JSON")

    return json.loads(line, parse_constant=refuse)


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[RunFolder]:
    """Closed only after the test: what is written must be there anyway."""
    path = tmp_path / "runs" / "one"
    with RunFolder(path, mission_toml='name = "é"\n', epoch_us=EPOCH_US) as made:
        yield made


def close(folder: RunFolder) -> None:
    with folder:
        pass


def journal(path: Path) -> list[Any]:
    """What each line of a journal says, all of them whole."""
    text = (path / "journal.jsonl").read_text(encoding="utf-8")
    assert text[-1:] in ("", "\n")
    return [strict(line) for line in text.splitlines()]


def recorded(path: Path) -> list[tuple[float, bytes]]:
    """Vehicle times and frames of a log, as pymavlink reads them."""
    log = mavutil.mavlink_connection(str(path / "flight.tlog"), dialect="all")
    read = []
    while (message := log.recv_match()) is not None:
        read.append((message._timestamp - EPOCH_US * 1e-6, bytes(message.get_msgbuf())))
    log.close()
    return read


def read_checkpoint(path: Path) -> Resume | None:
    """What a companion that is started again finds there."""
    try:
        values = resume_head(path).values
    except (OSError, ValueError):
        return None
    try:
        return values, read_known_map(path)
    except (OSError, ValueError):
        return values, None


def assert_recorded(path: Path, stamped: list[tuple[float, bytes]]) -> None:
    read = recorded(path)
    assert [frame for _, frame in read] == [frame for _, frame in stamped]
    times_s = [time_s for time_s, _ in stamped]
    assert [time_s for time_s, _ in read] == pytest.approx(times_s, abs=1e-5)


def test_pymavlink_reads_every_frame_of_the_log_at_its_time(folder: RunFolder) -> None:
    """Though it is not closed: nothing is lost without that."""
    stamped = frames()
    for until, part in ((7, stamped[:7]), (7, []), (200, stamped[7:200]), (400, stamped[200:])):
        folder.frames(part)
        size = sum(8 + len(frame) for _, frame in stamped[:until])
        assert (folder.path / "flight.tlog").stat().st_size == size
    assert_recorded(folder.path, stamped)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan], ids=str)
def test_the_journal_is_a_header_and_a_line_of_json_for_each_entry(
    folder: RunFolder, value: float
) -> None:
    """Each at once.  A certificate is infinitely far from keep-outs where there are none."""
    folder.header({"seed": 1, "mission": "environment-1"})
    folder.entries([{"t_s": 0.1, "kind": "say", "text": 'a "quoted"\nline, é'}])
    folder.entries([])
    assert len(journal(folder.path)) == 2
    proven = {"t_s": 0.2, "kind": "plan ready", "certificate": {"keep_out_m": value}}
    folder.entries([proven, {"t_s": 0.3, "kind": "arm"}])
    head, *entries = journal(folder.path)
    assert (head["schema"], head["version"], head["seed"]) == ("companion-journal", VERSION, 1)
    assert [entry["t_s"] for entry in entries] == [0.1, 0.2, 0.3]
    assert entries[0]["text"] == 'a "quoted"\nline, é'


def test_the_mission_is_kept_as_it_was_given_and_run_json_apart(folder: RunFolder) -> None:
    folder.run_json({"plans_s": [0.5]})
    close(folder)
    assert (folder.path / "mission.toml").read_text(encoding="utf-8") == 'name = "é"\n'
    assert strict((folder.path / "run.json").read_text(encoding="utf-8")) == {"plans_s": [0.5]}


def test_a_folder_with_other_files_is_taken_and_one_that_holds_a_flight_refused(
    tmp_path: Path,
) -> None:
    (tmp_path / "truth.jsonl").write_text("the simulator's\n", encoding="utf-8")
    close(RunFolder(tmp_path, mission_toml="", epoch_us=0))
    assert (tmp_path / "truth.jsonl").read_text(encoding="utf-8") == "the simulator's\n"
    for name in ("journal.jsonl", "flight.tlog"):
        file = tmp_path / "run" / name
        file.parent.mkdir()
        file.write_bytes(b"a flight")
        with pytest.raises(InputError, match=r"--out = .*holds a flight already.*new folder"):
            RunFolder(file.parent, mission_toml="", epoch_us=0)
        assert [each.name for each in file.parent.iterdir()] == [name]
        assert file.read_bytes() == b"a flight"
        shutil.rmtree(file.parent)
    (tmp_path / "run").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match=r"--out = .*cannot be written to.*Give a folder"):
        RunFolder(tmp_path / "run", mission_toml="", epoch_us=0)


# --- a restart in flight


def known_map() -> KnownMap:
    blank = empty_map(25.0, (-100.0, 150.0), (-50.0, 50.0))
    upper_m = blank.upper_m.copy()
    upper_m[1, 2] = 512.25
    return replace(blank, upper_m=upper_m, registration_m=1.5)


def assert_same_map(found: KnownMap | None, expected: KnownMap) -> None:
    assert found is not None
    for each in fields(KnownMap):
        np.testing.assert_array_equal(getattr(found, each.name), getattr(expected, each.name))


def again(folder: RunFolder, *, epoch_us: int = 1) -> RunFolder:
    """The folder of the same flight, by a companion that was started again."""
    return RunFolder(folder.path, mission_toml="another", epoch_us=epoch_us, resume=True)


def test_a_checkpoint_and_the_known_map_come_back_as_they_were(folder: RunFolder) -> None:
    values = {"phase": "FLYING", "leg": [[1.5, -2.25, 3000.0]], "none": None, "back": []}
    folder.known_map(known_map())
    folder.checkpoint({"phase": "earlier"})
    folder.checkpoint(values)
    found = read_checkpoint(folder.path)
    assert found[0] == values
    assert_same_map(found[1], known_map())


def test_a_restart_goes_on_after_the_last_whole_record_and_line(folder: RunFolder) -> None:
    """Whatever moment the first companion was killed at: here every length of its last record."""
    stamped = frames()[:40]
    folder.header({"seed": 1})
    folder.frames(stamped[:-1])
    folder.entries([{"t_s": 0.1, "kind": "x"}])
    whole_log = (folder.path / "flight.tlog").read_bytes()
    whole_journal = (folder.path / "journal.jsonl").read_bytes()
    folder.frames(stamped[-1:])
    folder.entries([{"t_s": 0.2, "kind": "torn"}])
    log = (folder.path / "flight.tlog").read_bytes()
    journal = (folder.path / "journal.jsonl").read_bytes()
    close(folder)
    for length in range(len(log) - len(whole_log)):
        (folder.path / "flight.tlog").write_bytes(log[: len(whole_log) + length])
        cut = min(len(whole_journal) + length, len(journal) - 1)
        (folder.path / "journal.jsonl").write_bytes(journal[:cut])
        close(again(folder))
        assert (folder.path / "flight.tlog").read_bytes() == whole_log
        assert (folder.path / "journal.jsonl").read_bytes() == whole_journal


@pytest.mark.parametrize("kept", ["nothing", "a checkpoint", "a torn one"])
def test_what_a_restart_records_follows_what_was_there_at_the_same_epoch(
    folder: RunFolder, kept: str
) -> None:
    """Without a checkpoint the log goes on at the epoch that it began with."""
    stamped = frames()
    folder.header({"seed": 1})
    folder.frames(stamped[:100])
    if kept != "nothing":
        folder.checkpoint({})
    folder.frames(stamped[100:200])
    close(folder)
    if kept == "a torn one":
        (folder.path / "resume.json").write_bytes(b'{"schema":')
    with (folder.path / "flight.tlog").open("ab") as file:
        file.write(b"\0\0\0\0\0\0\0\1\xfd\x1c\0")
    resumed = again(folder, epoch_us=EPOCH_US + 600_000_000)
    resumed.header({"seed": 1})
    resumed.frames(stamped[200:])
    resumed.entries([{"t_s": 12.0, "kind": "x"}])
    close(resumed)
    assert_recorded(folder.path, stamped)
    heads = [line for line in journal(folder.path) if "schema" in line]
    assert [head.get("resumed") for head in heads] == [None, 1]
    assert (folder.path / "mission.toml").read_text(encoding="utf-8") == 'name = "é"\n'


def test_every_restart_is_counted(folder: RunFolder) -> None:
    folder.header({})
    close(folder)
    for number in (1, 2, 3):
        resumed = again(folder)
        resumed.header({})
        resumed.checkpoint({})
        close(resumed)
        assert journal(folder.path)[-1]["resumed"] == number


def test_a_folder_that_another_companion_writes_to_is_refused_and_left_as_it_is(
    folder: RunFolder,
) -> None:
    """Else both append to the same files, and neither flight can be replayed."""
    folder.frames(frames()[:3])
    torn = (folder.path / "flight.tlog").read_bytes()[:-5]
    (folder.path / "flight.tlog").write_bytes(torn)
    with pytest.raises(InputError, match="another companion records its flight there"):
        again(folder)
    assert (folder.path / "flight.tlog").read_bytes() == torn
    close(folder)
    close(again(folder))


def test_to_resume_what_has_not_begun_is_to_begin_it(tmp_path: Path) -> None:
    with RunFolder(tmp_path / "new", mission_toml="m", epoch_us=5, resume=True) as folder:
        folder.header({})
        assert folder.epoch_us == 5
    [head] = journal(tmp_path / "new")
    assert "resumed" not in head


def test_records_of_all_kinds_of_frames_are_told_apart(tmp_path: Path) -> None:
    """MAVLink 1 and 2, signed and not: each ends where the next begins."""
    codec = wire.MAVLink(None, srcSystem=1, srcComponent=1)
    kinds = []
    for version_1, key in ((True, None), (False, None), (False, b"k" * 32)):
        codec.signing.secret_key, codec.signing.sign_outgoing = key, key is not None
        beat = wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
        kinds.append(beat.pack(codec, force_mavlink1=version_1))
    assert len({len(frame) for frame in kinds}) == 3
    log = b"".join(struct.pack(">Q", EPOCH_US) + frame for frame in kinds * 3)
    path = tmp_path / "log"
    ends = {0}
    for frame in kinds * 3:
        ends.add(max(ends) + 8 + len(frame))
    for length in range(len(log) + 1):
        path.write_bytes(log[:length])
        assert whole_records(path) == max(end for end in ends if end <= length)
    path.write_bytes(log)
    assert all(whole_records(path, start) == len(log) for start in ends)
    assert whole_records(path, len(log) + 1) == len(log)


def test_a_log_of_many_hours_is_looked_through_in_little_memory(tmp_path: Path) -> None:
    """As when resume.json was lost: in flight, on a small computer."""
    path = tmp_path / "flight.tlog"
    record = struct.pack(">Q", EPOCH_US) + bytes([0xFD, 255]) + bytes(265)
    with path.open("wb") as file:
        for _ in range(12):
            file.write(record * 5_000)  # 17 MB
        end = file.tell()
        file.write(b"\0" * 20_000_000)  # a hole that a power cut has left
    tracemalloc.start()
    try:
        assert whole_records(path) == end
        with RunFolder(tmp_path, mission_toml="", epoch_us=0, resume=True) as folder:
            assert folder.epoch_us == EPOCH_US
        peak_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert path.stat().st_size == end
    assert peak_bytes < 10_000_000


def test_frames_are_read_again_to_the_last_whole_one_whatever_comes_after_it(
    tmp_path: Path,
) -> None:
    frame = bytes([0xFD, 9, *range(19)])
    record = struct.pack(">Q", EPOCH_US) + frame
    many = 2 * 2**20 // len(record) + 1  # in more than one portion
    path = tmp_path / "log"
    zeros, garbage = b"\0" * 3 * 2**20, b"garbage" * 2**19
    for torn in (b"", record[:9], record[:-1], zeros, garbage, frame * 2**18):
        path.write_bytes(record * many + torn)
        assert recorded_frames(path) == [(EPOCH_US, frame)] * many
        assert whole_records(path) == len(record) * many


KILLED = """
import os, sys
from pathlib import Path
import numpy as np
from companion.telemetry.run_folder import RunFolder
from companion.world.known_map import empty_map
from dataclasses import replace
blank = empty_map(25.0, (-2e3, 2e3), (-2e3, 2e3))
rng = np.random.default_rng(1)
with RunFolder(Path(sys.argv[1]), mission_toml="", epoch_us=0, resume=True) as folder:
    folder.header({})
    number = 0
    while True:
        number += 1
        folder.frames([(number * 0.05, bytes([0xFD, 9] + [0] * 19))] * 20)
        folder.entries([{"t_s": number, "kind": "x", "text": "y" * 200}])
        folder.known_map(replace(blank, upper_m=rng.random(blank.upper_m.shape)))
        folder.checkpoint({"number": number, "long": ["z" * 100] * 50})
        if number == 1:
            print("ready", flush=True)
"""


def test_a_kill_at_any_moment_leaves_a_whole_checkpoint_map_and_record(tmp_path: Path) -> None:
    rng = random.Random(3)
    for _ in range(3):
        child = subprocess.Popen([sys.executable, "-c", KILLED, tmp_path], stdout=subprocess.PIPE)
        with child:
            assert child.stdout.readline() == b"ready\n"
            threading.Event().wait(rng.uniform(0.0, 0.1))
            child.kill()
        found = read_checkpoint(tmp_path)
        assert found[1] is not None
        assert found[0]["long"] == ["z" * 100] * 50
    with RunFolder(tmp_path, mission_toml="", epoch_us=0, resume=True):
        pass
    assert (tmp_path / "flight.tlog").stat().st_size % (8 + 21) == 0
    assert all(journal(tmp_path))


def test_inputs_that_grow_while_they_are_read_are_no_torn_ones(folder: RunFolder) -> None:
    folder.inputs([("stop",)])
    told = InputsFile(folder.path / "inputs.msgpack")
    reading = iter(told)
    assert next(reading) == ("stop",)
    folder.inputs([("stop",)])
    assert list(reading) == [("stop",)]
    assert (told.torn_bytes, told.is_damaged) == (0, False)


# --- a disk that is full

FULL = """
import resource, sys
from pathlib import Path
from companion.telemetry.run_folder import RunFolder
def fill(path, most):
    with RunFolder(path, mission_toml="", epoch_us=0) as folder:
        folder.header({})
        folder.checkpoint({"number": 0})
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, resource.RLIM_INFINITY))
        number = 0
        while folder.failure is None:
            number += 1
            folder.frames([(number * 0.05, bytes([0xFD, 9] + [0] * 19))] * 7)
            folder.entries([{"t_s": number, "kind": "x"}])
        print(folder.failure)
        folder.frames([(0.0, bytes([0xFD, 9] + [0] * 19))])
        folder.checkpoint({"number": 1, "long": "x" * most})
        folder.run_json({})
for most in sys.argv[2:]:
    fill(Path(sys.argv[1]) / most, int(most))
"""
SIZES = (4096, 5000, 5001, 5013, 173 * (8 + 21))


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one for each size of a disk, of a flight that has filled it."""
    path = tmp_path_factory.mktemp("full")
    command = [sys.executable, "-c", FULL, path, *map(str, SIZES)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "File too large\n" * len(SIZES)
    return path


@pytest.mark.parametrize("most", SIZES)
def test_a_full_disk_leaves_whole_records_and_the_checkpoint_before(full: Path, most: int) -> None:
    path = full / str(most)
    size = (path / "flight.tlog").stat().st_size
    assert size % (8 + 21) == 0
    assert most - size < 8 + 21
    assert all(journal(path))
    assert read_checkpoint(path)[0] == {"number": 0}
    names = ["flight.tlog", "inputs.msgpack", "journal.jsonl", "mission.toml", "resume.json"]
    assert sorted(each.name for each in path.iterdir()) == names


# --- what cannot be read


def test_a_log_with_a_wrong_byte_in_its_middle_is_kept_to_its_end(folder: RunFolder) -> None:
    """Only what is torn at the end is cut off; a hole that the disk has left there, too."""
    folder.frames(frames())
    close(folder)
    log = folder.path / "flight.tlog"
    whole = log.read_bytes()
    log.write_bytes(whole + b"\0" * 5000)
    close(again(folder))
    assert log.read_bytes() == whole
    bad = whole[:1000] + b"?" * 40 + whole[1040:]
    log.write_bytes(bad)
    close(again(folder))
    assert (folder.path / "flight.tlog.damaged").read_bytes() == bad
    assert log.read_bytes() == b""


@pytest.mark.parametrize("name", ["flight.tlog", "journal.jsonl"])
def test_a_flight_in_the_air_goes_on_though_it_can_not_be_recorded_any_more(
    folder: RunFolder, name: str
) -> None:
    folder.checkpoint({"number": 1})
    close(folder)
    (folder.path / name).unlink()
    (folder.path / name).mkdir()
    with again(folder) as resumed:
        assert resumed.failure
        resumed.header({})
        resumed.frames(frames())
        resumed.entries([{"t_s": 1.0, "kind": "x"}])
        resumed.checkpoint({"number": 2})
        resumed.run_json({})
    assert read_checkpoint(folder.path)[0] == {"number": 2}
