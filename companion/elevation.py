"""Elevation files: GeoTIFF and SRTM .hgt, read where a world needs them and checked.

The only module that imports rasterio, and only when a world names a file.  It opens just these two
formats and existing files: GDAL would follow a name to the network otherwise.
"""

import importlib
import math
import types
import warnings
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
import pyproj

from companion.errors import InputError
from companion.geodesy import LocalFrame
from companion.world.terrain import GridTerrain

VerticalDatum = Literal["AMSL", "EGM84", "EGM96", "EGM2008", "NAVD88", "NGVD29", "EVRF"]
"""Datums of heights above mean sea level, give or take what a mission allows for."""
Nodata = Literal["sea"] | float | None

_MOST_CELLS = 2.5e8
_COARSEST_M = 500.0
_DEG_M = 111_320.0
_LOWEST_M, _HIGHEST_M = -500.0, 9_000.0
_ELLIPSOIDS = ("WGS 84", "WGS84", "GRS 1980", "GRS80")
_BORDER_POINTS = 65


def read_terrain(
    path: Path,
    frame: LocalFrame,
    area_m: tuple[tuple[float, float], tuple[float, float]],
    *,
    vertical_datum: VerticalDatum,
    nodata: Nodata,
    field: str,
) -> GridTerrain:
    """The terrain of an area (north and east, minimum and maximum) from an elevation file.

    Reads only the window that the area needs.  Raises InputError naming the field (of the world
    file) if the file cannot be read, is not in latitude and longitude (WGS84 or alike), is not in
    metres, does not cover the area, has holes that nodata does not fill, or names another datum.
    """
    rasterio = _rasterio(field, path)
    if not path.is_file():
        raise InputError(field, str(path), "no such file", "Name a GeoTIFF or an SRTM .hgt file.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of files without coordinates: refused below
            driver = "SRTMHGT" if path.suffix.lower() == ".hgt" else "GTiff"
            source = rasterio.open(path, driver=driver)
        with source:
            _check_coordinates(source, field, path, vertical_datum)
            rows, columns = _window(source, frame, area_m, field, path)
            heights = source.read(1, window=(rows, columns))
            empty = _holes(heights, source.read_masks(1, window=(rows, columns)))
            transform = source.transform
    except rasterio.errors.RasterioError as error:
        rule = f"it cannot be read ({' '.join(str(error).split())})"
        raise InputError(field, str(path), rule, "Name a GeoTIFF or an SRTM .hgt file.") from None
    heights = _filled(heights, empty, nodata, field, path)
    return GridTerrain(
        frame=frame,
        heights_m=heights[::-1],
        south_deg=transform.f + transform.e * (rows[1] - 0.5),
        west_deg=transform.c + transform.a * (columns[0] + 0.5),
        step_north_deg=-transform.e,
        step_east_deg=transform.a,
    )


def _rasterio(field: str, path: Path) -> types.ModuleType:
    try:
        return importlib.import_module("rasterio")  # 0.2 s and 100 MB that few worlds need
    except ImportError as error:
        rule = f"elevation files need the package rasterio ({error})"
        raise InputError(field, str(path), rule, "Install rasterio.") from None


def _check_coordinates(source: Any, field: str, path: Path, vertical_datum: str) -> None:
    """One band of metres over north-up degrees of a datum like WGS84."""

    def refuse(rule: str, remedy: str) -> InputError:
        return InputError(field, str(path), rule, remedy)

    warp = "Convert it to EPSG:4326 (gdalwarp -t_srs EPSG:4326)."
    if source.crs is None:
        raise refuse("it does not say which coordinates it is in", warp)
    crs = pyproj.CRS.from_wkt(source.crs.to_wkt())
    flat = crs.sub_crs_list[0] if crs.is_compound else crs
    ellipsoid = flat.ellipsoid.name if flat.ellipsoid else "none"
    meridian = flat.prime_meridian.longitude if flat.prime_meridian else 0.0
    if not flat.is_geographic or ellipsoid not in _ELLIPSOIDS or meridian != 0.0:
        raise refuse(f"its coordinates are {flat.name}, not latitude and longitude of WGS84", warp)
    if len(flat.axis_info) == 3:
        raise refuse("its heights are above the ellipsoid", "Convert them to a vertical datum.")
    if crs.is_compound and not _same_datum(crs.sub_crs_list[1].name, vertical_datum):
        rule = f"it says that its heights are {crs.sub_crs_list[1].name}, not {vertical_datum}"
        raise refuse(rule, "Correct terrain.vertical_datum.")
    transform = source.transform
    if transform.b or transform.d or transform.a <= 0.0 or transform.e >= 0.0:
        raise refuse("its rows do not run from north to south", warp)
    if max(transform.a, -transform.e) * _DEG_M > _COARSEST_M:
        rule = f"its cells of {-transform.e * _DEG_M:.0f} m are coarser than {_COARSEST_M:.0f} m"
        raise refuse(rule, "Name a finer file.")
    if source.count != 1 or np.dtype(source.dtypes[0]).kind not in "iuf":
        raise refuse("it is not one band of heights", "Name a file of elevations.")
    if source.scales[0] != 1.0 or source.offsets[0] != 0.0:
        raise refuse("its heights are scaled", "Convert it (gdal_translate -unscale).")
    if (source.units[0] or "m").lower() not in ("m", "metre", "meter", "metres", "meters"):
        raise refuse(f"its heights are in {source.units[0]}", "Convert them to metres.")


def _same_datum(name: str, vertical_datum: str) -> bool:
    """Whether what a file calls its vertical datum may be the one that the world names."""
    short = name.upper().replace(" ", "")
    known = [datum for datum in get_args(VerticalDatum) if datum in short]
    return vertical_datum in (known or [vertical_datum]) and "ELLIPSOID" not in short


def _window(
    source: Any,
    frame: LocalFrame,
    area_m: tuple[tuple[float, float], tuple[float, float]],
    field: str,
    path: Path,
) -> tuple[tuple[int, int], tuple[int, int]]:
    """The rows and columns (from, to) whose middles enclose the area."""
    (south, north), (west, east) = area_m
    north_m = np.linspace(south, north, _BORDER_POINTS)
    east_m = np.linspace(west, east, _BORDER_POINTS)
    border = np.meshgrid(north_m, east_m, indexing="ij")  # and the inside: no matter
    latitude, longitude = frame.to_geodetic_many_deg(*border)
    transform, (height, width) = source.transform, source.shape
    row = (latitude - transform.f) / transform.e - 0.5
    middle = transform.c + 0.5 * width * transform.a
    column = ((longitude - middle + 180.0) % 360.0 - 180.0) / transform.a + 0.5 * width - 0.5
    rows = math.floor(row.min() - 0.01), math.ceil(row.max() + 0.01) + 1
    columns = math.floor(column.min() - 0.01), math.ceil(column.max() + 0.01) + 1
    if rows[0] < 0 or columns[0] < 0 or rows[1] > height or columns[1] > width:
        rule = "[area] reaches beyond the middles of its outer cells, " + _reach(
            transform.f + (height - 0.5) * transform.e,
            transform.f + 0.5 * transform.e,
            transform.c + 0.5 * transform.a,
            transform.c + (width - 0.5) * transform.a,
        )
        rule += ": to " + _reach(latitude.min(), latitude.max(), longitude.min(), longitude.max())
        raise InputError(field, str(path), rule, "Make [area] smaller, or name another file.")
    if (rows[1] - rows[0]) * (columns[1] - columns[0]) > _MOST_CELLS:
        rule = f"[area] takes more than {_MOST_CELLS:.1e} of its cells"
        raise InputError(field, str(path), rule, "Make [area] smaller.")
    return rows, columns


def _reach(south: float, north: float, west: float, east: float) -> str:
    return f"{south:.5f} to {north:.5f} N, {west:.5f} to {east:.5f} E"


def _holes(heights: npt.NDArray[Any], mask: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """Where there is no height: the file's own mark or mask, or what is no number."""
    empty: npt.NDArray[np.bool_] = mask == 0
    return empty | ~np.isfinite(heights) if heights.dtype.kind == "f" else empty


def _filled(
    heights: npt.NDArray[Any],
    empty: npt.NDArray[np.bool_],
    nodata: Nodata,
    field: str,
    path: Path,
) -> npt.NDArray[Any]:
    """The heights without holes, all of them of this earth."""
    if empty.any():
        if nodata is None:
            rule = f"{np.count_nonzero(empty)} of its cells in [area] have no height"
            remedy = 'Write terrain.nodata = "sea" or a height AMSL, or name another file.'
            raise InputError(field, str(path), rule, remedy)
        fill = 0.0 if nodata == "sea" else float(nodata)
        kind = heights.dtype
        if kind.kind in "iu" and not (
            fill.is_integer() and np.iinfo(kind).min <= fill <= np.iinfo(kind).max
        ):
            kind = np.dtype(np.float32)
        heights = np.where(empty, fill, heights).astype(kind)
    low, high = float(heights.min()), float(heights.max())
    if low < _LOWEST_M or high > _HIGHEST_M:
        rule = f"its heights run from {low:g} to {high:g} m, which is not this earth"
        raise InputError(field, str(path), rule, "Name a file of elevations in metres.")
    return heights
