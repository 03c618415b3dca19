"""A companion that dies of an error of its own leaves what it takes to see that error again."""

import json
import shutil
import threading
from pathlib import Path
from typing import Any

import pytest
from short_flight import ScriptedLink, Vehicle, fly_short, replayed, rewritten
from tlog import recorded_frames

from companion.config import load_mission
from companion.mission import machine
from companion.mission.events import Outcome
from companion.replay.what_if import what_if
from companion.telemetry.inputs import FILE, InputsFile

ERROR = "ZeroDivisionError: made up"


@pytest.fixture
def bug(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that cannot get past 20 s, in flight or in a replay."""
    step = machine.step

    def breaks(state: Any, event: Any, context: Any) -> Any:
        if event.time_s >= 20.0:
            raise ZeroDivisionError("made up")
        return step(state, event, context)

    monkeypatch.setattr(machine, "step", breaks)


class Paced(ScriptedLink):
    """A vehicle that does not run away from a companion in real time."""

    def receive(self, timeout_s: float) -> bytes | None:
        if timeout_s == 0.0:
            return None  # the next datagram has not come yet
        threading.Event().wait(0.004)
        return super().receive(timeout_s)


def flown_to_its_error(folder: Path, *, lockstep: bool) -> Path:
    """The run folder of a flight that ended so."""
    link = Paced(Vehicle(lockstep=lockstep))
    end = fly_short(folder, link=link, lockstep=lockstep, until_s=1e6).end
    assert end.outcome is Outcome.FAILED
    assert ERROR in end.reason
    return folder


@pytest.mark.usefixtures("bug")
@pytest.mark.parametrize("lockstep", [True, False], ids=["in lockstep", "in real time"])
def test_the_error_that_ended_a_flight_is_shown_again_at_its_place(
    tmp_path: Path, lockstep: bool
) -> None:
    found = replayed(flown_to_its_error(tmp_path / "run", lockstep=lockstep))
    assert found.difference is None
    assert found.is_identical
    assert found.unrecorded == 0
    assert found.ended_by.startswith(f"{ERROR} (test_ended.breaks, line ")
    lines = str(found).splitlines()
    assert lines[-1] == "identical"
    assert any(ERROR in line for line in lines)


@pytest.mark.usefixtures("bug")
def test_all_of_the_last_turn_is_recorded_and_nothing_that_was_not_sent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An error where the flight had none, and none where it had one, are differences."""
    run = flown_to_its_error(tmp_path / "run", lockstep=True)
    told = list(InputsFile(run / FILE))
    assert [each[0] for each in told[-4:]] == ["receive", "run", "raised", "held"]
    heard = [frame for _, frame in recorded_frames(run / "flight.tlog") if frame[6] == 1]
    last = next(each[1] for each in reversed(told) if each[0] == "receive")
    assert heard[-1] in last
    lines = (run / "journal.jsonl").read_text("utf-8").splitlines()
    assert json.loads(lines[-1])["kind"] == "part died"
    mission = load_mission(str(run / "mission.toml"))
    made = list(what_if(run, lambda _: mission, mission, seed=None))
    assert [each.plan_id for each in made] == [1]  # what if ends with the flight
    whole = (run / FILE).read_bytes()
    rewritten(run, lambda inputs: inputs.__delitem__(slice(-2, None)))
    said = str(replayed(run).difference)
    assert said.startswith(f"t 20.000 s: run.error: recorded nothing, replayed '{ERROR}")
    (run / FILE).write_bytes(whole)
    monkeypatch.undo()  # a companion that was mended
    assert replayed(run).difference.t_s == pytest.approx(20.0, abs=0.2)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The run folder of a short flight."""
    fly_short(tmp_path / "run", until_s=30.0)
    return tmp_path / "run"


def records_of(run: Path) -> list[bytes]:
    """The frames of a log, each with its stamp."""
    log, records, end = (run / "flight.tlog").read_bytes(), list[bytes](), 0
    while end < len(log):
        begin, end = end, end + 8 + 12 + log[end + 9]
        records.append(log[begin:end])
    return records


def head_of(run: Path, count: int) -> Any:
    """The replay of its first inputs alone."""
    head = Path(shutil.copytree(run, run.with_name(f"head-{count}")))
    rewritten(head, lambda inputs: inputs.__delitem__(slice(count, None)))
    return replayed(head, plans=False)


def midst_of(run: Path) -> int:
    """The number of an input in the midst of its flight."""
    runs = [number for number, each in enumerate(InputsFile(run / FILE)) if each == ("run",)]
    return runs[200]


@pytest.mark.parametrize("is_said", [True, False])
def test_a_frame_that_was_not_sent_is_left_out_if_it_is_said_so(run: Path, is_said: bool) -> None:
    begin, frames = midst_of(run), list[int]()
    for at in range(begin, begin + 40):
        frames.append(head_of(run, at).frames)
        if frames[-1] > frames[0]:
            break
    assert frames[-1] > frames[-2]  # by the input before this one
    if is_said:
        rewritten(run, lambda inputs: inputs.insert(at, ("unsent", [0])))
    records = records_of(run)
    component = 8 + 6  # where MAVLink 2 has it, behind the stamp: the autopilot's is 1
    del records[next(k for k in range(*frames[-2:]) if records[k][component] != 1)]
    (run / "flight.tlog").write_bytes(b"".join(records))
    assert (replayed(run, plans=False).difference is None) == is_said
