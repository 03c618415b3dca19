"""`companion export` and `report` at the door: what they refuse, and make of a flight cut off."""

import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import pytest
from answers import answered

from companion.replay.command import Format
from companion.replay.exporting import recorded, write

FORMATS = get_args(Format)
COMMANDS = [("report",), *(("export", "--format", to) for to in FORMATS)]
EACH = pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[-1])


@pytest.fixture(autouse=True)
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nine tenths of the time of a report goes into its figures."""
    monkeypatch.setattr("companion.views.report.svg_figures", lambda _facts: {})


def contents(run: Path) -> dict[Path, bytes]:
    return {file: file.read_bytes() for file in run.glob("*") if file.is_file()}


@EACH
def test_it_is_written_beside_the_flight_or_where_it_is_told(
    copy: Path, tmp_path: Path, command: tuple[str, ...]
) -> None:
    before, there = contents(copy), tmp_path / "my flight"
    assert answered(*command, copy, "--out", there)[::2] == (0, "")
    assert contents(copy) == before
    code, shown, _ = answered(*command, copy)
    [beside] = set(copy.iterdir()) - before.keys()
    assert code == 0
    assert beside.name == ("report.html" if command == ("report",) else f"flight.{command[-1]}")
    assert beside.read_bytes() == there.read_bytes()  # and the same each time
    if command != ("report",):
        said = f"1110 positions, 2 subpaths, 2 holds and events: {beside}"
        assert shown.splitlines()[-1] == said


NO_FLIGHTS: dict[str, Callable[[Path], object]] = {
    "it holds no mission.toml": lambda run: (run / "mission.toml").unlink(),
    "it holds no flight.tlog": lambda run: (run / "flight.tlog").unlink(),
    "No such file": lambda run: (run / "journal.jsonl").unlink(),
    "RUN_DIR = ": shutil.rmtree,
    "is a file": lambda run: (shutil.rmtree(run), run.write_bytes(b"a log")),
}
FLOWN = "that is what the flight was recorded in"
NO_PLACES = dict.fromkeys(("flight.tlog", "journal.jsonl", "../run/run.json"), FLOWN)
NO_PLACES |= {".": "--out", "none/file": "--out", "/dev/full": "not written (No space left on"}


@pytest.mark.parametrize("words", [*NO_FLIGHTS, *NO_PLACES])
def test_what_is_no_run_folder_is_refused_and_no_place_that_is_recorded_or_cannot_be_written_to(
    copy: Path, words: str
) -> None:
    """In one line, and it leaves the folder as it was."""
    NO_FLIGHTS.get(words, lambda _: None)(copy)
    before = contents(copy)
    out = ("--out", copy / words) if words in NO_PLACES else ()
    for command in COMMANDS:
        code, _, said = answered(*command, copy, *out)
        assert (code, len(said.splitlines())) == (2, 1), said
        assert NO_PLACES.get(words, words) in said
        assert contents(copy) == before


@pytest.mark.parametrize("to", FORMATS)
def test_a_flight_that_was_cut_off_anywhere_is_exported_as_far_as_it_goes(
    run_dir: Path, tmp_path: Path, to: Format
) -> None:
    rng, (whole, _) = random.Random(to), recorded(run_dir)
    for share in [0.0, 0.002, *(rng.random() for _ in range(4)), 0.999]:
        copy = Path(shutil.copytree(run_dir, tmp_path / f"{share}"))
        for name in ("journal.jsonl", "flight.tlog"):
            data = (run_dir / name).read_bytes()
            (copy / name).write_bytes(data[: int(share * len(data))])
        flight, notes = recorded(copy)
        write(flight, to, copy / f"flight.{to}")
        assert (copy / f"flight.{to}").is_file()
        assert min(share - 0.2, 0.3) * len(whole.track) < len(flight.track) <= len(whole.track)
        torn = (copy / "journal.jsonl").read_bytes().rpartition(b"\n")[2] != b""
        assert any("last line is not whole" in note for note in notes) is torn
        assert not any("\n" in note for note in notes)
