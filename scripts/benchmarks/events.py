"""How long one event takes the part that decides, with a large fence that is drawn in flight.

    scripts/bench events [--zones 50] [--corners 100] [--vehicle ardupilot-plane ...] [--json FILE]

A companion flies a mission of the simulator's without sockets (`pair`); in flight the vehicle is
given a fence of so many polygons, all over the area and one on the path, then another one around
the vehicle, then none.  Measured is the processor time of each event in the mission's machine, of
each fence as it is drawn, of checkpoints, and of each whole turn of the session.  What plans is
left out: it has a process of its own.  Each flight is flown twice, and the lesser time of each
event counts: both are the same but for what other programs take.  1 if an event took longer than
its bar, or a turn, which handles all events that came in at once, than its own.
"""

import math
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import numpy as np
import pair_worlds
import running
from numpy.typing import NDArray
from pair import Pair
from rich.table import Table

from companion.mavlink.autopilot_client import AutopilotClient
from companion.mission import checkpoint, entries, machine
from companion.runtime.compiler import load_kernel
from companion.runtime.loop import prompt_threads
from companion.session import Session
from companion.world.threats import PolygonZone
from vehicle_sim.plans import PlanItem, PlanKind

_BAR_MS, _TURN_BAR_MS = 20.0, 50.0  # a turn is shorter than the period of a stream of 20 Hz
_TURN = "whole turn"
_FIRST_S, _AROUND_S, _NONE_S = 5.0, 75.0, 140.0
"""After it began to fly; the companion reads a hundred items a second here."""

FloatArray = NDArray[np.float64]
Times = defaultdict[str, list[float]]


def polygon(
    rng: np.random.Generator, middle: FloatArray, radius_m: float, corners: int, name: str
) -> PolygonZone:
    """Jagged, and simple: its corners lie around the middle in order."""
    turns = np.arange(corners) * (math.tau / corners)
    reach_m = rng.uniform(0.7, 1.0, corners) * radius_m
    places = middle + reach_m[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    return PolygonZone(name=name, vertices_ne_m=tuple((n, e) for n, e in places.tolist()))


def polygons(
    scene: pair_worlds.Scene, about: FloatArray, zones: int, corners: int, *, ahead: bool
) -> list[PolygonZone]:
    """So many about a place; the first lies on the way from there to the target, or around it."""
    rng = np.random.default_rng(1)
    task, target = scene.mission.task, np.array(scene.mission.targets_ne_m[-1])
    reach_m = task.settings.scan_range_m
    along = (target - about) / np.linalg.norm(target - about)
    first = about + (0.5 * reach_m if ahead else 0.0) * along
    found = [polygon(rng, first, 0.08 * reach_m, corners, "0")]
    while len(found) < zones:
        middle = about + rng.uniform(-reach_m, reach_m, 2)
        found.append(polygon(rng, middle, 0.06 * reach_m, corners, str(len(found))))
    return found


def draw(zones: int, corners: int, *, ahead: bool) -> Callable[[Pair], None]:
    """Give the vehicle a fence at once, as if it had been uploaded."""

    def happen(pair: Pair) -> None:
        about = np.array(pair.where()[:2])
        drawn = polygons(pair.scene, about, zones, corners, ahead=ahead) if zones else []
        pair.flown.fences.append((pair.now_s, tuple(drawn)))
        items = [item for zone in drawn for item in pair.station.items_of(zone)]
        pair.simulation.plans[PlanKind.FENCE] = tuple(
            PlanItem(
                frame=0,
                command=command,
                parameters=(first, 0.0, 0.0, 0.0),
                x=round(latitude * 1e7),
                y=round(longitude * 1e7),
            )
            for command, first, latitude, longitude in items
        )
        pair.note(f"{zones} zones of {corners} corners")

    return happen


def timed(times: Times, name: Callable[..., str], function: Callable[..., Any]) -> Any:
    """The function, with its processor time kept under a name that depends on its arguments."""

    def call(*arguments: Any, **keywords: Any) -> Any:
        began_s = time.thread_time()
        try:
            return function(*arguments, **keywords)
        finally:
            times[name(*arguments)].append(time.thread_time() - began_s)

    return call


def fly(vehicle: str, zones: int, corners: int, limit_s: float = 400.0) -> tuple[Times, Pair]:
    """One flight: processor times in seconds, by what they were taken for."""
    scene = pair_worlds.scene_of(vehicle, 1)
    (target,) = scene.mission.targets_ne_m
    pair = Pair(scene.through(target, (0.0, 0.0), target), seed=1, kernel=load_kernel())
    pair.at(_FIRST_S, draw(zones, corners, ahead=True))
    pair.at(_AROUND_S, draw(zones, corners, ahead=False))
    pair.at(_NONE_S, draw(0, 0, ahead=False))
    times: Times = defaultdict(list)
    patched = (
        (machine, "step", lambda _state, event, *_: type(event).__name__),
        (entries, "of_event", lambda event, *_: f"journal of {type(event).__name__}"),
        (AutopilotClient, "events", lambda *_: "fence and parameters"),
        (checkpoint.CheckpointPolicy, "due", lambda *_: "checkpoint"),
        (Session, "receive", lambda *_: "bytes in"),
        (Session, "run", lambda *_: _TURN),
    )
    patches = [
        patch.object(owner, call, timed(times, name, getattr(owner, call)))
        for owner, call, name in patched
    ]
    for each in patches:
        each.start()
    try:
        with prompt_threads():  # as in flight
            pair.fly(limit_s=limit_s)
    finally:
        for each in patches:
            each.stop()
    return times, pair


def table_of(vehicle: str, times: dict[str, list[float]]) -> Table:
    """Milliseconds, the longest first."""
    title = f"{vehicle}: processor time, ms"
    table = running.figures(title, "event", "count", "median", "p99", "most")
    for name, taken in sorted(times.items(), key=lambda item: -max(item[1])):
        values = 1e3 * np.array(taken)
        row = (np.median(values), np.quantile(values, 0.99), values.max())
        table.add_row(name, str(len(values)), *(f"{value:.2f}" for value in row))
    return table


def main() -> int:
    """Fly with each vehicle."""
    each = {"nargs": "+", "choices": pair_worlds.VEHICLES, "default": pair_worlds.VEHICLES}
    options, console = running.begin(__doc__, zones=50, corners=100, vehicle=each)
    every: dict[str, dict[str, list[float]]] = {}
    slow = False
    for vehicle in options.vehicle:
        (once, pair), (again, _) = (fly(vehicle, options.zones, options.corners) for _ in "12")
        pairs = {name: zip(taken, again[name], strict=True) for name, taken in once.items()}
        times = every[vehicle] = {name: [min(two) for two in pairs[name]] for name in pairs}
        console.print(table_of(vehicle, times))
        told = [len(e["zones"]) for e in pair.flown.journal if e["kind"] == "fence"]
        ended = pair.flown.died or f"{pair.flown.outcome} ({pair.flown.reason})"
        console.print(f"fences told: {told} zones; {ended}\n", markup=False)
        slow |= any(
            max(taken) > 1e-3 * (_TURN_BAR_MS if name == _TURN else _BAR_MS)
            for name, taken in times.items()
        )
        if pair.flown.died:
            return 1
    running.store(options.json, every)
    return int(slow)


if __name__ == "__main__":
    sys.exit(main())
