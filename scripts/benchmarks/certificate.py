"""The certificate against brute force: never optimistic, and how tight.

scripts/bench certificate [--cases 10000] [--seed 1] [--json FILE]

What a proof takes: `scripts/bench speed`.
"""

import math
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from running import Found, main, most

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "path"))
import brute_force as brute
from brute_force import Case, FloatArray, Truth, broken_by, random_case, truth

from companion.path.certificate import Certificate


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


def judged(case: Case) -> dict[str, Any]:
    """What is told of a case, and what is so."""
    told, real = case.certificate(), truth(case, samples=120)
    return {
        "proven": told.proven,
        "broken": ", ".join(told.broken),
        "pieces": told.pieces,
        "optimistic": optimistic(case, told, real),
        "is safe": keeps(case, real, 0.0, 0.0, 0.0),  # by the columns, without any allowance
        "is safe by far": safe_by_far(case, told, real),
    }


def certificate(cases: int = 10_000, seed: int = 1) -> Found:
    """So many random cases."""
    found = [judged(random_case(np.random.default_rng([seed, k]))) for k in range(cases)]
    wrong = sum(len(each["optimistic"]) for each in found)
    by_far = [each for each in found if each["is safe by far"]]
    rejected = [each["broken"] for each in by_far if not each["proven"]]
    at_all = [not each["proven"] for each in found if each["is safe"]]
    share = 100.0 * len(rejected) / max(len(by_far), 1)
    pieces = np.percentile([each["pieces"] for each in found], (50, 95)).tolist()
    for what, value in {
        "cases": cases,
        "proven": sum(each["proven"] for each in found),
        "optimistic": wrong,
        "safe by more than the allowance": len(by_far),
        "of these rejected, %": share,
        "safe at all (columns)": len(at_all),
        "of those rejected, %": 100.0 * sum(at_all) / max(len(at_all), 1),
        "pieces, median": pieces[0],
        "pieces, 95 %": pieces[1],
    }.items():
        yield {"certificates": what, "|.6g": value}
    yield f"rejected for {dict(Counter(rejected))}"
    yield most("optimistic certificates", wrong, 0)
    yield most("safe curves that are rejected, %", share, 2.0)


if __name__ == "__main__":
    main(certificate)
