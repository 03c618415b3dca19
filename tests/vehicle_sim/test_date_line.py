"""Nothing changes where longitude goes from 180 to -180 degrees: a flight is the same anywhere."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from harness import VEHICLES, Flown, heartbeat
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot import px4copter
from vehicle_sim.autopilot.earth import FlatEarth, way_m
from vehicle_sim.autopilot.estimator import Estimator
from vehicle_sim.autopilot.values import Place
from vehicle_sim.dynamics.copter import Copter, Limits
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.sensors.gps import Fix

START_DEG = 179.9992
"""61 m before it."""


def around_deg(longitude_deg: float) -> float:
    return (longitude_deg + 180.0) % 360.0 - 180.0


def fence(longitude_deg: float, east_deg: float) -> tuple[PlanItem, ...]:
    """An inclusion zone about the start, so far to the east."""
    corners = ((46.99, -0.002), (47.01, -0.002), (47.01, east_deg), (46.99, east_deg))
    return tuple(
        PlanItem(
            frame=0,
            command=5001,
            parameters=(4.0, 0.0, 0.0, 0.0),
            x=round(latitude_deg * 1e7),
            y=round(around_deg(longitude_deg + east) * 1e7),
        )
        for latitude_deg, east in corners
    )


Row = tuple[float, float, float, str]


def flight(kind: str, autopilot: str, longitude_deg: float) -> tuple[Sequence[Row], Sequence[int]]:
    """Over the line to the east within a fence, into its edge, and what that makes it do."""
    on = (
        {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 4.0} if autopilot == "ardupilot" else {"GF_ACTION": 3.0}
    )
    flown = Flown(kind, autopilot, parameters=on, longitude_deg=longitude_deg, heading_deg=90.0)
    simulation = flown.simulation
    simulation.plans[PlanKind.FENCE] = fence(longitude_deg, 0.002)
    flown.send(heartbeat())
    for message in (24, 33):
        flown.order(511, message, 500_000)
    flown.into_the_air(12.0)
    for k in range(2800):
        if kind == "copter" and k % 20 == 0:
            flown.go(0.0, 0.0, 8.0, at_m=(0.0, 0.08 * k, -12.0))
        if k == 100:
            simulation.add_fault("ground_fence 5 m 9000 m ahead")  # so all of it is read again
        simulation.step()
    parser = mavlink.MAVLink(None)
    said = parser.parse_buffer(b"".join(frame for _, frame in simulation.take_frames())) or []
    places = [m.lon for m in said if m.get_type() in ("GLOBAL_POSITION_INT", "GPS_RAW_INT")]
    rows = [
        (row["north_m"], row["east_m"], row["altitude_amsl_m"], row["mode"])
        for row in flown.truth()
    ]
    return rows, places


@pytest.mark.parametrize(("kind", "autopilot"), VEHICLES)
def test_a_flight_over_the_date_line_is_that_over_any_other_meridian(
    kind: str, autopilot: str
) -> None:
    here, _ = flight(kind, autopilot, START_DEG - 170.0)
    there, places = flight(kind, autopilot, START_DEG)
    assert max(row[1] for row in here) > 150.0  # over the line and the fence's edge
    assert {row[3] for row in here} & {"RTL", "Return"}
    for (*one, mode), (*other, as_mode) in zip(here, there, strict=True):
        assert mode == as_mode
        assert one == pytest.approx(other, abs=0.05)
    assert {lon > 0 for lon in places} == {True, False}
    assert max(map(abs, places)) <= 1_800_000_000


def test_the_flat_earth_has_no_seam() -> None:
    west, east = Place(47.0, 179.9999, 0.0), Place(47.0, -179.9999, 0.0)
    same = way_m(Place(47.0, 8.0, 0.0), Place(47.0, 8.0002, 0.0))
    assert way_m(west, east) == pytest.approx(same, rel=1e-6)
    assert (same.real, same.imag > 0.0) == (0.0, True)
    assert FlatEarth(west).place(0.0, same.imag, 0.0).longitude_deg == pytest.approx(-179.9999)


def test_a_receiver_whose_noise_crosses_the_line_is_believed() -> None:
    limits = Limits(
        speed_m_s=10.0,
        acceleration_m_s2=5.0,
        speed_vertical_m_s=5.0,
        acceleration_vertical_m_s2=5.0,
    )
    copter = Copter(
        latitude_deg=47.0, longitude_deg=179.9999999, altitude_amsl_m=400.0, limits=limits
    )
    ekf = Estimator(copter, px4copter.FIRMWARE.timing, np.random.default_rng(1))
    for k in range(1, 1000):
        aside_deg = 2e-6 if k // 13 % 2 else -2e-6
        fix = Fix(
            time_us=k // 13 * 130_000,
            fix_type=3,
            latitude_deg=47.0,
            longitude_deg=around_deg(180.0 + aside_deg),
            altitude_amsl_m=400.0,
        )
        ekf.step(k * 0.01, 0.01, fix)
        ekf.follow()
        assert abs(ekf.estimate.longitude_deg) <= 180.0
        if ekf.estimate.position_ok and math.isfinite(ekf.estimate.horizontal_variance):
            assert ekf.estimate.horizontal_variance < 1.0
    assert ekf.estimate.position_ok
    assert abs(around_deg(ekf.estimate.longitude_deg - 180.0)) < 1e-3
