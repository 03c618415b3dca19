"""Lines of sight that go out from a radar over a lattice of cells.

Ground that something hides lies below `sight_line_m`; `known_map` says when that follows.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy

from companion.geodesy import LEAST_RADIUS_M, FloatArray
from companion.world.lattice import IntArray, Lattice

RAY_CELLS = 0.3  # between neighbouring rays at the farthest point, in cells
SLACK_CELLS = 1.5
"""Of a sight line, for the lattice alone (`known_map._hidden_bound_m`, `_line_from_one_m`)."""
_GROUP_CELLS, _GROUP_CELLS_UP = 0.25, 0.1
"""Radars this close, level and up, count as one: that saves a march for each position of a moving
radar, and costs slack and height (`sight_line_m`)."""


class March(NamedTuple):
    """Rays towards points, a step of a cell at a time, from the first one on."""

    cells: IntArray  # (steps, rays)
    """What lies under each step, as indices of the ravelled array; off the map the nearest cell."""
    away_m: FloatArray  # (steps,)
    distance_m: FloatArray  # (points,)
    ray_of: IntArray  # (points,)


def march(
    lattice: Lattice, points_ne_m: FloatArray, radar_ne_m: tuple[float, float], beyond: int
) -> March:
    """Go out from a radar to so many cells beyond the farthest of some points, (K, 2).

    Each point has a ray that passes within RAY_CELLS / 2 of it.
    """
    away, cell_m = points_ne_m - np.asarray(radar_ne_m), lattice.cell_m
    distance = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-9)
    farthest = max(float(distance.max()), cell_m)
    apart_rad = RAY_CELLS * cell_m / farthest
    index = np.rint(np.arctan2(away[:, 1], away[:, 0]) / apart_rad).astype(np.intp)
    first = int(index.min())
    used = np.bincount(index - first) > 0
    azimuth = (np.flatnonzero(used) + first) * apart_rad
    steps = np.arange(1.0, max(math.ceil(farthest / cell_m) + beyond, 2))
    (rows, columns), flat = lattice.shape, np.zeros((len(steps), len(azimuth)), dtype=np.intp)
    sides = (np.cos, lattice.north_min_m, rows), (np.sin, lattice.east_min_m, columns)
    for at_m, (along, least_m, count) in zip(radar_ne_m, sides, strict=True):
        at = np.multiply.outer(steps, along(azimuth))  # in place from here on
        at += (at_m - least_m) / cell_m
        flat *= count
        flat += np.clip(at, 0, count - 1, out=at).astype(np.intp)
    return March(flat, steps * cell_m, distance, (np.cumsum(used) - 1)[index - first])


def sight_line_m(
    lattice: Lattice,
    top_m: FloatArray,
    radars_nea_m: FloatArray,
    points_ne_m: FloatArray,
    slack_m: float,
) -> FloatArray:
    """Altitude of the highest sight line from radars to points over the terrain between.

    top_m: the highest of each cell.  radars_nea_m (K, 3), points_ne_m (K, 2), K > 0 -> (K,), metres
    AMSL; +inf over unknown ground, -inf where nothing lies between.  slack_m: 1.5 cells for the
    lattice, and how wrong the radar and the terrain may be; the march looks at every cell within it
    of the line.

    Lines are straight over a round earth: seen from the radar, ground at a distance d is d^2 / 2
    R_e lower than its altitude says, and beyond what hides it the line is higher by as much.

    Radars in one box of _GROUP_CELLS count as the middle of theirs, at the lowest: how far they are
    from it is added to the slack, and the lines are as much higher as the highest of them.
    """
    apart_m = np.array([_GROUP_CELLS, _GROUP_CELLS, _GROUP_CELLS_UP]) * lattice.cell_m
    bins = ((radars_nea_m - radars_nea_m.min(axis=0)) / apart_m).astype(np.intp)
    key = np.ravel_multi_index(tuple(bins.T), tuple(bins.max(axis=0) + 1))
    order = np.argsort(key, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(key[order])) + 1)
    boxes = [(radars_nea_m[k].min(axis=0), radars_nea_m[k].max(axis=0)) for k in groups]
    slack = slack_m + max(
        0.5 * math.hypot(high[0] - low[0], high[1] - low[1]) for low, high in boxes
    )
    size = 2 * math.ceil(slack / lattice.cell_m - 0.5) + 1
    highest_m = scipy.ndimage.maximum_filter(top_m, size=size, mode="nearest")
    result = np.empty(len(points_ne_m))
    for members, (low, high) in zip(groups, boxes, strict=True):
        north_m, east_m, _ = (0.5 * (low + high)).tolist()
        points, radar = points_ne_m[members], (north_m, east_m, float(low[2]))
        near = _slope_over_near_cells(lattice, top_m, radar, points, slack)
        line = _line_from_one_m(lattice, highest_m, near, radar, points, slack)
        result[members] = float(high[2] - low[2]) + line
    return result


def _line_from_one_m(
    lattice: Lattice,
    highest_m: FloatArray,
    near_slope: FloatArray,
    radar_nea_m: tuple[float, float, float],
    points_ne_m: FloatArray,
    slack_m: float,
) -> FloatArray:
    """`sight_line_m` from one radar over the highest cells within the slack, and over near ones.

    near_slope: of lines to the points over the cells beside the radar.

    One march along rays whose ends are RAY_CELLS apart serves all points: each takes the ray
    nearest to it, half of that beside it at most.  A line to anywhere in a cell (0.71 cells
    beside its middle) and between two steps (0.5) is then less than a cell from what the march
    looks at in north and in east, which is what the slack of 1.5 cells of a scan leaves for it.

    Slopes are rise over distance less distance / 2 R_e.  Of that a cell has the least, its rise
    the most that the slack allows.  What this leaves out of the sphere is the square of heights
    over R_e: z / (1 - z / R_e) is not below it.
    """
    cell = lattice.cell_m
    cells, away, distance, ray_of = march(lattice, points_ne_m, radar_nea_m[:2], 0)
    rise = highest_m.ravel().take(cells)
    rise -= radar_nea_m[2]
    nearest = np.maximum(away - slack_m, 0.5 * cell)  # nearer ones: one by one
    steepest = rise / (away + slack_m)[:, None]
    rise /= nearest[:, None]
    np.maximum(steepest, rise, out=steepest)
    steepest -= (np.maximum(away - slack_m, 0.0) / (2.0 * LEAST_RADIUS_M))[:, None]
    np.maximum.accumulate(steepest, axis=0, out=steepest)
    before = np.ceil(distance / cell).astype(np.intp) - 1
    slope = steepest[np.clip(before, 1, len(away)) - 1, ray_of]
    slope = np.where(before > 0, np.maximum(slope, near_slope), -np.inf)
    finite = np.isfinite(slope)
    runs = np.maximum(distance - slack_m, 0.0), distance + slack_m
    ends = [np.where(finite, slope, 0.0) * run + run**2 / (2.0 * LEAST_RADIUS_M) for run in runs]
    share = np.minimum(np.maximum(*ends) / LEAST_RADIUS_M, 1.0)
    with np.errstate(divide="ignore"):  # a line that never comes down again is no bound
        line = radar_nea_m[2] + LEAST_RADIUS_M * share / (1.0 - share)
    return np.where(finite, line, slope)


def _slope_over_near_cells(
    lattice: Lattice,
    top_m: FloatArray,
    radar_nea_m: tuple[float, float, float],
    points_ne_m: FloatArray,
    slack_m: float,
) -> FloatArray:
    """Slope of the steepest line to each point over the cells beside the radar, one by one.

    A cell that rises above the radar does so where it is nearest: at no distance at all if that
    may hold the radar, and then nothing is bounded behind it.  A line to anywhere in a point's
    cell goes over all cells whose circle is in the direction of that cell's.  (K, 2) -> (K,).
    """
    cell, radar_ne_m = lattice.cell_m, np.array(radar_nea_m[:2])
    reach_m = slack_m + cell  # the march takes no cell beyond for nearer than half a cell
    error_m = max(slack_m - SLACK_CELLS * cell, 0.0)
    rows, columns = lattice.about(radar_ne_m[None], reach_m + error_m)
    rise = top_m[rows, columns] - radar_nea_m[2]
    middles = np.broadcast_arrays(*lattice.middles_m(rows.start, columns.start, rise.shape))
    to_cells = np.stack(middles, axis=-1) - radar_ne_m
    gaps = np.maximum(np.abs(to_cells) - 0.5 * cell, 0.0)
    nearest = np.maximum(np.hypot(gaps[..., 0], gaps[..., 1]) - error_m, 0.0)
    is_near = (nearest <= reach_m) & (rise > -np.inf)
    rise, nearest, to_cells = rise[is_near], nearest[is_near], to_cells[is_near]
    corners = np.abs(to_cells) + 0.5 * cell
    farthest = np.hypot(corners[:, 0], corners[:, 1]) + error_m
    with np.errstate(divide="ignore"):
        slopes = rise / np.where(rise > 0.0, nearest, farthest)
    (azimuths, halves, _), (towards, wide, far) = (
        _circles_seen(away, math.sqrt(0.5) * cell + error_m)
        for away in (to_cells, points_ne_m - radar_ne_m)
    )
    result = np.full(len(points_ne_m), -np.inf)
    for slope, near, azimuth, half in zip(slopes, nearest, azimuths, halves, strict=True):
        turned = np.abs(np.remainder(towards - azimuth + math.pi, math.tau) - math.pi)
        over = (turned <= half + wide) & (near <= far)
        np.maximum(result, slope, out=result, where=over)
    return result


def _circles_seen(away_m: FloatArray, radius_m: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Azimuths of circles, half the angles that they take up, and their far ends.  (K, 2)."""
    distance = np.hypot(away_m[:, 0], away_m[:, 1])
    half = np.arcsin(np.minimum(radius_m / np.maximum(distance, 1e-9), 1.0))
    half[distance <= radius_m] = math.pi
    return np.arctan2(away_m[:, 1], away_m[:, 0]), half, distance + radius_m
