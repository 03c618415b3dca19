"""Elevation files for tests."""

from pathlib import Path
from typing import Any

import rasterio
from numpy.typing import NDArray
from rasterio.transform import Affine


def write_elevation(
    path: Path, heights_m: NDArray[Any], north_west_deg: tuple[float, float], step_deg: float
) -> None:
    """A GeoTIFF in WGS84, rows to the south; north_west_deg: of the middle of its first cell."""
    north, west = north_west_deg[0] + 0.5 * step_deg, north_west_deg[1] - 0.5 * step_deg
    rows, columns = heights_m.shape
    size: Any = {"height": rows, "width": columns, "count": 1, "dtype": heights_m.dtype}
    at = Affine(step_deg, 0.0, west, 0.0, -step_deg, north)
    with rasterio.open(path, "w", driver="GTiff", crs="EPSG:4326", transform=at, **size) as file:
        file.write(heights_m, 1)
