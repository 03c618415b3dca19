"""Plans and lists are told by what is in them; other files are refused, whatever their names."""

import gzip
import os
from pathlib import Path

import numpy as np
import pytest
from answers import answered
from geotiff import write_elevation

from companion.config import load_mission, load_world, mission_text
from companion.errors import InputError

MISSIONS = Path(__file__).parent / "missions"


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
    ("content", "what"),
    [
        (b"", "it is missing"),
        (b"<!DOCTYPE html><html>", "not TOML"),
        (b'{"type": "FeatureCollection", "features": []}', "not TOML"),
        ('schema = 1\nname = "x"\n'.encode("utf-16"), "no text in UTF-8"),
        (gzip.compress(b"QGC WPL 110\n", mtime=0), "no text in UTF-8"),
        (b"\x00\x06\x0a\x24\x18\x1e\x40\x00\xfd\x09", "no text in UTF-8"),
        (b"x\0\1", "not TOML"),
    ],
)
def test_what_is_no_mission_world_plan_or_zones_is_refused_in_one_line(
    tmp_path: Path, content: bytes, what: str
) -> None:
    (tmp_path / "x.txt").write_bytes(content)
    for load in (load_mission, load_world):
        with pytest.raises(InputError, match=what) as caught:
            load(str(tmp_path / "x.txt"))
        assert "\n" not in str(caught.value)
    toml = tmp_path / "mission.toml"
    fenced = MISSIONS / "fenced.plan"
    for text in ('plan = "x.txt"\n', f'plan = "{fenced}"\nthreats = "x.txt"\n'):
        toml.write_text(text)
        if b"Feature" not in content or "threats" not in text:
            with pytest.raises(InputError, match=r"no text in UTF-8|not JSON|no QGroundControl"):
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
    write_elevation(tmp_path / "h.tif", heights_m, (47.05, 7.95), 0.0005)
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
