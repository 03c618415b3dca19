"""The bars of design 10, measured anew, in one go: what holds, what does not.

scripts/bench bars [--seed 1] [--worlds 10] [--only speed woods ...] [--json FILE]

`killed`, `tracking` and `view` are not in it: they take a vehicle's time, no bar, or a browser.
"""

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import certificate
import kills
import latency
import numpy as np
import optimum
import simulator
import speed
import woods
from running import Found, main, most
from tapped import fly_campaign

from companion.campaign.report import read_campaign

FAMILIES = ("dense", "gathered", "walls", "copter", "plane")
OBSTACLES = (10, 100, 1_000, 10_000, 100_000)
_FLAT = 0.2
Part = Literal[
    "speed", "simulator", "latency", "certificate", "kills", "woods", "growth", "optimum"
]


def growth() -> Found:
    """Plans of missions among ever more obstacles."""
    text = f'over = "planner"\n[[places]]\nfamily = "spread"\nindices = {list(OBSTACLES)}'
    with TemporaryDirectory() as folder:
        rows = read_campaign(fly_campaign(Path(folder), text, "--keep", "none")).rows
    times = rows.sort("family_index")["plan_ms_median"].fill_null(np.nan).to_list()
    what = f"plan time, {OBSTACLES[0]:,} to {OBSTACLES[-1]:,} obstacles: most / least"
    yield most(what, max(times) / min(times), 1.0 + _FLAT)


def bars(
    seed: int = 1,
    worlds: int = 10,
    only: tuple[Part, ...] = (
        "speed", "simulator", "latency", "certificate", "kills", "woods", "growth", "optimum",
    ),
) -> Found:  # fmt: skip
    """seed: of worlds, trees and cases; worlds: so many of each family, and of each woods."""
    parts = {
        "speed": partial(speed.speed, first=seed),
        "simulator": simulator.simulator,
        "latency": partial(latency.latency, rates=(20.0,)),
        "certificate": partial(certificate.certificate, cases=1_000, seed=seed),
        "kills": partial(kills.killed, kills=10 * worlds, first=seed),
        "woods": partial(woods.woods, flights=worlds, first=seed),
        "growth": growth,
    }
    for name in only:
        if name == "optimum":
            for family in FAMILIES:
                yield from optimum.beside(family=family, seed=seed, worlds=worlds)
        else:
            yield from parts[name]()


if __name__ == "__main__":
    main(bars)
