"""A flight replayed decides the same; whatever was changed in its recording is found and named."""

import json
import random
import shutil
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from answers import answered
from flights import HILLS, HILLS_MISSION, Flight, flown_as
from pymavlink import mavutil  # noqa: TID251 - counts the frames independently
from pymavlink.dialects.v20 import all as wire
from short_flight import mission_of, replayed, rewritten
from tlog import recorded_frames

from companion.config import load_mission
from companion.errors import InputError
from companion.planner.plan import plan
from companion.planner.request import PlanOutcome
from companion.replay import reproduce
from companion.replay.differences import message_of
from companion.replay.reproduce import LogReplay
from companion.replay.what_if import what_if
from companion.telemetry.inputs import FILE, Input, packed

pytestmark = [pytest.mark.closed_loop, pytest.mark.xdist_group("hills")]
WORLD, MISSION = Path(HILLS), Path(HILLS_MISSION)
SEED = 3
STAMP = 8
EVER_US = 4_000_000_000_000_000


@pytest.fixture
def run_dir(flown: Any) -> Path:
    """A whole flight in lockstep, with a fault on its way."""
    flight: Flight = flown(*flown_as("hills"))
    assert flight.outcome == "arrived"
    return flight.folder


@pytest.fixture
def copy(run_dir: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(run_dir, tmp_path / "run"))


# --- the same


def test_a_flight_is_replayed_to_the_last_frame_entry_and_plan(run_dir: Path) -> None:
    found = replayed(run_dir)
    assert found.is_identical
    assert not found.plans_differ
    assert not found.torn
    assert found.unrecorded == 0
    log = mavutil.mavlink_connection(str(run_dir / "flight.tlog"))
    frames = 0
    while log.recv_msg() is not None:
        frames += 1
    log.close()
    assert found.frames == frames > 5_000
    lines = (run_dir / "journal.jsonl").read_text(encoding="utf-8").splitlines()
    assert found.entries == len(lines) - 1  # a header
    answers = ("plan ready", "plan refused")
    plans = sum(1 for line in lines if json.loads(line).get("kind") in answers)
    assert found.plans_computed == found.plans == plans > 2


def test_the_same_settings_give_the_plans_that_were_flown_on_this_processor(run_dir: Path) -> None:
    mission = load_mission(str(run_dir / "mission.toml"))
    found = list(what_if(run_dir, mission_of(run_dir), mission, seed=None))
    assert len(found) > 2
    for each in found:
        assert each.now == each.flown


@pytest.mark.nightly  # of shorter flights: `test_golden`, in other arithmetic too
def test_plans_of_other_arithmetic_that_differ_are_reported_and_excused(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def aside(*asked: Any) -> PlanOutcome:
        outcome = plan(*asked)
        return replace(outcome, evaluations=outcome.evaluations + 1)  # type: ignore[call-arg]

    monkeypatch.setattr(reproduce, "plan", aside)
    monkeypatch.setattr(reproduce.kernels, "signature", lambda: "numba elsewhere")
    found = replayed(run_dir)
    assert found.is_identical
    assert found.plans_differ
    for each in found.plans_differ:
        assert each.kernels[1] == "numba elsewhere"
        assert f"{each.kernels[0]}, now numba elsewhere" in str(each)


def test_the_telemetry_log_alone_tells_a_flight_in_lockstep(run_dir: Path) -> None:
    log = run_dir / "flight.tlog"
    mission = load_mission(str(MISSION))
    replay = run(LogReplay(log, mission, seed=SEED, version="0"))
    assert replay.found.is_identical
    ours = [frame for _, frame in recorded_frames(log) if frame[6] == 195]
    version_and_farewell = 30  # what depends on the version, and what came after the last input
    assert replay.found.frames > len(ours) - version_and_farewell


def test_a_log_flown_with_another_seed_is_found_out(run_dir: Path) -> None:
    mission = load_mission(str(MISSION))
    replay = run(LogReplay(run_dir / "flight.tlog", mission, seed=4, version="0"))
    assert replay.found.difference.what == "SET_POSITION_TARGET_GLOBAL_INT"


def run(replay: LogReplay) -> LogReplay:
    for _ in replay.steps():
        pass
    return replay


def beginning(run_dir: Path) -> list[tuple[int, bytes]]:
    """Of the flight's log, into its first subpaths: to the last answer of a turn."""
    log = recorded_frames(run_dir / "flight.tlog")
    ours = [frame[6] == 195 for _, frame in log]
    return log[: next(k for k in range(8000, len(log)) if ours[k - 1] and not ours[k])]


def from_log(
    records: list[tuple[int, bytes]], log: Path, keeps: Callable[[int, bytes], bool]
) -> LogReplay:
    """Of a log with some of these frames, by their number."""
    kept = [
        struct.pack(">Q", us) + frame for k, (us, frame) in enumerate(records) if keeps(k, frame)
    ]
    log.write_bytes(b"".join(kept))
    return LogReplay(log, load_mission(str(MISSION)), seed=SEED, version="0")


def test_a_log_with_a_frame_more_than_the_companion_sends_is_found_out(
    run_dir: Path, tmp_path: Path
) -> None:
    log = recorded_frames(run_dir / "flight.tlog")
    beat = next(frame for _, frame in log if frame[6:8] == b"\xc3\0")
    replay = from_log([*log, (EVER_US, beat)], tmp_path / "more.tlog", lambda _k, _frame: True)
    run(replay)
    difference = replay.found.difference
    assert difference is not None
    assert str(difference).endswith("frame.message: recorded 'HEARTBEAT', replayed nothing")


def test_a_log_in_which_the_companion_falls_silent_is_found_out(
    run_dir: Path, tmp_path: Path
) -> None:
    """A few frames more at the end are what was not recorded any more; a thousand are not."""
    log = beginning(run_dir)
    replay = from_log(log, tmp_path / "a.tlog", lambda k, frame: k < 2000 or frame[6] != 195)
    run(replay)
    difference = replay.found.difference
    assert difference.recorded == "nothing"
    last_us = max(us for us, frame in log[:2000] if frame[6] == 195)
    assert difference.t_s == pytest.approx((last_us - log[0][0]) * 1e-6, abs=1.1)
    end = [k for k, (_, frame) in enumerate(log) if frame[6] == 195][-100]
    short = from_log(log, tmp_path / "b.tlog", lambda k, frame: k < end or frame[6] != 195)
    run(short)
    assert short.found.is_identical
    assert short.found.unrecorded == 100


def test_a_log_in_which_there_is_no_companion_is_refused(run_dir: Path, tmp_path: Path) -> None:
    replay = from_log(beginning(run_dir), tmp_path / "alone.tlog", lambda _, frame: frame[6] != 195)
    with pytest.raises(InputError, match=r"nothing to compare with\. Give --shadow"):
        run(replay)


@pytest.mark.parametrize(
    ("way", "option"),
    [
        ([], ["--no-plans"]),
        (["--shadow"], ["--profile", "paper"]),
        (["--set", "planner.seed=1"], ["--no-plans"]),
    ],
)
def test_what_is_of_no_use_here_is_refused(way: list[str], option: list[str]) -> None:
    code, _, said = answered("replay", WORLD, *way, *option)
    assert code == 2
    assert f"error: {option[0].replace('--no-', '--')} = " in said
    assert len(said.splitlines()) == 1


# --- what was changed


def test_another_position_is_found_at_its_time_and_field(copy: Path) -> None:
    log, at_us = recorded_frames(copy / "flight.tlog"), 0

    def change(told: list[Input]) -> None:
        nonlocal at_us
        for number, each in enumerate(told[3000:], start=3000):
            if each[0] != "receive":
                continue
            frames = frames_of(each[1])
            for place, frame in enumerate(frames):
                message = message_of(frame)
                if message is not None and message.get_type() == "GLOBAL_POSITION_INT":
                    message.lat += 1000
                    frames[place] = bytes(message.pack(codec_of(frame)))
                    told[number] = ("receive", b"".join(frames), each[2])
                    at_us = next(t for t, held in log if held == frame)
                    return

    rewritten(copy, change)
    difference = replayed(copy).difference
    assert (difference.what, difference.field) == ("GLOBAL_POSITION_INT", "lat")
    assert difference.replayed - difference.recorded == 1000
    assert difference.t_s == pytest.approx((at_us - log[0][0]) * 1e-6 + 0.0, abs=0.2)


def frames_of(data: bytes) -> list[bytes]:
    frames, at = [], 0
    while at < len(data):
        size = 12 + data[at + 1]
        frames.append(data[at : at + size])
        at += size
    return frames


def codec_of(frame: bytes) -> wire.MAVLink:
    codec = wire.MAVLink(None, srcSystem=frame[5], srcComponent=frame[6])
    codec.seq = frame[4]
    return codec


def test_another_setpoint_in_the_log_is_found(copy: Path) -> None:
    path = copy / "flight.tlog"
    data, at, seen = bytearray(path.read_bytes()), 0, 0
    while seen < 300:
        size = STAMP + 12 + data[at + STAMP + 1]
        frame = bytes(data[at + STAMP : at + size])
        seen += frame[7] == wire.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT
        at += size
    at -= size
    message = message_of(frame)
    was = message.vx
    message.vx = was + 0.5
    data[at + STAMP : at + size] = message.pack(codec_of(frame))
    path.write_bytes(data)
    (time_us,) = struct.unpack_from(">Q", data, at)
    (first_us,) = struct.unpack_from(">Q", data, 0)
    difference = replayed(copy).difference
    assert (difference.what, difference.field) == ("SET_POSITION_TARGET_GLOBAL_INT", "vx")
    assert difference.recorded == pytest.approx(was + 0.5)
    assert difference.replayed == pytest.approx(was)
    assert difference.t_s == pytest.approx((time_us - first_us) * 1e-6, abs=0.2)


def test_another_entry_in_the_journal_is_found_and_the_command_ends_with_1(copy: Path) -> None:
    path = copy / "journal.jsonl"
    text = path.read_text(encoding="utf-8")
    was = '"kind":"phase","phase":"flying"'
    assert was in text
    path.write_text(text.replace(was, '"kind":"phase","phase":"landing"', 1), encoding="utf-8")
    code, out, _ = answered("replay", copy, "--no-plans")
    assert code == 1
    assert "phase.phase: recorded 'landing', replayed 'flying'" in out
    assert "not identical" in out


def test_another_weight_changes_plans_and_not_what_is_flown_by_the_recorded_ones(
    copy: Path,
) -> None:
    path = copy / "mission.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text + "\n[planner.weights]\nlength = 2.0\n", encoding="utf-8")
    found = replayed(copy)
    assert found.difference is None
    assert not found.is_identical
    assert found.plans_differ
    assert not any(each.is_excused for each in found.plans_differ)


# --- what is torn or spoiled


def test_a_recording_that_was_cut_anywhere_is_the_same_up_to_there(
    run_dir: Path, tmp_path: Path
) -> None:
    rng = random.Random(1)
    for number in range(6):
        folder = Path(shutil.copytree(run_dir, tmp_path / f"{number}"))
        for name, least in ((FILE, 40_000), ("flight.tlog", 0), ("journal.jsonl", 0)):
            path = folder / name
            size = path.stat().st_size
            if name == FILE or rng.random() < 0.5:
                with path.open("r+b") as file:
                    file.truncate(rng.randint(least, min(size, 120_000) if name == FILE else size))
        found = replayed(folder)
        assert found.is_identical, found
        shutil.rmtree(folder)


@pytest.mark.parametrize(
    ("content", "rule"),
    [
        (b"", "it does not begin like the inputs of a flight"),
        (b"{}", "it does not begin like the inputs of a flight"),
        (packed([("companion-inputs", 99)])[0], "this companion reads version 1"),
        (None, "it cannot be read"),
    ],
)
def test_what_is_no_recording_is_refused_in_one_line(
    tmp_path: Path, content: bytes | None, rule: str
) -> None:
    shutil.copy(MISSION, tmp_path / "mission.toml")
    for name, data in ((FILE, content), ("flight.tlog", b""), ("journal.jsonl", b"")):
        if data is not None:
            (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=rule):
        replayed(tmp_path)
