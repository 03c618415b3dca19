"""The mission machine, case by case (`test_never` has the laws over random events)."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from made_up import (
    COPTERS,
    EACH,
    HOME_AMSL_M,
    LAND,
    MISSION,
    OVER,
    TAKE_OFF_AMSL_M,
    TICK_S,
    Craft,
    arrived,
    flying,
    fresh,
    holding_mode_taken,
    holding_without_fix,
    holding_without_plan,
    home_or_on,
    landing,
    mission,
    moving,
    near_target,
    not_planned,
    planned,
    position,
    preparing,
    scan_done,
    status,
    texts,
    two_legs_away,
)
from renewed import replace

from companion.mavlink.autopilots import ARDUCOPTER
from companion.mission import changes, events
from companion.mission.decisions import reason_text
from companion.mission.events import Landed, Mode, Outcome, Plan, SetMode, Setpoint, TakeOff, Tick
from companion.mission.health import distrust
from companion.mission.state import Phase, Reason
from companion.mission.tables import parting
from companion.mission.vehicle_traits import VehicleTraits
from companion.planner.request import PlanOutcome, PlanRequest

GOOD = {"moved_at_s": 5.0, "fix_good": True, "fix_at_s": 5.0, "estimator_good": True} | {
    "estimator_at_s": 5.0,
    "doubted_at_s": 0.0,
}
"""Of a position that passes all other checks at that time."""


# --- the way it should go, literally


def test_a_mission_step_by_step() -> None:
    craft = Craft(near_target())
    take = craft.take
    assert take(Tick(time_s=1.0)) == []
    assert take(status(1.0, Mode.OTHER, armed=False)) == []
    found = events.VehicleFound(
        time_s=1.0, system_id=1, traits=ARDUCOPTER.traits, name="ArduCopter"
    )
    commands = take(found)
    assert craft.phase is Phase.PREPARING
    assert commands[0] == events.RequestStreams()
    prepared = (events.Item.PARAMETERS, events.Item.PLANS)
    assert take(*(events.Prepared(time_s=1.5, item=item) for item in prepared)) == []
    on_ground = (0.0, 0.0, HOME_AMSL_M)
    assert take(position(2.0, on_ground)) == []
    assert take(events.GpsFix(time_s=2.0, good=True), events.Estimator(time_s=2.0, good=True)) == []
    assert take(events.Home(time_s=2.0, position_nea_m=on_ground)) == []
    assert take(events.LandedState(time_s=2.0, landed=Landed.ON_GROUND)) == []
    assert craft.phase is Phase.PREPARING
    assert take(events.Prepared(time_s=2.0, item=events.Item.CHECKS)) == []
    assert craft.phase is Phase.ARMING
    assert take(position(2.2, on_ground)) == [SetMode(mode=Mode.GUIDED)]
    assert take(position(2.6, on_ground)) == []
    assert take(position(3.3, on_ground)) == [SetMode(mode=Mode.GUIDED)]
    assert take(status(3.4, Mode.GUIDED, armed=False)) == []
    assert take(position(4.4, on_ground)) == [events.Arm()]
    assert take(status(4.4, Mode.GUIDED, armed=True)) == []
    assert craft.phase is Phase.TAKING_OFF
    height_m = pytest.approx(TAKE_OFF_AMSL_M - HOME_AMSL_M)
    climb = TakeOff(above_home_m=height_m, altitude_amsl_m=TAKE_OFF_AMSL_M)
    assert take(position(4.45, on_ground)) == [climb]
    assert take(events.LandedState(time_s=4.5, landed=Landed.TAKING_OFF)) == []
    assert take(position(4.8, (0.0, 0.0, 3010.0), (0.0, 0.0, 10.0))) == []
    hover = (0.0, 0.0, TAKE_OFF_AMSL_M)
    near_hover = pytest.approx(hover, abs=1e-5)
    assert take(position(5.2, hover), events.LandedState(time_s=5.3, landed=Landed.IN_AIR)) == []
    assert take(position(5.4, hover)) == [events.SetSpeed(speed_m_s=150.0)]
    assert craft.phase is Phase.FLYING
    setpoint, scan = take(position(5.5, hover))
    assert setpoint == Setpoint(
        time_s=5.5,
        position_nea_m=near_hover,
        velocity_nea_m_s=(0.0, 0.0, 0.0),
        yaw_rad=pytest.approx(math.pi / 4),
        stay=True,
    )
    assert scan == events.StartScan(centre_nea_m=near_hover)
    [_, plan] = take(scan_done(5.6))  # after a word on how little it saw
    assert isinstance(plan, Plan)
    assert plan.due_s == 5.6 + 5.0
    assert plan.request.from_rest
    assert plan.request.target_ne_m == (5000.0, 5000.0)
    for time_s in np.arange(56, 107) / 10:
        now = float(time_s)
        good = (events.GpsFix(time_s=now, good=True), events.Estimator(time_s=now, good=True))
        assert take(status(now, Mode.GUIDED), *good) == []
        assert len(take(position(now, hover))) == 1
    [said] = take(events.PlanReady(time_s=10.6, outcome=planned(plan.request)))
    assert isinstance(said, events.StatusText)
    [first] = take(position(10.7, hover))
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


def test_the_vehicle_is_left_alone_from_the_hold_request_on() -> None:
    craft = arrived()
    craft.obeys_modes = False
    craft.run_for(5.0)
    asked = [command.at_nea_m for command in craft.sent(SetMode) if command.mode is Mode.HOLD]
    assert 4 <= len(asked) <= 6  # once a second
    assert None not in asked[:2]  # about the target
    assert set(asked[2:]) == {None}  # an autopilot may refuse to: then anywhere


# --- no plan, late plans, a silent radar


def test_without_a_plan_at_all_it_hovers_tries_four_times_and_lands_where_it_took_off() -> None:
    craft = Craft(plan=not_planned).fly_to(Phase.DONE)
    assert [plan.request.attempt for plan in craft.sent(Plan)] == [0, 1, 2, 3]
    assert craft.sent(SetMode)[-1].mode is Mode.LAND
    assert craft.end().outcome is Outcome.FAILED
    assert craft.end().reason == f"landed: {Reason.NO_PLAN.text}: it broke floor"
    assert len({setpoint.position_nea_m for setpoint in craft.sent(Setpoint)}) == 1


def only_the_first(request: PlanRequest) -> PlanOutcome:
    return planned(request) if request.plan_id == 1 else not_planned(request)


def test_without_a_successor_a_leg_is_flown_to_its_end_and_then_held_with_zero_velocity() -> None:
    craft = flying(plan=only_the_first)
    leg = craft.state.leg
    end_nea_m = leg.subpath.pose(leg.subpath.length_m).position_nea_m
    craft.fly_to(Phase.HOLDING)
    assert craft.state.reason is Reason.NO_PLAN
    held = [s for _ in range(15) for s in craft.tick() if isinstance(s, Setpoint)]
    assert len(held) == 15
    craft.run_until(lambda craft: craft.state.flight.failures == 2)  # refused from rest, too
    held += [s for s in craft.during(1.0) if isinstance(s, Setpoint)]
    for setpoint in held:
        np.testing.assert_allclose(setpoint.position_nea_m, end_nea_m, atol=1e-6)
        assert setpoint.velocity_nea_m_s == (0.0, 0.0, 0.0)
    craft.fly_to(Phase.DONE)
    assert len(craft.sent(Plan)) == 2 + 4 + 1 + 4  # the way back, then one home
    assert craft.end().outcome is Outcome.FAILED
    assert craft.sent(SetMode)[-1].mode is Mode.RETURN


def test_a_second_try_that_succeeds_flies_on() -> None:
    def second(request: PlanRequest) -> PlanOutcome:
        return not_planned(request) if request.plan_id == 2 else planned(request)

    craft = flying(two_legs_away(), plan=second).fly_to(Phase.HOLDING).fly_to(Phase.FLYING)
    assert craft.fly_to(Phase.DONE).end().outcome is Outcome.ARRIVED
    assert craft.state.flight.failures == 0


@pytest.mark.parametrize(("plan_id", "why"), [(2, Reason.PLAN_LATE), (99, Reason.NO_PLAN)])
def test_a_plan_that_never_comes_is_a_late_plan_at_the_end_of_the_leg(
    plan_id: int, why: Reason
) -> None:
    """News of an old one is ignored."""
    craft = flying(plan=lambda request: planned(request) if request.plan_id == 1 else None)
    craft.run_until(lambda craft: len(craft.sent(Plan)) == 2).run_for(6.0)
    assert craft.take(events.PlanLate(time_s=craft.now_s, plan_id=plan_id)) == []
    assert (craft.phase, craft.state.stage.shortfall) == (Phase.FLYING, why)
    assert craft.fly_to(Phase.HOLDING).state.reason is why


def test_a_silent_radar_is_a_hold_with_its_reason_at_the_end_of_what_is_known() -> None:
    craft = flying(plan=only_the_first)
    craft.answered = 0
    craft.fly_to(Phase.HOLDING)
    assert craft.state.reason is Reason.RADAR_SILENT
    assert len(craft.sent(Plan)) == 1
    assert craft.fly_to(Phase.DONE).end().reason.endswith(Reason.RADAR_SILENT.text)


def test_with_a_silent_radar_it_flies_on_from_rest_on_terrain_that_is_known_already() -> None:
    craft = flying(two_legs_away())
    craft.answered = 0
    assert craft.fly_to(Phase.DONE).end().outcome is Outcome.ARRIVED
    assert [plan.request.from_rest for plan in craft.sent(Plan)] == [True] * len(craft.sent(Plan))


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
        asked = len(craft.sent(events.StartScan))
        craft.answered = answers[min(max(asked, 1), len(answers)) - 1]
        craft.tick()
    assert len(craft.sent(events.StartScan)) == scans
    assert (answers == (0,)) == (craft.state.reason is Reason.RADAR_SILENT)


def test_in_flight_a_radar_that_left_something_out_is_asked_once() -> None:
    """And a scan of what is known already needs no answer."""
    craft = flying(two_legs_away())
    craft.answered, craft.asked = 1, 2
    begun = len(craft.sent(events.StartScan))
    craft.run_until(lambda craft: len(craft.sent(Plan)) == 2)
    assert len(craft.sent(events.StartScan)) == begun + 1
    craft = Craft().fly_to(Phase.FLYING)
    craft.take(position(craft.now_s + TICK_S, craft.here))
    known = replace(scan_done(craft.now_s, answered=0), asked=0)
    assert [type(c) for c in craft.take(known) if not isinstance(c, events.StatusText)] == [Plan]


def test_a_dead_planner_ends_the_mission_in_the_hold_mode_with_the_same_event() -> None:
    craft = flying()
    commands = craft.take(events.PlannerDied(time_s=craft.now_s, error="ValueError"))
    assert craft.phase is Phase.FAULTED
    assert commands == [
        SetMode(mode=Mode.HOLD),  # where it is, on its leg
        events.End(
            outcome=Outcome.FAILED,
            reason=f"{Reason.PLANNER_DIED.text}: ValueError",
            remedy=Reason.PLANNER_DIED.remedy,
        ),
    ]


# --- reasons of the vehicle's


def straight_on(craft: Craft, ticks: int, *, frozen: bool = False) -> list[events.Event]:
    """Positions as it goes on, or stands still and says that it moves."""
    velocity = (2.0, 2.0, 0.0) if frozen else craft.velocity
    flown = 0.0 if frozen else TICK_S
    return [
        position(
            craft.now_s + TICK_S * k,
            tuple(np.add(craft.here, flown * (k - 1) * np.array(velocity)).tolist()),
            velocity,
        )
        for k in range(1, ticks)
    ]


DOUBTS: dict[Reason, Callable[[Craft], list[events.Event]]] = {
    Reason.NO_FIX: lambda craft: [events.GpsFix(time_s=craft.now_s, good=False)],
    Reason.ESTIMATOR: lambda craft: [
        events.Estimator(time_s=craft.now_s, good=False),
        *straight_on(craft, 13),
    ],
    Reason.POSITION_STALE: lambda craft: [Tick(time_s=craft.now_s + 0.6)],
    Reason.POSITION_JUMPED: lambda craft: [
        position(craft.now_s + TICK_S, (*np.add(craft.here[:2], 100.0), craft.here[2]))
    ],
    Reason.POSITION_FROZEN: lambda craft: straight_on(craft, 13, frozen=True),
}


@pytest.mark.parametrize("reason", DOUBTS)
def test_each_reason_not_to_believe_the_position_stops_the_stream_and_asks_for_the_hold(
    reason: Reason,
) -> None:
    craft = flying()
    commands = craft.take(*DOUBTS[reason](craft))
    commands += craft.take(Tick(time_s=craft.state.now_s + 0.01))
    assert (craft.phase, craft.state.reason) == (Phase.HOLDING, reason)
    assert SetMode(mode=Mode.HOLD) in commands
    craft.tick()
    held = [commands for *_, after, commands in craft.steps if after.phase is Phase.HOLDING]
    assert not [c for commands in held for c in commands if isinstance(c, Setpoint)]


def shifted(craft: Craft, north_m: float) -> Craft:
    craft.here = (craft.here[0] + north_m, *craft.here[1:])
    return craft


def gives_in(craft: Craft) -> Craft:
    """It holds without a fix for 3 s, then gets one that is 50 m off."""
    craft.fix = False
    craft.run_for(3.0)
    craft.fix = True
    return shifted(craft, 50.0).run_for(10.0)


def test_it_holds_on_where_the_vehicle_cannot_be_says_how_far_off_and_goes_on_once_it_agrees() -> (
    None
):
    craft = gives_in(flying())
    assert craft.phase is Phase.HOLDING
    assert craft.state.reason is Reason.POSITION_ELSEWHERE
    why = f"hold: {Reason.POSITION_ELSEWHERE.text}: "
    [said] = [say.text for say in craft.sent(events.StatusText) if say.text.startswith(why)]
    off_m, allowed_m = (float(each.split(" m ")[0]) for each in said.removeprefix(why).split(", "))
    assert off_m == pytest.approx(50.0, abs=8.0)  # it stops from 150 m/s within a tick
    assert allowed_m < off_m
    assert not [c for c in craft.during(30.0) if isinstance(c, Setpoint | Plan)]
    shifted(craft, -50.0).run_for(5.0)
    assert craft.phase is Phase.FLYING


def test_how_far_off_it_is_and_what_is_allowed_are_told_so_that_they_differ() -> None:
    """Between trees a metre counts."""
    state = fresh(mission())
    limits = replace(state.task.limits, navigation_error_m=0.3, tracking_error_m=0.3)
    vehicle = replace(state.vehicle, astray_ne_m=(0.0, 1.04), position_at_s=5.0, believed_at_s=5.0)
    state = replace(state, vehicle=vehicle, task=replace(state.task, limits=limits))
    assert distrust(replace(vehicle, **GOOD), 5.0, limits) is Reason.POSITION_ELSEWHERE
    detail, _ = reason_text(state, Reason.POSITION_ELSEWHERE)
    assert detail == ": 1.0 m off, 0.6 m allowed"


@COPTERS
def test_a_vehicle_given_back_where_it_cannot_be_is_held_and_that_is_said(
    traits: VehicleTraits,
) -> None:
    craft = Craft(traits=traits).fly_to(Phase.FLYING).run_for(10.0)
    craft.mode = Mode.OTHER
    gives_in(craft)
    assert craft.state.reason is Reason.MODE_TAKEN
    craft.mode = Mode.GUIDED
    craft.run_for(5.0)
    assert craft.state.reason is Reason.POSITION_ELSEWHERE
    assert craft.mode is Mode.HOLD
    assert craft.sent(events.StatusText)[-1].text.endswith(" m allowed")
    assert shifted(craft, -50.0).run_for(10.0).phase is Phase.FLYING


def test_after_a_lost_fix_it_goes_on_from_where_it_is_when_the_position_was_good_for_2_s() -> None:
    craft = holding_without_fix(near_target())
    craft.run_for(3.0)
    craft.fix = True
    back_s = craft.now_s
    craft.fly_to(Phase.FLYING)
    assert 2.0 <= craft.now_s - back_s <= 6.0
    craft.tick()
    assert craft.sent(Setpoint)[-1].position_nea_m == craft.here
    assert craft.fly_to(Phase.DONE).end().outcome is Outcome.ARRIVED


def in_phase(phase: Phase) -> Craft:
    cases: dict[Phase, Callable[[], Craft]] = {
        Phase.PREPARING: preparing,
        Phase.ARRIVED: arrived,
        Phase.HOLDING: holding_without_plan,
        Phase.LANDING: lambda: landing().run_for(2.0),
    }
    return cases[phase]() if phase in cases else Craft(near_target()).fly_to(phase)


@pytest.mark.parametrize("taken", [Mode.OTHER, Mode.LAND, Mode.HOLD], ids=lambda m: m.value)
@pytest.mark.parametrize(
    "phase", [Phase.TAKING_OFF, Phase.FLYING, Phase.ARRIVED, Phase.HOLDING], ids=lambda p: p.value
)
def test_who_changes_the_mode_is_not_fought(phase: Phase, taken: Mode) -> None:
    craft = in_phase(phase)
    craft.tick()
    craft.mode, craft.obeys_modes, count = taken, False, len(craft.steps)
    craft.run_for(20.0)
    for before, event, _, commands in craft.steps[count:]:
        known = isinstance(event, events.VehicleStatus) or before.vehicle.mode is taken
        assert not known or moving(commands) == []
    if craft.phase not in OVER:
        assert craft.state.reason is Reason.MODE_TAKEN


@pytest.mark.parametrize("made", [flying, arrived])
def test_a_vehicle_taken_and_given_back_is_led_from_where_it_is(made: Callable[[], Craft]) -> None:
    """And not without a plan to where it was, nor to the target that it was at."""
    craft = made().is_taken(Mode.OTHER)
    craft.follows = False
    craft.run_for(2.0).fly_by_hand((-100.0, 10.0, 0.0), 60.0).run_for(5.0)
    craft.mode = Mode.GUIDED
    craft.fly_to(Phase.FLYING)
    setpoints = [c for c in craft.during(2.0) if isinstance(c, Setpoint)]
    assert setpoints
    assert max(math.dist(each.position_nea_m, craft.here) for each in setpoints) < 1e-5
    craft.follows = True
    assert craft.run_for(8.0).sent(Plan)[-1].request.from_rest


def test_a_fix_lost_on_the_ground_during_take_off_does_not_begin_the_flight_on_the_ground() -> None:
    craft = Craft().fly_to(Phase.ARMING)
    craft.take(status(craft.now_s, Mode.GUIDED, armed=True))
    assert craft.phase is Phase.TAKING_OFF
    craft.mode, craft.armed, craft.fix = Mode.GUIDED, True, False
    craft.take(events.GpsFix(time_s=craft.now_s, good=False), Tick(time_s=craft.now_s))
    craft.run_for(1.0)
    craft.fix = True
    craft.run_for(20.0)
    assert craft.landed is Landed.ON_GROUND
    assert not craft.sent(Setpoint)


@pytest.mark.parametrize("returns", [False, True])
def test_a_vehicle_that_is_on_the_ground_is_led_no_further(returns: bool) -> None:
    """Though it is armed, in guided mode and well located; one such report may be wrong."""
    craft = flying(two_legs_away(), plan=home_or_on)
    if returns:
        craft.order(events.OrderKind.RETURN).fly_to(Phase.RETURNING)
    craft.take(events.LandedState(time_s=craft.now_s, landed=Landed.ON_GROUND))
    assert craft.during(0.5)[-1] == craft.sent(Setpoint)[-1]
    disarmed = craft.copy()
    craft.landed, disarmed.armed = Landed.ON_GROUND, False
    for it, reason in ((craft, Reason.GROUNDED), (disarmed, Reason.DISARMED)):
        it.run_for(3.0)
        assert (it.end().outcome, it.end().reason) == (Outcome.FAILED, reason.text)
        assert not it.during(2.0)


def test_a_vehicle_that_somebody_takes_into_the_air_during_arming_is_not_armed() -> None:
    craft = Craft()
    craft.obeys_modes = False
    craft.fly_to(Phase.ARMING).run_for(2.0)
    craft.landed, craft.armed = Landed.IN_AIR, True
    assert moving(craft.run_for(1.0).during(5.0)) == []


def test_no_take_off_to_a_height_below_home() -> None:
    """Home above the floor of the band: an altitude of home that no mission file can know."""
    craft = Craft().fly_to(Phase.ARMING)
    craft.take(events.Home(time_s=craft.now_s, position_nea_m=(0.0, 0.0, 4000.0)))
    craft.take(status(craft.now_s, Mode.GUIDED, armed=True))
    now = craft.now_s
    craft.take(*(position(now + TICK_S * tick) for tick in range(20)))
    assert not [take_off for take_off in craft.sent(TakeOff) if take_off.above_home_m <= 0.0]


# --- stop


def by_hand(craft: Craft) -> list[events.Command]:
    """Ctrl-C."""
    return craft.take(events.StopAsked(time_s=craft.now_s))


def by_a_death(craft: Craft) -> list[events.Command]:
    """A part of the companion dies."""
    return craft.take(events.PlannerDied(time_s=craft.now_s, error="ValueError"))


def by_the_watchdog(craft: Craft) -> list[events.Command]:
    """The decider itself has died: nothing else is decided any more."""
    return parting(craft.state)


def alone(craft: Craft, commands: list[events.Command]) -> Craft:
    """The vehicle, without its companion: it does what it was told last, for five seconds."""
    craft.obey(commands)
    for _ in range(50):
        craft._move()
    return craft


def is_safe(craft: Craft) -> bool:
    """Held in the air; on the ground disarmed, and not about to take off when somebody arms it."""
    if craft.here[2] > HOME_AMSL_M:
        return craft.mode is Mode.HOLD
    return not craft.armed and craft.mode not in (Mode.TAKE_OFF, Mode.GUIDED)


@pytest.mark.parametrize("goes", [by_hand, by_a_death, by_the_watchdog])
@EACH
def test_whenever_it_goes_the_vehicle_is_left_holding_or_disarmed_on_the_ground(
    traits: VehicleTraits, goes: Callable[[Craft], list[events.Command]]
) -> None:
    """At each tick, in flight at each second; a landing goes on by itself."""
    craft = Craft(near_target(LAND), traits=traits)
    craft.fly_to(Phase.ARMING)
    phases = set()
    while craft.phase not in OVER:
        craft.tick()
        if craft.phase in OVER or (craft.phase is Phase.FLYING and craft.now_s % 1.0 > TICK_S):
            continue
        phases.add(craft.phase)
        at, left = f"{craft.phase} at {craft.now_s}", craft.copy()
        height_m, mode = left.here[2], left.mode
        path, commands = left.state.path, goes(left)
        if path is not None and not path.circling:
            places = [command.at_nea_m for command in commands if isinstance(command, SetMode)]
            assert places == [None], f"{at}: it is sent back to where it hovered"
        alone(left, commands)
        assert left.here[2] <= height_m, f"{at}: it climbs on"
        landed = mode is Mode.LAND and (goes is not by_hand or left.landed is Landed.ON_GROUND)
        assert is_safe(left) or landed, f"{at}: {left.mode}, armed {left.armed}"
    assert phases >= {Phase.ARMING, Phase.TAKING_OFF, Phase.FLYING}


@pytest.mark.parametrize("arms_late", [False, True])
@EACH
def test_a_vehicle_that_will_not_arm_is_left_out_of_its_take_off_mode(
    traits: VehicleTraits, arms_late: bool
) -> None:
    """Nor does it take off by an arming that comes through when it was given up."""
    craft = Craft(traits=traits)
    craft.arms = False
    before = craft.fly_to(Phase.ARMING).run_until(lambda craft: bool(craft.sent(events.End)), 100.0)
    assert before.end().reason == Reason.NOT_ARMED.text
    ended = before.steps[-1][3] if before.steps[-1][3] else before.commands[-3:]
    craft.armed = arms_late
    assert is_safe(alone(craft, ended))


@pytest.mark.parametrize("phase", [Phase.WAITING, Phase.PREPARING], ids=lambda each: each.value)
def test_a_vehicle_that_was_told_nothing_yet_is_told_nothing_in_the_end(phase: Phase) -> None:
    craft = in_phase(phase)
    commands = craft.take(events.StopAsked(time_s=craft.now_s))
    assert craft.end().outcome is Outcome.STOPPED
    assert not moving(commands)


@EACH
def test_a_pilot_who_takes_it_in_the_take_off_keeps_it(traits: VehicleTraits) -> None:
    craft = Craft(traits=traits).fly_to(Phase.TAKING_OFF).run_for(1.0)
    craft.take(status(craft.now_s, Mode.OTHER))
    assert not moving(by_hand(craft))


@pytest.mark.parametrize(
    "kind", [events.OrderKind.PAUSE, events.OrderKind.RETURN, events.OrderKind.LAND]
)
@EACH
def test_an_order_in_the_take_off_is_obeyed_at_once(
    traits: VehicleTraits, kind: events.OrderKind
) -> None:
    """At each tick until it flies: it holds before anything else; on the ground it stays there."""
    lands = traits.lands
    started = Craft(traits=traits).fly_to(Phase.ARMING)
    while started.phase is not Phase.FLYING:
        started.run_for(2 * TICK_S)
        craft, height_m = started.copy(), started.here[2]
        on_ground = height_m <= HOME_AMSL_M
        if kind is events.OrderKind.LAND and not lands and not on_ground:
            continue
        order = events.Order(time_s=craft.now_s, kind=kind)
        assert changes.order_result(craft.state, order) is changes.OrderResult.ACCEPTED
        craft.obey(craft.take(order))
        paused, at = (
            kind is events.OrderKind.PAUSE and not on_ground,
            f"{started.phase}, {started.now_s}",
        )
        deadline_s = craft.now_s + 60.0
        while not craft.over and craft.now_s < deadline_s:
            craft.tick()
            assert craft.here[2] <= height_m + 1.0, f"{at}: it climbs on"
        assert not [c for c in craft.sent(Setpoint) if not c.stay], at
        if paused:
            assert craft.state.reason is Reason.PAUSED, at
            continue
        assert craft.end().outcome is Outcome.STOPPED, at
        hands_over = kind is events.OrderKind.RETURN and not (traits.hovers or on_ground)
        assert not craft.armed or (hands_over and craft.mode is Mode.RETURN), at


@COPTERS
@pytest.mark.parametrize(
    ("accepts", "asked"), [(True, {4.8: 1, 1.0: 2}), (False, {3.5: 4})], ids=["accepted", "refused"]
)
def test_a_take_off_is_asked_for_once_a_second_and_after_it_was_accepted_if_it_does_not_begin(
    traits: VehicleTraits, accepts: bool, asked: dict[float, int]
) -> None:
    craft = Craft(traits=traits)
    craft.takes_off, craft.accepts = False, accepts
    craft.run_until(lambda craft: bool(craft.sent(TakeOff)))
    for seconds, times in asked.items():
        assert len(craft.run_for(seconds).sent(TakeOff)) == times


# --- words


@EACH
def test_an_ordinary_take_off_is_called_nothing_else(traits: VehicleTraits) -> None:
    craft = Craft(traits=traits).fly_to(Phase.FLYING)
    said = texts(craft.commands)
    assert not [text for text in said if "hold" in text or "taking over" in text]
    by_itself = traits is not ARDUCOPTER.traits
    assert ("taken off" in said) == by_itself


@pytest.mark.parametrize("seen_first", [False, True])
def test_a_failsafe_that_landed_it_is_named_with_what_was_seen_before(seen_first: bool) -> None:
    """Whether the autopilot acts before or after the companion has stopped it for that."""
    craft = flying()
    craft.take(events.Estimator(time_s=craft.now_s, good=False))
    craft.estimator = False
    if seen_first:
        craft.fly_to(Phase.HOLDING)
        assert craft.state.reason is Reason.ESTIMATOR
    craft.is_taken(Mode.LAND, failsafe=True)
    craft.run_until(lambda craft: craft.over)
    end = craft.end()
    assert end.reason == (
        f"{Reason.DISARMED.text}: {Reason.FAILSAFE.text}: {Reason.ESTIMATOR.text}"
    )
    assert end.remedy == Reason.ESTIMATOR.remedy


# --- nothing waits for ever


WAITS: dict[str, Callable[[], Craft]] = {
    "preparing": preparing,
    "arming": lambda: Craft().fly_to(Phase.ARMING),
    "taking off": lambda: Craft().fly_to(Phase.TAKING_OFF),
    "flying": flying,
    "holding without a plan": holding_without_plan,
    "holding without a fix": holding_without_fix,
    "arrived": arrived,
    "landing": landing,
    "waiting": Craft,
    "holding for a person": holding_mode_taken,
}
ENDLESS = ("waiting", "holding for a person")
"""As long as the link is there: they wait for somebody."""


@pytest.mark.parametrize("every_s", [0.1, 1.0, math.inf], ids=["10 Hz", "1 Hz", "link lost"])
@pytest.mark.parametrize("wait", WAITS)
def test_every_wait_ends_with_a_reason_when_only_the_clock_goes_on_or_the_link_is_lost(
    wait: str, every_s: float
) -> None:
    craft = WAITS[wait]()
    if every_s < math.inf:
        ticks = range(1, round(700.0 / every_s) + 1)
        craft.take(*(Tick(time_s=craft.state.now_s + tick * every_s) for tick in ticks))
    else:
        lost = (3.0, 30.0, 600.0)
        craft.take(*(events.LinkLost(time_s=craft.now_s, silent_s=silent_s) for silent_s in lost))
    if wait not in ENDLESS or every_s == math.inf:
        assert craft.over, f"still {craft.phase.value} after twelve minutes"
        assert craft.end().outcome is Outcome.FAILED


@pytest.mark.parametrize("silent_s", [3.0, 30.0])
def test_a_link_that_comes_back_in_the_air_prepares_again_and_goes_on(silent_s: float) -> None:
    craft = flying(near_target())
    craft.take(events.LinkLost(time_s=craft.now_s, silent_s=silent_s))
    assert (craft.phase, craft.state.reason) == (Phase.HOLDING, Reason.LINK_LOST)
    craft.fly_to(Phase.PREPARING)
    assert craft.fly_to(Phase.DONE).end().outcome is Outcome.ARRIVED


def test_a_link_that_comes_back_while_it_holds_without_a_fix_does_not_leave_it_there() -> None:
    craft = holding_without_fix().run_for(2.0)
    assert craft.mode is Mode.HOLD
    craft.take(events.LinkLost(time_s=craft.now_s, silent_s=3.0))
    craft.fix = True
    assert within_ten_minutes(craft, lambda craft: craft.phase is not Phase.HOLDING)


def within_ten_minutes(craft: Craft, done: Callable[[Craft], bool]) -> bool:
    start_s = craft.now_s
    while not done(craft) and craft.now_s < start_s + 600.0:
        craft.here = (craft.here[0] + 0.001 * (-1) ** round(craft.now_s / TICK_S), *craft.here[1:])
        craft.tick()
    return done(craft)


STANDS: dict[str, Any] = {"follows": False, "velocity": (0.0, 0.0, 0.0)}
DRIFTS: dict[str, Any] = {"follows": False, "velocity": (0.6, 0.0, 0.0)}


@pytest.mark.parametrize(
    ("make", "changes", "reason"),
    [
        (preparing, {}, f"{Reason.NOT_READY.text}: {Reason.NO_FIX.text}"),
        (Craft, {"takes_off": False}, Reason.NO_TAKE_OFF.text),
        (lambda: shifted(arrived(), 9.0), STANDS, "target reached"),  # within its tracking error
        (arrived, {"obeys_modes": False}, ""),  # it does not take the hold mode
        (landing, {"obeys_modes": False}, ""),  # it never says that it has landed
    ],
)
def test_what_never_comes_is_given_up(
    make: Callable[[], Craft], changes: dict[str, Any], reason: str
) -> None:
    craft = make()
    for name, value in changes.items():
        setattr(craft, name, value)
    assert within_ten_minutes(craft, lambda craft: craft.over)
    assert reason in ("", craft.end().reason)


def asking() -> Craft:
    """In a hover, of a planner that never answers."""
    return Craft(plan=lambda _: None).run_until(lambda craft: bool(craft.sent(Plan)))


@pytest.mark.parametrize(
    ("make", "changes"),
    [(asking, {}), (flying, STANDS), (holding_without_plan, DRIFTS), (arrived, DRIFTS)],
)
def test_no_phase_waits_for_ever_for_an_answer_or_for_a_vehicle_that_does_not_follow_or_rest(
    make: Callable[[], Craft], changes: dict[str, Any]
) -> None:
    craft = make()
    for name, value in changes.items():
        setattr(craft, name, value)
    phase = craft.phase
    assert within_ten_minutes(craft, lambda craft: craft.phase is not phase)
