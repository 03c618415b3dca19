"""A roadmap of Voronoi edges between obstacles, and the cheapest way over it as a B-spline."""

import math

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import binary_erosion
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import Voronoi

from companion.campaign.rivals.problem import (
    Field,
    FloatArray,
    IntArray,
    NoRoute,
    RouteProblem,
    resampled,
)

_THREAT = 2.5  # what a metre costs where ground is taken for an obstacle: within a radar's range
_APART = 4  # points of the field between sites, at least
_ENTRANCES = 30  # corners of the roadmap that start and target are joined to
_DEARER = 1.005  # how much more a rounder route may cost
_PIECES = 240.0  # of the field's spacing, of the B-spline's control polygon at first


def plan(problem: RouteProblem, rng: np.random.Generator) -> FloatArray | NoRoute:
    """The cheapest way over the roadmap, pulled straight, then smoothed where that stays free."""
    del rng
    field, ends = problem.field, (problem.start_ne_m, problem.target_ne_m)
    corners, lines = _roadmap(field)
    route = _cheapest(field, corners, lines, ends)
    if route is None:
        return NoRoute(why="no way over the roadmap")
    straight = field.straightened(route, math.inf)
    return problem.raised(smoothed(field, straight))


def _sites(field: Field) -> FloatArray:
    """Edges of what is closed or costs much, and the edge of the map, thinned.  -> (K, 2)."""
    barred = ~(field.rate < _THREAT)
    edge = barred & ~binary_erosion(barred, border_value=1)
    rows, columns = (size - 1 for size in field.rate.shape)
    steps = [np.arange(0, size + 1, 4 * _APART) for size in (rows, columns)]
    frame = [(r, c) for r in steps[0] for c in (0, columns)]
    frame += [(r, c) for c in steps[1] for r in (0, rows)]
    index = np.concatenate([np.argwhere(edge), np.array(frame)])
    _, first = np.unique(index // _APART, axis=0, return_index=True)
    return field.place_m(index[np.sort(first)])


def _roadmap(field: Field) -> tuple[FloatArray, IntArray]:
    """Corners (K, 2) and the free edges between them (E, 2)."""
    diagram = Voronoi(_sites(field))
    lines = np.array([pair for pair in diagram.ridge_vertices if min(pair) >= 0]).reshape(-1, 2)
    low = np.asarray(field.corner_ne_m)
    high = low + field.spacing_m * (np.array(field.rate.shape) - 1)
    inside = ((diagram.vertices >= low) & (diagram.vertices <= high)).all(axis=1)
    inside &= np.isfinite(field.rate_at(np.clip(diagram.vertices, low, high)))
    return diagram.vertices, lines[inside[lines].all(axis=1)]


def _cheapest(
    field: Field, corners: FloatArray, lines: IntArray, ends: tuple[FloatArray, FloatArray]
) -> FloatArray | None:
    """Over the roadmap, to which both ends are joined by the cheapest free lines."""
    used: IntArray = np.unique(lines)
    edges = [(int(a), int(b), field.line_cost(corners[a], corners[b])) for a, b in lines]
    start, target = len(corners), len(corners) + 1
    edges.append((start, target, field.line_cost(*ends)))
    for node, place in ((start, ends[0]), (target, ends[1])):
        away_m = np.linalg.norm(corners[used] - place, axis=-1)
        for corner in used[np.argsort(away_m, kind="stable")[:_ENTRANCES]].tolist():
            edges.append((node, corner, field.line_cost(place, corners[corner])))
    free = [each for each in edges if math.isfinite(each[2])]
    if not free:
        return None
    a, b, cost = (np.array(part) for part in zip(*free, strict=True))
    graph = csr_array((cost, (a, b)), shape=(target + 1, target + 1))
    costs, before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)  # type: ignore[call-overload]
    if not math.isfinite(costs[target]):
        return None
    way = [target]
    while way[-1] != start:
        way.append(int(before[way[-1]]))
    return np.array([*corners, *ends])[way[::-1]]


def _cost(field: Field, route_ne_m: FloatArray) -> float:
    """Of a route, in metres of level flight; infinite: it is not free."""
    even = field.even(route_ne_m)
    pieces_m = np.linalg.norm(np.diff(even, axis=0), axis=-1)
    return float(field.rate_at(0.5 * (even[1:] + even[:-1])) @ pieces_m)


def smoothed(field: Field, route_ne_m: FloatArray) -> FloatArray:
    """A clamped cubic B-spline about the route: the roundest that is free and costs little more.

    Its control points lie evenly along the route; the closer they are, the closer it follows.  The
    route itself if none will do.
    """
    allowed = _DEARER * _cost(field, route_ne_m)
    piece_m = _PIECES * field.spacing_m
    while piece_m > 2.0 * field.spacing_m:
        control = resampled(route_ne_m, piece_m)
        if len(control) < 4:
            control = resampled(route_ne_m, math.dist(route_ne_m[0], route_ne_m[-1]) / 4.0)
        inner = np.linspace(0.0, 1.0, len(control) - 2)
        curve = BSpline(np.concatenate([np.zeros(3), inner, np.ones(3)]), control, 3)
        points = np.asarray(curve(np.linspace(0.0, 1.0, 20 * len(control))))
        points[0], points[-1] = route_ne_m[0], route_ne_m[-1]
        if _cost(field, points) <= allowed:
            return points
        piece_m *= 0.7
    return route_ne_m
