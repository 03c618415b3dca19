"""What a beam can hit and a vehicle can touch: ground, trees, walls, buildings and wires.

Every near thing is an upright piece of a straight line with a half-width (a tree is one of no
length, a wall has round ends, a building is a ring of thin ones), from a bottom to a top.  So
distances and beams have closed forms.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, final

import numpy as np

from vehicle_sim.compiled import compiled
from vehicle_sim.geodesy import EARTH_RADIUS_M, FloatArray
from vehicle_sim.terrain import PeakTerrain, Terrain

_GROUND_STEP_M: Final = 1.0
_TINY: Final = 1e-12


@final
class Upright(NamedTuple):
    """A near thing along a line of corners."""

    corners_ne_m: Sequence[tuple[float, float]]
    half_width_m: float
    height_m: float
    """Above the highest ground at a corner."""
    closed: bool = False
    """A building: the line is a ring, and what it encloses is solid."""
    hangs_m: float = math.inf
    """A wire: so thick from its top down, and no lidar sees it.  Other things reach the ground."""


@final
class Scene:
    """Terrain and near things in the local frame."""

    def __init__(self, terrain: Terrain, things: Sequence[Upright]) -> None:
        self.terrain = terrain
        level = isinstance(terrain, PeakTerrain) and terrain.level
        self._level_amsl_m = terrain.height_at_amsl_m(0.0, 0.0) if level else None
        self.things = tuple(things)
        rows = [row for thing in things for row in self._straight(thing)]
        self._pieces = np.array(rows, dtype=np.float64).reshape(-1, 9)
        """From, to, half-width, bottom, top; sides of the building that begins here (0: none does)
        and how far from its first end it reaches.  (K, 9)."""
        self.empty = not rows
        """Whether there is nothing but ground."""

    def _straight(self, thing: Upright) -> list[tuple[float, ...]]:
        """The straight pieces of a thing's line."""
        corners, half_m = list(thing.corners_ne_m), thing.half_width_m
        ends = corners[1:] + corners[:1] if thing.closed else corners[1:] or corners
        ground_m = max(self.terrain.height_at_amsl_m(*corner) for corner in corners)
        top_m = ground_m + thing.height_m
        heights_m, sides = (top_m - thing.hangs_m, top_m), len(ends) if thing.closed else 0
        return [
            (*a, *b, half_m, *heights_m, 0 if k else sides, math.dist(a, b) + half_m)
            for k, (a, b) in enumerate(zip(corners, ends, strict=False))
        ]

    def distance_m(self, points_nea_m: FloatArray) -> FloatArray:
        """To the nearest point of any near thing, the ground not counted.  (P, 3) -> (P,).

        0 inside of one; infinite if there is none.
        """
        points = np.asarray(points_nea_m, dtype=np.float64).reshape(-1, 3)
        return _distances_m(points, self._pieces)

    def ray_lengths_m(
        self, eye_nea_m: Sequence[float] | FloatArray, directions: FloatArray, range_m: float
    ) -> FloatArray:
        """How far beams get: inf where nothing is within range.  (3,), (R, 3) -> (R,).

        Directions are unit vectors (north, east, up).  Beams are straight, and what is a distance
        d away lies d^2 / 2 R_e lower than over a plane.
        """
        eye = np.asarray(eye_nea_m, dtype=np.float64)
        length_m = self._to_ground_m(eye, directions, range_m)
        if not self.empty:
            length_m = _shortened_m(eye, directions, length_m, self._pieces, range_m)
        return np.where(length_m <= range_m, length_m, np.inf)

    def _to_ground_m(self, eye: FloatArray, directions: FloatArray, range_m: float) -> FloatArray:
        """Where beams meet the ground, straight between samples of it.  (3,), (R, 3) -> (R,)."""
        if self._level_amsl_m is not None:
            high_m = max(eye[2] - self._level_amsl_m, 0.0)
            return np.array([_down_to_m(high_m, *way) for way in directions.tolist()])
        steps_m = np.linspace(0.0, range_m, math.ceil(range_m / _GROUND_STEP_M) + 1)
        points = eye + directions[:, None, :] * steps_m[:, None]  # (R, S, 3)
        level2 = (directions[:, None, :2] ** 2).sum(axis=-1)
        points[..., 2] += level2 * steps_m**2 / (2.0 * EARTH_RADIUS_M)
        above_m = points[..., 2] - self.terrain.height_amsl_m(points[..., 0], points[..., 1])
        below = above_m[:, 1:] < 0.0
        k = below.argmax(axis=1)
        ray = np.arange(len(k))
        before_m, after_m = above_m[ray, k], above_m[ray, k + 1]
        share = before_m / np.where(before_m > after_m, before_m - after_m, 1.0)
        met_m = steps_m[k] + np.clip(share, 0.0, 1.0) * (steps_m[1] - steps_m[0])
        return np.where(below.any(axis=1), met_m, np.inf)


def _down_to_m(high_m: float, north: float, east: float, up: float) -> float:
    """Where a beam from so far above a level surface comes down on it; inf: nowhere.

    On the way its height above it is h + u s + c^2 s^2 / 2 R_e.
    """
    bend = (north * north + east * east) / EARTH_RADIUS_M
    root = up * up - 2.0 * bend * high_m
    if up >= 0.0 or root < 0.0:  # or it passes over the horizon
        return math.inf
    return 2.0 * high_m / (math.sqrt(root) - up)


def _in_ring(north: float, east: float, pieces: FloatArray, first: int) -> bool:
    """Whether a building that begins here has a point in it: an odd number of sides east."""
    inside = False
    for k in range(first, first + int(pieces[first, 7])):
        n1, e1, n2, e2 = pieces[k, 0], pieces[k, 1], pieces[k, 2], pieces[k, 3]
        if (n1 > north) != (n2 > north) and east < e1 + (north - n1) / (n2 - n1) * (e2 - e1):
            inside = not inside
    return inside


@compiled(_in_ring)
def _distances_m(points: FloatArray, pieces: FloatArray) -> FloatArray:
    """From points to the nearest piece, or the inside of a building.  (P, 3), (K, 9) -> (P,)."""
    nearest = np.full(len(points), np.inf)
    for i in range(len(points)):
        north, east, altitude = points[i, 0], points[i, 1], points[i, 2]
        for k in range(len(pieces)):
            away_n, away_e = north - pieces[k, 0], east - pieces[k, 1]
            along_n, along_e = pieces[k, 2] - pieces[k, 0], pieces[k, 3] - pieces[k, 1]
            length2 = max(along_n * along_n + along_e * along_e, _TINY)
            share = min(max((away_n * along_n + away_e * along_e) / length2, 0.0), 1.0)
            aside = math.hypot(away_n - share * along_n, away_e - share * along_e) - pieces[k, 4]
            above = max(altitude - pieces[k, 6], pieces[k, 5] - altitude, 0.0)
            if _in_ring(north, east, pieces, k):
                aside = 0.0
            nearest[i] = min(nearest[i], math.hypot(max(aside, 0.0), above))
    return nearest


def _in_footprint(eye: FloatArray, way: FloatArray, piece: FloatArray) -> tuple[float, float]:
    """From where to where a beam is above or in a piece; from inf to -inf: nowhere.

    It comes and goes between the two sides, or beyond an end through the circle there.
    """
    n, e, half_m = piece[2] - piece[0], piece[3] - piece[1], piece[4]
    length = math.hypot(n, e)
    n, e = (n / length, e / length) if length > 0.0 else (1.0, 0.0)
    away_n, away_e = eye[0] - piece[0], eye[1] - piece[1]
    along, across = away_n * n + away_e * e, away_e * n - away_n * e
    ahead, aside = way[0] * n + way[1] * e, way[1] * n - way[0] * e
    if abs(aside) < _TINY:
        aside = _TINY
    square, side_m = max(ahead * ahead + aside * aside, _TINY), math.copysign(half_m, aside)
    enter, leave = (-side_m - across) / aside, (side_m - across) / aside
    for comes in (True, False):
        met = along + (enter if comes else leave) * ahead
        past = along - min(max(met, 0.0), length)
        if met < 0.0 or met > length:
            half = past * ahead + across * aside
            root = half * half - square * (past * past + across * across - half_m * half_m)
            if root < 0.0:
                return math.inf, -math.inf
            if comes:
                enter = (-half - math.sqrt(root)) / square
            else:
                leave = (-half + math.sqrt(root)) / square
    return enter, leave


@compiled(_in_ring, _in_footprint, _down_to_m)
def _shortened_m(
    eye: FloatArray, ways: FloatArray, length_m: FloatArray, pieces: FloatArray, range_m: float
) -> FloatArray:
    """Beams of these lengths at most, to the first thing.  (3,), (R, 3), (R,), (K, 9) -> (R,)."""
    nearest = np.minimum(length_m, range_m + 1.0)
    for k in range(len(pieces)):
        top, starts_ring, is_wire = pieces[k, 6], pieces[k, 7] > 0.0, pieces[k, 5] > -math.inf
        away2 = (eye[0] - pieces[k, 0]) ** 2 + (eye[1] - pieces[k, 1]) ** 2
        if is_wire or (away2 > (range_m + pieces[k, 8]) ** 2 and not starts_ring):
            continue
        for i in range(len(ways)):
            way = ways[i]
            down = 0.0 if eye[2] <= top else _down_to_m(eye[2] - top, way[0], way[1], way[2])
            if down > nearest[i]:
                continue  # it passes above
            if starts_ring and down > 0.0:
                north, east = eye[0] + down * way[0], eye[1] + down * way[1]
                if _in_ring(north, east, pieces, k):
                    nearest[i] = down
            enter, leave = _in_footprint(eye, way, pieces[k])
            met = max(enter, down, 0.0)
            if met > leave or met > nearest[i]:
                continue
            rise = met * way[2] + met * met * (way[0] ** 2 + way[1] ** 2) / (2.0 * EARTH_RADIUS_M)
            if eye[2] + rise <= top + 1e-9:
                nearest[i] = met
    return np.where(nearest < range_m + 1.0, nearest, length_m)
