"""What happened and what was decided, as journal entries: plain values, units in their names."""

from dataclasses import asdict
from typing import Any

from companion.mission.events import (
    Event,
    LinkLost,
    PlanLate,
    PlannerDied,
    PlanReady,
    ScanDone,
    StopAsked,
)
from companion.mission.state import State
from companion.planner.request import NotPlanned, Planned, PlanRequest

Entry = dict[str, Any]


def of_event(event: Event, state: State) -> Entry | None:
    """The entry of an event, None for those that the telemetry log holds; state: after it."""
    match event:
        case ScanDone():
            return {
                "kind": "scan done",
                "blocks_asked": event.asked,
                "blocks_answered": event.answered,
                "registration_m": event.scan.registration_m,
                "cells_seen": int(state.flight.known.seen.sum()),
            }
        case PlanReady(outcome=Planned() as planned):
            return _of_plan(planned)
        case PlanReady(outcome=NotPlanned() as refused):
            return {
                "kind": "plan refused",
                "plan_id": refused.plan_id,
                "reason": refused.refusal.name,
                "broken": list(refused.broken),
                "evaluations": refused.evaluations,
            }
        case PlanLate(plan_id=plan_id):
            return {"kind": "plan late", "plan_id": plan_id}
        case PlannerDied(error=error):
            return {"kind": "planner died", "error": error}
        case LinkLost(silent_s=silent_s):
            return {"kind": "link lost", "silent_s": silent_s}
        case StopAsked():
            return {"kind": "stop asked"}
        case _:
            return None


def of_request(request: PlanRequest, due_s: float) -> Entry:
    """The entry of a plan request."""
    return {
        "kind": "plan asked",
        "plan_id": request.plan_id,
        "due_s": due_s,
        "attempt": request.attempt,
        "stops": request.stops,
        "from_rest": request.from_rest,
        "scan_nea_m": list(request.scan_nea_m),
        "start_nea_m": request.start.position_nea_m.tolist(),
        "tangent_nea": request.start.tangent_nea.tolist(),
        "curvature_nea_1_m": request.start.curvature_nea_1_m.tolist(),
        "target_ne_m": list(request.target_ne_m),
        "route_ne_m": [list(place) for place in request.route_ne_m],
    }


def _of_plan(planned: Planned) -> Entry:
    return {
        "kind": "plan ready",
        "plan_id": planned.plan_id,
        "kernel": planned.kernel,
        "evaluations": planned.evaluations,
        "tries": planned.tries,
        "rank": planned.rank,
        "cost": planned.cost,
        "to_go": planned.to_go,
        "terms": planned.terms,
        "guide_rad": planned.guide_rad,
        "reaches_target": planned.reaches_target,
        "length_m": planned.subpath.length_m,
        "control_nea_m": planned.subpath.control_nea_m.tolist(),
        "certificate": asdict(planned.certificate),
    }
