"""How both firmwares read SET_POSITION_TARGET: the tables of ardupilot.md 3 and px4.md 4."""

import math
from typing import Any

import pytest
from harness import NAN, Vector

from vehicle_sim.autopilot.setpoints import Stop, Target, read_by_arducopter, read_by_px4
from vehicle_sim.autopilot.values import Setpoint

POSITION, POSITION_VELOCITY, ALL, VELOCITY = 0xDF8, 0xDC0, 0xC00, 0xDC7
"""Masks."""
PLACE, SPEED, PUSH = (40.0, -7.0, -33.0), (2.0, 1.0, -0.5), (0.3, -0.2, 0.1)
NOTHING, GLOBAL = (NAN, NAN, NAN), (47.4, 8.5, 500.0)
EAST_RAD = math.pi / 2.0
"""The heading: ahead is east, to the right is south."""


GIVEN = Setpoint(False, 1, 0, PLACE, SPEED, PUSH, yaw_rad=0.3, yaw_rate_rad_s=0.1)


def given(mask: int, position: Vector = PLACE, **changes: Any) -> Setpoint:
    return GIVEN._replace(type_mask=mask, position=position, **changes)


def globally(mask: int, position: Vector = GLOBAL, frame: int = 6) -> Setpoint:
    return given(mask, position, frame=frame, is_global=True)


def asked(place: Vector = NOTHING, moves: Vector = NOTHING, push: Vector = NOTHING) -> Any:
    return pytest.approx([*place, *moves, *push], abs=1e-9, nan_ok=True)


def told(target: Target | Stop | None) -> list[float] | None:
    """Position, velocity and acceleration to be flown; None: nothing."""
    return [v for vector in target[:3] for v in vector] if isinstance(target, Target) else None


P, PV, PVA = asked(PLACE), asked(PLACE, SPEED), asked(PLACE, SPEED, PUSH)
V, VA, A = asked(NOTHING, SPEED), asked(NOTHING, SPEED, PUSH), asked(NOTHING, NOTHING, PUSH)


MASKS = [  # and what ArduCopter and PX4 take
    *((0xDF8, P, P), (0xDC0, PV, PV), (0xC00, PVA, PVA), (0x9C0, PV, PV), (0x5C0, PV, PV)),
    *((0x000, PVA, PVA), (0xDC7, V, V), (0xC07, VA, VA), (0xC3F, A, A), (0xFFF, None, None)),
    # one axis ignored: the whole group, or this axis
    (0xDC1, V, asked((NAN, -7.0, -33.0), SPEED)),
    (0xDE0, P, asked(PLACE, (2.0, 1.0, NAN))),
    (0xD40, PV, asked(PLACE, SPEED, (NAN, -0.2, NAN))),
    (0xDE3, None, asked((NAN, NAN, -33.0), (2.0, 1.0, NAN))),
    (0xDDC, None, asked((40.0, -7.0, NAN), (NAN, NAN, -0.5))),
    (0xC38, None, asked(PLACE, NOTHING, PUSH)),  # a push needs a velocity beside a place
    *((0xFC0, PV, PV), (0xE00, None, None)),  # force without an acceleration, and with it
    *((0xFDC0, PV, PV), (0x1DF8, P, P)),  # bits above 11
]


def test_arducopter_takes_whole_groups_or_stops_and_px4_takes_each_axis_by_itself() -> None:
    for mask, *taken in MASKS:
        for read, wanted in zip((read_by_arducopter, read_by_px4), taken, strict=True):
            target: Target | Stop | None = read(given(mask), 0.0)  # type: ignore[operator]
            assert told(target) == wanted, hex(mask)
            if isinstance(target, Target):
                assert math.isnan(target.yaw_rad) is bool(mask & 0x400)
                assert math.isnan(target.yaw_rate_rad_s) is bool(mask & 0x800)


@pytest.mark.parametrize(
    ("read", "send", "mask", "frames"),
    [
        (read_by_arducopter, given, POSITION, {1, 7, 8, 9}),
        (read_by_arducopter, globally, POSITION, {0, 3, 5, 6, 10, 11}),
        (read_by_arducopter, globally, POSITION_VELOCITY, {0, 3, 5, 6}),
        (read_by_px4, given, POSITION, {1}),
        (read_by_px4, given, VELOCITY, {1, 8}),
        (read_by_px4, globally, POSITION, {5, 6, 11}),
        (read_by_px4, globally, VELOCITY, {*range(22)}),
        (read_by_px4, globally, 0xDC4, {*range(22)}),  # of a place that lacks an axis nothing
    ],
)
def test_a_setpoint_is_taken_in_some_frames(
    read: Any, send: Any, mask: int, frames: set[int]
) -> None:
    targets = {frame: read(send(mask, frame=frame), 0.0) for frame in range(22)}
    assert {frame for frame in targets if told(targets[frame])} == frames
    for frame in frames:
        position = NOTHING if mask & 7 else GLOBAL if send is globally else None
        assert position is None or targets[frame].position == pytest.approx(position, nan_ok=True)


WILD = [  # and whether it is told that the real one does not survive it
    *((globally(POSITION, p), False) for p in ((91.0, 8.5, 500.0), (47.0, 180.5, 500.0))),
    *(
        (given(POSITION_VELOCITY, velocity_ned_m_s=(v, 0, 0)), False)
        for v in (NAN, 1001.0, -1001.0)
    ),
    # what the real one does not survive
    *((given(POSITION, p), True) for p in ((NAN, 0, -30), (0, 0, NAN), (1e9, 0, -30))),
    *((globally(POSITION, (47.0, 8.0, z)), True) for z in (NAN, 1e9)),
    (given(ALL, acceleration_ned_m_s2=(NAN, 0.0, 0.0)), True),
    (given(0x9F8, yaw_rad=NAN), True),
]


def test_wild_numbers_stop_arducopter_and_what_the_real_one_does_not_survive_is_told() -> None:
    for setpoint, is_told in WILD:
        target = read_by_arducopter(setpoint, 0.0)
        assert isinstance(target, Stop), setpoint
        assert target.text.startswith("SIM:") is is_told, setpoint


def test_not_a_number_in_what_is_ignored_is_harmless_and_to_px4_is_an_axis_not_given() -> None:
    assert told(read_by_arducopter(globally(ALL), 0.0)) == asked(GLOBAL, SPEED)  # no acceleration
    for read in (read_by_arducopter, read_by_px4):
        nothing = dict.fromkeys(("velocity_ned_m_s", "acceleration_ned_m_s2"), NOTHING)
        unread = given(POSITION, yaw_rad=NAN, **nothing)
        assert told(read(unread, 0.0)) == P
    wild = (NAN, math.inf, -math.inf)
    assert told(read_by_px4(given(POSITION_VELOCITY, velocity_ned_m_s=wild), 0.0)) == P
    assert read_by_px4(given(POSITION, wild), 0.0) is None
    assert told(read_by_px4(globally(POSITION_VELOCITY, (NAN, 8.5, 500.0)), 0.0)) == V


def test_frames_of_the_body_turn_with_it() -> None:
    turned = asked(NOTHING, (-1.0, 2.0, -0.5))
    assert told(read_by_px4(given(VELOCITY, frame=8), EAST_RAD)) == turned
    for frame in (8, 9):
        target = read_by_arducopter(given(VELOCITY & ~0x400, frame=frame), EAST_RAD)
        assert told(target) == turned
        assert isinstance(target, Target)
        assert target.yaw_rad == pytest.approx(0.3 + EAST_RAD)
