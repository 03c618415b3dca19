"""Orders in flight, with the real planner: told to land, it lands."""

from pathlib import Path
from typing import Any

import pytest
from flights import flown_as, journal_of
from pymavlink.dialects.v20 import all as wire
from short_flight import replayed

from companion.config import load_mission, mission_text
from companion.mission.state import Phase
from companion.planner.plan import plan
from companion.runtime.in_process import fly_in_process
from companion.session import Session
from companion.telemetry.run_folder import RunFolder
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world

pytestmark = [pytest.mark.closed_loop, pytest.mark.xdist_group("hills")]
WORLD, MISSION, _, SEED = flown_as("hills")


class Heard:
    """A vehicle whose link a ground station is on, too."""

    def __init__(self, vehicle: Simulation) -> None:
        self._vehicle = vehicle
        self.commands: list[bytes] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._vehicle, name)

    def take_frames(self) -> list[tuple[int, bytes]]:
        """What the ground station says comes first: the lockstep's question ends a tick."""
        said = [(0, self.commands.pop(0))] if self.commands else []
        return [*said, *self._vehicle.take_frames()]


def command(number: int) -> bytes:
    codec = wire.MAVLink(None, srcSystem=255, srcComponent=190)
    message = wire.MAVLink_command_long_message(1, 195, number, 0, *[0.0] * 7)
    return bytes(message.pack(codec))


def test_told_to_land_it_lands_and_is_the_same_again(tmp_path: Path) -> None:
    mission = load_mission(MISSION)
    session = Session(mission, seed=int(SEED), lockstep=True)
    vehicle: Any = Heard(Simulation(read_world(Path(WORLD))))
    told = False

    def look() -> None:
        nonlocal told
        flies = session.state.leg is not None
        if flies and not told and session.state.reference.length_m > 1_000.0:
            told = True
            vehicle.commands.append(command(wire.MAV_CMD_NAV_LAND))

    toml, epoch_us = mission_text(MISSION), 1_700_000_000_000_000
    with RunFolder(tmp_path / "run", mission_toml=toml, epoch_us=epoch_us, durable=False) as run:
        run.header(
            {"mission": mission.name, "seed": int(SEED), "profile": "flight", "lockstep": True}
        )
        fly_in_process(session, vehicle, planner=plan, folder=run, on_step=look)
    journal = journal_of(tmp_path / "run")
    orders = [entry["order"] for entry in journal if entry.get("kind") == "order"]
    assert orders == ["LAND"]
    phases = [entry["phase"] for entry in journal if entry.get("kind") == "phase"]
    assert phases[-3:] == [each.value for each in (Phase.HOLDING, Phase.LANDING, Phase.DONE)]
    [end] = [entry for entry in journal if entry.get("kind") == "end"]
    assert (end["outcome"], end["reason"]) == ("stopped", "landed: told to land")
    assert replayed(tmp_path / "run").is_identical
