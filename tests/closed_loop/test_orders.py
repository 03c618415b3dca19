"""Orders in flight, with the real planner: a keep-out is flown around; told to land, it lands."""

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from flights import flown_as, journal_of
from pymavlink.dialects.v20 import all as wire
from short_flight import replayed

from companion.config import load_mission, mission_text
from companion.live_view.recording import Recording
from companion.mission.state import Phase
from companion.planner.plan import plan
from companion.runtime.in_process import fly_in_process
from companion.session import Session
from companion.telemetry.run_folder import RunFolder
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world

pytestmark = [pytest.mark.closed_loop, pytest.mark.xdist_group("hills")]
WORLD, MISSION, _, SEED = flown_as("hills")
RADIUS_M = 800.0
Place = tuple[float, float]


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


def command(number: int, first: float, place_deg: Place = (0.0, 0.0)) -> bytes:
    codec = wire.MAVLink(None, srcSystem=255, srcComponent=190)
    values = (first, 0.0, 0.0, 0.0, *place_deg, 0.0)
    message = wire.MAVLink_command_long_message(1, 195, number, 0, *values)
    return bytes(message.pack(codec))


def test_a_keep_out_is_flown_around_and_told_to_land_it_lands_and_is_the_same_again(
    tmp_path: Path,
) -> None:
    mission = load_mission(MISSION)
    session = Session(mission, seed=int(SEED), lockstep=True)
    vehicle: Any = Heard(Simulation(read_world(Path(WORLD))))
    centre: Place = (math.nan, math.nan)
    nearest_m = math.inf
    todo: list[Callable[[], bool]] = []

    def keep_out() -> bool:
        nonlocal centre
        leg = session.state.flight.leg
        if leg is None or session.state.flight.reference.length_m < 1_000.0:
            return False
        north_m, east_m, _ = leg.subpath.pose(0.7 * leg.subpath.length_m).point_nea_m
        centre = north_m, east_m
        place = mission.frame.to_geodetic_deg(*centre)
        number = wire.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION
        vehicle.commands.append(command(number, RADIUS_M, place))
        return True

    def lift() -> bool:
        here = session.state.vehicle.position_nea_m
        if here is None or here[0] < centre[0] + RADIUS_M or here[1] < centre[1] + RADIUS_M:
            return False
        place = mission.frame.to_geodetic_deg(*centre)
        vehicle.commands.append(command(wire.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION, 0.0, place))
        return True

    def land() -> bool:
        vehicle.commands.append(command(wire.MAV_CMD_NAV_LAND, 0.0))
        return True

    todo += [land, lift, keep_out]

    def look() -> None:
        nonlocal nearest_m
        if todo and todo[-1]():
            todo.pop()
        here = session.state.vehicle.position_nea_m
        if here is not None and not math.isnan(centre[0]):
            nearest_m = min(nearest_m, math.dist(here[:2], centre))

    toml, epoch_us = mission_text(MISSION), 1_700_000_000_000_000
    with RunFolder(tmp_path / "run", mission_toml=toml, epoch_us=epoch_us, durable=False) as run:
        run.header(
            {"mission": mission.name, "seed": int(SEED), "profile": "flight", "lockstep": True}
        )
        fly_in_process(session, vehicle, planner=plan, folder=run, on_step=look)
    assert todo == []
    journal = journal_of(tmp_path / "run")
    orders = [entry["order"] for entry in journal if entry.get("kind") == "order"]
    assert orders == ["KEEP_OUT", "KEEP_OUT", "LAND"]
    with Recording(tmp_path / "run") as recording:
        recording.read()
    circles = [
        [z.radius_m for z in recording.decided_at(float(t)).keep_outs] for t in recording.times_s
    ]
    assert [each for each, _ in itertools.groupby(circles)] == [[], [RADIUS_M], []]
    assert nearest_m > RADIUS_M + mission.task.settings.safety_distance_m
    phases = [entry["phase"] for entry in journal if entry.get("kind") == "phase"]
    assert phases[-3:] == [each.value for each in (Phase.HOLDING, Phase.LANDING, Phase.DONE)]
    [end] = [entry for entry in journal if entry.get("kind") == "end"]
    assert (end["outcome"], end["reason"]) == ("stopped", "landed: told to land")
    assert replayed(tmp_path / "run").is_identical
