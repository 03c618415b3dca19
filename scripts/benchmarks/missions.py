"""Whole missions in random dense worlds and in the bundled ones, against the best that there is.

    python scripts/benchmarks/missions.py [--worlds 100] [--seeds 20] [--jobs 2] [--json FILE]
                                          [--only dense|bundled|sparse] [--profile paper]
    python scripts/benchmarks/missions.py --family gathered [--seed 7] [--worlds 20] [--each]

Every mission is flown without a vehicle (simulated scans, perfect tracking); its cost is compared
with the full-knowledge optimum of `optimum`, and every metre of every subpath, its tail included,
is measured against the true world by `truth`: the planner's own figures are not asked.  With
--family they are those of `families`, beside a rival that knows as little (`family_missions`).
"""

import argparse
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, final

import numpy as np
import optimum
import running
import truth
import worlds
from families import FAMILIES, SEED, best_of, unseen
from lattice import curve_cost
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from worlds import BenchmarkWorld

from companion.objective.scene import PROFILES
from companion.planner.offline import OfflineFlight, fly_offline
from companion.planner.plan import plan
from companion.planner.request import PlanOutcome, PlanRequest
from companion.runtime.compiler import load_kernel
from companion.world.known_map import KnownMap
from companion.world.simulated_scan import true_map

FloatArray = NDArray[np.float64]

_SPACING_M = 1.0
_ARRIVED_M = 1.0
_BARS = {"median": 1.01, "mean": 1.05, "90 %": 1.10}
_JOIN = 1e-6


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Join:
    """What jumps between two subpaths, relative to R, to 1 and to 1 / turn radius."""

    position: float
    tangent: float
    curvature: float

    @property
    def worst(self) -> float:
        """The largest of the three."""
        return max(self.position, self.tangent, self.curvature)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class MissionResult:
    """One mission, measured."""

    world: str
    seed: int
    arrived: bool
    failure: str
    subpaths: int
    stops: int
    """Legs flown to their end, for want of a successor, although the target was not there."""
    cost: float
    best_cost: float
    """J*; NaN where no optimum is known (or applies)."""
    length_m: float
    best_length_m: float
    shortest_m: float
    clearance_m: float
    keep_out_m: float
    turn_radius_m: float
    climb_deg: float
    dive_deg: float
    lowest_amsl_m: float
    highest_amsl_m: float
    radar_m: float
    """Flown inside radar ranges."""
    violations: tuple[str, ...]
    """`leg 3: terrain clearance`, over whole subpaths."""
    flown_violations: int
    """Subpaths with a violation on the part that was flown."""
    joins: tuple[Join, ...]
    plan_s: tuple[float, ...]

    @property
    def ratio(self) -> float:
        """J / J*."""
        return self.cost / self.best_cost


# --- flying


def fly(world: BenchmarkWorld, seed: int, blank: KnownMap) -> tuple[OfflineFlight, list[float]]:
    """The mission without a vehicle -> flight, seconds of processor time per plan.

    blank: what is known of the world before the first scan.
    """
    plan_s: list[float] = []
    kernel = load_kernel()

    def timed(request: PlanRequest) -> PlanOutcome:
        began_s = time.process_time()
        outcome = plan(request, kernel=kernel)
        plan_s.append(time.process_time() - began_s)
        return outcome

    flight = fly_offline(
        world.task,
        blank=blank,
        truth=true_map(world.terrain, blank),
        start_nea_m=world.start_nea_m,
        targets_ne_m=world.targets_ne_m,
        seed=seed,
        planner=timed,
    )
    return flight, plan_s


# --- measuring


def measured(
    world: BenchmarkWorld,
    seed: int,
    best: optimum.Optimum | None,
    blank: KnownMap | None = None,
) -> MissionResult:
    """Fly one mission and measure it.  blank: what is known before it; None: nothing."""
    flight, plan_s = fly(world, seed, blank or unseen(world))
    task = world.task
    curves = [truth.sampled(leg.subpath.control_nea_m, _SPACING_M) for leg in flight.legs]
    flown = [
        min(far, float(curve.length_m[-1]))
        for far, curve in zip(flight.flown_m, curves, strict=True)
    ]
    whole = [_measures(curve, world) for curve in curves]
    parts = [_until(curve, far) for curve, far in zip(curves, flown, strict=True)]
    over = [_measures(part, world) for part in parts]
    bounds = (task.limits, task.required_clearance_m, task.error_m)
    broken = [m.violations(*bounds) for m in whole]
    broken_flown = [m.violations(*bounds) for m in over]
    ended = [curve.length_m[-1] - far < 1.0 for curve, far in zip(curves, flown, strict=True)]
    onward = [not e for e in ended[:-1]]
    return MissionResult(
        world=world.name,
        seed=seed,
        arrived=_arrived(flight, world, curves),
        failure=_words(flight.failure),
        subpaths=len(curves),
        stops=flight.holds,
        cost=sum(
            curve_cost(c, world, far) for c, far in zip(curves, flown, strict=True)
        ),
        best_cost=best.cost if best else math.nan,
        length_m=sum(flown),
        best_length_m=best.length_m if best else math.nan,
        shortest_m=best.shortest_m if best else math.nan,
        clearance_m=min((m.clearance_m for m in whole), default=math.nan),
        keep_out_m=min((m.keep_out_m for m in whole), default=math.nan),
        turn_radius_m=min((m.turn_radius_m for m in whole), default=math.nan),
        climb_deg=math.degrees(max((m.climb_rad for m in whole), default=math.nan)),
        dive_deg=math.degrees(max((m.dive_rad for m in whole), default=math.nan)),
        lowest_amsl_m=min((m.lowest_amsl_m for m in whole), default=math.nan),
        highest_amsl_m=max((m.highest_amsl_m for m in whole), default=math.nan),
        radar_m=sum(m.radar_m for m in over),
        violations=tuple(
            f"leg {number}: {name}" for number, names in enumerate(broken, 1) for name in names
        ),
        flown_violations=sum(len(names) > 0 for names in broken_flown),
        joins=tuple(
            join(before.subpath.control_nea_m, after.subpath.control_nea_m, world)
            for before, after, goes_on in zip(flight.legs, flight.legs[1:], onward, strict=False)
            if goes_on
        ),
        plan_s=tuple(plan_s),
    )  # fmt: skip


def _arrived(flight: OfflineFlight, world: BenchmarkWorld, curves: list[truth.Curve]) -> bool:
    """Whether it came to the last target, by where the last curve ends."""
    if flight.failure is not None or not curves:
        return False
    return math.dist(curves[-1].points_nea_m[-1, :2], world.targets_ne_m[-1]) < _ARRIVED_M


def _words(failure: Any) -> str:
    if failure is None:
        return ""
    return f"{failure.refusal.name}: {', '.join(getattr(failure, 'broken', ()))}"


def _until(curve: truth.Curve, far_m: float) -> truth.Curve:
    count = max(int(np.searchsorted(curve.length_m, far_m, side="right")), 2)
    return truth.Curve(
        u=curve.u[:count],
        length_m=curve.length_m[:count],
        points_nea_m=curve.points_nea_m[:count],
        first=curve.first[:count],
        second=curve.second[:count],
    )


def _measures(curve: truth.Curve, world: BenchmarkWorld) -> truth.Measures:
    return truth.measure(
        curve,
        terrain=world.terrain,
        limits=world.task.limits,
        radars=world.task.radars,
        zones=world.task.zones,
        required_clearance_m=world.task.required_clearance_m,
    )


def join(before_nea_m: FloatArray, after_nea_m: FloatArray, world: BenchmarkWorld) -> Join:
    """What jumps where one curve goes over to the next, from the control points alone.

    The next curve's start is projected onto the curve before (Newton from the nearest of 2,000
    points), and tangent and curvature vector of both are compared there.
    """
    before, after = truth.spline(before_nea_m), truth.spline(after_nea_m)
    there = after(0.0)
    table = np.linspace(0.0, 1.0, 2001)
    u = float(table[np.argmin(np.linalg.norm(before(table) - there, axis=-1))])
    for _ in range(20):
        gap, v, a = before(u) - there, before(u, 1), before(u, 2)
        slope = float(v @ v + gap @ a)
        u = min(max(u - float(gap @ v) / max(slope, 1e-12), 0.0), 1.0)
    (t0, k0), (t1, k1) = _tangent_curvature(before, u), _tangent_curvature(after, 0.0)
    task = world.task
    return Join(
        position=float(np.linalg.norm(before(u) - there)) / task.settings.scan_range_m,
        tangent=float(np.linalg.norm(t1 - t0)),
        curvature=float(np.linalg.norm(k1 - k0)) * task.limits.turn_radius_m,
    )


def _tangent_curvature(curve: Any, u: float) -> tuple[FloatArray, FloatArray]:
    """Unit tangent and curvature vector dt/ds; (3,) each."""
    v, a = curve(u, 1), curve(u, 2)
    speed2 = max(float(v @ v), 1e-18)
    tangent = v / math.sqrt(speed2)
    return tangent, (a - float(a @ tangent) * tangent) / speed2


# --- all of them


def _job(name: str, seed: int, profile: str) -> MissionResult:
    world = worlds.by_name(name)
    if profile != world.task.settings.profile.name:
        settings = replace(world.task.settings, profile=PROFILES[profile])
        world = replace(world, task=replace(world.task, settings=settings))
    return measured(world, seed, best_of(world))


def missions(only: str, count: int, seeds: int) -> list[tuple[str, int]]:
    """World and seed of every mission."""
    result: list[tuple[str, int]] = []
    if only in ("", "dense"):
        result += [(f"dense-{k}", 1) for k in range(count)]
    if only == "sparse":
        result += [(f"sparse-{k}", 1) for k in range(count)]
    if only in ("", "bundled"):
        names = ("environment-1", "environment-2")
        result += [(name, seed) for name in names for seed in range(1, seeds + 1)]
    return result


def run(
    todo: Sequence[tuple[str, int]], jobs: int, profile: str, console: Console
) -> list[MissionResult]:
    """Fly and measure missions, in their order."""
    todo = [(name, seed, profile) for name, seed in todo]
    done = running.in_processes(_job, todo, jobs, "missions", console)
    return [flown.result() for _, flown in done]


# --- what is said about them


def summary(results: Sequence[MissionResult]) -> dict[str, Any]:
    """The figures of a set of missions, for tables and --json."""
    arrived = [r for r in results if r.arrived]
    ratios = np.array([r.ratio for r in arrived if math.isfinite(r.ratio)])
    lengths = np.array([r.length_m / r.shortest_m for r in arrived if math.isfinite(r.shortest_m)])
    joins = [j for r in results for j in r.joins]
    plans = np.array([s for r in results for s in r.plan_s])
    subpaths = sum(r.subpaths for r in results)
    return {
        "missions": len(results),
        "arrived": len(arrived),
        "with_optimum": len(ratios),
        "ratio_median": _of(np.median, ratios),
        "ratio_mean": _of(np.mean, ratios),
        "ratio_90": _of(lambda a: np.quantile(a, 0.9), ratios),
        "ratio_worst": _of(np.max, ratios),
        "length_median": _of(np.median, lengths),
        "length_worst": _of(np.max, lengths),
        "share_longer_than_1.3": _of(lambda a: np.mean(a > 1.3), lengths),
        "subpaths": subpaths,
        "subpaths_violating": sum(len({v.split(":")[0] for v in r.violations}) for r in results),
        "missions_violating": sum(bool(r.violations) for r in results),
        "missions_violating_where_flown": sum(bool(r.flown_violations) for r in results),
        "violations": _counted([v.partition(": ")[2] for r in results for v in r.violations]),
        "clearance_least_m": min((r.clearance_m for r in results), default=math.nan),
        "radar_mean_m": _of(np.mean, np.array([r.radar_m for r in results])),
        "missions_in_radar": sum(r.radar_m > 0.0 for r in results),
        "stops": sum(r.stops for r in results),
        "joins": len(joins),
        "jump_position": max((j.position for j in joins), default=0.0),
        "jump_tangent": max((j.tangent for j in joins), default=0.0),
        "jump_curvature": max((j.curvature for j in joins), default=0.0),
        "plans": len(plans),
        "plan_median_s": _of(np.median, plans),
        "plan_p99_s": _of(lambda a: np.quantile(a, 0.99), plans),
    }


def _of(figure: Callable[[FloatArray], Any], values: FloatArray) -> float:
    return float(figure(values)) if len(values) else math.nan


def _counted(names: list[str]) -> dict[str, int]:
    return {name: names.count(name) for name in sorted(set(names))}


def summary_table(groups: dict[str, dict[str, Any]]) -> Table:
    """One column for each group of missions, bars beside."""
    table = Table("", *groups, "bar", title="Whole missions against the full-knowledge optimum")
    rows: list[tuple[str, Callable[[dict[str, Any]], str], str]] = [
        ("missions, arrived", lambda s: f"{s['missions']}, {s['arrived']}", "every one"),
        ("J / J*, median", lambda s: f"{s['ratio_median']:.4f}", "<= 1.01"),
        ("J / J*, mean", lambda s: f"{s['ratio_mean']:.4f}", "<= 1.05 (aim 1.02)"),
        ("J / J*, 90 %", lambda s: f"{s['ratio_90']:.4f}", "<= 1.10"),
        ("J / J*, worst", lambda s: f"{s['ratio_worst']:.3f}", ""),
        ("length / shortest, median, worst",
         lambda s: f"{s['length_median']:.3f}, {s['length_worst']:.3f}", ""),
        ("longer than 1.3 x the shortest",
         lambda s: f"{100 * s['share_longer_than_1.3']:.1f} %", "< 1 %"),
        ("subpaths, violating", lambda s: f"{s['subpaths']}, {s['subpaths_violating']}", "0"),
        ("missions violating, where flown",
         lambda s: f"{s['missions_violating']}, {s['missions_violating_where_flown']}", "0"),
        ("what is violated", lambda s: ", ".join(f"{k} {v}" for k, v in s["violations"].items())
         or "nothing", "nothing"),
        ("least clearance, m", lambda s: f"{s['clearance_least_m']:.1f}", ""),
        ("radar: missions, mean m",
         lambda s: f"{s['missions_in_radar']}, {s['radar_mean_m']:.0f}", ""),
        ("stops on the way", lambda s: f"{s['stops']}", ""),
        ("joins", lambda s: f"{s['joins']}", ""),
        ("largest jump: position / R", lambda s: f"{s['jump_position']:.1e}", "<= 1e-6"),
        ("largest jump: tangent", lambda s: f"{s['jump_tangent']:.1e}", "<= 1e-6"),
        ("largest jump: curvature x turn radius",
         lambda s: f"{s['jump_curvature']:.1e}", "<= 1e-6"),
        ("plan, median, 99 %, ms",
         lambda s: f"{1e3 * s['plan_median_s']:.1f}, {1e3 * s['plan_p99_s']:.1f}", ""),
    ]  # fmt: skip
    for name, words, bar in rows:
        table.add_row(name, *(words(s) for s in groups.values()), bar)
    return table


def worst_table(results: Sequence[MissionResult], count: int = 8) -> Table:
    """The missions to look at: those that failed or broke a bound, then the dearest."""
    order = sorted(
        results,
        key=lambda r: (r.arrived, not r.violations, -r.ratio if math.isfinite(r.ratio) else 0.0),
    )
    table = Table("world", "seed", "arrived", "J / J*", "length / best", "stops", "clearance, m",
                  "radar, m", "violations", title="The worst missions")  # fmt: skip
    for r in order[:count]:
        table.add_row(
            r.world, str(r.seed), "yes" if r.arrived else f"no ({r.failure or 'too many legs'})",
            f"{r.ratio:.3f}", f"{r.length_m / r.best_length_m:.3f}", str(r.stops),
            f"{r.clearance_m:.1f}", f"{r.radar_m:.0f}", "; ".join(r.violations) or "none",
        )  # fmt: skip
    return table


def _group(world: str) -> str:
    kind = world.rpartition("-")[0]
    return kind if kind in ("dense", "sparse") else world


def kept(figures: dict[str, Any]) -> bool:
    """Whether a group keeps every bar."""
    ratios = zip(("ratio_median", "ratio_mean", "ratio_90"), _BARS.values(), strict=True)
    return (
        figures["arrived"] == figures["missions"]
        and figures["subpaths_violating"] == 0
        and all(figures[name] <= bar for name, bar in ratios)
        and figures["share_longer_than_1.3"] < 0.01
        and max(figures[f"jump_{what}"] for what in ("position", "tangent", "curvature")) <= _JOIN
    )


def _options() -> tuple[argparse.Namespace, Console]:
    family = {"action": "append", "choices": ("all", *FAMILIES)}
    return running.begin(
        __doc__,
        worlds=(int, "how many; 100 dense ones, 20 of a family"),
        seeds=(20, "of the bundled environments"),
        jobs=1,
        only=["", "dense", "bundled", "sparse"],
        profile=[*PROFILES],
        family=(family, "worlds of this family, beside a rival; more than once: several"),
        seed=(SEED, "of a family: which worlds are drawn"),
        elevation=(
            False,
            "of a family: an elevation file for guidance, blurred, off by 100 m and noisy",
        ),
        each=(False, "a line for each world of a family"),
        ompl=(False, "beside RRT* with full knowledge, if the package ompl is there"),
    )


def _by_family(options: argparse.Namespace, console: Console) -> int:
    """Fly worlds of families; 1 if one does not arrive or breaks a bound."""
    import family_missions

    names = FAMILIES if "all" in options.family else tuple(dict.fromkeys(options.family))
    how = family_missions.Options(
        seed=options.seed,
        profile=options.profile,
        reference=options.ompl,
        elevation=options.elevation,
    )
    found, kept_all = family_missions.report(
        names, options.worlds or 20, options.jobs, how, console
    )
    if options.each:
        console.print("\n".join(found["lines"]), soft_wrap=True)
    console.print(family_missions.table(found["summary"], options.seed))
    running.store(options.json, found)
    return 0 if kept_all else 1


def main() -> int:
    """Run the missions, print the tables; 1 if a bar is missed."""
    options, console = _options()
    if options.family:
        return _by_family(options, console)
    todo = missions(options.only, options.worlds or 100, options.seeds)
    results = run(todo, options.jobs, options.profile, console)
    groups = {
        group: summary([r for r in results if _group(r.world) == group])
        for group in dict.fromkeys(_group(r.world) for r in results)
    }
    if len(groups) > 1:
        groups["all"] = summary(results)
    console.print(summary_table(groups))
    console.print(worst_table(results))
    rows = [asdict(r) | {"ratio": r.ratio} for r in results]
    running.store(options.json, {"summary": groups, "missions": rows})
    return running.ended(console, kept=all(kept(figures) for figures in groups.values()))


if __name__ == "__main__":
    sys.exit(main())
