"""What ardupilot.md 7 says of the real ArduPlane, tried by values; tracking: test_tracking.py."""

import cmath
import math
from functools import partial

import harness
import pytest
from harness import PLANE_AUTO, PLANE_GUIDED, PLANE_HOME, PLANE_LOITER, PLANE_RTL, copied
from rigs import ArduPlane, circling

from vehicle_sim.faults import GpsConditions
from vehicle_sim.plans import PlanItem, PlanKind

item = partial(harness.item, PLANE_HOME)
MANUAL, FBWA, CRUISE = 0, 5, 7
REPOSITION, CHANGE_SPEED, CHANGE_HEADING = 192, 43000, 43002
ACCEPTED, _, DENIED, UNSUPPORTED, FAILED = range(5)


def from_home_m(rig: ArduPlane) -> float:
    return math.hypot(*rig.ne_m)


# --- boot, arming, take-off -----------------------------------------------------------------------


def test_it_is_armed_once_its_estimator_flies() -> None:
    rig = ArduPlane()
    results = [rig.run(seconds).command(400, 1.0) for seconds in (9.5, 11.0, 2.6)]
    assert results == [FAILED, FAILED, ACCEPTED]


def test_nothing_but_take_off_and_auto_leaves_the_ground() -> None:
    rig = ArduPlane().run(24.0)
    assert rig.command(400, 1.0) == ACCEPTED
    assert {rig.set_mode(of_quadplanes) for of_quadplanes in (17, 19, 21, 99)} == {FAILED}
    for mode in (MANUAL, FBWA, PLANE_LOITER, PLANE_RTL, PLANE_GUIDED):
        assert rig.set_mode(mode) == ACCEPTED
        assert rig.command(22, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 30.0) == FAILED
        rig.run(5.0)
    assert rig.reposition(500.0, 0.0, 50.0) == ACCEPTED
    assert rig.run(10.0).speed_m_s == 0.0
    assert rig.landed


# --- GUIDED: points -------------------------------------------------------------------------------


def test_reposition_is_a_command_int_with_a_place() -> None:
    rig = circling()
    place = (*rig.frame.to_geographic(300.0, 0.0), 90.0)
    assert rig.command(REPOSITION, -1.0, 1.0, 0.0, 0.0, *place) == UNSUPPORTED
    for frame, result in (*((f, ACCEPTED) for f in (0, 3, 5, 6, 10, 11)), (1, DENIED)):
        assert rig.command(REPOSITION, 5.0, 0.0, 0.0, 0.0, *place, frame=frame) == result
    for bad in ((95.0, 0.0, 90.0), (0.0, 190.0, 90.0), (0.0, 0.0, 90.0), (*place[:2], math.nan)):
        assert rig.command(REPOSITION, -1.0, 1.0, 0.0, 0.0, *bad, frame=3) == DENIED
    assert rig.texts[-1].startswith("SIM:")  # what the real one does not survive
    assert rig.set_mode(PLANE_LOITER) == ACCEPTED
    for changes_mode, result, mode in ((0.0, FAILED, "LOITER"), (1.0, ACCEPTED, "GUIDED")):
        given = (-1.0, changes_mode, 0.0, 0.0, *place)
        assert (rig.command(REPOSITION, *given, frame=3), rig.mode) == (result, mode)


def test_it_circles_where_guided_was_entered_and_tells_the_point() -> None:
    rig = circling()
    rig.set_mode(PLANE_LOITER)
    centre, height_m, before = rig.run(5.0).ne_m, rig.height_m, len(rig.reached())
    rig.set_mode(PLANE_GUIDED)
    assert math.dist(rig.run(80.0).ne_m, centre) == pytest.approx(97.0, abs=3.0)
    assert rig.height_m == pytest.approx(height_m, abs=1.0)
    waypoint = rig.status.waypoint
    assert rig.frame.to_local(*waypoint.place[:2]) == pytest.approx(centre, abs=0.5)
    assert waypoint.distance_m == pytest.approx(math.dist(rig.ne_m, centre), abs=3.0)
    assert len(rig.reached()) == before + 1


@pytest.mark.parametrize(("asked_m", "flown_m", "ccw"), [(40.0, 60.0, 0.0), (80.0, 97.0, 1.0)])
def test_a_circle_is_wider_than_asked_by_what_was_measured(
    asked_m: float, flown_m: float, ccw: float
) -> None:
    rig, places = circling(), list[complex]()
    for radius_m in (asked_m, -40.0, math.nan):  # what is no radius leaves the one before
        assert rig.reposition(0.0, 0.0, 80.0, radius_m, ccw) == ACCEPTED
    rig.run(40.0).run(15.0, lambda: places.append(complex(*rig.ne_m)))
    assert sum(map(abs, places)) / len(places) == pytest.approx(flown_m, abs=3.0)
    assert ((places[100] / places[0]).imag < 0.0) is bool(ccw)


# --- GUIDED: speed, height, course ----------------------------------------------------------------


@pytest.mark.parametrize(("asked_m_s", "flown_m_s"), [(18.0, 18.9), (25.0, 27.7)])
def test_a_speed_is_flown_as_measured(asked_m_s: float, flown_m_s: float) -> None:
    rig = circling()
    assert rig.command(178, 0.0, 19.0) == ACCEPTED
    assert rig.run(30.0).speed_m_s == pytest.approx(19.9, abs=0.3)
    assert rig.command(CHANGE_SPEED, 0.0, asked_m_s) == ACCEPTED
    assert rig.command(178, 0.0, 22.0) == ACCEPTED  # does not change that
    assert rig.run(30.0).speed_m_s == pytest.approx(flown_m_s, abs=0.3)
    assert rig.status.airspeed_m_s == pytest.approx(asked_m_s, abs=0.1)
    rig.set_mode(PLANE_LOITER)
    assert rig.run(30.0).speed_m_s == pytest.approx(23.45, abs=0.3)


def test_speeds_and_courses_out_of_range_or_out_of_guided_are_denied() -> None:
    rig, guided = circling(), ((CHANGE_SPEED, 20.0), (178, 20.0), (CHANGE_HEADING, 90.0))
    for wrong in ((1.0, 20.0), (0.0, 9.0), (0.0, 31.0), (0.0, math.nan)):
        assert rig.command(CHANGE_SPEED, *wrong) == DENIED
    for wrong in ((0.0, 360.0), (3.0, 90.0), (0.0, math.nan)):
        assert rig.command(CHANGE_HEADING, *wrong, 3.0) == DENIED
    rig.set_mode(PLANE_RTL)
    assert {rig.command(number, 0.0, value, 3.0) for number, value in guided} == {FAILED}


def test_of_setpoints_only_heights_are_taken_and_increments_add_up() -> None:
    rig, place = circling(90.0), (10.0, 10.0)
    rig.aim((*place, 90.0), frame=6, is_global=True)
    for _ in range(5):
        rig.aim((0.0, 0.0, -1.0), frame=7)
    assert rig.run(40.0).height_m == pytest.approx(95.0, abs=1.0)
    assert from_home_m(rig) < 150.0
    rig.aim((*place, 50.0), mask=0xDFC, frame=6, is_global=True)
    rig.aim((*place, 50.0), frame=7, is_global=True)
    rig.aim((3000.0, 0.0, -150.0))
    rig.aim((*place, math.nan), frame=5, is_global=True)
    assert rig.texts[-1].startswith("SIM:")
    assert rig.run(20.0).height_m == pytest.approx(95.0, abs=1.0)


def test_a_course_is_followed_until_something_else_is_asked_for() -> None:
    rig = circling()
    rig.reposition(3000.0, 0.0, 80.0)
    wanted = 1j * rig.run(30.0).vehicle.velocity_m_s  # to the right

    def off_deg() -> float:
        return abs(math.degrees(cmath.phase(rig.vehicle.velocity_m_s / wanted)))

    course_deg = math.degrees(cmath.phase(wanted)) % 360.0
    assert rig.command(CHANGE_HEADING, 0.0, course_deg, 3.0) == ACCEPTED
    took_s = rig.until(lambda: off_deg() < 45.0)
    # at the bank of 3 m/s2 and what the airframe makes of it: 0.745 * 3 m/s2 sideways
    assert took_s == pytest.approx(math.radians(45.0) * 23.45 / (0.745 * 3.0), rel=0.15)
    rig.run(60.0)
    assert off_deg() < 0.5
    assert rig.reposition(0.0, 0.0, 80.0) == ACCEPTED  # which ends it
    rig.run(30.0)
    assert off_deg() > 5.0


# --- other modes ----------------------------------------------------------------------------------


def test_without_a_pilot_it_holds_height_or_glides() -> None:
    rig = circling()
    rig.set_mode(CRUISE)
    assert rig.run(20.0).height_m == pytest.approx(80.0, abs=5.0)
    rig.set_mode(FBWA)
    assert rig.run(10.0).height_m < 75.0
    rig.until(lambda: rig.landed)
    assert rig.run(20.0).speed_m_s == 0.0


MISSION: tuple[PlanItem, ...] = (
    item(16),
    item(22, 0.0, 0.0, 50.0, 15.0),
    item(178, 0.0, 0.0, 0.0, 0.0, 20.0),
    item(16, 600.0, 0.0, 80.0),
    item(16, 600.0, 600.0, 100.0, 300.0),  # a wait that plane takes no notice of
    item(19, 0.0, 600.0, 80.0, 20.0),
    item(16, -800.0, 0.0, 60.0),
    item(16, -500.0, 0.0, 40.0),
    item(21),
)


@copied
def on_mission(items: int = len(MISSION)) -> ArduPlane:
    """Armed in AUTO with the first of them."""
    rig = ArduPlane()
    rig.plan(PlanKind.MISSION, *MISSION[:items])
    rig.run(24.0)
    assert [rig.set_mode(PLANE_AUTO), rig.command(400, 1.0)] == [ACCEPTED, ACCEPTED]
    return rig


def test_auto_flies_the_mission_from_take_off_to_landing() -> None:
    rig, circles_s = on_mission(), 0.0
    nearest_m = {(600.0, 0.0): math.inf, (600.0, 600.0): math.inf, (-800.0, 0.0): math.inf}

    def watch() -> None:
        nonlocal circles_s
        circles_s += 0.01 * (rig.autopilot.route.current == 5)
        for place in nearest_m:
            nearest_m[place] = min(nearest_m[place], math.dist(rig.ne_m, place))

    assert rig.run(60.0, watch).status.mission_state == 3
    assert rig.speed_m_s == pytest.approx(21.0, abs=0.5)  # DO_CHANGE_SPEED of the mission
    while rig.armed:
        rig.run(0.5, watch)
        assert rig.now_s < 400.0
    assert max(nearest_m.values()) < 60.0  # WP_RADIUS 50 m
    assert 40.0 < circles_s < 65.0  # 20 s of it on its circle, 500 m away
    north, east = rig.ne_m
    assert 0.0 < north < 800.0  # from 40 m above home it sinks wings level
    assert abs(east) < 5.0
    assert rig.texts[-1] == "Throttle disarmed"


def test_the_current_item_may_be_set_and_after_the_last_it_returns_and_circles_home() -> None:
    rig = on_mission(7).run(25.0)
    assert [rig.command(224, 20.0), rig.command(224, 6.0)] == [FAILED, ACCEPTED]
    assert rig.status.mission_current == 6
    rig.until(lambda: math.dist(rig.ne_m, (-800.0, 0.0)) < 60.0)
    rig.until(lambda: rig.mode == "RTL", 5.0)
    assert rig.status.mission_state == 5
    assert from_home_m(rig.run(90.0)) == pytest.approx(97.4, abs=3.0)  # recorded flight, 298 s
    assert rig.height_m == pytest.approx(100.0, abs=1.0)


# --- failsafes, wind ------------------------------------------------------------------------------


def test_a_breached_fence_sends_it_home_and_a_point_outside_is_denied() -> None:
    rig = circling(FENCE_ENABLE=1.0, FENCE_TYPE=2.0, FENCE_RADIUS=400.0)
    assert rig.reposition(900.0, 0.0, 80.0) == DENIED
    assert rig.command(CHANGE_HEADING, 0.0, 0.0, 3.0) == ACCEPTED
    rig.until(lambda: rig.mode == "RTL")
    assert from_home_m(rig) == pytest.approx(400.0, abs=5.0)
    assert "Circle fence breached" in rig.texts


def test_without_gps_it_levels_its_wings_and_stays_in_its_mode() -> None:
    rig = circling()
    rig.gps_conditions = GpsConditions(enabled=False)
    assert (rig.run(30.0).mode, rig.autopilot.estimate.position_ok) == ("GUIDED", False)
    assert abs(rig.vehicle.roll_rad) < 0.01
    assert rig.height_m == pytest.approx(80.0, abs=3.0)
    rig.gps_conditions = GpsConditions()
    assert from_home_m(rig.run(60.0)) < 1000.0
    assert rig.autopilot.estimate.position_ok
