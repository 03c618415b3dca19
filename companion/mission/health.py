"""Whether the vehicle's position may be believed (design section 7)."""

import math
from dataclasses import replace

from companion.mission.events import Position
from companion.mission.state import Reason, Vehicle
from companion.path.limits import Limits

_STALE_S = 0.5
_FROZEN_S = 1.0
_STILL_M_S = 1.0
_JUMP_SPEEDS = 1.5  # a step longer than this many times what the vehicle can fly is a jump
_JUMP_SLACK_M = 20.0
_RECENT_S = 0.5


def with_position(vehicle: Vehicle, event: Position, limits: Limits) -> Vehicle:
    """What is known of the vehicle after one more position."""
    before = vehicle.position_nea_m
    moved_at, jumped_at = event.time_s, vehicle.jumped_at_s
    if before is not None:
        step = math.dist(before, event.position_nea_m)
        elapsed = event.time_s - vehicle.position_at_s
        top = math.hypot(limits.speed_m_s, limits.climb_rate_m_s)
        if step > _JUMP_SPEEDS * top * elapsed + _JUMP_SLACK_M:
            jumped_at = event.time_s
        still = before[:2] == event.position_nea_m[:2]
        if still and math.hypot(*event.velocity_nea_m_s[:2]) > _STILL_M_S:
            moved_at = vehicle.moved_at_s
    return replace(
        vehicle,
        position_nea_m=event.position_nea_m,
        velocity_nea_m_s=event.velocity_nea_m_s,
        position_at_s=event.time_s,
        position_step_s=event.time_s - vehicle.position_at_s if before is not None else 0.0,
        moved_at_s=moved_at,
        jumped_at_s=jumped_at,
    )


def distrust(vehicle: Vehicle, now_s: float) -> Reason | None:
    """Why the position may not be believed now; None: it may."""
    if now_s - vehicle.position_at_s > _STALE_S:
        return Reason.POSITION_STALE
    if now_s - vehicle.moved_at_s > _FROZEN_S:
        return Reason.POSITION_FROZEN
    if now_s - vehicle.jumped_at_s < _RECENT_S:
        return Reason.POSITION_JUMPED
    if not vehicle.fix_good:
        return Reason.NO_FIX
    if not vehicle.estimator_good:
        return Reason.ESTIMATOR
    return None
