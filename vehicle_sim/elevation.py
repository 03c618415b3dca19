"""Elevation files: GeoTIFF or SRTM .hgt.  The companion makes the finer checks of the same file."""

import warnings
from pathlib import Path
from typing import Final, Literal

import numpy as np

from vehicle_sim.errors import InputError
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.terrain import Area, GridTerrain

_SPARE: Final = 0.02
"""Of a cell: the border of the area bends between the places of it that are looked at."""


def read_grid(
    path: Path, frame: LocalFrame, area_m: Area, nodata: Literal["sea"] | float | None
) -> GridTerrain:
    """The terrain of an area; InputError says what is wrong with the file."""
    import rasterio  # only if a file is named: it takes a while

    def must(holds: bool, rule: str, remedy: str) -> None:
        if not holds:
            raise InputError("terrain.file", str(path), rule, remedy)

    must(path.is_file(), "there is no such file", "Name a GeoTIFF or an SRTM .hgt.")
    north, east = np.meshgrid(np.linspace(*area_m[:2], 33), np.linspace(*area_m[2:], 33))
    latitude, longitude = frame.to_geographic_many(north.ravel(), east.ravel())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            driver = "SRTMHGT" if path.suffix.lower() == ".hgt" else "GTiff"
            dataset = rasterio.open(path, driver=driver)
        with dataset:
            a, turned, west_deg, _, e, north_deg = dataset.transform[:6]
            is_level = dataset.crs is not None and dataset.crs.is_geographic and not turned
            rule = "is not of latitude and longitude, north up"
            must(is_level and a > 0.0 > e, rule, "Warp it to EPSG:4326.")
            # rows and columns around the area: the first ones, and those after the last
            half_deg = 0.5 * dataset.width * a
            east_deg = (longitude - west_deg - half_deg + 180.0) % 360.0 - 180.0
            places = np.stack([(latitude - north_deg) / e, (east_deg + half_deg) / a]) - 0.5
            top, left = np.floor(places.min(axis=1) - _SPARE).astype(int).tolist()
            bottom, right = np.ceil(places.max(axis=1) + _SPARE).astype(int).tolist()
            covered = min(top, left) >= 0 and bottom < dataset.height and right < dataset.width
            must(covered, "does not cover [area]", "Make [area] smaller.")
            raw = dataset.read(1, window=((top, bottom + 1), (left, right + 1)), masked=True)
    except rasterio.errors.RasterioError as error:
        rule = f"cannot be read ({' '.join(str(error).split())})"
        raise InputError("terrain.file", str(path), rule, "Name a GeoTIFF.") from None
    heights, holes = raw.data, np.ma.getmaskarray(raw) | ~np.isfinite(raw.data)
    if holes.any():
        remedy = 'Say what is there: nodata = "sea", or a height AMSL.'
        rule = f"has {int(holes.sum())} points without height in [area]"
        must(nodata is not None, rule, remedy)
        heights = heights.astype(np.float32)
        heights[holes] = 0.0 if nodata == "sea" else nodata
    return GridTerrain(
        heights,
        north_deg=north_deg + (top + 0.5) * e,
        west_deg=west_deg + (left + 0.5) * a,
        step_deg=(-e, a),
        frame=frame,
        area_m=area_m,
    )
