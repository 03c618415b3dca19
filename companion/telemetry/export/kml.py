"""KML 2.2 with Google's gx:Track: the flight in Google Earth, with its time slider.

Altitudes are absolute, that is above mean sea level; the document is `flight.kml.j2`.
"""

from pathlib import Path
from typing import Final

from jinja2 import Environment, PackageLoader, StrictUndefined

from companion.geodesy import FloatArray
from companion.mission.state import Phase
from companion.telemetry.export import shapes
from companion.telemetry.export.features import Feature, features_of
from companion.telemetry.flight import Flight

_PHASES: Final = {
    Phase.TAKING_OFF.value: "ffb4771f",
    Phase.FLYING.value: "ff2ca02c",
    Phase.HOLDING.value: "ff2827d6",
    Phase.ARRIVED.value: "ffcfbe17",
    Phase.RETURNING.value: "ff0e7fff",
    Phase.LANDING.value: "ffbd6794",
    Phase.SHADOW.value: "ff4b568c",
    Phase.FAULTED.value: "ffc277e3",
}
"""Colours as KML has them: opacity, blue, green, red; phases on the ground are grey."""
_STYLES: Final = {
    **{f"phase-{name.replace(' ', '-')}": (colour, 3, None) for name, colour in _PHASES.items()},
    "phase-other": ("ff7f7f7f", 3, None),
    "subpath": ("a000ffff", 2, None),
    "keep_out": ("ff0000ff", 1, "300000ff"),
    "radar": ("ff0000ff", 1, "300000ff"),
    "keep_in": ("ff00ff00", 1, "0000ff00"),
}
"""Of phases and kinds of features: colour and width of lines, and what fills areas."""
_FOLDERS: Final = {
    "flown track": ("track",),
    "planned subpaths": ("subpath",),
    "targets": ("target", "rally"),
    "threats as known": ("keep_out", "keep_in", "radar"),
    "holds and events": ("event",),
}
"""And the kinds of features in each."""


def write_kml(flight: Flight, file: Path) -> None:
    """Write a flight.  Raises OSError if that cannot be done."""
    documents = Environment(
        loader=PackageLoader("companion.telemetry", "export"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    documents.filters |= {"printable": _printable, "utc": shapes.utc_text, "rows": _rows}
    parts = documents.get_template("flight.kml.j2").generate(
        name=flight.mission.name,
        styles=_STYLES,
        folders=_FOLDERS,
        features=list(features_of(flight)),
        name_of=_name,
        style_of=_style,
        tuple=tuple,
    )
    with file.open("w", encoding="utf-8") as out:
        out.writelines(parts)


def _name(each: Feature) -> str:
    facts = each.facts
    match each.kind:
        case "subpath":
            return f"{each.name}, leg {facts['leg']}" if facts["leg"] else f"{each.name}, not flown"
        case "rally":
            return each.name.replace("rally", "rally point")
        case "event":
            return f"{facts['what']}: {facts['why']}"
        case _:
            return each.name


def _style(each: Feature) -> str:
    """Its name among `_STYLES`; empty: Google Earth's own."""
    if each.kind == "track":
        return f"phase-{each.name.replace(' ', '-') if each.name in _PHASES else 'other'}"
    return each.kind if each.kind in _STYLES else ""


def _printable(text: object) -> str:
    return "".join(c if c.isprintable() or c in "\n\t" else " " for c in str(text))


def _rows(points: FloatArray) -> str:
    """(N, 3), or (N, 2) of places on the ground, however high that is."""
    rows = ((*point, 0.0)[:3] for point in points.tolist())
    return " ".join(f"{east:.7f},{north:.7f},{up:.3f}" for east, north, up in rows)
