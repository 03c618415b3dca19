"""Modes, commands and estimators against the message definitions and what was measured."""

import ast
import math
import re
from pathlib import Path
from typing import Any, get_args

import pytest
from geodesics import CORNER, FRAME, GEOD, SYSTEM, angle_between, geodetic, over_the_wire
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as wire

import companion
from companion.mavlink.autopilots import (
    ALL,
    ARDUCOPTER,
    ARDUPLANE,
    FIRMWARES,
    NAMES,
    PX4_FIXED_WING,
    PX4_MULTICOPTER,
    Autopilot,
    LaunchPose,
    autopilot_of,
    described,
)
from companion.mission.events import Estimator, Mode, SetMode, TakeOff
from companion.mission.mission import AutopilotName

PX4 = (PX4_MULTICOPTER, PX4_FIXED_WING)
# Streams that ArduPilot denies (ardupilot.md 1).
DENIED = (230, 331, 64, 111, 330, 231)
each = pytest.mark.parametrize("autopilot", ALL, ids=lambda a: a.name)
each_px4 = pytest.mark.parametrize("autopilot", PX4, ids=lambda a: a.name)


def heartbeat(autopilot: int, kind: int) -> Any:
    return over_the_wire(wire.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 3, 3))


# --- who it is


def test_code_beside_the_strategies_names_no_autopilot_but_in_logs_and_campaigns() -> None:
    one_of_them = re.compile("px4|ardu|MAV_AUTOPILOT_(?!INVALID|GENERIC)", re.IGNORECASE)
    root, found = Path(companion.__file__).parent, set[str]()
    for path in root.rglob("*.py"):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        docstrings = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        for node in (node for node in nodes if id(node) not in docstrings):
            words = (getattr(node, key, None) for key in ("id", "attr", "value", "name", "module"))
            if any(isinstance(word, str) and one_of_them.search(word) for word in words):
                found.add(path.relative_to(root).as_posix())
    elsewhere = ("mavlink/autopilots/", "telemetry/logs/", "campaign/", "sources/recognised.py")
    assert {each for each in found if not each.startswith(elsewhere)} == {"mission/mission.py"}
    assert {each.name for each in FIRMWARES} == set(get_args(AutopilotName))


@pytest.mark.parametrize(
    ("autopilot", "kind", "expected"),
    [
        (3, 2, ARDUCOPTER),
        (3, 13, ARDUCOPTER),
        (3, 4, ARDUCOPTER),
        (3, 1, ARDUPLANE),
        (12, 2, PX4_MULTICOPTER),
        (12, 14, PX4_MULTICOPTER),
        (12, 1, PX4_FIXED_WING),
    ],
)
def test_a_heartbeat_tells_which_autopilot_it_is(
    autopilot: int, kind: int, expected: Autopilot
) -> None:
    assert autopilot_of(heartbeat(autopilot, kind)) is expected
    assert described(heartbeat(autopilot, kind)) == expected.name == expected.traits.name


@pytest.mark.parametrize(
    ("autopilot", "kind", "words"),
    [
        (12, 21, "px4, vtol_tiltrotor"),
        (3, 10, "ardupilotmega, ground_rover"),
        (8, 6, "invalid, gcs"),
        (0, 2, "generic, quadrotor"),
        (200, 201, "MAV_AUTOPILOT 200, MAV_TYPE 201"),
    ],
)
def test_what_the_companion_does_not_fly_is_nobody_and_named(
    autopilot: int, kind: int, words: str
) -> None:
    assert autopilot_of(heartbeat(autopilot, kind)) is None
    assert described(heartbeat(autopilot, kind)) == words


def test_there_are_four_and_each_has_its_name() -> None:
    assert NAMES == ("ArduCopter", "ArduPlane", "PX4 multicopter", "PX4 fixed wing")


# --- modes


def mode_number(autopilot: Autopilot, mode: Mode) -> int:
    """custom_mode of the mode that is asked for."""
    [message] = autopilot.set_mode(SetMode(mode=mode), FRAME, SYSTEM)
    sent = over_the_wire(message)
    assert (sent.get_type(), sent.command) == ("COMMAND_LONG", 176)
    assert (sent.target_system, sent.target_component) == (SYSTEM, 1)
    assert sent.param1 == 1.0
    main, sub = int(sent.param2), int(sent.param3)
    return main << 16 | sub << 24 if autopilot in PX4 else main


@pytest.mark.parametrize(
    ("autopilot", "mode", "number"),
    [
        (ARDUCOPTER, Mode.GUIDED, wire.COPTER_MODE_GUIDED),
        (ARDUCOPTER, Mode.HOLD, wire.COPTER_MODE_BRAKE),
        (ARDUCOPTER, Mode.LAND, wire.COPTER_MODE_LAND),
        (ARDUCOPTER, Mode.RETURN, wire.COPTER_MODE_RTL),
        (ARDUPLANE, Mode.GUIDED, wire.PLANE_MODE_GUIDED),
        (ARDUPLANE, Mode.HOLD, wire.PLANE_MODE_LOITER),
        (ARDUPLANE, Mode.RETURN, wire.PLANE_MODE_RTL),
        (ARDUPLANE, Mode.TAKE_OFF, wire.PLANE_MODE_TAKEOFF),
        *[
            (autopilot, mode, number)
            for autopilot in PX4
            for mode, number in (  # px4.md 3
                (Mode.GUIDED, 0x00060000),
                (Mode.TAKE_OFF, 0x02040000),
                (Mode.HOLD, 0x03040000),
                (Mode.RETURN, 0x05040000),
                (Mode.LAND, 0x06040000),
            )
        ],
    ],
)
def test_a_mode_is_asked_for_and_recognised_by_the_autopilots_number(
    autopilot: Autopilot, mode: Mode, number: int
) -> None:
    assert mode_number(autopilot, mode) == number
    assert autopilot.modes.mode_of(number) is mode


@pytest.mark.parametrize(
    ("autopilot", "mode"),
    [
        (ARDUCOPTER, Mode.TAKE_OFF),
        (ARDUPLANE, Mode.LAND),
        *[(autopilot, Mode.OTHER) for autopilot in ALL],
    ],
)
def test_a_mode_that_there_is_not_is_not_asked_for(autopilot: Autopilot, mode: Mode) -> None:
    assert autopilot.set_mode(SetMode(mode=mode), FRAME, SYSTEM) == []


@each
def test_what_lands_has_a_mode_for_it(autopilot: Autopilot) -> None:
    lands = bool(autopilot.set_mode(SetMode(mode=Mode.LAND), FRAME, SYSTEM))
    assert lands == autopilot.traits.lands


@pytest.mark.parametrize(
    ("autopilot", "number", "name", "mode"),
    [
        (ARDUCOPTER, 0, "STABILIZE", Mode.OTHER),
        (ARDUCOPTER, 5, "LOITER", Mode.OTHER),
        (ARDUCOPTER, 21, "SMART RTL", Mode.RETURN),
        (ARDUCOPTER, 4_294_967_295, "mode 4294967295", Mode.OTHER),
        (ARDUPLANE, 5, "FLY BY WIRE A", Mode.OTHER),
        (ARDUPLANE, 10, "AUTO", Mode.OTHER),
        (PX4_MULTICOPTER, 0x00030000, "Position", Mode.OTHER),
        (PX4_MULTICOPTER, 0x04040000, "Mission", Mode.OTHER),
        (PX4_MULTICOPTER, 0x09040000, "Precision Land", Mode.LAND),
        (PX4_FIXED_WING, 0, "mode 0.0", Mode.OTHER),
        (PX4_FIXED_WING, 0xFFFFFFFF, "mode 255.0", Mode.OTHER),
    ],
)
def test_every_other_number_is_another_mode_and_has_a_name(
    autopilot: Autopilot, number: int, name: str, mode: Mode
) -> None:
    assert autopilot.modes.name_of(number) == name
    assert autopilot.modes.mode_of(number) is mode


def test_px4s_plane_holds_about_a_point_if_there_is_one() -> None:
    [message] = PX4_FIXED_WING.set_mode(SetMode(mode=Mode.HOLD, at_nea_m=CORNER), FRAME, SYSTEM)
    sent = over_the_wire(message)
    assert (sent.get_type(), sent.command, sent.frame) == ("COMMAND_INT", 192, 5)
    assert sent.param2 == 1.0  # bit 0 switches to Hold
    latitude, longitude = geodetic(*CORNER[:2])
    assert sent.x == pytest.approx(latitude * 1e7, abs=1)
    assert sent.y == pytest.approx(longitude * 1e7, abs=1)
    assert sent.z == CORNER[2]


@pytest.mark.parametrize("autopilot", [ARDUCOPTER, ARDUPLANE, PX4_MULTICOPTER])
def test_the_others_hold_where_they_are(autopilot: Autopilot) -> None:
    there = autopilot.set_mode(SetMode(mode=Mode.HOLD, at_nea_m=CORNER), FRAME, SYSTEM)
    here = autopilot.set_mode(SetMode(mode=Mode.HOLD), FRAME, SYSTEM)
    assert [m.to_dict() for m in there] == [m.to_dict() for m in here]


def test_px4s_plane_holds_where_it_is_if_the_point_is_no_place() -> None:
    nowhere = SetMode(mode=Mode.HOLD, at_nea_m=(math.nan, 0.0, 100.0))
    [message] = PX4_FIXED_WING.set_mode(nowhere, FRAME, SYSTEM)
    assert message.command == 176


# --- arming and take-off


@each
def test_it_is_armed_without_force(autopilot: Autopilot) -> None:
    [message] = autopilot.arm(SYSTEM)
    sent = over_the_wire(message)
    assert (sent.command, sent.target_system, sent.target_component) == (400, SYSTEM, 1)
    assert [getattr(sent, f"param{n}") for n in range(1, 8)] == [1.0] + [0.0] * 6


CLIMB = TakeOff(above_home_m=60.0, altitude_amsl_m=548.0)


def take_off(autopilot: Autopilot, heading_rad: float, command: TakeOff = CLIMB) -> Any:
    here = LaunchPose(position_nea_m=CORNER, heading_rad=heading_rad)
    messages = autopilot.take_off(command, here, FRAME, SYSTEM)
    return over_the_wire(messages[0]) if messages else None


def test_arducopter_climbs_to_a_height_above_home() -> None:
    sent = take_off(ARDUCOPTER, 0.3)
    assert (sent.get_type(), sent.command, sent.param7) == ("COMMAND_LONG", 22, 60.0)
    assert [getattr(sent, f"param{n}") for n in range(1, 7)] == [0.0] * 6


def test_arduplane_takes_off_by_its_mode() -> None:
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


@pytest.mark.parametrize("autopilot", [ARDUCOPTER, *PX4], ids=lambda a: a.name)
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e9, -1e9])
def test_a_take_off_to_nowhere_is_refused(autopilot: Autopilot, bad: float) -> None:
    assert take_off(autopilot, 0.0, TakeOff(above_home_m=bad, altitude_amsl_m=bad)) is None


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_take_off_along_no_direction_is_refused(bad: float) -> None:
    assert take_off(PX4_FIXED_WING, bad) is None


# --- speed


def test_arduplane_is_told_its_airspeed() -> None:
    [message] = ARDUPLANE.set_speed(18.0, SYSTEM)
    sent = over_the_wire(message)
    assert (sent.get_type(), sent.command) == ("COMMAND_INT", 43000)
    assert (sent.param1, sent.param2, sent.param3) == (wire.SPEED_TYPE_AIRSPEED, 18.0, 0.0)


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan, math.inf, 1e6])
def test_a_speed_that_is_none_is_refused(speed: float) -> None:
    assert ARDUPLANE.set_speed(speed, SYSTEM) == []


@pytest.mark.parametrize("autopilot", [ARDUCOPTER, *PX4], ids=lambda a: a.name)
def test_the_others_fly_at_the_speed_of_their_setpoints_or_their_own(autopilot: Autopilot) -> None:
    assert autopilot.set_speed(18.0, SYSTEM) == []


# --- whether setpoints are taken


@pytest.mark.parametrize("result", range(10))
def test_only_arduplane_refuses_a_setpoint_in_words(result: int) -> None:
    ack = over_the_wire(wire.MAVLink_command_ack_message(192, result))
    assert ARDUPLANE.refuses_setpoint(ack) == (result != wire.MAV_RESULT_ACCEPTED)
    other = over_the_wire(wire.MAVLink_command_ack_message(176, result))
    assert not ARDUPLANE.refuses_setpoint(other)
    assert not any(a.refuses_setpoint(ack) for a in (ARDUCOPTER, *PX4))


# --- streams


@each
def test_streams_have_rates_and_what_may_be_silent_is_one_of_them(autopilot: Autopilot) -> None:
    assert all(rate_hz > 0 for rate_hz in autopilot.streams_hz.values())
    assert autopilot.intermittent <= set(autopilot.streams_hz)
    assert wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT not in autopilot.streams_hz


@pytest.mark.parametrize("autopilot", [ARDUCOPTER, ARDUPLANE], ids=lambda a: a.name)
def test_nothing_is_asked_for_that_ardupilot_denies(autopilot: Autopilot) -> None:
    assert not set(DENIED) & set(autopilot.streams_hz)


# --- estimators


@pytest.mark.parametrize("autopilot", [ARDUCOPTER, ARDUPLANE], ids=lambda a: a.name)
@pytest.mark.parametrize(
    ("flags", "variances", "good"),
    [
        (0x33F, (0.03, 0.05), True),  # flying
        (0x33F, (13.33, 0.01), False),  # half a second after a step of 50 m, before any flag
        (0x33F, (0.03, 1.0), False),
        (0x33F, (math.nan, 0.0), False),
        (0x833F, (0.02, 0.01), False),  # glitch: after the estimate has given in
        (0x8027, (10.5, 0.0), False),
        (0x25, (0.0, 0.0), False),  # GPS lost
        (0xA7, (0.0, 0.0), False),  # before the first fix, or aiding has stopped
        (0x400, (0.0, 0.0), False),
        (0x33F & ~0x20, (0.0, 0.0), False),  # no height
    ],
)
def test_ardupilots_estimator_is_good_while_it_takes_its_measurements(
    autopilot: Autopilot, flags: int, variances: tuple[float, float], good: bool
) -> None:
    """Flags and figures of arducopter-gps-loss.tlog."""
    position, velocity = variances
    message = wire.MAVLink_ekf_status_report_message(flags, velocity, position, 0.0, 0.0, 0.0)
    read = autopilot.event_of(over_the_wire(message), 1.5, FRAME)
    assert read == Estimator(time_s=1.5, good=good)


def estimator_status(
    flags: int, accuracy_m: float, position: float = 0.05, velocity: float = 0.05
) -> Any:
    ratios = (velocity, position, 0.0, 0.1, 0.0, 0.0)
    return wire.MAVLink_estimator_status_message(0, flags, *ratios, accuracy_m, 0.3)


@each_px4
@pytest.mark.parametrize(
    ("flags", "good"),
    [
        (0x37F, True),  # flying
        (0x33F, True),
        (0x3FF, True),  # on the ground
        (0x365, False),  # 5 s after the loss of GPS
        (0x65, False),
        (0xE5, False),  # booting
        (0x37F | 0x400, False),  # glitch
        (0x37F | 0x800, False),  # accelerometers
        (0x37F & ~0x20, False),
    ],
)
def test_px4s_estimator_is_good_while_it_says_so(
    autopilot: Autopilot, flags: int, good: bool
) -> None:
    read = autopilot.event_of(over_the_wire(estimator_status(flags, 0.25)), 1.5, FRAME)
    assert read == Estimator(time_s=1.5, good=good, error_m=0.25)


@each_px4
@pytest.mark.parametrize(
    ("position", "velocity", "good"),
    [(0.2, 0.36, True), (1.0, 0.1, False), (0.1, 7.0, False), (0.1, math.nan, True)],
)
def test_px4s_estimator_is_not_good_while_it_throws_measurements_away(
    autopilot: Autopilot, position: float, velocity: float, good: bool
) -> None:
    message = over_the_wire(estimator_status(0x37F, 0.25, position, velocity))
    read = autopilot.event_of(message, 1.5, FRAME)
    assert read == Estimator(time_s=1.5, good=good, error_m=0.25)


@each_px4
@given(accuracy=st.floats(width=32))
def test_an_accuracy_is_a_length_or_unknown(autopilot: Autopilot, accuracy: float) -> None:
    read = autopilot.event_of(estimator_status(0x37F, accuracy), 1.5, FRAME)
    assert isinstance(read, Estimator)
    known = math.isfinite(accuracy) and accuracy > 0.0
    assert read.error_m == (accuracy if known else None)
