"""How a vehicle moves, against integrals and halving."""

import math
from dataclasses import replace

import numpy as np
import pytest
from brute_force import fastest_m_s
from hypothesis import given
from hypothesis import strategies as st
from planning import ARDUCOPTER, limits

from companion.path.envelope import (
    COPTER,
    Envelope,
    Handling,
    beyond_m,
    ending_m_s,
    envelope_of,
    flown_on_m,
    rising_m_s,
    slowing_m,
)

motions = st.builds(
    lambda v, braking, flies_on_s, overrun, settling_s: envelope_of(
        limits(speed_m_s=v, acceleration_m_s2=braking, dead_man_s=flies_on_s, overrun_m=overrun),
        replace(ARDUCOPTER, settling_s=settling_s),
    ),
    st.floats(1.0, 200.0),
    st.floats(0.5, 20.0),
    st.floats(0.0, 10.0),
    st.sampled_from([0.0, 0.5, 40.0, math.inf]),
    st.floats(0.0, 2.0),
)


@given(motion=motions, speed=st.floats(0.0, 300.0), left=st.floats(0.0, 3_000.0))
def test_speeds_near_the_ends_of_a_leg_are_the_highest_that_its_rules_allow(
    motion: Envelope, speed: float, left: float
) -> None:
    """And the dead-man reach is what a vehicle covers that flies on and then brakes."""
    share = (np.arange(4_000) + 0.5) / 4_000
    braked_m = (speed * (1.0 - share)).mean() * speed / motion.braking_m_s2
    covered_m = speed * motion.dead_man_s + braked_m
    assert flown_on_m(motion, speed) == pytest.approx(covered_m, rel=1e-5, abs=1e-9)
    [told] = fastest_m_s(motion, np.array([left]))
    assert ending_m_s(motion, left) == pytest.approx(told, rel=1e-6, abs=1e-6)
    [told] = fastest_m_s(motion, np.array([1e9]), np.array([left]))
    assert rising_m_s(motion, left) == pytest.approx(told, rel=1e-6, abs=1e-6)


@given(motion=motions)
def test_no_stretch_ends_farther_beyond_a_leg_than_is_told(motion: Envelope) -> None:
    """It slows down from where its speed is bounded by the end."""
    at_m = slowing_m(motion, motion.speed_m_s)
    assert ending_m_s(motion, at_m + 1e-6) == pytest.approx(motion.speed_m_s, rel=1e-6)
    assert at_m <= 0.01 or ending_m_s(motion, 0.99 * at_m) < motion.speed_m_s
    left = (1.5 * at_m + 1.0) * np.linspace(0.0, 1.0, 2_001) ** 2
    speed = fastest_m_s(motion, left)
    beyond = speed * motion.dead_man_s + speed**2 / (2.0 * motion.braking_m_s2) - left
    assert max(beyond.max(), 0.0) <= beyond_m(motion) + 1e-6
    assert beyond_m(motion) <= max(beyond.max(), 0.0) + 0.01 * motion.speed_m_s + 1e-6


@pytest.mark.parametrize("speed", [3.0, 8.0, 150.0])
def test_without_setpoints_it_leaves_its_tangent_by_what_its_jerk_and_its_map_turn_it(
    speed: float,
) -> None:
    bounds = limits(speed_m_s=speed, acceleration_m_s2=5.0, turn_radius_m=speed**2 / 4.0)
    motion = envelope_of(bounds, replace(COPTER, turning_s2=0.0), convergence_rad=0.02)
    time_s = np.linspace(0.0, flown_on_m(motion, speed) / speed, 200_001)
    across_m_s2 = np.maximum(4.0 - 20.0 * time_s, 0.0)  # jerk: four times the acceleration
    velocity = np.cumsum(across_m_s2) * time_s[1] + 0.02 * speed
    assert velocity.sum() * time_s[1] == pytest.approx(motion.aside_m, rel=0.05)
    assert velocity.sum() * time_s[1] <= motion.aside_m * 1.0001
    straight = replace(bounds, turn_radius_m=math.inf)
    assert envelope_of(straight, replace(COPTER, turns_with_grid=False), 0.02).aside_m == 0.0


@pytest.mark.parametrize("tracking_error_m", [0.3, 0.7, 5.0])
def test_without_setpoints_it_flies_on_as_far_inside_of_a_bend_as_the_last_one_was(
    tracking_error_m: float,
) -> None:
    """And is as far off that as off any straight path."""
    bounds = limits(tracking_error_m=tracking_error_m, turn_radius_m=20.0, speed_m_s=6.0)
    led = envelope_of(bounds, ARDUCOPTER)
    as_told = envelope_of(bounds, replace(ARDUCOPTER, leading_s2=0.0, turning_s2=0.0))
    hardest_m_s2 = min(led.lateral_m_s2, 6.0**2 / 20.0)
    turned_m = hardest_m_s2**2 / (6.0**2 / 20.0) ** 2 * as_told.aside_m
    inside_m = ARDUCOPTER.leading_s2 * hardest_m_s2 + ARDUCOPTER.steady_m
    assert led.tube_m + led.aside_m - turned_m >= inside_m - 1e-12
    assert led.aside_m - turned_m <= max(inside_m - led.tube_m, 0.0) + 1e-12


def test_the_reach_covers_the_54_m_that_arducopter_flew_on_at_10_m_s() -> None:
    # ardupilot.md 3: WPNAV_ACCEL 2.5 m/s2, GUID_TIMEOUT 3 s
    motion = envelope_of(limits(acceleration_m_s2=2.5), ARDUCOPTER)
    assert 54.0 <= flown_on_m(motion, 10.0) <= 60.0


@pytest.mark.parametrize("handling", [ARDUCOPTER, COPTER])
@pytest.mark.parametrize(("speed_m_s", "radius_m"), [(3.0, 6.0), (10.0, 5.5), (10.0, 60.0)])
def test_no_turn_is_so_tight_that_a_quarter_of_v_is_too_fast_for_its_tube(
    handling: Handling, speed_m_s: float, radius_m: float
) -> None:
    """More slowly no bend is flown.  A mission that asks for less than it may has its way."""
    bounds = limits(speed_m_s=speed_m_s, turn_radius_m=radius_m, tracking_error_m=0.5)
    motion = envelope_of(bounds, handling)
    slowest_m_s2 = (0.25 * speed_m_s) ** 2 / motion.turn_radius_m
    assert slowest_m_s2 <= motion.lateral_m_s2 * (1.0 + 1e-12)
    is_asked = motion.turn_radius_m == radius_m
    assert is_asked or slowest_m_s2 == pytest.approx(motion.lateral_m_s2)


@pytest.mark.parametrize("handling", [ARDUCOPTER, COPTER])
def test_a_mission_widens_the_tube_that_was_measured_and_never_narrows_it(
    handling: Handling,
) -> None:
    wide, narrow = (envelope_of(limits(tracking_error_m=m), handling) for m in (20.0, 0.01))
    assert (wide.tube_m, narrow.tube_m) == (20.0, handling.steady_m)
    assert narrow.dead_man_s == limits().dead_man_s + handling.lag_s
    bend_s2 = max(handling.turning_s2, handling.leading_s2)
    for each in (wide, narrow):
        assert each.lateral_m_s2 * bend_s2 <= each.tube_m * (1.0 + 1e-12)
    plane = envelope_of(limits(loiter_radius_m=50.0, lead_s=2.0, speed_m_s=20.0), handling)
    assert flown_on_m(plane, 20.0) == 40.0
