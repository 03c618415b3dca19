"""Whatever is in a run folder, a companion that was started again has something to go on with."""

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from renewed import replace

from companion.config import load_mission
from companion.mission import checkpoint
from companion.mission.state import Goal, Phase, State
from companion.telemetry.resume import ResumeData, load_resume_data
from companion.telemetry.run_folder import RunFolder
from companion.world.known_map import packed_map

MISSION = load_mission("sitl-arducopter")
BLANK = checkpoint.blank_map(MISSION)
HEIGHTS_M = np.linspace(400.0, 512.25, BLANK.upper_m.size).reshape(BLANK.upper_m.shape)
SEEN = replace(BLANK, upper_m=HEIGHTS_M, registration_m=1.5)
"""What the flight has come to know of the ground."""


def in_flight(**changes: Any) -> checkpoint.Values:
    """What is kept of a flight that is paused on its way to the second target."""
    state = State.of(MISSION, BLANK)
    flight = replace(state.flight, target=1, plan_id=7, legs_flown=3)
    paused = {"phase": Phase.HOLDING, "paused": True}
    state = replace(state, now_s=321.5, airborne=True, flight=flight, **paused)
    return {"system_id": 3, **checkpoint.values_of(state), **changes}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The run folder of a flight that was killed in the air."""
    with RunFolder(tmp_path / "run", mission_toml="", epoch_us=1_700_000_000_000_000) as made:
        made.header({"seed": 1})
        made.entries([{"t_s": 2.0, "kind": "vehicle found", "system_id": 3}])
        made.entries([{"t_s": 9.0, "kind": "arm"}])
        made.entries([{"t_s": 12.0, "kind": "phase", "phase": "flying", "was": "arming"}])
        made.entries([{"t_s": 320.0, "kind": "plan asked", "plan_id": 7}])
        made.known_map(SEEN)
        made.checkpoint(in_flight())
    return made.path


def resumed(folder: Path) -> tuple[ResumeData, State]:
    """What a folder tells, and the state that a flight begins with then."""
    recalled = load_resume_data(folder, MISSION)
    return recalled, checkpoint.initial_state(MISSION, recalled.resume)


def test_what_can_be_read_is_gone_on_with(folder: Path) -> None:
    """Terrain known in advance, too: without a radar nothing else would be flown over."""
    recalled, state = resumed(folder)
    assert (recalled.said, state.stage.news) == ((), "")
    assert (state.flight.target, state.paused, state.airborne) == (1, True, True)
    assert state.flight.known.surveyed.all()
    for name in ("upper_m", "cell_m", "north_min_m", "east_min_m", "registration_m"):
        assert np.array_equal(getattr(state.flight.known, name), getattr(SEEN, name))


GONE, CUT = object(), object()
CHECKPOINTS: dict[str, Any] = {
    "gone": GONE,
    "nested": b"[" * 100_000,
    "another version": {"version": 2},
    "epoch before time": {"epoch_us": -5},
    "inputs": {"inputs_bytes": "many"},
    "target": {"values": in_flight(target=99)},
    "not a number": {"values": in_flight(joined_m=float("nan"))},
    "control points": {"values": in_flight(flown=[[[[1.0, 2.0]], 0.0, 1.0]])},
    "fence": {"values": in_flight(fence={"zones": [{}]})},
}
MAPS: dict[str, Any] = {
    "truncated": CUT,
    "gone": GONE,
    "other cells": packed_map(replace(BLANK, cell_m=BLANK.cell_m * 2.0)),
    "smaller": packed_map(replace(BLANK, upper_m=BLANK.upper_m[:-1], seen=BLANK.seen[:-1])),
    "no numbers": packed_map(replace(BLANK, upper_m=np.full_like(BLANK.upper_m, np.nan))),
    "registration": packed_map(replace(BLANK, registration_m=float("nan"))),
}
DAMAGES = [("resume.json", what) for what in CHECKPOINTS] + [("known.npz", what) for what in MAPS]


def spoil(file: Path, content: Any) -> None:
    """Another content, other values in its head, or none."""
    data = file.read_bytes()
    file.unlink()
    match content:
        case bytes():
            file.write_bytes(content)
        case dict():
            file.write_text(json.dumps({**json.loads(data), **content}))
        case _ if content is CUT:
            file.write_bytes(data[: len(data) // 2])


@pytest.mark.parametrize(("name", "damage"), DAMAGES)
def test_what_cannot_be_read_is_said_in_one_line_and_the_rest_is_gone_on_with(
    folder: Path, name: str, damage: str
) -> None:
    """Without a checkpoint it takes over and never arms: what the journal has last is all it knows.

    Without a map of this flight it goes on where it was, over ground that is seen anew.
    """
    of_map = name == "known.npz"
    spoil(folder / name, (MAPS if of_map else CHECKPOINTS)[damage])
    with (folder / "journal.jsonl").open("ab") as journal:  # and whatever else stands in there
        journal.write(b'{"kind":"phase","phase":["flying"],"t_s":"x","plan_id":-1}\n')
        journal.write(b'{"kind":"vehicle found","system_id":900}\n\xff"kind":"arm"\n[1]\n{"t_')
    recalled, state = resumed(folder)
    [line] = recalled.said
    assert ("scanning anew" if of_map else "taking over without memory") in line
    assert name in line
    assert "\n" not in line
    assert len(line) < 200
    assert state.stage.news == line
    assert state.airborne
    assert np.array_equal(state.flight.known.upper_m, BLANK.upper_m)
    assert (state.flight.target, state.paused) == ((1, True) if of_map else (0, False))
    assert (state.leg, state.goal, state.flight.plan_id) == (None, Goal.TARGETS, 7)
    assert recalled.resume[0]["system_id"] == 3
    assert of_map or recalled.resume[0]["t_s"] == 320.0


@pytest.mark.parametrize("name", ["resume.json", "known.npz"])
def test_whatever_byte_is_wrong_there_is_something_to_go_on_with(folder: Path, name: str) -> None:
    """Any bit flipped, any end cut off: what is taken over is airborne, and has finite paths."""
    rng, whole, lost = random.Random(name), (folder / name).read_bytes(), 0
    for _ in range(120):
        data = bytearray(whole)
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        if rng.random() < 0.3:
            del data[rng.randrange(len(data)) :]
        (folder / name).write_bytes(data)
        recalled, state = resumed(folder)
        lost += bool(recalled.said)
        assert not np.isnan(state.flight.known.upper_m).any()
        assert 0 <= state.flight.target < len(MISSION.targets_ne_m)
    assert lost > 40


def test_what_never_got_off_the_ground_has_nothing_to_go_on_with(tmp_path: Path) -> None:
    """A loop starts it until its vehicle is there, and then it must take off."""
    with RunFolder(tmp_path, mission_toml="", epoch_us=0) as folder:
        assert load_resume_data(tmp_path, MISSION) == ResumeData()
        folder.header({})
        folder.entries([{"t_s": 1.0, "kind": "vehicle found", "system_id": 1}])
        folder.entries([{"t_s": 1.0, "kind": "phase", "phase": "preparing", "was": "waiting"}])
        folder.entries([{"t_s": 9.0, "kind": "say", "text": 'it says "kind":"arm"'}])
    assert load_resume_data(tmp_path, MISSION) == ResumeData()
