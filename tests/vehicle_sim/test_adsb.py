"""Scripted aircraft: what the autopilot says of them, against a position by hand."""

import math
from typing import Any

import pyproj
import pytest
from pymavlink.dialects.v20 import all as wire

from vehicle_sim.errors import InputError
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import parse_world

AIRCRAFT = {
    "icao_address": 0x4B1234,
    "callsign": "HB123",
    "north_m": 1000.0,
    "east_m": 0.0,
    "altitude_amsl_m": 900.0,
    "course_deg": 90.0,
    "speed_m_s": 40.0,
    "climb_m_s": 1.0,
}


def test_an_aircraft_is_told_of_once_a_second_by_the_autopilot(world_table: dict[str, Any]) -> None:
    world_table["traffic"] = [AIRCRAFT]
    simulation = Simulation(parse_world(world_table))
    codec, told = wire.MAVLink(None), []
    for _ in range(1000):
        simulation.step()
        for _, frame in simulation.take_frames():
            for message in codec.parse_buffer(frame) or ():
                if message.get_type() == "ADSB_VEHICLE":
                    told.append((simulation.now_us * 1e-6, message))
    assert len(told) == 10
    at_s, last = told[-1]
    assert (last.get_srcComponent(), last.callsign, last.ICAO_address) == (1, "HB123", 0x4B1234)
    origin = world_table["origin"]
    azimuth = math.degrees(math.atan2(40.0 * at_s, 1000.0))
    away_m = math.hypot(1000.0, 40.0 * at_s)
    longitude, latitude, _ = pyproj.Geod(ellps="WGS84").fwd(
        origin["longitude_deg"], origin["latitude_deg"], azimuth, away_m
    )
    assert (last.lat * 1e-7, last.lon * 1e-7) == pytest.approx((latitude, longitude), abs=2e-7)
    assert last.altitude == pytest.approx(900_000 + 1000 * at_s, abs=1)
    assert (last.heading, last.hor_velocity, last.ver_velocity) == (9000, 4000, 100)


def test_the_course_is_from_true_north_far_from_the_origin(world_table: dict[str, Any]) -> None:
    world_table["traffic"] = [AIRCRAFT | {"east_m": 100_000.0, "course_deg": 0.0}]
    simulation = Simulation(parse_world(world_table))
    codec, told = wire.MAVLink(None), []
    for _ in range(200):
        simulation.step()
        for _, frame in simulation.take_frames():
            told += [m for m in codec.parse_buffer(frame) or () if m.get_type() == "ADSB_VEHICLE"]
    first, last = told[0], told[-1]
    flown_deg, _, _ = pyproj.Geod(ellps="WGS84").inv(
        first.lon * 1e-7, first.lat * 1e-7, last.lon * 1e-7, last.lat * 1e-7
    )
    assert abs(math.remainder(first.heading * 0.01 - flown_deg, 360.0)) < 0.05
    assert abs(math.remainder(flown_deg, 360.0)) > 0.5


def test_an_aircraft_without_a_course_is_refused(world_table: dict[str, Any]) -> None:
    world_table["traffic"] = [{k: v for k, v in AIRCRAFT.items() if k != "course_deg"}]
    with pytest.raises(InputError, match=r"traffic\.0\.course_deg .*missing"):
        parse_world(world_table)
