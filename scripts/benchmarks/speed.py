"""How long a plan takes.

A plan here is one search of 3,000 evaluations at 40 samples with 20 obstacles in range, and the
certificate of what it finds.  What comes before it once per scan is timed beside it.
usage: python scripts/benchmarks/speed.py [--scenes 60] [--repeats 5] [--json FILE]
"""

import math
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from running import Found, main, most
from tapped import BIN, udp_socket

from companion.campaign.families import mountain
from companion.config import load_mission
from companion.path.subpath import Pose
from companion.planner.field import cost_to_go
from companion.planner.plan import plan
from companion.planner.price import Prices
from companion.planner.request import Planned, PlanRequest
from companion.planner.searches import Searches, scene_of, surroundings_of
from companion.runtime.compiler import load_kernel
from companion.world.known_map import empty_map
from companion.world.radars import Radar
from companion.world.simulated_scan import simulated_scan, true_map
from companion.world.terrain import PeakTerrain
from companion.world.zones import CircleZone

_SIDE_M = 60_000.0
_PEAKS, _RADARS, _KEEP_OUTS = 10, 7, 3
_FIRST_PLAN = """
import time
began = time.perf_counter()
from companion.runtime.compiler import load_kernel
load_kernel()  # plans once
print(time.perf_counter() - began)
"""


def request(number: int) -> PlanRequest:
    """A vehicle at V amid 20 obstacles, all within its scan range."""
    rng = np.random.default_rng([number, 20])
    task = load_mission("environment-2").task
    limits = replace(task.limits, north_m=(0.0, _SIDE_M), east_m=(0.0, _SIDE_M))
    here = 0.5 * _SIDE_M
    places = [_around(rng, here) for _ in range(_PEAKS + _RADARS + _KEEP_OUTS)]
    peaks = tuple(
        mountain(*at, rng.uniform(2_500.0, 5_500.0), tuple(rng.uniform(1_000.0, 2_500.0, 2)))
        for at in places[:_PEAKS]
    )
    radars = tuple(
        Radar(name="r", centre_nea_m=(*at, 0.0), range_m=float(rng.uniform(3_100.0, 4_500.0)))
        for at in places[_PEAKS : _PEAKS + _RADARS]
    )
    zones = tuple(
        CircleZone(name="z", north_m=n, east_m=e, radius_m=float(rng.uniform(300.0, 1_500.0)))
        for n, e in places[-_KEEP_OUTS:]
    )
    task = replace(task, limits=limits, radars=radars, zones=zones)
    terrain = PeakTerrain(peaks=peaks, ground_amsl_m=0.0)
    blank = empty_map(task.cell_m, limits.north_m, limits.east_m)
    scan_nea_m = (here, here, 3_100.0)
    heading = float(rng.uniform(-math.pi, math.pi))
    tangent = np.array([math.cos(heading), math.sin(heading), 0.0])
    bend = float(rng.uniform(-1.0, 1.0)) / 8_000.0
    start = Pose(
        position_nea_m=np.array(scan_nea_m) + 1_500.0 * tangent,
        tangent_nea=tangent,
        curvature_nea_1_m=bend * np.array([-tangent[1], tangent[0], 0.0]),
    )
    far = 0.45 * _SIDE_M
    return PlanRequest(
        plan_id=1,
        seed=number,
        task=task,
        known=blank.with_scan(simulated_scan(true_map(terrain, blank), scan_nea_m, 20_000.0)),
        scan_nea_m=scan_nea_m,
        start=start,
        from_rest=False,
        target_ne_m=(here + far * math.cos(heading), here + far * math.sin(heading)),
    )


def _around(rng: np.random.Generator, here: float) -> tuple[float, float]:
    """A place in range, but not on top of the vehicle."""
    bearing, distance = rng.uniform(-math.pi, math.pi), rng.uniform(7_000.0, 19_000.0)
    return here + float(distance * math.cos(bearing)), here + float(distance * math.sin(bearing))


def timed(what: Callable[[], Any], repeats: int) -> tuple[list[tuple[float, float]], Any]:
    """Milliseconds of the processor, and by the wall, of each repetition; and the last result."""
    times, result = [], None
    for _ in range(repeats):
        began, clock = time.thread_time(), time.perf_counter()
        result = what()
        times.append(((time.thread_time() - began) * 1e3, (time.perf_counter() - clock) * 1e3))
    return times, result


def speed(scenes: int = 60, repeats: int = 5) -> Found:
    """Times of what is done for a plan, each so often in each scene."""
    load_kernel()
    times: dict[str, list[tuple[float, float]]] = defaultdict(list)
    proven = 0

    def note(name: str, count: int, what: Callable[..., Any], *told: Any) -> Any:
        some, result = timed(partial(what, *told), count)
        times[name] += some
        return result

    for number in range(scenes):
        asked = request(number)
        speed_m_s, here = asked.task.limits.speed_m_s, asked.scan_nea_m[:2]
        told = asked.known, asked.task, here, asked.target_ne_m
        field = note("guidance", repeats, cost_to_go, *told)
        note("surfaces", repeats, scene_of, asked, field)
        note("surface to prove against", repeats, surroundings_of, asked, speed_m_s)
        searches = Searches(asked, lambda: False)
        searches.guided_by(Prices(asked.task, field))
        found = note("plan", repeats, _one, searches)
        proven += isinstance(found, Planned)
        if number % 6 == 0 and isinstance(found, Planned):
            motion_m_s = searches.scene.motion.speed_m_s
            prove = partial(searches.certified, from_rest=False)
            note("certificate alone", repeats, prove, found.subpath, motion_m_s)
        note("whole answer", 1, plan, asked)
    yield "ms of the processor, which the bars are for, and by the wall"
    for name, some in times.items():
        (median, wall), (slowest, wall_most) = np.quantile(some, (0.5, 0.99), axis=0).tolist()
        yield {
            "time of a plan": name,
            "median|.2f": median,
            "99 %|.2f": slowest,
            "wall, median|.2f": wall,
            "wall, 99 %|.2f": wall_most,
            "runs": len(some),
        }
    yield f"first search proven in {proven} of {scenes} scenes"
    search_ms = np.quantile(times["plan"], (0.5, 0.99), axis=0)[:, 0].tolist()
    yield most("plan, median and 99 %, ms", search_ms, (10.0, 20.0))
    yield most("from the start of a process to its first plan, s", _first_plan_s(), 1.0)
    first_s = min(_first_heartbeat_s() for _ in range(3))
    yield most("companion fly to first heartbeat, s", first_s, 1.5)


def _one(searches: Searches) -> Planned | None:
    searches.tries = 0
    return searches.found(searches.scene)


def _first_plan_s() -> float:
    """A process of its own: from nothing to the end of the first plan, with a warm cache."""
    result = subprocess.run(
        [sys.executable, "-c", _FIRST_PLAN], capture_output=True, text=True, check=True
    )
    return float(result.stdout)


def _first_heartbeat_s() -> float:
    """`companion fly`, from the start of its process to the first datagram that it sends."""
    with udp_socket() as link, tempfile.TemporaryDirectory() as folder:
        link.settimeout(60.0)
        where = f"udpout:127.0.0.1:{link.getsockname()[1]}"
        command = [BIN / "companion", "fly", "sitl-arducopter", "--connect", where]
        began_s = time.perf_counter()
        with subprocess.Popen(
            [*command, "--out", Path(folder) / "run"], stdout=subprocess.DEVNULL
        ) as companion:
            try:
                link.recv(2048)
                return time.perf_counter() - began_s
            finally:
                companion.kill()


if __name__ == "__main__":
    main(speed)
