"""Distances to many zones of many corners: boxes say what of a zone need be looked at.

The edges of polygons lie in groups of eight, each with a box about it.  An edge is looked at only
for points that it may matter for; what comes out is what `zone.distance_m` says of each zone, and
the least of them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import final

import numpy as np
from numpy.typing import NDArray

from companion.geodesy import BoolArray, FloatArray
from companion.world.threats import CircleZone, PolygonZone, Zone, edges_of

IntArray = NDArray[np.intp]
_GROUP = 8  # edges to a box
_AT_ONCE = 400_000  # pairs of points and zones
_GROUPS_AT_ONCE = 200_000  # groups of edges, each with a point


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ZoneIndex:
    """Zones, and boxes about them and about their edges: south, north, west, east."""

    zones: tuple[Zone, ...]
    boxes: FloatArray  # (zones, 4)
    keep_in: BoolArray  # (zones,)
    circles: tuple[CircleZone, ...]
    polygons: IntArray  # (polygons,): their numbers among the zones
    first_group: IntArray  # (polygons,)
    groups: IntArray  # (polygons,): how many
    edges: FloatArray  # (4, groups, 8): north, east of both ends; short groups end with points
    group_boxes: FloatArray  # (4, groups)

    def near(
        self, low_ne_m: tuple[float, float], high_ne_m: tuple[float, float], within_m: float
    ) -> tuple[Zone, ...]:
        """Zones that may be nearer than that to some point of an area, or forbid it.

        low_ne_m, high_ne_m: its south-western and north-eastern corner.
        """
        south, north, west, east = self.boxes.T
        gap_n = np.maximum(south - high_ne_m[0], low_ne_m[0] - north)
        gap_e = np.maximum(west - high_ne_m[1], low_ne_m[1] - east)
        apart = np.hypot(np.maximum(gap_n, 0.0), np.maximum(gap_e, 0.0))
        return tuple(self.zones[k] for k in np.flatnonzero((apart < within_m) | self.keep_in))

    def nearest(self, north_m: float, east_m: float) -> tuple[Zone | None, float]:
        """The zone that is the nearest to a point, or forbids it the most, and its distance."""
        gaps = _box_gaps_m(self.boxes.T, np.array([[north_m]]), np.array([[east_m]]))[0]
        gaps = np.where(self.keep_in, 0.0, gaps)
        best: tuple[Zone | None, float] = (None, np.inf)
        for k in np.argsort(gaps, kind="stable"):
            if gaps[k] > max(best[1], 0.0):
                break
            gap_m = float(self.zones[k].distance_m(np.asarray(north_m), np.asarray(east_m)))
            if gap_m < best[1]:
                best = self.zones[k], gap_m
        return best

    def gaps_m(
        self, north_m: FloatArray, east_m: FloatArray, within_m: float = np.inf
    ) -> FloatArray:
        """Distance to the nearest zone, negative where one forbids to be, metres.

        (...) x2 -> (...).  within_m: farther ones count as so far away.
        """
        shape = np.broadcast_shapes(np.shape(north_m), np.shape(east_m))
        north, east = (
            np.ascontiguousarray(np.broadcast_to(part, shape), dtype=np.float64).reshape(-1)
            for part in (north_m, east_m)
        )
        result = np.full(len(north), within_m)
        for circle in self.circles:
            np.minimum(result, circle.distance_m(north, east), out=result)
        step = max(_AT_ONCE // max(len(self.polygons), 1), 1)
        for first in range(0, len(north) if len(self.polygons) else 0, step):
            part = slice(first, first + step)
            self._to_polygons(north[part], east[part], result[part])
        return result.reshape(shape)

    def polygons_forbid(self, north_m: FloatArray, east_m: FloatArray) -> BoolArray:
        """Whether some polygon forbids to be there.  (N,) x2 -> (N,)."""
        found = np.zeros(len(north_m), dtype=bool)
        boxes = self.boxes[self.polygons].T
        apart = _box_gaps_m(boxes, north_m[:, None], east_m[:, None])
        point, polygon = np.nonzero((apart == 0.0) | self.keep_in[self.polygons])
        for part in self._portions(polygon):
            pairs = self._pairs_of(north_m, east_m, point[part], polygon[part])
            found[point[part][self._are_forbidden(pairs, polygon[part])]] = True
        return found

    def _to_polygons(self, north: FloatArray, east: FloatArray, result: FloatArray) -> None:
        """Lower `result` to the distances of polygons.  (N,) x3."""
        apart = _box_gaps_m(self.boxes[self.polygons].T, north[:, None], east[:, None])
        may_matter = (apart < result[:, None]) | (apart == 0.0) | self.keep_in[self.polygons]
        point, polygon = np.nonzero(may_matter)
        for part in self._portions(polygon):
            pairs = self._pairs_of(north, east, point[part], polygon[part])
            forbidden = self._are_forbidden(pairs, polygon[part])
            nearest = self._nearest_m(pairs, forbidden, result[point[part]])
            np.minimum.at(result, point[part], np.where(forbidden, -nearest, nearest))

    def _portions(self, polygon: IntArray) -> Iterator[slice]:
        """Pairs of points and polygons in portions, so that none takes much memory.  (P,)."""
        ends = np.cumsum(self.groups[polygon])
        first = 0
        while first < len(polygon):
            done = int(ends[first - 1]) if first else 0
            last = max(int(np.searchsorted(ends, done + _GROUPS_AT_ONCE, side="right")), first + 1)
            yield slice(first, last)
            first = last

    def _pairs_of(
        self, north: FloatArray, east: FloatArray, point: IntArray, polygon: IntArray
    ) -> "_Pairs":
        """Each pair of a point and a polygon, with each group of its edges.  (N,) x2, (P,) x2."""
        size = self.groups[polygon]
        starts = np.cumsum(size) - size
        pair = np.repeat(np.arange(len(point)), size)
        group = np.arange(len(pair)) + np.repeat(self.first_group[polygon] - starts, size)
        return _Pairs(
            starts=starts,
            pair=pair,
            group=group,
            north=north[point][pair],
            east=east[point][pair],
        )

    def _are_forbidden(self, pairs: "_Pairs", polygon: IntArray) -> BoolArray:
        """Of each pair, whether the polygon forbids the point (even-odd rule).  -> (P,)."""
        _, high, west, east = (side[pairs.group] for side in self.group_boxes)
        on = np.flatnonzero((west <= pairs.east) & (pairs.east <= east) & (pairs.north <= high))
        an, ae, bn, be = self.edges[:, pairs.group[on]]  # (X, 8)
        n, e, de = pairs.north[on, None], pairs.east[on, None], be - ae
        divisor = np.where(de == 0.0, 1.0, de)  # an edge that runs north crosses no line
        crosses = ((ae > e) != (be > e)) & (n < an + (e - ae) * (bn - an) / divisor)
        count = np.zeros(len(polygon), dtype=np.intp)
        np.add.at(count, pairs.pair[on], np.count_nonzero(crosses, axis=1))
        return (count % 2 == 1) != self.keep_in[self.polygons[polygon]]

    def _nearest_m(self, pairs: "_Pairs", forbidden: BoolArray, enough_m: FloatArray) -> FloatArray:
        """Of each pair, the distance to the polygon's edges; where allowed, `enough_m` is enough.

        (P,) x2 -> (P,).
        """
        first_n, first_e = self.edges[:2, pairs.group, 0]  # no edge is farther than this
        most = np.hypot(pairs.north - first_n, pairs.east - first_e)
        most = np.minimum.reduceat(most, pairs.starts)
        most = np.where(forbidden, most, np.minimum(most, enough_m))
        south, north, west, east = (side[pairs.group] for side in self.group_boxes)
        gap = np.hypot(
            np.maximum(np.maximum(south - pairs.north, pairs.north - north), 0.0),
            np.maximum(np.maximum(west - pairs.east, pairs.east - east), 0.0),
        )
        near = np.flatnonzero(gap <= most[pairs.pair])
        an, ae, bn, be = self.edges[:, pairs.group[near]]  # (Y, 8)
        n, e, dn, de = pairs.north[near, None] - an, pairs.east[near, None] - ae, bn - an, be - ae
        squared = np.maximum(dn * dn + de * de, 1e-12)
        along = np.clip((n * dn + e * de) / squared, 0.0, 1.0)
        np.minimum.at(most, pairs.pair[near], np.hypot(n - along * dn, e - along * de).min(axis=1))
        return most


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pairs:
    """P pairs of a point and a polygon, with each group of its edges: Q rows."""

    starts: IntArray  # (P,): the first row of each pair
    pair: IntArray  # (Q,)
    group: IntArray  # (Q,)
    north: FloatArray  # (Q,): of the point; `east` likewise
    east: FloatArray


def _box_gaps_m(boxes: FloatArray, north: FloatArray, east: FloatArray) -> FloatArray:
    """Distance of points from boxes, 0 within.  (4, K), (N, 1) x2 -> (N, K)."""
    south, north_, west, east_ = boxes
    return np.hypot(
        np.maximum(np.maximum(south - north, north - north_), 0.0),
        np.maximum(np.maximum(west - east, east - east_), 0.0),
    )


@lru_cache(maxsize=8)
def index_of(zones: tuple[Zone, ...]) -> ZoneIndex:
    """The index of some zones; kept, not to be changed."""
    polygons = [k for k, zone in enumerate(zones) if not isinstance(zone, CircleZone)]
    corners = [edges_of(zone.vertices_ne_m) for zone in zones if isinstance(zone, PolygonZone)]
    count = np.array([len(each) for each in corners], dtype=np.intp)
    size = -(-count // _GROUP)
    every = _in_groups(np.concatenate([np.empty((0, 4)), *corners]), count, size)
    low = np.minimum(every[..., :2], every[..., 2:]).min(axis=1)
    high = np.maximum(every[..., :2], every[..., 2:]).max(axis=1)
    first = np.cumsum(size) - size
    boxes = np.array([_box(zone) if isinstance(zone, CircleZone) else (0.0,) * 4 for zone in zones])
    boxes = boxes.reshape(-1, 4)
    if polygons:
        boxes[polygons, 0::2] = np.minimum.reduceat(low, first)
        boxes[polygons, 1::2] = np.maximum.reduceat(high, first)
    return ZoneIndex(
        zones=zones,
        boxes=boxes,
        keep_in=np.array([zone.keep_in for zone in zones], dtype=bool),
        circles=tuple(zone for zone in zones if isinstance(zone, CircleZone)),
        polygons=np.array(polygons, dtype=np.intp),
        first_group=first,
        groups=size,
        edges=np.ascontiguousarray(every.transpose(2, 0, 1)),
        group_boxes=np.ascontiguousarray(np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]])),
    )


def _box(circle: CircleZone) -> tuple[float, float, float, float]:
    n, e, r = circle.north_m, circle.east_m, circle.radius_m
    return n - r, n + r, e - r, e + r


def _in_groups(edges: FloatArray, count: IntArray, size: IntArray) -> FloatArray:
    """Edges of polygons, so many of each, in so many groups.  (M, 4), (Z,) x2 -> (groups, 8, 4).

    The last group of each is filled up with its last corner, over and over.
    """
    result = np.empty((int(size.sum()) * _GROUP, 4))
    result[:] = np.repeat(np.tile(edges[np.cumsum(count) - 1, 2:], 2), size * _GROUP, axis=0)
    shift = np.cumsum(size * _GROUP - count) - (size * _GROUP - count)
    result[np.arange(len(edges)) + np.repeat(shift, count)] = edges
    return result.reshape(-1, _GROUP, 4)
