"""The tables of world files, and what is said of a table that breaks a rule.

Those of missions are in `mission_schema`.  Keys carry their SI unit, altitudes their datum;
unknown keys are refused with the nearest known one named.  A broken rule is one line: field,
value, rule, remedy.
"""

import difflib
import types
import typing
from dataclasses import MISSING, fields
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model
from pydantic_core import ErrorDetails

from companion.errors import InputError
from companion.ranges import Longitude, Positive
from companion.sources.elevation import VerticalDatum

Horizontal = Annotated[float, Field(ge=-1e6, le=1e6)]
Altitude = Annotated[float, Field(ge=-500.0, le=50_000.0)]
Nodata = Literal["sea"] | Altitude


class Table(BaseModel):
    """A table of a file: its keys and no others, each of its own type."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    def of(self, kind: type) -> dict[str, Any]:
        """The fields of a dataclass that the table has too, with its values."""
        names = {each.name for each in fields(kind)} & type(self).model_fields.keys()
        return {name: getattr(self, name) for name in names}


def keys_of(kind: type, *names: str, **keys_by_name: str) -> Any:
    """A table with these fields of a dataclass: type, range and default are said there.

    keys_by_name: fields whose key in the file is another: field="key".
    """
    types_of = typing.get_type_hints(kind, include_extras=True)
    defaults = {each.name: each.default for each in fields(kind)}
    keys: Any = {
        name: (
            types_of[name],
            Field(... if defaults[name] is MISSING else defaults[name], alias=key),
        )
        for name, key in [*((name, None) for name in names), *keys_by_name.items()]
    }
    return create_model(f"Keys of {kind.__name__}", __base__=Table, **keys)


class OriginTable(Table):
    """Where the local frame has its origin."""

    latitude_deg: Annotated[float, Field(ge=-85.0, le=85.0)]
    longitude_deg: Longitude


class AreaTable(Table):
    """The map: no path leaves it."""

    north_min_m: Horizontal
    north_max_m: Horizontal
    east_min_m: Horizontal
    east_max_m: Horizontal


class RadarTable(Table):
    """A radar of a world."""

    name: str
    north_m: Horizontal
    east_m: Horizontal
    altitude_amsl_m: Altitude
    range_m: Positive


class PeakTable(Table):
    """A mountain of eq. 1."""

    north_m: Horizontal
    east_m: Horizontal
    height_amsl_m: Altitude
    spread_north_m: Positive
    spread_east_m: Positive


class TerrainTable(Table):
    """The true terrain of a world."""

    combine: Literal["maximum", "sum"]
    ground_amsl_m: Altitude
    peaks: list[PeakTable] = []


class FileTerrainTable(Table):
    """The true terrain of a world, from an elevation file."""

    file: Annotated[str, Field(min_length=1)]
    """Relative to the world file's folder."""
    vertical_datum: VerticalDatum
    nodata: Nodata | None = None
    """What lies where the file has no height: the sea, or ground AMSL.  Left out: an error."""


class WorldVehicleTable(BaseModel):
    """Of the simulator's vehicle, only where it stands concerns the companion."""

    model_config = ConfigDict(extra="ignore", frozen=True)
    north_m: Horizontal = 0.0
    east_m: Horizontal = 0.0


class WorldTable(Table):
    """A world.toml."""

    schema_: Annotated[Literal[1], Field(alias="schema")]
    name: str
    origin: OriginTable
    terrain: TerrainTable
    radars: list[RadarTable] = []
    vehicle: WorldVehicleTable
    scanner: dict[str, Any] = {}
    trees: list[dict[str, Any]] = []
    woods: list[dict[str, Any]] = []
    buildings: list[dict[str, Any]] = []
    walls: list[dict[str, Any]] = []
    wires: list[dict[str, Any]] = []
    lidar: dict[str, Any] = {}
    second_lidar: dict[str, Any] = {}


class FileWorldTable(WorldTable):
    """A world.toml whose terrain is an elevation file: it says how much of it is needed."""

    terrain: FileTerrainTable  # type: ignore[assignment]
    area: AreaTable


NAME, SENDER = r"^[A-Za-z0-9][A-Za-z0-9 _.-]{0,63}$", r"^\d{1,3}/\d{1,3}$"
_IN_WORDS = {
    NAME: "it must be up to 64 of A-Z, a-z, 0-9, space and _.-, beginning with a letter or digit",
    SENDER: "it must be SYSTEM/COMPONENT",
}
Model = TypeVar("Model", bound=BaseModel)


REMOVED = {
    "traffic": "Leave it out: keep vehicles apart by fences or altitudes of their own.",
}
"""Keys and values ("table.key = value") of files for versions before, and what to do instead."""


def removed_key(table: Any, path: tuple[str, ...] = ()) -> str:
    """The first key or value of a file that was removed; "": there is none."""
    here = ".".join(path)
    if here in REMOVED or f"{here} = {table}" in REMOVED:
        return here
    inner = [(path, each) for each in table] if isinstance(table, list) else []
    if isinstance(table, dict):
        inner = [((*path, key), each) for key, each in table.items()]
    return next(filter(None, (removed_key(each, at) for at, each in inner)), "")


def validated(model: type[Model], table: dict[str, Any], where: str) -> Model:
    """The checked table, or the first broken rule as an InputError."""
    try:
        return model.model_validate(table)
    except ValidationError as error:
        details = error.errors()
    unknown = [detail for detail in details if detail["type"] == "extra_forbidden"]
    first = (unknown or details)[0]
    field = f"{where}: {_dotted(first['loc'])}"
    path = ".".join(step for step in first["loc"] if isinstance(step, str))
    if remedy := REMOVED.get(path) or REMOVED.get(f"{path} = {first['input']}"):
        raise InputError(field, _shown(first["input"]), "it was removed in this version", remedy)
    if first["type"] == "extra_forbidden":
        raise _unknown_key(model, first, field)
    if first["type"] == "missing":
        key = first["loc"][-1]
        raise InputError(field, None, "it is missing", f"Add {key}; see docs/files.md.")
    message = first["msg"].replace("Input should be", "it must be")
    message = _IN_WORDS.get(first.get("ctx", {}).get("pattern", ""), message)
    if first["type"] == "union_tag_invalid":
        message = f"its type must be one of {first['ctx']['expected_tags']}"
    remedy = f"Give a valid value{_unit_of(field)}."
    raise InputError(field, _shown(first["input"]), message, remedy)


def _unknown_key(model: type[BaseModel], detail: ErrorDetails, field: str) -> InputError:
    key = str(detail["loc"][-1])
    known = _known_keys(model, detail["loc"][:-1])
    nearest = difflib.get_close_matches(key, known, n=1, cutoff=0.0)
    about_altitude = any(word in key for word in ("altitude", "floor", "ceiling", "height"))
    if about_altitude and nearest and nearest[0].endswith("_amsl_m"):
        rule = "an altitude must name its datum and unit, and only AMSL metres are known here"
    else:
        rule = "no such key (units are part of keys)"
    listed = f"Did you mean {nearest[0]}?" if nearest else "Remove it."
    return InputError(field, detail["input"], rule, f"{listed} Known here: {', '.join(known)}.")


def _known_keys(model: type[BaseModel], path: tuple[int | str, ...]) -> list[str]:
    here: Any = model
    for step in path:
        if isinstance(step, str):
            fields = {info.alias or name: info for name, info in here.model_fields.items()}
            here = _table_in(fields[step].annotation)
    return sorted(info.alias or name for name, info in here.model_fields.items())


def _table_in(annotation: Any) -> Any:
    if isinstance(annotation, type) and not isinstance(annotation, types.GenericAlias):
        return annotation
    return next(found for part in typing.get_args(annotation) if (found := _table_in(part)))


def _shown(value: Any) -> Any:
    """What to show of a value: containers may be long."""
    long = isinstance(value, dict | list) and len(value) > 4
    return f"{len(value)} items" if long else value


def _dotted(location: tuple[int | str, ...]) -> str:
    parts = [f"[{step}]" if isinstance(step, int) else f".{step}" for step in location]
    return "".join(parts).lstrip(".")


def _unit_of(key: str) -> str:
    units = {
        "_m_s2": " in metres per second squared",
        "_m_s": " in metres per second",
        "_amsl_m": " in metres above mean sea level",
        "_m": " in metres",
        "_s": " in seconds",
        "_deg": " in degrees",
        "_hz": " in hertz",
    }
    return next((unit for ending, unit in units.items() if key.endswith(ending)), "")
