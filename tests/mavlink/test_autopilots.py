"""Modes, commands and estimators against the message definitions and what was measured."""

import math
from typing import Any, get_args

import pytest
from pymavlink.dialects.v20 import all as wire
from wires import CORNER, FRAME, GEOD, SYSTEM, angle_between, geodetic, geodetic_e7, over_the_wire

from companion.mavlink.autopilots import (
    ALL,
    ARDUCOPTER,
    ARDUPLANE,
    FIRMWARES,
    NAMES,
    PX4_FIXED_WING,
    PX4_MULTICOPTER,
    Autopilot,
    autopilot_of,
    described,
)
from companion.mavlink.autopilots.messages import To
from companion.mission.events import Estimator, Mode, SetMode, TakeOff
from companion.mission.mission import AutopilotName

PX4 = (PX4_MULTICOPTER, PX4_FIXED_WING)
TO = To(SYSTEM, FRAME)
each = pytest.mark.parametrize("autopilot", ALL, ids=lambda a: a.name)
each_px4 = pytest.mark.parametrize("autopilot", PX4, ids=lambda a: a.name)


@pytest.mark.parametrize(
    ("autopilot", "kind", "expected", "words"),
    [
        *((3, kind, ARDUCOPTER, "ArduCopter") for kind in (2, 13, 4)),
        (3, 1, ARDUPLANE, "ArduPlane"),
        *((12, kind, PX4_MULTICOPTER, "PX4 multicopter") for kind in (2, 14)),
        (12, 1, PX4_FIXED_WING, "PX4 fixed wing"),
        (12, 21, None, "px4, vtol_tiltrotor"),
        (3, 10, None, "ardupilotmega, ground_rover"),
        (200, 201, None, "MAV_AUTOPILOT 200, MAV_TYPE 201"),
    ],
)
def test_which_autopilot(autopilot: int, kind: int, expected: Autopilot | None, words: str) -> None:
    beat = over_the_wire(wire.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 3, 3))
    assert autopilot_of(beat) is expected
    assert described(beat) == words
    assert expected is None or words == expected.traits.name
    assert expected is None or words in NAMES
    assert {each.name for each in FIRMWARES} == set(get_args(AutopilotName))


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
    *((autopilot, *each) for autopilot in PX4 for each in PX4_MODES),
]
TOLD = [
    (ARDUCOPTER, 5, "LOITER", Mode.OTHER),
    (ARDUCOPTER, 21, "SMART RTL", Mode.RETURN),
    (ARDUCOPTER, 4_294_967_295, "mode 4294967295", Mode.OTHER),
    (PX4_MULTICOPTER, 0x04040000, "Mission", Mode.OTHER),
    (PX4_MULTICOPTER, 0x09040000, "Precision Land", Mode.LAND),
    (PX4_FIXED_WING, 0, "mode 0.0", Mode.OTHER),
]


@pytest.mark.parametrize(("autopilot", "number", "name", "mode"), [*ASKED, *TOLD])
def test_modes_are_recognised(autopilot: Autopilot, number: int, name: str, mode: Mode) -> None:
    assert autopilot.modes.mode_of(number) is mode
    assert autopilot.modes.name_of(number) == name


@each
@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("at_nea_m", [None, (math.nan, 0.0, 100.0), CORNER])
def test_a_mode_is_asked_for_by_number_or_not_at_all(
    autopilot: Autopilot, mode: Mode, at_nea_m: Any
) -> None:
    numbers = [number for one, number, _, asked in ASKED if one is autopilot and asked is mode]
    command = SetMode(mode=mode, at_nea_m=at_nea_m)
    messages = [over_the_wire(m) for m in autopilot.set_mode(command, TO)]
    assert len(messages) == len(numbers)
    for sent, number in zip(messages, numbers, strict=True):
        assert (sent.target_system, sent.target_component) == (SYSTEM, 1)
        if (autopilot, mode, at_nea_m) == (PX4_FIXED_WING, Mode.HOLD, CORNER):  # about a point
            assert (sent.get_type(), sent.command, sent.frame) == ("COMMAND_INT", 192, 5)
            assert sent.param2 == 1.0  # bit 0 switches to Hold
            assert (sent.x, sent.y) == pytest.approx(geodetic_e7(*CORNER[:2]), abs=1)
            assert sent.z == CORNER[2]
            continue
        main, sub = int(sent.param2), int(sent.param3)
        assert (sent.get_type(), sent.command, sent.param1) == ("COMMAND_LONG", 176, 1.0)
        assert number == (main << 16 | sub << 24 if autopilot in PX4 else main)
    assert mode is not Mode.LAND or bool(numbers) == autopilot.traits.lands


CLIMB = TakeOff(above_home_m=60.0, altitude_amsl_m=548.0)


def take_off(autopilot: Autopilot, heading_rad: float, command: TakeOff = CLIMB) -> Any:
    heading_rad -= FRAME.grid_north_rad(*CORNER[:2])
    messages = autopilot.take_off(command, CORNER, heading_rad, TO)
    return over_the_wire(messages[0]) if messages else None


def test_ardupilots_take_off_to_a_height_above_home_or_by_their_mode() -> None:
    sent = take_off(ARDUCOPTER, 0.3)
    assert (sent.get_type(), sent.command) == ("COMMAND_LONG", 22)
    assert [getattr(sent, f"param{n}") for n in range(1, 8)] == [0.0] * 6 + [60.0]
    sent = take_off(ARDUPLANE, 0.3)
    assert (sent.command, sent.param2) == (176, wire.PLANE_MODE_TAKEOFF)


@each_px4
@pytest.mark.parametrize("bearing_deg", range(0, 360, 45))
def test_px4_climbs_to_an_altitude_amsl(autopilot: Autopilot, bearing_deg: int) -> None:
    sent = take_off(autopilot, math.radians(bearing_deg))
    assert (sent.get_type(), sent.command, sent.frame, sent.z) == ("COMMAND_INT", 22, 5, 548.0)
    assert math.isnan(sent.param4)  # the nose stays where it points
    latitude, longitude = geodetic(*CORNER[:2])
    azimuth, _, away_m = GEOD.inv(longitude, latitude, sent.y * 1e-7, sent.x * 1e-7)
    if autopilot is PX4_MULTICOPTER:
        assert away_m < 0.02
    else:  # along the runway, as the nose points from true north
        # a hundred kilometres off, the scale of the local frame is off by 4e-5
        assert away_m == pytest.approx(300.0, abs=0.05)
        assert angle_between(math.radians(azimuth), math.radians(bearing_deg)) < 2e-4


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e9, -1e9])
def test_a_take_off_to_nowhere_or_along_no_direction_is_refused(bad: float) -> None:
    nowhere = TakeOff(above_home_m=bad, altitude_amsl_m=bad)
    assert [take_off(autopilot, 0.0, nowhere) for autopilot in (ARDUCOPTER, *PX4)] == [None] * 3
    assert math.isfinite(bad) or take_off(PX4_FIXED_WING, bad) is None


@each
def test_arduplane_alone_is_told_its_airspeed(autopilot: Autopilot) -> None:
    sent = [over_the_wire(message) for message in autopilot.set_speed(18.0, SYSTEM)]
    told = [(m.get_type(), m.command, m.param1, m.param2, m.param3) for m in sent]
    airspeed = ("COMMAND_INT", 43000, wire.SPEED_TYPE_AIRSPEED, 18.0, 0.0)
    assert told == ([airspeed] if autopilot is ARDUPLANE else [])
    for speed in (0.0, -1.0, math.nan, math.inf, 1e6):
        assert autopilot.set_speed(speed, SYSTEM) == []


@pytest.mark.parametrize("result", range(10))
def test_only_arduplane_refuses_a_setpoint_in_words(result: int) -> None:
    for command in (192, 176):
        ack = over_the_wire(wire.MAVLink_command_ack_message(command, result))
        refuses = command == 192 and result != wire.MAV_RESULT_ACCEPTED
        assert [a.refuses_setpoint(ack) for a in ALL] == [a is ARDUPLANE and refuses for a in ALL]


ARDUPILOTS_SAY = [  # flags and figures of arducopter-gps-loss.tlog
    (0x33F, 0.03, 0.05, True),  # flying
    (0x33F, 13.33, 0.01, False),  # half a second after a step of 50 m, before any flag
    (0x33F, 0.03, 1.0, False),
    (0x33F, math.nan, 0.0, False),
    (0x833F, 0.02, 0.01, False),  # glitch: after the estimate has given in
    (0x8027, 10.5, 0.0, False),
    (0x25, 0.0, 0.0, False),  # GPS lost
    (0xA7, 0.0, 0.0, False),  # before the first fix, or aiding has stopped
    (0x400, 0.0, 0.0, False),
    (0x33F & ~0x20, 0.0, 0.0, False),  # no height
]
PX4_SAYS = [
    (0x37F, 0.2, 0.36, True),  # flying
    (0x3FF, 0.05, 0.05, True),  # on the ground
    (0x365, 0.05, 0.05, False),  # 5 s after the loss of GPS
    (0xE5, 0.05, 0.05, False),  # booting
    (0x37F | 0x400, 0.05, 0.05, False),  # glitch
    (0x37F | 0x800, 0.05, 0.05, False),  # accelerometers
    (0x37F & ~0x20, 0.05, 0.05, False),
    (0x37F, 1.0, 0.1, False),  # it throws measurements away
    (0x37F, 0.1, 7.0, False),
    (0x37F, 0.1, math.nan, True),
]


@each
def test_an_estimator_is_good_while_it_takes_its_measurements(autopilot: Autopilot) -> None:
    def told(flags: int, position: float, velocity: float, accuracy_m: float = 0.25) -> Any:
        if autopilot in PX4:
            figures = (velocity, position, 0.0, 0.1, 0.0, 0.0, accuracy_m, 0.3)
            message = wire.MAVLink_estimator_status_message(0, flags, *figures)
        else:  # ArduPilot tells of no accuracy
            figures = (velocity, position, 0.0, 0.0, 0.0)
            message = wire.MAVLink_ekf_status_report_message(flags, *figures)
        return autopilot.event_of(over_the_wire(message), 1.5, FRAME)

    is_px4 = autopilot in PX4
    for flags, position, velocity, good in PX4_SAYS if is_px4 else ARDUPILOTS_SAY:
        expected = Estimator(time_s=1.5, good=good, error_m=0.25 if is_px4 else None)
        assert told(flags, position, velocity) == expected, (hex(flags), position)
    for unknown_m in (math.nan, math.inf, 0.0, -1.0):  # an accuracy is a length
        assert told(0x33F, 0.05, 0.05, unknown_m) == Estimator(time_s=1.5, good=True, error_m=None)
