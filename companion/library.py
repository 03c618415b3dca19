"""The planner without MAVLink: one call flies a mission through a world that only scans show.

See docs/library.md.  Deterministic: the same arguments, the same flight.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import final

import numpy as np

from companion.config import load_mission, load_world
from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.optimise.registry import OPTIMISERS, Maker
from companion.path.certificate import Certificate, bounds_text
from companion.path.limits import Limits
from companion.planner import rules
from companion.planner.offline import OfflineFlight, OnBoard, TerrainRadar, fly_offline
from companion.planner.request import NotPlanned, Planned, PlanOutcome, PlanRequest
from companion.planner.settings import PlannerSettings, Task
from companion.planning import plan
from companion.profiles import PROFILES
from companion.runtime.compiler import load_kernel
from companion.sources.tables import keys_of, validated
from companion.world.known_map import NO_ANSWER, NOT_SEEN, KnownMap, Scan, empty_map
from companion.world.near_map import NearSensor, cell_for_m
from companion.world.radars import Radar, detection_probability
from companion.world.simulated import NearScene, Thing, simulated_scan, true_map
from companion.world.terrain import ArrayTerrain, Peak, PeakTerrain, Terrain
from companion.world.zones import CircleZone, PolygonZone

__all__ = [
    "NOT_SEEN", "NO_ANSWER", "OPTIMISERS", "PROFILES", "ArrayTerrain", "CircleZone", "Flown",
    "InputError", "KnownMap", "Limits", "Maker", "NearScene", "NearSensor", "NotPlanned", "Peak",
    "PeakTerrain", "PlanOutcome", "PlanRequest", "Planned", "PlannerSettings", "PolygonZone",
    "Radar", "Scan", "Scanner", "Task", "Terrain", "Thing", "fly", "plan", "simulated_scan",
]  # fmt: skip

Scanner = Callable[[KnownMap, tuple[float, float, float], float], Scan]
"""What is seen of the truth from a point (north, east, altitude) with a range, metres."""
_SPACING = 400  # points of the flown path to a scan range
_NO_NUMBERS = {"overrun_m", "profile", "weights", "optimiser"}  # may be infinite, or are objects


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Flown:
    """A mission that was flown, or how far it came."""

    arrived: bool
    why: str
    """Why it did not arrive, and what helps; empty if it did."""
    points_nea_m: FloatArray
    """(S, 3) north, east, altitude along what was flown, R / 400 apart or less."""
    length_m: float
    terms: dict[str, float]
    """`length`, `height` and `radar` of eq. 5, along what was flown."""
    cost: float
    """J, the sum of the terms: what docs/lab/benchmarks.md compares with the optimum."""
    seconds: float
    """About how long it takes, with its stops."""
    certificates: tuple[Certificate, ...]
    """The proof of each subpath; `certificate.broken` says what was not proven (`paper`)."""
    task: Task
    details: OfflineFlight
    """Everything: legs, plans with the cost terms of each search, scans, the known map."""


def fly(
    world: str | Terrain | FloatArray,
    mission: str | Task,
    *,
    start_nea_m: tuple[float, float, float] | None = None,
    targets_ne_m: Sequence[tuple[float, float]] = (),
    spacing_m: float | None = None,
    corner_ne_m: tuple[float, float] | None = None,
    known: KnownMap | None = None,
    scanner: Scanner = simulated_scan,
    near: NearSensor | None = None,
    scene: NearScene | None = None,
    planner: Callable[[PlanRequest], PlanOutcome] = plan,
    optimiser: str | Maker | None = None,
    seed: int = 1,
    most_legs: int | None = None,
) -> Flown:
    """Fly a mission: scan, plan a subpath, fly it, and again, until the last target.

    What the arguments mean: docs/library.md.  world: its name or file, its terrain, or heights AMSL
    (rows to the north, columns to the east).  mission: its name or file, or a task, which needs a
    start and targets.  known, near, optimiser: None: the mission's.  near, scene: in place of a
    scanner; `known.guess_m` is the ground, which they do not see (None: the world's).
    InputError: an argument is not understood.
    """
    if seed < 0 or (most_legs is not None and most_legs < 1):
        rule = "a seed is 0 or more, and a flight has one leg or more"
        raise InputError("seed, most_legs", (seed, most_legs), rule, "Raise it.")
    start_ne_m = None
    if isinstance(world, str):
        place = load_world(world)
        world, start_ne_m = place.terrain, place.start_ne_m
    given = (_numbers(target, 2, "targets_ne_m") for target in targets_ne_m)
    targets = tuple((north_m, east_m) for north_m, east_m in given)
    if isinstance(mission, str):
        read = load_mission(mission)
        task, near, known = read.task, near or read.near, known or read.known
        targets = targets or read.targets_ne_m
        if start_nea_m is None and start_ne_m is not None:
            start_nea_m = (*start_ne_m, task.take_off_amsl_m)
    else:
        task = _checked(mission, is_near=near is not None)
    if start_nea_m is None:
        raise InputError("start_nea_m", None, "it is not known", "Give north, east, altitude.")
    north_m, east_m, altitude_m = _numbers(start_nea_m, 3, "start_nea_m")
    if not targets:
        raise InputError("targets_ne_m", (), "there is none", "Give (north, east) of each.")
    if (near is None) is not (scene is None):
        rule = "a near sensor and the scene that it sees belong together"
        raise InputError("scene", scene, rule, "Give both: NearSensor and NearScene.")
    if optimiser is not None:
        if isinstance(optimiser, str):
            OPTIMISERS.chosen(optimiser, "optimiser")
        task = replace(task, settings=replace(task.settings, optimiser=optimiser))
    blank = known or empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)
    if isinstance(world, np.ndarray):
        world = _terrain(world, task, spacing_m, corner_ne_m)
    truth = true_map(world, blank)
    range_m = task.settings.scan_range_m
    sensor: TerrainRadar | OnBoard = TerrainRadar(task, lambda at: scanner(truth, at, range_m))
    if near is not None and scene is not None:
        if blank.guess_m is None:
            blank = replace(blank, guess_m=truth.upper_m)
        sensor = OnBoard(near, scene, task, blank)
    load_kernel()  # once: ten seconds the first time ever
    flight = fly_offline(
        task, sensor, blank=blank, start_nea_m=(north_m, east_m, altitude_m), targets_ne_m=targets,
        seed=seed, planner=planner, most_legs=most_legs,
    )  # fmt: skip
    points, why = flight.route_nea_m(range_m / _SPACING), ""
    if (failure := flight.failure) is not None:
        why = failure.why + (f" ({bounds_text(failure.broken)})" if failure.broken else "")
    return Flown(
        arrived=failure is None, why=why, points_nea_m=points, length_m=sum(flight.flown_m),
        terms=(terms := route_terms(points, task)), cost=sum(terms.values()),
        seconds=flight.seconds, certificates=tuple(plan.certificate for plan in flight.plans),
        task=task, details=flight,
    )  # fmt: skip


def _numbers(place: Sequence[float], count: int, field: str) -> tuple[float, ...]:
    """A place as so many finite numbers."""
    if np.shape(place) != (count,) or not np.isfinite(values := np.asarray(place, float)).all():
        raise InputError(field, place, f"it is not {count} finite numbers", "Give metres.")
    return tuple(values.tolist())


def _checked(task: Task, *, is_near: bool) -> Task:
    """Hold a task that comes from no file to the rules of mission files.

    is_near: with small cells, and no farther past an end than d_s, as mission files have it.
    """
    limits, settings = task.limits, task.settings
    if is_near:
        cell_m = settings.cell_m or cell_for_m(settings.scan_range_m, limits.north_m, limits.east_m)
        limits = replace(limits, overrun_m=min(limits.overrun_m, settings.safety_distance_m))
        settings = replace(settings, cell_m=cell_m)
        task = replace(task, limits=limits, settings=settings)
    for where, held in (("limits", limits), ("settings", settings)):
        numbers = {key: value for key, value in asdict(held).items() if key not in _NO_NUMBERS}
        numbers |= {k: v.item() for k, v in numbers.items() if isinstance(v, np.generic)}
        validated(keys_of(type(held), *numbers), numbers, where)
    rules.refuse(rules.of_task(task))
    if isinstance(settings.optimiser, str):
        OPTIMISERS.chosen(settings.optimiser, "settings.optimiser")
    return task


def _terrain(
    heights_m: FloatArray,
    task: Task,
    spacing_m: float | None,
    corner_ne_m: tuple[float, float] | None,
) -> Terrain:
    if spacing_m is None or not spacing_m > 0.0:
        raise InputError("spacing_m", spacing_m, "heights need one", "Give it in metres.")
    if heights_m.ndim != 2 or 0 in heights_m.shape or not np.isfinite(heights_m).all():
        rule = "heights are finite, (rows, columns)"
        raise InputError("world", heights_m.shape, rule, "Fill gaps.")
    south, west = corner_ne_m or (task.limits.north_m[0], task.limits.east_m[0])
    return ArrayTerrain(heights_m=heights_m, spacing_m=spacing_m, south_m=south, west_m=west)


def route_terms(points_nea_m: FloatArray, task: Task) -> dict[str, float]:
    """Eq. 5 to 7 and 10 as integrals along a path, scaled as of subpaths (planner-numbers A)."""
    length, height, radar = task.settings.weights.per_metre(task.settings.scan_range_m)
    middle = 0.5 * (points_nea_m[1:] + points_nea_m[:-1])
    step = np.linalg.norm(np.diff(points_nea_m, axis=0), axis=-1)
    floor, ceiling = task.band_amsl_m
    seen = (detection_probability(radar.distance_m(middle), radar.range_m) for radar in task.radars)
    high = step @ (middle[:, 2] - floor)
    return {
        "length": float(length * step.sum()),
        "height": float(height * high / (ceiling - floor)),
        "radar": float(radar * (step @ sum(seen, np.zeros(len(middle))))),
    }
