"""Whole missions in random worlds and in the bundled ones, against the best that there is.

    scripts/bench missions [--worlds 100] [--seeds 20] [--jobs 2] [--json FILE]
                           [--only dense|bundled|sparse] [--profile paper]
    scripts/bench missions --family gathered [--seed 7] [--worlds 20] [--each]
                           [--elevation]

Every mission is flown without a vehicle (simulated scans, perfect tracking); its cost is compared
with the full-knowledge optimum of `optimum`, and every metre of every subpath, its tail included,
is measured against the true world by `truth`: the planner's own figures are not asked.  With
--family the worlds are those of `campaign.families`, and a rival that knows as little flies them
too (A* over what it has seen: `campaign.rivals`); all are costed by the same measure along what
they fly.
"""

import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, final

import numpy as np
import optimum
import running
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from companion.campaign import drawn_world, families, truth
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.rivals import a_star
from companion.campaign.rivals import flight as rival
from companion.campaign.rivals.measure import measured as route_measured
from companion.campaign.route_cost import curve_cost
from companion.objective.scene import PROFILES
from companion.planner.offline import OfflineFlight, fly_offline
from companion.planner.plan import plan
from companion.planner.request import PlanOutcome, PlanRequest
from companion.runtime.compiler import load_kernel
from companion.world.known_map import KnownMap
from companion.world.simulated_scan import true_map

FloatArray = NDArray[np.float64]

_BUNDLED = ("environment-1", "environment-2")
_SPACING_M = 1.0
_ARRIVED_M = 1.0
_BARS = {"median": 1.01, "mean": 1.05, "90": 1.10}
_JOIN = 1e-6
_WORST = {"clearance_m": min, "keep_out_m": min, "turn_radius_m": min, "climb_rad": max,
          "dive_rad": max, "lowest_amsl_m": min, "highest_amsl_m": max}  # fmt: skip
"""Which of the measures of several subpaths is the worst."""


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
    """Of the search."""
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
    worst: dict[str, float]
    """The worst measure of all whole subpaths, by the names of `truth.Measures`."""
    radar_m: float
    """Flown inside radar ranges."""
    violations: tuple[str, ...]
    """`leg 3: terrain clearance`, over whole subpaths."""
    flown_violations: int
    """Subpaths with a violation on the part that was flown."""
    joins: tuple[Join, ...]
    plan_s: tuple[float, ...]
    rival_plans: int = 0
    """0: no rival has flown."""
    rival_cost: float = math.nan
    """J; NaN where the rival did not arrive."""
    rival_clearance_m: float = math.nan

    @property
    def ratio(self) -> float:
        """J / J*."""
        return self.cost / self.best_cost

    @property
    def is_cheaper(self) -> bool:
        """Whether ours arrived, and no dearer than the rival, or alone."""
        return self.arrived and not self.cost > self.rival_cost

    @property
    def end(self) -> str:
        """In words."""
        return "arrived" if self.arrived else f"did not arrive ({self.failure or 'too many legs'})"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class How:
    """How the missions of a run are flown."""

    seed: int
    """Which worlds are drawn."""
    profile: str
    rival: bool
    elevation: bool = False
    """Whether ours is given an elevation file for guidance."""


# --- flying


def fly(world: DrawnWorld, seed: int, blank: KnownMap) -> tuple[OfflineFlight, list[float]]:
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
    world: DrawnWorld, seed: int, best: optimum.Optimum | None, blank: KnownMap
) -> MissionResult:
    """Fly one mission and measure it.  blank: what is known before it."""
    flight, plan_s = fly(world, seed, blank)
    task = world.task
    curves = [truth.sampled(leg.subpath.control_nea_m, _SPACING_M) for leg in flight.legs]
    flown = [
        min(far, float(curve.length_m[-1]))
        for far, curve in zip(flight.flown_m, curves, strict=True)
    ]
    whole = [_measures(curve, world) for curve in curves]
    over = [_measures(_until(c, far), world) for c, far in zip(curves, flown, strict=True)]
    bounds = (task.limits, task.required_clearance_m, task.error_m)
    goes_on = [c.length_m[-1] - far >= 1.0 for c, far in zip(curves, flown, strict=True)]
    return MissionResult(
        world=world.name,
        seed=seed,
        arrived=_arrived(flight, world, curves),
        failure=_words(flight.failure),
        subpaths=len(curves),
        stops=flight.holds,
        cost=sum(curve_cost(c, world, far) for c, far in zip(curves, flown, strict=True)),
        best_cost=best.cost if best else math.nan,
        length_m=sum(flown),
        best_length_m=best.length_m if best else math.nan,
        shortest_m=best.shortest_m if best else math.nan,
        worst={
            name: worst((getattr(m, name) for m in whole), default=math.nan)
            for name, worst in _WORST.items()
        },
        radar_m=sum(m.radar_m for m in over),
        violations=tuple(
            f"leg {n}: {name}" for n, m in enumerate(whole, 1) for name in m.violations(*bounds)
        ),
        flown_violations=sum(len(m.violations(*bounds)) > 0 for m in over),
        joins=tuple(
            join(before.subpath.control_nea_m, after.subpath.control_nea_m, world)
            for before, after, on in zip(flight.legs, flight.legs[1:], goes_on, strict=False)
            if on
        ),
        plan_s=tuple(plan_s),
    )


def _arrived(flight: OfflineFlight, world: DrawnWorld, curves: list[truth.Curve]) -> bool:
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


def _measures(curve: truth.Curve, world: DrawnWorld) -> truth.Measures:
    return truth.measure(
        curve,
        terrain=world.terrain,
        limits=world.task.limits,
        radars=world.task.radars,
        zones=world.task.zones,
        required_clearance_m=world.task.required_clearance_m,
    )


def join(before_nea_m: FloatArray, after_nea_m: FloatArray, world: DrawnWorld) -> Join:
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


def flown_mission(group: str, index: int, seed: int, how: How) -> MissionResult:
    """Fly one world's mission, and the rival's if there is one."""
    world = (
        drawn_world.bundled(group) if group in _BUNDLED else families.world(group, how.seed, index)
    )
    best = optimum.best_of(world)
    settings = replace(world.task.settings, profile=PROFILES[how.profile])
    ours = replace(world, task=replace(world.task, settings=settings))
    blank = families.unseen_with_elevation(ours, index) if how.elevation else families.unseen(ours)
    result = measured(ours, seed, best, blank)
    if not how.rival:
        return result
    flown = rival.fly(world, a_star.plan)
    of_rival = route_measured(world, flown.points_nea_m)
    return replace(
        result,
        rival_plans=len(flown.plan_s),
        rival_cost=of_rival.cost if flown.arrived else math.nan,
        rival_clearance_m=of_rival.clearance_m,
    )


def missions(only: str, count: int, seeds: int) -> list[tuple[str, int, int]]:
    """Group, number of the world and seed of the search of every mission without --family."""
    kinds = {"": ("dense",), "bundled": ()}.get(only, (only,))
    result = [(kind, k, 1) for kind in kinds for k in range(count)]
    if only in ("", "bundled"):
        result += [(name, 0, seed) for name in _BUNDLED for seed in range(1, seeds + 1)]
    return result


def run(
    todo: Sequence[tuple[str, int, int]], jobs: int, how: How, console: Console
) -> dict[str, list[MissionResult]]:
    """Fly and measure missions, in their order, by group; what raises is said and left out."""
    groups: dict[str, list[MissionResult]] = {}
    calls = [(*each, how) for each in todo]
    for call, flown in running.in_processes(flown_mission, calls, jobs, "missions", console):
        try:
            groups.setdefault(call[0], []).append(flown.result())
        except Exception as error:  # noqa: BLE001 - the others are still worth measuring
            console.print(f"{call[0]} seed {how.seed} world {call[1]}: {error!r}", style="red")
    return {name: results for name, results in groups.items() if results}


# --- what is said about them


def summary(results: Sequence[MissionResult]) -> dict[str, Any]:
    """The figures of a set of missions, for tables and --json."""
    arrived = [r for r in results if r.arrived]
    joins = [j for r in results for j in r.joins]
    plans = [s for r in results for s in r.plan_s]
    longer = [r.length_m / r.shortest_m for r in arrived if math.isfinite(r.shortest_m)]
    spreads = {
        "ratio": [r.ratio for r in arrived],
        "length": longer,
        "rival": [r.rival_cost / r.best_cost for r in results],
        "pair": [r.cost / r.rival_cost for r in arrived],
    }
    return {
        "missions": len(results),
        "arrived": len(arrived),
        "without_optimum": sum(not math.isfinite(r.best_cost) for r in results),
        "share_longer_than_1.3": float(np.mean(np.array(longer) > 1.3)) if longer else math.nan,
        "subpaths": sum(r.subpaths for r in results),
        "subpaths_violating": sum(len({v.split(":")[0] for v in r.violations}) for r in results),
        "missions_violating": sum(bool(r.violations) for r in results),
        "missions_violating_where_flown": sum(bool(r.flown_violations) for r in results),
        "violations": Counter(sorted(v.partition(": ")[2] for r in results for v in r.violations)),
        "clearance_least_m": min((r.worst["clearance_m"] for r in results), default=math.nan),
        "radar_mean_m": float(np.mean([r.radar_m for r in results])),
        "missions_in_radar": sum(r.radar_m > 0.0 for r in results),
        "stops": sum(r.stops for r in results),
        "joins": len(joins),
        "jump_position": max((j.position for j in joins), default=0.0),
        "jump_tangent": max((j.tangent for j in joins), default=0.0),
        "jump_curvature": max((j.curvature for j in joins), default=0.0),
        "plans": len(plans),
        "plan_median_s": float(np.median(plans)) if plans else math.nan,
        "plan_p99_s": float(np.quantile(plans, 0.99)) if plans else math.nan,
        "rival_flew": sum(r.rival_plans > 0 for r in results),
        "rival_arrived": sum(math.isfinite(r.rival_cost) for r in results),
        "rival_clearance_least_m": min((r.rival_clearance_m for r in results), default=math.nan),
        "cheaper_than_rival": sum(r.is_cheaper for r in results) / len(results),
        **{f"{name}_{k}": v for name, ratios in spreads.items() for k, v in spread(ratios).items()},
    }


def spread(ratios: Sequence[float]) -> dict[str, float]:
    """Median, mean, 90 % and worst of those that are finite; NaN if none is."""
    values = np.array([each for each in ratios if math.isfinite(each)])
    figures: dict[str, Callable[[FloatArray], Any]] = {
        "median": np.median,
        "mean": np.mean,
        "90": lambda v: np.quantile(v, 0.9),
        "worst": np.max,
    }
    return {k: float(figure(values)) if len(values) else math.nan for k, figure in figures.items()}


def _four(prefix: str) -> Callable[[dict[str, Any]], str]:
    names = [f"{prefix}_{name}" for name in ("median", "mean", "90", "worst")]
    return lambda s: ", ".join(f"{s[name]:.4f}" for name in names)


_ROWS: tuple[tuple[str, Callable[[dict[str, Any]], str], str], ...] = (
    ("missions, arrived", lambda s: f"{s['missions']}, {s['arrived']}", "every one"),
    ("J / J*: median, mean, 90 %, worst", _four("ratio"), "1.01, 1.05 (aim 1.02), 1.10"),
    ("length / shortest: median, worst",
     lambda s: f"{s['length_median']:.3f}, {s['length_worst']:.3f}", ""),
    ("longer than 1.3 x the shortest",
     lambda s: f"{100 * s['share_longer_than_1.3']:.1f} %", "< 1 %"),
    ("subpaths, violating", lambda s: f"{s['subpaths']}, {s['subpaths_violating']}", "0"),
    ("missions violating, where flown",
     lambda s: f"{s['missions_violating']}, {s['missions_violating_where_flown']}", "0"),
    ("what is violated",
     lambda s: ", ".join(f"{k} {v}" for k, v in s["violations"].items()) or "nothing", "nothing"),
    ("least clearance, m", lambda s: f"{s['clearance_least_m']:.1f}", ""),
    ("missions in radar, mean m", lambda s: f"{s['missions_in_radar']}, {s['radar_mean_m']:.0f}",
     ""),
    ("stops on the way", lambda s: f"{s['stops']}", ""),
    ("joins; jump in position / R, tangent, curvature x turn radius",
     lambda s: f"{s['joins']}; {s['jump_position']:.1e}, {s['jump_tangent']:.1e}, "
     f"{s['jump_curvature']:.1e}", "<= 1e-6"),
    ("plan: median, 99 %, ms",
     lambda s: f"{1e3 * s['plan_median_s']:.1f}, {1e3 * s['plan_p99_s']:.1f}", ""),
)  # fmt: skip
_IF_ANY: tuple[tuple[str, str, Callable[[dict[str, Any]], str]], ...] = (
    ("without_optimum", "worlds without J*", lambda s: str(s["without_optimum"])),
    ("rival_flew", "rival arrived", lambda s: f"{s['rival_arrived']} of {s['missions']}"),
    ("rival_flew", "rival's J / J*", _four("rival")),
    ("rival_flew", "J / the rival's J", _four("pair")),
    ("rival_flew", "ours no dearer than the rival",
     lambda s: f"{100 * s['cheaper_than_rival']:.0f} %"),
)  # fmt: skip
"""Rows that are there if this figure of some group is a number, and not 0."""


def summary_table(groups: dict[str, dict[str, Any]], title: str) -> Table:
    """One column for each group of missions, bars beside."""
    table = Table("", *groups, "bar", title=title)
    for name, words, bar in _ROWS:
        table.add_row(name, *(words(s) for s in groups.values()), bar)
    for figure, name, words in _IF_ANY:
        if any(s[figure] > 0 for s in groups.values()):
            table.add_row(name, *(words(s) for s in groups.values()))
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
            r.world, str(r.seed), r.end, f"{r.ratio:.3f}", f"{r.length_m / r.best_length_m:.3f}",
            str(r.stops), f"{r.worst['clearance_m']:.1f}", f"{r.radar_m:.0f}",
            "; ".join(r.violations) or "none",
        )  # fmt: skip
    return table


def line(r: MissionResult) -> str:
    """One world of --each."""
    return (
        f"{r.world}: J/J* {r.ratio:.4f}, rival {r.rival_cost / r.best_cost:.4f}, "
        f"J {r.cost:.3f}, rival {r.rival_cost:.3f}, legs {r.subpaths}, holds {r.stops}, "
        f"highest {r.worst['highest_amsl_m']:.0f} m, radar {r.radar_m:.0f} m, "
        + "; ".join([r.end, *r.violations])
    )


def kept(figures: dict[str, Any]) -> bool:
    """Whether a group keeps every bar."""
    return (
        figures["arrived"] == figures["missions"]
        and figures["subpaths_violating"] == 0
        and all(figures[f"ratio_{name}"] <= bar for name, bar in _BARS.items())
        and figures["share_longer_than_1.3"] < 0.01
        and max(figures[f"jump_{what}"] for what in ("position", "tangent", "curvature")) <= _JOIN
    )


def main() -> int:
    """Run the missions, print the tables; 1 if a bar is missed.

    The bar of families is that every mission arrives without a violation.
    """
    options, console = running.begin(
        __doc__,
        worlds=(int, "how many; 100 dense ones, 20 of a family"),
        seeds=(20, "of the bundled environments"),
        jobs=1,
        only=["", "dense", "bundled", "sparse"],
        profile=[*PROFILES],
        family=(
            {"action": "append", "choices": ("all", *families.FAMILIES)},
            "worlds of this family, beside a rival; more than once: several",
        ),
        seed=(families.SEED, "of a family: which worlds are drawn"),
        elevation=(
            False,
            "of a family: an elevation file for guidance, blurred, off by 100 m and noisy",
        ),
        each=(False, "a line for each world of a family"),
    )
    how = How(seed=families.SEED, profile=options.profile, rival=False)
    title = "Whole missions against the full-knowledge optimum"
    if options.family:
        names = families.FAMILIES if "all" in options.family else dict.fromkeys(options.family)
        todo = [(name, index, 1) for name in names for index in range(options.worlds or 20)]
        how = replace(how, seed=options.seed, rival=True, elevation=options.elevation)
        title = f"Missions by family, seed {how.seed}"
    else:
        todo = missions(options.only, options.worlds or 100, options.seeds)
    found = run(todo, options.jobs, how, console)
    results = [r for of_group in found.values() for r in of_group]
    groups = {name: summary(of_group) for name, of_group in found.items()}
    each = [line(r) for r in results]
    if options.each:
        console.print("\n".join(each), soft_wrap=True)
    if len(groups) > 1 and not options.family:
        groups["all"] = summary(results)
    console.print(summary_table(groups, title), worst_table(results))
    rows = [asdict(r) | {"ratio": r.ratio} for r in results]
    running.store(
        options.json, {"seed": how.seed, "summary": groups, "missions": rows, "lines": each}
    )
    safe = all(r.arrived and not r.violations for r in results) and len(results) == len(todo)
    bars = options.family or all(kept(figures) for figures in groups.values())
    return running.ended(console, kept=bool(safe and bars))


if __name__ == "__main__":
    sys.exit(main())
