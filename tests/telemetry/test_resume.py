"""Whatever is in a run folder, a companion that was started again has something to go on with."""

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from renewed import replace

from companion.config import load_mission
from companion.mission import checkpoint
from companion.mission.state import Orders, Phase, Reason, State
from companion.telemetry.resume import ResumeData, load_resume_data
from companion.telemetry.run_folder import RunFolder
from companion.world.known_map import KnownMap

MISSION = load_mission("sitl-arducopter")
BLANK = checkpoint.blank_map(MISSION)
EPOCH_US = 1_700_000_000_000_000


def in_flight() -> checkpoint.Values:
    """What is kept of a flight that is paused on its way to the second target."""
    state = State.of(MISSION, BLANK)
    flight = replace(state.flight, target=1, plan_id=7, legs_flown=3)
    paused = {"phase": Phase.HOLDING, "orders": Orders(Reason.PAUSED)}
    state = replace(state, now_s=321.5, airborne=True, flight=flight, **paused)
    return {"system_id": 3, **checkpoint.values_of(state)}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The run folder of a flight that was killed in the air."""
    path = tmp_path / "run"
    with RunFolder(path, mission_toml="", epoch_us=EPOCH_US) as made:
        made.header({"seed": 1})
        made.entries([{"t_s": 2.0, "kind": "vehicle found", "system_id": 3}])
        made.entries([{"t_s": 9.0, "kind": "arm"}])
        made.entries([{"t_s": 12.0, "kind": "phase", "phase": "flying", "was": "arming"}])
        made.entries([{"t_s": 320.0, "kind": "plan asked", "plan_id": 7}])
        made.known_map(replace(BLANK, upper_m=np.full_like(BLANK.upper_m, 512.0)))
        made.checkpoint(in_flight())
    return path


def begun(recalled: ResumeData) -> State:
    return checkpoint.initial_state(MISSION, recalled.resume)


def test_what_can_be_read_is_gone_on_with(folder: Path) -> None:
    recalled = load_resume_data(folder, MISSION)
    assert recalled.said == ()
    state = begun(recalled)
    assert (state.flight.target, state.orders.active, state.airborne) == (1, Reason.PAUSED, True)
    assert (state.flight.known.upper_m == 512.0).all()
    assert state.stage.news == ""


def test_terrain_known_in_advance_is_still_known_after_a_restart(folder: Path) -> None:
    """Else, without a radar, nothing would be flown over any more."""
    assert BLANK.surveyed.all()
    assert begun(load_resume_data(folder, MISSION)).flight.known.surveyed.all()


def write(name: str, data: bytes) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_bytes(data)


def edit(**changes: Any) -> Callable[[Path], object]:
    """resume.json with other values in its head."""

    def change(folder: Path) -> None:
        head = json.loads((folder / "resume.json").read_bytes())
        (folder / "resume.json").write_text(json.dumps({**head, **changes}), encoding="utf-8")

    return change


def revalue(**changes: Any) -> Callable[[Path], object]:
    """resume.json with other values of the flight."""
    return lambda folder: edit(values={**in_flight(), **changes})(folder)


def cut(name: str, share: float) -> Callable[[Path], object]:
    def change(folder: Path) -> None:
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: round(share * len(data))])

    return change


DAMAGES: dict[str, Callable[[Path], object]] = {
    "empty": write("resume.json", b""),
    "binary": write("resume.json", b"\xff\xfe\x00"),
    "not an object": write("resume.json", b"[]"),
    "nested": write("resume.json", b"[" * 100_000),
    "truncated": cut("resume.json", 0.6),
    "another schema": edit(schema="other"),
    "another version": edit(version=2),
    "no version": edit(version=None),
    "epoch in words": edit(epoch_us="yesterday"),
    "epoch before time": edit(epoch_us=-5),
    "epoch without end": edit(epoch_us=1e300),
    "inputs": edit(inputs_bytes="many"),
    "values": edit(values=[]),
    "no values": edit(values={}),
    "a phase only": edit(values={"phase": "FLYING"}),
    "target": revalue(target=99),
    "target below": revalue(target=-1),
    "target in words": revalue(target="north"),
    "target infinite": revalue(target=float("inf")),
    "not a number": revalue(joined_m=float("nan")),
    "leg": revalue(leg={"number": 1}),
    "leg in words": revalue(leg="straight"),
    "control points": revalue(flown=[[[[1.0, 2.0]], 0.0, 1.0]]),
    "fence": revalue(fence={"zones": [{}]}),
    "reason": revalue(standing="BORED"),
    "system": revalue(system_id="one"),
    "system 0": revalue(system_id=0),
    "gone": lambda folder: (folder / "resume.json").unlink(),
    "a folder": lambda folder: (
        (folder / "resume.json").unlink(),
        (folder / "resume.json").mkdir(),
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_without_a_checkpoint_that_can_be_read_it_takes_over_and_never_arms(
    folder: Path, damage: str
) -> None:
    DAMAGES[damage](folder)
    recalled = load_resume_data(folder, MISSION)
    [line] = recalled.said
    assert "taking over without memory" in line
    assert "resume.json" in line
    assert "\n" not in line
    assert len(line) < 200
    state = begun(recalled)
    assert state.airborne
    assert state.stage.news == line
    assert (state.flight.target, state.leg, state.orders.active) == (0, None, None)
    assert np.array_equal(state.flight.known.upper_m, BLANK.upper_m)
    assert state.flight.plan_id == 7
    assert recalled.resume[0]["system_id"] == 3  # as the journal has it


MAPS: dict[str, Callable[[Path], object]] = {
    "empty": write("known.npz", b""),
    "binary": write("known.npz", b"PK\x03\x04\x00\x00"),
    "truncated": cut("known.npz", 0.5),
    "gone": lambda folder: (folder / "known.npz").unlink(),
}


@pytest.mark.parametrize("damage", MAPS)
def test_without_a_map_that_can_be_read_the_rest_is_gone_on_with(folder: Path, damage: str) -> None:
    MAPS[damage](folder)
    recalled = load_resume_data(folder, MISSION)
    [line] = recalled.said
    assert "scanning anew" in line
    assert "known.npz" in line
    state = begun(recalled)
    assert (state.flight.target, state.orders.active, state.airborne) == (1, Reason.PAUSED, True)
    assert np.array_equal(state.flight.known.upper_m, BLANK.upper_m)
    assert state.stage.news == line


@pytest.mark.parametrize(
    "known",
    [
        replace(BLANK, cell_m=BLANK.cell_m * 2.0),
        replace(BLANK, north_min_m=BLANK.north_min_m + 1.0),
        replace(BLANK, upper_m=BLANK.upper_m[:-1], seen=BLANK.seen[:-1]),
        replace(BLANK, seen=BLANK.seen[:-1]),
        replace(BLANK, upper_m=np.full_like(BLANK.upper_m, np.nan)),
        replace(BLANK, upper_m=BLANK.upper_m.astype(np.int64, casting="unsafe")),
        replace(BLANK, registration_m=float("nan")),
    ],
    ids=["cells", "origin", "size", "seen", "not a number", "whole numbers", "registration"],
)
@pytest.mark.filterwarnings("ignore:invalid value encountered in cast")
def test_a_map_of_something_else_is_no_map_of_this_flight(folder: Path, known: KnownMap) -> None:
    with RunFolder(folder, mission_toml="", epoch_us=1, resume=True) as again:
        again.known_map(known)
    [line] = load_resume_data(folder, MISSION).said
    assert "known.npz" in line


@pytest.mark.parametrize("name", ["resume.json", "known.npz"])
def test_whatever_byte_is_wrong_there_is_something_to_go_on_with(folder: Path, name: str) -> None:
    """Any bit flipped, any end cut off: what is taken over is airborne, and has finite paths."""
    rng, whole = random.Random(name), (folder / name).read_bytes()
    lost = 0
    for _ in range(120):
        data = bytearray(whole)
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        if rng.random() < 0.3:
            del data[rng.randrange(len(data)) :]
        (folder / name).write_bytes(data)
        recalled = load_resume_data(folder, MISSION)
        state = begun(recalled)
        lost += bool(recalled.said)
        assert not np.isnan(state.flight.known.upper_m).any()
        assert 0 <= state.flight.target < len(MISSION.targets_ne_m)
    assert lost > 40


# --- what is no flight yet


@pytest.mark.parametrize("made", [False, True])
def test_where_no_flight_has_begun_there_is_nothing_to_go_on_with(
    tmp_path: Path, made: bool
) -> None:
    if made:
        tmp_path.joinpath("run").mkdir()
    assert load_resume_data(tmp_path / "run", MISSION) == ResumeData()


def test_a_companion_that_never_got_off_the_ground_has_nothing_to_go_on_with(
    tmp_path: Path,
) -> None:
    """A loop starts it until its vehicle is there, and then it must take off."""
    with RunFolder(tmp_path, mission_toml="", epoch_us=0) as folder:
        folder.header({})
        folder.entries([{"t_s": 1.0, "kind": "vehicle found", "system_id": 1}])
        folder.entries([{"t_s": 1.0, "kind": "phase", "phase": "preparing", "was": "waiting"}])
        folder.entries([{"t_s": 9.0, "kind": "say", "text": 'it says "kind":"arm"'}])
    assert load_resume_data(tmp_path, MISSION) == ResumeData()


def test_a_journal_full_of_anything_is_read_as_far_as_it_goes(folder: Path) -> None:
    (folder / "resume.json").unlink()
    with (folder / "journal.jsonl").open("ab") as journal:
        journal.write(b'{"kind":"phase","phase":["flying"],"t_s":"x","plan_id":-1}\n')
        journal.write(b'{"kind":"vehicle found","system_id":900}\n\xff"kind":"arm"\n[1]\n{"t_')
    recalled = load_resume_data(folder, MISSION)
    assert recalled.resume[0]["system_id"] == 3
    assert recalled.resume[0]["t_s"] == 320.0
