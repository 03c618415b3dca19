"""Setpoints against pymavlink's own packing and parsing, geodesy against pyproj's geodesics."""

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

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import (
    ALL,
    ARDUCOPTER,
    ARDUPLANE,
    PX4_FIXED_WING,
    PX4_MULTICOPTER,
    Autopilot,
)
from companion.mission.events import Setpoint

IGNORED = {
    name: getattr(wire, f"POSITION_TARGET_TYPEMASK_{name}_IGNORE")
    for name in ("VX", "VY", "VZ", "AX", "AY", "AZ", "YAW", "YAW_RATE")
}
TARGETS = (ARDUCOPTER, PX4_MULTICOPTER, PX4_FIXED_WING)
"""Those that take SET_POSITION_TARGET."""
each = pytest.mark.parametrize("autopilot", ALL, ids=lambda a: a.name)
each_target = pytest.mark.parametrize("autopilot", TARGETS, ids=lambda a: a.name)
hovering = pytest.mark.parametrize("autopilot", [ARDUCOPTER, PX4_MULTICOPTER], ids=lambda a: a.name)


def mask(*names: str) -> int:
    return sum(IGNORED[name] for name in names)


def made(**changes: Any) -> Setpoint:
    values: dict[str, Any] = {
        "time_s": 12.3,
        "position_nea_m": CORNER,
        "velocity_nea_m_s": (100.0, -60.0, 5.0),
        "yaw_rad": 0.5,
    }
    return Setpoint(**{**values, **changes})


def sent(autopilot: Autopilot, setpoint: Setpoint, loiter_radius_m: float = 0.0) -> Any:
    messages = autopilot.setpoint(setpoint, FRAME, SYSTEM, loiter_radius_m)
    assert messages is not None
    [message] = messages
    return over_the_wire(message)


# --- SET_POSITION_TARGET_GLOBAL_INT


@each_target
def test_a_setpoint_is_a_place_amsl_in_frame_5_for_the_autopilot_of_the_vehicle(
    autopilot: Autopilot,
) -> None:
    message = sent(autopilot, made())
    assert message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"
    assert (message.target_system, message.target_component) == (SYSTEM, 1)
    assert message.coordinate_frame == 5 == wire.MAV_FRAME_GLOBAL_INT
    assert message.time_boot_ms == 12_300
    latitude, longitude = geodetic(*CORNER[:2])
    assert message.lat_int == pytest.approx(latitude * 1e7, abs=1)
    assert message.lon_int == pytest.approx(longitude * 1e7, abs=1)
    assert message.alt == 3500.0
    assert (message.afx, message.afy, message.afz, message.yaw_rate) == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("autopilot", "stay", "ignored"),
    [
        (ARDUCOPTER, False, mask("AX", "AY", "AZ", "YAW_RATE")),
        (ARDUCOPTER, True, mask("AX", "AY", "AZ", "YAW_RATE")),
        (PX4_MULTICOPTER, False, mask("AX", "AY", "AZ", "YAW_RATE")),
        (PX4_MULTICOPTER, True, mask("AX", "AY", "AZ", "YAW_RATE")),
        (PX4_FIXED_WING, False, mask("AX", "AY", "AZ", "YAW", "YAW_RATE")),
        (PX4_FIXED_WING, True, mask("VX", "VY", "VZ", "AX", "AY", "AZ", "YAW", "YAW_RATE")),
    ],
)
def test_the_mask_says_what_the_autopilot_is_to_use(
    autopilot: Autopilot, stay: bool, ignored: int
) -> None:
    assert sent(autopilot, made(stay=stay)).type_mask == ignored


@hovering
def test_what_hovers_stays_with_an_explicit_velocity_of_zero(autopilot: Autopilot) -> None:
    message = sent(autopilot, made(stay=True))
    assert (message.vx, message.vy, message.vz) == (0.0, 0.0, 0.0)
    assert message.yaw == pytest.approx(sent(autopilot, made()).yaw)


@each_target
@pytest.mark.parametrize("bearing_deg", range(0, 360, 45))
@pytest.mark.parametrize("place", PLACES)
def test_velocity_and_nose_point_along_the_true_course(
    autopilot: Autopilot, bearing_deg: int, place: tuple[float, float, float]
) -> None:
    bearing = math.radians(bearing_deg)
    velocity = (150.0 * math.cos(bearing), 150.0 * math.sin(bearing), 12.0)
    setpoint = made(position_nea_m=place, velocity_nea_m_s=velocity, yaw_rad=bearing)
    message = sent(autopilot, setpoint)
    course = true_course_rad(*place[:2], bearing)
    # The frame is no conformal one: at the corner a right angle is off by 1e-4 rad.
    assert angle_between(math.atan2(message.vy, message.vx), course) < 1e-4
    assert angle_between(message.yaw, course) < 1e-4
    assert math.hypot(message.vx, message.vy) == pytest.approx(150.0, rel=1e-6)
    assert message.vz == pytest.approx(-12.0)


@pytest.mark.parametrize("yaw_rad", [-100.0, -math.pi, 0.0, math.pi, 3.5, 100.0])
def test_yaw_is_sent_within_half_a_turn(yaw_rad: float) -> None:
    message = sent(ARDUCOPTER, made(position_nea_m=(0.0, 0.0, 3500.0), yaw_rad=yaw_rad))
    assert abs(message.yaw) <= math.pi + 1e-6
    assert angle_between(message.yaw, yaw_rad) < 1e-6


# --- COMMAND_INT DO_REPOSITION


@pytest.mark.parametrize("stay", [False, True])
def test_a_plane_of_ardupilot_is_repositioned_and_never_taken_from_a_pilot(stay: bool) -> None:
    message = sent(ARDUPLANE, made(stay=stay), loiter_radius_m=100.0)
    assert (message.get_type(), message.command) == ("COMMAND_INT", 192)
    assert (message.target_system, message.target_component) == (SYSTEM, 1)
    assert message.frame == wire.MAV_FRAME_GLOBAL_INT
    assert message.param2 == 0.0  # bit 0 would switch to GUIDED
    latitude, longitude = geodetic(*CORNER[:2])
    assert message.x == pytest.approx(latitude * 1e7, abs=1)
    assert message.y == pytest.approx(longitude * 1e7, abs=1)
    assert message.z == 3500.0


def test_a_plane_of_ardupilot_follows_with_a_small_circle_and_stays_on_a_wide_one() -> None:
    assert sent(ARDUPLANE, made(), loiter_radius_m=100.0).param3 == 10.0
    stays = made(stay=True)
    assert sent(ARDUPLANE, stays, loiter_radius_m=100.0).param3 == 80.0
    assert sent(ARDUPLANE, stays, loiter_radius_m=30.0).param3 == 15.0
    assert sent(ARDUPLANE, stays).param3 > 0.0  # 0 would keep the 10 m that it followed with


# --- what is refused

numbers = st.one_of(
    st.floats(),
    st.floats(-2e5, 2e5),
    st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e9, -1e9, 1e38, 1e300, 2e7, 5e-324]),
)
triples = st.tuples(numbers, numbers, numbers)
sensible = st.tuples(st.floats(-2e5, 2e5), st.floats(-2e5, 2e5), st.floats(-1e3, 6e4))
frames = st.sampled_from([FRAME, LocalFrame(latitude_deg=0.0, longitude_deg=0.0)])


@given(
    autopilot=st.sampled_from(ALL),
    time_s=st.one_of(numbers, st.floats(0.0, 4e6)),
    place=st.one_of(triples, sensible),
    velocity=st.one_of(triples, st.tuples(*[st.floats(-2e3, 2e3)] * 3)),
    yaw=st.one_of(numbers, st.floats(-4.0, 4.0)),
    stay=st.booleans(),
    radius_m=st.one_of(st.just(0.0), numbers),
    frame=frames,
)
def test_nothing_that_is_not_finite_and_in_range_is_ever_sent(
    autopilot: Autopilot,
    time_s: float,
    place: tuple[float, float, float],
    velocity: tuple[float, float, float],
    yaw: float,
    stay: bool,
    radius_m: float,
    frame: LocalFrame,
) -> None:
    setpoint = Setpoint(
        time_s=time_s, position_nea_m=place, velocity_nea_m_s=velocity, yaw_rad=yaw, stay=stay
    )
    messages = autopilot.setpoint(setpoint, frame, SYSTEM, radius_m)
    if messages is None:
        return
    [message] = messages
    message = over_the_wire(message)
    fields = {key: value for key, value in message.to_dict().items() if key != "mavpackettype"}
    assert all(map(math.isfinite, fields.values()))
    is_target = message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"
    here = (message.lat_int, message.lon_int) if is_target else (message.x, message.y)
    assert abs(here[0]) <= 900_000_000
    assert abs(here[1]) <= 1_800_000_000
    assert max(map(abs, here)) >= 100_000
    assert -500.0 <= (message.alt if is_target else message.z) <= 50_000.0
    if is_target:
        assert max(abs(message.vx), abs(message.vy), abs(message.vz)) <= 1000.0
        assert message.time_boot_ms == pytest.approx(1e3 * time_s, abs=0.501)


@given(place=st.tuples(st.floats(-2e5, 2e5), st.floats(-2e5, 2e5), st.floats(-500.0, 5e4)))
def test_what_is_in_range_is_sent_to_where_it_is(place: tuple[float, float, float]) -> None:
    message = sent(ARDUCOPTER, made(position_nea_m=place))
    latitude, longitude = geodetic(*place[:2])
    _, _, off_m = GEOD.inv(longitude, latitude, message.lon_int * 1e-7, message.lat_int * 1e-7)
    assert off_m < 0.02
    assert message.alt == pytest.approx(place[2], abs=0.01)


@each
@pytest.mark.parametrize("stay", [False, True])
@pytest.mark.parametrize(
    "changes",
    [
        *({"time_s": bad} for bad in (math.nan, -0.1, 2.0**32 / 1e3)),
        *({"position_nea_m": (0.0, bad, 3000.0)} for bad in (math.nan, math.inf, 1e9)),
        *({"position_nea_m": (0.0, 0.0, bad)} for bad in (math.nan, 50_001.0, -501.0)),
        *({"velocity_nea_m_s": (bad, 0.0, 0.0)} for bad in (math.nan, 1001.0)),
        {"velocity_nea_m_s": (0.0, 0.0, -1001.0)},
        *({"yaw_rad": bad} for bad in (math.nan, math.inf)),
    ],
    ids=str,
)
def test_a_setpoint_with_one_bad_value_is_refused(
    autopilot: Autopilot, stay: bool, changes: dict[str, Any]
) -> None:
    assert autopilot.setpoint(made(stay=stay, **changes), FRAME, SYSTEM, 0.0) is None


@each
def test_a_setpoint_about_latitude_and_longitude_0_is_refused(autopilot: Autopilot) -> None:
    gulf = LocalFrame(latitude_deg=0.0, longitude_deg=0.0)
    for off_m in (0.0, 0.001, 500.0):
        there = made(position_nea_m=(off_m, off_m, 100.0))
        assert autopilot.setpoint(there, gulf, SYSTEM, 0.0) is None
    assert ARDUPLANE.setpoint(made(stay=True), FRAME, SYSTEM, math.nan) is None
    assert ARDUPLANE.setpoint(made(stay=True), FRAME, SYSTEM, math.inf) is None
