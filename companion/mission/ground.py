"""The phases before the flight: waiting, preparing, ready, arming, taking off.

Each wait has an end, but for that of a vehicle that is ready: somebody has to say go.
"""

import math

import numpy as np
from msgspec.structs import replace

from companion.geodesy import FloatArray
from companion.mission import events, following, way_back
from companion.mission.battery import battery_lasts
from companion.mission.decisions import (
    AT_M,
    LANDING_ABORTED,
    Context,
    Step,
    ask,
    fault,
    give_up,
    has_had_control,
    in_phase_s,
    is_at_rest,
    is_duplicate_suspected,
    is_grounded,
    is_second_companion,
    is_silent,
    landing_order,
)
from companion.mission.events import Event, Item, Landed, LinkLost, Mode, Position, Vector, warn
from companion.mission.state import Orders, Phase, Reason, State, Trigger
from companion.mission.tables import takeover_reason
from companion.mission.vehicle_traits import TakeoffSequence
from companion.world.zones import gaps_m as zone_gaps_m
from companion.world.zones import packed

_PREPARE_S = 120.0
_ASKED_FOR = (Item.PARAMETERS, Item.PLANS)  # of the autopilot itself, in the air as well
_LISTEN_S = 1.0  # other companions say once a second that they are there
_UNLED_S = 2.0  # in guided mode, in the air, with a position that is not to be believed
_ARM_S = 60.0
_CLIMB_SAMPLES = 200
_TAKE_OFF_SLACK_S = 60.0
_BEGINS_S = 5.0  # a take-off that was accepted: 5 m up by then (ardupilot.md 2; px4.md 10: 1 s)
_CLIMBED_M = 20.0  # above home: a plane may be led from here on
_LEAST_M = 1.0  # as near as an altitude is told, of a take-off that hardly climbs
_LEVEL_M_S = 1.0


def waiting(state: State, event: Event, _context: Context) -> Step:
    """Wait for a matching autopilot; the runtime decides how long."""
    if isinstance(event, events.VehicleFound):
        if event.traits is None:
            return give_up(state, Reason.WRONG_VEHICLE, f": {event.name}")
        return state, [], Trigger.VEHICLE_FOUND
    return state, [], None


def preparing(state: State, event: Event, context: Context) -> Step:
    """Wait for a valid position, home, parameters and fence, on the ground or in flight.

    After a restart in the air, preparations of the previous companion are not repeated.
    """
    vehicle = state.vehicle
    if context.shadow:
        return _to_watch(state)
    if isinstance(event, events.Prepared) and event.refusal:
        if _is_flying(state):
            return state, [warn(event.refusal)], None
        if state.unready:
            return _unready(_without(state, event.item), event.refusal)
        return give_up(state, Reason.REFUSED, f": {event.refusal}", event.remedy)
    if state.unready and vehicle.armed:
        return give_up(state, Reason.ARMED_ALREADY)  # it is not taken over in the air unasked
    if in_phase_s(state) > _PREPARE_S and not state.unready:
        missing = _missing(state)
        return give_up(state, Reason.NOT_READY, missing and f": {missing}")
    if is_silent(state):
        return state, [], None
    if is_second_companion(state):
        return give_up(state, Reason.NOT_ALONE)
    if not has_had_control(state) and _may_not_be_alone(state):
        return state, [], None
    if state.landing:
        return _landing_goes_on(state)
    if vehicle.distrust is not None:
        unled = _is_flying(state) and vehicle.mode is Mode.GUIDED
        if unled and in_phase_s(state) > _UNLED_S:
            return ask(state, events.SetMode(mode=Mode.HOLD))
        return state, [], None
    if _is_flying(state):
        return _in_flight(state)
    ready = state.prepared.issuperset(_ASKED_FOR) and vehicle.home_nea_m is not None
    if vehicle.landed is not Landed.ON_GROUND or not ready:
        return state, [], None
    if state.airborne:
        return give_up(state, Reason.GROUNDED)
    reason = _refused(state, context)
    if reason is not None and state.unready:
        return _unready(state, reason.text)
    if reason is not None:
        return give_up(state, reason)
    if Item.CHECKS not in state.prepared:
        return state, [], None
    if vehicle.armed and not context.go:  # by us, before a restart: nobody has said go since
        if not is_grounded(state):  # it is disarmed once that is certain
            return state, [], None
        return give_up(state, Reason.NOT_READY, ": armed before a restart, and no go since")
    return state, [], Trigger.GO if context.go else Trigger.READY


def _to_watch(state: State) -> Step:
    """Wait for a valid position of a vehicle that is only watched."""
    if in_phase_s(state) > _PREPARE_S:
        missing = _missing(state)
        return give_up(state, Reason.NOT_READY, missing and f": {missing}")
    waits = is_silent(state) or state.vehicle.distrust is not None
    return state, [], None if waits else Trigger.WATCH


def ready(state: State, event: Event, context: Context) -> Step:
    """Wait for somebody to say go, for as long as it takes; the checks have to go on passing."""
    if is_second_companion(state):
        return give_up(state, Reason.NOT_ALONE)
    if state.vehicle.armed:
        return give_up(state, Reason.ARMED_ALREADY)
    if isinstance(event, events.Prepared) and event.refusal:
        return _unready(_without(state, event.item), event.refusal)
    why = Reason.LINK_LOST.text if isinstance(event, LinkLost) else _why_unready(state, context)
    return _unready(state, why) if why else (state, [], None)


def why_no_go(state: State) -> str:
    """Why a go is refused, as text for who says it."""
    if state.phase is Phase.WAITING:
        return Reason.NO_VEHICLE.text
    why = state.unready or _missing(state) or "its checks are not over"
    return f"it is not ready: {why}"


def _why_unready(state: State, context: Context) -> str:
    """What is missing for the flight by now; empty: nothing."""
    if is_silent(state):
        return Reason.LINK_LOST.text
    if missing := _missing(state):
        return missing
    if state.vehicle.landed is not Landed.ON_GROUND:
        return "it says that it is not on the ground"
    reason = _refused(state, context)
    return "" if reason is None else reason.text


def _unready(state: State, why: str) -> Step:
    """Say so, once; it prepares on, or again: what was checked is checked again."""
    if state.phase is Phase.READY:
        says = warn(f"not ready any more: {why}", "phase")
        return replace(_without(state, Item.CHECKS), unready=why), [says], Trigger.UNREADY
    if why == state.unready:
        return state, [], None
    return replace(state, unready=why), [warn(f"not ready: {why}", "phase")], None


def _without(state: State, item: Item) -> State:
    """The state with one more thing to prepare (again)."""
    return replace(state, prepared=state.prepared - {item})


def _may_not_be_alone(state: State) -> bool:
    """Whether it is too early to exclude another companion.

    On the ground there is time for that while arming; a companion that resumes its own path must be
    quick, and yields if it hears another one later (`is_second_companion`).
    """
    takes_over = _is_flying(state) and state.flight.path is None
    return is_duplicate_suspected(state) or (takes_over and in_phase_s(state) < _LISTEN_S)


def on_duplicate_id(state: State, event: events.DuplicateId, context: Context) -> Step:
    """Another companion with our ids: the one that came second must not take control.

    Two setpoint streams would fight over the vehicle.  The companion that has had control in the
    air continues with a warning; one that hears the other before that ends.
    """
    if is_second_companion(state) and not context.shadow:
        begun = state.phase is not Phase.WAITING
        return give_up(state, Reason.NOT_ALONE) if begun else (state, [], None)
    if event.certain and event.news:
        return state, [warn(f"{Reason.NOT_ALONE.text}: end it")], None
    return state, [], None


def _landing_goes_on(state: State) -> Step:
    """Complete a landing that was begun before a reboot, or by the previous companion."""
    vehicle = state.vehicle
    if vehicle.landed is Landed.ON_GROUND and not vehicle.armed:
        return state, [], Trigger.LANDED
    if vehicle.landed is Landed.UNKNOWN:
        return state, [], None
    state = replace(state, landing=False)
    if state.sank and vehicle.mode is not Mode.LAND:
        says = warn(LANDING_ABORTED)
        orders = Orders(Reason.PAUSED, landing_order(state))
        return replace(state, orders=orders), [says], None
    return state, [], Trigger.END_LAND if vehicle.mode in (Mode.LAND, Mode.GUIDED) else None


def _is_flying(state: State) -> bool:
    return state.vehicle.armed and state.vehicle.landed not in (Landed.ON_GROUND, Landed.UNKNOWN)


def _missing(state: State) -> str:
    """The reports that a vehicle that does not get ready has not sent."""
    vehicle = state.vehicle
    missing = [item.value for item in Item if item not in state.prepared]
    if vehicle.home_nea_m is None:
        missing.append("home")
    if vehicle.landed is Landed.UNKNOWN:
        missing.append("landed state")
    distrusted = vehicle.distrust
    if distrusted is not None:
        missing.append(distrusted.text)
    return ", ".join(missing)


def _refused(state: State, context: Context) -> Reason | None:
    """Why the vehicle must not take off from here; None: it may."""
    if not state.targets_ne_m:
        return Reason.NO_TARGETS
    if state.vehicle.armed and not state.armed_by_us:
        return Reason.ARMED_ALREADY
    if height_m(state) <= 0.0:
        return Reason.HOME_TOO_HIGH
    if not may_take_off(state):
        return Reason.OUTSIDE
    return None if battery_lasts(state, context.mission) else Reason.BATTERY_SHORT


def _in_flight(state: State) -> Step:
    """Take over in the air: rejoin the path of the previous companion, or stop first."""
    path = state.flight.path
    if path is None and not state.prepared.issuperset(_ASKED_FOR):
        return state, [], None
    if not state.targets_ne_m:
        return give_up(state, Reason.NO_TARGETS)
    state = replace(state, flight=following.along_leg(state))
    mode, ours = state.vehicle.mode, (Mode.GUIDED, Mode.HOLD)
    if state.orders.active is not None or state.taken or state.flight.returning:
        reason = takeover_reason(state)
        if mode in ours and not state.taken:
            reason = Reason.TAKING_OVER
        return replace(way_back.stopped(state), reason=reason), [], Trigger.IN_FLIGHT
    asked = state.asks > 0  # to hold: it may do so by now
    if mode is Mode.GUIDED and not asked:
        joined = following.joined(state, state.flight.path)
        if joined is not None:
            return replace(state, flight=joined), [], Trigger.TAKE_OVER
    ours_or_up = mode in (*ours, Mode.TAKE_OFF)
    reason = Reason.TAKING_OVER if ours_or_up else takeover_reason(state)
    return replace(state, reason=reason), [], Trigger.IN_FLIGHT


def arming(state: State, _event: Event, _context: Context) -> Step:
    """Request the first mode of the take-off sequence, then arming, once a second."""
    vehicle, traits = state.vehicle, state.vehicle.traits
    if is_duplicate_suspected(state):
        return state, [], None
    first = Mode.GUIDED if traits.take_off is TakeoffSequence.GUIDED_THEN_CLIMB else Mode.TAKE_OFF
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
        return ask(replace(state, armed_by_us=True), events.Arm())
    if traits.take_off is TakeoffSequence.CLIMB_THEN_ARM:
        return _ask_to_take_off(state)
    return ask(state, events.SetMode(mode=first))


def taking_off(state: State, event: Event, _context: Context) -> Step:
    """Wait until it is at the floor of the band; request the climb if that comes after arming.

    An autopilot with a take-off mode holds after it, and is then taken over.
    """
    guided = state.vehicle.traits.take_off is TakeoffSequence.GUIDED_THEN_CLIMB
    on_ground = state.vehicle.landed is Landed.ON_GROUND
    if isinstance(event, Position) and not on_ground and _has_climbed(state, event, guided=guided):
        if guided:
            return state, [], Trigger.AIRBORNE
        return replace(state, reason=Reason.TAKEN_OFF), [], Trigger.HANDED_OVER
    if on_ground and height_m(state) <= 0.0:
        return give_up(state, Reason.HOME_TOO_HIGH)
    if in_phase_s(state) > _longest_climb_s(state):
        return give_up(state, Reason.NO_TAKE_OFF)
    return _ask_to_take_off(state) if on_ground and guided else (state, [], None)


def take_off_broken_off(state: State, reason: Reason) -> Step:
    """On the ground that is the end."""
    down = state.vehicle.landed is Landed.ON_GROUND
    return give_up(state, reason) if down else fault(state, reason)


def _has_climbed(state: State, event: Position, *, guided: bool) -> bool:
    """Whether it is at the requested height, or at the end of the autopilot's own take-off."""
    landed, off_m = state.vehicle.landed, event.position_nea_m[2] - state.task.take_off_amsl_m
    home = state.vehicle.home_nea_m
    if guided:  # of a low climb half: as it lifts off it is within AT_M of its end
        climb_m = math.inf if home is None else state.task.take_off_amsl_m - home[2]
        near = abs(off_m) < min(AT_M, max(0.5 * climb_m, _LEAST_M))
        return landed is Landed.IN_AIR and near and is_at_rest(state, event)
    if landed is not Landed.IN_AIR:
        return False
    if off_m > -AT_M:
        return True
    risen_m = 0.0 if home is None else event.position_nea_m[2] - home[2]
    level = abs(event.velocity_nea_m_s[2]) < _LEVEL_M_S
    return level and risen_m > _CLIMBED_M and state.vehicle.mode is not Mode.OTHER


def _ask_to_take_off(state: State) -> Step:
    """Request the take-off until it is accepted, and again if it has not begun after a while."""
    if state.now_s - state.vehicle.take_off_taken_at_s < _BEGINS_S:
        return state, [], None
    above_home_m, amsl_m = height_m(state), state.task.take_off_amsl_m
    return ask(state, events.TakeOff(above_home_m=above_home_m, altitude_amsl_m=amsl_m))


def may_take_off(state: State) -> bool:
    """Whether the vehicle is on the map and its climb-out clear of zones (planes: ahead)."""
    task, here = state.task, state.vehicle.position_nea_m
    if here is None:
        return False
    for value, (low, high) in zip(here, (task.limits.north_m, task.limits.east_m), strict=False):
        if not low <= value <= high:
            return False
    north, east = _climb_out_ne_m(state, here)
    gaps_m = zone_gaps_m(packed(task.zones), north, east, 2.0 * task.zone_clearance_m)
    return bool(gaps_m.min() >= task.zone_clearance_m)


def _climb_out_ne_m(state: State, here: Vector) -> tuple[FloatArray, FloatArray]:
    """Ground track of the climb-out: straight up, or ahead along a plane's heading."""
    limits, heading = state.task.limits, state.vehicle.heading_rad
    climb_s = max(height_m(state), 0.0) / limits.climb_rate_m_s
    ahead_m = 0.0 if limits.hovers or heading is None else limits.speed_m_s * climb_s
    along = np.linspace(0.0, ahead_m, _CLIMB_SAMPLES)
    heading = heading or 0.0
    return here[0] + along * math.cos(heading), here[1] + along * math.sin(heading)


def height_m(state: State) -> float:
    """How far above home the climb-out ends."""
    home = state.vehicle.home_nea_m
    return state.task.take_off_amsl_m - (0.0 if home is None else home[2])


def _longest_climb_s(state: State) -> float:
    climb_rate = state.task.limits.climb_rate_m_s
    return 2.0 * max(height_m(state), 0.0) / climb_rate + _TAKE_OFF_SLACK_S
