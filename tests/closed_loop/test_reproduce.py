"""A flight replayed decides the same; whatever was changed in its recording is found and named.

Of damaged recordings: `tests/replay/test_refused.py`.
"""

import shutil
from pathlib import Path
from typing import Any

import pytest
from flights import SEED, Recorded
from pymavlink.dialects.v20 import all as wire
from short_flight import mission_of, replayed, rewritten
from tlog import read_by_pymavlink, recorded_frames, written

from companion.config import load_mission
from companion.errors import InputError
from companion.replay.compare import Replayed, replay_of_folder, replay_of_log
from companion.replay.differences import message_of
from companion.telemetry.inputs import Input

pytestmark = [pytest.mark.closed_loop, pytest.mark.xdist_group("hills")]
COMPANION = 195
EVER_US = 4_000_000_000_000_000
SETPOINT = "SET_POSITION_TARGET_GLOBAL_INT"


@pytest.fixture
def copy(hills: Recorded, tmp_path: Path) -> Path:
    return Path(shutil.copytree(hills.folder, tmp_path / "run"))


def of_log(hills: Recorded, log: Path, seed: int = SEED) -> Replayed:
    """What a replay finds that knows of the telemetry log alone."""
    replay = replay_of_log(log, load_mission(str(hills.mission)), seed=seed, version="0")
    for _ in replay.steps():
        pass
    return replay.replayed


def is_ours(frame: bytes) -> bool:
    return frame[6] == COMPANION


def test_a_flight_is_replayed_to_the_last_frame_entry_and_plan(hills: Recorded) -> None:
    found = replayed(hills.folder)
    assert found.is_identical
    assert not found.plans_differ
    assert not found.torn
    assert found.unrecorded == 0
    assert found.frames == len(read_by_pymavlink(hills.folder / "flight.tlog")) > 5_000
    assert found.entries == len(hills.journal) - 1
    plans = hills.entries("plan ready") + hills.entries("plan refused")
    assert found.plans_computed == found.plans == len(plans) > 2


def test_the_log_alone_tells_a_flight_to_its_end_and_another_seed_is_found_out(
    hills: Recorded,
) -> None:
    log = hills.folder / "flight.tlog"
    found = of_log(hills, log)
    assert found.is_identical
    version_and_farewell = 30  # what depends on the version, and what came after the last input
    assert found.frames > len(recorded_frames(log)) - version_and_farewell
    assert of_log(hills, log, seed=SEED + 1).difference.what == SETPOINT


def test_in_a_log_a_frame_more_and_a_companion_that_falls_silent_are_found_out(
    hills: Recorded, tmp_path: Path
) -> None:
    """At the first frame that the companion sent, or did not; without any it is refused."""
    log = recorded_frames(hills.folder / "flight.tlog")
    turns = [is_ours(frame) for _, frame in log]  # into its first subpaths, to the end of a turn
    log = log[: next(k for k in range(8000, len(log)) if turns[k - 1] and not turns[k])]
    ours = [k for k, (_, frame) in enumerate(log) if is_ours(frame)]
    beat = next(frame for _, frame in log if is_ours(frame) and frame[7] == 0)
    farewell = 3
    cut = of_log(hills, written(tmp_path / "cut.tlog", log))
    assert (cut.is_identical, cut.unrecorded) == (True, farewell)
    difference = of_log(hills, written(tmp_path / "more.tlog", [*log, (EVER_US, beat)])).difference
    assert (difference.field, difference.recorded) == ("message", "HEARTBEAT")

    def silent_from(number: int) -> Path:
        heard = [each for k, each in enumerate(log) if k < number or not is_ours(each[1])]
        return written(tmp_path / "silent.tlog", heard)

    difference = of_log(hills, silent_from(2000)).difference
    assert difference.field == "message"
    last_us = log[max(k for k in ours if k < 2000)][0]
    assert difference.t_s == pytest.approx((last_us - log[0][0]) * 1e-6, abs=1.1)
    with pytest.raises(InputError, match=r"nothing to compare with\. Give --shadow"):
        of_log(hills, silent_from(0))


def changed_in(frame: bytes, field: str, by: float) -> bytes:
    """The same frame with another value."""
    message: Any = message_of(frame)
    setattr(message, field, getattr(message, field) + by)
    codec = wire.MAVLink(None, srcSystem=frame[5], srcComponent=frame[6])
    codec.seq = frame[4]
    return bytes(message.pack(codec))


@pytest.mark.parametrize(
    ("name", "field", "by"), [("GLOBAL_POSITION_INT", "lat", 1000), (SETPOINT, "vx", 0.5)]
)
def test_another_position_or_setpoint_is_found_at_its_time_and_field(
    copy: Path, name: str, field: str, by: float
) -> None:
    """The position in what the session was told, the setpoint in the log."""
    log = recorded_frames(copy / "flight.tlog")
    number = getattr(wire, f"MAVLINK_MSG_ID_{name}").to_bytes(3, "little")
    at = [k for k, (_, frame) in enumerate(log) if k > 5000 and frame[7:10] == number][20]
    us, frame = log[at]
    other = changed_in(frame, field, by)

    def change(told: list[Input]) -> None:
        for k, each in enumerate(told):
            if each[0] == "receive" and frame in each[1]:
                told[k] = (each[0], each[1].replace(frame, other), *each[2:])

    if is_ours(frame):
        log[at] = us, other
        written(copy / "flight.tlog", log)
    else:
        rewritten(copy, change)
    difference = replayed(copy, plans=False).difference
    assert (difference.what, difference.field) == (name, field)
    assert abs(difference.replayed - difference.recorded) == pytest.approx(by)
    assert difference.t_s == pytest.approx((us - log[0][0]) * 1e-6, abs=0.2)


def test_another_weight_changes_plans_and_not_what_is_flown_by_the_recorded_ones(
    copy: Path,
) -> None:
    """To the first plan."""
    with (copy / "mission.toml").open("a", encoding="utf-8") as file:
        file.write("\n[planner.weights]\nlength = 2.0\n")
    replay = replay_of_folder(copy, mission_of(copy))
    next(None for _ in replay.steps() if replay.replayed.plans_computed)
    found = replay.replayed
    assert (found.difference, found.is_identical, found.plans_excused) == (None, False, 0)
    assert found.plans_differ
