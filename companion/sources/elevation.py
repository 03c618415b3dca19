"""Elevation files: GeoTIFF and SRTM .hgt, read where a world or a mission needs them, and checked.

The only module that imports rasterio, and only when a file is named.  It reads just these two
formats and existing files: GDAL would follow a name to the network otherwise.
"""

import contextlib
import importlib
import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, final, get_args

import numpy as np
import numpy.typing as npt
import pyproj

from companion.errors import InputError
from companion.geodesy import BoolArray, FloatArray, LocalFrame, wrap_deg
from companion.ranges import NotNegative
from companion.sources.files import answer
from companion.sources.tables import Altitude, FileName, Table
from companion.world.known_map import KnownMap
from companion.world.simulated import true_map
from companion.world.terrain import GridTerrain

VerticalDatum = Literal["AMSL", "EGM84", "EGM96", "EGM2008", "NAVD88", "NGVD29", "EVRF"]
"""Datums of heights above mean sea level, give or take what a mission allows for."""
_Area = tuple[tuple[float, float], tuple[float, float]]
"""Lowest and highest north, and east, of the local frame."""

_MAX_CELLS = 2.5e8
_STRIP_CELLS = 1 << 17
_COARSEST_M = 500.0
_DEG_M = 111_320.0
_LOWEST_M, _HIGHEST_M = -500.0, 9_000.0
_ELLIPSOIDS = ("WGS 84", "WGS84", "GRS 1980", "GRS80")
_BORDER_POINTS = 65
_WARP = "Convert it to EPSG:4326 (gdalwarp -t_srs EPSG:4326)."
_NAME_ONE = "Name a GeoTIFF or an SRTM .hgt file."


class _RefusedError(Exception):
    """A rule that a file breaks, and the remedy: the file is named where it is opened."""


class ElevationTable(Table):
    """A file of heights, and what is said of it; its methods raise InputError (terrain.file).

    They do if the file cannot be read, is not in latitude and longitude (WGS84 or alike), is not in
    metres, or names another datum.
    """

    file: FileName
    """Relative to the folder of the file that names it."""
    vertical_datum: VerticalDatum
    nodata: Literal["sea"] | Altitude | None = None
    """What lies where the file has no height: the sea, or ground AMSL; None: that is not known."""

    def terrain(self, folder: Path, frame: LocalFrame, area_m: _Area) -> GridTerrain:
        """The terrain of an area, of which only the part about it is read.

        InputError, too, if it does not cover the area, or has holes that nodata does not fill.
        """
        with self._part(folder, frame, area_m) as part:
            if part.beyond.any():
                rule = "[area] reaches beyond the middles of its outer cells"
                raise _RefusedError(rule, "Make [area] smaller, or name another file.")
            return part.terrain(frame, part.filled(self.nodata))

    @contextlib.contextmanager
    def _part(self, folder: Path, frame: LocalFrame, area_m: _Area) -> Iterator["_Part"]:
        """What an area needs of the file; InputError for what is refused meanwhile, too."""
        path, field = folder / self.file, "terrain.file"
        rasterio = importlib.import_module("rasterio")  # 0.2 s and 100 MB that few worlds need
        if not (answer(path.is_file) and str(path).isprintable()):  # GDAL takes UTF-8 alone
            raise InputError(field, str(path), "no such file, or of an odd name", _NAME_ONE)
        driver = "SRTMHGT" if path.suffix.lower() == ".hgt" else "GTiff"
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of files without coordinates: refused below
                with rasterio.open(path, driver=driver) as source:
                    _refuse(source, self.vertical_datum)
                    part = _read(source, frame, area_m)
            yield part
        except _RefusedError as error:
            raise InputError(field, str(path), *error.args) from None
        except rasterio.errors.RasterioError as error:
            rule = f"it cannot be read ({' '.join(str(error).split())})"
            raise InputError(field, str(path), rule, _NAME_ONE) from None


class KnownElevationTable(ElevationTable):
    """Terrain known in advance from a file; where that has no height it is not."""

    datum_error_m: NotNegative = 5.0
    trust: Literal["proof", "guidance"] = "proof"
    """What reads the file: certificates too, or only the choice of the way."""

    def known_map(self, frame: LocalFrame, blank: KnownMap, *, may_be_scanned: bool) -> KnownMap:
        """What it tells in advance about the cells of a blank map.

        Each cell gets the highest terrain in it, plus datum_error_m.  It counts as seen, so that
        nothing looks at it again, unless it may_be_scanned: a scan replaces what the file says.
        Cells where the file has no height stay unknown, unless nodata fills them.  InputError, too,
        if it has none anywhere on the map.
        """
        rows, columns = blank.upper_m.shape
        north_m = blank.north_min_m, blank.north_min_m + rows * blank.cell_m
        east_m = blank.east_min_m, blank.east_min_m + columns * blank.cell_m
        here = Path()  # `complete` has made the file's name absolute
        with self._part(here, frame, (north_m, east_m)) as part:
            if part.empty.all():
                rule = "it has no height anywhere on the map"
                raise _RefusedError(rule, "Name the file of this place.")
            if self.nodata is not None:
                part = replace(part, heights=part.filled(self.nodata), empty=part.beyond)
            terrain = part.terrain(frame, part.filled(_LOWEST_M))
        upper = _highest_m(terrain, blank) + self.datum_error_m
        if part.empty.any():
            holes = part.terrain(frame, part.empty.astype(np.uint8))
            upper[_highest_m(holes, blank) > 0.0] = np.inf
        known = np.isfinite(upper)
        seen = np.zeros_like(known) if may_be_scanned else known
        return replace(blank, upper_m=upper, seen=seen, given=known)

    def height_m(self, folder: Path, latitude_deg: float, longitude_deg: float) -> float | None:
        """The highest of its cells about a place, metres AMSL.

        None: one of them lies beyond the file, or has no height and nodata does not say any.
        """
        frame = LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
        with self._part(folder, frame, ((0.0, 0.0), (0.0, 0.0))) as part:
            if part.beyond.any() or (part.empty.any() and self.nodata is None):
                return None
            return float(part.filled(self.nodata).max())


def _refuse(source: Any, vertical_datum: str) -> None:
    """Refuse what is not one band of metres over north-up degrees of a datum like WGS84."""
    if source.crs is None:
        raise _RefusedError("it does not say which coordinates it is in", _WARP)
    crs = pyproj.CRS.from_wkt(source.crs.to_wkt())
    flat = crs.sub_crs_list[0] if crs.is_compound else crs
    ellipsoid = flat.ellipsoid.name if flat.ellipsoid else "none"
    meridian = flat.prime_meridian.longitude if flat.prime_meridian else 0.0
    at, unit = source.transform, (source.units[0] or "m").lower()
    datum = crs.sub_crs_list[1].name if crs.is_compound else vertical_datum
    rules = (
        (not flat.is_geographic or ellipsoid not in _ELLIPSOIDS or meridian != 0.0,
         f"its coordinates are {flat.name}, not latitude and longitude of WGS84", _WARP),
        (len(flat.axis_info) == 3,
         "its heights are above the ellipsoid", "Convert them to a vertical datum."),
        (not _same_datum(datum, vertical_datum),
         f"it says that its heights are {datum}, not {vertical_datum}",
         "Correct terrain.vertical_datum."),
        (at.b or at.d or at.a <= 0.0 or at.e >= 0.0,
         "its rows do not run from north to south", _WARP),
        (max(at.a, -at.e) * _DEG_M > _COARSEST_M,
         f"its cells of {-at.e * _DEG_M:.0f} m are coarser than {_COARSEST_M:.0f} m",
         "Name a finer file."),
        (source.count != 1 or np.dtype(source.dtypes[0]).kind not in "iuf",
         "it is not one band of heights", "Name a file of elevations."),
        (source.scales[0] != 1.0 or source.offsets[0] != 0.0,
         "its heights are scaled", "Convert it (gdal_translate -unscale)."),
        (unit not in ("m", "metre", "meter", "metres", "meters"),
         f"its heights are in {unit}", "Convert them to metres."),
    )  # fmt: skip
    for is_broken, rule, remedy in rules:
        if is_broken:
            raise _RefusedError(rule, remedy)


def _same_datum(name: str, vertical_datum: str) -> bool:
    """Whether what a file calls its vertical datum may be the one that the world names."""
    short = name.upper().replace(" ", "")
    known = [datum for datum in get_args(VerticalDatum) if datum in short]
    return vertical_datum in (known or [vertical_datum]) and "ELLIPSOID" not in short


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Part:
    """What an area needs of a file: the cells whose middles enclose it, from north to south."""

    heights: npt.NDArray[Any]  # (rows, columns), and so are the next two
    empty: BoolArray
    """Where the file has no height: its own mark or mask, what is no number, or beyond it."""
    beyond: BoolArray
    south_west_deg: tuple[float, float]
    """Of the middle of the cell in this corner."""
    step_deg: tuple[float, float]

    def filled(self, nodata: Literal["sea"] | float | None) -> npt.NDArray[Any]:
        """The heights without holes, all of them of this earth."""
        heights = self.heights
        if self.empty.any():
            if nodata is None:
                rule = f"{np.count_nonzero(self.empty)} of its cells in [area] have no height"
                remedy = 'Write terrain.nodata = "sea" or a height AMSL, or name another file.'
                raise _RefusedError(rule, remedy)
            fill = np.float32(0.0 if nodata == "sea" else nodata)
            heights = np.where(self.empty, fill, heights)
        low, high = float(heights.min()), float(heights.max())
        if low < _LOWEST_M or high > _HIGHEST_M:
            rule = f"its heights run from {low:g} to {high:g} m, which is not this earth"
            raise _RefusedError(rule, "Name a file of elevations in metres.")
        return heights

    def terrain(self, frame: LocalFrame, values: npt.NDArray[Any]) -> GridTerrain:
        """Values at the middles of the cells as a terrain."""
        return GridTerrain(
            frame=frame,
            heights_m=values[::-1],
            south_deg=self.south_west_deg[0],
            west_deg=self.south_west_deg[1],
            step_north_deg=self.step_deg[0],
            step_east_deg=self.step_deg[1],
        )


def _read(source: Any, frame: LocalFrame, area_m: _Area) -> _Part:
    """Read what an area needs of a file, and no more."""
    border = [np.linspace(*side, _BORDER_POINTS) for side in area_m]
    latitude, longitude = frame.to_geodetic_deg(*np.meshgrid(*border, indexing="ij"))
    at, (height, width) = source.transform, source.shape
    row = (latitude - at.f) / at.e - 0.5
    middle_deg = at.c + 0.5 * width * at.a
    column = wrap_deg(longitude - middle_deg) / at.a + 0.5 * width - 0.5
    (top, bottom), (left, right) = [
        (math.floor(each.min() - 0.01), math.ceil(each.max() + 0.01) + 1) for each in (row, column)
    ]
    if (bottom - top) * (right - left) > _MAX_CELLS:
        rule = f"[area] takes more than {_MAX_CELLS:.1e} of its cells"
        raise _RefusedError(rule, "Make [area] smaller.")
    window = (top, bottom), (left, right)
    found = source.read(1, window=window, boundless=True, masked=True)
    rows, columns = (np.arange(*span) for span in window)
    within = np.outer((rows >= 0) & (rows < height), (columns >= 0) & (columns < width))
    return _Part(
        heights=found.data,
        empty=np.ma.getmaskarray(found) | ~np.isfinite(found.data) | ~within,
        beyond=~within,
        south_west_deg=(at.f + at.e * (bottom - 0.5), at.c + at.a * (left + 0.5)),
        step_deg=(-at.e, at.a),
    )


def _highest_m(terrain: GridTerrain, blank: KnownMap) -> FloatArray:
    """The highest of each cell of a map, in strips: a big map would not fit into memory at once."""
    rows, columns = blank.shape
    strip = max(_STRIP_CELLS // columns, 1)
    result = np.empty(blank.shape)
    for first in range(0, rows, strip):
        part = slice(first, min(first + strip, rows))
        result[part] = true_map(terrain, blank.part(part, slice(0, columns))).upper_m
    return result
