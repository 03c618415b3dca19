"""Files that people take for missions: what they are is told by what is in them."""

import gzip
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
from answers import answered

from companion.config import load_mission, load_world, mission_text
from companion.errors import InputError
from companion.sources.elevation import write_elevation

MISSIONS = Path(__file__).parent / "missions"
RECORDINGS = Path(__file__).parents[1] / "recordings"
KML = '<?xml version="1.0"?>\n<!-- a note -->\n<kml xmlns="http://www.opengis.net/kml/2.2"/>'


@pytest.mark.parametrize("name", ["flight.plan.txt", "flight.json", "flight", "Flight.PLAN"])
def test_a_plan_is_a_plan_under_any_name(tmp_path: Path, name: str) -> None:
    content = (MISSIONS / "fenced.plan").read_bytes()
    (tmp_path / name).write_bytes(content)
    expected = load_mission(str(MISSIONS / "fenced.plan")).targets_ne_m
    assert load_mission(str(tmp_path / name)).targets_ne_m == expected
    toml = tmp_path / "mission.toml"
    toml.write_text(f'plan = "{name}"\n')
    assert load_mission(str(toml)).targets_ne_m == expected


@pytest.mark.parametrize(
    ("content", "what", "remedy"),
    [
        (b"\0\0\x27\x0a" + bytes(20), "a shapefile", "ogr2ogr -f GeoJSON zones.geojson x.txt"),
        (b"SQLite format 3\0", "GeoPackage", "ogr2ogr -f GeoJSON zones.geojson x.txt"),
        ("", "it is empty", "mission.toml"),
        (KML, "KML, which is not read", "ogr2ogr -f GeoJSON zones.geojson x.txt"),
        ("<!DOCTYPE html><html>", "a web page", "mission.toml"),
        ('{"type": "FeatureCollection", "features": []}', "GeoJSON", "threats = "),
        ('{"schema": 1}\n', "it is JSON, not TOML", "mission.toml"),
        ("version https://git-lfs.github.com/spec/v1\n", "Git LFS", "git lfs pull"),
        ('schema = 1\nname = "x"\n'.encode("utf-16"), "UTF-16", "UTF-8"),
        (gzip.compress(b"QGC WPL 110\n", mtime=0), "gzip", "gunzip"),
        (b"\x89PNG\r\n\x1a\n", "picture", ""),
        (b"II*\0\x08\0\0\0", "TIFF", "[terrain] file = "),
        (b"FMT, 128, 89, FMT, BBnNZ\n", "a log of ArduPilot", "replay LOG --shadow"),
        (b"ULog\x01\x12\x35\x01", "a log of PX4", "replay LOG --shadow"),
        (b"\xa3\x95\x80\x80", "a log of ArduPilot", "replay LOG --shadow"),
        (b"\x00\x06\x0a\x24\x18\x1e\x40\x00\xfd\x09", "a log of MAVLink", "--shadow"),
        (b"x\0\1", "no text", "docs/files.md"),
        ('name = "Z\u00fcrich"'.encode("latin-1"), "no text in UTF-8", ""),
    ],
)
def test_what_is_no_mission_is_told_what_it_is_and_where_it_belongs(
    tmp_path: Path, content: str | bytes, what: str, remedy: str
) -> None:
    raw = content if isinstance(content, bytes) else content.encode()
    (tmp_path / "x.txt").write_bytes(raw)
    naming = tmp_path / "mission.toml"
    naming.write_text('plan = "x.txt"\n')
    for load, name in ((load_mission, "x.txt"), (load_world, "x.txt"), (load_mission, naming.name)):
        with pytest.raises(InputError) as caught:
            load(str(tmp_path / name))
        told = str(caught.value)
        assert "TOML:" not in told
        assert what in told, told
        assert remedy in told, told


def test_a_kmz_and_a_recorded_log_are_no_missions(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "zones.kmz", "w") as archive:
        archive.writestr("doc.kml", KML)
    logs = [path for path in RECORDINGS.rglob("*") if path.suffix in (".tlog", ".bin", ".ulg")]
    for path in [tmp_path / "zones.kmz", *logs[:3]]:
        with pytest.raises(InputError) as caught:
            load_mission(str(path))
        assert ("zip" if path.suffix == ".kmz" else "it is a log") in str(caught.value)


def test_zones_named_as_threats_are_read_and_other_files_are_told_what_they_are(
    tmp_path: Path,
) -> None:
    (tmp_path / "fenced.plan").write_bytes((MISSIONS / "fenced.plan").read_bytes())
    toml = tmp_path / "mission.toml"
    toml.write_text('plan = "fenced.plan"\nthreats = "x"\n')
    for content, what in (
        ((MISSIONS / "plane.plan").read_text(), "a plan of QGroundControl"),
        (KML, "it is KML, which is not read. For its zones, make GeoJSON of it: ogr2ogr"),
        ("<a/>", "XML"),
        ("hello", "not JSON"),
        ("", "it is empty"),
        ('{"type": "Topology"}', "it is no GeoJSON FeatureCollection"),
    ):
        (tmp_path / "x").write_text(content)
        with pytest.raises(InputError, match=what):
            load_mission(str(toml))


def test_names_that_are_no_utf_8_are_files_like_others(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"fl\xfcge")
    folder.mkdir()
    plan = (MISSIONS / "fenced.plan").read_bytes()
    waypoints = b"QGC WPL 110\n0 1 0 16 0 0 0 0 47 8 0 1\n1 0 3 16 0 0 0 0 47 8.002 40 1\n"
    for name, content in ((b"pl\xe4n.plan", plan), (b"pl\xe4n", plan), (b"l\xefst", waypoints)):
        path = folder / os.fsdecode(name)
        path.write_bytes(content)
        assert load_mission(str(path)).targets_ne_m
        mission_text(str(path)).encode()
    path.write_bytes(b"<kml>")
    with pytest.raises(InputError) as caught:
        load_mission(str(path))
    assert r"fl\xfcge/l\xefst" in str(caught.value)
    assert str(caught.value).isascii()


def test_so_is_an_elevation_file_and_the_run_folder_names_it(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"h\xf6he")
    folder.mkdir()
    heights_m = np.arange(200.0)[:, None] + np.zeros((200, 200))
    write_elevation(tmp_path / "h.tif", heights_m, (47.05, 7.95), (0.0005, 0.0005))
    (tmp_path / "h.tif").replace(folder / "h.tif")
    lists = b"QGC WPL 110\n0 1 0 16 0 0 0 0 47 8 100 1\n1 0 3 16 0 0 0 0 47 8.002 240 1\n"
    (folder / "x.txt").write_bytes(lists)
    mission = folder / "mission.toml"
    terrain = '[terrain]\nfile = "h.tif"\nvertical_datum = "EGM96"\n'
    mission.write_text(f'plan = "x.txt"\n{terrain}')
    (again := tmp_path / "again.toml").write_text(mission_text(str(mission)), encoding="utf-8")
    first, second = load_mission(str(mission)).known, load_mission(str(again)).known
    assert first is not None
    assert second is not None
    assert np.isfinite(first.upper_m).any()
    assert np.array_equal(first.upper_m, second.upper_m)
    (folder / "h.tif").unlink()
    with pytest.raises(InputError, match="no such file"):
        load_mission(str(again))


@pytest.mark.parametrize("command", [["report"], ["export", "--format", "kml"]])
@pytest.mark.parametrize("suffix", [".tlog", ".bin", ".ulg", ".log", ""])
def test_a_file_in_place_of_a_run_folder_is_told_where_it_belongs(
    tmp_path: Path, command: list[str], suffix: str
) -> None:
    log = tmp_path / f"any{suffix}"
    log.write_bytes(b"\x00\x06\x0a\x24\x18\x1e\x40\x00\xfd\x09")
    code, _, said = answered(command[0], log, *command[1:])
    assert code == 2
    assert "no such folder" not in said
    assert "it is a file" in said
    assert "companion replay LOG --shadow" in said
    assert "companion view LOG" in said
