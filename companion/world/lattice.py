"""Square cells in the local frame: what all maps of the world are made of.

Rows go to the north, columns to the east.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.geodesy import FloatArray

IntArray = NDArray[np.intp]
Window = tuple[slice, slice]  # rows and columns of a lattice, start and stop on it

_ON_EDGE_M = 1e-3
"""So near below an edge between cells a point is taken to be on it: far above rounding of positions
(1e-9 m), far below what a map resolves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lattice:
    """Where the cells of an array are, in the local frame.  Maps are lattices with values."""

    cell_m: float
    north_min_m: float
    east_min_m: float
    shape: tuple[int, int]
    """Rows and columns."""

    def bare(self) -> "Lattice":
        """The lattice without what a map has in its cells."""
        return Lattice(
            cell_m=self.cell_m,
            north_min_m=self.north_min_m,
            east_min_m=self.east_min_m,
            shape=self.shape,
        )

    def cell_of(self, north_m: float, east_m: float) -> tuple[int, int]:
        """Row and column of the cell that holds a point (may lie outside the lattice).

        A mission often begins on an edge between cells: of that, and a millimetre short of it, it
        is the cell to the north or east, whatever the last digits of the position are.
        """
        return (
            math.floor((north_m - self.north_min_m + _ON_EDGE_M) / self.cell_m),
            math.floor((east_m - self.east_min_m + _ON_EDGE_M) / self.cell_m),
        )

    def middles_m(
        self, row: int, column: int, shape: tuple[int, ...]
    ) -> tuple[FloatArray, FloatArray]:
        """North (rows, 1) and east (1, columns) of the middles of a window of cells, metres."""
        north = self.north_min_m + np.arange(row + 0.5, row + shape[0]) * self.cell_m
        east = self.east_min_m + np.arange(column + 0.5, column + shape[1]) * self.cell_m
        return north[:, None], east[None, :]

    def about(self, points_ne_m: FloatArray, reach_m: float) -> Window:
        """The cells of the lattice within reach of a rectangle around points.  (N, 2)."""
        corner = np.array([self.north_min_m, self.east_min_m])
        low, high = points_ne_m.min(axis=0) - reach_m, points_ne_m.max(axis=0) + reach_m
        first = np.floor((low - corner) / self.cell_m).astype(np.intp)
        last = np.floor((high - corner) / self.cell_m).astype(np.intp) + 1
        (row, column), (row_end, column_end) = (
            np.clip(each, 0, self.shape).tolist() for each in (first, last)
        )
        return slice(row, row_end), slice(column, column_end)
