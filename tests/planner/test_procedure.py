"""The reference point along a leg, where a leg is left, how a vehicle joins it; and planes."""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from brute_force import fastest_m_s
from hypothesis import given, settings
from hypothesis import strategies as st
from planning import PLANE_TASK, leg_of, limits

from companion.path.envelope import ending_m_s, slowing_m
from companion.planner.procedure import (
    ARRIVED_M,
    Leg,
    Offset,
    Reference,
    advance,
    entering_m_s,
    follow,
    may_leave,
    off_path_m,
)
from companion.planner.settings import PlannerSettings, Task

LIMITS = limits(floor_amsl_m=0.0, ceiling_amsl_m=9_000.0)
V, A, CLIMB_RATE = LIMITS.speed_m_s, LIMITS.acceleration_m_s2, LIMITS.climb_rate_m_s
SETTINGS = PlannerSettings(
    scan_range_m=2_000.0, safety_distance_m=60.0, planning_time_s=2.0, scan_time_s=1.0
)
TASK = Task(limits=LIMITS, settings=SETTINGS)
MOTION = TASK.envelope
SHORT = Task(limits=replace(LIMITS, overrun_m=5.0), settings=replace(SETTINGS, cell_m=1.0))
"""Which may run on by 5 m only: V and the dead man are 3.5 V."""
ticks = st.sampled_from([0.05, 0.1, 0.2, 0.5])


def leg_to(*end: float, rules: Task = TASK) -> Leg:
    return leg_of(np.outer([0.0, 0.2, 0.6, 1.0], end), rules=rules)


def bent_leg(rules: Task = TASK) -> Leg:
    control = [[0, 0, 500], [600, 0, 500], [900, 700, 560], [1_500, 900, 520.0]]
    return leg_of(control, rules=rules)


def step(
    reference: Reference, leg: Leg, tick_s: float, behind_m: float = 0.0, **keywords: Any
) -> Reference:
    """One tick of a vehicle that is always so far behind its reference point."""
    pose = leg.subpath.pose(reference.length_m)
    return advance(
        reference, leg, tick_s, pose.position_nea_m - behind_m * pose.tangent_nea, **keywords
    )


def is_at_end(reference: Reference, leg: Leg, until_m: float = math.inf) -> bool:
    return min(leg.subpath.length_m, until_m) - reference.length_m < ARRIVED_M


def flown(
    leg: Leg, tick_s: float, *, goes_on: bool = False, until_m: float = math.inf, **keywords: Any
) -> list[Reference]:
    """The reference point, tick by tick, for 400 s at most."""
    references, how = [Reference()], {"goes_on": goes_on, "until_m": until_m} | keywords
    while len(references) * tick_s < 400.0 and not is_at_end(references[-1], leg, until_m):
        references.append(step(references[-1], leg, tick_s, **how))
    return references


# --- the reference point


@given(tick_s=ticks)
def test_a_level_leg_is_flown_in_the_time_of_a_trapezium_and_stops_just_at_its_end(
    tick_s: float,
) -> None:
    leg = leg_to(1_200.0, -900.0, 0.0)
    references = flown(leg, tick_s)
    trapezium_s = 1_500.0 / V + 0.5 * V / (0.5 * A) + 0.5 * V / A  # gained more gently
    settles_s = MOTION.settling_s * math.log(100.0)
    assert trapezium_s <= len(references) * tick_s <= trapezium_s + settles_s + 1.5 + 4 * tick_s
    end = flown(leg, tick_s, goes_on=True)[-1]  # with a successor it does not stop
    assert (end.length_m, end.speed_m_s) == (pytest.approx(1_500.0, abs=0.05), V)


@settings(max_examples=80)
@given(
    tick_s=ticks,
    task=st.sampled_from([TASK, SHORT]),
    slope=st.floats(-2.0, 2.0) | st.none(),
    goes_on=st.booleans(),
    until=st.floats(0.2, 1.2) | st.just(math.inf),
    behind=st.sampled_from([0.0, 0.0, 0.0, -9.0, 0.3]),
)
def test_the_reference_point_is_nowhere_faster_than_proven_and_stops_where_it_is_told_to(
    tick_s: float, task: Task, slope: float | None, goes_on: bool, until: float, behind: float
) -> None:
    """Nor than V, its acceleration and its climb rate allow.  slope: of a straight leg.

    It gains speed the more slowly the farther behind the vehicle is (else that would overshoot when
    it catches up), by one ahead it is not pulled along, and for one too far behind it waits.
    """
    leg, steepness = bent_leg(task), 0.0
    if slope is not None:
        leg = leg_to(600.0, 0.0, slope * 600.0, rules=task)
        steepness = abs(slope) / math.hypot(1.0, slope)
    length_m = leg.subpath.length_m
    until_m, end_m = until * length_m, min(until, 1.0) * length_m
    lag_m, gains = leg.motion.lag_m, min(1.0 - behind / 0.6, 1.0) * MOTION.gaining_m_s2
    references = flown(leg, tick_s, goes_on=goes_on, until_m=until_m, behind_m=behind * lag_m)
    assert is_at_end(references[-1], leg, until_m)
    waits = step(references[-2], leg, tick_s, 1.01 * lag_m, goes_on=goes_on)
    assert waits == Reference(length_m=references[-2].length_m, speed_m_s=0.0)
    stops = step(Reference(speed_m_s=V), leg, tick_s, goes_on=goes_on, until_m=0.1)  # told too late
    assert stops.speed_m_s >= V - 2.0 * A * tick_s - 1e-9
    left_m = length_m - np.array([each.length_m for each in references])
    limits_m_s = fastest_m_s(leg.motion, left_m)
    for (before, after), most_m_s in zip(pairwise(references), limits_m_s[:-1], strict=True):
        moved_m = after.length_m - before.length_m
        gained_m_s = after.speed_m_s - before.speed_m_s
        assert max(after.speed_m_s, moved_m / tick_s) <= V + 1e-9
        assert max(after.speed_m_s, moved_m / tick_s) * steepness <= CLIMB_RATE + 1e-6
        assert 0.0 <= moved_m <= end_m - before.length_m + 1e-9
        assert -2.0 * A * tick_s - 1e-9 <= gained_m_s <= gains * tick_s + 1e-9
        if until < math.inf:
            room_m = max(end_m - before.length_m, 0.0)
            assert after.speed_m_s <= math.sqrt(2.0 * A * room_m) + 2.0 * A * tick_s
        elif not goes_on:
            assert after.speed_m_s <= most_m_s + 1e-6


@pytest.mark.parametrize("slope", [0.25, -0.25])
@pytest.mark.parametrize("spacing_m", [15.0, 30.0])
def test_it_is_asked_to_rise_and_to_sink_no_harder_than_a_vehicle_does(
    slope: float, spacing_m: float
) -> None:
    """Of a level path that begins to climb; else ArduCopter is for seconds metres below it."""
    north_m = spacing_m * np.arange(17.0)
    altitude_m = 500.0 + slope * np.maximum(north_m - north_m[8], 0.0)
    leg = leg_of(np.stack([north_m, 0.0 * north_m, altitude_m], axis=-1), rules=TASK)
    references, tick_s = flown(leg, 0.1), 0.1
    up_m_s = [r.speed_m_s * leg.subpath.pose(r.length_m).tangent_nea[2] for r in references]
    hardest_m_s2 = np.abs(np.diff(up_m_s)).max() / tick_s
    assert hardest_m_s2 == pytest.approx(MOTION.vertical_m_s2, rel=0.1)  # a hundred paces a leg


@settings(max_examples=30)
@given(length_m=st.floats(20.0, 500.0), from_rest=st.booleans(), tick_s=ticks)
def test_among_near_things_the_answer_is_there_before_p_prog_where_the_vehicle_can_still_stop(
    length_m: float, from_rest: bool, tick_s: float
) -> None:
    if not from_rest:  # shorter ones are not planned in flight
        length_m = max(length_m, slowing_m(SHORT.envelope, V))
    leg, asked = leg_to(length_m, 0.0, 0.0, rules=SHORT), 0
    reference = Reference(speed_m_s=0.0 if from_rest else V)
    while not is_at_end(reference, leg):
        if leg.wants_successor(reference):
            asked, on, seconds, left = asked + 1, reference, 0.0, leg.leaves(reference)
            while on.length_m < left.length_m:  # as long as there is no answer
                on = step(on, leg, tick_s, goes_on=False)
                seconds += tick_s
            assert seconds >= SETTINGS.planning_time_s + SETTINGS.scan_time_s
            slows_m = slowing_m(SHORT.envelope, left.speed_m_s)
            assert slows_m <= length_m - left.length_m + 1e-6
            for _ in range(round(1.0 / tick_s)):
                reference = step(reference, leg, tick_s, goes_on=False)
        reference = step(reference, leg, tick_s, goes_on=False)
    assert asked or length_m < 2.0 * SHORT.tail_m
    assert not replace(leg, reaches_target=True).wants_successor(Reference(speed_m_s=V))


@settings(max_examples=30)
@given(asked_m=st.floats(0.0, 390.0), waits=st.floats(0.0, 0.9), tick_s=ticks)
def test_a_leg_is_entered_no_faster_than_it_is_proven_for(
    asked_m: float, waits: float, tick_s: float
) -> None:
    """As slowly as the one before would have been flown to its end, at the least."""
    leg = leg_to(400.0, 0.0, 0.0, rules=SHORT)
    begins = Reference(length_m=asked_m, speed_m_s=ending_m_s(SHORT.envelope, 400.0 - asked_m))
    left = leg.leaves(begins)
    if not leg.may_be_left(left):
        return
    slow = replace(leg_to(300.0, 0.0, 0.0, rules=SHORT), speed_m_s=left.speed_m_s)
    reference, answers_m = begins, begins.length_m + waits * (left.length_m - begins.length_m)
    while reference.length_m < left.length_m - 1e-6:
        is_there, room_m = reference.length_m >= answers_m, left.length_m - reference.length_m
        slows_m_s = entering_m_s(slow, leg.motion, room_m) if is_there else math.inf
        reference = step(reference, leg, tick_s, goes_on=False, slows_to_m_s=slows_m_s)
    assert reference.speed_m_s <= left.speed_m_s + MOTION.gaining_m_s2 * tick_s


@given(
    at=st.one_of(st.floats(0.05, 1.0), st.just(1.0)),
    off_m=st.tuples(*[st.floats(-15.0, 15.0)] * 3),
    past_m=st.sampled_from([0.0, 8.0]),
)
def test_off_the_path_is_the_distance_to_its_nearest_point_and_beyond_its_end_to_that(
    at: float, off_m: tuple[float, float, float], past_m: float
) -> None:
    """Or to where it would be if it went straight on for a while."""
    leg = bent_leg()
    reference = Reference(length_m=at * leg.subpath.length_m)
    pose = leg.subpath.pose(reference.length_m)
    vehicle = pose.position_nea_m + off_m
    near = np.linspace(reference.length_m - 80.0, reference.length_m + 80.0, 3_201)
    near = near[(near >= 0.0) & (near <= leg.subpath.length_m)]
    end = leg.subpath.pose(leg.subpath.length_m)
    past = end.position_nea_m + np.linspace(0.0, past_m, 161)[:, None] * end.tangent_nea
    points = np.concatenate([leg.subpath.points_nea_m(near), past])
    nearest = float(np.linalg.norm(points - vehicle, axis=-1).min())
    assert off_path_m(reference, leg, vehicle, past_m) == pytest.approx(nearest, abs=0.05)


# --- where to scan and where the next leg takes over


@given(length_m=st.floats(1.0, 5_000.0), longer_m=st.sampled_from([None, 600.0]))
def test_p_scan_and_p_prog_lie_in_order_on_the_leg(length_m: float, longer_m: float | None) -> None:
    task = replace(TASK, settings=replace(SETTINGS, scan_distance_m=longer_m))
    leg = leg_to(length_m, 0.0, 0.0, rules=task)
    scan, prog = leg.scan_at_m, leg.successor_at_m
    assert 0.0 <= scan <= prog <= leg.subpath.length_m
    if length_m >= task.scan_distance_m:
        # the paper: L before the end, and (in flight) the tail before the end
        assert scan == pytest.approx(length_m - task.scan_distance_m)
        assert prog == pytest.approx(length_m - task.tail_m)
    if length_m >= 345.0:
        assert (prog - scan) / V >= SETTINGS.planning_time_s + SETTINGS.scan_time_s - 1e-9
    back = replace(leg, through=True)  # of the way back: it is left at its very end
    assert back.successor_at_m == leg.subpath.length_m


@given(speed_m_s=st.floats(10.0, 30.0), longer_m=st.floats(0.0, 900.0))
def test_with_the_wind_a_plane_asks_so_soon_that_its_point_is_not_yet_at_p_prog(
    speed_m_s: float, longer_m: float
) -> None:
    task, settled = PLANE_TASK, PLANE_TASK.settings
    length_m = 2.0 * task.shortest_scan_distance_m + longer_m
    leg = leg_of([[i * length_m / 3.0, 0.0, 100.0] for i in range(4)], rules=task)
    asks = np.linspace(0.0, length_m, 2_001)
    references = (Reference(length_m=float(at)) for at in asks)
    at_m = next(it.length_m for it in references if leg.wants_successor(it, speed_m_s))
    answers_s = settled.scan_time_s + settled.planning_time_s + 3.0 * settled.position_period_s
    point_m = at_m + speed_m_s * (answers_s + task.limits.lead_s)
    assert point_m <= leg.successor_at_m + length_m / 2_000
    if speed_m_s <= task.limits.speed_m_s:
        assert at_m == pytest.approx(leg.scan_at_m, abs=length_m / 2_000)


# --- the offset of a vehicle that joins its leg, and fades

SLOW = limits(speed_m_s=10.0, acceleration_m_s2=2.5)
vectors = st.tuples(*[st.floats(-15.0, 15.0)] * 3)


@settings(max_examples=15)
@given(position=vectors, velocity=vectors, tick_s=st.sampled_from([0.02, 0.05, 0.1, 0.2]))
def test_it_fades_smoothly_within_half_of_the_acceleration(
    position: tuple[float, ...], velocity: tuple[float, ...], tick_s: float
) -> None:
    offset = Offset(position_nea_m=np.array(position), velocity_nea_m_s=np.array(velocity))
    for _ in range(math.ceil(120.0 / tick_s)):
        after = offset.after(tick_s, SLOW)
        change = np.linalg.norm(after.velocity_nea_m_s - offset.velocity_nea_m_s)
        assert change <= 0.5 * SLOW.acceleration_m_s2 * tick_s * 1.001
        mean = 0.5 * (after.velocity_nea_m_s + offset.velocity_nea_m_s)
        moved = after.position_nea_m - offset.position_nea_m
        assert np.linalg.norm(moved - tick_s * mean) <= SLOW.acceleration_m_s2 * tick_s**2
        offset = after
    assert offset.is_gone


# --- vehicles that cannot stop: they hold on circles, and are sent to points ahead of them

PLANE = PLANE_TASK.limits
LOITER = PLANE.loiter_radius_m


def plane_leg(turn_rad: float = 1.2) -> Leg:
    """1,500 m that turn so far to the right."""
    bearing = turn_rad * np.linspace(0.25, 1.0, 4)
    steps = np.stack([np.cos(bearing), np.sin(bearing), np.full(4, 0.02)], axis=-1)
    control = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]) * 375.0
    return leg_of(control + np.array([1_000.0, 1_000.0, 400.0]), rules=PLANE_TASK)


@given(seed=st.integers(0, 10**6), turn=st.floats(-2.0, 2.0), aside_m=st.floats(-80.0, 80.0))
def test_the_reference_is_the_nearest_point_of_the_path_never_goes_back_and_comes_to_its_end(
    seed: int, turn: float, aside_m: float
) -> None:
    """Of a plane that flies so far beside it, from before its start to beyond its end."""
    leg, reference, rng = plane_leg(turn), Reference(), np.random.default_rng(seed)
    length_m = leg.subpath.length_m
    for at_m in np.arange(-30.0, length_m + 60.0, 20.0):
        pose, last_m = leg.subpath.pose(at_m), reference.length_m
        across = np.array([-pose.tangent_nea[1], pose.tangent_nea[0], rng.normal(0.0, 0.05)])
        beyond = (at_m - np.clip(at_m, 0.0, length_m)) * pose.tangent_nea
        vehicle = pose.position_nea_m + beyond + aside_m * across
        reference = follow(reference, leg, vehicle)
        assert reference.length_m >= last_m
        assert reference.length_m == pytest.approx(np.clip(at_m, 0.0, length_m), abs=3.0)
        assert reference.speed_m_s == PLANE.speed_m_s
    assert reference.length_m == length_m


def test_where_a_path_comes_near_to_itself_it_is_not_cut_short() -> None:
    control = [[0, 0, 400.0], [1_500, 0, 400], [1_500, 60, 400], [0, 60, 400]]
    hairpin, reference = leg_of(control, rules=PLANE_TASK), Reference(length_m=200.0)
    for at_m in np.arange(200.0, 700.0, 2.0):
        other_side = hairpin.subpath.pose(at_m).position_nea_m + np.array([0.0, 35.0, 0.0])
        reference = follow(reference, hairpin, other_side)
        assert reference.length_m <= at_m + PLANE.turn_radius_m + 5.0 * PLANE.speed_m_s


@pytest.mark.parametrize("safety_m", [5.0, 20.0, 500.0])
def test_a_plane_is_sent_past_its_target_no_farther_than_it_is_proven_clear_there(
    safety_m: float,
) -> None:
    """Left there, its circle lies so far beside the last one that keeps d_s besides its errors."""
    settings = replace(PLANE_TASK.settings, safety_distance_m=safety_m)
    leg = leg_of(
        np.outer([0.0, 0.2, 0.6, 1.0], [900.0, 0.0, 0.0]),
        rules=replace(PLANE_TASK, settings=settings),
    )
    assert leg.past_target_m == pytest.approx(min(safety_m, 0.25 * LOITER))


@pytest.mark.parametrize("share", [0.0, 0.5])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_plane_leaves_its_circle_once_in_a_turn_and_joins_the_path_within_its_circle(
    share: float, sense: float
) -> None:
    """A point mass that turns at most at LOITER / 2 flies to the point ahead of it (L1's aim).

    About the start of a leg, or, taken over late, about any other point of it.
    """
    leg = plane_leg(turn_rad=0.6)
    for first in np.linspace(0.0, math.tau, 3, endpoint=False).tolist():
        widest = widest_m(leg, share * leg.subpath.length_m, sense, first)
        assert widest <= LOITER + PLANE.tracking_error_m


def widest_m(leg: Leg, at_m: float, sense: float, angle: float) -> float:
    """How far off the path the plane comes once it has left the circle."""
    start, step_m = leg.subpath.pose(at_m).position_nea_m, 0.1 * PLANE.speed_m_s
    for _ in range(math.ceil(2.2 * math.pi * LOITER / step_m)):
        angle += sense * step_m / LOITER
        here = start + LOITER * np.array([math.cos(angle), math.sin(angle), 0.0])
        course = angle + sense * math.pi / 2.0
        velocity = (math.cos(course), math.sin(course), 0.0)
        if may_leave(leg, at_m, (here[0], here[1], here[2]), velocity):
            break
    else:
        pytest.fail("it never left its circle")
    reference, widest = Reference(length_m=at_m), 0.0
    for _ in range(400):
        reference = follow(reference, leg, here)
        if leg.subpath.length_m - reference.length_m < 1.2 * LOITER:
            break  # it circles the end
        aim_m = reference.length_m + PLANE_TASK.envelope.lead_m
        aim = leg.subpath.pose(aim_m).position_nea_m - here
        error = math.remainder(math.atan2(aim[1], aim[0]) - course, math.tau)
        most = step_m / (LOITER / 2.0)
        course += min(max(error, -most), most)
        here = here + step_m * np.array([math.cos(course), math.sin(course), 0.0])
        nearest = leg.subpath.pose(reference.length_m).point_nea_m
        widest = max(widest, math.dist(nearest[:2], here[:2]))
    return widest


@pytest.mark.parametrize(("off_m", "leaves"), [(0.5 * LOITER, True), (91.0, True), (93.0, False)])
def test_a_plane_that_is_not_on_its_circle_does_not_leave_it(off_m: float, leaves: bool) -> None:
    """It would be off its path at once; the way it flies does not matter."""
    leg = plane_leg()
    pose = leg.subpath.pose(0.0)
    (north, east, _), (n, e, up) = pose.tangent_nea.tolist(), pose.point_nea_m
    place, velocity = (n - off_m * east, e + off_m * north, up), (north, east, 0.0)
    assert may_leave(leg, 0.0, place, velocity) is leaves
