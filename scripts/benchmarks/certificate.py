"""The certificate against brute force: never optimistic, and how tight.

scripts/bench certificate [--cases 10000] [--seed 1] [--json FILE]

Safe by far: by more than 2 % of d_s beyond what it has to keep.
"""

import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from running import Found, main, most

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "path"))
from brute_force import Case, Truth, broken_by, random_case, truth

from companion.path.certificate import Certificate


def optimistic(case: Case, certificate: Certificate, real: Truth) -> list[str]:
    """The numbers of a certificate that the truth breaks."""
    wrong = broken_by(certificate, real)
    if certificate.proven and not keeps(case, real, 0.0, 0.0, -2e-6):
        wrong.append("proven")
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


def judged(case: Case) -> dict[str, Any]:
    """What is told of a case, and what is so."""
    certificate, real = case.certificate(), truth(case, samples=120)
    margin_m = 0.02 * (case.task.required_clearance_m - case.task.envelope.contact_m)
    return {
        "proven": certificate.proven,
        "broken": ", ".join(certificate.broken),
        "pieces": certificate.pieces,
        "optimistic": optimistic(case, certificate, real),
        "is safe": keeps(case, real, 0.0, 0.0, 0.0),  # by the columns, without any allowance
        "is safe by far": keeps(case, real, margin_m, margin_m, margin_m),
    }


def certificate(cases: int = 10_000, seed: int = 1) -> Found:
    """So many random cases."""
    cases_judged = [judged(random_case(np.random.default_rng([seed, k]))) for k in range(cases)]
    wrong = sum(len(case["optimistic"]) for case in cases_judged)
    by_far = [case for case in cases_judged if case["is safe by far"]]
    rejected = [case["broken"] for case in by_far if not case["proven"]]
    at_all = [not case["proven"] for case in cases_judged if case["is safe"]]
    share = 100.0 * len(rejected) / max(len(by_far), 1)
    pieces = np.percentile([case["pieces"] for case in cases_judged], (50, 95)).tolist()
    for what, value in {
        "cases": cases,
        "proven": sum(case["proven"] for case in cases_judged),
        "optimistic": wrong,
        "safe by far": len(by_far),
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
