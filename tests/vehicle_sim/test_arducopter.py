"""What ardupilot.md says of the real ArduCopter (2 to 5), and the law `ideal`, tried by values.

How setpoints are read is in test_setpoints.py, tracking, stops and jumps in test_tracking.py, the
loss of GPS in test_estimator.py, fences in test_ardupilot_fence.py, what was recorded in
conformance/.
"""

import copy
import functools
import math

import harness
import pytest
import tracked
from harness import (
    BRAKE,
    GUIDED,
    NAN,
    POSITION,
    POSITION_VELOCITY,
    VELOCITY,
    ZERO,
    Vector,
)
from pyproj import Geod
from tracked import GROUND_M, HOME_DEG
from tracked import ArduCopter as Flown

from vehicle_sim.autopilot.values import Battery, Sender, SendMessage
from vehicle_sim.dynamics.copter import Limits
from vehicle_sim.plans import Jumps, PlanItem, PlanKind

ACCEPTED, _, DENIED, UNSUPPORTED, FAILED = range(5)
STABILIZE, AUTO, RTL = 0, 3, 6
ON_GROUND, IN_AIR, TAKEOFF, LANDING = 1, 2, 3, 4


def hovering(lean_deg: float = 30.0) -> Flown:
    """In GUIDED, 30 m above home."""
    return tracked.airborne(lean_deg=lean_deg)


@functools.cache
def _booted() -> Flown:
    it = Flown()
    it.run(42.5)
    return it


def booted(*, arm: bool = False) -> Flown:
    """One that may be armed; in GUIDED then."""
    it = copy.deepcopy(_booted())
    if arm:
        assert [it.command(176, 1, GUIDED), it.command(400, 1)] == [ACCEPTED, ACCEPTED]
    return it


def climb(it: Flown, metres: float, frame: int | None = None) -> int:
    return it.command(22, 0, 0, 0, 0, 0, 0, metres, frame=frame)


def stream(it: Flown, seconds: float, *setpoint: Vector, mask: int) -> list[Vector]:
    """The same setpoint ten times a second; where it was."""
    track = []
    for _ in range(round(seconds * 10)):
        it.give(*setpoint, mask=mask)
        it.run(0.1)
        track.append(it.local_m())
    return track


def fly_north(it: Flown, speed_m_s: float, seconds: float, mask: int = POSITION_VELOCITY) -> float:
    """A target that gathers speed from above home; returns where it has come to."""
    north_m = 0.0
    for k in range(round(seconds * 10)):
        v = min(0.2 * k, speed_m_s)
        it.give((north_m, 0.0, -30.0), (v, 0.0, 0.0), mask=mask)
        it.run(0.1)
        north_m += 0.1 * v
    return north_m


def fastest_m_s(it: Flown, seconds: float) -> float:
    speeds = list[float]()
    it.run(seconds, lambda: speeds.append(it.speed_m_s))
    return max(speeds)


def landed_state(it: Flown) -> int:
    return int(it.autopilot.status().landed_state)


# --- commands -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "parameters", "fields", "result"),
    [
        (176, (1, STABILIZE), {}, ACCEPTED),
        (176, (0, GUIDED), {}, DENIED),
        (176, (1, 99), {}, FAILED),
        (176, (1, NAN), {}, FAILED),
        (176, (NAN, 4), {}, DENIED),
        (400, (7,), {}, UNSUPPORTED),
        (22, (0, 0, 0, 0, 0, 0, 30), {}, FAILED),  # disarmed
        (520, (1,), {}, ACCEPTED),
        (410, (), {}, FAILED),  # there is no home yet
        (179, (1,), {}, FAILED),
        (207, (1,), {}, ACCEPTED),
        (207, (7,), {}, FAILED),
        (246, (1,), {}, ACCEPTED),
        (246, (0,), {}, UNSUPPORTED),
        (20, (), {}, ACCEPTED),  # a mode change, which is not checked while disarmed
        (300, (), {}, FAILED),
        (178, (1, 0), {}, FAILED),
        (31000, (), {}, UNSUPPORTED),
        (192, (), {}, UNSUPPORTED),
        (400, (1,), {"target_component": 99}, UNSUPPORTED),
    ],
)
def test_every_command_is_answered_as_on_the_real_one(
    number: int, parameters: tuple[float, ...], fields: dict[str, int], result: int
) -> None:
    assert Flown().command(number, *parameters, **fields) == result


def test_guided_is_had_without_a_position_but_armed_in_only_with_one() -> None:
    it = Flown()
    it.run(30.0)
    assert it.command(176, 1, GUIDED) == ACCEPTED
    assert it.autopilot.status().prearm_ok
    assert it.command(400, 1) == FAILED
    assert it.texts[-1] == "Arm: Need Position Estimate"
    it.run(12.0)
    assert it.command(400, 1) == ACCEPTED
    assert it.autopilot.status().base_mode == 217  # as ArduCopter's, armed in GUIDED
    idle_s = it.run_until(lambda: not it.autopilot.armed, within_s=20)
    assert idle_s == pytest.approx(10, abs=0.1)


def test_disarming_in_flight_needs_force_and_is_the_end() -> None:
    it = hovering()
    assert it.command(400, 0) == FAILED
    assert it.command(400, 0, 21196) == ACCEPTED
    fell_s = it.run_until(lambda: it.height_m == 0.0, within_s=10)
    assert fell_s == pytest.approx(math.sqrt(2 * 30 / 9.80665), abs=0.1)


def test_reposition_is_taken_as_command_int_only() -> None:
    it = hovering()
    there = (-1, 1, 0, 0, 47.0005, 8.0, 50.0)
    assert it.command(192, *there) == UNSUPPORTED
    assert it.command(176, 1, BRAKE) == ACCEPTED
    assert it.command(192, -1, 0, *there[2:], frame=3) == DENIED
    assert it.command(192, *there, frame=3) == ACCEPTED
    assert it.autopilot.mode_name == "GUIDED"
    it.run(30.0)
    assert it.local_m() == pytest.approx((55.66, 0.0, 50.0), abs=0.5)


def test_a_setpoint_that_is_not_survived_is_told_once_and_it_stays() -> None:
    it = hovering()
    before = len(it.texts)
    stream(it, 1.0, (NAN, 0.0, -30.0), mask=POSITION)
    assert len(it.texts) == before + 1
    assert it.texts[-1].startswith("SIM:")
    it.run(5.0)
    assert it.local_m() == pytest.approx((0.0, 0.0, 30.0), abs=1.0)


# --- take-off, landing, modes ---------------------------------------------------------------------


def test_take_off_fails_disarmed_in_stabilize_in_the_air_and_without_a_height() -> None:
    it = booted()
    it.command(176, 1, GUIDED)
    assert climb(it, 30.0) == FAILED
    it.command(176, 1, STABILIZE)
    assert it.command(400, 1) == ACCEPTED
    assert climb(it, 30.0) == FAILED
    assert climb(hovering(), 60.0) == FAILED
    it = booted(arm=True)
    for height_m in (NAN, math.inf, 0.0, -5.0):
        assert climb(it, height_m) == FAILED
    for frame, result in ((0, DENIED), (5, DENIED), (6, DENIED), (3, ACCEPTED)):
        assert climb(it, 30.0, frame) == result


def test_take_off_is_5_m_high_after_4_6_s_and_30_m_after_17_s_and_ends_a_second_later() -> None:
    it = booted(arm=True)
    it.run(4.0)
    assert climb(it, 30.0) == ACCEPTED
    took_s = it.run_until(lambda: it.height_m > 5.0, within_s=9.0)
    assert took_s == pytest.approx(4.6, abs=0.4)
    fastest, begun_s = 0.0, it.now_s - took_s
    while it.height_m < 29.7:
        it.step()
        fastest = max(fastest, it.copter.velocity_up_m_s)
    assert it.now_s - begun_s == pytest.approx(17.0, abs=1.5)
    assert fastest == pytest.approx(2.5, abs=0.15)
    assert landed_state(it) == TAKEOFF
    ended_s = it.run_until(lambda: landed_state(it) == IN_AIR, within_s=5.0)
    assert ended_s == pytest.approx(1.0, abs=0.5)


def test_a_setpoint_is_echoed_while_landed_and_ends_a_take_off() -> None:
    it = booted(arm=True)
    it.give((10.0, 0.0, -20.0), mask=POSITION)
    assert it.autopilot.target_echo().position_ned_m == pytest.approx((10.0, 0.0, -20.0), abs=0.1)
    it.run(5.0)
    assert (it.height_m, landed_state(it)) == (0.0, ON_GROUND)
    climb(it, 30.0)
    it.run(8.0)
    height_m = it.height_m
    assert 5.0 < height_m < 20.0
    it.give((20.0, 0.0, -height_m), mask=POSITION)
    it.run(15.0)
    assert it.local_m() == pytest.approx((20.0, 0.0, height_m), abs=0.5)


def test_a_gust_that_presses_it_down_ends_no_take_off() -> None:
    it = Flown()
    it.copter.wind_up_m_s = -1.0
    assert it.airborne(10.0).height_m == pytest.approx(10.0, abs=1.0)


@pytest.mark.parametrize("mode", [0, 2, 5, 16])  # STABILIZE, ALT_HOLD, LOITER, POSHOLD
def test_without_a_pilot_the_modes_by_hand_come_down(mode: int) -> None:
    it = hovering()
    assert it.command(176, 1, mode) == ACCEPTED
    it.run(8.0)
    assert it.copter.velocity_up_m_s == pytest.approx(-2.5, abs=0.05)


def test_rtl_climbs_to_15_m_comes_home_waits_and_lands() -> None:
    it = booted(arm=True)
    climb(it, 5.0)
    it.run(10.0)
    it.give((111.0, 0.0, -5.0), mask=POSITION)
    it.run(30.0)
    away_m = it.local_m()[0]
    assert it.command(176, 1, RTL) == ACCEPTED
    it.run_until(lambda: it.height_m > 14.0, within_s=20)
    assert it.local_m()[0] == pytest.approx(away_m, abs=1.0)  # up first
    assert it.autopilot.target_echo() is None
    waypoint = it.autopilot.status().waypoint
    assert waypoint.place.altitude_amsl_m - GROUND_M == pytest.approx(15.0, abs=0.1)
    it.run_until(lambda: landed_state(it) == LANDING, within_s=60)
    assert abs(it.local_m()[0]) < 2.0
    it.run_until(lambda: not it.autopilot.armed, within_s=60)
    assert abs(it.local_m()[0]) < 0.5


@pytest.mark.parametrize(("behaviour", "looks_home"), [(1.0, True), (2.0, False), (0.0, False)])
def test_on_its_way_home_the_nose_looks_where_the_parameter_says(
    behaviour: float, looks_home: bool
) -> None:
    it = hovering()
    it.autopilot.parameters["WP_YAW_BEHAVIOR"] = behaviour
    it.give((0.0, 60.0, -30.0), mask=POSITION)
    it.run(15.0)
    before_rad = it.copter.heading_rad
    assert before_rad == pytest.approx(math.pi / 2 if behaviour else 0.0, abs=0.05)
    it.command(176, 1, RTL)
    it.run(10.0)
    turned_rad = abs(math.remainder(it.copter.heading_rad - before_rad, math.tau))
    assert turned_rad == pytest.approx(math.pi if looks_home else 0.0, abs=0.1)


def test_brake_stops_and_ignores_setpoints() -> None:
    it = tracked.airborne(height_m=60.0)
    it.copter.velocity_north_m_s = 15.0
    it.command(176, 1, BRAKE)
    it.give((5000.0, 0.0, -60.0), (10.0, 0.0, 0.0), mask=POSITION_VELOCITY)
    it.run(8.0)
    north_m = it.local_m()[0]
    assert north_m == pytest.approx(15.0**2 / (2 * 7.5), abs=3.0)
    it.run(5.0)
    assert it.local_m()[0] == pytest.approx(north_m, abs=0.05)
    assert it.autopilot.target_echo() is None


# --- failsafes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("system", "acts"), [(254, True), (255, False)])
def test_a_ground_station_that_is_not_heard_for_4_9_s_sends_it_home(
    system: int, acts: bool
) -> None:
    """Whatever else is heard, and of whatever kind the one of its system id is."""
    it = hovering()
    it.autopilot.parameters["FS_GCS_ENABLE"] = 1
    it.take(it.autopilot.on_heartbeat(Sender(system=255, component=190), 6))
    begun_s = it.now_s
    other = Sender(system=system, component=77)
    for _ in range(80):
        it.take(it.autopilot.on_heartbeat(other, 18))
        it.run(0.1)
    said = it.when("GCS Failsafe")
    assert said == ([pytest.approx(begun_s + 4.9, abs=0.2)] if acts else [])
    assert it.autopilot.mode_name == ("RTL" if acts else "GUIDED")


def test_a_low_battery_is_told_and_acted_on_after_ten_seconds() -> None:
    it = hovering()
    it.autopilot.battery = Battery(voltage_v=10.4, consumed_mah=2000.0)
    it.autopilot.parameters["BATT_LOW_VOLT"] = 10.5
    it.autopilot.parameters["BATT_FS_LOW_ACT"] = 2
    it.run(9.8)
    assert it.autopilot.mode_name == "GUIDED"
    it.run(0.5)
    assert it.autopilot.mode_name == "RTL"
    assert "Battery 1 is low 10.40V used 2000 mAh" in it.texts


# --- GUIDED ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("frame", [1, 7, 8, 9])
def test_a_place_in_a_local_frame(frame: int) -> None:
    it = hovering()
    it.give((20.0, 10.0, -30.0), mask=POSITION)
    it.run(14.0)
    (north, east, up), yaw_rad = it.local_m(), it.copter.heading_rad
    assert abs(math.sin(2.0 * yaw_rad)) > 0.2
    it.give((12.0, 4.0, -3.0), mask=POSITION, frame=frame)
    sine, cosine = math.sin(yaw_rad), math.cos(yaw_rad)
    wanted = {1: (12.0, 4.0, -3.0), 7: (north + 12.0, east + 4.0, -up - 3.0)}.get(
        frame,
        (north + 12.0 * cosine - 4.0 * sine, east + 12.0 * sine + 4.0 * cosine, -up - 3.0),
    )
    assert it.autopilot.target_echo().position_ned_m == pytest.approx(wanted, abs=0.3)


@pytest.mark.parametrize("frame", [0, 5, 3, 6])
def test_a_place_in_a_global_frame_and_what_the_echo_says_of_it(frame: int) -> None:
    """ArduPilot's flat earth about the origin; metres for each 1e-7 degree: its Location.cpp."""
    it, scale = hovering(), 0.011131884502145034
    latitude_deg, longitude_deg = 47.5, 8.6
    z_m = 40.0 + (GROUND_M if frame in (0, 5) else 0.0)
    place = (latitude_deg, longitude_deg, z_m)
    it.give(place, (1.0, 0.5, 0.0), mask=POSITION_VELOCITY, frame=frame, is_global=True)
    north = (latitude_deg - 47.0) * 1e7 * scale
    east = (longitude_deg - 8.0) * 1e7 * scale * math.cos(math.radians((latitude_deg + 47.0) / 2))
    echo = it.autopilot.target_echo()
    assert echo.position_ned_m[:2] == pytest.approx((north, east), abs=1.0)
    assert echo.position_ned_m[2] == pytest.approx(-40.0, abs=0.3)
    assert echo.velocity_ned_m_s == (1.0, 0.5, 0.0)


@pytest.mark.parametrize("frame", [10, 11])
def test_above_terrain_it_goes_down_without_data(frame: int) -> None:
    it = hovering()
    it.give((47.0005, 8.0, 30.0), mask=POSITION, frame=frame, is_global=True)
    it.run(5.0)
    before_m = it.height_m
    it.run(5.0)
    assert (before_m - it.height_m) / 5.0 == pytest.approx(1.5, abs=0.1)
    assert it.local_m()[0] < 5.0


def test_local_places_are_about_the_origin_also_when_home_is_moved() -> None:
    it = hovering()
    home = (47.001, 8.0, GROUND_M + 20.0)
    assert it.command(179, 0, 0, 0, 0, *home, frame=0) == ACCEPTED
    for place, is_global, down_m in (
        ((5.0, 0.0, -30.0), False, -30.0),
        ((47.0, 8.0, 30.0), True, -50.0),
    ):
        it.give(place, mask=POSITION, frame=6 if is_global else 1, is_global=is_global)
        assert it.autopilot.target_echo().position_ned_m[2] == pytest.approx(down_m, abs=0.1)


def test_a_change_of_speed_limits_a_place_alone_and_is_forgotten_with_the_submode() -> None:
    it = hovering()
    it.give((300.0, 0.0, -30.0), mask=POSITION)
    assert it.command(178, 1, 3) == ACCEPTED
    assert fastest_m_s(it, 10.0) == pytest.approx(3.06, abs=0.1)
    it.give((60.0, 0.0, -30.0), (3.0, 0.0, 0.0), mask=POSITION_VELOCITY)
    it.run(0.1)
    it.give((300.0, 0.0, -30.0), mask=POSITION)
    assert fastest_m_s(it, 12.0) == pytest.approx(10.0, abs=0.6)
    it = hovering()
    fly_north(it, 6.0, 12.0)
    it.command(178, 1, 3)
    north_m = it.local_m()[0]
    for k in range(50):
        it.give((north_m + 0.6 * k, 0.0, -30.0), (6.0, 0.0, 0.0), mask=POSITION_VELOCITY)
        it.run(0.1)
    assert it.speed_m_s == pytest.approx(6.0, abs=0.2)


def test_up_down_and_along_have_speeds_of_their_own_and_the_slower_sets_the_pace() -> None:
    it = hovering(45.0)
    it.give((40.0, 0.0, -50.0), mask=POSITION)
    it.run_until(lambda: it.height_m > 40.0)  # half of the way up at 2.5 m/s
    assert it.local_m()[0] == pytest.approx(20.0, abs=4.0)
    it.give((140.0, 0.0, -56.0), mask=POSITION)
    it.run_until(lambda: it.local_m()[0] > 90.0)  # at 10 m/s 70 m of 120, and of 16 m up
    assert it.height_m == pytest.approx(40.0 + 16.0 * 70.0 / 120.0, abs=1.5)
    for kind, speed_m_s, down_m in ((2, 1.0, -70.0), (3, 0.5, -10.0)):
        it.give((40.0, 0.0, down_m), (0.1, 0.0, 0.0), mask=POSITION_VELOCITY)
        it.give((40.0, 0.0, down_m), mask=POSITION)
        assert it.command(178, kind, speed_m_s) == ACCEPTED
        it.run(6.0)
        assert abs(it.copter.velocity_up_m_s) == pytest.approx(speed_m_s, abs=0.05)


def test_a_setpoint_of_nothing_stops_it_from_5_m_s_as_measured() -> None:
    """4.3, 2.9 and 1.4 m/s after 1, 2 and 3 s; streamed, each one begins the stop anew."""
    it, speeds = hovering(45.0), list[float]()
    fly_north(it, 5.0, 14.0)
    for _ in range(3):
        stream(it, 1.0, ZERO, mask=0xFFF)
        speeds.append(it.speed_m_s)
    assert speeds == pytest.approx([4.3, 2.9, 1.4], abs=0.35)


def test_an_acceleration_alone_is_flown_until_the_time_out() -> None:
    it = hovering()
    stream(it, 3.0, ZERO, ZERO, (1.0, 0.0, 0.0), mask=0xC3F)
    assert it.copter.velocity_north_m_s == pytest.approx(2.6, abs=0.4)
    assert it.autopilot.target_echo().type_mask == 0xC3F
    it.run(12.0)
    assert it.copter.velocity_north_m_s == pytest.approx(0.0, abs=0.1)


def test_a_yaw_that_was_told_is_reset_by_a_setpoint_that_ignores_it() -> None:
    it = hovering()
    assert it.command(115, 120, 0, 1, 0) == ACCEPTED
    it.run(5.0)
    assert math.degrees(it.copter.heading_rad) == pytest.approx(120.0, abs=1.0)
    assert it.command(115, 50, 0, -1, 1) == ACCEPTED
    it.run(5.0)
    assert math.degrees(it.copter.heading_rad) == pytest.approx(70.0, abs=1.0)
    stream(it, 8.0, ZERO, (0.0, 5.0, 0.0), mask=VELOCITY)
    assert math.degrees(it.copter.heading_rad) == pytest.approx(90.0, abs=3.0)


# --- AUTO -----------------------------------------------------------------------------------------

item = functools.partial(harness.item, HOME_DEG)


def on_mission(*items: PlanItem) -> Flown:
    it = booted(arm=True)
    it.autopilot.plans[PlanKind.MISSION] = (item(16), *items)
    it.autopilot.on_plan(PlanKind.MISSION)
    assert it.command(300) == ACCEPTED
    assert it.autopilot.mode_name == "AUTO"
    return it


def test_a_mission_is_flown_from_take_off_to_landing() -> None:
    it = on_mission(
        item(22, z_m=20.0),
        item(178, 0, 0, 0, 1.0, 4.0),
        item(16, 60.0, 0.0, 25.0),
        item(16, 60.0, 40.0, 25.0, 3.0),
        PlanItem(frame=0, command=177, parameters=(3.0, 1.0, 0.0, 0.0)),
        item(20),
    )
    seen = list[int]()
    fastest, since_s = 0.0, it.now_s
    while it.autopilot.armed and it.now_s < since_s + 250.0:
        it.step()
        current = it.autopilot.route.current
        seen += [current] if not seen or seen[-1] != current else []
        if current in (3, 4):
            fastest = max(fastest, it.speed_m_s)
    assert seen == [1, 3, 4, 3, 4, 6]
    told = [(at, reply.message.seq) for at, reply in it.said if isinstance(reply, SendMessage)]
    assert [seq for _, seq in told] == [1, 3, 4, 3, 4]  # when it leaves: after 3 s at item 4
    assert told[2][0] - told[1][0] > 10.0 + 3.0  # 40 m at 4 m/s, and the wait
    assert fastest == pytest.approx(4.0, abs=0.2)
    assert math.hypot(*it.local_m()[:2]) < 1.0


def test_a_landing_item_comes_down_where_it_says_and_the_current_item_can_be_set() -> None:
    it = on_mission(item(22, z_m=10.0), item(16, 300.0, 0.0, 10.0), item(21, 30.0, 20.0))
    it.run_until(lambda: it.autopilot.route.current == 2, within_s=60.0)
    assert it.command(224, 9) == FAILED
    assert it.command(224, 3) == ACCEPTED
    it.run_until(lambda: landed_state(it) == LANDING, within_s=60.0)
    it.run_until(lambda: not it.autopilot.armed, within_s=60.0)
    assert it.local_m()[:2] == pytest.approx((30.0, 20.0), abs=1.0)


def test_an_endless_jump_between_nothings_ends() -> None:
    forever = PlanItem(frame=0, command=177, parameters=(1.0, -1.0, 0.0, 0.0))
    assert len(list(Jumps(1).walk((item(16), forever), 1, 50))) == 50


# --- the law `ideal` ------------------------------------------------------------------------------

WGS84 = Geod(ellps="WGS84")
FICTIONAL = Limits(
    speed_m_s=170.0,
    acceleration_m_s2=10.0,
    speed_vertical_m_s=25.0,
    acceleration_vertical_m_s2=5.0,
)


def fictional() -> Flown:
    """Without drag, 1 km up."""
    given = {"ANGLE_MAX": 8000.0, "WPNAV_SPEED_UP": 2500.0, "WPNAV_SPEED_DN": 2500.0}
    return Flown(0.0, FICTIONAL, drag=False, **given).airborne(1000.0)


def tell(it: Flown, north_m: float, east_m: float, up_m: float, *v: float) -> None:
    """A place and a velocity, as GLOBAL_INT above the sea."""
    azimuth_deg = math.degrees(math.atan2(east_m, north_m))
    longitude_deg, latitude_deg, _ = WGS84.fwd(
        *(8.0, 47.0, azimuth_deg, math.hypot(north_m, east_m))
    )
    place, velocity = (latitude_deg, longitude_deg, up_m), (v[0], v[1], v[2])
    it.give(place, velocity, mask=POSITION_VELOCITY, frame=5, is_global=True)


@pytest.mark.sample(2)
@pytest.mark.parametrize("every_steps", [10, 5])
def test_a_turn_of_9_m_s2_at_150_m_s_is_entered_without_overshoot_and_followed(
    every_steps: int,
) -> None:
    it, speed, radius_m, ramp_s = fictional(), 150.0, 2500.0, 40.0
    straight_m = speed * ramp_s / 2 + speed * 20.0  # to full speed, straight on, then the turn
    most_m_s2, worst_m, copter = 0.0, 0.0, it.copter
    for k in range(12_000):
        t = k * 0.01
        v = min(t / ramp_s, 1.0) * speed
        flown_m = 0.5 * t * v if t < ramp_s else speed * (t - 0.5 * ramp_s)
        turn_rad = max(flown_m - straight_m, 0.0) / radius_m
        north = min(flown_m, straight_m) + radius_m * math.sin(turn_rad)
        east = radius_m * (1 - math.cos(turn_rad))
        if t > ramp_s + 10:
            azimuth_deg, _, away_m = WGS84.inv(8.0, 47.0, copter.longitude_deg, copter.latitude_deg)
            azimuth_rad = math.radians(azimuth_deg)
            is_n, is_e = away_m * math.cos(azimuth_rad), away_m * math.sin(azimuth_rad)
            worst_m = max(worst_m, math.hypot(is_n - north, is_e - east))
            cross = copter.acceleration_east_m_s2 * copter.velocity_north_m_s
            cross -= copter.acceleration_north_m_s2 * copter.velocity_east_m_s
            most_m_s2 = max(most_m_s2, cross / it.speed_m_s)
        if k % every_steps == 0:
            tell(it, north, east, 1000.0, v * math.cos(turn_rad), v * math.sin(turn_rad), 0.0)
        it.step()
    assert most_m_s2 <= 9.0 * 1.05
    assert 5.0 < worst_m <= 15.0


def test_a_stream_with_climb_is_followed_in_height_too() -> None:
    it = fictional()
    for k in range(3000):
        t = k * 0.01
        if k % 10 == 0:
            height = 1000.0 + (t * t / 2 if t < 10 else 50 + 10 * (t - 10))
            tell(it, 0.0, 0.0, height, 0.0, 0.0, -min(t, 10.0))
        it.step()
    assert it.height_m == pytest.approx(1250.0, abs=0.3)
