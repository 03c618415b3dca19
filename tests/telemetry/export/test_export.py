"""Exports of a recorded flight, read by programs that are not ours, and held against the log."""

import csv
import itertools
import json
import struct
from pathlib import Path
from typing import Any

import fastkml.validator
import geopandas
import numpy as np
import pyogrio
import pyproj
import pytest
from lxml import etree
from pymavlink.dialects.v20 import all as wire

from companion.config import load_mission
from companion.mission.journal import PlanReady
from companion.replay.exporting import recorded
from companion.sources.geojson import read_geojson
from companion.telemetry.export.formats import COLUMNS, write_csv, write_geojson, write_kml
from companion.telemetry.journal import Journal

SCHEMAS = Path(fastkml.validator.__file__).parent / "schema"
KML = {"k": "http://www.opengis.net/kml/2.2", "gx": "http://www.google.com/kml/ext/2.2"}
GEOD = pyproj.Geod(ellps="WGS84")
PHASES = ["preparing", "arming", "taking off", "flying", "holding", "flying", "arrived", "done"]
METRE_DEG = 1.0 / 111_000.0


@pytest.fixture(scope="module")
def exported(run_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the flight in every format."""
    folder = tmp_path_factory.mktemp("exported")
    flight, _ = recorded(run_dir)
    write_kml(flight, folder / "flight.kml")
    write_geojson(flight, folder / "flight.geojson")
    write_csv(flight, folder / "flight.csv")
    return folder


@pytest.fixture(scope="module")
def positions(run_dir: Path) -> list[tuple[int, Any]]:
    """Every position of the log with a fix and its stamp, read by pymavlink."""
    data, at, found = (run_dir / "flight.tlog").read_bytes(), 0, []
    parser = wire.MAVLink(None)
    while at < len(data):
        size = 12 + data[at + 9]
        message = parser.decode(bytearray(data[at + 8 : at + 8 + size]))
        if message.get_type() == "GLOBAL_POSITION_INT" and message.lat:
            found.append((struct.unpack_from(">Q", data, at)[0], message))
        at += 8 + size
    assert len(found) > 900
    return found


@pytest.fixture(scope="module")
def plans(run_dir: Path) -> list[PlanReady]:
    entries = Journal(run_dir / "journal.jsonl").entries()
    return [entry for entry in entries if isinstance(entry, PlanReady)]


def b_spline(control: Any, count: int) -> Any:
    """Points of a clamped uniform cubic B-spline, by scipy."""
    from scipy.interpolate import BSpline

    spans = len(control) - 3
    knots = np.concatenate([[0, 0, 0], np.linspace(0, 1, spans + 1), [1, 1, 1]])
    return BSpline(knots, np.array(control), 3)(np.linspace(0, 1, count))


def chord_away_m(line: Any, point: Any) -> float:
    """Least distance of a point from the pieces of a line."""
    starts, along = line[:-1], np.diff(line, axis=0)
    share = ((point - starts) * along).sum(1) / np.maximum((along**2).sum(1), 1e-12)
    feet = starts + np.clip(share, 0.0, 1.0)[:, None] * along
    return float(np.linalg.norm(feet - point, axis=1).min())


# --- KML


@pytest.fixture(scope="module")
def kml(exported: Path) -> Any:
    return etree.parse(exported / "flight.kml")


def test_the_kml_is_valid_by_the_schemas_of_the_ogc_and_google(kml: Any) -> None:
    schema = etree.XMLSchema(etree.parse(SCHEMAS / "kml22gx.xsd"))
    assert schema.validate(kml), schema.error_log


def test_the_tracks_of_the_kml_hold_every_position_at_its_time(
    kml: Any, positions: list[tuple[int, Any]]
) -> None:
    found: dict[str, list[float]] = {}
    tracks = kml.xpath("//gx:Track", namespaces=KML)
    for track in tracks:
        whens = [each.text for each in track.xpath("k:when", namespaces=KML)]
        coords = [each.text for each in track.xpath("gx:coord", namespaces=KML)]
        assert len(whens) == len(coords)
        assert whens == sorted(whens)
        assert track.xpath("k:altitudeMode/text()", namespaces=KML) == ["absolute"]
        for when, coord in zip(whens, coords, strict=True):
            place = [float(value) for value in coord.split()]
            assert found.setdefault(when, place) == place
    times = {np.datetime64(when[:-1]).astype("int64"): found[when] for when in found}
    assert len(times) == len(positions)
    for stamp_us, message in positions:
        place = times[round(stamp_us / 1000)]
        expected = [message.lon * 1e-7, message.lat * 1e-7, message.alt * 1e-3]
        assert place == pytest.approx(expected, abs=1e-9)


def test_the_tracks_are_coloured_by_phase_and_join(
    kml: Any, positions: list[tuple[int, Any]]
) -> None:
    marks = kml.xpath("//k:Placemark[gx:Track]", namespaces=KML)
    names = [mark.findtext("k:name", namespaces=KML) for mark in marks]
    assert names == PHASES
    styles = [mark.findtext("k:styleUrl", namespaces=KML) for mark in marks]
    defined = {f"#{each.get('id')}" for each in kml.xpath("//k:Style", namespaces=KML)}
    assert set(styles) <= defined
    by_phase = dict(zip(names, styles, strict=True))
    assert len({by_phase[name] for name in PHASES[2:]}) == 5  # "done" is grey
    coords = [mark.xpath(".//gx:coord/text()", namespaces=KML) for mark in marks]
    for before, after in itertools.pairwise(coords):
        assert before[-1] == after[0]
    assert sum(map(len, coords)) == len(positions) + len(PHASES) - 1


def test_gdal_reads_every_layer_of_the_kml(exported: Path) -> None:
    layers = {name for name, _ in pyogrio.list_layers(exported / "flight.kml")}
    drawn = {"flown track", "planned subpaths", "targets"}
    assert layers == drawn | {"threats as known", "holds and events"}
    threats = geopandas.read_file(exported / "flight.kml", layer="threats as known")
    assert threats.geometry.is_valid.all()
    assert {'tower <&> "mast"', "village", "county", "radar 1"} <= set(threats["Name"])
    subpaths = geopandas.read_file(exported / "flight.kml", layer="planned subpaths")
    assert list(subpaths["Name"]) == ["plan 1, leg 1", "plan 2, leg 2"]
    events = geopandas.read_file(exported / "flight.kml", layer="holds and events")
    assert list(events["code"].fillna("")) == ["PAUSED", ""]
    assert list(events["Name"]) == ["hold: paused by a person", "end: arrived: target reached"]


# --- GeoJSON


@pytest.fixture(scope="module")
def table(exported: Path) -> Any:
    return geopandas.read_file(exported / "flight.geojson")


def test_geopandas_reads_every_feature_in_wgs84(table: Any) -> None:
    assert table.crs.to_epsg() == 4326
    extended = table.geometry.bounds.pipe(lambda box: box.maxx > box.minx)  # a climb is no line
    assert table.geometry[extended].is_valid.all()
    assert not table.geometry.is_empty.any()
    counts = table["kind"].value_counts().to_dict()
    assert counts["track"] == len(PHASES)
    assert counts["subpath"] == 2
    assert counts["target"] == counts["rally"] == counts["keep_in"] == 1
    assert counts["keep_out"] == counts["event"] == 2
    assert counts["radar"] == len(load_mission("environment-1").task.radars)
    assert list(table[table["kind"] == "track"]["phase"]) == PHASES


def test_polygons_wind_as_the_standard_says(exported: Path) -> None:
    """RFC 7946, 3.1.6: the outer ring anticlockwise, closed, the first position repeated."""
    found = json.loads((exported / "flight.geojson").read_text(encoding="utf-8"))
    polygons = [f["geometry"] for f in found["features"] if f["geometry"]["type"] == "Polygon"]
    assert len(polygons) > 3
    for polygon in polygons:
        [ring] = polygon["coordinates"]
        assert ring[0] == ring[-1]
        longitude, latitude = np.array(ring)[:, :2].T
        assert np.sum((longitude[1:] - longitude[:-1]) * (latitude[1:] + latitude[:-1])) < 0.0


def test_the_track_of_the_geojson_is_that_of_the_log(
    table: Any, positions: list[tuple[int, Any]]
) -> None:
    lines = table[(table["kind"] == "track") & (table.geometry.geom_type == "LineString")]
    rows = np.array([row for line in lines.geometry for row in line.coords])
    tracks, (first, last) = table[table["kind"] == "track"], (positions[0][1], positions[-1][1])
    ends_s = tracks["from_s"].iloc[0], tracks["until_s"].iloc[-1]
    assert ends_s == (first.time_boot_ms / 1e3, last.time_boot_ms / 1e3)
    assert (tracks["from_s"] < tracks["until_s"]).any()
    logged = {(m.lon * 1e-7, m.lat * 1e-7, m.alt * 1e-3) for _, m in positions}
    assert {tuple(row) for row in rows.round(7)} == {tuple(np.round(row, 7)) for row in logged}


def test_subpaths_follow_their_curves_and_bear_what_is_proven(
    table: Any, plans: list[PlanReady], run_dir: Path
) -> None:
    frame = load_mission(str(run_dir / "mission.toml")).frame
    rows = table[table["kind"] == "subpath"]
    for (_, row), plan in zip(rows.iterrows(), plans, strict=True):
        curve = b_spline(plan.control_nea_m, 500)
        line = np.array(row.geometry.coords)
        places = [frame.to_local_m(latitude, longitude) for longitude, latitude, _ in line]
        for (north, east), altitude in zip(places, line[:, 2], strict=True):
            gaps = np.linalg.norm(curve - (north, east, altitude), axis=1)
            assert gaps.min() < plan.length_m / 500
        nea_m = np.column_stack([places, line[:, 2]])
        for point in curve:
            assert chord_away_m(nea_m, point) < 0.25
        ends = np.array([[*places[0], line[0, 2]], [*places[-1], line[-1, 2]]])
        np.testing.assert_allclose(ends, curve[[0, -1]], atol=0.02)
        assert row["clearance_m"] == plan.certificate.clearance_m
        assert (row["leg"], row["flown"]) == (plan.plan_id, True)


def test_zones_radars_and_targets_lie_where_the_mission_has_them(table: Any, run_dir: Path) -> None:
    mission = load_mission(str(run_dir / "mission.toml"))
    for radar in mission.task.radars:
        [shape] = table[(table["kind"] == "radar") & (table["name"] == radar.name)].geometry
        latitude, longitude = mission.frame.to_geodetic_deg(*radar.centre_nea_m[:2])
        edge = np.array(shape.exterior.coords)
        count = len(edge)
        _, _, metres = GEOD.inv([longitude] * count, [latitude] * count, edge[:, 0], edge[:, 1])
        np.testing.assert_allclose(metres, radar.range_m, rtol=0.02)  # the frame's own stretch
    [target] = table[table["kind"] == "target"].geometry
    latitude, longitude = mission.frame.to_geodetic_deg(4000.0, 3000.0)
    assert (target.x, target.y) == pytest.approx((longitude, latitude), abs=0.1 * METRE_DEG)


def test_a_hold_lies_where_the_vehicle_was_then(
    table: Any, positions: list[tuple[int, Any]]
) -> None:
    hold = table[table["what"] == "hold"].iloc[0]
    [message] = [m for _, m in positions if m.time_boot_ms == round(hold["t_s"] * 1e3)]
    place = (message.lon * 1e-7, message.lat * 1e-7, message.alt * 1e-3)
    assert (hold.geometry.x, hold.geometry.y, hold.geometry.z) == pytest.approx(place, abs=1e-7)
    assert hold["why"] == "paused by a person"
    assert 9.0 < hold["until_s"] - hold["t_s"] < 12.0


# --- CSV


def test_the_csv_has_a_row_for_each_position_and_the_documented_columns(
    exported: Path, positions: list[tuple[int, Any]], run_dir: Path
) -> None:
    with (exported / "flight.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == list(COLUMNS)
    assert len(rows) == len(positions)
    frame = load_mission(str(run_dir / "mission.toml")).frame
    for row, (stamp_us, message) in zip(rows, positions, strict=True):
        assert np.datetime64(row["utc"][:-1]).astype("int64") == round(stamp_us / 1000)
        assert float(row["t_s"]) == message.time_boot_ms / 1000
        assert float(row["latitude_deg"]) == pytest.approx(message.lat * 1e-7, abs=1e-9)
        assert float(row["longitude_deg"]) == pytest.approx(message.lon * 1e-7, abs=1e-9)
        assert float(row["altitude_amsl_m"]) == message.alt / 1000
        assert float(row["up_m_s"]) == -message.vz / 100
        north, east = frame.to_local_m(message.lat * 1e-7, message.lon * 1e-7)
        assert (float(row["north_m"]), float(row["east_m"])) == pytest.approx(
            (north, east), abs=0.01
        )
        assert row["boot"] == "0"
    assert [name for name, _ in itertools.groupby(row["phase"] for row in rows)] == PHASES
    assert [leg for leg, _ in itertools.groupby(row["leg"] for row in rows)] == ["0", "1", "2"]


def test_the_page_explains_every_column() -> None:
    page = (Path(__file__).parents[3] / "docs" / "export.md").read_text(encoding="utf-8")
    for name, (_, words) in COLUMNS.items():
        assert f"| `{name}` | {words} |" in page


# --- all


def test_two_exports_are_the_same_bytes(run_dir: Path, exported: Path, tmp_path: Path) -> None:
    for writer, to in ((write_kml, "kml"), (write_geojson, "geojson"), (write_csv, "csv")):
        writer(recorded(run_dir)[0], tmp_path / "again")
        assert (tmp_path / "again").read_bytes() == (exported / f"flight.{to}").read_bytes()


def test_the_threats_of_an_export_are_threats_for_a_mission(exported: Path, tmp_path: Path) -> None:
    """The keep-outs and keep-ins alone, as a person would cut them out in QGIS."""
    found = json.loads((exported / "flight.geojson").read_text(encoding="utf-8"))
    zones = ("keep_out", "keep_in")
    found["features"] = [f for f in found["features"] if f["properties"]["kind"] in zones]
    file = tmp_path / "zones.geojson"
    file.write_text(json.dumps(found), encoding="utf-8")
    threats = read_geojson(file, "threats")
    assert (len(threats.keep_outs), len(threats.keep_ins)) == (2, 1)
