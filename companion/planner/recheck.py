"""Rechecks the rest of a leg against rules that have changed in flight.

What was proven stays proven: a leg is checked only against rules that are new or stricter.
"""

import numpy as np

from companion.planner.procedure import Leg
from companion.planner.settings import Task
from companion.world.columns import distances_to_cells_m
from companion.world.near_map import NearMap
from companion.world.zones import Zone, gaps_m, packed

_PIECES = 48
"""Of the rest of a leg at first: most are clear as wholes, by one look at all of them."""
_LEEWAY, _LEEWAY_M = 2e-3, 0.01
"""Of the required distance, and metres besides: a certificate is not exact either (to 1 %)."""
_FINEST = 0.25
"""Of the leeway: of a piece whose half is shorter, what is not clear by then is not."""
_BAND_SLACK_M = 0.5
"""A ceiling above home moves that much with where the autopilot has its home."""
_BAND_SAMPLES = 100
"""A leg climbs by less than its climb angle over 1 % of its length between two of them."""


def is_touched(leg: Leg, from_m: float, task: Task) -> bool:
    """Whether a leg violates, from a length on, a rule that is new: a zone, the floor, the ceiling.

    task: the rules now.
    """
    before, zones = leg.rules, task.zones
    if before == task:
        return False
    if before is not None and task.zone_clearance_m <= before.zone_clearance_m:
        zones = tuple(zone for zone in zones if zone not in before.zones)
    lengths = np.linspace(from_m, leg.subpath.length_m, _BAND_SAMPLES)
    heights = leg.subpath.points_nea_m(lengths)[:, 2]
    low_m, high_m = _band_amsl_m(task)
    was_low_m, was_high_m = (-np.inf, np.inf) if before is None else _band_amsl_m(before)
    too_low = low_m > was_low_m and heights.min() < low_m - _BAND_SLACK_M
    too_high = high_m < was_high_m and heights.max() > high_m + _BAND_SLACK_M
    return bool(too_low or too_high) or comes_too_near(leg, from_m, zones, task.zone_clearance_m)


def _band_amsl_m(task: Task) -> tuple[float, float]:
    """Between which altitudes a curve is proven."""
    inset_m = task.margins.band_inset_m
    return task.limits.floor_amsl_m + inset_m, task.limits.ceiling_amsl_m - inset_m


def comes_too_near(leg: Leg, from_m: float, zones: tuple[Zone, ...], required_m: float) -> bool:
    """Whether a leg comes nearer to a zone, from a length on, than the path must keep, to 0.2 %.

    Between samples too: pieces of the curve that are not clear of all zones as wholes are halved,
    until they are or their middle is too near.
    """
    leeway_m = _LEEWAY * required_m + _LEEWAY_M
    wanted_m, table = required_m - leeway_m, packed(zones)
    cuts_m = np.linspace(min(from_m, leg.subpath.length_m), leg.subpath.length_m, _PIECES + 1)
    begin_m, end_m = cuts_m[:-1], cuts_m[1:]
    while zones and len(begin_m):
        middle_m, half_m = 0.5 * (begin_m + end_m), 0.5 * (end_m - begin_m)
        north, east, _ = leg.subpath.points_nea_m(middle_m).T
        enough_m = np.maximum(wanted_m + half_m, 0.0) + _LEEWAY_M
        told_m = gaps_m(table, north, east, enough_m)
        left = told_m - half_m < wanted_m  # no point of a piece is nearer than by half its length
        if (told_m < wanted_m).any() or (half_m[left] < _FINEST * leeway_m).any():
            return True
        begin_m, end_m = (
            np.append(begin_m[left], middle_m[left]),
            np.append(middle_m[left], end_m[left]),
        )
    return False


def meets_near_things(leg: Leg, from_m: float, near: NearMap, required_m: float) -> bool:
    """Whether something stands nearer than required to the rest of a leg, seen from above.

    What is too near already may be left: a stop would be on the same path.  It must lead away, to
    where the distance is kept, within as much of the path.  Looked at every half cell: what lies
    between two points is nearer by less than a thirtieth of a cell if required_m is a cell or more.
    """
    steps = max(round(2.0 * (leg.subpath.length_m - from_m) / near.lattice.cell_m), 1)
    lengths = np.linspace(from_m, leg.subpath.length_m, steps + 1)
    points = leg.subpath.points_nea_m(lengths)[:, :2]
    window = near.lattice.about(points, required_m)
    gaps_m = distances_to_cells_m(points, near.occupied(window), window, near.lattice)
    kept = gaps_m >= required_m
    left_at = int(np.argmax(kept)) if kept.any() else steps
    if left_at and lengths[left_at] - from_m > required_m:
        return True
    return bool((gaps_m[:left_at] < gaps_m[0]).any() or not kept[left_at:].all())
