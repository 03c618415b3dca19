"""The certificate against brute force: never optimistic, and how tight; what it costs.

python scripts/benchmarks/certificate.py [--cases 10000] [--seed 1] [--json FILE]
"""

import math
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import running
from speed import request, timed

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "path"))
import brute_force as brute
from brute_force import Case, FloatArray, Truth, broken_by, random_case, truth

from companion import jit
from companion.path.bspline import cubics_of
from companion.path.certificate import Certificate
from companion.path.proof import Bounds, prove
from companion.planner.searches import surroundings_of


@dataclass
class Tally:
    cases: int = 0
    proven: int = 0
    optimistic: list[str] = field(default_factory=list)
    safe: int = 0
    safe_rejected: list[str] = field(default_factory=list)
    safe_at_all: int = 0
    """By the same truth that the proof is about (columns), without any allowance."""
    safe_at_all_rejected: int = 0
    pieces: list[int] = field(default_factory=list)


def optimistic(case: Case, told: Certificate, real: Truth) -> list[str]:
    """The numbers of a certificate that the truth breaks."""
    wrong = broken_by(told, real)
    if told.proven and not keeps(case, real, 0.0, 0.0, -2e-6):
        wrong.append("proven")
    if case.peaks is not None and told.proven:
        near = 1.5 * case.task.required_clearance_m
        around_m = case.task.limits.loiter_radius_m
        far_m = brute.surface_distance_m(case.peaks, real.nearest_nea_m, near, around_m)
        if far_m < told.clearance_m - 1e-3:
            wrong.append("true surface")
    return wrong


def keeps(case: Case, real: Truth, terrain_m: float, dead_man_m: float, zone_m: float) -> bool:
    """Whether the truth keeps all bounds, by the margins given (and 1 % of turn and angles)."""
    limits, inset_m = case.task.limits, case.task.envelope.error_m
    part = 0.0 if zone_m < 0.0 else 0.01
    return (
        real.clearance_m >= case.task.required_clearance_m + terrain_m - 2e-6
        and real.keep_out_m >= case.task.required_clearance_m + zone_m
        and real.dead_man_m >= case.task.envelope.contact_m + dead_man_m - 2e-6
        and real.turn_radius_m >= limits.turn_radius_m * (1.0 + part - 1e-6)
        and real.climb_angle_rad <= limits.climb_angle_rad * (1.0 - part + 1e-6)
        and real.dive_angle_rad <= limits.dive_angle_rad * (1.0 - part + 1e-6)
        and real.lowest_amsl_m >= limits.floor_amsl_m + inset_m - 2e-6
        and real.highest_amsl_m <= limits.ceiling_amsl_m - inset_m + 2e-6
        and real.off_map_m <= 2e-6
    )


def local_slope(case: Case, at_nea_m: FloatArray) -> float:
    """Steepest slope of the true surface within the clearance of a point, horizontally."""
    assert case.peaks is not None
    reach = case.task.required_clearance_m
    steps = np.linspace(-reach, reach, 25)
    heights = case.peaks.height_m(at_nea_m[0] + steps[:, None], at_nea_m[1] + steps[None, :])
    slope_n, slope_e = np.gradient(heights, steps[1] - steps[0])
    return float(np.hypot(slope_n, slope_e).max())


def safe_by_far(case: Case, told: Certificate, real: Truth) -> bool:
    """Whether a curve is safe by more than 2 % of d_s, or a cell times the local slope of peaks.

    Against the surface of the peaks where that may make a difference, else against the columns.
    """
    margin = 0.02 * (case.task.required_clearance_m - case.task.envelope.contact_m)
    if case.peaks is None or told.proven:
        return keeps(case, real, margin, margin, margin)
    if not set(told.broken) <= {"terrain clearance", "dead-man reach"}:
        return keeps(case, real, -1e9, -1e9, margin)
    curve_m = max(margin, case.known.cell_m * local_slope(case, real.nearest_nea_m))
    ahead_m = max(margin, case.known.cell_m * local_slope(case, real.dead_man_nea_m))
    # Of two points a cell apart (diagonally) on the surface one may be nearer than its column.
    apart = 1.5 * math.hypot(case.known.cell_m, curve_m) + case.known.registration_m
    if real.clearance_m < case.task.required_clearance_m + curve_m - apart:
        return False
    points = brute.curve(case.control_nea_m)(np.linspace(0.0, 1.0, 200))
    clearance_m = min(brute.surface_truth_m(case, points), _unknown_m(case, points))
    if clearance_m < case.task.required_clearance_m + curve_m:
        return False
    if case.task.limits.loiter_radius_m:
        dead_man_m = min(clearance_m, real.keep_out_m)
    else:
        ahead = brute.stretches_nea_m(case)
        dead_man_m = min(
            brute.surface_truth_m(case, ahead), _unknown_m(case, ahead), _zones_m(case)
        )
    surface = replace(real, clearance_m=clearance_m, dead_man_m=dead_man_m)
    return keeps(case, surface, curve_m, ahead_m, margin)


def _unknown_m(case: Case, points: FloatArray) -> float:
    """Distance of points from what is not known, which has no surface."""
    if np.isfinite(case.known.upper_m).all():
        return np.inf
    heights = np.where(np.isinf(case.known.upper_m), np.inf, -1e9)
    unknown = replace(case, known=replace(case.known, upper_m=heights))
    return float(brute.terrain_m(unknown, points).min())


def _zones_m(case: Case) -> float:
    n, e, _ = brute.stretches_nea_m(case).T
    return min((float(zone.distance_m(n, e).min()) for zone in case.task.zones), default=np.inf)


def measure(case: Case, tally: Tally) -> None:
    """One more case."""
    told = case.certificate()
    real = truth(case, samples=120)
    tally.cases += 1
    tally.proven += told.proven
    tally.pieces.append(told.pieces)
    tally.optimistic += optimistic(case, told, real)
    if keeps(case, real, 0.0, 0.0, 0.0):
        tally.safe_at_all += 1
        tally.safe_at_all_rejected += not told.proven
    if safe_by_far(case, told, real):
        tally.safe += 1
        if not told.proven:
            tally.safe_rejected.append(", ".join(told.broken))


def ms_each(prover: Callable[..., Bounds], rounds: int) -> list[float]:
    """Time of proofs of subpaths of 20 km amid the 20 obstacles of `speed`."""
    rng, asked = np.random.default_rng(5), request(0)
    here, taken = surroundings_of(asked, asked.task.limits.speed_m_s), []
    for _ in range(50):
        cubics = cubics_of(gentle(rng, asked.scan_nea_m))
        times, _ = timed(lambda c=cubics: prover(c, here, False), rounds)
        taken.append(min(times)[0])
    return taken


def gentle(rng: np.random.Generator, start_nea_m: tuple[float, float, float]) -> FloatArray:
    """Five control points of a gently turning subpath of about 20 km."""
    heading = rng.uniform(-0.5, 0.5)
    control = [np.array(start_nea_m)]
    for _ in range(4):
        step = np.array([np.sin(heading), np.cos(heading), rng.uniform(-0.06, 0.06)])
        control.append(control[-1] + 5_000.0 * step)
        heading += rng.uniform(-0.5, 0.5)
    return np.array(control)


def rows(tally: Tally, times: dict[str, list[float]]) -> dict[str, Any]:
    """The record."""
    result: dict[str, Any] = {
        "cases": tally.cases,
        "proven": tally.proven,
        "optimistic": len(tally.optimistic),
        "safe by more than the allowance": tally.safe,
        "of these rejected, %": 100.0 * len(tally.safe_rejected) / max(tally.safe, 1),
        "rejected for": Counter(tally.safe_rejected),
        "safe at all (columns)": tally.safe_at_all,
        "of those rejected, %": 100.0 * tally.safe_at_all_rejected / max(tally.safe_at_all, 1),
        "pieces, median": float(np.median(tally.pieces)),
        "pieces, 95 %": float(np.percentile(tally.pieces, 95)),
    }
    for name, taken in times.items():
        result[f"{name}, ms, median"] = float(np.median(taken))
        result[f"{name}, ms, 95 %"] = float(np.percentile(taken, 95))
    return result


def main() -> int:
    asked, console = running.begin(__doc__, cases=10_000, seed=1)
    tally = Tally()
    for k in range(asked.cases):
        measure(random_case(np.random.default_rng([asked.seed, k])), tally)
    times = {"plain": ms_each(prove, 1), "compiled": ms_each(jit.compiled(prove), 20)}
    table = rows(tally, times)
    for name, value in table.items():
        print(f"{name:34} {value if not isinstance(value, float) else round(value, 3)}")
    rejected = 100.0 * len(tally.safe_rejected) / max(tally.safe, 1)
    bars = (
        running.most("optimistic certificates", len(tally.optimistic), 0),
        running.most("safe curves that are rejected, %", rejected, 2.0),
    )
    return running.ended(console, asked.json, table, bars)


if __name__ == "__main__":
    sys.exit(main())
