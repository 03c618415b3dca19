"""What a replay was not asked properly, or not given whole, it says in one line: never a traceback,
and never that nothing is the same as something."""

import contextlib
import copy
import json
import random
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from answers import answered
from rasterio.transform import Affine
from short_flight import (
    EPOCH_US,
    fly_short,
    replayed,
    rewritten,
    short_mission,
    straight_plan,
)
from tlog import recorded_frames

from companion.config import load_mission
from companion.errors import InputError
from companion.mavlink.dialect import codec, wire
from companion.mission.start import Start
from companion.planner.request import PlanOutcome, PlanRequest
from companion.replay import actions, reproduce
from companion.replay.differences import Recording
from companion.replay.session_inputs import DamagedInputError, feed, session_of, start_of
from companion.telemetry.inputs import FILE, HEADER, Input, InputsFile, packed

BOOTED_S, BEGAN_S, FLOWN_S = 3600.0, 3603.0, 33.0
"""It is known when the vehicle was booted once its clock has been heard some times."""


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a vehicle that was booted an hour before."""
    path = tmp_path_factory.mktemp("refused") / "run"
    fly_short(path, booted_s=BOOTED_S, until_s=FLOWN_S)
    return path


@pytest.fixture
def run(run_dir: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(run_dir, tmp_path / "run"))


def replays(*arguments: object) -> tuple[int, str, list[str]]:
    """Exit code of a replay, what it printed, and the lines of its errors."""
    quick = [] if "--seed" in arguments else ["--no-plans"]
    code, out, said = answered("replay", *arguments, *quick)
    return code, out, [line for line in said.splitlines() if "error:" in line]


def flown_s(stamp_us: int) -> float:
    return (stamp_us - EPOCH_US) * 1e-6 - BEGAN_S


# --- from and until


def test_until_is_seconds_of_the_flight(run_dir: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    code, out, _ = replays(run_dir, "--until", 10, "--json", report)
    found = json.loads(report.read_text("utf-8"))
    assert code == 0
    assert found["flown_s"] == pytest.approx(10.0, abs=0.5)
    assert found["frames"] > 100
    assert f"of flight from vehicle time {BEGAN_S:,.1f} s" in out


def test_so_is_from(run_dir: Path) -> None:
    whole, later = replayed(run_dir), replayed(run_dir, from_s=20.0)
    assert whole.is_identical
    assert later.is_identical
    assert 0 < later.frames < 0.6 * whole.frames


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (("--from", 1e6), "--from = 1000000.0: the flight has "),
        (("--from", 20.02, "--until", 20.05), "--until = 20.05: nothing was recorded in so short"),
    ],
)
def test_a_span_in_which_nothing_was_compared_is_refused(
    run_dir: Path, option: tuple[object, ...], words: str
) -> None:
    code, out, [error] = replays(run_dir, *option)
    assert code == 2
    assert words in error
    assert "seconds, or leave it out." in error
    assert "identical" not in out


def test_a_recording_with_nothing_in_it_is_refused(run: Path) -> None:
    for name in ("flight.tlog", "journal.jsonl"):
        (run / name).write_bytes(b"")
    code, out, [error] = replays(run)
    assert code == 2
    assert "it holds nothing to compare a replay with. Give the recording of a flight" in error
    assert "identical" not in out


def test_that_no_frame_was_compared_is_said(run: Path) -> None:
    (run / "flight.tlog").write_bytes(b"")
    _, out, _ = replays(run)
    assert "no frame was compared: flight.tlog holds none" in out


def test_what_came_before_from_may_be_more_or_less_than_was_recorded(run: Path) -> None:
    log = recorded_frames(run / "flight.tlog")
    early = [n for n, (at_us, _) in enumerate(log) if 5.0 < flown_s(at_us) < 15.0]
    spoiled = list(log)
    del spoiled[early[3]], spoiled[early[40]]
    spoiled.insert(early[60], spoiled[early[60]])
    data = b"".join(struct.pack(">Q", at_us) + frame for at_us, frame in spoiled)
    (run / "flight.tlog").write_bytes(data)
    path = run / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:3], b"garbage\n", *lines[4:6], lines[5], *lines[6:]]))
    assert not replayed(run).is_identical
    found = replayed(run, from_s=20.0)
    assert found.is_identical, found.difference
    assert found.frames > 100


def test_what_differs_after_from_is_found_at_its_place(run: Path) -> None:
    log = recorded_frames(run / "flight.tlog")
    early = next(n for n, (at_us, _) in enumerate(log) if flown_s(at_us) > 5.0)
    late = next(n for n, (at_us, _) in enumerate(log) if flown_s(at_us) > 25.0)
    late_s = BEGAN_S + flown_s(log[late][0])
    del log[late], log[early]
    data = b"".join(struct.pack(">Q", at_us) + frame for at_us, frame in log)
    (run / "flight.tlog").write_bytes(data)
    difference = replayed(run, from_s=20.0).difference
    assert difference.t_s == pytest.approx(late_s, abs=0.2)


def test_a_frame_that_differs_before_from_moves_nothing_after_it(tmp_path: Path) -> None:
    beats = [
        (float(t), wire.MAVLink_heartbeat_message(18, 8, 0, t, 4, 3).pack(codec(1)))
        for t in range(1, 9)
    ]
    (tmp_path / "journal.jsonl").write_text("", encoding="utf-8")
    data = b"".join(struct.pack(">Q", round(t * 1e6)) + frame for t, frame in beats)
    (tmp_path / "flight.tlog").write_bytes(data)
    mine = list(beats)
    mine[1] = (2.0, beats[7][1])
    with contextlib.closing(Recording(tmp_path)) as recording:
        recording.pass_by(mine[:4], [])
        assert recording.first_difference(mine[4:], []) is None
        assert recording.frames == 4


# --- what is damaged


@pytest.mark.parametrize("junk", [b"garbage\n", b"[1,2]\n", b'{"t_s":1.0,"kind":"say"\n', b"\n"])
def test_a_line_of_the_journal_that_cannot_be_read_is_a_difference(run: Path, junk: bytes) -> None:
    path = run / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    lines[5] = junk
    path.write_bytes(b"".join(lines))
    code, out, _ = replays(run)
    assert code == 1
    assert f"journal.line: recorded {junk!r}" in out


def test_a_line_of_the_journal_that_another_version_spells_otherwise_is_the_same(run: Path) -> None:
    path, before = run / "journal.jsonl", replayed(run)
    path.write_bytes(path.read_bytes().replace(b'"kind":"', b'"kind": "'))
    found = replayed(run)
    assert found.is_identical
    assert found.entries == before.entries > 0


def test_a_log_that_turns_to_garbage_is_a_difference(run: Path) -> None:
    path = run / "flight.tlog"
    data = path.read_bytes()
    path.write_bytes(data[:2000] + b"\0\1" * 1000 + data[4000:])
    code, out, _ = replays(run)
    assert code == 1
    assert "flight.tlog: recorded '" in out
    assert "bytes that are no frames'" in out


ODD = [None, 1, -1, "x", "", [], {}, [[1]], [1, 2, 3], [[1], [2, 3]], b"x", 2**63, 1e300]
ODD += [float("nan"), float("inf"), True, {"a": 1}, ["x"]]


def mutant(value: Any, rng: random.Random) -> Any:
    """A value like it of which something, however deep inside, is odd."""
    if isinstance(value, dict | list | tuple) and value and rng.random() < 0.8:
        changed = copy.copy(value) if not isinstance(value, tuple) else list(value)
        key = rng.choice(list(changed) if isinstance(changed, dict) else range(len(changed)))
        changed[key] = mutant(changed[key], rng)
        return tuple(changed) if isinstance(value, tuple) else changed
    return rng.choice(ODD)


@pytest.fixture(scope="module")
def resumed_dir(tmp_path_factory: pytest.TempPathFactory, run_dir: Path) -> Path:
    """The same with a second life, begun from a checkpoint."""
    path = Path(shutil.copytree(run_dir, tmp_path_factory.mktemp("resumed") / "run"))
    values = json.loads((path / "resume.json").read_bytes())["values"]

    def change(told: list[Input]) -> None:
        name, start = told[0]
        known = (path / "known.npz").read_bytes()
        told.append((name, {**start, "resume": values, "known": known}))
        told += told[1:60]

    rewritten(path, change)
    return path


def planned_at_once(request: PlanRequest, stop: Callable[[], bool]) -> PlanOutcome:
    """A planner that asks whether to go on, as a search does."""
    stop()
    return straight_plan(request)


def test_whatever_is_odd_in_the_inputs_nothing_is_raised_that_is_no_input_error(
    resumed_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reproduce, "plan", planned_at_once)
    whole = list(InputsFile(resumed_dir / FILE))
    telling = [n for n, each in enumerate(whole) if each[0] not in ("receive", "run")]
    assert {whole[n][0] for n in telling} >= {"start", "deliver", "stop", "farewell"}
    rng, ended = random.Random(5), 0
    path = Path(shutil.copytree(resumed_dir, tmp_path / "odd"))
    for _ in range(25):

        def change(told: list[Input]) -> None:
            place = rng.choice(telling if rng.random() < 0.8 else range(len(told)))
            name, *arguments = told[place]
            told[place] = (name, *(mutant(each, rng) for each in arguments or [None]))

        shutil.copy(resumed_dir / FILE, path / FILE)
        rewritten(path, change)
        try:
            found = replayed(path)
        except InputError:
            ended += 1
        else:
            ended += bool(found.damaged or found.torn) or found.difference is not None
    assert ended > 6


def test_inputs_that_turn_to_garbage_are_refused(run: Path) -> None:
    path = run / FILE
    data = path.read_bytes()
    whole = sum(map(len, packed((HEADER, *list(InputsFile(path))[:150]))))
    for rest, expected in ((b"\xc1" + data[whole:], 2), (bytes(5000), 0), (data[whole:][:9], 0)):
        path.write_bytes(data[:whole] + rest)
        code, out, errors = replays(run)
        assert code == expected
        if expected:
            assert "bytes that are no inputs" in errors[0]
            assert "identical up to there" in out
        else:  # a power cut, or a kill
            assert "the recording ends early: " in out
            assert out.endswith("\nidentical\n")


def test_a_damaged_input_is_refused_and_what_came_before_it_is_shown(run: Path) -> None:
    def change(told: list[Input]) -> None:
        told[200] = ("deliver", {"kind": "planned"})

    rewritten(run, change)
    code, out, [error] = replays(run)
    assert code == 2
    assert "identical up to there" in out
    assert "RUN_DIR = " in error
    assert "what was recorded is damaged (an answer of the planner that is none" in error


@pytest.mark.parametrize(
    "told",
    [
        *[("deliver", each) for each in (None, 5, [], "x", {}, {"plan_id": 1, "kind": "?"})],
        *[("silence", each) for each in (None, "x", float("nan"), float("inf"), True)],
        *[("receive", b"", each) for each in ("x", float("nan"), [])],
        ("receive", "x", 1.0),
        ("run", 1),
        ("stop", 1),
        ("complain", None),
        ("nothing of the kind",),
    ],
)
def test_what_is_nothing_that_a_session_is_told_is_named(run_dir: Path, told: Input) -> None:
    session = session_of(start_of(next(iter(InputsFile(run_dir / FILE)))), mission_of_valley)
    with pytest.raises(DamagedInputError):
        feed(session, told)


def mission_of_valley(_: Start) -> Any:
    return load_mission("valley")


def test_an_error_of_the_session_itself_is_not_called_a_broken_input(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = session_of(start_of(next(iter(InputsFile(run_dir / FILE)))), mission_of_valley)

    def broken(*_: object) -> None:
        raise KeyError("made up")

    monkeypatch.setattr(session, "run", broken)
    with pytest.raises(KeyError, match="made up"):
        feed(session, ("run",))


@pytest.mark.parametrize(
    "change", [{"seed": "x"}, {"system_id": 0}, {"resume": 5}, {"odd": 1}, {"profile": "x"}]
)
def test_a_start_that_is_none_is_named(run_dir: Path, change: dict[str, Any]) -> None:
    name, values = next(iter(InputsFile(run_dir / FILE)))
    with pytest.raises(DamagedInputError, match="a start that is none"):
        start_of((name, {**values, **change}))


# --- the elevation file


def elevations(path: Path, *, higher_m: int = 0) -> Path:
    """Heights every 3 seconds about the origin of the mission."""
    step = 1 / 1200
    heights = np.random.default_rng(4).integers(300, 800, (120, 120)).astype(np.int16)
    heights[30:90, 30:90] += higher_m
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        crs="EPSG:4326",
        transform=Affine(step, 0, 8.0 - 60 * step, 0, -step, 47.0 + 60 * step),
        dtype="int16",
        count=1,
        height=120,
        width=120,
    ) as file:
        file.write(heights, 1)
    return path


@pytest.fixture
def flown_with_elevations(tmp_path: Path) -> tuple[Path, Path]:
    file = elevations(tmp_path / "dem.tif")
    text = short_mission(terrain={"file": str(file), "vertical_datum": "EGM96"})
    fly_short(tmp_path / "run", text=text, until_s=5.0)
    return tmp_path / "run", file


def test_an_elevation_file_that_has_changed_is_said_in_one_line(
    flown_with_elevations: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, file = flown_with_elevations
    assert replays(path)[0] == 0
    elevations(file, higher_m=10)
    monkeypatch.setattr(actions, "load_kernel", lambda: pytest.fail("it is compiled in vain"))
    for option in ((), ("--seed", 3)):  # what if, too
        code, out, [error] = replays(path, *option)
        assert code == 2
        assert f"terrain.file = '{file}': the elevation file has changed since the flight" in error
        assert "Put the file of the flight there, or name it in " in error
        assert "first difference" not in out


def test_a_flight_that_was_recorded_without_a_word_of_its_terrain_is_still_replayed(
    flown_with_elevations: tuple[Path, Path],
) -> None:
    path, file = flown_with_elevations

    def change(told: list[Input]) -> None:
        name, values = told[0]
        assert len(values.pop("terrain")) == 64
        told[0] = (name, values)

    rewritten(path, change)
    assert replays(path)[0] == 0
    elevations(file, higher_m=10)
    assert replays(path)[0] in (0, 1)
