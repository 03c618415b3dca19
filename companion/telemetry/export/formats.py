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
from companion.telemetry.export import shapes
from companion.telemetry.flight import Flight, IntArray
from companion.world.zones import CircleZone

Facts = dict[str, str | int | float | bool | None]
"""For people who click on it: names with units, plain values; None: not known, or none."""
_OF_PLAN: Final = ("length_m", "cost", "evaluations", "reaches_target")
_GEOMETRIES: Final = {
    **dict.fromkeys(("track", "subpath"), "LineString"),
    **dict.fromkeys(("target", "rally", "event"), "Point"),
}
"""Of kinds in GeoJSON; the others are areas."""
_OF_MOMENT: Final = ("what", "why", "code", "t_s", "until_s")
MAX_POINTS: Final = 50_000
"""Of all tracks about: more than that, and map programs become slow."""


class Feature(NamedTuple):
    """One thing to show."""

    kind: str
    """track, subpath, target, rally, keep_out, keep_in, radar or event (reference/export.md)."""
    name: str
    points: FloatArray
    """(N, 3) longitude, latitude, altitude AMSL; (1, 2) of a place on the ground.  Of an area its
    edge, anticlockwise and closed, at the mission's ceiling or the radar's altitude."""
    facts: Facts
    times_us: IntArray = np.empty(0, dtype=np.int64)
    """When the vehicle was at each point, microseconds since 1970; of tracks and events."""


def features_of(flight: Flight) -> Iterator[Feature]:
    """The features of a flight, kind by kind."""
    track, frame, task = flight.track, flight.mission.frame, flight.mission.task
    lon_lat_up = np.column_stack([track.longitude_deg, track.latitude_deg, track.altitude_amsl_m])
    facts: Facts
    for phase, part in flight.segments():  # each up to where the next one begins
        first, last = part.start, min(part.stop, len(track) - 1)
        count = min(last - first, math.ceil(MAX_POINTS * (last - first) / len(track)))
        rows = np.unique(np.linspace(first, last, count + 1).astype(np.intp))
        facts = {
            "phase": phase,
            "from_utc": shapes.utc_text(track.time_us[first]),
            "until_utc": shapes.utc_text(track.time_us[part.stop - 1]),
            "from_s": float(track.t_s[first]),
            "until_s": float(track.t_s[part.stop - 1]),
            "positions": part.stop - part.start,
        }
        yield Feature("track", phase, lon_lat_up[rows], facts, track.time_us[rows])
    for planned in flight.planned:
        plan, proven = planned.plan, planned.plan.certificate
        is_bounded = proven.clearance_m is not None and math.isfinite(proven.clearance_m)
        facts = {
            "plan_id": plan.plan_id,
            "leg": planned.leg,
            "flown": planned.leg is not None,
            "ready_s": plan.t_s,
            "begun_s": planned.begun_s,
            **{name: getattr(plan, name) for name in _OF_PLAN},
            "clearance_m": proven.clearance_m if is_bounded else None,  # JSON has no infinity
            "broken": ", ".join(proven.broken),
        }
        line = shapes.of_subpath(plan.subpath, frame)
        yield Feature("subpath", f"plan {plan.plan_id}", line, facts)
    targets_ne_m = flight.decided.targets_ne_m
    for kind, places in {"target": targets_ne_m, "rally": flight.mission.rally_ne_m}.items():
        for number, place_ne_m in enumerate(places, start=1):
            place = np.array([frame.to_geodetic_deg(*place_ne_m)[::-1]])
            yield Feature(kind, f"{kind} {number}", place, {})
    for zone in flight.zones_of(flight.decided):
        edge_ne_m, ceiling_m = shapes.outline_ne_m(zone), task.limits.ceiling_amsl_m
        facts = {"radius_m": zone.radius_m if isinstance(zone, CircleZone) else None}
        edge = shapes.of_points(np.insert(edge_ne_m, 2, ceiling_m, axis=1), frame)
        yield Feature("keep_in" if zone.keep_in else "keep_out", zone.name, edge, facts)
    for radar in task.radars:
        north_m, east_m, altitude_m = radar.centre_nea_m
        facts = {"range_m": radar.range_m, "altitude_amsl_m": altitude_m}
        edge_ne_m = shapes.circle_ne_m((north_m, east_m), radar.range_m)
        edge = shapes.of_points(np.insert(edge_ne_m, 2, altitude_m, axis=1), frame)
        yield Feature("radar", radar.name, edge, facts)
    for moment in flight.moments if len(track) else ():  # where the vehicle was then
        at = flight.row_at(moment.time_s)
        facts = {name: getattr(moment, name) for name in _OF_MOMENT}
        facts["utc"] = shapes.utc_text(track.time_us[at])
        yield Feature("event", moment.what, lon_lat_up[[at]], facts, track.time_us[[at]])


# --- GeoJSON


def write_geojson(flight: Flight, file: Path) -> None:
    """Write a flight, one feature a line.  Raises OSError if that cannot be done."""
    head = {"type": "FeatureCollection", "name": flight.mission.name, "altitude_datum": "AMSL"}
    lines = (
        json.dumps(_geojson(feature), ensure_ascii=False, allow_nan=False)
        for feature in features_of(flight)
    )
    with file.open("w", encoding="utf-8") as out:
        out.write(json.dumps(head, ensure_ascii=False)[:-1] + ', "features": [')
        out.write(",\n".join(lines) + "\n]}\n")


def _geojson(feature: Feature) -> dict[str, Any]:
    """As the standard has it; property `kind` says what each is."""
    rows = [[round(value, 7) for value in row] for row in feature.points.tolist()]
    rows = [row for row, _ in groupby(rows)]  # none that repeats the one before
    kind = _GEOMETRIES.get(feature.kind, "Polygon")
    if kind == "LineString" and len(rows) == 1:
        rows *= 2
    coordinates = {"Point": rows[0], "LineString": rows, "Polygon": [rows]}[kind]
    properties = {"kind": feature.kind, "name": feature.name, **feature.facts}
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


# --- KML 2.2 with Google's gx:Track: the flight in Google Earth, with its time slider

_STYLES: Final = {
    "phase-flying": ("ff2ca02c", 3, None),
    "phase-holding": ("ff2827d6", 3, None),
    "phase-returning": ("ff0e7fff", 3, None),
    "phase-landing": ("ffbd6794", 3, None),
    "phase-faulted": ("ffc277e3", 3, None),
    "track": ("ff7f7f7f", 3, None),
    "subpath": ("a000ffff", 2, None),
    "keep_out": ("ff0000ff", 1, "300000ff"),
    "radar": ("ff0000ff", 1, "300000ff"),
    "keep_in": ("ff00ff00", 1, "0000ff00"),
}
"""Of phases and kinds of features: colour and width of lines, and what fills areas.

Colours are opacity, blue, green, red; phases in which nothing is flown are grey.
"""
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
    documents.filters |= {"utc": shapes.utc_text, "rows": _rows}
    parts = documents.get_template("flight.kml.j2").generate(
        name=flight.mission.name,
        styles=_STYLES,
        folders=_FOLDERS,
        features=list(features_of(flight)),
        name_of=_name,
        style_of=_style,
    )
    with file.open("w", encoding="utf-8") as out:
        out.writelines(parts)


def _name(feature: Feature) -> str:
    facts = feature.facts
    match feature.kind:
        case "subpath":
            flown = f"leg {facts['leg']}" if facts["leg"] else "not flown"
            return f"{feature.name}, {flown}"
        case "event":
            return f"{facts['what']}: {facts['why']}"
        case _:
            return feature.name


def _style(feature: Feature) -> str:
    """Its name among `_STYLES`; empty: Google Earth's own."""
    names = (f"phase-{feature.name}", feature.kind) if feature.kind == "track" else (feature.kind,)
    return next((name for name in names if name in _STYLES), "")


def _rows(points: FloatArray, between: str = ",") -> list[str]:
    """Places, (N, 3) or (N, 2), as KML has them."""
    return [between.join(f"{value:.7f}" for value in point) for point in points.tolist()]


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
"""The columns: how each is written, and what it means (docs/reference/export.md)."""


def write_csv(flight: Flight, file: Path) -> None:
    """Write the track.  Raises OSError if that cannot be done."""
    track, known = flight.track, flight.decided_at(flight.times_s)
    north_m, east_m, _ = flight.places_nea_m.T
    values: dict[str, Any] = {
        "utc": [shapes.utc_text(time_us) for time_us in track.time_us],
        "north_m": north_m,
        "east_m": east_m,
        "phase": [decided.phase for decided in known],
        "leg": [decided.leg_number for decided in known],
    }
    columns = [values.get(name, getattr(track, name, None)) for name in COLUMNS]
    forms = [form for form, _ in COLUMNS.values()]
    with file.open("w", encoding="utf-8", newline="") as out:
        rows = csv.writer(out)
        rows.writerow(COLUMNS)
        for row in zip(*columns, strict=True):
            written = (format(value, form) for value, form in zip(row, forms, strict=True))
            rows.writerow("" if text == "nan" else text for text in written)
