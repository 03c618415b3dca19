"""The mission machine: (state, event) -> (state, commands).  The only way a mission changes.

An event first updates vehicle and terrain, then the handler of the phase decides; a trigger changes
the phase by the table in `state`, and the new phase begins with its own commands.  No clock, no
I/O: times are those of the events.
"""

from collections.abc import Callable
from typing import Any, Final

from msgspec.structs import replace

from companion.mission import backtracking, changes, fallback, flying, following, ground, stopped
from companion.mission import shadow as watching
from companion.mission.decisions import (
    Context,
    Step,
    begin_hold,
    parting,
    reason_text,
)
from companion.mission.events import (
    Battery,
    Command,
    DuplicateId,
    Echo,
    End,
    Estimator,
    Event,
    GpsFix,
    Home,
    Landed,
    LandedState,
    LinkDelay,
    Mode,
    Outcome,
    PlannerDied,
    Position,
    Prepared,
    RequestStreams,
    ScanDone,
    SetMode,
    SetSpeed,
    StatusText,
    StopAsked,
    TakeOffTaken,
    Tick,
    VehicleFound,
    VehicleStatus,
)
from companion.mission.health import distrust, with_battery, with_position, with_position_trust
from companion.mission.state import (
    IN_AIR,
    MOVES,
    ON_GROUND,
    OVER,
    Grounded,
    HoldMode,
    LandOrdered,
    Orders,
    Paused,
    Phase,
    Reason,
    Replan,
    ReturnOrdered,
    Silent,
    State,
    StreamLost,
    TakenOver,
    TakeOver,
    Trigger,
)
from companion.mission.vehicle_traits import UNKNOWN

_AS_IT_SHOULD = {
    Trigger.END_HOLD: "holding",
    Trigger.LANDED: "landed",
    Trigger.HANDED_ON: "its autopilot returns by itself",
}
"""Ends after which the vehicle needs nothing more, and what it is doing then."""


def step(state: State, event: Event, context: Context) -> tuple[State, list[Command]]:
    """Handle one event: the new state and the commands."""
    if state.phase in OVER:
        return state, []
    now_s = max(state.now_s, event.time_s)
    limits = state.task.limits
    if not isinstance(event, Position):
        state = _observed(state, event, now_s, context)
        vehicle = state.vehicle
    elif event.time_s > state.vehicle.position_at_s:
        vehicle = with_position(state.vehicle, event, limits)
    else:
        return replace(state, now_s=now_s), []  # overtaken by a newer one
    reason = distrust(vehicle, now_s, limits)
    if reason is not None or vehicle.distrust is not None:
        vehicle = with_position_trust(vehicle, reason, now_s)
    airborne = state.airborne or (vehicle.armed and vehicle.landed is Landed.IN_AIR)
    state = replace(state, now_s=now_s, vehicle=vehicle, airborne=airborne)
    in_any_phase, step = _IN_ANY_PHASE.get(type(event)), None
    if in_any_phase is not None:
        step = in_any_phase(state, event, context)
    after, commands, trigger = step or IN_PHASE[state.phase](state, event, context)
    if trigger is Trigger.GIVE_UP and not context.shadow:
        after, more, trigger = fallback.fall_back(after, context)
        commands = [*commands, *more]
    phase = None if trigger is None else MOVES.get((after.phase, trigger))
    if trigger is None or phase is None:
        return after, commands
    entered = replace(
        after, phase=phase, hold=None, since_s=after.now_s, asked_at_s=-1e9, asks=0, obeyed=False
    )
    return _enter(entered, after, trigger, context, commands)


def _observed(state: State, event: Event, now_s: float, context: Context) -> State:
    """Update vehicle and terrain by an event, except for positions."""
    vehicle, flight = state.vehicle, state.flight
    match event:
        case Tick():
            return state
        case VehicleFound(traits=traits):
            vehicle = replace(vehicle, traits=traits or UNKNOWN)
        case VehicleStatus(mode=mode, armed=armed, failsafe=failsafe):
            vehicle = replace(
                vehicle, mode=mode, armed=armed, failsafe=failsafe, status_at_s=event.time_s
            )
        case LandedState(landed=landed) if landed is not vehicle.landed:
            vehicle = replace(vehicle, landed=landed, landed_at_s=event.time_s)
        case TakeOffTaken():
            vehicle = replace(vehicle, take_off_taken_at_s=now_s)
        case GpsFix(good=good):
            vehicle = replace(vehicle, fix_good=good, fix_at_s=event.time_s)
        case Estimator(good=good, error_m=error_m):
            failed = vehicle.estimator_good and not good
            failed_at_s = event.time_s if failed else vehicle.estimator_failed_at_s
            vehicle = replace(
                vehicle,
                estimator_good=good,
                estimator_at_s=event.time_s,
                estimator_failed_at_s=failed_at_s,
                error_m=error_m,
            )
        case Home(position_nea_m=home) if not vehicle.home_kept:
            vehicle = replace(vehicle, home_nea_m=home)
        case LinkDelay(round_trip_s=round_trip_s):
            vehicle = replace(vehicle, round_trip_s=round_trip_s)
        case Battery():
            vehicle = with_battery(state, event, context.mission)
        case Echo():
            vehicle = replace(
                vehicle,
                echo_nea_m=event.position_nea_m,
                echo_nea_m_s=event.velocity_nea_m_s,
                echo_at_s=event.time_s,
            )
            flight = following.with_echo(replace(state, now_s=now_s, vehicle=vehicle))
        case DuplicateId(certain=certain):
            state = replace(state, duplicate_id=certain, duplicate_id_at_s=now_s)
        case Prepared(item=item, refusal="") if item not in state.prepared:
            state = replace(state, prepared=state.prepared | {item})
        case ScanDone(scan=scan) if state.phase not in ON_GROUND:  # else it was only to answer
            flight = replace(flight, known=flight.known.with_scan(scan))
        case _:
            pass
    return replace(state, vehicle=vehicle, flight=flight)


def _stop(state: State, _event: StopAsked, _context: Context) -> Step:
    return replace(state, reason=Reason.STOPPED), [], Trigger.STOP


def _died(state: State, event: PlannerDied, _context: Context) -> Step:
    detail = f": {event.error}" if event.error else ""
    return replace(state, reason=Reason.PLANNER_DIED, detail=detail), [], Trigger.DIED


_IN_ANY_PHASE: Final[dict[type[Event], Callable[[State, Any, Context], Step | None]]] = {
    StopAsked: _stop,
    PlannerDied: _died,
    DuplicateId: ground.on_duplicate_id,
    **changes.HANDLERS,
}
"""Handlers of events in any phase; None: also left to the phase."""

IN_PHASE: Final[dict[Phase, Callable[[State, Event, Context], Step]]] = {
    Phase.WAITING: ground.waiting,
    Phase.PREPARING: ground.preparing,
    Phase.READY: ground.ready,
    Phase.ARMING: ground.arming,
    Phase.TAKING_OFF: ground.taking_off,
    Phase.FLYING: flying.flying,
    Phase.RETURNING: backtracking.returning,
    Phase.HOLDING: stopped.holding,
    Phase.ARRIVED: stopped.arrived,
    Phase.LANDING: stopped.landing,
    Phase.HANDING_OVER: fallback.handing_over,
    Phase.SHADOW: watching.shadow,
}
"""The handler of each phase; a mission that is over ignores events."""


def _enter(
    state: State, before: State, trigger: Trigger, context: Context, commands: list[Command]
) -> tuple[State, list[Command]]:
    """The entry actions of a phase."""
    if state.phase in IN_AIR:
        in_control_since_s = state.now_s if before.phase is Phase.PREPARING else -1e9
        state = replace(
            state,
            airborne=True,
            in_control_since_s=min(state.in_control_since_s, in_control_since_s),
        )
    match state.phase:
        case Phase.PREPARING if trigger is Trigger.UNREADY:
            return state, commands
        case Phase.READY:
            says_ready = StatusText(
                text="ready: waits for go: MISSION_START or a yes", about="phase"
            )
            return replace(state, unready=""), [*commands, says_ready]
        case Phase.PREPARING:
            says: list[Command] = [StatusText(text=f"mission {context.mission.name}")]
            news = (stopped.landing_words(state, context), state.news)
            says += [StatusText(text=text, warning=True) for text in news if text]
            return replace(state, news=""), [*commands, RequestStreams(), *says]
        case Phase.FLYING | Phase.LANDING | Phase.RETURNING:
            return _set_out(state, commands)
        case Phase.HOLDING:
            return _hold(state, commands)
        case Phase.ARRIVED:
            flight = following.at_rest_at_end(state.flight)
            state = replace(state, flight=flight)
            return state, [*commands, stopped.reached(state)]
        case Phase.DONE | Phase.FAULTED:
            return state, [*commands, *_ending(before, trigger, context)]
        case _:
            return state, commands


def _set_out(state: State, commands: list[Command]) -> tuple[State, list[Command]]:
    """To fly, back or on, or to land."""
    flight = replace(state.flight, progress_at_s=state.now_s, echoed_at_s=state.now_s)
    state = replace(state, flight=flight, reason=None, taken=False)
    if state.phase is not Phase.FLYING:
        state = replace(state, orders=Orders())
    elif not state.flight.homeward:  # to a target again
        state = replace(state, flight=replace(flight, fallen_back=None))
    if state.phase is Phase.RETURNING:
        went_back = backtracking.start_backtrack(state)
        assert went_back is not None  # whoever triggers it has looked
        state = replace(state, flight=went_back)
        commands = [*commands, StatusText(text="returning", about="phase")]
    if state.phase is not Phase.LANDING and state.vehicle.traits is not UNKNOWN:
        commands = [*commands, SetSpeed(speed_m_s=state.task.limits.speed_m_s)]
    return state, commands


def _hold(state: State, commands: list[Command]) -> tuple[State, list[Command]]:
    """Hold for the reason that there is."""
    reason = state.reason or Reason.NO_PLAN
    state = replace(state, hold=begin_hold(state, reason))
    match state.hold:
        case Paused() | ReturnOrdered() | LandOrdered():
            state = replace(state, orders=replace(state.orders, active=reason))
        case TakenOver():
            state = replace(state, taken=True)
        case HoldMode() | StreamLost() | Grounded() | Silent():
            flight = replace(state.flight, troubles=state.flight.troubles + 1)
            state = replace(state, flight=flight)
        case Replan() | TakeOver() | None:
            pass
    says_so = "" if reason is Reason.TAKEN_OFF else "hold: "
    text = f"{says_so}{reason.text}{reason_text(state, reason)[0]}"
    says: list[Command] = [StatusText(text=text, warning=reason.warns, about="phase")]
    if isinstance(state.hold, HoldMode):
        state = replace(state, asked_at_s=state.now_s)
        says += parting(state) if reason is Reason.BROKEN_OFF else [SetMode(mode=Mode.HOLD)]
    return state, [*commands, *says]


def _ending(before: State, trigger: Trigger, context: Context) -> list[Command]:
    """Put the vehicle on hold, if we control it, and report how the mission ended."""
    end = _end_of(before, trigger)
    if context.shadow or trigger in _AS_IT_SHOULD:
        return [end]
    return [*parting(before, stopped=trigger is Trigger.STOP), end]


def _end_of(before: State, trigger: Trigger) -> End:
    """How the mission ended, in words."""
    fallen_back = before.flight.fallen_back
    if trigger in _AS_IT_SHOULD:
        off_m = stopped.landed_off_m(before) if trigger is Trigger.LANDED else 0.0
        if fallen_back is None and off_m > stopped.lands_within_m(before):
            remedy = "Land it by a landing pattern of its autopilot, or set end.action to hold."
            far = f"landed {off_m:.0f} m from where it was to land"
            return End(outcome=Outcome.FAILED, reason=far, remedy=remedy)
        if fallen_back is None:
            return End(outcome=Outcome.ARRIVED, reason="target reached", remedy="")
        how = _AS_IT_SHOULD[trigger]
        asked = fallen_back in (Reason.RETURN_ASKED, Reason.LAND_ASKED)
        outcome = Outcome.STOPPED if asked else Outcome.FAILED
        detail, remedy = reason_text(before, fallen_back)
        return End(outcome=outcome, reason=f"{how}: {fallen_back.text}{detail}", remedy=remedy)
    reason = before.reason or Reason.NO_PLAN
    outcome = Outcome.STOPPED if trigger is Trigger.STOP else Outcome.FAILED
    text = f"{reason.text}{before.detail}"
    return End(outcome=outcome, reason=text, remedy=before.remedy or reason.remedy)
