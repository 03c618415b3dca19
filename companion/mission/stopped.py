"""The phases in which the vehicle stands in the air, or lands: holding, arrived, landing."""

import math
from dataclasses import replace

from companion.mission import flying
from companion.mission.decisions import (
    AT_M,
    STOPPED_M_S,
    Context,
    Step,
    ask,
    cannot_fly,
    fault,
    give_up,
    in_phase_s,
    is_gone,
    speed_m_s,
)
from companion.mission.events import Event, Landed, LinkLost, Mode, Position, SetMode
from companion.mission.mission import EndAction
from companion.mission.state import Reason, State, Trigger

SELF_HELD = (Reason.NO_PLAN, Reason.PLAN_LATE, Reason.RADAR_SILENT)
"""Reasons to hold that leave the position trustworthy: stop on setpoints, in guided mode."""

LET_GO = (Reason.MODE_TAKEN, Reason.LINK_LOST, Reason.DISARMED, Reason.GROUNDED)
"""Reasons to hold in which the vehicle is not ours to command."""

_TRUST_S = 2.0  # a position must have been good for so long before the flight goes on
_PAUSE_S = 2.0  # between attempts to plan from rest
_ATTEMPTS = 4
_THERE_M = 1.0
_SETTLE_S = 30.0  # for a vehicle that does not come quite to rest
_HOLD_S = 300.0  # for a position that does not get better
_OBEY_S = 60.0  # for the end action's mode, and for a descent that stands still
_SINKING_M_S = 0.1


def holding(state: State, event: Event, context: Context) -> Step:
    """Stop in a way that the reason allows, and go on when it is gone."""
    vehicle, reason = state.vehicle, state.reason
    if is_gone(event):
        return give_up(state, Reason.LINK_LOST)
    if isinstance(event, LinkLost):
        return state, [], None
    if not vehicle.armed:
        return give_up(state, Reason.DISARMED)
    if vehicle.landed is Landed.ON_GROUND:
        return give_up(state, Reason.GROUNDED)
    if reason in LET_GO:
        return _let_go(state)
    if reason in SELF_HELD:
        return _hold_on_setpoints(state, event, context)
    return _hold_in_its_own_mode(state)


def _let_go(state: State) -> Step:
    """Somebody else flies: say nothing until guided mode is selected again."""
    trusted = state.now_s - state.vehicle.bad_at_s > _TRUST_S
    back = state.vehicle.mode is Mode.GUIDED and trusted
    return state, [], Trigger.RESUME if back else None


def _hold_on_setpoints(state: State, event: Event, context: Context) -> Step:
    """Stay at the end of the leg; try again after a pause, and not for ever."""
    reason = cannot_fly(state, event)
    if reason is not None:
        state = replace(state, reason=reason, flight=flying.at_rest(state.flight, None))
        return state, [], None
    if not isinstance(event, Position):
        return state, [], None
    commands = flying.hold_setpoint(state, event.time_s, context)
    moving = speed_m_s(event) > STOPPED_M_S and in_phase_s(state) < _SETTLE_S
    if in_phase_s(state) < _PAUSE_S or moving:
        return state, commands, None
    if state.flight.failures < _ATTEMPTS:
        return state, commands, Trigger.RESUME
    return state, commands, Trigger.GIVE_UP


def _hold_in_its_own_mode(state: State) -> Step:
    """The autopilot holds, until it stands and its position was good for a while."""
    vehicle = state.vehicle
    if vehicle.mode is Mode.HOLD:
        state = replace(state, obeyed=True)
    elif vehicle.mode is not Mode.GUIDED:
        return replace(state, reason=Reason.MODE_TAKEN), [], None
    if in_phase_s(state) > _HOLD_S:
        return state, [], Trigger.GIVE_UP
    if not state.obeyed:
        return ask(state, SetMode(mode=Mode.HOLD))
    stands = math.hypot(*vehicle.velocity_nea_m_s) < STOPPED_M_S or in_phase_s(state) > _SETTLE_S
    trusted = state.now_s - max(vehicle.bad_at_s, state.since_s) > _TRUST_S
    if not (stands and trusted):
        return state, [], None
    if vehicle.mode is Mode.GUIDED:
        return state, [], Trigger.RESUME
    return ask(state, SetMode(mode=Mode.GUIDED))


def arrived(state: State, event: Event, context: Context) -> Step:
    """Stop at the target; then the next target, or the end action."""
    asked = state.asked_at_s > state.since_s
    if state.vehicle.mode is Mode.HOLD and asked:
        return state, [], Trigger.END_HOLD
    if is_gone(event):
        return give_up(state, Reason.LINK_LOST)
    reason = cannot_fly(state, event)
    if reason is not None:
        return fault(replace(state, flight=flying.at_rest(state.flight, None)), reason)
    if in_phase_s(state) > _SETTLE_S + _OBEY_S:
        return give_up(state, Reason.NOT_OBEYING if asked else Reason.NOT_FOLLOWING)
    if not isinstance(event, Position):
        return state, [], None
    commands = flying.hold_setpoint(state, event.time_s, context)
    if not _stands_at_target(state, event, context):
        return state, commands, None
    if state.flight.target + 1 < len(context.mission.targets_ne_m):
        flight = replace(state.flight, target=state.flight.target + 1, stops=0)
        return replace(state, flight=flight), commands, Trigger.NEXT_TARGET
    if context.mission.end_action is EndAction.LAND:
        return state, commands, Trigger.END_LAND
    state, asking, _ = ask(state, SetMode(mode=Mode.HOLD))
    return state, [*commands, *asking], None


def _stands_at_target(state: State, event: Position, context: Context) -> bool:
    """At rest there; after a while, as near to it and to rest as the vehicle can be."""
    here = state.flight.hover_nea_m
    off = math.inf if here is None else math.dist(event.position_nea_m, here)
    if in_phase_s(state) > _SETTLE_S:
        return off < max(AT_M, context.mission.task.limits.tracking_error_m)
    return off < _THERE_M and speed_m_s(event) < STOPPED_M_S


def landing(state: State, event: Event) -> Step:
    """Ask for the land mode until it is taken, then wait for the ground."""
    vehicle = state.vehicle
    if vehicle.landed is Landed.ON_GROUND and not vehicle.armed:
        return state, [], Trigger.LANDED
    if is_gone(event):
        return give_up(state, Reason.LINK_LOST)
    if isinstance(event, Position) and event.velocity_nea_m_s[2] < -_SINKING_M_S:
        state = replace(state, flight=replace(state.flight, progress_at_s=state.now_s))
    if state.now_s - state.flight.progress_at_s > _OBEY_S:
        return give_up(state, Reason.NOT_OBEYING)
    if vehicle.mode is Mode.LAND:
        return replace(state, obeyed=True), [], None
    if state.obeyed or vehicle.mode is not Mode.GUIDED:
        return fault(replace(state, flight=flying.at_rest(state.flight, None)), Reason.MODE_TAKEN)
    return ask(state, SetMode(mode=Mode.LAND))
