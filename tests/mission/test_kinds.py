"""Every kind of autopilot and vehicle: take-off, take-over in the air, the flight, its end."""

import math
from itertools import pairwise

import numpy as np
import pytest
from made_up import EACH, PLANES, Craft, calm, led, moving, now, tell, told
from made_up_plans import not_planned
from renewed import replace

from companion.mavlink.autopilots import PX4_FIXED_WING
from companion.mission import events, stopped
from companion.mission.decisions import Context
from companion.mission.events import Landed, Mode, OrderKind, Outcome, SetMode, Setpoint
from companion.mission.mission import EndAction
from companion.mission.phases import Phase, Reason
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits

FIRST = {
    TakeoffSequence.GUIDED_THEN_CLIMB: [SetMode, events.Arm, events.TakeOff],
    TakeoffSequence.MODE_THEN_ARM: [SetMode, events.Arm],
    TakeoffSequence.CLIMB_THEN_ARM: [events.TakeOff, events.Arm],
}


def outcome_of(craft: Craft) -> Outcome:
    return craft.fly_to(Phase.DONE).end().outcome


@pytest.mark.sample(3)  # of each autopilot
@EACH
@pytest.mark.parametrize("end", list(EndAction), ids=lambda end: end.value)
def test_a_mission_is_sent_up_arrives_and_ends_as_it_should_and_keeps_the_setpoints_period(
    traits: VehicleTraits, end: EndAction
) -> None:
    craft = led(traits, end_action=end)
    told = [type(c) for c in moving(craft.commands) if not isinstance(c, events.SetSpeed)]
    assert list(dict.fromkeys(told[: told.index(Setpoint)])) == FIRST[traits.take_off]
    guided = traits.take_off is TakeoffSequence.GUIDED_THEN_CLIMB
    modes = {Mode.GUIDED} if guided else {Mode.GUIDED, Mode.TAKE_OFF}
    assert {each.mode for each in craft.sent(SetMode)} <= modes
    gaps = [b.time_s - a.time_s for a, b in pairwise(craft.sent(Setpoint)[-20:])]
    period_s, tick_s = traits.setpoint_period_s, craft.tick_s
    assert max(period_s - 0.5 * tick_s, tick_s) - 1e-6 <= min(gaps)
    assert max(gaps) <= period_s + tick_s + 1e-6
    outcome, radius_m = outcome_of(craft), craft.state.task.limits.loiter_radius_m
    [target], down = craft.context.mission.targets_ne_m, craft.landed is Landed.ON_GROUND
    stops = [each.position_nea_m for each in craft.sent(Setpoint)]
    assert min(math.dist(stop[:2], target) for stop in stops) < max(1.0, 0.25 * radius_m)
    off_m = math.dist(craft.here[:2], target)
    home_m, near_m = math.hypot(*craft.here[:2]), 5.0 if traits.hovers else 3.0 * radius_m
    missed = down and not traits.hovers and min(off_m, home_m) > 1.5 * radius_m
    assert (outcome is Outcome.ARRIVED) is not missed
    if end is EndAction.HOLD:
        assert off_m < near_m
        assert craft.mode is (Mode.GUIDED if traits.holds_in_guided else Mode.HOLD)
    if end is EndAction.LAND and traits.lands:
        assert off_m < 2.0 * near_m
        assert (down, craft.armed) == (True, False)
    if end is EndAction.RETURN:
        assert home_m < 1.5 * near_m + 10.0
        assert Phase.RETURNING in craft.phases


@pytest.mark.sample(3)
@EACH
@pytest.mark.parametrize("mode", [Mode.GUIDED, Mode.HOLD, Mode.OTHER], ids=lambda mode: mode.value)
def test_in_the_air_it_takes_over_once_in_guided_mode(traits: VehicleTraits, mode: Mode) -> None:
    """And nobody has to say go; while another flies it, it is left alone.

    Below the band it climbs before anything is planned: a copter is led up at the mission's rate.
    """
    craft = calm(traits).aloft(mode, height_m=5.0)
    begins_m = craft.here[2]
    craft.context = Context(mission=craft.context.mission, seed=1)
    if mode is Mode.OTHER:
        craft.run_for(30.0)
        assert (craft.state.phase, craft.state.reason) == (Phase.HOLDING, Reason.MODE_TAKEN)
        assert not craft.sent(SetMode) + craft.sent(Setpoint)
        craft.mode = Mode.GUIDED
    craft.run_until(lambda craft: craft.state.flight.plan_id > 0)
    task = craft.state.task
    assert craft.here[2] >= task.band_amsl_m[0] - task.limits.tracking_error_m
    heights = [begins_m, *(c.position_nea_m[2] for c in craft.sent(Setpoint))]
    if traits.hovers:
        assert max(b - a for a, b in pairwise(heights)) <= task.limits.climb_rate_m_s + 1e-6
    assert outcome_of(craft) is Outcome.ARRIVED
    assert not craft.sent(events.Arm) + craft.sent(events.TakeOff)


# --- restarts


@pytest.mark.sample(5)
@EACH
@pytest.mark.parametrize("after_s", [0.3, 3.1, 8.7, 14.9, 21.3, 27.7])
def test_a_restart_in_flight_goes_on_without_a_jump(traits: VehicleTraits, after_s: float) -> None:
    """Where the vehicle is led: 1 m and 1 m/s from where it was led, or from where it is."""
    craft = told(calm(traits).run_until(lambda craft: craft.state.leg is not None), after_s)
    last, count = craft.sent(Setpoint)[-1], len(craft.sent(Setpoint))
    craft.restart().run_until(lambda craft: len(craft.sent(Setpoint)) > count)
    first = craft.sent(Setpoint)[count]
    passed_s = first.time_s - last.time_s
    assert passed_s < 6.0
    if traits.hovers:
        moved_m = math.dist(first.position_nea_m, last.position_nea_m)
        assert moved_m <= 1.0 + passed_s * math.hypot(*last.velocity_nea_m_s)
        was = (craft.velocity, last.velocity_nea_m_s)  # stopped at the last setpoint, or not
        apart = min(math.dist(first.velocity_nea_m_s, velocity) for velocity in was)
        assert first.stay or apart <= 1.0 + 2.5 * craft.tick_s
    assert outcome_of(craft) is Outcome.ARRIVED


# --- planes


@PLANES
def test_a_plane_leaves_its_circle_when_it_flies_along_its_path(traits: VehicleTraits) -> None:
    """Begun at once, it came round on the far side of what is proven."""
    craft = calm(traits).run_until(lambda craft: craft.state.leg is not None)
    craft.run_until(lambda craft: not craft.state.path.circling)
    tangent = craft.state.leg.subpath.pose(0.0).tangent_nea[:2]
    assert np.dot(craft.velocity[:2], tangent) > 0.85 * math.hypot(*craft.velocity[:2])


@PLANES
@pytest.mark.parametrize("at_end", [False, True])
def test_a_plane_told_to_return_circles_one_place(traits: VehicleTraits, at_end: bool) -> None:
    """Until it leaves for home: if that place moved, it would swing wide of both circles.

    Of a leg the end, though it begins to circle that from before it: there its way back begins.
    """
    craft = led(traits)
    plan = craft.plan
    if at_end:
        craft.plan = lambda r: not_planned(r) if r.flown is None else plan(r)
        craft.fly_to(Phase.HOLDING)
    before = len(craft.sent(Setpoint))
    tell(craft, OrderKind.RETURN)
    circled = craft.state.flight.hover_nea_m
    craft.fly_to(Phase.RETURNING)
    assert craft.state.leg.subpath.pose(0.0).position_nea_m == pytest.approx(circled, abs=0.5)
    craft.run_until(lambda craft: not craft.state.path.circling)
    held = [each.position_nea_m for each in craft.sent(Setpoint)[before:] if each.stay]
    assert len(held) > 10
    for place in held:
        assert place == pytest.approx(circled, abs=0.5)


@PLANES
def test_a_plane_that_loses_its_position_comes_back_to_its_circle(traits: VehicleTraits) -> None:
    """It alone is proven: by each circle beside the last it came nearer to a hill, and hit it.

    It does not leave it at all where only news of its position is missing, not the position.
    """
    craft = calm(traits, not_planned).run_until(lambda craft: craft.state.flight.failures)
    circled = craft.state.flight.hover_nea_m
    silent, heard = now(says_where=list), now(says_where=craft.says_where)
    for lost, again in [(now(fix=False), now(fix=True)), (silent, heard)]:
        craft.run_for(5.0)
        before, unheard = len(craft.sent(SetMode)), lost is silent
        told(craft, lost, now(obeys_modes=False), 2.0, now(obeys_modes=True), 2.0)
        hold = craft.sent(SetMode)[before]
        assert (hold.mode, hold.at_nea_m) == (Mode.HOLD, circled if unheard else None)
        stays = unheard and traits.holds_in_guided
        assert craft.mode is (Mode.GUIDED if stays else Mode.HOLD)  # asked until it obeys
        told(craft, again, 6.0)
        sent = craft.sent(Setpoint)[-1]
        assert sent.stay
        assert sent.position_nea_m == pytest.approx(circled, abs=0.5)


def test_a_plane_that_lands_too_far_from_where_it_was_to_land_has_not_arrived() -> None:
    craft = calm(PX4_FIXED_WING.traits, end_action=EndAction.LAND).fly_to(Phase.LANDING)
    off_m = 2.0 * stopped.lands_within_m(craft.state) + 50.0
    craft.state = replace(craft.state, targets_ne_m=((craft.here[0], craft.here[1] + off_m),))
    assert outcome_of(craft) is Outcome.FAILED
