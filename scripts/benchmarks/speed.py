"""How long plans take, by processor time, in whole missions of each environment.

    scripts/bench speed [--environments gathered forest ...] [--missions 2] [--json FILE]

Missions are flown without a vehicle, with perfect tracking: bundled ones and worlds of families,
drawn; forest and street with a lidar, as seen from on board.  Timed is each whole answer, the first
of each mission by itself, and in it guidance: the cost-to-go of all that is known.  Then how long a
new process takes to its first plan, and `companion fly` to its first heartbeat.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal
from unittest.mock import patch

import numpy as np
from running import Found, main, most
from tapped import BIN, udp_socket
from woods import scene_of

from companion.campaign import families
from companion.campaign.run import fly_alone
from companion.library import fly
from companion.planner import plan as planning
from companion.planner.plan import plan
from companion.runtime.compiler import load_kernel

Environment = Literal[
    "environment-1", "environment-2", "valley", "gathered", "dense", "walls", "copter", "street",
    "forest",
]  # fmt: skip
_BARRED = {"environment-2", "street", "forest"}
_SHARES, _BARS_MS, _GUIDANCE_BAR_MS = (0.5, 0.99), (30.0, 100.0), 3.0
_FIRST_PLAN = """
import time
began = time.perf_counter()
from companion.runtime.compiler import load_kernel
load_kernel()  # plans once
print(time.perf_counter() - began)
"""


def timed(times_ms: list[float], function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, with milliseconds of the processor noted for each call."""

    def call(*arguments: Any, **keywords: Any) -> Any:
        began_s = time.thread_time()
        try:
            return function(*arguments, **keywords)
        finally:
            times_ms.append(1e3 * (time.thread_time() - began_s))

    return call


def flown(environment: str, seed: int) -> list[float]:
    """How long each plan of a mission took: bundled, among near things, or of a drawn world."""
    if environment in families.FAMILIES:
        return [1e3 * seconds for seconds in fly_alone(families.world(environment, seed, 0))[1]]
    times_ms = list[float]()
    scene = scene_of(environment, seed) if environment in ("street", "forest") else None
    fly(environment, environment, scene=scene, planner=timed(times_ms, plan), seed=seed)
    return times_ms


def speed(
    environments: tuple[Environment, ...] = (
        "environment-2",
        "gathered",
        "dense",
        "walls",
        "copter",
        "street",
        "forest",
    ),
    missions: int = 2,
    first: int = 1,
) -> Found:
    """So many missions of each environment, with seeds from the first on."""
    load_kernel()
    bars = []
    yield "ms of the processor"
    for name in environments:
        firsts_ms, times_ms, guidance_ms = list[float](), list[float](), list[float]()
        measured = timed(guidance_ms, planning.cost_to_go)
        for seed in range(first, first + missions):
            with patch.object(planning, "cost_to_go", measured):
                mine_ms = flown(name, seed)
            firsts_ms.append(mine_ms[0])
            times_ms += mine_ms
        median, slowest = np.quantile(times_ms, _SHARES).tolist()
        guided = float(np.median(guidance_ms))
        yield {
            "plans": name,
            "answers": len(times_ms),
            "first, most|.1f": max(firsts_ms),
            "median|.1f": median,
            "99 %|.1f": slowest,
            "most|.1f": max(times_ms),
            "guidance, median|.1f": guided,
        }
        if name in _BARRED:
            bars.append(most(f"{name}: a plan, median and 99 %, ms", (median, slowest), _BARS_MS))
        bars.append(most(f"{name}: guidance, median, ms", guided, _GUIDANCE_BAR_MS))
    yield from bars
    printed = subprocess.run([sys.executable, "-c", _FIRST_PLAN], capture_output=True, check=True)
    yield most("from the start of a process to its first plan, s", float(printed.stdout), 1.0)
    first_s = min(_first_heartbeat_s() for _ in range(3))
    yield most("companion fly to first heartbeat, s", first_s, 1.5)


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
