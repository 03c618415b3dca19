"""Both kinds of terrain: what they are by closed form and by scipy, and how files of them are read.

That their bounds hold is seen by test_radar.py: what it hides is hidden.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from harness import placed
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pyproj import Geod
from rasterio.transform import Affine
from scipy.interpolate import RegularGridInterpolator

from vehicle_sim.elevation import read_grid
from vehicle_sim.errors import InputError
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.terrain import GridTerrain, PeakTerrain

WGS84 = Geod(ellps="WGS84")
STEP, HALF_M = (1 / 1200, 1 / 1200), 3_000.0
PLACES = ((0.0, 0.0), (36.5, -84.3), (-47.0, 179.99), (62.0, -180.0))
ROWS, COLUMNS = 100, 160


def test_a_single_peak_is_equation_1_over_the_ground() -> None:
    peak = (1000.0, 2000.0, 900.0, 300.0, 500.0)
    terrain = PeakTerrain([peak], combine="maximum", ground_amsl_m=100.0)
    assert terrain.height_at_amsl_m(1000.0, 2000.0) == 900.0
    for place in ((1300.0, 2000.0), (1000.0, 2500.0)):
        assert terrain.height_at_amsl_m(*place) == pytest.approx(900.0 / np.e)
    assert terrain.height_at_amsl_m(9000.0, 9000.0) == 100.0
    twice = PeakTerrain([peak, peak], combine="sum", ground_amsl_m=0.0)
    assert twice.height_at_amsl_m(1000.0, 2000.0) == 1800.0


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6), place=st.sampled_from(PLACES))
def test_the_grid_is_bilinear_in_latitude_and_longitude_and_goes_on_beyond_its_edge(
    seed: int, place: tuple[float, float]
) -> None:
    rng = np.random.default_rng(seed)
    terrain = GridTerrain(
        rng.integers(200, 320, (ROWS, COLUMNS)).astype(np.int16),
        north_deg=place[0] + 0.5 * ROWS * STEP[0],
        west_deg=place[1] - 0.5 * COLUMNS * STEP[1],
        step_deg=STEP,
        frame=LocalFrame(**placed(place, height=False)),
        area_m=(-HALF_M, HALF_M, -HALF_M, HALF_M),
    )
    north, east = rng.uniform(-HALF_M, HALF_M, (2, 200))
    azimuth, ones = np.degrees(np.arctan2(east, north)), np.ones(200)
    start = (place[1] * ones, place[0] * ones)
    longitude, latitude, _ = WGS84.fwd(*start, azimuth, np.hypot(north, east))
    east_deg = (longitude - place[1] + 180.0) % 360.0 - 180.0
    rows_deg = (np.arange(ROWS) + 1 - 0.5 * ROWS) * STEP[0]
    columns_deg = (np.arange(COLUMNS) - 0.5 * COLUMNS) * STEP[1]
    heights = terrain.heights_m[::-1].astype(float)
    surface = RegularGridInterpolator((rows_deg, columns_deg), heights)
    expected = surface(np.stack([latitude - place[0], east_deg], axis=-1))
    # 1 cm: a way of 250 m between the places of the table bends by 1 mm and slopes are up to 2
    np.testing.assert_allclose(terrain.height_amsl_m(north, east), expected, rtol=0, atol=0.01)
    assert terrain.height_at_amsl_m(north[0], east[0]) == pytest.approx(expected[0], abs=0.01)
    edge_m = terrain.height_at_amsl_m(HALF_M, -HALF_M)
    assert terrain.height_at_amsl_m(9e4, -9e4) == edge_m


# --- files ----------------------------------------------------------------------------------------

FRAME = LocalFrame(latitude_deg=46.5, longitude_deg=8.5)
AREA = (-2_000.0, 3_000.0, -4_000.0, 1_500.0)
DATA = np.random.default_rng(3).integers(300, 2_000, (120, 150)).astype(np.int16)


def placing(west_deg: float, north_deg: float, turn: float = 0.0, down: float = -1.0) -> Affine:
    return Affine(STEP[0], turn, west_deg, 0, down * STEP[0], north_deg)


def written(path: Path, data: NDArray[Any] = DATA, **changes: Any) -> Path:
    """A file whose middle is FRAME's origin."""
    placed = placing(8.5 - 75 * STEP[0], 46.5 + 60 * STEP[0])
    profile: dict[str, Any] = {"driver": "GTiff", "crs": "EPSG:4326", "transform": placed}
    profile |= {"dtype": data.dtype, "count": 1, "height": data.shape[0], "width": data.shape[1]}
    with rasterio.open(path, "w", **(profile | changes)) as file:
        file.write(data, 1)
    return path


def read(path: Path, nodata: Any = None) -> GridTerrain:
    return read_grid(path, FRAME, AREA, nodata)


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("terrain.file = ")
    return message


def test_a_point_of_the_file_is_where_the_file_or_its_name_says(tmp_path: Path) -> None:
    terrain = read(written(tmp_path / "terrain.tif"))
    for row, column in ((50, 60), (60, 75), (45, 80)):
        latitude = 46.5 + (60 - row - 0.5) * STEP[0]
        longitude = 8.5 + (column + 0.5 - 75) * STEP[0]
        height_m = terrain.height_at_amsl_m(*FRAME.to_local(latitude, longitude))
        assert height_m == pytest.approx(DATA[row, column], abs=0.1)
    tile = np.random.default_rng(5).integers(100, 3_000, (1201, 1201)).astype(">i2")
    path = tmp_path / "N46E008.hgt"  # of SRTM
    path.write_bytes(tile.tobytes())
    there = FRAME.to_local(47.0 - 615 / 1200, 8.0 + 580 / 1200)
    assert read(path).height_at_amsl_m(*there) == pytest.approx(tile[615, 580], abs=0.1)


def test_holes_are_an_error_unless_the_world_says_what_lies_there(tmp_path: Path) -> None:
    data = DATA.astype(np.float32)
    data[60, 70], data[61, 70], data[0, 0] = -9999.0, np.nan, -9999.0
    path = written(tmp_path / "terrain.tif", data, nodata=-9999.0)
    assert "2 points without height" in refused(path)
    assert (read(path, "sea").heights_m == 0.0).sum() == 2
    assert (read(path, 12.5).heights_m == 12.5).sum() == 2


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"crs": "EPSG:32632"}, "latitude and longitude"),
        ({"transform": placing(8.4, 46.6, turn=1e-5)}, "north up"),
        ({"transform": placing(8.4, 46.4, down=1.0)}, "north up"),
        ({"transform": placing(8.49, 46.55)}, "does not cover [area]"),
    ],
    ids=str,
)
def test_what_cannot_be_flown_over_is_refused_in_one_line(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    assert words in refused(written(tmp_path / "terrain.tif", **changes))


def test_what_is_no_elevation_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "terrain.tif").write_text("nothing")
    assert "cannot be read" in refused(tmp_path / "terrain.tif")
    assert "no such file" in refused(Path("/vsicurl/http://127.0.0.1/terrain.tif"))
