"""The true terrain: peaks after eq. 1 of the paper over level ground, and what bounds it.

A peak is h exp(-((n - n0) / s_n)^2 - ((e - e0) / s_e)^2).  In coordinates scaled by 1 / s about its
centre it falls with the distance alone, so its maximum over a convex area lies at the point nearest
to the centre, and its minimum over a box at the farthest corner: both exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, Self, final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
Combine = Literal["maximum", "sum"]
PeakRow = tuple[float, float, float, float, float]
"""North and east of the centre, height AMSL, spread north and east; all in metres."""


class Terrain(Protocol):
    """What the simulator asks of the ground; positions in the local frame, in metres."""

    def height_amsl_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Height of the terrain.  (...), (...) -> (...)."""

    def height_at_amsl_m(self, north_m: float, east_m: float) -> float:
        """Height of the terrain at one point."""

    def highest_in_quads_amsl_m(self, corners_ne_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Highest terrain over convex quadrilaterals, and where.  (C, 4, 2) -> (C,), (C, 2)."""

    def lowest_in_grid_amsl_m(
        self, north_edges_m: FloatArray, east_edges_m: FloatArray
    ) -> FloatArray:
        """Lower bound of the terrain in every cell of a grid.  (N + 1,), (E + 1,) -> (N, E)."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PeakTerrain:
    """Peaks over ground: max(ground, highest peak) or max(ground, sum of the peaks)."""

    combine: Combine
    ground_amsl_m: float
    peak_north_m: FloatArray
    """(P,), as the four below."""
    peak_east_m: FloatArray
    peak_height_m: FloatArray
    spread_north_m: FloatArray
    spread_east_m: FloatArray

    @classmethod
    def of(cls, peaks: Sequence[PeakRow], *, combine: Combine, ground_amsl_m: float) -> Self:
        """The terrain that these peaks make."""
        columns = np.array(peaks, dtype=np.float64).reshape(-1, 5).T.copy()
        return cls(
            combine=combine,
            ground_amsl_m=ground_amsl_m,
            peak_north_m=columns[0],
            peak_east_m=columns[1],
            peak_height_m=columns[2],
            spread_north_m=columns[3],
            spread_east_m=columns[4],
        )

    def _combined_m(self, each_m: FloatArray) -> FloatArray:
        """Peaks along axis 0 -> height of the terrain.  (P, ...) -> (...)."""
        if not len(self.peak_height_m):
            return np.full(each_m.shape[1:], self.ground_amsl_m)
        joined = each_m.max(axis=0) if self.combine == "maximum" else each_m.sum(axis=0)
        return np.maximum(joined, self.ground_amsl_m)

    def _peaks_m(self, away_north_m: FloatArray, away_east_m: FloatArray) -> FloatArray:
        """Height of each peak at these distances from its centre.  (P, ...) -> (P, ...)."""
        if away_north_m.ndim == 1:  # at one point: ten times a second
            x, y = away_north_m / self.spread_north_m, away_east_m / self.spread_east_m
            return self.peak_height_m * np.exp(-x * x - y * y)
        column = (-1, *[1] * (away_north_m.ndim - 1))
        x = away_north_m / self.spread_north_m.reshape(column)
        y = away_east_m / self.spread_east_m.reshape(column)
        return self.peak_height_m.reshape(column) * np.exp(-x * x - y * y)

    def height_amsl_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Height of the terrain.  (...), (...) -> (...)."""
        north, east = np.broadcast_arrays(north_m, east_m)
        column = (-1, *[1] * north.ndim)
        return self._combined_m(
            self._peaks_m(
                north - self.peak_north_m.reshape(column), east - self.peak_east_m.reshape(column)
            )
        )

    def height_at_amsl_m(self, north_m: float, east_m: float) -> float:
        """Height of the terrain at one point."""
        if not len(self.peak_height_m):
            return self.ground_amsl_m
        each_m = self._peaks_m(north_m - self.peak_north_m, east_m - self.peak_east_m)
        joined = max(each_m.tolist()) if self.combine == "maximum" else float(each_m.sum())
        return joined if joined > self.ground_amsl_m else self.ground_amsl_m

    def _peak_bounds_m(
        self, north_m: tuple[FloatArray, FloatArray], east_m: tuple[FloatArray, FloatArray]
    ) -> FloatArray:
        """Exact maximum of every peak over boxes (low, high).  4 x (C,) -> (P, C)."""
        centre_north, centre_east = self.peak_north_m[:, None], self.peak_east_m[:, None]
        return self._peaks_m(
            np.clip(centre_north, *north_m) - centre_north,
            np.clip(centre_east, *east_m) - centre_east,
        )

    def highest_in_quads_amsl_m(self, corners_ne_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Highest terrain over convex quadrilaterals, and where.  (C, 4, 2) -> (C,), (C, 2).

        Exact for "maximum".  For "sum" the height is an upper bound, and the place is where the
        peak that matters most is highest.
        """
        middle = corners_ne_m.mean(axis=1)  # (C, 2)
        low, high = corners_ne_m.min(axis=1), corners_ne_m.max(axis=1)
        height = self.height_amsl_m(middle[:, 0], middle[:, 1])
        near = self._near(low.min(axis=0), high.max(axis=0))
        if not len(near.peak_height_m):
            return height, middle
        bounds = near._peak_bounds_m((low[:, 0], high[:, 0]), (low[:, 1], high[:, 1]))  # (P, C)
        if self.combine == "sum":
            height = near._combined_m(bounds)
            peak, cell = bounds.argmax(axis=0), np.arange(len(middle))
            return height, near._nearest_in_quads_ne_m(peak, corners_ne_m[cell])
        place = middle.copy()
        peak, cell = np.nonzero(bounds > height)  # only these can beat the middle of the cell
        if not len(peak):
            return height, place
        points = near._nearest_in_quads_ne_m(peak, corners_ne_m[cell])
        values = near.peak_height_m[peak] * np.exp(
            -(((points[:, 0] - near.peak_north_m[peak]) / near.spread_north_m[peak]) ** 2)
            - ((points[:, 1] - near.peak_east_m[peak]) / near.spread_east_m[peak]) ** 2
        )
        order = np.argsort(values, kind="stable")  # the highest is written last and stays
        higher = order[values[order] > height[cell[order]]]
        height[cell[higher]], place[cell[higher]] = values[higher], points[higher]
        return height, place

    def _near(self, low_ne_m: FloatArray, high_ne_m: FloatArray) -> "PeakTerrain":
        """The terrain without the peaks that cannot rise above the ground in this box."""
        if self.combine == "sum":
            return self  # every peak adds something everywhere
        bounds = self._peak_bounds_m((low_ne_m[:1], high_ne_m[:1]), (low_ne_m[1:], high_ne_m[1:]))
        keep = bounds[:, 0] > self.ground_amsl_m
        return PeakTerrain(
            combine=self.combine,
            ground_amsl_m=self.ground_amsl_m,
            peak_north_m=self.peak_north_m[keep],
            peak_east_m=self.peak_east_m[keep],
            peak_height_m=self.peak_height_m[keep],
            spread_north_m=self.spread_north_m[keep],
            spread_east_m=self.spread_east_m[keep],
        )

    def _nearest_in_quads_ne_m(self, peak: IntArray, corners_ne_m: FloatArray) -> FloatArray:
        """Where each peak is highest in its quadrilateral.  (K,), (K, 4, 2) -> (K, 2)."""
        centre = np.stack([self.peak_north_m[peak], self.peak_east_m[peak]], axis=-1)[:, None]
        spread = np.stack([self.spread_north_m[peak], self.spread_east_m[peak]], axis=-1)[:, None]
        start = (corners_ne_m - centre) / spread  # (K, 4, 2), the centre is now the origin
        edge = np.roll(start, -1, axis=1) - start
        side = start[..., 0] * edge[..., 1] - start[..., 1] * edge[..., 0]
        inside = np.all(side >= 0.0, axis=1) | np.all(side <= 0.0, axis=1)
        along = -np.sum(start * edge, axis=-1) / np.sum(edge * edge, axis=-1)
        points = start + np.clip(along, 0.0, 1.0)[..., None] * edge
        nearest = np.argmin(np.sum(points * points, axis=-1), axis=1)
        best = points[np.arange(len(points)), nearest]
        best[inside] = 0.0
        return best * spread[:, 0] + centre[:, 0]

    def lowest_in_grid_amsl_m(
        self, north_edges_m: FloatArray, east_edges_m: FloatArray
    ) -> FloatArray:
        """Lower bound of the terrain in every cell of a grid.  (N + 1,), (E + 1,) -> (N, E).

        Each peak's minimum over a box factors into a north and an east part, so a grid costs two
        rows of exponentials and one outer product a peak.
        """
        shape = (len(north_edges_m) - 1, len(east_edges_m) - 1)
        lowest = np.full(shape, self.ground_amsl_m, dtype=np.float64)
        total = np.zeros_like(lowest)
        near = self._near(
            np.array([north_edges_m[0], east_edges_m[0]]),
            np.array([north_edges_m[-1], east_edges_m[-1]]),
        )
        columns = (near.peak_north_m, near.peak_east_m, near.peak_height_m)
        spreads = (near.spread_north_m, near.spread_east_m)
        for north, east, height, s_north, s_east in zip(*columns, *spreads, strict=True):
            x = np.abs(north_edges_m - north) / s_north
            y = np.abs(east_edges_m - east) / s_east
            part_north = height * np.exp(-(np.maximum(x[:-1], x[1:]) ** 2))
            peak = np.outer(part_north, np.exp(-(np.maximum(y[:-1], y[1:]) ** 2)))
            if self.combine == "maximum":
                np.maximum(lowest, peak, out=lowest)
            else:
                total += peak
        return lowest if self.combine == "maximum" else np.maximum(lowest, total)
