"""What ardupilot.md says of ArduCopter (2 to 5) and ArduPlane (7), and the law `ideal`.

Arming, missions and failsafes are in test_firmwares.py, tracking in test_tracking.py, how setpoints
are read in test_setpoints.py, the loss of GPS in test_estimator.py, recorded flights in
conformance/.
"""

import cmath
import math
from collections.abc import Sequence

import pytest
from harness import COPTER_HOME, NAN, Rig, Vector, circling, hovering, item

from vehicle_sim.autopilot.earth import FlatEarth
from vehicle_sim.autopilot.guards import Fence
from vehicle_sim.autopilot.values import Place
from vehicle_sim.plans import PlanItem, PlanKind

ACCEPTED, _, DENIED, UNSUPPORTED, FAILED = range(5)
TAKEOFF, LANDING = 3, 4
"""MAV_LANDED_STATE."""
REPOSITION, CHANGE_SPEED, CHANGE_HEADING = 192, 43000, 43002
GROUND_M = COPTER_HOME[2]
approx = pytest.approx

# --- ArduCopter: commands and modes ---------------------------------------------------------------


def fastest_m_s(it: Rig, seconds: float) -> float:
    speeds = list[float]()
    it.run(seconds, lambda: speeds.append(it.speed_m_s))
    return max(speeds)


def echo_m(it: Rig) -> Vector:
    """Where it says that it is told to go: north, east, down."""
    place: Vector = it.autopilot.target_echo().position
    return place


@pytest.mark.parametrize(
    ("number", "parameters", "result"),
    [
        *((176, (1, 0), ACCEPTED), (176, (0, 4), DENIED), (176, (1, 99), FAILED)),
        *((176, (1, NAN), FAILED), (176, (NAN, 4), DENIED), (400, (7,), UNSUPPORTED)),
        (22, (0, 0, 0, 0, 0, 0, 30), FAILED),  # disarmed
        *((520, (1,), ACCEPTED), (410, (), FAILED), (179, (1,), FAILED)),  # there is no home yet
        *((207, (1,), ACCEPTED), (207, (7,), FAILED), (246, (1,), ACCEPTED), (224, (NAN,), FAILED)),
        (246, (0,), UNSUPPORTED),
        (20, (), ACCEPTED),  # a mode change, which is not checked while disarmed
        *((300, (), FAILED), (178, (1, 0), FAILED), (31000, (), UNSUPPORTED)),
        (192, (), UNSUPPORTED),
    ],
)
def test_every_command_is_answered_as_on_the_real_one(
    number: int, parameters: tuple[float, ...], result: int
) -> None:
    assert Rig().command(number, *parameters) == result


def test_take_off_needs_a_height_above_home_goes_up_as_measured_and_a_setpoint_ends_it() -> None:
    it = Rig().armable()
    assert [it.set_mode("GUIDED"), it.arm()] == [ACCEPTED, ACCEPTED]
    it.run(4.0)
    for height_m in (NAN, math.inf, 0.0, -5.0):
        assert it.command(22, *[0.0] * 6, height_m) == FAILED
    for frame, result in ((0, DENIED), (5, DENIED), (6, DENIED), (3, ACCEPTED)):
        assert it.command(22, 0, 0, 0, 0, 0, 0, 30.0, frame=frame) == result
    assert it.until(lambda: it.height_m > 5.0) == approx(4.6, abs=0.4)
    ended = it.copy()
    ended.aim((20.0, 0.0, -ended.height_m))
    assert ended.run(15.0).ned_m == approx((20.0, 0.0, -5.0), abs=0.5)
    assert it.until(lambda: it.height_m > 29.7) == approx(17.0 - 4.6, abs=1.5)
    assert it.status.landed_state == TAKEOFF
    assert it.until(lambda: it.status.landed_state != TAKEOFF) == approx(1.0, abs=0.5)
    assert it.command(22, *[0.0] * 6, 60.0) == FAILED


@pytest.mark.parametrize("mode", ["STABILIZE", "LOITER"])
def test_without_a_pilot_the_modes_by_hand_come_down(mode: str) -> None:
    it = hovering()
    assert it.set_mode(mode) == ACCEPTED
    assert it.run(8.0).vehicle.velocity_up_m_s == approx(-2.5, abs=0.05)


def test_rtl_climbs_to_15_m_comes_home_tail_first_waits_and_lands() -> None:
    it = hovering(5.0)
    it.aim((0.0, 111.0, -5.0))
    away_m, heading_rad = it.run(30.0).ned_m[1], it.vehicle.heading_rad
    assert heading_rad == approx(math.pi / 2, abs=0.05)  # it looks where it flies
    assert it.set_mode("RTL") == ACCEPTED
    it.until(lambda: it.height_m > 14.0, within_s=20)
    assert it.ned_m[1] == approx(away_m, abs=1.0)  # up first
    assert it.status.waypoint.place.altitude_amsl_m - GROUND_M == approx(15.0, abs=0.1)
    it.until(lambda: it.status.landed_state == LANDING, within_s=60.0)
    assert abs(it.ned_m[1]) < 2.0
    assert it.vehicle.heading_rad == approx(heading_rad, abs=0.1)
    it.until(lambda: not it.armed, within_s=60)
    assert abs(it.ned_m[1]) < 0.5


def test_a_return_over_home_takes_1_55_s_for_climbing_and_for_going_home_and_waits() -> None:
    it = hovering(20.0)
    assert it.set_mode("RTL") == ACCEPTED
    lands_s = it.until(lambda: it.status.landed_state == LANDING, within_s=20.0)
    assert lands_s == approx(1.55 + 1.55 + 5.0, abs=0.1)  # RTL_LOIT_TIME


def test_brake_stops_and_ignores_setpoints() -> None:
    it = hovering(60.0)
    it.vehicle.velocity_m_s = 15.0 + 0j
    it.set_mode("BRAKE")
    it.aim((5000.0, 0.0, -60.0), (10.0, 0.0, 0.0))
    north_m = it.run(8.0).ned_m[0]
    assert north_m == approx(15.0**2 / (2 * 7.5), abs=3.0)
    assert it.run(5.0).ned_m[0] == approx(north_m, abs=0.05)
    assert it.autopilot.target_echo() is None


# --- ArduCopter: GUIDED ---------------------------------------------------------------------------


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
    for place, answer in (((NAN, 8.0, 0.0), FAILED), (home, ACCEPTED)):
        assert it.command(179, 0, 0, 0, 0, *place, frame=0) == answer
    it.aim((5.0, 0.0, -30.0))
    assert echo_m(it)[2] == approx(-30.0, abs=0.1)
    it.aim((47.0, 8.0, 30.0), frame=6, is_global=True)
    assert echo_m(it)[2] == approx(-50.0, abs=0.1)


def test_a_change_of_speed_limits_a_place_alone_and_is_forgotten_with_the_submode() -> None:
    it = hovering()
    it.aim((300.0, 0.0, -30.0))
    assert it.command(178, 1, 3) == ACCEPTED
    assert fastest_m_s(it, 10.0) == approx(3.06, abs=0.1)
    begins_m = it.ned_m[0]
    for k in range(80):  # a target that moves
        it.aim((begins_m + 0.6 * k, 0.0, -30.0), (6.0, 0.0, 0.0))
        it.run(0.1)
    assert it.speed_m_s == approx(6.0, abs=0.2)
    it.aim((500.0, 0.0, -30.0))
    assert fastest_m_s(it, 12.0) == approx(10.0, abs=0.6)


@pytest.mark.parametrize(("kind", "up_m", "speed_m_s"), [(2.0, 80.0, 1.0), (3.0, 10.0, 0.7)])
def test_speeds_up_and_down_are_asked_for_by_themselves(
    kind: float, up_m: float, speed_m_s: float
) -> None:
    it = hovering()
    it.aim((0.0, 0.0, -up_m))
    assert it.command(178, kind, speed_m_s) == ACCEPTED
    assert abs(it.run(6.0).vehicle.velocity_up_m_s) == approx(speed_m_s, abs=0.1)


def test_an_acceleration_alone_is_flown_until_the_time_out() -> None:
    it = hovering().stream(3.0, None, None, (1.0, 0.0, 0.0))
    assert it.vehicle.velocity_m_s.real == approx(2.6, abs=0.4)
    assert it.autopilot.target_echo().type_mask == 0xC3F
    assert it.run(12.0).vehicle.velocity_m_s.real == approx(0.0, abs=0.1)


def test_a_yaw_that_was_told_is_reset_by_a_setpoint_that_ignores_it() -> None:
    it = hovering()
    for asked, heading_deg in (((120, 0, 1, 0), 120.0), ((50, 0, -1, 1), 70.0)):
        assert it.command(115, *asked) == ACCEPTED
        assert math.degrees(it.run(5.0).vehicle.heading_rad) == approx(heading_deg, abs=1.0)
    it.stream(8.0, None, (0.0, 5.0, 0.0))
    assert math.degrees(it.vehicle.heading_rad) == approx(90.0, abs=3.0)


def test_ideal_follows_a_turn_of_9_m_s2_at_150_m_s_without_overshoot() -> None:
    """A straight line, then the turn: of 2.5 km, told ten times a second."""
    able = {"speed_max_m_s": 170.0, "acceleration_max_m_s2": 10.0}
    able |= {"speed_vertical_max_m_s": 25.0, "acceleration_vertical_max_m_s2": 5.0}
    it = Rig("ideal", **able).take_off(1000.0)
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


# --- ArduPlane ------------------------------------------------------------------------------------


def test_nothing_but_take_off_and_auto_leaves_the_ground() -> None:
    rig = Rig("ardupilot", "plane").armable()
    assert rig.arm() == ACCEPTED
    assert {rig.set_mode(of_quadplanes) for of_quadplanes in (17, 19, 21, 99)} == {FAILED}
    for mode in ("MANUAL", "FBWA", "LOITER", "RTL", "GUIDED"):
        assert rig.set_mode(mode) == ACCEPTED
        assert rig.command(22, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 30.0) == FAILED
        rig.run(5.0)
    assert rig.reposition(500.0, 0.0, 50.0) == ACCEPTED
    assert rig.run(10.0).speed_m_s == 0.0


def test_orders_that_are_no_place_speed_or_course_or_come_out_of_guided_are_denied() -> None:
    rig = circling()
    place = (*rig.place(300.0, 0.0, 0.0)[:2], 90.0)
    assert rig.command(REPOSITION, -1.0, 1.0, 0.0, 0.0, *place) == UNSUPPORTED  # no COMMAND_INT
    for frame, result in (*((f, ACCEPTED) for f in (0, 3, 5, 6, 10, 11)), (1, DENIED)):
        assert rig.command(REPOSITION, 5.0, 0.0, 0.0, 0.0, *place, frame=frame) == result
    for bad in ((95.0, 0.0, 90.0), (0.0, 190.0, 90.0), (0.0, 0.0, 90.0), (*place[:2], NAN)):
        assert rig.command(REPOSITION, -1.0, 1.0, 0.0, 0.0, *bad, frame=3) == DENIED
    assert rig.texts()[-1].startswith("SIM:")  # what the real one does not survive
    for wrong in ((1.0, 20.0), (0.0, 9.0), (0.0, 31.0), (0.0, NAN)):
        assert rig.command(CHANGE_SPEED, *wrong) == DENIED
    for wrong in ((0.0, 360.0), (3.0, 90.0), (0.0, NAN)):
        assert rig.command(CHANGE_HEADING, *wrong, 3.0) == DENIED
    rig.set_mode("LOITER")
    for number, value in ((CHANGE_SPEED, 20.0), (178, 20.0), (CHANGE_HEADING, 90.0)):
        assert rig.command(number, 0.0, value, 3.0) == FAILED
    for changes_mode, result, mode in ((0.0, FAILED, "LOITER"), (1.0, ACCEPTED, "GUIDED")):
        given = (-1.0, changes_mode, 0.0, 0.0, *place)
        assert (rig.command(REPOSITION, *given, frame=3), rig.mode) == (result, mode)


@pytest.mark.parametrize(("asked_m", "flown_m", "ccw"), [(40.0, 60.0, 0.0), (80.0, 97.0, 1.0)])
def test_a_circle_is_wider_than_asked_by_what_was_measured(
    asked_m: float, flown_m: float, ccw: float
) -> None:
    rig, places = circling(), list[complex]()
    assert rig.reposition(0.0, 0.0, 80.0, asked_m, ccw) == ACCEPTED
    rig.run(40.0).run(15.0, lambda: places.append(complex(*rig.ne_m)))
    assert sum(map(abs, places)) / len(places) == approx(flown_m, abs=3.0)
    assert ((places[100] / places[0]).imag < 0.0) is bool(ccw)


@pytest.mark.parametrize(("asked_m_s", "flown_m_s"), [(18.0, 18.9), (25.0, 27.7)])
def test_a_speed_is_flown_as_measured(asked_m_s: float, flown_m_s: float) -> None:
    rig = circling()
    assert rig.command(178, 0.0, 19.0) == ACCEPTED
    assert rig.run(30.0).speed_m_s == approx(19.9, abs=0.3)
    assert rig.command(CHANGE_SPEED, 0.0, asked_m_s) == ACCEPTED
    assert rig.run(30.0).speed_m_s == approx(flown_m_s, abs=0.3)
    assert rig.autopilot.airspeed_m_s() == approx(asked_m_s, abs=0.1)
    rig.set_mode("LOITER")
    assert rig.run(30.0).speed_m_s == approx(23.45, abs=0.3)


def test_of_setpoints_only_heights_are_taken_and_increments_add_up() -> None:
    rig, place = circling(90.0), (10.0, 10.0)
    rig.aim((*place, 90.0), frame=6, is_global=True)
    for _ in range(5):
        rig.aim((0.0, 0.0, -1.0), frame=7)
    assert rig.run(40.0).height_m == approx(95.0, abs=1.0)
    assert math.hypot(*rig.ne_m) < 150.0
    rig.aim((*place, 50.0), mask=0xDFC, frame=6, is_global=True)
    rig.aim((*place, 50.0), frame=7, is_global=True)
    rig.aim((3000.0, 0.0, -150.0))
    rig.aim((*place, NAN), frame=5, is_global=True)
    assert rig.texts()[-1].startswith("SIM:")
    assert rig.run(20.0).height_m == approx(95.0, abs=1.0)


def test_a_course_is_turned_to_as_hard_as_asked_and_held_until_there_is_a_new_point() -> None:
    rig = circling()
    rig.reposition(3000.0, 0.0, 80.0)
    wanted = 1j * rig.run(30.0).vehicle.velocity_m_s  # to the right

    def off_rad() -> float:
        return abs(cmath.phase(rig.vehicle.velocity_m_s / wanted))

    course_deg = math.degrees(cmath.phase(wanted)) % 360.0
    assert rig.command(CHANGE_HEADING, 0.0, course_deg, 3.0) == ACCEPTED
    # at the bank of 3 m/s2 and what the airframe makes of it: 0.745 * 3 m/s2 sideways
    turns_s = 0.25 * math.pi * 23.45 / (0.745 * 3.0)
    assert rig.until(lambda: off_rad() < 0.25 * math.pi) == approx(turns_s, rel=0.15)
    rig.run(60.0)
    assert off_rad() < 0.01
    assert rig.reposition(0.0, 0.0, 80.0) == ACCEPTED
    rig.run(30.0)
    assert off_rad() > 0.1


# --- a plane without GPS --------------------------------------------------------------------------


@pytest.mark.parametrize(("glides_in", "flies_in"), [("", "GUIDED"), ("FBWA", "LOITER")])
def test_without_gps_a_plane_levels_its_wings_holds_its_height_and_stays_in_its_mode(
    glides_in: str, flies_in: str
) -> None:
    rig = circling()
    rig.fault("for 30 s: gps_off")
    if glides_in:
        rig.set_mode(glides_in)
        rig.run(10.0).set_mode(flies_in)
    height_m = rig.run(8.0).height_m
    assert (rig.run(12.0).mode, rig.autopilot.estimate.position_ok) == (flies_in, False)
    assert abs(rig.vehicle.roll_rad) < 0.01
    assert rig.height_m == approx(height_m, abs=3.0)
    assert math.hypot(*rig.run(60.0).ne_m) < 1000.0
    assert rig.autopilot.estimate.position_ok


def test_a_take_off_of_a_plane_waits_for_a_position() -> None:
    rig = Rig("ardupilot", "plane").run(4.0)
    rig.set_mode("TAKEOFF")
    assert rig.command(400, 1.0, 2989.0) == ACCEPTED
    assert rig.run(3.0).vehicle.stands
    rig.until(lambda: rig.height_m > 40.0, 60.0)


# --- the fence ------------------------------------------------------------------------------------

HOME = Place(*COPTER_HOME)
EARTH = FlatEarth(HOME)


def circle(north_m: float, east_m: float, radius_m: float, command: int = 5004) -> PlanItem:
    return item(HOME, command, north_m, east_m, 0.0, radius_m, frame=0)


def fenced(*items: PlanItem, kinds: float = 4.0, **parameters: float) -> Rig:
    """At 30 m, with a fence of polygons and circles."""
    it = hovering(FENCE_ENABLE=1.0, FENCE_TYPE=kinds, **parameters)
    it.plan(PlanKind.FENCE, *items)
    return it


STAR = [
    item(HOME, 5001, 20.0 * way.real, 20.0 * way.imag, 0.0, 5.0, frame=0)
    for way in (cmath.rect(1.0, 0.8 * math.pi * k) for k in range(5))
]
"""It crosses itself: its middle is a hole."""
TWO_CIRCLES = (circle(0.0, 0.0, 10.0, 5003), circle(50.0, 0.0, 10.0, 5003))
ONE_CIRCLE = (circle(100.0, 0.0, 10.0),)


@pytest.mark.parametrize(
    ("kinds", "items", "options", "place", "found"),
    [
        *((1, ONE_CIRCLE, 0, (0.0, 0.0, 99.0), 0), (1, ONE_CIRCLE, 0, (0.0, 0.0, 101.0), 1)),
        *((2, ONE_CIRCLE, 0, (149.0, 0.0, 0.0), 0), (2, ONE_CIRCLE, 0, (151.0, 0.0, 0.0), 2)),
        (7, ONE_CIRCLE, 0, (151.0, 0.0, 101.0), 3),
        *((4, ONE_CIRCLE, 0, (100.0, 0.0, 0.0), 4), (4, ONE_CIRCLE, 0, (110.5, 0.0, 0.0), 0)),
        # of two inclusions it stays in both, or by an option in either
        *((4, TWO_CIRCLES, 0, (50.0, 0.0, 9.0), 4), (4, TWO_CIRCLES, 2, (50.0, 0.0, 9.0), 0)),
        *((4, TWO_CIRCLES, 2, (25.0, 0.0, 9.0), 4), (4, STAR, 0, (0.0, 0.0, 9.0), 4)),
        *((4, STAR, 0, (14.0, 0.0, 9.0), 0), (4, STAR, 0, (0.0, 19.0, 9.0), 4)),
    ],
)
def test_each_kind_of_fence_is_where_its_parameters_say(
    kinds: int, items: Sequence[PlanItem], options: int, place: Vector, found: int
) -> None:
    it = Rig(FENCE_ENABLE=1.0, FENCE_TYPE=float(kinds), FENCE_OPTIONS=float(options))
    it.simulation.plans[PlanKind.FENCE] = tuple(items)
    fence = Fence(it.autopilot.parameters, it.autopilot.plans)
    there = EARTH.place(place[0], place[1], -place[2])
    assert fence.outside(there, HOME, EARTH) == found


@pytest.mark.parametrize(("action", "mode"), [(0, "GUIDED"), (1, "RTL"), (2, "LAND"), (4, "BRAKE")])
def test_outside_of_an_inclusion_the_action_is_a_parameter(action: int, mode: str) -> None:
    corners = ((50.0, 0.0), (90.0, 0.0), (90.0, 40.0))
    it = fenced(*(item(HOME, 5001, *c, 0.0, 3.0, frame=0) for c in corners), FENCE_ACTION=action)
    begun_s = it.now_s
    assert it.run(1.0).mode == mode
    assert it.when("Polygon fence breached") == [approx(begun_s + 0.1, abs=0.1)]
    assert it.set_mode("GUIDED") == 0  # it can be had again
    assert (it.run(1.0).mode, it.status.fence[0]) == ("GUIDED", 1)
    it.command(207, 0)  # off
    assert not it.run(0.2).status.fence[0]
    it.command(207, 1)
    assert it.run(0.2).status.fence == (1, 2)  # counted once each time that it begins


def test_outside_of_its_fence_or_in_a_mode_for_the_air_it_is_not_armed_and_says_why() -> None:
    it = Rig(FENCE_ENABLE=1.0, FENCE_TYPE=4.0).armable()
    for mode in ("RTL", "LAND", "BRAKE"):
        assert [it.set_mode(mode), it.arm()] == [ACCEPTED, FAILED]
        assert it.texts()[-1] == f"Arm: {mode} mode not armable"
    it.simulation.plans[PlanKind.FENCE] = (item(HOME, 5004, 0.0, 0.0, 0.0, 50.0, frame=0),)
    assert [it.set_mode("GUIDED"), it.arm()] == [ACCEPTED, FAILED]
    assert it.texts()[-1] == "Arm: Vehicle breaching Polygon"
    it.command(207, 0)  # off
    assert it.arm() == ACCEPTED


def test_the_floor_comes_with_the_height_is_breached_from_above_and_goes_with_the_landing() -> None:
    it = fenced(kinds=8.0, FENCE_ALT_MIN=15.0)
    lands = it.copy()
    while it.height_m > 15.0:
        assert not it.status.fence[0]
        it.aim(None, (0.0, 0.0, 1.5))
        it.step()
    assert (it.run(0.2).mode, len(it.when("Min Alt fence breached"))) == ("RTL", 1)
    lands.set_mode("LAND")
    lands.until(lambda: lands.landed, 60.0)
    lands.take_off(12.0)  # not yet 2 m above it
    assert lands.when("Min Alt fence breached") == []


def test_a_target_beyond_it_is_dropped_without_a_word_and_a_planes_denied() -> None:
    it = fenced(circle(80.0, 0.0, 15.0))
    texts = len(it.texts())
    for place in ((40.0, 0.0, -30.0), (80.0, 0.0, -30.0)):
        it.aim(place)
        assert echo_m(it) == approx((40.0, 0.0, -30.0), abs=0.1)
    assert len(it.texts()) == texts
    rig = circling(FENCE_ENABLE=1.0, FENCE_TYPE=2.0, FENCE_RADIUS=400.0)
    assert rig.reposition(900.0, 0.0, 80.0) == DENIED
    assert rig.command(CHANGE_HEADING, 0.0, 0.0, 3.0) == ACCEPTED
    rig.until(lambda: rig.mode == "RTL")
    assert math.hypot(*rig.ne_m) == approx(400.0, abs=5.0)
