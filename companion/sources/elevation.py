"""Elevation files: GeoTIFF and SRTM .hgt, read where a world or a mission needs them, and checked.

The only module that imports rasterio, and only when a file is named.  It reads just these two
formats and existing files: GDAL would follow a name to the network otherwise.
"""

import importlib
import math
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pyproj

from companion.errors import InputError
from companion.geodesy import BoolArray, FloatArray, LocalFrame
from companion.ranges import Altitude, NotNegative
from companion.sources.files import answer
from companion.sources.tables import FileName, Table
from companion.world.known_map import KnownMap
from companion.world.simulated import true_map
from companion.world.terrain import GridTerrain

VerticalDatum = Literal["AMSL", "EGM84", "EGM96", "EGM2008", "NAVD88", "NGVD29", "EVRF"]
"""Datums of heights above mean sea level, give or take what a mission allows for."""
_Area = tuple[tuple[float, float], tuple[float, float]]
"""Lowest and highest north, and east, of the local frame."""

_MAX_CELLS = 2.5e8  # of a file: 1 GB as float32
_STRIP_CELLS = 1 << 17  # of a map at once: of a big one they would not fit into memory
_COARSEST_M = 500.0
_LOWEST_M, _HIGHEST_M = -500.0, 9_000.0  # the Dead Sea, Everest, and some more
_ELLIPSOIDS = ("WGS 84", "WGS84", "GRS 1980", "GRS80")
_METRES = ("m", "metre", "meter", "metres", "meters")
_BORDER_POINTS = 65
_WARP = "Convert it to EPSG:4326 (gdalwarp -t_srs EPSG:4326)."
_NAME_ONE = "Name a GeoTIFF or an SRTM .hgt file."


class ElevationTable(Table):
    """A file of heights, and what is said of it; its methods raise InputError (terrain.file).

    They do if the file cannot be read, is not in latitude and longitude (WGS84 or alike), is not in
    metres, or names another datum.
    """

    file: FileName
    """Relative to the folder of the file that names it; here absolute (`located`)."""
    vertical_datum: VerticalDatum
    nodata: Literal["sea"] | Altitude | None = None
    """What lies where the file has no height: the sea, or ground AMSL; None: that is not known."""

    def terrain(self, frame: LocalFrame, area_m: _Area) -> GridTerrain:
        """The terrain of an area, of which only the part about it is read.

        InputError, too, if it does not cover the area, or has holes that nodata does not fill.
        """
        terrain, unknown = self._read(frame, area_m)
        if count := np.count_nonzero(unknown):
            rule = f"{count} of its cells in [area] have no height, or lie beyond its edge"
            remedy = 'Write terrain.nodata = "sea" or a height AMSL, or make [area] smaller.'
            raise _refusal(self.file, rule, remedy)
        return terrain

    def _read(self, frame: LocalFrame, area_m: _Area) -> tuple[GridTerrain, BoolArray]:
        """The cells whose middles enclose an area, and which of them have no height, even so.

        Both from south to north; what is not known counts as _LOWEST_M in the first.
        """
        rasterio = importlib.import_module("rasterio")  # 0.2 s and 100 MB that few worlds need
        path = Path(self.file)
        if not (answer(path.is_file) and self.file.isprintable()):
            raise _refusal(self.file, "no such file, or of an odd name", _NAME_ONE)
        driver = "SRTMHGT" if path.suffix.lower() == ".hgt" else "GTiff"
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of files without coordinates: refused below
                with rasterio.open(path, driver=driver) as source:
                    for rule, remedy in _oddities(source, self.vertical_datum):
                        raise _refusal(self.file, rule, remedy)
                    whole = _grid(source, frame)
                    border = np.meshgrid(*(np.linspace(*side, _BORDER_POINTS) for side in area_m))
                    places = np.array(whole.nodes(*border))
                    for rule, remedy in _unfit(whole.cell_m, places):
                        raise _refusal(self.file, rule, remedy)
                    rows, columns = (
                        range(math.floor(axis.min() - 0.01), math.ceil(axis.max() + 0.01) + 1)
                        for axis in places
                    )
                    height, width = source.shape
                    down = height - rows.stop, height - rows.start
                    window = down, (columns.start, columns.stop)
                    heights = source.read(1, window=window, boundless=True, masked=True)[::-1]
        except rasterio.errors.RasterioError as error:
            rule = f"it cannot be read ({' '.join(str(error).split())})"
            raise _refusal(self.file, rule, _NAME_ONE) from None
        beyond = ~np.outer(np.isin(rows, range(height)), np.isin(columns, range(width)))
        unknown = beyond | np.ma.getmaskarray(heights) | ~np.isfinite(heights.data)
        heights_m = heights.data.astype(np.result_type(heights.dtype, np.float32))
        if self.nodata is not None:
            heights_m[unknown] = 0.0 if self.nodata == "sea" else self.nodata
            unknown = beyond
        known_m, heights_m[unknown] = heights_m[~unknown], _LOWEST_M
        if heights_m.min() < _LOWEST_M or heights_m.max() > _HIGHEST_M:
            rule = f"its heights run from {known_m.min():g} to {known_m.max():g} m, which is not "
            rule += "this earth"
            raise _refusal(self.file, rule, "Name a file of elevations in metres.")
        south = whole.south + rows.start * whole.step_north
        west = whole.west + columns.start * whole.step_east
        return replace(whole, heights_m=heights_m, south=south, west=west), unknown


class KnownElevationTable(ElevationTable):
    """Terrain known in advance from a file; where that has no height it is not."""

    datum_error_m: NotNegative = 5.0
    trust: Literal["proof", "guidance"] = "proof"
    """What reads the file: certificates too, or only the choice of the way."""

    def upper_m(self, frame: LocalFrame, blank: KnownMap) -> FloatArray:
        """The highest terrain in each cell of a map, plus datum_error_m; inf: it is not known.

        InputError, too, if it is not known anywhere on the map.
        """
        rows, columns = blank.shape
        north_m = blank.north_min_m, blank.north_min_m + rows * blank.cell_m
        east_m = blank.east_min_m, blank.east_min_m + columns * blank.cell_m
        terrain, unknown = self._read(frame, (north_m, east_m))
        if unknown.all():
            rule = "it has no height anywhere on the map"
            raise _refusal(self.file, rule, "Name the file of this place.")
        upper_m = _highest_m(terrain, blank) + self.datum_error_m
        if unknown.any():
            holes = replace(terrain, heights_m=unknown.astype(np.uint8))
            upper_m[_highest_m(holes, blank) > 0.0] = np.inf
        return upper_m

    def height_m(self, latitude_deg: float, longitude_deg: float) -> float | None:
        """The highest of its cells about a place, metres AMSL; None: one of them has no height."""
        frame = LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
        grid = self._read(frame, ((0.0, 0.0), (0.0, 0.0)))
        return None if grid[1].any() else float(grid[0].heights_m.max())


def _refusal(file: str, rule: str, remedy: str) -> InputError:
    return InputError("terrain.file", file, rule, remedy)


def _oddities(source: Any, vertical_datum: str) -> Iterator[tuple[str, str]]:
    """Why it is no band of metres over a north-up map of a datum like WGS84: rule, remedy."""
    if source.crs is None:
        remedy = "Say which (gdal_edit.py -a_srs EPSG:4326, if it is in degrees)."
        yield "it does not say which coordinates it is in", remedy
        return
    flat, datum = _coordinates(source)
    ellipsoid = flat.ellipsoid.name if flat.ellipsoid else "none"
    meridian = flat.prime_meridian.longitude if flat.prime_meridian else 0.0
    at, unit = source.transform, (source.units[0] or "m").lower()
    rules = (
        (not (flat.is_geographic or flat.is_projected),
         f"its coordinates ({flat.name}) are of no map of the earth", _NAME_ONE),
        (ellipsoid not in _ELLIPSOIDS or meridian != 0.0,
         f"its coordinates are {flat.name}, of another datum than WGS84", _WARP),
        (len(flat.axis_info) == 3,
         "its heights are above the ellipsoid", "Convert them to a vertical datum."),
        (not _same_datum(datum or vertical_datum, vertical_datum),
         f"it says that its heights are {datum}, not {vertical_datum}",
         "Correct terrain.vertical_datum."),
        (at.b or at.d or at.a <= 0.0 or at.e >= 0.0,
         "its rows do not run from north to south", _WARP),
        (source.count != 1 or np.dtype(source.dtypes[0]).kind not in "iuf",
         "it is not one band of heights", "Name a file of elevations."),
        (source.scales[0] != 1.0 or source.offsets[0] != 0.0,
         "its heights are scaled", "Convert it (gdal_translate -unscale)."),
        (unit not in _METRES, f"its heights are in {unit}", "Convert them to metres."),
    )  # fmt: skip
    yield from ((rule, remedy) for is_broken, rule, remedy in rules if is_broken)


def _unfit(cell_m: float, places: FloatArray) -> Iterator[tuple[str, str]]:
    """Why it is no file for an area.  places: (2, ...) its rows and columns.  As `_oddities`."""
    if cell_m > _COARSEST_M:
        rule = f"its cells of {cell_m:.0f} m are coarser than {_COARSEST_M:.0f} m"
        yield rule, "Name a finer file."
    if not np.isfinite(places).all():
        yield "its map projection does not reach [area]", "Name the file of this place."
    if np.prod(np.ptp(places, axis=(1, 2)) + 2.0) > _MAX_CELLS:
        yield f"[area] takes more than {_MAX_CELLS:.1e} of its cells", "Make [area] smaller."


def _coordinates(source: Any) -> tuple[pyproj.CRS, str | None]:
    """Those of its map, and the name of its vertical datum, if it says one."""
    crs = pyproj.CRS.from_wkt(source.crs.to_wkt())
    if not crs.is_compound:
        return crs, None
    flat, upward = crs.sub_crs_list[:2]
    return flat, upward.name


def _same_datum(name: str, vertical_datum: str) -> bool:
    """Whether what a file calls its vertical datum may be the one that the world names."""
    short = name.upper().replace(" ", "")
    known = [datum for datum in get_args(VerticalDatum) if datum in short]
    return vertical_datum in (known or [vertical_datum]) and "ELLIPSOID" not in short


def _grid(source: Any, frame: LocalFrame) -> GridTerrain:
    """All of a file, without its heights: where its cells are."""
    (flat, _), at, projection = _coordinates(source), source.transform, None
    if flat.is_projected:  # from degrees of its own datum
        projection = pyproj.Transformer.from_crs(flat.geodetic_crs, flat, always_xy=True)
    return GridTerrain(
        frame=frame,
        heights_m=np.broadcast_to(np.zeros((), dtype=np.float32), source.shape),
        south=at.f + at.e * (source.height - 0.5),
        west=at.c + at.a * 0.5,
        step_north=-at.e,
        step_east=at.a,
        projection=projection,
    )


def _highest_m(terrain: GridTerrain, blank: KnownMap) -> FloatArray:
    """The highest of each cell of a map, in whole metres."""
    rows, columns = blank.shape
    strip = max(_STRIP_CELLS // columns, 1)
    parts = (
        blank.part(slice(first, min(first + strip, rows)), slice(0, columns))
        for first in range(0, rows, strip)
    )
    return np.concatenate([true_map(terrain, part).upper_m for part in parts])
