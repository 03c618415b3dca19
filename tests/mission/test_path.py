"""A flight as it goes: each leg is scanned for, planned, led along and followed by the next.

Off its path a vehicle stops or holds; where it joins one, nothing jumps.  Where a plan or the
radar's answer does not come, or comes too late: `test_stories`.
"""

import functools
import itertools
import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import MISSION, PLANES, SPEED_M_S, TICK_S, Craft, flying, led, position
from made_up_plans import LEG_M
from renewed import deep, replace

from companion.mavlink.autopilots import ARDUCOPTER
from companion.mission import events
from companion.mission.decisions import Turn
from companion.mission.events import Plan, Setpoint, StartScan
from companion.mission.following import departs, joined, lead_m, outside_m, send_setpoint
from companion.mission.phases import Answered, OnPath, Phase, Reason
from companion.mission.state import State
from companion.mission.vehicle_traits import VehicleTraits
from companion.path.subpath import Subpath
from companion.planner.procedure import Reference

# The distances of environment-1 by hand: V = 150 m/s, a = 5 m/s2, T = 5 s, t_scan = 4 s,
# d_s = 500 m, R = 20 km: tail = max(0.15 R, V^2 / 2a + d_s), L = V (T + t_scan) + tail.
TAIL_M = max(3000.0, 150.0**2 / 10.0 + 500.0)
L_M = 150.0 * (9.0 + 3 * 0.1) + TAIL_M  # T, the scan, and three positions
NORTH_EAST = math.sqrt(0.5)


def flown_m(setpoint: Setpoint) -> float:
    """Its distance from the start."""
    return math.hypot(*setpoint.position_nea_m[:2])


def test_each_leg_is_scanned_for_once_at_p_scan_and_planned_and_begun_at_p_prog() -> None:
    """The answer is due after T; the first leg is scanned for and planned from rest.

    On a straight line the steps at speed are those of v dt, to 1e-6, from one leg to the next.
    """
    craft = Craft().run_until(lambda craft: craft.state.flight.legs_flown == 3)
    setpoints, (first, *later) = craft.sent(Setpoint), craft.sent(StartScan)
    assert len(later) == 2
    assert flown_m(setpoints[0]) == math.hypot(*first.centre_nea_m[:2]) < 2e-6
    for number, scan in enumerate(later):
        p_scan_m = LEG_M + number * (LEG_M - TAIL_M) - L_M
        assert 0.0 <= math.hypot(*scan.centre_nea_m[:2]) - p_scan_m <= SPEED_M_S * TICK_S
    plans = [(after.now_s, c) for *_, after, told in craft.steps for c in told if type(c) is Plan]
    assert [plan.request.plan_id for _, plan in plans] == [1, 2, 3]
    for number, (asked_s, plan) in enumerate(plans):
        assert plan.due_s == pytest.approx(asked_s + 5.0)
        assert plan.request.from_rest == (number == 0)
        start, p_prog_m = plan.request.start, number * (LEG_M - TAIL_M)
        assert np.hypot(*start.position_nea_m[:2]) == pytest.approx(p_prog_m, abs=3e-6)
        if number:
            np.testing.assert_allclose(start.tangent_nea, [NORTH_EAST, NORTH_EAST, 0], atol=1e-9)
    for before, _, after, _ in craft.steps:
        if after.flight.legs_flown > before.flight.legs_flown >= 1:
            assert 0.0 <= after.reference.length_m <= SPEED_M_S * TICK_S
            assert before.reference.length_m <= LEG_M - TAIL_M
    at_speed = [s for s in setpoints if math.hypot(*s.velocity_nea_m_s) > 149.999]
    assert len(at_speed) > 1000
    np.testing.assert_allclose(np.diff([*map(flown_m, at_speed)]), SPEED_M_S * TICK_S, atol=1e-6)


# --- off its path

ALONG, BACK = (NORTH_EAST, NORTH_EAST, 0.0), (-NORTH_EAST, -NORTH_EAST, 0.0)
ASIDE, UP = (NORTH_EAST, -NORTH_EAST, 0.0), (0.0, 0.0, 1.0)
SLANTED = (0.6 * NORTH_EAST, -0.6 * NORTH_EAST, 0.8)
ERROR_M, SAFETY_M = MISSION.task.limits.tracking_error_m, MISSION.task.settings.safety_distance_m
FAR_M = ERROR_M + min(ERROR_M, 0.5 * SAFETY_M)
STOPS_S = SPEED_M_S / 5.0


@functools.cache
def cruising() -> Craft:
    return flying().run_for(60.0)


def on_arc(craft: Craft, radius_m: float, angle_rad: float, at: float) -> OnPath:
    """Its path, if that bent to the right so, and it were led there at V."""
    turn_rad = np.linspace(0.0, angle_rad, 30)
    arc = np.stack([np.sin(turn_rad), 1.0 - np.cos(turn_rad), 0.0 * turn_rad], axis=-1)
    bent = Subpath(control_nea_m=radius_m * arc + (0.0, 0.0, craft.here[2]))
    path, speed_m_s = craft.state.path, craft.state.task.limits.speed_m_s
    reference = Reference(length_m=at * bent.length_m, speed_m_s=speed_m_s)
    return replace(path, leg=replace(path.leg, subpath=bent), reference=reference, next_leg=None)


LIMITS = {
    "out of the tube": ((ASIDE, UP, SLANTED), ERROR_M, 0.0, Reason.BESIDE_PATH, None),
    "ahead of where it was told to be": ((ALONG,), ERROR_M, 0.0, None, None),
    "a second ahead or behind": ((ALONG, BACK), ERROR_M + SPEED_M_S, 0.0, None, Reason.OFF_PATH),
    "too far off for a stop": ((ASIDE,), FAR_M, 0.0, Reason.BESIDE_PATH, Reason.OFF_PATH),
    "not back in time": ((ASIDE,), ERROR_M, STOPS_S + 4.0, None, Reason.OFF_PATH),
    "not back, in time": ((ASIDE,), ERROR_M, STOPS_S + 2.0, Reason.BESIDE_PATH, None),
}
"""Which way it is how far from its reference point, having been outside of its tube for so long:
from there on it is to stop on its path, or to hold."""


@pytest.mark.parametrize("limit", LIMITS)
def test_who_leaves_what_was_proven_is_noted_and_to_stop_or_hold(limit: str) -> None:
    ways, limit_m, later_s, stops, holds = LIMITS[limit]
    for way, is_out in itertools.product(ways, (False, True)):
        state = deep(cruising().state)
        path, off_m = state.path, limit_m * (1.02 if is_out else 0.98)
        told = path.leg.subpath.pose(path.reference.length_m).position_nea_m
        here = tuple((told + off_m * np.array(way)).tolist())
        if later_s:
            path.outside_since_s, path.outside_m = state.now_s - later_s, 1.0
        event = position(state.now_s, here, cruising().velocity)
        reason = departs(state, state.stage, path, event, Turn(state, cruising().context))
        assert reason is (holds if is_out else None)
        if holds is None:
            assert later_s or path.outside_m == pytest.approx(0.02 * limit_m * is_out, rel=0.01)
            assert (path.stop and path.stop.reason) is (stops if is_out else None)


@PLANES
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_plane_that_sinks_or_rises_leaves_its_tube(traits: VehicleTraits, sign: float) -> None:
    """What is proven is the level circle about each point of the path, and not a ball."""
    craft = led(traits)
    state, task = craft.state, craft.state.task
    north, east, up = state.leg.subpath.pose(state.reference.length_m).point_nea_m
    aside_m, tube_m = 0.9 * task.limits.loiter_radius_m, task.envelope.tube_m
    for share, out_m in ((0.98, 0.0), (1.02, 0.02 * tube_m)):
        here = (north + aside_m, east, up + sign * share * tube_m)
        event = position(craft.now_s, here, (9.0, 0.0, 0.0))
        assert outside_m(state, state.path, event)[0] == pytest.approx(out_m, abs=1e-6)


@PLANES
def test_the_point_that_a_plane_is_sent_to_runs_over_onto_the_next_leg_and_stays_at_an_end(
    traits: VehicleTraits,
) -> None:
    craft = led(traits)
    state, leg = deep(craft.state), craft.state.leg
    path, ahead_m, over_m = state.path, lead_m(state), leg.successor_at_m
    over = leg.subpath.pose(over_m)
    control = over.position_nea_m + np.outer([0.0, 0.3, 0.6, 1.0], 900.0 * over.tangent_nea)
    next_leg = replace(leg, subpath=Subpath(control_nea_m=control))
    for at_m, then, place in (
        (over_m + 0.4 * ahead_m, next_leg, next_leg.subpath.pose(0.4 * ahead_m)),
        (over_m - 0.4 * ahead_m, next_leg, leg.subpath.pose(over_m - 0.4 * ahead_m)),
        (leg.subpath.length_m + 0.4 * ahead_m, None, leg.subpath.pose(leg.subpath.length_m)),
    ):
        path.reference, path.next_leg = Reference(length_m=at_m - ahead_m), then
        state.flight.sent_at_s, turn = -math.inf, Turn(state, craft.context)
        send_setpoint(state, path, position(state.now_s, craft.here), turn)
        (sent,) = turn.commands
        assert sent.position_nea_m == pytest.approx(place.point_nea_m)
        assert sent.stay is (then is None)


@given(
    bend=st.floats(1.1, 3.0),
    angle_rad=st.floats(1.5, 2.5),
    at=st.floats(0.3, 0.6),
    spread=st.floats(0.1, 1.5),
)
def test_who_is_within_a_tracking_error_of_its_path_is_not_outside_of_anything(
    bend: float, angle_rad: float, at: float, spread: float
) -> None:
    """On paths that bend up to the turn radius, before and behind the reference point."""
    craft = led(ARDUCOPTER.traits)
    error_m, radius_m = (limits := craft.state.task.limits).tracking_error_m, limits.turn_radius_m
    path = on_arc(craft, bend * radius_m, angle_rad, at)
    pose, samples = (bent := path.leg.subpath).pose(path.reference.length_m), bent.sampled(0.1)
    for off_m in spread * error_m * np.random.default_rng(1).normal(size=(300, 3)):
        here = (pose.position_nea_m + off_m).tolist()
        event = position(craft.now_s, tuple(here), craft.velocity)
        across_m, before_m, far_m = outside_m(craft.state, path, event)
        apart_m = np.linalg.norm(samples.value - here, axis=-1).min()
        ahead_m = float(off_m @ pose.tangent_nea)
        assert across_m > 0.0 or apart_m <= error_m + 0.01
        assert apart_m > error_m - 0.01 or across_m < 0.05
        assert (before_m > 0.0) is (ahead_m > error_m)
        assert far_m == 0.0 or abs(ahead_m) > error_m


@pytest.mark.parametrize("radius_m", [400.0, 1_000.0, 10_000.0])
def test_setpoints_lead_along_a_bend_and_into_it_by_what_is_flown_wide(radius_m: float) -> None:
    state, path = deep(cruising().state), on_arc(cruising(), radius_m, 1.0, 0.5)
    state.flight.sent_at_s, turn = -math.inf, Turn(state, cruising().context)
    send_setpoint(state, path, position(state.now_s, cruising().here), turn)
    pose = path.leg.subpath.pose(path.reference.length_m)
    [sent] = turn.commands
    off = np.subtract(sent.position_nea_m, pose.position_nea_m)
    expected_m = state.vehicle.traits.handling.leading_s2 * SPEED_M_S**2 / radius_m
    inwards = pose.curvature_nea_1_m / np.linalg.norm(pose.curvature_nea_1_m)
    np.testing.assert_allclose(off, expected_m * inwards, rtol=0.01, atol=1e-6)
    speed_m_s = math.hypot(*sent.velocity_nea_m_s)
    np.testing.assert_allclose(sent.velocity_nea_m_s, speed_m_s * pose.tangent_nea, atol=1e-6)
    assert sent.yaw_rad == pytest.approx(math.atan2(*pose.tangent_nea[1::-1]))


# --- who joins a path, as after a restart


def told_nothing(state: State, at: Any, velocity: Any, echo: events.Echo | None = None) -> State:
    """The state of a companion that finds its vehicle there, and what it says of its target."""
    state = deep(state)
    vehicle, state.flight.sent = state.vehicle, None
    vehicle.position_nea_m, vehicle.velocity_nea_m_s, vehicle.echo = at, velocity, echo
    return state


@pytest.mark.parametrize("speed_m_s", [0.5, 5.0, 14.0])
@pytest.mark.parametrize(("left_m", "beside_m"), [(0.0, 0.0), (-3.0, 1.0), (0.3, 0.3), (6.0, 2.0)])
def test_who_joins_a_path_near_its_end_comes_to_rest_without_a_jump(
    left_m: float, beside_m: float, speed_m_s: float
) -> None:
    """The autopilot has flown on, to where it can hardly stop any more."""
    craft = flying()
    end = craft.state.leg.subpath.pose(craft.state.leg.subpath.length_m)
    along, across = end.tangent_nea, np.array([-end.tangent_nea[1], end.tangent_nea[0], 0.0])
    craft.here = tuple((end.position_nea_m - left_m * along + beside_m * across).tolist())
    craft.velocity = tuple((speed_m_s * along).tolist())
    state = told_nothing(craft.state, craft.here, craft.velocity)
    state.path.next_leg = None
    craft.state = replace(state, path=joined(state, state.path), search=Answered())
    craft.watch.position = None  # it has not jumped there
    sent: list[Setpoint] = []
    craft.goal = None
    while craft.state.phase is Phase.FLYING and len(sent) < 300:
        sent += [each for each in craft.tick() if isinstance(each, Setpoint)]
    assert craft.state.phase is not Phase.FLYING
    assert math.dist(sent[0].velocity_nea_m_s, speed_m_s * along) <= 1.0
    harder = 2.5 * craft.state.task.limits.acceleration_m_s2  # twice on the path, half beside it
    for before, after in pairwise(sent):
        moved = np.add(before.position_nea_m, TICK_S * np.array(before.velocity_nea_m_s))
        assert math.dist(moved, after.position_nea_m) <= 0.25
        assert math.dist(before.velocity_nea_m_s, after.velocity_nea_m_s) <= harder * TICK_S
    assert math.hypot(*sent[-1].velocity_nea_m_s) < 0.1


@given(
    share=st.floats(0.05, 0.95),
    on_next=st.booleans(),
    pace=st.floats(0.1, 1.0),
    says=st.none() | st.tuples(st.floats(0.0, 0.9), st.sampled_from([None, 0.0, 0.7])),
)
def test_who_is_found_on_either_of_two_legs_is_led_on_from_where_its_autopilot_leads_it(
    share: float, on_next: bool, pace: float, says: Any
) -> None:
    """It says how long ago that was where, and how fast it moves it on; else that is where it is.

    The next leg turns off to the right from p_prog of the first, which has been flown then.
    """
    state, path = cruising().state, deep(cruising().state).path
    over_at_m = path.leg.successor_at_m
    begins = path.leg.subpath.pose(over_at_m).position_nea_m
    aside = begins + np.linspace(0.0, LEG_M, 4)[:, None] * np.array(ASIDE)
    path.next_leg = replace(path.leg, subpath=Subpath(control_nea_m=aside))
    leg, length_m = (path.next_leg, LEG_M) if on_next else (path.leg, over_at_m)
    at, echo = leg.subpath.pose(share * length_m), None
    there = here = at.position_nea_m + np.multiply(UP, 0.8 * ERROR_M)
    flies = leads = pace * SPEED_M_S * at.tangent_nea
    if says is not None:
        (age_s, of_that), told = says, None
        was = behind = there - 30.0 * at.tangent_nea
        if of_that is not None:
            here, leads = behind, of_that * flies
            was, told = there - age_s * leads, tuple(leads.tolist())
        echo = events.Echo(
            time_s=state.now_s - age_s, position_nea_m=tuple(was.tolist()), velocity_nea_m_s=told
        )
    found = told_nothing(state, tuple(here.tolist()), tuple(flies.tolist()), echo)
    path = joined(found, path)
    assert path.leg is leg
    at_m, speed_m_s, offset = path.reference.length_m, path.reference.speed_m_s, path.offset
    pose = leg.subpath.pose(at_m)
    np.testing.assert_allclose(pose.position_nea_m + offset.position_nea_m, there, atol=1e-6)
    leads_with = speed_m_s * pose.tangent_nea + offset.velocity_nea_m_s
    np.testing.assert_allclose(leads_with, leads, atol=1e-6)
    assert at_m == pytest.approx(share * length_m, abs=0.1)
    flown = [segment.until_m for segment in found.flight.flown[len(state.flight.flown) :]]
    assert flown == pytest.approx([over_at_m, at_m] if on_next else [at_m])


@PLANES
@pytest.mark.parametrize("says", [False, True])
def test_a_plane_found_circling_goes_on_circling_there(traits: VehicleTraits, says: bool) -> None:
    """As far as its autopilot says what it circles; else the place next to where it is."""
    state = led(traits).state
    centre = state.leg.subpath.pose(state.reference.length_m + 40.0)
    apart = np.add(ASIDE, (0.3, 0.0, 0.0))
    radius_m = state.task.limits.loiter_radius_m
    at = centre.position_nea_m + radius_m * apart / np.linalg.norm(apart)
    echo = events.Echo(time_s=state.now_s, position_nea_m=centre.point_nea_m) if says else None
    found = told_nothing(state, tuple(at.tolist()), (0.0, 15.0, 0.0), echo)
    path = joined(found, state.path)
    assert path.circling
    off_m = math.dist(found.flight.hover_nea_m, centre.point_nea_m)
    assert off_m < 0.5 if says else off_m > 5.0
