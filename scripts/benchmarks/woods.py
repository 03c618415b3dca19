"""Fly the bundled lidar missions among trees drawn anew: arrivals, clearance, time, holds.

    scripts/bench woods [--flights 50] [--first 201] [--pilot companion] [--world forest] [--json F]
                        [--library]

Seed k draws the trees of `forest` and the lidar's noise; the houses of `street` stay.  The
companion and its rivals (`woods_rivals`) fly without sockets, in the same worlds, with the same
lidar, the same map of what it has seen and the same speed.  Distances are true ones: every 0.1 m
of the way to all things there are.  Held: not arrived, nothing touched.

--library: through `companion.library`, a tenth of the time (`woods_library`); also the world
`posts`; no bendy ruler.
"""

import math
import sys
from itertools import product
from typing import Any

import numpy as np
import running
import woods_library
import woods_rivals
from numpy.typing import NDArray
from stepped import Flight

from companion.config import folder_of, load_mission
from companion.mission.state import OVER, Phase
from vehicle_sim.world import World, read_world

WORLDS = ("forest", "street", "posts")
RIVALS: dict[str, type[woods_rivals.Bendy | woods_rivals.AStar]] = {
    "bendy ruler": woods_rivals.Bendy,
    "A*": woods_rivals.AStar,
}
PILOTS = ("companion", *RIVALS)

LIMIT_S = 900.0


def fly(name: str, pilot: str, seed: int) -> dict[str, Any]:
    """One flight: what came of it."""
    truth = read_world(folder_of(name) / "world.toml").with_woods_of(seed)
    if pilot in RIVALS:
        seconds, track = woods_rivals.fly(name, truth, seed, RIVALS[pilot])
        found = {"seconds": seconds, "holds": None, "end": None, **_told(truth, track)}
    else:
        found = _flown(name, seed, truth)
    return {"world": name, "pilot": pilot, "seed": seed, **found}


def _flown(name: str, seed: int, truth: World) -> dict[str, Any]:
    """By the companion."""
    it, phases, began_s, track = (
        Flight(load_mission(name), truth, seed),
        [Phase.WAITING],
        math.inf,
        [],
    )
    while it.phase not in (Phase.ARRIVED, *OVER) and it.now_s < LIMIT_S:
        it.step()
        phase = it.phase
        if phase is not phases[-1]:
            phases.append(phase)
        if phase is Phase.FLYING:
            began_s = min(began_s, it.now_s)
        if it.now_s >= began_s:
            track.append(it.simulation.place_nea_m())
    arrived = phases[-1] is Phase.ARRIVED
    reason = it.session.state.reason
    return {
        "seconds": it.now_s - began_s if arrived else math.inf,
        "holds": phases.count(Phase.HOLDING),
        "end": None if arrived or reason is None else reason.text,
        **_told(truth, np.array(track)),
    }


def _told(world: World, track_nea_m: NDArray[np.float64]) -> dict[str, float]:
    """Of the way."""
    return {
        "flown_m": float(np.hypot(*np.diff(track_nea_m[:, :2], axis=0).T).sum()),
        "straight_m": math.dist(track_nea_m[0, :2], track_nea_m[-1, :2]),
        "nearest_m": true_gap_m(world, track_nea_m),
    }


def true_gap_m(world: World, track_nea_m: NDArray[np.float64]) -> float:
    """The least distance of a way, every 0.1 m of it, to all that stands in a world."""
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(track_nea_m, axis=0), axis=1)))
    at_m = np.arange(0.0, along_m[-1] + 0.1, 0.1)
    points = np.stack([np.interp(at_m, along_m, column) for column in track_nea_m.T], axis=-1)
    least_m = math.inf
    for thing in world.scene(world.truth()).things:
        above_m = np.maximum(points[:, 2] - thing.top_amsl_m, thing.bottom_amsl_m - points[:, 2])
        corners = np.array(thing.corners_ne_m)
        ends = np.roll(corners, -1, axis=0)
        if not thing.closed and len(corners) > 1:
            corners, ends = corners[:-1], ends[:-1]
        for start, end in zip(corners, ends, strict=True):
            along, away = end - start, points[:, :2] - start
            share = np.clip(away @ along / max(along @ along, 1e-12), 0.0, 1.0)
            aside_m = np.hypot(*(away - share[:, None] * along).T) - thing.half_width_m
            gaps_m = np.hypot(np.maximum(aside_m, 0.0), np.maximum(above_m, 0.0))
            least_m = min(least_m, float(gaps_m.min()))
    return least_m


def main() -> int:
    """Fly them, print the table; 1 if the companion came too near or ended without a reason."""
    options, console = running.begin(
        __doc__,
        flights=10,
        first=1,
        jobs=2,
        world=["both", *WORLDS],
        pilot=["all", *PILOTS],
        library=False,
    )
    worlds = WORLDS[:2] if options.world == "both" else (options.world,)
    pilots = PILOTS if options.pilot == "all" else (options.pilot,)
    if options.library:
        pilots = tuple(each for each in pilots if each != "bendy ruler")
    seeds = range(options.first, options.first + options.flights)
    flies = woods_library.fly if options.library else fly
    todo = [(name, pilot, seed) for name in worlds for pilot in pilots for seed in seeds]
    flights = running.in_processes(flies, todo, options.jobs, "woods", console)
    found = [future.result() for _, future in flights]
    headings = "arrived", "held", "touched", "least m", "flown / straight", "m/s", "s"
    table = running.figures("Among near things", "", *headings, "holds", "why")
    bars = []
    for name, pilot in product(worlds, pilots):
        mine = [each for each in found if (each["world"], each["pilot"]) == (name, pilot)]
        arrived = [each for each in mine if each["seconds"] < math.inf]
        touched = [each for each in mine if each["nearest_m"] <= 0.0]
        nearest_m = min(each["nearest_m"] for each in mine)
        if pilot not in RIVALS:
            safety_m = load_mission(name).task.settings.safety_distance_m
            bars.append(running.least(f"{name}: least distance, m", nearest_m, safety_m))
            silent = sum(not each["end"] for each in mine if each not in arrived)
            bars.append(running.most(f"{name}: ended without a reason", silent, 0))
        middle = {
            "ratio": [each["flown_m"] / each["straight_m"] for each in arrived],
            "speed": [each["flown_m"] / each["seconds"] for each in arrived],
            "time": [each["seconds"] for each in arrived],
            "holds": [each["holds"] for each in mine if each["holds"] is not None],
        }
        ratio, speed, seconds, holds = (np.median(each or [math.nan]) for each in middle.values())
        table.add_row(
            f"{name}, {pilot}",
            f"{len(arrived)} of {len(mine)}",
            str(sum(each not in arrived and each not in touched for each in mine)),
            str(len(touched)),
            f"{nearest_m:.2f}",
            f"{ratio:.2f}",
            f"{speed:.2f}",
            f"{seconds:.0f}",
            f"{holds:.0f}",
            "; ".join(f"{each['seed']}: {each['end']}" for each in mine if each["end"]),
        )
    console.print(table)
    return running.ended(console, options.json, found, bars)


if __name__ == "__main__":
    sys.exit(main())
