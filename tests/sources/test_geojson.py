"""Zones of a map as GeoJSON has them: what is taken, left out, and refused."""

import contextlib
import copy
import functools
import json
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spoiled import collection, feature, refusal, replace_somewhere

from companion.config import load_mission
from companion.errors import InputError
from companion.sources.zones import Zones, read_geojson

RING = [[8.0, 47.0], [8.1, 47.0], [8.1, 47.2], [8.0, 47.0]]
HOLE = [[8.04, 47.02], [8.08, 47.02], [8.08, 47.1], [8.04, 47.02]]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("geojson") / "threats.geojson"


def read(path: Path, content: Any, leave_out: tuple[Any, ...] = ()) -> Zones:
    path.write_text(json.dumps(content), encoding="utf-8")
    return read_geojson(path, "mission.toml: threats", leave_out)


def corners(ring: list[list[float]]) -> list[list[float]]:
    """Latitude first, and the last corner once."""
    return [[latitude, longitude] for longitude, latitude in ring[:-1]]


def test_polygons_are_zones_and_points_circles(path: Path) -> None:
    found = read(
        path,
        collection(
            feature("Polygon", [RING], name="quarry"),
            feature("Polygon", [HOLE]) | {"properties": None},
            feature("MultiPolygon", [[RING], [HOLE]], name="lakes"),
            feature("Point", [8.0, 47.0, 400.0], radius_m=250, name="mast"),
            feature("Point", [8.0, 47.0], radius_m=9000.0, kind="keep_in"),
        ),
    )
    place = {"latitude_deg": 47.0, "longitude_deg": 8.0}
    ring, hole = corners(RING), corners(HOLE)
    assert found.keep_outs == [
        {"name": "quarry", "vertices_deg": ring},
        {"name": "feature 1", "vertices_deg": hole},
        {"name": "lakes part 1", "vertices_deg": ring},
        {"name": "lakes part 2", "vertices_deg": hole},
        {"name": "mast", **place, "radius_m": 250.0},
    ]
    assert found.keep_ins == [{"name": "feature 4", **place, "radius_m": 9000.0}]
    assert not found.notes
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}}
    assert read(path, collection(feature("Polygon", [RING]), crs=crs)).keep_outs


def test_holes_make_a_keep_out_no_smaller_and_a_keep_in_no_larger(path: Path) -> None:
    found = read(path, collection(feature("Polygon", [RING, HOLE], name="town")))
    assert len(found.keep_outs) == 1
    assert found.notes == ["keep-out 'town': its holes are kept out of as well"]
    found = read(path, collection(feature("Polygon", [RING, HOLE], name="range", kind="keep_in")))
    assert [zone["name"] for zone in found.keep_ins] == ["range"]
    assert [zone["name"] for zone in found.keep_outs] == ["range hole 1"]


PIN, LINE = feature("Point", [8.0, 47.0]), feature("LineString", RING)
NULL = feature("Point", []) | {"geometry": None}
ALL = ("points", "lines", "empty")


EMPTY = {"type": "GeometryCollection", "geometries": []}
NO_ZONES = {
    "points": [
        *[PIN] * 3,
        feature("MultiPoint", [[8.0, 47.0], [8.1, 47.0]]),
        feature("Point", [8.0, 47.0], radius_m=None, kind="keep_in"),
    ],
    "lines": [LINE, feature("MultiLineString", [RING, HOLE])],
    "empty": [NULL, {"type": "Feature"}, {"type": "Feature", "geometry": EMPTY}]
    + [feature("Polygon", [[]])]
    + [feature(shape, []) for shape in ("Polygon", "MultiPolygon", "Point", "LineString")],
}
COUNTED = {
    "points": "6 x point without radius_m",
    "lines": "3 x line",
    "empty": "8 x feature without a geometry",
}


@pytest.mark.parametrize("kind", ALL)
def test_what_is_no_zone_is_refused_with_its_count_and_left_out_when_told(
    path: Path, kind: str
) -> None:
    """Zones are never left out with it."""
    there = collection(feature("Polygon", [RING]), *NO_ZONES[kind])
    told = refusal(functools.partial(read, leave_out=tuple({*ALL} - {kind})), path, there)
    assert f"features = '{COUNTED[kind]}': " in told
    found = read(path, there, (kind,))
    assert [len(zone["vertices_deg"]) for zone in found.keep_outs] == [3]
    assert COUNTED[kind] in found.notes[0]


def test_zones_among_lines_are_taken_of_collections_and_many_points(path: Path) -> None:
    circles = feature("MultiPoint", [[8.0, 47.0], [8.1, 47.0]], radius_m=50.0)
    parts = [LINE["geometry"], feature("MultiPolygon", [[HOLE], [RING]])["geometry"]]
    mixed = feature("x", 0) | {"geometry": {"type": "GeometryCollection", "geometries": parts}}
    found = read(path, collection(mixed, circles), ALL)
    assert [len(zone.get("vertices_deg", [])) for zone in found.keep_outs] == [3, 3, 0, 0]
    assert len(read(path, mixed["geometry"], ALL).keep_outs) == 2


def test_a_mission_says_what_it_leaves_out_of_its_map(path: Path) -> None:
    plan = path.with_name("box.waypoints")
    plan.write_text("QGC WPL 110\n0 1 0 16 0 0 0 0 47 8 0 1\n1 0 3 16 0 0 0 0 47 8.002 40 1\n")
    path.write_text(json.dumps(collection(PIN, LINE, NULL)))
    mission = path.with_name("mission.toml")

    def told(threats: str) -> str:
        mission.write_text(f'plan = "box.waypoints"\n{threats}\n')
        return refusal(lambda path, _: load_mission(str(path)), mission, None)

    remedy = told(f'threats = "{path.name}"').partition("leave them out: ")[2].removesuffix(".")
    assert "leave_out[0]" in told(remedy.replace('"points"', '"pins"'))
    mission.write_text(f'plan = "box.waypoints"\n{remedy}\n')  # as it is told
    notes = " ".join(load_mission(str(mission)).notes)
    assert "1 x point without radius_m, 1 x line, 1 x feature" in notes
    assert "holds no zone" in notes


NO_COLLECTION = "no GeoJSON FeatureCollection"
NO_GEOMETRY = r"\.geometry = .*no geometry as RFC 7946 has it"
REFUSED: list[tuple[Any, str]] = [
    *(
        (collection(feature("Polygon", [RING]), feature(*bad, **more, name="x")), words)
        for bad, more, words in (
            (("Polygon", [[[47.0, 98.0], *RING]]), {}, "longitude first"),
            (
                ("Polygon", [[[181.0, 8.0], *RING]]),
                {},
                r"coordinates = 'latitude 8.0, longitude 181.0': out of range",
            ),
            (("Polygon", [[[8.0], *RING]]), {}, NO_GEOMETRY),
            (("Polygon", [RING[:2]]), {}, NO_GEOMETRY),
            (("Polygon", [RING]), {"kind": "fence"}, "'keep_out' or 'keep_in'"),
            (("MultiPolygon", [[RING], [HOLE]]), {"kind": "keep_in"}, "Keep one"),
            (("Circle", [8.0, 47.0]), {}, NO_GEOMETRY),
            (("Point", [8.0, 47.0]), {"radius_m": "9"}, "radius_m.*a valid number"),
            (("Point", [8.0, 47.0]), {"radius_m": 10**400}, "radius_m.*a valid number"),
        )
    ),
    ({"type": "Topology", "coordinates": [RING]}, NO_COLLECTION),
    ({"type": "FeatureCollection", "features": {}}, NO_COLLECTION),
    (collection(None), r"features\[0\] = None: it has no type"),
    (collection({"type": "Feature", "geometry": 7}), r"features\[0\] \(feature 0\)\.geometry"),
    (
        collection(crs={"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::2056"}}),
        "not longitude and latitude of WGS84",
    ),
]


@pytest.mark.parametrize(("bad", "words"), REFUSED, ids=range(len(REFUSED)))
def test_what_cannot_be_taken_is_told_by_its_feature(path: Path, bad: Any, words: str) -> None:
    """Also where all is to be left out that is no zone: these are meant for one, and broken."""
    for leave_out in ((), ALL):
        message = refusal(functools.partial(read, leave_out=leave_out), path, bad)
        assert re.search(words, message), message
        if len(bad.get("features", ())) == 2:
            assert message.startswith("threats.geojson: features[1] (x)")


EVERYTHING = collection(
    feature("Polygon", [RING, HOLE], name="a", kind="keep_in"),
    feature("MultiPolygon", [[RING], [HOLE]], name="b"),
    feature("Point", [8.1, 47.1], kind="keep_in", radius_m=15000),
)


@given(data=st.data())
def test_any_value_anywhere_is_taken_or_an_input_error(path: Path, data: st.DataObject) -> None:
    content = copy.deepcopy(EVERYTHING)
    for _ in range(data.draw(st.integers(1, 3))):
        replace_somewhere(content, data)
    with contextlib.suppress(InputError):
        read(path, content)
