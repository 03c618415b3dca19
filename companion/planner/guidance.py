"""The guide direction of the paper (2.6, f3): towards the target, or along a tangent of radars."""

import math
from dataclasses import dataclass
from typing import final

from companion.geodesy import wrap_rad
from companion.world.threats import Radar

_WIDEST_RAD = math.radians(135.0)  # part A, row 15: a cluster may span more than half a turn


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Circle:
    bearing_rad: float
    distance_m: float
    radius_m: float

    @property
    def half_width_rad(self) -> float:
        return math.asin(self.radius_m / self.distance_m)


def tangent_guide_rad(
    scan_ne_m: tuple[float, float],
    target_ne_m: tuple[float, float],
    radars: tuple[Radar, ...],
    overlap_m: float,
) -> float:
    """Bearing of the guide direction from p_scan, radians clockwise from the frame's north.

    Case 1: S-T crosses no radar circle: towards the target.  Case 2: the nearest circle that
    S-T crosses, with all circles that overlap it by more than d_overlap, and those that overlap
    these, and so on (part A, row 17); of its two outer tangents the one with the smaller angle
    to S-T (row 16).  Circles of the whole range (row 14); a radar around S is ignored (row 15).
    """
    north, east = target_ne_m[0] - scan_ne_m[0], target_ne_m[1] - scan_ne_m[1]
    straight, distance = math.atan2(east, north), math.hypot(north, east)
    around = [radar for radar in radars if _distance_m(scan_ne_m, radar) > radar.range_m]
    crossed = [
        (entry, radar)
        for radar in around
        if (entry := _entry_m(_circle(scan_ne_m, radar), straight, distance)) is not None
    ]
    if not crossed:
        return straight
    nearest = min(crossed, key=lambda pair: pair[0])[1]
    left, right = 0.0, 0.0
    for radar in _cluster(nearest, around, overlap_m):
        circle = _circle(scan_ne_m, radar)
        offset = wrap_rad(circle.bearing_rad - straight)
        left = min(left, offset - circle.half_width_rad)
        right = max(right, offset + circle.half_width_rad)
    left, right = max(left, -_WIDEST_RAD), min(right, _WIDEST_RAD)
    return wrap_rad(straight + (left if -left < right else right))


def _distance_m(point_ne_m: tuple[float, float], radar: Radar) -> float:
    centre = radar.centre_nea_m
    return math.hypot(centre[0] - point_ne_m[0], centre[1] - point_ne_m[1])


def _circle(scan_ne_m: tuple[float, float], radar: Radar) -> _Circle:
    north, east = radar.centre_nea_m[0] - scan_ne_m[0], radar.centre_nea_m[1] - scan_ne_m[1]
    return _Circle(
        bearing_rad=math.atan2(east, north),
        distance_m=math.hypot(north, east),
        radius_m=radar.range_m,
    )


def _entry_m(circle: _Circle, bearing_rad: float, reach_m: float) -> float | None:
    """Distance along a ray from S to where it enters a circle, None if it does not in reach."""
    offset = wrap_rad(circle.bearing_rad - bearing_rad)
    along, aside = circle.distance_m * math.cos(offset), circle.distance_m * math.sin(offset)
    if along <= 0.0 or abs(aside) >= circle.radius_m:
        return None
    entry = along - math.sqrt(circle.radius_m**2 - aside**2)
    return entry if entry < reach_m else None


def _cluster(first: Radar, radars: list[Radar], overlap_m: float) -> list[Radar]:
    """All radars joined to the first by overlaps of more than d_overlap, transitively."""
    cluster, waiting = [first], [first]
    while waiting:
        here = waiting.pop()
        for other in radars:
            apart = _distance_m((here.centre_nea_m[0], here.centre_nea_m[1]), other)
            if other not in cluster and apart < here.range_m + other.range_m - overlap_m:
                cluster.append(other)
                waiting.append(other)
    return cluster
