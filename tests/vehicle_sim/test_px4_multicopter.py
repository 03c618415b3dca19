"""What px4.md says of the real PX4 multicopter (1 to 7), tried by values.

Tracking is in test_tracking.py, how setpoints are read in test_setpoints.py, the loss of GPS in
test_estimator.py, what was recorded in conformance/.  Conditions: SIH_KDV 0.25 and COM_OBL_RC_ACT 5
unless stated.  Tolerances are what the document gives as a range; otherwise 0.7 m (two times the
noise of the EKF), 10 % of speeds, and as stated.
"""

import functools
import math
from typing import Any

import harness
import pytest
from harness import (
    HOLD,
    MISSION,
    NAN,
    OFFBOARD,
    PLACE,
    PX4_LAND,
    RETURN,
    TAKEOFF,
    ZERO,
    Vector,
    copied,
)
from rigs import Px4Copter
from tracked import lean_deg

from vehicle_sim.autopilot.values import Ack, Landed, Reboot, Result, Sender
from vehicle_sim.faults import GpsConditions
from vehicle_sim.plans import PlanKind

ACCEPTED, REJECTED, DENIED = Result.ACCEPTED, Result.TEMPORARILY_REJECTED, Result.DENIED
POSITION, ALTITUDE = (3, 0), (2, 0)
STATION = Sender(system=255, component=190)
UP: Vector = (0.0, 0.0, -15.0)
item = functools.partial(harness.item, PLACE, frame=6)
FENCE = item(5004, 60.0, 0.0, 0.0, 20.0)
"""An exclusion of 20 m, 60 m to the north."""


@copied
def on_ground() -> Px4Copter:
    """Armable, in Hold."""
    return Px4Copter().run(7.0)


@copied
def _flying(height_m: float, drag: float) -> Px4Copter:
    return Px4Copter(SIH_KDV=drag).take_off(height_m, seconds=8.0 + height_m / 2.0)


def hover(height_m: float = 15.0, drag: float = 0.25, **parameters: float) -> Px4Copter:
    """In OFFBOARD above the origin."""
    rig = _flying(height_m, drag)
    for name, value in parameters.items():
        rig.autopilot.parameters[name] = value
    return rig


def cruise(speed_m_s: float = 5.0, **parameters: float) -> Px4Copter:
    """Flying north with a stream of velocities."""
    return hover(**parameters).stream(7.0, None, (speed_m_s, 0.0, 0.0))


def about(value: Any, within: float) -> Any:
    return pytest.approx(value, abs=within)


# --- 1 and 3: arming, modes, commands -------------------------------------------------------------


def test_when_it_may_be_armed_and_booted_again() -> None:
    rig = Px4Copter().run(1.0)  # it boots
    assert [rig.command(400, 1.0), rig.command(400, 1.0, 21196.0)] == [REJECTED, ACCEPTED]
    rig = on_ground()
    assert rig.command(246, 1.0) == ACCEPTED
    assert any(isinstance(reply, Reboot) for _, reply in rig.said)
    rig.command(400, 1.0)
    assert rig.command(246, 1.0) == REJECTED
    assert rig.until(lambda: not rig.armed, 20.0) == about(10.5, 0.6)  # it has not flown


@pytest.mark.parametrize(
    ("mode", "armable"),
    [
        *((mode, True) for mode in (TAKEOFF, HOLD, RETURN, PX4_LAND)),
        *((mode, False) for mode in (OFFBOARD, POSITION, ALTITUDE, MISSION)),
    ],  # no stream, no pilot, no mission
)
def test_disarmed_every_mode_is_had_and_some_can_be_armed(
    mode: tuple[int, int], armable: bool
) -> None:
    rig = on_ground()
    assert rig.set_mode(*mode) == ACCEPTED
    status = rig.run(0.2).status
    assert status.mode == mode[0] << 16 | mode[1] << 24
    assert (status.system_status, status.prearm_ok) == (3 if armable else 0, armable)
    assert rig.command(400, 1.0) == (ACCEPTED if armable else REJECTED)
    for flags in (0.0, NAN):  # no custom mode
        rig.command(176, flags, 6.0)
        rig.step()
        assert [r.result for _, r in rig.said if isinstance(r, Ack)][-2:] == [ACCEPTED, REJECTED]


def test_offboard_takes_a_setpoint_and_what_came_before_it_is_a_sign_of_life_only() -> None:
    rig = on_ground()
    rig.command(400, 1.0)
    rig.run(0.3).aim(UP)  # in the same moment, as MAVSDK 4 sends them: it checks at once
    assert (rig.set_mode(*OFFBOARD), rig.mode) == (ACCEPTED, "Offboard")
    rig = hover()
    rig.set_mode(*HOLD)
    assert rig.run(3.0).set_mode(*OFFBOARD) == REJECTED  # without a stream
    rig.aim((300.0, 0.0, -12.0))
    assert rig.run(0.2).set_mode(*OFFBOARD) == ACCEPTED
    assert (rig.run(0.6).mode, rig.autopilot.target) == ("Offboard", None)
    assert rig.speed_m_s < 0.6


def test_home_can_be_moved_but_not_to_nowhere() -> None:
    rig, move = on_ground(), (179, 0.0, 0.0, 0.0, 0.0, 47.4, 8.55)
    results = [rig.command(*move, up_m, frame=0) for up_m in (500.0, NAN, 3.4e38)]
    assert results == [ACCEPTED, DENIED, DENIED]
    home = rig.autopilot.home
    assert (home.latitude_deg, home.altitude_amsl_m) == (47.4, 500.0)


def test_a_commanded_take_off_ends_in_hold_at_its_height() -> None:
    rig = on_ground()
    assert rig.command(22, *(NAN,) * 7) == ACCEPTED
    rig.command(400, 1.0)
    assert rig.until(lambda: rig.mode == "Hold", 20.0) == about(7.8, 1.0)
    assert rig.run(5.0).height_m == about(2.5, 0.7)


def test_it_lands_disarms_two_seconds_later_and_can_be_flown_again() -> None:
    rig = hover()
    assert rig.command(21, 0.0, 0.0, 0.0, NAN) == ACCEPTED
    rig.until(lambda: rig.landed)
    assert rig.until(lambda: not rig.armed) == about(2.0, 0.1)
    assert rig.status.landed_state == Landed.ON_GROUND
    assert rig.mode == "Offboard"  # the last commanded flight mode again: px4.md 3
    rig.aim((0.0, 0.0, -6.0))
    rig.command(400, 1.0)
    assert 3.0 < rig.stream(8.0, (0.0, 0.0, -6.0)).height_m < 6.7


# --- 4: setpoints flown, limits, steps ------------------------------------------------------------


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
    rig = Px4Copter().run(4.0)
    pilot = rig.autopilot
    origin = pilot.estimate.origin = pilot.estimate.place.at(488.0)
    pilot.frame = pilot.firmware.frame(origin)
    pilot.home, pilot.ground_m = origin.at(493.0), 480.0
    rig.command(176, 1.0, *OFFBOARD)
    rig.aim((*origin[:2], z_m), frame=frame, is_global=True)
    assert pilot.target.position == about((0.0, 0.0, -above_origin_m), 1e-6)


def test_the_nose_turns_to_the_yaw_that_is_told_and_frame_8_turns_with_it() -> None:
    rig = hover()
    for seconds, yaw_rad in ((6.0, math.pi / 2.0), (4.0, None)):
        rig.stream(seconds, UP, None, None, yaw_rad)
        assert math.degrees(rig.vehicle.heading_rad) == about(90.0, 3.0)
    rig.stream(4.0, None, (3.0, 0.0, 0.0), frame=8)
    assert rig.vehicle.velocity_neu_m_s[:2] == about((0.0, 3.0), 0.3)


def test_a_place_30_m_away_is_flown_to_with_all_the_tilt_there_is() -> None:
    """With the stock drag."""
    rig, leans, norths, speeds = hover(drag=1.0), list[float](), list[float](), list[float]()
    for _ in range(240):
        rig.stream(0.05, (30.0, 0.0, -15.0))
        leans.append(lean_deg(rig))
        norths.append(rig.ned_m[0])
        speeds.append(rig.speed_m_s)
    assert (max(leans), max(speeds)) == (about(45.0, 2.0), about(8.8, 0.5))
    assert 0.05 * sum(north < 29.0 for north in norths) == about(4.8, 0.4)
    assert max(norths) == about(31.4, 0.7)


@pytest.mark.parametrize(
    ("how", "expected"),
    [
        ("position", {"farthest": 10.0}),
        ("velocity", {"metres": 11.0, "seconds": 2.3}),
        ("hold", {"metres": 31.2, "seconds": 5.6}),
    ],
)
def test_it_stops_from_12_m_s(how: str, expected: dict[str, float]) -> None:
    """15 %: 0.1 s of delay is 1.2 m."""
    rig = cruise(12.0).stream(2.0, None, (12.0, 0.0, 0.0))
    here, start_s = rig.ned_m, rig.now_s
    setpoint = ((*here[:2], -15.0),) if how == "position" else (None, ZERO)
    if how == "hold":
        rig.set_mode(*HOLD)
    seen = {"farthest": 0.0}
    for _ in range(280):
        rig.stream(0.05, *setpoint)
        seen["metres"] = rig.ned_m[0] - here[0]
        seen["farthest"] = max(seen["farthest"], seen["metres"])
        if rig.speed_m_s < 0.3:
            seen.setdefault("seconds", rig.now_s - start_s)
    assert {name: seen[name] for name in expected} == pytest.approx(expected, rel=0.15)


# --- 6: loss of the stream, failsafes -------------------------------------------------------------


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


@pytest.mark.parametrize(("north_m", "highest_m"), [(20.0, 20.0), (60.0, 30.0)])
def test_a_return_climbs_no_higher_than_the_cone_of_45_degrees_and_comes_home(
    north_m: float, highest_m: float
) -> None:
    rig, heights = hover().stream(20.0, (north_m, 0.0, -15.0)), list[float]()
    rig.set_mode(*RETURN)
    rig.run(30.0, lambda: heights.append(rig.height_m))
    assert max(heights) == about(highest_m, 1.0)
    assert math.hypot(*rig.ne_m) == about(0.0, 2.0)
    assert not rig.landed


@pytest.mark.parametrize(
    ("rate_hz", "modes"),
    [(1.2, ["Offboard"]), (0.8, ["Offboard", "Hold"] * 4)],
)
def test_a_slow_stream_flips_between_the_modes(rate_hz: float, modes: list[str]) -> None:
    rig, seen = cruise(), list[str]()
    for k in range(1200):
        if k % round(100.0 / rate_hz) == 0:
            rig.aim(None, (5.0, 0.0, 0.0))
        rig.step()
        seen += [rig.mode] if seen[-1:] != [rig.mode] else []
    assert seen[:8] == modes


def test_a_stream_that_is_lost_on_the_ground_leaves_it_armed_in_hold() -> None:
    rig = on_ground().stream(0.5, ZERO)
    rig.set_mode(*OFFBOARD)
    rig.command(400, 1.0)
    rig.stream(1.0, ZERO)
    assert rig.until(lambda: rig.mode == "Hold", 3.0) == about(1.1, 0.2)
    assert rig.run(5.0).armed


def test_hold_without_a_position_is_a_descent() -> None:
    rig = hover()
    rig.set_mode(*HOLD)
    rig.gps_conditions = GpsConditions(enabled=False)
    assert rig.until(lambda: rig.mode == "Descend", 10.0) == about(5.2, 0.4)


def test_the_battery_brings_it_home() -> None:
    """COM_LOW_BAT_ACT 3: return when critical, land in an emergency."""
    rig = hover()
    for left, mode in ((0.065, "Return"), (0.04, "Land")):
        rig.autopilot.battery.remaining = left
        assert rig.stream(0.5, None, ZERO).mode == mode
    assert rig.set_mode(*OFFBOARD) == ACCEPTED  # whoever commands another one has it
    assert rig.stream(1.0, None, ZERO).mode == "Offboard"


def test_a_ground_station_is_missed_only_after_it_was_heard() -> None:
    rig = hover(NAV_DLL_ACT=3.0).stream(12.0, None, ZERO)
    rig.autopilot.on_heartbeat(STATION, 18)  # of a companion
    rig.stream(12.0, None, ZERO)
    rig.autopilot.on_heartbeat(STATION, 6)
    assert [rig.stream(s, None, ZERO).mode for s in (9.5, 1.0)] == ["Offboard", "Land"]


@pytest.mark.parametrize(
    ("limit", "velocity"),
    [("GF_MAX_HOR_DIST", (3.0, 0.0, 0.0)), ("GF_MAX_VER_DIST", (0.0, 0.0, -1.5))],
)
def test_beyond_the_cylinder_about_home_it_does_what_gf_action_says(
    limit: str, velocity: Vector
) -> None:
    rig = hover(GF_ACTION=3.0, **{limit: 20.0})
    assert rig.stream(3.0, UP).mode == "Offboard"
    assert rig.stream(8.0, None, velocity).mode == "Return"
    assert rig.texts.count("Geofence: approaching or outside geofence\t") == 1


# --- 3, 7: places, mission and fence --------------------------------------------------------------


def test_a_reposition_switches_to_hold_and_one_into_the_fence_is_refused() -> None:
    rig = hover()
    rig.plans[PlanKind.FENCE] = (FENCE,)

    def reposition(north_m: float, up_m: float) -> int:
        place = rig.place(north_m, 0.0, up_m)
        return rig.command(192, -1.0, 1.0, 0.0, NAN, *place, frame=5)

    assert [reposition(60.0, 15.0), reposition(-30.0, 20.0)] == [DENIED, ACCEPTED]
    assert rig.stream(20.0, None, ZERO).mode == "Hold"
    assert rig.ned_m == about((-30.0, 0.0, -20.0), 1.0)
    assert abs(rig.vehicle.heading_rad) == about(math.pi, 0.1)  # where it flew to
    rig.command(178, 1.0, 2.0, -1.0)  # in AUTO modes it counts
    reposition(-60.0, 20.0)
    assert rig.run(6.0).speed_m_s == about(2.0, 0.3)
    rig.command(192, -1.0, 1.0, 0.0, NAN, NAN, NAN, 503.0, frame=5)  # a height alone
    rig.run(8.0)
    assert (rig.speed_m_s, rig.height_m) == (about(0.0, 0.5), about(15.0, 0.7))


def test_it_flies_a_mission() -> None:
    rig, corners = on_ground(), ((40.0, 0.0), (40.0, 40.0))
    rig.plan(
        PlanKind.MISSION,
        item(22, 0.0, 0.0, 10.0),
        item(16, *corners[0], 10.0, 1.0),
        item(16, *corners[1], 15.0),
        item(20),
    )
    assert rig.status.mission_state == 2
    assert rig.command(300, 0.0, 0.0) == ACCEPTED
    began_s, nearest_m, modes = dict[int, float](), [math.inf, math.inf], list[str]()
    while rig.armed and rig.now_s < 200.0:
        rig.step()
        modes.append(rig.mode)
        began_s.setdefault(rig.autopilot.route.current, rig.now_s)
        away_m = (math.dist(rig.ne_m, place) for place in corners)
        nearest_m = list(map(min, nearest_m, away_m))
    assert list(began_s) == [0, 1, 2, 3]
    assert modes[-2] == "Return"  # as its last item says
    told_s = {seq: at for at, seq in rig.reached()}
    assert began_s[2] - told_s[1] == about(1.0, 0.05)  # when it comes there: then it waits
    assert max(nearest_m) < 10.5  # NAV_ACC_RAD
    assert rig.landed
    assert math.hypot(*rig.ne_m) < 2.0


def test_a_mission_is_left_for_offboard_and_a_breach_holds_until_another_command() -> None:
    rig = hover()
    rig.plan(PlanKind.MISSION, item(16, 40.0, 0.0, 15.0), item(16, 0.0, 40.0, 15.0))
    rig.command(300, 0.0, 0.0)
    assert rig.stream(3.0, None, ZERO).mode == "Mission"
    assert rig.set_mode(*OFFBOARD) == ACCEPTED
    rig.stream(3.0, UP)
    rig.plans[PlanKind.FENCE] = (FENCE,)
    while rig.ned_m[0] < 40.0:
        rig.stream(0.05, None, (4.0, 0.0, 0.0))
    for seconds in (1.0, 8.0):
        assert rig.stream(seconds, None, (4.0, 0.0, 0.0)).mode == "Hold"
        assert rig.texts.count("Geofence: approaching or outside geofence\t") == 1
    inside_m = rig.ned_m[0] - 40.0
    assert inside_m == about(5.0, 1.5)
    assert rig.set_mode(*OFFBOARD) == ACCEPTED
    rig.stream(3.0, None, (8.0, 0.0, 0.0))
    assert 8.0 < rig.ned_m[0] - 40.0 - inside_m < 24.0
