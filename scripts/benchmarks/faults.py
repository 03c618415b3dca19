"""Fly the mission again and again, and each time something goes wrong: the table of faults.

    scripts/bench faults [--flights 500] [--seed 1] [--jobs 2] [--only PATTERN] [--json FILE]
                         [--vehicle ardupilot-copter ...] [--show INDEX]

Every fault of the simulator's catalogue, and the rows of design 7 that are none of the vehicle's,
with each autopilot and kind of vehicle, at random moments of the mission, in random strength and
length.  Companion and vehicle meet in one process (`pair`); the same seed flies the same flights.
The bar: no distance below d_s that the companion could know of, and no ending without a reason.
What it could know stands in `faults_judge`.  1 if the bar is broken.
"""

import math
import re
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import final

import faults_judge
import numpy as np
import running
from faults_judge import Verdict
from faults_trials import trials
from pair import Flown, Pair
from pair_worlds import VEHICLES, scene_of
from rich.console import Console
from rich.table import Table

from companion.runtime.compiler import load_kernel

WORLDS = 9


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """One flight of the table, before it is flown."""

    index: int
    trial: str
    vehicle: str
    world: int
    seed: int


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """And after."""

    flight: Flight
    verdict: Verdict
    done: tuple[tuple[float, str], ...]
    """What was made to happen, seconds after the companion began to fly."""
    vehicle_s: float
    wall_s: float


def table_of(count: int, seed: int, vehicles: Sequence[str], only: str = "") -> list[Flight]:
    """So many flights: every row with every vehicle, again and again, in other worlds."""
    rows = [
        (trial.name, vehicle)
        for trial in trials()
        for vehicle in vehicles
        if re.search(only, trial.name) and trial.applies(scene_of(vehicle, 0))
    ]
    return [
        Flight(
            index=k,
            trial=name,
            vehicle=vehicle,
            world=int(np.random.default_rng([seed, k]).integers(WORLDS)),
            seed=seed,
        )
        for k in range(count)
        for name, vehicle in (rows[k % len(rows)],)
    ]


def fly(flight: Flight) -> tuple[Flown, Result]:
    """One flight, from the boot to what is left of it."""
    began_s = time.perf_counter()
    scene = scene_of(flight.vehicle, flight.world)
    trial = next(each for each in trials() if each.name == flight.trial)
    rng = np.random.default_rng([flight.seed, flight.index, 1])
    pair = Pair(scene, seed=1000 * flight.seed + flight.index, kernel=load_kernel())
    for at_s, happening in trial.draw(rng, scene):
        pair.at(at_s, happening)
    slower = 1.5 if scene.kind == "plane" else 1.0
    flown = pair.fly(limit_s=slower * trial.limit_s, patient=True)
    result = Result(
        flight=flight,
        verdict=faults_judge.judge(flown),
        done=tuple((at - flown.airborne_s, what) for at, what in flown.done),
        vehicle_s=pair.now_s,
        wall_s=time.perf_counter() - began_s,
    )
    return flown, result


def _job(flight: Flight) -> Result:
    return fly(flight)[1]


def run(flights: Sequence[Flight], jobs: int, console: Console) -> list[Result]:
    """Fly them all, in their order; what breaks the bar is said at once."""
    load_kernel()  # fills the cache on disk once, before all jobs look into it
    collected = []
    todo = [(flight,) for flight in flights]
    for _, flown in running.in_processes(_job, todo, jobs, "flights", console):
        collected.append(flown.result())
        for line in broken(collected[-1:]):
            console.print(line, markup=False, soft_wrap=True)
    return collected


# --- what is said about them


def _short(value: float) -> str:
    return f"{value:.1f}" if math.isfinite(value) else ""


def by_fault(results: Sequence[Result]) -> Table:
    """One line for each row of the trials."""
    table = running.figures(
        "What went wrong, and what came of it", "fault", "flights", "arrived", "resumed", "held",
        "landed", "returned", "let go", "refused", "fell", "other", "terrain m", "known", "zone m",
        "known", "inside s", "silent s", "own", "violations",
    )  # fmt: skip
    names = dict.fromkeys(result.flight.trial for result in results)
    for name in [*names, "all"]:
        rows = [r for r in results if name in ("all", r.flight.trial)]
        table.add_row(name, *_row(rows), style="bold" if name == "all" else None)
    return table


_CLASSES = ("arrived", "held and resumed", "held for good", "landed", "returned", "let go",
            "refused", "fell")  # fmt: skip


_LEAST = ("terrain_m", "terrain_known_m", "zone_m", "zone_known_m")
_MOST = ("inside_s", "silent_s", "own_silent_s")


def _row(rows: Sequence[Result]) -> list[str]:
    verdicts = [r.verdict for r in rows]
    counts = Counter(v.outcome for v in verdicts)
    other = sum(n for name, n in counts.items() if name not in _CLASSES)
    return [
        str(len(rows)),
        *(str(counts[name] or "") for name in _CLASSES),
        str(other or ""),
        *(_short(min(getattr(v, name) for v in verdicts)) for name in _LEAST),
        *(_short(max(getattr(v, name) for v in verdicts)) for name in _MOST),
        str(sum(v.violations for v in verdicts) or ""),
    ]


def broken(results: Sequence[Result]) -> list[str]:
    """What breaks the bar, a line each, with what flies it again."""
    lines = []
    for r in results:
        f, v = r.flight, r.verdict
        happened = "; ".join(f"{at:.1f} s {what}" for at, what in r.done)
        where = f"--show {f.index} ({f.trial}, {f.vehicle}, world {f.world}): {happened}"
        if f.trial == "nothing" and v.outcome != "arrived":
            lines.append(f"{v.outcome} with nothing wrong: {v.reason}  {where}")
        elif v.outcome == "refused" or not v.explained:
            lines.append(f"{v.outcome}: {v.reason}  {where}")
        for breach in v.breaches:
            if breach.could_know:
                near = f"{breach.what} {breach.worst_m:.1f} m from {breach.t_s:.1f} s"
                lines.append(f"{near}  {where}")
    return lines


def show(flight: Flight, console: Console) -> None:
    """One flight again, with its journal."""
    flown, result = fly(flight)
    for entry in flown.journal:
        if entry["kind"] not in ("plan asked", "plan", "scan", "acknowledged"):
            console.print(str({k: v for k, v in entry.items() if v is not None})[:300])
    console.print("done:", [(round(a + flown.airborne_s, 1), w) for a, w in result.done])
    console.print("station heard:", flown.texts[-5:])
    console.print(f"flew from {flown.airborne_s:.1f} s, ended {flown.ended_s:.1f} s")
    console.print(str(result.verdict))
    last = ""
    for row in flown.truth:
        now = f"{row['mode']} armed {row['armed']} landed {row['landed']}"
        if now != last:
            console.print(f"{row['t_s']:.1f} s truth: {now}")
            last = now


def main() -> int:
    """Fly them, print the table; 1 if the bar is broken."""
    options, console = running.begin(
        __doc__,
        width=200,
        flights=500,
        seed=1,
        jobs=2,
        only=("", "rows whose name this pattern matches"),
        vehicle={"nargs": "+", "choices": VEHICLES, "default": list(VEHICLES)},
        show=(int, "fly this one again, and print its journal"),
    )
    count = options.flights if options.show is None else options.show + 1
    flights = table_of(count, options.seed, options.vehicle, options.only)
    if options.show is not None:
        show(flights[-1], console)
        return 0
    began_s = time.perf_counter()
    results = run(flights, options.jobs, console)
    took_s = time.perf_counter() - began_s
    console.print(by_fault(results))
    lines = broken(results)
    times = [(r.vehicle_s, r.wall_s) for r in results]
    vehicle_s, wall_s = (sum(each) for each in zip(*times, strict=True))
    console.print(
        f"{len(results)} flights, {vehicle_s / 3600:.1f} h of vehicle time in "
        f"{took_s / 60:.1f} min; {vehicle_s / wall_s:.0f} x real time on each core"
    )
    running.store(options.json, [asdict(r) for r in results])
    return running.ended(console, kept=not lines)


if __name__ == "__main__":
    sys.exit(main())
