"""Every kind of autopilot and vehicle: take-off, take-over in the air, the flight, its end."""

import json
import math
from itertools import pairwise

import pytest
from made_up import AWAY, EACH, PLANES, flying, position, tell
from made_up_plans import not_planned
from renewed import replace
from wild import HOME_AMSL_M, Wild

from companion.mavlink.autopilots import PX4_FIXED_WING
from companion.mission import checkpoint, events, stopped
from companion.mission.changes import OrderResult
from companion.mission.decisions import Context
from companion.mission.events import (
    Arm,
    Landed,
    Mode,
    OrderKind,
    Outcome,
    SetMode,
    Setpoint,
    TakeOff,
)
from companion.mission.following import outside_m
from companion.mission.mission import EndAction
from companion.mission.phases import Phase, Reason
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits
from companion.planner.request import Planned, PlanRequest
from companion.world.zones import CircleZone

FIRST = {
    TakeoffSequence.GUIDED_THEN_CLIMB: [SetMode, Arm, TakeOff],
    TakeoffSequence.MODE_THEN_ARM: [SetMode, Arm],
    TakeoffSequence.CLIMB_THEN_ARM: [TakeOff, Arm],
}


def outcome_of(wild: Wild) -> Outcome:
    [end] = wild.fly_to(Phase.DONE).sent(events.End)
    assert isinstance(end, events.End)
    return end.outcome


@EACH
def test_it_is_sent_up_in_the_order_that_its_autopilot_wants(traits: VehicleTraits) -> None:
    wild = Wild.calmly(traits).run_until(lambda wild: wild.landed is not Landed.ON_GROUND)
    told = [type(c) for c in wild.said_to if isinstance(c, SetMode | Arm | TakeOff | Setpoint)]
    assert list(dict.fromkeys(told)) == FIRST[traits.take_off]
    guided = traits.take_off is TakeoffSequence.GUIDED_THEN_CLIMB
    modes = {command.mode for command in wild.sent(SetMode)}
    assert modes <= {Mode.GUIDED if guided else Mode.TAKE_OFF}


@pytest.mark.sample(3)  # of each autopilot
@EACH
@pytest.mark.parametrize("end", list(EndAction), ids=lambda end: end.value)
def test_a_mission_arrives_and_ends_as_it_should(traits: VehicleTraits, end: EndAction) -> None:
    wild = Wild.calmly(traits, end_action=end)
    outcome, limits = outcome_of(wild), wild.mission.task.limits
    target, home = wild.mission.targets_ne_m[0], wild.state.flight.flown[0].control_nea_m[0, :2]
    there, within_m = target if end is EndAction.LAND else home, math.inf
    if wild.landed is Landed.ON_GROUND and not traits.hovers:
        within_m = 1.5 * limits.loiter_radius_m
    assert (outcome is Outcome.ARRIVED) is (math.dist(wild.here[:2], there) <= within_m)
    near_m = 5.0 if traits.hovers else 3.0 * limits.loiter_radius_m
    stops = [c.position_nea_m for c in wild.sent(Setpoint) if c.stay]
    assert min(math.dist(stop[:2], target) for stop in stops) < 1.0
    if end is EndAction.HOLD:
        assert math.dist(wild.here[:2], target) < near_m
        assert wild.mode is (Mode.GUIDED if traits.holds_in_guided else Mode.HOLD)
    if end is EndAction.LAND and traits.lands:
        assert math.dist(wild.here[:2], target) < 2.0 * near_m
        assert (wild.landed, wild.armed) == (Landed.ON_GROUND, False)
    if end is EndAction.RETURN:
        assert math.hypot(*wild.here[:2]) < 1.5 * near_m + 10.0
        assert Phase.RETURNING in wild.watch.phases


@pytest.mark.sample(3)
@EACH
@pytest.mark.parametrize("mode", [Mode.GUIDED, Mode.HOLD, Mode.OTHER], ids=lambda mode: mode.value)
def test_a_vehicle_that_flies_already_is_taken_over_once_somebody_selects_guided(
    traits: VehicleTraits, mode: Mode
) -> None:
    """And nobody has to say go; while another flies it, it is left alone."""
    wild = Wild.calmly(traits).aloft(mode)
    wild.watch.context = wild.context = Context(mission=wild.mission, seed=1)
    if mode is Mode.OTHER:
        wild.run_for(30.0)
        assert (wild.state.phase, wild.state.reason) == (Phase.HOLDING, Reason.MODE_TAKEN)
        assert not wild.sent(SetMode) + wild.sent(Setpoint)
        wild.mode = Mode.GUIDED
    assert outcome_of(wild) is Outcome.ARRIVED
    assert not wild.sent(Arm) + wild.sent(TakeOff)


@EACH
def test_a_vehicle_below_the_band_climbs_before_anything_is_planned(traits: VehicleTraits) -> None:
    """A copter is led up at the mission's rate."""
    wild = Wild.calmly(traits).aloft(Mode.GUIDED, height_m=5.0)
    wild.fly_to(Phase.FLYING).run_until(lambda wild: wild.state.flight.plan_id > 0)
    limits, lowest_m = wild.mission.task.limits, wild.mission.task.band_amsl_m[0]
    assert wild.here[2] >= lowest_m - limits.tracking_error_m
    assert wild.state.flight.hover_nea_m[2] >= lowest_m
    heights = [HOME_AMSL_M + 5.0, *(c.position_nea_m[2] for c in wild.sent(Setpoint))]
    if traits.hovers:
        assert max(b - a for a, b in pairwise(heights)) <= limits.climb_rate_m_s * 1.0 + 1e-6


def led(traits: VehicleTraits) -> Wild:
    """Some way along its first leg."""
    return Wild.calmly(traits).run_until(lambda it: it.state.reference.length_m > 60.0)


@EACH
def test_setpoints_keep_the_period_of_the_autopilot(traits: VehicleTraits) -> None:
    wild = led(traits)
    gaps = [b.time_s - a.time_s for a, b in pairwise(wild.sent(Setpoint)[-20:])]
    assert min(gaps) >= max(traits.setpoint_period_s - 0.5 * wild.tick_s, wild.tick_s) - 1e-6
    assert max(gaps) <= traits.setpoint_period_s + wild.tick_s + 1e-6


# --- restarts


@pytest.mark.sample(5)
@EACH
@pytest.mark.parametrize("after_s", [0.3, 3.1, 8.7, 14.9, 21.3, 27.7])
def test_a_restart_at_any_moment_of_a_flight_goes_on_without_a_jump(
    traits: VehicleTraits, after_s: float
) -> None:
    """Where the vehicle is led: 1 m and 1 m/s from where it was led, or from where it is."""
    wild = Wild.calmly(traits).run_until(lambda wild: wild.state.leg is not None)
    wild.run_for(after_s)
    last = wild.sent(Setpoint)[-1]
    wild._restart()
    count = len(wild.sent(Setpoint))
    wild.run_until(lambda wild: len(wild.sent(Setpoint)) > count)
    first = wild.sent(Setpoint)[count]
    passed_s = first.time_s - last.time_s
    assert passed_s < 6.0
    if traits.hovers:
        moved_m = math.dist(first.position_nea_m, last.position_nea_m)
        assert moved_m <= 1.0 + passed_s * math.hypot(*last.velocity_nea_m_s)
        was = (wild.velocity, last.velocity_nea_m_s)  # it has stopped at the last setpoint, or not
        apart = min(math.dist(first.velocity_nea_m_s, velocity) for velocity in was)
        assert first.stay or apart <= 1.0 + 2.5 * wild.tick_s
    assert outcome_of(wild) is Outcome.ARRIVED


def test_what_is_restored_is_what_was_kept() -> None:
    """Under a fence, too."""
    craft = flying(AWAY)
    zone = CircleZone(name="drawn", north_m=4_000.0, east_m=-4_000.0, radius_m=500.0)
    craft.take(events.FenceChanged(time_s=craft.now_s, zones=(zone,)))
    craft.run_until(lambda craft: craft.state.flight.legs_flown == 2)
    values = json.loads(json.dumps(checkpoint.values_of(craft.state)))
    state = checkpoint.restored(craft.context.mission, craft.state.flight.known, values)
    again = checkpoint.values_of(state)
    assert again == {**checkpoint.values_of(craft.state), "phase": Phase.WAITING.name}
    assert state.task == craft.state.task
    assert state.airborne


# --- planes


@pytest.mark.parametrize("is_escape", [False, True])
@PLANES
def test_a_plane_leaves_its_circle_when_it_flies_the_way_of_its_path(
    traits: VehicleTraits, is_escape: bool
) -> None:
    """A straight way out, too: begun at once, it came round on the far side of what is proven."""
    wild = Wild.calmly(traits)
    searched = wild.towards

    def towards(request: PlanRequest) -> Planned:
        planned = searched(request)
        return replace(planned, terms={}) if is_escape else planned

    wild.towards = towards
    wild.run_until(lambda wild: wild.state.leg is not None)
    assert wild.state.path.circling
    assert all(setpoint.stay for setpoint in wild.sent(Setpoint))
    wild.run_until(lambda wild: not wild.state.path.circling)
    tangent = wild.state.leg.subpath.pose(0.0).tangent_nea
    along = sum(a * b for a, b in zip(wild.velocity[:2], tangent, strict=False))
    assert along > 0.85 * math.hypot(*wild.velocity[:2])


@PLANES
def test_a_plane_that_holds_at_the_end_of_a_leg_returns_from_the_circle_that_it_flies(
    traits: VehicleTraits,
) -> None:
    """It begins to circle the end from before it; what it flies back along begins at the end."""
    wild = led(traits)
    wild.answer = lambda r: wild.way_back(r) if r.flown is not None else not_planned(r)
    circled = wild.fly_to(Phase.HOLDING).state.flight.hover_nea_m
    assert tell(wild, OrderKind.RETURN) is OrderResult.ACCEPTED
    wild.run_until(lambda wild: wild.state.path is not None)
    assert wild.state.leg.subpath.pose(0.0).position_nea_m == pytest.approx(circled, abs=0.5)


@PLANES
@pytest.mark.parametrize("safety_m", [5.0, 50.0])
def test_a_plane_is_sent_past_its_target_no_farther_than_leaves_it_clear(
    traits: VehicleTraits, safety_m: float
) -> None:
    """Wherever it is sent last it circles: by so much nearer to terrain than about its path."""
    task = Wild.calmly(traits).mission.task
    settings = replace(task.settings, safety_distance_m=safety_m)
    wild = Wild.calmly(traits, task=replace(task, settings=settings))
    wild.run_until(lambda wild: wild.state.leg is not None and wild.state.leg.reaches_target)
    end = wild.state.leg.subpath.pose(wild.state.leg.subpath.length_m)
    wild.fly_to(Phase.ARRIVED)
    past = [each.position_nea_m - end.position_nea_m for each in wild.sent(Setpoint)[:-1]]
    past_m = max(float(each @ end.tangent_nea) for each in past)
    assert 0.0 < past_m <= min(safety_m, 0.25 * task.limits.loiter_radius_m) + 1e-6


@PLANES
def test_a_plane_that_is_told_to_return_circles_one_place_until_it_leaves_for_home(
    traits: VehicleTraits,
) -> None:
    """What it is to circle must not move: it would swing wide of both circles."""
    wild = led(traits)
    assert tell(wild, OrderKind.RETURN) is OrderResult.ACCEPTED
    before = len(wild.sent(Setpoint))
    wild.fly_to(Phase.RETURNING).run_until(lambda wild: not wild.state.path.circling)
    held = [each for each in wild.sent(Setpoint)[before:] if each.stay]
    assert len(held) > 10
    for each in held:
        assert each.position_nea_m == pytest.approx(held[0].position_nea_m, abs=0.5)


@PLANES
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_plane_that_sinks_or_rises_out_of_its_tube_has_left_it(
    traits: VehicleTraits, sign: float
) -> None:
    """What is proven is the level circle about each point of the path, and not a ball."""
    wild = led(traits)
    state, task = wild.state, wild.mission.task
    north, east, up = state.leg.subpath.pose(state.reference.length_m).point_nea_m
    aside_m, tube_m = 0.9 * task.limits.loiter_radius_m, task.envelope.tube_m
    for share, out_m in ((0.98, 0.0), (1.02, 0.02 * tube_m)):
        here = (north + aside_m, east, up + sign * share * tube_m)
        event = position(wild.now_s, here, (9.0, 0.0, 0.0))
        assert outside_m(state, state.path, event)[0] == pytest.approx(out_m, abs=1e-6)


def test_a_plane_that_lands_too_far_from_where_it_was_to_land_has_not_arrived() -> None:
    wild = Wild.calmly(PX4_FIXED_WING.traits, end_action=EndAction.LAND).fly_to(Phase.LANDING)
    off_m = 2.0 * stopped.lands_within_m(wild.state) + 50.0
    wild.state = replace(wild.state, targets_ne_m=((wild.here[0], wild.here[1] + off_m),))
    assert outcome_of(wild) is Outcome.FAILED


@PLANES
@pytest.mark.parametrize("beyond", [0.9, 1.1])
def test_no_leg_is_planned_from_a_circle_that_the_plane_is_not_on(
    traits: VehicleTraits, beyond: float
) -> None:
    """Dense about the limit, a tracking error outside of the circle that it was just told."""
    plane = Wild.calmly(traits).aloft(Mode.GUIDED).fly_to(Phase.FLYING)
    plane.run_until(lambda plane: plane.state.flight.hover_nea_m is not None)
    limits, (north, east, up) = plane.mission.task.limits, plane.here
    away_m = limits.loiter_radius_m + beyond * limits.tracking_error_m
    flight = replace(plane.state.flight, hover_nea_m=(north + away_m, east, up))
    plane.state = replace(plane.state, flight=flight, search=None)
    speed, scans = (limits.speed_m_s, 0.0, 0.0), len(plane.sent(events.StartScan))
    for later_s in (0.1, 0.2):
        plane.take(position(plane.now_s + later_s, plane.here, speed))
    assert (len(plane.sent(events.StartScan)) > scans) is (beyond < 1.0)
