import json
import math
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil  # noqa: TID251 - the reader that users have is the oracle
from pymavlink.dialects.v20 import all as wire

from companion.errors import InputError
from companion.telemetry.run_folder import RunFolder

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
def folder(tmp_path: Path) -> RunFolder:
    """Never closed: what is written must be there anyway."""
    return RunFolder(tmp_path / "runs" / "one", mission_toml='name = "é"\n', epoch_us=EPOCH_US)


def close(folder: RunFolder) -> None:
    with folder:
        pass


def test_pymavlink_reads_every_frame_of_the_log_at_its_time(folder: RunFolder) -> None:
    stamped = frames()
    folder.frames(stamped[:7])
    folder.frames([])
    folder.frames(stamped[7:])
    log = mavutil.mavlink_connection(str(folder.path / "flight.tlog"), dialect="all")
    read = []
    while (message := log.recv_match()) is not None:
        read.append((message._timestamp - EPOCH_US * 1e-6, bytes(message.get_msgbuf())))
    log.close()
    close(folder)
    assert [frame for _, frame in read] == [frame for _, frame in stamped]
    for (time_s, _), (expected_s, _) in zip(read, stamped, strict=True):
        assert time_s == pytest.approx(expected_s, abs=1e-5)


def test_mavlogdump_prints_the_log(folder: RunFolder) -> None:
    folder.frames(frames())
    close(folder)
    program = Path(sys.executable).with_name("mavlogdump.py")
    command = [sys.executable, program, "--types", "HEARTBEAT", folder.path / "flight.tlog"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=20)
    lines = done.stdout.splitlines()
    assert len(lines) == 200
    assert all("HEARTBEAT {type : 18" in line for line in lines)
    assert ":13:20." in lines[0]


def test_a_record_is_eight_bytes_of_microseconds_and_the_frame(folder: RunFolder) -> None:
    folder.frames([(1.5, b"frame")])
    close(folder)
    stamp = struct.pack(">Q", EPOCH_US + 1_500_000)
    assert (folder.path / "flight.tlog").read_bytes() == stamp + b"frame"


def test_the_journal_is_a_header_and_a_line_for_each_entry(folder: RunFolder) -> None:
    folder.header({"seed": 1, "mission": "environment-1"})
    folder.entries([{"t_s": 0.1, "kind": "say", "text": 'a "quoted"\nline, é'}])
    folder.entries([])
    folder.entries([{"t_s": 0.2, "kind": "leg", "number": 1}, {"t_s": 0.3, "kind": "arm"}])
    close(folder)
    lines = (folder.path / "journal.jsonl").read_text(encoding="utf-8").splitlines()
    head, *entries = map(strict, lines)
    assert (head["schema"], head["version"], head["seed"]) == ("companion-journal", 1, 1)
    assert [entry["t_s"] for entry in entries] == [0.1, 0.2, 0.3]
    assert entries[0]["text"] == 'a "quoted"\nline, é'


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan], ids=str)
def test_a_number_that_is_not_finite_is_written_as_json_all_the_same(
    folder: RunFolder, value: float
) -> None:
    """A certificate has an infinite distance to keep-outs where there are none."""
    folder.entries([{"t_s": 0.1, "kind": "plan ready", "certificate": {"keep_out_m": value}}])
    close(folder)
    [line] = (folder.path / "journal.jsonl").read_text(encoding="utf-8").splitlines()
    assert strict(line)["kind"] == "plan ready"


def test_nothing_is_lost_without_a_close(folder: RunFolder) -> None:
    folder.header({})
    for number, stamped in enumerate(frames(), start=1):
        folder.frames([stamped])
        folder.entries([{"t_s": stamped[0], "kind": "x"}])
        if number % 50 == 0:
            size = (folder.path / "flight.tlog").stat().st_size
            assert size == sum(8 + len(frame) for _, frame in frames()[:number])
            text = (folder.path / "journal.jsonl").read_text(encoding="utf-8")
            assert text.count("\n") == 1 + number
    close(folder)


def test_the_mission_is_kept_as_it_was_given_and_run_json_apart(folder: RunFolder) -> None:
    folder.run_json({"plans_s": [0.5]})
    close(folder)
    assert (folder.path / "mission.toml").read_text(encoding="utf-8") == 'name = "é"\n'
    assert strict((folder.path / "run.json").read_text(encoding="utf-8")) == {"plans_s": [0.5]}


@pytest.mark.parametrize("file", ["journal.jsonl", "flight.tlog"])
def test_a_folder_that_holds_a_flight_is_refused_and_left_as_it_is(
    tmp_path: Path, file: str
) -> None:
    (tmp_path / file).write_bytes(b"a flight")
    with pytest.raises(InputError, match=r"--out = .*holds a flight already.*new folder"):
        close(RunFolder(tmp_path, mission_toml="", epoch_us=0))
    assert (tmp_path / file).read_bytes() == b"a flight"
    assert not (tmp_path / "mission.toml").exists()


def test_a_folder_with_other_files_is_taken(tmp_path: Path) -> None:
    (tmp_path / "truth.jsonl").write_text("the simulator's\n", encoding="utf-8")
    close(RunFolder(tmp_path, mission_toml="", epoch_us=0))
    assert (tmp_path / "truth.jsonl").read_text(encoding="utf-8") == "the simulator's\n"


def test_a_place_that_cannot_be_a_folder_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match=r"--out = .*cannot be written to.*Give a folder"):
        RunFolder(tmp_path / "file", mission_toml="", epoch_us=0)
