"""The phases before the flight: waiting, preparing, arming, taking off.  Each wait has an end."""

import dataclasses
import math

import numpy as np
from msgspec.structs import replace

from companion.geodesy import FloatArray
from companion.mission import following, joining
from companion.mission.decisions import (
    AT_M,
    BROKEN_OFF,
    Context,
    Step,
    ask,
    came_second,
    cannot_fly,
    fault,
    give_up,
    has_led,
    in_phase_s,
    is_at_rest,
    is_gone,
    is_silent,
    is_suspected,
    taken_by,
)
from companion.mission.driving import TakeOffWay
from companion.mission.events import (
    Arm,
    Event,
    Item,
    Landed,
    LinkLost,
    Mode,
    Namesake,
    Position,
    Prepared,
    Say,
    SetMode,
    TakeOff,
    Vector,
    VehicleFound,
)
from companion.mission.health import battery_lasts
from companion.mission.state import Orders, Phase, Reason, State, Trigger
from companion.world.zone_index import index_of

_PREPARE_S = 120.0
_ASKED_FOR = (Item.PARAMETERS, Item.PLANS)  # of the autopilot itself, in the air as well
_LISTEN_S = 1.0  # other companions say once a second that they are there
_UNLED_S = 2.0  # in guided mode, in the air, with a position that is not to be believed
_ARM_S = 60.0
_CLIMB_SAMPLES = 200
_TAKE_OFF_SLACK_S = 60.0
_BEGINS_S = 5.0  # a take-off that was accepted: 5 m up by then (ardupilot.md 2; px4.md 10: 1 s)
_CLIMBED_M = 20.0  # above home: a plane may be led from here on
_LEVEL_M_S = 1.0


def waiting(state: State, event: Event, _context: Context) -> Step:
    """For an autopilot that the mission is for; the runtime says when it has waited long enough."""
    if isinstance(event, VehicleFound):
        if event.driving is None:
            return give_up(state, Reason.WRONG_VEHICLE, f": {event.name}")
        return state, [], Trigger.VEHICLE_FOUND
    if isinstance(event, LinkLost):
        return give_up(state, Reason.NO_VEHICLE)
    return state, [], None


def preparing(state: State, event: Event, context: Context) -> Step:
    """For a position that may be believed, home, parameters and fence, on the ground or in flight.

    What a companion before this one had prepared need not be prepared again in the air.
    """
    vehicle = state.vehicle
    if isinstance(event, LinkLost):
        return _silent(state, event, context)
    if isinstance(event, Prepared) and event.refusal and not context.shadow:
        if _is_flying(state):
            return state, [Say(text=event.refusal, warning=True)], None
        return give_up(state, Reason.REFUSED, f": {event.refusal}", event.remedy)
    if in_phase_s(state) > _PREPARE_S:
        return give_up(state, Reason.NOT_READY, _missing(state))
    if is_silent(state):
        return state, [], None
    if came_second(state) and not context.shadow:
        return give_up(state, Reason.NOT_ALONE)
    if not (has_led(state) or context.shadow) and _may_not_be_alone(state):
        return state, [], None
    if state.landing and not context.shadow:
        return _landing_goes_on(state)
    if vehicle.distrust is not None:
        unled = _is_flying(state) and vehicle.mode is Mode.GUIDED and not context.shadow
        if unled and in_phase_s(state) > _UNLED_S:
            return ask(state, SetMode(mode=Mode.HOLD))
        return state, [], None
    if context.shadow:
        return state, [], Trigger.WATCH
    if _is_flying(state):
        return _in_flight(state)
    ready = state.prepared.issuperset(_ASKED_FOR) and vehicle.home_nea_m is not None
    if vehicle.landed is not Landed.ON_GROUND or not ready:
        return state, [], None
    if state.airborne:
        return give_up(state, Reason.GROUNDED)
    state, commands, trigger = _on_ground(state, context)
    waits = trigger is Trigger.READY and Item.CHECKS not in state.prepared
    return state, commands, None if waits else trigger


def _may_not_be_alone(state: State) -> bool:
    """Whether it is too early to know that there is no other companion, as far as it can be.

    On the ground there is time enough for that while it arms; who goes on with a path of its own
    must be quick, and yields if it then hears another (`came_second`).
    """
    takes_over = _is_flying(state) and state.flight.leg is None
    return is_suspected(state) or (takes_over and in_phase_s(state) < _LISTEN_S)


def not_alone(state: State, event: Namesake, context: Context) -> Step:
    """Somebody else with our ids: of two companions the one that came second takes no command.

    Two streams of setpoints would pull the vehicle apart.  Whoever has had it in the air flies on
    and says so; whoever hears the other before that ends.
    """
    if came_second(state) and not context.shadow:
        begun = state.phase is not Phase.WAITING
        return give_up(state, Reason.NOT_ALONE) if begun else (state, [], None)
    if event.certain and event.news:
        return state, [Say(text=f"{Reason.NOT_ALONE.text}: end it", warning=True)], None
    return state, [], None


def _landing_goes_on(state: State) -> Step:
    """What a companion before this one had begun is seen to its end."""
    vehicle = state.vehicle
    if vehicle.landed is Landed.ON_GROUND and not vehicle.armed:
        return state, [], Trigger.LANDED
    if vehicle.landed is Landed.UNKNOWN:
        return state, [], None
    state = replace(state, landing=False)
    if state.sank and vehicle.mode is not Mode.LAND:
        says = Say(text=BROKEN_OFF, warning=True)
        return replace(state, orders=Orders(Reason.PAUSED)), [says], None
    return state, [], Trigger.END_LAND if vehicle.mode in (Mode.LAND, Mode.GUIDED) else None


def _silent(state: State, event: LinkLost, context: Context) -> Step:
    if state.airborne and not is_gone(state, event, context):
        return state, [], None
    return give_up(state, Reason.LINK_LOST)


def _is_flying(state: State) -> bool:
    return state.vehicle.armed and state.vehicle.landed not in (Landed.ON_GROUND, Landed.UNKNOWN)


def _missing(state: State) -> str:
    """What a vehicle that does not get ready has not said."""
    vehicle = state.vehicle
    missing = [item.value for item in Item if item not in state.prepared]
    if vehicle.home_nea_m is None:
        missing.append("home")
    if vehicle.landed is Landed.UNKNOWN:
        missing.append("landed state")
    distrusted = vehicle.distrust
    if distrusted is not None:
        missing.append(distrusted.text)
    return f": {', '.join(missing)}" if missing else ""


def _on_ground(state: State, context: Context) -> Step:
    if not state.targets_ne_m:
        return give_up(state, Reason.NO_TARGETS)
    if state.vehicle.armed and not state.armed_by_us:
        return give_up(state, Reason.ARMED_ALREADY)
    if height_m(state, context) <= 0.0:
        return give_up(state, Reason.HOME_TOO_HIGH)
    if not may_rise(state, context):
        return give_up(state, Reason.OUTSIDE)
    if not battery_lasts(state, context.mission):
        return give_up(state, Reason.BATTERY_SHORT)
    return state, [], Trigger.READY


def _in_flight(state: State) -> Step:
    """Take over in the air: the path of the companion that was here before, or stop first."""
    if not state.flight.leg and not state.prepared.issuperset(_ASKED_FOR):
        return state, [], None
    if not state.targets_ne_m:
        return give_up(state, Reason.NO_TARGETS)
    mode = state.vehicle.mode
    if state.orders.active is not None or state.taken or state.flight.returning:
        ours = mode in (Mode.GUIDED, Mode.HOLD) and not state.taken
        reason = Reason.TAKING_OVER if ours else taken_by(state)
        flight = following.at_rest(following.unflown(state.flight), None)
        return replace(state, reason=reason, flight=flight), [], Trigger.IN_FLIGHT
    asked = state.asks > 0  # to hold: it may do so by now
    if mode is Mode.GUIDED and state.flight.leg is not None and not asked:
        joined = joining.joined(state)
        if joined is not None:
            return replace(state, flight=joined), [], Trigger.TAKE_OVER
    ours = mode in (Mode.GUIDED, Mode.HOLD, Mode.TAKE_OFF)
    reason = Reason.TAKING_OVER if ours else taken_by(state)
    return replace(state, reason=reason), [], Trigger.IN_FLIGHT


def arming(state: State, event: Event, context: Context) -> Step:
    """Ask for the mode that the take-off begins with, then to arm, once a second."""
    vehicle, driving = state.vehicle, state.vehicle.driving
    if isinstance(event, LinkLost):
        return give_up(state, Reason.LINK_LOST)
    if is_suspected(state):
        return state, [], None
    first = Mode.GUIDED if driving.take_off is TakeOffWay.GUIDED_THEN_CLIMB else Mode.TAKE_OFF
    if vehicle.mode is first and vehicle.armed:
        return state, [], Trigger.ARMED
    if vehicle.mode is first:
        state = replace(state, obeyed=True)
    elif state.obeyed or (vehicle.armed and not state.armed_by_us):
        return give_up(state, Reason.MODE_TAKEN)
    rises = vehicle.landed is not Landed.ON_GROUND
    if in_phase_s(state) > _ARM_S or (rises and not state.armed_by_us):
        return give_up(state, Reason.NOT_ARMED)
    if rises:
        return state, [], None  # its next heartbeat will say that it is armed
    if vehicle.mode is first:
        return ask(replace(state, armed_by_us=True), Arm())
    if driving.take_off is TakeOffWay.CLIMB_THEN_ARM:
        return _ask_to_take_off(state, context)
    return ask(state, SetMode(mode=first))


def taking_off(state: State, event: Event, context: Context) -> Step:
    """Wait until it is at the floor of the band; ask for the climb, where that comes after arming.

    An autopilot that climbs in a mode of its own then holds, and is taken over like any other.
    """
    vehicle, driving = state.vehicle, state.vehicle.driving
    guided = driving.take_off is TakeOffWay.GUIDED_THEN_CLIMB
    modes = (Mode.GUIDED,) if guided else (Mode.TAKE_OFF, Mode.HOLD, Mode.GUIDED)
    if vehicle.landed is Landed.ON_GROUND:
        return _still_on_ground(state, event, context, modes)
    reason = cannot_fly(state, event, modes)
    if reason is not None:
        return fault(state, reason)
    if isinstance(event, Position) and _has_climbed(state, event, context, guided=guided):
        if guided:
            return state, [], Trigger.AIRBORNE
        return replace(state, reason=Reason.TAKING_OVER), [], Trigger.HANDED_OVER
    if in_phase_s(state) > _longest_climb_s(state, context):
        return give_up(state, Reason.NO_TAKE_OFF)
    return state, [], None


def _has_climbed(state: State, event: Position, context: Context, *, guided: bool) -> bool:
    """At the height asked for, or as high as the autopilot's own take-off goes."""
    landed, off_m = state.vehicle.landed, event.position_nea_m[2] - take_off_amsl_m(state, context)
    if guided:
        return landed is Landed.IN_AIR and abs(off_m) < AT_M and is_at_rest(state, event)
    if landed is not Landed.IN_AIR:
        return False
    if off_m > -AT_M:
        return True
    home = state.vehicle.home_nea_m
    risen_m = 0.0 if home is None else event.position_nea_m[2] - home[2]
    level = abs(event.velocity_nea_m_s[2]) < _LEVEL_M_S
    return level and risen_m > _CLIMBED_M and state.vehicle.mode is not Mode.OTHER


def _still_on_ground(state: State, event: Event, context: Context, modes: tuple[Mode, ...]) -> Step:
    reason = cannot_fly(state, event, modes, stands=True)
    if reason is not None:
        return give_up(state, reason)
    if height_m(state, context) <= 0.0:
        return give_up(state, Reason.HOME_TOO_HIGH)
    if in_phase_s(state) > _longest_climb_s(state, context):
        return give_up(state, Reason.NO_TAKE_OFF)
    if modes != (Mode.GUIDED,):
        return state, [], None
    return _ask_to_take_off(state, context)


def _ask_to_take_off(state: State, context: Context) -> Step:
    """Until it is accepted; then again only if it has not begun after a while."""
    if state.now_s - state.vehicle.take_off_taken_at_s < _BEGINS_S:
        return state, [], None
    above_home_m, amsl_m = height_m(state, context), take_off_amsl_m(state, context)
    return ask(state, TakeOff(above_home_m=above_home_m, altitude_amsl_m=amsl_m))


def may_rise(state: State, context: Context) -> bool:
    """Whether the vehicle stands on the map and climbs clear of zones: a plane climbs ahead."""
    task, here = state.task, state.vehicle.position_nea_m
    if here is None:
        return False
    for value, (low, high) in zip(here, (task.limits.north_m, task.limits.east_m), strict=False):
        if not low <= value <= high:
            return False
    north, east = _climb_out_ne_m(state, context, here)
    gaps_m = index_of(task.zones).gaps_m(north, east, 2.0 * task.zone_clearance_m)
    return bool(gaps_m.min() >= task.zone_clearance_m)


def _climb_out_ne_m(state: State, context: Context, here: Vector) -> tuple[FloatArray, FloatArray]:
    """Where the climb leads over: straight up, or straight on along a plane's nose."""
    limits, heading = state.task.limits, state.vehicle.heading_rad
    climb_s = max(height_m(state, context), 0.0) / limits.climb_rate_m_s
    ahead_m = 0.0 if limits.hovers or heading is None else limits.speed_m_s * climb_s
    along = np.linspace(0.0, ahead_m, _CLIMB_SAMPLES)
    heading = heading or 0.0
    return here[0] + along * math.cos(heading), here[1] + along * math.sin(heading)


def take_off_amsl_m(state: State, context: Context) -> float:
    """Where the climb-out ends, within the vehicle's own fence too."""
    return dataclasses.replace(context.mission, task=state.task).take_off_amsl_m


def height_m(state: State, context: Context) -> float:
    """How far above home the climb-out ends."""
    home = state.vehicle.home_nea_m
    return take_off_amsl_m(state, context) - (0.0 if home is None else home[2])


def _longest_climb_s(state: State, context: Context) -> float:
    climb_rate = state.task.limits.climb_rate_m_s
    return 2.0 * max(height_m(state, context), 0.0) / climb_rate + _TAKE_OFF_SLACK_S
