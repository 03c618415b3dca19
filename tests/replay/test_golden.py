"""Golden flights decide what they decided when a person last looked (see golden.py), and soon."""

import json
import statistics
import sys
import tomllib
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from golden import GOLDENS, NAMES, decisions_of, differences, expected
from record_golden import texts

import companion
from companion.mavlink.dialect import wire
from companion.mavlink.frames import Receiver
from companion.mission.state import Phase
from companion.replay.feed import Feeder, flown_mission
from companion.session import Session
from companion.telemetry.inputs import FILE, InputsFile

EACH = pytest.mark.parametrize("name", NAMES)
OURS = str(Path(companion.__file__).parent)
MOST_CALLS, MOST_FILES = 33, 12
ENOUGH = 300  # positions on a leg


def changed(name: str) -> str:
    """What a golden flight decides otherwise now."""
    return differences(expected(GOLDENS / name), list(decisions_of(GOLDENS / name)))


@EACH
def test_a_golden_flight_decides_what_it_decided(name: str) -> None:
    assert len((GOLDENS / name / "why.md").read_text(encoding="utf-8")) > 80
    assert not (report := changed(name)), (
        f"{report}\nIf that is meant: scripts/update-goldens {name}"
    )


@EACH
@pytest.mark.sample(2)
@pytest.mark.usefixtures("nudged")
def test_a_golden_flight_decides_the_same_a_micrometre_aside(name: str) -> None:
    assert not (report := changed(name)), f"{report}\nit hangs on the last digits of a position"


@EACH
def test_a_recipe_gives_the_mission_that_was_flown(name: str) -> None:
    how = json.loads((GOLDENS / name / "flight.json").read_text(encoding="utf-8"))
    if "log" not in how:
        recorded = (GOLDENS / name / "mission.toml").read_text(encoding="utf-8")
        again = texts(GOLDENS / name, how)
        assert tomllib.loads(again["mission.toml"]) == tomllib.loads(recorded)
        assert "vehicle" in tomllib.loads(again["world.toml"])


def files_passed(session: Session, frame: bytes) -> list[str] | None:
    """The file of each function of ours that is called; None: it led to no setpoint on a leg."""
    calls: list[str] = []

    def note(at: FrameType, event: str, _: Any) -> None:
        if event == "call" and at.f_code.co_filename.startswith(OURS):
            calls.append(at.f_code.co_filename)

    sys.setprofile(note)
    try:
        session.receive(frame)
        output = session.run()
    finally:
        sys.setprofile(None)
    follows = session.state.phase is Phase.FLYING and session.state.leg is not None
    return calls if follows and len(output.frames) == 1 else None


def test_between_a_position_and_its_setpoint_lie_few_calls_in_few_files() -> None:
    folder, passed = GOLDENS / "copter-loses-gps", []
    feeder = Feeder(flown_mission(folder))
    for told in InputsFile(folder / FILE):
        if told[0] != "receive" or feeder.session.state.phase is not Phase.FLYING:
            feeder.take(told)
            continue
        for message in Receiver().feed(told[1]):
            frame = bytes(message.get_msgbuf())
            if message.get_msgId() != wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
                feeder.session.receive(frame)
                feeder.session.run()
            elif (files := files_passed(feeder.session, frame)) is not None:
                passed.append(files)
        if len(passed) >= ENOUGH:
            break
    assert len(passed) > 100
    assert statistics.median(map(len, passed)) <= MOST_CALLS
    assert statistics.median(len(set(files)) for files in passed) <= MOST_FILES
