"""The mission machine: (state, event) -> (state, commands).  The only way a mission changes.

An event first updates vehicle and terrain.  Then comes what others want, then what is wrong
(`tables.FAULTS`), then what the phase does; a trigger changes the phase by the table in `state`,
and the new phase begins with its own commands.  No clock, no I/O: times are those of the events.
"""

from collections.abc import Callable
from typing import Any, Final

from msgspec.structs import replace

from companion.mission import changes, events, flying, following, ground, stopped, way_back
from companion.mission import shadow as watching
from companion.mission.battery import with_battery
from companion.mission.decisions import (
    HEARTBEAT_S,
    Context,
    Step,
    fault,
    give_up,
    held,
    longest_silence_s,
    reason_text,
)
from companion.mission.events import Command, End, Event, Landed, Mode, Outcome, SetMode, say, warn
from companion.mission.following import held_here
from companion.mission.health import distrust, with_position, with_position_trust
from companion.mission.state import (
    IN_AIR,
    ON_GROUND,
    OVER,
    Hold,
    Orders,
    Phase,
    Reason,
    State,
    Trigger,
)
from companion.mission.tables import fall_back, fault_of, parting
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
    now_s, limits = max(state.now_s, event.time_s), state.task.limits
    if not isinstance(event, events.Position):
        state = _observed(replace(state, now_s=now_s), event, context)
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
    others = _IN_ANY_PHASE.get(type(event))
    decided = None if others is None else others(state, event, context)
    is_well = (  # as it mostly is: then no row of the table is true
        vehicle.mode is Mode.GUIDED
        and vehicle.armed
        and vehicle.landed is Landed.IN_AIR
        and vehicle.distrust is None
        and now_s - vehicle.status_at_s <= HEARTBEAT_S
        and state.held is None
        and others is None
    )
    if decided is None and not is_well:
        reason = fault_of(state, event)
        decided = None if reason is None else _BREAK_OFF[state.phase](state, reason)
    after, commands, trigger = decided or IN_PHASE[state.phase](state, event, context)
    if trigger is Trigger.GIVE_UP and not context.shadow:
        after, more, trigger = fall_back(after, context)
        commands = [*commands, *more]
    if trigger is None or after.phase not in trigger.origins:
        return after, commands
    return _enter(after, trigger, context, commands)


def _observed(state: State, event: Event, context: Context) -> State:
    """Update vehicle and terrain by an event, except for positions."""
    vehicle, now_s, told_s = state.vehicle, state.now_s, event.time_s
    match event:
        case events.VehicleFound(traits=traits):
            return state.told(traits=traits or UNKNOWN)
        case events.VehicleStatus(mode=mode, armed=armed, failsafe=failsafe):
            return state.told(mode=mode, armed=armed, failsafe=failsafe, status_at_s=told_s)
        case events.LandedState(landed=landed) if landed is not vehicle.landed:
            return state.told(landed=landed, landed_at_s=told_s)
        case events.TakeOffTaken():
            return state.told(take_off_taken_at_s=now_s)
        case events.GpsFix(good=good):
            return state.told(fix_good=good, fix_at_s=told_s)
        case events.Estimator(good=good, error_m=error_m):
            failed = vehicle.estimator_good and not good
            return state.told(
                estimator_good=good,
                estimator_at_s=told_s,
                estimator_failed_at_s=told_s if failed else vehicle.estimator_failed_at_s,
                error_m=error_m,
            )
        case events.Home(position_nea_m=home) if not vehicle.home_kept:
            return state.told(home_nea_m=home)
        case events.LinkDelay(round_trip_s=round_trip_s):
            return state.told(round_trip_s=round_trip_s)
        case events.Battery():
            return replace(state, vehicle=with_battery(state, event, context.mission))
        case events.Echo(position_nea_m=place, velocity_nea_m_s=velocity):
            state = state.told(echo_nea_m=place, echo_nea_m_s=velocity, echo_at_s=told_s)
            return replace(state, flight=following.with_echo(state))
        case events.DuplicateId(certain=certain):
            return replace(state, duplicate_id=certain, duplicate_id_at_s=now_s)
        case events.Prepared(item=item, refusal="") if item not in state.prepared:
            return replace(state, prepared=state.prepared | {item})
        case events.ScanDone(scan=scan) if state.phase not in ON_GROUND:  # else only to answer
            return state.with_flight(known=state.flight.known.with_scan(scan))
        case _:
            return state


def _stop(state: State, _event: events.StopAsked, _context: Context) -> Step:
    return replace(state, reason=Reason.STOPPED), [], Trigger.STOP


def _died(state: State, event: events.PlannerDied, _context: Context) -> Step:
    detail = f": {event.error}" if event.error else ""
    return replace(state, reason=Reason.PLANNER_DIED, detail=detail), [], Trigger.DIED


def _link_lost(state: State, event: events.LinkLost, context: Context) -> Step | None:
    """Before the flight a silence ends the mission at once, later once it is too long."""
    phase = state.phase
    if phase in (Phase.READY, Phase.TAKING_OFF):
        return None
    early = phase is Phase.ARMING or (phase is Phase.PREPARING and not state.airborne)
    if phase is Phase.WAITING:
        return give_up(state, Reason.NO_VEHICLE)
    if early or event.silent_s >= longest_silence_s(state, context):
        return give_up(state, Reason.LINK_LOST)
    return (state, [], None) if phase is Phase.PREPARING else None


_IN_ANY_PHASE: Final[dict[type[Event], Callable[[State, Any, Context], Step | None]]] = {
    events.StopAsked: _stop,
    events.PlannerDied: _died,
    events.LinkLost: _link_lost,
    events.DuplicateId: ground.on_duplicate_id,
    **changes.HANDLERS,
}
"""Handlers of events in any phase; None: also left to the phase."""

_BREAK_OFF: Final[dict[Phase, Callable[[State, Reason], Step]]] = {
    Phase.TAKING_OFF: ground.take_off_broken_off,
    Phase.FLYING: lambda state, reason: fault(held_here(state), reason),
    Phase.RETURNING: lambda state, reason: fault(way_back.stopped(state), reason),
    Phase.ARRIVED: lambda state, reason: fault(held_here(state), reason),
    Phase.HOLDING: stopped.broken_off,
}
"""What follows in each phase from a row of `tables.FAULTS`."""

IN_PHASE: Final[dict[Phase, Callable[[State, Event, Context], Step]]] = {
    Phase.WAITING: ground.waiting,
    Phase.PREPARING: ground.preparing,
    Phase.READY: ground.ready,
    Phase.ARMING: ground.arming,
    Phase.TAKING_OFF: ground.taking_off,
    Phase.FLYING: flying.flying,
    Phase.RETURNING: flying.returning,
    Phase.HOLDING: stopped.holding,
    Phase.ARRIVED: stopped.arrived,
    Phase.LANDING: stopped.landing,
    Phase.HANDING_OVER: stopped.handing_over,
    Phase.SHADOW: watching.shadow,
}
"""The handler of each phase; a mission that is over ignores events."""


def _enter(
    before: State, trigger: Trigger, context: Context, commands: list[Command]
) -> tuple[State, list[Command]]:
    """The next phase, and what it begins with."""
    phase, now_s = trigger.after, before.now_s
    state = replace(
        before, phase=phase, held=None, since_s=now_s, asked_at_s=-1e9, asks=0, obeyed=False
    )
    if phase in IN_AIR:
        since_s = now_s if before.phase is Phase.PREPARING else -1e9
        since_s = min(state.in_control_since_s, since_s)
        state = replace(state, airborne=True, in_control_since_s=since_s)
    says: list[Command] = []
    match phase:
        case Phase.READY:
            state = replace(state, unready="")
            says = [say("ready: waits for go: MISSION_START or a yes", "phase")]
        case Phase.PREPARING if trigger is not Trigger.UNREADY:
            news = (stopped.landing_words(state, context), state.news)
            says = [events.RequestStreams(), say(f"mission {context.mission.name}")]
            says += [warn(text) for text in news if text]
            state = replace(state, news="")
        case Phase.FLYING | Phase.LANDING | Phase.RETURNING:
            state, says = _set_out(state)
        case Phase.HOLDING:
            state, says = _hold(state)
        case Phase.ARRIVED:
            state = replace(state, flight=following.at_rest_at_end(state.flight))
            says = [stopped.reached(state)]
        case Phase.DONE | Phase.FAULTED:
            if not (context.shadow or trigger in _AS_IT_SHOULD):
                says += parting(before, stopped=trigger is Trigger.STOP)
            says.append(_end_of(before, trigger))
        case _:
            pass
    return state, [*commands, *says]


def _set_out(state: State) -> tuple[State, list[Command]]:
    """To fly, back or on, or to land."""
    says: list[Command] = []
    state = replace(state, reason=None, taken=False)
    state = state.with_flight(progress_at_s=state.now_s, echoed_at_s=state.now_s)
    if state.phase is not Phase.FLYING:
        state = replace(state, orders=Orders())
    elif not state.flight.homeward:  # to a target again
        state = state.with_flight(fallen_back=None)
    if state.phase is Phase.RETURNING:
        went_back = way_back.begun(state)
        assert went_back is not None  # whoever triggers it has looked
        state, says = replace(state, flight=went_back), [say("returning", "phase")]
    if state.phase is not Phase.LANDING and state.vehicle.traits is not UNKNOWN:
        says.append(events.SetSpeed(speed_m_s=state.task.limits.speed_m_s))
    return state, says


def _hold(state: State) -> tuple[State, list[Command]]:
    """Hold for the reason that there is."""
    reason = state.reason or Reason.NO_PLAN
    state, says_so = held(state, reason)
    match state.hold:
        case Hold.PAUSED | Hold.RETURN | Hold.LAND:
            state = replace(state, orders=replace(state.orders, active=reason))
        case Hold.TAKEN_OVER:
            state = replace(state, taken=True)
        case Hold.MODE | Hold.STREAM_LOST | Hold.GROUNDED | Hold.SILENT:
            state = state.with_flight(troubles=state.flight.troubles + 1)
        case _:
            pass
    says: list[Command] = [says_so]
    if state.hold is Hold.MODE:
        state = replace(state, asked_at_s=state.now_s)
        says += parting(state) if reason is Reason.BROKEN_OFF else [SetMode(mode=Mode.HOLD)]
    return state, says


def _end_of(before: State, trigger: Trigger) -> End:
    """How the mission ended, in words."""
    fallen_back, how = before.flight.fallen_back, _AS_IT_SHOULD.get(trigger)
    if how is None:
        reason = before.reason or Reason.NO_PLAN
        outcome = Outcome.STOPPED if trigger is Trigger.STOP else Outcome.FAILED
        text, remedy = f"{reason.text}{before.detail}", before.remedy or reason.remedy
        return End(outcome=outcome, reason=text, remedy=remedy)
    if fallen_back is not None:
        asked = fallen_back in (Reason.RETURN_ASKED, Reason.LAND_ASKED)
        outcome = Outcome.STOPPED if asked else Outcome.FAILED
        detail, remedy = reason_text(before, fallen_back)
        return End(outcome=outcome, reason=f"{how}: {fallen_back.text}{detail}", remedy=remedy)
    off_m = stopped.landed_off_m(before) if trigger is Trigger.LANDED else 0.0
    if off_m > stopped.lands_within_m(before):
        remedy = "Land it by a landing pattern of its autopilot, or set end.action to hold."
        far = f"landed {off_m:.0f} m from where it was to land"
        return End(outcome=Outcome.FAILED, reason=far, remedy=remedy)
    return End(outcome=Outcome.ARRIVED, reason="target reached", remedy="")
