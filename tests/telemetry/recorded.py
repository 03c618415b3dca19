"""A short flight, recorded as `companion fly` does it: paused once, past zones, to its target."""

from pathlib import Path

from pymavlink.dialects.v20 import all as wire
from scripted_vehicle import Pair, Vehicle

from companion.config import load_mission, mission_text
from companion.mission.state import Phase
from companion.session import Session
from companion.telemetry.run_folder import RunFolder

EPOCH_US = 1_790_000_000_000_000
PAUSE = wire.MAV_CMD_DO_PAUSE_CONTINUE
AROUND = """
[[keep_outs]]
name = "tower <&> \\"mast\\""
north_m = 9000.0
east_m = -1000.0
radius_m = 400.0
[[keep_outs]]
name = "village"
vertices_m = [[8000.0, 6000.0], [8000.0, 8000.0], [9500.0, 7000.0]]
[[keep_ins]]
name = "county"
vertices_m = [[-4000.0, -4000.0], [-4000.0, 60000.0], [60000.0, 60000.0], [60000.0, -4000.0]]
[[rally_points]]
north_m = 500.0
east_m = 1500.0
"""


def mission_file(folder: Path) -> Path:
    """environment-1 with its target at hand, zones around the way there, and a rally point."""
    text = mission_text("environment-1")
    for key in ("north_m", "east_m"):
        assert text.count(f"{key} = 100000.0") == 1
    text = text.replace("north_m = 100000.0", "north_m = 4000.0")
    text = text.replace("east_m = 100000.0", "east_m = 3000.0")
    file = folder / "mission.toml"
    file.write_text(text + AROUND, encoding="utf-8")
    return file


def flown(file: Path) -> Pair:
    """The mission, paused on its way by a person."""
    it = Pair(Session(load_mission(str(file)), seed=1, lockstep=True), Vehicle())
    it.run_until(lambda it: it.session.state.leg is not None)
    for _ in range(50):
        it.tick()
    tell(it, 0.0)
    it.run_until(lambda it: it.session.state.phase is Phase.HOLDING)
    for _ in range(100):
        it.tick()
    tell(it, 1.0)
    return it.run_until(lambda it: it.out.end is not None)


def tell(it: Pair, goes_on: float) -> None:
    """A person at a ground station has it pause, or go on."""
    codec = wire.MAVLink(None, srcSystem=255, srcComponent=190)
    values = (goes_on, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    it.feed(wire.MAVLink_command_long_message(1, 195, PAUSE, 0, *values).pack(codec))


def record(folder: Path, it: Pair, text: str) -> None:
    """Write what a flight has left, as the recorder does."""
    facts = {"mission": "environment-1", "seed": 1, "profile": "flight", "lockstep": True}
    with RunFolder(folder, mission_toml=text, epoch_us=EPOCH_US) as run:
        run.header(facts)
        run.inputs(it.inputs)
        run.frames(it.record)
        run.entries(it.journal)
        run.run_json({"companion": "0"})


def run_folder(folder: Path) -> Path:
    """A run folder of that flight."""
    file = mission_file(folder)
    record(folder / "run", flown(file), file.read_text(encoding="utf-8"))
    return folder / "run"
