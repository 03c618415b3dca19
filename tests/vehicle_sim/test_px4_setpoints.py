"""Masks and frames of SET_POSITION_TARGET on PX4: every row of px4.md 4, read and flown."""

import math

import pytest
from tracking_px4 import Rig, Vector

from vehicle_sim.autopilot.setpoints import Target, is_flyable, read_by_px4
from vehicle_sim.autopilot.values import Setpoint

_EAST_RAD = math.pi / 2.0
_P, _V, _A = (10.0, 20.0, -30.0), (1.0, 2.0, -0.5), (0.1, 0.2, -0.3)
_POSITION, _VELOCITY, _ACCELERATION = 0xFF8, 0xFC7, 0xE3F
"""Masks that leave only one of them (FORCE apart)."""


def _read(
    mask: int,
    *,
    frame: int = 1,
    is_global: bool = False,
    position: Vector = _P,
    velocity: Vector = _V,
    acceleration: Vector = _A,
) -> Target | None:
    return read_by_px4(
        Setpoint(
            is_global=is_global,
            frame=frame,
            type_mask=mask & ~0x200 if mask != 0xFFF else mask,
            position=position,
            velocity_ned_m_s=velocity,
            acceleration_ned_m_s2=acceleration,
            yaw_rad=0.3,
            yaw_rate_rad_s=0.1,
        ),
        _EAST_RAD,
    )


def _same(one: Vector, other: Vector) -> bool:
    """NaN equals NaN."""
    return all(
        a == pytest.approx(b, abs=1e-6) or (math.isnan(a) and math.isnan(b))
        for a, b in zip(one, other, strict=True)
    )


_NONE = (math.nan,) * 3


@pytest.mark.parametrize(
    ("mask", "position", "velocity", "acceleration"),
    [
        (_POSITION, _P, _NONE, _NONE),
        (0xFC0, _P, _V, _NONE),
        (0xE00, _P, _V, _A),
        (_VELOCITY, _NONE, _V, _NONE),
        (_ACCELERATION, _NONE, _NONE, _A),
        (0xFE3, (math.nan, math.nan, -30.0), (1.0, 2.0, math.nan), _NONE),
        (0xFDC, (10.0, 20.0, math.nan), (math.nan, math.nan, -0.5), _NONE),
    ],
)
def test_local_ned_takes_any_mixture(
    mask: int, position: Vector, velocity: Vector, acceleration: Vector
) -> None:
    target = _read(mask)
    assert target is not None
    assert is_flyable(target)
    assert _same(target.position, position)
    assert _same(target.velocity, velocity)
    assert _same(target.acceleration, acceleration)
    assert math.isnan(target.yaw_rad)


def test_mask_0_uses_every_field() -> None:
    target = _read(0)
    assert target is not None
    assert (target.position, target.yaw_rad, target.yaw_rate_rad_s) == (_P, 0.3, 0.1)


def test_body_frame_velocity_turns_with_the_heading() -> None:
    """Heading east: ahead is east, to the right is south."""
    target = _read(_VELOCITY, frame=8)
    assert target is not None
    assert _same(target.velocity, (-2.0, 1.0, -0.5))


@pytest.mark.parametrize(
    ("mask", "frame", "is_global"),
    [
        (_POSITION, 8, False),
        (_VELOCITY, 7, False),
        (_POSITION, 9, False),
        *((_VELOCITY, frame, False) for frame in (2, 3, 12, 20, 21)),
        (_POSITION, 0, False),
        (0xDFF, 1, False),
        (0x9FF, 1, False),
        (_POSITION, 0, True),
        (_POSITION, 3, True),
        (_POSITION, 10, True),
        (0xFFF, 5, True),
    ],
)
def test_what_counts_as_no_setpoint(mask: int, frame: int, is_global: bool) -> None:
    place = (47.4, 8.5, 500.0) if is_global else _P
    assert _read(mask, frame=frame, is_global=is_global, position=place) is None


def test_a_force_is_refused_only_with_an_acceleration() -> None:
    def forced(mask: int) -> Target | None:
        setpoint = Setpoint(
            is_global=False,
            frame=1,
            type_mask=mask | 0x200,
            position=_P,
            velocity_ned_m_s=_V,
            acceleration_ned_m_s2=_A,
            yaw_rad=0.0,
        )
        return read_by_px4(setpoint, _EAST_RAD)

    assert forced(0xC00) is None
    assert forced(0xDC0) is not None


@pytest.mark.parametrize("mask", [0xFFE, 0xFFC])
def test_half_a_position_is_taken_but_cannot_be_flown(mask: int) -> None:
    target = _read(mask)
    assert target is not None
    assert not is_flyable(target)


def test_numbers_that_are_not_finite_count_as_not_given() -> None:
    nothing = (math.nan, math.inf, -math.inf)
    assert _read(_POSITION, position=nothing) is None
    target = _read(0xFC0, velocity=nothing)
    assert target is not None
    assert _same(target.velocity, _NONE)
    assert is_flyable(target)


@pytest.mark.parametrize(
    ("frame", "z_m", "above_origin_m"),
    [
        (5, 498.0, 10.0),  # origin at 488 m
        (6, 498.0, 493.0),  # 498 m above home, 5 m above the origin: with the wrong sign, 493 m
        (6, 10.0, 5.0),  # px4.md 1, item 6: asked 10 m above home, flew to home's height
        (11, 498.0, 490.0),  # 498 m above ground at 480 m
    ],
)
def test_frames_of_global_int(frame: int, z_m: float, above_origin_m: float) -> None:
    rig = Rig()
    rig.run(4.0)
    origin = rig.px4.estimator.origin = rig.px4.estimate.place.at(488.0)
    rig.px4.frame = rig.px4.firmware.frame(origin)
    rig.px4.home, rig.px4.ground_m = origin.at(493.0), 480.0
    rig.command(176, 1.0, 6.0)
    rig.send((*origin[:2], z_m), mask=_POSITION & ~0x200, frame=frame, is_global=True)
    target = rig.px4.target
    assert target is not None
    assert target.position == pytest.approx((0.0, 0.0, -above_origin_m), abs=1e-6)


@pytest.mark.parametrize("frame", [0, 3, 5, 6, 10, 11])
def test_a_velocity_alone_is_taken_in_every_frame_of_global_int(frame: int) -> None:
    target = _read(_VELOCITY, frame=frame, is_global=True, position=(0.0, 0.0, 0.0))
    assert target is not None
    assert _same(target.velocity, _V)


@pytest.mark.parametrize("mask", [0xFC4, 0xFC3])
def test_a_global_position_needs_all_three_axes(mask: int) -> None:
    target = _read(mask, frame=5, is_global=True, position=(47.4, 8.5, 498.0))
    assert target is None or _same(target.position, _NONE)


# --- flown ----------------------------------------------------------------------------------------


def _hover() -> Rig:
    rig = Rig()
    rig.take_off(12.0)
    return rig


def test_a_setpoint_before_offboard_is_a_sign_of_life_only() -> None:
    """px4.md 3: its value is dropped."""
    rig = _hover()
    rig.command(176, 1.0, 4.0, 3.0)
    rig.run(3.0)
    rig.send((300.0, 0.0, -12.0))
    rig.run(0.2)
    rig.command(176, 1.0, 6.0)
    rig.run(0.6)
    assert rig.px4.mode_name == "Offboard"
    assert rig.px4.target is None
    assert rig.speed_m_s < 0.6
