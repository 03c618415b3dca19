"""Reference pages made from declarations by `scripts/docs`: journal.md and fly-json.md."""

import ast
import enum
import inspect
import textwrap
import types
from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Any, Final, Literal, get_args, get_origin, get_type_hints

from msgspec import Struct, structs

from companion.mission import journal
from companion.mission.journal import KINDS, VERSION
from companion.path.certificate import Certificate
from companion.telemetry.flight_status import VERSION as FLY_JSON
from companion.telemetry.flight_status import FlightBegun, FlightEnded, FlightStatus
from companion.world.zones import CircleZone, PolygonZone

_HEAD = f"""# The journal

Made from `companion/mission/journal.py` by `scripts/docs`; do not edit.

`journal.jsonl` of a run folder says what happened and what was decided: UTF-8, one JSON object a
line. The first line is a header, and so is one more for each time that the companion was started
again in the flight; all others are entries, in the order in which they happened: `t_s`, `kind`, and
the fields of that kind. What is sent many times a second, setpoints above all, is in `flight.tlog`.
`companion.telemetry.journal.Journal` reads it. This page is about version {VERSION}.

- **Time**: `t_s` is the vehicle's clock, seconds since its boot (until that is known, since the
  companion's start). It begins again when the autopilot reboots. Nothing in a journal depends on
  the wall clock; the log has both times.
- **Units** are part of the names: metres, seconds, radians.
- **Frames**: `_ne_m` is north and east of the mission's origin in its local frame (azimuthal
  equidistant, WGS84), `_nea_m` these and the altitude above mean sea level.
- **null** is what there is not, and what JSON has no number for: infinity.
- A last line without an end (the companion was killed, the disk was full) does not count.

## Versions

New kinds, and new fields that may be left out, make no new version: readers pass over what they do
not know, and say so. Everything else does, and a companion reads one version only. 1 and 2 were
written by companions before 0.2.0, which reads them.
"""

_FLY_JSON = f"""# The lines of `companion fly --json`

Made from `companion/telemetry/flight_status.py` by `scripts/docs`; do not edit.

One JSON object a line on standard output, and nothing else; what is for people goes to standard
error. `begun` comes first, `ended` last, whatever ends the program but a kill (of a command line
that is not understood there is no line). `status` comes four times a second, and up to ten times
when there is news. A slow reader misses some of these, one that leaves all: the flight goes on, and
its journal has everything. This page is about version {FLY_JSON}. More fields and more kinds of
lines may come without a new one.

Units are part of the names. `_nea_m` is north and east of the mission's origin in its local frame,
and altitude above mean sea level; null is what is not known.
"""

_CHAPTERS: Final[dict[type, str]] = {
    journal.Phase: "The mission",
    journal.ScanAsked: "Scans and subpaths",
    journal.Fence: "What others want",
    journal.VehicleFound: "The vehicle",
    journal.ModeAsked: "What the companion does",
}
"""By the first of their kinds."""
_PARTS: Final[dict[type, dict[str, type]]] = {
    journal.PlanReady: {"A `certificate`": Certificate},
    journal.Fence: {"A circle of `zones`": CircleZone, "A polygon of `zones`": PolygonZone},
}
"""Objects in entries that are explained after them."""


def journal_markdown() -> str:
    """The page: every kind of line with its fields, their types and what they mean."""
    lines = [_HEAD, "## Header", "", *_section(journal.Header)]
    for name, kind in KINDS.items():
        if kind in _CHAPTERS:
            lines += [f"## {_CHAPTERS[kind]}", ""]
        lines += [f"### `{name}`", "", *_section(kind)]
        for title, part in _PARTS.get(kind, {}).items():
            lines += [f"### {title}", "", *_section(part)]
    return "\n".join(lines).rstrip() + "\n"


def fly_json_markdown() -> str:
    """The page: every kind of line of `fly --json` with its fields."""
    lines = [_FLY_JSON]
    for kind in (FlightBegun, FlightStatus, FlightEnded):
        lines += [f"## `{kind.__struct_config__.tag}`", "", *_section(kind, left_out="")]
    return "\n".join(lines).rstrip() + "\n"


def _section(kind: type, left_out: str = "t_s") -> Iterator[str]:
    yield " ".join((kind.__doc__ or "").split())
    yield ""
    hints, words = get_type_hints(kind, include_extras=True), words_of(kind)
    fields = [name for name in hints if name != left_out]
    declared = structs.fields(kind) if issubclass(kind, Struct) else ()
    optional = {field.name for field in declared if not field.required}
    if fields:
        yield from ("| field | type | |", "|---|---|---|")
    for name in fields:
        text = _words(hints[name])
        if kind is Certificate and text == _PLAIN[float]:
            text += " or null"
        if name in optional:
            text = f"{text.removesuffix(' or null')}, may be left out"
        yield f"| `{name}` | {text} | {words.get(name, '')} |"
    if fields:
        yield ""


def words_of(kind: type) -> dict[str, str]:
    """What stands below each field of a class."""
    [declared] = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(declared, ast.ClassDef)
    return {
        field.target.id: " ".join(text.value.value.split())
        for field, text in pairwise(declared.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }


def _words(kind: Any) -> str:
    """A type as a person says it."""
    origin, inner = get_origin(kind), get_args(kind)
    if kind in _PLAIN:
        return _PLAIN[kind]
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        return ", ".join(f"`{each.value}`" for each in kind)
    if origin is Annotated:
        return _words(inner[0])
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in inner)
    if origin is types.UnionType:
        return " or ".join(dict.fromkeys(_words(each) for each in inner))
    if origin is tuple and inner[-1] is Ellipsis:
        return f"list of {_words(inner[0])}".replace(_OBJECT, "objects: see below", 1)
    if origin is dict:
        return f"object of names: {_words(inner[1])}"
    return _OBJECT


_OBJECT = "object: see below"
_PLAIN: dict[Any, str] = {
    float: "number",
    int: "whole number",
    str: "text",
    bool: "true or false",
    type(None): "null",
    journal.NorthEast: "[north, east]",
    journal.NorthEastAltitude: "[north, east, altitude]",
}
