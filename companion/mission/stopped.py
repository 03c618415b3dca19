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

from companion.mission import events, phases, way_back
from companion.mission.battery import gives_up_for_battery, warn_of_battery
from companion.mission.decisions import (
    ASK_AGAIN_S,
    AT_M,
    Context,
    Turn,
    abort_landing,
    fence_is_given_up,
    hold_for,
    in_words,
    is_at_rest,
    longest_silence_s,
    waits_for_fence,
)
from companion.mission.events import Battery, Event, Landed, Mode, PlanReady, Position, SetMode
from companion.mission.flying import looks_at_circle, zone_beside
from companion.mission.following import come_to_rest, send_hold
from companion.mission.health import TRUST_S
from companion.mission.mission import EndAction, Fallback
from companion.mission.phases import ORDERED, TAKEN, TAKES_OVER, By, Reason, Trigger
from companion.mission.state import State, Way
from companion.mission.tables import is_ours, parting, stays_down, takeover_reason, wanted_fallback
from companion.mission.way_back import begins_at_home, home_ne_m, is_above_home
from companion.planner.loiter_search import loiter_point

FAILSAFE_OVER = "failsafe over: MISSION_START to the companion, or guided mode, goes on"

_TOLD_S = 30.0  # that guided mode is asked for on a person's word
_TROUBLES = 8
_MAX_STOPS = 100
"""On the way to one target, for want of a successor: flights have arrived after 50 between houses,
and after 24 in front of a wall with one gap (docs/lab/benchmarks.md)."""
_PAUSE_S = 2.0  # between attempts to plan from rest
_SENSOR_S = 15.0  # for a sensor to see again, before each of them
_CIRCLES = 2.5  # loiter radii: what circles a place, or beside it, is there
_THERE_M = 1.0
_SETTLED = 0.8  # tracking errors: with one it would have left its next path at once
_SETTLE_S = 30.0  # for a vehicle that does not come quite to rest
_HOLD_S = 300.0  # for a position that does not get better
_OBEY_S = 60.0  # for the end action's mode, and for a descent that stands still
_SINKING_M_S = 0.1
_ANSWER_S = 60.0
_ASKS_ABOUT = 2
_UNHEARD = {None, Reason.POSITION_STALE, Reason.HEALTH_SILENT}
"""Nothing is wrong, or the link is: the vehicle knows where it is."""
_TOLD_TO_STAY_S = 1.0  # a setpoint may be lost: an end in guided mode is told several times
_STAYS_DOWN_S = 10.0  # ten times asked for
_LANDS_WITHIN = 1.5  # loiter radii
_ASKS = 5  # in vain, once a second


def holding(state: State, held: phases.Holding, event: Event, turn: Turn) -> None:
    """Stop as the reason allows, and continue when it is gone."""
    if stays_down(state):
        return _stay_down(state, turn)
    if isinstance(event, Position) and looks_at_circle(state, turn):
        return
    if held.why is Reason.STREAM_LOST:
        return _take_again(state, event, turn)
    if held.why is Reason.LINK_LOST:
        return _heard_again(state, event, turn)
    return _HELD_BY[held.why.by](state, held, event, turn)


def note_circle(state: State) -> None:
    """Before others hold a plane that was led: the circle that it comes back to, if it was on one.

    Each that its autopilot holds it on lies a radius beside the last, and nobody has proven it.
    """
    sent = None if state.vehicle.traits.hovers else state.flight.sent
    state.flight.circle_nea_m = sent.position_nea_m if sent and sent.stay else None


def hold_by_itself(state: State) -> SetMode:
    """What has its autopilot hold it: a plane on its circle, if nothing but news of it is missing.

    Else where it is: an autopilot that is wrong about its place is wrong about the circle's.
    """
    vehicle = state.vehicle
    stays = vehicle.mode is Mode.GUIDED and {state.held_for, vehicle.distrust} <= _UNHEARD
    return SetMode(mode=Mode.HOLD, at_nea_m=state.flight.circle_nea_m if stays else None)


def _circle_beside(state: State) -> events.Vector | None:
    """That circle, or one that the rules in force allow; None: the plane is far away from it."""
    circle, vehicle, task = state.flight.circle_nea_m, state.vehicle, state.task
    position = vehicle.position_nea_m
    if circle is None or position is None:
        return None
    if math.dist(circle[:2], position[:2]) > _CIRCLES * task.limits.loiter_radius_m:
        return None
    if zone_beside(task, circle) is None:
        return circle
    return loiter_point(state.flight.known, task, position, vehicle.velocity_nea_m_s, circle)


def broken_off(state: State, reason: Reason, turn: Turn) -> None:
    """Held for another reason from now on, or at an end."""
    if reason in (Reason.DISARMED, Reason.GROUNDED):
        return _over(state, reason, turn)
    if state.held_by is By.SETPOINTS:
        note_circle(state)
    if reason is Reason.LINK_LOST or state.held_by is By.SETPOINTS:
        come_to_rest(state)
    if reason in TAKEN:
        return taken(state, turn)
    hold_for(state, reason)
    if reason.asks_to_hold:
        _ask_to_hold(state, turn)


def _ask_to_hold(state: State, turn: Turn) -> None:
    """At once, unless it holds already: asked anew, PX4 holds where it believes to be by now."""
    if state.vehicle.mode is not Mode.HOLD:
        turn.ask(hold_by_itself(state))


def _over(state: State, how: Reason, turn: Turn) -> None:
    """End on the ground, with what was seen to lead to it."""
    held, reason, taken = state.stage, state.reason, state.held_for in TAKEN
    assert isinstance(held, phases.Holding)
    if reason is None or not (taken or reason.asks_to_hold):
        return turn.give_up(how)
    why = None
    if reason is Reason.FAILSAFE and taken:
        late = state.vehicle.bad_at_s > state.stage.since_s
        why = held.seen or (state.vehicle.last_distrust if late else None)
    remedy = why.remedy if why else how.remedy
    detail = f": {reason.text}" + (f": {why.text}" if why else "")
    return turn.give_up(how, detail, reason.remedy if reason.asks_to_hold else remedy)


def _stay_down(state: State, turn: Turn) -> None:
    """End before the flight: out of the take-off mode, and disarmed if we have armed it."""
    vehicle, order = state.vehicle, state.order or Reason.STOPPED
    elsewhere = vehicle.mode not in (Mode.GUIDED, Mode.TAKE_OFF, Mode.HOLD)
    if vehicle.armed and elsewhere:
        return taken(state, turn)
    out = vehicle.mode not in (Mode.TAKE_OFF, Mode.GUIDED)
    down = out and not (vehicle.armed and state.armed_by_us)
    if down and vehicle.status_at_s > state.stage.since_s:
        state.reason, state.detail = order, " before it took off"
        state.remedy = "Start again to fly."
        return turn.to(Trigger.STOP)
    if state.in_phase_s > _STAYS_DOWN_S:
        return turn.give_up(Reason.NOT_OBEYING)
    if not elsewhere:
        turn.ask(*parting(state))


def _heard_again(state: State, event: Event, turn: Turn) -> None:
    """Prepare again after a silence, which may have concerned some messages only.

    Given up after ten minutes in the air; on the ground, or in lockstep, after 30 s.
    """
    if state.in_phase_s > longest_silence_s(state, turn.context):
        return turn.give_up(Reason.LINK_LOST)
    if isinstance(event, Position) and not state.is_silent:
        turn.to(Trigger.PREPARE_AGAIN)


def _while_taken_over(state: State, held: phases.Holding, event: Event, turn: Turn) -> None:
    """Another controller flies: send no command until guided mode is selected, or an order comes.

    Also after a failsafe: the autopilot's hold cannot be told from a pilot's.
    """
    if isinstance(event, Battery):
        return warn_of_battery(state, turn)
    mode = state.vehicle.mode
    was_told = state.now_s - held.released_at_s < _TOLD_S
    given_back = mode is Mode.GUIDED or (was_told and mode is Mode.HOLD)
    if was_told or given_back or not _is_trusted(state):
        _take_again(state, event, turn, given_back=given_back)
    elif held.released_at_s > 0.0:
        held.released_at_s = -1e9
        turn.warn("guided mode was not taken")
    elif state.reason is Reason.FAILSAFE and not (state.vehicle.failsafe or held.failsafe_over):
        held.failsafe_over = True
        turn.warn(FAILSAFE_OVER)


def _is_trusted(state: State) -> bool:
    return state.now_s - max(state.vehicle.bad_at_s, state.stage.since_s) > TRUST_S


def _is_elsewhere(state: State) -> bool:
    """Whether the position passes all checks but cannot have been reached, which is news."""
    distrust = state.vehicle.distrust
    return distrust is Reason.POSITION_ELSEWHERE and state.reason is not distrust


def _take_again(state: State, event: Event, turn: Turn, *, given_back: bool = True) -> None:
    """Lead it again once its position was valid for a while, and it is in guided mode.

    PX4 returns to that by itself as soon as setpoints arrive again (px4.md 6): no mode is
    requested.  A position that passes all checks but cannot have been reached is held for.
    """
    if given_back and _is_elsewhere(state):  # the previous reason is over
        come_to_rest(state)
        turn.hold(Reason.POSITION_ELSEWHERE)
        _ask_to_hold(state, turn)
        state.taken = False
    elif not _is_trusted(state):
        come_to_rest(state)
    elif state.vehicle.mode is Mode.GUIDED:
        come_to_rest(state, _circle_beside(state))
        resumed(state, turn)
    elif state.held_for is not Reason.STREAM_LOST:
        _ask_for_guided(state, event, turn)
    elif isinstance(event, Position):
        _stream_here(state, event, math.inf, turn)


def resumed(state: State, turn: Turn) -> None:
    """End of a hold: the active order first; else continue, or backtrack.

    If the backtrack is too far away or blocked, a path home is planned.
    """
    flight, wanted = state.flight, state.order
    if wanted not in (None, state.reason):
        come_to_rest(state, flight.hover_nea_m or state.vehicle.position_nea_m)
        state.taken = False
        hold_for(state, wanted)
        return
    if not flight.returning:
        return turn.to(Trigger.RESUME)
    clear = not any(leg.is_touched(0.0, state.task) for leg in flight.back)
    if clear and (path := way_back.begun(state)) is not None:
        return turn.to(Trigger.BACKTRACK, phases.Led(path=path))
    reason = flight.fallen_back or state.reason or Reason.NO_PLAN
    return way_back.home_by_plan(state, turn, "returning another way", reason)


def _hold_on_setpoints(state: State, held: phases.Holding, event: Event, turn: Turn) -> None:
    """Hold at the end of the leg; retry after a pause, a limited number of times."""
    if isinstance(event, PlanReady):
        return way_back.on_plan(state, event, turn)
    if not isinstance(event, Position):
        return
    if gives_up_for_battery(state):  # a pause, too, ends before the battery does
        hold_for(state, Reason.BATTERY_LOW)
        turn.warn(f"hold: {Reason.BATTERY_LOW.text}")
        return
    warn_of_battery(state, turn)
    send_hold(state, event.time_s, turn)
    if (asked := held.backtrack) is None:
        _end_of_hold(state, event, turn)
    elif state.now_s - asked.since_s > _ANSWER_S:
        turn.give_up(state.reason or Reason.NO_PLAN)


def _end_of_hold(state: State, event: Position, turn: Turn) -> None:
    """What comes after a hold on setpoints, once that is due."""
    why, near, flight = state.held_for, turn.context.mission.near, state.flight
    held_s, settled = state.in_phase_s, _is_settled(state, event)
    moving = not settled and held_s < _SETTLE_S
    pause_s = _PAUSE_S
    if near is not None:  # what it sees now is on the map at once
        pause_s = _SENSOR_S if state.vehicle.sight.is_blind else state.task.settings.planning_time_s
    if why is Reason.LAND_ASKED and not moving:
        return _land_here(state, turn)
    if why in (Reason.PAUSED, Reason.LAND_ASKED) or held_s < pause_s or moving:
        return
    if waits_for_fence(state, turn.context):
        if not fence_is_given_up(state):
            return
        hold_for(state, Reason.FENCE_UNREAD)
        return _other_way(state, turn)
    low_battery = state.reason is Reason.BATTERY_LOW  # which may have ended a pause
    on_way_back = flight.returning or (low_battery and flight.homeward)
    if state.vehicle.ground_above_m and flight.way is Way.OUT and why not in ORDERED:
        if held_s < _SENSOR_S * turn.context.mission.attempts:
            return
        hold_for(state, Reason.GROUND_NEARER)
        return _other_way(state, turn)
    tries = flight.failures < turn.context.mission.attempts and flight.stops <= _MAX_STOPS
    if not on_way_back and (why in (Reason.RETURN_ASKED, Reason.BATTERY_LOW) or not tries):
        return _other_way(state, turn)
    if state.vehicle.traits.hovers and (state.reason is Reason.NEW_THREAT or not settled):
        come_to_rest(state)  # the band may be another one, or it does not come back
    return resumed(state, turn)


def _is_settled(state: State, event: Position) -> bool:
    """Whether it is at rest where it is told to be: it may swing through after a hard stop."""
    hover = state.flight.hover_nea_m
    if hover is None or not state.vehicle.traits.hovers:
        return is_at_rest(state)
    off_m = math.dist(hover, event.position_nea_m)
    return is_at_rest(state) and off_m <= _SETTLED * state.task.limits.tracking_error_m


def _other_way(state: State, turn: Turn) -> None:
    """Backtrack if that is the fallback; else as `fall_back` says.

    Not once planning a path home has failed.
    """
    reason, flight = state.reason or Reason.NO_PLAN, state.flight
    how = wanted_fallback(state, turn.context)
    at_home = not flight.flown and is_above_home(state)
    if how is not Fallback.RETURN or flight.homeward or at_home:
        return turn.give_up(reason)
    why, flight.fallen_back = in_words(state, reason), reason
    if not flight.flown:
        text = f"{why}: planning a way home"
        return way_back.home_by_plan(state, turn, text, reason, warning=True)
    how_so = "flying back and landing" if begins_at_home(state) else "flying back, then home"
    turn.warn(f"{why}: {how_so}", "end")
    return way_back.request(state, turn)


def _hold_in_its_own_mode(state: State, held: phases.Holding, event: Event, turn: Turn) -> None:
    """The autopilot holds, until the vehicle is at rest and its position was valid for a while."""
    mode, flight, held_s = state.vehicle.mode, state.flight, state.in_phase_s
    if held_s > _HOLD_S or flight.troubles > _TROUBLES:
        return turn.to(Trigger.GIVE_UP)
    if mode is not Mode.TAKE_OFF and _is_elsewhere(state):
        return _take_again(state, event, turn)
    hold = hold_by_itself(state)
    stands = is_at_rest(state) or held_s > _SETTLE_S or flight.hover_nea_m is not None
    held.obeyed = _obeys(state, held, hold, stands=stands)
    if not held.obeyed:
        come_to_rest(state)
        return turn.ask(hold if held.asks < _ASKS_ABOUT else SetMode(mode=Mode.HOLD))
    ordered = state.order if mode is Mode.HOLD else None
    unled = state.reason is Reason.BROKEN_OFF and flight.plan_id == 0
    if unled and ordered is Reason.RETURN_ASKED:
        return turn.give_up(Reason.RETURN_ASKED)  # there is no way back but its own
    if stands and ordered is Reason.LAND_ASKED:
        return _land_here(state, turn)
    if stands:
        _take_again(state, event, turn, given_back=False)


def _obeys(state: State, held: phases.Holding, hold: SetMode, *, stands: bool) -> bool:
    """Whether its autopilot holds it: in a mode of its own, or on the circle that it was told.

    Once held it may be in guided mode again, as long as it stands and its position is valid.
    """
    vehicle, taking_over = state.vehicle, held.why in TAKES_OVER
    if vehicle.mode is not Mode.GUIDED:
        return vehicle.mode is Mode.HOLD or taking_over  # a take-off ends in a hold
    circles = vehicle.traits.holds_in_guided and hold.at_nea_m is not None
    if circles and held.asked_at_s >= held.since_s:
        return True
    has_held = held.obeyed or (taking_over and not vehicle.traits.hovers)  # a copter flies on
    return has_held and stands and vehicle.distrust is None


def _land_here(state: State, turn: Turn) -> None:
    """Land, as ordered."""
    state.flight.fallen_back = Reason.LAND_ASKED
    turn.say(f"{Reason.LAND_ASKED.text}: landing here", "phase")
    return turn.to(Trigger.END_LAND)


def taken(state: State, turn: Turn) -> None:
    """A pilot or the autopilot has taken over."""
    turn.hold(takeover_reason(state))
    state.taken = True


def _stream_here(state: State, event: Position, near_m: float, turn: Turn) -> None:
    """Setpoints where it holds, or is by now if that is farther away; a plane's on its circle."""
    hover = state.flight.hover_nea_m
    if hover is None or math.dist(hover, event.position_nea_m) > near_m:
        come_to_rest(state, _circle_beside(state) or event.position_nea_m)
    send_hold(state, event.time_s, turn)


def _ask_for_guided(state: State, event: Event, turn: Turn) -> None:
    """Request guided mode; with setpoints at the position, for autopilots that need them first."""
    traits = state.vehicle.traits
    if traits.hovers or traits.needs_setpoints_before_offboard:  # refused before (ardupilot.md 7)
        if not isinstance(event, Position):
            return
        near_m = max(AT_M, _CIRCLES * state.task.limits.loiter_radius_m)
        _stream_here(state, event, near_m, turn)
    turn.ask(SetMode(mode=Mode.GUIDED))


_HELD_BY = {
    By.SETPOINTS: _hold_on_setpoints,
    By.MODE: _hold_in_its_own_mode,
    By.NOBODY: _while_taken_over,
}


# --- at the target


def arrived(state: State, stage: phases.Stopped, event: Event, turn: Turn) -> None:
    """Stop at the target; then the next target, or the end action."""
    flight, asked = state.flight, stage.asked_at_s > stage.since_s
    if state.vehicle.mode is Mode.HOLD and asked:
        return turn.to(Trigger.END_HOLD)
    if state.in_phase_s > _SETTLE_S + _OBEY_S:
        return turn.give_up(Reason.NOT_OBEYING if asked else Reason.NOT_FOLLOWING)
    if isinstance(event, PlanReady):
        return way_back.on_plan(state, event, turn)
    if not isinstance(event, Position):
        return
    send_hold(state, event.time_s, turn)
    if not _stands_at_target(state, event):
        return
    if flight.target + 1 < len(state.targets_ne_m):
        flight.target, flight.stops = flight.target + 1, 0
        return turn.to(Trigger.NEXT_TARGET)
    return _end(state, stage, turn)


def _end(state: State, stage: phases.Stopped, turn: Turn) -> None:
    """The mission's end action."""
    traits, action, flight = state.vehicle.traits, turn.context.mission.end_action, state.flight
    if flight.homeward or (action is EndAction.LAND and traits.lands):
        return turn.to(Trigger.END_LAND if traits.lands else Trigger.HAND_OVER)
    if action is EndAction.RETURN:
        if stage.backtrack is not None:
            return
        if flight.flown:
            return way_back.request(state, turn)
        text = "returning: planning a way home"
        return way_back.home_by_plan(state, turn, text, Reason.NO_PLAN)
    if traits.holds_in_guided:
        if state.in_phase_s > _TOLD_TO_STAY_S:
            turn.to(Trigger.END_HOLD)
        return
    # an autopilot may refuse to hold about a point (its own fence): then anywhere
    about = flight.hover_nea_m if stage.asks < _ASKS_ABOUT else None
    turn.ask(SetMode(mode=Mode.HOLD, at_nea_m=about))


def say_reached(state: State, turn: Turn) -> None:
    """Text at a target; for a plane that missed it by too much, with the distance."""
    position, target = state.vehicle.position_nea_m, state.flight.hover_nea_m
    off_m = 0.0
    if not state.vehicle.traits.hovers and position is not None and target is not None:
        off_m = math.dist(position[:2], target[:2])
    if off_m > state.task.limits.tracking_error_m:
        turn.warn(f"target reached: passed {off_m:.0f} m away", "phase")
    else:
        turn.say("target reached", "phase")


def _stands_at_target(state: State, event: Position) -> bool:
    """At rest at the target; after a while, as near to it and as slow as the vehicle can be."""
    hover, limits = state.flight.hover_nea_m, state.task.limits
    off = math.inf if hover is None else math.dist(event.position_nea_m, hover)
    if not state.vehicle.traits.hovers:
        return off < _CIRCLES * limits.loiter_radius_m + limits.tracking_error_m
    if state.in_phase_s > _SETTLE_S:
        return off < max(AT_M, limits.tracking_error_m)
    return off < _THERE_M and is_at_rest(state)


# --- down


def lands_within_m(state: State) -> float:
    """How near to a place the vehicle lands.

    PX4's planes land on a circle about where the mode begins (px4.md 10).
    """
    hovers, radius_m = state.vehicle.traits.hovers, state.task.limits.loiter_radius_m
    return math.inf if hovers else _LANDS_WITHIN * radius_m


def landed_off_m(state: State) -> float:
    """Distance from its last target or return point, metres."""
    position, flight = state.vehicle.position_nea_m, state.flight
    if position is None or not state.targets_ne_m:
        return 0.0
    home = home_ne_m(state) if flight.returning else None
    return math.dist(position[:2], home or state.targets_ne_m[flight.target])


def landing_words(state: State, context: Context) -> str:
    """A warning before take-off about the landing at the target; "": none."""
    traits = state.vehicle.traits
    if context.mission.end_action is not EndAction.LAND or traits.hovers:
        return ""
    if not traits.lands:
        return f"{traits.name} is not told to land: it circles the last target"
    within_m = lands_within_m(state)
    return f"{traits.name} lands on a circle: up to {within_m:.0f} m from the target"


def landing(state: State, stage: phases.Stage, event: Event, turn: Turn) -> None:
    """Request the land mode until it is taken, then wait for touchdown."""
    vehicle = state.vehicle
    if vehicle.landed is Landed.ON_GROUND and not vehicle.armed:
        return turn.to(Trigger.LANDED)
    if isinstance(event, Position) and event.velocity_nea_m_s[2] < -_SINKING_M_S:
        stage.progress_at_s = state.now_s
    if state.now_s - stage.progress_at_s > _OBEY_S:
        return turn.give_up(Reason.NOT_OBEYING)
    if vehicle.mode is Mode.LAND:
        stage.obeyed = True
    elif is_ours(state):
        turn.ask(SetMode(mode=Mode.LAND))
    elif not state.is_grounded:  # PX4 holds without setpoints
        return _broken_off(state, turn)
    return None  # on the ground, and not yet disarmed: the mode is the autopilot's


def _broken_off(state: State, turn: Turn) -> None:
    """The vehicle has left the land mode: not landed again without an order.

    Hold in place if guided mode was selected; else the pilot has control, and it holds once handed
    back.
    """
    guided = state.vehicle.mode is Mode.GUIDED
    reason = Reason.PAUSED if guided else takeover_reason(state)
    come_to_rest(state, state.vehicle.position_nea_m if guided else None)
    abort_landing(state, turn)
    return turn.fault(reason)


def handing_over(state: State, stage: phases.Stage, _event: Event, turn: Turn) -> None:
    """Request RTL until the autopilot takes it; from then on the autopilot is in control."""
    vehicle = state.vehicle
    if state.is_silent:
        return
    if vehicle.mode is Mode.RETURN:
        return turn.to(Trigger.HANDED_ON)
    if stage.asks == _ASKS and state.now_s - stage.asked_at_s >= ASK_AGAIN_S:
        return turn.give_up(Reason.NOT_OBEYING)
    turn.ask(SetMode(mode=Mode.RETURN))
