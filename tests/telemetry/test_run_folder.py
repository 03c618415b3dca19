"""A run folder: what is written is there at once, and whole to the last record, however it ends."""

import json
import math
import random
import resource
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
from pymavlink.dialects.v20 import all as wire
from tlog import read_by_pymavlink

from companion.errors import InputError
from companion.mission.journal import VERSION
from companion.telemetry.inputs import InputsFile
from companion.telemetry.run_folder import RunFolder, known_map, resume_head, whole_records
from companion.world.known_map import KnownMap, empty_map

EPOCH_US = 1_700_000_000_000_000  # 2023-11-14 22:13:20 UTC
MISSION = 'name = "é"\n'


def frames() -> list[tuple[float, bytes]]:
    """Positions of 20 s."""
    vehicle = wire.MAVLink(None, srcSystem=1, srcComponent=1)
    at = [
        wire.MAVLink_global_position_int_message(k * 100, 470_000_000, 80_000_000, *[0] * 6)
        for k in range(200)
    ]
    return [(k / 10, message.pack(vehicle)) for k, message in enumerate(at)]


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[RunFolder]:
    """Closed only after the test: what is written must be there anyway."""
    path = tmp_path / "runs" / "one"
    with RunFolder(path, mission_toml=MISSION, epoch_us=EPOCH_US) as made:
        yield made


def again(folder: RunFolder, *, epoch_us: int = 1) -> RunFolder:
    """The folder of the same flight, by a companion that was started again."""
    return RunFolder(folder.path, mission_toml="another", epoch_us=epoch_us, resume=True)


def journal(path: Path) -> list[Any]:
    """What each line of a journal says, all of them whole."""
    text = (path / "journal.jsonl").read_text(encoding="utf-8")
    assert text[-1:] in ("", "\n")
    return [json.loads(line) for line in text.splitlines()]


def assert_pymavlink_reads(path: Path, stamped: list[tuple[float, bytes]]) -> None:
    """Its reader finds these frames at these vehicle times."""
    stamps_us = [EPOCH_US + round(time_s * 1e6) for time_s, _ in stamped]
    frames = [bytes(frame) for _, frame in stamped]
    assert read_by_pymavlink(path / "flight.tlog") == list(zip(stamps_us, frames, strict=True))


# --- what is written


def test_what_is_recorded_is_there_at_once_as_other_programs_read_it(folder: RunFolder) -> None:
    """A certificate is infinitely far from keep-outs where there are none."""
    stamped, size = frames(), 0
    for part in (stamped[:7], [], stamped[7:]):
        folder.frames(part)
        size += sum(8 + len(frame) for _, frame in part)
        assert (folder.path / "flight.tlog").stat().st_size == size
    assert_pymavlink_reads(folder.path, stamped)
    entry = {"t_s": 0.1, "kind": "say", "text": 'a "quoted"\nline, é'}
    odd = {"certificate": {"keep_out_m": math.inf}, "values": [-math.inf, math.nan]}
    folder.header({"seed": 1})
    folder.entries([entry, {"t_s": 0.2, **odd}])
    told = {"certificate": {"keep_out_m": None}, "values": [None, None]}
    head = {"schema": "companion-journal", "version": VERSION, "seed": 1}
    assert journal(folder.path) == [head, entry, {"t_s": 0.2, **told}]
    folder.run_json({"plans_s": [0.5]})
    assert json.loads((folder.path / "run.json").read_text("utf-8")) == {"plans_s": [0.5]}
    assert (folder.path / "mission.toml").read_text("utf-8") == MISSION


def test_a_checkpoint_and_the_known_map_come_back_as_they_were(folder: RunFolder) -> None:
    blank = empty_map(25.0, (-100.0, 150.0), (-50.0, 50.0))
    known = replace(blank, upper_m=blank.upper_m.copy(), registration_m=1.5)
    known.upper_m[1, 2] = 512.25
    values = {"phase": "FLYING", "leg": [[1.5, -2.25, 3000.0]], "none": None, "back": []}
    folder.known_map(known)
    folder.checkpoint({"phase": "earlier"})
    folder.checkpoint(values)
    assert resume_head(folder.path).values == values
    for each in fields(KnownMap):
        found = getattr(known_map(folder.path), each.name)
        np.testing.assert_array_equal(found, getattr(known, each.name))


def test_a_folder_of_another_flight_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    """One with other files is taken; to resume what has not begun is to begin it."""
    (tmp_path / "truth.jsonl").write_text("the simulator's\n")
    with RunFolder(tmp_path, mission_toml="m", epoch_us=5, resume=True) as folder:
        folder.header({})
        assert folder.epoch_us == 5
    assert "resumed" not in journal(tmp_path)[0]
    assert (tmp_path / "truth.jsonl").read_text() == "the simulator's\n"
    for name in ("journal.jsonl", "flight.tlog"):
        file = tmp_path / name.partition(".")[0] / name
        file.parent.mkdir()
        file.write_bytes(b"a flight")
        with pytest.raises(InputError, match=r"--out = .*holds a flight already.*new folder"):
            RunFolder(file.parent, mission_toml="", epoch_us=0)
        assert list(file.parent.iterdir()) == [file]
        assert file.read_bytes() == b"a flight"
    with pytest.raises(InputError, match=r"--out = .*cannot be written to.*Give a folder"):
        RunFolder(tmp_path / "truth.jsonl", mission_toml="", epoch_us=0)


# --- a restart in flight


def test_cut_at_any_byte_it_goes_on_after_the_last_whole_record_and_line(folder: RunFolder) -> None:
    """Of all kinds of frames: MAVLink 1 and 2, signed and not.  Of no other companion's folder."""
    log, lines = folder.path / "flight.tlog", folder.path / "journal.jsonl"
    codec, log_ends, line_ends = wire.MAVLink(None, srcSystem=1, srcComponent=1), [0], [0]
    for version_1, key in ((True, None), (False, None), (False, b"k" * 32)) * 2:
        codec.signing.secret_key, codec.signing.sign_outgoing = key, key is not None
        beat = wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
        folder.frames([(0.1, bytes(beat.pack(codec, force_mavlink1=version_1)))])
        folder.entries([{"t_s": 0.1, "kind": "x" * len(log_ends)}])
        log_ends.append(log.stat().st_size)
        line_ends.append(lines.stat().st_size)
    whole_log, whole_lines = log.read_bytes(), lines.read_bytes()
    log.write_bytes(whole_log[:-5])
    with pytest.raises(InputError, match="another companion records its flight there"):
        again(folder)
    assert log.read_bytes() == whole_log[:-5]
    folder.close()
    for length in range(max(len(whole_log), len(whole_lines))):
        log.write_bytes(whole_log[:length])
        lines.write_bytes(whole_lines[:length])
        again(folder).close()
        for ends, path in ((log_ends, log), (line_ends, lines)):
            assert path.stat().st_size == max(end for end in ends if end <= length)
    for rest in (bytes(3 * 2**20), b"garbage" * 2**19):  # more than is read at once
        log.write_bytes(whole_log + rest)
        assert {whole_records(log, start) for start in [*log_ends, 2**23]} == {len(whole_log)}


@pytest.mark.parametrize("kept", ["nothing", "a checkpoint", "a torn one"])
def test_restarts_are_counted_and_record_at_the_same_epoch(folder: RunFolder, kept: str) -> None:
    """Without a checkpoint the log goes on at the epoch that it began with."""
    stamped = frames()
    folder.header({"seed": 1})
    folder.frames(stamped[:50])
    if kept != "nothing":
        folder.checkpoint({})
    folder.frames(stamped[50:100])
    folder.close()
    if kept == "a torn one":
        (folder.path / "resume.json").write_bytes(b'{"schema":')
    for part in (stamped[100:150], stamped[150:]):
        with again(folder, epoch_us=EPOCH_US + 600_000_000) as resumed:
            resumed.header({"seed": 1})
            resumed.frames(part)
    assert_pymavlink_reads(folder.path, stamped)
    assert [head.get("resumed") for head in journal(folder.path)] == [None, 1, 2]
    assert (folder.path / "mission.toml").read_text("utf-8") == MISSION


def test_a_log_of_many_hours_is_looked_through_in_little_memory(tmp_path: Path) -> None:
    """As when resume.json was lost: in flight, on a small computer."""
    path = tmp_path / "flight.tlog"
    whole = (struct.pack(">Q", EPOCH_US) + bytes([0xFD, 255]) + bytes(265)) * 20_000  # 5.5 MB
    path.write_bytes(whole + bytes(8_000_000))  # a hole that a power cut has left
    tracemalloc.start()
    try:
        with RunFolder(tmp_path, mission_toml="", epoch_us=0, resume=True) as folder:
            assert folder.epoch_us == EPOCH_US
        assert tracemalloc.get_traced_memory()[1] < 4_000_000
    finally:
        tracemalloc.stop()
    assert path.stat().st_size == len(whole)


def test_inputs_that_grow_while_they_are_read_are_no_torn_ones(folder: RunFolder) -> None:
    folder.inputs([("stop",)])
    told = InputsFile(folder.path / "inputs.msgpack")
    reading = iter(told)
    assert next(reading) == ("stop",)
    folder.inputs([("stop",)])
    assert list(reading) == [("stop",)]
    assert (told.torn_bytes, told.is_damaged) == (0, False)


def test_a_log_with_a_wrong_byte_in_its_middle_is_kept_to_its_end(folder: RunFolder) -> None:
    """Only what is torn at the end is cut off; a hole that the disk has left there, too."""
    folder.frames(frames())
    folder.close()
    log = folder.path / "flight.tlog"
    whole = log.read_bytes()
    log.write_bytes(whole + b"\0" * 5000)
    again(folder).close()
    assert log.read_bytes() == whole
    bad = whole[:1000] + b"?" * 40 + whole[1040:]
    log.write_bytes(bad)
    again(folder).close()
    assert (folder.path / "flight.tlog.damaged").read_bytes() == bad
    assert log.read_bytes() == b""


@pytest.mark.parametrize("name", ["flight.tlog", "journal.jsonl"])
def test_a_flight_goes_on_that_cannot_be_recorded_any_more(folder: RunFolder, name: str) -> None:
    """It may be in the air; what a restart needs is kept as before."""
    folder.checkpoint({"number": 1})
    folder.close()
    (folder.path / name).unlink()
    (folder.path / name).mkdir()
    with again(folder) as resumed:
        assert resumed.failure
        resumed.header({})
        resumed.frames(frames())
        resumed.checkpoint({"number": 2})
        resumed.run_json({})
    assert resume_head(folder.path).values == {"number": 2}


# --- kills and full disks

FRAMES = [bytes([0xFD, 9] + [0] * 19)] * 7
RECORD = 8 + 21  # bytes, with its stamp
KILLED = """
import sys
from pathlib import Path
from companion.telemetry.run_folder import RunFolder
from companion.world.known_map import empty_map
known = empty_map(25.0, (-2e3, 2e3), (-2e3, 2e3))
with RunFolder(Path(sys.argv[1]), mission_toml="", epoch_us=0, resume=True) as folder:
    folder.header({})
    while True:
        folder.frames([(0.05, bytes([0xFD, 9] + [0] * 19))] * 7)
        folder.entries([{"t_s": 1.0, "kind": "x", "text": "y" * 200}])
        folder.known_map(known)
        folder.checkpoint({"long": ["z" * 100] * 50})
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
        assert resume_head(tmp_path).values["long"] == ["z" * 100] * 50
        assert known_map(tmp_path).shape == (160, 160)
    RunFolder(tmp_path, mission_toml="", epoch_us=0, resume=True).close()
    assert (tmp_path / "flight.tlog").stat().st_size % RECORD == 0
    assert all(journal(tmp_path))


@pytest.mark.parametrize("most", [4096, 5000, 5001, 5013, 173 * RECORD])
def test_a_full_disk_leaves_whole_records_and_the_checkpoint_before(
    folder: RunFolder, most: int
) -> None:
    """Of any size: in the midst of a stamp, of a frame, and between two records."""
    folder.header({})
    folder.checkpoint({"number": 0})
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, unlimited[1]))
    try:
        while folder.failure is None:
            folder.frames([(0.05, frame) for frame in FRAMES])
            folder.entries([{"t_s": 0.05, "kind": "x"}])
        assert folder.failure == "File too large"
        folder.frames([(0.0, FRAMES[0])])
        folder.checkpoint({"number": 1, "long": "x" * most})
        folder.run_json({})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
    size = (folder.path / "flight.tlog").stat().st_size
    assert size % RECORD == 0
    assert most - size < RECORD
    assert all(journal(folder.path))
    assert resume_head(folder.path).values == {"number": 0}
    assert not {"run.json", ".resume.json.new"} & {each.name for each in folder.path.iterdir()}
