"""A planner on trial: where to fly and what to prove are two things (FASTER, decision 0030).

Among near things sight ends at the next tree, and a subpath that must end in sight leads to where
one sees far, not to where the route goes.  So the subpath is searched as if what nobody has seen
were open ground, as guidance takes it to be, and of that as much is flown as is proven on the map
as it is: it is long enough to be left at full speed, and its tail is the way to stop.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from companion.path.bspline import basis
from companion.path.certificate import Certificate, certify
from companion.path.subpath import Subpath
from companion.planner import kernels
from companion.planner.plan import _surroundings, plan
from companion.planner.request import Planned, PlanOutcome, PlanRequest
from companion.world.known_map import KnownMap

_PARTS = 8
"""A span is cut at eighths: 0.7 m apart in the forest, where a subpath has two of 6 to 8 m."""

Prove = Callable[[Subpath], Certificate]


def plan_aimed(request: PlanRequest) -> PlanOutcome:
    """The answer of a search that aims beyond sight, as far as it is proven; else as without it.

    From a place where an attempt has failed nothing is aimed at: what is left to search there is in
    sight.
    """
    if request.attempt:
        return plan(request)
    around, prover = _surroundings(request), kernels.compiled().prove
    aim = plan(replace(request, known=_believed(request.known)))
    found = None
    if isinstance(aim, Planned):
        found = _proven_part(
            aim,
            request,
            lambda path: certify(path, around, from_rest=request.from_rest, prover=prover),
        )
    return found or plan(request)


def _believed(known: KnownMap) -> KnownMap:
    """The map on which what nobody has seen is as it is guessed to be."""
    assert known.guess_m is not None
    upper_m = np.where(np.isfinite(known.upper_m), known.upper_m, known.guess_m)
    return replace(known, upper_m=upper_m, seen=np.isfinite(upper_m))


def _proven_part(aim: Planned, request: PlanRequest, prove: Prove) -> Planned | None:
    """The longest proven part of a subpath that can be left at full speed; None: there is none."""
    certificate = prove(aim.subpath)
    if certificate.proven:
        return replace(aim, certificate=certificate)
    parts = _PARTS * (len(aim.subpath.control_nea_m) - 3)
    least_m = request.task.shortest_scan_distance_m
    first = math.ceil(parts * aim.subpath.parameter_at(least_m))
    for count in range(parts - 1, first - 1, -1):
        part = _first_part(aim.subpath, count)
        certificate = prove(part)
        if certificate.proven:
            return replace(aim, subpath=part, certificate=certificate, reaches_target=False)
    return None


def _first_part(subpath: Subpath, count: int) -> Subpath:
    """The same curve, as far as so many eighths of its spans by the parameter.

    It has the same polynomials between its knots, all knots of the whole in its reach among them,
    so through as many points as it has control points it is that one, to rounding.
    """
    points, spans = count + 3, len(subpath.control_nea_m) - 3
    knots = np.concatenate([np.zeros(2), np.linspace(0.0, 1.0, count + 1), np.ones(2)])
    means = (knots[:-2] + knots[1:-1] + knots[2:]) / 3.0  # Greville's: a point to each basis
    wanted = basis(means * count / (_PARTS * spans), spans + 3).value @ subpath.control_nea_m
    return Subpath(control_nea_m=np.linalg.solve(basis(means, points).value, wanted))
