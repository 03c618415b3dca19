"""World and mission files: read, checked, and turned into values that need no checks any more.

What a mission file means is `mission_file`'s part; the tables are in `schema` and `mission_schema`.
"""

import re
from collections.abc import Sequence
from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import NamedTuple

from companion.errors import InputError
from companion.geodesy import LocalFrame
from companion.mission.mission import Mission
from companion.planner import rules
from companion.sources.files import (
    PLAN,
    WAYPOINTS,
    RawTable,
    answer,
    begins_as,
    plain,
    read_text,
    toml_table,
    toml_text,
    with_settings,
)
from companion.sources.mission_file import MissionFile, complete, mission_of
from companion.sources.mission_schema import MissionTable
from companion.sources.schema import FileWorldTable, WorldTable, validated
from companion.world.terrain import Peak, PeakTerrain, Terrain

_OF_MISSIONS = {"targets", "planner", "altitude", "plan", "from_vehicle"}
"""Keys that only missions have."""
_OLDER = re.compile(rb'\{"schema":"companion-journal","version":([12])[,}]')
_HEADER_BYTES = 100


class World(NamedTuple):
    """A world as `companion plan` needs it."""

    name: str
    terrain: Terrain
    start_ne_m: tuple[float, float]
    origin_deg: tuple[float, float]
    """Latitude and longitude."""


def bundled() -> list[str]:
    """The names of the worlds and missions that come with the package."""
    folder = resources.files("companion") / "environments"
    return sorted(entry.name for entry in folder.iterdir() if (entry / "mission.toml").is_file())


def mission_text(name_or_path: str) -> str:
    """The mission file as it stands, or, if it names others, with what they hold.

    So a run folder needs no other file to be flown again but the elevation file, if there is one.
    """
    whole = _whole(name_or_path)
    if whole.is_whole:
        return _read(name_or_path, "mission")
    head = [f"# As read from {plain(Path(name_or_path).name, 'a file')}."]
    head += [f"# {plain(note, '', 300)}" for note in whole.notes]
    return "\n".join(head) + "\n" + toml_text(whole.table)


def mission_name(name_or_path: str) -> str | None:
    """The name that a mission gives itself, if it does; InputError if it cannot be read."""
    name = _whole(name_or_path).table.get("name")
    return name if isinstance(name, str) else None


def elevation_file(name_or_path: str) -> str | None:
    """The file that a mission knows its terrain from, if there is one; InputError as above."""
    terrain = _whole(name_or_path).table.get("terrain")
    file = terrain.get("file") if isinstance(terrain, dict) else None
    return file if isinstance(file, str) else None


def load_mission(
    name_or_path: str, profile: str | None = None, settings: Sequence[str] = ()
) -> Mission:
    """A bundled mission, a mission.toml, or a .plan or waypoint list by itself.

    profile overrides the file's; settings ("planner.safety_distance_m=300") its other keys.
    """
    whole = _whole(name_or_path)
    table = with_settings(whole.table, settings)
    try:
        model = validated(MissionTable, table, name_or_path)
        return mission_of(model, profile, name_or_path, whole.notes)
    except InputError as error:
        if not _is_plan(name_or_path):
            raise
        remedy = (
            f"{error.remedy} What a plan lacks is assumed: name it in a mission.toml to say it."
        )
        raise InputError(error.field, error.value, error.rule, remedy) from None


def refuse_older(run_dir: Path) -> None:
    """InputError about the run folder of an older companion, before anything of it is touched.

    Whatever else may be wrong with it is found by those who read it.
    """
    with suppress(OSError), (run_dir / "journal.jsonl").open("rb") as file:
        if found := _OLDER.match(file.readline(_HEADER_BYTES)):
            version = found[1].decode()
            rule = f"an older companion has recorded it: its journal is of version {version}"
            raise InputError("RUN_DIR", str(run_dir), rule, "Use companion 0.2.0 for it.")


def _whole(name_or_path: str) -> MissionFile:
    """A mission with what the files that it names hold; a plan by itself names no other."""
    if _is_plan(name_or_path):
        table: RawTable = {"plan": Path(name_or_path).name}
    else:
        table = toml_table(_read(name_or_path, "mission"), name_or_path)
    if "terrain" in table and not _OF_MISSIONS & table.keys():
        rule = "this is a world, not a mission"
        raise InputError("MISSION", name_or_path, rule, "Give its mission.toml.")
    return complete(table, folder_of(name_or_path), name_or_path)


def _is_plan(name_or_path: str) -> bool:
    """Whether it is a plan or a waypoint list by itself."""
    path = Path(name_or_path)
    is_named_so = path.suffix.lower() == ".plan" and answer(path.is_file)
    return name_or_path not in bundled() and (is_named_so or begins_as(path, PLAN, WAYPOINTS))


def world_table(name_or_path: str) -> RawTable:
    """A bundled world or a file, as it stands there."""
    return toml_table(_read(name_or_path, "world"), name_or_path)


def load_world(name_or_path: str) -> World:
    """A bundled world or a file."""
    table = world_table(name_or_path)
    if _OF_MISSIONS & table.keys():
        rule = "this is a mission, not a world"
        raise InputError("WORLD", name_or_path, rule, "Give its world.toml.")
    of_file = isinstance(table.get("terrain"), dict) and "file" in table["terrain"]
    model = validated(FileWorldTable if of_file else WorldTable, table, name_or_path)
    return World(
        name=model.name,
        terrain=_terrain(model, name_or_path),
        start_ne_m=(model.vehicle.north_m, model.vehicle.east_m),
        origin_deg=(model.origin.latitude_deg, model.origin.longitude_deg),
    )


def _terrain(model: WorldTable | FileWorldTable, name_or_path: str) -> Terrain:
    if not isinstance(model, FileWorldTable):
        return PeakTerrain(
            peaks=tuple(Peak(**dict(peak)) for peak in model.terrain.peaks),
            ground_amsl_m=model.terrain.ground_amsl_m,
            sum_of_peaks=model.terrain.combine == "sum",
        )
    origin, area = model.origin, model.area
    rules.refuse(rules.of_area(*area.sides_m), f"{name_or_path}: ")
    file = model.terrain.elevation(folder_of(name_or_path), name_or_path)
    return file.terrain(LocalFrame(**dict(origin)), area.sides_m)


# --- files


def folder_of(name_or_path: str) -> Path:
    """Where the other files of a world or a mission are."""
    if name_or_path in bundled():
        return Path(str(resources.files("companion"))) / "environments" / name_or_path
    return Path(name_or_path).parent


def _read(name_or_path: str, kind: str) -> str:
    if name_or_path in bundled():
        file = resources.files("companion") / "environments" / name_or_path / f"{kind}.toml"
        return file.read_text(encoding="utf-8")
    remedy = f"Give a {kind}.toml, or one of: {', '.join(bundled())}."
    return read_text(Path(name_or_path), kind.upper(), remedy)
