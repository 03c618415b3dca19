"""What happened and what was decided, as journal entries: plain values, units in their names."""

from collections.abc import Iterator
from dataclasses import asdict, fields
from typing import Any

from companion.mission.events import (
    Arm,
    Command,
    Event,
    FenceChanged,
    LinkDelay,
    LinkLost,
    Namesake,
    Order,
    PlanLate,
    PlannerDied,
    PlanReady,
    Position,
    Prepared,
    Rebooted,
    ScanDone,
    SetMode,
    SettingsChanged,
    StopAsked,
    TakeOff,
    TargetsChanged,
    Tick,
)
from companion.mission.state import State
from companion.planner.request import NotPlanned, Planned, PlanRequest
from companion.world.threats import Zone

Entry = dict[str, Any]


def of_event(event: Event, state: State) -> Entry | None:
    """The entry of an event, None for those that the telemetry log holds; state: after it."""
    if isinstance(event, Position | Tick):
        return None
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
                **({} if refused.place_ne_m is None else {"place_ne_m": refused.place_ne_m}),
            }
        case PlanLate(plan_id=plan_id):
            return {"kind": "plan late", "plan_id": plan_id}
        case PlannerDied(error=error):
            return {"kind": "part died", "error": error}
        case LinkLost(silent_s=silent_s):
            return {"kind": "link lost", "silent_s": silent_s}
        case Namesake(certain=True, news=True):
            return {"kind": "another companion"}
        case StopAsked():
            return {"kind": "stop asked"}
        case _:
            return _of_change(event)


def _of_change(event: Event) -> Entry | None:
    """What changed from outside."""
    match event:
        case FenceChanged():
            return {
                "kind": "fence",
                "zones": [_of_zone(zone) for zone in event.zones],
                "floor_amsl_m": event.floor_amsl_m,
                "ceiling_amsl_m": event.ceiling_amsl_m,
            }
        case TargetsChanged(targets_ne_m=targets):
            return {"kind": "targets", "targets_ne_m": [list(target) for target in targets]}
        case SettingsChanged(what=what):
            return {"kind": "setting", "what": what}
        case Order():
            return {
                "kind": "order",
                "order": event.kind.name,
                "sender": event.sender,
                "target_ne_m": None if event.target_ne_m is None else list(event.target_ne_m),
                "speed_m_s": event.speed_m_s,
            }
        case Prepared(item=item, refusal=refusal):
            return {"kind": "prepared", "item": item.value, "refusal": refusal}
        case LinkDelay(round_trip_s=round_trip_s):
            return {"kind": "link delay", "round_trip_s": round_trip_s}
        case Rebooted():
            return {"kind": "vehicle rebooted"}
        case _:
            return None


def _of_zone(zone: Zone) -> Entry:
    """As `asdict`, which copies each corner of its own: 25 ms for 5,000."""
    return {each.name: getattr(zone, each.name) for each in fields(zone)}


def of_change(before: State, after: State) -> Iterator[Entry]:
    """The entries of how far the mission has come."""
    if after.phase is not before.phase or after.reason is not before.reason:
        yield {
            "kind": "phase",
            "phase": after.phase.value,
            "was": before.phase.value,
            "reason": None if after.reason is None else after.reason.text,
            "code": None if after.reason is None else after.reason.name,
        }
    if after.flight.legs_flown != before.flight.legs_flown:
        yield {"kind": "leg", "number": after.flight.legs_flown}


def of_command(command: Command) -> Entry | None:
    """The entry of what the autopilot is told; None: setpoints are in the telemetry log."""
    match command:
        case SetMode(mode=mode):
            return {"kind": "set mode", "mode": mode.value}
        case Arm():
            return {"kind": "arm"}
        case TakeOff(above_home_m=height):
            return {"kind": "take off", "above_home_m": height}
        case _:
            return None


def of_request(request: PlanRequest, due_s: float) -> Entry:
    """The entry of a plan request."""
    return {
        "kind": "plan asked",
        "plan_id": request.plan_id,
        "due_s": due_s,
        "attempt": request.attempt,
        "rest": None if request.rest is None else asdict(request.rest),
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
