import math
from functools import cache, partial

import harness
import pytest
from tracked import CHANGE_HEADING, CHANGE_SPEED, PLANE_HOME_DEG, REPOSITION, flying, off_path
from tracked import PLANE_ROWS as TABLE
from tracked import ArduPlane as Rig

from vehicle_sim.autopilot.values import Result, Sender
from vehicle_sim.faults import GpsConditions
from vehicle_sim.plans import PlanKind

item = partial(harness.item, PLANE_HOME_DEG)
MANUAL, FBWA, CRUISE, AUTO, RTL, LOITER, GUIDED = 0, 5, 7, 10, 11, 12, 15

# --- boot, arming, take-off -----------------------------------------------------------------------


def test_it_is_armed_once_its_estimator_flies() -> None:
    rig = Rig()
    for seconds, result in ((9.5, Result.FAILED), (11.0, Result.FAILED), (2.6, Result.ACCEPTED)):
        rig.run(seconds)
        assert rig.command(400, 1.0) is result


def test_nothing_but_take_off_and_auto_leaves_the_ground() -> None:
    rig = Rig()
    rig.run(24.0)
    assert rig.command(400, 1.0) is Result.ACCEPTED
    for quadplane in (17, 19, 21, 99):
        assert rig.set_mode(quadplane) is Result.FAILED
    for mode in (MANUAL, FBWA, LOITER, RTL, GUIDED):
        assert rig.set_mode(mode) is Result.ACCEPTED
        assert rig.command(22, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 30.0) is Result.FAILED
        rig.run(5.0)
    assert rig.reposition(500.0, 0.0, 50.0) is Result.ACCEPTED
    rig.run(10.0)
    assert rig.speed_m_s == 0.0
    assert rig.autopilot.landed


# --- GUIDED: points -------------------------------------------------------------------------------


def test_reposition_is_a_command_int_with_a_place() -> None:
    rig = flying()
    place = (*rig.frame.to_geographic(300.0, 0.0), 90.0)
    assert rig.command(REPOSITION, -1.0, 1.0, 0.0, 0.0, *place) is Result.UNSUPPORTED
    for frame in (0, 3, 5, 6, 10, 11):
        assert rig.command(REPOSITION, 5.0, 0.0, 0.0, 0.0, *place, frame=frame) is Result.ACCEPTED
    assert rig.command(REPOSITION, 5.0, 0.0, 0.0, 0.0, *place, frame=1) is Result.DENIED
    for bad in ((95.0, 0.0, 90.0), (0.0, 190.0, 90.0), (0.0, 0.0, 90.0), (*place[:2], math.nan)):
        assert rig.command(REPOSITION, -1.0, 1.0, 0.0, 0.0, *bad, frame=3) is Result.DENIED
    assert rig.texts[-1].startswith("SIM:")  # what the real one does not survive
    assert rig.set_mode(LOITER) is Result.ACCEPTED
    assert rig.command(REPOSITION, -1.0, 0.0, 0.0, 0.0, *place, frame=3) is Result.FAILED
    assert rig.autopilot.mode_name == "LOITER"
    assert rig.command(REPOSITION, -1.0, 1.0, 0.0, 0.0, *place, frame=3) is Result.ACCEPTED
    assert rig.autopilot.mode_name == "GUIDED"


def test_it_circles_where_guided_was_entered_and_tells_the_point() -> None:
    rig = flying()
    rig.set_mode(LOITER)
    rig.run(5.0)
    centre, height_m, before = rig.ne_m, rig.height_m, len(rig.reached())
    rig.set_mode(GUIDED)
    rig.run(80.0)
    assert math.dist(rig.ne_m, centre) == pytest.approx(97.0, abs=3.0)
    assert rig.height_m == pytest.approx(height_m, abs=1.0)
    waypoint = rig.autopilot.status().waypoint
    assert waypoint is not None
    told = rig.frame.to_local(waypoint.place.latitude_deg, waypoint.place.longitude_deg)
    assert told == pytest.approx(centre, abs=0.5)
    assert waypoint.distance_m == pytest.approx(math.dist(rig.ne_m, centre), abs=3.0)
    assert len(rig.reached()) == before + 1


@cache
def flown_off_path_m(row: int) -> tuple[float, float]:
    _, law, lateral_m_s2, hz, _ = TABLE[row]
    return off_path(law, lateral_m_s2, hz=hz)[:2]


LOOK_AHEADS = (1, 2, 3, 4, 6, 8, 9)


@pytest.mark.parametrize(
    "row",
    [
        pytest.param(k, marks=[] if k in (*LOOK_AHEADS, 10, 12) else [pytest.mark.nightly])
        for k in range(len(TABLE))
    ],
    ids=lambda k: f"{TABLE[k][0]}, {TABLE[k][2]} m/s2, {TABLE[k][3]} Hz",
)
def test_it_follows_a_weaving_route_as_well_as_the_real_one(row: int) -> None:
    """Within 40 % or 2 m of what was measured, rms and most."""
    rms_m, most_m = TABLE[row][4]
    rms, most = flown_off_path_m(row)
    assert rms == pytest.approx(rms_m, rel=0.4, abs=2.0)
    assert most == pytest.approx(most_m, rel=0.4, abs=2.0)


def test_the_best_look_ahead_is_the_measured_one_and_curvature_matters_more_than_rate() -> None:
    found = {(TABLE[k][0], TABLE[k][3]): flown_off_path_m(k)[0] for k in LOOK_AHEADS}
    ahead = {int(name.split()[1]): rms for (name, hz), rms in found.items() if hz == 4.0}
    assert min(ahead, key=lambda metres: ahead[metres]) == 115
    assert ahead[60] > ahead[80] > ahead[100] > ahead[115] < ahead[130] < ahead[160]
    at_1_hz = found["reposition 160 m ahead, radius 10 m", 1.0]
    assert abs(at_1_hz - ahead[160]) < 0.5 * (ahead[160] - ahead[115])


# --- GUIDED: speed, height, course ----------------------------------------------------------------


@pytest.mark.parametrize(("asked_m_s", "flown_m_s"), [(18.0, 18.9), (20.0, 21.0), (25.0, 27.7)])
def test_a_speed_is_flown_as_measured(asked_m_s: float, flown_m_s: float) -> None:
    rig = flying()
    assert rig.command(178, 0.0, 19.0) is Result.ACCEPTED
    rig.run(30.0)
    assert rig.speed_m_s == pytest.approx(19.9, abs=0.3)
    assert rig.command(CHANGE_SPEED, 0.0, asked_m_s) is Result.ACCEPTED
    assert rig.command(178, 0.0, 22.0) is Result.ACCEPTED  # does not change that
    rig.run(30.0)
    assert rig.speed_m_s == pytest.approx(flown_m_s, abs=0.3)
    assert rig.autopilot.status().airspeed_m_s == pytest.approx(asked_m_s, abs=0.1)
    rig.set_mode(LOITER)
    rig.run(30.0)
    assert rig.speed_m_s == pytest.approx(23.45, abs=0.3)


def test_speeds_out_of_range_or_over_ground_are_denied() -> None:
    rig = flying()
    for wrong in ((1.0, 20.0), (0.0, 9.0), (0.0, 31.0), (0.0, math.nan)):
        assert rig.command(CHANGE_SPEED, *wrong) is Result.DENIED
    rig.set_mode(RTL)
    assert rig.command(CHANGE_SPEED, 0.0, 20.0) is Result.FAILED
    assert rig.command(178, 0.0, 20.0) is Result.FAILED


def test_of_setpoints_only_heights_are_taken_and_increments_add_up() -> None:
    rig = flying(settle_s=90.0)
    place = (10.0, 10.0)
    rig.give((*place, 90.0), mask=0xDF8, frame=6, is_global=True)
    for _ in range(5):
        rig.give((0.0, 0.0, -1.0), mask=0xDF8, frame=7)
    rig.run(40.0)
    assert rig.height_m == pytest.approx(95.0, abs=1.0)
    assert math.hypot(*rig.ne_m) < 150.0
    rig.give((*place, 50.0), mask=0xDFC, frame=6, is_global=True)
    rig.give((*place, 50.0), mask=0xDF8, frame=7, is_global=True)
    rig.give((3000.0, 0.0, -150.0), mask=0xDF8)
    rig.give((*place, math.nan), mask=0xDF8, frame=5, is_global=True)
    assert rig.texts[-1].startswith("SIM:")
    rig.run(20.0)
    assert rig.height_m == pytest.approx(95.0, abs=1.0)


@pytest.mark.parametrize(
    ("asked_m", "flown_m", "ccw"), [(40.0, 60.0, 0.0), (80.0, 97.0, 1.0), (150.0, 167.0, 0.0)]
)
def test_a_circle_is_wider_than_asked_by_what_was_measured(
    asked_m: float, flown_m: float, ccw: float
) -> None:
    rig = flying()
    for radius_m in (asked_m, -40.0, math.nan):  # what is no radius leaves the one before
        assert rig.reposition(0.0, 0.0, 80.0, radius_m, ccw) is Result.ACCEPTED
    rig.run(40.0)
    places = list[tuple[float, float]]()
    rig.run(15.0, lambda: places.append(rig.ne_m))
    assert sum(math.hypot(*p) for p in places) / len(places) == pytest.approx(flown_m, abs=3.0)
    (n0, e0), (n1, e1) = places[0], places[100]
    assert (n0 * e1 - e0 * n1 < 0.0) is bool(ccw)


def test_a_stream_of_points_that_ends_leaves_it_on_the_last_one_without_a_word() -> None:
    rig = flying()
    said, texts = len(rig.reached()), len(rig.texts)
    for k in range(20):
        north_m, east_m = rig.ne_m
        rig.reposition(north_m + 20.0, east_m, 80.0, 60.0)
        rig.run(0.98)
        assert rig.autopilot.mode_name == "GUIDED", k
    last = rig.frame.to_local(*rig.autopilot.status().waypoint.place[:2])
    assert len(rig.reached()) - said == pytest.approx(20, abs=4)  # a near point is reached at once
    rig.run(60.0)
    assert math.dist(rig.ne_m, last) == pytest.approx(78.0, abs=5.0)
    assert len(rig.texts) == texts


def test_a_course_is_followed_for_ever_and_out_of_range_denied() -> None:
    rig = flying()
    rig.reposition(3000.0, 0.0, 80.0)
    rig.run(30.0)

    def course_deg() -> float:
        plane = rig.plane
        return math.degrees(math.atan2(plane.velocity_east_m_s, plane.velocity_north_m_s)) % 360.0

    def off_deg() -> float:
        return abs(math.remainder(course_deg() - wanted_deg, 360.0))

    for wrong in ((0.0, 360.0), (3.0, 90.0), (0.0, math.nan)):
        assert rig.command(CHANGE_HEADING, *wrong, 3.0) is Result.DENIED
    wanted_deg = (course_deg() + 90.0) % 360.0
    assert rig.command(CHANGE_HEADING, 0.0, wanted_deg, 3.0) is Result.ACCEPTED
    took_s = rig.run_until(lambda: off_deg() < 45.0)
    # at the bank of 3 m/s2 and what the airframe makes of it: 0.745 * 3 m/s2 sideways
    assert took_s == pytest.approx(math.radians(45.0) * 23.45 / (0.745 * 3.0), rel=0.15)
    rig.run(60.0)
    assert off_deg() < 0.5
    assert rig.reposition(0.0, 0.0, 80.0) is Result.ACCEPTED  # which ends it
    rig.run(30.0)
    assert off_deg() > 5.0
    rig.set_mode(LOITER)
    assert rig.command(CHANGE_HEADING, 0.0, 90.0, 3.0) is Result.FAILED


# --- other modes ----------------------------------------------------------------------------------


def test_it_returns_climbing_and_circles_home() -> None:
    rig = flying()
    rig.reposition(1500.0, 0.0, 60.0)
    rig.run(60.0)
    assert rig.set_mode(RTL) is Result.ACCEPTED
    rig.run(120.0)
    assert math.hypot(*rig.ne_m) == pytest.approx(97.4, abs=3.0)  # recorded flight, 298 s
    assert rig.height_m == pytest.approx(100.0, abs=1.0)


def test_without_a_pilot_it_holds_height_or_glides() -> None:
    rig = flying()
    rig.set_mode(CRUISE)
    rig.run(20.0)
    assert rig.height_m == pytest.approx(80.0, abs=5.0)
    rig.set_mode(FBWA)
    rig.run(10.0)
    assert rig.height_m < 75.0
    rig.run_until(lambda: rig.autopilot.landed)
    rig.run(20.0)
    assert rig.speed_m_s == 0.0


@pytest.fixture
def mission_rig() -> Rig:
    rig = Rig()

    rig.plans[PlanKind.MISSION] = (
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
    rig.autopilot.on_plan(PlanKind.MISSION)
    rig.run(24.0)
    return rig


def test_auto_flies_the_mission_from_take_off_to_landing(mission_rig: Rig) -> None:
    rig = mission_rig
    assert rig.set_mode(AUTO) is Result.ACCEPTED
    assert rig.command(400, 1.0) is Result.ACCEPTED
    nearest_m = {(600.0, 0.0): math.inf, (600.0, 600.0): math.inf, (-800.0, 0.0): math.inf}
    circles_s = 0.0

    def watch() -> None:
        nonlocal circles_s
        circles_s += 0.01 * (rig.autopilot.route.current == 5)
        for place in nearest_m:
            nearest_m[place] = min(nearest_m[place], math.dist(rig.ne_m, place))

    rig.run(60.0, watch)
    assert rig.autopilot.status().mission_state == 3
    assert rig.speed_m_s == pytest.approx(21.0, abs=0.5)  # DO_CHANGE_SPEED of the mission
    while rig.autopilot.armed:
        rig.run(0.5, watch)
        assert rig.now_s < 400.0
    assert max(nearest_m.values()) < 60.0  # WP_RADIUS 50 m
    assert 40.0 < circles_s < 65.0  # 20 s of it on its circle, 500 m away
    north, east = rig.ne_m
    assert 0.0 < north < 800.0  # from 40 m above home it sinks wings level
    assert abs(east) < 5.0
    assert rig.texts[-1] == "Throttle disarmed"


def test_the_current_item_may_be_set_and_after_the_last_it_returns(mission_rig: Rig) -> None:
    rig = mission_rig
    rig.plans[PlanKind.MISSION] = rig.plans[PlanKind.MISSION][:7]
    rig.autopilot.on_plan(PlanKind.MISSION)
    rig.set_mode(AUTO)
    rig.command(400, 1.0)
    rig.run(25.0)
    assert rig.command(224, 20.0) is Result.FAILED
    assert rig.command(224, 6.0) is Result.ACCEPTED
    assert rig.autopilot.status().mission_current == 6
    rig.run_until(lambda: math.dist(rig.ne_m, (-800.0, 0.0)) < 60.0)
    rig.run_until(lambda: rig.autopilot.mode_name == "RTL", 5.0)
    assert rig.autopilot.status().mission_state == 5


# --- failsafes ------------------------------------------------------------------------------------


def test_a_breached_fence_sends_it_home_and_a_point_outside_is_denied() -> None:
    rig = flying({"FENCE_ENABLE": 1.0, "FENCE_TYPE": 2.0, "FENCE_RADIUS": 400.0})
    assert rig.reposition(900.0, 0.0, 80.0) is Result.DENIED
    assert rig.command(CHANGE_HEADING, 0.0, 0.0, 3.0) is Result.ACCEPTED
    rig.run_until(lambda: rig.autopilot.mode_name == "RTL")
    assert math.hypot(*rig.ne_m) == pytest.approx(400.0, abs=5.0)
    assert "Circle fence breached" in rig.texts


def test_the_lost_ground_station_sends_it_home() -> None:
    rig = flying({"FS_GCS_ENABL": 1.0})
    rig.take(rig.autopilot.on_heartbeat(Sender(system=255, component=190), 6))
    took_s = rig.run_until(lambda: rig.autopilot.mode_name == "RTL")
    assert took_s == pytest.approx(4.9, abs=0.2)
    rig.take(rig.autopilot.on_heartbeat(Sender(system=255, component=190), 6))
    rig.run(0.1)
    assert (rig.texts[-1], rig.autopilot.mode_name) == ("GCS Failsafe Cleared", "RTL")


def test_without_gps_it_levels_its_wings_and_stays_in_its_mode() -> None:
    rig = flying()
    rig.gps_conditions = GpsConditions(enabled=False)
    rig.run(30.0)
    assert rig.autopilot.mode_name == "GUIDED"
    assert not rig.autopilot.estimate.position_ok
    assert abs(rig.plane.roll_rad) < 0.01
    assert rig.height_m == pytest.approx(80.0, abs=3.0)
    rig.gps_conditions = GpsConditions()
    rig.run(60.0)
    assert math.hypot(*rig.ne_m) < 1000.0
    assert rig.autopilot.estimate.position_ok


def test_wind_carries_it_but_not_its_circle() -> None:
    rig = flying()
    rig.reposition(0.0, 0.0, 80.0, 100.0)
    rig.plane.wind_east_m_s = 6.0
    rig.run(60.0)
    distances_m, speeds_m_s = list[float](), list[float]()

    def watch() -> None:
        distances_m.append(math.hypot(*rig.ne_m))
        speeds_m_s.append(rig.speed_m_s)

    rig.run(60.0, watch)
    assert min(distances_m) > 75.0
    assert max(distances_m) < 150.0
    assert max(speeds_m_s) - min(speeds_m_s) == pytest.approx(12.0, abs=0.5)
