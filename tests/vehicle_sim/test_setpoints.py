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


def test_an_acceleration_alone_is_flown_until_the_time_out(pilot: Make) -> None:
    it = pilot().airborne(100.0)
    for _ in range(30):
        it.setpoint(mask=0xC3F, frame=1, is_global=False, acceleration_ned_m_s2=(1.0, 0.0, 0.0))
        it.run(0.1)
    assert it.copter.velocity_north_m_s == pytest.approx(2.9, abs=0.4)
    assert it.target().type_mask == 0xC3F
    it.run(12.0)
    assert it.copter.velocity_north_m_s == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize(
    ("mask", "echo"), [(0xDF8, 0xDF8), (0xDC0, 0xC00), (0xDC7, 0xC07), (0xFFF, 0xC07)]
)
def test_the_echo_says_which_groups_it_steers_for(hovering: Any, mask: int, echo: int) -> None:
    hovering.setpoint(HERE, (1.0, 0.0, 0.0), mask=mask)
    assert hovering.target().type_mask == echo


@pytest.mark.parametrize("position", [(91.0, 8.0, 100.0), (47.0, 181.0, 100.0)])
def test_a_place_off_the_globe_stops(hovering: Any, position: tuple[float, ...]) -> None:
    hovering.setpoint(position, (1.0, 0.0, 0.0))
    assert echoed(hovering) == STOPPED


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
