"""docs/journal.md, made from the models that the journal is read with: `scripts/docs` writes it."""

import types
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from companion.telemetry import journal_entries, journal_lines, journal_plans

_HEAD = f"""# The journal

Made from `companion/telemetry/journal_*.py` by `scripts/docs`; do not edit.

`journal.jsonl` of a run folder says what happened and what was decided: UTF-8, one JSON object a
line. The first line is a header, and so is one more for each time that the companion was started
again in the flight; all others are entries, in the order in which they happened: `t_s`, `kind`, and
the fields of that kind. What is sent many times a second, setpoints above all, is in `flight.tlog`.
`companion.telemetry.journal.Journal` reads it. This page is about version {journal_lines.VERSION}.

- **Time**: `t_s` is the vehicle's clock, seconds since its boot (until that is known, since the
  companion's start). It begins again when the autopilot reboots. Nothing in a journal depends on
  the wall clock; the log has both times.
- **Units** are part of the names: metres, seconds, radians.
- **Frames**: `_ne_m` is north and east of the mission's origin in its local frame (azimuthal
  equidistant, WGS84), `_nea_m` these and the altitude above mean sea level.
- **null** is what there is not, and what JSON has no number for: infinity.
- A last line without an end (the companion was killed, the disk was full) does not count.

## Versions

A reader of this version reads all older ones. New kinds, and new fields that may be left out, make
no new version: readers pass over what they do not know, and say so. Everything else does.

| version | what is new | in a journal of an older version |
|---|---|---|
| 1 | | |
| 2 | `phase` has `code` | looked up by the words of `reason`, null if these have changed since |
| 3 | `plan asked` has `rest` in place of `stops` | null |
"""

_CHAPTERS: tuple[tuple[str, tuple[type[BaseModel], ...]], ...] = (
    (
        "The mission",
        (
            journal_entries.Phase,
            journal_entries.LegBegun,
            journal_entries.Resumed,
            journal_entries.StopAsked,
            journal_entries.End,
        ),
    ),
    (
        "Scans and subpaths",
        (
            journal_plans.ScanAsked,
            journal_plans.ScanDone,
            journal_plans.PlanAsked,
            journal_plans.PlanReady,
            journal_plans.CertificateGiven,
            journal_plans.PlanRefused,
            journal_plans.PlanLate,
        ),
    ),
    (
        "What others want",
        (
            journal_entries.Fence,
            journal_entries.CircleGiven,
            journal_entries.PolygonGiven,
            journal_entries.Targets,
            journal_entries.Setting,
            journal_entries.CommandHeard,
            journal_entries.OrderGiven,
        ),
    ),
    (
        "The vehicle",
        (
            journal_entries.VehicleFound,
            journal_entries.Prepared,
            journal_entries.VehicleSays,
            journal_entries.Acknowledged,
            journal_entries.VehicleRebooted,
            journal_entries.LinkDelay,
            journal_entries.LinkLost,
            journal_entries.AnotherCompanion,
            journal_entries.MessagesDropped,
        ),
    ),
    (
        "What the companion does",
        (
            journal_entries.ModeAsked,
            journal_entries.ArmAsked,
            journal_entries.TakeOffAsked,
            journal_entries.SetpointRefused,
            journal_entries.Said,
            journal_entries.PartDied,
        ),
    ),
)


def journal_markdown() -> str:
    """The page: every kind of line with its fields, their types and what they mean."""
    lines = [_HEAD, "## Header", "", *_section(journal_lines.Header)]
    for title, models in _CHAPTERS:
        lines += [f"## {title}", ""]
        for model in models:
            lines += [f"### {name_of(model)}", "", *_section(model)]
    return "\n".join(lines).rstrip() + "\n"


def name_of(model: type[BaseModel]) -> str:
    """What the page calls a model: the kind of its entries, or its place in them."""
    if (kind := model.model_fields.get("kind")) is not None:
        return f"`{get_args(kind.annotation)[0]}`"
    return {
        journal_plans.CertificateGiven: "A `certificate`",
        journal_entries.CircleGiven: "A circle of `zones`",
        journal_entries.PolygonGiven: "A polygon of `zones`",
    }[model]


def _section(model: type[BaseModel]) -> Iterator[str]:
    yield " ".join((model.__doc__ or "").split())
    yield ""
    fields = {
        field.alias or name: field
        for name, field in model.model_fields.items()
        if name not in ("t_s", "kind")
    }
    if fields:
        yield from ("| field | type | |", "|---|---|---|")
    for name, field in fields.items():
        words = " ".join((field.description or "").split())
        yield f"| `{name}` | {_type(field)} | {words} |"
    if fields:
        yield ""


def _type(field: FieldInfo) -> str:
    text = _words(field.annotation)
    return text if field.is_required() else f"{text.removesuffix(' or null')}, may be left out"


def _words(kind: Any) -> str:
    """A type as a person says it."""
    origin, inner = get_origin(kind), get_args(kind)
    if kind in _PLAIN:
        return _PLAIN[kind]
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
    journal_lines.NorthEast: "[north, east]",
    journal_lines.NorthEastAltitude: "[north, east, altitude]",
}
