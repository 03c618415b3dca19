"""Events against pymavlink's own packing and parsing, geodesy against pyproj's geodesics."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as wire
from wires import (
    CORNER,
    FRAME,
    GEOD,
    PLACES,
    SYSTEM,
    angle_between,
    geodetic,
    over_the_wire,
    true_course_rad,
)

from companion.mavlink.autopilots import (
    ALL,
    ARDUCOPTER,
    ARDUPLANE,
    PX4_MULTICOPTER,
    Autopilot,
)
from companion.mission.events import (
    Battery,
    Echo,
    Event,
    GpsFix,
    Home,
    Landed,
    LandedState,
    Origin,
    Position,
    Setpoint,
    Vector,
    VehicleStatus,
)
from vehicle_sim.autopilot.earth import FlatEarth, Projection
from vehicle_sim.autopilot.values import Place

each = pytest.mark.parametrize("autopilot", ALL, ids=lambda a: a.name)


def event(
    message: Any, autopilot: Autopilot = ARDUCOPTER, origin_nea_m: Vector | None = None
) -> Event | None:
    return autopilot.event_of(over_the_wire(message), 1.5, FRAME, origin_nea_m)


def at(lat_e7: int, lon_e7: int, **fields: int) -> Any:
    values = {"alt": 0, "relative_alt": 0, "vx": 0, "vy": 0, "vz": 0, "hdg": 0, **fields}
    return wire.MAVLink_global_position_int_message(12_300, lat_e7, lon_e7, **values)


@pytest.mark.parametrize("place", PLACES)
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
            hdg=round(math.degrees(course) * 100),
        )
    )
    assert isinstance(read, Position)
    assert read.heading_rad is not None
    assert angle_between(read.heading_rad, bearing) < 3e-4
    assert read.time_s == 12.3
    assert read.position_nea_m == pytest.approx(place, abs=0.02)
    north, east, up = read.velocity_nea_m_s
    assert math.hypot(north, east) == pytest.approx(150.0, abs=0.01)
    assert math.atan2(east, north) == pytest.approx(bearing, abs=2e-4)
    assert up == pytest.approx(2.5)
    unknown = event(at(round(latitude * 1e7), round(longitude * 1e7), hdg=65_535))
    assert isinstance(unknown, Position)
    assert unknown.heading_rad is None


@given(bearing=st.floats(-math.pi, math.pi), speed=st.floats(0.0, 300.0))
def test_setpoint_and_position_are_inverse_to_each_other(bearing: float, speed: float) -> None:
    velocity = (speed * math.cos(bearing), speed * math.sin(bearing), -3.0)
    setpoint = Setpoint(
        time_s=12.3, position_nea_m=CORNER, velocity_nea_m_s=velocity, yaw_rad=bearing
    )
    messages = ARDUCOPTER.setpoint(setpoint, FRAME, SYSTEM, 0.0)
    assert messages is not None
    sent = over_the_wire(messages[0])
    speeds = (round(100 * sent.vx), round(100 * sent.vy), round(100 * sent.vz))
    fields = dict(zip(("vx", "vy", "vz"), speeds, strict=True))
    read = event(at(sent.lat_int, sent.lon_int, alt=round(1e3 * sent.alt), **fields))
    assert isinstance(read, Position)
    assert read.position_nea_m == pytest.approx(CORNER, abs=0.02)
    assert read.velocity_nea_m_s == pytest.approx(velocity, abs=0.011)


@pytest.mark.parametrize("place", [(0, 0), (3090, -717), (-99_000, 99_000), (0, 80_000_000)])
def test_about_latitude_and_longitude_0_there_is_no_position(place: tuple[int, int]) -> None:
    """3090, -717 was recorded: an ArduPlane that has no fix yet; on the equator there are some."""
    assert (event(at(*place)) is None) == (place[1] < 100_000)


degrees_e7 = st.one_of(
    st.integers(-(2**31), 2**31 - 1), st.sampled_from([2**31 - 1, -(2**31), 900_000_001])
)


@given(lat_e7=degrees_e7, lon_e7=degrees_e7, alt=degrees_e7)
def test_a_position_is_finite_or_none(lat_e7: int, lon_e7: int, alt: int) -> None:
    read = event(at(lat_e7, lon_e7, alt=alt, vx=100, vy=-100, vz=3))
    if isinstance(read, Position):
        assert all(map(math.isfinite, (*read.position_nea_m, *read.velocity_nea_m_s)))


@each
@pytest.mark.parametrize("armed", [True, False])
@pytest.mark.parametrize("status", range(9))
def test_a_heartbeat_tells_of_arming_and_of_a_failsafe(
    autopilot: Autopilot, armed: bool, status: int
) -> None:
    base = 1 | (wire.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    read = event(wire.MAVLink_heartbeat_message(2, 3, base, 4, status, 3), autopilot)
    assert isinstance(read, VehicleStatus)
    assert (read.time_s, read.armed) == (1.5, armed)
    name = wire.enums["MAV_STATE"][status].name
    assert read.failsafe == (name in ("MAV_STATE_CRITICAL", "MAV_STATE_EMERGENCY"))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("UNDEFINED", Landed.UNKNOWN),
        ("ON_GROUND", Landed.ON_GROUND),
        ("IN_AIR", Landed.IN_AIR),
        ("TAKEOFF", Landed.TAKING_OFF),
        ("LANDING", Landed.LANDING),
        ("of a later standard", Landed.UNKNOWN),
    ],
)
def test_the_landed_states_are_those_of_the_message_definition(name: str, expected: Landed) -> None:
    number = getattr(wire, f"MAV_LANDED_STATE_{name}", 99)
    read = event(wire.MAVLink_extended_sys_state_message(0, number))
    assert read == LandedState(time_s=1.5, landed=expected)


@pytest.mark.parametrize(("fix_type", "good"), [(0, False), (2, False), (3, True), (6, True)])
def test_a_fix_is_good_from_three_dimensions_on(fix_type: int, good: bool) -> None:
    message = wire.MAVLink_gps_raw_int_message(0, fix_type, *([0] * 8))
    assert event(message) == GpsFix(time_s=1.5, good=good)


@pytest.mark.parametrize("kind", [Home, Origin])
def test_home_and_origin_are_places_amsl(kind: type) -> None:
    latitude, longitude = geodetic(*CORNER[:2])
    place = (round(latitude * 1e7), round(longitude * 1e7))

    def said(latitude_e7: int, longitude_e7: int) -> Event | None:
        if kind is Origin:
            return event(wire.MAVLink_gps_global_origin_message(latitude_e7, longitude_e7, 584_070))
        rest = (584_070, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
        return event(wire.MAVLink_home_position_message(latitude_e7, longitude_e7, *rest))

    read = said(*place)
    assert isinstance(read, kind)
    assert read.position_nea_m == pytest.approx((*CORNER[:2], 584.07), abs=0.02)  # type: ignore[attr-defined]
    assert said(0, 0) is None


@pytest.mark.parametrize(("percent", "remaining"), [(0, 0.0), (37, 0.37), (100, 1.0), (-1, None)])
def test_what_is_left_in_the_battery_is_a_share_or_unknown(
    percent: int, remaining: float | None
) -> None:
    status = wire.MAVLink_sys_status_message(0, 0, 0, 0, 12_000, 0, percent, 0, 0, 0, 0, 0, 0)
    battery = wire.MAVLink_battery_status_message(0, 0, 0, 0, [0] * 10, 0, 0, 0, percent)
    second = wire.MAVLink_battery_status_message(1, 0, 0, 0, [0] * 10, 0, 0, 0, percent)
    expected = None if remaining is None else Battery(time_s=1.5, remaining=remaining)
    assert event(status) == event(battery) == expected
    assert event(second) is None


@each
def test_other_messages_mean_nothing_to_the_mission(autopilot: Autopilot) -> None:
    assert event(wire.MAVLink_system_time_message(0, 0), autopilot) is None


# --- echoes

ORIGINS = ((0.0, 0.0, 488.0), (-30_000.0, 20_000.0, 488.0))


def local_target(x: float, y: float, z: float, type_mask: int = 0, **velocity: float) -> Any:
    v = {"vx": 0.0, "vy": 0.0, "vz": 0.0, **velocity}
    values = (x, y, z, v["vx"], v["vy"], v["vz"], 0.0, 0.0, 0.0, 0.0, 0.0)
    return wire.MAVLink_position_target_local_ned_message(0, 1, type_mask, *values)


@pytest.mark.parametrize("origin", ORIGINS)
@pytest.mark.parametrize("ne_m", [(0.0, 0.0), (300.0, -200.0), (9000.0, 4000.0), (-4e4, 3e4)])
@pytest.mark.parametrize(
    ("autopilot", "earth"),
    [(ARDUCOPTER, FlatEarth), (PX4_MULTICOPTER, Projection)],
    ids=["flat", "sphere"],
)
def test_a_local_echo_is_read_on_the_autopilots_own_earth(
    autopilot: Autopilot, earth: Any, origin: Vector, ne_m: tuple[float, float]
) -> None:
    there = earth(Place(*geodetic(*origin[:2]), origin[2])).place(*ne_m, 0.0)
    read = event(local_target(*ne_m, -60.0, vx=3.0, vz=-1.0), autopilot, origin)
    assert isinstance(read, Echo)
    latitude, longitude = geodetic(*read.position_nea_m[:2])
    _, _, off_m = GEOD.inv(longitude, latitude, there[1], there[0])
    assert off_m < 0.05
    assert read.position_nea_m[2] == pytest.approx(548.0)


@each
def test_a_local_echo_needs_an_origin_and_a_position_and_a_vehicle_that_hovers(
    autopilot: Autopilot,
) -> None:
    origin, hovers = ORIGINS[0], autopilot in (ARDUCOPTER, PX4_MULTICOPTER)
    assert event(local_target(1.0, 2.0, -3.0), autopilot, None) is None
    assert isinstance(event(local_target(1.0, 2.0, -3.0), autopilot, origin), Echo) == hovers
    for bit in (1, 2, 4):
        assert event(local_target(1.0, 2.0, -3.0, bit), autopilot, origin) is None


@given(x=st.floats(width=32), y=st.floats(width=32), z=st.floats(width=32))
@pytest.mark.parametrize("autopilot", [ARDUCOPTER, PX4_MULTICOPTER], ids=lambda a: a.name)
def test_an_echo_is_finite_or_none(autopilot: Autopilot, x: float, y: float, z: float) -> None:
    for values in ((x, y, z), (math.nan, y, z), (x, math.inf, z), (x, y, math.nan)):
        read = event(local_target(*values), autopilot, ORIGINS[0])
        assert read is None or all(map(math.isfinite, read.position_nea_m))  # type: ignore[union-attr]
        assert read is None or all(map(math.isfinite, values))


def test_an_echo_of_arduplane_is_its_waypoint() -> None:
    latitude, longitude = geodetic(*CORNER[:2])

    def said(latitude_e7: int, longitude_e7: int) -> Any:
        values = (latitude_e7, longitude_e7, 664.19, *([0.0] * 8))
        return wire.MAVLink_position_target_global_int_message(0, 0, 0xFDF8, *values)

    read = event(said(round(latitude * 1e7), round(longitude * 1e7)), ARDUPLANE)
    assert isinstance(read, Echo)
    assert read.position_nea_m == pytest.approx((*CORNER[:2], 664.19), abs=0.02)
    assert event(said(0, 0), ARDUPLANE) is None
