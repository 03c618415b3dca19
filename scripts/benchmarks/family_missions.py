"""Missions in families of random worlds, each beside a rival and the full-knowledge optimum.

    scripts/bench missions --family gathered [--seed 7] [--worlds 20] [--jobs 2] [--each] [--ompl]
                           [--elevation]

The planner flies what its scans show; so does the rival (`rival`); the optimum knows everything.
All three are costed by the same measure along what they fly, and every metre of every subpath is
checked against the true world.  Optima are kept in the user's cache by a hash of world and solver.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, final

import families
import missions
import numpy as np
import rival
import running
import truth
from missions import MissionResult
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from companion.objective.scene import PROFILES

FloatArray = NDArray[np.float64]

_PLAN_SEED = 1


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FamilyResult:
    """One world of a family: ours, the rival's, and the optimum's."""

    family: str
    index: int
    ours: MissionResult
    rival_cost: float
    """J; NaN where the rival did not arrive."""
    rival_clearance_m: float
    rival_plans: int
    reference_cost: float
    """J of the reference with full knowledge (--ompl); NaN where there is none."""

    @property
    def is_cheaper(self) -> bool:
        """Whether ours arrived, and no dearer than the rival, or alone."""
        return self.ours.arrived and not self.ours.cost > self.rival_cost

    @property
    def rival_ratio(self) -> float:
        """The rival's J / J*."""
        return self.rival_cost / self.ours.best_cost


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How the missions of one run are flown."""

    seed: int
    profile: str
    reference: bool
    elevation: bool
    """Whether ours is given an elevation file for guidance."""


def measured(family: str, index: int, options: Options) -> FamilyResult:
    """Fly one world's mission, and the rival's."""
    world = families.world(family, options.seed, index)
    best = families.best_of(world)
    flight = rival.fly(world)
    clearance = truth.terrain_distance_m(
        flight.points_nea_m, world.terrain, 2.0 * world.task.required_clearance_m
    )
    reference = math.nan
    if options.reference:
        import ompl_reference

        reference = ompl_reference.cost(world)
    settings = replace(world.task.settings, profile=PROFILES[options.profile])
    flown = replace(world, task=replace(world.task, settings=settings))
    blank = families.unseen_with_elevation(flown, index) if options.elevation else None
    return FamilyResult(
        family=family,
        index=index,
        ours=missions.measured(flown, _PLAN_SEED, best, blank),
        rival_cost=flight.cost(world) if flight.arrived else math.nan,
        rival_clearance_m=float(clearance.min()),
        rival_plans=flight.plans,
        reference_cost=reference,
    )


def run(
    names: Sequence[str], count: int, jobs: int, options: Options, console: Console
) -> list[FamilyResult]:
    """Fly and measure all worlds, in their order; what raises is said and left out."""
    results = []
    todo = [(name, index, options) for name in names for index in range(count)]
    for (name, index, _), flown in running.in_processes(measured, todo, jobs, "worlds", console):
        try:
            results.append(flown.result())
        except Exception as error:  # noqa: BLE001 - the other worlds are still worth measuring
            console.print(f"{name} seed {options.seed} world {index}: {error!r}", style="red")
    return results


# --- what is said about them


def summary(results: Sequence[FamilyResult]) -> dict[str, Any]:
    """The figures of one family."""
    figures = missions.summary([r.ours for r in results])
    ratios = np.array([r.rival_ratio for r in results if math.isfinite(r.rival_ratio)])
    pairs = [r.ours.cost / r.rival_cost for r in results if r.ours.arrived]
    references = np.array(
        [r.reference_cost / r.ours.best_cost for r in results if math.isfinite(r.reference_cost)]
    )
    return (
        figures
        | {
            "rival_arrived": sum(math.isfinite(r.rival_cost) for r in results),
            "rival_clearance_least_m": min(r.rival_clearance_m for r in results),
            "cheaper_than_rival": sum(r.is_cheaper for r in results) / len(results),
            "highest_amsl_m": max(r.ours.highest_amsl_m for r in results),
            "without_optimum": sum(not math.isfinite(r.ours.best_cost) for r in results),
        }
        | {
            f"{name}_{k}": v
            for name, values in (
                ("rival", ratios),
                ("pair", np.array([pair for pair in pairs if math.isfinite(pair)])),
                ("reference", references),
            )
            for k, v in _spread(values).items()
        }
    )


def _spread(ratios: FloatArray) -> dict[str, float]:
    if not len(ratios):
        return dict.fromkeys(("median", "mean", "90", "worst"), math.nan)
    return {
        "median": float(np.median(ratios)),
        "mean": float(ratios.mean()),
        "90": float(np.quantile(ratios, 0.9)),
        "worst": float(ratios.max()),
    }


def _four(prefix: str) -> Callable[[dict[str, Any]], str]:
    names = [f"{prefix}_{name}" for name in ("median", "mean", "90", "worst")]
    return lambda s: ", ".join(f"{s[name]:.4f}" for name in names)


def table(groups: dict[str, dict[str, Any]], seed: int) -> Table:
    """One column for each family."""
    rows: list[tuple[str, Callable[[dict[str, Any]], str]]] = [
        ("arrived", lambda s: f"{s['arrived']} of {s['missions']}"),
        ("missions violating, what", lambda s: ", ".join(
            [str(s["missions_violating"]), *(f"{k} {v}" for k, v in s["violations"].items())])),
        ("J / J*: median, mean, 90 %, worst", _four("ratio")),
        ("rival's J / J*", _four("rival")),
        ("J / the rival's J", _four("pair")),
        ("rival arrived", lambda s: f"{s['rival_arrived']} of {s['missions']}"),
        ("ours no dearer than the rival", lambda s: f"{100 * s['cheaper_than_rival']:.0f} %"),
        ("stops on the way", lambda s: str(s["stops"])),
        ("missions in radar, mean m",
         lambda s: f"{s['missions_in_radar']}, {s['radar_mean_m']:.0f}"),
        ("plan: median, 99 %, ms",
         lambda s: f"{1e3 * s['plan_median_s']:.0f}, {1e3 * s['plan_p99_s']:.0f}"),
    ]  # fmt: skip
    if any(math.isfinite(s["reference_median"]) for s in groups.values()):
        rows.insert(5, ("reference's J / J*", _four("reference")))
    if any(s["without_optimum"] for s in groups.values()):
        rows.insert(5, ("worlds without J*", lambda s: str(s["without_optimum"])))
    result = Table("", *groups, title=f"Missions by family, seed {seed}")
    for name, words in rows:
        result.add_row(name, *(words(figures) for figures in groups.values()))
    return result


def lines(results: Sequence[FamilyResult], seed: int) -> list[str]:
    """One line for each world: for --each."""
    said = []
    for r in results:
        o = r.ours
        end = "arrived" if o.arrived else f"did not arrive ({o.failure or 'no reason given'})"
        said.append(
            f"{r.family} seed {seed} world {r.index}: "
            f"J/J* {o.ratio:.4f}, rival {r.rival_ratio:.4f}, J {o.cost:.3f}, rival "
            f"{r.rival_cost:.3f}, legs {o.subpaths}, holds {o.stops}, "
            f"highest {o.highest_amsl_m:.0f} m, radar {o.radar_m:.0f} m, "
            + "; ".join([end, *o.violations])
        )
    return said


def report(
    names: Sequence[str], count: int, jobs: int, options: Options, console: Console
) -> tuple[dict[str, Any], bool]:
    """Fly all; the numbers, and whether every mission arrived without a violation."""
    results = run(names, count, jobs, options, console)
    of = {name: [r for r in results if r.family == name] for name in names}
    groups = {name: summary(found) for name, found in of.items() if found}
    kept = all(r.ours.arrived and not r.ours.violations for r in results)
    found = {
        "seed": options.seed,
        "summary": groups,
        "missions": [asdict(r) | {"ratio": r.ours.ratio} for r in results],
        "lines": lines(results, options.seed),
    }
    return found, kept and len(results) == len(names) * count
