"""A scan of a world that is known: what the radar would show, for planning without a vehicle."""

import math
from dataclasses import replace

import numpy as np

from companion.world.known_map import NOT_SEEN, KnownMap, Scan, sight_line_m
from companion.world.terrain import PeakTerrain


def true_map(terrain: PeakTerrain, like: KnownMap) -> KnownMap:
    """A map of which everything is known: the highest terrain of every cell, in whole metres."""
    north, east = like.middles_m(0, 0, (like.upper_m.shape[0], like.upper_m.shape[1]))
    half = 0.5 * like.cell_m
    heights = terrain.highest_in_box_m(north - half, north + half, east - half, east + half)
    return replace(like, upper_m=np.ceil(heights), seen=np.ones(heights.shape, dtype=bool))


def simulated_scan(
    truth: KnownMap, radar_nea_m: tuple[float, float, float], range_m: float
) -> Scan:
    """What a radar at a point sees of a true map: cells in range that nothing hides."""
    row, column = truth.cell_of(radar_nea_m[0], radar_nea_m[1])
    half = math.ceil(range_m / truth.cell_m)
    south, west = max(row - half, 0), max(column - half, 0)
    heights = truth.upper_m[south : row + half + 1, west : column + half + 1].copy()
    north, east = truth.middles_m(south, west, (heights.shape[0], heights.shape[1]))
    in_range = np.hypot(north - radar_nea_m[0], east - radar_nea_m[1]) <= range_m
    rows, columns = np.nonzero(in_range)
    middles = np.stack([north[rows, 0], east[0, columns]], axis=-1)
    radars = np.broadcast_to(np.asarray(radar_nea_m), (len(rows), 3))
    line = sight_line_m(truth, radars, middles, 0.0, stop_short_m=truth.cell_m)
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
