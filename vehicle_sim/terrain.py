"""The true terrain: peaks after eq. 1 of the paper over level ground, and what bounds it.

A peak is h exp(-((n - n0) / s_n)^2 - ((e - e0) / s_e)^2).  In coordinates scaled by 1 / s about its
centre it falls with the distance alone, so its maximum over a convex area lies at the point nearest
to the centre, and its minimum over a box at the farthest corner: both exact.
"""

import math
from collections.abc import Sequence
from typing import Literal, Protocol, final

import numpy as np
from numpy.typing import NDArray

from vehicle_sim.compiled import compiled

FloatArray = NDArray[np.float64]
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
class PeakTerrain:
    """Peaks over ground: max(ground, highest peak) or max(ground, sum of the peaks)."""

    def __init__(self, peaks: Sequence[PeakRow], *, combine: Combine, ground_amsl_m: float) -> None:
        self.combine, self.ground_amsl_m = combine, float(ground_amsl_m)
        self._peaks = np.array(peaks, dtype=np.float64).reshape(-1, 5)
        self._rows = self._peaks.tolist()  # for single points, ten times a second
        self.level = not len(peaks)
        """There is nothing but the ground."""

    def height_amsl_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Height of the terrain.  (...), (...) -> (...)."""
        north, east = np.broadcast_arrays(north_m, east_m)
        n, e, height, s_n, s_e = self._peaks.T.reshape(5, -1, *[1] * north.ndim)
        return self._joined(height * np.exp(-(((north - n) / s_n) ** 2) - ((east - e) / s_e) ** 2))

    def _joined(self, peaks_m: FloatArray) -> FloatArray:
        """What peaks and the ground make together.  (P, ...) -> (...)."""
        if self.combine == "maximum" or self.level:
            return peaks_m.max(axis=0, initial=self.ground_amsl_m)
        return np.maximum(peaks_m.sum(axis=0), self.ground_amsl_m)

    def height_at_amsl_m(self, north_m: float, east_m: float) -> float:
        """Height of the terrain at one point."""
        if self.level:
            return self.ground_amsl_m
        each_m = [
            height * math.exp(-(((north_m - n) / s_n) ** 2) - ((east_m - e) / s_e) ** 2)
            for n, e, height, s_n, s_e in self._rows
        ]
        return max(self.ground_amsl_m, max(each_m) if self.combine == "maximum" else sum(each_m))

    def highest_in_quads_amsl_m(self, corners_ne_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Highest terrain over convex quadrilaterals, and where.  (C, 4, 2) -> (C,), (C, 2).

        Exact for "maximum".  For "sum" the height is an upper bound, and the place is where the
        peak that matters most is highest.
        """
        adds = self.combine == "sum"
        return _highest_in_quads(corners_ne_m, self._peaks, self.ground_amsl_m, adds)

    def lowest_in_grid_amsl_m(
        self, north_edges_m: FloatArray, east_edges_m: FloatArray
    ) -> FloatArray:
        """Lower bound of the terrain in every cell of a grid.  (N + 1,), (E + 1,) -> (N, E).

        Each peak's minimum over a box factors into a north and an east part.
        """
        n, e, height, s_n, s_e = self._peaks.T[..., None]  # (P, 1) each
        x, y = np.abs(north_edges_m - n) / s_n, np.abs(east_edges_m - e) / s_e
        part_north = height * np.exp(-(np.maximum(x[:, :-1], x[:, 1:]) ** 2))  # (P, N)
        part_east = np.exp(-(np.maximum(y[:, :-1], y[:, 1:]) ** 2))  # (P, E)
        return self._joined(part_north[:, :, None] * part_east[:, None])


def _nearest_in_quad(quad: FloatArray, peak: FloatArray) -> tuple[float, float]:
    """Where a peak is highest in a convex quadrilateral: nearest to its centre, scaled.  (4, 2)."""
    best2, best_n, best_e, lefts = math.inf, 0.0, 0.0, 0
    for k in range(4):
        n1, e1 = (quad[k, 0] - peak[0]) / peak[3], (quad[k, 1] - peak[1]) / peak[4]
        n2, e2 = (quad[k - 3, 0] - peak[0]) / peak[3], (quad[k - 3, 1] - peak[1]) / peak[4]
        edge_n, edge_e = n2 - n1, e2 - e1
        side = n1 * edge_e - e1 * edge_n
        lefts += 1 if side > 0.0 else -1 if side < 0.0 else 0
        share = -(n1 * edge_n + e1 * edge_e) / max(edge_n * edge_n + edge_e * edge_e, 1e-300)
        share = min(max(share, 0.0), 1.0)
        n, e = n1 + share * edge_n, e1 + share * edge_e
        if n * n + e * e < best2:
            best2, best_n, best_e = n * n + e * e, n, e
    if abs(lefts) == 4:  # the centre is inside
        return peak[0], peak[1]
    return peak[0] + best_n * peak[3], peak[1] + best_e * peak[4]


@compiled(_nearest_in_quad)
def _highest_in_quads(
    quads: FloatArray, peaks: FloatArray, ground_amsl_m: float, adds: bool
) -> tuple[FloatArray, FloatArray]:
    """Height and place of the highest point.  (C, 4, 2), (P, 5) -> (C,), (C, 2)."""
    highest, place = np.full(len(quads), ground_amsl_m), np.empty((len(quads), 2))
    for k in range(len(quads)):
        place[k, 0], place[k, 1] = quads[k, :, 0].mean(), quads[k, :, 1].mean()
        best, total = 0.0, 0.0
        for peak in peaks:
            if not adds and peak[2] <= highest[k]:
                continue
            north, east = _nearest_in_quad(quads[k], peak)
            x, y = (north - peak[0]) / peak[3], (east - peak[1]) / peak[4]
            height = peak[2] * math.exp(-x * x - y * y)
            total += height
            if height > best and (adds or height > highest[k]):
                best, place[k, 0], place[k, 1] = height, north, east
            highest[k] = max(highest[k], total if adds else height)
    return highest, place
