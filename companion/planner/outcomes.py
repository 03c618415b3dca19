"""The answers to plan requests as plain values, for a file, and back, to the last bit.

A restored subpath is made of the same control points, so whatever follows from it is the same.
"""

from dataclasses import asdict
from typing import Any

import numpy as np

from companion.path.certificate import Certificate
from companion.path.subpath import Subpath
from companion.planner.request import NotPlanned, Planned, PlanOutcome, Refusal, WayBack

Values = dict[str, Any]


def values_of(outcome: PlanOutcome) -> Values:
    """An answer as numbers, texts, lists and dictionaries."""
    match outcome:
        case Planned():
            return {
                "kind": "planned",
                "plan_id": outcome.plan_id,
                "kernel": outcome.kernel,
                "control_nea_m": outcome.subpath.control_nea_m.tolist(),
                "reaches_target": outcome.reaches_target,
                "cost": float(outcome.cost),
                "to_go": float(outcome.to_go),
                "terms": {name: float(value) for name, value in outcome.terms.items()},
                "certificate": asdict(outcome.certificate),
                "guide_rad": float(outcome.guide_rad),
                "route_ne_m": [[float(n), float(e)] for n, e in outcome.route_ne_m],
                "evaluations": int(outcome.evaluations),
                "rank": int(outcome.rank),
                "tries": int(outcome.tries),
                "stopped_after": outcome.stopped_after,
            }
        case NotPlanned():
            return {
                "kind": "not planned",
                "plan_id": outcome.plan_id,
                "refusal": outcome.refusal.name,
                "broken": list(outcome.broken),
                "place_ne_m": None if outcome.place_ne_m is None else list(outcome.place_ne_m),
                "evaluations": int(outcome.evaluations),
                "stopped_after": outcome.stopped_after,
            }
        case WayBack():
            return {
                "kind": "way back",
                "plan_id": outcome.plan_id,
                "control_nea_m": [each.control_nea_m.tolist() for each in outcome.subpaths],
                "through": list(outcome.through),
                "reaches_start": outcome.reaches_start,
            }


def outcome_of(values: Values) -> PlanOutcome:
    """The answer that they were made of.  KeyError, TypeError, ValueError: they are not such."""
    plan_id, kind = int(values["plan_id"]), values["kind"]
    if kind == "planned":
        certificate = dict(values["certificate"])
        certificate["broken"] = tuple(certificate["broken"])
        return Planned(
            plan_id=plan_id,
            kernel=str(values["kernel"]),
            subpath=_subpath(values["control_nea_m"]),
            reaches_target=bool(values["reaches_target"]),
            cost=float(values["cost"]),
            to_go=float(values["to_go"]),
            terms={str(name): float(value) for name, value in values["terms"].items()},
            certificate=Certificate(**certificate),
            guide_rad=float(values["guide_rad"]),
            route_ne_m=tuple((float(n), float(e)) for n, e in values["route_ne_m"]),
            evaluations=int(values["evaluations"]),
            rank=int(values["rank"]),
            tries=int(values["tries"]),
            stopped_after=_count(values["stopped_after"]),
        )
    if kind == "not planned":
        return NotPlanned(
            plan_id=plan_id,
            refusal=Refusal[values["refusal"]],
            broken=tuple(values["broken"]),
            place_ne_m=_place(values.get("place_ne_m")),  # older ones have none
            evaluations=int(values["evaluations"]),
            stopped_after=_count(values["stopped_after"]),
        )
    if kind == "way back":
        return WayBack(
            plan_id=plan_id,
            subpaths=tuple(_subpath(each) for each in values["control_nea_m"]),
            through=tuple(bool(each) for each in values["through"]),
            reaches_start=bool(values["reaches_start"]),
        )
    raise ValueError(f"no kind of answer: {kind!r}")


def _place(value: Any) -> tuple[float, float] | None:
    return None if value is None else (float(value[0]), float(value[1]))


def _count(value: Any) -> int | None:
    return None if value is None else int(value)


def _subpath(rows: list[list[float]]) -> Subpath:
    control = np.array(rows, dtype=np.float64)
    if control.ndim != 2 or control.shape[1] != 3 or len(control) < 4:
        raise ValueError("control points are rows of north, east, altitude")
    if not np.isfinite(control).all():
        raise ValueError("control points are finite")
    return Subpath(control_nea_m=control)
