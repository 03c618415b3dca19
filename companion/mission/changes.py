"""External changes during a mission: threats, targets, orders."""

import enum
from collections.abc import Callable
from typing import Any, Final

from msgspec.structs import replace

from companion.mission import events, following, ground
from companion.mission.battery import battery_is_short
from companion.mission.decisions import Context, Step, fault, give_up, preceded, with_hold_reason
from companion.mission.events import Command, Event, Landed, say, warn
from companion.mission.state import (
    ON_PATH,
    ON_SETPOINTS,
    OVER,
    Answered,
    Flight,
    Held,
    Hold,
    Orders,
    Phase,
    Planning,
    Reason,
    State,
    Trigger,
    Vehicle,
    Way,
)
from companion.mission.stopped import resumed, taken
from companion.mission.tables import is_breach_of_fence
from companion.planner.progress import NO_PROGRESS
from companion.planner.recheck import is_touched, meets_near_things
from companion.planner.rules import target_refusal
from companion.world.zones import nearest

_GOING_UP = (Phase.ARMING, Phase.TAKING_OFF)
_NOT_TO_GO_ON = (Phase.LANDING, Phase.HANDING_OVER, Phase.SHADOW, *OVER)
_OF_VEHICLE = "mission changed"
_FEW_ITEMS = 10  # of a fence: they are read before a person has read the text


class OrderResult(enum.Enum):
    """Result of an order."""

    ACCEPTED = "it is carried out"
    INVALID = "it cannot be carried out as it stands"
    NOT_NOW = "it cannot be carried out now"


def order_result(state: State, order: events.Order, *, go: bool = False) -> OrderResult:
    """The result of an order, for its acknowledgement; go: it takes off without being told."""
    in_air = state.phase in (*ON_PATH, *_GOING_UP, Phase.HOLDING, Phase.ARRIVED)
    match order.kind:
        case events.OrderKind.REPOSITION:
            if order.target_ne_m is None or target_refusal(state.task, order.target_ne_m):
                return OrderResult.INVALID
            led = in_air and state.phase not in _GOING_UP
            return OrderResult.ACCEPTED if led else OrderResult.NOT_NOW
        case events.OrderKind.START | events.OrderKind.CONTINUE if not go and _waits_for_go(state):
            ready = state.phase is Phase.READY and order.kind is events.OrderKind.START
            return OrderResult.ACCEPTED if ready else OrderResult.NOT_NOW
        case events.OrderKind.START | events.OrderKind.CONTINUE:
            return OrderResult.NOT_NOW if state.phase in _NOT_TO_GO_ON else OrderResult.ACCEPTED
        case events.OrderKind.PAUSE:
            return OrderResult.ACCEPTED if _may_pause(state) else OrderResult.NOT_NOW
        case events.OrderKind.RETURN:
            held = state.hold is not None and not (_accepts_orders(state) or _stops(state))
            return OrderResult.ACCEPTED if in_air and not held else OrderResult.NOT_NOW
        case events.OrderKind.LAND:
            held = state.hold in (Hold.TAKEN_OVER, Hold.GROUNDED, Hold.SILENT)
            if state.phase is not Phase.LANDING and (held or not in_air):
                return OrderResult.NOT_NOW
            down = state.phase in _GOING_UP and state.vehicle.landed is Landed.ON_GROUND
            lands = state.vehicle.traits.lands or down  # then it stays there
            return OrderResult.ACCEPTED if lands else OrderResult.INVALID


def why_not(state: State, order: events.Order) -> str:
    """Why an order is refused, as text for its sender."""
    why = f"the mission is {state.phase.value}"
    if order_result(state, order) is OrderResult.INVALID:
        place = order.target_ne_m
        why = "it has no target" if place is None else target_refusal(state.task, place)
        if order.kind is events.OrderKind.LAND:
            why = f"{state.vehicle.traits.name} is not told to land: send it back"
    elif order.kind is events.OrderKind.PAUSE and _is_short(state):
        why = Reason.BATTERY_LOW.text
    elif order.kind is events.OrderKind.START and _waits_for_go(state):
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
    return state.orders.active is Reason.BATTERY_LOW or battery_is_short(state)


def _may_pause(state: State) -> bool:
    """Whether a pause is possible: a low battery would end it at once."""
    if state.phase in _GOING_UP:
        return True
    if _is_short(state):
        return False
    return _accepts_orders(state) or _stops(state) or state.phase in ON_PATH


def _accepts_orders(state: State) -> bool:
    """Whether an order takes effect immediately in this hold."""
    return state.hold in ON_SETPOINTS and state.reason is not Reason.BATTERY_LOW


def _stops(state: State) -> bool:
    """Whether it is stopped by its autopilot: an order takes effect once it is led again."""
    return state.hold in (Hold.MODE, Hold.TAKE_OVER)


# --- threats


def _with_fence(state: State, event: events.FenceChanged, context: Context) -> Step:
    """A new fence: recheck the rest of the path, and stop if it conflicts."""
    known = state.fence is not None
    state = state.with_fence(context.mission.task, event)
    says: list[Command] = [say(f"fence: {len(event.zones)} zones", warning=known)]
    if (inside := _inside(state)) and state.phase not in ON_PATH:
        says.append(warn(f"inside zone {inside}"))
    if not _is_touched(state):
        return state, says, None
    if state.phase not in ON_PATH:  # a path that was to be gone on with
        flight = following.at_rest(state.flight, state.flight.hover_nea_m)
        return replace(state, flight=flight), says, None
    return preceded(says, following.stop(state, Reason.NEW_THREAT))


def _fence_reading(state: State, event: events.FenceReading, _context: Context) -> Step:
    """The fence has changed: said at once; who waits for it is `decisions.waits_for_fence`."""
    if not event.items:
        return replace(state, fence_unread_s=None), [], None
    if state.fence_unread_s is None:
        state = replace(state, fence_unread_s=event.time_s)
    text = f"the fence has changed: reading {event.items:,} items"
    return state, [warn(text)] if event.items > _FEW_ITEMS else [], None


def _with_near_things(state: State, event: events.NearSeen, _context: Context) -> Step:
    """A sensor has looked around: stop if it is blind now, or something is in the way."""
    range_m, sees_m, says = state.task.settings.scan_range_m, event.sees_m, list[Command]()
    if state.airborne and sees_m < min(range_m, state.vehicle.sees_m):  # before: preflight
        state = state.told(sees_m=sees_m)
        says = [warn(f"sensor sees {sees_m:g} m of R = {range_m:g} m")]
    state = state.told(sight=event.sight)
    path = state.flight.path
    if state.phase not in ON_PATH or path is None:
        return state, says, None
    stops_for = None if path.stop is None else path.stop.reason
    if event.sight.is_blind:
        if state.flight.returning or stops_for is not None:
            return state, says, None  # what was flown before is flown again
        says.append(warn(Reason.SENSOR_SILENT.text))
        return preceded(says, following.stop(state, Reason.SENSOR_SILENT))
    kept_m = state.task.settings.safety_distance_m + state.task.limits.tracking_error_m
    legs = [(path.leg, following.vehicle_at_m(state, path)), (path.next_leg, 0.0)]
    if stops_for is not Reason.NEW_THREAT and any(
        leg and meets_near_things(leg, at_m, event.near, kept_m) for leg, at_m in legs
    ):
        return preceded(says, following.stop(state, Reason.NEW_THREAT))
    return state, says, None


def _on_ground_seen(state: State, event: events.GroundSeen, _context: Context) -> Step:
    """The ground is nearer than the map says: stop, and wait for the two to agree.

    Not on the way back: what was flown before is flown again; nor while it stops: `stopped` waits
    for it, too.
    """
    state = state.told(ground_above_m=event.above_m)
    flight, path = state.flight, state.flight.path
    follows = state.phase is Phase.FLYING and path is not None and path.stop is None
    if not event.above_m or not follows or flight.returning or flight.homeward:
        return state, [], None
    says = warn(f"{Reason.GROUND_NEARER.text}: by {event.above_m:.1f} m")
    return preceded([says], following.stop(state, Reason.GROUND_NEARER))


def _is_touched(state: State) -> bool:
    """Whether the rest of the path conflicts with a new rule."""
    flight = state.flight
    legs = [(flight.leg, flight.reference.length_m), (flight.next_leg, 0.0)]
    legs += [(leg, 0.0) for leg in flight.back]
    return any(leg is not None and is_touched(leg, at_m, state.task) for leg, at_m in legs)


def _inside(state: State) -> str:
    """The name of a zone that the vehicle violates; empty: none."""
    here = state.vehicle.position_nea_m
    if here is None:
        return ""
    zone, gap_m = nearest(state.task.zones, here[0], here[1])
    return zone.name if zone is not None and gap_m < 0.0 else ""


# --- targets and orders


def _with_targets(state: State, targets_ne_m: tuple[tuple[float, float], ...], why: str) -> Step:
    """New targets: stop, and plan to the first of them."""
    flight, of_vehicle = state.flight, why == _OF_VEHICLE
    if targets_ne_m == state.targets_ne_m and (of_vehicle or _flies_there(state)):
        return state, [], None
    if of_vehicle and (flight.returning or flight.fallen_back is not None):
        return state, [warn("mission changed: returning all the same")], None
    if not targets_ne_m and state.phase not in (Phase.WAITING, Phase.PREPARING, Phase.READY):
        return state, [warn("the vehicle's mission is empty: the old one is flown")], None
    for target in targets_ne_m:
        if trouble := target_refusal(state.task, target):
            return state, [warn(f"{why}: {trouble}")], None
    orders = state.orders if of_vehicle else Orders()
    state = replace(state, targets_ne_m=targets_ne_m, orders=orders)
    state = state.told(battery_short_at_s=None).with_flight(  # it may reach this one
        target=0,
        route_ne_m=(),
        progress=NO_PROGRESS,
        stops=0,
        failures=0,
        way=Way.OUT,
        back=(),
        fallen_back=None,
        search=Answered() if isinstance(flight.search, Planning) else flight.search,
        planning_backtrack=None,
        refusal=None,
    )
    says: list[Command] = [say(why)]
    if state.phase in ON_PATH and targets_ne_m:
        return preceded(says, following.stop(state, Reason.NEW_TARGET))
    if state.phase is Phase.ARRIVED:
        if state.asks == 0:
            return state, says, Trigger.NEXT_TARGET
        return preceded(says, fault(state, Reason.TAKING_OVER))  # it may hold by now
    if state.hold in (Hold.PAUSED, Hold.RETURN, Hold.LAND):
        state = with_hold_reason(state, Reason.NEW_TARGET)
    return state, says, None


def _flies_there(state: State) -> bool:
    """Whether the vehicle is flying to the first target, with no other order active."""
    outward = state.phase is Phase.FLYING and state.flight.target == 0
    return outward and state.orders.active is None and not state.flight.homeward


def _ordered(state: State, order: events.Order, context: Context) -> Step:
    match order.kind:
        case events.OrderKind.START if state.phase is Phase.READY:
            return state, [say(f"go: told by {order.sender}")], Trigger.GO
        case events.OrderKind.START | events.OrderKind.CONTINUE:
            return _go_on(state)
        case events.OrderKind.PAUSE:
            return _pause(state)
        case events.OrderKind.REPOSITION:
            assert order.target_ne_m is not None
            return _with_targets(state, (order.target_ne_m,), "new target")
        case events.OrderKind.RETURN:
            waits = state.fence_unread_s is not None and not context.mission.goes_on_while_reading
            text = "it returns once the changed fence is read, or goes on being read for too long"
            on_its_way = state.flight.returning or state.flight.homeward
            step = _back_again(state) if on_its_way else _stop_for(state, Reason.RETURN_ASKED)
            return preceded([say(text)] if waits else [], step)
        case events.OrderKind.LAND:  # once it has stopped
            lands = state.phase is Phase.LANDING or state.orders.active is Reason.LAND_ASKED
            return (state, [], None) if lands else _stop_for(state, Reason.LAND_ASKED)


def _go_on(state: State) -> Step:
    """End a pause: the order suspended by it is active again."""
    wanted = state.orders.suspended or Reason.CONTINUED
    state = replace(state, orders=state.orders.continued())
    if state.phase in ON_PATH and (after := _braking_for(state, wanted, Reason.PAUSED)):
        return after, [say("going on")], None
    if state.hold is Hold.PAUSED:
        return preceded([say("going on")], resumed(state))
    if state.hold is Hold.TAKEN_OVER:
        released = Held(Hold.TAKEN_OVER) if state.held is None else state.held
        return replace(state, held=replace(released, released_at_s=state.now_s)), [], None
    return state, [], None


def _pause(state: State) -> Step:
    """Hold until an order to continue; a return that has not begun is suspended."""
    if not _may_pause(state):
        return state, [], None
    state = replace(state, orders=state.orders.paused())
    if state.phase in _GOING_UP:
        return fault(state, Reason.BROKEN_OFF)
    if _stops(state):
        return state, [say(Reason.PAUSED.text)], None
    if state.phase in ON_PATH:
        return following.stop(state, Reason.PAUSED)
    state = with_hold_reason(state.with_flight(planning_backtrack=None), Reason.PAUSED)
    return state, [say(Reason.PAUSED.text)], None


def _back_again(state: State) -> Step:
    """Go on with the backtrack."""
    orders = state.orders
    if Reason.LAND_ASKED not in (orders.active, orders.suspended):
        return _go_on(state) if orders.active is Reason.PAUSED else (state, [], None)
    state = replace(state, orders=Orders())
    after = _braking_for(state, Reason.CONTINUED, Reason.PAUSED, Reason.LAND_ASKED)
    if after is None and state.hold in (Hold.PAUSED, Hold.LAND):
        after = with_hold_reason(state, Reason.CONTINUED)
    return (state, [], None) if after is None else (after, [say("going on")], None)


def _braking_for(state: State, reason: Reason, *before: Reason) -> State | None:
    """The state if it stops on its path for another reason than one of those before."""
    path = state.flight.path
    if path is None or path.stop is None or path.stop.reason not in before:
        return None
    return state.with_flight(path=replace(path, stop=replace(path.stop, reason=reason)))


def _stop_for(state: State, order: Reason) -> Step:
    """Stop as the phase allows; then the order is carried out."""
    state = replace(state, orders=Orders(order))
    if state.phase in _GOING_UP:
        return fault(state, Reason.BROKEN_OFF)
    if state.phase is Phase.ARRIVED and state.asks:  # for the end action's mode: it may have it
        return fault(state, Reason.TAKING_OVER)
    if state.phase in (*ON_PATH, Phase.ARRIVED):
        return following.stop(state, order)
    if state.hold in ON_SETPOINTS and state.reason is not order:
        state = with_hold_reason(state.with_flight(planning_backtrack=None), order)
    return state, [], None


# --- the vehicle itself


def _fence_breach(state: State, event: events.FenceBreach, _context: Context) -> Step:
    state = state.told(fence_breached_at_s=event.time_s)
    return taken(state) if is_breach_of_fence(state) else (state, [], None)


def _prepared(state: State, event: events.Prepared, _context: Context) -> Step | None:
    if not event.refusal or state.phase in (Phase.PREPARING, Phase.READY):
        return None
    if state.phase is Phase.ARMING:
        return give_up(state, Reason.REFUSED, f": {event.refusal}", event.remedy)
    return state, [warn(event.refusal)], None


def _rebooted(state: State, _event: events.Rebooted, _context: Context) -> Step | None:
    """The autopilot has rebooted: prepare again; the known terrain is kept."""
    if state.phase is Phase.WAITING:
        return None
    flight = state.flight
    blank = Flight(
        known=flight.known,
        target=flight.target,
        plan_id=flight.plan_id,
        legs_flown=flight.legs_flown,
        flown=flight.flown,
        way=Way.HOME if flight.homeward else Way.OUT,
        fallen_back=flight.fallen_back,
    )
    home, traits = state.vehicle.home_nea_m if state.airborne else None, state.vehicle.traits
    kept = home is not None
    vehicle = Vehicle(traits=traits, bad_at_s=state.now_s, home_nea_m=home, home_kept=kept)
    if flight.returning:  # the way back is asked for again
        orders = Orders(Reason.RETURN_ASKED)
        paused = state.orders.active is Reason.PAUSED
        state = replace(state, orders=orders.paused() if paused else orders)
    waited = state.phase is Phase.READY or state.unready
    if state.phase is Phase.LANDING:  # it goes on with that, as after a restart
        state = replace(state, landing=True, sank=state.obeyed)
    state = replace(
        state,
        flight=blank,
        vehicle=vehicle,
        prepared=frozenset(),
        armed_by_us=state.armed_by_us and state.airborne,  # on the ground it is another's
        fence_unread_s=None,
        unready=Reason.REBOOTED.text if waited else "",
    )
    return state, [warn(Reason.REBOOTED.text)], Trigger.PREPARE_AGAIN


HANDLERS: Final[dict[type[Event], Callable[[State, Any, Context], Step | None]]] = {
    events.NearSeen: _with_near_things,
    events.GroundSeen: _on_ground_seen,
    events.FenceChanged: _with_fence,
    events.FenceReading: _fence_reading,
    events.FenceBreach: _fence_breach,
    events.TargetsChanged: lambda state, e, _: _with_targets(state, e.targets_ne_m, _OF_VEHICLE),
    events.Order: _ordered,
    events.Rebooted: _rebooted,
    events.Prepared: _prepared,
}
"""Handlers of events that are independent of the phase; None: also left to the phase."""
