"""The mission machine: (state, event) -> (state, commands).  The only way a mission changes.

An event first changes what is known of the vehicle, then the phase's own handler decides; a
trigger moves the mission on through the table in `state`, and what it enters begins with its
own commands.  No clock, no I/O: times are those of the events.
"""

import math
from dataclasses import replace
from typing import assert_never

from companion.mission import flying
from companion.mission.events import (
    Arm,
    Command,
    End,
    Estimator,
    Event,
    GpsFix,
    Home,
    Landed,
    LandedState,
    LinkLost,
    Mode,
    Outcome,
    PlanLate,
    PlannerDied,
    PlanReady,
    Position,
    RequestStreams,
    Say,
    ScanDone,
    SetMode,
    StopAsked,
    TakeOff,
    Tick,
    VehicleStatus,
)
from companion.mission.flying import Context, Step
from companion.mission.health import distrust, with_position
from companion.mission.mission import EndAction
from companion.mission.state import MOVES, Phase, Reason, State, Trigger, Vehicle

_ASK_AGAIN_S = 1.0
_PREPARE_S = 120.0
_ARM_S = 60.0
_TAKE_OFF_SLACK_S = 60.0
_TRUST_S = 2.0  # a position must have been good for so long before the flight goes on
_PAUSE_S = 2.0  # between attempts to plan from rest
_ATTEMPTS = 4
_STOPPED_M_S = 0.5
_AT_M = 5.0
_SELF_HELD = (Reason.NO_PLAN, Reason.PLAN_LATE, Reason.RADAR_SILENT)
"""Reasons to hold that leave the position trustworthy: stop on setpoints, in guided mode."""


def step(state: State, event: Event, context: Context) -> tuple[State, list[Command]]:
    """One event: the new state, and what to do because of it."""
    if state.phase in (Phase.DONE, Phase.FAULTED):
        return state, []
    state = replace(state, now_s=max(state.now_s, event.time_s))
    after, commands, trigger = _decide(state, event, context)
    after = replace(after, vehicle=_observed(after, event, context))
    if trigger is None:
        return after, commands
    phase = MOVES.get((after.phase, trigger))
    if phase is None:
        return after, commands
    entered = replace(after, phase=phase, since_s=after.now_s, asked_at_s=-1e9)
    return _enter(entered, trigger, context, commands)


def _observed(state: State, event: Event, context: Context) -> Vehicle:
    """What is known of the vehicle after an event."""
    vehicle = state.vehicle
    match event:
        case Position():
            vehicle = with_position(vehicle, event, context.mission.task.limits)
        case VehicleStatus(mode=mode, armed=armed):
            vehicle = replace(vehicle, mode=mode, armed=armed)
        case LandedState(landed=landed):
            vehicle = replace(vehicle, landed=landed)
        case GpsFix(good=good):
            vehicle = replace(vehicle, fix_good=good)
        case Estimator(good=good):
            vehicle = replace(vehicle, estimator_good=good)
        case Home(altitude_amsl_m=altitude):
            vehicle = replace(vehicle, home_amsl_m=altitude)
        case _:
            pass
    if distrust(vehicle, state.now_s) is not None:
        vehicle = replace(vehicle, bad_at_s=state.now_s)
    return vehicle


def _decide(state: State, event: Event, context: Context) -> Step:
    if isinstance(event, StopAsked):
        return replace(state, reason=Reason.STOPPED), [], Trigger.STOP
    if isinstance(event, PlannerDied):
        return replace(state, reason=Reason.PLANNER_DIED), [], Trigger.DIED
    if isinstance(event, ScanDone):
        known = state.flight.known.with_scan(event.scan)
        state = replace(state, flight=replace(state.flight, known=known))
    match state.phase:
        case Phase.WAITING:
            return _waiting(state, event)
        case Phase.PREPARING:
            return _preparing(state, event)
        case Phase.ARMING:
            return _arming(state, event)
        case Phase.TAKING_OFF:
            return _taking_off(state, event, context)
        case Phase.FLYING:
            return _flying(state, event, context)
        case Phase.HOLDING:
            return _holding(state, event, context)
        case Phase.ARRIVED:
            return _arrived(state, event, context)
        case Phase.LANDING:
            return _landing(state, event)
        case Phase.RETURNING | Phase.SHADOW | Phase.DONE | Phase.FAULTED:
            return state, [], None
    assert_never(state.phase)


def _waiting(state: State, event: Event) -> Step:
    if isinstance(event, VehicleStatus):
        return state, [], Trigger.VEHICLE_FOUND
    if isinstance(event, LinkLost):
        return replace(state, reason=Reason.NO_VEHICLE), [], Trigger.GIVE_UP
    return state, [], None


def _preparing(state: State, event: Event) -> Step:
    if isinstance(event, LinkLost):
        return replace(state, reason=Reason.LINK_LOST), [], Trigger.GIVE_UP
    vehicle = state.vehicle
    if vehicle.landed in (Landed.IN_AIR, Landed.TAKING_OFF, Landed.LANDING):
        return replace(state, reason=Reason.ALREADY_FLYING), [], Trigger.GIVE_UP
    on_ground = vehicle.landed is Landed.ON_GROUND and vehicle.home_amsl_m is not None
    if on_ground and distrust(vehicle, state.now_s) is None:
        return state, [], Trigger.READY
    return _within(state, _PREPARE_S, Reason.NOT_READY)


def _arming(state: State, event: Event) -> Step:
    if isinstance(event, LinkLost):
        return replace(state, reason=Reason.LINK_LOST), [], Trigger.GIVE_UP
    vehicle = state.vehicle
    if isinstance(event, VehicleStatus) and event.mode is Mode.GUIDED and event.armed:
        return state, [], Trigger.ARMED
    asked = _ask(state, SetMode(mode=Mode.GUIDED) if vehicle.mode is not Mode.GUIDED else Arm())
    return asked if asked[1] else _within(state, _ARM_S, Reason.NOT_ARMED)


def _taking_off(state: State, event: Event, context: Context) -> Step:
    fault = _fault(state, event)
    if fault is not None:
        return replace(state, reason=fault), [], Trigger.FAULT
    vehicle, mission = state.vehicle, context.mission
    home = vehicle.home_amsl_m or 0.0
    height = mission.take_off_amsl_m - home
    if vehicle.landed is Landed.ON_GROUND:
        return _ask(state, TakeOff(above_home_m=height))
    if isinstance(event, Position) and vehicle.landed is Landed.IN_AIR:
        near = abs(event.position_nea_m[2] - mission.take_off_amsl_m) < _AT_M
        if near and _speed_m_s(event) < _STOPPED_M_S:
            return state, [], Trigger.AIRBORNE
    allowed = 2.0 * height / mission.task.limits.climb_rate_m_s + _TAKE_OFF_SLACK_S
    if state.now_s - state.since_s > allowed:
        return replace(state, reason=Reason.NO_TAKE_OFF), [], Trigger.FAULT
    return state, [], None


def _flying(state: State, event: Event, context: Context) -> Step:
    fault = _fault(state, event)
    if fault is not None:
        flight = flying.at_rest(state.flight, None)
        return replace(state, reason=fault, flight=flight), [], Trigger.FAULT
    match event:
        case Position():
            return flying.on_position(state, event, context)
        case ScanDone():
            return flying.on_scan(state, event, context)
        case PlanReady():
            return flying.on_plan(state, event, context)
        case PlanLate():
            return flying.on_late_plan(state, event)
        case _:
            return state, [], None


def _holding(state: State, event: Event, context: Context) -> Step:
    """Stop in a way that the reason allows, and go on when it is gone."""
    reason, vehicle = state.reason, state.vehicle
    if isinstance(event, LinkLost) and reason is Reason.LINK_LOST:
        return state, [], Trigger.GIVE_UP
    if isinstance(event, VehicleStatus) and not event.armed:
        return replace(state, reason=Reason.DISARMED), [], Trigger.GIVE_UP
    fault = _fault(state, event) if reason in _SELF_HELD else None
    if fault is not None:
        flight = flying.at_rest(state.flight, None)
        return replace(state, reason=fault, flight=flight), [SetMode(mode=Mode.HOLD)], None
    if reason in _SELF_HELD:
        return _hold_on_setpoints(state, event, context)
    if reason is Reason.NO_TAKE_OFF:
        return state, [], Trigger.GIVE_UP
    trusted = state.now_s - vehicle.bad_at_s > _TRUST_S
    if reason in (Reason.MODE_TAKEN, Reason.LINK_LOST):
        back = isinstance(event, VehicleStatus) and event.mode is Mode.GUIDED and trusted
        return state, [], Trigger.RESUME if back else None
    if isinstance(event, VehicleStatus) and event.mode in (Mode.LAND, Mode.OTHER):
        return replace(state, reason=Reason.MODE_TAKEN), [], None
    if not trusted:
        return (
            _ask(state, SetMode(mode=Mode.HOLD))
            if vehicle.mode is Mode.GUIDED
            else (state, [], None)
        )
    if isinstance(event, VehicleStatus) and event.mode is Mode.GUIDED:
        return state, [], Trigger.RESUME
    return _ask(state, SetMode(mode=Mode.GUIDED))


def _hold_on_setpoints(state: State, event: Event, context: Context) -> Step:
    """Stay at the end of the leg; try again after a pause, and not for ever."""
    if not isinstance(event, Position):
        return state, [], None
    setpoint = flying.hold_setpoint(state, event.time_s, context)
    commands: list[Command] = [setpoint] if setpoint is not None else []
    if state.now_s - state.since_s < _PAUSE_S or _speed_m_s(event) > _STOPPED_M_S:
        return state, commands, None
    again = state.flight.failures < _ATTEMPTS
    return state, commands, Trigger.RESUME if again else Trigger.GIVE_UP


def _arrived(state: State, event: Event, context: Context) -> Step:
    """Stop at the target; then the next target, or the end action."""
    asked = state.asked_at_s > state.since_s
    if isinstance(event, VehicleStatus) and event.mode is Mode.HOLD and asked:
        return state, [], Trigger.END_HOLD
    fault = _fault(state, event)
    if fault is not None:
        return replace(state, reason=fault), [], Trigger.FAULT
    if not isinstance(event, Position):
        return state, [], None
    setpoint = flying.hold_setpoint(state, event.time_s, context)
    commands: list[Command] = [setpoint] if setpoint is not None else []
    if setpoint is None or _speed_m_s(event) > _STOPPED_M_S:
        return state, commands, None
    if math.dist(event.position_nea_m, setpoint.position_nea_m) > _AT_M:
        return state, commands, None
    if state.flight.target + 1 < len(context.mission.targets_ne_m):
        flight = replace(state.flight, target=state.flight.target + 1)
        return replace(state, flight=flight), commands, Trigger.NEXT_TARGET
    if context.mission.end_action is EndAction.LAND:
        return state, commands, Trigger.END_LAND
    state, asking, _ = _ask(state, SetMode(mode=Mode.HOLD))
    return state, [*commands, *asking], None


def _landing(state: State, event: Event) -> Step:
    vehicle = state.vehicle
    if isinstance(event, VehicleStatus) and not event.armed and vehicle.landed is Landed.ON_GROUND:
        return state, [], Trigger.LANDED
    if vehicle.mode is Mode.LAND:
        return state, [], None
    return _ask(state, SetMode(mode=Mode.LAND))


def _enter(
    state: State, trigger: Trigger, context: Context, commands: list[Command]
) -> tuple[State, list[Command]]:
    """What a phase begins with."""
    match state.phase:
        case Phase.PREPARING:
            return state, [*commands, RequestStreams(), Say(text=f"mission {context.mission.name}")]
        case Phase.FLYING:
            state = replace(state, reason=None)
            return state, commands
        case Phase.HOLDING:
            reason = state.reason or Reason.NO_PLAN
            says: list[Command] = [Say(text=f"hold: {reason.text}", warning=True)]
            if reason not in (*_SELF_HELD, Reason.MODE_TAKEN, Reason.LINK_LOST):
                says.append(SetMode(mode=Mode.HOLD))
            return state, [*commands, *says]
        case Phase.ARRIVED:
            leg = state.flight.leg
            end = None if leg is None else leg.subpath.pose(leg.subpath.length_m).position_nea_m
            hover = None if end is None else (float(end[0]), float(end[1]), float(end[2]))
            flight = flying.at_rest(state.flight, hover)
            return replace(state, flight=flight), [*commands, Say(text="target reached")]
        case Phase.DONE | Phase.FAULTED:
            return state, [*commands, *_ending(state, trigger)]
        case _:
            return state, commands


def _ending(state: State, trigger: Trigger) -> list[Command]:
    """Leave the vehicle in its own hold, if it is in the air and ours, and say how it ended."""
    if trigger in (Trigger.END_HOLD, Trigger.LANDED):
        return [End(outcome=Outcome.ARRIVED, reason="target reached", remedy="")]
    reason = state.reason or Reason.NO_PLAN
    outcome = Outcome.STOPPED if trigger is Trigger.STOP else Outcome.FAILED
    ours = state.vehicle.armed and state.vehicle.mode is Mode.GUIDED
    in_air = state.vehicle.landed in (Landed.IN_AIR, Landed.TAKING_OFF)
    hold: list[Command] = [SetMode(mode=Mode.HOLD)] if ours and in_air else []
    return [*hold, End(outcome=outcome, reason=reason.text, remedy=reason.remedy)]


def _fault(state: State, event: Event) -> Reason | None:
    """Why a flight cannot go on as it is."""
    if isinstance(event, LinkLost):
        return Reason.LINK_LOST
    if isinstance(event, VehicleStatus):
        if not event.armed:
            return Reason.DISARMED
        return None if event.mode is Mode.GUIDED else Reason.MODE_TAKEN
    if isinstance(event, Position):
        seen = replace(state.vehicle, position_at_s=event.time_s)
        return distrust(seen, state.now_s)
    return distrust(state.vehicle, state.now_s) if isinstance(event, Tick) else None


def _ask(state: State, command: Command) -> Step:
    """Ask for something once a second."""
    if state.now_s - state.asked_at_s < _ASK_AGAIN_S:
        return state, [], None
    return replace(state, asked_at_s=state.now_s), [command], None


def _within(state: State, limit_s: float, reason: Reason) -> Step:
    """Give up a wait on the ground that takes too long."""
    if state.now_s - state.since_s > limit_s:
        return replace(state, reason=reason), [], Trigger.GIVE_UP
    return state, [], None


def _speed_m_s(event: Position) -> float:
    return math.hypot(*event.velocity_nea_m_s)
