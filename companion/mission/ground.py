"""The phases before the flight: waiting, preparing, arming, taking off.  Each wait has an end."""

import numpy as np

from companion.mission.decisions import (
    AT_M,
    STOPPED_M_S,
    Context,
    Step,
    ask,
    cannot_fly,
    fault,
    give_up,
    in_phase_s,
    lost_command,
    speed_m_s,
)
from companion.mission.events import (
    Arm,
    Event,
    Landed,
    LinkLost,
    Mode,
    Position,
    SetMode,
    TakeOff,
    VehicleStatus,
)
from companion.mission.health import distrust
from companion.mission.state import Reason, State, Trigger

_PREPARE_S = 120.0
_ARM_S = 60.0
_TAKE_OFF_SLACK_S = 60.0


def waiting(state: State, event: Event) -> Step:
    """For the first heartbeat; the runtime says when it has waited long enough."""
    if isinstance(event, VehicleStatus):
        if not event.fits:
            return give_up(state, Reason.WRONG_VEHICLE)
        return state, [], Trigger.VEHICLE_FOUND
    if isinstance(event, LinkLost):
        return give_up(state, Reason.NO_VEHICLE)
    return state, [], None


def preparing(state: State, event: Event, context: Context) -> Step:
    """For a position that may be believed, home, and the word that it stands on the ground."""
    vehicle = state.vehicle
    if isinstance(event, LinkLost):
        return give_up(state, Reason.LINK_LOST)
    if vehicle.landed not in (Landed.ON_GROUND, Landed.UNKNOWN):
        return give_up(state, Reason.ALREADY_FLYING)
    if in_phase_s(state) > _PREPARE_S:
        return give_up(state, Reason.NOT_READY)
    there = vehicle.landed is Landed.ON_GROUND and vehicle.home_amsl_m is not None
    if not there or distrust(vehicle, state.now_s) is not None:
        return state, [], None
    if _height_m(state, context) <= 0.0:
        return give_up(state, Reason.HOME_TOO_HIGH)
    if not _may_rise(state, context):
        return give_up(state, Reason.OUTSIDE)
    return state, [], Trigger.READY


def arming(state: State, event: Event) -> Step:
    """Ask for guided mode, then to arm, once a second."""
    vehicle = state.vehicle
    if isinstance(event, LinkLost):
        return give_up(state, Reason.LINK_LOST)
    if vehicle.landed is not Landed.ON_GROUND:
        return give_up(state, Reason.ALREADY_FLYING)
    if vehicle.mode is Mode.GUIDED and vehicle.armed:
        return state, [], Trigger.ARMED
    if in_phase_s(state) > _ARM_S:
        return give_up(state, Reason.NOT_ARMED)
    return ask(state, SetMode(mode=Mode.GUIDED) if vehicle.mode is not Mode.GUIDED else Arm())


def taking_off(state: State, event: Event, context: Context) -> Step:
    """Ask for the climb to the floor of the band, and wait until it hovers there."""
    vehicle = state.vehicle
    if vehicle.landed is Landed.ON_GROUND:
        return _still_on_ground(state, event, context)
    reason = cannot_fly(state, event)
    if reason is not None:
        return fault(state, reason)
    if isinstance(event, Position) and vehicle.landed is Landed.IN_AIR:
        off = abs(event.position_nea_m[2] - context.mission.take_off_amsl_m)
        if off < AT_M and speed_m_s(event) < STOPPED_M_S:
            return state, [], Trigger.AIRBORNE
    if in_phase_s(state) > _longest_climb_s(state, context):
        return give_up(state, Reason.NO_TAKE_OFF)
    return state, [], None


def _still_on_ground(state: State, event: Event, context: Context) -> Step:
    reason = lost_command(state, event) or distrust(state.vehicle, state.now_s)
    if reason is not None:
        return give_up(state, reason)
    height = _height_m(state, context)
    if height <= 0.0:
        return give_up(state, Reason.HOME_TOO_HIGH)
    if in_phase_s(state) > _longest_climb_s(state, context):
        return give_up(state, Reason.NO_TAKE_OFF)
    return ask(state, TakeOff(above_home_m=height))


def _may_rise(state: State, context: Context) -> bool:
    """Whether the vehicle stands on the map, clear of keep-outs."""
    task, here = context.mission.task, state.vehicle.position_nea_m
    if here is None:
        return False
    for value, (low, high) in zip(here, (task.limits.north_m, task.limits.east_m), strict=False):
        if not low <= value <= high:
            return False
    north, east = np.asarray(here[0]), np.asarray(here[1])
    gaps = [float(zone.distance_m(north, east)) for zone in task.keep_outs]
    return min(gaps, default=np.inf) >= task.required_clearance_m


def _height_m(state: State, context: Context) -> float:
    return context.mission.take_off_amsl_m - (state.vehicle.home_amsl_m or 0.0)


def _longest_climb_s(state: State, context: Context) -> float:
    climb_rate = context.mission.task.limits.climb_rate_m_s
    return 2.0 * max(_height_m(state, context), 0.0) / climb_rate + _TAKE_OFF_SLACK_S
