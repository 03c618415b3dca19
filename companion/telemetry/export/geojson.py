"""GeoJSON (RFC 7946) for QGIS and others: longitude, latitude (WGS84), altitude.

The altitude is AMSL, as everywhere in a run folder.  The standard means heights above the
ellipsoid, which a flight does not need to know: the file says what it has (`altitude_datum`).
"""

import json
from itertools import groupby
from pathlib import Path
from typing import Any

from companion.telemetry.export import shapes
from companion.telemetry.export.features import Feature, features_of
from companion.telemetry.flight import Flight

_DIGITS = (7, 7, 3)


def write_geojson(flight: Flight, file: Path) -> None:
    """Write a flight, one feature a line.  Raises OSError if that cannot be done."""
    head = {"type": "FeatureCollection", "name": flight.mission.name, "altitude_datum": "AMSL"}
    with file.open("w", encoding="utf-8") as out:
        out.write(json.dumps(head, ensure_ascii=False)[:-1] + ', "features": [')
        for number, each in enumerate(features_of(flight)):
            text = json.dumps(_feature(each), ensure_ascii=False, allow_nan=False)
            out.write(",\n" * (number > 0) + text)
        out.write("\n]}\n")


def _feature(each: Feature) -> dict[str, Any]:
    """As the standard has it; property `kind` says what each is."""
    properties: dict[str, Any] = {"kind": each.kind, "name": each.name}
    if each.kind == "track":
        properties["phase"] = each.name
    properties |= each.facts
    if each.kind == "event" and each.times_us is not None:
        properties["utc"] = shapes.utc_text(each.times_us[0])
    return {"type": "Feature", "properties": properties, "geometry": _geometry(each)}


def _geometry(each: Feature) -> dict[str, Any]:
    points = each.points[:, :2] if each.kind in ("keep_in", "keep_out") else each.points
    rows = [
        [round(value, digits) for value, digits in zip(row, _DIGITS, strict=False)]
        for row in points.tolist()
    ]
    if each.kind in ("keep_in", "keep_out", "radar"):
        return {"type": "Polygon", "coordinates": [[*rows, rows[0]]]}
    rows = [row for row, _ in groupby(rows)]  # none that repeats the one before
    if len(rows) > 1:
        return {"type": "LineString", "coordinates": rows}
    return {"type": "Point", "coordinates": rows[0]}
