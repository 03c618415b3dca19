"""From leg to leg, and back to a path: after a restart, and for the backtrack."""

import math

import numpy as np
from msgspec.structs import replace

from companion.mission.events import Vector
from companion.mission.state import Answered, Flight, OnPath, Reason, State
from companion.path.envelope import ending_m_s
from companion.planner import join
from companion.planner.procedure import Leg, Reference
from companion.planner.request import FlownSegment
from companion.planner.settings import Task

_SPACING_M = 1.0
_MAX_SAMPLES = 1000
_ROUNDS, _MIN_BEND = 6, 0.25
_FRESH_S = 1.0
_ON_CIRCLE = 1.5  # loiter radii: a plane may be circling there


def joined(state: State, path: OnPath | None) -> Flight | None:
    """The flight led along this path, or on its next leg, from the current setpoint on.

    None if that is farther from the path than was proven.
    """
    vehicle, flight, led_so = state.vehicle, state.flight, _led(state)
    if led_so is None or path is None:
        return None
    led, velocity = led_so
    off_m, at_m = nearest(path.leg, led)
    if path.next_leg is not None:
        next_off_m, next_at_m = nearest(path.next_leg, led)
        if next_off_m < off_m - 1e-6:
            flight, path = switched_to_next_leg(flight, path, state.task)
            off_m, at_m = next_off_m, next_at_m
    limits = state.task.at_speed(path.leg.speed_m_s).limits
    if off_m > limits.tracking_error_m + _ON_CIRCLE * limits.loiter_radius_m:
        return None
    pose, hovers = path.leg.subpath.pose(at_m), vehicle.traits.hovers
    speed = max(float(np.dot(velocity, pose.tangent_nea)), 0.0)
    speed = min(speed, limits.speed_m_s)
    if hovers and path.next_leg is None:  # what it cannot brake from is offset
        left_m = path.leg.subpath.length_m - at_m
        speed = min(speed, ending_m_s(path.leg.motion(state.task), left_m))
    circling, offset = not hovers and off_m > limits.tracking_error_m, path.offset
    if hovers:
        offset = join.begin(np.asarray(led), np.asarray(velocity), pose, speed)
    flown = flown_segments(replace(flight, path=path), at_m)
    path = replace(
        path,
        reference=Reference(length_m=at_m, speed_m_s=speed),
        circling=circling,
        joined_m=at_m,
        offset=offset,
    )
    return replace(
        flight,
        path=path,
        flown=flown,
        progress_at_s=state.now_s,
        hover_nea_m=pose.point_nea_m if circling else None,
        search=None if path.next_leg is None else Answered(),
    )


def switched_to_next_leg(flight: Flight, path: OnPath, task: Task) -> tuple[Flight, OnPath]:
    """On to the next leg: the reference point has reached p_prog of this one."""
    over_at_m, reference = path.leg.successor_at_m(task), path.reference
    assert path.next_leg is not None
    onto = replace(
        path,
        leg=path.next_leg,
        next_leg=None,
        reference=Reference(
            length_m=max(reference.length_m - over_at_m, 0.0), speed_m_s=reference.speed_m_s
        ),
        joined_m=0.0,
    )
    flight = replace(
        flight,
        path=onto,
        search=None,
        troubles=0,
        shortfall=Reason.NO_PLAN,
        legs_flown=flight.legs_flown + 1,
        flown=flown_segments(replace(flight, path=path), over_at_m),
    )
    return flight, onto


def flown_segments(flight: Flight, until_m: float) -> tuple[FlownSegment, ...]:
    """The flown segments, including this leg up to a length."""
    path = flight.path
    if path is None or flight.returning:
        return flight.flown
    return *flight.flown, FlownSegment(
        control_nea_m=path.leg.subpath.control_nea_m,
        from_m=path.joined_m,
        until_m=until_m,
        speed_m_s=path.leg.speed_m_s,
    )


def along_leg(state: State) -> Flight:
    """The flight with its reference where the leg is nearest to the vehicle: it has come so far."""
    flight, path, here = state.flight, state.flight.path, state.vehicle.position_nea_m
    if path is None or here is None:
        return flight
    _, at_m = nearest(path.leg, here)
    reference = Reference(length_m=max(at_m, path.joined_m))
    return replace(flight, path=replace(path, reference=reference))


def _led(state: State) -> tuple[Vector, Vector] | None:
    """The current setpoint of the vehicle and its velocity.  -> metres, m/s.

    Our own recent setpoint; else the autopilot's reported target; else the position.  A report is
    some tenths of a second old: the target has moved since, unless it is stationary, as
    ArduPilot's is after a setpoint time-out.
    """
    vehicle, flight = state.vehicle, state.flight
    here, velocity, echo = vehicle.position_nea_m, vehicle.velocity_nea_m_s, vehicle.echo_nea_m
    if here is None:
        return None
    if not vehicle.traits.hovers:
        return here, velocity
    if flight.sent is not None and state.now_s - flight.sent_at_s < _FRESH_S:
        return flight.sent.position_nea_m, velocity
    near_m = 2.0 * state.task.limits.tracking_error_m + state.task.limits.speed_m_s * _FRESH_S
    age_s = state.now_s - vehicle.echo_at_s
    if echo is None or age_s > _FRESH_S or math.dist(echo, here) >= near_m:
        return here, velocity
    velocity = vehicle.echo_nea_m_s or velocity
    north, east, up = (at + age_s * v for at, v in zip(echo, velocity, strict=True))
    return (north, east, up), velocity


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
