"""Exports of a recorded flight, read by programs that are not ours, and held against the log."""

import csv
import itertools
import json
from pathlib import Path
from typing import Any

import fastkml.validator
import geopandas
import numpy as np
import pytest
import shapely
from lxml import etree
from planning import spline
from tlog import frames_of

from companion.config import load_mission
from companion.mission.journal import PlanReady
from companion.mission.mission import Mission
from companion.replay.exporting import recorded, write
from companion.sources.zones import read_geojson
from companion.telemetry.export.formats import COLUMNS
from companion.telemetry.journal import Journal

SCHEMA = Path(fastkml.validator.__file__).parent / "schema" / "kml22gx.xsd"
PAGE = Path(__file__).parents[3] / "docs" / "reference" / "export.md"
KML = {"k": "http://www.opengis.net/kml/2.2", "gx": "http://www.google.com/kml/ext/2.2"}
PHASES = ["preparing", "arming", "taking off", "flying", "holding", "flying", "arrived", "done"]
Positions = list[tuple[int, Any, tuple[float, float, float]]]


@pytest.fixture(scope="module")
def exported(run_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the flight in every format."""
    folder = tmp_path_factory.mktemp("exported")
    flight, _ = recorded(run_dir)
    write(flight, "kml", folder / "flight.kml")
    write(flight, "geojson", folder / "flight.geojson")
    write(flight, "csv", folder / "flight.csv")
    return folder


@pytest.fixture(scope="module")
def positions(run_dir: Path) -> Positions:
    """Of every position with a fix stamp, message, and longitude, latitude, altitude."""
    log = frames_of((run_dir / "flight.tlog").read_bytes())
    found = [(at, m) for at, m in log if m.get_type() == "GLOBAL_POSITION_INT" and m.lat]
    assert len(found) > 900
    return [(at, m, (m.lon * 1e-7, m.lat * 1e-7, m.alt * 1e-3)) for at, m in found]


@pytest.fixture(scope="module")
def mission(run_dir: Path) -> Mission:
    return load_mission(str(run_dir / "mission.toml"))


def utc_ms(text: str) -> int:
    """Milliseconds since 1970 of a time such as 2026-01-01T00:00:00.123Z."""
    return int(np.datetime64(text[:-1]).astype("int64"))


def test_the_kml_is_valid_and_has_every_position_at_its_time_in_a_track_for_each_phase(
    exported: Path, positions: Positions
) -> None:
    """Each in its own colour; and each begins where the one before it ends."""
    kml = etree.parse(exported / "flight.kml")
    schema = etree.XMLSchema(etree.parse(SCHEMA))
    assert schema.validate(kml), schema.error_log
    marks = kml.xpath("//k:Placemark[gx:Track]", namespaces=KML)
    assert [mark.findtext("k:name", namespaces=KML) for mark in marks] == PHASES
    styles = [mark.findtext("k:styleUrl", namespaces=KML) for mark in marks]
    assert set(styles) <= {f"#{each.get('id')}" for each in kml.xpath("//k:Style", namespaces=KML)}
    by_phase = dict(zip(PHASES, styles, strict=True))
    assert len({by_phase[name] for name in ("flying", "holding", "done")}) == 3
    assert set(kml.xpath("//gx:Track/k:altitudeMode/text()", namespaces=KML)) == {"absolute"}
    joined: list[tuple[int, list[float]]] = []
    for mark in marks:
        times_ms = map(utc_ms, mark.xpath(".//k:when/text()", namespaces=KML))
        coords = mark.xpath(".//gx:coord/text()", namespaces=KML)
        places = [[float(word) for word in coord.split()] for coord in coords]
        rows = list(zip(times_ms, places, strict=True))
        assert not joined or joined.pop() == rows[0]
        joined += rows
    assert joined == [
        (round(at_us / 1000), pytest.approx(place, abs=1e-9)) for at_us, _, place in positions
    ]


def test_geopandas_reads_every_feature_and_position_of_the_geojson_in_wgs84(
    exported: Path, mission: Mission, positions: Positions
) -> None:
    table = geopandas.read_file(exported / "flight.geojson")
    assert table.crs.to_epsg() == 4326
    extended = table.geometry.bounds.pipe(lambda box: box.maxx > box.minx)  # a climb is no line
    assert table.geometry[extended].is_valid.all()
    assert not table.geometry.is_empty.any()
    zones = {"target": 1, "rally": 1, "keep_in": 1, "keep_out": 2}
    flown = {"track": len(PHASES), "subpath": 2, "event": 2, "radar": len(mission.task.radars)}
    assert table["kind"].value_counts().to_dict().items() >= (zones | flown).items()
    assert list(table[table["what"] == "hold"]["why"]) == ["paused by a person"]
    tracks = table[table["kind"] == "track"]
    assert list(tracks["phase"]) == PHASES
    rows = {tuple(np.round(row, 7)) for line in tracks.geometry for row in line.coords}
    assert rows == {tuple(np.round(place, 7)) for *_, place in positions}
    ends_s = [m.time_boot_ms / 1e3 for _, m, _ in (positions[0], positions[-1])]
    assert [tracks["from_s"].iloc[0], tracks["until_s"].iloc[-1]] == ends_s


def test_zones_wind_as_the_standard_says_and_are_threats_for_a_mission(
    exported: Path, tmp_path: Path
) -> None:
    """RFC 7946, 3.1.6: the outer ring anticlockwise.

    The keep-outs and keep-ins alone, as a person would cut them out in QGIS.
    """
    found = json.loads((exported / "flight.geojson").read_text(encoding="utf-8"))
    zones = ("keep_out", "keep_in")
    found["features"] = [f for f in found["features"] if f["properties"]["kind"] in zones]
    for feature in found["features"]:
        [ring] = feature["geometry"]["coordinates"]
        assert shapely.LinearRing(np.array(ring)[:, :2]).is_ccw
    file = tmp_path / "zones.geojson"
    file.write_text(json.dumps(found), encoding="utf-8")
    threats = read_geojson(file, "threats")
    assert (len(threats.keep_outs), len(threats.keep_ins)) == (2, 1)


def test_subpaths_follow_their_curves_and_bear_what_is_proven(
    exported: Path, mission: Mission, run_dir: Path
) -> None:
    """No chord leaves the curve by a quarter of a metre."""
    entries = Journal(run_dir / "journal.jsonl").entries()
    plans = [entry for entry in entries if isinstance(entry, PlanReady)]
    table = geopandas.read_file(exported / "flight.geojson")
    rows = table[table["kind"] == "subpath"]
    for (_, row), plan in zip(rows.iterrows(), plans, strict=True):
        places = [(*mission.frame.to_local_m(lat, lon), up) for lon, lat, up in row.geometry.coords]
        curve = spline(plan.control_nea_m)(np.linspace(0.0, 1.0, 500))
        for axes in ([0, 1], [0, 2]):  # from above, and from the east
            lines = (shapely.LineString(np.array(each)[:, axes]) for each in (places, curve))
            assert shapely.hausdorff_distance(*lines, densify=0.01) < 0.25
        np.testing.assert_allclose([places[0], places[-1]], curve[[0, -1]], atol=0.02)
        assert row["clearance_m"] == plan.certificate.clearance_m
        assert (row["leg"], row["flown"]) == (plan.plan_id, True)


def test_the_csv_has_a_row_for_each_position_and_the_documented_columns(
    exported: Path, positions: Positions, mission: Mission
) -> None:
    with (exported / "flight.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == list(COLUMNS)
    for row, (stamp_us, message, (longitude, latitude, up_m)) in zip(rows, positions, strict=True):
        north_m, east_m = mission.frame.to_local_m(latitude, longitude)
        expected = {"longitude_deg": longitude, "latitude_deg": latitude, "altitude_amsl_m": up_m}
        expected |= {"t_s": message.time_boot_ms / 1000, "up_m_s": -message.vz / 100}
        assert utc_ms(row["utc"]) == round(stamp_us / 1000)
        assert {name: float(row[name]) for name in expected} == pytest.approx(expected, abs=1e-9)
        assert (float(row["north_m"]), float(row["east_m"])) == pytest.approx(
            (north_m, east_m), abs=0.01
        )
    assert [name for name, _ in itertools.groupby(row["phase"] for row in rows)] == PHASES
    assert [leg for leg, _ in itertools.groupby(row["leg"] for row in rows)] == ["0", "1", "2"]
    page = PAGE.read_text(encoding="utf-8")
    assert all(f"| `{name}` | {words} |" in page for name, (_, words) in COLUMNS.items())
