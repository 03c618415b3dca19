"""A companion that dies of an error of its own leaves what it takes to see that error again."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from scripted_vehicle import ScriptedLink, Vehicle
from short_flight import fly_short, mission_of, replayed, rewritten
from tlog import recorded_frames, written

from companion.mission import machine
from companion.mission.events import Outcome
from companion.replay.compare import replay_of_folder
from companion.telemetry.inputs import FILE, InputsFile

ERROR = "ZeroDivisionError: made up"
STOPPED = r"at t (19\.9|20\.\d) s \(it has stood still for 2\.1 s\)"


class Paced(ScriptedLink):
    """A vehicle that does not run away from a companion in real time."""

    def receive(self, timeout_s: float) -> bytes | None:
        return super().receive(timeout_s) if timeout_s else None  # the next has not come yet

    def clock(self) -> float:
        """However busy this computer is, no part of the companion seems to stand still."""
        return 0.001 * self.count


@pytest.mark.parametrize("lockstep", [True, False], ids=["in lockstep", "in real time"])
def test_the_error_that_ended_a_flight_is_shown_again_at_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lockstep: bool
) -> None:
    """All of the last turn is recorded, and nothing that was not sent.

    An error where the flight had none, and none where it had one, are differences.
    """
    run, step = tmp_path / "run", machine.step

    def breaks(state: Any, event: Any, context: Any) -> Any:
        """A machine that cannot get past 20 s, in flight or in a replay."""
        if event.time_s >= 20.0:
            raise ZeroDivisionError("made up")
        return step(state, event, context)

    monkeypatch.setattr(machine, "step", breaks)
    link = Paced(Vehicle(lockstep=lockstep))
    end = fly_short(run, link=link, lockstep=lockstep, until_s=1e6).end
    assert (end.outcome, ERROR in end.reason) == (Outcome.FAILED, True)
    found = replayed(run)
    assert (found.difference, found.is_identical, found.unrecorded) == (None, True, 0)
    assert found.ended_by.startswith(f"{ERROR} (test_ended.breaks, line ")
    *said, last = str(found).splitlines()
    assert last == "identical"
    assert any(ERROR in line for line in said)
    told = list(InputsFile(run / FILE))
    assert [each[0] for each in told[-4:]] == ["receive", "run", "raised", "held"]
    heard = [frame for _, frame in recorded_frames(run / "flight.tlog") if frame[6] == 1]
    assert heard[-1] in next(each[1] for each in reversed(told) if each[0] == "receive")
    lines = (run / "journal.jsonl").read_text("utf-8").splitlines()
    assert json.loads(lines[-1])["kind"] == "part died"
    rewritten(run, lambda inputs: inputs.__delitem__(slice(-2, None)))
    said = str(replayed(run).difference)
    assert re.match(rf"t 20\.\d+ s: run.error: recorded nothing, replayed '{ERROR}", said)
    rewritten(run, lambda inputs: inputs.extend(told[-2:]))
    monkeypatch.undo()  # a companion that was mended
    assert replayed(run).difference.t_s == pytest.approx(20.0, abs=0.2)


def test_a_companion_that_cannot_begin_in_a_replay_differs_and_nothing_recorded_is_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fly_short(tmp_path / "run", until_s=5.0)
    monkeypatch.setattr("companion.replay.feed.Session", lambda *_, **__: 1 / 0)
    found = replayed(tmp_path / "run")
    assert (found.damaged, found.is_identical) == ("", False)
    assert str(found.difference).startswith("t 0.000 s: start.error: recorded nothing, replayed")


@pytest.mark.parametrize("is_said", [True, False])
def test_a_frame_that_was_not_sent_is_left_out_if_it_is_said_so(
    tmp_path: Path, is_said: bool
) -> None:
    run = tmp_path / "run"
    fly_short(run, until_s=30.0)
    replay = replay_of_folder(run, mission_of(run), plans=False)
    frames = [replay.replayed.frames for _ in replay.steps()]  # after each input
    records = recorded_frames(run / "flight.tlog")
    sends = (  # the first frame that an input in the midst of the flight had it send
        (number, k)
        for number in range(len(frames) // 2, len(frames))
        for k in range(frames[number - 1], frames[number])
        if records[k][1][6] != 1  # the autopilot's component
    )
    number, unsent = next(sends)
    if is_said:
        rewritten(run, lambda inputs: inputs.insert(number + 1, ("unsent", [0])))
    del records[unsent]
    written(run / "flight.tlog", records)
    assert (replayed(run, plans=False).difference is None) == is_said


# --- a disk that stood still, and a companion that was killed


def test_it_is_said_up_to_when_a_recording_goes_that_had_stopped_and_what_a_kill_left_is_passed(
    tmp_path: Path,
) -> None:
    """What the one before has written last may be of no input; a header may have no entries."""
    run, link = tmp_path / "run", Paced(Vehicle(lockstep=False))
    fly_short(run, link=link, lockstep=False, until_s=40.0, complains_s=20.0)
    rewritten(run, lambda told: told.__delitem__(slice(told.index(("stop",)), None)))
    fly_short(run, link=link, lockstep=False, until_s=60.0, again=True)
    found = replayed(run)
    assert (found.is_identical, found.starts) == (True, 2)
    [stop] = found.stops
    assert re.fullmatch(rf"{STOPPED}; what there is ends at t (39|40)\.\d s", stop)
    entries = [x for x in (run / "journal.jsonl").read_bytes().splitlines() if b'"schema"' not in x]
    recorded = len(recorded_frames(run / "flight.tlog")) + len(entries)
    assert found.of_no_input > 0
    assert found.frames + found.entries + found.of_no_input == recorded
    journal = run / "journal.jsonl"
    before, header, after = journal.read_text("utf-8").rpartition('{"schema":')
    twice = f"{before}{header}{after.splitlines()[0]}\n{header}{after}"  # killed before any input
    journal.write_text(twice)
    assert replayed(run).entries == found.entries
    journal.write_text(twice.replace('"kind":"resumed"', '"kind":"say"'))
    assert replayed(run).difference.t_s > 36.0
