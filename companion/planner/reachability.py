"""Reachability: whether the known map proves that there is no way to the target."""

import math

import numpy as np
import scipy

from companion import jit
from companion.geodesy import BoolArray, FloatArray
from companion.planner.cheapest_ways import IndexArray
from companion.planner.cost_grid import Place, sampled
from companion.planner.field import CostToGo
from companion.planner.settings import Task
from companion.world.columns import dilated_m
from companion.world.known_map import KnownMap
from companion.world.zones import too_near

_EVERYWHERE = np.ones((3, 3), dtype=bool)
"""A curve may go on from a part of a cell to any of the eight about it."""
_MOST_PARTS, _MOST_ACROSS = 4e6, 8
"""Parts of cells in a map, and in a cell across: a fill of so many takes a quarter of a second."""


def blocked_at(
    known: KnownMap, task: Task, field: CostToGo, ends_ne_m: tuple[Place, Place]
) -> Place | None:
    """Where the cheapest route meets the barrier, north and east; None: not all are blocked.

    Ground that was not seen is open, and so is what a sight line bounds.  What is closed is so for
    any curve: a part of a cell is barred if everywhere in it, and at any altitude, a certificate
    would break.  So a curve that can be proven comes to no part that is barred, and goes on from
    one to one of the eight next to it: a flood fill finds all that curves can reach.
    """
    if not field.is_barred:
        return None
    across = int(min(max(math.sqrt(_MOST_PARTS / known.upper_m.size), 1.0), _MOST_ACROSS))
    barred = _barred(known, task, across)
    regions = np.asarray(scipy.ndimage.label(~barred, structure=_EVERYWHERE)[0], dtype=np.int64)
    part_m = known.cell_m / across
    corner_ne_m = known.north_min_m, known.east_min_m
    here, target = (int(_at(regions, np.array(at), corner_ne_m, part_m)) for at in ends_ne_m)
    if 0 in (here, target) or here == target:
        return None
    points = sampled(np.array(field.route_ne_m), 0.5 * part_m)
    north, east = points[int((_at(regions, points, corner_ne_m, part_m) != here).argmax())]
    return float(north), float(east)


def _at(regions: IndexArray, at_ne_m: FloatArray, corner_ne_m: Place, part_m: float) -> IndexArray:
    """The regions in which points lie.  (..., 2) -> (...)."""
    index = np.floor((at_ne_m - corner_ne_m) / part_m).astype(np.int64)
    row, column = np.moveaxis(np.clip(index, 0, np.array(regions.shape) - 1), -1, 0)
    return np.asarray(regions[row, column])


def _barred(known: KnownMap, task: Task, across: int) -> BoolArray:
    """The parts of cells in which no curve can be proven at any altitude.

    across: parts of a cell, north and east.  -> (rows across, columns across).
    """
    ceiling_m = task.limits.ceiling_amsl_m - task.error_m
    clearance_m, part_m = task.required_clearance_m, known.cell_m / across
    half_m = math.sqrt(0.5) * part_m
    reach = math.ceil(clearance_m / known.cell_m)
    middle = (np.arange((2 * reach + 1) * across) + 0.5) / across - reach  # cell 0 is from 0 to 1
    gap_m = np.maximum(np.abs(middle - 0.5) - 0.5, 0.0) * known.cell_m
    away_m = np.hypot(gap_m[:, None], gap_m[None, :]) + half_m
    rises_m = np.sqrt(np.maximum(clearance_m**2 - away_m**2, 0.0))
    rises_m[away_m >= clearance_m] = -np.inf
    upper_m = np.where(known.surveyed, known.upper_m, -np.inf)
    barred = jit.compiled(dilated_m)(upper_m, rises_m, across, -np.inf) > ceiling_m
    if task.zones:
        rows, columns = barred.shape
        north_m = known.north_min_m + (np.arange(rows) + 0.5) * part_m
        east_m = known.east_min_m + (np.arange(columns) + 0.5) * part_m
        lattice, deep_m = (tuple(north_m), tuple(east_m)), task.zone_clearance_m - half_m
        barred |= too_near(task.zones, *lattice, deep_m)
    return np.asarray(barred)
