"""Short flights with the scripted vehicle, recorded as real ones are."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from recorded import EPOCH_US, short_mission
from scripted_vehicle import ScriptedLink, Vehicle, straight_plan

from companion.config import load_mission
from companion.mission.mission import Mission
from companion.mission.start import Start
from companion.replay.compare import Replayed, replay_of_folder
from companion.runtime import loop
from companion.runtime.planner_process import PlannerHere
from companion.session import Session
from companion.telemetry.flight_summary import FlightSummary
from companion.telemetry.inputs import FILE, HEADER, Input, InputsFile, packed
from companion.telemetry.resume import load_resume_data
from companion.telemetry.run_folder import RunFolder


def fly_short(
    path: Path,
    *,
    text: str = "",
    link: ScriptedLink | None = None,
    lockstep: bool = True,
    until_s: float = 60.0,
    again: bool = False,
    complains_s: float = math.inf,
) -> FlightSummary:
    """Record a flight of the mission of a text until its vehicle was watched for so long.

    again: another companion goes on with it.  complains_s: when its disk has stood still.
    """
    link = link or ScriptedLink(Vehicle(lockstep=lockstep))
    vehicle, text, complaints = link.vehicle, text or short_mission(), [complains_s]

    def stops() -> bool:
        if vehicle.time_ms >= 1e3 * complaints[-1]:
            complaints.append(math.inf)
            session.complain("not recorded any more: it has stood still for 2.1 s")
        return vehicle.time_ms >= 1e3 * until_s

    with RunFolder(path, mission_toml=text, epoch_us=EPOCH_US, resume=again) as folder:
        folder.header({"mission": "", "seed": 1, "profile": "flight", "lockstep": lockstep})
        mission = load_mission(str(path / "mission.toml"))
        resume = load_resume_data(path, mission).resume if again else None
        session = Session(mission, seed=1, lockstep=lockstep, go=True, resume=resume)
        return loop.fly(
            session,
            link,
            folder,
            on_progress=lambda _: None,
            stop_asked=stops,
            planner=PlannerHere(straight_plan),
            clock=link.clock,
        )


def replayed(path: Path, **options: Any) -> Replayed:
    """What the replay of a run folder finds."""
    replay = replay_of_folder(path, mission_of(path), **options)
    for _ in replay.steps():
        pass
    return replay.replayed


def mission_of(path: Path) -> Callable[[Start], Mission]:
    """The mission of a run folder, as it was flown."""
    return lambda start: load_mission(str(path / "mission.toml"), start.profile)


def rewritten(path: Path, change: Callable[[list[Input]], None]) -> None:
    """Change what the session of a recorded flight was told."""
    told = list(InputsFile(path / FILE))
    change(told)
    (path / FILE).write_bytes(b"".join(packed((HEADER, *told))))
