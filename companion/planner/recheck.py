"""Rechecks the rest of a leg against rules that have changed in flight: zones, floor and ceiling.

What was proven stays proven: a leg is checked only against rules that are new or stricter.
"""

import math

import numpy as np

from companion.planner.procedure import Leg
from companion.planner.settings import Task
from companion.world.near_map import NearMap
from companion.world.zones import Zone, gaps_m, packed

_LEEWAY, _LEEWAY_M = 2e-3, 0.01
"""Of the required distance, and metres besides: a certificate is not exact either (to 1 %)."""
_BAND_SLACK_M = 0.5  # a ceiling above home moves that much with where the autopilot has its home
_BAND_SAMPLES = 100
"""A leg climbs by less than its climb angle over 1 % of its length between two of them."""


def is_touched(leg: Leg, from_m: float, task: Task) -> bool:
    """Whether a leg violates, from a length on, a rule that is new: a zone, the floor, the ceiling.

    task: the rules now.
    """
    before, zones = leg.rules, task.zones
    was_low_m, was_high_m = -math.inf, math.inf
    if before is not None:
        was_low_m, was_high_m = before.limits.inner_band_amsl_m(before.error_m)
        zones = tuple(zone for zone in zones if zone not in before.zones)
    low_m, high_m = task.limits.inner_band_amsl_m(task.error_m)
    lengths = np.linspace(from_m, leg.subpath.length_m, _BAND_SAMPLES)
    heights = leg.subpath.points_nea_m(lengths)[:, 2]
    too_low = low_m > was_low_m and heights.min() < low_m - _BAND_SLACK_M
    too_high = high_m < was_high_m and heights.max() > high_m + _BAND_SLACK_M
    return bool(too_low or too_high) or comes_too_near(leg, from_m, zones, task.zone_clearance_m)


def comes_too_near(leg: Leg, from_m: float, zones: tuple[Zone, ...], required_m: float) -> bool:
    """Whether a leg comes nearer to a zone, from a length on, than the path must keep, to 0.2 %.

    Looked at a leeway apart: between two samples nothing is nearer than half of that.
    """
    leeway_m, length_m = _LEEWAY * required_m + _LEEWAY_M, leg.subpath.length_m
    count = math.ceil(max(length_m - from_m, 0.0) / leeway_m) + 1
    lengths = np.linspace(min(from_m, length_m), length_m, count)
    north, east, _ = leg.subpath.points_nea_m(lengths).T
    told_m = gaps_m(packed(zones), north, east, required_m)
    return bool((told_m < required_m - 0.5 * leeway_m).any())


def meets_near_things(leg: Leg, from_m: float, near: NearMap, required_m: float) -> bool:
    """Whether something stands nearer than required to the rest of a leg, seen from above.

    What is too near already may be left: a stop would be on the same path.  It must lead away, to
    where the distance is kept, within as much of the path.  Looked at every half cell: what lies
    between two points is nearer by less than a thirtieth of a cell if required_m is a cell or more.
    """
    steps = max(round(2.0 * (leg.subpath.length_m - from_m) / near.lattice.cell_m), 1)
    lengths = np.linspace(from_m, leg.subpath.length_m, steps + 1)
    points = leg.subpath.points_nea_m(lengths)[:, :2]
    gaps_m = near.gaps_m(points, required_m)
    kept = gaps_m >= required_m
    left_at = int(np.argmax(kept)) if kept.any() else steps
    leads_away = lengths[left_at] - from_m <= required_m and (gaps_m[:left_at] >= gaps_m[0]).all()
    return not (leads_away and kept[left_at:].all())
