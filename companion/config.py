"""World and mission files: read, checked, and turned into values that need no checks any more.

What they mean is the part of `sources`: `mission_file`, `plan_file`, `world_file`.
"""

import re
from collections.abc import Sequence
from contextlib import suppress
from importlib import resources
from pathlib import Path

from companion.errors import InputError
from companion.mission.mission import Mission
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
    within,
)
from companion.sources.mission_file import MissionFile, MissionTable, complete, mission_of
from companion.sources.tables import validated
from companion.sources.world_file import World, world_of

_ENVIRONMENTS = Path(str(resources.files("companion"))) / "environments"
_OF_MISSIONS = {"targets", "planner", "altitude", "plan", "from_vehicle"}
"""Keys that only missions have."""
_OLDER = re.compile(rb'\{"schema":"companion-journal","version":([12])[,}]')
_HEADER_BYTES = 100


def bundled() -> list[str]:
    """The names of the worlds and missions that come with the package."""
    return sorted(file.parent.name for file in _ENVIRONMENTS.glob("*/mission.toml"))


def mission_text(name_or_path: str) -> str:
    """The mission file as it stands, or, if it names others, with what they hold.

    An elevation file alone is named still, by its absolute path.
    """
    return _text(name_or_path, _whole(name_or_path))


def mission_files(name_or_path: str) -> tuple[str, dict[str, Path]]:
    """A mission's text, and files by the names that it has for them: all that flying it needs."""
    whole = _whole(name_or_path)
    if (file := elevation_file(name_or_path)) is None:
        return _text(name_or_path, whole), {}
    tile = Path(file)
    name = tile.name if tile.suffix.lower() == ".hgt" else "terrain.tif"  # placed by its name
    terrain = whole.table["terrain"] | {"file": name}
    table = whole.table | {"terrain": terrain}
    return _text(name_or_path, whole._replace(table=table)), {name: tile}


def _text(name_or_path: str, whole: MissionFile) -> str:
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
    whole, advice = _whole(name_or_path), ""
    if _is_plan(name_or_path):
        advice = "What a plan lacks is assumed: name it in a mission.toml to say it."
    table = with_settings(whole.table, settings)
    with within(name_or_path, advice):
        return mission_of(validated(MissionTable, table), profile, whole.notes)


def refuse_older(run_dir: Path) -> None:
    """InputError about the run folder of an older companion, before anything of it is touched.

    Whatever else may be wrong with it is found by those who read it.
    """
    with suppress(OSError), (run_dir / "journal.jsonl").open("rb") as file:
        if match := _OLDER.match(file.readline(_HEADER_BYTES)):
            version = match[1].decode()
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
    with within(name_or_path):
        return world_of(table, folder_of(name_or_path))


def folder_of(name_or_path: str) -> Path:
    """Where the other files of a world or a mission are."""
    is_bundled = name_or_path in bundled()
    return _ENVIRONMENTS / name_or_path if is_bundled else Path(name_or_path).parent


def _read(name_or_path: str, kind: str) -> str:
    path = Path(name_or_path)
    if name_or_path in bundled():
        path = folder_of(name_or_path) / f"{kind}.toml"
    remedy = f"Give a {kind}.toml, or one of: {', '.join(bundled())}."
    return read_text(path, kind.upper(), remedy)
