"""Rejoining a path: after a restart, and for the backtrack."""

import math

import numpy as np
from msgspec.structs import replace

from companion.mission.events import Vector
from companion.mission.state import Answered, Flight, State
from companion.planner import join
from companion.planner.procedure import Leg, Reference

_SPACING_M = 1.0
_MAX_SAMPLES = 1000
_ROUNDS, _MIN_BEND = 6, 0.25
_FRESH_S = 1.0
_ON_CIRCLE = 1.5  # loiter radii: a plane may be circling there


def joined(state: State) -> Flight | None:
    """Rejoin the leg, or the next one, from the current setpoint.

    None if that is farther from the path than was proven.
    """
    vehicle, flight = state.vehicle, state.flight
    led_so = _led(state)
    if led_so is None or flight.leg is None:
        return None
    led, velocity = led_so
    best: tuple[float, Leg, float] | None = None
    for leg in (flight.leg, flight.next_leg):
        if leg is not None:
            off_m, at_m = nearest(leg, led)
            if best is None or off_m < best[0] - 1e-6:
                best = (off_m, leg, at_m)
    assert best is not None
    off_m, leg, at_m = best
    limits = state.task.limits
    if off_m > limits.tracking_error_m + _ON_CIRCLE * limits.loiter_radius_m:
        return None
    went_over = leg is flight.next_leg
    pose = leg.subpath.pose(at_m)
    speed = max(float(np.dot(velocity, pose.tangent_nea)), 0.0)
    speed = min(speed, limits.speed_m_s)
    ends = went_over or flight.next_leg is None
    if vehicle.traits.hovers and ends:  # what it cannot brake from by then is offset
        speed = min(speed, limits.braked_m_s(leg.subpath.length_m - at_m, limits.overrun_m))
    circling = not vehicle.traits.hovers and off_m > limits.tracking_error_m
    flight = replace(
        flight,
        leg=leg,
        next_leg=None if went_over else flight.next_leg,
        legs_flown=flight.legs_flown + (1 if went_over else 0),
        reference=Reference(length_m=at_m, speed_m_s=speed),
        circling=circling,
        joined_m=at_m,
        progress_at_s=state.now_s,
        hover_nea_m=pose.point_nea_m if circling else None,
        search=None if went_over or flight.next_leg is None else Answered(),
    )
    if vehicle.traits.hovers:
        offset = join.begin(np.asarray(led), np.asarray(velocity), pose, speed)
        flight = replace(flight, offset=offset)
    return flight


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
    points = leg.subpath.sampled(spacing_m).points_nea_m
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
