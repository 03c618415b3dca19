"""Zones of a map as GeoJSON has them: what is taken and left out; refused: `test_refusals`."""

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest
from documents import HOLE, RING, collection, feature, mission, refusal

from companion.sources.zones import Zones, read_geojson

PIN, LINE = feature("Point", [8.0, 47.0]), feature("LineString", RING)
ALL = ("points", "lines", "empty")


def read(folder: Path, content: Any, leave_out: tuple[Any, ...] = ()) -> Zones:
    path = folder / "zones.geojson"
    path.write_text(json.dumps(content), encoding="utf-8")
    return read_geojson(path, "mission.toml: threats", leave_out)


def corners(ring: list[list[float]]) -> list[list[float]]:
    """Latitude first, and the last corner once."""
    return [[latitude, longitude] for longitude, latitude in ring[:-1]]


def test_polygons_are_zones_and_points_circles(folder: Path) -> None:
    """Holes make a keep-out no smaller and a keep-in no larger."""
    parts = [LINE["geometry"], feature("MultiPolygon", [[HOLE], [RING]])["geometry"]]
    mixed = {"type": "GeometryCollection", "geometries": parts}
    found = read(
        folder,
        collection(
            feature("Polygon", [RING, HOLE], name="quarry"),
            feature("Polygon", [HOLE]) | {"properties": None},
            feature("Polygon", [RING, HOLE], name="range", kind="keep_in"),
            feature("Point", [8.0, 47.0, 400.0], radius_m=250, name="mast"),
            feature("MultiPoint", [[8.0, 47.0], [8.1, 47.0]], radius_m=50.0),
            feature("Point", [8.0, 47.0], radius_m=9000.0, kind="keep_in"),
            feature("x", 0, name="mixed") | {"geometry": mixed},
            crs={"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}},
        ),
        ("lines",),
    )
    place = {"latitude_deg": 47.0, "longitude_deg": 8.0}
    ring, hole = corners(RING), corners(HOLE)
    assert found.keep_outs == [
        {"name": "quarry", "vertices_deg": ring},
        {"name": "feature 1", "vertices_deg": hole},
        {"name": "range hole 1", "vertices_deg": hole},
        {"name": "mast", **place, "radius_m": 250.0},
        {"name": "feature 4", **place, "radius_m": 50.0},
        {"name": "feature 4", "latitude_deg": 47.0, "longitude_deg": 8.1, "radius_m": 50.0},
        {"name": "mixed part 1", "vertices_deg": hole},
        {"name": "mixed part 2", "vertices_deg": ring},
    ]
    circle = {"name": "feature 5", **place, "radius_m": 9000.0}
    assert found.keep_ins == [{"name": "range", "vertices_deg": ring}, circle]
    left_out = "zones.geojson: left out, as they are no zones: 1 x line"
    assert found.notes == ["keep-out 'quarry': its holes are kept out of as well", left_out]
    assert len(read(folder, mixed, ALL).keep_outs) == 2


EMPTY = {"type": "GeometryCollection", "geometries": []}
NO_ZONES = {
    "6 x point without radius_m": [
        *[PIN] * 3,
        feature("MultiPoint", [[8.0, 47.0], [8.1, 47.0]]),
        feature("Point", [8.0, 47.0], radius_m=None, kind="keep_in"),
    ],
    "3 x line": [LINE, feature("MultiLineString", [RING, HOLE])],
    "8 x feature without a geometry": [
        *({"type": "Feature"}, {"type": "Feature", "geometry": None}),
        *({"type": "Feature", "geometry": EMPTY}, feature("Polygon", [[]])),
        *(feature(shape, []) for shape in ("Polygon", "MultiPolygon", "Point", "LineString")),
    ],
}


@pytest.mark.parametrize(("kind", "counted"), [*zip(ALL, NO_ZONES, strict=True)])
def test_what_is_no_zone_is_refused_with_its_count_and_left_out_when_told(
    folder: Path, kind: str, counted: str
) -> None:
    """Zones are never left out with it."""
    there = collection(feature("Polygon", [RING]), *NO_ZONES[counted])
    others = tuple({*ALL} - {kind})
    told = refusal(read, folder, there, others)
    assert f"features = '{counted}': " in told
    found = read(folder, there, (kind,))
    assert [len(zone["vertices_deg"]) for zone in found.keep_outs] == [3]
    assert counted in found.notes[0]


def test_a_mission_that_does_as_it_is_told_says_what_it_leaves_out(folder: Path) -> None:
    read(folder, collection(PIN, LINE), ALL)
    told = refusal(mission, folder, "mission", 'threats = "zones.geojson"')
    remedy = told.partition("leave them out: ")[2].removesuffix(".")
    [threats] = tomllib.loads(remedy).values()
    notes = " ".join(mission(folder, "mission", f"threats = {json.dumps(threats)}").notes)
    assert "1 x point without radius_m, 1 x line" in notes
    assert "holds no zone" in notes
