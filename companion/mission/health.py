"""Whether the position is to be believed (design section 7).

After a GPS loss or glitch all checks may pass for a wrong position: estimators reset to a wrong
receiver.  So velocities are integrated since the position was last valid, and it is valid again
only where they lead, or after it has passed all checks for so long that the older position must
have been wrong.
"""

import math

from companion.mission.events import Landed, Position, Vector
from companion.mission.phases import Reason
from companion.mission.state import Vehicle
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


def take_position(vehicle: Vehicle, event: Position, limits: Limits) -> None:
    """Take one position.

    It has jumped if it cannot be reached from the last one: neither by the vehicle's limits nor,
    over a short time, at the reported velocities.
    """
    before, position, at_s = vehicle.position_nea_m, event.position_nea_m, event.time_s
    elapsed_s, is_stuck = 0.0, False
    if before is not None:
        elapsed_s, step_m = at_s - vehicle.position_at_s, math.dist(before, position)
        far = step_m > _JUMP_SLACK_M
        jumps = far and step_m > _flown_at_most_m(elapsed_s, limits) + _JUMP_SLACK_M
        a, b = vehicle.velocity_nea_m_s, event.velocity_nea_m_s
        mean = 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])
        step_ne_m = position[0] - before[0], position[1] - before[1]
        if not jumps and elapsed_s <= _STALE_S:
            north_m, east_m = step_ne_m[0] - elapsed_s * mean[0], step_ne_m[1] - elapsed_s * mean[1]
            usual_m = _SURPRISE_M + _SURPRISE_SHARE * math.hypot(*mean) * elapsed_s
            jumps = math.hypot(north_m, east_m) > usual_m
        moves = math.hypot(*event.velocity_nea_m_s[:2]) > _STILL_M_S
        is_stuck = moves and before[:2] == position[:2]
        on_ground = vehicle.landed in (Landed.ON_GROUND, Landed.UNKNOWN)  # believed as it comes
        if on_ground or (at_s - vehicle.bad_at_s > TRUST_S and not jumps):
            vehicle.believed_at_s, vehicle.astray_ne_m, vehicle.blind_s = at_s, (0.0, 0.0), 0.0
        else:
            vouched = vehicle.fix_good and vehicle.estimator_good
            if not vouched and vehicle.jumped_at_s <= vehicle.believed_at_s:
                vehicle.blind_s += elapsed_s  # no source has confirmed it
            if not is_stuck:  # else it tells nothing
                _reckon(vehicle, step_ne_m, mean, at_s - vehicle.moved_at_s, limits)
        if jumps:
            vehicle.jumped_at_s = at_s
    if not is_stuck:
        vehicle.moved_at_s = at_s
    vehicle.position_nea_m, vehicle.velocity_nea_m_s = position, event.velocity_nea_m_s
    vehicle.heading_rad, vehicle.position_at_s = event.heading_rad, at_s
    vehicle.position_step_s = elapsed_s


def _flown_at_most_m(elapsed_s: float, limits: Limits) -> float:
    return _JUMP_SPEEDS * math.hypot(limits.speed_m_s, limits.climb_rate_m_s) * elapsed_s


def _reckon(
    vehicle: Vehicle,
    step_ne_m: tuple[float, float],
    velocity_nea_m_s: Vector,
    elapsed_s: float,
    limits: Limits,
) -> None:
    """How far the position has come from the predicted one since it was last valid.

    Distance that can have been flown in gaps does not count.
    """
    north_m = step_ne_m[0] - elapsed_s * velocity_nea_m_s[0]
    east_m, share = step_ne_m[1] - elapsed_s * velocity_nea_m_s[1], 1.0
    if elapsed_s > _STALE_S:
        size_m = math.hypot(north_m, east_m)
        share = max(size_m - _flown_at_most_m(elapsed_s, limits), 0.0) / max(size_m, 1e-9)
    was_north_m, was_east_m = vehicle.astray_ne_m
    vehicle.astray_ne_m = was_north_m + share * north_m, was_east_m + share * east_m


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


def take_distrust(vehicle: Vehicle, reason: Reason | None, now_s: float) -> None:
    """Note whether the position is valid now."""
    vehicle.distrust = reason
    if reason is not None:
        vehicle.last_distrust, vehicle.bad_at_s = reason, now_s
        if reason is not Reason.POSITION_ELSEWHERE:
            vehicle.doubted_at_s = now_s
