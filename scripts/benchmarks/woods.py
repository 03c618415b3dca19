"""Fly the bundled lidar missions among trees drawn anew: arrivals, clearance, time, holds.

    scripts/bench woods [--flights 50] [--first 201] [--pilot companion] [--world forest] [--json F]
                        [--library]

Seed k draws the trees of `forest` and the lidar's noise; the houses of `street` stay.  The
companion flies the simulated ArduCopter without sockets or, with --library, a point in
`companion.library` (`woods_library`), a tenth of the time.  Its rivals (`woods_rivals`) fly a point
either way, in the same worlds, with the same lidar, the same map of what it has seen and the same
speed.  Distances are true ones, to all things there are.  Held: not arrived, nothing touched.
"""

import math
from itertools import product
from typing import Any

import numpy as np
import woods_library
from running import Bar, Found, OneOf, in_processes, least, main, most
from stepped import Flight
from woods_rivals import PILOTS

from companion.config import folder_of, load_mission
from companion.mission.state import OVER, Phase
from vehicle_sim.world import read_world

WORLDS = ("forest", "street", "posts")
_LIMIT_S = 900.0


def fly(name: str, pilot: str, seed: int) -> dict[str, Any]:
    """One flight by the companion on the simulator: what came of it."""
    if pilot in PILOTS:
        return woods_library.fly(name, pilot, seed)
    world = read_world(folder_of(name) / "world.toml").with_woods_of(seed)
    it, phases = Flight(load_mission(name), world, seed), [Phase.WAITING]
    began_s, track = math.inf, list[tuple[float, float, float]]()
    while it.phase not in (Phase.ARRIVED, *OVER) and it.now_s < _LIMIT_S:
        it.step()
        if it.phase is not phases[-1]:
            phases.append(it.phase)
        if track or it.phase is Phase.FLYING:
            track.append(it.simulation.place_nea_m())
            began_s = min(began_s, it.now_s)
    way, arrived, reason = np.array(track), phases[-1] is Phase.ARRIVED, it.session.state.reason
    return woods_library.told(name, pilot, seed, way[:, :2]) | {
        "seconds": it.now_s - began_s if arrived else math.inf,
        "holds": phases.count(Phase.HOLDING),
        "end": None if arrived or reason is None else reason.text,
        "nearest_m": float(world.scene(world.truth()).distance_m(way).min()),
    }


def woods(
    flights: int = 10,
    first: int = 1,
    jobs: int = 2,
    world: str = OneOf("both", *WORLDS),
    pilot: str = OneOf("all", "companion", *PILOTS),
    library: bool = False,
) -> Found:
    """Fly them; the bars are the companion's: not too near, no end without a reason."""
    worlds = WORLDS[:2] if world == "both" else (world,)
    pilots = ("companion", *PILOTS) if pilot == "all" else (pilot,)
    todo = [*product(worlds, pilots, range(first, first + flights))]
    flown = [*in_processes(woods_library.fly if library else fly, todo, jobs)]
    bars = list[Bar]()
    for name, who in product(worlds, pilots):
        mine = [each for each in flown if (each["world"], each["pilot"]) == (name, who)]
        arrived = [each for each in mine if each["seconds"] < math.inf]
        lost = [each for each in mine if each["seconds"] == math.inf]
        nearest_m = min(each["nearest_m"] for each in mine)
        yield {
            "among near things": f"{name}, {who}",
            "arrived": f"{len(arrived)} of {len(mine)}",
            "held": sum(each["nearest_m"] > 0.0 for each in lost),
            "touched": sum(each["nearest_m"] <= 0.0 for each in mine),
            "least, m|.2f": nearest_m,
            "flown / straight|.2f": _middle(e["flown_m"] / e["straight_m"] for e in arrived),
            "m/s|.2f": _middle(each["flown_m"] / each["seconds"] for each in arrived),
            "s|.0f": _middle(each["seconds"] for each in arrived),
            "holds|.0f": _middle(e["holds"] for e in mine if e["holds"] is not None),
            "why": "; ".join(f"{each['seed']}: {each['end']}" for each in mine if each["end"]),
        }
        if who not in PILOTS:
            safety_m = load_mission(name).task.settings.safety_distance_m
            bars.append(least(f"{name}: least distance, m", nearest_m, safety_m))
            silent = sum(not each["end"] for each in lost)
            bars.append(most(f"{name}: ended without a reason", silent, 0))
    yield flown
    yield from bars


def _middle(values: Any) -> float:
    return float(np.median([*values] or [math.nan]))


if __name__ == "__main__":
    main(woods)
