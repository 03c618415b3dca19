"""The mission machine: (state, event) -> (state, commands).  The only way a mission changes.

An event first changes what is known of the vehicle and of the terrain, then the phase's own
handler decides; a trigger moves the mission on through the table in `state`, and what it enters
begins with its own commands.  No clock, no I/O: times are those of the events.
"""

from dataclasses import replace
from typing import assert_never

from companion.mission import flying, ground, stopped
from companion.mission.decisions import Context, Step
from companion.mission.events import (
    Command,
    End,
    Estimator,
    Event,
    GpsFix,
    Home,
    Landed,
    LandedState,
    Mode,
    Outcome,
    PlannerDied,
    Position,
    RequestStreams,
    Say,
    ScanDone,
    SetMode,
    StopAsked,
    VehicleStatus,
)
from companion.mission.health import distrust, with_position
from companion.mission.state import IN_AIR, MOVES, Phase, Reason, State, Trigger, Vehicle


def step(state: State, event: Event, context: Context) -> tuple[State, list[Command]]:
    """One event: the new state, and what to do because of it."""
    if state.phase in (Phase.DONE, Phase.FAULTED):
        return state, []
    state = replace(state, now_s=max(state.now_s, event.time_s))
    if isinstance(event, Position) and event.time_s <= state.vehicle.position_at_s:
        return state, []  # overtaken by a newer one
    state = replace(state, vehicle=_observed(state, event, context))
    if isinstance(event, ScanDone):
        known = state.flight.known.with_scan(event.scan)
        state = replace(state, flight=replace(state.flight, known=known))
    after, commands, trigger = _decide(state, event, context)
    phase = None if trigger is None else MOVES.get((after.phase, trigger))
    if trigger is None or phase is None:
        return after, commands
    entered = replace(after, phase=phase, since_s=after.now_s, asked_at_s=-1e9, obeyed=False)
    return _enter(entered, after, trigger, context, commands)


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
    match state.phase:
        case Phase.WAITING:
            return ground.waiting(state, event)
        case Phase.PREPARING:
            return ground.preparing(state, event, context)
        case Phase.ARMING:
            return ground.arming(state, event)
        case Phase.TAKING_OFF:
            return ground.taking_off(state, event, context)
        case Phase.FLYING:
            return flying.flying(state, event, context)
        case Phase.HOLDING:
            return stopped.holding(state, event, context)
        case Phase.ARRIVED:
            return stopped.arrived(state, event, context)
        case Phase.LANDING:
            return stopped.landing(state, event)
        case Phase.RETURNING | Phase.SHADOW | Phase.DONE | Phase.FAULTED:
            return state, [], None
    assert_never(state.phase)


def _enter(
    state: State, before: State, trigger: Trigger, context: Context, commands: list[Command]
) -> tuple[State, list[Command]]:
    """What a phase begins with."""
    match state.phase:
        case Phase.PREPARING:
            return state, [*commands, RequestStreams(), Say(text=f"mission {context.mission.name}")]
        case Phase.FLYING | Phase.LANDING:
            flight = replace(state.flight, progress_at_s=state.now_s)
            return replace(state, reason=None, flight=flight), commands
        case Phase.HOLDING:
            reason = state.reason or Reason.NO_PLAN
            says: list[Command] = [Say(text=f"hold: {reason.text}", warning=True)]
            if reason not in (*stopped.SELF_HELD, *stopped.LET_GO):
                state = replace(state, asked_at_s=state.now_s)
                says.append(SetMode(mode=Mode.HOLD))
            return state, [*commands, *says]
        case Phase.ARRIVED:
            flight = flying.at_rest_at_end(state.flight)
            return replace(state, flight=flight), [*commands, Say(text="target reached")]
        case Phase.DONE | Phase.FAULTED:
            return state, [*commands, *_ending(before, trigger)]
        case _:
            return state, commands


def _ending(before: State, trigger: Trigger) -> list[Command]:
    """Leave the vehicle in its own hold, if it flies for us, and say how the mission ended."""
    if trigger in (Trigger.END_HOLD, Trigger.LANDED):
        return [End(outcome=Outcome.ARRIVED, reason="target reached", remedy="")]
    vehicle, reason = before.vehicle, before.reason or Reason.NO_PLAN
    outcome = Outcome.STOPPED if trigger is Trigger.STOP else Outcome.FAILED
    end = End(outcome=outcome, reason=reason.text, remedy=reason.remedy)
    sent_up = before.phase is Phase.TAKING_OFF and before.asked_at_s > 0.0
    flies = before.phase in IN_AIR and (vehicle.landed is not Landed.ON_GROUND or sent_up)
    if flies and vehicle.armed and vehicle.mode is Mode.GUIDED:
        return [SetMode(mode=Mode.HOLD), end]
    return [end]
