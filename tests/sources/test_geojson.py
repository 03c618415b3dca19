import contextlib
import copy
import functools
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spoiled import refusal, replace_somewhere

from companion.errors import InputError
from companion.sources.geojson import Threats, read_geojson

RING = [[8.0, 47.0], [8.1, 47.0], [8.1, 47.2], [8.0, 47.0]]
HOLE = [[8.04, 47.02], [8.08, 47.02], [8.08, 47.1], [8.04, 47.02]]


def feature(shape: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": shape, "coordinates": coordinates},
    }


def collection(*features: Any, **more: Any) -> dict[str, Any]:
    return {"type": "FeatureCollection", "features": list(features), **more}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("geojson") / "threats.geojson"


def read(path: Path, content: Any) -> Threats:
    path.write_text(json.dumps(content), encoding="utf-8")
    return read_geojson(path, "mission.toml: threats")


refused = functools.partial(refusal, read)


def test_a_polygon_is_a_keep_out_with_latitude_first_and_the_last_corner_once(path: Path) -> None:
    found = read(path, collection(feature("Polygon", [RING], name="quarry")))
    corners = [[47.0, 8.0], [47.0, 8.1], [47.2, 8.1]]
    assert found.keep_outs == [{"name": "quarry", "vertices_deg": corners}]
    assert not found.keep_ins
    assert not found.radars
    assert not found.notes


def test_points_are_circles_and_radars(path: Path) -> None:
    found = read(
        path,
        collection(
            feature("Point", [8.0, 47.0, 400.0], radius_m=250, name="mast"),
            feature("Point", [8.0, 47.0], radius_m=9000.0, kind="keep_in"),
            feature("Point", [8.1, 47.1], kind="radar", altitude_amsl_m=900.5, range_m=15000),
        ),
    )
    place = {"latitude_deg": 47.0, "longitude_deg": 8.0}
    assert found.keep_outs == [{"name": "mast", **place, "radius_m": 250.0}]
    assert found.keep_ins == [{"name": "feature 1", **place, "radius_m": 9000.0}]
    assert found.radars == [
        {
            "name": "feature 2",
            "latitude_deg": 47.1,
            "longitude_deg": 8.1,
            "altitude_amsl_m": 900.5,
            "range_m": 15000.0,
        }
    ]


def test_each_part_of_a_multipolygon_is_kept_out_of(path: Path) -> None:
    found = read(path, feature("MultiPolygon", [[RING], [HOLE]], name="lakes"))
    assert [zone["name"] for zone in found.keep_outs] == ["lakes part 1", "lakes part 2"]


def test_holes_make_a_keep_out_no_smaller_and_a_keep_in_no_larger(path: Path) -> None:
    found = read(path, collection(feature("Polygon", [RING, HOLE], name="town")))
    assert len(found.keep_outs) == 1
    assert found.notes == ["keep-out 'town': its holes are kept out of as well"]
    found = read(path, collection(feature("Polygon", [RING, HOLE], name="range", kind="keep_in")))
    assert [zone["name"] for zone in found.keep_ins] == ["range"]
    assert [zone["name"] for zone in found.keep_outs] == ["range hole 1"]


def test_a_feature_without_properties_is_a_keep_out_named_by_its_number(path: Path) -> None:
    bare = feature("Polygon", [RING]) | {"properties": None}
    assert read(path, collection(bare)).keep_outs[0]["name"] == "feature 0"


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (feature("Polygon", [[[47.0, 98.0], *RING]], name="x"), ["longitude comes first"]),
        (feature("Polygon", [[[181.0, 8.0], *RING]], name="x"), ["out of range"]),
        (feature("Polygon", [[["8", 47.0], *RING]], name="x"), ["a valid number"]),
        (feature("Polygon", [[[8.0], *RING]], name="x"), ["at least 2 items"]),
        (feature("Polygon", [RING[:2]], name="x"), ["three or more corners"]),
        (feature("Polygon", [], name="x"), ["at least 1 item"]),
        (feature("Polygon", 7, name="x"), ["must be a valid list"]),
        (feature("Polygon", [RING], name="x", kind="radar"), ["a radar is a point"]),
        (feature("Polygon", [RING], name="x", kind="fence"), ["'keep_out', 'keep_in' or 'radar'"]),
        (feature("MultiPolygon", [[RING], [HOLE]], name="x", kind="keep_in"), ["Keep one"]),
        (feature("LineString", RING, name="x"), ["one of 'Point', 'Polygon', 'MultiPolygon'"]),
        (feature("Point", [8.0, 47.0], name="x"), ["radius_m", "missing"]),
        (feature("Point", [8.0, 47.0], name="x", radius_m="9"), ["radius_m", "a valid number"]),
        (feature("Point", [8.0, 47.0], name="x", radius_m=10**400), ["radius_m", "a valid number"]),
        (feature("Point", [8.0, 47.0], name="x", kind="radar", range_m=9), ["altitude_amsl_m"]),
    ],
)
def test_what_cannot_be_taken_is_told_by_its_feature(
    path: Path, bad: dict[str, Any], words: list[str]
) -> None:
    message = refused(path, collection(feature("Polygon", [RING]), bad))
    assert message.startswith("threats.geojson: features[1] (x)")
    assert all(word in message for word in words), message


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({}, "no GeoJSON FeatureCollection"),
        ({"type": "Polygon", "coordinates": [RING]}, "no GeoJSON FeatureCollection"),
        ({"type": "FeatureCollection", "features": {}}, "no GeoJSON FeatureCollection"),
        (collection(7), "features[0]"),
        (collection({"type": "Feature", "geometry": None}), "features[0] (feature 0): geometry"),
        (
            collection(crs={"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::2056"}}),
            "not longitude and latitude of WGS84",
        ),
    ],
)
def test_what_is_no_collection_of_features_is_refused(path: Path, bad: Any, words: str) -> None:
    assert words in refused(path, bad)


def test_a_crs_that_says_wgs84_is_taken(path: Path) -> None:
    name = {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}
    crs = {"type": "name", "properties": name}
    assert read(path, collection(feature("Polygon", [RING]), crs=crs)).keep_outs


EVERYTHING = collection(
    feature("Polygon", [RING, HOLE], name="a", kind="keep_in"),
    feature("MultiPolygon", [[RING], [HOLE]], name="b"),
    feature("Point", [8.1, 47.1], kind="radar", altitude_amsl_m=900.5, range_m=15000),
)


@given(data=st.data())
def test_any_value_anywhere_is_taken_or_an_input_error(path: Path, data: st.DataObject) -> None:
    content = copy.deepcopy(EVERYTHING)
    for _ in range(data.draw(st.integers(1, 3))):
        replace_somewhere(content, data)
    with contextlib.suppress(InputError):
        read(path, content)
