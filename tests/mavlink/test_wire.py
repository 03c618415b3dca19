"""What autopilots are told and say, against pymavlink, geodesics and what was measured."""

import itertools
import math
from typing import Any, get_args

import pytest
import wires
from pymavlink.dialects.v20 import all as wire
from wires import FRAME, GEOD, SYSTEM, assert_told, geodetic, geodetic_e7, heard, over_the_wire

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import (
    ALL,
    FIRMWARES,
    NAMES,
    Autopilot,
    autopilot_of,
    described,
    named,
)
from companion.mavlink.autopilots.messages import To
from companion.mission import events
from companion.mission.events import Landed, Mode, Setpoint, Vector
from companion.mission.mission import AutopilotName
from vehicle_sim.autopilot.earth import FlatEarth, Projection
from vehicle_sim.autopilot.values import Place

ARDUCOPTER, ARDUPLANE, PX4_MULTICOPTER, PX4_FIXED_WING, *_ = ALL
HOVERING, PX4 = (ARDUCOPTER, PX4_MULTICOPTER), (PX4_MULTICOPTER, PX4_FIXED_WING)
CORNER = (100_000.0, 100_000.0, 3500.0)
PLACES = (CORNER, (0.0, 0.0, 3500.0), (-5000.0, 105_000.0, 4000.0))
TO = To(SYSTEM, FRAME)
each = pytest.mark.parametrize("autopilot", ALL, ids=lambda a: a.name)


def event(
    name: str,
    autopilot: Autopilot = ARDUCOPTER,
    origin_nea_m: Vector | None = None,
    **fields: Any,
) -> Any:
    """What is made of a message at 1.5 s."""
    return autopilot.event_of(heard(name, **fields), 1.5, FRAME, origin_nea_m)


# --- setpoints


def made(**changes: Any) -> Setpoint:
    velocity: Vector = (100.0, -60.0, 5.0)
    usual = {"time_s": 12.3, "position_nea_m": CORNER, "velocity_nea_m_s": velocity, "yaw_rad": 0.5}
    return Setpoint(**{**usual, **changes})


def sent(messages: list[Any] | None) -> Any:
    """The one message, as it is read."""
    [message] = messages or []
    return over_the_wire(message)


def e7(place: Vector) -> Any:
    """Latitude and longitude of a place in the frame, within a centimetre or two."""
    return [pytest.approx(degrees, abs=1.5) for degrees in geodetic_e7(*place[:2])]


THERE = dict(zip(("x", "y"), e7(CORNER), strict=True))
THERE |= {"z": CORNER[2], "frame": 5, "target_system": SYSTEM, "target_component": 1}
ALL_IGNORED = {"afx": 0.0, "afy": 0.0, "afz": 0.0, "yaw_rate": 0.0}
POSITION, WITH_VELOCITY, AND_YAW = 0xDF8, 0xDC0, 0x9C0
"""What is not ignored, by POSITION_TARGET_TYPEMASK."""


@pytest.mark.parametrize("place", [*PLACES, (9.0, 0.0, -500.0), (0.0, 9.0, 50_000.0)])
@pytest.mark.parametrize(
    ("autopilot", "stay", "mask"),
    [
        *((autopilot, stay, AND_YAW) for autopilot in HOVERING for stay in (False, True)),
        (PX4_FIXED_WING, False, WITH_VELOCITY),
        (PX4_FIXED_WING, True, POSITION),
    ],
)
def test_a_setpoint_is_a_true_place_amsl_velocity_and_nose_with_its_mask(
    autopilot: Autopilot, stay: bool, mask: int, place: Vector
) -> None:
    to = {"target_system": SYSTEM, "target_component": 1, "coordinate_frame": 5}
    head = {**to, "time_boot_ms": 12_300, "type_mask": mask, "alt": place[2], **ALL_IGNORED}
    latitude_e7, longitude_e7 = e7(place)
    for bearing in (-2.9, -2.0, -1.0, 0.0, 0.5, 1.5, 3.0):
        velocity = (150.0 * math.cos(bearing), 150.0 * math.sin(bearing), 12.0)
        told = {"position_nea_m": place, "velocity_nea_m_s": velocity, "yaw_rad": bearing}
        # The frame is no conformal one: at the corner a right angle is off by 1e-4 rad.
        course = wires.true_course_rad(*place[:2], bearing)
        moves = not (stay and autopilot in HOVERING)  # what hovers is told an explicit zero
        north, east, down = 150.0 * math.cos(course), 150.0 * math.sin(course), -12.0
        assert_told(
            sent(autopilot.setpoint(made(stay=stay, **told), TO, 0.0)),
            "SET_POSITION_TARGET_GLOBAL_INT",
            **{**head, "lat_int": latitude_e7, "lon_int": longitude_e7},
            vx=pytest.approx(north * moves, abs=0.015),
            vy=pytest.approx(east * moves, abs=0.015),
            vz=pytest.approx(down * moves),
            yaw=pytest.approx(course, abs=1e-4),
        )


def test_an_arduplane_is_repositioned() -> None:
    """It follows with a small circle, and stays on a wide one (ardupilot.md 7)."""
    following, staying = {100.0: 10.0}, {100.0: 80.0, 30.0: 15.0, 0.0: 60.0}
    for stay, circles_m in ((False, following), (True, staying)):
        for wanted_m, circle_m in circles_m.items():
            message = sent(ARDUPLANE.setpoint(made(stay=stay), TO, wanted_m))
            assert_told(message, "COMMAND_INT", command=192, param3=circle_m, **THERE)
            assert message.param2 == 0.0  # bit 0 would switch to GUIDED


@each
@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("time_s", (math.nan, math.inf, -0.1, 2.0**32 / 1e3)),
        ("position_nea_m", [(0.0, bad, 3000.0) for bad in (math.nan, math.inf, 1e9, 1e300)]),
        ("position_nea_m", [(0.0, 0.0, bad) for bad in (math.nan, 50_001.0, -501.0)]),
        ("velocity_nea_m_s", [(bad, 0.0, 0.0) for bad in (math.nan, -math.inf, 1001.0)]),
        ("velocity_nea_m_s", [(0.0, 0.0, -1001.0)]),
        ("yaw_rad", (math.nan, math.inf)),
    ],
)
def test_what_is_out_of_range_is_not_sent(autopilot: Autopilot, field: str, values: Any) -> None:
    gulf = To(SYSTEM, LocalFrame(latitude_deg=0.0, longitude_deg=0.0))
    for stay in (False, True):
        for bad in values:
            told = made(stay=stay, **{field: bad})
            assert autopilot.setpoint(told, TO, 0.0) is None, bad
        nowhere = made(stay=stay, position_nea_m=(900.0, -900.0, 100.0))
        assert autopilot.setpoint(nowhere, gulf, 0.0) is None  # 0, 0 would be flown to
        for radius_m in (math.nan, math.inf, -1.0):  # of a circle, which a plane is told
            for message in autopilot.setpoint(made(stay=stay), TO, radius_m) or ():
                assert math.isfinite(getattr(message, "param3", 0.0))


# --- events


@pytest.mark.parametrize("place", PLACES)
def test_a_position_is_read_where_it_was_with_velocity_along_the_frame(place: Vector) -> None:
    bearing, course = 0.7, wires.true_course_rad(*place[:2], 0.7)
    fields = dict(zip(("lat", "lon"), geodetic_e7(*place[:2]), strict=True))
    fields |= {"alt": round(place[2] * 1e3), "relative_alt": 123, "vz": -250}
    fields |= {"vx": round(15_000 * math.cos(course)), "vy": round(15_000 * math.sin(course))}
    nose = round(math.degrees(course) * 100)
    read = event("GLOBAL_POSITION_INT", time_boot_ms=12_300, hdg=nose, **fields)
    assert (read.time_s, read.position_nea_m) == (12.3, pytest.approx(place, abs=0.02))
    assert wires.angle_between(read.heading_rad, bearing) < 3e-4
    velocity = (150.0 * math.cos(bearing), 150.0 * math.sin(bearing), 2.5)
    assert read.velocity_nea_m_s == pytest.approx(velocity, abs=0.03)
    assert event("GLOBAL_POSITION_INT", hdg=65_535, **fields).heading_rad is None


def test_states_are_those_of_the_message_definitions() -> None:
    landed = [Landed.UNKNOWN, Landed.ON_GROUND, Landed.IN_AIR, Landed.TAKING_OFF, Landed.LANDING]
    for number, state in enumerate([*landed, *[Landed.UNKNOWN] * 95]):
        assert event("EXTENDED_SYS_STATE", landed_state=number).landed is state
    for fix_type, good in ((0, False), (2, False), (3, True), (6, True)):
        assert event("GPS_RAW_INT", fix_type=fix_type) == events.GpsFix(time_s=1.5, good=good)
    for percent, share in ((0, 0.0), (37, 0.37), (100, 1.0), (-1, None), (101, None)):
        left = None if share is None else events.Battery(time_s=1.5, remaining=share)
        assert event("SYS_STATUS", battery_remaining=percent) == left
        assert event("BATTERY_STATUS", battery_remaining=percent) == left
        assert event("BATTERY_STATUS", battery_remaining=percent, id=1) is None  # of something else
    for autopilot, status, armed in itertools.product(ALL, range(9), (False, True)):
        base_mode = 1 | wire.MAV_MODE_FLAG_SAFETY_ARMED * armed
        read = event("HEARTBEAT", autopilot, base_mode=base_mode, system_status=status)
        fails = status in (wire.MAV_STATE_CRITICAL, wire.MAV_STATE_EMERGENCY)
        assert (read.time_s, read.armed, read.failsafe) == (1.5, armed, fails)
    assert event("SYSTEM_TIME") is None


@pytest.mark.parametrize(
    ("name", "kind", "latitude", "longitude", "height"),
    [
        ("GLOBAL_POSITION_INT", events.Position, "lat", "lon", {"alt": 584_070}),
        ("HOME_POSITION", events.Home, "latitude", "longitude", {"altitude": 584_070}),
        ("GPS_GLOBAL_ORIGIN", events.Origin, "latitude", "longitude", {"altitude": 584_070}),
        ("POSITION_TARGET_GLOBAL_INT", events.Echo, "lat_int", "lon_int", {"alt": 584.07}),
    ],
)
def test_places_are_amsl_and_on_earth_and_0_0_is_none(
    name: str, kind: type, latitude: str, longitude: str, height: dict[str, Any]
) -> None:
    """3090, -717 was recorded: an ArduPlane that has no fix yet; on the equator there are some."""

    def read(lat_e7: int, lon_e7: int) -> Any:
        return event(name, ARDUPLANE, **{latitude: lat_e7, longitude: lon_e7}, **height)

    there = read(*geodetic_e7(*CORNER[:2]))
    assert isinstance(there, kind)
    assert there.position_nea_m == pytest.approx((*CORNER[:2], 584.07), abs=0.02)
    assert read(0, 80_000_000) is not None
    nowhere = [(0, 0), (3090, -717), (-99_000, 99_000)]
    for place in (*nowhere, (470_000_000, 1_800_000_001), (2**31 - 1, 80_000_000), (0, -(2**31))):
        assert read(*place) is None


@pytest.mark.parametrize("origin_nea_m", [(0.0, 0.0, 488.0), (-30_000.0, 20_000.0, 488.0)])
@pytest.mark.parametrize("ne_m", [(0.0, 0.0), (300.0, -200.0), (9000.0, 4000.0), (-4e4, 3e4)])
def test_a_local_echo_is_read_on_the_autopilots_own_earth(origin_nea_m: Vector, ne_m: Any) -> None:
    """It needs an origin, and numbers; planes tell none."""
    name, target = "POSITION_TARGET_LOCAL_NED", {"x": ne_m[0], "y": ne_m[1], "z": -60.0}
    bad = [{"x": math.nan}, {"y": math.inf}, {"z": math.nan}]
    bad += [{"type_mask": bit} for bit in (1, 2, 4)]
    for autopilot, earth in zip(HOVERING, (FlatEarth, Projection), strict=True):
        assert event(name, autopilot, None, **target) is None
        for fields in bad:
            assert event(name, autopilot, origin_nea_m, **(target | fields)) is None
        told = event(name, autopilot, origin_nea_m, **target)
        there = earth(Place(*geodetic(*origin_nea_m[:2]), origin_nea_m[2])).place(*ne_m, 0.0)
        latitude, longitude = geodetic(*told.position_nea_m[:2])
        _, _, off_m = GEOD.inv(longitude, latitude, there[1], there[0])
        assert (off_m < 0.05, told.position_nea_m[2]) == (True, pytest.approx(548.0))
    for plane in (ARDUPLANE, PX4_FIXED_WING):
        assert event(name, plane, origin_nea_m, **target) is None


@each
def test_an_estimator_is_good_while_it_takes_its_measurements(autopilot: Autopilot) -> None:
    """Flags and figures of recorded flights (arducopter-gps-loss; px4.md 8)."""
    is_px4 = autopilot in PX4
    healthy, bad = (0x37F, 0xC00) if is_px4 else (0x33F, 0x8480)
    needed = 0x33  # attitude, horizontal velocity and position, height

    def told(flags: int, position: float, velocity: float, accuracy_m: float = 0.25) -> Any:
        figures = {"flags": flags, "pos_horiz_accuracy": accuracy_m}
        figures |= {"pos_horiz_ratio": position, "vel_ratio": velocity}
        if not is_px4:
            figures = {"flags": flags, "pos_horiz_variance": position}
            figures["velocity_variance"] = velocity
        return event("ESTIMATOR_STATUS" if is_px4 else "EKF_STATUS_REPORT", autopilot, **figures)

    for bit in (1 << k for k in range(16)):
        assert told(healthy ^ bit, 0.05, 0.05).good is not bool(bit & (needed | bad)), hex(bit)
    # 13.33: half a second after a step of 50 m, before any flag; PX4 does not use what it has not
    ratios = {(0.2, 0.36): True, (13.33, 0.01): False, (1.0, 0.1): False, (0.03, 1.0): False}
    for (position, velocity), good in (ratios | {(0.1, math.nan): is_px4}).items():
        expected = events.Estimator(time_s=1.5, good=good, error_m=0.25 if is_px4 else None)
        assert told(healthy, position, velocity) == expected
    for unknown_m in (math.nan, math.inf, 0.0, -1.0):  # an accuracy is a length
        assert told(healthy, 0.05, 0.05, unknown_m).error_m is None


# --- who it is, modes and commands


def test_which_autopilot() -> None:
    for autopilot, kind, expected, words in (
        *((3, kind, ARDUCOPTER, "ArduCopter") for kind in (2, 13, 4)),
        (3, 1, ARDUPLANE, "ArduPlane"),
        *((12, kind, PX4_MULTICOPTER, "PX4 multicopter") for kind in (2, 14)),
        (12, 1, PX4_FIXED_WING, "PX4 fixed wing"),
        (12, 21, None, "px4, vtol_tiltrotor"),
        (3, 10, None, "ardupilotmega, ground_rover"),
        (8, 6, None, "invalid, gcs"),
        (200, 201, None, "MAV_AUTOPILOT 200, MAV_TYPE 201"),
    ):
        beat = heard("HEARTBEAT", type=kind, autopilot=autopilot)
        assert (autopilot_of(beat), described(beat)) == (expected, words)
        assert expected is None or words in NAMES
    assert {each.name for each in FIRMWARES} == set(get_args(AutopilotName))
    assert [named(each.firmware.name, each.traits.kind) for each in ALL] == [*ALL]
    assert len({(each.firmware, each.traits.kind) for each in ALL}) == len(ALL)  # else never chosen


PX4_MODES = (  # px4.md 3
    *((0x00060000, "Offboard", Mode.GUIDED), (0x02040000, "Takeoff", Mode.TAKE_OFF)),
    *((0x03040000, "Hold", Mode.HOLD), (0x05040000, "Return", Mode.RETURN)),
    (0x06040000, "Land", Mode.LAND),
)
ASKED = [
    (ARDUCOPTER, wire.COPTER_MODE_GUIDED, "GUIDED", Mode.GUIDED),
    (ARDUCOPTER, wire.COPTER_MODE_BRAKE, "BRAKE", Mode.HOLD),
    (ARDUCOPTER, wire.COPTER_MODE_LAND, "LAND", Mode.LAND),
    (ARDUCOPTER, wire.COPTER_MODE_RTL, "RTL", Mode.RETURN),
    (ARDUPLANE, wire.PLANE_MODE_GUIDED, "GUIDED", Mode.GUIDED),
    (ARDUPLANE, wire.PLANE_MODE_LOITER, "LOITER", Mode.HOLD),
    (ARDUPLANE, wire.PLANE_MODE_RTL, "RTL", Mode.RETURN),
    (ARDUPLANE, wire.PLANE_MODE_TAKEOFF, "TAKEOFF", Mode.TAKE_OFF),
    *((autopilot, *mode) for autopilot in PX4 for mode in PX4_MODES),
]
TOLD = [
    (ARDUCOPTER, 5, "LOITER", Mode.OTHER),
    (ARDUCOPTER, 21, "SMART RTL", Mode.RETURN),
    (ARDUCOPTER, 4_294_967_295, "mode 4294967295", Mode.OTHER),
    (ARDUPLANE, 5, "FLY BY WIRE A", Mode.OTHER),
    (PX4_MULTICOPTER, 0x04040000, "Mission", Mode.OTHER),
    (PX4_MULTICOPTER, 0x09040000, "Precision Land", Mode.LAND),
    (PX4_FIXED_WING, 0, "mode 0.0", Mode.OTHER),
]


@pytest.mark.parametrize(("autopilot", "number", "name", "mode"), [*ASKED, *TOLD])
def test_modes_are_recognised(autopilot: Autopilot, number: int, name: str, mode: Mode) -> None:
    modes = autopilot.modes
    assert (modes.mode_of(number), modes.name_of(number)) == (mode, name)


@each
def test_a_mode_is_asked_for_by_number_or_not_at_all(autopilot: Autopilot) -> None:
    for mode, at_nea_m in itertools.product(Mode, (None, (math.nan, 0.0, 100.0), CORNER)):
        numbers = [number for one, number, _, asked in ASKED if one is autopilot and asked is mode]
        command = events.SetMode(mode=mode, at_nea_m=at_nea_m)
        messages = [over_the_wire(message) for message in autopilot.set_mode(command, TO)]
        assert len(messages) == len(numbers)
        for message, number in zip(messages, numbers, strict=True):
            circles = autopilot in (PX4_FIXED_WING, ARDUPLANE)
            if circles and (mode, at_nea_m) == (Mode.HOLD, CORNER):
                switches = autopilot is PX4_FIXED_WING  # to Hold; ArduPlane stays in GUIDED
                about = {"param2": float(switches), "param3": 0.0}
                assert_told(message, "COMMAND_INT", command=192, **about, **THERE)
                continue
            main, sub = (number >> 16 & 255, number >> 24) if autopilot in PX4 else (number, 0)
            to = {"target_system": SYSTEM, "target_component": 1}
            flag = {"param1": 1.0, "param2": main, "param3": sub}
            assert_told(message, "COMMAND_LONG", command=176, **flag, **to)
        assert mode is not Mode.LAND or bool(numbers) == autopilot.traits.lands


def take_off(autopilot: Autopilot, heading_rad: float, to_m: float = 548.0) -> list[Any]:
    heading_rad -= FRAME.grid_north_rad(*CORNER[:2])
    command = events.TakeOff(above_home_m=to_m - 488.0, altitude_amsl_m=to_m)
    return [over_the_wire(each) for each in autopilot.take_off(command, CORNER, heading_rad, TO)]


def test_a_take_off_is_to_a_height_above_home_by_a_mode_or_to_an_altitude_amsl() -> None:
    ([copter], [plane]) = (take_off(each, 0.3) for each in (ARDUCOPTER, ARDUPLANE))
    assert_told(copter, "COMMAND_LONG", command=22, param7=60.0, param1=0.0, param4=0.0)
    assert_told(plane, "COMMAND_LONG", command=176, param2=wire.PLANE_MODE_TAKEOFF)
    latitude, longitude = geodetic(*CORNER[:2])
    for autopilot, bearing_deg in itertools.product(PX4, range(0, 360, 45)):
        [told] = take_off(autopilot, math.radians(bearing_deg))
        assert_told(told, "COMMAND_INT", command=22, frame=5, z=548.0)
        assert math.isnan(told.param4)  # the nose stays where it points
        azimuth, _, away_m = GEOD.inv(longitude, latitude, told.y * 1e-7, told.x * 1e-7)
        # along the runway; a hundred kilometres off, the local frame's scale is off by 4e-5
        assert away_m == pytest.approx(300.0 * (autopilot is PX4_FIXED_WING), abs=0.05)
        if autopilot is PX4_FIXED_WING:  # as the nose points from true north
            assert wires.angle_between(math.radians(azimuth - bearing_deg), 0.0) < 2e-4
    for bad in (math.nan, math.inf, -math.inf, 1e9, -1e9):
        assert [take_off(one, 0.0, bad) for one in (ARDUCOPTER, *PX4)] == [[]] * 3
        assert math.isfinite(bad) or take_off(PX4_FIXED_WING, bad) == []


@each
def test_arduplane_alone_is_told_its_airspeed(autopilot: Autopilot) -> None:
    messages = autopilot.set_speed(18.0, SYSTEM)
    assert len(messages) == (autopilot is ARDUPLANE)
    for each in messages:
        airspeed = {"param1": wire.SPEED_TYPE_AIRSPEED, "param2": 18.0, "param3": 0.0}
        assert_told(over_the_wire(each), "COMMAND_INT", command=43000, **airspeed)
    for speed in (0.0, -1.0, math.nan, math.inf, 1e6):
        assert autopilot.set_speed(speed, SYSTEM) == []
