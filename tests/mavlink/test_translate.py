"""Fields against pymavlink's own packing and parsing, geodesy against pyproj's geodesics."""

import math
from typing import Any

import pyproj
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as wire

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import ARDUCOPTER
from companion.mavlink.translate import (
    command_long,
    event_of,
    heartbeat_message,
    mode_message,
    setpoint_message,
)
from companion.mission.events import (
    Estimator,
    Event,
    GpsFix,
    Home,
    Landed,
    LandedState,
    Mode,
    Position,
    Setpoint,
    VehicleStatus,
)

LATITUDE_DEG, LONGITUDE_DEG = 47.0, 8.0
FRAME = LocalFrame(latitude_deg=LATITUDE_DEG, longitude_deg=LONGITUDE_DEG)
GEOD = pyproj.Geod(ellps="WGS84")
CORNER = (100_000.0, 100_000.0, 3500.0)
SYSTEM = 7


def over_the_wire(message: Any) -> Any:
    """What the other side reads: packed to bytes by one codec, parsed by another."""
    frame = message.pack(wire.MAVLink(None, srcSystem=SYSTEM, srcComponent=195))
    assert frame[0] == 0xFD  # MAVLink 2
    [parsed] = wire.MAVLink(None).parse_buffer(frame)
    return parsed


def geodetic(north_m: float, east_m: float) -> tuple[float, float]:
    """A point of the azimuthal equidistant frame is at its distance and azimuth of the origin."""
    azimuth = math.degrees(math.atan2(east_m, north_m))
    longitude, latitude, _ = GEOD.fwd(
        LONGITUDE_DEG, LATITUDE_DEG, azimuth, math.hypot(north_m, east_m)
    )
    return latitude, longitude


def true_course_rad(north_m: float, east_m: float, bearing_rad: float) -> float:
    """Azimuth between two points on the ground, 20 m apart along a bearing of the local frame."""
    step_north, step_east = 10.0 * math.cos(bearing_rad), 10.0 * math.sin(bearing_rad)
    behind = geodetic(north_m - step_north, east_m - step_east)
    ahead = geodetic(north_m + step_north, east_m + step_east)
    azimuth, _, _ = GEOD.inv(behind[1], behind[0], ahead[1], ahead[0])
    return math.radians(azimuth)


def angle_between(a_rad: float, b_rad: float) -> float:
    return abs(math.remainder(a_rad - b_rad, math.tau))


def made(**changes: Any) -> Setpoint:
    values: dict[str, Any] = {
        "time_s": 12.3,
        "position_nea_m": CORNER,
        "velocity_nea_m_s": (100.0, -60.0, 5.0),
        "yaw_rad": 0.5,
    }
    return Setpoint(**{**values, **changes})


def event(message: Any, now_s: float = 1.5) -> Event | None:
    return event_of(over_the_wire(message), now_s, FRAME, ARDUCOPTER)


def at(lat_e7: int, lon_e7: int, **fields: int) -> Any:
    values = {"alt": 0, "relative_alt": 0, "vx": 0, "vy": 0, "vz": 0, "hdg": 0, **fields}
    return wire.MAVLink_global_position_int_message(12_300, lat_e7, lon_e7, **values)


# --- setpoints


def test_a_setpoint_is_a_place_amsl_in_frame_5_for_the_autopilot_of_the_vehicle() -> None:
    sent = over_the_wire(setpoint_message(made(), FRAME, SYSTEM))
    assert sent.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"
    assert (sent.target_system, sent.target_component) == (SYSTEM, 1)
    assert sent.coordinate_frame == 5 == wire.MAV_FRAME_GLOBAL_INT
    assert sent.time_boot_ms == 12_300
    latitude, longitude = geodetic(*CORNER[:2])
    assert sent.lat_int == pytest.approx(latitude * 1e7, abs=1)
    assert sent.lon_int == pytest.approx(longitude * 1e7, abs=1)
    assert sent.alt == 3500.0
    assert (sent.afx, sent.afy, sent.afz, sent.yaw_rate) == (0.0, 0.0, 0.0, 0.0)


def test_the_mask_uses_position_velocity_and_yaw_and_ignores_the_rest() -> None:
    ignored = (
        wire.POSITION_TARGET_TYPEMASK_AX_IGNORE
        | wire.POSITION_TARGET_TYPEMASK_AY_IGNORE
        | wire.POSITION_TARGET_TYPEMASK_AZ_IGNORE
        | wire.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
    )
    sent = over_the_wire(setpoint_message(made(), FRAME, SYSTEM))
    assert sent.type_mask == ignored == 2496


@pytest.mark.parametrize("bearing_deg", range(0, 360, 45))
@pytest.mark.parametrize("place", [CORNER, (0.0, 0.0, 3500.0), (-5000.0, 105_000.0, 3500.0)])
def test_velocity_and_nose_point_along_the_true_course(
    bearing_deg: int, place: tuple[float, float, float]
) -> None:
    bearing = math.radians(bearing_deg)
    velocity = (150.0 * math.cos(bearing), 150.0 * math.sin(bearing), 12.0)
    setpoint = made(position_nea_m=place, velocity_nea_m_s=velocity, yaw_rad=bearing)
    sent = over_the_wire(setpoint_message(setpoint, FRAME, SYSTEM))
    course = true_course_rad(*place[:2], bearing)
    # The frame is no conformal one: at the corner a right angle is off by 1e-4 rad.
    assert angle_between(math.atan2(sent.vy, sent.vx), course) < 1e-4
    assert angle_between(sent.yaw, course) < 1e-4
    assert math.hypot(sent.vx, sent.vy) == pytest.approx(150.0, rel=1e-6)
    assert sent.vz == pytest.approx(-12.0)


def test_the_convergence_at_the_corner_is_a_degree_and_not_forgotten() -> None:
    setpoint = made(velocity_nea_m_s=(150.0, 0.0, 0.0), yaw_rad=0.0)
    sent = over_the_wire(setpoint_message(setpoint, FRAME, SYSTEM))
    assert abs(sent.vy) > 2.0
    assert math.copysign(1.0, sent.vy) == math.copysign(1.0, true_course_rad(*CORNER[:2], 0.0))


@pytest.mark.parametrize("yaw_rad", [-100.0, -math.pi, 0.0, math.pi, 3.5, 100.0])
def test_yaw_is_sent_within_half_a_turn(yaw_rad: float) -> None:
    origin = (0.0, 0.0, 3500.0)
    sent = setpoint_message(made(position_nea_m=origin, yaw_rad=yaw_rad), FRAME, SYSTEM)
    parsed = over_the_wire(sent)
    assert abs(parsed.yaw) <= math.pi + 1e-6
    assert angle_between(parsed.yaw, yaw_rad) < 1e-6


numbers = st.one_of(
    st.floats(),
    st.floats(-2e5, 2e5),
    st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e9, -1e9, 1e38, 1e300, 2e7, 5e-324]),
)
triples = st.tuples(numbers, numbers, numbers)
sensible = st.tuples(st.floats(-2e5, 2e5), st.floats(-2e5, 2e5), st.floats(-1e3, 6e4))
frames = st.sampled_from([FRAME, LocalFrame(latitude_deg=0.0, longitude_deg=0.0)])


@given(
    time_s=st.one_of(numbers, st.floats(0.0, 4e6)),
    place=st.one_of(triples, sensible),
    velocity=st.one_of(triples, st.tuples(*[st.floats(-2e3, 2e3)] * 3)),
    yaw=st.one_of(numbers, st.floats(-4.0, 4.0)),
    frame=frames,
)
def test_nothing_that_is_not_finite_and_in_range_is_ever_sent(
    time_s: float,
    place: tuple[float, float, float],
    velocity: tuple[float, float, float],
    yaw: float,
    frame: LocalFrame,
) -> None:
    setpoint = Setpoint(time_s=time_s, position_nea_m=place, velocity_nea_m_s=velocity, yaw_rad=yaw)
    message = setpoint_message(setpoint, frame, SYSTEM)
    if message is None:
        return
    sent = over_the_wire(message)
    values = (sent.alt, sent.vx, sent.vy, sent.vz, sent.afx, sent.afy, sent.afz, sent.yaw)
    assert all(map(math.isfinite, (*values, sent.yaw_rate)))
    assert abs(sent.lat_int) <= 900_000_000
    assert abs(sent.lon_int) <= 1_800_000_000
    assert (sent.lat_int, sent.lon_int) != (0, 0)
    assert -500.0 <= sent.alt <= 50_000.0
    assert max(abs(sent.vx), abs(sent.vy), abs(sent.vz)) <= 1000.0
    assert sent.time_boot_ms == pytest.approx(1e3 * time_s, abs=0.501)


@given(place=st.tuples(st.floats(-2e5, 2e5), st.floats(-2e5, 2e5), st.floats(-500.0, 5e4)))
def test_what_is_in_range_is_sent_to_where_it_is(place: tuple[float, float, float]) -> None:
    sent = over_the_wire(setpoint_message(made(position_nea_m=place), FRAME, SYSTEM))
    latitude, longitude = geodetic(*place[:2])
    _, _, off_m = GEOD.inv(longitude, latitude, sent.lon_int * 1e-7, sent.lat_int * 1e-7)
    assert off_m < 0.02
    assert sent.alt == pytest.approx(place[2], abs=0.01)


@pytest.mark.parametrize(
    "changes",
    [
        {"time_s": math.nan},
        {"time_s": -0.1},
        {"time_s": 2.0**32 / 1e3},
        {"position_nea_m": (math.nan, 0.0, 3000.0)},
        {"position_nea_m": (0.0, math.inf, 3000.0)},
        {"position_nea_m": (0.0, 1e9, 3000.0)},
        {"position_nea_m": (0.0, 0.0, math.nan)},
        {"position_nea_m": (0.0, 0.0, 50_001.0)},
        {"position_nea_m": (0.0, 0.0, -501.0)},
        {"velocity_nea_m_s": (math.nan, 0.0, 0.0)},
        {"velocity_nea_m_s": (1001.0, 0.0, 0.0)},
        {"velocity_nea_m_s": (0.0, 0.0, -1001.0)},
        {"yaw_rad": math.inf},
        {"yaw_rad": math.nan},
    ],
    ids=str,
)
def test_a_setpoint_with_one_bad_value_is_refused(changes: dict[str, Any]) -> None:
    assert setpoint_message(made(**changes), FRAME, SYSTEM) is None


@pytest.mark.parametrize("off_m", [0.0, 0.001])
def test_a_setpoint_that_rounds_to_0_0_on_the_wire_is_refused(off_m: float) -> None:
    gulf = LocalFrame(latitude_deg=0.0, longitude_deg=0.0)
    assert setpoint_message(made(position_nea_m=(off_m, off_m, 100.0)), gulf, SYSTEM) is None


# --- events


@pytest.mark.parametrize("place", [CORNER, (0.0, 0.0, 3500.0), (-5000.0, 105_000.0, 4000.0)])
def test_a_position_is_read_where_it_was_with_velocity_along_the_frame(
    place: tuple[float, float, float],
) -> None:
    latitude, longitude = geodetic(*place[:2])
    bearing = 0.7
    course = true_course_rad(*place[:2], bearing)
    read = event(
        at(
            round(latitude * 1e7),
            round(longitude * 1e7),
            alt=round(place[2] * 1e3),
            relative_alt=123,
            vx=round(15_000 * math.cos(course)),
            vy=round(15_000 * math.sin(course)),
            vz=-250,
        )
    )
    assert isinstance(read, Position)
    assert read.time_s == 12.3
    assert read.position_nea_m == pytest.approx(place, abs=0.02)
    north, east, up = read.velocity_nea_m_s
    assert math.hypot(north, east) == pytest.approx(150.0, abs=0.01)
    assert math.atan2(east, north) == pytest.approx(bearing, abs=2e-4)
    assert up == pytest.approx(2.5)


@given(bearing=st.floats(-math.pi, math.pi), speed=st.floats(0.0, 300.0))
def test_setpoint_and_position_are_inverse_to_each_other(bearing: float, speed: float) -> None:
    velocity = (speed * math.cos(bearing), speed * math.sin(bearing), -3.0)
    sent = over_the_wire(setpoint_message(made(velocity_nea_m_s=velocity), FRAME, SYSTEM))
    speeds = (round(100 * sent.vx), round(100 * sent.vy), round(100 * sent.vz))
    fields = dict(zip(("vx", "vy", "vz"), speeds, strict=True))
    read = event(at(sent.lat_int, sent.lon_int, alt=round(1e3 * sent.alt), **fields))
    assert isinstance(read, Position)
    assert read.position_nea_m == pytest.approx(CORNER, abs=0.02)
    assert read.velocity_nea_m_s == pytest.approx(velocity, abs=0.011)


def test_latitude_and_longitude_0_are_no_position() -> None:
    assert event(at(0, 0)) is None


degrees_e7 = st.one_of(
    st.integers(-(2**31), 2**31 - 1), st.sampled_from([2**31 - 1, -(2**31), 900_000_001])
)


@given(lat_e7=degrees_e7, lon_e7=degrees_e7, alt=degrees_e7)
def test_a_position_is_finite_or_none(lat_e7: int, lon_e7: int, alt: int) -> None:
    read = event(at(lat_e7, lon_e7, alt=alt, vx=100, vy=-100, vz=3))
    if isinstance(read, Position):
        assert all(map(math.isfinite, (*read.position_nea_m, *read.velocity_nea_m_s)))


def heartbeat(custom_mode: int, base_mode: int) -> Any:
    return wire.MAVLink_heartbeat_message(2, 3, base_mode, custom_mode, 4, 3)


@pytest.mark.parametrize(
    ("number", "mode"),
    [(4, Mode.GUIDED), (17, Mode.HOLD), (9, Mode.LAND), (0, Mode.OTHER), (5, Mode.OTHER)],
)
@pytest.mark.parametrize("armed", [True, False])
def test_a_heartbeat_tells_mode_and_arming(number: int, mode: Mode, armed: bool) -> None:
    base = 1 | (wire.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    assert event(heartbeat(number, base)) == VehicleStatus(time_s=1.5, mode=mode, armed=armed)


@pytest.mark.parametrize("number", range(5))
def test_the_landed_states_are_those_of_the_message_definition(number: int) -> None:
    names = {
        "MAV_LANDED_STATE_UNDEFINED": Landed.UNKNOWN,
        "MAV_LANDED_STATE_ON_GROUND": Landed.ON_GROUND,
        "MAV_LANDED_STATE_IN_AIR": Landed.IN_AIR,
        "MAV_LANDED_STATE_TAKEOFF": Landed.TAKING_OFF,
        "MAV_LANDED_STATE_LANDING": Landed.LANDING,
    }
    expected = names[wire.enums["MAV_LANDED_STATE"][number].name]
    read = event(wire.MAVLink_extended_sys_state_message(0, number))
    assert read == LandedState(time_s=1.5, landed=expected)


def test_a_landed_state_of_a_later_standard_is_unknown() -> None:
    read = event(wire.MAVLink_extended_sys_state_message(0, 99))
    assert read == LandedState(time_s=1.5, landed=Landed.UNKNOWN)


@pytest.mark.parametrize(("fix_type", "good"), [(0, False), (2, False), (3, True), (6, True)])
def test_a_fix_is_good_from_three_dimensions_on(fix_type: int, good: bool) -> None:
    message = wire.MAVLink_gps_raw_int_message(0, fix_type, *([0] * 8))
    assert event(message) == GpsFix(time_s=1.5, good=good)


@pytest.mark.parametrize(
    ("flags", "good"), [(0x33F, True), (0x25, False), (0xA7, False), (0x10, True)]
)
def test_the_estimator_is_good_while_it_has_an_absolute_horizontal_position(
    flags: int, good: bool
) -> None:
    """Flags measured on ArduCopter: flying, GPS lost, before the first fix (ardupilot.md)."""
    message = wire.MAVLink_ekf_status_report_message(flags, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert event(message) == Estimator(time_s=1.5, good=good)


def test_home_is_an_altitude_amsl_in_metres() -> None:
    message = wire.MAVLink_home_position_message(0, 0, 584_070, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
    assert event(message) == Home(time_s=1.5, altitude_amsl_m=pytest.approx(584.07))


def test_other_messages_mean_nothing_to_the_mission() -> None:
    assert event(wire.MAVLink_system_time_message(0, 0)) is None


# --- commands


@pytest.mark.parametrize(
    ("mode", "number"), [(Mode.GUIDED, 4), (Mode.HOLD, 17), (Mode.LAND, 9)], ids=str
)
def test_a_mode_is_set_by_its_number(mode: Mode, number: int) -> None:
    sent = over_the_wire(mode_message(SYSTEM, mode, ARDUCOPTER))
    assert (sent.get_type(), sent.command) == ("COMMAND_LONG", 176)
    assert (sent.param1, sent.param2) == (1.0, number)
    assert (sent.target_system, sent.target_component) == (SYSTEM, 1)


def test_parameters_that_are_left_out_are_zero() -> None:
    sent = over_the_wire(command_long(SYSTEM, 400, 1.0))
    assert [getattr(sent, f"param{number}") for number in range(1, 8)] == [1.0] + [0.0] * 6
    assert sent.confirmation == 0


def test_the_heartbeat_is_that_of_an_onboard_controller_that_is_no_autopilot() -> None:
    sent = over_the_wire(heartbeat_message(wire.MAV_STATE_ACTIVE))
    assert (sent.type, sent.autopilot, sent.system_status) == (18, 8, 4)
    assert sent.base_mode == 0
