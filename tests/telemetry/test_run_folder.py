"""A run folder: what is written is there at once, and whole to the last record, however it ends."""

import filecmp
import json
import math
import resource
import struct
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as wire
from tlog import read_by_pymavlink

from companion.errors import InputError
from companion.mission.journal import VERSION
from companion.telemetry.inputs import InputsFile
from companion.telemetry.run_folder import RunFolder, resume_head, whole_records

EPOCH_US = 1_700_000_000_000_000  # 2023-11-14 22:13:20 UTC
CODEC = wire.MAVLink(None, srcSystem=1, srcComponent=1)
FRAMES = [  # of 20 s
    (k / 10, bytes(wire.MAVLink_heartbeat_message(2, 3, 0, k, 4, 3).pack(CODEC)))
    for k in range(200)
]
RECORD = 8 + len(FRAMES[0][1])  # bytes, with its stamp


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[RunFolder]:
    """Closed only after the test: what is written must be there anyway."""
    with RunFolder(tmp_path / "runs" / "one", mission_toml="é", epoch_us=EPOCH_US) as made:
        yield made


def again(path: Path, *, epoch_us: int = 1) -> RunFolder:
    """The folder of the same flight, by a companion that was started again."""
    return RunFolder(path, mission_toml="another", epoch_us=epoch_us, resume=True)


def journal(path: Path) -> list[Any]:
    """What each line of a journal says, all of them whole."""
    text = (path / "journal.jsonl").read_text(encoding="utf-8")
    assert text[-1:] in ("", "\n")
    return [json.loads(line) for line in text.splitlines()]


def assert_pymavlink_reads_all(path: Path) -> None:
    """Its reader finds all frames at their vehicle times."""
    expected = [(EPOCH_US + round(time_s * 1e6), frame) for time_s, frame in FRAMES]
    assert read_by_pymavlink(path / "flight.tlog") == expected


# --- what is written


def test_what_is_recorded_is_there_at_once_as_other_programs_read_it(folder: RunFolder) -> None:
    """A certificate is infinitely far from keep-outs where there are none."""
    for begin, end in ((0, 7), (7, 7), (7, 200)):
        folder.frames(FRAMES[begin:end])
        assert (folder.path / "flight.tlog").stat().st_size == end * RECORD
    assert_pymavlink_reads_all(folder.path)
    entry = {"t_s": 0.1, "kind": "say", "text": 'a "quoted"\nline, é'}
    odd = {"certificate": {"keep_out_m": math.inf}, "values": [-math.inf, math.nan]}
    folder.header({"seed": 1})
    folder.entries([entry, {"t_s": 0.2, **odd}])
    told = {"certificate": {"keep_out_m": None}, "values": [None, None]}
    head = {"schema": "companion-journal", "version": VERSION, "seed": 1}
    assert journal(folder.path) == [head, entry, {"t_s": 0.2, **told}]
    folder.run_json({"plans_s": [0.5]})
    assert json.loads((folder.path / "run.json").read_text("utf-8")) == {"plans_s": [0.5]}
    assert (folder.path / "mission.toml").read_text("utf-8") == "é"


def test_a_folder_of_another_flight_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    """One with other files is taken; to resume what has not begun is to begin it."""
    (tmp_path / "truth.jsonl").write_text("the simulator's\n")
    with again(tmp_path, epoch_us=5) as folder:
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
        assert [(each, each.read_bytes()) for each in file.parent.iterdir()] == [
            (file, b"a flight")
        ]
    with pytest.raises(InputError, match=r"--out = .*cannot be written to.*Give a folder"):
        RunFolder(tmp_path / "truth.jsonl", mission_toml="", epoch_us=0)


# --- a restart in flight


def test_cut_at_any_byte_it_goes_on_after_the_last_whole_record_and_line(folder: RunFolder) -> None:
    """Of all kinds of frames: MAVLink 1 and 2, signed and not.  Of no other companion's folder."""
    log, lines = folder.path / "flight.tlog", folder.path / "journal.jsonl"
    codec, ends = wire.MAVLink(None, srcSystem=1, srcComponent=1), {log: [0], lines: [0]}
    for version_1, key in ((True, None), (False, None), (False, b"k" * 32)) * 2:
        codec.signing.secret_key, codec.signing.sign_outgoing = key, key is not None
        beat = wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
        folder.frames([(0.1, bytes(beat.pack(codec, force_mavlink1=version_1)))])
        folder.entries([{"t_s": 0.1, "kind": "x" * len(ends[log])}])
        for path, of in ends.items():
            of.append(path.stat().st_size)
    whole = {path: path.read_bytes() for path in ends}
    log.write_bytes(whole[log][:-5])
    with pytest.raises(InputError, match="another companion records its flight there"):
        again(folder.path)
    assert log.read_bytes() == whole[log][:-5]
    folder.close()
    for length in range(max(map(len, whole.values()))):
        for path, data in whole.items():
            path.write_bytes(data[:length])
        again(folder.path).close()
        for path, of in ends.items():
            assert path.stat().st_size == max(end for end in of if end <= length)
    for rest in (bytes(3 * 2**20), b"garbage" * 2**19):  # more than is read at once
        log.write_bytes(whole[log] + rest)
        assert {whole_records(log, at) for at in [*ends[log], 2**23]} == {len(whole[log])}


@pytest.mark.parametrize("kept", ["nothing", "a checkpoint", "a torn one"])
def test_restarts_are_counted_and_record_at_the_same_epoch(folder: RunFolder, kept: str) -> None:
    """Without a checkpoint the log goes on at the epoch that it began with."""
    folder.header({"seed": 1})
    folder.frames(FRAMES[:50])
    if kept != "nothing":
        folder.checkpoint({})
    folder.frames(FRAMES[50:100])
    folder.close()
    if kept == "a torn one":
        (folder.path / "resume.json").write_bytes(b'{"schema":')
    for part in (FRAMES[100:150], FRAMES[150:]):
        with again(folder.path, epoch_us=EPOCH_US + 600_000_000) as resumed:
            resumed.header({"seed": 1})
            resumed.frames(part)
    assert_pymavlink_reads_all(folder.path)
    assert [head.get("resumed") for head in journal(folder.path)] == [None, 1, 2]
    assert (folder.path / "mission.toml").read_text("utf-8") == "é"


def test_a_log_with_a_wrong_byte_in_its_middle_is_kept_to_its_end(folder: RunFolder) -> None:
    folder.frames(FRAMES)
    folder.close()
    log = folder.path / "flight.tlog"
    whole = log.read_bytes()
    bad = whole[:1000] + b"?" * 40 + whole[1040:]
    log.write_bytes(bad)
    again(folder.path).close()
    assert (folder.path / "flight.tlog.damaged").read_bytes() == bad
    assert log.read_bytes() == b""


@pytest.mark.parametrize("name", ["flight.tlog", "journal.jsonl"])
def test_a_flight_goes_on_that_cannot_be_recorded_any_more(folder: RunFolder, name: str) -> None:
    """It may be in the air; what a restart needs is kept as before."""
    folder.checkpoint({"number": 1})
    folder.close()
    (folder.path / name).unlink()
    (folder.path / name).mkdir()
    with again(folder.path) as resumed:
        assert resumed.failure
        resumed.header({})
        resumed.frames(FRAMES)
        resumed.checkpoint({"number": 2})
        resumed.run_json({})
    assert resume_head(folder.path).values == {"number": 2}


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
            folder.frames(FRAMES[:7])
            folder.entries([{"t_s": 0.05, "kind": "x"}])
        assert folder.failure == "File too large"
        folder.frames(FRAMES[:1])
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


# --- on a small computer


def test_a_log_of_many_hours_is_looked_through_in_little_memory(tmp_path: Path) -> None:
    """As when resume.json was lost: in flight."""
    path = tmp_path / "flight.tlog"
    whole = (struct.pack(">Q", EPOCH_US) + bytes([0xFD, 255]) + bytes(265)) * 20_000  # 5.5 MB
    path.write_bytes(whole + bytes(8_000_000))  # a hole that a power cut has left
    tracemalloc.start()
    try:
        with again(tmp_path) as folder:
            assert folder.epoch_us == EPOCH_US
        assert tracemalloc.get_traced_memory()[1] < 4_000_000
    finally:
        tracemalloc.stop()
    assert path.stat().st_size == len(whole)


def test_a_large_file_that_the_mission_names_is_copied_whole_and_in_little_memory(
    tmp_path: Path,
) -> None:
    """One that cannot be read is refused in one line, and leaves what is there."""
    tile, out = tmp_path / "dem.tif", tmp_path / "run"
    tile.write_bytes(bytes(range(256)) * 65_536)  # 17 MB
    tracemalloc.start()
    try:
        RunFolder(out, mission_toml="", beside={"terrain.tif": tile}, epoch_us=1).close()
        assert tracemalloc.get_traced_memory()[1] < 4_000_000
    finally:
        tracemalloc.stop()
    assert filecmp.cmp(out / "terrain.tif", tile, shallow=False)
    (out / "terrain.tif").rename(kept := tmp_path / "terrain.tif")
    with pytest.raises(
        InputError, match=r"terrain\.file = '[^\n]*/gone': it cannot be read [^\n]*\.$"
    ):
        RunFolder(tmp_path, mission_toml="", beside={kept.name: tmp_path / "gone"}, epoch_us=1)
    assert filecmp.cmp(kept, tile, shallow=False)
    assert not [*tmp_path.glob(".*")]


def test_inputs_that_grow_while_they_are_read_are_no_torn_ones(folder: RunFolder) -> None:
    """As the live view reads them."""
    folder.inputs([("stop",)])
    inputs = InputsFile(folder.path / "inputs.msgpack")
    reading = iter(inputs)
    assert next(reading) == ("stop",)
    folder.inputs([("stop",)])
    assert list(reading) == [("stop",)]
    assert inputs.torn_bytes == 0
