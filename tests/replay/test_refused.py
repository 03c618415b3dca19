"""What a replay was not asked properly, or not given whole, it says in one line: never a traceback,
and never that nothing is the same as something."""

import copy
import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from answers import answered
from rasterio.transform import Affine
from short_flight import (
    fly_short,
    replayed,
    rewritten,
    short_mission,
    straight_plan,
)

from companion.config import load_mission
from companion.errors import InputError
from companion.mission.journal import VERSION
from companion.planner.request import PlanOutcome, PlanRequest
from companion.replay import actions, reproduce
from companion.replay.feed import DamagedInputError, Feeder, start_of
from companion.telemetry.inputs import FILE, HEADER, Input, InputsFile, packed


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("refused") / "run"
    fly_short(path, until_s=33.0)
    return path


@pytest.fixture
def run(run_dir: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(run_dir, tmp_path / "run"))


def replays(*arguments: object) -> tuple[int, str, list[str]]:
    """Exit code of a replay, what it printed, and the lines of its errors."""
    quick = [] if "--seed" in arguments else ["--no-plans"]
    code, out, said = answered("replay", *arguments, *quick)
    return code, out, [line for line in said.splitlines() if "error:" in line]


# --- nothing to compare


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


# --- another version


def of_an_older_journal(run: Path) -> str:
    path = run / "journal.jsonl"
    head, rest = path.read_bytes().split(b"\n", 1)
    older = json.dumps({**json.loads(head), "version": VERSION - 1}, separators=(",", ":"))
    path.write_bytes(older.encode() + b"\n" + rest)
    return "its journal is of version 2"


def with_a_key_that_is_gone(run: Path) -> str:
    with (run / "mission.toml").open("a", encoding="utf-8") as file:
        file.write("[traffic]\nspacing_m = 100.0\n")
    return "its mission.toml has traffic, which was removed"


@pytest.mark.parametrize("change", [of_an_older_journal, with_a_key_that_is_gone])
@pytest.mark.parametrize(
    "command",
    [
        ("replay", "RUN"),
        ("replay", "RUN", "--seed", 3),
        ("report", "RUN"),
        ("export", "RUN", "--format", "csv"),
        ("view", "RUN", "--view-port", 0),
        ("fly", "environment-1", "--out", "RUN", "--resume"),
    ],
    ids=lambda command: " ".join(map(str, command)),
)
def test_a_run_folder_of_an_older_version_is_told_who_reads_it_and_left_as_it_is(
    run: Path, command: tuple[object, ...], change: Callable[[Path], str]
) -> None:
    why = change(run)
    before = {file: file.read_bytes() for file in run.iterdir()}
    code, _, said = answered(*(run if word == "RUN" else word for word in command))
    assert code == 2
    rule = f"an older companion has recorded it: {why}. Use companion 0.2.0 for it."
    assert said == f"error: RUN_DIR = '{run}': {rule}\n"
    assert {file: file.read_bytes() for file in run.iterdir()} == before


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
    with pytest.raises(DamagedInputError):
        begun(run_dir).take(told)


def begun(run_dir: Path) -> Feeder:
    feeder = Feeder(lambda _: load_mission("valley"))
    feeder.take(next(iter(InputsFile(run_dir / FILE))))
    return feeder


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
