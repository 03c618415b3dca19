"""A scan of a world that is known: what the radar would show, for planning without a vehicle."""

import math
from dataclasses import dataclass
from typing import Self, final

import numpy as np

from companion.world.known_map import NOT_SEEN, KnownMap, Scan, sight_line_m
from companion.world.terrain import Terrain


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """The terrain on the lattice of a map, rasterised where it is looked at.

    So a scan takes as long in a big world as in a small one.
    """

    terrain: Terrain
    cell_m: float
    north_min_m: float
    east_min_m: float
    shape: tuple[int, int]
    """Rows and columns."""

    @classmethod
    def of(cls, terrain: Terrain, like: KnownMap) -> Self:
        """The truth behind a map."""
        return cls(
            terrain=terrain,
            cell_m=like.cell_m,
            north_min_m=like.north_min_m,
            east_min_m=like.east_min_m,
            shape=(like.upper_m.shape[0], like.upper_m.shape[1]),
        )

    def part(self, rows: slice, columns: slice) -> KnownMap:
        """A map of which everything is known: the highest terrain of each cell, in whole metres."""
        south = self.north_min_m + rows.start * self.cell_m
        west = self.east_min_m + columns.start * self.cell_m
        north = (south + np.arange(rows.stop - rows.start) * self.cell_m)[:, None]
        east = (west + np.arange(columns.stop - columns.start) * self.cell_m)[None, :]
        highest = self.terrain.highest_in_box_m(
            north, north + self.cell_m, east, east + self.cell_m
        )
        return KnownMap(
            cell_m=self.cell_m,
            north_min_m=south,
            east_min_m=west,
            upper_m=np.ceil(highest),
            seen=np.ones(highest.shape, dtype=bool),
        )


def true_map(terrain: Terrain, like: KnownMap) -> KnownMap:
    """The truth of a whole map at once."""
    rows, columns = like.upper_m.shape
    return Truth.of(terrain, like).part(slice(0, rows), slice(0, columns))


def simulated_scan(
    truth: KnownMap | Truth, radar_nea_m: tuple[float, float, float], range_m: float
) -> Scan:
    """What a radar at a point sees of the truth: cells in range that nothing hides."""
    rows, columns = truth.shape if isinstance(truth, Truth) else truth.upper_m.shape
    row = math.floor((radar_nea_m[0] - truth.north_min_m) / truth.cell_m)
    column = math.floor((radar_nea_m[1] - truth.east_min_m) / truth.cell_m)
    half = math.ceil(range_m / truth.cell_m)
    south, north = np.clip([row - half, row + half + 1], 0, rows).tolist()
    west, east = np.clip([column - half, column + half + 1], 0, columns).tolist()
    here = truth.part(slice(south, north), slice(west, east))
    heights = here.upper_m.copy()
    north_m, east_m = here.middles_m(0, 0, (heights.shape[0], heights.shape[1]))
    in_range = np.hypot(north_m - radar_nea_m[0], east_m - radar_nea_m[1]) <= range_m
    at_row, at_column = np.nonzero(in_range)
    middles = np.stack([north_m[at_row, 0], east_m[0, at_column]], axis=-1)
    radars = np.broadcast_to(np.asarray(radar_nea_m), (len(at_row), 3))
    line = sight_line_m(here, radars, middles, 0.0, stop_short_m=truth.cell_m)
    seen = np.zeros(heights.shape, dtype=bool)
    seen[in_range] = heights[in_range] >= line
    heights[~seen] = NOT_SEEN
    return Scan(
        row=south,
        column=west,
        heights_m=heights,
        radar_nea_m=np.broadcast_to(np.asarray(radar_nea_m), (*heights.shape, 3)),
        range_m=range_m,
        drift_m=0.0,
        registration_m=0.0,
    )
