"""A flight as it goes: each leg is scanned for, planned, led along and followed by the next.

Where a plan or the radar's answer does not come, or comes too late: `test_stories`.
"""

import math

import numpy as np
import pytest
from made_up import AWAY, MISSION, SPEED_M_S, TICK_S, Craft, flying, now, position, told
from made_up_plans import LEG_M
from renewed import replace

from companion.mission.events import Plan, Setpoint, StartScan
from companion.mission.phases import Phase

# The distances of environment-1 by hand: V = 150 m/s, a = 5 m/s2, T = 5 s, t_scan = 4 s,
# d_s = 500 m, R = 20 km: tail = max(0.15 R, V^2 / 2a + d_s), L = V (T + t_scan) + tail.
TAIL_M = max(3000.0, 150.0**2 / 10.0 + 500.0)
L_M = 150.0 * (9.0 + 3 * 0.1) + TAIL_M  # T, the scan, and three positions
NORTH_EAST = math.sqrt(0.5)


def flown_m(setpoint: Setpoint) -> float:
    """Its distance from the start."""
    return math.hypot(*setpoint.position_nea_m[:2])


def test_targets_are_reached_in_their_order_with_a_stop_at_each() -> None:
    corners = ((9000.0, 0.0), (9000.0, 9000.0), (0.0, 9000.0))
    craft = Craft(replace(MISSION, targets_ne_m=corners)).fly_to(Phase.DONE)
    stops = [
        after.flight.hover_nea_m[:2]
        for before, _, after, _ in craft.steps
        if after.phase is Phase.ARRIVED is not before.phase and after.flight.hover_nea_m
    ]
    np.testing.assert_allclose(stops, corners, atol=1e-6)


def test_every_leg_is_scanned_for_once_at_p_scan_and_planned_from_p_prog_where_it_goes_over() -> (
    None
):
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


def test_setpoints_lead_along_the_leg_nose_ahead_to_rest_at_its_target() -> None:
    setpoints = Craft(AWAY).fly_to(Phase.DONE).sent(Setpoint)
    for setpoint in setpoints[100:]:
        north, east, _ = setpoint.position_nea_m
        assert north == pytest.approx(east, abs=1e-6)
        along = math.hypot(*setpoint.velocity_nea_m_s) * np.array([NORTH_EAST, NORTH_EAST, 0.0])
        np.testing.assert_allclose(setpoint.velocity_nea_m_s, along, atol=1e-6)
        assert setpoint.yaw_rad == pytest.approx(math.pi / 4, abs=0.02)  # at its target, too
    assert setpoints[-1].velocity_nea_m_s == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(setpoints[-1].position_nea_m[:2], (20_000.0, 20_000.0), atol=1.0)


def test_the_reference_waits_for_a_vehicle_that_falls_behind_and_goes_on_when_it_follows() -> None:
    craft = told(flying(), now(follows=False, velocity=(0.5, 0.5, 0.0)))
    ahead = [s for _ in range(100) for s in craft.tick() if isinstance(s, Setpoint)]
    leads = [math.dist(s.position_nea_m, craft.here) for s in ahead]
    assert max(leads) <= SPEED_M_S * 1.0 + SPEED_M_S * TICK_S
    assert ahead[-1].velocity_nea_m_s == (0.0, 0.0, 0.0)
    while math.dist(craft.here, craft.sent(Setpoint)[-1].position_nea_m) > 4.5:  # it catches up
        craft.drift((30.0, 30.0, 0.0))
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
    assert all(flown_m(setpoint) >= flown_m(newest) for setpoint in sent)
    assert all(setpoint.velocity_nea_m_s[0] >= 0.0 for setpoint in sent)
