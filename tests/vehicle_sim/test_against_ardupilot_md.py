"""What ardupilot.md says of the real ArduPilot, statement by statement, tried over the wire.

A case is named by the section of the document and what it says there.  Nothing of the vehicle is
looked at but its frames.  Left out is what is stated elsewhere: tracking, stops and jumps
(test_tracking.py), rates (test_streams.py), who may send (test_routing.py), signing, the exchange
of plans, the plane (test_arduplane.py), boot and loss of GPS (test_estimator.py, conformance/).
"""

import functools
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from harness import (
    ALL,
    ATTITUDE,
    BRAKE,
    COMPANION,
    COPTER_LAND,
    ECHO,
    GCS,
    GUIDED,
    HOME_M,
    LOCAL_POSITION,
    PLANE_GUIDED,
    POSITION,
    POSITION_VELOCITY,
    VELOCITY,
    ZERO,
    Ids,
    Key,
    Vector,
    Wire,
    booted,
    circling,
    cruising,
    heartbeat,
    hovering,
    local,
    over_ground,
    place_e7,
    reposition,
)
from pymavlink.dialects.v20 import all as mavlink

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
NAN = math.nan
CASES: list[Any] = []

Check = Callable[[], None]


def says(section: str, statement: str) -> Callable[[Check], Check]:
    """The document says this in this section, and here is how it is tried."""

    def note(check: Check) -> Check:
        CASES.append(pytest.param(check, id=f"{section}: {statement}"))
        return check

    return note


def says_in_rows(
    section: str, rows: Mapping[str, tuple[Any, ...]]
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """The same, for each row of a table."""

    def note(check: Callable[..., None]) -> Callable[..., None]:
        for statement, values in rows.items():
            tried = functools.partial(check, *values)
            CASES.append(pytest.param(tried, id=f"{section}: {statement}"))
        return check

    return note


def numbers(*names: str) -> list[int]:
    return [getattr(mavlink, f"MAVLINK_MSG_ID_{name}") for name in names]


# --- the head: version and default parameters -----------------------------------------------------


@says_in_rows("head", {"copter": ("copter", 64495), "plane": ("plane", 62319)})
def version_and_capabilities(kind: Any, capabilities: int) -> None:
    wire = booted(kind)
    assert wire.command(512, 148) == ACCEPTED
    version = wire.last("AUTOPILOT_VERSION")
    assert version.flight_sw_version == 0x04070000
    assert version.capabilities == capabilities
    assert bytes(version.flight_custom_version) == b"2598e9d4"


# --- 0 and 1: boot --------------------------------------------------------------------------------


DEFAULTS = {
    "ANGLE_MAX": 3000,
    "WPNAV_SPEED": 1000,
    "WPNAV_ACCEL": 250,
    "PSC_JERK_XY": 5,
    "GUID_TIMEOUT": 3,
    "FS_GCS_ENABLE": 0,
    "WP_YAW_BEHAVIOR": 2,
    "DISARM_DELAY": 10,
    "FENCE_ENABLE": 0,
    "FENCE_TYPE": 7,
    "FENCE_ACTION": 1,
    "FENCE_RADIUS": 150,
    "FENCE_ALT_MAX": 100,
    "FENCE_MARGIN": 2,
    "MAV_SYSID": 1,
    "MAV_GCS_SYSID": 255,
    "MAV1_POSITION": 0,
    "MAV_OPTIONS": 0,
}


@says("head", "defaults of parameters, and the old names are gone")
def parameters() -> None:
    wire = booted()
    assert {name: wire.parameter(name) for name in DEFAULTS} == DEFAULTS
    begun_s = wire.now_s + 0.01
    for name in (b"SYSID_THISMAV", b"SYSID_MYGCS", b"SR0_POSITION"):
        wire.send(mavlink.MAVLink_param_request_read_message(1, 1, name, -1))
    wire.run(0.5)
    assert not wire.all("PARAM_VALUE", since_s=begun_s)


@says("1", "STATUSTEXT only after somebody was heard")
def texts_need_somebody() -> None:
    wire = Wire()
    wire.run(44.0)
    assert not wire.all("STATUSTEXT", link=None)
    wire.send(heartbeat(), link=1)
    wire.command(511, 230, 1e6, link=1)
    wire.run(0.5)
    assert wire.all("STATUSTEXT", link=1)
    assert not wire.all("STATUSTEXT", link=0)


# --- 0 and 1: rates -------------------------------------------------------------------------------


STREAMED = """SYS_STATUS GLOBAL_POSITION_INT LOCAL_POSITION_NED ATTITUDE ATTITUDE_QUATERNION
    GPS_RAW_INT EKF_STATUS_REPORT EXTENDED_SYS_STATE HOME_POSITION GPS_GLOBAL_ORIGIN
    MISSION_CURRENT SYSTEM_TIME VFR_HUD BATTERY_STATUS NAV_CONTROLLER_OUTPUT WIND
    AUTOPILOT_VERSION"""
SILENT = "POSITION_TARGET_LOCAL_NED POSITION_TARGET_GLOBAL_INT FENCE_STATUS DISTANCE_SENSOR"
"""In STABILIZE on the ground, without a fence and a range finder."""


@says("1 SET_MESSAGE_INTERVAL", "which are accepted and which denied")
def accepted_intervals() -> None:
    wire = booted()
    counts = dict.fromkeys(STREAMED.split(), 10) | dict.fromkeys(SILENT.split(), 0)
    assert {wire.interval(number, 5) for number in numbers(*counts)} == {ACCEPTED}
    assert {wire.interval(number, 5) for number in (230, 331, 64, 111, 330, 231)} == {DENIED}
    begun_s = wire.now_s + 0.01
    wire.run(2.0)
    told = {name: len(wire.all(name, since_s=begun_s)) for name in counts}
    assert told == pytest.approx(counts, abs=1)
    assert {name for name, count in told.items() if not count} == set(SILENT.split())
    current = wire.last("MISSION_CURRENT")
    ids = ("mission_id", "fence_id", "rally_points_id")
    assert [getattr(current, name, 0) for name in ids] == [0, 0, 0]


@says("1 SET_MESSAGE_INTERVAL", "POSITION_TARGET_GLOBAL_INT only while there is a waypoint")
def waypoint_echo() -> None:
    wire = hovering()
    wire.interval(87, 10)
    wire.send(local((60.0, 0.0, -30.0), mask=POSITION))
    wire.run(2.0)
    assert len(wire.all("POSITION_TARGET_GLOBAL_INT")) == pytest.approx(20, abs=2)
    told = wire.last("POSITION_TARGET_GLOBAL_INT")
    assert (told.lat_int, told.lon_int) == pytest.approx(place_e7(60.0, 0.0), abs=30)
    wire.send(local((60.0, 0.0, -30.0), (1.0, 0.0, 0.0), mask=POSITION_VELOCITY))
    begun_s = wire.now_s
    wire.run(2.0)
    assert not wire.all("POSITION_TARGET_GLOBAL_INT", since_s=begun_s + 0.01)
    assert wire.command(176, 1, 6) == ACCEPTED  # RTL
    wire.run(2.0)
    assert wire.all("POSITION_TARGET_GLOBAL_INT", since_s=begun_s + 0.01)


@says("1 SET_MESSAGE_INTERVAL", "POSITION_TARGET_LOCAL_NED only in guided modes")
def target_echo_in_guided() -> None:
    wire = hovering()
    wire.interval(ECHO, 50)
    wire.run(1.0)
    assert wire.all("POSITION_TARGET_LOCAL_NED")
    wire.command(176, 1, BRAKE)
    begun_s = wire.now_s
    wire.run(1.0)
    assert not wire.all("POSITION_TARGET_LOCAL_NED", since_s=begun_s + 0.03)


@says("1 SET_MESSAGE_INTERVAL", "FENCE_STATUS is silent until there is a fence")
def fence_status() -> None:
    wire = booted()
    wire.interval(162, 10)
    wire.run(0.5)
    assert not wire.all("FENCE_STATUS")
    wire.parameter("FENCE_ENABLE", 1.0)
    wire.run(0.5)
    assert wire.all("FENCE_STATUS")


@says_in_rows(
    "1 REQUEST_DATA_STREAM",
    {
        "POSITION": (6, {"GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"}),
        "EXTRA1": (10, {"ATTITUDE", "SIMSTATE"}),
    },
)
def group_of_streams(group: int, members: set[str]) -> None:
    wire = booted()
    wire.send(mavlink.MAVLink_request_data_stream_message(1, 1, group, 5, 1))
    wire.run(2.0)
    kinds = {each.kind for each in wire.heard if each.link == 0}
    assert members <= kinds
    assert "COMMAND_ACK" not in kinds
    if group == 6:
        assert kinds - {"HEARTBEAT", "TIMESYNC"} == members
        assert wire.parameter("MAV1_POSITION") == 5  # stored as the parameter of the group


@says_in_rows(
    "1 REQUEST_MESSAGE",
    {
        "what there is": (ACCEPTED, {242: "HOME_POSITION", 49: "GPS_GLOBAL_ORIGIN"}),
        "what there is not": (FAILED, {230: "ESTIMATOR_STATUS", 300: "PROTOCOL_VERSION"}),
    },
)
def one_message(result: int, names: dict[int, str]) -> None:
    for number, name in names.items():
        wire = booted()
        assert wire.command(512, number) == result
        wire.run(0.2)
        assert len(wire.all(name)) == (result == ACCEPTED)


@says("1", "PING is not answered")
def ping() -> None:
    wire = booted()
    wire.send(mavlink.MAVLink_ping_message(1, 1, 0, 0))
    wire.run(0.5)
    assert not wire.all("PING", link=None)


# --- 2: GUIDED, arming, take-off ------------------------------------------------------------------


def armed() -> Wire:
    wire = booted()
    for number in (LOCAL_POSITION, 245):
        wire.interval(number, 20)
    assert [wire.command(176, 1, GUIDED), wire.command(400, 1)] == [ACCEPTED, ACCEPTED]
    return wire


def climb(wire: Wire, metres: float) -> int | None:
    return wire.command(22, 0, 0, 0, 0, 0, 0, metres)


@says("2", "NAV_TAKEOFF fails disarmed, in STABILIZE and a second time in flight")
def take_off_that_fails() -> None:
    wire = booted()
    wire.command(176, 1, GUIDED)
    assert climb(wire, 30.0) == FAILED
    wire.command(176, 1, 0)
    assert wire.command(400, 1) == ACCEPTED
    assert climb(wire, 30.0) == FAILED
    assert climb(hovering(), 60.0) == FAILED


@says("2", "NAV_TAKEOFF: 5 m after 4.6 s, 30 m after 17 s, 2.5 m/s")
def take_off() -> None:
    wire = armed()
    wire.run(4.0)
    assert climb(wire, 30.0) == ACCEPTED
    assert wire.run_until(lambda: wire.ned_m[2] < -5.0, within_s=9.0) == pytest.approx(4.6, abs=0.4)
    fastest = 0.0

    def arrived() -> bool:
        nonlocal fastest
        fastest = max(fastest, -wire.last("LOCAL_POSITION_NED").vz)
        return bool(wire.ned_m[2] < -29.7)

    took_s = 4.6 + wire.run_until(arrived, within_s=20.0)
    assert took_s == pytest.approx(17.0, abs=1.5)
    assert fastest == pytest.approx(2.5, abs=0.15)


@says_in_rows("2", {f"NAV_TAKEOFF as COMMAND_INT in frame {f}": (f,) for f in (0, 3, 5, 6)})
def take_off_by_command_int(frame: int) -> None:
    result = armed().command(22, 0, 0, 0, 0, 0, 0, 30.0, frame=frame)
    assert (result == ACCEPTED) == (frame == 3)


@says("2", "a setpoint while landed is echoed but does not lift off")
def setpoint_on_the_ground() -> None:
    wire = armed()
    echo = wire.echo_of(local((10.0, 0.0, -20.0)))
    assert (echo.x, echo.z) == pytest.approx((10.0, -20.0), abs=0.1)
    wire.run(5.0)
    assert wire.ned_m[2] == pytest.approx(0.0, abs=0.1)
    assert wire.last("EXTENDED_SYS_STATE").landed_state == 1


@says("2", "a setpoint during take-off is taken at once and the take-off abandoned")
def setpoint_during_take_off() -> None:
    wire = armed()
    climb(wire, 30.0)
    wire.run(8.0)
    height_m = -wire.ned_m[2]
    assert 5.0 < height_m < 20.0
    echo = wire.echo_of(local((20.0, 0.0, -height_m)))
    assert echo.x == pytest.approx(20.0, abs=0.1)
    wire.run(15.0)
    assert wire.ned_m == pytest.approx((20.0, 0.0, -height_m), abs=0.5)


@says("2", "landed_state: 3 until about 1 s after the height is reached, then 2")
def take_off_finished() -> None:
    wire = armed()
    climb(wire, 20.0)
    wire.run_until(lambda: wire.ned_m[2] < -19.7, within_s=30.0)
    assert wire.last("EXTENDED_SYS_STATE").landed_state == 3
    in_air = lambda: wire.last("EXTENDED_SYS_STATE").landed_state == 2  # noqa: E731
    assert wire.run_until(in_air, within_s=5.0) == pytest.approx(1.0, abs=0.5)


@says("2", "LAND: landed_state 4 then 1, from 30 m in 35 s, disarms 2 s after touchdown")
def land() -> None:
    wire = hovering()
    wire.command(176, 1, COPTER_LAND)
    wire.run(0.5)
    assert wire.last("EXTENDED_SYS_STATE").landed_state == 4
    took_s = 0.5 + wire.run_until(lambda: wire.ned_m[2] > -0.05, within_s=50.0)
    assert took_s == pytest.approx(35.0, abs=1.5)
    disarmed = lambda: bool(wire.said_s("Disarming motors"))  # noqa: E731
    assert wire.run_until(disarmed, within_s=6.0) == pytest.approx(2.0, abs=0.4)
    wire.run(1.1)
    assert not wire.last("HEARTBEAT").base_mode & 0x80
    assert wire.last("EXTENDED_SYS_STATE").landed_state == 1


@says("2", "GUIDED without a setpoint holds")
def guided_holds() -> None:
    wire = hovering()
    wire.command(176, 1, BRAKE)
    wire.command(176, 1, GUIDED)
    wire.run(10.0)
    assert wire.ned_m == pytest.approx((0.0, 0.0, -30.0), abs=0.3)


@says("2", "AUTO without a mission fails, stays in GUIDED")
def auto_without_a_mission() -> None:
    wire = hovering()
    assert wire.command(176, 1, 3) == FAILED
    wire.run(1.1)
    assert wire.mode == GUIDED


def fastest_m_s(wire: Wire, seconds: float) -> float:
    begun_s = wire.now_s
    wire.run(seconds)
    told = wire.all("LOCAL_POSITION_NED", since_s=begun_s)
    return max(math.hypot(each.message.vx, each.message.vy) for each in told)


@says("2", "DO_CHANGE_SPEED limits position-only to 3.06 m/s and is forgotten with the submode")
def change_speed() -> None:
    wire = hovering()
    wire.send(local((300.0, 0.0, -30.0)))
    assert wire.command(178, 1, 3) == ACCEPTED
    assert fastest_m_s(wire, 10.0) == pytest.approx(3.06, abs=0.1)
    wire.send(local((60.0, 0.0, -30.0), (3.0, 0.0, 0.0), mask=POSITION_VELOCITY))
    wire.run(0.1)
    wire.send(local((300.0, 0.0, -30.0)))
    assert fastest_m_s(wire, 12.0) == pytest.approx(10.0, abs=0.6)


@says("2", "DO_CHANGE_SPEED does not limit position and velocity")
def change_speed_of_a_stream() -> None:
    wire, north_m = cruising(6.0, POSITION_VELOCITY)
    assert wire.command(178, 1, 3) == ACCEPTED
    for k in range(50):
        north = north_m + 0.6 * k
        wire.send(local((north, 0.0, -30.0), (6.0, 0.0, 0.0), mask=POSITION_VELOCITY))
        wire.run(0.1)
    assert wire.level_m_s == pytest.approx(6.0, abs=0.2)


# --- 3: masks -------------------------------------------------------------------------------------

P, V, A = "position", "velocity", "acceleration"
MASKS: dict[str, tuple[int, set[str]]] = {
    "0xDF8 position": (0xDF8, {P}),
    "0xDC0 position and velocity": (0xDC0, {P, V}),
    "0xC00 all": (0xC00, {P, V, A}),
    "0x9C0 with yaw rate": (0x9C0, {P, V}),
    "0x5C0 with the other": (0x5C0, {P, V}),
    "0x1C0 with both": (0x1C0, {P, V}),
    "0x000 everything": (0x000, {P, V, A}),
    "0xDC7 velocity": (0xDC7, {V}),
    "0xC07 velocity and acceleration": (0xC07, {V, A}),
    "0xC3F acceleration": (0xC3F, {A}),
    "0xDC1 no x: velocity": (0xDC1, {V}),
    "0xDC4 no z: velocity": (0xDC4, {V}),
    "0xDE0 no vz: position": (0xDE0, {P}),
    "0xD40 some of the acceleration: none": (0xD40, {P, V}),
    "0xC38 position and acceleration: stop": (0xC38, set()),
    "0xFFF nothing: stop": (0xFFF, set()),
    "0xDE7 part of a velocity alone: stop": (0xDE7, set()),
    "0xE00 force: stop": (0xE00, set()),
    "0xFC0 force, acceleration ignored": (0xFC0, {P, V}),
    "0xFF8 force, position only": (0xFF8, {P}),
    "0x1DC0 bit 12": (0x1DC0, {P, V}),
    "0xFDC0 bits 12 to 15": (0xFDC0, {P, V}),
}


@says_in_rows("3 masks", MASKS)
def mask_of_a_setpoint(mask: int, taken: set[str]) -> None:
    wire = hovering()
    echo = wire.echo_of(local((40.0, -7.0, -33.0), (2.0, 1.0, -0.5), (0.3, -0.2, 0.1), mask=mask))
    used = {name for name, bits in ((P, 7), (V, 0x38), (A, 0x1C0)) if not echo.type_mask & bits}
    if P in taken:
        assert (echo.x, echo.y, echo.z) == pytest.approx((40.0, -7.0, -33.0), abs=0.2)
    assert (P in used) is (P in taken)
    assert V not in used or taken != {P}
    if V in taken:
        assert (echo.vx, echo.vy, echo.vz) == pytest.approx((2.0, 1.0, -0.5), abs=0.05)
    elif P not in taken and A not in taken:
        assert (echo.vx, echo.vy, echo.vz) == pytest.approx(ZERO, abs=0.01)
    if A in taken:
        assert (echo.afx, echo.afy, echo.afz) == pytest.approx((0.3, -0.2, 0.1), abs=0.01)
    else:
        assert (echo.afx, echo.afy, echo.afz) == pytest.approx(ZERO, abs=0.01)
    assert not wire.texts(since_s=wire.now_s - 0.5)


@says("3 masks", "NaN in ignored fields is harmless")
def nan_that_is_ignored() -> None:
    wire = hovering()
    nans = (NAN, NAN, NAN)
    echo = wire.echo_of(local((40.0, 0.0, -30.0), nans, nans, mask=POSITION, yaw=NAN))
    assert echo.x == pytest.approx(40.0, abs=0.1)
    assert wire.not_survived is None


@says("3 masks", "stop from 5 m/s: 4.3, 2.9 and 1.4 m/s after 1, 2 and 3 s, without a text")
def stopping() -> None:
    wire, north_m = cruising(5.0, POSITION_VELOCITY)
    begun_s = wire.now_s
    speeds = []
    for _ in range(3):
        for _ in range(10):  # streamed at 10 Hz: each one begins the stop anew
            wire.send(local((north_m, 0.0, -30.0), mask=0xFFF))
            wire.run(0.1)
        speeds.append(wire.level_m_s)
    assert speeds == pytest.approx([4.3, 2.9, 1.4], abs=0.35)
    assert not wire.texts(since_s=begun_s)
    assert wire.mode == GUIDED


# --- 3: frames ------------------------------------------------------------------------------------


def aside() -> tuple[Wire, Vector, float]:
    """North and east of home, with its nose in no simple direction; place and heading."""
    wire = hovering()
    wire.send(local((20.0, 10.0, -30.0)))
    wire.run(14.0)
    yaw_rad = float(wire.last("ATTITUDE").yaw)
    assert abs(math.sin(2.0 * yaw_rad)) > 0.2
    return wire, wire.ned_m, yaw_rad


@says_in_rows("3 frames", {f"LOCAL_NED frame {f} is taken": (f,) for f in (1, 7, 8, 9)})
def local_frame(frame: int) -> None:
    wire, (north, east, down), yaw_rad = aside()
    echo = wire.echo_of(local((12.0, 4.0, -3.0), frame=frame))
    if frame == 1:
        wanted = (12.0, 4.0, -3.0)
    elif frame == 7:
        wanted = (north + 12.0, east + 4.0, down - 3.0)
    else:
        sine, cosine = math.sin(yaw_rad), math.cos(yaw_rad)
        ahead, right = 12.0 * cosine - 4.0 * sine, 12.0 * sine + 4.0 * cosine
        wanted = (north + ahead, east + right, down - 3.0)
    assert (echo.x, echo.y, echo.z) == pytest.approx(wanted, abs=0.3)


@says_in_rows("3 frames", {f"GLOBAL_INT frame {f} is taken": (f,) for f in (0, 5, 3, 6)})
def global_frame(frame: int) -> None:
    wire = hovering()
    wire.run(0.5)
    up_m = 40.0 + (HOME_M if frame in (0, 5) else 0.0)
    echo = wire.echo_of(over_ground(25.0, -15.0, up_m, frame=frame))
    assert (echo.x, echo.y) == pytest.approx((25.0, -15.0), abs=0.3)
    assert echo.z == pytest.approx(-40.0, abs=0.3)
    echo = wire.echo_of(
        over_ground(25.0, -15.0, up_m, (1.0, 0.5, 0.0), frame=frame, mask=POSITION_VELOCITY)
    )
    assert (echo.vx, echo.vy, echo.z) == pytest.approx((1.0, 0.5, -40.0), abs=0.3)
    echo = wire.echo_of(
        over_ground(25.0, -15.0, up_m, acceleration=(0.5, 0.0, 0.0), frame=frame, mask=ALL)
    )
    assert echo.afx == 0.0  # which GLOBAL_INT does not have


AHEAD = (2.0, 0.0, 0.0)
STOPS: dict[str, Any] = {
    **{
        f"LOCAL_NED frame {f}": local((12.0, 4.0, -3.0), frame=f)
        for f in (0, 2, 3, 4, 6, 10, 12, 20, 21)
    },
    **{f"GLOBAL_INT frame {f}": over_ground(25.0, 0.0, 40.0, frame=f) for f in (1, 2, 7, 8, 12)},
    **{
        f"GLOBAL_INT frame {f} with velocity": over_ground(
            25.0, 0.0, 40.0, AHEAD, mask=POSITION_VELOCITY, frame=f
        )
        for f in (10, 11)
    },
    "a latitude of 91 degrees": over_ground(126.4 * 111_318.845, 0.0, 40.0),
    **{
        f"velocity {v:g} m/s": local((9.0, 0, -30), (v, 0, 0), mask=POSITION_VELOCITY)
        for v in (NAN, 1001.0, -1001.0)
    },
}


@says_in_rows("3", {f"{what}: stop": (setpoint,) for what, setpoint in STOPS.items()})
def what_stops(setpoint: Any) -> None:
    wire = hovering()
    begun_s = wire.now_s
    echo = wire.echo_of(setpoint)
    assert echo.type_mask & 7
    assert (echo.vx, echo.vy, echo.vz) == ZERO
    assert not wire.texts(since_s=begun_s)
    assert wire.not_survived is None


@says_in_rows("0.4", {f"frame {f}: 1.5 m/s down, hardly along": (f,) for f in (10, 11)})
def above_terrain(frame: int) -> None:
    wire = hovering()
    wire.send(over_ground(50.0, 0.0, 30.0, frame=frame))
    wire.run(5.0)
    before_m = wire.ned_m[2]
    wire.run(5.0)
    assert (wire.ned_m[2] - before_m) / 5.0 == pytest.approx(1.5, abs=0.1)
    assert wire.ned_m[0] < 5.0
    wire.run(25.0)
    assert wire.ned_m[2] > -0.5


@says("3 frames", "LOCAL_NED z is relative to the EKF origin, also when home is moved")
def home_is_not_the_origin() -> None:
    wire = hovering()
    assert wire.command(179, 0, 0, 0, 0, *place_e7(100.0, 0.0), HOME_M + 20.0, frame=0) == ACCEPTED
    assert wire.echo_of(local((5.0, 0.0, -30.0))).z == pytest.approx(-30.0, abs=0.1)
    assert wire.echo_of(over_ground(5.0, 0.0, 30.0)).z == pytest.approx(-50.0, abs=0.1)
    assert wire.command(512, 49) == ACCEPTED
    assert wire.last("GPS_GLOBAL_ORIGIN").altitude == pytest.approx(HOME_M * 1e3, abs=50)


# --- 3: who may send ------------------------------------------------------------------------------


@says("3 who may send", "two senders: the last one to arrive is the target until the next")
def no_arbitration() -> None:
    wire = hovering()
    for _ in range(3):
        assert wire.echo_of(local((50.0, 0, -30)), source=GCS).x == pytest.approx(50.0, abs=0.1)
        assert wire.echo_of(local((-50.0, 0, -30))).x == pytest.approx(-50.0, abs=0.1)


# --- 3: tracking ----------------------------------------------------------------------------------


@says("3 tracking", "a yaw of CONDITION_YAW is reset by a setpoint that ignores yaw")
def condition_yaw() -> None:
    wire = hovering()
    assert wire.command(115, 120, 0, 1, 0) == ACCEPTED
    wire.run(5.0)
    assert math.degrees(wire.last("ATTITUDE").yaw) == pytest.approx(120.0, abs=1.0)
    wire.run(8.0, lambda: wire.send(local(ZERO, (5.0, 0.0, 0.0), mask=VELOCITY)))
    assert math.degrees(wire.last("ATTITUDE").yaw) == pytest.approx(0.0, abs=3.0)


@says("3 tracking", "setpoint to echo at 50 Hz: at most 33 ms")
def echo_latency() -> None:
    wire = hovering()
    wire.interval(ECHO, 50)
    delays = []
    for k in range(40):
        wire.run(0.013 * (k % 3))
        wire.send(local((10.0 + k, 0.0, -30.0)))
        sent_s = wire.now_s
        wire.run(0.05)
        delays.append(
            next(
                each.at_s - sent_s
                for each in wire.all("POSITION_TARGET_LOCAL_NED", since_s=sent_s)
                if each.message.x == pytest.approx(10.0 + k, abs=0.01)
            )
        )
    assert max(delays) <= 0.033
    assert np.median(delays) <= 0.021


# --- 3: stream stops, jumps -----------------------------------------------------------------------


@says("3 stops", "the echo's target runs on and then its velocity goes to 0")
def echo_after_the_last() -> None:
    wire, north_m = cruising(10.0, ALL)
    wire.send(local((north_m, 0.0, -30.0), (10.0, 0.0, 0.0), mask=ALL))
    wire.run(2.0)
    echo = wire.echo()
    assert echo.x == pytest.approx(north_m + 20.0, abs=0.5)
    assert echo.vx == pytest.approx(10.0, abs=0.1)
    wire.run(10.0)
    echo = wire.echo()
    assert echo.x == pytest.approx(north_m + 30.0, abs=0.5)
    assert echo.vx == 0.0


@says("0.2", "a path that ends with zero-velocity setpoints is not overshot by much")
def ends_with_zeros() -> None:
    wire, north_m = cruising(5.0, ALL)
    end_m = north_m + 12.5
    for k in range(50):  # braking at 1 m/s2
        t = 0.1 * k
        v = 5.0 - t
        wire.send(
            local((north_m + 5.0 * t - 0.5 * t * t, 0.0, -30.0), (v, 0, 0), (-1, 0, 0), mask=ALL)
        )
        wire.run(0.1)
    wire.run(1.0, lambda: wire.send(local((end_m, 0.0, -30.0), mask=POSITION_VELOCITY)))
    wire.run(8.0)
    assert wire.ned_m[0] == pytest.approx(end_m, abs=0.3)


@says("3 stops", "after a gap of 10 s, resuming where the path should be: a sprint at 15 m/s")
def resumed_after_a_gap() -> None:
    wire, north_m = cruising(10.0, POSITION_VELOCITY)
    wire.run(10.0)
    north_m += 100.0
    fastest = 0.0
    for _ in range(200):
        wire.send(local((north_m, 0.0, -30.0), (10.0, 0.0, 0.0), mask=POSITION_VELOCITY))
        wire.run(0.1)
        north_m += 1.0
        fastest = max(fastest, wire.level_m_s)
    assert fastest == pytest.approx(15.0, abs=1.5)


# --- 3: values that are not survived or not checked -----------------------------------------------

NOT_SURVIVED: dict[str, tuple[Any]] = {
    "NaN x": (local((NAN, 0.0, -30.0)),),
    "NaN z": (local((0.0, 0.0, NAN)),),
    "NaN altitude": (over_ground(10.0, 0.0, NAN),),
    "NaN used acceleration": (local(ZERO, ZERO, (NAN, 0.0, 0.0), mask=ALL),),
    "NaN used yaw": (local((0.0, 0.0, -30.0), mask=0x9F8, yaw=NAN),),
    "x = 1e9": (local((1e9, 0.0, -30.0)),),
    "an altitude of 1e9": (over_ground(10.0, 0.0, 1e9),),
}


@says_in_rows("3 values", {f"{what} is the end of it": row for what, row in NOT_SURVIVED.items()})
def not_survived(setpoint: Any) -> None:
    wire = hovering()
    begun_s = wire.now_s
    wire.run(1.0, lambda: wire.send(setpoint))
    assert wire.not_survived is not None
    (text,) = wire.texts(since_s=begun_s)  # once
    assert text.startswith("SIM:")
    wire.run(5.0)
    assert wire.ned_m[2] == pytest.approx(-30.0, abs=1.0)


@says("0.3", "lat/lon 0,0 is accepted: it flies off at full speed")
def to_null_island() -> None:
    wire = hovering()
    setpoint = over_ground(0.0, 0.0, 30.0)
    setpoint.lat_int = setpoint.lon_int = 0
    wire.send(setpoint)
    wire.run(15.0)
    assert wire.level_m_s > 9.0
    assert wire.not_survived is None


@says("3 values", "z = +50 is accepted: it descends")
def below_the_ground() -> None:
    wire = hovering()
    wire.send(local((0.0, 0.0, 50.0)))
    wire.run(6.0)
    assert wire.last("LOCAL_POSITION_NED").vz == pytest.approx(1.5, abs=0.1)


@says("3 values", "velocity 200 m/s and acceleration 1000 m/s2 are accepted; the target runs away")
def target_runs_away() -> None:
    wire = hovering()
    setpoint = local((0.0, 0.0, -30.0), (200.0, 0.0, 0.0), (1000.0, 0.0, 0.0), mask=ALL)
    wire.send(setpoint)
    wire.run(2.9)
    echo = wire.echo()
    assert 1000.0 < echo.x < 6000.0  # 4508 at some time of the measurement
    assert wire.not_survived is None


# --- 4: fence, mission, rally ---------------------------------------------------------------------

FENCE, MISSION, RALLY = 1, 0, 2


def fence_item(command: int, p1: float, north_m: float, east_m: float) -> Any:
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, 0, 0, command, 0, 1, p1, 0, 0, 0, *place_e7(north_m, east_m), 0.0, FENCE
    )


def fence_circle(north_m: float, east_m: float, radius_m: float, *, command: int = 5004) -> Any:
    return fence_item(command, radius_m, north_m, east_m)


def polygon(*corners: tuple[float, float]) -> list[Any]:
    return [fence_item(5001, len(corners), n, e) for n, e in corners]


SQUARE = ((-200.0, -200.0), (-200.0, 200.0), (200.0, 200.0), (200.0, -200.0))


@says("4", "it asks with MISSION_REQUEST; 6 items take 55 ms, 60 half a second; 40 ms back")
def exchange_takes() -> None:
    wire = booted()
    for count, wanted in ((6, pytest.approx(0.055, abs=0.03)), (60, pytest.approx(0.5, rel=0.4))):
        turns = [math.tau * k / count for k in range(count)]
        items = polygon(*((300 * math.cos(turn), 300 * math.sin(turn)) for turn in turns))
        begun_s = wire.now_s
        assert wire.upload(items, FENCE) == ACCEPTED
        assert wire.now_s - begun_s == wanted
        begun_s = wire.now_s
        got = wire.download(FENCE)
        assert wire.now_s - begun_s == pytest.approx(0.04 * count / 6, abs=0.04 + 0.04 * count / 6)
        assert [(item.seq, item.x, item.y) for item in got] == [(i.seq, i.x, i.y) for i in items]


@says("4", "the total of a mission does not count item 0, which is home")
def total_of_a_mission() -> None:
    wire = booted()
    place = (*place_e7(50.0, 0.0), 20.0)
    items = [
        mavlink.MAVLink_mission_item_int_message(
            1, 1, 0, 3, command, 0, 1, 0, 0, 0, 0, *place, MISSION
        )
        for command in (16, 22, 16, 20)
    ]
    assert wire.upload(items, MISSION) == ACCEPTED
    wire.interval(42, 5)
    wire.run(0.5)
    assert wire.last("MISSION_CURRENT").total == 3


@says("4", "GCS on SERIAL0 and companion on SERIAL1 both may upload and download")
def anyone_may_upload() -> None:
    wire = booted()
    assert wire.upload(polygon(*SQUARE), FENCE, source=GCS, link=0) == 0
    assert len(wire.download(FENCE, source=COMPANION, link=1)) == 4
    assert wire.upload(polygon(*SQUARE[:3]), FENCE, source=COMPANION, link=1) == 0
    assert len(wire.download(FENCE, source=GCS, link=0)) == 3


@says("4", "the exchange is not forwarded, and nobody is told of a change")
def no_notification() -> None:
    wire = booted()
    wire.send(heartbeat(), source=COMPANION, link=1)
    wire.run(1.0)
    begun_s = wire.now_s
    wire.upload(polygon(*SQUARE), FENCE, source=GCS)
    wire.run(1.0)
    told = {each.kind for each in wire.heard if each.link == 1 and each.at_s > begun_s}
    assert not {kind for kind in told if kind.startswith(("MISSION", "FENCE"))}


def fenced(*items: Any, enable: bool = True, lean_deg: int = 45) -> Wire:
    wire = hovering(lean_deg)
    wire.parameter("FENCE_TYPE", 4.0)
    assert wire.upload(list(items), FENCE) == 0
    if enable:
        wire.parameter("FENCE_ENABLE", 1.0)
    wire.run(0.5)
    return wire


def stream_north(
    wire: Wire, speed_m_s: float, seconds: float, mask: int, east_m: float = 0.0
) -> float:
    """From above home; returns how far north it got at most."""
    north_m = most_m = 0.0
    for k in range(round(seconds * 10)):
        v = min(0.2 * k, speed_m_s)
        wire.send(local((north_m, east_m, -30.0), (v, 0.0, 0.0), mask=mask))
        wire.run(0.1)
        north_m += 0.1 * v
        most_m = max(most_m, wire.ned_m[0])
    return most_m


@says("4", "an uploaded fence does nothing until it is enabled")
def fence_that_is_off() -> None:
    wire = fenced(fence_circle(80, 0, 15), enable=False)
    assert stream_north(wire, 8.0, 18.0, ALL) > 90.0
    assert wire.mode == GUIDED


@says_in_rows(
    "4",
    {
        "FENCE_TYPE 7: FENCE_RADIUS": ((200.0, 0.0, -30.0),),
        "FENCE_TYPE 7: FENCE_ALT_MAX": ((0.0, 0.0, -110.0),),
    },
)
def cylinder_and_height(beyond: Vector) -> None:
    wire = hovering(45)
    wire.parameter("FENCE_ENABLE", 1.0)
    begun_s = wire.now_s
    assert wire.echo_of(local((50.0, 0.0, -30.0))).x == pytest.approx(50.0, abs=0.1)
    echo = wire.echo_of(local(beyond))  # dropped without any message
    assert (echo.x, echo.z) == pytest.approx((50.0, -30.0), abs=0.1)
    assert not wire.texts(since_s=begun_s)


@says_in_rows(
    "4",
    {
        "a target inside an exclusion is dropped": ([fence_circle(80, 0, 15)], 80.0),
        "a target outside an inclusion is dropped": ([fence_circle(0, 0, 60, command=5003)], 80.0),
    },
)
def target_in_a_fence(items: list[Any], north_m: float) -> None:
    wire = fenced(*items)
    begun_s = wire.now_s
    assert wire.echo_of(local((40.0, 0.0, -30.0))).x == pytest.approx(40.0, abs=0.1)
    assert wire.echo_of(local((north_m, 0.0, -30.0))).x == pytest.approx(40.0, abs=0.1)
    assert not wire.texts(since_s=begun_s)


@says("0.6", "streaming through an exclusion at 8 m/s: breach, RTL, 14.5 m deep")
def into_an_exclusion() -> None:
    wire = fenced(fence_circle(80, 0, 15))
    most_m = stream_north(wire, 8.0, 22.0, ALL)
    assert wire.said_s("Polygon fence breached")
    assert wire.mode == 6
    assert most_m - 65.0 == pytest.approx(14.5, abs=1.5)


@says("4", "a position beyond an exclusion: straight through the centre, breach, RTL")
def beyond_an_exclusion() -> None:
    wire = fenced(fence_circle(80, 0, 15))
    wire.send(local((140.0, 0.0, -30.0)))
    wire.run_until(lambda: bool(wire.said_s("Polygon fence breached")), within_s=25.0)
    assert wire.ned_m[0] == pytest.approx(66.0, abs=2.0)
    assert wire.ned_m[1] == pytest.approx(0.0, abs=0.5)
    wire.run(1.1)
    assert wire.mode == 6


@says("4", "passing 1 m outside the edge at 8 m/s: no reaction")
def past_the_edge() -> None:
    wire = fenced(fence_circle(60, 20, 15))
    begun_s = wire.now_s
    for _ in range(30):  # over to the line that is 4 m east of home first
        wire.send(local((0.0, 4.0, -30.0)))
        wire.run(0.2)
    stream_north(wire, 8.0, 20.0, ALL, east_m=4.0)
    apart = [
        math.hypot(each.message.x - 60.0, each.message.y - 20.0) - 15.0
        for each in wire.all("LOCAL_POSITION_NED", since_s=begun_s)
    ]
    assert min(apart) == pytest.approx(0.97, abs=0.1)
    assert not wire.said_s("breached")
    assert wire.mode == GUIDED


@says("4", "a fence uploaded around the vehicle: breach after 0.5 s, RTL; GUIDED can be had again")
def fence_around_the_vehicle() -> None:
    wire = fenced(fence_circle(300, 0, 5))
    assert wire.upload([fence_circle(0, 0, 20)], FENCE) == 0
    begun_s = wire.now_s
    wire.run(2.5)
    (breach_s,) = wire.said_s("Polygon fence breached")
    assert breach_s - begun_s == pytest.approx(0.5, abs=0.4)
    assert wire.mode == 6
    assert wire.command(176, 1, GUIDED) == ACCEPTED
    wire.run(1.1)
    assert wire.mode == GUIDED


# --- 5: components, routing, failsafe -------------------------------------------------------------


def lose_the_ground_station(heard: Ids) -> tuple[Wire, float]:
    """The companion streams on, this one beats on; when the ground station was last heard."""
    wire = hovering()
    wire.parameter("FS_GCS_ENABLE", 1.0)

    def talk() -> None:
        wire.send(heartbeat(), local((5.0, 0.0, -30.0)))
        wire.send(heartbeat(6), source=heard)

    wire.send(heartbeat(6), source=GCS)
    last_s = wire.now_s
    wire.run(8.0, talk)
    return wire, last_s


@says("5", "GCS failsafe: RTL 4.9 s after 255 was last heard, whatever the companion sends")
def gcs_failsafe() -> None:
    wire, last_s = lose_the_ground_station((254, 190))
    (said_s,) = wire.said_s("GCS Failsafe")
    assert said_s - last_s == pytest.approx(4.9, abs=0.2)
    assert wire.mode == 6


@says("5", "a companion with sysid 255 keeps the GCS failsafe fed")
def fed_failsafe() -> None:
    wire, _ = lose_the_ground_station((255, 77))
    assert not wire.said_s("GCS Failsafe")
    assert wire.mode == GUIDED


@says("5", "the companion's own death is not noticed")
def companion_dies() -> None:
    wire = hovering()
    wire.parameter("FS_GCS_ENABLE", 1.0)
    wire.send(heartbeat(), source=COMPANION, link=1)
    begun_s = wire.now_s
    wire.run(12.0, lambda: wire.send(heartbeat(6), source=GCS))
    assert wire.mode == GUIDED
    assert not wire.texts(since_s=begun_s + 0.1)


# --- 5: signing -----------------------------------------------------------------------------------

SECRET, SECOND = bytes(range(32)), 100_000
"""Of time stamps: 10 microseconds each."""
THEN = 3600 * 24 * 365 * 11 * SECOND
CHANNEL, RADIO = 0, 1


def setup_signing(secret: bytes = SECRET, timestamp: int = THEN) -> Any:
    return mavlink.MAVLink_setup_signing_message(1, 1, list(secret), timestamp)


def signed() -> Wire:
    wire = booted()
    wire.send(setup_signing(), source=GCS, link=CHANNEL)
    wire.run(13.0)
    return wire


def answers(wire: Wire, link: int, after_s: float | None = None, secret: bytes = SECRET) -> bool:
    """Whether the vehicle takes what is so signed on this link; after_s: None is unsigned."""
    key = None
    if after_s is not None:
        key = Key(secret=secret, link=7, timestamp=THEN + round(after_s * SECOND))
    begun = len(wire.heard)
    question = mavlink.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0)
    wire.send(question, source=GCS, link=link, key=key)
    wire.run(0.05)
    return any(e.kind == "COMMAND_ACK" and e.link == link for e in wire.heard[begun:])


@says("5 signing", "unsigned is taken on channel 0 alone, and signed with the right key elsewhere")
def signatures() -> None:
    wire = signed()
    assert answers(wire, CHANNEL)
    assert not answers(wire, RADIO)
    assert not answers(wire, RADIO, 75.0, bytes(32 * [9]))
    assert answers(wire, RADIO, 75.0)
    assert not answers(wire, RADIO, -30.0)
    wire.send(heartbeat(), source=COMPANION, link=RADIO)
    wire.run(0.1)
    assert not [each for each in wire.heard if each.source == COMPANION]  # not passed on either
    wire.send(setup_signing(bytes(32), 0), source=GCS, link=CHANNEL)
    wire.run(1.1)
    assert not wire.heard[-1].frame[2] & 1  # a key of zeros turns it off
    assert answers(wire, RADIO)


# --- 5: reboot ------------------------------------------------------------------------------------


@says("5 reboot", "heartbeat gap 2.1 s, another port, intervals gone, time_boot_ms restarts")
def reboot() -> None:
    wire = booted()
    wire.interval(ATTITUDE, 10)
    wire.run(1.0)
    wire.takes_new_port()
    before_ms = wire.last("ATTITUDE").time_boot_ms
    assert wire.command(246, 1) == ACCEPTED
    wire.run(10.0)
    assert wire.takes_new_port()
    beats = [each.at_s for each in wire.all("HEARTBEAT")]
    assert max(np.diff(beats)) == pytest.approx(2.1, abs=1.0)  # counted from the one before
    booted_s = 46.0
    assert not wire.all("ATTITUDE", since_s=booted_s + 0.5)
    wire.interval(ATTITUDE, 10)
    wire.run(0.5)
    assert wire.last("ATTITUDE").time_boot_ms < min(before_ms, 12_000)


# --- 7: plane -------------------------------------------------------------------------------------


def away_m(wire: Wire) -> float:
    return math.hypot(*wire.ned_m[:2])


@says("7", "SET_POSITION_TARGET_LOCAL_NED frame 7 adds up: five times z = -1, +5 m")
def plane_increments() -> None:
    wire = circling()
    for _ in range(5):
        wire.send(local((0.0, 0.0, -1.0), frame=7))
        wire.run(0.2)
    wire.run(15.0)
    assert -wire.ned_m[2] == pytest.approx(85.0, abs=1.0)


@says("7", "SET_POSITION_TARGET_LOCAL_NED frame 1 is ignored")
def plane_ignores() -> None:
    wire = circling()
    wire.run(20.0, lambda: wire.send(local((3000.0, 0.0, -150.0))))
    assert -wire.ned_m[2] == pytest.approx(80.0, abs=1.5)
    assert away_m(wire) < 120.0


@says_in_rows(
    "7",
    {
        f"radius {asked} m, p4 = {ccw:g}: flown {flown} m": (asked, flown, ccw)
        for asked, flown, ccw in ((40, 60, 0.0), (80, 97, 1.0), (150, 167, 0.0))
    },
)
def plane_radius(asked_m: float, flown_m: float, ccw: float) -> None:
    wire = circling()
    assert reposition(wire, 0.0, 0.0, 80.0, radius_m=asked_m, ccw=ccw) == ACCEPTED
    for kept in (-40.0, NAN):
        assert reposition(wire, 0.0, 0.0, 80.0, radius_m=kept, ccw=ccw) == ACCEPTED
    wire.run(40.0)
    begun_s = wire.now_s
    wire.run(15.0)
    told = wire.all("LOCAL_POSITION_NED", since_s=begun_s)
    mean_m = np.mean([math.hypot(e.message.x, e.message.y) for e in told])
    assert mean_m == pytest.approx(flown_m, abs=3.0)
    turn = told[0].message.x * told[10].message.y - told[0].message.y * told[10].message.x
    assert (turn < 0.0) is bool(ccw)


@says("7", "a new point ends a heading")
def plane_heading_ends() -> None:
    wire = circling()
    wire.command(43002, 0, 90.0, 3.0, frame=0)
    wire.run(15.0)
    assert reposition(wire, 0.0, 0.0, 80.0) == ACCEPTED
    wire.run(60.0)
    assert away_m(wire) < 130.0


@says("7", "stream stops: it circles the last point for ever, no message")
def plane_stream_stops() -> None:
    wire = circling()
    for k in range(20):
        reposition(wire, 100.0 + 10.0 * k, 0.0, 80.0, radius_m=60.0)
        wire.run(0.25)
    begun_s = wire.now_s
    wire.run(60.0)
    north, east, _ = wire.ned_m
    assert math.hypot(north - 290.0, east) == pytest.approx(78.0, abs=5.0)
    assert not wire.texts(since_s=begun_s)
    assert wire.mode == PLANE_GUIDED


@says("7", "MISSION_ITEM_REACHED about once a second while a near point is streamed")
def plane_reaches() -> None:
    """How often it was streamed there is not told: once a second here."""
    wire = circling()
    begun_s = wire.now_s
    for _ in range(20):
        north, east, _ = wire.ned_m
        reposition(wire, north + 20.0, east, 80.0, radius_m=60.0)
        wire.run(0.98)
    reached = wire.all("MISSION_ITEM_REACHED", since_s=begun_s)
    assert len(reached) == pytest.approx(20, abs=4)


# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("check", CASES)
def test_what_the_document_says_of_the_real_one_holds_for_this_one(check: Check) -> None:
    check()
