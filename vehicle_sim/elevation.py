"""Elevation files of the world: GeoTIFF and SRTM .hgt, opened by rasterio only if one is named."""

import importlib
import math
import re
import warnings
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from vehicle_sim.errors import InputError
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.grid import Area, GridTerrain

VerticalDatum = Literal["AMSL", "EGM84", "EGM96", "EGM2008", "NAVD88", "NGVD29", "EVRF"]
_FIELD = "terrain.file"
_MAX_POINTS = 2.5e8
_COARSEST_DEG = 1 / 240
_ELLIPSOID = re.compile(r'(?:SPHEROID|ELLIPSOID)\["[^"]*",[\d.]+,([\d.]+)')
_FLATTENINGS = (298.257222, 298.257224)
"""Of the ellipsoids of WGS84, NAD83 and ETRS89, which agree to 0.1 mm."""


def read_grid(
    path: Path, frame: LocalFrame, area_m: Area, nodata: Literal["sea"] | float | None
) -> GridTerrain:
    """The terrain of an area; InputError says what is wrong with the file."""
    if not path.is_file():
        raise _refusal(path, "there is no such file", "Name a GeoTIFF or an SRTM .hgt")
    try:
        rasterio = importlib.import_module("rasterio")
    except ImportError:
        raise _refusal(path, "rasterio is not installed", "Install it") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            is_hgt = path.suffix.lower() == ".hgt"
            dataset = rasterio.open(path, driver="SRTMHGT" if is_hgt else "GTiff")
        with dataset:
            _check(dataset, path)
            top, left, bottom, right = _needed(dataset, frame, area_m, path)
            raw = dataset.read(1, window=((top, bottom), (left, right)), masked=True)
            a, _, c, _, e, f = dataset.transform[:6]
            north_deg, west_deg = f + (top + 0.5) * e, c + (left + 0.5) * a
    except rasterio.errors.RasterioError as error:
        reason = " ".join(str(error).split())
        raise _refusal(path, f"cannot be read ({reason})", "Name a GeoTIFF") from None
    return GridTerrain.of(
        _without_holes(raw, nodata, path),
        north_deg=north_deg,
        west_deg=west_deg,
        step_deg=(-e, a),
        frame=frame,
        area_m=area_m,
    )


def _refusal(path: Path, rule: str, remedy: str) -> InputError:
    return InputError(_FIELD, str(path), rule, f"{remedy}.")


def _check(dataset: Any, path: Path) -> None:
    """Latitude and longitude, north up, metres, one band."""
    crs, to_degrees = dataset.crs, "Warp it to EPSG:4326"
    if crs is None or not crs.is_geographic:
        kind = "no coordinate system" if crs is None else "projected coordinates"
        raise _refusal(path, f"has {kind}, not latitude and longitude", to_degrees)
    ellipsoid = _ELLIPSOID.search(crs.to_wkt())
    a, b, _, d, e = dataset.transform[:5]
    is_like_wgs84 = ellipsoid and _FLATTENINGS[0] < float(ellipsoid[1]) < _FLATTENINGS[1]
    is_elevation = dataset.count == 1 and dataset.dtypes[0][0] in "iuf"
    is_plain = dataset.scales == (1.0,) and dataset.offsets == (0.0,)
    unit = dataset.units[0] or "m"
    for is_well, rule, remedy in (
        (is_like_wgs84, "is not on the ellipsoid of WGS84", to_degrees),
        (b == d == 0.0 and a > 0.0 > e, "is turned: north must be up", to_degrees),
        (max(a, -e) <= _COARSEST_DEG, "has cells of more than 15 arc seconds", "Name a finer file"),
        (is_elevation, "is not one band of heights", "Name a file of elevations"),
        (is_plain, "has scaled heights", "Unscale it"),
        (unit.lower().startswith("m"), f"has heights in {unit}", "Convert them to metres"),
    ):
        if not is_well:
            raise _refusal(path, rule, remedy)


def _needed(dataset: Any, frame: LocalFrame, area_m: Area, path: Path) -> tuple[int, int, int, int]:
    """The part of the file around the area: first row and column, and those after the last."""
    north, east = np.meshgrid(np.linspace(*area_m[:2], 33), np.linspace(*area_m[2:], 33))
    latitude, longitude = frame.to_geographic_many(north.ravel(), east.ravel())
    a, _, c, _, e, f = dataset.transform[:6]
    east_of_middle = (longitude - c - 0.5 * dataset.width * a + 180.0) % 360.0 - 180.0
    row, column = (latitude - f) / e, east_of_middle / a + 0.5 * dataset.width
    spare = 0.02  # of a cell: the border bends between the places looked at
    top, bottom = math.floor(row.min() - 0.5 - spare), math.ceil(row.max() - 0.5 + spare) + 1
    left, right = math.floor(column.min() - 0.5 - spare), math.ceil(column.max() - 0.5 + spare) + 1
    if min(top, left) < 0 or bottom > dataset.height or right > dataset.width:
        raise _refusal(path, "does not cover [area]", "Make [area] smaller")
    if (bottom - top) * (right - left) > _MAX_POINTS:
        raise _refusal(path, f"has over {_MAX_POINTS:.0e} points in [area]", "Make [area] smaller")
    return top, left, bottom, right


def _without_holes(raw: Any, nodata: Literal["sea"] | float | None, path: Path) -> NDArray[Any]:
    """Heights without holes, within the range that exists on earth."""
    holes = np.ma.getmaskarray(raw) | ~np.isfinite(raw.data)
    heights: NDArray[Any] = raw.data
    if holes.any():
        if nodata is None:
            remedy = 'Say what is there: nodata = "sea", or a height AMSL'
            raise _refusal(path, f"has {int(holes.sum())} points without height in [area]", remedy)
        heights = heights.astype(np.float32)
        heights[holes] = 0.0 if nodata == "sea" else nodata
    if heights.min() < -500 or heights.max() > 9000:
        raise _refusal(path, "has heights that are not of this earth", "Name another file")
    return heights
