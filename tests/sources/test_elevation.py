"""Elevation files: heights where they are; refused: `test_refusals`."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from documents import ENVIRONMENTS, HEIGHTS_M, STEP_DEG, refusal, terrain
from rasterio.transform import Affine
from scipy.interpolate import RegularGridInterpolator

from companion.config import load_world
from companion.geodesy import LocalFrame
from companion.sources.elevation import ElevationTable
from companion.world.terrain import GridTerrain
from vehicle_sim.world import read_world

FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
AREA = ((-2_000.0, 3_000.0), (-4_000.0, 1_500.0))


def read(path: Path, nodata: Any = None, frame: LocalFrame = FRAME) -> GridTerrain:
    table = ElevationTable(file=str(path), vertical_datum="EGM96", nodata=nodata)
    return table.terrain(Path(), frame, AREA)


@pytest.mark.parametrize(
    ("dtype", "crs"),
    [("int16", 4326), ("float32", 4269), ("uint16", 4258), ("int16", 9707)],
)
def test_it_is_bilinear_between_middles_of_cells(tmp_path: Path, dtype: str, crs: int) -> None:
    """Also in datums that agree with WGS84 to a metre or two."""
    terrain(tmp_path / "x.tif", HEIGHTS_M.astype(dtype), crs=f"EPSG:{crs}")
    rows, columns = map(np.arange, HEIGHTS_M.shape)
    latitudes, longitudes = 47.0 + (99.5 - rows) * STEP_DEG, 8.0 + (columns - 119.5) * STEP_DEG
    surface = RegularGridInterpolator((latitudes[::-1], longitudes), HEIGHTS_M[::-1].astype(float))
    rng = np.random.default_rng(1)
    north, east = (rng.uniform(low, high, 300) for low, high in AREA)
    places = [FRAME.to_geodetic_deg(n, e) for n, e in zip(north, east, strict=True)]
    found = read(tmp_path / "x.tif").height_m(north, east)
    np.testing.assert_allclose(found, surface(places), rtol=0, atol=1e-4)


def test_only_the_window_of_the_area_is_read_of_a_file_of_100_million_cells(tmp_path: Path) -> None:
    path, at = tmp_path / "terrain.tif", Affine(1e-4, 0, 7.5, 0, -1e-4, 47.5)
    how: Any = {"driver": "GTiff", "crs": "EPSG:4326", "dtype": "int16", "count": 1}
    size: Any = {"height": 10_000, "width": 10_000, "tiled": True, "sparse_ok": True}
    rasterio.open(path, "w", transform=at, **how, **size).close()
    found = read(path)
    assert found.heights_m.size < 600 * 900
    assert found.height_m(np.zeros(1), np.zeros(1)).tolist() == [0.0]


def test_an_srtm_tile_is_read_by_its_name(tmp_path: Path) -> None:
    data = np.random.default_rng(5).integers(100, 3_000, (1201, 1201)).astype(">i2")
    path, frame = tmp_path / "N46E008.hgt", LocalFrame(latitude_deg=46.5, longitude_deg=8.5)
    path.write_bytes(data.tobytes())
    rows, columns = np.array([(590, 570), (600, 600), (615, 580)]).T  # row 0 at 47 N
    north, east = frame.to_local_m(47.0 - rows / 1200, 8.0 + columns / 1200)
    found = read(path, frame=frame).height_m(north, east)
    assert found == pytest.approx(data[rows, columns], abs=0.05)


@pytest.mark.parametrize(
    ("hole", "nodata", "filled"), [(-9999.0, "sea", 0.0), (math.nan, 0.5, 0.5)]
)
def test_holes_are_filled_or_refused(
    tmp_path: Path, hole: float, nodata: Any, filled: float
) -> None:
    """Outside of the area they do not matter."""
    path, data = tmp_path / "x.tif", HEIGHTS_M.astype(np.float32)
    data[0, 0] = hole
    terrain(path, data, nodata=-9999)
    assert read(path).heights_m.min() >= 300
    data[100:102, 119:121] = hole
    terrain(path, data, nodata=-9999)
    assert "4 of its cells in [area] have no height" in refusal(read, path)
    found = read(path, nodata)
    assert (found.heights_m == filled).sum() == 4
    assert found.heights_m.min() == filled


def test_both_programs_read_the_same_heights_to_a_centimetre() -> None:
    rng = np.random.default_rng(6)
    north, east = rng.uniform(-5_200, 5_200, 10_000), rng.uniform(-4_200, 3_700, 10_000)
    ours = load_world("valley").terrain.height_m(north, east)
    theirs = read_world(ENVIRONMENTS / "valley" / "world.toml").truth().height_amsl_m(north, east)
    assert np.abs(ours - theirs).max() < 0.01
