"""World and mission files: read, checked, and turned into values that need no checks any more.

What they mean is the part of `sources`: `mission_file`, `plan_file`, `world_file`.
"""

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import final

from companion.errors import InputError
from companion.mission.mission import Mission
from companion.sources.files import (
    PLAN,
    WAYPOINTS,
    RawTable,
    answer,
    begins_as,
    located,
    plain,
    read_text,
    toml_table,
    toml_text,
    with_settings,
    within,
)
from companion.sources.mission_file import MissionTable, complete, mission_of
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


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class MissionFile:
    """A mission as it was read, once, with what the files that it names hold.

    An elevation file alone is named still, by its absolute path.
    """

    where: str
    """Its bundled name, or its path."""
    table: RawTable
    """Nothing in it has been checked."""
    notes: tuple[str, ...] = ()
    """What was assumed and what was left out, for people."""
    written: str | None = None
    """As it stands there, if that is all: it names no other file."""
    advice: str = ""
    """What else to do about a rule that it breaks."""

    @property
    def name(self) -> str | None:
        """The name that it gives itself, if it does."""
        name = self.table.get("name")
        return name if isinstance(name, str) else None

    @property
    def elevation_file(self) -> Path | None:
        """The file that it knows its terrain from, if there is one."""
        terrain = self.table.get("terrain")
        file = terrain.get("file") if isinstance(terrain, dict) else None
        return Path(file) if isinstance(file, str) else None

    @property
    def text(self) -> str:
        """As TOML."""
        if self.written is not None:
            return self.written
        head = [f"# As read from {plain(Path(self.where).name, 'a file')}."]
        head += [f"# {plain(note, '', 300)}" for note in self.notes]
        return "\n".join(head) + "\n" + toml_text(self.table)

    def files(self) -> tuple[str, dict[str, Path]]:
        """Its text, and files by the names that it has for them: all that flying it needs."""
        if (file := self.elevation_file) is None:
            return self.text, {}
        name = file.name if file.suffix.lower() == ".hgt" else "terrain.tif"  # placed by its name
        table = self.table | {"terrain": self.table["terrain"] | {"file": name}}
        return replace(self, table=table).text, {name: file}

    def mission(self, profile: str | None = None, settings: Sequence[str] = ()) -> Mission:
        """What it means.  Raises InputError about the first rule that is broken.

        profile overrides its own; settings ("planner.safety_distance_m=300") its other keys.
        """
        with within(self.where, self.advice):
            checked = validated(MissionTable, with_settings(self.table, settings))
            return mission_of(checked, profile, self.notes)


def read_mission(name_or_path: str) -> MissionFile:
    """A bundled mission, a mission.toml, or a .plan or waypoint list by itself.

    Raises InputError if it, or a file that it names, cannot be read.
    """
    if is_plan := _is_plan(name_or_path):  # which names no other file
        text, given = "", RawTable(plan=Path(name_or_path).name)
    else:
        text = _read(name_or_path, "mission")
        given = toml_table(text, name_or_path)
    if "terrain" in given and not _OF_MISSIONS & given.keys():
        rule = "this is a world, not a mission"
        raise InputError("MISSION", name_or_path, rule, "Give its mission.toml.")
    table, notes = complete(given, folder_of(name_or_path), name_or_path)
    return MissionFile(
        where=name_or_path,
        table=table,
        notes=notes,
        written=text if table is given else None,
        advice="What a plan lacks is assumed: name it in a mission.toml to say it." * is_plan,
    )


def load_mission(
    name_or_path: str, profile: str | None = None, settings: Sequence[str] = ()
) -> Mission:
    """The mission in a file; what the arguments mean: `MissionFile.mission`."""
    return read_mission(name_or_path).mission(profile, settings)


def refuse_older(run_dir: Path) -> None:
    """InputError about the run folder of an older companion, before anything of it is touched.

    Whatever else may be wrong with it is found by those who read it.
    """
    with suppress(OSError), (run_dir / "journal.jsonl").open("rb") as file:
        if match := _OLDER.match(file.readline(_HEADER_BYTES)):
            version = match[1].decode()
            rule = f"an older companion has recorded it: its journal is of version {version}"
            raise InputError("RUN_DIR", str(run_dir), rule, "Use companion 0.2.0 for it.")


def _is_plan(name_or_path: str) -> bool:
    """Whether it is a plan or a waypoint list by itself."""
    path = Path(name_or_path)
    is_named_so = path.suffix.lower() == ".plan" and answer(path.is_file)
    return name_or_path not in bundled() and (is_named_so or begins_as(path, PLAN, WAYPOINTS))


def world_table(name_or_path: str) -> RawTable:
    """A bundled world or a file, as it stands there, but that its elevation file is `located`."""
    return located(toml_table(_read(name_or_path, "world"), name_or_path), folder_of(name_or_path))


def load_world(name_or_path: str) -> World:
    """A bundled world or a file."""
    table = world_table(name_or_path)
    if _OF_MISSIONS & table.keys():
        rule = "this is a mission, not a world"
        raise InputError("WORLD", name_or_path, rule, "Give its world.toml.")
    with within(name_or_path):
        return world_of(table)


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
