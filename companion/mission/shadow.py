"""The phase `shadow`: plan for the vehicle and report, never command.

A leg is planned from where the vehicle is, as if it were to fly it; as long as it does, the
successors follow as in flight.  When it does not, the next leg begins where it went.
"""

import math

import numpy as np
from msgspec.structs import replace

from companion.mission import flying, following
from companion.mission.decisions import Context, Step, in_words
from companion.mission.events import Command, Event, Landed, PlanReady, Position, Vector, say, warn
from companion.mission.health import TRUST_S
from companion.mission.state import OnPath, Reason, State
from companion.planner.procedure import Reference

_SAY_AGAIN_S = 10.0
_ARRIVED_M = 30.0


def shadow(state: State, event: Event, context: Context) -> Step:
    """What would be done now."""
    reason = state.vehicle.distrust
    if reason is None and state.now_s - state.vehicle.bad_at_s < TRUST_S:
        reason = state.reason  # good again, but not for long enough to go on
    if reason is not state.reason:
        return _would(replace(state, reason=reason), reason)
    if reason is not None or state.vehicle.landed is Landed.ON_GROUND or not state.targets_ne_m:
        return state, [], None
    if isinstance(event, Position):
        return _on_position(state, event)
    after, commands, trigger = flying.on_answer(state, event, context)
    return after, commands, None if isinstance(event, PlanReady) else trigger


def _would(state: State, reason: Reason | None) -> Step:
    """Report that it would hold now, or continue."""
    state = following.held_here(state)
    if reason is None:
        return state, [say("shadow: would go on")], None
    return state, [warn(f"shadow: would hold: {in_words(state, reason)}")], None


def _on_position(state: State, event: Position) -> Step:
    """Follow the vehicle along the leg that was planned, or plan one from where it is."""
    flight, here = state.flight, event.position_nea_m
    target = state.targets_ne_m[flight.target]
    if math.dist(here[:2], target) < max(_ARRIVED_M, state.task.limits.tracking_error_m):
        last = flight.target + 1 == len(state.targets_ne_m)
        says: list[Command] = [] if last else [say("shadow: target reached")]
        at = flight.target if last else flight.target + 1
        flight = replace(following.at_rest(flight, None), target=at)
        return replace(state, flight=flight), says, None
    if (path := flight.path) is None:
        return _ask(state, here)
    off_m, at_m = following.nearest(path.leg, here)
    if off_m > 3.0 * state.task.limits.tracking_error_m:
        text = f"shadow: the vehicle is {off_m:.0f} m off the path"
        return following.held_here(state), [say(text)], None
    return _follow(state, path, at_m)


def _ask(state: State, here: Vector) -> Step:
    """Scan and plan from here, every few seconds until there is a leg."""
    flight = state.flight
    if flight.search is not None and state.now_s - flight.progress_at_s < _SAY_AGAIN_S:
        return state, [], None
    flight = replace(flight, progress_at_s=state.now_s)
    flight, commands = flying.start_scan(flight, here)
    return replace(state, flight=flight), commands, None


def _follow(state: State, path: OnPath, at_m: float) -> Step:
    """The vehicle is on the leg: scan at p_scan, go over at p_prog."""
    flight, task, leg = state.flight, state.task, path.leg
    speed = float(np.linalg.norm(state.vehicle.velocity_nea_m_s))
    length_m = max(path.reference.length_m, at_m)
    path = replace(path, reference=Reference(length_m=length_m, speed_m_s=speed))
    flight = replace(flight, path=path)
    if path.next_leg is not None and length_m >= leg.successor_at_m(task):
        flight, _ = following.switched_to_next_leg(flight, path, task)
    elif leg.subpath.length_m - length_m < 1.0:
        flight = following.at_rest(flight, None)
    elif flight.search is None and leg.wants_successor(length_m, task):
        flight, commands = flying.start_scan(flight, leg.subpath.pose(length_m).point_nea_m)
        return replace(state, flight=flight), commands, None
    return replace(state, flight=flight), [], None
