"""A short flight, recorded as `companion fly` does it: paused once, past zones, to its target."""

from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as wire
from scripted_vehicle import Pair, Vehicle

from companion.config import load_mission, read_mission
from companion.mission.state import Phase
from companion.session import Session
from companion.sources.files import toml_table, toml_text
from companion.telemetry.run_folder import RunFolder

EPOCH_US = 1_790_000_000_000_000
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


def short_mission(**tables: Any) -> str:
    """A mission file: environment-1 with one target, 5 km away."""
    table = toml_table(read_mission("environment-1").text, "environment-1")
    target = {"north_m": 4000.0, "east_m": 3000.0}
    return toml_text({**table, "targets": [target], **tables})


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
    """A run folder of that flight, paused on its way by a person for ten seconds."""
    text = short_mission() + AROUND
    file = folder / "mission.toml"
    file.write_text(text, encoding="utf-8")
    it = Pair(Session(load_mission(str(file)), seed=1, lockstep=True), Vehicle())
    it.fly_out().run_for(5.0).ask(wire.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)
    it.fly_to(Phase.HOLDING).run_for(10.0).ask(wire.MAV_CMD_DO_PAUSE_CONTINUE, 1.0)
    it.run_until(lambda it: it.out.end is not None)
    record(folder / "run", it, text)
    return folder / "run"
