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
    yaw_rad: float = 0.3,
    is_global: bool = False,
) -> Setpoint:
    vectors = (position, velocity, acceleration)
    return Setpoint(is_global, frame, mask, *vectors, yaw_rad, yaw_rate_rad_s=0.1)


def globally(mask: int, position: Vector = GLOBAL, frame: int = 6, **more: Any) -> Setpoint:
    return given(mask, position, frame=frame, is_global=True, **more)


def vectors(target: Any) -> Any:
    flat = [value for vector in target[:3] for value in vector]
    return pytest.approx(flat, abs=1e-9, nan_ok=True)


def asked(
    position: Vector = NOTHING, velocity: Vector = NOTHING, acceleration: Vector = NOTHING
) -> list[float]:
    return [*position, *velocity, *acceleration]


P, PV, PVA = asked(PLACE), asked(PLACE, SPEED), asked(PLACE, SPEED, PUSH)
V, VA, A = asked(NOTHING, SPEED), asked(NOTHING, SPEED, PUSH), asked(NOTHING, NOTHING, PUSH)

# --- ArduCopter: groups ---------------------------------------------------------------------------


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
    ("setpoint", "is_told"),
    [
        *((given(POSITION, frame=f), False) for f in (0, 2, 3, 4, 6, 10, 12, 20, 21)),
        *((globally(POSITION, frame=f), False) for f in (1, 2, 7, 8, 12)),
        *((globally(POSITION_VELOCITY, frame=f), False) for f in (10, 11)),
        *((globally(POSITION, p), False) for p in ((91.0, 8.5, 500.0), (47.0, 180.5, 500.0))),
        *((given(POSITION_VELOCITY, velocity=(v, 0, 0)), False) for v in (NAN, 1001.0, -1001.0)),
        # what the real one does not survive
        *((given(POSITION, p), True) for p in ((NAN, 0, -30), (0, 0, NAN), (1e9, 0, -30))),
        *((globally(POSITION, (47.0, 8.0, z)), True) for z in (NAN, 1e9)),
        (given(ALL, acceleration=(NAN, 0.0, 0.0)), True),
        (given(0x9F8, yaw_rad=NAN), True),
    ],
)
def test_what_arducopter_does_not_like_stops_it_and_is_told_if_it_were_not_survived(
    setpoint: Setpoint, *, is_told: bool
) -> None:
    target = read_by_arducopter(setpoint, 0.0)
    assert isinstance(target, Stop)
    assert target.text.startswith("SIM:") if is_told else target == Stop()


def test_not_a_number_in_what_is_ignored_is_harmless() -> None:
    for read in (read_by_arducopter, read_by_px4):
        target = read(given(POSITION, velocity=NOTHING, acceleration=NOTHING, yaw_rad=NAN), 0.0)
        assert vectors(target) == P


@pytest.mark.parametrize("frame", [0, 3, 5, 6, 10, 11])
def test_arducopter_takes_a_global_place_in_these_frames(frame: int) -> None:
    masks = (POSITION, *((ALL,) if frame < 10 else ()))
    for mask, place in product(masks, (GLOBAL, ZERO)):  # null island is a place, too
        target = read_by_arducopter(globally(mask, place, frame), 0.0)
        assert isinstance(target, Target)
        assert target.position == place
        assert math.isnan(target.acceleration[0])  # GLOBAL_INT has none beside a velocity


# --- PX4: axes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mask", "taken"),
    [
        *((0xDF8, P), (0xDC0, PV), (0xC00, PVA), (0xDC7, V), (0xC3F, A), (0x000, PVA)),
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
    "setpoint",
    [
        *(given(POSITION, frame=frame) for frame in (8, 9, 0)),
        *(given(VELOCITY, frame=frame) for frame in (7, 2, 3, 12, 20, 21)),
        *(globally(POSITION, frame=frame) for frame in (0, 3, 10)),
        given(POSITION, (NAN, math.inf, -math.inf)),
    ],
)
def test_what_counts_as_no_setpoint_of_px4(setpoint: Setpoint) -> None:
    assert read_by_px4(setpoint, EAST_RAD) is None


@pytest.mark.parametrize("frame", [0, 3, 5, 6, 10, 11])
def test_px4_takes_a_velocity_alone_in_every_frame_of_global_int(frame: int) -> None:
    for mask in (VELOCITY, 0xDC4, 0xDC3):  # and a place of which an axis is missing is none
        if mask == VELOCITY or frame in (5, 6, 11):
            assert vectors(read_by_px4(globally(mask, frame=frame), EAST_RAD)) == V


def test_what_is_not_finite_is_not_given_and_half_of_a_place_cannot_be_flown() -> None:
    target = read_by_px4(given(0xDC0, velocity=(NAN, math.inf, -math.inf)), EAST_RAD)
    assert vectors(target) == P
    for mask in (0xDFE, 0xDFC, 0xDEA):  # of the last north is a place and east a velocity
        target = read_by_px4(given(mask), EAST_RAD)
        assert target is not None
        assert not is_flyable(target)


def test_frames_of_the_body_turn_with_it() -> None:
    turned = asked(NOTHING, (-1.0, 2.0, -0.5))
    assert vectors(read_by_px4(given(VELOCITY, frame=8), EAST_RAD)) == turned
    for frame in (8, 9):
        target = read_by_arducopter(given(VELOCITY & ~0x400, frame=frame), EAST_RAD)
        assert isinstance(target, Target)
        assert vectors(target) == turned
        assert target.yaw_rad == pytest.approx(0.3 + EAST_RAD)
