"""A scan of a world that is known: what the radar would show, for planning without a vehicle."""

import math
from dataclasses import dataclass
from typing import Self, final

import numpy as np

from companion.geodesy import LEAST_RADIUS_M, BoolArray
from companion.world.known_map import NOT_SEEN, KnownMap, Scan
from companion.world.lattice import Lattice
from companion.world.sight_lines import rays_towards
from companion.world.terrain import Terrain

_NEAR_CELLS = 2.0
"""What is so near is always seen: no ray has a step before it."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Truth(Lattice):
    """The terrain on the lattice of a map, rasterised where it is looked at.

    So a scan takes as long in a big world as in a small one.
    """

    terrain: Terrain

    @classmethod
    def of(cls, terrain: Terrain, like: Lattice) -> Self:
        """The truth behind a map."""
        return cls(
            terrain=terrain,
            cell_m=like.cell_m,
            north_min_m=like.north_min_m,
            east_min_m=like.east_min_m,
            shape=like.shape,
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


def true_map(terrain: Terrain, like: Lattice) -> KnownMap:
    """The truth of a whole map at once."""
    return Truth.of(terrain, like).part(slice(0, like.shape[0]), slice(0, like.shape[1]))


def simulated_scan(
    truth: KnownMap | Truth, radar_nea_m: tuple[float, float, float], range_m: float
) -> Scan:
    """What a complete radar at a point sees of the truth (design section 4)."""
    rows, columns = truth.about(np.array([radar_nea_m[:2]]), range_m)
    here = truth.part(rows, columns)
    north_m, east_m = here.middles_m(0, 0, here.shape)
    away_m = np.hypot(north_m - radar_nea_m[0], east_m - radar_nea_m[1])
    in_range = away_m <= range_m
    seen = in_range & (away_m <= _NEAR_CELLS * here.cell_m)
    if in_range.any():
        seen |= in_range & _in_sight(here, radar_nea_m, in_range)
    return Scan(
        row=rows.start,
        column=columns.start,
        heights_m=np.where(seen, here.upper_m, NOT_SEEN),
        radar_nea_m=np.broadcast_to(np.asarray(radar_nea_m), (*seen.shape, 3)),
        range_m=range_m,
    )


def _in_sight(
    here: KnownMap,
    radar_nea_m: tuple[float, float, float],
    wanted: BoolArray,
) -> BoolArray:
    """The cells that rise above all before them on some ray.  (rows, columns).

    The ground here is as high as the highest of its cell at every step of a ray, and curves away
    as much as it may.  A cell is seen if it is no lower, as the radar looks, than all that the same
    ray crosses before; so of a cell that is not seen each ray across it has been over one that is,
    and that one hides it (`known_map._hidden_bound_m` builds on it).  On the face of a mountain a
    ray may meet hardly anything but such cells, or none but the first and the last.  Every wanted
    cell is crossed by a ray: they are RAY_CELLS apart at most, and steps of a cell do not jump over
    one.
    """
    rows, columns = np.nonzero(wanted)
    north, east = here.middles_m(0, 0, wanted.shape)
    middles = np.stack([north[rows, 0], east[0, columns]], axis=-1)
    rays = rays_towards(middles, radar_nea_m[:2], here.cell_m)
    steps = np.arange(1.0, math.ceil(rays.farthest_m / here.cell_m) + 2)
    top = np.pad(here.upper_m, 1, constant_values=-np.inf)  # beyond the edge there is nothing
    wider = Lattice(
        cell_m=here.cell_m,
        north_min_m=here.north_min_m - here.cell_m,
        east_min_m=here.east_min_m - here.cell_m,
        shape=top.shape,
    )
    crossed = wider.crossed(radar_nea_m[:2], rays.azimuth_rad, steps)
    slope = top.ravel().take(crossed)
    slope -= radar_nea_m[2]
    slope /= (steps * here.cell_m)[:, None]
    slope -= (steps * here.cell_m / (2.0 * LEAST_RADIUS_M))[:, None]
    seen = np.zeros(top.shape, dtype=bool)
    seen.ravel()[crossed[slope >= np.maximum.accumulate(slope, axis=0)]] = True
    return seen[1:-1, 1:-1]
