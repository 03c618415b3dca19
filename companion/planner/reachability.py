"""Reachability: whether the known map proves that there is no way to the target."""

import math
from dataclasses import replace

import numpy as np
import scipy

from companion.geodesy import BoolArray
from companion.planner.cheapest_ways import IndexArray
from companion.planner.cost_grid import Place, sampled
from companion.planner.field import CostToGo
from companion.planner.kernels import compiled
from companion.planner.settings import Task
from companion.world.known_map import KnownMap
from companion.world.zones import too_near

_EVERYWHERE = np.ones((3, 3), dtype=bool)
"""A curve may go on from a cell to any of the eight about it."""


def blocked_at(
    known: KnownMap, task: Task, field: CostToGo, here_ne_m: Place, target_ne_m: Place
) -> Place | None:
    """Where the cheapest route meets the barrier, north and east; None: not all are blocked.

    Ground that was not seen is open, and so is what a sight line bounds.  What is closed is so for
    any curve: a point of the lattice is barred if everywhere within half a diagonal of it, and at
    any altitude, a certificate would break.  So the lattice point nearest to a curve that can be
    proven is never barred, and as the curve goes on it steps to one of the eight next to it: a
    flood fill finds all that curves can reach.
    """
    if not field.is_barred:
        return None
    known = _finer(known)
    barred = _barred(known, task)
    regions = np.asarray(scipy.ndimage.label(~barred, structure=_EVERYWHERE)[0], dtype=np.int64)
    here, target = (int(_at(known, regions, place)) for place in (here_ne_m, target_ne_m))
    if 0 in (here, target) or here == target:
        return None
    points = sampled(np.array(field.route_ne_m), 0.5 * known.cell_m)
    leaves = np.array([int(_at(known, regions, point)) != here for point in points])
    north, east = points[int(leaves.argmax())]
    return float(north), float(east)


def _at(known: KnownMap, regions: IndexArray, place: Place) -> int:
    row, column = known.cell_of(*place)
    rows, columns = regions.shape
    return int(regions[min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)])


def _barred(known: KnownMap, task: Task) -> BoolArray:
    """The cells about whose middles no curve can be proven, at any altitude.  (rows, columns)."""
    ceiling_m = task.limits.ceiling_amsl_m - task.error_m
    clearance_m, half_m = task.required_clearance_m, math.sqrt(0.5) * known.cell_m
    rows, columns = known.upper_m.shape
    north, east = known.middles_m(0, 0, (rows, columns))
    places, far_m = (tuple(north[:, 0].tolist()), tuple(east[0].tolist())), task.zone_clearance_m
    barred = too_near(task.zones, *places, far_m - half_m, compiled().zone_gaps).copy()
    reach = math.ceil(clearance_m / known.cell_m)
    top = np.pad(np.where(known.surveyed, known.upper_m, -np.inf), reach, constant_values=-np.inf)
    for i, j in np.ndindex(2 * reach + 1, 2 * reach + 1):
        gaps = (max(abs(at - reach) - 0.5, 0.0) * known.cell_m for at in (i, j))
        away_m = math.hypot(*gaps) + half_m
        if away_m < clearance_m:
            enough_m = ceiling_m - math.sqrt(clearance_m**2 - away_m**2)
            barred |= top[i : i + rows, j : j + columns] > enough_m
    return barred


def _finer(known: KnownMap) -> KnownMap:
    """The same map, each cell as two by two."""
    return replace(
        known,
        cell_m=0.5 * known.cell_m,
        upper_m=known.upper_m.repeat(2, axis=0).repeat(2, axis=1),
        seen=known.surveyed.repeat(2, axis=0).repeat(2, axis=1),
        given=None,
        guess_m=None,
    )
