"""What a beam can hit and a vehicle can touch: ground, trees, walls, buildings and wires.

Every near thing is an upright piece of a straight line with a half-width (a tree is one of no
length, a wall has round ends, a building is a ring of thin ones), from a bottom to a top.  So
distances and beams have closed forms.  The pieces are short, and a tree of their middles finds
those that matter.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
import scipy
from numpy.typing import NDArray

from vehicle_sim.geodesy import EARTH_RADIUS_M
from vehicle_sim.terrain import FloatArray, PeakTerrain, Terrain

_PIECE_M = 8.0
_GROUND_STEP_M = 1.0
_TINY = 1e-12
_POINTS_AT_ONCE = 4096


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
        level = isinstance(terrain, PeakTerrain) and not len(terrain.peak_height_m)
        self._level_amsl_m = terrain.height_at_amsl_m(0.0, 0.0) if level else None
        self.things = tuple(things)
        rows = [row for thing in things for row in _pieces(thing)]
        columns = np.array(rows, dtype=np.float64).reshape(-1, 8).T
        self._from_ne_m, self._to_ne_m = columns[:2].T.copy(), columns[2:4].T.copy()
        self._half_width_m, self._bottom_m, self._top_m = columns[4:7]
        self._visible = columns[7] > 0.0
        middles = 0.5 * (self._from_ne_m + self._to_ne_m)
        halves_m = 0.5 * np.hypot(*(self._to_ne_m - self._from_ne_m).T) + self._half_width_m
        self._farthest_m = float(halves_m.max(initial=0.0))
        """No point of a piece is farther from its middle."""
        self._middles = scipy.spatial.cKDTree(middles) if len(middles) else None
        self.empty = self._middles is None
        """Whether there is nothing but ground."""
        self._solids = [_Solid.of(thing) for thing in things if thing.closed]

    def distance_m(self, points_nea_m: FloatArray) -> FloatArray:
        """To the nearest point of any near thing, the ground not counted.  (P, 3) -> (P,).

        0 inside of one; infinite if there is none.
        """
        points = np.asarray(points_nea_m, dtype=np.float64).reshape(-1, 3)
        if self._middles is None:
            return np.full(len(points), np.inf)
        parts = range(0, len(points), _POINTS_AT_ONCE)
        found = [self._distance_m(points[k : k + _POINTS_AT_ONCE]) for k in parts]
        return np.concatenate([np.empty(0), *found])

    def _distance_m(self, points: FloatArray) -> FloatArray:
        assert self._middles is not None
        _, nearest = self._middles.query(points[:, :2])
        most_m = self._to_pieces_m(points, np.asarray(nearest, dtype=np.intp))
        near = self._middles.query_ball_point(points[:, :2], most_m + self._farthest_m + 1e-6)
        counts = np.array([len(each) for each in near])
        pieces = np.concatenate(near).astype(np.intp)
        each_m = self._to_pieces_m(np.repeat(points, counts, axis=0), pieces)
        distance_m = np.minimum.reduceat(each_m, np.cumsum(counts) - counts)
        for solid in self._solids:
            inside = solid.contains(points[:, :2])
            above_m = np.maximum(points[inside, 2] - solid.top_amsl_m, 0.0)
            distance_m[inside] = np.minimum(distance_m[inside], above_m)
        return distance_m

    def _to_pieces_m(self, points: FloatArray, pieces: NDArray[np.intp]) -> FloatArray:
        """From each point to a piece.  (K, 3), (K,) -> (K,)."""
        start, along = self._from_ne_m[pieces], self._to_ne_m[pieces] - self._from_ne_m[pieces]
        away = points[:, :2] - start
        length2 = np.maximum((along * along).sum(axis=1), _TINY)
        share = np.clip((away * along).sum(axis=1) / length2, 0.0, 1.0)
        aside_m = np.hypot(*(away - share[:, None] * along).T) - self._half_width_m[pieces]
        above_m = np.maximum(
            points[:, 2] - self._top_m[pieces], self._bottom_m[pieces] - points[:, 2]
        )
        return np.hypot(np.maximum(aside_m, 0.0), np.maximum(above_m, 0.0))

    def ray_lengths_m(
        self, eye_nea_m: Sequence[float] | FloatArray, directions: FloatArray, range_m: float
    ) -> FloatArray:
        """How far beams get: inf where nothing is within range.  (3,), (R, 3) -> (R,).

        Directions are unit vectors (north, east, up).  Beams are straight, and what is a distance
        d away lies d^2 / 2 R_e lower than over a plane.
        """
        eye = np.asarray(eye_nea_m, dtype=np.float64)
        length_m = self._to_ground_m(eye, directions, range_m)
        if self._middles is not None:
            near = np.array(
                self._middles.query_ball_point(eye[:2], range_m + self._farthest_m), dtype=np.intp
            )
            near = near[self._visible[near]]
            if len(near):
                met_m = self._to_things_m(eye, directions, near)
                length_m = np.minimum(length_m, met_m)
            for solid in self._solids:
                solid.cut_by_roof(eye, directions, length_m)
        return np.where(length_m <= range_m, length_m, np.inf)

    def _to_things_m(
        self, eye: FloatArray, directions: FloatArray, near: NDArray[np.intp]
    ) -> FloatArray:
        """Where beams enter the first of these pieces.  (3,), (R, 3), (K,) -> (R,)."""
        along_m = self._to_ne_m[near] - self._from_ne_m[near]
        half_m, away = self._half_width_m[near], eye[:2] - self._from_ne_m[near]
        ways = directions[:, :2]
        square = _not_zero((ways * ways).sum(axis=1))[:, None]
        enter, leave = _round(away, ways, square, half_m)
        if (long := np.flatnonzero(along_m.any(axis=1))).size:  # trees have one end and no sides
            length_m = np.hypot(*along_m[long].T)
            unit, back = along_m[long] / length_m[:, None], away[long]
            ahead, ahead_s = (back * unit).sum(axis=1), _not_zero(ways @ unit.T)
            left = np.stack([-unit[:, 1], unit[:, 0]], axis=-1)
            aside, aside_s = (back * left).sum(axis=1), _not_zero(ways @ left.T)
            first, last = _overlap(
                _between(ahead, ahead_s, 0.0, length_m),
                _between(aside, aside_s, -half_m[long], half_m[long]),
            )
            sides = np.where(first > last, np.inf, first), np.where(first > last, -np.inf, last)
            for other in (sides, _round(back - along_m[long], ways, square, half_m[long])):
                enter[:, long] = np.minimum(enter[:, long], other[0])
                leave[:, long] = np.maximum(leave[:, long], other[1])
        middles = 0.5 * (self._from_ne_m[near] + self._to_ne_m[near])
        drop_m = ((middles - eye[:2]) ** 2).sum(axis=1) / (2.0 * EARTH_RADIUS_M)
        bottom_m, top_m = self._bottom_m[near] - drop_m, self._top_m[near] - drop_m
        enter, leave = _overlap(
            (enter, leave), _between(eye[2], _not_zero(directions[:, 2:]), bottom_m, top_m)
        )
        enter = np.maximum(enter, 0.0)
        nearest: FloatArray = np.where(enter <= leave, enter, np.inf).min(axis=1)
        return nearest

    def _to_ground_m(self, eye: FloatArray, directions: FloatArray, range_m: float) -> FloatArray:
        """Where beams meet the ground, straight between samples of it.  (3,), (R, 3) -> (R,)."""
        if self._level_amsl_m is not None:
            return _to_level_m(eye[2] - self._level_amsl_m, directions)
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


@final
@dataclass(frozen=True, slots=True)
class _Solid:
    """The inside of a building."""

    corners_ne_m: FloatArray
    top_amsl_m: float

    @classmethod
    def of(cls, thing: Upright) -> "_Solid":
        return cls(np.array(thing.corners_ne_m, dtype=np.float64), thing.top_amsl_m)

    def contains(self, points_ne_m: FloatArray) -> NDArray[np.bool_]:
        """By the number of sides to the east of each point.  (P, 2) -> (P,)."""
        low, high = self.corners_ne_m.min(axis=0), self.corners_ne_m.max(axis=0)
        inside: NDArray[np.bool_] = ((points_ne_m >= low) & (points_ne_m <= high)).all(axis=1)
        if not inside.any():
            return inside
        (n1, e1), (n2, e2) = self.corners_ne_m.T, np.roll(self.corners_ne_m, -1, axis=0).T
        north, east = points_ne_m[inside, 0, None], points_ne_m[inside, 1, None]
        rise = np.where(n2 == n1, 1.0, n2 - n1)
        crossed = ((n1 > north) != (n2 > north)) & (east < e1 + (north - n1) / rise * (e2 - e1))
        inside[inside] = crossed.sum(axis=1) % 2 == 1
        return inside

    def cut_by_roof(self, eye: FloatArray, directions: FloatArray, length_m: FloatArray) -> None:
        """Shorten the beams that come down on the roof.  (3,), (R, 3), (R,)."""
        high_m = eye[2] - self.top_amsl_m
        if high_m <= 0.0:
            return
        to_roof_m = _to_level_m(high_m, directions)
        try_these = np.flatnonzero(to_roof_m < np.minimum(length_m, 1e6))
        points = eye[:2] + directions[try_these, :2] * to_roof_m[try_these, None]
        met = try_these[self.contains(points)]
        length_m[met] = to_roof_m[met]


def _pieces(thing: Upright) -> list[tuple[float, ...]]:
    """Short pieces of a thing's line: from, to, half-width, bottom, top, visible."""
    corners = list(thing.corners_ne_m)
    ends = corners[1:] + corners[:1] if thing.closed else corners[1:] or corners
    rest = (thing.half_width_m, thing.bottom_amsl_m, thing.top_amsl_m, float(thing.visible))
    rows = list[tuple[float, ...]]()
    for (n1, e1), (n2, e2) in zip(corners, ends, strict=False):
        count = max(math.ceil(math.hypot(n2 - n1, e2 - e1) / _PIECE_M), 1)
        norths, easts = np.linspace(n1, n2, count + 1), np.linspace(e1, e2, count + 1)
        for k in range(count):
            rows.append((norths[k], easts[k], norths[k + 1], easts[k + 1], *rest))
    return rows


def _to_level_m(high_m: float, directions: FloatArray) -> FloatArray:
    """Where beams from so far above a level surface come down on it.  (R, 3) -> (R,).

    On the way their height above it is h + u s + c^2 s^2 / 2 R_e.
    """
    up, bend = directions[:, 2], (directions[:, :2] ** 2).sum(axis=1) / EARTH_RADIUS_M
    root = up * up - 2.0 * bend * max(high_m, 0.0)
    met = (up < 0.0) & (root >= 0.0)  # else beyond the horizon
    down = np.where(met, np.sqrt(np.maximum(root, 0.0)) - up, 1.0)
    return np.where(met, 2.0 * max(high_m, 0.0) / down, np.inf)


def _not_zero(speed: FloatArray) -> FloatArray:
    """To divide by."""
    return np.where(np.abs(speed) < _TINY, _TINY, speed)


_Span = tuple[FloatArray, FloatArray]
"""Where beams are between two bounds: from, to."""


def _between(
    at: FloatArray | float,
    speed: FloatArray,
    low: FloatArray | float,
    high: FloatArray | float,
) -> _Span:
    one, other = (low - at) / speed, (high - at) / speed
    return np.minimum(one, other), np.maximum(one, other)


def _round(away: FloatArray, ways: FloatArray, square: FloatArray, radius_m: FloatArray) -> _Span:
    """Where beams are in circles; from inf to -inf: nowhere.  (K, 2), (R, 2), (R, 1), (K,)."""
    half = ways @ away.T
    root = half * half - square * ((away * away).sum(axis=1) - radius_m * radius_m)
    met, wide = root >= 0.0, np.sqrt(np.maximum(root, 0.0))
    enter, leave = (-half - wide) / square, (-half + wide) / square
    return np.where(met, enter, np.inf), np.where(met, leave, -np.inf)


def _overlap(one: _Span, other: _Span) -> _Span:
    return np.maximum(one[0], other[0]), np.minimum(one[1], other[1])


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
    tree = scipy.spatial.cKDTree(places)
    kept = []
    for k in np.flatnonzero(free):
        if free[k]:
            kept.append(k)
            near = np.array(tree.query_ball_point(places[k], most_m))
            away_m = np.hypot(*(places[near] - places[k]).T)
            free[near[away_m < np.maximum(apart_m[near], apart_m[k])]] = False
    return places[np.array(kept, dtype=np.intp)]
