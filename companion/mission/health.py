"""Position validity and battery endurance (design section 7).

After a GPS loss or glitch all checks may pass for a wrong position: estimators reset to a wrong
receiver.  So velocities are integrated since the position was last valid, and it is valid again
only where they lead, or after it has passed all checks for so long that the older position must
have been wrong.
"""

import itertools
import math

from msgspec.structs import replace

from companion.mission import joining
from companion.mission.events import Battery, Landed, Position, Vector
from companion.mission.home import beyond_path_m
from companion.mission.mission import Mission
from companion.mission.state import Reason, State, Vehicle, Way
from companion.path.limits import Limits

TRUST_S = 2.0
"""A position must have been valid for this long before a flight resumes."""
BELIEVED_AFTER_S = 60.0
"""A position that passes all checks for this long without a jump is valid wherever it is: most
glitches are over by then, and the position before them may have been wrong."""
_STALE_S = 0.5
_FROZEN_S = 1.0
_STILL_M_S = 1.0
_JUMP_SPEEDS = 1.5  # a step longer than this many times what the vehicle can fly is a jump
_JUMP_SLACK_M = 20.0
_SURPRISE_M = 4.0  # a step that differs more from what the speed made it is a jump, too
_SURPRISE_SHARE = 0.35
_TILT_M_S2 = 0.1  # half a degree that inertial sensors are off: 5 m after 10 s, 45 m after 30
_TOLD_SPEED_M_S = 0.1  # that speeds are off by while GPS is used
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
    """Update the vehicle by one position.

    It has jumped if it cannot be reached from the last one: neither by the vehicle's limits nor,
    over a short time, at the reported velocities.
    """
    before, at_s = vehicle.position_nea_m, event.time_s
    elapsed_s, moved_at_s, jumped_at_s = 0.0, at_s, vehicle.jumped_at_s
    believed_at_s, astray_ne_m, blind_s = (
        vehicle.believed_at_s,
        vehicle.astray_ne_m,
        vehicle.blind_s,
    )
    if before is not None:
        elapsed_s = at_s - vehicle.position_at_s
        step_m = math.dist(before, event.position_nea_m)
        far = step_m > _JUMP_SLACK_M
        jumps = far and step_m > _flown_at_most_m(elapsed_s, limits) + _JUMP_SLACK_M
        if not jumps and elapsed_s <= _STALE_S:
            surprise_ne_m, mean_m_s = _surprise(vehicle, before, event, elapsed_s)
            usual_m = _SURPRISE_M + _SURPRISE_SHARE * mean_m_s * elapsed_s
            jumps = math.hypot(*surprise_ne_m) > usual_m
        jumped_at_s = at_s if jumps else jumped_at_s
        moves = math.hypot(*event.velocity_nea_m_s[:2]) > _STILL_M_S
        if moves and before[:2] == event.position_nea_m[:2]:
            moved_at_s = vehicle.moved_at_s
        on_ground = vehicle.landed in (Landed.ON_GROUND, Landed.UNKNOWN)  # believed as it comes
        if on_ground or (at_s - vehicle.bad_at_s > TRUST_S and not jumps):
            believed_at_s, astray_ne_m, blind_s = at_s, (0.0, 0.0), 0.0
        else:
            astray_ne_m, blind_s = _reckoned(vehicle, before, event, limits, moves=moves)
    return replace(
        vehicle,
        position_nea_m=event.position_nea_m,
        velocity_nea_m_s=event.velocity_nea_m_s,
        heading_rad=event.heading_rad,
        position_at_s=at_s,
        position_step_s=elapsed_s,
        moved_at_s=moved_at_s,
        jumped_at_s=jumped_at_s,
        believed_at_s=believed_at_s,
        astray_ne_m=astray_ne_m,
        blind_s=blind_s,
    )


def _flown_at_most_m(elapsed_s: float, limits: Limits) -> float:
    return _JUMP_SPEEDS * math.hypot(limits.speed_m_s, limits.climb_rate_m_s) * elapsed_s


def _surprise(
    vehicle: Vehicle, before_nea_m: Vector, event: Position, elapsed_s: float
) -> tuple[tuple[float, float], float]:
    """Deviation of a position from that predicted by the mean reported velocity, north and east.

    And the speed of that mean.
    """
    a, b = vehicle.velocity_nea_m_s, event.velocity_nea_m_s
    mean = 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])
    north, east, _ = event.position_nea_m
    surprise_ne_m = (
        north - before_nea_m[0] - elapsed_s * mean[0],
        east - before_nea_m[1] - elapsed_s * mean[1],
    )
    return surprise_ne_m, math.hypot(*mean)


def _reckoned(
    vehicle: Vehicle, before_nea_m: Vector, event: Position, limits: Limits, *, moves: bool
) -> tuple[tuple[float, float], float]:
    """Deviation, north and east, of the position from the predicted one since it was last valid.

    And how long no source has confirmed it.  Distance that can have been flown in gaps does not
    count.
    """
    blind_s = vehicle.blind_s
    vouched = vehicle.fix_good and vehicle.estimator_good
    if not vouched and vehicle.jumped_at_s <= vehicle.believed_at_s:
        blind_s = blind_s + event.time_s - vehicle.position_at_s
    if moves and before_nea_m[:2] == event.position_nea_m[:2]:
        return vehicle.astray_ne_m, blind_s  # it tells nothing
    elapsed_s = event.time_s - vehicle.moved_at_s
    surprise, _ = _surprise(vehicle, before_nea_m, event, elapsed_s)
    if elapsed_s > _STALE_S:
        size_m = math.hypot(*surprise)
        share = max(size_m - _flown_at_most_m(elapsed_s, limits), 0.0) / max(size_m, 1e-9)
        surprise = surprise[0] * share, surprise[1] * share
    north_m, east_m = vehicle.astray_ne_m
    return (north_m + surprise[0], east_m + surprise[1]), blind_s


def astray_m(vehicle: Vehicle) -> float:
    """Distance of the position from the predicted one, since it was last valid."""
    return math.hypot(*vehicle.astray_ne_m)


def may_differ_m(vehicle: Vehicle, limits: Limits) -> float:
    """Allowed distance from the predicted position.

    Both may have the mission's navigation error; velocities are reported to 0.1 m/s, and the error
    of an estimator without GPS grows with the square of time, until it resets to GPS.
    """
    since_s = vehicle.position_at_s - vehicle.believed_at_s
    blind_m = 0.5 * _TILT_M_S2 * vehicle.blind_s**2
    return 2.0 * limits.navigation_error_m + _TOLD_SPEED_M_S * since_s + blind_m


def with_position_trust(vehicle: Vehicle, reason: Reason | None, now_s: float) -> Vehicle:
    """The vehicle with the validity of its position updated."""
    if reason is None:
        return replace(vehicle, distrust=None)
    doubted_at_s = vehicle.doubted_at_s if reason is Reason.POSITION_ELSEWHERE else now_s
    return replace(
        vehicle, distrust=reason, last_distrust=reason, doubted_at_s=doubted_at_s, bad_at_s=now_s
    )


def distrust(vehicle: Vehicle, now_s: float, limits: Limits) -> Reason | None:
    """Why the position is invalid now; None: it is valid.

    Reports of bad quality come first; then a position that passes all checks, not yet for long, but
    which the vehicle cannot have reached.
    """
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
    if vehicle.astray_ne_m == (0.0, 0.0) or now_s - vehicle.doubted_at_s >= BELIEVED_AFTER_S:
        return None
    elsewhere = astray_m(vehicle) > may_differ_m(vehicle, limits)
    return Reason.POSITION_ELSEWHERE if elsewhere else None


def with_battery(state: State, event: Battery, mission: Mission) -> Vehicle:
    """Update the vehicle by one battery report."""
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
    """Whether all battery reports for a while say that it will not last.

    A single report counts, too, if none follows.
    """
    vehicle, since_s = state.vehicle, state.vehicle.battery_short_at_s
    if since_s is None:
        return False
    unheard_s = state.now_s - vehicle.battery_at_s
    return vehicle.battery_at_s - since_s >= _SHORT_S or unheard_s >= _LAST_WORD_S


def battery_lasts(state: State, mission: Mission) -> bool:
    """Whether the battery reaches the target with the reserve, as far as known.

    More than the reserve must be left, and enough for the distance if the mission gives the
    endurance.  The consumption of this flight only causes a warning (`battery_forecast`):
    simulators, and batteries that are not full, lose half of it in the first minute.
    """
    left = state.vehicle.battery
    if left is None:
        return True
    if left < mission.reserve:
        return False
    if mission.endurance_s is None:
        return True
    left_s, way_m = (left - mission.reserve) * mission.endurance_s, way_left_m(state, _DETOUR)
    return left_s >= way_m / state.task.limits.speed_m_s


def battery_forecast(state: State, mission: Mission) -> bool:
    """Whether it reaches the target with the reserve at the consumption of this flight."""
    vehicle = state.vehicle
    if vehicle.battery_full is None or vehicle.battery is None:
        return True
    since_s, full = vehicle.battery_full
    elapsed_s, lost = state.now_s - since_s, full - vehicle.battery
    if elapsed_s < _DRAIN_S or lost < _TELLING:
        return True
    left_s = (vehicle.battery - mission.reserve) * elapsed_s / (lost - _STEP)
    return left_s >= way_left_m(state, _DETOUR) / state.task.limits.speed_m_s


def way_left_m(state: State, detour: float = 1.0) -> float:
    """Remaining distance: the backtrack, or the last plan's route and on from target to target.

    detour: how many times as long as that the way to the targets may become.
    """
    here, flight = state.vehicle.position_nea_m, state.flight
    if flight.way is Way.BACK:
        ahead = [leg for leg in (flight.leg, flight.next_leg, *flight.back) if leg is not None]
        flown_m = flight.reference.length_m
        if (
            flight.path is None and ahead and here is not None
        ):  # it was stopped on the first of them
            flown_m = joining.nearest(ahead[0], here)[1]
        return sum(leg.subpath.length_m for leg in ahead) - flown_m + beyond_path_m(state)
    if here is None or not state.targets_ne_m:
        return 0.0
    route, from_here = flight.route_ne_m, itertools.repeat(here[:2])
    if route:  # it begins where it was planned
        apart_m = list(map(math.dist, route, from_here))
        route = route[apart_m.index(min(apart_m)) :]
    places = [here[:2], *route, *state.targets_ne_m[flight.target :]]
    return sum(map(math.dist, places, places[1:])) * detour
