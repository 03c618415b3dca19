"""A scan of a world that is known: what the radar would show, for planning without a vehicle."""

import numpy as np

from companion.geodesy import LEAST_RADIUS_M, BoolArray
from companion.world.known_map import NOT_SEEN, KnownMap, Scan
from companion.world.lattice import Lattice
from companion.world.sight_lines import march
from companion.world.terrain import Terrain

_NEAR_CELLS = 2.0  # what is so near is always seen: no ray has a step before it


def true_map(terrain: Terrain, like: Lattice) -> KnownMap:
    """A map of which everything is known: the highest terrain of each cell, in whole metres."""
    south = (like.north_min_m + np.arange(float(like.shape[0])) * like.cell_m)[:, None]
    west = (like.east_min_m + np.arange(float(like.shape[1])) * like.cell_m)[None, :]
    highest = terrain.highest_in_box_m(south, south + like.cell_m, west, west + like.cell_m)
    return KnownMap(
        cell_m=like.cell_m,
        north_min_m=like.north_min_m,
        east_min_m=like.east_min_m,
        upper_m=np.ceil(highest),
        seen=np.ones(highest.shape, dtype=bool),
    )


def simulated_scan(
    truth: KnownMap,
    radar_nea_m: tuple[float, float, float],
    range_m: float,
    terrain: Terrain | None = None,
) -> Scan:
    """What a complete radar at a point sees of the truth (design section 4).

    terrain: the truth is made from it where it is looked at, and the map only says where the cells
    are: so a scan takes as long in a big world as in a small one.
    """
    rows, columns = truth.about(np.array([radar_nea_m[:2]]), range_m)
    here = truth.part(rows, columns)
    here = here if terrain is None else true_map(terrain, here)
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
    here: KnownMap, radar_nea_m: tuple[float, float, float], wanted: BoolArray
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
    top = np.pad(here.upper_m, 1, constant_values=-np.inf)  # beyond the edge there is nothing
    wider = Lattice(
        cell_m=here.cell_m,
        north_min_m=here.north_min_m - here.cell_m,
        east_min_m=here.east_min_m - here.cell_m,
        shape=top.shape,
    )
    cells, away, _, _ = march(wider, middles, radar_nea_m[:2], 2)
    slope = top.ravel().take(cells)
    slope -= radar_nea_m[2]
    slope /= away[:, None]
    slope -= (away / (2.0 * LEAST_RADIUS_M))[:, None]
    seen = np.zeros(top.shape, dtype=bool)
    seen.ravel()[cells[slope >= np.maximum.accumulate(slope, axis=0)]] = True
    return seen[1:-1, 1:-1]
