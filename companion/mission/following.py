"""Path following: the reference point, its setpoint, whether the vehicle follows, leg after leg.

Multicopters are sent the reference point itself, which accelerates and brakes by itself and waits
for the vehicle.  Planes are sent a point ahead of their position on the path.
"""

import math
from copy import copy

import numpy as np

from companion.mission import phases
from companion.mission.decisions import Turn
from companion.mission.events import Echo, Position, Setpoint, Vector
from companion.mission.phases import OnPath, Reason
from companion.mission.state import State
from companion.path.envelope import beyond_m, ending_m_s, slowing_m
from companion.planner import procedure
from companion.planner.loiter_search import loiter_point
from companion.planner.procedure import Leg, Offset, Reference
from companion.planner.request import FlownSegment

_NOT_TAKEN_S = 2.0
_FARTHEST = 1.0  # tubes beyond the first: there it is told to hold at once, half of d_s at most
_BACK_S = 3.0  # after it has come to rest: for the vehicle to be back on its path
_ECHO_S = 1.5  # an older echo says nothing

_INSIDE = 0.0, 0.0, 0.0

_ROUNDING_M = 1e-6
_SENT_LATELY_S = 1.0
_AT_TARGET_M = 1.0  # nearer to it, the direction to it is that of an error
_LONGEST_LEAD = 1.3  # of what the path's tail was made for
_AT_END = 1.2  # loiter radii

_SPACING_M = 1.0
_MAX_SAMPLES = 1000
_ROUNDS, _MIN_BEND = 6, 0.25
_FRESH_S = 1.0
_ON_CIRCLE = 1.5  # loiter radii: a plane may be circling there


def lead_m(state: State) -> float:
    """How far ahead of the reference point the setpoint of a plane lies, along the path."""
    vehicle = state.vehicle
    over_ground = math.hypot(*vehicle.velocity_nea_m_s[:2])  # what counts in wind, not V
    return min(vehicle.traits.lead_s * over_ground, _LONGEST_LEAD * state.task.envelope.lead_m)


def advance_reference(state: State, stage: phases.Led, path: OnPath, event: Position) -> None:
    """Advance the reference point by one position; at p_prog switch to the next leg."""
    vehicle, leg, before = state.vehicle, path.leg, path.reference
    position = np.asarray(event.position_nea_m)
    slows_to_m_s, leaves_at_m = math.inf, math.inf
    if path.next_leg is not None:
        leaves_at_m = leg.successor_at_m
        room_m = leaves_at_m - before.length_m
        slows_to_m_s = procedure.entering_m_s(path.next_leg, leg.motion, room_m)
    if vehicle.traits.hovers:
        path.reference = procedure.advance(
            before,
            leg,
            vehicle.position_step_s,
            position,
            goes_on=leg.through and path.next_leg is not None,
            until_m=math.inf if path.stop is None else path.stop.at_m,
            slows_to_m_s=slows_to_m_s,
        )
    else:
        path.reference = procedure.follow(before, leg, position)
    if path.reference.length_m > before.length_m or path.circling:
        stage.progress_at_s = state.now_s
    path.circling = False
    if path.offset is not None:
        path.offset = path.offset.after(vehicle.position_step_s, leg.task.limits)
    if path.next_leg is not None and path.reference.length_m >= leaves_at_m - _ROUNDING_M:
        switch_to_next_leg(state, path)


def outside_m(state: State, path: OnPath, event: Position) -> tuple[float, float, float]:
    """How far the vehicle is outside of what was proven: across, ahead and far along; 0: inside.

    Across: of the tube about the path, a tracking error wide, that ends so far beyond the end of
    the leg, and as far again where dead-man stretches may end there; of a plane the circle about
    each point of the path is proven.  Ahead: of where it was told to be.  Far along: farther ahead,
    or behind, than the reference point waits for it.
    """
    leg, reference, motion = path.leg, path.reference, path.leg.motion
    allowed_m = motion.tube_m
    if not (state.task.settings.profile.verified or state.flight.returning):
        return _INSIDE
    pose = leg.subpath.pose(reference.length_m)
    if not state.vehicle.traits.hovers:
        off_m = procedure.off_disc_m(pose.point_nea_m, event.position_nea_m, motion.loiter_m)
        return max(off_m - allowed_m, 0.0), 0.0, 0.0
    position = np.asarray(event.position_nea_m)
    off = position - pose.position_nea_m
    ahead_m = float(off @ pose.tangent_nea)
    aside_m = math.sqrt(max(float(off @ off) - ahead_m**2, 0.0))
    # the path leaves its tangent by along^2 / 2 R at most where it bends no more than the turn
    # radius R; twice that is allowed for, as it may bend up and down as well
    bends_m = ahead_m**2 / leg.task.limits.turn_radius_m
    if -2.0 * allowed_m <= ahead_m <= allowed_m and aside_m + bends_m <= allowed_m:
        return _INSIDE  # as it mostly is
    if path.offset is not None:
        allowed_m += float(np.linalg.norm(path.offset.position_nea_m))
    past_m = min(beyond_m(motion), motion.tube_m)
    across_m = procedure.off_path_m(reference, leg, position, past_m) - allowed_m
    before_m = ahead_m - allowed_m
    far_m = abs(ahead_m) - motion.lag_m - allowed_m
    return max(across_m, 0.0), max(before_m, 0.0), max(far_m, 0.0)


def departs(
    state: State, stage: phases.Led, path: OnPath, event: Position, turn: Turn
) -> Reason | None:
    """Whether it follows; a reason: it is told to hold at once, else there is a note, or a stop.

    It does not if the target that it reports has disagreed with the setpoints for too long.
    Outside of the tube it keeps less than the safety distance.  A copter is stopped on its path,
    and the way on is planned anew from there (design 5.2); if it slows down for a stop already, or
    is within the tube, and only ahead of where it was told to be, it is noted.  It is to hold if it
    is farther outside than the safety distance allows for, does not come back, or is a plane.
    """
    now_s, limits, motion = state.now_s, path.leg.task.limits, path.leg.motion
    echo = state.vehicle.echo
    hears = echo is not None and now_s - echo.time_s < _ECHO_S
    if hears and now_s - stage.echoed_at_s > _NOT_TAKEN_S:
        return Reason.NOT_TAKEN
    across_m, before_m, far_m = outside_m(state, path, event)
    outside = max(across_m, before_m, far_m)
    if outside == 0.0:
        path.outside_since_s, path.outside_m = math.inf, 0.0
        return None
    is_news = math.isinf(path.outside_since_s)
    if is_news:
        path.outside_since_s, path.outside_m = now_s, outside
    most_m = min(_FARTHEST * motion.tube_m, 0.5 * state.task.settings.safety_distance_m)
    stops_s = limits.speed_m_s / limits.acceleration_m_s2
    is_away = across_m > 0.0 and now_s > path.outside_since_s + stops_s + _BACK_S
    if not limits.hovers or across_m > most_m or far_m > 0.0 or is_away:
        return Reason.OFF_PATH
    left_m = path.leg.subpath.length_m - path.reference.length_m
    ends = path.next_leg is None and left_m <= slowing_m(motion, motion.speed_m_s)
    if across_m > 0.0 and path.stop is None and not ends:
        stop(state, Reason.BESIDE_PATH, turn)
    if is_news:
        text = f"beside its path, {outside:.2g} m more than its tracking error"
        turn.say(text, "path", warning=path.stop is not None)
    return None


def take_echo(state: State, echo: Echo) -> None:
    """Note when the reported target last agreed with the setpoints, or there were none."""
    stage, limits = state.stage, state.task.limits
    if not isinstance(stage, phases.Led):
        return
    allowed_m = max(1.5 * limits.speed_m_s, 2.0 * limits.tracking_error_m)
    if not limits.hovers:
        allowed_m += 2.0 * limits.loiter_radius_m
    last = state.flight.sent
    if last is None or math.dist(echo.position_nea_m[:2], last.position_nea_m[:2]) <= allowed_m:
        stage.echoed_at_s = state.now_s


def is_stopped(state: State, path: OnPath) -> bool:
    """Whether the reference point has come to the end of its leg, or where it is to stop.

    For a copter that is rejoining the path only once it is on it: the setpoint would jump.
    """
    leg, stop = path.leg, path.stop
    left_m = (leg.subpath.length_m if stop is None else stop.at_m) - path.reference.length_m
    if state.vehicle.traits.hovers:
        joins = path.offset is not None and not path.offset.is_gone
        return not joins and left_m < procedure.ARRIVED_M
    if stop is not None:
        return True  # it circles where it was to stop
    if leg.reaches_target:  # it passes it, and circles it then
        return left_m < procedure.ARRIVED_M
    return left_m < _AT_END * state.task.limits.loiter_radius_m


def send_setpoint(state: State, path: OnPath, event: Position, turn: Turn) -> None:
    """Send the setpoint for the reference point, if one is due.

    A plane is sent so far ahead along the path.  Beyond p_prog that lies on the next leg, if there
    is one; else it stays at the end of this one, and the plane circles there.
    """
    leg, next_leg, traits, limits = path.leg, path.next_leg, state.vehicle.traits, state.task.limits
    least_s = traits.setpoint_period_s - 0.5 * state.vehicle.position_step_s
    if state.now_s - state.flight.sent_at_s <= least_s:
        return
    at_m = path.reference.length_m + (0.0 if traits.hovers else lead_m(state))
    pose, beyond_m = leg.subpath.pose(at_m), at_m - leg.subpath.length_m
    if next_leg is not None and at_m > (over_at_m := leg.successor_at_m):
        pose = next_leg.subpath.pose(at_m - over_at_m)
    stays = not traits.hovers and next_leg is None and beyond_m >= 0.0
    climbs_m_s = limits.climb_rate_m_s / max(abs(float(pose.tangent_nea[2])), 1e-9)
    speed = min(path.reference.speed_m_s, limits.speed_m_s, climbs_m_s)
    north_m, east_m, altitude_m = pose.position_nea_m.tolist()
    if (leading_s2 := traits.handling.leading_s2) > 0.0:
        turn_n, turn_e, _ = (leading_s2 * speed**2 * pose.curvature_nea_1_m).tolist()
        north_m, east_m = north_m + turn_n, east_m + turn_e
    ahead_n, ahead_e, ahead_u = pose.tangent_nea.tolist()
    velocity = speed * ahead_n, speed * ahead_e, speed * ahead_u
    if stays and leg.reaches_target:  # sent to the target itself it swerves aside
        beyond_m = min(beyond_m, leg.past_target_m)
        stays = False
        north_m += beyond_m * ahead_n
        east_m += beyond_m * ahead_e
    if (offset := path.offset) is not None:
        aside, drift = offset.position_nea_m.tolist(), offset.velocity_nea_m_s.tolist()
        north_m, east_m, altitude_m = north_m + aside[0], east_m + aside[1], altitude_m + aside[2]
        velocity = velocity[0] + drift[0], velocity[1] + drift[1], velocity[2] + drift[2]
    yaw = turn.context.mission.yaw_rad
    sent = Setpoint(
        time_s=event.time_s,
        position_nea_m=(north_m, east_m, altitude_m),
        velocity_nea_m_s=velocity,
        yaw_rad=math.atan2(ahead_e, ahead_n) if yaw is None else yaw,
        stay=stays,
    )
    state.flight.sent, state.flight.sent_at_s = sent, state.now_s
    turn.commands.append(sent)


def vehicle_at_m(state: State, path: OnPath) -> float:
    """Length along the leg where the vehicle is; not beyond the reference point.

    A copter that gains speed is up to a second behind that, and would stop as much later.
    """
    at_m, vehicle = path.reference.length_m, state.vehicle
    if vehicle.position_nea_m is None:
        return at_m
    pose = path.leg.subpath.pose(at_m)
    moved_m = (state.now_s - vehicle.position_at_s) * np.asarray(vehicle.velocity_nea_m_s)
    position = np.asarray(vehicle.position_nea_m) + moved_m
    behind_m = float((pose.position_nea_m - position) @ pose.tangent_nea)
    return max(at_m - max(behind_m, 0.0), 0.0)


def stop(state: State, reason: Reason, turn: Turn) -> None:
    """Stop on the path as soon as the vehicle can, and hold there."""
    flight, path = state.flight, state.path
    if path is None:
        come_to_rest(state, flight.hover_nea_m or state.vehicle.position_nea_m)
        return turn.fault(reason)
    leg, reference = path.leg, path.reference
    if not state.vehicle.traits.hovers:  # it flies on to the point that it is sent to
        at_m = reference.length_m + (0.0 if path.circling else lead_m(state))
        if path.next_leg is not None and at_m > leg.successor_at_m:
            at_m -= leg.successor_at_m
            switch_to_next_leg(state, path)
        leg, at_m = path.leg, min(at_m, path.leg.subpath.length_m)
        path.reference = Reference(length_m=at_m, speed_m_s=reference.speed_m_s)
        point = leg.subpath.pose(at_m).point_nea_m
        if reason in (Reason.NEW_THREAT, Reason.FENCE_UNREAD):
            position = state.vehicle.position_nea_m or point
            velocity = state.vehicle.velocity_nea_m_s
            point = loiter_point(flight.known, state.task, position, velocity, point) or point
        requeue_backtrack(state, leg, path.next_leg)
        come_to_rest(state, point)
        return turn.fault(reason)
    brakes_m = 0.5 * reference.speed_m_s**2 / state.task.limits.acceleration_m_s2
    stop_at_m = max(vehicle_at_m(state, path) + brakes_m, reference.length_m)
    stop_at_m = min(stop_at_m, leg.subpath.length_m)
    if path.stop is not None:
        stop_at_m = min(stop_at_m, path.stop.at_m)
    requeue_backtrack(state, path.next_leg)
    path.stop, path.next_leg = phases.Stop(stop_at_m, reason), None
    if isinstance(state.stage, phases.Flying):
        state.stage.search = phases.Answered()


def requeue_backtrack(state: State, *legs: Leg | None) -> None:
    """Put these legs back before the rest of the backtrack, if it is on one."""
    flight = state.flight
    if flight.returning:
        flight.back = (*(leg for leg in legs if leg is not None), *flight.back)


def come_to_rest(state: State, hover_nea_m: Vector | None = None) -> None:
    """Without a leg: the next one begins where the vehicle stops.

    Without a place it is chosen again: it may have been held too low.
    """
    stage, path = state.stage, state.path
    if path is not None:
        note_flown(state, path, path.reference.length_m)
    if isinstance(stage, phases.Led | phases.Preparing):
        stage.path = None
    if isinstance(stage, phases.Flying):
        stage.search = None
    elif isinstance(stage, phases.Stopped):
        stage.backtrack = None
    state.flight.hover_nea_m = hover_nea_m


def rest_at_end(state: State) -> None:
    """At rest at the end of its leg, at its stop, or at its hover: of what was flown the end, too.

    A plane goes on to circle the end from some way before it.
    """
    path, hover_nea_m = state.path, state.flight.hover_nea_m
    if path is not None:
        path.reference, hover_nea_m = Reference(length_m=end_m(path)), end_of(path)
    come_to_rest(state, hover_nea_m)


def end_m(path: OnPath) -> float:
    """The length flown at the end of a leg, or at the stop before it."""
    return path.leg.subpath.length_m if path.stop is None else path.stop.at_m


def end_of(path: OnPath) -> Vector:
    """The place there."""
    return path.leg.subpath.pose(end_m(path)).point_nea_m


def send_hold(state: State, time_s: float, turn: Turn) -> None:
    """Hold position: a setpoint with an explicit velocity of zero."""
    flight, vehicle, yaw = state.flight, state.vehicle, turn.context.mission.yaw_rad
    hover, least_s = flight.hover_nea_m, vehicle.traits.setpoint_period_s
    least_s -= 0.5 * vehicle.position_step_s
    if hover is None or state.now_s - flight.sent_at_s <= least_s:
        return
    sent = Setpoint(
        time_s=time_s,
        position_nea_m=_on_the_way(state, hover),
        velocity_nea_m_s=(0.0, 0.0, 0.0),
        yaw_rad=_towards_target_rad(state, hover) if yaw is None else yaw,
        stay=True,
    )
    flight.sent, flight.sent_at_s = sent, state.now_s
    turn.commands.append(sent)


def _towards_target_rad(state: State, here_nea_m: Vector) -> float:
    """Yaw of a vehicle that holds: towards the target; at the target unchanged."""
    flight, target = state.flight, state.targets_ne_m[state.flight.target]
    north_m, east_m = target[0] - here_nea_m[0], target[1] - here_nea_m[1]
    if flight.sent is not None and math.hypot(north_m, east_m) < _AT_TARGET_M:
        return flight.sent.yaw_rad
    return math.atan2(east_m, north_m)


def _on_the_way(state: State, here_nea_m: Vector) -> Vector:
    """The hold setpoint for now: climbs and descents are led at the mission's climb rate."""
    north, east, altitude = here_nea_m
    flight, at = state.flight, state.vehicle.position_nea_m
    if not state.vehicle.traits.hovers or at is None:
        return here_nea_m
    since_s = state.now_s - flight.sent_at_s
    sent = None if flight.sent is None else flight.sent.position_nea_m
    is_new = sent is None or since_s > _SENT_LATELY_S or math.dist(sent[:2], here_nea_m[:2]) > 1.0
    from_m = at[2] if sent is None or is_new else sent[2]
    most_m = state.task.limits.climb_rate_m_s * min(since_s, _SENT_LATELY_S)
    return north, east, from_m + min(max(altitude - from_m, -most_m), most_m)


# --- from leg to leg, and back to a path: after a restart, and for the backtrack


def joined(state: State, path: OnPath | None) -> OnPath | None:
    """The vehicle is led along this path, or on its next leg, from the current setpoint on.

    None if that is farther from the path than was proven: nothing has changed then.
    """
    flight, hovers, led_so = state.flight, state.vehicle.traits.hovers, _led(state)
    if led_so is None or path is None:
        return None
    (led, velocity), path = led_so, copy(path)
    leg, off_m, at_m = _nearest_of(path, led)
    limits, holds = leg.task.limits, flight.sent is not None and flight.sent.stay
    if off_m > limits.tracking_error_m + _ON_CIRCLE * limits.loiter_radius_m:
        return None
    path.circling = not hovers and (holds or off_m > limits.tracking_error_m)
    if path.circling and (centre := _circled(state)) is not None:
        circled, off_m, centre_at_m = _nearest_of(path, centre)
        if off_m <= limits.tracking_error_m:  # another circle it would enter from the side
            leg, at_m = circled, centre_at_m
    if leg is path.next_leg:
        switch_to_next_leg(state, path)
    pose = path.leg.subpath.pose(at_m)
    speed = max(float(np.dot(velocity, pose.tangent_nea)), 0.0)
    speed = min(speed, limits.speed_m_s)
    if hovers and path.next_leg is None:  # what it cannot brake from is offset
        left_m = path.leg.subpath.length_m - at_m
        speed = min(speed, ending_m_s(path.leg.motion, left_m))
    if hovers:
        path.offset = Offset.of(led, velocity, pose, speed)
    note_flown(state, path, at_m)
    path.reference, path.joined_m = Reference(length_m=at_m, speed_m_s=speed), at_m
    flight.hover_nea_m = pose.point_nea_m if path.circling else None
    return path


def switch_to_next_leg(state: State, path: OnPath) -> None:
    """On to the next leg: the reference point has reached p_prog of this one."""
    assert path.next_leg is not None
    over_at_m, reference = path.leg.successor_at_m, path.reference
    note_flown(state, path, over_at_m)
    path.leg, path.next_leg, path.joined_m = path.next_leg, None, 0.0
    length_m = max(reference.length_m - over_at_m, 0.0)
    path.reference = Reference(length_m=length_m, speed_m_s=reference.speed_m_s)
    if isinstance(state.stage, phases.Flying):
        state.stage.search, state.stage.shortfall = None, Reason.NO_PLAN
    state.flight.troubles = 0
    state.flight.legs_flown += 1


def note_flown(state: State, path: OnPath, until_m: float) -> None:
    """Add this leg to what was flown, up to a length; not on the way back."""
    if not state.flight.returning:
        flown = FlownSegment(
            control_nea_m=path.leg.subpath.control_nea_m,
            from_m=path.joined_m,
            until_m=until_m,
            speed_m_s=path.leg.speed_m_s,
        )
        state.flight.flown = (*state.flight.flown, flown)


def _led(state: State) -> tuple[Vector, Vector] | None:
    """The current setpoint of the vehicle and its velocity.  -> metres, m/s.

    Our own recent setpoint; else the autopilot's reported target, if it moves that on by itself;
    else the position: a PX4 that lacks setpoints slows down beyond the last.  A report is some
    tenths of a second old: the target has moved since, unless it is stationary, as ArduPilot's is
    after a setpoint time-out.
    """
    vehicle, flight = state.vehicle, state.flight
    position, velocity, echo = vehicle.position_nea_m, vehicle.velocity_nea_m_s, vehicle.echo
    if position is None:
        return None
    if not vehicle.traits.hovers:
        return position, velocity
    if flight.sent is not None and state.now_s - flight.sent_at_s < _FRESH_S:
        return flight.sent.position_nea_m, velocity
    near_m = 2.0 * state.task.limits.tracking_error_m + state.task.limits.speed_m_s * _FRESH_S
    age_s = math.inf if echo is None else state.now_s - echo.time_s
    if echo is None or (moves := echo.velocity_nea_m_s) is None or age_s > _FRESH_S:
        return position, velocity
    if math.dist(echo.position_nea_m, position) >= near_m:
        return position, velocity
    north, east, up = (at + age_s * v for at, v in zip(echo.position_nea_m, moves, strict=True))
    return (north, east, up), moves


def _circled(state: State) -> Vector | None:
    """What a plane circles: where we have sent it to stay, or what it says that it was sent to."""
    flight, echo = state.flight, state.vehicle.echo
    if flight.sent is not None and flight.sent.stay and state.now_s - flight.sent_at_s < _FRESH_S:
        return flight.sent.position_nea_m
    is_fresh = echo is not None and state.now_s - echo.time_s < _FRESH_S
    return echo.position_nea_m if echo is not None and is_fresh else None


def _nearest_of(path: OnPath, point_nea_m: Vector) -> tuple[Leg, float, float]:
    """The nearer leg of a path and the one after it, and `nearest` of it."""
    leg, (off_m, at_m) = path.leg, nearest(path.leg, point_nea_m)
    if path.next_leg is not None:
        next_off_m, next_at_m = nearest(path.next_leg, point_nea_m)
        if next_off_m < off_m - 1e-6:
            return path.next_leg, next_off_m, next_at_m
    return leg, off_m, at_m


def nearest(leg: Leg, point_nea_m: Vector) -> tuple[float, float]:
    """Distance of a point from a leg, and the length along it where it is nearest, metres."""
    length_m = leg.subpath.length_m
    spacing_m = max(_SPACING_M, length_m / _MAX_SAMPLES)
    points = leg.subpath.sampled(spacing_m).value
    distance = np.linalg.norm(points - np.asarray(point_nea_m), axis=-1)
    k = int(distance.argmin())
    at_m, step_m = length_m * k / (len(points) - 1), length_m / (len(points) - 1)
    low_m, high_m = max(at_m - step_m, 0.0), min(at_m + step_m, length_m)
    for _ in range(_ROUNDS):  # of Newton's method, which no last digit leads elsewhere
        pose = leg.subpath.pose(at_m)
        offset = np.asarray(point_nea_m) - pose.position_nea_m
        bend = max(1.0 - float(offset @ pose.curvature_nea_1_m), _MIN_BEND)
        at_m = min(max(at_m + float(offset @ pose.tangent_nea) / bend, low_m), high_m)
    there = leg.subpath.pose(at_m).position_nea_m
    return float(np.linalg.norm(np.asarray(point_nea_m) - there)), at_m
