"""External changes during a mission: threats, targets, orders."""

import enum
from collections.abc import Callable
from typing import Any, Final

from msgspec.structs import replace

from companion.mission import events, following, ground, phases
from companion.mission.battery import battery_is_short
from companion.mission.decisions import Turn, hold_for
from companion.mission.events import Event, Landed, Order, OrderKind
from companion.mission.following import come_to_rest
from companion.mission.phases import (
    GOING_UP,
    ON_PATH,
    ORDERED,
    OVER,
    TAKEN,
    By,
    Phase,
    Reason,
    Trigger,
)
from companion.mission.state import Flight, Goal, State, Targets, Vehicle, Way
from companion.mission.stopped import resumed, taken
from companion.mission.tables import is_breach_of_fence
from companion.mission.way_back import set_targets
from companion.planner.procedure import Leg
from companion.planner.rules import target_refusal
from companion.world.zones import nearest

_NOT_TO_GO_ON = (Phase.LANDING, Phase.HANDING_OVER, Phase.SHADOW, *OVER)
_WAITS_FOR_FENCE = "it returns once the changed fence is read, or goes on being read for too long"
_FEW_ITEMS = 10  # of a fence: they are read before a person has read the text


class OrderResult(enum.Enum):
    """Result of an order."""

    ACCEPTED = "it is carried out"
    INVALID = "it cannot be carried out as it stands"
    NOT_NOW = "it cannot be carried out now"


def order_result(state: State, order: Order, *, go: bool = False) -> OrderResult:
    """The result of an order, for its acknowledgement; go: it takes off without being told."""
    in_air = state.phase in (*ON_PATH, *GOING_UP, Phase.HOLDING, Phase.ARRIVED)
    match order.kind:
        case OrderKind.REPOSITION:
            if order.target_ne_m is None or target_refusal(state.task, order.target_ne_m):
                return OrderResult.INVALID
            led = in_air and state.phase not in GOING_UP
            return OrderResult.ACCEPTED if led else OrderResult.NOT_NOW
        case OrderKind.START | OrderKind.CONTINUE if not go and _waits_for_go(state):
            ready = state.phase is Phase.READY and order.kind is OrderKind.START
            return OrderResult.ACCEPTED if ready else OrderResult.NOT_NOW
        case OrderKind.START | OrderKind.CONTINUE:
            return OrderResult.NOT_NOW if state.phase in _NOT_TO_GO_ON else OrderResult.ACCEPTED
        case OrderKind.PAUSE:
            return OrderResult.ACCEPTED if _may_pause(state) else OrderResult.NOT_NOW
        case OrderKind.RETURN:
            obeys = in_air and _obeys(state)
            return OrderResult.ACCEPTED if obeys else OrderResult.NOT_NOW
        case OrderKind.LAND:
            held = state.held_by is By.NOBODY
            if state.phase is not Phase.LANDING and (held or not in_air):
                return OrderResult.NOT_NOW
            down = state.phase in GOING_UP and state.vehicle.landed is Landed.ON_GROUND
            lands = state.vehicle.traits.lands or down  # then it stays there
            return OrderResult.ACCEPTED if lands else OrderResult.INVALID


def why_not(state: State, order: Order) -> str:
    """Why an order is refused, as text for its sender."""
    why = f"the mission is {state.phase.value}"
    if order_result(state, order) is OrderResult.INVALID:
        place = order.target_ne_m
        why = "it has no target" if place is None else target_refusal(state.task, place)
        if order.kind is OrderKind.LAND:
            why = f"{state.vehicle.traits.name} is not told to land: send it back"
    elif order.kind is OrderKind.PAUSE and _is_short(state):
        why = Reason.BATTERY_LOW.text
    elif order.kind is OrderKind.START and _waits_for_go(state):
        why = ground.why_no_go(state)
    elif state.phase is Phase.READY:
        why = "it waits for MISSION_START"
    elif state.phase is Phase.HOLDING and state.reason is not None:
        why = state.reason.text
    return f"{order.kind.name.lower()} refused: {why}"


def _waits_for_go(state: State) -> bool:
    """Whether it is on the ground, and nobody has said go yet."""
    if state.airborne or (state.vehicle.armed and state.phase is not Phase.READY):
        return False
    return state.phase in (Phase.WAITING, Phase.PREPARING, Phase.READY)


def _is_short(state: State) -> bool:
    return state.goal is Goal.DOWN or battery_is_short(state)


def _may_pause(state: State) -> bool:
    """Whether a pause is possible: a low battery would end it at once."""
    follows = state.phase in (*ON_PATH, Phase.HOLDING) and _obeys(state)
    return state.phase in GOING_UP or (follows and not _is_short(state))


def _obeys(state: State) -> bool:
    """Whether an order takes effect: at once, or once what its autopilot stopped is led again."""
    why = state.held_for
    goes_its_way = why in (Reason.BATTERY_LOW, Reason.STREAM_LOST)
    return why is None or not (goes_its_way or why.by is By.NOBODY)


# --- threats


def _on_fence(state: State, event: events.FenceChanged, turn: Turn) -> None:
    """A new fence: recheck the rest of the path, and stop if it conflicts."""
    flight, path, known = state.flight, state.path, state.fence is not None
    state.take_fence(turn.context.mission.task, event)
    turn.say(f"fence: {len(event.zones)} zones", warning=known)
    on_path = state.phase in ON_PATH
    if (inside := _inside(state)) and not on_path:
        turn.warn(f"inside zone {inside}")
    legs: list[tuple[Leg | None, float]] = [(leg, 0.0) for leg in flight.back]
    if path is not None:
        legs += [(path.leg, path.reference.length_m), (path.next_leg, 0.0)]
    if any(leg is not None and leg.is_touched(at_m, state.task) for leg, at_m in legs):
        if on_path:
            following.stop(state, Reason.NEW_THREAT, turn)
        else:  # a path that was to be gone on with
            come_to_rest(state, flight.hover_nea_m)


def _on_fence_reading(state: State, event: events.FenceReading, turn: Turn) -> None:
    """The fence has changed: said at once; who waits for it is `decisions.waits_for_fence`."""
    if not event.items:
        state.fence_unread_s = None
        return
    if state.fence_unread_s is None:
        state.fence_unread_s = event.time_s
    if event.items > _FEW_ITEMS:
        turn.warn(f"the fence has changed: reading {event.items:,} items")


def _on_near_things(state: State, event: events.NearSeen, turn: Turn) -> None:
    """A sensor has looked around: stop if it is blind now, or something is in the way."""
    vehicle, path = state.vehicle, state.path
    range_m, sees_m, vehicle.sight = state.task.settings.scan_range_m, event.sees_m, event.sight
    if state.airborne and sees_m < min(range_m, vehicle.sees_m):  # before: preflight
        vehicle.sees_m = sees_m
        turn.warn(f"sensor sees {sees_m:g} m of R = {range_m:g} m")
    if state.phase not in ON_PATH or path is None:
        return
    stops_for = None if path.stop is None else path.stop.reason
    if event.sight.is_blind:
        if not state.flight.returning and stops_for is None:  # what was flown is flown again
            turn.warn(Reason.SENSOR_SILENT.text)
            following.stop(state, Reason.SENSOR_SILENT, turn)
        return
    kept_m = state.task.settings.safety_distance_m + state.task.limits.tracking_error_m
    legs = [(path.leg, following.vehicle_at_m(state, path)), (path.next_leg, 0.0)]
    if stops_for is not Reason.NEW_THREAT and any(
        leg and leg.meets(event.near, at_m, kept_m) for leg, at_m in legs
    ):
        following.stop(state, Reason.NEW_THREAT, turn)


def _on_ground_seen(state: State, event: events.GroundSeen, turn: Turn) -> None:
    """The ground is nearer than the map says: stop, and wait for the two to agree.

    Not on the way back: what was flown before is flown again; nor while it stops: `stopped` waits
    for it, too.
    """
    state.vehicle.ground_above_m = event.above_m
    flight, path = state.flight, state.path
    follows = state.phase is Phase.FLYING and path is not None and path.stop is None
    if event.above_m and follows and flight.way is Way.OUT:
        turn.warn(f"{Reason.GROUND_NEARER.text}: by {event.above_m:.1f} m")
        following.stop(state, Reason.GROUND_NEARER, turn)


def _inside(state: State) -> str:
    """The name of a zone that the vehicle violates; empty: none."""
    position = state.vehicle.position_nea_m
    if position is None:
        return ""
    zone, gap_m = nearest(state.task.zones, position[0], position[1])
    return zone.name if zone is not None and gap_m < 0.0 else ""


# --- targets and orders


def _on_targets(state: State, event: events.TargetsChanged, turn: Turn) -> None:
    """Those of the vehicle's mission; not on the way home."""
    flight, targets_ne_m = state.flight, event.targets_ne_m
    if targets_ne_m == state.targets_ne_m:
        return
    if flight.returning or flight.fallen_back is not None:
        turn.warn("mission changed: returning all the same")
    elif not targets_ne_m and state.phase not in (Phase.WAITING, Phase.PREPARING, Phase.READY):
        turn.warn("the vehicle's mission is empty: the old one is flown")
    else:
        _fly_to(state, targets_ne_m, "mission changed", turn)


def _fly_to(state: State, targets_ne_m: Targets, why: str, turn: Turn) -> None:
    """New targets: stop, and plan to the first of them."""
    flight = state.flight
    for target in targets_ne_m:
        if trouble := target_refusal(state.task, target):
            return turn.warn(f"{why}: {trouble}")
    set_targets(state, targets_ne_m, Way.OUT)
    state.vehicle.battery_short_at_s = flight.fallen_back = flight.refusal = None
    if isinstance(state.stage, phases.Flying) and isinstance(state.stage.search, phases.Planning):
        state.stage.search = phases.Answered()
    turn.say(why)
    if state.phase in ON_PATH and targets_ne_m:
        following.stop(state, Reason.NEW_TARGET, turn)
    elif state.phase is Phase.ARRIVED and state.stage.asks:
        turn.fault(Reason.TAKING_OVER)  # it may hold by now
    elif state.phase is Phase.ARRIVED:
        turn.to(Trigger.NEXT_TARGET)
    elif state.held_for in ORDERED:
        hold_for(state, Reason.NEW_TARGET)


def _on_order(state: State, order: Order, turn: Turn) -> None:
    match order.kind:
        case OrderKind.START if state.phase is Phase.READY:
            turn.say(f"go: told by {order.sender}")
            turn.to(Trigger.GO)
        case OrderKind.START | OrderKind.CONTINUE:
            _go_on(state, turn)
        case OrderKind.PAUSE:
            _pause(state, turn)
        case OrderKind.REPOSITION:
            assert order.target_ne_m is not None
            outward = state.phase is Phase.FLYING and state.flight.target == 0
            flies = outward and state.order is None and not state.flight.homeward
            if not flies or (order.target_ne_m,) != state.targets_ne_m:  # else it goes there
                state.goal, state.paused = Goal.TARGETS, False
                _fly_to(state, (order.target_ne_m,), "new target", turn)
        case OrderKind.RETURN:
            goes_on = turn.context.mission.goes_on_while_reading
            if state.fence_unread_s is not None and not goes_on:
                turn.say(_WAITS_FOR_FENCE)
            if state.flight.way is not Way.OUT:
                _back_again(state, turn)
            else:
                _stop_for(state, Goal.HOME, turn)
        case OrderKind.LAND:  # once it has stopped
            if state.phase is not Phase.LANDING and state.order is not Reason.LAND_ASKED:
                _stop_for(state, Goal.LAND, turn)


def _go_on(state: State, turn: Turn) -> None:
    """End a pause: it goes on to its goal."""
    state.paused = False
    wanted = state.order or Reason.CONTINUED
    if state.phase in ON_PATH and _brakes_for(state, wanted, Reason.PAUSED):
        turn.say("going on")
    elif state.held_for is Reason.PAUSED:
        turn.say("going on")
        resumed(state, turn)
    elif isinstance(state.stage, phases.Holding) and state.stage.why in TAKEN:
        state.stage.released_at_s = state.now_s


def _pause(state: State, turn: Turn) -> None:
    """Hold until an order to continue; a return that has not begun is suspended."""
    if not _may_pause(state):
        return
    if state.held_for is not None:
        turn.say(Reason.PAUSED.text)
    _stop_for(state, state.goal, turn, pauses=True)


def _back_again(state: State, turn: Turn) -> None:
    """Go on with the backtrack."""
    if state.goal is not Goal.LAND:
        if state.paused:
            _go_on(state, turn)
        return
    state.goal, state.paused = Goal.HOME, False
    if not _brakes_for(state, Reason.CONTINUED, Reason.PAUSED, Reason.LAND_ASKED):
        if state.held_for not in (Reason.PAUSED, Reason.LAND_ASKED):
            return
        hold_for(state, Reason.CONTINUED)
    turn.say("going on")


def _brakes_for(state: State, reason: Reason, *before: Reason) -> bool:
    """Whether it stops on its path for one of those before; then it does for another reason."""
    path = state.path
    if path is None or path.stop is None or path.stop.reason not in before:
        return False
    path.stop = replace(path.stop, reason=reason)
    return True


def _stop_for(state: State, goal: Goal, turn: Turn, *, pauses: bool = False) -> None:
    """Stop as the phase allows; then it goes on to that goal, or waits in a pause."""
    state.goal, state.paused = goal, pauses
    order = Reason.PAUSED if pauses else goal.value
    assert order is not None
    if state.phase in GOING_UP:
        turn.fault(Reason.BROKEN_OFF)
    elif state.phase is Phase.ARRIVED and state.stage.asks:  # the end action's mode: it may have it
        turn.fault(Reason.TAKING_OVER)
    elif state.phase in (*ON_PATH, Phase.ARRIVED):
        following.stop(state, order, turn)
    elif state.held_by is By.SETPOINTS and state.reason is not order:
        hold_for(state, order)


# --- the vehicle itself


def _on_fence_breach(state: State, event: events.FenceBreach, turn: Turn) -> None:
    state.vehicle.fence_breached_at_s = event.time_s
    if is_breach_of_fence(state):
        taken(state, turn)


def _on_prepared(state: State, event: events.Prepared, turn: Turn) -> None:
    if not event.refusal or state.phase in (Phase.PREPARING, Phase.READY):
        turn.is_left = True
    elif state.phase is Phase.ARMING:
        turn.give_up(Reason.REFUSED, f": {event.refusal}", event.remedy)
    else:
        turn.warn(event.refusal)


def _on_reboot(state: State, _event: events.Rebooted, turn: Turn) -> None:
    """The autopilot has rebooted: prepare again; the known terrain is kept."""
    if state.phase is Phase.WAITING:
        turn.is_left = True
        return
    flight = state.flight
    home, traits = state.vehicle.home_nea_m if state.airborne else None, state.vehicle.traits
    if flight.returning and state.goal is Goal.TARGETS:  # the way back is asked for again
        state.goal = Goal.HOME
    was = state.stage
    again = phases.Preparing()
    if state.phase is Phase.READY or state.unready:
        again.unready = Reason.REBOOTED.text
    if was.phase is Phase.LANDING:  # it goes on with that, as after a restart
        again.landing, again.sank = True, was.obeyed
    elif isinstance(was, phases.Preparing):
        again.landing, again.sank = was.landing, was.sank
    if isinstance(was, phases.Led | phases.Preparing) and was.path is not None:
        following.note_flown(state, was.path, was.path.reference.length_m)
        was.path = None
    state.flight = Flight(
        known=flight.known,
        target=flight.target,
        plan_id=flight.plan_id,
        legs_flown=flight.legs_flown,
        flown=flight.flown,
        way=Way.HOME if flight.homeward else Way.OUT,
        fallen_back=flight.fallen_back,
    )
    state.vehicle = Vehicle(
        traits=traits, bad_at_s=state.now_s, home_nea_m=home, home_kept=home is not None
    )
    state.prepared, state.fence_unread_s = frozenset(), None
    state.armed_by_us = state.armed_by_us and state.airborne  # on the ground it is another's
    turn.warn(Reason.REBOOTED.text)
    turn.to(Trigger.PREPARE_AGAIN, again)


HANDLERS: Final[dict[type[Event], Callable[[State, Any, Turn], None]]] = {
    events.NearSeen: _on_near_things,
    events.GroundSeen: _on_ground_seen,
    events.FenceChanged: _on_fence,
    events.FenceReading: _on_fence_reading,
    events.FenceBreach: _on_fence_breach,
    events.TargetsChanged: _on_targets,
    Order: _on_order,
    events.Rebooted: _on_reboot,
    events.Prepared: _on_prepared,
}
"""Handlers of events that are independent of the phase."""
