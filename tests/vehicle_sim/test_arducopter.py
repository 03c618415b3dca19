"""What ardupilot.md says of the real ArduCopter (2 to 5), and the law `ideal`, tried by values.

Tracking, stops and jumps are in test_tracking.py, how setpoints are read in test_setpoints.py, the
loss of GPS in test_estimator.py, fences in test_ardupilot_fence.py, recordings in conformance/.
"""

import cmath
import functools
import math
from collections.abc import Callable

import harness
import pytest
from harness import AUTO, BRAKE, COPTER_HOME, GUIDED, NAN, RTL, Vector, copied, limits
from rigs import ArduCopter, Rig, circling, hovering

from vehicle_sim.autopilot.values import Sender, Text
from vehicle_sim.dynamics.battery import Battery
from vehicle_sim.plans import Jumps, PlanItem, PlanKind

ACCEPTED, _, DENIED, UNSUPPORTED, FAILED = range(5)
STABILIZE, LOITER, ON_GROUND, LANDING, GROUND_M = 0, 5, 1, 4, COPTER_HOME[2]
item = functools.partial(harness.item, COPTER_HOME)
approx = pytest.approx


@copied
def booted(*, armed: bool = True) -> ArduCopter:
    """In GUIDED, or one that may be armed."""
    it = ArduCopter().run(42.5)
    if armed:
        assert [it.set_mode(GUIDED), it.command(400, 1)] == [ACCEPTED, ACCEPTED]
    return it


def climb(it: ArduCopter, metres: float, frame: int | None = None) -> int:
    return it.command(22, 0, 0, 0, 0, 0, 0, metres, frame=frame)


def follow(it: ArduCopter, from_m: float, speed_m_s: float, seconds: float) -> None:
    """A target that moves north, from there on, ten times a second."""
    for k in range(round(seconds * 10)):
        it.aim((from_m + 0.1 * k * speed_m_s, 0.0, -30.0), (speed_m_s, 0.0, 0.0))
        it.run(0.1)


def fastest_m_s(it: ArduCopter, seconds: float) -> float:
    speeds = list[float]()
    it.run(seconds, lambda: speeds.append(it.speed_m_s))
    return max(speeds)


def echo_m(it: ArduCopter) -> Vector:
    """Where it says that it is told to go: north, east, down."""
    place: Vector = it.autopilot.target_echo().position_ned_m
    return place


# --- commands -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "parameters", "result"),
    [
        *((176, (1, STABILIZE), ACCEPTED), (176, (0, GUIDED), DENIED), (176, (1, 99), FAILED)),
        *((176, (1, NAN), FAILED), (176, (NAN, 4), DENIED), (400, (7,), UNSUPPORTED)),
        (22, (0, 0, 0, 0, 0, 0, 30), FAILED),  # disarmed
        *((520, (1,), ACCEPTED), (410, (), FAILED), (179, (1,), FAILED)),  # there is no home yet
        *((207, (1,), ACCEPTED), (207, (7,), FAILED), (246, (1,), ACCEPTED)),
        (246, (0,), UNSUPPORTED),
        (20, (), ACCEPTED),  # a mode change, which is not checked while disarmed
        *((300, (), FAILED), (178, (1, 0), FAILED), (31000, (), UNSUPPORTED)),
        (192, (), UNSUPPORTED),
    ],
)
def test_every_command_is_answered_as_on_the_real_one(
    number: int, parameters: tuple[float, ...], result: int
) -> None:
    assert ArduCopter().command(number, *parameters) == result
    assert ArduCopter().command(400, 1, target_component=99) == UNSUPPORTED


def test_guided_is_had_without_a_position_but_armed_in_only_with_one() -> None:
    it = ArduCopter().run(30.0)
    assert it.set_mode(GUIDED) == ACCEPTED
    assert it.status.prearm_ok
    assert (it.command(400, 1), it.texts[-1]) == (FAILED, "Arm: Need Position Estimate")
    assert it.run(12.0).command(400, 1) == ACCEPTED
    assert it.status.base_mode == 217  # as ArduCopter's, armed in GUIDED
    assert it.until(lambda: not it.armed, within_s=20) == approx(10, abs=0.1)  # it stays idle


def test_a_setpoint_that_is_not_survived_is_told_once_and_it_stays() -> None:
    it = hovering()
    before = len(it.texts)
    assert len(it.stream(1.0, (NAN, 0.0, -30.0)).texts) == before + 1
    assert it.texts[-1].startswith("SIM:")
    assert it.run(5.0).ned_m == approx((0.0, 0.0, -30.0), abs=1.0)


def test_reposition_is_taken_as_command_int_only() -> None:
    it, there = hovering(), (-1, 1, 0, 0, 47.0005, 8.0, 50.0)
    assert [it.command(192, *there), it.set_mode(BRAKE)] == [UNSUPPORTED, ACCEPTED]
    assert it.command(192, -1, 0, *there[2:], frame=3) == DENIED
    assert (it.command(192, *there, frame=3), it.mode) == (ACCEPTED, "GUIDED")
    assert it.run(30.0).ned_m == approx((55.66, 0.0, -50.0), abs=0.5)


# --- take-off, landing, modes ---------------------------------------------------------------------


def test_take_off_fails_disarmed_in_stabilize_in_the_air_and_without_a_height() -> None:
    it = booted(armed=False)
    results = [it.set_mode(GUIDED), climb(it, 30.0), it.set_mode(STABILIZE)]
    results += [it.command(400, 1), climb(it, 30.0), climb(hovering(), 60.0)]
    assert results == [ACCEPTED, FAILED, ACCEPTED, ACCEPTED, FAILED, FAILED]
    it = booted()
    assert {climb(it, height_m) for height_m in (NAN, math.inf, 0.0, -5.0)} == {FAILED}
    assert [climb(it, 30.0, frame) for frame in (0, 5, 6, 3)] == [DENIED] * 3 + [ACCEPTED]


def test_a_setpoint_is_echoed_while_landed_and_ends_a_take_off() -> None:
    it = booted()
    it.aim((10.0, 0.0, -20.0))
    assert echo_m(it) == approx((10.0, 0.0, -20.0), abs=0.1)
    assert (it.run(5.0).height_m, it.status.landed_state) == (0.0, ON_GROUND)
    climb(it, 30.0)
    height_m = it.run(8.0).height_m
    assert 5.0 < height_m < 20.0
    it.aim((20.0, 0.0, -height_m))
    assert it.run(15.0).ned_m == approx((20.0, 0.0, -height_m), abs=0.5)


@pytest.mark.parametrize("mode", [STABILIZE, LOITER])
def test_without_a_pilot_the_modes_by_hand_come_down(mode: int) -> None:
    it = hovering()
    assert it.set_mode(mode) == ACCEPTED
    assert it.run(8.0).vehicle.velocity_up_m_s == approx(-2.5, abs=0.05)


def test_rtl_climbs_to_15_m_comes_home_tail_first_waits_and_lands() -> None:
    it = booted()
    climb(it, 5.0)
    it.run(10.0).aim((0.0, 111.0, -5.0))
    away_m, heading_rad = it.run(30.0).ned_m[1], it.vehicle.heading_rad
    assert heading_rad == approx(math.pi / 2, abs=0.05)  # it looks where it flies
    assert it.set_mode(RTL) == ACCEPTED
    it.until(lambda: it.height_m > 14.0, within_s=20)
    assert it.ned_m[1] == approx(away_m, abs=1.0)  # up first
    assert it.autopilot.target_echo() is None
    assert it.status.waypoint.place.altitude_amsl_m - GROUND_M == approx(15.0, abs=0.1)
    it.until(lambda: it.status.landed_state == LANDING, within_s=60.0)
    assert abs(it.ned_m[1]) < 2.0
    assert it.vehicle.heading_rad == approx(heading_rad, abs=0.1)
    it.until(lambda: not it.armed, within_s=60)
    assert abs(it.ned_m[1]) < 0.5


def test_brake_stops_and_ignores_setpoints() -> None:
    it = hovering(height_m=60.0)
    it.vehicle.velocity_m_s = 15.0 + 0j
    it.set_mode(BRAKE)
    it.aim((5000.0, 0.0, -60.0), (10.0, 0.0, 0.0))
    north_m = it.run(8.0).ned_m[0]
    assert north_m == approx(15.0**2 / (2 * 7.5), abs=3.0)
    assert it.run(5.0).ned_m[0] == approx(north_m, abs=0.05)
    assert it.autopilot.target_echo() is None


# --- failsafes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "parameter"), [(hovering, "FS_GCS_ENABLE"), (circling, "FS_GCS_ENABL")]
)
@pytest.mark.parametrize(("system", "acts"), [(254, True), (255, False)])
def test_a_ground_station_that_is_not_heard_for_4_9_s_sends_copter_and_plane_home(
    make: Callable[[], Rig], parameter: str, system: int, acts: bool
) -> None:
    """Whatever else is heard, and of whatever kind the one of its system id is."""
    it, other, station = make(), Sender(system, component=77), Sender(255, component=190)
    it.autopilot.parameters[parameter] = 1
    it.take(it.autopilot.on_heartbeat(station, 6))
    begun_s, before = it.now_s, len(it.texts)
    for _ in range(80):
        it.take(it.autopilot.on_heartbeat(other, 18))
        it.run(0.1)
    told = [at for at, reply in it.said if isinstance(reply, Text) and "GCS" in reply.text]
    assert told == ([approx(begun_s + 4.9, abs=0.2)] if acts else [])
    assert it.mode == ("RTL" if acts else "GUIDED")
    it.take(it.autopilot.on_heartbeat(station, 6))
    it.run(0.2)
    assert it.texts[before + acts :] == ["GCS Failsafe Cleared"] * acts
    assert it.mode == ("RTL" if acts else "GUIDED")


def test_a_low_battery_is_told_and_acted_on_after_ten_seconds() -> None:
    it = hovering()
    it.autopilot.battery = Battery(voltage_v=10.4, consumed_mah=2000.0)
    it.autopilot.parameters["BATT_LOW_VOLT"] = 10.5
    it.autopilot.parameters["BATT_FS_LOW_ACT"] = 2
    assert [it.run(seconds).mode for seconds in (9.8, 0.5)] == ["GUIDED", "RTL"]
    assert "Battery 1 is low 10.40V used 2000 mAh" in it.texts


# --- GUIDED ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("frame", [1, 7, 8, 9])
def test_a_place_in_a_local_frame(frame: int) -> None:
    it = hovering()
    it.aim((20.0, 10.0, -30.0))
    (north, east, down), yaw_rad = it.run(14.0).ned_m, it.vehicle.heading_rad
    assert abs(math.sin(2.0 * yaw_rad)) > 0.2
    it.aim((12.0, 4.0, -3.0), frame=frame)
    way = complex(12.0, 4.0)  # north and east
    if frame in (8, 9):
        way *= complex(math.cos(yaw_rad), math.sin(yaw_rad))
    wanted = (north + way.real, east + way.imag, down - 3.0)
    assert echo_m(it) == approx((12.0, 4.0, -3.0) if frame == 1 else wanted, abs=0.3)


@pytest.mark.parametrize("frame", [0, 5, 3, 6])
def test_a_place_in_a_global_frame_and_what_the_echo_says_of_it(frame: int) -> None:
    """ArduPilot's flat earth about the origin; metres for each 1e-7 degree: its Location.cpp."""
    it, scale, latitude_deg, longitude_deg = hovering(), 0.011131884502145034, 47.5, 8.6
    z_m = 40.0 + (GROUND_M if frame in (0, 5) else 0.0)
    it.aim((latitude_deg, longitude_deg, z_m), (1.0, 0.5, 0.0), frame=frame, is_global=True)
    north = (latitude_deg - 47.0) * 1e7 * scale
    east = (longitude_deg - 8.0) * 1e7 * scale * math.cos(math.radians((latitude_deg + 47.0) / 2))
    assert echo_m(it)[:2] == approx((north, east), abs=1.0)
    assert echo_m(it)[2] == approx(-40.0, abs=0.3)
    assert it.autopilot.target_echo().velocity_ned_m_s == (1.0, 0.5, 0.0)


def test_local_places_are_about_the_origin_also_when_home_is_moved() -> None:
    it, home = hovering(), (47.001, 8.0, GROUND_M + 20.0)
    assert it.command(179, 0, 0, 0, 0, *home, frame=0) == ACCEPTED
    it.aim((5.0, 0.0, -30.0))
    assert echo_m(it)[2] == approx(-30.0, abs=0.1)
    it.aim((47.0, 8.0, 30.0), frame=6, is_global=True)
    assert echo_m(it)[2] == approx(-50.0, abs=0.1)


def test_above_terrain_it_goes_down_without_data() -> None:
    it = hovering()
    it.aim((47.0005, 8.0, 30.0), frame=11, is_global=True)
    before_m = it.run(5.0).height_m
    assert (before_m - it.run(5.0).height_m) / 5.0 == approx(1.5, abs=0.1)
    assert it.ned_m[0] < 5.0


def test_a_change_of_speed_limits_a_place_alone_and_is_forgotten_with_the_submode() -> None:
    it = hovering()
    it.aim((300.0, 0.0, -30.0))
    assert it.command(178, 1, 3) == ACCEPTED
    assert fastest_m_s(it, 10.0) == approx(3.06, abs=0.1)
    follow(it, it.ned_m[0], 6.0, 8.0)
    assert it.command(178, 1, 3) == ACCEPTED
    follow(it, it.ned_m[0], 6.0, 5.0)
    assert it.speed_m_s == approx(6.0, abs=0.2)
    it.aim((300.0, 0.0, -30.0))
    assert fastest_m_s(it, 12.0) == approx(10.0, abs=0.6)


def test_an_acceleration_alone_is_flown_until_the_time_out() -> None:
    it = hovering().stream(3.0, None, None, (1.0, 0.0, 0.0))
    assert it.vehicle.velocity_m_s.real == approx(2.6, abs=0.4)
    assert it.autopilot.target_echo().type_mask == 0xC3F
    assert it.run(12.0).vehicle.velocity_m_s.real == approx(0.0, abs=0.1)


def test_up_down_and_along_have_speeds_of_their_own_and_the_slower_sets_the_pace() -> None:
    it = hovering()
    it.aim((40.0, 0.0, -50.0))
    it.until(lambda: it.height_m > 40.0)  # half of the way up at 2.5 m/s
    assert it.ned_m[0] == approx(20.0, abs=4.0)
    it.aim((140.0, 0.0, -56.0))
    it.until(lambda: it.ned_m[0] > 90.0)  # at 10 m/s 70 m of 120, and of 16 m up
    assert it.height_m == approx(40.0 + 16.0 * 70.0 / 120.0, abs=1.5)
    for kind, speed_m_s, down_m in ((2, 1.0, -70.0), (3, 0.5, -10.0)):
        it.aim((40.0, 0.0, down_m), (0.1, 0.0, 0.0))
        it.aim((40.0, 0.0, down_m))
        assert it.command(178, kind, speed_m_s) == ACCEPTED
        assert abs(it.run(6.0).vehicle.velocity_up_m_s) == approx(speed_m_s, abs=0.05)


def test_a_yaw_that_was_told_is_reset_by_a_setpoint_that_ignores_it() -> None:
    it = hovering()
    for asked, heading_deg in (((120, 0, 1, 0), 120.0), ((50, 0, -1, 1), 70.0)):
        assert it.command(115, *asked) == ACCEPTED
        assert math.degrees(it.run(5.0).vehicle.heading_rad) == approx(heading_deg, abs=1.0)
    it.stream(8.0, None, (0.0, 5.0, 0.0))
    assert math.degrees(it.vehicle.heading_rad) == approx(90.0, abs=3.0)


# --- AUTO -----------------------------------------------------------------------------------------


def on_mission(*items: PlanItem) -> ArduCopter:
    it = booted()
    it.plan(PlanKind.MISSION, item(16), *items)
    assert (it.command(300), it.status.mode) == (ACCEPTED, AUTO)
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
    seen, speeds, since_s = list[int](), list[float](), it.now_s
    while it.armed and it.now_s < since_s + 250.0:
        it.step()
        current = it.autopilot.route.current
        seen += [current] if seen[-1:] != [current] else []
        speeds += [it.speed_m_s] if current in (3, 4) else []
    assert seen == [1, 3, 4, 3, 4, 6]
    told = it.reached()
    assert [seq for _, seq in told] == [1, 3, 4, 3, 4]  # when it leaves: after 3 s at item 4
    assert told[2][0] - told[1][0] > 10.0 + 3.0  # 40 m at 4 m/s, and the wait
    assert max(speeds) == approx(4.0, abs=0.2)
    assert math.hypot(*it.ne_m) < 1.0


def test_a_landing_item_comes_down_where_it_says_and_the_current_item_can_be_set() -> None:
    it = on_mission(item(22, z_m=10.0), item(16, 300.0, 0.0, 10.0), item(21, 30.0, 20.0))
    it.until(lambda: it.autopilot.route.current == 2, within_s=60.0)
    assert [it.command(224, 9), it.command(224, 3)] == [FAILED, ACCEPTED]
    it.until(lambda: it.status.landed_state == LANDING)
    it.until(lambda: not it.armed, within_s=60.0)
    assert it.ne_m == approx((30.0, 20.0), abs=1.0)


def test_an_endless_jump_between_nothings_ends() -> None:
    forever = PlanItem(frame=0, command=177, parameters=(1.0, -1.0, 0.0, 0.0))
    assert len(list(Jumps(1).walk((item(16), forever), 1, 50))) == 50


# --- the law `ideal` ------------------------------------------------------------------------------


def test_ideal_follows_a_turn_of_9_m_s2_at_150_m_s_without_overshoot() -> None:
    """A straight line, then the turn: of 2.5 km, told ten times a second."""
    given = {"ANGLE_MAX": 8000.0, "WPNAV_SPEED_UP": 2500.0, "WPNAV_SPEED_DN": 2500.0}
    airframe = limits(170.0, 10.0, 25.0, 5.0)
    it = ArduCopter(ground_amsl_m=0.0, airframe=airframe, drag=False, **given).airborne(1000.0)
    speed, radius_m, straight_m = 150.0, 2500.0, 3000.0
    it.vehicle.velocity_m_s, copter = speed + 0j, it.vehicle
    turns_m_s2, off_m = list[float](), list[float]()
    for k in range(6000):
        flown_m = speed * k * 0.01
        turn_rad = max(flown_m - straight_m, 0.0) / radius_m
        way = cmath.rect(1.0, turn_rad)  # north + east j
        place = min(flown_m, straight_m) - radius_m * 1j * (way - 1.0)
        if k > 1000:
            off_m.append(abs(complex(*it.ne_m) - place))
            turn = copter.acceleration_m_s2 * copter.velocity_m_s.conjugate()
            turns_m_s2.append(turn.imag / it.speed_m_s)
        if k % 10 == 0:
            it.aim((place.real, place.imag, -1000.0), (speed * way.real, speed * way.imag, 0.0))
        it.step()
    assert 8.5 < max(turns_m_s2) <= 9.0 * 1.05
    assert 5.0 < max(off_m) <= 15.0
