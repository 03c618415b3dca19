"""A flight as it goes: each leg is scanned for, planned, led along and followed by the next.

And what it does where a plan or the radar's answer does not come, or comes too late.
"""

import math

import numpy as np
import pytest
from made_up import (
    HOME_AMSL_M,
    LEG_M,
    MISSION,
    SPEED_M_S,
    TAKE_OFF_AMSL_M,
    TICK_S,
    Craft,
    flying,
    near_target,
    not_planned,
    once,
    only_the_first,
    planned,
    position,
    scan_done,
    status,
    two_legs_away,
)
from renewed import replace

from companion.mavlink.autopilots import ARDUCOPTER
from companion.mission import events
from companion.mission.events import (
    Command,
    Event,
    Landed,
    Mode,
    Outcome,
    Plan,
    SetMode,
    Setpoint,
    StartScan,
    StatusText,
    Tick,
)
from companion.mission.phases import Phase, Reason
from companion.planner.procedure import hover_pose
from companion.planner.request import Planned, PlanRequest

# The distances of environment-1 by hand: V = 150 m/s, a = 5 m/s2, T = 5 s, t_scan = 4 s,
# d_s = 500 m, R = 20 km: tail = max(0.15 R, V^2 / 2a + d_s), L = V (T + t_scan) + tail.
TAIL_M = max(3000.0, 150.0**2 / 10.0 + 500.0)
L_M = 150.0 * (9.0 + 3 * 0.1) + TAIL_M  # T, the scan, and three positions
NORTH_EAST = math.sqrt(0.5)
GROUND, HOVER = (0.0, 0.0, HOME_AMSL_M), (0.0, 0.0, TAKE_OFF_AMSL_M)


def test_a_mission_begins_step_by_step() -> None:
    """Each event is followed by these commands, literally, from the first heartbeat to a plan."""
    guided = SetMode(mode=Mode.GUIDED)
    found = events.VehicleFound(time_s=1.0, system_id=1, traits=ARDUCOPTER.traits, name="made up")
    height_m = pytest.approx(TAKE_OFF_AMSL_M - HOME_AMSL_M)
    climb = events.TakeOff(above_home_m=height_m, altitude_amsl_m=TAKE_OFF_AMSL_M)
    near_hover = pytest.approx(HOVER, abs=1e-5)
    stays = Setpoint(
        time_s=5.5,
        position_nea_m=near_hover,
        velocity_nea_m_s=(0.0, 0.0, 0.0),
        yaw_rad=pytest.approx(math.pi / 4),
        stay=True,
    )
    prepared = [events.Prepared(time_s=1.5, item=item) for item in events.Item]
    good = [events.GpsFix(time_s=2.0, good=True), events.Estimator(time_s=2.0, good=True)]
    on_ground = events.LandedState(time_s=2.0, landed=Landed.ON_GROUND)
    home = events.Home(time_s=2.0, position_nea_m=GROUND)
    rises = events.LandedState(time_s=4.5, landed=Landed.TAKING_OFF)
    is_up = events.LandedState(time_s=5.3, landed=Landed.IN_AIR)
    steps: list[tuple[Phase, list[Event], list[Command]]] = [
        (Phase.WAITING, [Tick(time_s=1.0), status(1.0, Mode.OTHER, armed=False)], []),
        (Phase.PREPARING, [*prepared[:-1], position(2.0, GROUND), *good, home, on_ground], []),
        (Phase.ARMING, prepared[-1:], []),
        (Phase.ARMING, [position(2.2, GROUND)], [guided]),
        (Phase.ARMING, [position(2.6, GROUND)], []),
        (Phase.ARMING, [position(3.3, GROUND)], [guided]),
        (Phase.ARMING, [status(3.4, Mode.GUIDED, armed=False)], []),
        (Phase.ARMING, [position(4.4, GROUND)], [events.Arm()]),
        (Phase.TAKING_OFF, [status(4.4, Mode.GUIDED, armed=True)], []),
        (Phase.TAKING_OFF, [position(4.45, GROUND)], [climb]),
        (Phase.TAKING_OFF, [rises, position(4.8, (0.0, 0.0, 3010.0), (0.0, 0.0, 10.0))], []),
        (Phase.TAKING_OFF, [position(5.2, HOVER), is_up], []),
        (Phase.FLYING, [position(5.4, HOVER)], [events.SetSpeed(speed_m_s=150.0)]),
        (Phase.FLYING, [position(5.5, HOVER)], [stays, StartScan(centre_nea_m=near_hover)]),
    ]
    craft = Craft(near_target())
    for phase, told, commands in steps:
        if phase is Phase.PREPARING:
            assert craft.take(found)[0] == events.RequestStreams()
        assert craft.take(*told) == commands
        assert craft.phase is phase
    [_, plan] = craft.take(scan_done(5.6))  # after a word on how little it saw
    assert isinstance(plan, Plan)
    assert plan.due_s == 5.6 + 5.0
    assert plan.request.from_rest
    assert plan.request.target_ne_m == (5000.0, 5000.0)
    for now in (np.arange(56, 107) / 10).tolist():
        assert craft.take(status(now), *(replace(each, time_s=now) for each in good)) == []
        assert len(craft.take(position(now, HOVER))) == 1
    [said] = craft.take(events.PlanReady(time_s=10.6, outcome=planned(plan.request)))
    assert isinstance(said, StatusText)
    [first] = craft.take(position(10.7, HOVER))
    assert isinstance(first, Setpoint)
    gained = pytest.approx(0.1 * MISSION.task.envelope.gaining_m_s2)
    assert math.hypot(*first.velocity_nea_m_s) == gained


def test_targets_are_reached_in_their_order_with_a_stop_at_each() -> None:
    corners = ((9000.0, 0.0), (9000.0, 9000.0), (0.0, 9000.0))
    craft = Craft(replace(MISSION, targets_ne_m=corners)).fly_to(Phase.DONE)
    stops = [
        after.flight.hover_nea_m[:2]
        for before, _, after, _ in craft.steps
        if after.phase is Phase.ARRIVED is not before.phase and after.flight.hover_nea_m
    ]
    np.testing.assert_allclose(stops, corners, atol=1e-6)


# --- legs, on a straight line towards the north-east


def flown_m(setpoint: Setpoint) -> float:
    """Its distance from the start."""
    return math.hypot(*setpoint.position_nea_m[:2])


@once
def three_legs() -> Craft:
    """On its third."""
    return Craft().run_until(lambda craft: craft.state.flight.legs_flown == 3)


def test_every_leg_is_scanned_for_once_at_p_scan_and_planned_from_p_prog_with_its_tangent() -> None:
    """The answer is due after T; the first leg is scanned for and planned from rest."""
    craft = three_legs()
    first, *later = craft.sent(StartScan)
    assert len(later) == 2
    assert flown_m(craft.sent(Setpoint)[0]) == math.hypot(*first.centre_nea_m[:2]) < 2e-6
    for number, scan in enumerate(later):
        p_scan_m = LEG_M + number * (LEG_M - TAIL_M) - L_M
        assert 0.0 <= math.hypot(*scan.centre_nea_m[:2]) - p_scan_m <= SPEED_M_S * TICK_S
    steps = [(after, c) for _, _, after, commands in craft.steps for c in commands]
    plans = [(after.now_s, c) for after, c in steps if isinstance(c, Plan)]
    assert [plan.request.plan_id for _, plan in plans] == [1, 2, 3]
    for number, (asked_s, plan) in enumerate(plans):
        assert plan.due_s == pytest.approx(asked_s + 5.0)
        assert plan.request.from_rest == (number == 0)
        start, p_prog_m = plan.request.start, number * (LEG_M - TAIL_M)
        assert np.hypot(*start.position_nea_m[:2]) == pytest.approx(p_prog_m, abs=1e-6)
        if number:
            np.testing.assert_allclose(start.tangent_nea, [NORTH_EAST, NORTH_EAST, 0], atol=1e-9)


def test_at_p_prog_the_reference_goes_over_to_the_next_leg_and_setpoints_are_continuous() -> None:
    """On a straight line the steps at speed are those of v dt, to 1e-6."""
    craft = three_legs()
    for before, event, after, _ in craft.steps:
        if after.flight.legs_flown > before.flight.legs_flown >= 1:
            assert isinstance(event, events.Position)
            assert 0.0 <= after.reference.length_m <= SPEED_M_S * TICK_S
            assert before.reference.length_m <= LEG_M - TAIL_M
    at_speed = [s for s in craft.sent(Setpoint) if math.hypot(*s.velocity_nea_m_s) > 149.999]
    assert len(at_speed) > 1000
    steps_m = np.diff([flown_m(setpoint) for setpoint in at_speed])
    np.testing.assert_allclose(steps_m, SPEED_M_S * TICK_S, atol=1e-6)


def test_setpoints_lie_on_the_leg_nose_ahead_and_keep_to_speed_and_acceleration_to_rest() -> None:
    setpoints = Craft(two_legs_away()).fly_to(Phase.DONE).sent(Setpoint)
    for setpoint in setpoints[100:]:
        north, east, altitude = setpoint.position_nea_m
        assert north == pytest.approx(east, abs=1e-6)
        assert altitude == pytest.approx(TAKE_OFF_AMSL_M)
        speed = math.hypot(*setpoint.velocity_nea_m_s)
        along = [speed * NORTH_EAST, speed * NORTH_EAST, 0.0]
        np.testing.assert_allclose(setpoint.velocity_nea_m_s, along, atol=1e-6)
        assert setpoint.yaw_rad == pytest.approx(math.pi / 4, abs=0.02)  # at its target, too
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
    assert Phase.HOLDING not in craft.phases


def test_a_datagram_that_was_overtaken_or_comes_twice_changes_nothing() -> None:
    craft = flying()
    was = position(craft.now_s, craft.here, craft.velocity)
    assert craft.take(was) == []
    craft.tick()
    newest = craft.sent(Setpoint)[-1]
    sent = [c for c in [*craft.take(was), *craft.tick()] if isinstance(c, Setpoint)]
    assert sent
    for setpoint in sent:
        assert flown_m(setpoint) >= flown_m(newest)
        assert setpoint.velocity_nea_m_s[0] >= 0.0


# --- no plan, late plans


def test_without_a_plan_at_all_it_hovers_tries_four_times_and_lands_where_it_took_off() -> None:
    craft = Craft(plan=not_planned).fly_to(Phase.DONE)
    assert [plan.request.attempt for plan in craft.sent(Plan)] == [0, 1, 2, 3]
    assert craft.sent(SetMode)[-1].mode is Mode.LAND
    assert craft.end().reason == f"landed: {Reason.NO_PLAN.text}: it broke floor"
    assert len({setpoint.position_nea_m for setpoint in craft.sent(Setpoint)}) == 1


def test_without_a_successor_a_leg_is_flown_to_its_end_and_then_held_with_zero_velocity() -> None:
    craft = flying(plan=only_the_first)
    leg = craft.state.leg
    end_nea_m = leg.subpath.pose(leg.subpath.length_m).position_nea_m
    assert craft.fly_to(Phase.HOLDING).state.reason is Reason.NO_PLAN
    held = [s for s in craft.during(1.5) if isinstance(s, Setpoint)]
    assert len(held) == 15
    craft.run_until(lambda craft: craft.state.flight.failures == 2)  # refused from rest, too
    for setpoint in [*held, *(s for s in craft.during(1.0) if isinstance(s, Setpoint))]:
        np.testing.assert_allclose(setpoint.position_nea_m, end_nea_m, atol=1e-6)
        assert setpoint.velocity_nea_m_s == (0.0, 0.0, 0.0)
    craft.fly_to(Phase.DONE)
    assert len(craft.sent(Plan)) == 2 + 4 + 1 + 4  # the way back, then one home


def test_a_second_try_that_succeeds_flies_on() -> None:
    craft = flying(two_legs_away(), plan=lambda r: not_planned(r) if r.plan_id == 2 else planned(r))
    assert craft.fly_to(Phase.HOLDING).fly_to(Phase.DONE).end().outcome is Outcome.ARRIVED
    assert craft.state.flight.failures == 0


@pytest.mark.parametrize(("plan_id", "why"), [(2, Reason.PLAN_LATE), (99, Reason.NO_PLAN)])
def test_a_plan_that_never_comes_is_a_late_plan_at_the_end_of_the_leg(
    plan_id: int, why: Reason
) -> None:
    """News of another one is ignored, and so is the plan itself when it comes after p_prog."""
    asked: list[PlanRequest] = []

    def first_only(request: PlanRequest) -> Planned | None:
        asked.append(request)
        return planned(request) if request.plan_id == 1 else None

    craft = flying(plan=first_only).run_until(lambda _: len(asked) == 2).run_for(6.0)
    assert craft.take(events.PlanLate(time_s=craft.now_s, plan_id=plan_id)) == []
    assert (craft.phase, craft.state.stage.shortfall) == (Phase.FLYING, why)
    craft.run_until(lambda craft: craft.state.reference.length_m > LEG_M - TAIL_M)
    craft.take(events.PlanReady(time_s=craft.now_s, outcome=planned(asked[1])))
    assert craft.state.path.next_leg is None
    assert craft.fly_to(Phase.HOLDING).state.reason is Reason.PLAN_LATE


@pytest.mark.parametrize(("above_m", "is_proven"), [(0.5, True), (-0.5, False)])
def test_a_subpath_that_is_not_proven_is_not_flown(above_m: float, is_proven: bool) -> None:
    """It begins too low for a made-up proof."""
    low_m = MISSION.task.limits.floor_amsl_m + MISSION.task.error_m + above_m
    craft = Craft(near_target())
    craft.plan = lambda request: planned(
        replace(request, start=hover_pose((0.0, 0.0, low_m))), climb_m=10.0
    )
    craft.run_until(lambda craft: bool(craft.sent(Plan))).run_for(10.0)
    assert (craft.state.leg is not None) is is_proven


# --- a silent radar


def test_a_silent_radar_is_a_hold_with_its_reason_at_the_end_of_what_is_known() -> None:
    """On terrain that is known already it flies on from rest."""
    for mission, arrives in ((MISSION, False), (two_legs_away(), True)):
        craft = flying(mission, plan=planned if arrives else only_the_first)
        craft.answered = 0
        assert craft.fly_to(Phase.HOLDING).state.reason is Reason.RADAR_SILENT
        assert len(craft.sent(Plan)) == 1
        end = craft.fly_to(Phase.DONE).end()
        assert (end.outcome is Outcome.ARRIVED) is arrives
        assert arrives or end.reason.endswith(Reason.RADAR_SILENT.text)
        assert all(plan.request.from_rest for plan in craft.sent(Plan))


@pytest.mark.parametrize(
    ("answers", "scans"), [((0,), 1), ((1,), 3), ((2,), 1), ((1, 0), 2), ((1, 1, 0), 3)]
)
def test_from_rest_a_radar_that_left_something_out_is_asked_twice_more(
    answers: tuple[int, ...], scans: int
) -> None:
    """What another look does not show either is planned without."""
    craft = Craft()
    craft.asked = 2
    while not craft.sent(Plan) and craft.phase is not Phase.HOLDING:
        asked = len(craft.sent(StartScan))
        craft.answered = answers[min(max(asked, 1), len(answers)) - 1]
        craft.tick()
    assert len(craft.sent(StartScan)) == scans
    assert (answers == (0,)) == (craft.state.reason is Reason.RADAR_SILENT)


def test_in_flight_a_radar_that_left_something_out_is_asked_once() -> None:
    """And a scan of what is known already needs no answer."""
    craft = flying(two_legs_away())
    craft.answered, craft.asked = 1, 2
    begun = len(craft.sent(StartScan))
    craft.run_until(lambda craft: len(craft.sent(Plan)) == 2)
    assert len(craft.sent(StartScan)) == begun + 1
    craft = Craft().fly_to(Phase.FLYING)
    craft.take(position(craft.now_s + TICK_S, craft.here))
    known = replace(scan_done(craft.now_s, answered=0), asked=0)
    assert [type(c) for c in craft.take(known) if not isinstance(c, StatusText)] == [Plan]
