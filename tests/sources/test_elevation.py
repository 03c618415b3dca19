"""Elevation files: heights where they are, or one line that says why not."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from geotiff import square, write_elevation
from numpy.typing import NDArray
from rasterio.transform import Affine
from scipy.interpolate import RegularGridInterpolator
from spoiled import refusal

from companion.config import load_world
from companion.errors import InputError
from companion.geodesy import LocalFrame
from companion.sources.elevation import ElevationTable
from companion.world.terrain import GridTerrain
from vehicle_sim.world import read_world

VALLEY = Path(__file__).parents[2] / "companion" / "environments" / "valley"
FRAME = LocalFrame(latitude_deg=46.5, longitude_deg=8.5)
AREA = ((-2_000.0, 3_000.0), (-4_000.0, 1_500.0))
STEP = 1 / 1200
Make = Callable[..., Path]


def heights(rows: int = 120, columns: int = 150) -> NDArray[np.int16]:
    return np.random.default_rng(3).integers(300, 2_000, (rows, columns)).astype(np.int16)


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """A GeoTIFF whose middle is FRAME's origin, with the changes wanted."""

    def made(data: NDArray[Any] | None = None, **changes: Any) -> Path:
        data = heights() if data is None else data
        height, width = (0.5 * (count - 1) * STEP for count in data.shape)
        path = tmp_path / "terrain.tif"
        write_elevation(path, data, (46.5 + height, 8.5 - width), STEP, **changes)
        return path

    return made


def read(path: Path, **changes: Any) -> GridTerrain:
    usual = {"vertical_datum": "EGM96", "nodata": None}
    return ElevationTable(file=str(path), **(usual | changes)).terrain(Path(), FRAME, AREA)


def refused(path: Path, **changes: Any) -> str:
    told = refusal(lambda path, changes: read(path, **changes), path, changes)
    assert told.startswith("terrain.file = ")
    return told


@pytest.mark.parametrize(
    ("dtype", "crs"),
    [
        ("int16", "EPSG:4326"),
        ("float32", "EPSG:4269"),
        ("uint16", "EPSG:4258"),
        ("int16", "EPSG:9707"),
    ],
)
def test_it_is_bilinear_between_middles_of_cells(make: Make, dtype: str, crs: str) -> None:
    """Also in datums that agree with WGS84 to a metre or two."""
    data = heights().astype(dtype)
    terrain = read(make(data, crs=crs))
    rows, columns = data.shape
    latitudes = 46.5 + (0.5 * rows - 0.5 - np.arange(rows)) * STEP
    longitudes = 8.5 + (np.arange(columns) + 0.5 - 0.5 * columns) * STEP
    surface = RegularGridInterpolator((latitudes[::-1], longitudes), data[::-1].astype(float))
    rng = np.random.default_rng(1)
    north, east = (rng.uniform(low, high, 300) for low, high in AREA)
    places = [FRAME.to_geodetic_deg(n, e) for n, e in zip(north, east, strict=True)]
    np.testing.assert_allclose(terrain.height_m(north, east), surface(places), rtol=0, atol=1e-4)


def test_only_the_window_of_the_area_is_read_of_a_file_of_100_million_cells(tmp_path: Path) -> None:
    path, at = tmp_path / "terrain.tif", square(8.0, 47.0, 1 / 10_000)
    how: Any = {"driver": "GTiff", "crs": "EPSG:4326", "dtype": "int16", "count": 1}
    size: Any = {"height": 10_000, "width": 10_000, "tiled": True, "sparse_ok": True}
    rasterio.open(path, "w", transform=at, **how, **size).close()
    terrain = read(path)
    assert terrain.heights_m.size < 600 * 900
    assert terrain.height_m(np.zeros(1), np.zeros(1)).tolist() == [0.0]


def test_an_srtm_tile_is_read_by_its_name(tmp_path: Path) -> None:
    data = np.random.default_rng(5).integers(100, 3_000, (1201, 1201)).astype(">i2")
    path = tmp_path / "N46E008.hgt"
    path.write_bytes(data.tobytes())
    terrain = read(path)
    rows, columns = np.array([(590, 570), (600, 600), (615, 580)]).T  # row 0 at 47 N
    north, east = FRAME.to_local_m(47.0 - rows / 1200, 8.0 + columns / 1200)
    assert terrain.height_m(north, east) == pytest.approx(data[rows, columns], abs=0.05)


@pytest.mark.parametrize(
    ("hole", "nodata", "filled"), [(-9999.0, "sea", 0.0), (math.nan, 0.5, 0.5)]
)
def test_holes_are_filled_or_refused(make: Make, hole: float, nodata: Any, filled: float) -> None:
    """Outside of the area they do not matter."""
    data = heights().astype(np.float32)
    data[0, 0] = -9999
    assert read(make(data, nodata=-9999)).heights_m.min() >= 300
    data[60:62, 70:72] = hole
    path = make(data, nodata=-9999)
    message = refused(path)
    assert "4 of its cells in [area] have no height" in message
    assert 'terrain.nodata = "sea"' in message
    terrain = read(path, nodata=nodata)
    assert (terrain.heights_m == filled).sum() == 4
    assert terrain.heights_m.min() == filled


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"crs": "EPSG:32632"}, "UTM zone 32N.*EPSG:4326"),
        ({"crs": "EPSG:4267"}, "NAD27.*not latitude and longitude of WGS84"),
        ({"crs": "EPSG:4979"}, "above the ellipsoid"),
        (
            {"crs": "EPSG:9707"},
            "EGM96.*not NAVD88.*terrain.vertical_datum|terrain.vertical_datum.*EGM96.*not NAVD88",
        ),
        ({"crs": None}, "does not say which coordinates"),
        ({"transform": Affine(STEP, 1e-5, 8.4, 0, -STEP, 46.6)}, "from north to south"),
        ({"transform": Affine(STEP, 0, 8.4, 0, STEP, 46.4)}, "from north to south"),
        ({"transform": square(8.0, 47.0, 0.01)}, "1113 m are coarser than 500 m"),
        (
            {"transform": square(8.49, 46.55, STEP)},
            r"2912 of its cells in \[area\] .*beyond its edge.*smaller",
        ),
        ({"count": 3}, "not one band"),
        ({"units": "ft"}, "in ft"),
        ({"scale": 0.1}, "scaled"),
        ({"data": heights() * np.int16(10)}, "not this earth"),
    ],
    ids=str,
)
def test_odd_files_are_refused(make: Make, changes: dict[str, Any], words: str) -> None:
    assert re.search(words, refused(make(**changes), vertical_datum="NAVD88"))


def test_what_is_no_elevation_file_or_absent_is_refused(tmp_path: Path) -> None:
    for name in ("terrain.tif", "N46E008.hgt"):
        (tmp_path / name).write_bytes(b"\0" * 100)
        assert "cannot be read" in refused(tmp_path / name)
    for absent in (tmp_path / "absent.tif", Path("/vsicurl/http://127.0.0.1/terrain.tif")):
        assert "no such file" in refused(absent)


@pytest.mark.parametrize(
    ("was", "becomes", "words"),
    [
        ('vertical_datum = "AMSL"', 'vertical_datum = "WGS84"', "vertical_datum.*'NAVD88'"),
        ('vertical_datum = "AMSL"', "", "vertical_datum.*missing"),
        ("north_max_m = 5200.0", "north_max_m = -6000.0", "area.north_max_m.*Swap"),
        ("north_max_m = 5200.0", "north_max_m = 55000.0", r"terrain.file.*beyond its edge"),
        ("[area]", "[region]", "area.*it is missing"),
    ],
)
def test_open_worlds_are_refused(tmp_path: Path, was: str, becomes: str, words: str) -> None:
    text = (VALLEY / "world.toml").read_text(encoding="utf-8")
    assert was in text
    (tmp_path / "world.toml").write_text(text.replace(was, becomes, 1), encoding="utf-8")
    (tmp_path / "terrain.tif").write_bytes((VALLEY / "terrain.tif").read_bytes())
    with pytest.raises(InputError, match=words):
        load_world(str(tmp_path / "world.toml"))


def test_both_programs_read_the_same_heights_to_a_centimetre() -> None:
    rng = np.random.default_rng(6)
    north, east = rng.uniform(-5_200, 5_200, 10_000), rng.uniform(-4_200, 3_700, 10_000)
    ours, theirs = load_world("valley").terrain, read_world(VALLEY / "world.toml").truth()
    off_m = ours.height_m(north, east) - theirs.height_amsl_m(north, east)
    assert np.abs(off_m).max() < 0.01
