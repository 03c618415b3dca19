"""A recorded flight for other people's programs: Google Earth (KML), QGIS (GeoJSON), tables (CSV).

KML and GeoJSON show the same features: places, lines and areas with attributes.  Altitudes are
AMSL, as everywhere in a run folder.  KML's absolute ones are; the standard of GeoJSON (RFC 7946)
means heights above the ellipsoid, so its file says what it has (`altitude_datum`).
"""

import csv
import json
import math
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from companion.geodesy import FloatArray
from companion.mission.state import Phase
from companion.telemetry.export import shapes
from companion.telemetry.flight import Flight, IntArray
from companion.world.zones import CircleZone

Facts = dict[str, str | int | float | bool | None]
"""For people who click on it: names with units, plain values; None: not known, or none."""
_NO_FACTS: Final[Facts] = {}
_OF_PLAN: Final = ("length_m", "cost", "evaluations", "reaches_target")
_OF_PROOF: Final = (
    *("clearance_m", "keep_out_m", "dead_man_m", "turn_radius_m", "climb_angle_rad"),
    *("dive_angle_rad", "lowest_amsl_m", "highest_amsl_m", "radar_m"),
)
_OF_MOMENT: Final = ("what", "why", "code", "t_s", "until_s")


class Feature(NamedTuple):
    """One thing to show."""

    kind: str
    """track, subpath, target, rally, keep_out, keep_in, radar or event (docs/export.md)."""
    name: str
    points: FloatArray
    """(N, 3) longitude, latitude, altitude AMSL; (1, 2) of a place on the ground.  Of an area its
    edge, anticlockwise, the first point not repeated; a zone's is at the mission's ceiling."""
    facts: Facts
    times_us: IntArray | None = None
    """When the vehicle was at each point, microseconds since 1970; of tracks and events."""


def features_of(flight: Flight) -> Iterator[Feature]:
    """The features of a flight, kind by kind."""
    whole, frame, task = flight.track, flight.mission.frame, flight.mission.task
    facts: Facts
    for phase, part in flight.segments():  # each up to where the next one begins
        drawn = slice(part.start, min(part.stop + 1, len(whole)))
        piece = whole.part(shapes.thinned(drawn, len(whole)))
        facts = {
            "from_utc": shapes.utc_text(whole.time_us[part.start]),
            "until_utc": shapes.utc_text(whole.time_us[part.stop - 1]),
            "from_s": float(whole.t_s[part.start]),
            "until_s": float(whole.t_s[part.stop - 1]),
            "positions": part.stop - part.start,
        }
        line, times_us = shapes.of_track(piece), piece.time_us
        yield Feature(kind="track", name=phase, points=line, facts=facts, times_us=times_us)
    for planned in flight.planned:
        plan, proven = planned.plan, planned.plan.certificate
        facts = {
            "plan_id": plan.plan_id,
            "leg": planned.leg,
            "flown": planned.leg is not None,
            "ready_s": plan.t_s,
            "begun_s": planned.begun_s,
            **{name: getattr(plan, name) for name in _OF_PLAN},
            **{name: _bounded(getattr(proven, name)) for name in _OF_PROOF},
            "broken": ", ".join(proven.broken),
        }
        line = shapes.of_subpath(plan.subpath, frame)
        yield Feature(kind="subpath", name=f"plan {plan.plan_id}", points=line, facts=facts)
    for kind, places in {"target": flight.targets_ne_m, "rally": flight.mission.rally_ne_m}.items():
        for number, place_ne_m in enumerate(places, start=1):
            place = np.array([frame.to_geodetic_deg(*place_ne_m)[::-1]])
            yield Feature(kind=kind, name=f"{kind} {number}", points=place, facts=_NO_FACTS)
    for zone in flight.zones:
        kind = "keep_in" if zone.keep_in else "keep_out"
        radius_m = zone.radius_m if isinstance(zone, CircleZone) else None
        facts = {"keep_in": zone.keep_in, "radius_m": radius_m}
        edge = shapes.of_zone(zone, frame, task.limits.ceiling_amsl_m)
        yield Feature(kind=kind, name=zone.name, points=edge, facts=facts)
    for radar in task.radars:
        facts = {"range_m": radar.range_m, "altitude_amsl_m": radar.centre_nea_m[2]}
        edge = shapes.of_radar(radar, frame)
        yield Feature(kind="radar", name=radar.name, points=edge, facts=facts)
    for moment in flight.moments:  # where the vehicle was then
        if (at := flight.index_at(moment.boot, moment.t_s)) is not None:
            here = whole.part(slice(at, at + 1))
            facts = {name: getattr(moment, name) for name in _OF_MOMENT}
            place, time_us = shapes.of_track(here), here.time_us
            name = moment.what
            yield Feature(kind="event", name=name, points=place, facts=facts, times_us=time_us)


def _bounded(number: float | None) -> float | None:
    """JSON has no infinity."""
    return number if number is not None and math.isfinite(number) else None


# --- GeoJSON


def write_geojson(flight: Flight, file: Path) -> None:
    """Write a flight, one feature a line.  Raises OSError if that cannot be done."""
    head = {"type": "FeatureCollection", "name": flight.mission.name, "altitude_datum": "AMSL"}
    with file.open("w", encoding="utf-8") as out:
        out.write(json.dumps(head, ensure_ascii=False)[:-1] + ', "features": [')
        for number, each in enumerate(features_of(flight)):
            text = json.dumps(_geojson(each), ensure_ascii=False, allow_nan=False)
            out.write(",\n" * (number > 0) + text)
        out.write("\n]}\n")


def _geojson(each: Feature) -> dict[str, Any]:
    """As the standard has it; property `kind` says what each is."""
    properties: dict[str, Any] = {"kind": each.kind, "name": each.name}
    if each.kind == "track":
        properties["phase"] = each.name
    properties |= each.facts
    if each.kind == "event" and each.times_us is not None:
        properties["utc"] = shapes.utc_text(each.times_us[0])
    is_zone = each.kind in ("keep_in", "keep_out")
    rows = [
        [round(longitude, 7), round(latitude, 7), *(round(up, 3) for up in height)]
        for longitude, latitude, *height in each.points[:, : 2 if is_zone else 3].tolist()
    ]
    if is_zone or each.kind == "radar":
        geometry: dict[str, Any] = {"type": "Polygon", "coordinates": [[*rows, rows[0]]]}
    else:
        rows = [row for row, _ in groupby(rows)]  # none that repeats the one before
        is_line = len(rows) > 1
        geometry = {"type": "LineString", "coordinates": rows}
        geometry = geometry if is_line else {"type": "Point", "coordinates": rows[0]}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


# --- KML 2.2 with Google's gx:Track: the flight in Google Earth, with its time slider

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
    """Write a flight as `flight.kml.j2` has it.  Raises OSError if that cannot be done."""
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


# --- CSV: one row for each position that the vehicle has reported

COLUMNS: Final = {
    "utc": ("", "time of the log, ISO 8601"),
    "t_s": (".3f", "vehicle time: seconds since its boot"),
    "boot": ("d", "how often the autopilot had rebooted"),
    "latitude_deg": (".7f", "WGS84"),
    "longitude_deg": (".7f", "WGS84"),
    "altitude_amsl_m": (".3f", "above mean sea level, as the autopilot has it"),
    "above_home_m": (".3f", "above home, as the autopilot has it"),
    "north_m": (".2f", "of the mission's origin, in its local frame"),
    "east_m": (".2f", "of the mission's origin, in its local frame"),
    "north_m_s": (".2f", "velocity towards true north"),
    "east_m_s": (".2f", "velocity towards true east"),
    "up_m_s": (".2f", "velocity upwards"),
    "heading_deg": (".2f", "where the nose points, clockwise from true north; empty: not known"),
    "phase": ("", "of the mission (docs/reference/mission-states.md)"),
    "leg": ("d", "the subpath that was flown, counted from 1; 0: none yet"),
}
"""The columns: how each is written, and what it means (docs/export.md)."""


def write_csv(flight: Flight, file: Path) -> None:
    """Write the track.  Raises OSError if that cannot be done."""
    track, known = flight.track, flight.decided_at_positions()
    north_m, east_m, _ = flight.places_nea_m.T
    values: dict[str, Any] = {
        "utc": [shapes.utc_text(time_us) for time_us in track.time_us],
        "north_m": north_m,
        "east_m": east_m,
        "phase": [each.phase for each in known],
        "leg": [each.leg_number for each in known],
    }
    columns = [values.get(name, getattr(track, name, None)) for name in COLUMNS]
    forms = [form for form, _ in COLUMNS.values()]
    with file.open("w", encoding="utf-8", newline="") as out:
        rows = csv.writer(out)
        rows.writerow(COLUMNS)
        for row in zip(*columns, strict=True):
            written = (format(each, form) for each, form in zip(row, forms, strict=True))
            rows.writerow("" if text == "nan" else text for text in written)
