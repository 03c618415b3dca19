"""The phases in which the vehicle holds or comes down: holding, arrived, landing, handing over.

What happens to a flight that cannot go on; on the ground, unless mission or pilot decide otherwise:

| the vehicle | `fallback` return | land | hold |
|---|---|---|---|
| may still be led, and a way home is proven | flies it, and lands | lands where it is | holds |
| does not do as it is told, or there is no way back | its autopilot's own return | lands | holds |
| is above where it took off, or does not know where it is | lands | lands | holds |
| cannot be told to land (ArduPlane) | its autopilot's own return | the same | holds |

The first line is `_other_way`; all others come through `tables.fall_back`.  If the vehicle rejects
one of the two modes the other is requested; if it rejects both, hold is requested and the operator
asked to take over.  It is left alone if a pilot has control or it is silent, and if the operator or
a dead part of the companion has ended the mission.
"""

import math

from msgspec.structs import replace

from companion.mission import events, flying, following, way_back
from companion.mission.battery import battery_runs_low, battery_warning, given_up_for_battery
from companion.mission.decisions import (
    AT_M,
    LANDING_ABORTED,
    STOPPED_M_S,
    Context,
    Step,
    ask,
    fault,
    fence_is_given_up,
    give_up,
    held,
    in_phase_s,
    in_words,
    is_at_rest,
    is_grounded,
    is_silent,
    landing_order,
    longest_silence_s,
    preceded,
    waits_for_fence,
    with_hold_reason,
)
from companion.mission.events import Command, Event, Landed, Mode, Position, say, warn
from companion.mission.following import held_here
from companion.mission.health import TRUST_S
from companion.mission.mission import EndAction, Fallback
from companion.mission.state import ON_SETPOINTS, Held, Hold, Orders, Reason, State, Trigger
from companion.mission.tables import is_ours, parting, stays_down, takeover_reason, wanted_fallback
from companion.mission.way_back import begins_at_home, home_ne_m, is_above_home
from companion.planner.recheck import is_touched

FAILSAFE_OVER = "failsafe over: MISSION_START to the companion, or guided mode, goes on"

_TOLD_S = 30.0  # that guided mode is asked for on a person's word
_TROUBLES = 8
_MAX_STOPS = 12  # on the way to one target, for want of a successor
_MAX_STOPS_NEAR = 100  # where sight is short
_PAUSE_S = 2.0  # between attempts to plan from rest
_SENSOR_S = 15.0  # for a sensor to see again, before each of them
_THERE_M = 1.0
_SETTLED = 0.8  # tracking errors: with one it would have left its next path at once
_SETTLE_S = 30.0  # for a vehicle that does not come quite to rest
_HOLD_S = 300.0  # for a position that does not get better
_OBEY_S = 60.0  # for the end action's mode, and for a descent that stands still
_SINKING_M_S = 0.1
_ANSWER_S = 60.0
_ASKS_ABOUT = 2
_CIRCLES = 2.5  # loiter radii: what circles its target is there
_TOLD_TO_STAY_S = 1.0  # a setpoint may be lost: an end in guided mode is told several times
_STAYS_DOWN_S = 10.0  # ten times asked for
_LANDS_WITHIN = 1.5  # loiter radii
_ASKS = 5  # in vain, once a second


def holding(state: State, event: Event, context: Context) -> Step:
    """Stop as the reason allows, and continue when it is gone."""
    if stays_down(state):
        return _stay_down(state)
    if isinstance(event, Position) and (step := flying.circling_near_zone(state)) is not None:
        return step
    match state.hold:
        case Hold.REPLAN | Hold.PAUSED | Hold.RETURN | Hold.LAND:
            return _hold_on_setpoints(state, event, context)
        case Hold.STREAM_LOST:
            return _lead_back(state, event, context)
        case Hold.TAKEN_OVER | Hold.GROUNDED:
            return _while_taken_over(state, event, context)
        case Hold.SILENT:
            return _heard_again(state, event, context)
        case _:
            return _hold_in_its_own_mode(state, event, context)


def broken_off(state: State, reason: Reason) -> Step:
    """Held for another reason from now on, or at an end."""
    if reason in (Reason.DISARMED, Reason.GROUNDED):
        return _over(state, reason)
    if reason is Reason.LINK_LOST or state.hold in ON_SETPOINTS:
        state = held_here(state)
    return (
        taken(state)
        if reason.hold is Hold.TAKEN_OVER
        else (with_hold_reason(state, reason), [], None)
    )


def _over(state: State, how: Reason) -> Step:
    """End on the ground, with what was seen to lead to it."""
    reason, taken = state.reason, state.hold is Hold.TAKEN_OVER
    if reason is None or not (taken or reason.hold is Hold.MODE):
        return give_up(state, how)
    why = None
    if reason is Reason.FAILSAFE and taken:
        late = state.vehicle.bad_at_s > state.since_s
        why = (state.held and state.held.why) or (state.vehicle.last_distrust if late else None)
    remedy = why.remedy if why else how.remedy
    detail = f": {reason.text}" + (f": {why.text}" if why else "")
    return give_up(state, how, detail, reason.remedy if reason.hold is Hold.MODE else remedy)


def _stay_down(state: State) -> Step:
    """End before the flight: out of the take-off mode, and disarmed if we have armed it."""
    vehicle, order = state.vehicle, state.orders.active or Reason.STOPPED
    elsewhere = vehicle.mode not in (Mode.GUIDED, Mode.TAKE_OFF, Mode.HOLD)
    if vehicle.armed and elsewhere:
        return taken(state)
    out = vehicle.mode not in (Mode.TAKE_OFF, Mode.GUIDED)
    down = out and not (vehicle.armed and state.armed_by_us)
    if down and vehicle.status_at_s > state.since_s:
        remedy = "Start again to fly."
        state = replace(state, reason=order, detail=" before it took off", remedy=remedy)
        return state, [], Trigger.STOP
    if in_phase_s(state) > _STAYS_DOWN_S:
        return give_up(state, Reason.NOT_OBEYING)
    return (state, [], None) if elsewhere else ask(state, *parting(state))


def _heard_again(state: State, event: Event, context: Context) -> Step:
    """Prepare again after a silence, which may have concerned some messages only."""
    if in_phase_s(state) > longest_silence_s(state, context):
        return give_up(state, Reason.LINK_LOST)
    heard = isinstance(event, Position) and not is_silent(state)
    return state, [], Trigger.PREPARE_AGAIN if heard else None


def _is_trusted(state: State) -> bool:
    return state.now_s - max(state.vehicle.bad_at_s, state.since_s) > TRUST_S


def _is_elsewhere(state: State) -> bool:
    """Whether the position passes all checks but cannot have been reached."""
    reason = state.vehicle.distrust
    return reason is Reason.POSITION_ELSEWHERE and state.reason is not reason


def _elsewhere(state: State) -> Step:
    """Hold for that, with a text: the previous reason is over."""
    state, says = held(held_here(state), Reason.POSITION_ELSEWHERE)
    return replace(state, taken=False), [says], None


def _while_taken_over(state: State, event: Event, context: Context) -> Step:
    """Another controller flies: send no command until guided mode is selected, or an order comes.

    Also after a failsafe: the autopilot's hold cannot be told from a pilot's.
    """
    if isinstance(event, events.Battery):
        state, warning = battery_warning(state, context.mission)
        return state, warning, None
    known = state.held if state.held and state.hold is Hold.TAKEN_OVER else Held(Hold.GROUNDED)
    told = state.now_s - known.released_at_s < _TOLD_S
    given_back = state.vehicle.mode is Mode.GUIDED or (told and state.vehicle.mode is Mode.HOLD)
    if given_back and _is_elsewhere(state):
        return _elsewhere(state)
    if not _is_trusted(state):
        return held_here(state), [], None
    if state.vehicle.mode is Mode.GUIDED:
        return resumed(held_here(state))
    if told:
        return _ask_for_guided(state, event, context)
    if known.released_at_s > 0.0:
        state = replace(state, held=replace(known, released_at_s=-1e9))
        return state, [warn("guided mode was not taken")], None
    acts = state.reason is not Reason.FAILSAFE or state.vehicle.failsafe
    if acts or known.failsafe_over:
        return state, [], None
    state = replace(state, held=replace(known, failsafe_over=True))
    return state, [warn(FAILSAFE_OVER)], None


def resumed(state: State) -> Step:
    """End of a hold: the active order first; else continue, or backtrack.

    If the backtrack is too far away or blocked, a path home is planned.
    """
    wanted = state.orders.active
    if wanted not in (None, state.reason):
        flight = following.at_rest(state.flight, state.vehicle.position_nea_m)
        return with_hold_reason(replace(state, flight=flight, taken=False), wanted), [], None
    flight = state.flight
    if not flight.returning:
        return state, [], Trigger.RESUME
    clear = not any(is_touched(leg, 0.0, state.task) for leg in flight.back)
    if clear and way_back.begun(state) is not None:
        return state, [], Trigger.BACKTRACK
    reason = flight.fallen_back or state.reason or Reason.NO_PLAN
    return way_back.home_by_plan(state, "returning another way", reason)


def _hold_on_setpoints(state: State, event: Event, context: Context) -> Step:
    """Hold at the end of the leg; retry after a pause, a limited number of times."""
    if isinstance(event, events.PlanReady):
        return way_back.on_plan(state, event, context)
    if not isinstance(event, Position):
        return state, [], None
    if battery_runs_low(state):  # a pause, too, ends before the battery does
        low = with_hold_reason(given_up_for_battery(state), Reason.BATTERY_LOW)
        return low, [warn(f"hold: {Reason.BATTERY_LOW.text}")], None
    state, warning = battery_warning(state, context.mission)
    flight, stay = following.hold_setpoint(state, event.time_s, context)
    state = replace(state, flight=flight)
    if flight.planning_backtrack is not None:
        if state.now_s - flight.planning_backtrack.since_s > _ANSWER_S:
            return give_up(state, state.reason or Reason.NO_PLAN)
        return state, [*warning, *stay], None
    return _end_of_hold(state, event, context, [*warning, *stay])


def _end_of_hold(state: State, event: Position, context: Context, commands: list[Command]) -> Step:
    """What comes after a hold on setpoints, once that is due.

    commands: of the hold, left out where another way is looked for in the same moment.
    """
    hold, near, flight = state.hold, context.mission.near, state.flight
    held_s, settled = in_phase_s(state), _is_settled(state, event)
    moving = not settled and held_s < _SETTLE_S
    pause_s = _PAUSE_S
    if near is not None:  # what it sees now is on the map at once
        pause_s = _SENSOR_S if state.vehicle.sight.is_blind else state.task.settings.planning_time_s
    if hold is Hold.LAND and not moving:
        return preceded(commands, _land_here(state))
    if hold in (Hold.PAUSED, Hold.LAND) or held_s < pause_s or moving:
        return state, commands, None
    if waits_for_fence(state, context):
        if not fence_is_given_up(state):
            return state, commands, None
        return preceded(commands, _other_way(with_hold_reason(state, Reason.FENCE_UNREAD), context))
    low_battery = state.reason is Reason.BATTERY_LOW  # which may have ended a pause
    on_way_back = flight.returning or (low_battery and flight.homeward)
    goes_back = flight.returning or flight.homeward
    if state.vehicle.ground_above_m and not goes_back and hold is Hold.REPLAN:
        if held_s < _SENSOR_S * context.mission.attempts:
            return state, commands, None
        return _other_way(with_hold_reason(state, Reason.GROUND_NEARER), context)
    stops_allowed = _MAX_STOPS if near is None else _MAX_STOPS_NEAR
    tries = flight.failures < context.mission.attempts and flight.stops <= stops_allowed
    if not on_way_back and (hold is Hold.RETURN or not tries):
        return _other_way(state, context)
    hovers = state.vehicle.traits.hovers
    if hovers and (state.reason is Reason.NEW_THREAT or not settled):
        state = held_here(state)  # the band may be another one, or it does not come back
    return preceded(commands, resumed(state))


def _is_settled(state: State, event: Position) -> bool:
    """Whether it is at rest where it is told to be: it may swing through after a hard stop."""
    hover = state.flight.hover_nea_m
    if hover is None or not state.vehicle.traits.hovers or not is_at_rest(state, event):
        return is_at_rest(state, event)
    off_m = math.dist(hover, event.position_nea_m)
    return off_m <= _SETTLED * state.task.limits.tracking_error_m


def _other_way(state: State, context: Context) -> Step:
    """Backtrack if that is the fallback; else as `fall_back` says.

    Not once planning a path home has failed.
    """
    reason, flight = state.reason or Reason.NO_PLAN, state.flight
    how = wanted_fallback(state, context)
    at_home = not flight.flown and is_above_home(state)
    if how is not Fallback.RETURN or flight.homeward or at_home:
        return give_up(state, reason)
    why = in_words(state, reason)
    state = state.with_flight(fallen_back=reason)
    if not flight.flown:
        return way_back.home_by_plan(state, f"{why}: planning a way home", reason, warning=True)
    how_so = "flying back and landing" if begins_at_home(state) else "flying back, then home"
    return preceded([warn(f"{why}: {how_so}", "end")], way_back.request(state, context))


def _hold_in_its_own_mode(state: State, event: Event, context: Context) -> Step:
    """The autopilot holds, until the vehicle is at rest and its position was valid for a while."""
    vehicle, mode, hovers = state.vehicle, state.vehicle.mode, state.vehicle.traits.hovers
    taking_over = state.hold is Hold.TAKE_OVER
    if in_phase_s(state) > _HOLD_S or state.flight.troubles > _TROUBLES:
        return state, [], Trigger.GIVE_UP
    if mode is not Mode.TAKE_OFF and _is_elsewhere(state):
        return _elsewhere(state)
    flies_on = hovers and mode is Mode.GUIDED  # to a target that is not known
    if mode is Mode.HOLD or (taking_over and not flies_on):
        state = replace(state, obeyed=True)
    stands = (
        not hovers
        or math.hypot(*vehicle.velocity_nea_m_s) < STOPPED_M_S
        or in_phase_s(state) > _SETTLE_S
        or state.flight.hover_nea_m is not None
    )
    doubted = vehicle.distrust is not None
    if not state.obeyed or (mode is Mode.GUIDED and (doubted or not stands)):
        return ask(replace(held_here(state), obeyed=False), events.SetMode(mode=Mode.HOLD))
    if stands and mode is Mode.HOLD and state.orders.active is Reason.LAND_ASKED:
        return _land_here(state)
    unled = state.reason is Reason.BROKEN_OFF and state.flight.plan_id == 0
    if unled and mode is Mode.HOLD and state.orders.active is Reason.RETURN_ASKED:
        return give_up(state, Reason.RETURN_ASKED)  # there is no way back but its own
    if not stands or not _is_trusted(state):
        return held_here(state), [], None
    if mode is Mode.GUIDED:
        return resumed(held_here(state))
    return _ask_for_guided(state, event, context)


def _land_here(state: State) -> Step:
    """Land, as ordered."""
    says = say(f"{Reason.LAND_ASKED.text}: landing here", "phase")
    return state.with_flight(fallen_back=Reason.LAND_ASKED), [says], Trigger.END_LAND


def taken(state: State) -> Step:
    """A pilot or the autopilot has taken over."""
    state, says = held(state, takeover_reason(state))
    return replace(state, taken=True), [says], None


def _lead_back(state: State, event: Event, context: Context) -> Step:
    """PX4 returns to OFFBOARD by itself as soon as setpoints arrive again (px4.md 6).

    No mode is requested: if it does not return, it holds for another reason.
    """
    mode = state.vehicle.mode
    if _is_elsewhere(state):
        return _elsewhere(state)
    if not _is_trusted(state):
        return held_here(state), [], None
    if mode is Mode.GUIDED:
        return resumed(held_here(state))
    return _stream_here(state, event, math.inf, context)


def _stream_here(state: State, event: Event, near_m: float, context: Context) -> Step:
    """Setpoints where it holds, or where it is by now if that is farther away."""
    if not isinstance(event, Position):
        return state, [], None
    hover = state.flight.hover_nea_m
    if hover is None or math.dist(hover, event.position_nea_m) > near_m:
        flight = following.at_rest(state.flight, event.position_nea_m)
        state = replace(state, flight=flight)
    flight, stay = following.hold_setpoint(state, event.time_s, context)
    return replace(state, flight=flight), stay, None


def _ask_for_guided(state: State, event: Event, context: Context) -> Step:
    """Request guided mode; with setpoints at the position, for autopilots that need them first."""
    traits, asking = state.vehicle.traits, events.SetMode(mode=Mode.GUIDED)
    if not (traits.hovers or traits.needs_setpoints_before_offboard):
        return ask(state, asking)  # refused before (ardupilot.md 7)
    if not isinstance(event, Position):
        return state, [], None
    near_m = max(AT_M, _CIRCLES * state.task.limits.loiter_radius_m)
    state, stay, _ = _stream_here(state, event, near_m, context)
    return preceded(stay, ask(state, asking))


# --- at the target


def arrived(state: State, event: Event, context: Context) -> Step:
    """Stop at the target; then the next target, or the end action."""
    asked = state.asked_at_s > state.since_s
    if state.vehicle.mode is Mode.HOLD and asked:
        return state, [], Trigger.END_HOLD
    if in_phase_s(state) > _SETTLE_S + _OBEY_S:
        return give_up(state, Reason.NOT_OBEYING if asked else Reason.NOT_FOLLOWING)
    if isinstance(event, events.PlanReady):
        return way_back.on_plan(state, event, context)
    if not isinstance(event, Position):
        return state, [], None
    flight, stay = following.hold_setpoint(state, event.time_s, context)
    state = replace(state, flight=flight)
    if not _stands_at_target(state, event):
        return state, stay, None
    if flight.target + 1 < len(state.targets_ne_m):
        return state.with_flight(target=flight.target + 1, stops=0), stay, Trigger.NEXT_TARGET
    return preceded(stay, _end(state, context))


def _end(state: State, context: Context) -> Step:
    """The mission's end action."""
    traits, action, flight = state.vehicle.traits, context.mission.end_action, state.flight
    if flight.homeward or (action is EndAction.LAND and traits.lands):
        return state, [], Trigger.END_LAND if traits.lands else Trigger.HAND_OVER
    if action is EndAction.RETURN:
        if flight.planning_backtrack is not None:
            return state, [], None
        if flight.flown:
            return way_back.request(state, context)
        return way_back.home_by_plan(state, "returning: planning a way home", Reason.NO_PLAN)
    if traits.holds_in_guided:
        told = in_phase_s(state) > _TOLD_TO_STAY_S
        return state, [], Trigger.END_HOLD if told else None
    # an autopilot may refuse to hold about a point (its own fence): then anywhere
    about = flight.hover_nea_m if state.asks < _ASKS_ABOUT else None
    return ask(state, events.SetMode(mode=Mode.HOLD, at_nea_m=about))


def reached(state: State) -> events.StatusText:
    """Text at a target; for a plane that missed it by too much, with the distance."""
    here, there = state.vehicle.position_nea_m, state.flight.hover_nea_m
    if not state.vehicle.traits.hovers and here is not None and there is not None:
        off_m = math.dist(here[:2], there[:2])
        if off_m > state.task.limits.tracking_error_m:
            return warn(f"target reached: passed {off_m:.0f} m away", "phase")
    return say("target reached", "phase")


def _stands_at_target(state: State, event: Position) -> bool:
    """At rest at the target; after a while, as near to it and as slow as the vehicle can be."""
    here, limits = state.flight.hover_nea_m, state.task.limits
    off = math.inf if here is None else math.dist(event.position_nea_m, here)
    if not state.vehicle.traits.hovers:
        return off < _CIRCLES * limits.loiter_radius_m + limits.tracking_error_m
    if in_phase_s(state) > _SETTLE_S:
        return off < max(AT_M, limits.tracking_error_m)
    return off < _THERE_M and is_at_rest(state, event)


# --- down


def lands_within_m(state: State) -> float:
    """How near to a place the vehicle lands.

    PX4's planes land on a circle about where the mode begins (px4.md 10).
    """
    hovers, radius_m = state.vehicle.traits.hovers, state.task.limits.loiter_radius_m
    return math.inf if hovers else _LANDS_WITHIN * radius_m


def landed_off_m(state: State) -> float:
    """Distance from its last target or return point, metres."""
    here, flight = state.vehicle.position_nea_m, state.flight
    if here is None or not state.targets_ne_m:
        return 0.0
    home = home_ne_m(state) if flight.returning else None
    return math.dist(here[:2], home or state.targets_ne_m[flight.target])


def landing_words(state: State, context: Context) -> str:
    """A warning before take-off about the landing at the target; "": none."""
    traits = state.vehicle.traits
    if context.mission.end_action is not EndAction.LAND or traits.hovers:
        return ""
    if not traits.lands:
        return f"{traits.name} is not told to land: it circles the last target"
    within_m = lands_within_m(state)
    return f"{traits.name} lands on a circle: up to {within_m:.0f} m from the target"


def landing(state: State, event: Event, _context: Context) -> Step:
    """Request the land mode until it is taken, then wait for touchdown."""
    vehicle = state.vehicle
    if vehicle.landed is Landed.ON_GROUND and not vehicle.armed:
        return state, [], Trigger.LANDED
    if isinstance(event, Position) and event.velocity_nea_m_s[2] < -_SINKING_M_S:
        state = state.with_flight(progress_at_s=state.now_s)
    if state.now_s - state.flight.progress_at_s > _OBEY_S:
        return give_up(state, Reason.NOT_OBEYING)
    if vehicle.mode is Mode.LAND:
        return replace(state, obeyed=True), [], None
    if not is_ours(state):  # PX4 holds without setpoints
        if is_grounded(state):
            return state, [], None  # down, and not yet disarmed: the mode is the autopilot's
        return _broken_off(state)
    return ask(state, events.SetMode(mode=Mode.LAND))


def _broken_off(state: State) -> Step:
    """The vehicle has left the land mode: not landed again without an order.

    Hold in place if guided mode was selected; else the pilot has control, and it holds once handed
    back.
    """
    guided = state.vehicle.mode is Mode.GUIDED
    reason = Reason.PAUSED if guided else takeover_reason(state)
    flight = following.at_rest(state.flight, state.vehicle.position_nea_m if guided else None)
    state = replace(state, flight=flight)
    if reason is Reason.FENCE_BREACHED:
        return fault(state, reason)
    state = replace(state, orders=Orders(Reason.PAUSED, landing_order(state)))
    return preceded([warn(LANDING_ABORTED)], fault(state, reason))


def handing_over(state: State, _event: Event, _context: Context) -> Step:
    """Request RTL until the autopilot takes it; from then on the autopilot is in control."""
    vehicle = state.vehicle
    if is_silent(state):
        return state, [], None
    if vehicle.mode is Mode.RETURN:
        return state, [], Trigger.HANDED_ON
    if not vehicle.armed or is_grounded(state):
        return give_up(state, Reason.GROUNDED if vehicle.armed else Reason.DISARMED)
    if not is_ours(state):
        return give_up(state, takeover_reason(state))
    asked = ask(state, events.SetMode(mode=Mode.RETURN))
    return give_up(asked[0], Reason.NOT_OBEYING) if asked[0].asks > _ASKS else asked
