"""How wide and far a vehicle moves: integrals, and what was measured."""

import math
from dataclasses import replace

import numpy as np
import pytest
from planning import ARDUCOPTER, PLANE_TASK, limits

from companion.mavlink.autopilots import PX4_FIXED_WING
from companion.path.envelope import COPTER, Handling, envelope_of, flown_on_m


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


def test_the_reach_covers_the_54_m_that_arducopter_flew_on_at_10_m_s() -> None:
    # ardupilot.md 3: WPNAV_ACCEL 2.5 m/s2, GUID_TIMEOUT 3 s
    motion = envelope_of(limits(acceleration_m_s2=2.5), ARDUCOPTER)
    assert 54.0 <= flown_on_m(motion, 10.0) <= 60.0


def test_a_copter_is_asked_to_rise_no_harder_than_arducopter_does_by_default() -> None:
    # WPNAV_ACCEL_Z of 1 m/s2, WPNAV_ACCEL of 2.5
    assert envelope_of(limits(acceleration_m_s2=2.5), ARDUCOPTER).vertical_m_s2 <= 1.0


def test_what_is_proven_of_a_px4_plane_covers_a_circle_44_m_beside_its_last_point() -> None:
    # px4.md 10: where it goes over to its own hold in wind of 5 m/s, when the setpoints end
    bounds = replace(PLANE_TASK.limits, loiter_radius_m=80.0, tracking_error_m=15.0)
    motion = envelope_of(bounds, PX4_FIXED_WING.traits.handling)
    assert motion.loiter_m + motion.tube_m >= 80.0 + 44.0


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
