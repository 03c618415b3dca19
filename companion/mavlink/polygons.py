"""Fence polygons made safe for the planner: simple, and moved outwards or inwards by a margin.

Plane geometry: points are (north, east) in metres, polygons implicitly closed.  shapely does it.
"""

import math
from collections.abc import Sequence
from typing import Any

import shapely

Point = tuple[float, float]
_SAME_M = 1e-3


def cleaned(vertices: Sequence[Point]) -> tuple[Point, ...]:
    """Without corners that are given twice in a row."""
    kept: list[Point] = []
    for vertex in vertices:
        if not kept or math.dist(kept[-1], vertex) > _SAME_M:
            kept.append(vertex)
    while len(kept) > 1 and math.dist(kept[0], kept[-1]) <= _SAME_M:
        kept.pop()
    return tuple(kept)


def crosses_itself(vertices: Sequence[Point]) -> bool:
    """Whether two sides that are not neighbours meet, or neighbours lie on each other."""
    return not shapely.is_simple(shapely.LinearRing(vertices))


def hull(vertices: Sequence[Point]) -> tuple[Point, ...]:
    """The convex hull; no corners if there is no area."""
    return _corners(shapely.MultiPoint(vertices).convex_hull)


def offset(vertices: Sequence[Point], outwards_m: float) -> tuple[Point, ...] | None:
    """A simple polygon with every side moved outwards (negative: inwards), corners mitred.

    Outwards it holds every point within the distance of the polygon, and what that encloses;
    inwards only points that far inside.  None if nothing is left, or parts that hang apart.
    """
    return _corners(shapely.Polygon(vertices).buffer(outwards_m, join_style="mitre")) or None


def _corners(shape: Any) -> tuple[Point, ...]:
    """Of the outline of a polygon; of anything else none."""
    if shape.is_empty or shape.geom_type != "Polygon":
        return ()
    return tuple((north, east) for north, east in shape.exterior.coords[:-1])
