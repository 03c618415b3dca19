"""Curves, circles and polygons as rows of longitude, latitude (WGS84 degrees) and altitude AMSL."""

import math
from datetime import UTC, datetime, timedelta
from typing import Final, TypeVar, final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from companion.geodesy import BoolArray, FloatArray, LocalFrame
from companion.mission.events import Vector
from companion.path.subpath import Subpath
from companion.world.known_map import KnownMap
from companion.world.radars import Radar
from companion.world.zones import CircleZone, Zone

Number = TypeVar("Number", bound=np.generic)
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_CURVE_POINTS = 2000
_CURVE_ERROR_M = 0.25  # a hand's breadth off the curve, which nobody sees
_POINT_EVERY_M, _MAX_POINTS = 0.1, 20_000  # a vehicle is that near to its path
_CIRCLE_POINTS, _BALL_RINGS = 72, 13


def utc_text(time_us: int) -> str:
    """The time of microseconds since 1970 as ISO 8601, as xsd:dateTime has it."""
    time = _EPOCH + timedelta(microseconds=int(time_us))
    return time.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def of_points(points_nea_m: FloatArray, frame: LocalFrame) -> FloatArray:
    """Points of the local frame.  (N, 3) -> (N, 3)."""
    latitude, longitude = frame.to_geodetic_deg(points_nea_m[:, 0], points_nea_m[:, 1])
    return np.column_stack([longitude, latitude, points_nea_m[:, 2]])


def of_subpath(subpath: Subpath, frame: LocalFrame) -> FloatArray:
    """So many points that lines through them follow the curve to a quarter of a metre.  -> (N, 3).

    Of 2,000 at equal lengths each n-th one, where the curve leaves a chord of n steps by no more
    than n^2 / 8 of what it bends in a step at most.
    """
    points_nea_m = subpath.points_nea_m(np.linspace(0.0, subpath.length_m, _CURVE_POINTS + 1))
    bends_m = np.linalg.norm(np.diff(points_nea_m, 2, axis=0), axis=1)
    steps = math.sqrt(8.0 * _CURVE_ERROR_M / max(float(bends_m.max()), 1e-6))
    chosen = np.arange(0, _CURVE_POINTS, max(int(steps), 1))
    return of_points(points_nea_m[[*chosen, _CURVE_POINTS]], frame)


def circle_ne_m(centre_ne_m: tuple[float, float], radius_m: float) -> FloatArray:
    """A closed circle, anticlockwise as seen from above.  -> (N, 2)."""
    turn = np.linspace(0.0, 2.0 * np.pi, _CIRCLE_POINTS + 1)
    return radius_m * np.stack([np.sin(turn), np.cos(turn)], axis=-1) + np.asarray(centre_ne_m)


def outline_ne_m(zone: Zone) -> FloatArray:
    """The closed outline of a zone, anticlockwise as seen from above.  -> (N, 2)."""
    if isinstance(zone, CircleZone):
        return circle_ne_m((zone.north_m, zone.east_m), zone.radius_m)
    ne_m = np.array([*zone.vertices_ne_m, zone.vertices_ne_m[0]], dtype=np.float64)
    (north, east), (north_next, east_next) = ne_m[:-1].T, ne_m[1:].T
    return ne_m[::-1] if np.sum(north * east_next - east * north_next) > 0.0 else ne_m


def walls_nea_m(zone: Zone, band_m: tuple[float, float]) -> FloatArray:
    """The walls of a zone between two altitudes.  -> (2, N, 3)."""
    outline = outline_ne_m(zone)
    return np.stack([np.insert(outline, 2, altitude_m, axis=1) for altitude_m in band_m])


def ball_nea_m(radar: Radar, band_m: tuple[float, float], points: int) -> FloatArray:
    """The sphere in which a radar sees between two altitudes.  -> (M, points + 1, 3)."""
    north_m, east_m, altitude_m = radar.centre_nea_m
    sines = np.clip([(end_m - altitude_m) / radar.range_m for end_m in band_m], -1.0, 1.0)
    lift = np.arcsin(np.linspace(sines[0], sines[1], _BALL_RINGS))[:, None]
    turn = np.linspace(0.0, 2.0 * np.pi, points + 1)
    ball = [np.cos(lift) * np.cos(turn), np.cos(lift) * np.sin(turn), np.sin(lift) + 0.0 * turn]
    return np.stack(ball, axis=-1) * radar.range_m + [north_m, east_m, altitude_m]


def heights_m(known: KnownMap) -> FloatArray:
    """Of the terrain that was seen or known in advance, AMSL; NaN of other cells."""
    return np.where(known.surveyed & np.isfinite(known.upper_m), known.upper_m, np.nan)


def under_m(known: KnownMap, points_ne_m: FloatArray) -> FloatArray:
    """That of the cell that holds each point, NaN outside.  (N, 2) -> (N,)."""
    cells = np.floor((points_ne_m - (known.north_min_m, known.east_min_m)) / known.cell_m)
    is_inside: BoolArray = np.all((cells >= 0) & (cells < known.shape), axis=-1)
    rows, columns = np.where(is_inside[:, None], cells, 0).astype(np.intp).T
    return np.where(is_inside, heights_m(known)[rows, columns], np.nan)


def highest(values: NDArray[Number], step: int) -> NDArray[Number]:
    """The highest value of each block of step x step cells."""
    rows, columns = (np.arange(0, count, step) for count in values.shape)
    of_rows = np.maximum.reduceat(values, rows, 0)
    blocks: NDArray[Number] = np.maximum.reduceat(of_rows, columns, 1)
    return blocks


@final
class SubpathPoints:
    """A subpath as many points, from which distances are soon told."""

    def __init__(self, subpath: Subpath) -> None:
        count = min(max(math.ceil(subpath.length_m / _POINT_EVERY_M), 1), _MAX_POINTS)
        self._lengths_m = np.linspace(0.0, subpath.length_m, count + 1)
        self._tree = cKDTree(subpath.points_nea_m(self._lengths_m))

    def nearest(self, place_nea_m: Vector | FloatArray) -> tuple[float, float]:
        """Distance of a place from the subpath, and the length along it where it is nearest."""
        away_m, at = self._tree.query(np.asarray(place_nea_m))
        return float(away_m), float(self._lengths_m[at])
