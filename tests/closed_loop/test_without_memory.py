"""A companion that is killed in flight, and whose memory cannot be read by the one that follows."""

import itertools
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tlog
from flights import ENVIRONMENTS, kept, launch, run, short_mission

from companion.config import load_mission
from companion.mission.checkpoint import without_checkpoint
from companion.mission.events import Order, OrderKind
from companion.planner.plan import plan
from companion.runtime.in_process import loop_in_process
from companion.session import Session
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world

pytestmark = [pytest.mark.closed_loop, pytest.mark.nightly]  # without a wire: `test_memory`


def truncate(folder: Path) -> None:
    file = folder / "resume.json"
    file.write_bytes(file.read_bytes()[:300])


def another_version(folder: Path) -> None:
    file = folder / "resume.json"
    file.write_text(json.dumps({**json.loads(file.read_bytes()), "version": 99}), encoding="utf-8")
    (folder / "known.npz").write_bytes(b"")


def is_in_a_leg(now: dict[str, Any] | None) -> bool:
    in_leg = now is not None and now["phase"] == "FLYING" and now["leg"] is not None
    return in_leg and now["legs_flown"] >= 1


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("sitl-arducopter", truncate),
        ("sitl-px4", another_version),
    ],
)
def test_it_takes_over_says_so_never_arms_and_arrives(
    tmp_path: Path, name: str, damage: Callable[[Path], None]
) -> None:
    mission = short_mission(name, tmp_path)
    flight = launch(tmp_path / "run", name, mission, "--resume", "--system", "1")
    folder, first = flight.folder, flight.companion
    first.until(lambda: is_in_a_leg(kept(folder)))
    first.kill()
    log, journal = folder / "flight.tlog", folder / "journal.jsonl"
    recorded = (log.read_bytes(), journal.read_bytes())
    damage(folder)
    torn, known = (folder / "resume.json").read_bytes(), (folder / "known.npz").read_bytes()

    flight.companion = run(*map(str, first.process.args))  # type: ignore[union-attr]
    flight.wait()
    flight.ended_well()
    said = flight.companion.transcript
    assert said.count("warning: taking over without memory of the flight: resume.json") == 1
    assert (folder / "resume.lost-1.json").read_bytes() == torn
    assert (folder / "known.lost-1.npz").read_bytes() == known
    for file, before in zip((log, journal), recorded, strict=True):
        whole = before[: before.rindex(b"\n") + 1] if file is journal else before[:-288]
        assert file.read_bytes().startswith(whole), f"{file.name} was written over"

    heads = [k for k, entry in enumerate(flight.journal) if "schema" in entry]
    later = flight.journal[heads[1] :]
    assert later[0]["resumed"] == 1
    assert not [entry for entry in later if entry.get("kind") in ("arm", "take off")]
    [warning] = [text for text in flight.says if "without memory" in text]
    frames = tlog.messages(folder)
    texts = "".join(each.text for each in frames if each.get_type() == "STATUSTEXT")
    assert warning in texts
    armed = [row["armed"] for row in flight.truth]
    assert [after for before, after in itertools.pairwise(armed) if before != after][:1] == [True]


@pytest.mark.parametrize(("name", "after_s"), [("sitl-arducopter", 85.0), ("sitl-px4-plane", 90.0)])
def test_told_to_return_it_lands_at_home_and_not_where_it_took_over(
    name: str, after_s: float
) -> None:
    mission = load_mission(name)
    vehicle = Simulation(read_world(ENVIRONMENTS / name / "world.toml"), seed=1)
    before = Session(mission, seed=1, lockstep=True, go=True)
    for _ in loop_in_process(before, vehicle, planner=plan).turns():
        if vehicle.now_us > after_s * 1e6:
            break
    number = before.state.flight.plan_id
    lost = without_checkpoint("torn", system_id=1, time_s=before.now_s, plan_id=number)
    session = Session(mission, seed=1, lockstep=True, resume=(lost, None))
    loop, told = loop_in_process(session, vehicle, planner=plan), False
    for _ in loop.turns():
        if not told and session.state.flight.leg is not None:
            told = True
            session._handle(Order(time_s=session.now_s, kind=OrderKind.RETURN))
    home, here = session.state.vehicle.home_nea_m, session.state.vehicle.position_nea_m
    assert home is not None
    assert here is not None
    assert vehicle.landed
    limits = mission.task.limits
    assert math.dist(here[:2], home[:2]) < max(5.0, 1.5 * limits.loiter_radius_m)
