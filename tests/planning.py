"""What tests of curves, costs and plans begin with."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import shapely
from scipy.interpolate import BSpline
from scipy.optimize import brentq

from companion.geodesy import FloatArray
from companion.mavlink.autopilots import named
from companion.path.limits import Limits
from companion.path.subpath import Subpath
from companion.planner.offline import OfflineFlight, TerrainRadar, fly_offline
from companion.planner.plan import plan
from companion.planner.procedure import Leg, hover_pose
from companion.planner.request import NotPlanned, Planned, PlanRequest
from companion.planner.settings import PlannerSettings, Task
from companion.world.known_map import KnownMap, empty_map
from companion.world.radars import Radar
from companion.world.simulated import simulated_scan, true_map
from companion.world.terrain import Peak, PeakTerrain
from companion.world.zones import CircleZone, PolygonZone, Zone

ARDUCOPTER = named("ardupilot", "copter").traits.handling

_CHUNK = 50  # points whose columns are looked at together

_COPTER = Limits(
    speed_m_s=15.0,
    acceleration_m_s2=3.0,
    climb_rate_m_s=4.0,
    turn_radius_m=150.0,
    climb_angle_rad=0.2,
    dive_angle_rad=0.2,
    floor_amsl_m=300.0,
    ceiling_amsl_m=700.0,
    north_m=(0.0, 8_000.0),
    east_m=(0.0, 8_000.0),
    tracking_error_m=5.0,
)
BENT = replace(
    _COPTER, turn_radius_m=400.0, climb_angle_rad=0.1, dive_angle_rad=0.15, ceiling_amsl_m=800.0,
    north_m=(1_500.0, 5_500.0), east_m=(1_500.0, 5_500.0),
)  # fmt: skip
"""So that random curves break every bound now and then."""
LARGE = replace(
    _COPTER, speed_m_s=150.0, acceleration_m_s2=5.0, climb_rate_m_s=25.0, turn_radius_m=2_500.0,
    climb_angle_rad=0.17, dive_angle_rad=0.17, floor_amsl_m=3_000.0, ceiling_amsl_m=5_000.0,
    north_m=(-5e3, 105e3), east_m=(-5e3, 105e3), tracking_error_m=10.0,
)  # fmt: skip
"""At the paper's scale."""
PLANE_TASK = Task(
    limits=Limits(
        speed_m_s=18.0,
        acceleration_m_s2=2.0,
        climb_rate_m_s=3.0,
        turn_radius_m=100.0,
        climb_angle_rad=0.1,
        dive_angle_rad=0.1,
        floor_amsl_m=60.0,
        ceiling_amsl_m=260.0,
        north_m=(-2_000.0, 2_000.0),
        east_m=(-2_000.0, 2_000.0),
        tracking_error_m=12.0,
        loiter_radius_m=80.0,
    ),
    settings=PlannerSettings(
        scan_range_m=1_600.0, safety_distance_m=30.0, planning_time_s=1.0, scan_time_s=1.0
    ),
)
"""Of a plane on 4 km x 4 km between 60 and 260 m."""


def limits(**changes: Any) -> Limits:
    """A copter of 15 m/s on 8 km x 8 km between 300 and 700 m, but for some changes."""
    return replace(_COPTER, **changes)


def ask(
    task: Task, known: KnownMap, start_nea_m: tuple[float, float, float], **changes: Any
) -> PlanRequest:
    """The question of a vehicle that hovers where it scans."""
    request = PlanRequest(
        plan_id=1,
        seed=7,
        task=task,
        known=known,
        scan_nea_m=start_nea_m,
        start=hover_pose(start_nea_m),
        from_rest=True,
        target_ne_m=(7_500.0, 7_500.0),
    )
    return replace(request, **changes)


def planned(request: PlanRequest) -> Planned:
    outcome = plan(request)  # of this module: it may be asked a little aside (tests/nudge.py)
    assert isinstance(outcome, Planned)
    return outcome


def refused(request: PlanRequest) -> NotPlanned:
    outcome = plan(request)
    assert isinstance(outcome, NotPlanned)
    return outcome


def fly(
    task: Task,
    truth: KnownMap,
    start_nea_m: tuple[float, float, float],
    *targets_ne_m: tuple[float, float],
    seed: int = 1,
    **keywords: Any,
) -> OfflineFlight:
    """A flight through a world of which nothing is known at first."""
    blank = empty_map(truth.cell_m, task.limits.north_m, task.limits.east_m)
    range_m = task.settings.scan_range_m
    return fly_offline(
        task,
        TerrainRadar(task, lambda at_nea_m: simulated_scan(truth, at_nea_m, range_m)),
        blank=keywords.pop("blank", blank),
        start_nea_m=start_nea_m,
        targets_ne_m=targets_ne_m,
        seed=seed,
        planner=keywords.pop("planner", plan),
        **keywords,
    )


def hills(*rows: tuple[float, ...], ground_m: float = 0.0) -> PeakTerrain:
    """Peaks by north, east, height and their spreads to the north and east."""
    return PeakTerrain(peaks=tuple(Peak(*row) for row in rows), ground_amsl_m=ground_m)


def radar(north_m: float, east_m: float, range_m: float) -> Radar:
    """One that stands at 0 m."""
    return Radar(name="radar", centre_nea_m=(north_m, east_m, 0.0), range_m=range_m)


def circle(north_m: float, east_m: float, radius_m: float, *, keep_in: bool = False) -> CircleZone:
    return CircleZone(
        name="circle", north_m=north_m, east_m=east_m, radius_m=radius_m, keep_in=keep_in
    )


# --- a small world: hills of 300 to 900 m on 8 km x 8 km, a vehicle of 15 m/s

SQUARE = ((5e3, 5e3), (5e3, 5.4e3), (5.4e3, 5.4e3), (5.4e3, 5e3))
TASK = Task(
    limits=_COPTER,
    settings=PlannerSettings(
        scan_range_m=2_000.0,
        safety_distance_m=60.0,
        planning_time_s=2.0,
        scan_time_s=1.0,
        overlap_m=200.0,
        evaluations=600,
    ),
    radars=(Radar(name="r", centre_nea_m=(6_500.0, 3_300.0, 0.0), range_m=900.0),),
    zones=(
        CircleZone(name="c", north_m=2_300.0, east_m=4_300.0, radius_m=350.0),
        PolygonZone(name="s", vertices_ne_m=SQUARE),
    ),
)
TERRAIN = hills(
    (3_000.0, 2_600.0, 900.0, 500.0, 400.0),
    (4_300.0, 3_900.0, 650.0, 400.0, 700.0),
    (2_000.0, 6_000.0, 800.0, 500.0, 500.0),
    (6_000.0, 6_200.0, 500.0, 600.0, 300.0),
    ground_m=100.0,
)
BLANK = empty_map(TASK.cell_m, TASK.limits.north_m, TASK.limits.east_m)
"""Nothing is known."""
TRUTH = true_map(TERRAIN, BLANK)
"""Everything is."""


# --- zones that nobody chose


def drawn_zones(
    rng: np.random.Generator, count: int, middle_ne_m: Any, spread_m: float, radius_m: float,
    keep_in: float = 0.0,
) -> tuple[Zone, ...]:  # fmt: skip
    """So many about a place; keep_in: the share of those to stay inside of, 4 times as wide."""
    zones = list[Zone]()
    for k in range(count):
        north, east = (middle_ne_m + rng.uniform(-spread_m, spread_m, 2)).tolist()
        inside = bool(rng.random() < keep_in)
        size_m = radius_m * float(rng.uniform(0.2, 1.0)) * (4.0 if inside else 1.0)
        if rng.random() < 0.4:
            circle = {"north_m": north, "east_m": east, "radius_m": size_m}
            zones.append(CircleZone(name=f"c{k}", keep_in=inside, **circle))
        else:
            corners = jagged(rng, (north, east), size_m, int(rng.integers(3, 60)))
            zones.append(PolygonZone(name=f"p{k}", vertices_ne_m=corners, keep_in=inside))
    return tuple(zones)


def jagged(
    rng: np.random.Generator, middle_ne_m: tuple[float, float], radius_m: float, corners: int
) -> tuple[tuple[float, float], ...]:
    """A polygon; some have corners at whole numbers or twice, and some cross themselves."""
    turns = np.linspace(0.0, math.tau, corners, endpoint=False)
    turns = rng.permutation(turns) if rng.random() < 0.2 else turns
    away_m = rng.uniform(0.3, 1.0, corners) * radius_m
    places = middle_ne_m + away_m[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    digits = int(rng.choice([1, 9])) - math.floor(math.log10(radius_m))
    places = np.repeat(np.round(places, digits), rng.choice([1, 1, 1, 2], corners), axis=0)
    return tuple((north, east) for north, east in places.tolist())


# --- legs, curves and distances


def leg_of(control_nea_m: Any, **changes: Any) -> Leg:
    """A leg along a spline that does not reach the target, under `TASK`, but for some changes."""
    subpath = Subpath(control_nea_m=np.asarray(control_nea_m, dtype=float))
    leg = Leg(number=1, plan_id=1, subpath=subpath, reaches_target=False, rules=TASK)
    return replace(leg, **changes)


def spline(control_nea_m: FloatArray) -> Any:
    """The clamped cubic B-spline with uniform inner knots, by scipy.  (points, 3)."""
    spans = len(control_nea_m) - 3
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, spans + 1), np.ones(3)])
    return BSpline(knots, control_nea_m, 3)


def parameter_of(curve: Any, point_nea_m: FloatArray) -> float:
    """Where a curve passes through a point of it."""
    fine = np.linspace(0.0, 1.0, 2_001)
    k = int(np.linalg.norm(curve(fine) - point_nea_m, axis=-1).argmin())
    bracket = fine[max(k - 1, 0)], fine[min(k + 1, 2_000)]
    u: float = brentq(lambda at: (curve(at) - point_nea_m) @ curve(at, 1), *bracket, xtol=1e-15)
    return u


def zone_distance_m(zone: Zone, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
    """Signed distance to a zone: to edges by shapely, inside by the winding number.  (K,) x2."""
    if isinstance(zone, CircleZone):
        beyond = np.hypot(north_m - zone.north_m, east_m - zone.east_m) - zone.radius_m
        return np.asarray(-beyond if zone.keep_in else beyond)
    ring = shapely.LinearRing(zone.vertices_ne_m)
    nearest = shapely.distance(ring, shapely.points(north_m, east_m))
    seen = np.array(zone.vertices_ne_m) @ [1.0, 1j] - (north_m + 1j * east_m)[:, None]
    with np.errstate(all="ignore"):  # on a corner the distance is 0, and its sign does not matter
        turns = np.nan_to_num(np.angle(np.roll(seen, -1, axis=1) / seen).sum(axis=1)) / math.tau
    inside = np.round(turns) % 2 == 1
    return np.where(inside != zone.keep_in, -nearest, nearest)


def zones_distance_m(zones: Iterable[Zone], places: FloatArray) -> FloatArray:
    """That to the nearest of them, seen from above; without any endless.  (K, 2 or 3) -> (K,)."""
    gaps = [zone_distance_m(zone, places[:, 0], places[:, 1]) for zone in zones]
    return np.asarray(np.min([np.full(len(places), np.inf), *gaps], axis=0))


def over(values: FloatArray, least: float, most: float) -> FloatArray:
    """How far they are beyond their bounds."""
    return np.asarray(np.maximum(values - most, 0.0) + np.maximum(least - values, 0.0))


def column_distance_m(known: KnownMap, points: FloatArray, within_m: float = np.inf) -> FloatArray:
    """Distance of points to columns as high as their cells, unknown ones endless.  (K, 3) -> (K,).

    Columns farther than within_m count as that far.
    """
    result = np.full(len(points), within_m)
    low_n = known.north_min_m + np.arange(known.upper_m.shape[0]) * known.cell_m
    low_e = known.east_min_m + np.arange(known.upper_m.shape[1]) * known.cell_m
    far = within_m + known.cell_m
    for k in range(0, len(points), _CHUNK):
        n, e, z = points[k : k + _CHUNK].T
        rows = (low_n > n.min() - far) & (low_n < n.max() + far)
        columns = (low_e > e.min() - far) & (low_e < e.max() + far)
        if not rows.any() or not columns.any():
            continue
        north, east = low_n[rows], low_e[columns]
        upper = known.upper_m[np.ix_(rows, columns)]
        n, e = n[:, None], e[:, None]
        gap_n = np.maximum(np.maximum(north - n, n - north - known.cell_m), 0.0)
        gap_e = np.maximum(np.maximum(east - e, e - east - known.cell_m), 0.0)
        down = np.maximum(z[:, None, None] - upper, 0.0)
        aside = np.hypot(gap_n[:, :, None], gap_e[:, None, :]) - known.registration_m
        nearest = np.hypot(np.maximum(aside, 0.0), down).min(axis=(1, 2))
        result[k : k + _CHUNK] = np.minimum(nearest, within_m)
    return result
