"""Elevation files: heights where they are; refused: `test_refusals`."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from documents import HEIGHTS_M, STEP_DEG, refusal, terrain
from pyproj import CRS
from rasterio.transform import Affine
from rasterio.warp import transform
from scipy.ndimage import map_coordinates

from companion.geodesy import LocalFrame
from companion.sources.elevation import ElevationTable, KnownElevationTable
from companion.world.known_map import empty_map
from companion.world.terrain import GridTerrain
from vehicle_sim import geodesy
from vehicle_sim.elevation import read_grid

FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
AREA = ((-2_000.0, 3_000.0), (-4_000.0, 1_500.0))


def read(path: Path, nodata: Any = None, frame: LocalFrame = FRAME) -> GridTerrain:
    table = ElevationTable(file=str(path), vertical_datum="EGM96", nodata=nodata)
    return table.terrain(frame, AREA)


@pytest.mark.parametrize(
    ("epsg", "dtype"),
    [
        # in degrees, of datums that agree with WGS84 to a metre or two
        *((4326, "int16"), (4269, "float32"), (4258, "uint16"), (9707, "int16")),
        *((epsg, "int16") for epsg in (32632, 3035, 2263, 3857, 3413)),
    ],
)
def test_a_file_of_any_map_is_read_where_gdal_places_it_by_both_programs(
    tmp_path: Path, epsg: int, dtype: str
) -> None:
    """Of metres or feet, conformal or not, turned by any angle; no map of it is lower anywhere."""
    axis = CRS(epsg).axis_info[0]
    [x], [y] = transform("EPSG:4326", f"EPSG:{epsg}", [8.0], [47.0])
    step = STEP_DEG if axis.unit_name == "degree" else 90.0 / axis.unit_conversion_factor
    rows, columns = HEIGHTS_M.shape
    at = (step, 0.0, x - 0.5 * columns * step, 0.0, -step, y + 0.5 * rows * step)
    terrain(tmp_path / "x.tif", HEIGHTS_M.astype(dtype), crs=f"EPSG:{epsg}", transform=at)
    north, east = (np.random.default_rng(7).uniform(*side, 300) for side in AREA)
    latitude, longitude = FRAME.to_geodetic_deg(north, east)
    placed = transform("EPSG:4326", f"EPSG:{epsg}", longitude, latitude)
    across, down = (np.array(placed[0]) - at[2]) / step, (at[5] - np.array(placed[1])) / step
    gdals = map_coordinates(HEIGHTS_M.astype(float), [down - 0.5, across - 0.5], order=1)
    ours = read(tmp_path / "x.tif").height_m(north, east)
    np.testing.assert_allclose(ours, gdals, rtol=0, atol=1e-3)
    frame = geodesy.LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
    theirs = read_grid(tmp_path / "x.tif", frame, (*AREA[0], *AREA[1]), None)
    np.testing.assert_allclose(theirs.height_amsl_m(north, east), gdals, rtol=0, atol=0.02)
    known = KnownElevationTable(
        file=str(tmp_path / "x.tif"), vertical_datum="EGM96", datum_error_m=0
    )
    blank = empty_map(40.0, *AREA)
    upper_m = known.upper_m(FRAME, blank)
    cells = [blank.cell_of(n, e) for n, e in zip(north, east, strict=True)]
    assert (upper_m[tuple(np.transpose(cells))] >= gdals).all()


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
