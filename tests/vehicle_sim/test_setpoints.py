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


def by_groups(mask: int) -> list[float] | None:
    """Of a group all or nothing; a push beside a place needs a velocity, and no bit of a force."""
    groups = [not mask & bits for bits in (0x007, 0x038, 0x1C0)]
    place, moves, push = groups
    if not any(groups) or (push and (mask & 0x200 or (place and not moves))):
        return None
    vectors = zip(groups, (PLACE, SPEED, PUSH), strict=True)
    return [v for is_whole, vector in vectors for v in (vector if is_whole else NOTHING)]


def by_axes(mask: int) -> list[float] | None:
    """Each axis by itself; no push with the bit of a force."""
    axes = [NAN if mask >> bit & 1 else v for bit, v in enumerate((*PLACE, *SPEED, *PUSH))]
    is_force = mask & 0x200 and mask & 0x1C0 != 0x1C0
    return None if is_force or mask & 0x1FF == 0x1FF else axes


@pytest.mark.parametrize(("read", "law"), [(read_by_arducopter, by_groups), (read_by_px4, by_axes)])
def test_of_any_mask_arducopter_takes_groups_or_stops_and_px4_takes_axes(
    read: Any, law: Any
) -> None:
    for mask in (*range(0x1000), 0x1DF8, 0xFDC0):  # bits above 11 mean nothing
        target = read(given(mask), 0.0)
        assert repr(told(target)) == repr(law(mask)), hex(mask)
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


@pytest.mark.parametrize(
    ("setpoint", "is_told"),
    [
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
    ],
)
def test_wild_numbers_stop_arducopter_and_what_the_real_one_does_not_survive_is_told(
    setpoint: Setpoint, is_told: bool
) -> None:
    target = read_by_arducopter(setpoint, 0.0)
    assert isinstance(target, Stop)
    assert target.text.startswith("SIM:") is is_told


def test_not_a_number_in_what_is_ignored_is_harmless_and_to_px4_is_an_axis_not_given() -> None:
    assert told(read_by_arducopter(globally(ALL), 0.0)) == asked(GLOBAL, SPEED)  # no acceleration
    for read in (read_by_arducopter, read_by_px4):
        nothing = dict.fromkeys(("velocity_ned_m_s", "acceleration_ned_m_s2"), NOTHING)
        unread = given(POSITION, yaw_rad=NAN, **nothing)
        assert told(read(unread, 0.0)) == asked(PLACE)
    wild = (NAN, math.inf, -math.inf)
    assert told(read_by_px4(given(POSITION_VELOCITY, velocity_ned_m_s=wild), 0.0)) == asked(PLACE)
    assert read_by_px4(given(POSITION, wild), 0.0) is None
    half = globally(POSITION_VELOCITY, (NAN, 8.5, 500.0))
    assert told(read_by_px4(half, 0.0)) == asked(NOTHING, SPEED)


@pytest.mark.parametrize(
    ("read", "frame"), [(read_by_px4, 8), (read_by_arducopter, 8), (read_by_arducopter, 9)]
)
def test_a_heading_to_the_east_turns_frames_of_the_body(read: Any, frame: int) -> None:
    target = read(given(VELOCITY & ~0x400, frame=frame), math.pi / 2.0)
    assert told(target) == asked(NOTHING, (-1.0, 2.0, -0.5))
    if read is read_by_arducopter:
        assert target.yaw_rad == pytest.approx(0.3 + math.pi / 2.0)
