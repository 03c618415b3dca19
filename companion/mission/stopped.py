"""The phases in which the vehicle holds or lands: holding, arrived, landing."""

import math

from msgspec.structs import replace

from companion.mission import backtracking, fallback, flying, following
from companion.mission.decisions import (
    AT_M,
    LANDING_ABORTED,
    STOPPED_M_S,
    Context,
    Step,
    ask,
    cannot_fly,
    fault,
    fence_is_given_up,
    give_up,
    in_phase_s,
    is_at_rest,
    is_gone,
    is_grounded,
    is_own_takeoff,
    is_silent,
    landing_order,
    longest_silence_s,
    parting,
    preceded,
    reason_text,
    takeover_reason,
    waits_for_fence,
    with_hold_reason,
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
    SetMode,
    StatusText,
)
from companion.mission.health import TRUST_S
from companion.mission.home import begins_at_home, home_ne_m, is_above_home
from companion.mission.mission import EndAction, Fallback
from companion.mission.state import (
    Grounded,
    HoldMode,
    LandOrdered,
    OnSetpoints,
    Orders,
    Paused,
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
from companion.planner.recheck import is_touched

FAILSAFE_OVER = "failsafe over: MISSION_START to the companion, or guided mode, goes on"

_BREACH_S = 5.0  # from what the autopilot does to what it says
_TOLD_S = 30.0  # that guided mode is asked for on a person's word
_LEADS_BACK_S = 30.0  # a link that comes back later finds a vehicle that holds
_TROUBLES = 8
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


def holding(state: State, event: Event, context: Context) -> Step:
    """Stop as the reason allows, and continue when it is gone."""
    if isinstance(event, Position):
        step = fence_breached(state) or flying.circling_near_zone(state, event)
        if step is not None:
            return step
    hold = state.hold
    if is_gone(state, event, context):
        return give_up(state, Reason.LINK_LOST)
    if isinstance(event, LinkLost) or (is_silent(state) and not isinstance(hold, Silent)):
        return with_hold_reason(_replan_hover(state), Reason.LINK_LOST), [], None
    if state.reason is Reason.BROKEN_OFF and state.vehicle.landed is Landed.ON_GROUND:
        return _stay_down(state)
    if not state.vehicle.armed:
        return _over(state, Reason.DISARMED)
    if is_grounded(state):
        return _over(state, Reason.GROUNDED)
    match hold:
        case Replan() | Paused() | ReturnOrdered() | LandOrdered():
            return _hold_on_setpoints(state, event, context, hold)
        case HoldMode() | TakeOver() | None:
            return _hold_in_its_own_mode(state, event, context)
        case StreamLost():
            return _lead_back(state, event, context)
        case TakenOver():
            return _while_taken_over(state, event, context, hold)
        case Grounded():
            return _while_taken_over(state, event, context, TakenOver())
        case Silent():
            return _heard_again(state, event, context)


def _over(state: State, how: Reason) -> Step:
    """End on the ground, with what was seen to lead to it."""
    reason, hold = state.reason, state.hold
    if reason is None or not (isinstance(hold, TakenOver) or reason.hold is HoldMode):
        return give_up(state, how)
    why = None
    if reason is Reason.FAILSAFE and isinstance(hold, TakenOver):
        late = state.vehicle.bad_at_s > state.since_s
        why = hold.why or (state.vehicle.last_distrust if late else None)
    remedy = why.remedy if why else how.remedy
    detail = f": {reason.text}" + (f": {why.text}" if why else "")
    return give_up(state, how, detail, reason.remedy if reason.hold is HoldMode else remedy)


def _stay_down(state: State) -> Step:
    """End before the flight: out of the take-off mode, and disarmed if we have armed it."""
    vehicle, order = state.vehicle, state.orders.active or Reason.STOPPED
    if vehicle.armed and vehicle.mode not in (Mode.GUIDED, Mode.TAKE_OFF, Mode.HOLD):
        return _taken(state)
    out = vehicle.mode not in (Mode.TAKE_OFF, Mode.GUIDED)
    down = out and not (vehicle.armed and state.armed_by_us)
    if down and vehicle.status_at_s > state.since_s:
        remedy = "Start again to fly."
        state = replace(state, reason=order, detail=" before it took off", remedy=remedy)
        return state, [], Trigger.STOP
    if in_phase_s(state) > _STAYS_DOWN_S:
        return give_up(state, Reason.NOT_OBEYING)
    return ask(state, *parting(state))


def fence_breached(state: State) -> Step | None:
    """Change the hold's reason to a breach of the vehicle's fence; None: it is not that.

    On PX4 it looks like a loss of setpoints first; and the autopilot knows a fence changed in
    flight before the companion has downloaded it.
    """
    if not isinstance(state.hold, TakenOver | StreamLost) or state.reason is Reason.FENCE_BREACHED:
        return None
    by_itself = state.vehicle.failsafe or in_phase_s(state) < _BREACH_S
    if not by_itself or takeover_reason(state) is not Reason.FENCE_BREACHED:
        return None
    return _taken(state)


def _heard_again(state: State, event: Event, context: Context) -> Step:
    """Prepare again after a silence, which may have concerned some messages only."""
    if in_phase_s(state) > longest_silence_s(state, context):
        return give_up(state, Reason.LINK_LOST)
    if isinstance(event, Position) and not is_silent(state):
        return state, [], Trigger.PREPARE_AGAIN
    return state, [], None


def _is_trusted(state: State) -> bool:
    return state.now_s - max(state.vehicle.bad_at_s, state.since_s) > TRUST_S


def _is_elsewhere(state: State) -> bool:
    """Whether the position passes all checks but cannot have been reached."""
    reason = state.vehicle.distrust
    return reason is Reason.POSITION_ELSEWHERE and state.reason is not reason


def _elsewhere(state: State) -> Step:
    """Hold for that, with a text: the previous reason is over."""
    reason = Reason.POSITION_ELSEWHERE
    says = StatusText(
        text=f"hold: {reason.text}{reason_text(state, reason)[0]}", warning=True, about="phase"
    )
    return replace(with_hold_reason(_replan_hover(state), reason), taken=False), [says], None


def _while_taken_over(state: State, event: Event, context: Context, hold: TakenOver) -> Step:
    """Another controller flies: send no command until guided mode is selected, or an order comes.

    Also after a failsafe: the autopilot's hold cannot be told from a pilot's.
    """
    if isinstance(event, Battery):
        state, warning = flying.battery_warning(state, context)
        return state, warning, None
    told = state.now_s - hold.released_at_s < _TOLD_S
    given_back = state.vehicle.mode is Mode.GUIDED or (told and state.vehicle.mode is Mode.HOLD)
    if given_back and _is_elsewhere(state):
        return _elsewhere(state)
    if not _is_trusted(state):
        return _replan_hover(state), [], None
    if state.vehicle.mode is Mode.GUIDED:
        return resumed(_replan_hover(state))
    if told:
        return _ask_for_guided(state, event, context)
    if hold.released_at_s > 0.0:
        says = StatusText(text="guided mode was not taken", warning=True)
        return replace(state, hold=replace(hold, released_at_s=-1e9)), [says], None
    acts = state.reason is not Reason.FAILSAFE or state.vehicle.failsafe
    if acts or hold.failsafe_over:
        return state, [], None
    state = replace(state, hold=replace(hold, failsafe_over=True))
    return state, [StatusText(text=FAILSAFE_OVER, warning=True)], None


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
    if clear and backtracking.start_backtrack(state) is not None:
        return state, [], Trigger.BACKTRACK
    reason = flight.fallen_back or state.reason or Reason.NO_PLAN
    return backtracking.home_by_plan(state, "returning another way", reason)


def _hold_on_setpoints(state: State, event: Event, context: Context, hold: OnSetpoints) -> Step:
    """Hold at the end of the leg; retry after a pause, a limited number of times."""
    reason = cannot_fly(state, event)
    if reason is not None and reason.hold is TakenOver:
        return _taken(_replan_hover(state))
    if reason is not None:
        return with_hold_reason(_replan_hover(state), reason), [], None
    if isinstance(event, PlanReady):
        return _on_backtrack_plan(state, event, context)
    if not isinstance(event, Position):
        return state, [], None
    if flying.battery_runs_low(state):  # a pause, too, ends before the battery does
        low = with_hold_reason(flying.given_up_for_battery(state), Reason.BATTERY_LOW)
        return low, [StatusText(text=f"hold: {Reason.BATTERY_LOW.text}", warning=True)], None
    state, warning = flying.battery_warning(state, context)
    flight, commands = following.hold_setpoint(state, event.time_s, context)
    commands, state = [*warning, *commands], replace(state, flight=flight)
    if flight.planning_backtrack is not None:
        if state.now_s - flight.planning_backtrack.since_s > _ANSWER_S:
            return give_up(state, state.reason or Reason.NO_PLAN)
        return state, commands, None
    moving = not _is_settled(state, event) and in_phase_s(state) < _SETTLE_S
    near, pause_s = context.mission.near, _PAUSE_S
    if near is not None:  # what it sees now is on the map at once
        pause_s = _SENSOR_S if state.vehicle.sight.is_blind else state.task.settings.planning_time_s
    if isinstance(hold, LandOrdered):
        return (state, commands, None) if moving else _land_here(state, commands)
    if isinstance(hold, Paused) or in_phase_s(state) < pause_s or moving:
        return state, commands, None
    if waits_for_fence(state, context):
        if not fence_is_given_up(state):
            return state, commands, None
        return preceded(commands, _other_way(with_hold_reason(state, Reason.FENCE_UNREAD), context))
    low_battery = state.reason is Reason.BATTERY_LOW  # which may have ended a pause
    on_way_back = state.flight.returning or (low_battery and state.flight.homeward)
    goes_back = on_way_back or state.flight.homeward
    if state.vehicle.ground_above_m and not goes_back and isinstance(hold, Replan):
        if in_phase_s(state) < _SENSOR_S * context.mission.attempts:
            return state, commands, None
        return _other_way(with_hold_reason(state, Reason.GROUND_NEARER), context)
    if isinstance(hold, ReturnOrdered) and not on_way_back:
        return _other_way(state, context)
    flight = state.flight
    may_try = flight.failures < context.mission.attempts
    if on_way_back or (may_try and flight.stops <= flying.max_stops(context)):
        if state.vehicle.traits.hovers and (
            state.reason is Reason.NEW_THREAT or not _is_settled(state, event)
        ):
            state = _replan_hover(state)  # the band may be another one, or it does not come back
        return preceded(commands, resumed(state))
    return _other_way(state, context)


def _is_settled(state: State, event: Position) -> bool:
    """Whether it is at rest where it is told to be: it may swing through after a hard stop."""
    hover = state.flight.hover_nea_m
    if hover is None or not state.vehicle.traits.hovers or not is_at_rest(state, event):
        return is_at_rest(state, event)
    off_m = math.dist(hover, event.position_nea_m)
    return off_m <= _SETTLED * state.task.limits.tracking_error_m


def _on_backtrack_plan(state: State, event: PlanReady, context: Context) -> Step:
    """Take the backtrack; if it failed, plan a path home, or give up."""
    flight, asked = state.flight, state.flight.planning_backtrack
    if asked is None or event.outcome.plan_id != flight.plan_id:
        return state, [], None
    if asked.rules is not state.task:  # it was proven under other rules
        return backtracking.request_backtrack(state, context)
    back = backtracking.on_backtrack_plan(state, event)
    if back is not None:
        after = replace(state, flight=replace(flight, way=back, planning_backtrack=None))
        if backtracking.start_backtrack(after) is not None:
            return after, [], Trigger.BACKTRACK
    reason = state.reason or Reason.NO_PLAN
    text = f"{reason.text}: no way back is proven, planning one home"
    return backtracking.home_by_plan(state, text, reason, warning=True)


def _other_way(state: State, context: Context) -> Step:
    """Backtrack if that is the fallback; else as `fallback` says.

    Not once planning a path home has failed.
    """
    reason, flight = state.reason or Reason.NO_PLAN, state.flight
    how = fallback.wanted_fallback(state, context)
    at_home = not flight.flown and is_above_home(state)
    if how is not Fallback.RETURN or flight.homeward or at_home:
        return give_up(state, reason)
    why = f"{reason.text}{reason_text(state, reason)[0]}"
    state = replace(state, flight=replace(flight, fallen_back=reason))
    if not flight.flown:
        text = f"{why}: planning a way home"
        return backtracking.home_by_plan(state, text, reason, warning=True)
    state, asking, trigger = backtracking.request_backtrack(state, context)
    how_so = "flying back and landing" if begins_at_home(state) else "flying back, then home"
    text = f"{why}: {how_so}"
    return state, [StatusText(text=text, warning=True, about="end"), *asking], trigger


def _hold_in_its_own_mode(state: State, event: Event, context: Context) -> Step:
    """The autopilot holds, until the vehicle is at rest and its position was valid for a while."""
    vehicle, mode = state.vehicle, state.vehicle.mode
    taking_over = isinstance(state.hold, TakeOver)
    climbs = mode is Mode.TAKE_OFF and (
        taking_over or (is_own_takeoff(state) and not state.obeyed)  # it has not heard us yet
    )
    if mode not in (Mode.GUIDED, Mode.HOLD) and not climbs:
        return _taken(state)
    if in_phase_s(state) > _HOLD_S or state.flight.troubles > _TROUBLES:
        return state, [], Trigger.GIVE_UP
    if mode is not Mode.TAKE_OFF and _is_elsewhere(state):
        return _elsewhere(state)
    flies_on = vehicle.traits.hovers and mode is Mode.GUIDED  # to a target that is not known
    if mode is Mode.HOLD or (taking_over and not flies_on):
        state = replace(state, obeyed=True)
    doubted = vehicle.distrust is not None
    is_stationary = not vehicle.traits.hovers or math.hypot(*vehicle.velocity_nea_m_s) < STOPPED_M_S
    is_stationary = (
        is_stationary or in_phase_s(state) > _SETTLE_S or state.flight.hover_nea_m is not None
    )
    if not state.obeyed or (mode is Mode.GUIDED and (doubted or not is_stationary)):
        return ask(replace(_replan_hover(state), obeyed=False), SetMode(mode=Mode.HOLD))
    if is_stationary and mode is Mode.HOLD and state.orders.active is Reason.LAND_ASKED:
        return _land_here(state, [])
    unled = state.reason is Reason.BROKEN_OFF and state.flight.plan_id == 0
    if unled and mode is Mode.HOLD and state.orders.active is Reason.RETURN_ASKED:
        return give_up(state, Reason.RETURN_ASKED)  # there is no way back but its own
    if not is_stationary or not _is_trusted(state):
        return _replan_hover(state), [], None
    if mode is Mode.GUIDED:
        return resumed(_replan_hover(state))
    return _ask_for_guided(state, event, context)


def _land_here(state: State, commands: list[Command]) -> Step:
    """Land, as ordered."""
    state = replace(state, flight=replace(state.flight, fallen_back=Reason.LAND_ASKED))
    says = StatusText(text=f"{Reason.LAND_ASKED.text}: landing here", about="phase")
    return state, [*commands, says], Trigger.END_LAND


def _taken(state: State) -> Step:
    """A pilot or the autopilot has taken over."""
    reason = takeover_reason(state)
    says = StatusText(text=f"hold: {reason.text}", warning=True, about="phase")
    return replace(with_hold_reason(state, reason), taken=True), [says], None


def _lead_back(state: State, event: Event, context: Context) -> Step:
    """PX4 returns to OFFBOARD by itself as soon as setpoints arrive again (px4.md 6).

    No mode is requested: if it does not return, it holds for another reason.
    """
    mode = state.vehicle.mode
    if mode not in (Mode.GUIDED, Mode.HOLD) or in_phase_s(state) > _LEADS_BACK_S:
        return _taken(state)
    if _is_elsewhere(state):
        return _elsewhere(state)
    if not _is_trusted(state):
        return _replan_hover(state), [], None
    if mode is Mode.GUIDED:
        return resumed(_replan_hover(state))
    if not isinstance(event, Position):
        return state, [], None
    if state.flight.hover_nea_m is None:
        flight = following.at_rest(state.flight, event.position_nea_m)
        state = replace(state, flight=flight)
    flight, stay = following.hold_setpoint(state, event.time_s, context)
    return replace(state, flight=flight), stay, None


def _replan_hover(state: State) -> State:
    """Choose the waiting place again: the vehicle may have been held too low."""
    return replace(state, flight=following.at_rest(state.flight, None))


def _ask_for_guided(state: State, event: Event, context: Context) -> Step:
    """Request guided mode; with setpoints at the position, for autopilots that need them first."""
    traits = state.vehicle.traits
    if not (traits.hovers or traits.needs_setpoints_before_offboard):
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
        return _on_backtrack_plan(state, event, context)
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
    traits, action = state.vehicle.traits, context.mission.end_action
    if state.flight.homeward:
        action = EndAction.LAND
    if action is EndAction.LAND and (traits.lands or state.flight.homeward):
        return state, commands, Trigger.END_LAND if traits.lands else Trigger.HAND_OVER
    if action is EndAction.RETURN:
        if state.flight.planning_backtrack is not None:
            return state, commands, None
        if not state.flight.flown:
            text = "returning: planning a way home"
            step = backtracking.home_by_plan(state, text, Reason.NO_PLAN)
            return preceded(commands, step)
        state, asking, _ = backtracking.request_backtrack(state, context)
        return state, [*commands, *asking], None
    if traits.holds_in_guided:
        told = in_phase_s(state) > _TOLD_TO_STAY_S
        return state, commands, Trigger.END_HOLD if told else None
    # an autopilot may refuse to hold about a point (its own fence): then anywhere
    about = state.flight.hover_nea_m if state.asks < _ASKS_ABOUT else None
    state, asking, _ = ask(state, SetMode(mode=Mode.HOLD, at_nea_m=about))
    return state, [*commands, *asking], None


def reached(state: State) -> StatusText:
    """Text at a target; for a plane that missed it by too much, with the distance."""
    limits, here, there = state.task.limits, state.vehicle.position_nea_m, state.flight.hover_nea_m
    if not state.vehicle.traits.hovers and here is not None and there is not None:
        off_m = math.dist(here[:2], there[:2])
        if off_m > limits.tracking_error_m:
            text = f"target reached: passed {off_m:.0f} m away"
            return StatusText(text=text, warning=True, about="phase")
    return StatusText(text="target reached", about="phase")


def lands_within_m(state: State) -> float:
    """How near to a place the vehicle lands.

    PX4's planes land on a circle about where the mode begins (px4.md 10).
    """
    return (
        math.inf
        if state.vehicle.traits.hovers
        else _LANDS_WITHIN * state.task.limits.loiter_radius_m
    )


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


def _stands_at_target(state: State, event: Position) -> bool:
    """At rest at the target; after a while, as near to it and as slow as the vehicle can be."""
    here, limits = state.flight.hover_nea_m, state.task.limits
    off = math.inf if here is None else math.dist(event.position_nea_m, here)
    if not state.vehicle.traits.hovers:
        return off < _CIRCLES * limits.loiter_radius_m + limits.tracking_error_m
    if in_phase_s(state) > _SETTLE_S:
        return off < max(AT_M, limits.tracking_error_m)
    return off < _THERE_M and is_at_rest(state, event)


def landing(state: State, event: Event, context: Context) -> Step:
    """Request the land mode until it is taken, then wait for touchdown."""
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
    orders = Orders(Reason.PAUSED, landing_order(state))
    state, commands, trigger = fault(replace(state, orders=orders), reason)
    return state, [*commands, StatusText(text=LANDING_ABORTED, warning=True)], trigger
