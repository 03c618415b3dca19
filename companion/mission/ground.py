"""The phases before the flight: waiting, preparing, ready, arming, taking off.

Each wait has an end, but for that of a vehicle that is ready: somebody has to say go.
"""

import math

import numpy as np
from msgspec.structs import replace

from companion.geodesy import FloatArray
from companion.mission import events, following, phases, way_back
from companion.mission.battery import battery_lasts
from companion.mission.decisions import AT_M, Context, Turn, abort_landing, is_at_rest
from companion.mission.events import Event, Item, Landed, LinkLost, Mode, Position, Vector
from companion.mission.phases import Phase, Reason, Trigger
from companion.mission.state import State
from companion.mission.tables import takeover_reason
from companion.mission.vehicle_traits import TakeoffSequence
from companion.planner.procedure import Reference
from companion.world.zones import gaps_m as zone_gaps_m

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


def waiting(_state: State, left: phases.Preparing, event: Event, turn: Turn) -> None:
    """Wait for a matching autopilot; the runtime decides how long."""
    if isinstance(event, events.VehicleFound):
        if event.traits is None:
            turn.give_up(Reason.WRONG_VEHICLE, f": {event.name}")
        else:
            turn.to(Trigger.VEHICLE_FOUND, replace(left, phase=Phase.PREPARING))


def preparing(state: State, stage: phases.Preparing, event: Event, turn: Turn) -> None:
    """Wait for a valid position, home, parameters and fence, on the ground or in flight.

    After a restart in the air, preparations of the previous companion are not repeated.
    """
    vehicle, context = state.vehicle, turn.context
    asked_for = state.prepared.issuperset(_ASKED_FOR)
    if not context.shadow and isinstance(event, events.Prepared) and event.refusal:
        return _refuses(state, event, turn)
    if stage.unready and vehicle.armed:
        return turn.give_up(Reason.ARMED_ALREADY)  # it is not taken over in the air unasked
    if state.in_phase_s > _PREPARE_S and not stage.unready:
        missing = _missing(state)
        return turn.give_up(Reason.NOT_READY, missing and f": {missing}")
    if state.is_silent:
        return
    if context.shadow:
        if vehicle.distrust is None:
            turn.to(Trigger.WATCH)
        return
    if state.is_second_companion:
        return turn.give_up(Reason.NOT_ALONE)
    if not state.has_had_control and _may_not_be_alone(state):
        return
    if stage.landing:
        return _landing_goes_on(state, stage, turn)
    if vehicle.distrust is not None:
        unled = _is_flying(state) and vehicle.mode is Mode.GUIDED
        if unled and state.in_phase_s > _UNLED_S:
            turn.ask(events.SetMode(mode=Mode.HOLD))
    elif _is_flying(state):
        _in_flight(state, stage, turn)
    elif vehicle.landed is Landed.ON_GROUND and vehicle.home_nea_m is not None and asked_for:
        _on_ground(state, turn)


def _refuses(state: State, event: events.Prepared, turn: Turn) -> None:
    """The vehicle must not fly as it is set up."""
    if _is_flying(state):
        turn.warn(event.refusal)
    elif state.unready or state.phase is Phase.READY:
        state.prepared -= {event.item}
        _unready(state, event.refusal, turn)
    else:
        turn.give_up(Reason.REFUSED, f": {event.refusal}", event.remedy)


def _on_ground(state: State, turn: Turn) -> None:
    """All that was asked of it is there: it may go, or waits for that."""
    if state.airborne:  # since a restart, as its take-off may only have begun
        if not state.vehicle.armed or state.in_phase_s > _BEGINS_S:
            turn.give_up(Reason.GROUNDED)
        return
    reason, go = _refused(state, turn.context), turn.context.go
    if reason is not None and state.unready:
        return _unready(state, reason.text, turn)
    if reason is not None:
        return turn.give_up(reason)
    if Item.CHECKS not in state.prepared:
        return
    if go or not state.vehicle.armed:
        turn.to(Trigger.GO if go else Trigger.READY)
    elif state.is_grounded:  # armed by us before a restart: it is disarmed once that is certain
        turn.give_up(Reason.NOT_READY, ": armed before a restart, and no go since")


def ready(state: State, _: phases.Stage, event: Event, turn: Turn) -> None:
    """Wait for somebody to say go, for as long as it takes; the checks have to go on passing."""
    if state.is_second_companion:
        turn.give_up(Reason.NOT_ALONE)
    elif state.vehicle.armed:
        turn.give_up(Reason.ARMED_ALREADY)
    elif isinstance(event, events.Prepared) and event.refusal:
        _refuses(state, event, turn)
    elif isinstance(event, LinkLost):
        _unready(state, Reason.LINK_LOST.text, turn)
    elif why := _why_unready(state, turn.context):
        _unready(state, why, turn)


def why_no_go(state: State) -> str:
    """Why a go is refused, as text for who says it."""
    if state.phase is Phase.WAITING:
        return Reason.NO_VEHICLE.text
    why = state.unready or _missing(state) or "its checks are not over"
    return f"it is not ready: {why}"


def _why_unready(state: State, context: Context) -> str:
    """What is missing for the flight by now; empty: nothing."""
    if state.is_silent:
        return Reason.LINK_LOST.text
    if missing := _missing(state):
        return missing
    if state.vehicle.landed is not Landed.ON_GROUND:
        return "it says that it is not on the ground"
    reason = _refused(state, context)
    return "" if reason is None else reason.text


def _unready(state: State, why: str, turn: Turn) -> None:
    """Say so, once; it prepares on, or again: what was checked is checked again."""
    if state.phase is Phase.READY:
        turn.warn(f"not ready any more: {why}", "phase")
        state.prepared -= {Item.CHECKS}
        turn.to(Trigger.UNREADY, phases.Preparing(unready=why))
    elif isinstance(state.stage, phases.Preparing) and why != state.unready:
        turn.warn(f"not ready: {why}", "phase")
        state.stage.unready = why


def _may_not_be_alone(state: State) -> bool:
    """Whether it is too early to exclude another companion.

    On the ground there is time for that while arming; a companion that resumes its own path must be
    quick, and yields if it hears another one later (`is_second_companion`).
    """
    takes_over = _is_flying(state) and state.path is None
    return state.is_duplicate_suspected or (takes_over and state.in_phase_s < _LISTEN_S)


def on_duplicate_id(state: State, event: events.DuplicateId, turn: Turn) -> None:
    """Another companion with our ids: the one that came second must not take control.

    Two setpoint streams would fight over the vehicle.  The companion that has had control in the
    air continues with a warning; one that hears the other before that ends.
    """
    if state.is_second_companion and not turn.context.shadow:
        if state.phase is not Phase.WAITING:
            turn.give_up(Reason.NOT_ALONE)
    elif event.certain and event.news:
        turn.warn(f"{Reason.NOT_ALONE.text}: end it")


def _landing_goes_on(state: State, stage: phases.Preparing, turn: Turn) -> None:
    """Complete a landing that was begun before a reboot, or by the previous companion."""
    vehicle = state.vehicle
    if vehicle.landed is Landed.ON_GROUND and not vehicle.armed:
        return turn.to(Trigger.LANDED)
    if vehicle.landed is Landed.UNKNOWN:
        return
    stage.landing = False
    if stage.sank and vehicle.mode is not Mode.LAND:
        abort_landing(state, turn)
    elif vehicle.mode in (Mode.LAND, Mode.GUIDED):
        turn.to(Trigger.END_LAND)


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
    if vehicle.distrust is not None:
        missing.append(vehicle.distrust.text)
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


def _in_flight(state: State, stage: phases.Preparing, turn: Turn) -> None:
    """Take over in the air: rejoin the path of the previous companion, or stop first."""
    path, position = stage.path, state.vehicle.position_nea_m
    mode, led_in = state.vehicle.mode, (Mode.GUIDED, Mode.HOLD)
    if path is None and not state.prepared.issuperset(_ASKED_FOR):
        return
    if not state.targets_ne_m:
        return turn.give_up(Reason.NO_TARGETS)
    if path is not None and position is not None:  # so far it has come
        _, at_m = following.nearest(path.leg, position)
        path.reference = Reference(length_m=max(at_m, path.joined_m))
    turn.to(Trigger.IN_FLIGHT)
    if state.order is not None or state.taken or state.flight.returning:
        led = mode in led_in and not state.taken
        state.because(Reason.TAKING_OVER if led else takeover_reason(state))
        return way_back.leave_path(state)
    asked = stage.asks > 0  # to hold: it may do so by now
    if mode is Mode.GUIDED and not asked:
        joined = following.joined(state, path)
        if joined is not None:
            stage.path, search = None, None if joined.next_leg is None else phases.Answered()
            return turn.to(Trigger.TAKE_OVER, phases.Flying(path=joined, search=search))
    ours_or_up = mode in (*led_in, Mode.TAKE_OFF)
    state.because(Reason.TAKING_OVER if ours_or_up else takeover_reason(state))


def arming(state: State, stage: phases.Stage, _event: Event, turn: Turn) -> None:
    """Request the first mode of the take-off sequence, then arming, once a second."""
    vehicle, traits = state.vehicle, state.vehicle.traits
    if state.is_duplicate_suspected:
        return
    first = Mode.GUIDED if traits.take_off is TakeoffSequence.GUIDED_THEN_CLIMB else Mode.TAKE_OFF
    if vehicle.mode is first and vehicle.armed:
        return turn.to(Trigger.ARMED)
    if vehicle.mode is first:
        stage.obeyed = True
    elif stage.obeyed or (vehicle.armed and not state.armed_by_us):
        return turn.give_up(Reason.MODE_TAKEN)
    rises = vehicle.landed is not Landed.ON_GROUND
    if state.in_phase_s > _ARM_S or (rises and not state.armed_by_us):
        return turn.give_up(Reason.NOT_ARMED)
    if rises:
        return  # its next heartbeat will say that it is armed
    if vehicle.mode is first:
        state.armed_by_us = True
        turn.ask(events.Arm())
    elif traits.take_off is TakeoffSequence.CLIMB_THEN_ARM:
        _ask_to_take_off(state, turn)
    else:
        turn.ask(events.SetMode(mode=first))


def taking_off(state: State, _: phases.Stage, event: Event, turn: Turn) -> None:
    """Wait until it is at the floor of the band; request the climb if that comes after arming.

    An autopilot with a take-off mode holds after it, and is then taken over.
    """
    guided = state.vehicle.traits.take_off is TakeoffSequence.GUIDED_THEN_CLIMB
    on_ground = state.vehicle.landed is Landed.ON_GROUND
    climb_m_s = state.task.limits.climb_rate_m_s
    if isinstance(event, Position) and not on_ground and _has_climbed(state, event, guided=guided):
        if not guided:
            state.because(Reason.TAKEN_OFF)
        turn.to(Trigger.AIRBORNE if guided else Trigger.HANDED_OVER)
    elif on_ground and height_m(state) <= 0.0:
        turn.give_up(Reason.HOME_TOO_HIGH)
    elif state.in_phase_s > _TAKE_OFF_SLACK_S + 2.0 * max(height_m(state), 0.0) / climb_m_s:
        turn.give_up(Reason.NO_TAKE_OFF)
    elif on_ground and guided:
        _ask_to_take_off(state, turn)


def _has_climbed(state: State, event: Position, *, guided: bool) -> bool:
    """Whether it is at the requested height, or at the end of the autopilot's own take-off."""
    landed, off_m = state.vehicle.landed, event.position_nea_m[2] - state.task.take_off_amsl_m
    home = state.vehicle.home_nea_m
    if guided:  # of a low climb half: as it lifts off it is within AT_M of its end
        climb_m = math.inf if home is None else state.task.take_off_amsl_m - home[2]
        near = abs(off_m) < min(AT_M, max(0.5 * climb_m, _LEAST_M))
        return landed is Landed.IN_AIR and near and is_at_rest(state)
    if landed is not Landed.IN_AIR:
        return False
    if off_m > -AT_M:
        return True
    risen_m = 0.0 if home is None else event.position_nea_m[2] - home[2]
    level = abs(event.velocity_nea_m_s[2]) < _LEVEL_M_S
    return level and risen_m > _CLIMBED_M and state.vehicle.mode is not Mode.OTHER


def _ask_to_take_off(state: State, turn: Turn) -> None:
    """Request the take-off until it is accepted, and again if it has not begun after a while."""
    if state.now_s - state.vehicle.take_off_taken_at_s >= _BEGINS_S:
        above_home_m, amsl_m = height_m(state), state.task.take_off_amsl_m
        turn.ask(events.TakeOff(above_home_m=above_home_m, altitude_amsl_m=amsl_m))


def may_take_off(state: State) -> bool:
    """Whether the vehicle is on the map and its climb-out clear of zones (planes: ahead)."""
    task, position = state.task, state.vehicle.position_nea_m
    if position is None:
        return False
    for value, (low, high) in zip(
        position, (task.limits.north_m, task.limits.east_m), strict=False
    ):
        if not low <= value <= high:
            return False
    north, east = _climb_out_ne_m(state, position)
    gaps_m = zone_gaps_m(task.zones, north, east, 2.0 * task.zone_clearance_m)
    return bool(gaps_m.min() >= task.zone_clearance_m)


def _climb_out_ne_m(state: State, position: Vector) -> tuple[FloatArray, FloatArray]:
    """Ground track of the climb-out: straight up, or ahead along a plane's heading."""
    limits, heading = state.task.limits, state.vehicle.heading_rad
    climb_s = max(height_m(state), 0.0) / limits.climb_rate_m_s
    ahead_m = 0.0 if limits.hovers or heading is None else limits.speed_m_s * climb_s
    along = np.linspace(0.0, ahead_m, _CLIMB_SAMPLES)
    heading = heading or 0.0
    return position[0] + along * math.cos(heading), position[1] + along * math.sin(heading)


def height_m(state: State) -> float:
    """How far above home the climb-out ends."""
    home = state.vehicle.home_nea_m
    return state.task.take_off_amsl_m - (0.0 if home is None else home[2])
