"""Masks and frames: the tables that were measured on the real ArduCopter, through the echo."""

import math
from collections.abc import Callable
from typing import Any

import pytest

Make = Callable[..., Any]
HERE = (47.0, 8.0, 100.0)
NORTH = (47.0005, 8.0, 130.0)
STOPPED = (None, (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def hovering(request: pytest.FixtureRequest) -> Any:
    make = request.getfixturevalue("pilot_class")
    return make().airborne(100.0)


def echoed(it: Any) -> tuple[Any, Any]:
    target = it.target()
    return target.position_ned_m, target.velocity_ned_m_s


@pytest.mark.parametrize(
    ("mask", "uses_position", "uses_velocity"),
    [
        (0xDF8, True, False),
        (0xDC0, True, True),
        (0xC00, True, True),
        (0x9C0, True, True),
        (0x5C0, True, True),
        (0x1C0, True, True),
        (0x000, True, True),
        (0xDC7, False, True),
        (0xC07, False, True),
        (0xDC1, False, True),
        (0xDC4, False, True),
        (0xDE0, True, False),
        (0xD40, True, True),
        (0xC38, False, False),
        (0xFFF, False, False),
        (0xDE7, False, False),
        (0xC3F, False, False),
        (0xE00, False, False),
        (0xFC0, True, True),
        (0xFF8, True, False),
        (0x1DC0, True, True),
        (0xFDC0, True, True),
    ],
)
def test_the_mask_says_what_is_taken(
    hovering: Any, mask: int, *, uses_position: bool, uses_velocity: bool
) -> None:
    hovering.setpoint((10.0, 20.0, -130.0), (1.0, 2.0, -3.0), mask=mask, frame=1, is_global=False)
    position, velocity = echoed(hovering)
    assert velocity == ((1.0, 2.0, -3.0) if uses_velocity else (0.0, 0.0, 0.0))
    if uses_position:
        assert position == pytest.approx((10.0, 20.0, -130.0), abs=1e-5)
    else:
        assert position is None


@pytest.mark.parametrize(("frame", "down_m"), [(0, -130.0), (5, -130.0), (3, -130.0), (6, -130.0)])
def test_global_frames_are_above_sea_or_home(hovering: Any, frame: int, down_m: float) -> None:
    hovering.setpoint(NORTH, frame=frame)
    assert echoed(hovering)[0] == pytest.approx((55.66, 0.0, down_m), abs=0.01)


def test_above_home_is_not_above_sea(pilot: Make) -> None:
    it = pilot(ground_amsl_m=70.0).airborne(100.0)
    for frame, down_m in ((5, -60.0), (0, -60.0), (3, -130.0), (6, -130.0)):
        it.setpoint(NORTH, frame=frame)
        assert echoed(it)[0][2] == pytest.approx(down_m)


@pytest.mark.parametrize(
    ("frame", "mask", "text"),
    [
        (1, 0xDF8, "Unknown mavlink coordinate frame 1"),
        (8, 0xDF8, "Unknown mavlink coordinate frame 8"),
        (1, 2496, "Unknown mavlink coordinate frame 1"),
        (10, 2496, None),
        (11, 2496, None),
    ],
)
def test_other_global_frames_stop(hovering: Any, frame: int, mask: int, text: str | None) -> None:
    hovering.setpoint(NORTH)
    before = len(hovering.texts)
    hovering.setpoint(NORTH, (1.0, 0.0, 0.0), frame=frame, mask=mask)
    assert echoed(hovering) == STOPPED
    assert hovering.texts[before:] == ([] if text is None else [text])


@pytest.mark.parametrize("frame", [0, 2, 3, 4, 6, 10, 12, 20, 21])
def test_other_local_frames_stop(hovering: Any, frame: int) -> None:
    hovering.setpoint((1.0, 2.0, 3.0), (1.0, 0.0, 0.0), frame=frame, is_global=False)
    assert echoed(hovering) == STOPPED


def test_offset_frames_count_from_the_vehicle_and_body_frames_from_its_nose(pilot: Make) -> None:
    it = pilot().airborne(100.0)
    it.setpoint(HERE, yaw_rad=math.pi / 2)
    it.run(5.0)  # nose to the east
    for frame, there in ((7, (10.0, 20.0)), (8, (-20.0, 10.0)), (9, (-20.0, 10.0))):
        it.setpoint((10.0, 20.0, -5.0), frame=frame, is_global=False)
        assert echoed(it)[0] == pytest.approx((*there, -105.0), abs=0.05)


@pytest.mark.parametrize(
    ("position", "velocity", "mask"),
    [
        ((47.0, 8.0, math.nan), (0.0, 0.0, 0.0), 2496),
        ((47.0, 8.0, 1e9), (0.0, 0.0, 0.0), 2496),
        ((math.inf, 8.0, 100.0), (0.0, 0.0, 0.0), 2496),
    ],
)
def test_what_is_not_finite_or_absurd_stops_the_vehicle_and_is_said_once(
    hovering: Any, position: tuple[float, ...], velocity: tuple[float, ...], mask: int
) -> None:
    hovering.setpoint(NORTH, (1.0, 0.0, 0.0))
    before = len(hovering.texts)
    for _ in range(3):
        hovering.setpoint(position, velocity, mask=mask)
        assert echoed(hovering) == STOPPED
    assert len(hovering.texts[before:]) == 1
    assert hovering.texts[-1].startswith("SIM: ")
    assert "refused" in hovering.texts[-1]


@pytest.mark.parametrize("velocity", [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0)])
def test_a_velocity_that_is_not_finite_stops_in_silence_as_measured(
    hovering: Any, velocity: tuple[float, ...]
) -> None:
    hovering.setpoint(NORTH, (1.0, 0.0, 0.0))
    before = len(hovering.texts)
    hovering.setpoint(HERE, velocity)
    assert echoed(hovering) == STOPPED
    assert hovering.texts[before:] == []


@pytest.mark.parametrize(("frame", "mask"), [(1, 0xC00), (1, 0xC07), (1, 0xC3F)])
def test_an_acceleration_that_is_not_finite_is_refused(
    hovering: Any, frame: int, mask: int
) -> None:
    hovering.setpoint(NORTH, (1.0, 0.0, 0.0))
    before = len(hovering.texts)
    hovering.setpoint(
        (0.0, 0.0, -100.0),
        mask=mask,
        frame=frame,
        is_global=False,
        acceleration_ned_m_s2=(math.nan, 0.0, 0.0),
    )
    assert echoed(hovering) == STOPPED
    assert len(hovering.texts[before:]) == 1


def test_an_acceleration_alone_is_flown_until_the_time_out(pilot: Make) -> None:
    it = pilot().airborne(100.0)
    for _ in range(30):
        it.setpoint(mask=0xC3F, frame=1, is_global=False, acceleration_ned_m_s2=(1.0, 0.0, 0.0))
        it.run(0.1)
    assert it.copter.velocity_north_m_s == pytest.approx(2.9, abs=0.4)
    assert it.target().type_mask == 0xC3F
    it.run(12.0)
    assert it.copter.velocity_north_m_s == pytest.approx(0.0, abs=0.1)


def test_a_height_above_terrain_is_taken_for_one_above_the_sea_and_flown_into_the_ground(
    pilot: Make,
) -> None:
    it = pilot(down_m_s=1.5, vertical_m_s=2.5, ground_amsl_m=400.0).airborne(30.0)
    it.setpoint((47.001, 8.0, 30.0), mask=0xDF8, frame=10)
    it.run(10.0)
    assert it.copter.velocity_up_m_s == pytest.approx(-1.5, abs=0.05)
    assert it.north_m() < 8.0  # hardly any horizontal motion
    it.run_until(lambda: it.autopilot.landed, within_s=60.0)


@pytest.mark.parametrize(
    ("mask", "echo"), [(0xDF8, 0xDF8), (0xDC0, 0xC00), (0xDC7, 0xC07), (0xFFF, 0xC07)]
)
def test_the_echo_says_which_groups_it_steers_for(hovering: Any, mask: int, echo: int) -> None:
    hovering.setpoint(HERE, (1.0, 0.0, 0.0), mask=mask)
    assert hovering.target().type_mask == echo


def test_nan_in_what_is_ignored_is_harmless(hovering: Any) -> None:
    nan = math.nan
    hovering.setpoint(
        (10.0, 0.0, -100.0), (nan, nan, nan), mask=0xDF8, frame=1, is_global=False, yaw_rad=nan
    )
    assert echoed(hovering)[0] == pytest.approx((10.0, 0.0, -100.0), abs=1e-6)


@pytest.mark.parametrize("position", [(91.0, 8.0, 100.0), (47.0, 181.0, 100.0)])
def test_a_place_off_the_globe_stops(hovering: Any, position: tuple[float, ...]) -> None:
    hovering.setpoint(position, (1.0, 0.0, 0.0))
    assert echoed(hovering) == STOPPED


def test_too_fast_stops_and_merely_fast_is_taken(hovering: Any) -> None:
    hovering.setpoint(HERE, (1001.0, 0.0, 0.0))
    assert echoed(hovering) == STOPPED
    hovering.setpoint(HERE, (200.0, 0.0, 0.0))
    assert echoed(hovering)[1] == (200.0, 0.0, 0.0)


def test_the_echo_is_ardupilots_flat_earth_about_the_origin(hovering: Any) -> None:
    latitude_deg, longitude_deg = 47.5, 8.6
    hovering.setpoint((latitude_deg, longitude_deg, 150.0))
    scale = 0.011131884502145034  # metres for each 1e-7 degree, from ArduPilot's Location.cpp
    north = (latitude_deg - 47.0) * 1e7 * scale
    east = (longitude_deg - 8.0) * 1e7 * scale * math.cos(math.radians((latitude_deg + 47.0) / 2))
    assert echoed(hovering)[0] == pytest.approx((north, east, -150.0), abs=1e-3)


def test_acceleration_is_honoured_in_local_frames_and_dropped_in_global_ones(hovering: Any) -> None:
    acceleration = (0.5, 0.0, 0.0)
    hovering.setpoint(HERE, mask=0xC00, acceleration_ned_m_s2=acceleration)
    assert hovering.target().acceleration_ned_m_s2 == (0.0, 0.0, 0.0)
    hovering.setpoint(
        (0.0, 0.0, -100.0), mask=0xC00, frame=1, is_global=False, acceleration_ned_m_s2=acceleration
    )
    assert hovering.target().acceleration_ned_m_s2 == acceleration
