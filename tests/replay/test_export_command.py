"""`companion export` and `report` at the door: what they refuse, and make of a flight cut off."""

import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import pytest
from answers import answered
from recorded import run_folder

from companion.replay.command import Format
from companion.replay.exporting import recorded, write

FORMATS = get_args(Format)
COMMANDS = [("report",), *(("export", "--format", to) for to in FORMATS)]
EACH = pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[-1])


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_folder(tmp_path_factory.mktemp("recorded"))


@pytest.fixture
def copy(run_dir: Path, tmp_path: Path) -> Path:
    """The same run folder, to be spoiled."""
    return Path(shutil.copytree(run_dir, tmp_path / "run"))


@pytest.fixture(autouse=True)
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nine tenths of the time of a report goes into its figures."""
    monkeypatch.setattr("companion.views.report.svg_figures", lambda _facts: {})


def refused(command: tuple[str, ...], run: Path, *options: object) -> str:
    """What is said of it: one line, and it leaves the folder as it was."""
    before = {file: file.read_bytes() for file in run.glob("*") if file.is_file()}
    code, _, said = answered(*command, run, *options)
    assert (code, len(said.splitlines())) == (2, 1), said
    assert {file: file.read_bytes() for file in run.glob("*") if file.is_file()} == before
    return said


@EACH
def test_it_is_written_beside_the_flight_or_where_it_is_told(
    copy: Path, tmp_path: Path, command: tuple[str, ...]
) -> None:
    before = {file: file.read_bytes() for file in copy.iterdir()}
    there = tmp_path / "my flight"
    assert answered(*command, copy, "--out", there)[::2] == (0, "")
    assert {file: file.read_bytes() for file in copy.iterdir()} == before
    code, shown, _ = answered(*command, copy)
    [beside] = set(copy.iterdir()) - before.keys()
    assert code == 0
    assert beside.name == ("report.html" if command == ("report",) else f"flight.{command[-1]}")
    assert beside.read_bytes() == there.read_bytes()  # and the same each time
    if command != ("report",):
        said = f"1110 positions, 2 subpaths, 2 holds and events: {beside}"
        assert shown.splitlines()[-1] == said


@EACH
def test_what_was_recorded_is_not_written_over_and_no_place_that_cannot_be_written_to(
    copy: Path, command: tuple[str, ...]
) -> None:
    flown = "that is what the flight was recorded in"
    for out, words in {
        **{copy / file.name: flown for file in copy.iterdir()},
        copy / ".." / "run" / "run.json": flown,
        copy: "--out",
        copy / "none" / "file": "--out",
        "/dev/full": "--out = '/dev/full': not written (No space left on device)",
    }.items():
        assert words in refused(command, copy, "--out", out)


def in_place_of_a_folder(run: Path) -> None:
    shutil.rmtree(run)
    run.write_bytes(b"a log")


NO_FLIGHTS: dict[str, Callable[[Path], object]] = {
    "it holds no mission.toml": lambda run: (run / "mission.toml").unlink(),
    "it holds no flight.tlog": lambda run: (run / "flight.tlog").unlink(),
    "No such file": lambda run: (run / "journal.jsonl").unlink(),
    "RUN_DIR = ": shutil.rmtree,
    "is a file": in_place_of_a_folder,
}


@pytest.mark.parametrize("words", NO_FLIGHTS)
def test_what_is_no_run_folder_is_refused(copy: Path, words: str) -> None:
    NO_FLIGHTS[words](copy)
    for command in COMMANDS[:2]:
        assert words in refused(command, copy)


@pytest.mark.parametrize("to", FORMATS)
def test_a_flight_that_was_cut_off_anywhere_is_exported_as_far_as_it_goes(
    run_dir: Path, tmp_path: Path, to: Format
) -> None:
    rng = random.Random(to)
    whole, _ = recorded(run_dir)
    for share in [0.0, 0.002, *(rng.random() for _ in range(4)), 0.999]:
        copy = Path(shutil.copytree(run_dir, tmp_path / f"{share}"))
        for name in ("journal.jsonl", "flight.tlog"):
            data = (run_dir / name).read_bytes()
            (copy / name).write_bytes(data[: int(share * len(data))])
        flight, notes = recorded(copy)
        assert len(flight.track) <= len(whole.track)
        assert not any("\n" in note for note in notes)
        write(flight, to, copy / f"flight.{to}")
        assert (copy / f"flight.{to}").is_file()
        if share > 0.5:
            assert len(flight.track) > 0.3 * len(whole.track)
            torn = any("last line is not whole" in note for note in notes)
            assert torn is not (copy / "journal.jsonl").read_bytes().endswith(b"\n")
