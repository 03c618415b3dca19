"""A flight in real time, killed with -9 and started again, is replayed as it was: two lives."""

from functools import partial
from pathlib import Path

import pytest
from flights import HILLS, HILLS_MISSION, launch, run
from programs import Program

from companion.config import load_mission
from companion.replay.reproduce import Replay
from companion.runtime.compiler import load_kernel

pytestmark = [pytest.mark.closed_loop, pytest.mark.nightly]  # and a golden flight is such a one


def until_written(path: Path, text: bytes, by: Program) -> None:
    """Wait until a file of a flight has a text."""
    by.until(lambda: path.exists() and text in path.read_bytes(), what=f"write {text!r}")


def test_a_flight_in_real_time_with_a_kill_and_a_silence_is_replayed(tmp_path: Path) -> None:
    faults = tmp_path / "faults.txt"
    faults.write_text("at 30 s for 5 s: link_off\n", encoding="utf-8")
    flight = launch(
        tmp_path / "run",
        HILLS,
        HILLS_MISSION,
        clock=("--speedup", "10"),
        simulator_options=("--faults", faults),
    )
    written = partial(until_written, flight.folder / "journal.jsonl")
    written(b'"kind":"arm"', flight.companion)
    flight.companion.kill()
    again = run(*map(str, flight.companion.process.args), "--resume")  # type: ignore[union-attr]
    for text in (b'"kind":"resumed"', b'"kind":"scan done"'):
        written(text, again)
    again.interrupt(60.0)
    replay = Replay(
        flight.folder,
        lambda start: load_mission(HILLS_MISSION, start.profile),
        kernel=load_kernel(),
    )
    for _ in replay.steps():
        pass
    assert replay.found.is_identical, replay.found
    assert replay.found.starts == 2
    assert replay.found.unrecorded == 0
