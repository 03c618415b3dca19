"""Elevation files for tests."""

from pathlib import Path
from typing import Any

import rasterio
from numpy.typing import NDArray
from rasterio.transform import Affine


def write_elevation(
    path: Path,
    heights_m: NDArray[Any],
    north_west_deg: tuple[float, float],
    step_deg: float,
    *,
    units: str = "",
    scale: float = 1.0,
    **changes: Any,
) -> None:
    """A GeoTIFF in WGS84, rows to the south; north_west_deg: of the middle of its first cell."""
    north, west = north_west_deg[0] + 0.5 * step_deg, north_west_deg[1] - 0.5 * step_deg
    rows, columns = heights_m.shape
    usual = {"height": rows, "width": columns, "count": 1, "dtype": heights_m.dtype}
    usual |= {"crs": "EPSG:4326", "transform": square(west, north, step_deg), "driver": "GTiff"}
    with rasterio.open(path, "w", **(usual | changes)) as file:
        for band in range(file.count):
            file.write(heights_m, band + 1)
        file.units, file.scales = [units] * file.count, [scale] * file.count


def square(west_deg: float, north_deg: float, step_deg: float) -> Affine:
    """Where its cells lie, from the north-western corner."""
    return Affine(step_deg, 0.0, west_deg, 0.0, -step_deg, north_deg)
