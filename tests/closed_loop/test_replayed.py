"""A flight in real time, killed with -9 and started again, is replayed as it was: two lives."""

import subprocess
from pathlib import Path

import pytest
from flights import Launch, interrupt, run

from companion.config import load_mission
from companion.replay.same import Replay
from companion.runtime.compiler import load_kernel

pytestmark = pytest.mark.closed_loop
HILLS = Path(__file__).parent / "hills"
MISSION = str(HILLS / "mission.toml")
LOOK_S, PATIENCE_S = 0.02, 100.0


def wait_for(path: Path, text: bytes, process: "subprocess.Popen[str]") -> None:
    """Wait until a file of a flight has a text."""
    for _ in range(round(PATIENCE_S / LOOK_S)):
        if path.exists() and text in path.read_bytes():
            return
        try:
            process.wait(timeout=LOOK_S)
        except subprocess.TimeoutExpired:
            continue
        break
    raise AssertionError(f"no {text!r} in {path}")


def test_a_flight_in_real_time_with_a_kill_and_a_silence_is_replayed(
    start: Launch, tmp_path: Path
) -> None:
    faults = tmp_path / "faults.txt"
    faults.write_text("at 30 s for 5 s: link_off\n", encoding="utf-8")
    flight = start(
        str(HILLS / "world.toml"),
        MISSION,
        clock=("--speedup", "10"),
        simulator_options=("--faults", str(faults)),
    )
    journal = flight.folder / "journal.jsonl"
    wait_for(journal, b'"kind":"arm"', flight.companion)
    flight.companion.kill()
    flight.companion.communicate()
    arguments = [str(each) for each in flight.companion.args]  # type: ignore[union-attr]
    flight.companion = run("companion", *arguments[1:], "--resume")
    wait_for(journal, b'"kind":"resumed"', flight.companion)
    wait_for(journal, b'"kind":"scan done"', flight.companion)
    interrupt(flight.companion)
    flight.companion.communicate(timeout=PATIENCE_S)
    replay = Replay(
        flight.folder, lambda start: load_mission(MISSION, start.profile), kernel=load_kernel()
    )
    for _ in replay.steps():
        pass
    assert replay.found.is_identical, replay.found
    assert replay.found.starts == 2
    assert replay.found.unrecorded == 0
