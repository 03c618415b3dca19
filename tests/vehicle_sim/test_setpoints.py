"""How both firmwares read SET_POSITION_TARGET: the tables of ardupilot.md 3 and px4.md 4."""

import math
from itertools import product
from typing import Any

import pytest
from harness import ALL, NAN, POSITION, POSITION_VELOCITY, VELOCITY, ZERO, Vector

from vehicle_sim.autopilot.setpoints import (
    Stop,
    Target,
    is_flyable,
    read_by_arducopter,
    read_by_px4,
)
from vehicle_sim.autopilot.values import Setpoint

PLACE: Vector = (40.0, -7.0, -33.0)
SPEED: Vector = (2.0, 1.0, -0.5)
PUSH: Vector = (0.3, -0.2, 0.1)
NOTHING: Vector = (NAN, NAN, NAN)
GLOBAL: Vector = (47.4, 8.5, 500.0)
EAST_RAD = math.pi / 2.0
"""The heading: ahead is east, to the right is south."""


def given(
    mask: int,
    position: Vector = PLACE,
    velocity: Vector = SPEED,
    acceleration: Vector = PUSH,
    frame: int = 1,
    *,
    is_global: bool = False,
    yaw_rad: float = 0.3,
) -> Setpoint:
    return Setpoint(
        is_global=is_global,
        frame=frame,
        type_mask=mask,
        position=position,
        velocity_ned_m_s=velocity,
        acceleration_ned_m_s2=acceleration,
        yaw_rad=yaw_rad,
        yaw_rate_rad_s=0.1,
    )


def vectors(target: Target) -> Any:
    flat = [value for vector in target[:3] for value in vector]
    return pytest.approx(flat, abs=1e-9, nan_ok=True)


def asked(
    position: Vector = NOTHING, velocity: Vector = NOTHING, acceleration: Vector = NOTHING
) -> list[float]:
    return [*position, *velocity, *acceleration]


# --- ArduCopter: groups ---------------------------------------------------------------------------

P, PV, PVA = asked(PLACE), asked(PLACE, SPEED), asked(PLACE, SPEED, PUSH)
V, VA, A = asked(NOTHING, SPEED), asked(NOTHING, SPEED, PUSH), asked(NOTHING, NOTHING, PUSH)


@pytest.mark.parametrize(
    ("mask", "taken"),
    [
        *((0xDF8, P), (0xDC0, PV), (0xC00, PVA), (0x9C0, PV), (0x5C0, PV), (0x1C0, PV)),
        *((0x000, PVA), (0xDC7, V), (0xC07, VA), (0xC3F, A)),
        *((0xDC1, V), (0xDC4, V), (0xDE0, P), (0xD40, PV)),  # one axis ignored: the whole group
        *((0xFC0, PV), (0xFF8, P), (0x1DC0, PV), (0xFDC0, PV)),  # force without an acceleration
        *((0xC38, None), (0xFFF, None), (0xDE7, None), (0xE00, None)),
    ],
)
def test_arducopter_takes_whole_groups_or_stops(mask: int, taken: list[float] | None) -> None:
    target = read_by_arducopter(given(mask), 0.0)
    if taken is None:
        assert target == Stop()
        return
    assert isinstance(target, Target)
    assert taken == vectors(target)
    assert math.isnan(target.yaw_rad) is bool(mask & 0x400)
    assert math.isnan(target.yaw_rate_rad_s) is bool(mask & 0x800)


@pytest.mark.parametrize(
    "setpoint",
    [
        *(given(POSITION, frame=frame) for frame in (0, 2, 3, 4, 6, 10, 12, 20, 21)),
        *(given(POSITION, GLOBAL, frame=f, is_global=True) for f in (1, 2, 7, 8, 12)),
        *(given(POSITION_VELOCITY, GLOBAL, frame=f, is_global=True) for f in (10, 11)),
        given(POSITION, (91.0, 8.5, 500.0), frame=6, is_global=True),
        given(POSITION, (47.0, 180.5, 500.0), frame=6, is_global=True),
        *(given(POSITION_VELOCITY, velocity=(v, 0.0, 0.0)) for v in (NAN, 1001.0, -1001.0)),
    ],
)
def test_what_arducopter_does_not_like_stops_it_without_a_word(setpoint: Setpoint) -> None:
    assert read_by_arducopter(setpoint, 0.0) == Stop()


@pytest.mark.parametrize(
    "setpoint",
    [
        given(POSITION, (NAN, 0.0, -30.0)),
        given(POSITION, (0.0, 0.0, NAN)),
        given(POSITION, (47.0, 8.0, NAN), frame=6, is_global=True),
        given(ALL, acceleration=(NAN, 0.0, 0.0)),
        given(0x9F8, yaw_rad=NAN),
        given(POSITION, (1e9, 0.0, -30.0)),
        given(POSITION, (47.0, 8.0, 1e9), frame=6, is_global=True),
    ],
)
def test_what_arducopter_does_not_survive_is_refused_with_a_word(setpoint: Setpoint) -> None:
    target = read_by_arducopter(setpoint, 0.0)
    assert isinstance(target, Stop)
    assert target.text.startswith("SIM:")


def test_not_a_number_in_what_is_ignored_is_harmless() -> None:
    for read in (read_by_arducopter, read_by_px4):
        target = read(given(POSITION, velocity=NOTHING, acceleration=NOTHING, yaw_rad=NAN), 0.0)
        assert isinstance(target, Target)
        assert vectors(target) == P


@pytest.mark.parametrize("frame", [0, 3, 5, 6, 10, 11])
def test_arducopter_takes_a_global_place_in_these_frames(frame: int) -> None:
    masks = (POSITION, *((ALL,) if frame < 10 else ()))
    for mask, place in product(masks, (GLOBAL, ZERO)):  # null island is a place, too
        target = read_by_arducopter(given(mask, place, frame=frame, is_global=True), 0.0)
        assert isinstance(target, Target)
        assert target.position == place
        assert math.isnan(target.acceleration[0])  # GLOBAL_INT has none beside a velocity


# --- PX4: axes ------------------------------------------------------------------------------------

ONLY_P, ONLY_V, ONLY_A = 0xDF8, 0xDC7, 0xC3F


@pytest.mark.parametrize(
    ("mask", "taken"),
    [
        *((ONLY_P, P), (0xDC0, PV), (0xC00, PVA), (ONLY_V, V), (ONLY_A, A), (0x000, PVA)),
        (0xDE3, asked((NAN, NAN, -33.0), (2.0, 1.0, NAN))),
        (0xDDC, asked((40.0, -7.0, NAN), (NAN, NAN, -0.5))),
        (0xFC0, PV),  # force without an acceleration
        *((0xE00, None), (0xFFF, None), (0x9FF, None)),
    ],
)
def test_px4_takes_each_axis_by_itself(mask: int, taken: list[float] | None) -> None:
    target = read_by_px4(given(mask), EAST_RAD)
    assert (target is None) is (taken is None)
    if target is not None:
        assert taken == vectors(target)
        assert is_flyable(target)


@pytest.mark.parametrize(
    ("mask", "frame", "is_global"),
    [
        *((ONLY_P, 8, False), (ONLY_V, 7, False), (ONLY_P, 9, False), (ONLY_P, 0, False)),
        *((ONLY_V, frame, False) for frame in (2, 3, 12, 20, 21)),
        *((ONLY_P, frame, True) for frame in (0, 3, 10)),
    ],
)
def test_what_counts_as_no_setpoint_of_px4(mask: int, frame: int, is_global: bool) -> None:
    place = GLOBAL if is_global else PLACE
    assert read_by_px4(given(mask, place, frame=frame, is_global=is_global), EAST_RAD) is None


@pytest.mark.parametrize("frame", [0, 3, 5, 6, 10, 11])
def test_px4_takes_a_velocity_alone_in_every_frame_of_global_int(frame: int) -> None:
    for mask in (ONLY_V, 0xDC4, 0xDC3):  # and a place of which an axis is missing is none
        if mask == ONLY_V or frame in (5, 6, 11):
            target = read_by_px4(given(mask, GLOBAL, frame=frame, is_global=True), EAST_RAD)
            assert target is not None
            assert vectors(target) == V


def test_what_is_not_finite_is_not_given_and_half_of_a_place_cannot_be_flown() -> None:
    odd: Vector = (NAN, math.inf, -math.inf)
    assert read_by_px4(given(ONLY_P, odd), EAST_RAD) is None
    target = read_by_px4(given(0xDC0, velocity=odd), EAST_RAD)
    assert target is not None
    assert vectors(target) == P
    for mask in (0xDFE, 0xDFC, 0xDEA):  # of the last north is a place and east a velocity
        target = read_by_px4(given(mask), EAST_RAD)
        assert target is not None
        assert not is_flyable(target)


def test_frames_of_the_body_turn_with_it() -> None:
    by_px4 = read_by_px4(given(ONLY_V, frame=8), EAST_RAD)
    assert by_px4 is not None
    assert vectors(by_px4) == asked(NOTHING, (-1.0, 2.0, -0.5))
    for frame in (8, 9):
        target = read_by_arducopter(given(VELOCITY & ~0x400, frame=frame), EAST_RAD)
        assert isinstance(target, Target)
        assert vectors(target) == asked(NOTHING, (-1.0, 2.0, -0.5))
        assert target.yaw_rad == pytest.approx(0.3 + EAST_RAD)
