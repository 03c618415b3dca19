"""The mission machine: (state, event) -> (state, commands).  The only way a mission changes.

The state is copied once, with all of it that changes, and the copy is changed in place: nobody else
does.  An event first updates vehicle and terrain.  Then comes what others want, then what is wrong
(`tables.FAULTS`), then what the phase does; a trigger changes the phase by the table in `phases`,
and the new phase begins with its own commands.  No clock, no I/O: times are those of the events.
"""

from collections.abc import Callable
from copy import copy
from typing import Any, Final

from companion.mission import changes, events, flying, following, ground, phases, stopped, way_back
from companion.mission.battery import take_battery
from companion.mission.decisions import Context, Turn, longest_silence_s, reason_text
from companion.mission.events import Command, End, Event, Landed, Mode, Outcome
from companion.mission.health import distrust, take_distrust, take_position
from companion.mission.phases import (
    IN_AIR,
    ON_GROUND,
    OVER,
    TAKEN,
    TAKES_OVER,
    By,
    Phase,
    Reason,
    Stage,
    Trigger,
)
from companion.mission.state import HEARTBEAT_S, State
from companion.mission.tables import fall_back, fault_of, parting
from companion.mission.vehicle_traits import UNKNOWN

_AS_IT_SHOULD = {
    Trigger.END_HOLD: "holding",
    Trigger.LANDED: "landed",
    Trigger.HANDED_ON: "its autopilot returns by itself",
}
"""Ends after which the vehicle needs nothing more, and what it is doing then."""


def step(before: State, event: Event, context: Context) -> tuple[State, list[Command]]:
    """Handle one event: the new state and the commands."""
    if before.stage.phase in OVER:
        return before, []
    state = copy(before)
    state.vehicle, state.flight = copy(before.vehicle), copy(before.flight)
    state.stage = stage = copy(before.stage)
    if isinstance(stage, phases.Led | phases.Preparing):
        stage.path = copy(stage.path)
    vehicle, now_s = state.vehicle, max(before.now_s, event.time_s)
    turn, limits = Turn(state, context), state.task.limits
    state.now_s = now_s
    if not isinstance(event, events.Position):
        _observe(state, event, context)
    elif event.time_s > vehicle.position_at_s:
        take_position(vehicle, event, limits)
    else:
        return state, []  # overtaken by a newer one
    doubt = distrust(vehicle, now_s, limits)
    if doubt is not None or vehicle.distrust is not None:
        take_distrust(vehicle, doubt, now_s)
    state.airborne = state.airborne or (vehicle.armed and vehicle.landed is Landed.IN_AIR)
    in_any_phase = _IN_ANY_PHASE.get(type(event))
    if in_any_phase is not None:
        in_any_phase(state, event, turn)
    is_well = (  # as it mostly is: then no row of the table is true
        vehicle.mode is Mode.GUIDED
        and vehicle.armed
        and vehicle.landed is Landed.IN_AIR
        and vehicle.distrust is None
        and now_s - vehicle.status_at_s <= HEARTBEAT_S
        and not isinstance(stage, phases.Holding)
        and in_any_phase is None
    )
    if in_any_phase is None or turn.is_left:
        reason = None if is_well else fault_of(state, event)
        if reason is not None:
            _break_off(state, reason, turn)
        else:
            PHASES[state.stage.phase][1](state, state.stage, event, turn)
    if turn.trigger is Trigger.GIVE_UP and not context.shadow:
        fall_back(state, turn)
    if turn.trigger is not None and state.phase in turn.trigger.origins:
        _enter(state, turn.trigger, turn)
    return state, turn.commands


def _break_off(state: State, reason: Reason, turn: Turn) -> None:
    """What follows from a row of `tables.FAULTS`."""
    if state.phase is Phase.HOLDING:
        stopped.broken_off(state, reason, turn)
    elif state.phase is Phase.HANDING_OVER or (
        state.phase is Phase.TAKING_OFF and state.vehicle.landed is Landed.ON_GROUND
    ):
        turn.give_up(reason)
    else:
        if state.phase is not Phase.TAKING_OFF:
            way_back.leave_path(state)
        turn.fault(reason)


_HEARD: Final = ("status_at_s", "landed_at_s", "fix_at_s", "estimator_at_s", "battery_at_s")
"""Of the vehicle: the times at which these were heard."""


def rebased(before: State, shift_s: float) -> State:
    """The state on a clock that shows shift_s more: its own time, and the waits that go on."""
    state, vehicle, stage = copy(before), copy(before.vehicle), copy(before.stage)
    state.vehicle, state.stage = vehicle, stage
    state.now_s += shift_s
    stage.since_s += shift_s
    stage.asked_at_s += shift_s
    state.duplicate_id_at_s += shift_s
    if state.fence_unread_s is not None:
        state.fence_unread_s += shift_s
    vehicle.bad_at_s += shift_s
    vehicle.battery_short_at_s = None
    for name in _HEARD:  # while the clock stood still: it was just now
        if getattr(vehicle, name) == before.now_s:
            setattr(vehicle, name, state.now_s)
    return state


def _observe(state: State, event: Event, context: Context) -> None:
    """Update vehicle and terrain by an event, except for positions."""
    vehicle, now_s, told_s = state.vehicle, state.now_s, event.time_s
    match event:
        case events.VehicleFound(traits=traits):
            vehicle.traits = traits or UNKNOWN
        case events.VehicleStatus():
            vehicle.mode, vehicle.armed = event.mode, event.armed
            vehicle.failsafe, vehicle.status_at_s = event.failsafe, told_s
        case events.LandedState(landed=landed) if landed is not vehicle.landed:
            vehicle.landed, vehicle.landed_at_s = landed, told_s
        case events.TakeOffTaken():
            vehicle.take_off_taken_at_s = now_s
        case events.GpsFix(good=good):
            vehicle.fix_good, vehicle.fix_at_s = good, told_s
        case events.Estimator(good=good, error_m=error_m):
            if vehicle.estimator_good and not good:
                vehicle.estimator_failed_at_s = told_s
            vehicle.estimator_good, vehicle.estimator_at_s = good, told_s
            vehicle.error_m = error_m
        case events.Home(position_nea_m=home) if not vehicle.home_kept:
            vehicle.home_nea_m = home
        case events.Battery():
            take_battery(state, event, context.mission)
        case events.Echo():
            vehicle.echo = event
            following.take_echo(state, event)
        case events.DuplicateId(certain=certain):
            state.duplicate_id, state.duplicate_id_at_s = certain, now_s
        case events.Prepared(item=item, refusal=""):
            state.prepared |= {item}
        case events.ScanDone(scan=scan) if state.phase not in ON_GROUND:  # else only to answer
            state.flight.known = state.flight.known.with_scan(scan)
        case _:
            pass


def _on_end(state: State, event: events.StopAsked | events.PlannerDied, turn: Turn) -> None:
    """A person wants the end, or a part of the companion has died."""
    if isinstance(event, events.StopAsked):
        state.because(Reason.STOPPED)
        turn.to(Trigger.STOP)
    else:
        state.because(Reason.PLANNER_DIED)
        state.detail = f": {event.error}" if event.error else ""
        turn.to(Trigger.DIED)


def _on_link_lost(state: State, event: events.LinkLost, turn: Turn) -> None:
    """Before the flight a silence ends the mission at once, later once it is too long."""
    phase, airborne = state.phase, state.airborne
    early = phase is Phase.ARMING or (phase is Phase.PREPARING and not airborne)
    if phase is Phase.WAITING:
        turn.give_up(Reason.NO_VEHICLE)
    elif phase in (Phase.READY, Phase.TAKING_OFF):
        turn.is_left = True
    elif early or event.silent_s >= longest_silence_s(state, turn.context):
        turn.give_up(Reason.LINK_LOST)
    else:
        turn.is_left = phase is not Phase.PREPARING


_IN_ANY_PHASE: Final[dict[type[Event], Callable[[State, Any, Turn], None]]] = {
    events.StopAsked: _on_end,
    events.PlannerDied: _on_end,
    events.LinkLost: _on_link_lost,
    events.DuplicateId: ground.on_duplicate_id,
    **changes.HANDLERS,
}
"""Handlers of events in any phase; some leave it to the phase (`Turn.is_left`)."""

PHASES: Final[dict[Phase, tuple[type[Stage], Callable[[State, Any, Event, Turn], None]]]] = {
    Phase.WAITING: (phases.Preparing, ground.waiting),
    Phase.PREPARING: (phases.Preparing, ground.preparing),
    Phase.READY: (Stage, ground.ready),
    Phase.ARMING: (Stage, ground.arming),
    Phase.TAKING_OFF: (Stage, ground.taking_off),
    Phase.FLYING: (phases.Flying, flying.on_path),
    Phase.RETURNING: (phases.Led, flying.on_path),
    Phase.HOLDING: (phases.Holding, stopped.holding),
    Phase.ARRIVED: (phases.Stopped, stopped.arrived),
    Phase.LANDING: (Stage, stopped.landing),
    Phase.HANDING_OVER: (Stage, stopped.handing_over),
    Phase.SHADOW: (phases.Flying, flying.shadow),
    Phase.DONE: (Stage, lambda *_: None),
    Phase.FAULTED: (Stage, lambda *_: None),
}
"""What each phase knows, and its handler; a mission that is over ignores events."""


def _enter(state: State, trigger: Trigger, turn: Turn) -> None:
    """Begin the next phase: with what it begins, and how the last one ends."""
    was, phase, context = state.stage, trigger.after, turn.context
    if phase in OVER:
        if not (context.shadow or trigger in _AS_IT_SHOULD):
            turn.do(*parting(state, stopped=trigger is Trigger.STOP))
        turn.do(_end_of(state, trigger))
    if phase is Phase.HOLDING:
        if was.phase in phases.LED:
            stopped.note_circle(state)
        turn.hold(state.reason or Reason.NO_PLAN)
    else:
        state.stage = turn.stage or PHASES[phase][0](phase=phase)
    state.stage.since_s = state.stage.progress_at_s = state.now_s
    left = was.path if isinstance(was, phases.Led | phases.Preparing) else None
    if left is not None and state.path is not left:  # broken off on it
        following.note_flown(state, left, left.reference.length_m)
    if phase in IN_AIR:
        since_s = state.now_s if was.phase is Phase.PREPARING else -1e9
        state.in_control_since_s = min(state.in_control_since_s, since_s)
        state.airborne = True
    match phase:
        case Phase.READY:
            turn.say("ready: waits for go: MISSION_START or a yes", "phase")
        case Phase.PREPARING if trigger is not Trigger.UNREADY:
            turn.do(events.RequestStreams())
            turn.say(f"mission {context.mission.name}")
            stage = state.stage
            assert isinstance(stage, phases.Preparing)
            for text in filter(None, (stopped.landing_words(state, context), stage.news)):
                turn.warn(text)
        case Phase.FLYING | Phase.LANDING | Phase.RETURNING:
            _set_out(state, turn)
        case Phase.HOLDING:
            assert isinstance(state.stage, phases.Holding)
            _hold(state, state.stage, turn)
        case Phase.ARRIVED:
            stopped.say_reached(state, turn)
        case _:
            pass


def _set_out(state: State, turn: Turn) -> None:
    """To fly, back or on, or to land."""
    state.reason, state.taken, state.flight.circle_nea_m = None, False, None
    if isinstance(state.stage, phases.Led):
        state.stage.echoed_at_s = state.now_s
    if state.phase is Phase.FLYING and not state.flight.homeward:  # to a target again
        state.flight.fallen_back = None
    if state.phase is Phase.RETURNING:
        turn.say("returning", "phase")
    if state.phase is not Phase.LANDING and state.vehicle.traits is not UNKNOWN:
        turn.do(events.SetSpeed(speed_m_s=state.task.limits.speed_m_s))


def _hold(state: State, held: phases.Holding, turn: Turn) -> None:
    """What comes with a hold, for the reason that there is."""
    reason = held.why
    if reason in TAKEN:
        state.taken = True
    elif reason.by is not By.SETPOINTS and reason not in TAKES_OVER:
        state.flight.troubles += 1
    if reason.asks_to_hold:
        held.asked_at_s = state.now_s
        broken_off = reason is Reason.BROKEN_OFF
        turn.do(*(parting(state) if broken_off else [stopped.hold_by_itself(state)]))


def _end_of(state: State, trigger: Trigger) -> End:
    """How the mission ended, in words."""
    fallen_back, how = state.flight.fallen_back, _AS_IT_SHOULD.get(trigger)
    if how is None:
        reason = state.reason or Reason.NO_PLAN
        outcome = Outcome.STOPPED if trigger is Trigger.STOP else Outcome.FAILED
        text, remedy = f"{reason.text}{state.detail}", state.remedy or reason.remedy
        return End(outcome=outcome, reason=text, remedy=remedy)
    if fallen_back is not None:
        asked = fallen_back in (Reason.RETURN_ASKED, Reason.LAND_ASKED)
        outcome = Outcome.STOPPED if asked else Outcome.FAILED
        detail, remedy = reason_text(state, fallen_back)
        return End(outcome=outcome, reason=f"{how}: {fallen_back.text}{detail}", remedy=remedy)
    off_m = stopped.landed_off_m(state) if trigger is Trigger.LANDED else 0.0
    if off_m > stopped.lands_within_m(state):
        remedy = "Land it by a landing pattern of its autopilot, or set end.action to hold."
        far = f"landed {off_m:.0f} m from where it was to land"
        return End(outcome=Outcome.FAILED, reason=far, remedy=remedy)
    return End(outcome=Outcome.ARRIVED, reason="target reached", remedy="")
