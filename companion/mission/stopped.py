"""The phases in which the vehicle holds or lands: holding, arrived, landing."""

import math

from msgspec.structs import replace

from companion.mission import circling, ends, flying, following, returning
from companion.mission.decisions import (
    AT_M,
    BROKEN_OFF,
    STOPPED_M_S,
    Context,
    Step,
    ask,
    because,
    cannot_fly,
    fault,
    give_up,
    in_phase_s,
    is_at_rest,
    is_gone,
    is_grounded,
    is_silent,
    longest_silence_s,
    taken_by,
    words,
)
from companion.mission.events import (
    Battery,
    Command,
    Event,
    Landed,
    LinkLost,
    Mode,
    PlanReady,
    Position,
    Say,
    SetMode,
)
from companion.mission.health import TRUST_S
from companion.mission.mission import EndAction, Fallback
from companion.mission.state import (
    Down,
    GoBack,
    HoldMode,
    OnSetpoints,
    Orders,
    Paused,
    Reason,
    Replan,
    Silent,
    State,
    StreamLost,
    Taken,
    TakeOver,
    Trigger,
)
from companion.planner.recheck import is_touched

FAILSAFE_OVER = "failsafe over: MISSION_START to the companion, or guided mode, goes on"

_BREACH_S = 5.0  # from what the autopilot does to what it says
_TOLD_S = 30.0  # that guided mode is asked for on a person's word
_LEADS_BACK_S = 30.0  # a link that comes back later finds a vehicle that holds
_TROUBLES = 8
_PAUSE_S = 2.0  # between attempts to plan from rest
_THERE_M = 1.0
_SETTLE_S = 30.0  # for a vehicle that does not come quite to rest
_HOLD_S = 300.0  # for a position that does not get better
_OBEY_S = 60.0  # for the end action's mode, and for a descent that stands still
_SINKING_M_S = 0.1
_ANSWER_S = 60.0
_ASKS_ABOUT = 2
_CIRCLES = 2.5  # loiter radii: what circles its target is there
_TOLD_TO_STAY_S = 1.0  # a setpoint may be lost: an end in guided mode is told several times
_LANDS_WITHIN = 1.5  # loiter radii


def holding(state: State, event: Event, context: Context) -> Step:
    """Stop in a way that the reason allows, and go on when it is gone."""
    if isinstance(event, Position):
        step = fence_breached(state) or circling.kept_clear(state, event)
        if step is not None:
            return step
    hold = state.hold
    if is_gone(state, event, context):
        return give_up(state, Reason.LINK_LOST)
    if isinstance(event, LinkLost) or (is_silent(state) and not isinstance(hold, Silent)):
        return because(_anew(state), Reason.LINK_LOST), [], None
    if not state.vehicle.armed:
        return give_up(state, Reason.DISARMED)
    if is_grounded(state):
        return give_up(state, Reason.GROUNDED)
    match hold:
        case Replan() | Paused() | GoBack():
            return _hold_on_setpoints(state, event, context, hold)
        case HoldMode() | TakeOver() | None:
            return _hold_in_its_own_mode(state, event, context)
        case StreamLost():
            return _lead_back(state, event, context)
        case Taken():
            return _let_go(state, event, context, hold)
        case Down():
            return _let_go(state, event, context, Taken())
        case Silent():
            return _heard_again(state, event, context)


def fence_breached(state: State) -> Step | None:
    """A hold that the vehicle's own fence is the reason for, as it turns out; None: it is not.

    PX4's was a loss of setpoints at first sight; and a fence drawn in flight is known to the
    autopilot before the companion has read it.
    """
    if not isinstance(state.hold, Taken | StreamLost) or state.reason is Reason.FENCE_BREACHED:
        return None
    by_itself = state.vehicle.failsafe or in_phase_s(state) < _BREACH_S
    if not by_itself or taken_by(state) is not Reason.FENCE_BREACHED:
        return None
    return _taken(state)


def _heard_again(state: State, event: Event, context: Context) -> Step:
    """After a silence everything is prepared again; it may be of a part of the messages only."""
    if in_phase_s(state) > longest_silence_s(state, context):
        return give_up(state, Reason.LINK_LOST)
    if isinstance(event, Position) and not is_silent(state):
        return state, [], Trigger.PREPARE_AGAIN
    return state, [], None


def _is_trusted(state: State) -> bool:
    return state.now_s - max(state.vehicle.bad_at_s, state.since_s) > TRUST_S


def _is_elsewhere(state: State) -> bool:
    """Whether all vouch for a position at which the vehicle cannot be."""
    reason = state.vehicle.distrust
    return reason is Reason.POSITION_ELSEWHERE and state.reason is not reason


def _elsewhere(state: State) -> Step:
    """Hold on for that, and say so: what it was held for until now is over."""
    reason = Reason.POSITION_ELSEWHERE
    says = Say(text=f"hold: {reason.text}{words(state, reason)[0]}", warning=True, about="phase")
    return replace(because(_anew(state), reason), taken=False), [says], None


def _let_go(state: State, event: Event, context: Context, hold: Taken) -> Step:
    """Somebody else flies: command nothing until they select guided mode, or a person says so.

    After a failsafe too: that its autopilot holds again looks just as if a pilot had chosen to.
    """
    if isinstance(event, Battery):
        state, warning = flying.battery_warning(state, context)
        return state, warning, None
    told = state.now_s - hold.told_at_s < _TOLD_S
    given_back = state.vehicle.mode is Mode.GUIDED or (told and state.vehicle.mode is Mode.HOLD)
    if given_back and _is_elsewhere(state):
        return _elsewhere(state)
    if not _is_trusted(state):
        return _anew(state), [], None
    if state.vehicle.mode is Mode.GUIDED:
        return resumed(_anew(state))
    if told:
        return _ask_for_guided(state, event, context)
    if hold.told_at_s > 0.0:
        says = Say(text="guided mode was not taken", warning=True)
        return replace(state, hold=replace(hold, told_at_s=-1e9)), [says], None
    acts = state.reason is not Reason.FAILSAFE or state.vehicle.failsafe
    if acts or hold.failsafe_over:
        return state, [], None
    state = replace(state, hold=replace(hold, failsafe_over=True))
    return state, [Say(text=FAILSAFE_OVER, warning=True)], None


def resumed(state: State) -> Step:
    """A hold is over: what a person wants comes first; else go on, or back.

    Too far from the way back, or with a threat on it, home is planned to like any target.
    """
    wanted = state.orders.active
    if wanted not in (None, state.reason):
        flight = following.at_rest(state.flight, state.vehicle.position_nea_m)
        return because(replace(state, flight=flight, taken=False), wanted), [], None
    flight = state.flight
    if not flight.returning:
        return state, [], Trigger.RESUME
    clear = not any(is_touched(leg, 0.0, state.task) for leg in flight.back)
    if clear and returning.began(state) is not None:
        return state, [], Trigger.GO_BACK
    return returning.homeward(state), [Say(text="returning another way")], Trigger.RESUME


def _hold_on_setpoints(state: State, event: Event, context: Context, hold: OnSetpoints) -> Step:
    """Stay at the end of the leg; try again after a pause, and not for ever."""
    reason = cannot_fly(state, event)
    if reason is not None and reason.hold is Taken:
        return _taken(_anew(state))
    if reason is not None:
        return because(_anew(state), reason), [], None
    if isinstance(event, PlanReady):
        return _way_back(state, event, context)
    if not isinstance(event, Position):
        return state, [], None
    if flying.runs_low(state):  # a pause, too, ends before the battery does
        low = because(flying.given_up_for_battery(state), Reason.BATTERY_LOW)
        return low, [Say(text=f"hold: {Reason.BATTERY_LOW.text}", warning=True)], None
    state, warning = flying.battery_warning(state, context)
    flight, commands = following.hold_setpoint(state, event.time_s, context)
    commands, state = [*warning, *commands], replace(state, flight=flight)
    if flight.planning_back is not None:
        if state.now_s - flight.planning_back.since_s > _ANSWER_S:
            return give_up(state, state.reason or Reason.NO_PLAN)
        return state, commands, None
    moving = not is_at_rest(state, event) and in_phase_s(state) < _SETTLE_S
    if isinstance(hold, Paused) or in_phase_s(state) < _PAUSE_S or moving:
        return state, commands, None
    on_way_back = _is_on_way_back(state)
    if isinstance(hold, GoBack) and not on_way_back:
        return _other_way(state, context)
    flight = state.flight
    tries = flight.failures < context.mission.attempts and flight.stops <= flying.MOST_STOPS
    if on_way_back or tries:
        if state.reason is Reason.NEW_THREAT and state.vehicle.driving.hovers:
            state = _anew(state)  # the band may be another one
        state, says, trigger = resumed(state)
        return state, [*commands, *says], trigger
    return _other_way(state, context)


def _way_back(state: State, event: PlanReady, context: Context) -> Step:
    """The way back is there; or else by the rules that it was flown by; or else there is none."""
    flight, asked = state.flight, state.flight.planning_back
    if asked is None or event.outcome.plan_id != flight.plan_id:
        return state, [], None
    if asked.rules is not state.task:  # it was proven under other rules
        return returning.ask(state, context)
    back = returning.answered(state, event)
    whole = back is not None and back.legs[-1].reaches_target
    if not whole and (looser := returning.as_flown(state)) is not None:
        state, asking, trigger = returning.ask(looser[0], context)
        return state, [Say(text=looser[1], warning=True), *asking], trigger
    if back is not None:
        after = replace(state, flight=replace(flight, way=back, planning_back=None))
        if returning.began(after) is not None:
            return after, [], Trigger.GO_BACK
    return give_up(state, state.reason or Reason.NO_PLAN)


def _is_on_way_back(state: State) -> bool:
    """Whether the way back is in hand, or was when the battery ended a pause on it."""
    low = state.reason is Reason.BATTERY_LOW
    return state.flight.returning or (low and state.flight.homeward)


def _other_way(state: State, context: Context) -> Step:
    """The way that was flown, back, if that is the fallback; else, or without one, as `ends` says.

    Once home has been planned to in vain there is none.
    """
    reason, flight = state.reason or Reason.NO_PLAN, state.flight
    how = ends.wanted(state, context)
    if how is not Fallback.RETURN or not flight.flown or flight.homeward:
        return give_up(state, reason)
    state = replace(state, flight=replace(flight, fallen_back=reason))
    state, asking, trigger = returning.ask(state, context)
    text = f"{reason.text}{words(state, reason)[0]}: flying back and landing"
    return state, [Say(text=text, warning=True, about="end"), *asking], trigger


def _hold_in_its_own_mode(state: State, event: Event, context: Context) -> Step:
    """The autopilot holds, until it stands and its position was good for a while."""
    vehicle, mode = state.vehicle, state.vehicle.mode
    taking_over = isinstance(state.hold, TakeOver)
    if mode not in (Mode.GUIDED, Mode.HOLD) and not (taking_over and mode is Mode.TAKE_OFF):
        return _taken(state)
    if in_phase_s(state) > _HOLD_S or state.flight.troubles > _TROUBLES:
        return state, [], Trigger.GIVE_UP
    if mode is not Mode.TAKE_OFF and _is_elsewhere(state):
        return _elsewhere(state)
    if mode is Mode.HOLD or (taking_over and not _must_stop_first(state)):
        state = replace(state, obeyed=True)
    doubted = vehicle.distrust is not None
    stands = not vehicle.driving.hovers or math.hypot(*vehicle.velocity_nea_m_s) < STOPPED_M_S
    stands = stands or in_phase_s(state) > _SETTLE_S or state.flight.hover_nea_m is not None
    if not state.obeyed or (mode is Mode.GUIDED and (doubted or not stands)):
        return ask(replace(_anew(state), obeyed=False), SetMode(mode=Mode.HOLD))
    if not stands or not _is_trusted(state):
        return _anew(state), [], None
    if mode is Mode.GUIDED:
        return resumed(_anew(state))
    return _ask_for_guided(state, event, context)


def _taken(state: State) -> Step:
    """Somebody else flies it from now on, or its autopilot does."""
    reason = taken_by(state)
    says = Say(text=f"hold: {reason.text}", warning=True, about="phase")
    return replace(because(state, reason), taken=True), [says], None


def _lead_back(state: State, event: Event, context: Context) -> Step:
    """PX4 goes back to guided mode by itself as soon as setpoints come in again (px4.md 6).

    Nothing is asked of it: if it does not, it holds for another reason.
    """
    mode = state.vehicle.mode
    if mode not in (Mode.GUIDED, Mode.HOLD) or in_phase_s(state) > _LEADS_BACK_S:
        return _taken(state)
    if _is_elsewhere(state):
        return _elsewhere(state)
    if not _is_trusted(state):
        return _anew(state), [], None
    if mode is Mode.GUIDED:
        return resumed(_anew(state))
    if not isinstance(event, Position):
        return state, [], None
    if state.flight.hover_nea_m is None:
        flight = following.at_rest(state.flight, event.position_nea_m)
        state = replace(state, flight=flight)
    flight, stay = following.hold_setpoint(state, event.time_s, context)
    return replace(state, flight=flight), stay, None


def _anew(state: State) -> State:
    """Where to wait for a leg is chosen again: it may be too low where the vehicle was held."""
    return replace(state, flight=following.at_rest(state.flight, None))


def _must_stop_first(state: State) -> bool:
    """Whether it flies somewhere that nobody knows: what hovers, in guided mode."""
    return state.vehicle.driving.hovers and state.vehicle.mode is Mode.GUIDED


def _ask_for_guided(state: State, event: Event, context: Context) -> Step:
    """Ask for guided mode; with setpoints for where it is, of autopilots that want them first."""
    driving = state.vehicle.driving
    if not (driving.hovers or driving.streams_first):
        return ask(state, SetMode(mode=Mode.GUIDED))  # refused before (ardupilot.md 7)
    if not isinstance(event, Position):
        return state, [], None
    hover, limits = state.flight.hover_nea_m, state.task.limits
    near_m = max(AT_M, _CIRCLES * limits.loiter_radius_m)
    if hover is None or math.dist(hover, event.position_nea_m) > near_m:
        flight = following.at_rest(state.flight, event.position_nea_m)
        state = replace(state, flight=flight)
    flight, stay = following.hold_setpoint(state, event.time_s, context)
    state, asking, _ = ask(replace(state, flight=flight), SetMode(mode=Mode.GUIDED))
    return state, [*stay, *asking], None


def arrived(state: State, event: Event, context: Context) -> Step:
    """Stop at the target; then the next target, or the end action."""
    vehicle, asked = state.vehicle, state.asked_at_s > state.since_s
    if vehicle.mode is Mode.HOLD and asked:
        return state, [], Trigger.END_HOLD
    if is_gone(state, event, context):
        return give_up(state, Reason.LINK_LOST)
    reason = cannot_fly(state, event)
    if reason is not None:
        return fault(replace(state, flight=following.at_rest(state.flight, None)), reason)
    if in_phase_s(state) > _SETTLE_S + _OBEY_S:
        return give_up(state, Reason.NOT_OBEYING if asked else Reason.NOT_FOLLOWING)
    if isinstance(event, PlanReady):
        return _way_back(state, event, context)
    if not isinstance(event, Position):
        return state, [], None
    flight, commands = following.hold_setpoint(state, event.time_s, context)
    state = replace(state, flight=flight)
    if not _stands_at_target(state, event):
        return state, commands, None
    if state.flight.target + 1 < len(state.targets_ne_m):
        flight = replace(state.flight, target=state.flight.target + 1, stops=0)
        return replace(state, flight=flight), commands, Trigger.NEXT_TARGET
    return _end(state, context, commands)


def _end(state: State, context: Context, commands: list[Command]) -> Step:
    """The mission's end action."""
    driving, action = state.vehicle.driving, context.mission.end_action
    if state.flight.homeward:
        action = EndAction.LAND
    if action is EndAction.LAND and (driving.lands or state.flight.homeward):
        return state, commands, Trigger.END_LAND if driving.lands else Trigger.HAND_OVER
    if action is EndAction.RETURN and state.flight.flown:
        if state.flight.planning_back is not None:
            return state, commands, None
        state, asking, _ = returning.ask(state, context)
        return state, [*commands, *asking], None
    if driving.holds_in_guided:
        told = in_phase_s(state) > _TOLD_TO_STAY_S
        return state, commands, Trigger.END_HOLD if told else None
    # an autopilot may refuse to hold about a point (its own fence): then anywhere
    about = state.flight.hover_nea_m if state.asks < _ASKS_ABOUT else None
    state, asking, _ = ask(state, SetMode(mode=Mode.HOLD, at_nea_m=about))
    return state, [*commands, *asking], None


def reached(state: State) -> Say:
    """What is said at a target: of a plane that has passed it farther away than it should, that."""
    limits, here, there = state.task.limits, state.vehicle.position_nea_m, state.flight.hover_nea_m
    if not state.vehicle.driving.hovers and here is not None and there is not None:
        off_m = math.dist(here[:2], there[:2])
        if off_m > limits.tracking_error_m:
            text = f"target reached: passed {off_m:.0f} m away"
            return Say(text=text, warning=True, about="phase")
    return Say(text="target reached", about="phase")


def lands_within_m(state: State) -> float:
    """How near to a place the vehicle comes down where it is told to land there.

    PX4's planes land on a circle about where the mode begins (px4.md 10).
    """
    return (
        math.inf
        if state.vehicle.driving.hovers
        else _LANDS_WITHIN * state.task.limits.loiter_radius_m
    )


def landed_off_m(state: State) -> float:
    """How far from its last target, or from where it was to return to, metres."""
    here, flight = state.vehicle.position_nea_m, state.flight
    if here is None or not state.targets_ne_m:
        return 0.0
    place = state.targets_ne_m[flight.target]
    if flight.returning and flight.flown:
        north, east, _ = flight.flown[0].control_nea_m[0]
        place = (float(north), float(east))
    return math.dist(here[:2], place)


def landing_words(state: State, context: Context) -> str:
    """What a person should know before take-off of a landing at the target; "": nothing."""
    driving = state.vehicle.driving
    if context.mission.end_action is not EndAction.LAND or driving.hovers:
        return ""
    if not driving.lands:
        return f"{driving.name} is not told to land: it circles the last target"
    within_m = lands_within_m(state)
    return f"{driving.name} lands on a circle: up to {within_m:.0f} m from the target"


def _stands_at_target(state: State, event: Position) -> bool:
    """At rest there; after a while, as near to it and to rest as the vehicle can be."""
    here, limits = state.flight.hover_nea_m, state.task.limits
    off = math.inf if here is None else math.dist(event.position_nea_m, here)
    if not state.vehicle.driving.hovers:
        return off < _CIRCLES * limits.loiter_radius_m + limits.tracking_error_m
    if in_phase_s(state) > _SETTLE_S:
        return off < max(AT_M, limits.tracking_error_m)
    return off < _THERE_M and is_at_rest(state, event)


def landing(state: State, event: Event, context: Context) -> Step:
    """Ask for the land mode until it is taken, then wait for the ground."""
    vehicle = state.vehicle
    if vehicle.landed is Landed.ON_GROUND and not vehicle.armed:
        return state, [], Trigger.LANDED
    if is_gone(state, event, context):
        return give_up(state, Reason.LINK_LOST)
    if isinstance(event, Position) and event.velocity_nea_m_s[2] < -_SINKING_M_S:
        state = replace(state, flight=replace(state.flight, progress_at_s=state.now_s))
    if state.now_s - state.flight.progress_at_s > _OBEY_S:
        return give_up(state, Reason.NOT_OBEYING)
    if vehicle.mode is Mode.LAND:
        return replace(state, obeyed=True), [], None
    if state.obeyed or vehicle.mode not in (Mode.GUIDED, Mode.HOLD):  # PX4 holds without setpoints
        if is_grounded(state):
            return state, [], None  # down, and not yet disarmed: the mode is the autopilot's
        return _broken_off(state)
    return ask(state, SetMode(mode=Mode.LAND))


def _broken_off(state: State) -> Step:
    """It has left the land mode: it is not landed again before a person says so.

    Held where it is if they selected guided mode; else it is theirs, and held once given back.
    """
    guided = state.vehicle.mode is Mode.GUIDED
    reason = Reason.PAUSED if guided else taken_by(state)
    flight = following.at_rest(state.flight, state.vehicle.position_nea_m if guided else None)
    state = replace(state, flight=flight)
    if reason is Reason.FENCE_BREACHED:
        return fault(state, reason)
    state, commands, trigger = fault(replace(state, orders=Orders(Reason.PAUSED)), reason)
    return state, [*commands, Say(text=BROKEN_OFF, warning=True)], trigger
