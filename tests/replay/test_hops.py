"""Between a position and the setpoint that answers it lie few calls, in few files."""

import statistics
import sys
from pathlib import Path
from types import FrameType
from typing import Any

from golden import GOLDENS

import companion
from companion.config import load_mission
from companion.mavlink.dialect import wire
from companion.mavlink.frames import Receiver
from companion.mission.state import Phase
from companion.replay.feed import Feeder
from companion.session import Session
from companion.telemetry import inputs
from companion.telemetry.inputs import InputsFile

OURS = str(Path(companion.__file__).parent)
MOST_CALLS, MOST_FILES = 43, 12
ENOUGH = 300  # positions on a leg


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


def test_a_position_passes_few_functions_in_few_files() -> None:
    folder, passed = GOLDENS / "copter-loses-gps", []
    start, *rest = InputsFile(folder / inputs.FILE)
    feeder = Feeder(lambda of: load_mission(str(folder / "mission.toml"), of.profile))
    feeder.take(start)
    session = feeder.session
    for each in rest:
        if each[0] != "receive" or session.state.phase is not Phase.FLYING:
            feeder.take(each)
            continue
        for message in Receiver().feed(each[1]):
            frame = bytes(message.get_msgbuf())
            if message.get_msgId() != wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
                session.receive(frame)
                session.run()
            elif (files := files_passed(session, frame)) is not None:
                passed.append(files)
        if len(passed) >= ENOUGH:
            break
    assert len(passed) > 100
    assert statistics.median(map(len, passed)) <= MOST_CALLS
    assert statistics.median(len(set(files)) for files in passed) <= MOST_FILES
