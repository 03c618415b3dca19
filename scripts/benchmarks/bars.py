"""Every bar of design 10, measured anew, in one go: what holds, what does not.

scripts/bench bars [--seed 1] [--worlds 10] [--seeds 3] [--only speed quality ...] [--json FILE]
"""

import json
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import optimum
import running
from running import Bar
from tapped import fly_campaign

from companion.campaign import alone, truth
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.report import read_campaign
from companion.campaign.run import drawn_of

FAMILIES = ("dense", "gathered", "walls", "relief", "copter", "plane")
OBSTACLES = (10, 100, 1_000, 10_000, 100_000)
RIVALS = ("L-SHADE", "L-SHADE-60", "jSO", "jSO-60", "CMA-ES", "scipy DE")
_FLAT = 0.2


class Bench:
    """Runs benchmarks, each with the options that it takes here."""

    def __init__(self, folder: Path, options: Namespace) -> None:
        self.folder, self.options = folder, options

    def of(self, name: str, *options: object) -> list[Bar]:
        """The bars of one benchmark; its tables go to the terminal."""
        path = self.folder / "found.json"
        program = Path(__file__).with_name(f"{name}.py")
        command = [sys.executable, program, "--json", path, *options]
        done = subprocess.run([str(part) for part in command], check=False)
        if not path.exists():
            raise SystemExit(f"{name} ended with {done.returncode} and no figures")
        bars = [Bar(*each) for each in json.loads(path.read_text(encoding="utf-8"))["bars"]]
        path.unlink()
        return bars

    def campaign(self, text: str) -> Path:
        """A campaign of the planner alone, flown.  -> its folder"""
        return fly_campaign(self.folder, f'over = "planner"\n{text}', "--keep", "none")


def quality(bench: Bench) -> Iterator[Bar]:
    """Of the flight objective beside rivals, of the paper's beside its bars alone."""
    for objective, rivals in (("flight", RIVALS), ("paper", ())):
        options = ("--objective", objective, "--seeds", bench.options.seeds, "--slow-seeds", 1)
        yield from bench.of("quality", *options, "--only", "refined-de", *rivals)


def routes(bench: Bench) -> Iterator[Bar]:
    """Of worlds drawn from the seed, some of each family."""
    drawn = f"seed = {bench.options.seed}\ncount = {bench.options.worlds}"
    places = "".join(f'[[places]]\nfamily = "{family}"\n{drawn}\n' for family in FAMILIES)
    folder = bench.campaign(f'{places}[factors]\nknowledge = ["scans", "elevation"]')
    yield from bench.of("optimum", "--campaign", folder)
    rows = read_campaign(folder).rows
    wrong, checked = (
        sum(getattr(row, name) or 0 for row in rows) for name in ("violations", "subpaths_checked")
    )
    yield running.most(f"violations in {checked:,} subpaths", wrong, 0)
    yield running.least("missions that arrive", sum(row.arrived for row in rows), len(rows))
    worlds = [drawn_of(optimum.place_of(row)) for row in rows if row.knowledge == "scans"]
    most = max(jump for world in worlds for jump in _jumps(world, bench.options.seed))
    yield running.most("joins: position, tangent, curvature", most, 1e-6)


def _jumps(world: DrawnWorld, seed: int) -> Iterator[float]:
    """Of a mission: where each leg goes over to the next (`truth.jumps`)."""
    for before, after in pairwise(alone.fly(world, seed=seed).subpaths_nea_m):
        yield from truth.jumps(before, after, world.task) or ()  # None: from rest


def growth(bench: Bench) -> Iterator[Bar]:
    """Of missions among ever more obstacles."""
    text = f'[[places]]\nfamily = "spread"\nindices = {list(OBSTACLES)}'
    rows = read_campaign(bench.campaign(text)).rows
    times = [
        row.plan_ms_median or np.nan for row in sorted(rows, key=lambda row: row.family_index or 0)
    ]
    for since in (0, 2):
        what = f"plan time, {OBSTACLES[since]:,} to {OBSTACLES[-1]:,} obstacles: most / least"
        yield running.most(what, max(times[since:]) / min(times[since:]), 1.0 + _FLAT)


_ALL: dict[str, Callable[[Bench], Iterable[Bar]]] = {
    "speed": lambda bench: bench.of("speed"),
    "lockstep": lambda bench: bench.of("lockstep"),
    "one_process": lambda bench: bench.of("one_process"),
    "latency": lambda bench: bench.of("latency", "--rates", 20.0),
    "growth": growth,
    "routes": routes,
    "quality": quality,
}


def main() -> int:
    options, console = running.begin(
        __doc__,
        seed=(1, "of the worlds"),
        worlds=(10, "of each family"),
        seeds=(3, "of each search"),
        only={"nargs": "*", "choices": list(_ALL), "default": list(_ALL)},
    )
    bars: list[Bar] = []
    for name in options.only:
        began_s = time.monotonic()
        with TemporaryDirectory() as folder:
            bars += _ALL[name](Bench(Path(folder), options))
        console.print(f"{name}: {time.monotonic() - began_s:.0f} s")
    return running.ended(console, options.json, None, bars)


if __name__ == "__main__":
    sys.exit(main())
