"""Every bar of design 10, measured anew, in one go: what holds, what does not.

    scripts/bench bars [--seed 1] [--worlds 10] [--seeds 3] [--only speed quality ...] [--json FILE]

Each benchmark runs as a process of its own, one after the other; worlds are drawn from the seed.
Let nothing else run.  1 if a bar is missed.
"""

import json
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import optimum
import running
from tapped import BIN

from companion.campaign import truth
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.report import read_campaign
from companion.campaign.run import drawn_of
from companion.planner.offline import fly_offline
from companion.planner.plan import plan
from companion.runtime.compiler import load_kernel
from companion.world.known_map import empty_map
from companion.world.simulated_scan import true_map

FAMILIES = ("dense", "gathered", "walls", "relief", "copter", "plane")
OBSTACLES = (10, 100, 1_000, 10_000, 100_000)
RIVALS = ("L-SHADE", "L-SHADE-60", "jSO", "jSO-60", "CMA-ES", "scipy DE")
_SEARCH_BARS = {"flight": {3_000: 95.0, 6_000: 97.0}, "paper": {1_500: 95.0, 3_000: 97.0}}
_FLAT = 0.2


class Bar(NamedTuple):
    """A row of the table."""

    what: str
    bar: str
    measured: str
    kept: bool


class Bench:
    """Runs benchmarks, each with the options that it takes here."""

    def __init__(self, folder: Path, options: Namespace) -> None:
        self.folder, self.options = folder, options

    def of(self, name: str, *options: object) -> Any:
        """The numbers of one benchmark; its tables go to the terminal."""
        path = self.folder / "found.json"
        program = Path(__file__).with_name(f"{name}.py")
        command = [sys.executable, program, "--json", path, *options]
        done = subprocess.run([str(part) for part in command], check=False)
        if not path.exists():
            raise SystemExit(f"{name} ended with {done.returncode} and no figures")
        found = json.loads(path.read_text(encoding="utf-8"))
        path.unlink()
        return found

    def campaign(self, text: str) -> Path:
        """A campaign of the planner alone, flown.  -> its folder"""
        file, folder = self.folder / "campaign.toml", self.folder / "campaign"
        file.write_text(f'schema = 1\nname = "bars"\nover = "planner"\n{text}', encoding="utf-8")
        command = [BIN / "companion", "campaign", "run", file, "--out", folder, "--keep", "none"]
        subprocess.run([str(part) for part in command], check=True)
        return folder


def speed(bench: Bench) -> Iterator[Bar]:
    found = bench.of("speed")
    times = {name: np.array(each)[:, 0] for name, each in found["times_ms"].items()}
    ours, numpy = times[f"plan, {found['kernel']}"], times["plan, numpy"]
    median, slowest = float(np.median(ours)), float(np.quantile(ours, 0.99))
    yield _most("plan, median and 99 %, ms", (median, slowest), (10.0, 20.0))
    yield _least("plan: times as fast as numpy", float(np.median(numpy)) / median, 5.0)
    yield _most("companion fly to first heartbeat, s", (found["first_heartbeat_s"],), (1.5,))


def quality(bench: Bench) -> Iterator[Bar]:
    """Of the flight objective beside rivals, of the paper's beside its bars alone."""
    for objective, rivals in (("flight", RIVALS), ("paper", ())):
        options = ("--objective", objective, "--seeds", bench.options.seeds, "--slow-seeds", 1)
        found = bench.of("quality", *options, "--only", "refined-de", *rivals)["without_needles"]
        success = {(row["search"], row["evaluations"]): 100.0 * row["success"] for row in found}
        for budget, bar in _SEARCH_BARS[objective].items():
            what = f"search, {objective} objective, {budget:,}: within 1 %, %"
            yield _least(what, success["refined-de", budget], bar)
        for budget in sorted({budget for _, budget in success}) if rivals else ():
            best = max(rivals, key=lambda name, budget=budget: success[name, budget])
            behind = success[best, budget] - success["refined-de", budget]
            yield _most(f"search, {budget:,}: points behind {best}", (behind,), (0.0,))


def routes(bench: Bench) -> Iterator[Bar]:
    """Of worlds drawn from the seed, some of each family."""
    drawn = f"seed = {bench.options.seed}\ncount = {bench.options.worlds}"
    places = "".join(f'[[places]]\nfamily = "{family}"\n{drawn}\n' for family in FAMILIES)
    folder = bench.campaign(f'{places}[factors]\nknowledge = ["scans", "elevation"]')
    for name, found in bench.of("optimum", "--campaign", folder).items():
        family, _, knowledge, _ = name.split("/")
        spread = np.median, np.mean, partial(np.quantile, q=0.9)
        figures = tuple(float(of(found)) for of in spread) if found else ()
        yield _most(f"J / J*, {family}, {knowledge}", figures, optimum.BARS[knowledge])
    rows = read_campaign(folder).rows
    wrong, checked = (
        sum(getattr(row, name) or 0 for row in rows) for name in ("violations", "subpaths_checked")
    )
    yield _most(f"violations in {checked:,} subpaths", (wrong,), (0.0,))
    yield _least("missions that arrive", sum(row.arrived for row in rows), len(rows))
    worlds = [drawn_of(optimum.place_of(row)) for row in rows if row.knowledge == "scans"]
    most = max(jump for world in worlds for jump in _jumps(world, bench.options.seed))
    yield _most("joins: position, tangent, curvature", (most,), (1e-6,))


def _jumps(world: DrawnWorld, seed: int) -> Iterator[float]:
    """Of a mission: where each leg goes over to the next (`truth.jumps`)."""
    task, kernel = world.task, load_kernel()
    blank = empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)
    flight = fly_offline(
        task,
        blank=blank,
        truth=true_map(world.terrain, blank),
        start_nea_m=world.start_nea_m,
        targets_ne_m=world.targets_ne_m,
        seed=seed,
        planner=partial(plan, kernel=kernel),
    )
    for before, after in pairwise(leg.subpath.control_nea_m for leg in flight.legs):
        yield from truth.jumps(before, after, task) or ()  # None: from rest


def growth(bench: Bench) -> Iterator[Bar]:
    """Of missions among ever more obstacles."""
    text = f'[[places]]\nfamily = "spread"\nindices = {list(OBSTACLES)}'
    rows = read_campaign(bench.campaign(text)).rows
    times = [
        row.plan_ms_median or np.nan for row in sorted(rows, key=lambda row: row.family_index or 0)
    ]
    for since in (0, 2):
        what = f"plan time, {OBSTACLES[since]:,} to {OBSTACLES[-1]:,} obstacles: most / least"
        yield _most(what, (max(times[since:]) / min(times[since:]),), (1.0 + _FLAT,))


def latency(bench: Bench) -> Iterator[Bar]:
    for row in bench.of("latency", "--rates", 20.0):
        waits, gaps = (1e3 * np.array(row[key]) for key in ("waits_s", "gaps_s"))
        yield _most("gaps of the stream, 99.9 %, ms", (float(np.quantile(gaps, 0.999)),), (100.0,))
        yield _most("position to setpoint, 99 %, ms", (float(np.quantile(waits, 0.99)),), (5.0,))


def lockstep(bench: Bench) -> Iterator[Bar]:
    found = bench.of("lockstep")
    flights, replays = found["flight"], found["replay"]
    yield _least("over UDP in lockstep: times real time", flights["environment-1"], 150.0)
    yield _least("over UDP in lockstep: of bare frames", found["share"], 0.7)
    yield _least("replay without planning: times real time", replays["environment-1"], 600.0)
    yield _least("the same, PX4", replays["sitl-px4"], 300.0)


def one_process(bench: Bench) -> Iterator[Bar]:
    found = bench.of("one_process")
    times = found["flight_s"] / max(found["processor_s"].values())
    yield _least("in one process: times real time", times, 400.0)


_ALL: dict[str, Callable[[Bench], Iterable[Bar]]] = {
    each.__name__: each for each in (speed, lockstep, one_process, latency, growth, routes, quality)
}


def _most(what: str, values: tuple[float, ...], bars: tuple[float, ...]) -> Bar:
    kept = len(values) == len(bars) and all(v <= bar for v, bar in zip(values, bars, strict=True))
    return Bar(what, _listed(bars), _listed(values), kept)


def _least(what: str, value: float, bar: float) -> Bar:
    return Bar(what, f"{bar:g} or more", f"{value:.4g}", kept=value >= bar)


def _listed(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:.4g}" for value in values)


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
    table = running.figures("The bars of design 10", "", "bar", "measured", "")
    for bar in bars:
        table.add_row(bar.what, bar.bar, bar.measured, "met" if bar.kept else "missed")
    console.print(table)
    running.store(options.json, [bar._asdict() for bar in bars])
    return 0 if all(bar.kept for bar in bars) else 1


if __name__ == "__main__":
    sys.exit(main())
