"""Elevation files: GeoTIFF or SRTM .hgt.  The companion makes the finer checks of the same file."""

import warnings
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import pyproj

from vehicle_sim.errors import InputError
from vehicle_sim.geodesy import FloatArray, LocalFrame
from vehicle_sim.terrain import Area, GridTerrain, Pair, Placed

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
            placed = _placing(dataset)
            must(placed is not None, "is no map that is north up", "Warp it to EPSG:4326.")
            assert placed is not None
            # rows and columns around the area: the first ones, and those after the last
            places = np.stack(placed(latitude, longitude))
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
    return GridTerrain(heights, placed=placed, corner=(top, left), frame=frame, area_m=area_m)


def _placing(dataset: Any) -> Placed | None:
    """Where in a file places lie, from its first cell on; None: it is no map that is north up."""
    east, turned, west, _, south, north = dataset.transform[:6]
    crs = None if dataset.crs is None else pyproj.CRS.from_wkt(dataset.crs.to_wkt())
    flat = crs.sub_crs_list[0] if crs is not None and crs.is_compound else crs
    if flat is None or not (flat.is_projected or flat.is_geographic):
        return None
    if turned or not east > 0.0 > south:
        return None
    to_map = pyproj.Transformer.from_crs(flat.geodetic_crs, flat, always_xy=True)
    middle = west + 0.5 * dataset.width * east

    def placed(latitude_deg: FloatArray, longitude_deg: FloatArray) -> Pair:
        x, y = to_map.transform(longitude_deg, latitude_deg)
        if flat.is_geographic:
            x = middle + (x - middle + 180.0) % 360.0 - 180.0
        return (y - north) / south - 0.5, (x - west) / east - 0.5

    return placed
