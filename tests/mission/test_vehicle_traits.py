"""Every kind of autopilot and vehicle: take-off, take-over in the air, the flight, its end."""

import math
from itertools import pairwise

import pytest
from made_up import EACH, PLANES, preparing
from renewed import replace
from wild import HOME_AMSL_M, Wild

from companion.mavlink.autopilots import PX4_FIXED_WING
from companion.mission import events, machine, stopped
from companion.mission.decisions import Context, Turn
from companion.mission.events import Arm, End, Landed, Mode, Outcome, SetMode, Setpoint, TakeOff
from companion.mission.following import outside_m
from companion.mission.mission import EndAction, Fallback
from companion.mission.state import Phase, Reason
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits
from companion.world.zones import CircleZone

FIRST = {
    TakeoffSequence.GUIDED_THEN_CLIMB: [SetMode, Arm, TakeOff],
    TakeoffSequence.MODE_THEN_ARM: [SetMode, Arm],
    TakeoffSequence.CLIMB_THEN_ARM: [TakeOff, Arm],
}


def up(wild: Wild) -> bool:
    return wild.landed is not Landed.ON_GROUND


def the_end(wild: Wild) -> End:
    [end] = wild.sent(End)
    assert isinstance(end, End)
    return end


@EACH
def test_it_is_sent_up_in_the_order_that_its_autopilot_wants(traits: VehicleTraits) -> None:
    wild = Wild.calmly(traits).run_until(up)
    told = [type(c) for c in wild.said_to if isinstance(c, SetMode | Arm | TakeOff | Setpoint)]
    assert list(dict.fromkeys(told)) == FIRST[traits.take_off]
    modes = (
        {Mode.GUIDED} if traits.take_off is TakeoffSequence.GUIDED_THEN_CLIMB else {Mode.TAKE_OFF}
    )
    assert {command.mode for command in wild.sent(SetMode)} <= modes


@pytest.mark.sample(3)  # of each autopilot
@EACH
@pytest.mark.parametrize("end", list(EndAction), ids=lambda end: end.value)
def test_a_mission_arrives_and_ends_as_it_should(traits: VehicleTraits, end: EndAction) -> None:
    wild = Wild.calmly(traits, end_action=end).fly_to(Phase.DONE)
    target, home = wild.mission.targets_ne_m[0], wild.state.flight.flown[0].control_nea_m[0, :2]
    there, within_m = target if end is EndAction.LAND else home, math.inf
    if wild.landed is Landed.ON_GROUND and not traits.hovers:
        within_m = 1.5 * wild.mission.task.limits.loiter_radius_m
    is_near = math.dist(wild.here[:2], there) <= within_m
    assert (the_end(wild).outcome is Outcome.ARRIVED) is is_near
    near_m = 5.0 if traits.hovers else 3.0 * wild.mission.task.limits.loiter_radius_m
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
@pytest.mark.parametrize("mode", [Mode.GUIDED, Mode.HOLD], ids=lambda mode: mode.value)
def test_a_vehicle_that_flies_already_is_taken_over(traits: VehicleTraits, mode: Mode) -> None:
    wild = Wild.calmly(traits).aloft(mode)
    wild.watch.context = wild.context = Context(mission=wild.mission, seed=1)  # nobody says go
    wild.fly_to(Phase.DONE)
    assert the_end(wild).outcome is Outcome.ARRIVED
    assert not wild.sent(Arm)
    assert not wild.sent(TakeOff)


@EACH
def test_a_vehicle_that_somebody_else_flies_is_left_alone_until_guided_is_selected(
    traits: VehicleTraits,
) -> None:
    wild = Wild.calmly(traits).aloft(Mode.OTHER).run_for(30.0)
    assert (wild.state.phase, wild.state.reason) == (Phase.HOLDING, Reason.MODE_TAKEN)
    assert not wild.sent(SetMode)
    assert not wild.sent(Setpoint)
    wild.mode = Mode.GUIDED
    assert the_end(wild.fly_to(Phase.DONE)).outcome is Outcome.ARRIVED


@EACH
def test_a_vehicle_below_the_band_climbs_before_anything_is_planned(traits: VehicleTraits) -> None:
    wild = Wild.calmly(traits).aloft(Mode.GUIDED, height_m=5.0)
    wild.fly_to(Phase.FLYING).run_until(lambda wild: wild.state.flight.plan_id > 0)
    lowest_m = wild.mission.task.band_amsl_m[0]
    assert wild.here[2] >= lowest_m - wild.mission.task.limits.tracking_error_m
    assert wild.state.flight.hover_nea_m[2] >= lowest_m
    heights = [c.position_nea_m[2] for c in wild.sent(Setpoint)]
    if traits.hovers:  # the climb is led at the mission's rate
        steps = [b - a for a, b in pairwise(heights)]
        assert max(steps) <= wild.mission.task.limits.climb_rate_m_s * 1.0 + 1e-6
        assert heights[0] < HOME_AMSL_M + 5.0 + wild.mission.task.limits.climb_rate_m_s + 1e-6


@PLANES
def test_a_plane_leaves_its_circle_when_it_flies_the_way_of_its_path(traits: VehicleTraits) -> None:
    wild = Wild.calmly(traits).fly_to(Phase.FLYING)
    wild.run_until(lambda wild: wild.state.leg is not None)
    assert wild.state.path.circling
    stays = len([c for c in wild.sent(Setpoint) if not c.stay])
    assert stays == 0
    wild.run_until(lambda wild: not wild.state.path.circling)
    leg = wild.state.leg
    tangent = leg.subpath.pose(0.0).tangent_nea
    velocity = wild.velocity
    along = velocity[0] * tangent[0] + velocity[1] * tangent[1]
    assert along > 0.85 * math.hypot(*velocity[:2])


@PLANES
def test_a_plane_that_has_circled_for_long_is_not_taken_for_stuck_as_it_sets_out(
    traits: VehicleTraits,
) -> None:
    """It may have had to fly to its circle first: the wait for its way there counts from there."""
    wild = Wild.calmly(traits).fly_to(Phase.FLYING)
    wild.run_until(lambda wild: wild.state.path and wild.state.path.circling)
    leg = wild.state.leg
    start = leg.subpath.pose(0.0)
    circled = replace(wild.state, progress_at_s=wild.now_s - 40.0)
    north, east, up = (float(x) for x in start.position_nea_m - 30.0 * start.tangent_nea)
    velocity = (20.0 * float(start.tangent_nea[0]), 20.0 * float(start.tangent_nea[1]), 0.0)
    vehicle = replace(
        wild.state.vehicle,
        position_nea_m=(north - 0.1 * velocity[0], east - 0.1 * velocity[1], up),
        velocity_nea_m_s=velocity,
        position_at_s=wild.now_s,
    )
    event = events.Position(
        time_s=wild.now_s + 0.1, position_nea_m=(north, east, up), velocity_nea_m_s=velocity
    )
    before = replace(circled, vehicle=vehicle)
    state, _ = machine.step(before, event, wild.context)
    assert not state.path.circling
    assert state.reference.length_m == 0.0  # abeam of the start, or before it
    assert state.phase is Phase.FLYING


@PLANES
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_plane_that_sinks_or_rises_out_of_its_tube_has_left_it(
    traits: VehicleTraits, sign: float
) -> None:
    """What is proven is the level circle about each point of the path, and not a ball."""
    wild = Wild.calmly(traits)
    wild.run_until(lambda wild: wild.state.reference.length_m > 60.0)
    state, tube_m = wild.state, wild.mission.task.envelope.tube_m
    pose = state.leg.subpath.pose(state.reference.length_m)
    north, east, up = pose.point_nea_m
    aside_m = 0.9 * wild.mission.task.limits.loiter_radius_m
    for share, out_m in ((0.98, 0.0), (1.02, 0.02 * tube_m)):
        here = (north + aside_m, east, up + sign * share * tube_m)
        event = events.Position(
            time_s=wild.now_s, position_nea_m=here, velocity_nea_m_s=(9.0, 0.0, 0.0)
        )
        assert outside_m(state, state.path, event)[0] == pytest.approx(out_m, abs=1e-6)


@PLANES
def test_a_plane_that_stops_circles_a_point_ahead_on_its_path(traits: VehicleTraits) -> None:
    wild = Wild.calmly(traits)
    wild.run_until(lambda wild: wild.state.reference.length_m > 60.0)
    wild.bad_plans = 1.0
    wild.fly_to(Phase.HOLDING)
    assert wild.state.reason in (Reason.NO_PLAN, Reason.PLAN_LATE)
    assert wild.state.flight.hover_nea_m is not None
    assert all(c.stay for c in wild.run_for(1.5).sent(Setpoint)[-3:])


@EACH
def test_setpoints_keep_the_period_of_the_autopilot(traits: VehicleTraits) -> None:
    wild = Wild.calmly(traits).run_until(lambda wild: wild.state.reference.length_m > 60.0)
    times = [c.time_s for c in wild.sent(Setpoint)][-20:]
    gaps = [b - a for a, b in pairwise(times)]
    assert min(gaps) >= max(traits.setpoint_period_s - 0.5 * wild.tick_s, wild.tick_s) - 1e-6
    assert max(gaps) <= traits.setpoint_period_s + wild.tick_s + 1e-6


@pytest.mark.sample(3)  # of each autopilot
@EACH
@pytest.mark.parametrize("how", list(Fallback), ids=lambda how: how.value)
def test_without_a_way_on_the_mission_falls_back(traits: VehicleTraits, how: Fallback) -> None:
    wild = Wild.calmly(traits, fallback=how, targets_ne_m=((900.0, 300.0),))
    wild.run_until(lambda wild: wild.state.reference.length_m > 60.0)
    wild.bad_plans = 1.0
    wild.fly_to(Phase.DONE)
    end = the_end(wild)
    assert end.outcome is Outcome.FAILED
    assert Reason.NO_PLAN.text in end.reason
    if how is Fallback.LAND and traits.lands:
        assert end.reason.startswith("landed: ")
    if how is Fallback.RETURN:
        assert Phase.RETURNING in wild.watch.phases
        assert math.hypot(*wild.here[:2]) < 20.0 + 3.0 * wild.mission.task.limits.loiter_radius_m


def test_what_the_vehicle_is_refused_for_is_said_with_its_remedy() -> None:
    craft = preparing()
    item = events.Prepared(
        time_s=craft.now_s, item=events.Item.PARAMETERS, refusal="GUID_TIMEOUT = 60", remedy="Set."
    )
    craft.take(item)
    end = craft.end()
    assert end.reason == f"{Reason.REFUSED.text}: GUID_TIMEOUT = 60"
    assert end.remedy == "Set."


def test_a_plane_that_lands_too_far_from_its_target_has_not_arrived() -> None:
    wild = Wild.calmly(PX4_FIXED_WING.traits, end_action=EndAction.LAND).fly_to(Phase.LANDING)
    within_m = stopped.lands_within_m(wild.state)
    far = wild.here[0], wild.here[1] + 2.0 * within_m + 50.0
    wild.state = replace(wild.state, targets_ne_m=(far,))
    end = the_end(wild.fly_to(Phase.DONE))
    off_m = math.dist(wild.here[:2], far)
    assert off_m > within_m
    assert end.outcome is Outcome.FAILED
    assert end.reason == f"landed {off_m:.0f} m from where it was to land"


def test_a_plane_that_passes_its_target_too_far_away_says_so() -> None:
    wild = Wild.calmly(PX4_FIXED_WING.traits).fly_to(Phase.ARRIVED)
    state, here = wild.state, wild.state.vehicle.position_nea_m
    for off_m in (0.9, 1.1):
        off_m *= state.task.limits.tracking_error_m
        place = (here[0] + off_m, here[1], here[2])
        state.flight.hover_nea_m = place
        turn = Turn(state, wild.context)
        stopped.say_reached(state, turn)
        (said,) = turn.commands
        far = off_m > state.task.limits.tracking_error_m
        assert said.text == "target reached" + (f": passed {off_m:.0f} m away" if far else "")
        assert said.warning is far


# --- a plane without a leg: where it begins one, and a fence that is drawn about it


def circling(traits: VehicleTraits) -> Wild:
    """A plane in guided mode that has just been told where to wait for its first leg."""
    plane = Wild.calmly(traits).aloft(Mode.GUIDED).fly_to(Phase.FLYING)
    return plane.run_until(lambda plane: plane.state.flight.hover_nea_m is not None)


@PLANES
@pytest.mark.parametrize("beyond", [0.9, 1.1])
def test_no_leg_is_planned_from_a_circle_that_the_plane_is_not_on(
    traits: VehicleTraits, beyond: float
) -> None:
    """Dense about the limit: a tracking error outside of the circle."""
    plane = circling(traits)
    limits, (north, east, up) = plane.mission.task.limits, plane.here
    away_m = limits.loiter_radius_m + beyond * limits.tracking_error_m
    flight = replace(plane.state.flight, hover_nea_m=(north + away_m, east, up))
    plane.state = replace(plane.state, flight=flight, search=None)
    speed, scans = (limits.speed_m_s, 0.0, 0.0), len(plane.sent(events.StartScan))
    for later_s in (0.1, 0.2):
        at_s = plane.now_s + later_s
        plane.take(events.Position(time_s=at_s, position_nea_m=plane.here, velocity_nea_m_s=speed))
    assert (len(plane.sent(events.StartScan)) > scans) is (beyond < 1.0)


@PLANES
@pytest.mark.parametrize("gap_m", [-0.6, 0.6])
def test_a_fence_too_near_to_its_circle_is_said_once_and_it_stays(
    traits: VehicleTraits, gap_m: float
) -> None:
    """Dense about the limit: the required clearance of the circle, less half a metre."""
    plane = circling(traits)
    task, hover = plane.mission.task, plane.state.flight.hover_nea_m
    away_m = task.limits.loiter_radius_m + task.required_clearance_m - 0.5 + gap_m
    zone = CircleZone(name="new", north_m=hover[0] + away_m + 70.0, east_m=hover[1], radius_m=70.0)
    plane.take(events.FenceChanged(time_s=plane.now_s, zones=(zone,)))
    count = len(plane.said_to)
    plane.run_for(0.9)  # and no plan is there yet
    later = plane.said_to[count:]
    said = [c.text for c in later if isinstance(c, events.StatusText) and c.warning]
    assert said == (["circling too near to zone new"] if gap_m < 0.0 else [])
    setpoints = [c for c in later if isinstance(c, events.Setpoint)]
    assert setpoints
    assert all(each.stay and each.position_nea_m == hover for each in setpoints)
