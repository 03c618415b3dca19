from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.transform import Affine

from vehicle_sim.elevation import read_grid
from vehicle_sim.errors import InputError
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.grid import GridTerrain
from vehicle_sim.world import read_world

VALLEY = Path(__file__).parents[2] / "companion" / "environments" / "valley"
FRAME = LocalFrame(latitude_deg=46.5, longitude_deg=8.5)
AREA = (-2_000.0, 3_000.0, -4_000.0, 1_500.0)
STEP = 1 / 1200


def heights() -> NDArray[np.int16]:
    return np.random.default_rng(3).integers(300, 2_000, (120, 150)).astype(np.int16)


def written(path: Path, data: NDArray[Any], **changes: Any) -> Path:
    """A file whose middle is FRAME's origin."""
    profile: dict[str, Any] = {
        "driver": "GTiff",
        "crs": "EPSG:4326",
        "transform": Affine(STEP, 0, 8.5 - 75 * STEP, 0, -STEP, 46.5 + 60 * STEP),
        "dtype": data.dtype,
        "count": 1,
        "height": data.shape[0],
        "width": data.shape[1],
    }
    with rasterio.open(path, "w", **(profile | changes)) as file:
        file.write(data, 1)
    return path


def read(path: Path, nodata: Any = None) -> GridTerrain:
    return read_grid(path, FRAME, AREA, nodata)


def refused(path: Path, nodata: Any = None) -> str:
    with pytest.raises(InputError) as caught:
        read(path, nodata)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("terrain.file = ")
    return message


def test_a_point_of_the_file_is_where_the_file_says(tmp_path: Path) -> None:
    data = heights()
    terrain = read(written(tmp_path / "terrain.tif", data))
    for row, column in ((50, 60), (60, 75), (45, 80)):
        latitude = 46.5 + (60 - row - 0.5) * STEP
        longitude = 8.5 + (column + 0.5 - 75) * STEP
        north, east = FRAME.to_local(latitude, longitude)
        assert terrain.height_at_amsl_m(north, east) == pytest.approx(data[row, column], abs=0.1)


def test_an_srtm_tile_is_read_by_its_name(tmp_path: Path) -> None:
    data = np.random.default_rng(5).integers(100, 3_000, (1201, 1201)).astype(">i2")
    path = tmp_path / "N46E008.hgt"
    path.write_bytes(data.tobytes())
    north, east = FRAME.to_local(47.0 - 615 / 1200, 8.0 + 580 / 1200)
    assert read(path).height_at_amsl_m(north, east) == pytest.approx(data[615, 580], abs=0.1)


def test_holes_are_an_error_unless_the_world_says_what_lies_there(tmp_path: Path) -> None:
    data = heights().astype(np.float32)
    data[60, 70], data[61, 70], data[0, 0] = -9999.0, np.nan, -9999.0
    path = written(tmp_path / "terrain.tif", data, nodata=-9999.0)
    assert "2 points without height" in refused(path)
    assert (read(path, "sea").heights_m == 0.0).sum() == 2
    assert (read(path, 12.5).heights_m == 12.5).sum() == 2


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"crs": "EPSG:32632"}, "latitude and longitude"),
        ({"crs": None}, "latitude and longitude"),
        ({"transform": Affine(STEP, 1e-5, 8.4, 0, -STEP, 46.6)}, "north up"),
        ({"transform": Affine(STEP, 0, 8.4, 0, STEP, 46.4)}, "north up"),
        ({"transform": Affine(STEP, 0, 8.49, 0, -STEP, 46.55)}, "does not cover [area]"),
        ({"transform": Affine(STEP, 0, 8.39, 0, -STEP, 46.55)}, "does not cover [area]"),
    ],
    ids=str,
)
def test_what_cannot_be_flown_over_is_refused_in_one_line(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    assert words in refused(written(tmp_path / "terrain.tif", heights(), **changes))


def test_what_is_no_elevation_file_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "terrain.tif"
    other.write_text("nothing")
    assert "cannot be read" in refused(other)
    assert "no such file" in refused(Path("/vsicurl/http://127.0.0.1/terrain.tif"))


def test_the_bundled_valley_stands_on_low_ground_between_ridges() -> None:
    terrain = read_world(VALLEY / "world.toml").truth()
    assert 380.0 < terrain.height_at_amsl_m(2_350.0, -3_350.0) < 430.0
    assert terrain.height_at_amsl_m(-750.0, -3_500.0) > 700.0
