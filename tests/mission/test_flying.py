import copy
import functools
import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from made_up import (
    LEG_M,
    MISSION,
    SPEED_M_S,
    TICK_S,
    Craft,
    flying,
    near_target,
    planned,
    position,
    two_legs_away,
)
from renewed import deep, replace

from companion.mission import events
from companion.mission.decisions import Turn
from companion.mission.entries import of_change
from companion.mission.events import Mode, Plan, Position, Setpoint, StartScan, StatusText
from companion.mission.following import is_on_path, joined, left_path, outside_m
from companion.mission.phases import Answered, OnPath, Phase, Reason
from companion.path.subpath import Subpath
from companion.planner.procedure import Reference, hover_pose
from companion.planner.request import Planned, PlanRequest

# The distances of environment-1 by hand: V = 150 m/s, a = 5 m/s2, T = 5 s, t_scan = 4 s,
# d_s = 500 m, R = 20 km: tail = max(0.15 R, V^2 / 2a + d_s), L = V (T + t_scan) + tail.
TAIL_M = max(3000.0, 150.0**2 / 10.0 + 500.0)
L_M = 150.0 * (9.0 + 3 * 0.1) + TAIL_M  # T, the scan, and three positions
NORTH_EAST = math.sqrt(0.5)


def flown_m(setpoint: Setpoint) -> float:
    """Distance from the start: all legs lie on one straight line towards the target."""
    return math.hypot(*setpoint.position_nea_m[:2])


@functools.cache
def two_legs() -> Craft:
    return Craft().run_until(lambda craft: craft.state.flight.legs_flown == 3)


def test_every_leg_is_scanned_for_once_at_p_scan_and_not_before() -> None:
    craft = two_legs()
    first, *later = craft.sent(StartScan)
    assert len(later) == 2
    assert flown_m(craft.sent(Setpoint)[0]) == math.hypot(*first.centre_nea_m[:2]) < 2e-6
    for number, scan in enumerate(later, start=1):
        end_m = LEG_M + (number - 1) * (LEG_M - TAIL_M)
        assert 0.0 <= math.hypot(*scan.centre_nea_m[:2]) - (end_m - L_M) <= SPEED_M_S * TICK_S


def test_the_next_leg_is_planned_from_p_prog_with_its_tangent_and_is_due_after_t() -> None:
    craft = two_legs()
    steps = [(after, c) for _, _, after, commands in craft.steps for c in commands]
    plans = [(after.now_s, c) for after, c in steps if isinstance(c, Plan)]
    assert [plan.request.plan_id for _, plan in plans] == [1, 2, 3]
    for number, (asked_s, plan) in enumerate(plans):
        assert plan.due_s == pytest.approx(asked_s + 5.0)
        assert plan.request.from_rest == (number == 0)
        expected_m = number * (LEG_M - TAIL_M)
        start = plan.request.start
        assert np.hypot(*start.position_nea_m[:2]) == pytest.approx(expected_m, abs=1e-6)
        if number:
            np.testing.assert_allclose(start.tangent_nea, [NORTH_EAST, NORTH_EAST, 0], atol=1e-9)


def test_the_reference_goes_over_to_the_next_leg_at_p_prog() -> None:
    craft = two_legs()
    for before, event, after, _ in craft.steps:
        if after.flight.legs_flown > before.flight.legs_flown >= 1:
            assert isinstance(event, Position)
            reference = after.reference.length_m
            assert 0.0 <= reference <= SPEED_M_S * TICK_S
            assert before.reference.length_m <= LEG_M - TAIL_M


def test_setpoints_are_continuous_across_the_switch_to_1e_6() -> None:
    """On a straight line the steps are those of the speed: trapezoids of v dt."""
    setpoints = two_legs().sent(Setpoint)
    moving = [s for s in setpoints if math.hypot(*s.velocity_nea_m_s) > 149.999]
    flown = [flown_m(setpoint) for setpoint in moving]
    assert len(flown) > 1000
    np.testing.assert_allclose(np.diff(flown), SPEED_M_S * TICK_S, atol=1e-6)


def test_a_setpoint_lies_on_the_leg_with_its_velocity_and_nose_along_it() -> None:
    for setpoint in flying().run_for(20.0).sent(Setpoint)[100:]:
        north, east, altitude = setpoint.position_nea_m
        assert north == pytest.approx(east, abs=1e-6)
        assert altitude == pytest.approx(3030.0)
        speed = math.hypot(*setpoint.velocity_nea_m_s)
        expected = [speed * NORTH_EAST, speed * NORTH_EAST, 0.0]
        np.testing.assert_allclose(setpoint.velocity_nea_m_s, expected, atol=1e-6)
        assert setpoint.yaw_rad == pytest.approx(math.pi / 4)


def test_speed_and_acceleration_keep_to_the_mission_and_it_ends_at_the_target_at_rest() -> None:
    setpoints = Craft(two_legs_away()).fly_to(Phase.DONE).sent(Setpoint)
    speeds = np.array([math.hypot(*s.velocity_nea_m_s) for s in setpoints])
    assert speeds.max() == pytest.approx(SPEED_M_S)
    changes = np.diff(speeds) / TICK_S
    assert changes.max() <= 5.0 + 1e-6
    assert changes.min() >= -2.0 * 5.0 - 1e-6  # it may brake twice as hard
    assert setpoints[-1].velocity_nea_m_s == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(setpoints[-1].position_nea_m[:2], (20_000.0, 20_000.0), atol=1.0)


def test_the_reference_waits_for_a_vehicle_that_falls_behind_and_goes_on_when_it_follows() -> None:
    craft = flying()
    craft.follows = False
    craft.velocity = (0.5, 0.5, 0.0)
    ahead = [s for _ in range(100) for s in craft.tick() if isinstance(s, Setpoint)]
    leads = [math.dist(s.position_nea_m, craft.here) for s in ahead]
    assert max(leads) <= SPEED_M_S * 1.0 + SPEED_M_S * TICK_S
    assert ahead[-1].velocity_nea_m_s == (0.0, 0.0, 0.0)
    while math.dist(craft.here, craft.sent(Setpoint)[-1].position_nea_m) > 4.5:  # it catches up
        craft.velocity = (30.0, 30.0, 0.0)
        craft.here = tuple(np.add(craft.here, (3.0, 3.0, 0.0)))
        craft.tick()
    craft.follows = True
    assert math.hypot(*craft.run_for(70.0).velocity) == pytest.approx(SPEED_M_S)
    assert Phase.HOLDING not in {after.phase for *_, after, _ in craft.steps}


ERROR_M, SAFETY_M = MISSION.task.limits.tracking_error_m, MISSION.task.settings.safety_distance_m
ASIDE, ALONG = (NORTH_EAST, -NORTH_EAST, 0.0), (NORTH_EAST, NORTH_EAST, 0.0)
BACK = (-NORTH_EAST, -NORTH_EAST, 0.0)
Way = tuple[float, float, float]


@functools.cache
def cruising() -> Craft:
    return flying().run_for(60.0)


def found_at(craft: Craft, way: Way, by_m: float, later_s: float = 0.0) -> tuple[OnPath, Any]:
    """What follows if the vehicle is found so far from its reference point."""
    state = deep(craft.state)
    path = state.path
    told = path.leg.subpath.pose(path.reference.length_m).position_nea_m
    here = tuple(np.add(told, np.multiply(way, by_m)).tolist())
    if later_s:
        since_s = state.now_s - later_s
        path.outside_since_s, path.outside_m = since_s, 1.0
    event, turn = position(state.now_s, here, craft.velocity), Turn(state, craft.context)
    return path, left_path(state, path, event, turn)


FAR_M = ERROR_M + min(ERROR_M, 0.5 * SAFETY_M)
STOPS_S = SPEED_M_S / 5.0
UP, SLANTED = (0.0, 0.0, 1.0), (0.6 * NORTH_EAST, -0.6 * NORTH_EAST, 0.8)


LIMITS = {
    "out of the tube": ((ASIDE, UP, SLANTED), ERROR_M, Reason.BESIDE_PATH, None),
    "ahead of where it was told to be": ((ALONG,), ERROR_M, None, None),
    "a second ahead or behind": ((ALONG, BACK), ERROR_M + SPEED_M_S, None, Reason.OFF_PATH),
    "too far off for a stop": ((ASIDE,), FAR_M, Reason.BESIDE_PATH, Reason.OFF_PATH),
}
"""Ways, and how far: from there on it is to stop on its path, or to hold."""


@pytest.mark.parametrize("share", [0.98, 1.02])
@pytest.mark.parametrize("limit", LIMITS)
def test_who_leaves_where_it_was_proven_to_be_is_noted_and_is_to_stop_or_to_hold(
    limit: str, share: float
) -> None:
    ways, limit_m, stops, departs = LIMITS[limit]
    for way in ways:
        path, reason = found_at(cruising(), way, share * limit_m)
        assert reason is (departs if share > 1.0 else None)
        if departs is None:
            left_m = max(share - 1.0, 0.0) * limit_m
            assert path.outside_m == pytest.approx(left_m, rel=0.01)
            stop = None if path.stop is None else path.stop.reason
            assert stop is (stops if share > 1.0 else None)


@pytest.mark.parametrize(
    ("off", "later_s", "reason"),
    [(1.5, STOPS_S + 2.0, None), (1.5, STOPS_S + 4.0, Reason.OFF_PATH), (0.5, STOPS_S + 4.0, None)],
)
def test_who_does_not_come_back_is_told_to_hold(
    off: float, later_s: float, reason: Reason | None
) -> None:
    path, departs = found_at(cruising(), ASIDE, off * ERROR_M, later_s=later_s)
    assert departs is reason
    assert (path.outside_m > 0.0) is (off > 1.0)


def test_who_is_seen_at_a_glance_to_be_on_its_path_is_not_outside_of_anything() -> None:
    """On paths that bend up to the turn radius, before and behind the reference point."""
    craft, rng = cruising(), np.random.default_rng(1)
    state, radius_m, seen = craft.state, MISSION.task.limits.turn_radius_m, 0
    leg = state.leg
    assert leg is not None
    for _ in range(60):
        turn_rad = np.linspace(0.0, rng.uniform(0.2, 2.0), 7)
        bend_m = radius_m * rng.uniform(1.1, 3.0)  # of the polygon: the curve lies inside it
        control = np.stack([np.sin(turn_rad), 1.0 - np.cos(turn_rad), 0.0 * turn_rad], axis=-1)
        bent = Subpath(control_nea_m=bend_m * control + (0.0, 0.0, craft.here[2]))
        at = Reference(length_m=rng.uniform(0.0, bent.length_m), speed_m_s=SPEED_M_S)
        path = replace(state.path, leg=replace(leg, subpath=bent), reference=at)
        told = bent.pose(at.length_m).position_nea_m
        for off_m in (np.zeros(3), *(rng.normal(size=(40, 3)) * ERROR_M * rng.uniform(0.1, 1.5))):
            here = position(state.now_s, tuple((told + off_m).tolist()), craft.velocity)
            if is_on_path(state, path, here):
                seen += 1
                assert outside_m(state, path, here) == (0.0, 0.0, 0.0)
            else:
                assert off_m.any()
    assert seen > 500


def test_who_overshoots_the_end_of_its_path_has_left_it() -> None:
    craft = cruising()
    leg = craft.state.leg
    at_end = Reference(length_m=leg.subpath.length_m - 0.5 * ERROR_M, speed_m_s=5.0)
    path = replace(craft.state.path, reference=at_end, next_leg=None)
    craft = copy.copy(craft)
    craft.state = replace(craft.state, path=path)
    for beyond_m in (0.98 * ERROR_M, 1.02 * ERROR_M):
        left, departs = found_at(craft, ALONG, 0.5 * ERROR_M + beyond_m)
        ahead = 0.5 * ERROR_M + beyond_m - ERROR_M  # of where it was told to be
        assert left.outside_m == pytest.approx(max(beyond_m - ERROR_M, ahead), abs=1e-3)
        assert (left.stop, departs) == (None, None)  # it stops there anyway


def test_who_has_left_its_path_stops_says_so_and_goes_on_from_there() -> None:
    craft = flying().run_for(60.0)
    legs, craft.follows = craft.state.flight.legs_flown, False
    for tick in range(2_000):  # it drifts out by a metre a tick, and back
        told = craft.sent(Setpoint)[-1].position_nea_m
        off_m = max(18.0 - abs(tick - 18.0), 0.0)
        craft.here = tuple(np.add(told, np.multiply(ASIDE, off_m)).tolist())
        craft.velocity = craft.sent(Setpoint)[-1].velocity_nea_m_s
        craft.tick()
        if craft.state.flight.legs_flown > legs:
            break
    assert Reason.BESIDE_PATH in {after.reason for *_, after, _ in craft.steps}
    assert {after.phase for *_, after, _ in craft.steps[-500:]} <= {Phase.FLYING, Phase.HOLDING}
    assert craft.mode is Mode.GUIDED
    assert craft.state.flight.legs_flown > legs
    assert craft.state.flight.stops == 1
    said = [each.text for each in craft.sent(StatusText)]
    assert any(text.startswith("beside its path, ") for text in said)
    entries = [e for before, _, after, _ in craft.steps for e in of_change(before, after)]
    (left,) = [each for each in entries if each["kind"] == "path_left"]
    assert 0.0 < left["left_path_m"] < 1.01


def test_a_datagram_that_was_overtaken_or_comes_twice_changes_nothing() -> None:
    craft = flying()
    was = position(craft.now_s, craft.here, craft.velocity)
    assert craft.take(was) == []
    craft.tick()
    newest = craft.sent(Setpoint)[-1]
    sent = [c for c in craft.take(was) if isinstance(c, Setpoint)]
    sent += [c for c in craft.tick() if isinstance(c, Setpoint)]
    assert craft.phase is Phase.FLYING
    assert sent
    for setpoint in sent:
        assert flown_m(setpoint) >= flown_m(newest)
        assert setpoint.velocity_nea_m_s[0] >= 0.0


def test_a_plan_that_comes_after_p_prog_is_not_flown() -> None:
    asked: list[PlanRequest] = []

    def first_only(request: PlanRequest) -> Planned | None:
        asked.append(request)
        return planned(request) if request.plan_id == 1 else None

    craft = Craft(plan=first_only).run_until(lambda _: len(asked) == 2)
    craft.run_until(lambda craft: craft.state.reference.length_m > LEG_M - TAIL_M)
    craft.take(events.PlanReady(time_s=craft.now_s, outcome=planned(asked[1])))
    assert craft.state.path.next_leg is None
    assert craft.fly_to(Phase.HOLDING).state.reason is Reason.PLAN_LATE


@pytest.mark.parametrize("speed_m_s", [0.5, 5.0, 14.0])
@pytest.mark.parametrize(("left_m", "beside_m"), [(0.0, 0.0), (-3.0, 1.0), (0.3, 0.3), (6.0, 2.0)])
def test_who_joins_a_path_near_its_end_comes_to_rest_without_a_jump(
    left_m: float, beside_m: float, speed_m_s: float
) -> None:
    """As after a restart: the autopilot has flown on, to where it can hardly stop any more."""
    craft = flying()
    craft.run_until(lambda it: it.state.reference.length_m > 100.0)
    curve = craft.state.leg.subpath
    end = curve.pose(curve.length_m)
    along, across = end.tangent_nea, np.array([-end.tangent_nea[1], end.tangent_nea[0], 0.0])
    north, east, altitude = end.position_nea_m - left_m * along + beside_m * across
    at, velocity = (float(north), float(east), float(altitude)), tuple(speed_m_s * along)
    state = replace(
        craft.state,
        vehicle=replace(craft.state.vehicle, position_nea_m=at, velocity_nea_m_s=velocity),
        flight=replace(craft.state.flight, sent=None),
        path=replace(craft.state.path, next_leg=None),
    )
    went_on = joined(state, state.path)
    assert went_on is not None
    craft.state = replace(state, path=went_on, search=Answered())
    craft.here, craft.velocity = at, velocity
    sent: list[Setpoint] = []
    while craft.state.phase is Phase.FLYING and len(sent) < 300:
        sent += [each for each in craft.tick() if isinstance(each, Setpoint)]
    assert craft.state.phase is not Phase.FLYING
    assert math.dist(sent[0].velocity_nea_m_s, velocity) <= 1.0
    harder = 2.5 * craft.state.task.limits.acceleration_m_s2  # twice on the path, half beside it
    for before, after in pairwise(sent):
        moved = np.add(before.position_nea_m, TICK_S * np.array(before.velocity_nea_m_s))
        assert math.dist(moved, after.position_nea_m) <= 0.25
        assert math.dist(before.velocity_nea_m_s, after.velocity_nea_m_s) <= harder * TICK_S
    assert math.hypot(*sent[-1].velocity_nea_m_s) < 0.1


def went_on(at_m: float, told_m: float, pace: float, age_s: float, moves: Any = None) -> OnPath:
    """Where it goes on along its leg: at that length and share of V, told to be at the other."""
    state = two_legs().state
    curve = state.leg.subpath
    north, east, up = (float(each) for each in pace * SPEED_M_S * curve.pose(at_m).tangent_nea)
    vehicle = replace(
        state.vehicle,
        position_nea_m=curve.pose(at_m).point_nea_m,
        velocity_nea_m_s=(north, east, up),
        echo=events.Echo(
            time_s=state.now_s - age_s,
            position_nea_m=curve.pose(told_m).point_nea_m,
            velocity_nea_m_s=moves,
        ),
    )
    told_nothing = replace(state, vehicle=vehicle, flight=replace(state.flight, sent=None))
    path = joined(deep(told_nothing), state.path)
    assert path is not None
    return path


@pytest.mark.parametrize("share", [0.2, 0.8])
def test_it_rejoins_the_leg_that_is_the_nearer_one_and_has_flown_the_other(share: float) -> None:
    """The next leg turns off to the right from p_prog of this one."""
    state = deep(two_legs().state)
    path = state.path
    over_at_m = path.leg.successor_at_m(state.task)
    begins = path.leg.subpath.pose(over_at_m).position_nea_m
    aside = begins + np.linspace(0.0, LEG_M, 4)[:, None] * np.array(ASIDE)
    path.next_leg = replace(path.leg, subpath=Subpath(control_nea_m=aside))
    state.vehicle.echo = state.flight.sent = None
    for leg, at_m in ((path.leg, share * over_at_m), (path.next_leg, share * LEG_M)):
        state.vehicle.position_nea_m = leg.subpath.pose(at_m).point_nea_m
        then = deep(state)
        goes_on = joined(then, path)
        assert goes_on.leg is leg
        assert goes_on.reference.length_m == pytest.approx(at_m, abs=0.1)
        flown_m = [each.until_m for each in then.flight.flown[len(state.flight.flown) :]]
        assert flown_m == pytest.approx([at_m] if leg is path.leg else [over_at_m, at_m])


@pytest.mark.parametrize("age_s", [0.0, 0.1, 0.4])
def test_it_goes_on_where_the_autopilots_target_has_moved_since_it_was_told(age_s: float) -> None:
    path = went_on(1_000.0, 1_000.0 - age_s * SPEED_M_S, 1.0, age_s)
    assert path.reference.length_m == pytest.approx(1_000.0, abs=0.1)


def test_it_goes_on_from_a_target_that_stands_as_slowly_as_the_target() -> None:
    path = went_on(1_000.0 - 0.6 * SPEED_M_S, 1_000.0, 0.6, 0.4, (0.0, 0.0, 0.0))
    assert path.reference.length_m == pytest.approx(1_000.0, abs=0.01)
    assert path.reference.speed_m_s == 0.0
    assert np.linalg.norm(path.offset.velocity_nea_m_s) == 0.0


def test_at_its_target_it_looks_where_it_has_flown_to() -> None:
    craft = Craft(near_target()).fly_to(Phase.ARRIVED).run_for(1.0)
    *flown, stays = craft.sent(Setpoint)
    assert stays.velocity_nea_m_s == (0.0, 0.0, 0.0)
    last = next(each for each in reversed(flown) if any(each.velocity_nea_m_s))
    assert stays.yaw_rad == pytest.approx(last.yaw_rad, abs=0.02)


@pytest.mark.parametrize(("above_m", "proven"), [(0.5, True), (-0.5, False)])
def test_a_subpath_that_begins_too_low_is_not_flown_and_no_made_up_planner_proves_it(
    above_m: float, proven: bool
) -> None:
    task = MISSION.task
    low_m = task.limits.floor_amsl_m + task.error_m + above_m
    craft = Craft(near_target())
    craft.plan = lambda request: planned(
        replace(request, start=hover_pose((0.0, 0.0, low_m))), climb_m=10.0
    )
    craft.run_until(lambda craft: bool(craft.sent(Plan))).run_for(10.0)
    assert (craft.state.leg is not None) is proven
