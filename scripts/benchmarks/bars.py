"""Every bar of design 10, measured anew, in one go: what holds, what does not.

scripts/bench bars [--seed 1] [--worlds 10] [--seeds 3] [--only speed quality ...] [--json FILE]
"""

from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import latency
import lockstep
import numpy as np
import one_process
import optimum
import quality
import speed
from running import Found, Some, least, main, most
from tapped import fly_campaign

from companion.campaign import alone, truth
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.report import read_campaign
from companion.campaign.run import drawn_of

FAMILIES = ("dense", "gathered", "walls", "copter", "plane")
OBSTACLES = (10, 100, 1_000, 10_000, 100_000)
RIVALS = ("L-SHADE", "L-SHADE-60", "jSO", "jSO-60", "CMA-ES", "scipy DE")
_FLAT = 0.2


def searches(seeds: int) -> Found:
    """Of the flight objective beside rivals, of the paper's beside its bars alone."""
    for objective, rivals in (("flight", RIVALS), ("paper", ())):
        yield from quality.quality(objective, seeds, 1, (quality.OURS, *rivals))


def routes(seed: int, worlds: int) -> Found:
    """Of worlds drawn from the seed, some of each family."""
    drawn = f"seed = {seed}\ncount = {worlds}"
    places = "".join(f'[[places]]\nfamily = "{family}"\n{drawn}\n' for family in FAMILIES)
    text = f'over = "planner"\n{places}'
    with TemporaryDirectory() as folder:
        flown = fly_campaign(Path(folder), text, "--keep", "none")
        rows = read_campaign(flown).rows
        yield from optimum.beside(flown)
    wrong, checked = (
        sum(getattr(row, name) or 0 for row in rows) for name in ("violations", "subpaths_checked")
    )
    yield most(f"violations in {checked:,} subpaths", wrong, 0)
    yield least("missions that arrive", sum(row.arrived for row in rows), len(rows))
    places_of = [drawn_of(optimum.place_of(row)) for row in rows]
    jump = max(jump for world in places_of for jump in _jumps(world, seed))
    yield most("joins: position, tangent, curvature", jump, 1e-6)


def _jumps(world: DrawnWorld, seed: int) -> Iterator[float]:
    """Of a mission: where each leg goes over to the next (`truth.jumps`)."""
    for before, after in pairwise(alone.fly(world, seed=seed).subpaths_nea_m):
        yield from truth.jumps(before, after, world.task) or ()  # None: from rest


def growth() -> Found:
    """Of missions among ever more obstacles."""
    text = f'over = "planner"\n[[places]]\nfamily = "spread"\nindices = {list(OBSTACLES)}'
    with TemporaryDirectory() as folder:
        rows = read_campaign(fly_campaign(Path(folder), text, "--keep", "none")).rows
    rows = sorted(rows, key=lambda row: row.family_index or 0)
    times = [row.plan_ms_median or np.nan for row in rows]
    for since in (0, 2):
        what = f"plan time, {OBSTACLES[since]:,} to {OBSTACLES[-1]:,} obstacles: most / least"
        yield most(what, max(times[since:]) / min(times[since:]), 1.0 + _FLAT)


def bars(
    seed: int = 1,
    worlds: int = 10,
    seeds: int = 3,
    only: tuple[str, ...] = Some(
        ("speed", "lockstep", "one_process", "latency", "growth", "routes", "quality")
    ),
) -> Found:
    """seed: of the worlds, so many of each family; seeds: of each search."""
    parts = {
        "speed": speed.speed,
        "lockstep": lockstep.lockstep,
        "one_process": one_process.one_process,
        "latency": partial(latency.latency, rates=(20.0,)),
        "growth": growth,
        "routes": partial(routes, seed, worlds),
        "quality": partial(searches, seeds),
    }
    for name in only:
        yield from parts[name]()


if __name__ == "__main__":
    main(bars)
