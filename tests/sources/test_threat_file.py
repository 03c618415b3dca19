"""Zones from KML and fence lists, against the KML reader of other projects."""

import contextlib
from pathlib import Path

import geopandas
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spoiled import refusal

from companion.config import load_mission
from companion.errors import InputError
from companion.sources.geojson import Threats
from companion.sources.threat_file import read_threats

MISSION = Path(__file__).parents[2] / "companion" / "environments" / "valley" / "mission.toml"
KML = """<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2"><Document>
<Placemark><name>quarry</name><Polygon><outerBoundaryIs><LinearRing><coordinates>
8.0,47.0,0 8.1,47.0,0 8.1,47.2,0 8.0,47.0,0</coordinates></LinearRing></outerBoundaryIs>
<innerBoundaryIs><LinearRing><coordinates>8.04,47.02 8.08,47.02 8.08,47.1 8.04,47.02
</coordinates></LinearRing></innerBoundaryIs></Polygon></Placemark>
<Folder><Placemark><name>two</name><MultiGeometry>
<Polygon><outerBoundaryIs><LinearRing><coordinates>9,47 9.1,47 9.1,47.1 9,47</coordinates>
</LinearRing></outerBoundaryIs></Polygon>
<Polygon><outerBoundaryIs><LinearRing><coordinates>9.2,47 9.3,47 9.3,47.1 9.2,47</coordinates>
</LinearRing></outerBoundaryIs></Polygon></MultiGeometry></Placemark></Folder>
</Document></kml>
"""
MAST = """<kml xmlns="http://www.opengis.net/kml/2.2"><Placemark><name>mast</name><ExtendedData>
<Data name="kind"><value>%s</value></Data><Data name="radius_m"><value>250</value></Data>
</ExtendedData><Point><coordinates>8.0,47.0,400</coordinates></Point></Placemark></kml>"""

LINE = MAST.replace("Point>", "LineString>")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("threats") / "zones.kml"


def read(path: Path, text: str) -> Threats:
    path.write_text(text, encoding="utf-8")
    return read_threats(path, "mission.toml: threats")


def test_the_polygons_of_a_kml_are_keep_outs_where_gdal_sees_them(path: Path) -> None:
    found = read(path, KML)
    layers = [geopandas.read_file(path, layer=name) for name in geopandas.list_layers(path)["name"]]
    outlines = [
        [(y, x) for x, y, *_ in part.exterior.coords[:-1]]
        for layer in layers
        for geometry in layer.geometry
        for part in getattr(geometry, "geoms", [geometry])
    ]
    ours = [[tuple(c) for c in zone["vertices_deg"]] for zone in found.keep_outs]
    assert ours == outlines
    assert [zone["name"] for zone in found.keep_outs] == ["quarry", "two", "two"]
    assert found.notes == ["keep-out 'quarry': its holes are kept out of as well"]


@pytest.mark.parametrize(("kind", "place"), [("keep_out", "keep_outs"), ("keep_in", "keep_ins")])
def test_a_point_of_a_kml_with_a_radius_is_a_circle(path: Path, kind: str, place: str) -> None:
    found = read(path, MAST % kind)
    circle = {"name": "mast", "latitude_deg": 47.0, "longitude_deg": 8.0, "radius_m": 250.0}
    assert getattr(found, place) == [circle]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("<html/>", "it is a web page"),
        ("<a/>", "it is <a>, not <kml>"),
        ("<kml", "not XML"),
        ("hello", "what is in it is not known"),
        ("", "what is in it is not known"),
        (MAST % "city", "'keep_out', 'keep_in' or 'radar'"),
        ((MAST % "keep_out").replace("250", "wide"), "properties.radius_m = 'wide'"),
        ((MAST % "keep_out").replace("8.0,47.0,400", ""), "'1 without a geometry'"),
        ("<kml><Placemark><name>x</name></Placemark></kml>", "'1 without a geometry'"),
        ((MAST % "keep_out").replace("8.0,47.0,400", "8.0,x"), "must be a valid number"),
        (KML.replace("9.3,47 9.3,47.1", ""), "a ring has three or more corners"),
        (LINE % "keep_out", "'1 line': a zone is a polygon"),
    ],
)
def test_what_is_no_zone_is_refused_in_one_line(path: Path, text: str, expected: str) -> None:
    assert expected in refusal(read, path, text)


@given(st.integers(0, len(KML) - 1), st.text(max_size=5))
def test_a_spoiled_kml_is_read_or_an_input_error(path: Path, at: int, junk: str) -> None:
    with contextlib.suppress(InputError):
        read(path, KML[:at] + junk + KML[at + 3 :])


def test_a_mission_keeps_out_of_what_its_fence_list_says(tmp_path: Path) -> None:
    mission = load_mission(str(MISSION))
    origin = mission.frame
    lat, lon = origin.latitude_deg, origin.longitude_deg
    rows = [
        f"{n}\t0\t0\t5002\t3\t0\t0\t0\t{lat + n * 0.001:.6f}\t{lon + (n % 2) * 0.002:.6f}\t0\t1"
        for n in range(3)
    ]
    (tmp_path / "zones.waypoints").write_text("QGC WPL 110\n" + "\n".join(rows) + "\n")
    text = MISSION.read_text(encoding="utf-8")
    head, _, rest = text.partition("\n")
    flown = tmp_path / "mission.toml"
    flown.write_text(f'{head}\nthreats = "zones.waypoints"\n{rest}', encoding="utf-8")
    zones = load_mission(str(flown)).task.zones
    assert len(zones) == len(mission.task.zones) + 1
