"""The planner without MAVLink: one call flies a mission through a world that only scans show.

See docs/library.md.  Deterministic: the same arguments, the same flight.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, fields, replace
from typing import final

import numpy as np

from companion.config import load_mission, load_world
from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.optimise.registry import OPTIMISERS, Maker, temporarily_registered
from companion.path.certificate import Certificate, bounds_text
from companion.path.limits import Limits
from companion.planner.offline import OfflineFlight, Scanner, fly_offline
from companion.planner.on_board import OnBoard, flight_time_s
from companion.planner.request import NotPlanned, Planned, PlanOutcome, PlanRequest
from companion.planner.rules import check_task
from companion.planner.settings import PlannerSettings, Task
from companion.planning import plan
from companion.profiles import PROFILES
from companion.runtime.compiler import load_kernel
from companion.sources.schema import keys_of, validated
from companion.world.known_map import NO_ANSWER, NOT_SEEN, KnownMap, Scan, empty_map
from companion.world.near_map import NearSensor, cell_for_m
from companion.world.radars import Radar, detection_probability
from companion.world.simulated_scan import simulated_scan, true_map
from companion.world.simulated_sweep import NearScene, Thing
from companion.world.terrain import ArrayTerrain, Peak, PeakTerrain, Terrain
from companion.world.zones import CircleZone, PolygonZone

__all__ = [
    "NOT_SEEN", "NO_ANSWER", "OPTIMISERS", "PROFILES", "ArrayTerrain", "CircleZone", "Flown",
    "InputError", "KnownMap", "Limits", "Maker", "NearScene", "NearSensor", "NotPlanned", "Peak",
    "PeakTerrain", "PlanOutcome", "PlanRequest", "Planned", "PlannerSettings", "PolygonZone",
    "Radar", "Scan", "Scanner", "Task", "Terrain", "Thing", "flight_time_s", "fly", "plan",
    "simulated_scan",
]  # fmt: skip

_SPACING = 400  # points of the flown path to a scan range
_NO_NUMBERS = {"overrun_m", "profile", "weights"}  # may be infinite, or are objects


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
    """Of what was flown."""
    terms: dict[str, float]
    """`length`, `height` and `radar` of eq. 5, along what was flown."""
    certificates: tuple[Certificate, ...]
    """The proof of each subpath; `certificate.broken` says what was not proven (`paper`)."""
    task: Task
    """Under which it was flown."""
    details: OfflineFlight
    """Everything: legs, plans with the cost terms of each search, scans, the known map."""

    @property
    def cost(self) -> float:
        """J, the sum of the terms: what docs/results/benchmarks.md compares with the optimum."""
        return sum(self.terms.values())

    @property
    def seconds(self) -> float:
        """An estimate of how long it takes, with its stops.  Computed each time."""
        return flight_time_s(self.details, self.task)


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

    Parameters
    ----------
    world
        The truth: a bundled name, a world.toml, a `Terrain`, or heights AMSL (rows to the north,
        columns to the east), `spacing_m` apart from `corner_ne_m` (the map's south-west corner).
    mission
        A bundled name or a mission file, or a `Task`, which needs a start and targets.
    start_nea_m, targets_ne_m
        North, east (and altitude AMSL) in metres; by default those of the files.
    known
        Terrain known in advance; None: that of the mission file, or nothing.
    scanner
        What is seen of the truth from a point with a range: `simulated_scan`, or your own.
    near, scene
        In place of a scanner: a sensor of near things (by default the mission's), and what stands
        in the world.  `known.guess_m` is the ground, which it does not see; None: the world's.
    planner
        What answers the requests: `plan`, or your own.
    optimiser
        A name in `OPTIMISERS`, or your own: what makes one; None: the mission's.
    seed
        Of every search.
    most_legs
        After how many it gives up; None: six times as many as a straight way has, at least 60.

    InputError: an argument is not understood.
    """
    if seed < 0 or (most_legs is not None and most_legs < 1):
        rule = "a seed is 0 or more, and a flight has one leg or more"
        raise InputError("seed, most_legs", (seed, most_legs), rule, "Raise it.")
    task, start_nea_m, targets, known, near = _mission(
        world, mission, start_nea_m, targets_ne_m, known, near
    )
    if (near is None) is not (scene is None):
        rule = "a near sensor and the scene that it sees belong together"
        raise InputError("scene", scene, rule, "Give both: NearSensor and NearScene.")
    terrain = _terrain(world, task, spacing_m, corner_ne_m)
    blank = known or empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)
    truth, flies = true_map(terrain, blank), None
    if near is not None and scene is not None:
        blank = replace(blank, guess_m=truth.upper_m) if blank.guess_m is None else blank
        on_board = OnBoard(near, scene, task, blank)
        scanner, flies = on_board.scan, on_board.flies
    load_kernel()  # once: ten seconds the first time ever
    with _searched_with(optimiser, task) as task:
        flight = fly_offline(
            task,
            blank=blank,
            truth=truth,
            start_nea_m=start_nea_m,
            targets_ne_m=targets,
            seed=seed,
            planner=planner,
            scanner=scanner,
            flies=flies,
            most_legs=most_legs,
        )
    return _flown(flight, task)


@contextmanager
def _searched_with(optimiser: str | Maker | None, task: Task) -> Iterator[Task]:
    """The task, with another optimiser if one is given."""
    if isinstance(optimiser, str):
        OPTIMISERS.chosen(optimiser, "optimiser")
    with (
        temporarily_registered(optimiser) if callable(optimiser) else nullcontext(optimiser) as name
    ):
        yield (
            task if name is None else replace(task, settings=replace(task.settings, optimiser=name))
        )


_Place = tuple[float, float, float]
_Mission = tuple[Task, _Place, tuple[tuple[float, float], ...], KnownMap | None, NearSensor | None]


def _mission(
    world: str | Terrain | FloatArray,
    mission: str | Task,
    start_nea_m: tuple[float, float, float] | None,
    targets_ne_m: Sequence[tuple[float, float]],
    known: KnownMap | None,
    near: NearSensor | None,
) -> _Mission:
    """The task, start, targets, what is known, and sensor, from files where they are not given."""
    targets = tuple(
        (float(north), float(east))
        for north, east in (_numbers(at, 2, "targets_ne_m") for at in targets_ne_m)
    )
    if isinstance(mission, str):
        read = load_mission(mission)
        near = near or read.near
        task, targets, known = read.task, targets or read.targets_ne_m, known or read.known
        if start_nea_m is None and isinstance(world, str):
            start_nea_m = (*load_world(world).start_ne_m, read.task.take_off_amsl_m)
    else:
        task = _checked(mission if near is None else _among_near_things(mission))
    if start_nea_m is None:
        raise InputError("start_nea_m", None, "it is not known", "Give north, east, altitude.")
    north_m, east_m, altitude_m = _numbers(start_nea_m, 3, "start_nea_m")
    if not targets:
        raise InputError("targets_ne_m", (), "there is none", "Give (north, east) of each.")
    return task, (north_m, east_m, altitude_m), targets, known, near


def _among_near_things(task: Task) -> Task:
    """The task with small cells, and no farther past an end than d_s: as mission files have it."""
    limits, settings = task.limits, task.settings
    cell_m = settings.cell_m or cell_for_m(settings.scan_range_m, limits.north_m, limits.east_m)
    overrun_m = min(limits.overrun_m, settings.safety_distance_m)
    return replace(
        task,
        limits=replace(limits, overrun_m=overrun_m),
        settings=replace(settings, cell_m=cell_m),
    )


def _numbers(place: Sequence[float], count: int, field: str) -> list[float]:
    """A place as so many finite numbers."""
    if np.shape(place) != (count,) or not np.isfinite(found := np.asarray(place, float)).all():
        raise InputError(field, place, f"it is not {count} finite numbers", "Give metres.")
    return found.tolist()


def _checked(task: Task) -> Task:
    """Hold a task that comes from no file to the rules of mission files."""
    for where, held in (("limits", task.limits), ("settings", task.settings)):
        values = {each.name: getattr(held, each.name) for each in fields(held)}
        table = {
            name: value.item() if isinstance(value, np.generic) else value
            for name, value in values.items()
            if name not in _NO_NUMBERS
        }
        validated(keys_of(type(held), *table), table, where)
    check_task(task)
    if task.settings.optimiser is not None:
        OPTIMISERS.chosen(task.settings.optimiser, "settings.optimiser")
    return task


def _terrain(
    world: str | Terrain | FloatArray,
    task: Task,
    spacing_m: float | None,
    corner_ne_m: tuple[float, float] | None,
) -> Terrain:
    if isinstance(world, str):
        return load_world(world).terrain
    if not isinstance(world, np.ndarray):
        return world
    if spacing_m is None or not spacing_m > 0.0:
        raise InputError("spacing_m", spacing_m, "heights need one", "Give it in metres.")
    if world.ndim != 2 or 0 in world.shape or not np.isfinite(world).all():
        raise InputError("world", world.shape, "heights are finite, (rows, columns)", "Fill gaps.")
    south, west = corner_ne_m or (task.limits.north_m[0], task.limits.east_m[0])
    return ArrayTerrain(heights_m=world, spacing_m=spacing_m, south_m=south, west_m=west)


def _flown(flight: OfflineFlight, task: Task) -> Flown:
    points = flight.route_nea_m(task.settings.scan_range_m / _SPACING)
    failure = flight.failure
    why = ""
    if failure is not None:
        broken = f" ({bounds_text(failure.broken)})" if failure.broken else ""
        why = f"{failure.refusal.name}: {failure.refusal.value}{broken}"
    return Flown(
        arrived=failure is None,
        why=why,
        points_nea_m=points,
        length_m=sum(flight.flown_m),
        terms=route_terms(points, task),
        certificates=tuple(planned.certificate for planned in flight.plans),
        task=task,
        details=flight,
    )


def route_terms(points_nea_m: FloatArray, task: Task) -> dict[str, float]:
    """Eq. 5 to 7 and 10 as integrals along a path, scaled as of subpaths (planner-numbers A)."""
    weights, unit = task.settings.weights, 100.0 / task.settings.scan_range_m
    middle = 0.5 * (points_nea_m[1:] + points_nea_m[:-1])
    step = np.linalg.norm(np.diff(points_nea_m, axis=0), axis=-1)
    floor, ceiling = task.band_amsl_m
    detection = np.zeros(len(middle))
    for radar in task.radars:
        detection += detection_probability(radar.distance_m(middle), radar.range_m)
    return {
        "length": float(weights.length * unit / 2.4 * step.sum()),
        "height": float(
            weights.height * unit * (step @ (middle[:, 2] - floor)) / (ceiling - floor)
        ),
        "radar": float(weights.radar * 3.0 * unit * (step @ detection)),
    }
