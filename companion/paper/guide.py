"""The guide direction (paper 2.6, f3): towards the target, or along a tangent of radars."""

import math

from companion.geodesy import wrap_rad
from companion.world.radars import Radar

_WIDEST_RAD = math.radians(135.0)  # row 15: a cluster may span more than half a turn

Place = tuple[float, ...]  # north and east, metres; more does not count


def tangent_guide_rad(
    scan_ne_m: Place, target_ne_m: Place, radars: tuple[Radar, ...], overlap_m: float
) -> float:
    """Bearing of the guide direction from p_scan, radians clockwise from the frame's north.

    Case 1: S-T crosses no radar circle: towards the target.  Case 2: the circle that S-T enters
    first (row 32), with all circles that overlap it by more than d_overlap, and those that overlap
    these, and so on (row 17); of its two outer tangents the one with the smaller angle to S-T
    (row 16).  Circles of the whole range (row 14); a radar around S is ignored (row 15).
    """
    straight = _bearing_rad(scan_ne_m, target_ne_m)
    offsets = {
        radar: wrap_rad(_bearing_rad(scan_ne_m, radar.centre_nea_m) - straight)
        for radar in radars
        if _apart_m(scan_ne_m, radar) > radar.range_m
    }
    entries_m = dict[Radar, float]()  # where S-T enters each, from S
    for radar, offset in offsets.items():
        apart_m = _apart_m(scan_ne_m, radar)
        along, aside = apart_m * math.cos(offset), apart_m * math.sin(offset)
        if along > 0.0 and abs(aside) < radar.range_m:
            entries_m[radar] = along - math.sqrt(radar.range_m**2 - aside**2)
    north, east = target_ne_m[0] - scan_ne_m[0], target_ne_m[1] - scan_ne_m[1]
    if min(entries_m.values(), default=math.inf) >= math.hypot(north, east):
        return straight
    cluster, newest = set[Radar](), {min(entries_m, key=entries_m.__getitem__)}
    while newest:  # whoever overlaps what was found last
        cluster |= newest
        newest = {
            other
            for radar in newest
            for other in offsets
            if _apart_m(radar.centre_nea_m, other) < radar.range_m + other.range_m - overlap_m
        } - cluster
    left, right = 0.0, 0.0
    for radar in cluster:
        half_width = math.asin(radar.range_m / _apart_m(scan_ne_m, radar))
        left = min(left, offsets[radar] - half_width)
        right = max(right, offsets[radar] + half_width)
    left, right = max(left, -_WIDEST_RAD), min(right, _WIDEST_RAD)
    return wrap_rad(straight + (left if -left < right else right))


def _bearing_rad(start: Place, end: Place) -> float:
    return math.atan2(end[1] - start[1], end[0] - start[0])


def _apart_m(place: Place, radar: Radar) -> float:
    """Horizontal distance to a radar."""
    return math.hypot(radar.centre_nea_m[0] - place[0], radar.centre_nea_m[1] - place[1])
