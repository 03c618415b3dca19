"""The best route of a mission when everything is known, by a method that is not companion's.

    companion campaign run safety --out FOLDER && scripts/bench optimum --campaign FOLDER [--jobs 2]

Of a campaign of the planner alone: J of each run against J*, the cost of the best route in its
world, or, without a campaign, of some worlds that are flown for it.  How J* is found:

1. `Grid`: Dijkstra over a 500 m grid with 48 directions, with the cost of the route (its length,
   its height where only height keeps the clearance, radar exposure). Routes found are made dearer
   and the search is run again, so that other ways round the obstacles come up too; with going
   over obstacles allowed (the climb limit left out) and forbidden.
2. `Descent`: from each of these a clamped cubic B-spline with a free start heading, improved under
   the rules that the planner must keep: true clearance, band, radars, turn radius, climb,
   keep-outs. The best are refined with more control points.
3. What comes out is checked densely with `truth`; where it breaks a bound by a little, the bound is
   drawn in by as much and step 2 goes on. Only a feasible route counts, so the cost found is an
   upper bound of the optimum's.  It is kept in the user's cache.  1 if a bar is missed.
"""

import hashlib
import math
import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, final

import numpy as np
from numpy.typing import NDArray
from platformdirs import user_cache_dir
from running import Bar, Found, in_processes, main, most
from scipy.ndimage import distance_transform_edt, map_coordinates, spline_filter
from scipy.optimize import minimize
from scipy.sparse import csr_array
from tapped import fly_campaign

from companion import library
from companion.campaign import drawn_world, truth
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.file import Place
from companion.campaign.report import read_campaign
from companion.campaign.run import drawn_of
from companion.campaign.store import Row
from companion.geodesy import FloatArray
from companion.paper.rivals import cheapest, grid_steps
from companion.world.radars import Radar
from companion.world.zones import CircleZone

_GRID_M, _SURFACE_M = 500.0, 125.0
_WAYS = [(i, j) for i in range(5) for j in range(-4, 5) if math.gcd(i, j) == 1 and (i, j) > (0, 0)]
_EACH, _MOST, _DEARER = 3, 6, 1.12  # ways of each kind, in all, and how much dearer
_OF_GRID = 0.996  # of a cost over the grid: below it no curve is
_LARGE_SIDE_M, _USUAL_SIDE_M = 180_000.0, 150_000.0  # of a world: coarser grid, longer curves
_SOLVER_SIDE_M, _SOLVER_CLEARANCE_M = 110_000.0, 260.0
_SAMPLES_PER_POINT = 10
_STEP = 1e-20  # of the derivatives by a complex step, which has no rounding
_NEXT_M = 0.01  # of those of the ground: a difference
_STIFF, _PUSH, _SCALE_M = 300.0, 100.0, 1000.0  # of the augmented Lagrangian


# --- the cheapest ways over a grid


@final
class Grid:
    """A world's points 125 m apart; ways are over every fourth, or fewer where it is large."""

    def __init__(self, world: DrawnWorld) -> None:
        self.world, task = world, world.task
        self.unit, high, seen = task.settings.weights.per_metre(task.settings.scan_range_m)
        self.high, self.seen = high / self.unit, seen / self.unit  # in metres of level flight
        self.north_m, self.east_m = drawn_world.axes_m(world, _SURFACE_M)
        self.need_m = drawn_world.lowest_safe_m(world, _SURFACE_M, task.required_clearance_m)
        self._spline = spline_filter(self.need_m, order=3, mode="nearest")
        self._stride = round(_GRID_M / _SURFACE_M * max(round(_side_m(world) / _LARGE_SIDE_M), 1))

    def need_at_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """The lowest altitude that keeps the clearance, by a cubic spline: smooth."""
        at = (north_m - self.north_m[0]) / _SURFACE_M, (east_m - self.east_m[0]) / _SURFACE_M
        needs = map_coordinates(self._spline, at, order=3, mode="nearest", prefilter=False)
        return np.asarray(needs)

    def rate(self, *, over: bool, radar_free: bool) -> FloatArray:
        """Cost per metre; infinite: closed."""
        world = self.world
        low_m, high_m = world.task.band_amsl_m
        altitude = np.clip(self.need_m, low_m, high_m)
        result = 1.0 + self.high * (altitude - low_m) / (high_m - low_m)
        result[self.need_m > (high_m if over else low_m + 15.0)] = np.inf
        north, east = np.meshgrid(self.north_m, self.east_m, indexing="ij")
        for radar in world.task.radars:
            n, e, z = radar.centre_nea_m
            ratio2 = ((north - n) ** 2 + (east - e) ** 2 + (altitude - z) ** 2) / radar.range_m**2
            inside = np.inf if radar_free else self.seen / (1.0 + ratio2**2)
            result += np.where(ratio2 <= 1.0, inside, 0.0)
        for zone in world.task.zones:
            result[zone.distance_m(north, east) < world.task.required_clearance_m] = np.inf
        return result

    def ways(
        self, rate: FloatArray, count: int, ends_ne_m: tuple[tuple[float, float], ...]
    ) -> list[tuple[float, FloatArray]]:
        """The cheapest way and others that differ: cost in metres, (N, 2) points."""
        ways: list[tuple[float, FloatArray]] = []
        first = self._graph(rate)
        columns, graph = len(self.east_m[:: self._stride]), first
        corner = np.array([self.north_m[0], self.east_m[0]])
        spacing_m = self._stride * _SURFACE_M
        cells = np.round((np.array(ends_ne_m) - corner) / spacing_m).astype(int)
        while len(ways) < count:
            way = np.array(cheapest(graph, *(cells @ [columns, 1]).tolist()), dtype=np.intp)
            if not len(way):
                break
            steps = np.sort([way[:-1], way[1:]], axis=0)
            cost_m = float(np.maximum(first[*steps], first[*steps[::-1]]).sum()) * _SURFACE_M
            route = corner + spacing_m * np.stack(np.divmod(way, columns), axis=-1)
            route[[0, -1]] = ends_ne_m
            ways.append((cost_m, route))
            rate = rate * self._dearer_near(route)
            graph = self._graph(rate)
        return ways

    def _graph(self, rate: FloatArray) -> csr_array:
        size = math.prod(rate[:: self._stride, :: self._stride].shape)
        costs, steps = grid_steps(rate, self._stride, _WAYS)
        return csr_array((costs, steps.T), shape=(size, size))

    def _dearer_near(self, route: FloatArray) -> FloatArray:
        """1.25 within 3 km of a way except near its ends, else 1."""
        away = np.ones(self.need_m.shape, dtype=bool)
        far = np.linalg.norm(route[:, None] - route[[0, -1]], axis=-1).min(axis=1) > 8_000.0
        corner = [self.north_m[0], self.east_m[0]]
        away[*np.round((route[far] - corner) / _SURFACE_M).astype(int).T] = False
        if away.all():
            return np.ones(away.shape)
        return np.where(distance_transform_edt(away) * _SURFACE_M <= 3_000.0, 1.25, 1.0)


# --- a smooth curve made cheaper under the rules that the planner must keep


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Margins:
    """How far the bounds are drawn in, so that what the samples miss is kept too."""

    clearance_m: float = 5.0
    radar_m: float = 2.0
    turn: float = 0.002
    climb: float = 0.001


@final
class Descent:
    """An augmented Lagrangian over the control points of a curve, by L-BFGS-B.

    Clearance, radars, keep-outs, turn radius, climb and dive are bounds at samples, band and map
    are bounds of the control points.  soft: radars whose exposure is paid for.
    """

    def __init__(self, grid: Grid, points: int, soft: tuple[Radar, ...], margins: Margins) -> None:
        self.world, self.grid, self.soft, self.margins = grid.world, grid, soft, margins
        world = grid.world
        if any(not isinstance(zone, CircleZone) for zone in world.task.zones):
            raise ValueError("the optimum is found among circular keep-out zones only")
        count = _SAMPLES_PER_POINT * points
        u, unit = np.linspace(0.0, 1.0, count + 1), truth.spline(np.eye(points))
        self.basis = np.array([unit(u), unit.derivative()(u), unit.derivative(2)(u)])
        self.quadrature = np.full(count + 1, 1.0 / count)
        self.quadrature[[0, -1]] *= 0.5

    def terms(
        self, state: NDArray[np.complex128], length_m: float
    ) -> tuple[FloatArray, FloatArray]:
        """Kilometres of level flight per parameter, (...), and bounds, kept where <= 0, (B, ...).

        state: north, east, altitude, their first derivatives, and the second of the first two.
        """
        world, limits = self.world, self.world.task.limits
        north, east, up, v_n, v_e, v_up, a_n, a_e = state
        flat2 = v_n**2 + v_e**2 + 1e-12
        flat, speed = np.sqrt(flat2), np.sqrt(flat2 + v_up**2)
        low_m, high_m = world.task.band_amsl_m
        rate = 1.0 + self.grid.high * (up - low_m) / (high_m - low_m)
        at, ahead = np.array([north.real[0], east.real[0]]), _NEXT_M * np.eye(3)[:, :2, None]
        by_n, by_e, need_m = self.grid.need_at_m(*np.moveaxis(at + ahead, 1, 0))
        slope_n, slope_e = (by_n - need_m) / _NEXT_M, (by_e - need_m) / _NEXT_M
        need = need_m + 1j * (slope_n * north.imag + slope_e * east.imag)
        bounds = [(need + self.margins.clearance_m - up) / _SCALE_M]
        for radar in world.task.radars:
            n, e, z = radar.centre_nea_m
            distance2 = (north - n) ** 2 + (east - e) ** 2 + (up - z) ** 2
            if radar in self.soft:
                beyond = (np.sqrt(distance2) - radar.range_m) / 30.0 - 3.0
                edge = 1.0 / (1.0 + np.exp(np.where(beyond.real > 50.0, 50.0, beyond)))
                rate = rate + self.grid.seen * edge / (1.0 + (distance2 / radar.range_m**2) ** 2)
            else:
                bounds.append(_outside(distance2, radar.range_m + self.margins.radar_m))
        for zone in world.task.zones:
            assert isinstance(zone, CircleZone)  # made sure of in __init__
            distance2 = (north - zone.north_m) ** 2 + (east - zone.east_m) ** 2
            wide_m = zone.radius_m + world.task.required_clearance_m + self.margins.radar_m
            bounds.append(_outside(distance2, wide_m))
        cross = v_n * a_e - v_e * a_n
        radius_m = limits.turn_radius_m * (1.0 + self.margins.turn)
        bounds.append(np.sign(cross.real) * cross * radius_m / flat**3 - 1.0)
        for sign, angle in ((1.0, limits.climb_angle_rad), (-1.0, limits.dive_angle_rad)):
            bounds.append(sign * v_up / flat - math.tan(angle) * (1.0 - self.margins.climb))
        even = 0.1 * (speed - length_m) ** 2 / length_m  # keeps the parameter even along the curve
        return (rate * speed + even) / 1000.0, np.array(bounds)

    def improve(self, control: FloatArray, rounds: int, iterations: int) -> FloatArray:
        """Control points that cost less and keep the bounds; both ends stay."""
        limits = self.world.task.limits
        box = np.array([limits.north_m, limits.east_m, self.world.task.band_amsl_m])
        lower, upper = box[:, 0] + 1e-3, box[:, 1] - 1e-3
        free = np.ones(control.shape, dtype=bool)
        free[0], free[-1, :2] = False, False
        box = np.stack([lower, upper], axis=-1)[np.nonzero(free)[1]] / _SCALE_M
        control = np.where(free, np.clip(control, lower, upper), control)
        multipliers: FloatArray | float = 0.0
        weight = self.quadrature * _PUSH

        def terms_at(points: FloatArray) -> tuple[FloatArray, FloatArray]:
            r, v, a = self.basis @ points
            state = np.concatenate([r.T, v.T, a.T[:2]])
            step = 1j * _STEP * np.eye(len(state))[:, :, None]
            return self.terms(state[:, None] + step, length_m)

        def lagrangian(x: FloatArray) -> tuple[float, FloatArray]:
            points = control.copy()
            points[free] = x * _SCALE_M
            cost, bounds = terms_at(points)
            push = bounds * _STIFF + multipliers
            push = np.where(push.real > 0.0, push, 0.0)
            whole = self.quadrature * cost + weight * (push**2).sum(axis=0) / (2.0 * _STIFF)
            slopes = np.vstack([whole.imag / _STEP, np.zeros(len(weight))]).reshape(3, 3, -1)
            by_point = np.einsum("bsk,bas->ka", self.basis, slopes)
            return float(whole[0].real.sum()), by_point[free] * _SCALE_M

        for _ in range(rounds):
            length_m = _length_m(control)
            done = minimize(
                lagrangian, control[free] / _SCALE_M, jac=True, method="L-BFGS-B", bounds=box,
                options={"maxiter": iterations, "maxcor": 20, "ftol": 1e-10, "gtol": 1e-7},
            )  # fmt: skip
            control[free] = done.x * _SCALE_M
            multipliers = np.maximum(terms_at(control)[1].real * _STIFF + multipliers, 0.0)
        return control


def _outside(distance2_m2: FloatArray, radius_m: float) -> FloatArray:
    """Of a sphere: about the distance to it near its edge, of one sign with it everywhere."""
    return np.asarray((radius_m**2 - distance2_m2) / (2.0 * radius_m * _SCALE_M))


# --- from a way over the grid to a feasible curve


@final
class Solver:
    """Everything about one world that its curves share."""

    def __init__(self, world: DrawnWorld) -> None:
        if len(world.targets_ne_m) != 1:
            raise ValueError("the optimum is that of one start and one target")
        self.world, self.grid = world, Grid(world)
        self.ends_ne_m = (world.start_nea_m[:2], world.targets_ne_m[0])

    def candidates(self) -> list[tuple[float, FloatArray]]:
        """Ways over the grid that differ, the cheapest first, none much dearer than that.

        -> cost in metres of level flight, (N, 2) points.
        """
        ways: list[tuple[float, FloatArray]] = []
        for over, radar_free in ((False, True), (True, True), (True, False)):
            rate = self.grid.rate(over=over, radar_free=radar_free)
            ways += self.grid.ways(rate, _EACH, self.ends_ne_m)
        ways.sort(key=lambda way: way[0])
        chosen: list[tuple[float, FloatArray]] = []
        for cost, route in ways:
            shape = _evenly(route, 120)
            near_any = any(_apart_m(shape, _evenly(other, 120)) < 1_500.0 for _, other in chosen)
            if cost <= _DEARER * ways[0][0] and not near_any and len(chosen) < _MOST:
                chosen.append((cost, route))
        return chosen

    def curve(self, route_ne_m: FloatArray, points: int) -> FloatArray:
        """A first curve along a way: control points evenly along it, high enough for the ground.

        Where a way goes over an obstacle the climb begins early enough.
        """
        at, fine = _evenly(route_ne_m, points), _evenly(route_ne_m, 8 * points)
        along = np.linspace(0.0, _length_m(fine), len(fine))
        slope = 0.9 * math.tan(self.world.task.limits.climb_angle_rad)
        away = np.abs(along[None, :] - np.linspace(0.0, along[-1], points)[:, None])
        altitude = (self.grid.need_at_m(*fine.T)[None, :] - slope * away).max(axis=1)
        altitude = np.clip(altitude, *self.world.task.band_amsl_m)
        altitude[0] = self.world.start_nea_m[2]
        return np.column_stack([at, altitude])

    def entered(self, route_ne_m: FloatArray) -> tuple[Radar, ...]:
        """The radars that a way over the grid goes through."""
        points = self.curve(route_ne_m, 400)
        depths = {radar: _depth_m(points, radar) for radar in self.world.task.radars}
        return tuple(radar for radar, depth_m in depths.items() if depth_m > 0.5 * _GRID_M)

    def improved(self, control: FloatArray, soft: tuple[Radar, ...], iterations: int) -> FloatArray:
        """The curve after the augmented Lagrangian."""
        descent = Descent(self.grid, len(control), soft, Margins())
        return descent.improve(control, 5, iterations)

    def mended(self, control: FloatArray, soft: tuple[Radar, ...]) -> tuple[float, FloatArray]:
        """Cost of a feasible curve near this one, infinite if none was found; the curve."""
        margins, task = Margins(), self.world.task
        limits, required_m = task.limits, task.required_clearance_m
        hard = [radar for radar in task.radars if radar not in soft]
        for _ in range(5):
            curve = truth.sampled(control, 2.0)
            measured = truth.measure(curve, self.world.terrain, task)
            into = max((_depth_m(curve.points_nea_m, radar) for radar in hard), default=-math.inf)
            if not measured.violations(task) and into <= 0.0:
                return sum(library.route_terms(curve.points_nea_m, task).values()), control
            steepest = max(
                math.tan(measured.climb_rad) / math.tan(limits.climb_angle_rad),
                math.tan(measured.dive_rad) / math.tan(limits.dive_angle_rad),
            )
            bent, into = limits.turn_radius_m / measured.turn_radius_m, max(into, 0.0)
            into = max(into, required_m - measured.zones_m)
            margins = Margins(
                clearance_m=margins.clearance_m + 1.6 * max(required_m - measured.clearance_m, 0.0),
                radar_m=margins.radar_m + 1.2 * into,
                turn=margins.turn + 1.2 * max(bent - 1.0, 0.0),
                climb=margins.climb + 1.2 * max(steepest - 1.0, 0.0),
            )
            descent = Descent(self.grid, len(control), soft, margins)
            control = descent.improve(control, 3, 100)
        return math.inf, control


def refined(control: FloatArray, points: int) -> FloatArray:
    """The same curve, nearly, with another number of control points."""
    u = np.linspace(0.0, 1.0, 20 * points)
    target, basis = truth.spline(control)(u), truth.spline(np.eye(points))(u)
    inner = target - np.outer(basis[:, 0], control[0]) - np.outer(basis[:, -1], control[-1])
    middle = np.linalg.lstsq(basis[:, 1:-1], inner, rcond=None)[0]
    return np.concatenate([control[:1], middle, control[-1:]])


def optimum(world: DrawnWorld) -> tuple[float, FloatArray]:
    """J* and the control points, (K, 3), of the best route; ValueError: none was found.

    A way's cost over the grid is within 0.4 % of what its curve costs, or below it where the curve
    cannot follow: ways that are dearer than that need no curve.
    """
    solver, finer = Solver(world), max(1.0, _side_m(world) / _USUAL_SIDE_M)
    best = math.inf, np.empty((0, 3))
    for grid_m, route in solver.candidates():
        if solver.grid.unit * grid_m * _OF_GRID > best[0]:
            break
        for soft in {(), solver.entered(route)}:
            few = solver.improved(solver.curve(route, round(30 * finer)), soft, 100)
            many = solver.improved(refined(few, round(60 * finer)), soft, 120)
            points = truth.sampled(many, 50.0).points_nea_m
            if sum(library.route_terms(points, world.task).values()) <= 1.01 * best[0]:
                best = min(best, solver.mended(many, soft), key=lambda route: route[0])
    if not math.isfinite(best[0]):
        raise ValueError(f"{world.name}: no feasible route was found")
    return best


def _side_m(world: DrawnWorld) -> float:
    return max(np.ptp(world.task.limits.north_m), np.ptp(world.task.limits.east_m))


def _depth_m(points_nea_m: FloatArray, radar: Radar) -> float:
    """How deep points go into a radar's range; negative: all are outside."""
    away_m = np.linalg.norm(points_nea_m - np.asarray(radar.centre_nea_m), axis=-1)
    return radar.range_m - float(away_m.min())


def _evenly(route: FloatArray, count: int) -> FloatArray:
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=-1)))
    at = np.linspace(0.0, along[-1], count)
    return np.stack([np.interp(at, along, column) for column in route.T], axis=-1)


def _length_m(route: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(route, axis=0), axis=-1).sum())


def _apart_m(a: FloatArray, b: FloatArray) -> float:
    """The greatest distance from a point of one route to the other."""
    between = np.linalg.norm(a[:, None] - b[None, :], axis=-1)
    return float(max(between.min(axis=0).max(), between.min(axis=1).max()))


# --- of any world, found once


def scaled(world: DrawnWorld, by: float) -> DrawnWorld:
    """The same world at another size: lengths and speeds times a factor.  J stays what it is."""
    return _scaled(world, by, "")


def _scaled(value: Any, by: float, name: str) -> Any:
    """A value with all that it holds; names say what a length or a speed is."""
    if is_dataclass(value) and not isinstance(value, type):
        parts = {field.name: getattr(value, field.name) for field in fields(value) if field.init}
        return replace(value, **{name: _scaled(part, by, name) for name, part in parts.items()})
    if isinstance(value, tuple):
        return tuple(_scaled(item, by, name) for item in value)
    is_length = isinstance(value, (float, np.ndarray)) and name.endswith(("_m", "_m_s", "_m_s2"))
    return value * by if is_length else value


def best_of(world: DrawnWorld) -> float | None:
    """J*, found at the size that the solver is made for, or before; None: there is no route.

    It is the same at every size.
    """
    digest = hashlib.sha256(b"".join(Path(it.__file__).read_bytes() for it in (truth, library)))
    digest.update(Path(__file__).read_bytes())
    store = Path(user_cache_dir("companion")) / f"optima-{digest.hexdigest()[:16]}"
    file = store / f"{world.fingerprint}.txt"
    if file.is_file():
        return float(file.read_text(encoding="utf-8"))
    clearance_m = world.task.required_clearance_m
    scale = max(_SOLVER_SIDE_M / _side_m(world), _SOLVER_CLEARANCE_M / clearance_m)
    try:
        cost, _ = optimum(scaled(world, scale) if abs(scale - 1.0) > 1e-9 else world)
    except ValueError:
        return None
    store.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(f".{os.getpid()}")
    part.write_text(repr(cost), encoding="utf-8")
    part.replace(file)
    return cost


# --- beside a campaign

BARS = (1.02, 1.04, 1.10, 1.25)
"""Of J / J* with scans alone, of fresh worlds: median, mean, 90 %, worst."""


def best_of_place(place: Place) -> float | None:
    """J* of a campaign's world."""
    return best_of(drawn_of(place))


def place_of(row: Row) -> Place:
    """Where a run was flown."""
    return Place(*(row[column] for column in Place._fields))


def ratios(rows: Sequence[Row], known: dict[Place, float | None]) -> FloatArray:
    """J / J* of the runs that arrived, where J* is known."""
    pairs = [(row["cost"], known[place_of(row)]) for row in rows if row["arrived"]]
    return np.array([cost / best for cost, best in pairs if cost and best])


def beside(
    campaign: str = "",
    family: Literal["dense", "gathered", "walls", "copter", "plane"] = "gathered",
    seed: int = 1,
    worlds: int = 60,
    jobs: int = 2,
) -> Found:
    """J of a campaign's runs by family and planner, or of worlds flown for it, beside J*."""
    with TemporaryDirectory() as folder:
        text = f'over = "planner"\n[[places]]\nfamily = "{family}"\nseed = {seed}\ncount = {worlds}'
        flown = Path(campaign) if campaign else fly_campaign(Path(folder), text, "--keep", "none")
        rows = [row for row in read_campaign(flown).rows.to_dicts() if row["over"] == "planner"]
    places = list(dict.fromkeys(map(place_of, rows)))
    optima = in_processes(best_of_place, [(place,) for place in places], jobs)
    known, bars = dict(zip(places, optima, strict=True)), list[Bar]()
    groups: dict[tuple[str, ...], list[Row]] = defaultdict(list)
    for row in rows:
        where = row["family"] or row["world"]
        groups[where, row["planner"], row["knowledge"], row["optimiser"]].append(row)
    for key, mine in groups.items():
        ratio = ratios(mine, known)
        spread = [np.median(ratio), ratio.mean(), np.quantile(ratio, 0.9), ratio.max()]
        spread = [float(value) for value in spread] if len(ratio) else []
        if key[1:3] == ("ours", "scans"):
            bars.append(most(f"J / J*, {key[0]}: median, mean, 90 %, worst", spread, BARS))
            wrong = sum(row["violations"] or 0 for row in mine)
            bars.append(most(f"{key[0]}: violations in subpaths checked every metre", wrong, 0))
        headings = "J / J*: median|.4f", "mean|.4f", "90 %|.4f", "worst|.4f"
        yield {
            "J against the full-knowledge optimum": ", ".join(key),
            "runs": len(mine),
            "arrived": sum(row["arrived"] for row in mine),
            "without J*": sum(known[place_of(row)] is None for row in mine),
        } | dict(zip(headings, spread or [None] * 4, strict=True))
        yield [", ".join(key), ratio.tolist()]
    yield from bars


if __name__ == "__main__":
    main(beside)
