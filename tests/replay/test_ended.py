"""A companion that dies of an error of its own leaves what it takes to see that error again."""

import json
import shutil
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from short_flight import ScriptedLink, Vehicle, fly_short, replayed, rewritten
from tlog import recorded_frames

from companion.config import load_mission
from companion.mission import machine
from companion.mission.events import Outcome
from companion.replay.what_if import what_if
from companion.telemetry.inputs import FILE, Input, InputsFile

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


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Callable[[bool], Path]:
    """Flies once in lockstep and once in real time -> run folder."""

    @cache
    def fly(lockstep: bool) -> Path:
        folder, link = tmp_path_factory.mktemp("ended") / "run", Paced(Vehicle(lockstep=lockstep))
        end = fly_short(folder, link=link, lockstep=lockstep, until_s=1e6).end
        assert end.outcome is Outcome.FAILED
        assert ERROR in end.reason
        return folder

    return fly


@pytest.fixture
def ended(
    tmp_path: Path, bug: None, flown: Callable[[bool], Path], request: pytest.FixtureRequest
) -> Path:
    """The run folder of a flight that ended so."""
    del bug
    return Path(shutil.copytree(flown(request.param), tmp_path / "run"))


EITHER = pytest.mark.parametrize(
    "ended", [True, False], indirect=True, ids=["in lockstep", "in real time"]
)
LOCKSTEP = pytest.mark.parametrize("ended", [True], indirect=True, ids=["in lockstep"])


@EITHER
def test_the_error_that_ended_a_flight_is_shown_again_at_its_place(ended: Path) -> None:
    found = replayed(ended)
    assert found.difference is None
    assert found.is_identical
    assert found.unrecorded == 0
    assert (found.ended_by.call, found.ended_by.error) == ("run", ERROR)
    assert found.ended_by.place.startswith("test_ended.breaks, line ")
    lines = str(found).splitlines()
    assert lines[-1] == "identical"
    assert any(ERROR in line for line in lines)
    assert found.as_json()["ended_by"] == ERROR


@LOCKSTEP
def test_what_the_last_turn_was_told_is_recorded_and_nothing_that_was_not_sent(
    ended: Path,
) -> None:
    told = list(InputsFile(ended / FILE))
    assert [each[0] for each in told[-4:]] == ["receive", "run", "raised", "held"]
    heard = [frame for _, frame in recorded_frames(ended / "flight.tlog") if frame[6] == 1]
    last = next(each[1] for each in reversed(told) if each[0] == "receive")
    assert heard[-1] in last
    lines = (ended / "journal.jsonl").read_text("utf-8").splitlines()
    assert json.loads(lines[-1])["kind"] == "part died"


@LOCKSTEP
def test_a_companion_that_was_mended_is_told_from_the_one_that_flew(
    ended: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    difference = replayed(ended).difference
    assert difference.t_s == pytest.approx(20.0, abs=0.2)


@LOCKSTEP
def test_an_error_where_the_flight_had_none_is_a_difference(ended: Path) -> None:
    def change(told: list[Input]) -> None:
        del told[-2:]

    rewritten(ended, change)
    difference = replayed(ended).difference
    assert str(difference).startswith(f"t 20.000 s: run.error: recorded nothing, replayed '{ERROR}")


@LOCKSTEP
def test_what_if_ends_with_the_flight(ended: Path) -> None:
    mission = load_mission(str(ended / "mission.toml"))
    made = list(what_if(ended, lambda _: mission, mission, seed=None))
    assert [each.plan_id for each in made] == [1]


def test_an_error_from_outside_of_the_decisions_is_no_difference(tmp_path: Path) -> None:
    class Failing(ScriptedLink):
        def send(self, frames: list[bytes]) -> None:
            if self.vehicle.time_ms >= 20_000:
                raise OSError("the driver is gone")
            super().send(frames)

    end = fly_short(tmp_path / "run", link=Failing(Vehicle())).end
    assert end.outcome is Outcome.FAILED
    found = replayed(tmp_path / "run")
    assert found.difference is None
    assert str(found.ended_by) == "OSError: the driver is gone"
    assert found.ended_by.call == ""


def records_of(run: Path) -> list[bytes]:
    """The frames of a log, each with its stamp."""
    log, records, end = (run / "flight.tlog").read_bytes(), list[bytes](), 0
    while end < len(log):
        begin, end = end, end + 8 + 12 + log[end + 9]
        records.append(log[begin:end])
    return records


@pytest.mark.parametrize("is_said", [True, False])
def test_a_frame_that_was_not_sent_is_left_out_if_it_is_said_so(
    tmp_path: Path, is_said: bool
) -> None:
    run = tmp_path / "run"
    fly_short(run, until_s=30.0)
    runs = [number for number, each in enumerate(InputsFile(run / FILE)) if each == ("run",)]
    frames = list[int]()
    for at in range(runs[200], runs[200] + 40):
        head = tmp_path / f"head-{at}"
        shutil.copytree(run, head)
        rewritten(head, lambda inputs, at=at: inputs.__setitem__(slice(at, None), []))
        frames.append(replayed(head, plans=False).frames)
        if frames[-1] > frames[0]:
            break
    assert frames[-1] > frames[-2]  # by the input before this one
    if is_said:
        rewritten(run, lambda inputs: inputs.insert(at, ("unsent", [0])))
    records = records_of(run)
    ours = 8 + 6  # where MAVLink 2 has the component, behind the stamp: the autopilot's is 1
    sent = [at for at in range(*frames[-2:]) if records[at][ours] != 1]
    del records[sent[0]]
    (run / "flight.tlog").write_bytes(b"".join(records))
    found = replayed(run, plans=False)
    assert (found.difference is None) == is_said


def test_what_the_watchdog_sent_meanwhile_is_passed_over(tmp_path: Path) -> None:
    """Two frames and the entry about them, in the midst of a flight."""
    run = tmp_path / "run"
    fly_short(run, until_s=30.0)
    told = list(InputsFile(run / FILE))
    at = [number for number, each in enumerate(told) if each == ("run",)][200] + 1
    whole, head = replayed(run, plans=False), tmp_path / "head"
    shutil.copytree(run, head)
    rewritten(head, lambda inputs: inputs.__setitem__(slice(at, None), []))
    until = replayed(head, plans=False)
    rewritten(run, lambda inputs: inputs.insert(at, ("held", 2)))
    records = records_of(run)
    records[until.frames : until.frames] = records[:2]
    (run / "flight.tlog").write_bytes(b"".join(records))
    lines = (run / "journal.jsonl").read_bytes().splitlines(keepends=True)
    lines.insert(1 + until.entries, b'{"t_s":1.0,"kind":"held"}\n')
    (run / "journal.jsonl").write_bytes(b"".join(lines))
    found = replayed(run, plans=False)
    assert 0 < until.frames < found.frames == whole.frames
    assert found.is_identical
