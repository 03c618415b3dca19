"""The best route of a mission when everything is known, by a method that is not companion's.

    companion campaign run safety --out FOLDER && scripts/bench optimum --campaign FOLDER [--jobs 2]

Of a campaign of the planner alone: J of each run against J*, the cost of the best route in its
world.  How it is found:

1. `lattice`: Dijkstra over a 500 m grid with 48 directions, with the cost of the route (its length,
   its height where only height keeps the clearance, radar exposure). Routes found are made dearer
   and the search is run again, so that other ways round the obstacles come up too; with going
   over obstacles allowed (the climb limit left out) and forbidden.
2. `descent`: from each of these a clamped cubic B-spline with a free start heading, improved under
   the rules that the planner must keep: true clearance, band, radars, turn radius, climb,
   keep-outs. The best are refined with more control points.
3. What comes out is checked densely with `truth`; where it breaks a bound by a little, the bound is
   drawn in by as much and step 2 goes on. Only a feasible route counts, so the cost found is an
   upper bound of the optimum's.

`best_of` looks for it where it was found before.  1 if a bar of design 10 is missed.
"""

import functools
import hashlib
import json
import math
import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import descent
import lattice
import numpy as np
from descent import Margins, Problem, Smooth
from lattice import GRID_M, SURFACE_M, Lattice
from platformdirs import user_cache_dir
from running import Bar, Found, in_processes, main, most

from companion.campaign import drawn_world, route_cost, truth
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.file import Place
from companion.campaign.report import read_campaign
from companion.campaign.route_cost import Rates, curve_cost
from companion.campaign.row import Row
from companion.campaign.run import drawn_of
from companion.geodesy import FloatArray
from companion.world.radars import Radar

_EACH, _MOST, _DEARER = 3, 6, 1.12  # ways of each kind, in all, and how much dearer
_OF_GRID = 0.996  # of a cost over the grid: below it no curve is
_USUAL_SIDE_M = 150_000.0  # of a world; in a larger one curves get more control points
_SOLVER = (__file__, descent.__file__, lattice.__file__, truth.__file__, route_cost.__file__)
_SOLVER_SIDE_M, _SOLVER_CLEARANCE_M = 110_000.0, 260.0
OPTIMA = Path(__file__).with_name("optima.json")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """The best feasible route that was found."""

    cost: float
    """J."""
    control_nea_m: FloatArray
    """(K, 3): of a clamped cubic B-spline."""


# --- from a way over the grid to a feasible curve


@final
class Solver:
    """Everything about one world that its curves share."""

    def __init__(self, world: DrawnWorld) -> None:
        if len(world.targets_ne_m) != 1:
            raise ValueError("the optimum is that of one start and one target")
        self.world = world
        self.ends_ne_m = (world.start_nea_m[:2], world.targets_ne_m[0])
        limits = world.task.limits
        side = max(limits.north_m[1] - limits.north_m[0], limits.east_m[1] - limits.east_m[0])
        self.finer = max(1.0, side / _USUAL_SIDE_M)
        self.lattice = Lattice(world, GRID_M * max(round(side / 180_000.0), 1))
        north, east = drawn_world.axes_m(world, SURFACE_M)
        need = drawn_world.lowest_safe_m(world, SURFACE_M, world.task.required_clearance_m)
        self.surface = Smooth(north, east, need)
        self.tried = 0

    def candidates(self) -> list[tuple[float, FloatArray]]:
        """Ways over the grid that differ, the cheapest first, none much dearer than that.

        -> cost in metres of level flight, (N, 2) points.
        """
        found: list[tuple[float, FloatArray]] = []
        for over, radar_free in ((False, True), (True, True), (True, False)):
            rate = self.lattice.rate(over=over, radar_free=radar_free)
            found += self.lattice.ways(rate, _EACH, self.ends_ne_m)
        found.sort(key=lambda way: way[0])
        chosen: list[tuple[float, FloatArray]] = []
        for cost, route in found:
            shape = _evenly(route, 120)
            near_any = any(_apart_m(shape, _evenly(other, 120)) < 1_500.0 for _, other in chosen)
            if cost <= _DEARER * found[0][0] and not near_any and len(chosen) < _MOST:
                chosen.append((cost, route))
        return chosen

    def curve(self, route_ne_m: FloatArray, points: int) -> FloatArray:
        """A first curve along a way: control points evenly along it, high enough for the ground.

        Where a way goes over an obstacle the climb begins early enough.
        """
        at = _evenly(route_ne_m, points)
        fine = _evenly(route_ne_m, 8 * points)
        need = self.surface.at(fine)[0]
        along = np.linspace(0.0, _length_m(fine), len(fine))
        slope = 0.9 * math.tan(self.world.task.limits.climb_angle_rad)
        away = np.abs(along[None, :] - np.linspace(0.0, along[-1], points)[:, None])
        altitude = (need[None, :] - slope * away).max(axis=1)
        altitude = np.clip(altitude, self.world.floor_amsl_m, self.world.ceiling_amsl_m)
        altitude[0] = self.world.start_nea_m[2]
        return np.column_stack([at, altitude])

    def entered(self, route_ne_m: FloatArray) -> tuple[Radar, ...]:
        """The radars that a way over the grid goes through."""
        points = self.curve(route_ne_m, 400)
        return tuple(
            radar
            for radar in self.world.task.radars
            if np.linalg.norm(points - np.asarray(radar.centre_nea_m), axis=-1).min()
            < radar.range_m - 0.5 * self.lattice.cell_m
        )

    def improved(self, control: FloatArray, soft: tuple[Radar, ...], iterations: int) -> FloatArray:
        """The curve after the augmented Lagrangian."""
        self.tried += 1
        problem = Problem(self.world, self.surface, len(control), soft, Margins())
        return problem.improve(control, 5, iterations)

    def mended(self, control: FloatArray, soft: tuple[Radar, ...]) -> tuple[float, FloatArray]:
        """Cost of a feasible curve near this one, infinite if none was found; the curve."""
        margins = Margins()
        for _ in range(5):
            curve = truth.sampled(control, 2.0)
            measures = self.measured(curve)
            broken = self.violations(measures)
            if not broken and radar_intrusion_m(curve, self.world, soft) <= 0.0:
                return curve_cost(curve, self.world), control
            margins = self._drawn_in(margins, measures, curve, soft)
            problem = Problem(self.world, self.surface, len(control), soft, margins)
            control = problem.improve(control, 3, 100)
        return math.inf, control

    @property
    def required_m(self) -> float:
        """Distance of the curve from the terrain."""
        return self.world.task.required_clearance_m

    def violations(self, measures: truth.Measures) -> tuple[str, ...]:
        """The bounds that are broken."""
        return measures.violations(self.world.task)

    def measured(self, curve: truth.Curve) -> truth.Measures:
        """Everything about one sampled curve."""
        return truth.measure(curve, self.world.terrain, self.world.task)

    def _drawn_in(
        self,
        margins: Margins,
        measures: truth.Measures,
        curve: truth.Curve,
        soft: tuple[Radar, ...],
    ) -> Margins:
        limits = self.world.task.limits
        short = max(self.required_m - measures.clearance_m, 0.0)
        steepest = max(
            math.tan(measures.climb_rad) / math.tan(limits.climb_angle_rad),
            math.tan(measures.dive_rad) / math.tan(limits.dive_angle_rad),
        )
        into = max(
            radar_intrusion_m(curve, self.world, soft), self.required_m - measures.keep_out_m, 0.0
        )
        return replace(
            margins,
            clearance_m=margins.clearance_m + 1.6 * short,
            radar_m=margins.radar_m + 1.2 * into,
            turn=margins.turn + 1.2 * max(limits.turn_radius_m / measures.turn_radius_m - 1.0, 0.0),
            climb=margins.climb + 1.2 * max(steepest - 1.0, 0.0),
        )


def radar_intrusion_m(curve: truth.Curve, world: DrawnWorld, soft: tuple[Radar, ...] = ()) -> float:
    """How deep a curve goes into radar ranges, soft ones left out; negative: outside all."""
    depths = [
        radar.range_m
        - float(np.linalg.norm(curve.points_nea_m - np.asarray(radar.centre_nea_m), axis=-1).min())
        for radar in world.task.radars
        if radar not in soft
    ]
    return max(depths, default=-math.inf)


def refined(control: FloatArray, points: int) -> FloatArray:
    """The same curve, nearly, with another number of control points."""
    u = np.linspace(0.0, 1.0, 20 * points)
    target, basis = truth.spline(control)(u), truth.spline(np.eye(points))(u)
    inner = target - np.outer(basis[:, 0], control[0]) - np.outer(basis[:, -1], control[-1])
    middle = np.linalg.lstsq(basis[:, 1:-1], inner, rcond=None)[0]
    return np.concatenate([control[:1], middle, control[-1:]])


def optimum(world: DrawnWorld) -> Optimum:
    """The best route.

    A way's cost over the grid is within 0.4 % of what its curve costs, or below it where the curve
    cannot follow: ways that are dearer than that need no curve.
    """
    solver, unit = Solver(world), Rates.of(world).unit
    best, best_control = math.inf, np.empty((0, 3))
    for grid_m, route in solver.candidates():
        if unit * grid_m * _OF_GRID > best:
            break
        for soft in {(), solver.entered(route)}:
            few, many = round(30 * solver.finer), round(60 * solver.finer)
            control = solver.improved(solver.curve(route, few), soft, 100)
            finer = solver.improved(refined(control, many), soft, 120)
            rough = curve_cost(truth.sampled(finer, 50.0), world)
            if rough > 1.01 * best:
                continue
            cost, mended = solver.mended(finer, soft)
            if cost < best:
                best, best_control = cost, mended
    if not math.isfinite(best):
        raise ValueError(f"{world.name}: no feasible route was found")
    return Optimum(cost=best, control_nea_m=best_control.round(6))


def _evenly(route: FloatArray, count: int) -> FloatArray:
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=-1))])
    at = np.linspace(0.0, along[-1], count)
    return np.stack([np.interp(at, along, column) for column in route.T], axis=-1)


def _length_m(route: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(route, axis=0), axis=-1).sum())


def _apart_m(a: FloatArray, b: FloatArray) -> float:
    """The greatest distance from a point of one route to the other."""
    between = np.linalg.norm(a[:, None] - b[None, :], axis=-1)
    return float(max(between.min(axis=0).max(), between.min(axis=1).max()))


# --- of any world, found once


def load(path: Path = OPTIMA) -> dict[str, Optimum]:
    """What has been computed before, by fingerprint of the world."""
    rows = json.loads(path.read_text(encoding="utf-8"))
    return {
        key: Optimum(cost=row["cost"], control_nea_m=np.array(row["control_nea_m"]))
        for key, row in rows.items()
    }


def best(drawn: DrawnWorld) -> Optimum:
    """The full-knowledge optimum, found in the world at the size that its solver is made for.

    J is the same at every size.  ValueError: none was found.
    """
    limits = drawn.task.limits
    side = max(limits.north_m[1] - limits.north_m[0], limits.east_m[1] - limits.east_m[0])
    scale = max(_SOLVER_SIDE_M / side, _SOLVER_CLEARANCE_M / drawn.task.required_clearance_m)
    if abs(scale - 1.0) < 1e-9:
        return optimum(drawn)
    found = optimum(drawn_world.scaled(drawn, scale))
    return replace(found, control_nea_m=found.control_nea_m / scale)


def best_of(world: DrawnWorld) -> Optimum | None:
    """The optimum, from the store of this solver or found now; None if none was found."""
    known = load().get(world.fingerprint)
    if known is not None:
        return known
    stored = _store() / f"{world.fingerprint}.json"
    if stored.is_file():
        return load(stored)[world.fingerprint]
    try:
        found = best(world)
    except ValueError:
        return None
    stored.parent.mkdir(parents=True, exist_ok=True)
    part = stored.with_suffix(f".{os.getpid()}")
    row = {"cost": found.cost, "control_nea_m": found.control_nea_m.tolist()}
    part.write_text(json.dumps({world.fingerprint: row}), encoding="utf-8")
    part.replace(stored)
    return found


@functools.cache
def _store() -> Path:
    digest = hashlib.sha256()
    for path in _SOLVER:
        digest.update(Path(path).read_bytes())
    return Path(user_cache_dir("companion")) / f"optima-{digest.hexdigest()[:16]}"


# --- beside a campaign

BARS = {"scans": (1.03, 1.06, 1.12)}
_HEADINGS = ("J / J*: median|.4f", "mean|.4f", "90 %|.4f", "worst|.4f")
_FIGURES = np.median, np.mean, lambda found: np.quantile(found, 0.9), np.max


def best_of_place(place: Place) -> Optimum | None:
    """The optimum of a campaign's world."""
    return best_of(drawn_of(place))


def place_of(row: Row) -> Place:
    """Where a run was flown."""
    return Place(
        label="", world=row.world, mission=row.mission, family=row.family,
        family_seed=row.family_seed, family_index=row.family_index,
    )  # fmt: skip


def ratios(rows: Sequence[Row], known: dict[Place, Optimum | None]) -> FloatArray:
    """J / J* of the runs that arrived, where J* is known."""
    found = [(row.cost, known[place_of(row)]) for row in rows if row.arrived]
    return np.array([cost / best.cost for cost, best in found if cost and best])


def beside(campaign: Path, jobs: int = 2) -> Found:
    """Find the optima of a campaign's worlds: J against them, by family and planner."""
    rows = [row for row in read_campaign(campaign).rows if row.over == "planner"]
    places = list(dict.fromkeys(map(place_of, rows)))
    optima = in_processes(best_of_place, [(place,) for place in places], jobs)
    known = dict(zip(places, optima, strict=True))
    bars, numbers = list[Bar](), list[tuple[str, list[float]]]()
    groups: dict[tuple[str, str, str, str], list[Row]] = defaultdict(list)
    for row in rows:
        groups[row.family or row.world, row.planner, row.knowledge, row.optimiser].append(row)
    for key, mine in groups.items():
        found = ratios(mine, known)
        spread = [float(f(found)) for f in _FIGURES] if len(found) else []
        if key[1] == "ours" and key[2] in BARS:
            bars.append(most(f"J / J*, {key[0]}, {key[2]}", spread[:3], BARS[key[2]]))
        yield {
            "J against the full-knowledge optimum": ", ".join(key),
            "runs": len(mine),
            "arrived": sum(row.arrived for row in mine),
            "without J*": sum(known[place_of(row)] is None for row in mine),
        } | dict(zip(_HEADINGS, spread or [None] * 4, strict=True))
        numbers.append((", ".join(key), found.tolist()))
    yield numbers
    yield from bars


if __name__ == "__main__":
    main(beside)
