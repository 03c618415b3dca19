"""Elevation files of the world: GeoTIFF and SRTM .hgt, opened by rasterio only if one is named.

The companion, which plans by the same file, makes the finer checks of it.
"""

import importlib
import math
import warnings
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from vehicle_sim.errors import InputError
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.grid import Area, GridTerrain

VerticalDatum = Literal["AMSL", "EGM84", "EGM96", "EGM2008", "NAVD88", "NGVD29", "EVRF"]
_SPARE = 0.02
"""Of a cell: the border of the area bends between the places of it that are looked at."""


def read_grid(
    path: Path, frame: LocalFrame, area_m: Area, nodata: Literal["sea"] | float | None
) -> GridTerrain:
    """The terrain of an area; InputError says what is wrong with the file."""
    if not path.is_file():
        raise _refusal(path, "there is no such file", "Name a GeoTIFF or an SRTM .hgt.")
    try:
        rasterio = importlib.import_module("rasterio")
    except ImportError:
        raise _refusal(path, "rasterio is not installed", "Install it.") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            is_hgt = path.suffix.lower() == ".hgt"
            dataset = rasterio.open(path, driver="SRTMHGT" if is_hgt else "GTiff")
        with dataset:
            a, turned, west_deg, _, e, north_deg = dataset.transform[:6]
            if dataset.crs is None or not dataset.crs.is_geographic or turned or not a > 0.0 > e:
                rule = "is not of latitude and longitude, north up"
                raise _refusal(path, rule, "Warp it to EPSG:4326.")
            top, left, bottom, right = _needed(dataset, frame, area_m, path)
            raw = dataset.read(1, window=((top, bottom), (left, right)), masked=True)
    except rasterio.errors.RasterioError as error:
        reason = " ".join(str(error).split())
        raise _refusal(path, f"cannot be read ({reason})", "Name a GeoTIFF.") from None
    return GridTerrain.of(
        _without_holes(raw, nodata, path),
        north_deg=north_deg + (top + 0.5) * e,
        west_deg=west_deg + (left + 0.5) * a,
        step_deg=(-e, a),
        frame=frame,
        area_m=area_m,
    )


def _refusal(path: Path, rule: str, remedy: str) -> InputError:
    return InputError("terrain.file", str(path), rule, remedy)


def _needed(dataset: Any, frame: LocalFrame, area_m: Area, path: Path) -> tuple[int, int, int, int]:
    """The part of the file around the area: first row and column, and those after the last."""
    north, east = np.meshgrid(np.linspace(*area_m[:2], 33), np.linspace(*area_m[2:], 33))
    latitude, longitude = frame.to_geographic_many(north.ravel(), east.ravel())
    a, _, c, _, e, f = dataset.transform[:6]
    east_of_middle = (longitude - c - 0.5 * dataset.width * a + 180.0) % 360.0 - 180.0
    places = np.stack([(latitude - f) / e, east_of_middle / a + 0.5 * dataset.width])
    top, left = (math.floor(each.min() - 0.5 - _SPARE) for each in places)
    bottom, right = (math.ceil(each.max() - 0.5 + _SPARE) + 1 for each in places)
    if min(top, left) < 0 or bottom > dataset.height or right > dataset.width:
        raise _refusal(path, "does not cover [area]", "Make [area] smaller.")
    return top, left, bottom, right


def _without_holes(raw: Any, nodata: Literal["sea"] | float | None, path: Path) -> NDArray[Any]:
    """Heights without holes."""
    holes = np.ma.getmaskarray(raw) | ~np.isfinite(raw.data)
    heights: NDArray[Any] = raw.data
    if holes.any():
        if nodata is None:
            remedy = 'Say what is there: nodata = "sea", or a height AMSL.'
            raise _refusal(path, f"has {int(holes.sum())} points without height in [area]", remedy)
        heights = heights.astype(np.float32)
        heights[holes] = 0.0 if nodata == "sea" else nodata
    return heights
