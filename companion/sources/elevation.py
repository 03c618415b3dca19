"""Elevation files: GeoTIFF and SRTM .hgt, read where a world or a mission needs them, and checked.

The only module that imports rasterio, and only when a file is named.  It reads just these two
formats and existing files: GDAL would follow a name to the network otherwise.
"""

import contextlib
import importlib
import math
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, final, get_args

import numpy as np
import numpy.typing as npt
import pyproj

from companion.errors import InputError
from companion.geodesy import FloatArray, LocalFrame
from companion.sources.files import answer, told_path
from companion.world.known_map import KnownMap
from companion.world.simulated_scan import true_map
from companion.world.terrain import GridTerrain

VerticalDatum = Literal["AMSL", "EGM84", "EGM96", "EGM2008", "NAVD88", "NGVD29", "EVRF"]
"""Datums of heights above mean sea level, give or take what a mission allows for."""
Nodata = Literal["sea"] | float | None

Span = tuple[int, int]
"""From and to of rows or columns."""

_MAX_CELLS = 2.5e8
_STRIP_CELLS = 1 << 17
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
    with _opened(path, vertical_datum, field) as source:
        reached = _reached(source, frame, area_m)
        _check_covered(source, reached)
        rows, columns = reached.rows, reached.columns
        heights = _filled(*_read(source, rows, columns), nodata)
        return _grid(heights, rows, columns, source.transform, frame)


def read_known_map(
    path: Path,
    frame: LocalFrame,
    blank: KnownMap,
    *,
    vertical_datum: VerticalDatum,
    nodata: Nodata,
    datum_error_m: float,
    may_be_scanned: bool,
    field: str,
) -> KnownMap:
    """What an elevation file tells in advance about the cells of a blank map.

    Each cell gets the highest terrain in it, plus datum_error_m.  It counts as seen, so that
    nothing looks at it again, unless it may_be_scanned: a scan replaces what the file says.
    Cells where the file has no height stay unknown, unless nodata fills them.

    Raises InputError naming the field as `read_terrain` does; a file that covers a part of the map
    will do, one that covers none of it will not.
    """
    rows, columns = blank.upper_m.shape
    north_m = blank.north_min_m, blank.north_min_m + rows * blank.cell_m
    east_m = blank.east_min_m, blank.east_min_m + columns * blank.cell_m
    with _opened(path, vertical_datum, field) as source:
        reached = _reached(source, frame, (north_m, east_m))
        _check_size(reached)
        window = reached.rows, reached.columns
        heights, empty, beyond = _read_where_it_is(source, *window)
        transform = source.transform
        if empty.all():
            rule = "it has no height anywhere on the map"
            raise _RefusedError(rule, "Name the file of this place.")
        if nodata is not None:
            heights, empty = _filled(heights, empty & ~beyond, nodata), beyond
        heights[empty] = max(_LOWEST_M, _least_of(heights.dtype))
        _check_heights(heights)
    terrain = _grid(heights, *window, transform, frame)
    upper = _highest_m(terrain, blank) + datum_error_m
    if empty.any():
        holes = _grid(empty.astype(np.uint8), *window, transform, frame)
        upper[_highest_m(holes, blank) > 0.0] = np.inf
    known = np.isfinite(upper)
    seen = np.zeros_like(known) if may_be_scanned else known
    return replace(blank, upper_m=upper, seen=seen, given=known)


def height_at_m(
    path: Path,
    place_deg: tuple[float, float],
    *,
    vertical_datum: VerticalDatum,
    nodata: Nodata,
    field: str,
) -> float | None:
    """The highest of the cells of an elevation file about a latitude and longitude, metres AMSL.

    None: one of them lies beyond the file, or has no height and nodata does not say any.  Raises
    InputError naming the field as `read_terrain` does.
    """
    with _opened(path, vertical_datum, field) as source:
        frame = LocalFrame(latitude_deg=place_deg[0], longitude_deg=place_deg[1])
        reached = _reached(source, frame, ((0.0, 0.0), (0.0, 0.0)))
        heights, empty, beyond = _read_where_it_is(source, reached.rows, reached.columns)
        if beyond.any() or (empty.any() and nodata is None):
            return None
        return float(_filled(heights, empty, nodata).max())


def write_elevation(
    path: Path,
    heights_m: FloatArray,
    north_west_deg: tuple[float, float],
    step_deg: tuple[float, float],
) -> None:
    """Write heights AMSL, (rows to the south, columns to the east), as a GeoTIFF in WGS84.

    north_west_deg: latitude and longitude of the first; step_deg: of a row and of a column.
    """
    rasterio, (step_n, step_e) = importlib.import_module("rasterio"), step_deg
    north, west = north_west_deg[0] + 0.5 * step_n, north_west_deg[1] - 0.5 * step_e
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        crs="EPSG:4326",
        dtype="float32",
        count=1,
        height=heights_m.shape[0],
        width=heights_m.shape[1],
        transform=rasterio.Affine(step_e, 0.0, west, 0.0, -step_n, north),
        compress="deflate",
        predictor=3,
    ) as file:
        file.write(heights_m.astype(np.float32), 1)


class _RefusedError(Exception):
    """A rule that a file breaks, and the remedy: `_opened` says which file it is."""


@contextlib.contextmanager
def _opened(path: Path, vertical_datum: str, field: str) -> Iterator[Any]:
    """An elevation file that has been checked; InputError for what is refused meanwhile, too."""
    try:
        rasterio = importlib.import_module("rasterio")  # 0.2 s and 100 MB that few worlds need
    except ImportError as error:
        rule = f"elevation files need the package rasterio ({error})"
        raise InputError(field, str(path), rule, "Install rasterio.") from None
    if not answer(path.is_file):
        raise InputError(field, str(path), "no such file", "Name a GeoTIFF or an SRTM .hgt file.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of files without coordinates: refused below
            driver = "SRTMHGT" if path.suffix.lower() == ".hgt" else "GTiff"
            memory = _in_memory(path, rasterio)  # there for as long as it is read
            source = rasterio.open(path if memory is None else memory.name, driver=driver)
        with source:
            _check_coordinates(source, vertical_datum)
            yield source
    except _RefusedError as error:
        raise InputError(field, str(path), *error.args) from None
    except rasterio.errors.RasterioError as error:
        rule = f"it cannot be read ({' '.join(str(error).split())})"
        raise InputError(field, str(path), rule, "Name a GeoTIFF or an SRTM .hgt file.") from None


def _in_memory(path: Path, rasterio: Any) -> Any:
    """A copy of the file, if its path is no UTF-8, which GDAL does not take; else None."""
    if told_path(path) == str(path):
        return None
    name = path.name.encode(errors="replace").decode()
    return rasterio.MemoryFile(path.read_bytes(), filename=name)


def _read(source: Any, rows: Span, columns: Span) -> tuple[npt.NDArray[Any], npt.NDArray[np.bool_]]:
    """Heights of a window, and where there are none."""
    heights = source.read(1, window=(rows, columns))
    return heights, _holes(heights, source.read_masks(1, window=(rows, columns)))


def _read_where_it_is(
    source: Any, rows: Span, columns: Span
) -> tuple[npt.NDArray[Any], npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Heights of a window, where there are none, and what of the window lies beyond the file."""
    shape = rows[1] - rows[0], columns[1] - columns[0]
    empty, beyond = np.ones(shape, dtype=bool), np.ones(shape, dtype=bool)
    heights = np.zeros(shape, dtype=source.dtypes[0])
    inside = [
        (max(first, 0), min(last, size))
        for (first, last), size in zip((rows, columns), source.shape, strict=True)
    ]
    if all(first < last for first, last in inside):
        there = tuple(
            slice(first - start, last - start)
            for (first, last), (start, _) in zip(inside, (rows, columns), strict=True)
        )
        heights[there], empty[there] = _read(source, inside[0], inside[1])
        beyond[there] = False
    return heights, empty, beyond


def _highest_m(terrain: GridTerrain, blank: KnownMap) -> FloatArray:
    """The highest of each cell of a map, in strips: a big map would not fit into memory at once."""
    rows, columns = blank.shape
    strip = max(_STRIP_CELLS // columns, 1)
    result = np.empty(blank.shape)
    for first in range(0, rows, strip):
        part = slice(first, min(first + strip, rows))
        result[part] = true_map(terrain, blank.part(part, slice(0, columns))).upper_m
    return result


def _least_of(kind: np.dtype[Any]) -> float:
    return float(np.iinfo(kind).min if kind.kind in "iu" else np.finfo(kind).min)


def _grid(
    heights: npt.NDArray[Any], rows: Span, columns: Span, transform: Any, frame: LocalFrame
) -> GridTerrain:
    """The terrain of a window of a file, whose rows run from north to south."""
    return GridTerrain(
        frame=frame,
        heights_m=heights[::-1],
        south_deg=transform.f + transform.e * (rows[1] - 0.5),
        west_deg=transform.c + transform.a * (columns[0] + 0.5),
        step_north_deg=-transform.e,
        step_east_deg=transform.a,
    )


def _check_coordinates(source: Any, vertical_datum: str) -> None:
    """One band of metres over north-up degrees of a datum like WGS84."""
    warp = "Convert it to EPSG:4326 (gdalwarp -t_srs EPSG:4326)."
    if source.crs is None:
        raise _RefusedError("it does not say which coordinates it is in", warp)
    crs = pyproj.CRS.from_wkt(source.crs.to_wkt())
    flat = crs.sub_crs_list[0] if crs.is_compound else crs
    ellipsoid = flat.ellipsoid.name if flat.ellipsoid else "none"
    meridian = flat.prime_meridian.longitude if flat.prime_meridian else 0.0
    if not flat.is_geographic or ellipsoid not in _ELLIPSOIDS or meridian != 0.0:
        raise _RefusedError(
            f"its coordinates are {flat.name}, not latitude and longitude of WGS84", warp
        )
    if len(flat.axis_info) == 3:
        raise _RefusedError(
            "its heights are above the ellipsoid", "Convert them to a vertical datum."
        )
    if crs.is_compound and not _same_datum(crs.sub_crs_list[1].name, vertical_datum):
        rule = f"it says that its heights are {crs.sub_crs_list[1].name}, not {vertical_datum}"
        raise _RefusedError(rule, "Correct terrain.vertical_datum.")
    transform = source.transform
    if transform.b or transform.d or transform.a <= 0.0 or transform.e >= 0.0:
        raise _RefusedError("its rows do not run from north to south", warp)
    if max(transform.a, -transform.e) * _DEG_M > _COARSEST_M:
        rule = f"its cells of {-transform.e * _DEG_M:.0f} m are coarser than {_COARSEST_M:.0f} m"
        raise _RefusedError(rule, "Name a finer file.")
    if source.count != 1 or np.dtype(source.dtypes[0]).kind not in "iuf":
        raise _RefusedError("it is not one band of heights", "Name a file of elevations.")
    if source.scales[0] != 1.0 or source.offsets[0] != 0.0:
        raise _RefusedError("its heights are scaled", "Convert it (gdal_translate -unscale).")
    if (source.units[0] or "m").lower() not in ("m", "metre", "meter", "metres", "meters"):
        raise _RefusedError(f"its heights are in {source.units[0]}", "Convert them to metres.")


def _same_datum(name: str, vertical_datum: str) -> bool:
    """Whether what a file calls its vertical datum may be the one that the world names."""
    short = name.upper().replace(" ", "")
    known = [datum for datum in get_args(VerticalDatum) if datum in short]
    return vertical_datum in (known or [vertical_datum]) and "ELLIPSOID" not in short


@final
class _Reached(NamedTuple):
    """What an area needs of a file: rows and columns (from, to) whose middles enclose it."""

    rows: Span
    columns: Span
    latitude: tuple[float, float]
    """Lowest and highest of the area's outline, degrees."""
    longitude: tuple[float, float]


def _reached(
    source: Any, frame: LocalFrame, area_m: tuple[tuple[float, float], tuple[float, float]]
) -> _Reached:
    (south, north), (west, east) = area_m
    north_m = np.linspace(south, north, _BORDER_POINTS)
    east_m = np.linspace(west, east, _BORDER_POINTS)
    border = np.meshgrid(north_m, east_m, indexing="ij")  # and the inside: no matter
    latitude, longitude = frame.to_geodetic_deg(*border)
    transform, width = source.transform, source.width
    row = (latitude - transform.f) / transform.e - 0.5
    middle = transform.c + 0.5 * width * transform.a
    column = ((longitude - middle + 180.0) % 360.0 - 180.0) / transform.a + 0.5 * width - 0.5
    return _Reached(
        rows=(math.floor(row.min() - 0.01), math.ceil(row.max() + 0.01) + 1),
        columns=(math.floor(column.min() - 0.01), math.ceil(column.max() + 0.01) + 1),
        latitude=(float(latitude.min()), float(latitude.max())),
        longitude=(float(longitude.min()), float(longitude.max())),
    )


def _check_covered(source: Any, reached: _Reached) -> None:
    transform, (height, width) = source.transform, source.shape
    rows, columns = reached.rows, reached.columns
    if rows[0] < 0 or columns[0] < 0 or rows[1] > height or columns[1] > width:
        rule = "[area] reaches beyond the middles of its outer cells, " + _reach(
            transform.f + (height - 0.5) * transform.e,
            transform.f + 0.5 * transform.e,
            transform.c + 0.5 * transform.a,
            transform.c + (width - 0.5) * transform.a,
        )
        rule += f": to {_reach(*reached.latitude, *reached.longitude)}"
        raise _RefusedError(rule, "Make [area] smaller, or name another file.")
    _check_size(reached)


def _check_size(reached: _Reached) -> None:
    rows, columns = reached.rows, reached.columns
    if (rows[1] - rows[0]) * (columns[1] - columns[0]) > _MAX_CELLS:
        rule = f"[area] takes more than {_MAX_CELLS:.1e} of its cells"
        raise _RefusedError(rule, "Make [area] smaller.")


def _reach(south: float, north: float, west: float, east: float) -> str:
    return f"{south:.5f} to {north:.5f} N, {west:.5f} to {east:.5f} E"


def _holes(heights: npt.NDArray[Any], mask: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """Where there is no height: the file's own mark or mask, or what is no number."""
    empty: npt.NDArray[np.bool_] = mask == 0
    return empty | ~np.isfinite(heights) if heights.dtype.kind == "f" else empty


def _filled(
    heights: npt.NDArray[Any], empty: npt.NDArray[np.bool_], nodata: Nodata
) -> npt.NDArray[Any]:
    """The heights without holes, all of them of this earth."""
    if empty.any():
        if nodata is None:
            rule = f"{np.count_nonzero(empty)} of its cells in [area] have no height"
            remedy = 'Write terrain.nodata = "sea" or a height AMSL, or name another file.'
            raise _RefusedError(rule, remedy)
        fill = 0.0 if nodata == "sea" else float(nodata)
        kind = heights.dtype
        if kind.kind in "iu" and not (
            fill.is_integer() and np.iinfo(kind).min <= fill <= np.iinfo(kind).max
        ):
            kind = np.dtype(np.float32)
        heights = np.where(empty, fill, heights).astype(kind)
    _check_heights(heights)
    return heights


def _check_heights(heights: npt.NDArray[Any]) -> None:
    low, high = float(heights.min()), float(heights.max())
    if low < _LOWEST_M or high > _HIGHEST_M:
        rule = f"its heights run from {low:g} to {high:g} m, which is not this earth"
        raise _RefusedError(rule, "Name a file of elevations in metres.")
