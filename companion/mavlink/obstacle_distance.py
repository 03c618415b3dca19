"""OBSTACLE_DISTANCE: how far it is to known terrain and zones all round, at this altitude.

For ground stations to draw, and only if a mission switches it on: it reaches 655 m and can wake an
autopilot's own avoidance (mavlink.md 2.5).  72 sectors of 5 degrees, the first one about true
north (MAV_FRAME_GLOBAL).
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np
import scipy

from companion.geodesy import BoolArray, FloatArray, LocalFrame
from companion.mavlink.dialect import Message, wire
from companion.world.known_map import KnownMap
from companion.world.threats import CircleZone, Zone
from companion.world.zone_index import index_of

SECTORS = 72
FARTHEST_CM = 65_533
"""The field is 16 bits wide, one value above it means that nothing is there, 65535 unknown."""
_NOTHING_CM, _UNKNOWN_CM = FARTHEST_CM + 1, 65_535
_REACH_M = FARTHEST_CM * 0.01
_WIDTH_RAD = math.tau / SECTORS
_PIECE_M = 10.0  # of an edge, so that what is near in one sector is not near in the next
_SAGITTA_M = 0.25


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleSurroundings:
    """The vehicle's position and the known terrain and zones around it."""

    frame: LocalFrame
    known: KnownMap
    zones: tuple[Zone, ...]
    position_nea_m: tuple[float, float, float]


def obstacle_distance(around: VehicleSurroundings, now_s: float) -> Message:
    """OBSTACLE_DISTANCE at vehicle time now_s."""
    return wire.MAVLink_obstacle_distance_message(
        time_usec=round(max(now_s, 0.0) * 1e6),
        sensor_type=wire.MAV_DISTANCE_SENSOR_UNKNOWN,
        distances=distances_cm(around),
        increment=round(math.degrees(_WIDTH_RAD)),
        min_distance=0,
        max_distance=FARTHEST_CM,
        increment_f=0.0,
        angle_offset=0.0,
        frame=wire.MAV_FRAME_GLOBAL,
    )


def distances_cm(around: VehicleSurroundings) -> list[int]:
    """The wire's 72 distances, never more than to the nearest obstacle of the sector.

    Sector k reaches 2.5 degrees to both sides of the true azimuth 5 k.  65534: nothing there;
    65535: nothing is known to be there, and not all of it is known.
    """
    north_m, east_m, altitude_m = around.position_nea_m
    if not all(math.isfinite(value) for value in around.position_nea_m):
        return [_UNKNOWN_CM] * SECTORS
    turn_rad = around.frame.grid_north_rad(north_m, east_m)
    blocked_m, unknown_m = _terrain_m(around.known, (north_m, east_m), altitude_m, turn_rad)
    here_ne_m = (north_m, east_m)
    for zone in index_of(around.zones).near(here_ne_m, here_ne_m, _REACH_M):
        blocked_m = np.minimum(blocked_m, _zone_m(zone, (north_m, east_m), turn_rad))
    centimetres = np.floor(np.minimum(blocked_m, 2.0 * _REACH_M) * 100.0)
    free = np.where(unknown_m <= _REACH_M, _UNKNOWN_CM, _NOTHING_CM)
    return [int(value) for value in np.where(centimetres <= FARTHEST_CM, centimetres, free)]


def _terrain_m(
    known: KnownMap, here_ne_m: tuple[float, float], altitude_m: float, turn_rad: float
) -> tuple[FloatArray, FloatArray]:
    """Distance to terrain that is as high as the vehicle, and to ground that is not known.

    -> each (72,), inf where there is none within reach.
    """
    cell = known.cell_m
    rows, columns = known.upper_m.shape
    (south, west), (north, east) = (
        known.cell_of(here_ne_m[0] + sign * _REACH_M, here_ne_m[1] + sign * _REACH_M)
        for sign in (-1.0, 1.0)
    )
    count = north - south + 3, east - west + 3
    height_m = np.full(count, np.inf)  # what is not on the map is not known
    first, last = max(south - 1, 0), min(north + 2, rows)
    left, right = max(west - 1, 0), min(east + 2, columns)
    if first < last and left < right:
        inner = np.s_[first - south + 1 : last - south + 1, left - west + 1 : right - west + 1]
        height_m[inner] = known.upper_m[first:last, left:right]
    corner = (
        known.north_min_m + (south - 1) * cell - here_ne_m[0],
        known.east_min_m + (west - 1) * cell - here_ne_m[1],
    )
    is_unknown = ~np.isfinite(height_m) & (height_m > 0.0)
    is_blocked = (height_m >= altitude_m) & ~is_unknown
    slack_m = known.registration_m
    blocked_m = _cells_m(is_blocked, corner, cell, turn_rad) - slack_m
    unknown_m = _cells_m(is_unknown, corner, cell, turn_rad) - slack_m
    return np.maximum(blocked_m, 0.0), np.maximum(unknown_m, 0.0)


def _cells_m(
    cells: BoolArray, corner_ne_m: tuple[float, float], cell_m: float, turn_rad: float
) -> FloatArray:
    """Distance to the nearest of some cells in each sector.  (rows, columns) -> (72,).

    Only cells at the rim of the area: the others are hidden behind them.
    """
    under = math.floor(-corner_ne_m[0] / cell_m), math.floor(-corner_ne_m[1] / cell_m)
    if cells[under]:
        return np.zeros(SECTORS)
    inner = scipy.ndimage.binary_erosion(cells, np.ones((3, 3), dtype=bool), border_value=1)
    rows, columns = np.nonzero(cells & ~inner)
    south, west = corner_ne_m[0] + rows * cell_m, corner_ne_m[1] + columns * cell_m
    away = np.maximum(np.maximum(south, -south - cell_m), 0.0)
    aside = np.maximum(np.maximum(west, -west - cell_m), 0.0)
    azimuth = np.arctan2(west + 0.5 * cell_m, south + 0.5 * cell_m)
    corners = [
        _wrapped(np.arctan2(west + across * cell_m, south + up * cell_m) - azimuth)
        for up in (0.0, 1.0)
        for across in (0.0, 1.0)
    ]
    left, right = np.min(corners, axis=0), np.max(corners, axis=0)
    middle = azimuth + 0.5 * (left + right) + turn_rad
    return _nearest_m(np.hypot(away, aside), middle, 0.5 * (right - left))


def _zone_m(zone: Zone, here_ne_m: tuple[float, float], turn_rad: float) -> FloatArray:
    """Distance to the edge of a zone in each sector; 0 where the vehicle may not be.  -> (72,)."""
    gap_m = float(zone.distance_m(*(np.asarray(value) for value in here_ne_m)))
    if gap_m <= 2.0 * _SAGITTA_M:  # nearer than the edges below are to those of a circle
        return np.zeros(SECTORS)
    if gap_m > _REACH_M:
        return np.full(SECTORS, np.inf)
    corners = _corners_ne_m(zone) - np.asarray(here_ne_m)  # (corners, 2), from the vehicle
    along = np.roll(corners, -1, axis=0) - corners
    squared = np.maximum(np.einsum("ek,ek->e", along, along), 1e-12)
    foot = -np.einsum("ek,ek->e", corners, along) / squared
    apart = np.hypot(*(corners + foot[:, None] * along).T)
    reach = np.sqrt(np.maximum(_REACH_M**2 - apart**2, 0.0) / squared)
    low, high = np.clip(foot - reach, 0.0, 1.0), np.clip(foot + reach, 0.0, 1.0)
    near = np.flatnonzero((apart <= _REACH_M) & (low < high))
    length_m = (high - low)[near] * np.sqrt(squared[near])
    count = np.maximum(np.ceil(length_m / _PIECE_M), 1.0).astype(np.intp)
    edge = np.repeat(near, count)  # (pieces,)
    number = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    share = (high - low)[edge] / np.repeat(count, count)
    first, last = low[edge] + number * share, low[edge] + (number + 1) * share

    def place(at: FloatArray) -> FloatArray:
        return (corners[edge] + at[:, None] * along[edge]).T  # (2, pieces)

    nearest, begin, end = place(np.clip(foot[edge], first, last)), place(first), place(last)
    azimuth = np.arctan2(begin[1], begin[0])
    half = 0.5 * _wrapped(np.arctan2(end[1], end[0]) - azimuth)
    return _nearest_m(np.hypot(*nearest), azimuth + half + turn_rad, np.abs(half))


def _corners_ne_m(zone: Zone) -> FloatArray:
    """A zone as a polygon that is never smaller than what is forbidden.  -> (corners, 2)."""
    if not isinstance(zone, CircleZone):
        return np.asarray(zone.vertices_ne_m, dtype=np.float64)
    radius = zone.radius_m
    count = max(math.ceil(math.pi / math.acos(max(1.0 - _SAGITTA_M / radius, 0.0))), 8)
    radius *= 1.0 if zone.keep_in else 1.0 / math.cos(math.pi / count)
    angles = np.arange(count) * (math.tau / count)
    return np.stack(
        [zone.north_m + radius * np.cos(angles), zone.east_m + radius * np.sin(angles)], axis=-1
    )


def _nearest_m(distance_m: FloatArray, azimuth_rad: FloatArray, half_rad: FloatArray) -> FloatArray:
    """The nearest in each sector of things that reach half_rad to both sides of an azimuth.

    (N,) x3 -> (72,), inf where there is none.
    """
    centres = np.arange(SECTORS) * _WIDTH_RAD
    apart = np.abs(_wrapped(azimuth_rad[:, None] - centres))  # (N, 72)
    covers = apart <= half_rad[:, None] + 0.5 * _WIDTH_RAD
    return np.where(covers, distance_m[:, None], np.inf).min(axis=0, initial=np.inf)


def _wrapped(angle_rad: FloatArray) -> FloatArray:
    return (angle_rad + math.pi) % math.tau - math.pi
