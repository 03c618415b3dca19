"""What px4.md says of the real PX4: multicopter (1 to 7) and aeroplane (10).

Arming, missions and failsafes are in test_firmwares.py, tracking in test_tracking.py, how setpoints
are read in test_setpoints.py, the loss of GPS in test_estimator.py, recorded flights in
conformance/.  Conditions: SIH_KDV 0.25 and COM_OBL_RC_ACT 5 unless stated.  Tolerances are what the
document gives as a range; otherwise 0.7 m (two times the noise of the EKF), 10 % of speeds, and as
stated.
"""

import math
from typing import Any

import pytest
from harness import GCS, NAN, PLACE, ZERO, Rig, Vector, copied, cruising, heartbeat, hover, item

from vehicle_sim.autopilot.values import Landed, Result
from vehicle_sim.plans import PlanKind

ACCEPTED, REJECTED, DENIED = Result.ACCEPTED, Result.TEMPORARILY_REJECTED, Result.DENIED
UP: Vector = (0.0, 0.0, -15.0)
FENCE = item(PLACE, 5004, 60.0, 0.0, 0.0, 20.0, frame=6)
"""An exclusion of 20 m, 60 m to the north."""
OUTSIDE = "Geofence: approaching or outside geofence\t"


def about(value: Any, within: float) -> Any:
    return pytest.approx(value, abs=within)


@copied
def on_ground() -> Rig:
    """Armable, in Hold."""
    return Rig("px4").run(7.0)


def cruise(speed_m_s: float = 5.0, **parameters: float) -> Rig:
    """Flying north with a stream of velocities."""
    return hover(**parameters).stream(7.0, None, (speed_m_s, 0.0, 0.0))


def fenced(**parameters: float) -> Rig:
    rig = hover(**parameters)
    rig.send(heartbeat(6), source=GCS)
    rig.simulation.plans[PlanKind.FENCE] = (FENCE,)
    return rig


# --- multicopter: arming, modes, commands ---------------------------------------------------------


def test_it_is_armed_by_force_while_it_boots_and_booted_again_only_disarmed() -> None:
    assert Rig("px4").run(1.0).command(400, 1.0, 21196.0) == ACCEPTED
    rig = on_ground()
    rig.arm()
    assert rig.command(246, 1.0) == REJECTED
    rig.command(400, 0)
    assert rig.command(246, 1.0) == ACCEPTED
    assert not rig.run(1.0).simulation.armable


@pytest.mark.parametrize(
    ("mode", "armable"),
    [
        *((mode, True) for mode in ("Takeoff", "Hold", "Return", "Land")),
        *((mode, False) for mode in ("Offboard", "Position", "Altitude", "Mission")),
    ],  # no stream, no pilot, no mission
)
def test_disarmed_every_mode_is_had_and_some_can_be_armed(mode: str, armable: bool) -> None:
    rig = on_ground()
    assert rig.set_mode(mode) == ACCEPTED
    status = rig.run(0.2).status
    assert rig.mode == mode
    assert (status.system_status, status.prearm_ok) == (3 if armable else 0, armable)
    assert rig.arm() == (ACCEPTED if armable else REJECTED)
    for flags in (0.0, NAN):  # no custom mode
        assert rig.command(176, flags, 6.0) == ACCEPTED
        rig.step()
        assert rig.last("COMMAND_ACK").result == REJECTED


def test_offboard_takes_a_setpoint_and_what_came_before_it_is_a_sign_of_life_only() -> None:
    rig = on_ground()
    rig.arm()
    rig.run(0.3).aim(UP)  # in the same moment, as MAVSDK 4 sends them: it checks at once
    assert (rig.set_mode("Offboard"), rig.mode) == (ACCEPTED, "Offboard")
    rig = hover()
    rig.set_mode("Hold")
    assert rig.run(3.0).set_mode("Offboard") == REJECTED  # without a stream
    rig.aim((300.0, 0.0, -12.0))
    assert rig.run(0.2).set_mode("Offboard") == ACCEPTED
    assert (rig.run(0.6).mode, rig.autopilot.target) == ("Offboard", None)
    assert rig.speed_m_s < 0.6


def test_home_can_be_moved_but_not_to_nowhere() -> None:
    rig, move = on_ground(), (179, 0.0, 0.0, 0.0, 0.0, 47.4, 8.55)
    results = [rig.command(*move, up_m, frame=0) for up_m in (500.0, NAN, 3.4e38)]
    assert results == [ACCEPTED, REJECTED, REJECTED]
    home = rig.autopilot.home
    assert (home.latitude_deg, home.altitude_amsl_m) == (47.4, 500.0)
    assert rig.command(179) == REJECTED  # 0, 0 is no place
    assert rig.autopilot.home is home


def test_a_take_off_goes_to_its_usual_height_and_ends_in_hold() -> None:
    rig = on_ground()
    assert rig.command(22, 0.0, 0.0, 0.0, *[NAN] * 4) == rig.arm() == ACCEPTED
    assert rig.until(lambda: rig.mode == "Hold", 20.0) == about(7.8, 0.3)
    assert rig.height_m == about(2.5, 0.3)


@pytest.mark.parametrize("altitude_m", [30.0, 500.0])
def test_a_take_off_leads_nowhere_down(altitude_m: float) -> None:
    """Of an altitude above the sea below where it is; and the hold after it stays there, too."""
    rig = hover(30.0)
    assert rig.command(22, 0.0, 0.0, 0.0, NAN, NAN, NAN, altitude_m, frame=0) == ACCEPTED
    assert rig.run(20.0).height_m == about(30.0, 1.0)
    assert rig.mode == "Hold"


def test_it_lands_disarms_two_seconds_later_and_can_be_flown_again() -> None:
    """px4-offboard-short.tlog: 1.4 m/s at 9 m, 0.7 below 5 m, 0.3 below 1 m."""
    rig = hover(9.2)
    assert rig.command(21, 0.0, 0.0, 0.0, NAN) == ACCEPTED
    for from_m, to_m, sink_m_s, within in (
        *((8.0, 7.0, 1.15, 0.25), (4.5, 2.0, 0.7, 0.1)),
        (0.75, 0.25, 0.4, 0.2),
    ):
        rig.until(lambda: rig.height_m < from_m)  # noqa: B023
        took_s = rig.until(lambda: rig.height_m < to_m)  # noqa: B023
        assert (from_m - to_m) / took_s == about(sink_m_s, within)
    rig.until(lambda: rig.landed)
    assert rig.until(lambda: not rig.armed) == about(2.0, 0.1)
    assert rig.status.landed_state == Landed.ON_GROUND
    assert rig.mode == "Offboard"  # the last commanded flight mode again: px4.md 3
    rig.aim((0.0, 0.0, -6.0))
    rig.arm()
    assert 3.0 < rig.stream(8.0, (0.0, 0.0, -6.0)).height_m < 6.7


@pytest.mark.parametrize(("north_m", "highest_m"), [(20.0, 20.0), (60.0, 30.0)])
def test_a_return_climbs_no_higher_than_the_cone_of_45_degrees_and_comes_home(
    north_m: float, highest_m: float
) -> None:
    rig, heights = hover().stream(20.0, (north_m, 0.0, -15.0)), list[float]()
    rig.set_mode("Return")
    rig.run(30.0, lambda: heights.append(rig.height_m))
    assert max(heights) == about(highest_m, 1.0)
    assert math.hypot(*rig.ne_m) == about(0.0, 2.0)
    assert not rig.landed


def test_a_reposition_switches_to_hold_and_one_into_the_fence_is_refused() -> None:
    rig = fenced()
    assert [rig.reposition(60.0, 0.0, 15.0), rig.reposition(-30.0, 0.0, 20.0)] == [DENIED, ACCEPTED]
    assert rig.stream(20.0, None, ZERO).mode == "Hold"
    assert rig.ned_m == about((-30.0, 0.0, -20.0), 1.0)
    assert abs(rig.vehicle.heading_rad) == about(math.pi, 0.1)  # where it flew to
    for speed_m_s in (2.0, NAN):  # in AUTO modes it counts
        assert rig.command(178, 1.0, speed_m_s, -1.0) == ACCEPTED
    rig.reposition(-60.0, 0.0, 20.0)
    assert rig.run(6.0).speed_m_s == about(2.0, 0.3)
    rig.command(192, -1.0, 1.0, 0.0, NAN, NAN, NAN, 503.0, frame=5)  # a height alone
    rig.run(8.0)
    assert (rig.speed_m_s, rig.height_m) == (about(0.0, 0.5), about(15.0, 0.7))


# --- multicopter: setpoints -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("setpoint", "mask", "flown_m_s", "ends_m"),
    [
        (((10.0, 5.0, -12.0), (1.0, 0.0, 0.0)), None, None, (11.05, 5.0, -12.0)),  # v / MPC_XY_P
        (((10.0, 5.0, 0.0), (0.0, 0.0, -0.3)), 0xDDC, None, (10.0, 5.0, -19.5)),
        ((None, (3.0, 1.0, -1.0)), None, (3.0, 1.0, 1.0), None),
        (((0.0, 0.0, -30.0), (3.0, 0.0, 0.0)), 0xDE3, (3.0, 0.0, 0.0), None),
        ((UP,), 0xDFE, ZERO, None),  # half a place: it brakes
        ((None, (15.0, 0.0, 0.0)), None, (11.9, 0.0, 0.0), None),
        ((None, (0.0, 0.0, -6.0)), None, (0.0, 0.0, 2.8), None),
        ((None, (0.0, 0.0, 6.0)), None, (0.0, 0.0, -1.6), None),
    ],
)
def test_what_becomes_of_a_setpoint(
    setpoint: Any, mask: int | None, flown_m_s: Vector | None, ends_m: Vector | None
) -> None:
    rig = hover(15.0 if ends_m else 30.0)
    assert rig.command(178, 1.0, 2.0, -1.0) == ACCEPTED  # a change of speed is for AUTO modes
    assert rig.stream(15.0 if ends_m else 7.0, *setpoint, mask=mask).mode == "Offboard"
    assert ends_m is None or rig.ned_m == about(ends_m, 0.8)
    assert flown_m_s is None or rig.vehicle.velocity_neu_m_s == about(flown_m_s, 0.4)


@pytest.mark.parametrize(
    ("frame", "z_m", "above_origin_m"),
    [
        (5, 498.0, 10.0),  # origin at 488 m
        (6, 498.0, 493.0),  # 498 m above home, 5 m above the origin: with the wrong sign, 493 m
        (6, 10.0, 5.0),  # px4.md 1, item 6: asked 10 m above home, flew to home's height
        (11, 498.0, 490.0),  # 498 m above ground at 480 m
    ],
)
def test_frames_of_global_int(frame: int, z_m: float, above_origin_m: float) -> None:
    rig = Rig("px4").run(4.0)
    pilot = rig.autopilot
    origin = pilot.estimate.origin = pilot.estimate.place.at(488.0)
    pilot.frame = pilot.firmware.frame(origin)
    pilot.home, pilot.ground_m = origin.at(493.0), 480.0
    rig.command(176, 1.0, 6.0)
    rig.aim((*origin[:2], z_m), frame=frame, is_global=True)
    assert pilot.target.position == about((0.0, 0.0, -above_origin_m), 0.01)


# --- failsafes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("action", "mode", "sinks_m_s", "metres"),
    [
        (0, "Position", (0.6, 0.8), (5.0, 20.0)),
        (1, "Altitude", (0.5, 0.8), None),  # 0.5 to 0.7, of which the EKF wanders by 0.1
        (3, "Return", None, None),
        (4, "Land", (1.26, 1.54), None),
        (5, "Hold", None, (5.8, 8.6)),  # about 4 m there, 7.2 in px4-offboard-short.tlog
    ],
)
def test_a_lost_stream_is_acted_on_after_1_1_s_and_taken_up_when_it_is_back(
    action: int, mode: str, sinks_m_s: Any, metres: Any
) -> None:
    rig = cruise(COM_OBL_RC_ACT=float(action))
    rig.aim(None, (5.0, 0.0, 0.0))
    rig.step()
    assert 0.01 + rig.until(lambda: rig.mode != "Offboard", 3.0) == about(1.1, 0.1)
    status = rig.status
    assert (rig.mode, status.intended_mode, status.system_status) == (mode, 6 << 16, 5)  # CRITICAL
    here_m = rig.ned_m[0]
    down_m = rig.run(2.0).ned_m[2]
    sunk_m_s = (rig.run(3.0).ned_m[2] - down_m) / 3.0
    rig.run(3.0)
    assert sinks_m_s is None or sinks_m_s[0] <= sunk_m_s <= sinks_m_s[1]
    assert metres is None or metres[0] <= rig.ned_m[0] - here_m <= metres[1]
    if mode == "Return":
        assert rig.height_m == about(30.0, 1.0)
    assert rig.stream(0.3, None, (5.0, 0.0, 0.0)).mode == "Offboard"


def test_hold_without_a_position_is_a_descent() -> None:
    rig = hover()
    rig.set_mode("Hold")
    rig.fault("gps_off")
    assert rig.until(lambda: rig.mode == "Descend", 10.0) == about(5.2, 0.4)


@pytest.mark.parametrize(
    ("limit", "velocity"),
    [("GF_MAX_HOR_DIST", (3.0, 0.0, 0.0)), ("GF_MAX_VER_DIST", (0.0, 0.0, -1.5))],
)
def test_beyond_the_cylinder_about_home_it_does_what_gf_action_says(
    limit: str, velocity: Vector
) -> None:
    rig = fenced(GF_ACTION=3.0, **{limit: 20.0})
    assert rig.stream(3.0, UP).mode == "Offboard"
    assert rig.stream(8.0, None, velocity).mode == "Return"
    assert rig.texts().count(OUTSIDE) == 1


def test_a_breach_holds_until_another_command() -> None:
    rig, stream = fenced(), (None, (4.0, 0.0, 0.0))
    rig.until(lambda: rig.stream(0.05, *stream).ned_m[0] > 40.0)
    for seconds in (1.0, 8.0):
        assert rig.stream(seconds, *stream).mode == "Hold"
        assert rig.texts().count(OUTSIDE) == 1
    inside_m = rig.ned_m[0] - 40.0
    assert inside_m == about(5.0, 1.5)
    assert rig.set_mode("Offboard") == ACCEPTED
    rig.stream(3.0, None, (8.0, 0.0, 0.0))
    assert 8.0 < rig.ned_m[0] - 40.0 - inside_m < 24.0


# --- aeroplane ------------------------------------------------------------------------------------


def off_circle_m(rig: Rig, north_m: float, east_m: float, radius_m: float = 80.0) -> float:
    """How far it leaves a circle about a place in half a minute, at most."""
    off_m = list[float]()
    rig.run(30.0, lambda: off_m.append(abs(math.dist(rig.ne_m, (north_m, east_m)) - radius_m)))
    return max(off_m)


def to_point(rig: Rig, north_m: float, east_m: float, seconds: float) -> Rig:
    """A point 70 m up is sent at 10 Hz."""
    return rig.stream(seconds, (north_m, east_m, -70.0), rate_hz=10.0)


def offboard(to_north_m: float, to_east_m: float = 0.0, **more: float) -> Rig:
    """Cruising, in OFFBOARD with a point that has been sent for a second."""
    rig = to_point(cruising(**more), to_north_m, to_east_m, 1.0)
    assert (rig.set_mode("Offboard"), rig.mode) == (0, "Offboard")
    return rig


@pytest.mark.parametrize("mask", [0xDC7, 0xC3F], ids=["velocity", "acceleration"])
def test_without_a_position_the_last_commands_stay(mask: int) -> None:
    rig, banks_rad = to_point(offboard(5000.0), 0.0, 5000.0, 1.0), list[float]()
    here = complex(*rig.ne_m)
    for _ in range(100):
        rig.aim((0.0, 0.0, -70.0), (14.0, 0.0, 0.0), (0.1, 0.1, 0.0), mask=mask)
        rig.run(0.1)
        banks_rad.append(rig.vehicle.roll_rad)
    assert banks_rad[10:] == about([banks_rad[10]] * 90, 0.03)
    assert banks_rad[10] > 0.5
    assert abs(complex(*rig.ne_m) - here) < 100.0  # round and round, wherever it was to go
    assert (rig.mode, rig.height_m) == ("Offboard", about(68.0, 3.0))


def test_speed_is_the_parameter_whatever_is_commanded() -> None:
    rig = offboard(5000.0, FW_AIRSPD_TRIM=12.0)
    assert rig.command(178, 0.0, 20.0, -1.0) == 0
    to_point(rig, 5000.0, 0.0, 20.0)
    assert rig.vehicle.airspeed_m_s == about(12.0 * 1.027, 0.1)  # at 550 m


@pytest.mark.parametrize("radius_m", [150.0, -60.0])
def test_loiter_radius_is_held(radius_m: float) -> None:
    rig, asked_m = cruising(NAV_LOITER_RAD=radius_m), 200.0  # px4.md 10: ignored
    assert rig.reposition(200.0, 100.0, 70.0, asked_m) == 0
    assert off_circle_m(rig.run(60.0), 200.0, 100.0, abs(radius_m)) < 0.7
    (north_m, east_m), v_n = rig.ne_m, rig.vehicle.velocity_m_s.real
    turns = (north_m - 200.0) * rig.vehicle.velocity_m_s.imag - (east_m - 100.0) * v_n
    assert turns * radius_m > 0.0


def test_lost_gps_flies_a_bank_then_descends() -> None:
    rig = offboard(5000.0, NAV_GPSF_LT=10.0)
    rig.fault("gps_off")
    seen = [(to_point(rig, 5000.0, 0.0, 1.0).mode, rig.height_m) for _ in range(30)]
    assert (seen[3][0], seen[-1][0]) == ("Offboard", "Descend")
    assert math.degrees(rig.vehicle.roll_rad) == about(15.0, 0.5)
    assert seen[12][1] == about(seen[6][1], 1.0)
    assert (seen[20][1] - seen[28][1]) / 8.0 == about(0.5, 0.05)


def test_landing_circles_down_where_it_was_commanded_and_disarms() -> None:
    rig = offboard(5000.0)
    north_m, east_m = rig.ne_m
    assert rig.command(21, 0.0, 0.0, 0.0, NAN, *rig.place(900.0, 0.0, 0.0), frame=5) == 0
    assert rig.run(30.0).status.landed_state == Landed.LANDING
    assert rig.vehicle.velocity_up_m_s == about(-0.87, 0.02)
    assert rig.speed_m_s == about(10.8, 0.2)
    assert off_circle_m(rig, north_m, east_m) < 0.6
    rig.until(lambda: rig.landed)
    assert rig.until(lambda: not rig.armed) == about(2.0, 0.1)
    assert (rig.height_m, rig.mode) == (0.0, "Offboard")  # the one last commanded for flight


def test_return_circles_over_home_at_its_height() -> None:
    rig = cruising(600.0, -200.0, RTL_RETURN_ALT=90.0, RTL_DESCEND_ALT=60.0)
    assert rig.command(20) == 0
    assert rig.run(45.0).mode == "Return"
    assert rig.height_m > 80.0
    assert off_circle_m(rig.run(60.0), 0.0, 0.0) < 0.6
    assert rig.height_m == about(60.0 - 2.2, 1.0)
