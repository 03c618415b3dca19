"""Whether the vehicle's position may be believed, and its battery will last (design section 7)."""

import itertools
import math

from companion.mission import joining
from companion.mission.events import Battery, Landed, Position
from companion.mission.mission import Mission
from companion.mission.renewed import replace
from companion.mission.state import Reason, State, Vehicle
from companion.path.limits import Limits

_STALE_S = 0.5
_FROZEN_S = 1.0
_STILL_M_S = 1.0
_JUMP_SPEEDS = 1.5  # a step longer than this many times what the vehicle can fly is a jump
_JUMP_SLACK_M = 20.0
_SURPRISE_M = 4.0  # a step that differs more from what the speed made it is a jump, too
_SURPRISE_SHARE = 0.35
_RECENT_S = 0.5
_UNHEARD_S = 5.0
_FLICKERS_S = 1.0  # estimators give in to what they do not believe 7 to 10 s later
_DRAIN_S = 60.0  # before that, what the battery has lost says nothing of what it will
_TELLING = 0.05  # nor before it has lost so much
_STEP = 0.01  # it is told in hundredths
_DETOUR = 1.1  # of the way that is known to be left
_SHORT_S = 3.0  # one word of an empty battery may be wrong
_LAST_WORD_S = 10.0  # ten times as long as between two


def with_position(vehicle: Vehicle, event: Position, limits: Limits) -> Vehicle:
    """What is known of the vehicle after one more position."""
    before = vehicle.position_nea_m
    moved_at, jumped_at = event.time_s, vehicle.jumped_at_s
    if before is not None:
        elapsed = event.time_s - vehicle.position_at_s
        if _has_jumped(vehicle, event, elapsed, limits):
            jumped_at = event.time_s
        still = before[:2] == event.position_nea_m[:2]
        if still and math.hypot(*event.velocity_nea_m_s[:2]) > _STILL_M_S:
            moved_at = vehicle.moved_at_s
    return replace(
        vehicle,
        position_nea_m=event.position_nea_m,
        velocity_nea_m_s=event.velocity_nea_m_s,
        heading_rad=event.heading_rad,
        position_at_s=event.time_s,
        position_step_s=event.time_s - vehicle.position_at_s if before is not None else 0.0,
        moved_at_s=moved_at,
        jumped_at_s=jumped_at,
    )


def _has_jumped(vehicle: Vehicle, event: Position, elapsed_s: float, limits: Limits) -> bool:
    """Whether a position cannot have been flown to from the last one.

    Neither by what the vehicle can do at all, nor, over a short time, at the speeds that it told.
    """
    before = vehicle.position_nea_m
    assert before is not None
    step_m = math.dist(before, event.position_nea_m)
    top_m_s = math.hypot(limits.speed_m_s, limits.climb_rate_m_s)
    if step_m > _JUMP_SPEEDS * top_m_s * elapsed_s + _JUMP_SLACK_M:
        return True
    if elapsed_s > _STALE_S:
        return False
    mean = [
        0.5 * (a + b) for a, b in zip(vehicle.velocity_nea_m_s, event.velocity_nea_m_s, strict=True)
    ]
    told = [a + elapsed_s * v for a, v in zip(before, mean, strict=True)]
    surprise_m = math.dist(told[:2], event.position_nea_m[:2])
    return surprise_m > _SURPRISE_M + _SURPRISE_SHARE * math.hypot(*mean) * elapsed_s


def distrust(vehicle: Vehicle, now_s: float, limits: Limits) -> Reason | None:
    """Why the position may not be believed now; None: it may."""
    if now_s - vehicle.position_at_s > _STALE_S:
        return Reason.POSITION_STALE
    if now_s - vehicle.moved_at_s > _FROZEN_S:
        return Reason.POSITION_FROZEN
    if now_s - vehicle.jumped_at_s < _RECENT_S:
        return Reason.POSITION_JUMPED
    unheard_s = now_s - min(vehicle.fix_at_s, vehicle.estimator_at_s)
    if unheard_s > _UNHEARD_S and vehicle.fix_good and vehicle.estimator_good:
        return Reason.HEALTH_SILENT
    if not vehicle.fix_good:
        return Reason.NO_FIX
    if not vehicle.estimator_good and now_s - vehicle.estimator_failed_at_s > _FLICKERS_S:
        return Reason.ESTIMATOR
    if vehicle.error_m is not None and vehicle.error_m > limits.navigation_error_m:
        return Reason.INACCURATE
    return None


def with_battery(state: State, event: Battery, mission: Mission) -> Vehicle:
    """What is known of the vehicle after one more word of its battery."""
    vehicle, left = state.vehicle, event.remaining
    full = vehicle.battery_full
    in_air = vehicle.landed not in (Landed.ON_GROUND, Landed.UNKNOWN)
    if in_air and (full is None or left > full[1]):
        full = (event.time_s, left)
    vehicle = replace(vehicle, battery=left, battery_at_s=event.time_s, battery_full=full)
    since_s = event.time_s if vehicle.battery_short_at_s is None else vehicle.battery_short_at_s
    lasts = battery_lasts(replace(state, vehicle=vehicle), mission)
    return replace(vehicle, battery_short_at_s=None if lasts else since_s)


def battery_is_short(state: State) -> bool:
    """Whether all that was heard of the battery for a while says that it will not last.

    A single word is believed, too, when nothing follows to contradict it.
    """
    vehicle, since_s = state.vehicle, state.vehicle.battery_short_at_s
    if since_s is None:
        return False
    unheard_s = state.now_s - vehicle.battery_at_s
    return vehicle.battery_at_s - since_s >= _SHORT_S or unheard_s >= _LAST_WORD_S


def battery_lasts(state: State, mission: Mission) -> bool:
    """Whether the battery reaches the target with the reserve, as far as that is known.

    There is more left than the reserve, and enough where the mission says how long a full one
    lasts.  What was measured in this flight is only warned of (`battery_forecast`): simulators, and
    batteries that are not full, lose half of it in the first minute.
    """
    left = state.vehicle.battery
    if left is None:
        return True
    if left < mission.reserve:
        return False
    if mission.endurance_s is None:
        return True
    return (left - mission.reserve) * mission.endurance_s >= _to_go_s(state)


def battery_forecast(state: State, mission: Mission) -> bool:
    """Whether it reaches the target with the reserve if it goes on as in this flight so far."""
    vehicle = state.vehicle
    if vehicle.battery_full is None or vehicle.battery is None:
        return True
    since_s, full = vehicle.battery_full
    elapsed_s, lost = state.now_s - since_s, full - vehicle.battery
    if elapsed_s < _DRAIN_S or lost < _TELLING:
        return True
    left_s = (vehicle.battery - mission.reserve) * elapsed_s / (lost - _STEP)
    return left_s >= _to_go_s(state)


def _to_go_s(state: State) -> float:
    return _to_go_m(state) / state.task.limits.speed_m_s


def _to_go_m(state: State) -> float:
    """The way that is left: back, or along the last plan's route and from target to target."""
    here, flight = state.vehicle.position_nea_m, state.flight
    if flight.returning:
        ahead = [leg for leg in (flight.leg, flight.next_leg, *flight.back) if leg is not None]
        flown_m = flight.reference.length_m
        if flight.leg is None and ahead and here is not None:  # it was stopped on the first of them
            flown_m = joining.nearest(ahead[0], here)[1]
        return sum(leg.subpath.length_m for leg in ahead) - flown_m
    if here is None or not state.targets_ne_m:
        return 0.0
    places = [here[:2], *flight.route_ne_m, *state.targets_ne_m[flight.target :]]
    if flight.route_ne_m:  # it begins where it was planned
        nearest = min(
            range(len(flight.route_ne_m)), key=lambda k: math.dist(flight.route_ne_m[k], here[:2])
        )
        places = [here[:2], *flight.route_ne_m[nearest:], *state.targets_ne_m[flight.target :]]
    return _DETOUR * sum(math.dist(a, b) for a, b in itertools.pairwise(places))
