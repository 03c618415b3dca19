"""The phase `shadow`: plan for the vehicle and report, never command.

A leg is planned from where the vehicle is, as if it were to fly it; as long as it does, the
successors follow as in flight.  When it does not, the next leg begins where it went.
"""

import math

from companion.mission import flying, following
from companion.mission.decisions import Turn, in_words
from companion.mission.events import Event, Landed, Position
from companion.mission.health import TRUST_S
from companion.mission.state import OnPath, State
from companion.planner.procedure import Reference

_SAY_AGAIN_S = 10.0
_ARRIVED_M = 30.0


def shadow(state: State, event: Event, turn: Turn) -> None:
    """What would be done now."""
    flight, reason = state.flight, state.vehicle.distrust
    if reason is None and state.now_s - state.vehicle.bad_at_s < TRUST_S:
        reason = state.reason  # good again, but not for long enough to go on
    if reason is not state.reason:
        state.reason = reason
        following.come_to_rest(flight)
        if reason is None:
            turn.say("shadow: would go on")
        else:
            turn.warn(f"shadow: would hold: {in_words(state, reason)}")
    elif reason is not None or state.vehicle.landed is Landed.ON_GROUND or not state.targets_ne_m:
        pass
    elif isinstance(event, Position):
        _on_position(state, event, turn)
    else:
        flying.on_answer(state, event, turn)


def _on_position(state: State, event: Position, turn: Turn) -> None:
    """Follow the vehicle along the leg that was planned, or plan one from where it is."""
    flight, here, path = state.flight, event.position_nea_m, state.flight.path
    tracking_error_m = state.task.limits.tracking_error_m
    if math.dist(here[:2], state.targets_ne_m[flight.target]) < max(_ARRIVED_M, tracking_error_m):
        following.come_to_rest(flight)
        if flight.target + 1 < len(state.targets_ne_m):
            flight.target += 1
            turn.say("shadow: target reached")
    elif path is not None:
        off_m, at_m = following.nearest(path.leg, here)
        if off_m > 3.0 * tracking_error_m:
            turn.say(f"shadow: the vehicle is {off_m:.0f} m off the path")
            following.come_to_rest(flight)
        else:
            _follow(state, path, at_m, turn)
    elif flight.search is None or state.now_s - flight.progress_at_s >= _SAY_AGAIN_S:
        flight.progress_at_s = state.now_s  # every few seconds until there is a leg
        flying.start_scan(state, here, turn)


def _follow(state: State, path: OnPath, at_m: float, turn: Turn) -> None:
    """The vehicle is on the leg: scan at p_scan, go over at p_prog."""
    task, leg = state.task, path.leg
    length_m = max(path.reference.length_m, at_m)
    speed_m_s = math.hypot(*state.vehicle.velocity_nea_m_s)
    path.reference = Reference(length_m=length_m, speed_m_s=speed_m_s)
    if path.next_leg is not None and length_m >= leg.successor_at_m(task):
        following.switch_to_next_leg(state.flight, path, task)
    elif leg.subpath.length_m - length_m < 1.0:
        following.come_to_rest(state.flight)
    elif state.flight.search is None and leg.wants_successor(length_m, task):
        flying.start_scan(state, leg.subpath.pose(length_m).point_nea_m, turn)
