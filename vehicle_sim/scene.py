"""What a beam can hit and a vehicle can touch: ground, trees, walls, buildings and wires.

Every near thing is an upright piece of a straight line with a half-width (a tree is one of no
length, a wall has round ends, a building is a ring of thin ones), from a bottom to a top.  So
distances and beams have closed forms.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, final

import numpy as np
from scipy.spatial import cKDTree

from vehicle_sim.compiled import compiled
from vehicle_sim.geodesy import EARTH_RADIUS_M
from vehicle_sim.terrain import FloatArray, PeakTerrain, Terrain

_GROUND_STEP_M: Final = 1.0
_TINY: Final = 1e-12


@final
class Upright(NamedTuple):
    """A near thing along a line of corners, at all heights from bottom to top."""

    corners_ne_m: Sequence[tuple[float, float]]
    half_width_m: float
    bottom_amsl_m: float
    top_amsl_m: float
    closed: bool = False
    """A building: the line is a ring, and what it encloses is solid."""
    visible: bool = True
    """To a lidar: a wire is not."""


@final
class Scene:
    """Terrain and near things in the local frame."""

    def __init__(self, terrain: Terrain, things: Sequence[Upright]) -> None:
        self._terrain = terrain
        level = isinstance(terrain, PeakTerrain) and terrain.level
        self._level_amsl_m = terrain.height_at_amsl_m(0.0, 0.0) if level else None
        self.things = tuple(things)
        rows = [row for number, thing in enumerate(things) for row in _pieces(thing, number)]
        self._pieces = np.array(rows, dtype=np.float64).reshape(-1, 10)
        """From, to, half-width, bottom, top, visible, which building (-1: none), and how far from
        its first end it reaches.  (K, 10)."""
        self.empty = not rows
        """Whether there is nothing but ground."""

    def distance_m(self, points_nea_m: FloatArray) -> FloatArray:
        """To the nearest point of any near thing, the ground not counted.  (P, 3) -> (P,).

        0 inside of one; infinite if there is none.
        """
        points = np.asarray(points_nea_m, dtype=np.float64).reshape(-1, 3)
        if self.empty:
            return np.full(len(points), np.inf)
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
        above_m = points[..., 2] - self._terrain.height_amsl_m(points[..., 0], points[..., 1])
        below = above_m[:, 1:] < 0.0
        k = below.argmax(axis=1)
        ray = np.arange(len(k))
        before_m, after_m = above_m[ray, k], above_m[ray, k + 1]
        share = before_m / np.where(before_m > after_m, before_m - after_m, 1.0)
        met_m = steps_m[k] + np.clip(share, 0.0, 1.0) * (steps_m[1] - steps_m[0])
        return np.where(below.any(axis=1), met_m, np.inf)


def _pieces(thing: Upright, number: int) -> list[tuple[float, ...]]:
    """The straight pieces of a thing's line; those of a building stand together."""
    corners = list(thing.corners_ne_m)
    ends = corners[1:] + corners[:1] if thing.closed else corners[1:] or corners
    rest = (thing.half_width_m, thing.bottom_amsl_m, thing.top_amsl_m, float(thing.visible))
    ring = number if thing.closed else -1
    return [
        (*a, *b, *rest, ring, math.dist(a, b) + thing.half_width_m)
        for a, b in zip(corners, ends, strict=False)
    ]


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
    """Whether a building, by its first piece, has a point in it: an odd number of sides east."""
    inside = False
    for k in range(first, len(pieces)):
        if pieces[k, 8] != pieces[first, 8]:
            break
        n1, e1, n2, e2 = pieces[k, 0], pieces[k, 1], pieces[k, 2], pieces[k, 3]
        if (n1 > north) != (n2 > north) and east < e1 + (north - n1) / (n2 - n1) * (e2 - e1):
            inside = not inside
    return inside


def _begins_ring(pieces: FloatArray, k: int) -> bool:
    return bool(pieces[k, 8] >= 0.0 and (k == 0 or pieces[k - 1, 8] != pieces[k, 8]))


@compiled(_in_ring, _begins_ring)
def _distances_m(points: FloatArray, pieces: FloatArray) -> FloatArray:
    """From points to the nearest piece, or the inside of a building.  (P, 3), (K, 10) -> (P,)."""
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
            if _begins_ring(pieces, k) and _in_ring(north, east, pieces, k):
                aside = 0.0
            nearest[i] = min(nearest[i], math.hypot(max(aside, 0.0), above))
    return nearest


def _in_circle(away_n: float, away_e: float, n: float, e: float, r: float) -> tuple[float, float]:
    """From where to where a level way is in a circle about 0; from inf to -inf: nowhere."""
    square = max(n * n + e * e, _TINY)
    half = away_n * n + away_e * e
    root = half * half - square * (away_n * away_n + away_e * away_e - r * r)
    if root < 0.0:
        return math.inf, -math.inf
    return (-half - math.sqrt(root)) / square, (-half + math.sqrt(root)) / square


def _in_stripe(at: float, speed: float, low: float, high: float) -> tuple[float, float]:
    """From where to where something that moves from `at` is between two bounds."""
    if abs(speed) < _TINY:
        speed = _TINY
    one, other = (low - at) / speed, (high - at) / speed
    return min(one, other), max(one, other)


def _in_footprint(eye: FloatArray, way: FloatArray, piece: FloatArray) -> tuple[float, float]:
    """From where to where a beam is above or in a piece: two round ends and what is between."""
    n1, e1, n2, e2, half_m = piece[0], piece[1], piece[2], piece[3], piece[4]
    away_n, away_e = eye[0] - n1, eye[1] - e1
    enter, leave = _in_circle(away_n, away_e, way[0], way[1], half_m)
    length = math.hypot(n2 - n1, e2 - e1)
    if length > 0.0:
        n, e = (n2 - n1) / length, (e2 - e1) / length
        first, last = _in_circle(eye[0] - n2, eye[1] - e2, way[0], way[1], half_m)
        enter, leave = min(enter, first), max(leave, last)
        first, last = _in_stripe(away_n * n + away_e * e, way[0] * n + way[1] * e, 0.0, length)
        other = _in_stripe(away_e * n - away_n * e, way[1] * n - way[0] * e, -half_m, half_m)
        first, last = max(first, other[0]), min(last, other[1])
        if first <= last:
            enter, leave = min(enter, first), max(leave, last)
    return enter, leave


@compiled(_in_ring, _begins_ring, _in_circle, _in_stripe, _in_footprint, _down_to_m)
def _shortened_m(
    eye: FloatArray, ways: FloatArray, length_m: FloatArray, pieces: FloatArray, range_m: float
) -> FloatArray:
    """Beams of these lengths at most, to the first thing.  (3,), (R, 3), (R,), (K, 10) -> (R,)."""
    nearest = np.minimum(length_m, range_m + 1.0)
    for k in range(len(pieces)):
        top, starts_ring = pieces[k, 6], _begins_ring(pieces, k)
        away2 = (eye[0] - pieces[k, 0]) ** 2 + (eye[1] - pieces[k, 1]) ** 2
        is_far = away2 > (range_m + pieces[k, 9]) ** 2
        if pieces[k, 7] == 0.0 or (is_far and not starts_ring):
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


# --- woods ----------------------------------------------------------------------------------------

_CANDIDATES = 4.0  # for each square of the least spacing
_CLUMP = 10.0  # from one clump to the next, in least spacings
_WAVES = 12


def drawn_wood(
    rng: np.random.Generator,
    edges_m: tuple[float, float, float, float],
    spacing_m: tuple[float, float],
    clearing_share: float,
) -> FloatArray:
    """Where trees stand, between south, north, west and east edge.  -> (T, 2).

    A Poisson-disc draw whose spacing varies from place to place between its bounds: clumps, and
    where it would be widest, clearings on about this share of the area.
    """
    south, north, west, east = edges_m
    least_m, most_m = spacing_m
    count = math.ceil(_CANDIDATES * (north - south) * (east - west) / least_m**2)
    places = np.array([south, west]) + rng.random((count, 2)) * [north - south, east - west]
    wave_1_m = rng.normal(size=(2, _WAVES)) * (math.tau / (_CLUMP * least_m))
    level = np.cos(places @ wave_1_m + rng.random(_WAVES) * math.tau).sum(axis=1)
    rank = np.empty(count)
    rank[np.argsort(level, kind="stable")] = (np.arange(count) + 0.5) / count
    apart_m = least_m + (most_m - least_m) * np.minimum(rank / (1.0 - clearing_share + _TINY), 1.0)
    free = rank <= 1.0 - clearing_share
    tree = cKDTree(places)
    kept = []
    for k in np.flatnonzero(free):
        if free[k]:
            kept.append(k)
            near = np.array(tree.query_ball_point(places[k], most_m))
            away_m = np.hypot(*(places[near] - places[k]).T)
            free[near[away_m < np.maximum(apart_m[near], apart_m[k])]] = False
    return places[np.array(kept, dtype=np.intp)]
