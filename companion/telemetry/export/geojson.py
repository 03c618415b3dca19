"""GeoJSON (RFC 7946) for QGIS and others: longitude, latitude (WGS84), altitude.

The altitude is AMSL, as everywhere in a run folder.  The standard means heights above the
ellipsoid, which a flight does not need to know: the file says what it has (`altitude_datum`).
"""

import json
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

from companion.geodesy import FloatArray
from companion.telemetry.export import shapes
from companion.telemetry.export.facts import (
    Facts,
    drawn_track,
    moment_facts,
    plan_facts,
    radar_facts,
    zone_facts,
)
from companion.telemetry.export.flight import RecordedFlight

Feature = dict[str, Any]


def write_geojson(flight: RecordedFlight, file: Path) -> None:
    """Write a flight, one feature a line.  Raises OSError if that cannot be done."""
    head = {"type": "FeatureCollection", "name": flight.mission.name, "altitude_datum": "AMSL"}
    with file.open("w", encoding="utf-8") as out:
        out.write(json.dumps(head, ensure_ascii=False)[:-1] + ', "features": [')
        for number, feature in enumerate(features(flight)):
            text = json.dumps(feature, ensure_ascii=False, allow_nan=False)
            out.write(",\n" * (number > 0) + text)
        out.write("\n]}\n")


def features(flight: RecordedFlight) -> Iterator[Feature]:
    """The features of a flight; property `kind` says what each is."""
    for phase, piece, facts in drawn_track(flight):
        line = _line(shapes.of_track(piece))
        yield _feature("track", phase, line, {"phase": phase, **facts})
    for each in flight.planned:
        line = _line(shapes.of_subpath(each.subpath, flight.mission.frame))
        yield _feature("subpath", f"plan {each.plan.plan_id}", line, plan_facts(each))
    yield from _places(flight)
    yield from _threats(flight)
    for moment in flight.moments:
        at = flight.index_at(moment.boot, moment.t_s)
        if at is not None:
            point = shapes.of_track(flight.track.part(slice(at, at + 1)))
            facts = {**moment_facts(moment), "utc": shapes.utc_text(flight.track.time_us[at])}
            yield _feature("event", moment.what, _geometry("Point", _rows(point)[0]), facts)


def _places(flight: RecordedFlight) -> Iterator[Feature]:
    for kind, places in {"target": flight.targets_ne_m, "rally": flight.mission.rally_ne_m}.items():
        for number, (north_m, east_m) in enumerate(places, start=1):
            latitude, longitude = flight.mission.frame.to_geodetic_deg(north_m, east_m)
            place = _geometry("Point", [round(longitude, 7), round(latitude, 7)])
            yield _feature(kind, f"{kind} {number}", place, {})


def _threats(flight: RecordedFlight) -> Iterator[Feature]:
    frame, limits = flight.mission.frame, flight.mission.task.limits
    for zone in flight.zones:
        kind = "keep_in" if zone.keep_in else "keep_out"
        edge = shapes.of_zone(zone, frame, limits.floor_amsl_m)[:, :2]
        yield _feature(kind, zone.name, _polygon(edge), zone_facts(zone))
    for radar in flight.mission.task.radars:
        edge = shapes.of_radar(radar, frame)
        yield _feature("radar", radar.name, _polygon(edge), radar_facts(radar))


def _feature(kind: str, name: str, geometry: Feature, facts: Facts) -> Feature:
    properties = {"kind": kind, "name": name, **facts}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def _line(points: FloatArray) -> Feature:
    """A line without points that repeat the one before; a point if there is no other."""
    rows = [row for row, _ in groupby(_rows(points))]
    return _geometry("LineString", rows) if len(rows) > 1 else _geometry("Point", rows[0])


def _polygon(edge: FloatArray) -> Feature:
    rows = _rows(edge)
    return _geometry("Polygon", [[*rows, rows[0]]])


def _geometry(kind: str, coordinates: object) -> Feature:
    return {"type": kind, "coordinates": coordinates}


def _rows(points: FloatArray) -> list[list[float]]:
    digits = (7, 7, 3)
    return [
        [round(value, places) for value, places in zip(row, digits, strict=False)]
        for row in points.tolist()
    ]
