"""MAVSDK-Python against the PX4 personality: the present package, and the last that spoke gRPC."""

import json
from typing import Any

import pytest
from processes import HOME, away_m, height_m, place
from programs import free_port

from vehicle_sim.autopilot.px4copter import FIRMWARE
from vehicle_sim.parameters import Kind

OLDER = pytest.param("mavsdk-3", marks=pytest.mark.nightly)


@pytest.mark.parametrize("environment", ["mavsdk", OLDER])
def test_it_reads_loads_and_flies_by_commands_missions_and_setpoints(
    environment: str, fly: Any, client: Any
) -> None:
    port = free_port()
    url = f"udpin://127.0.0.1:{port}"
    other = client(environment, "mavsdk_session.py", url, free_port())
    vehicle = fly("--autopilot", "px4", "--connect", f"udpout:127.0.0.1:{port}", speedup=10)
    assert other.wait(90.0) == 0, other.transcript
    found = json.loads(other.transcript.splitlines()[-1])
    whole = sum(row.kind is not Kind.REAL32 for row in FIRMWARE.table)
    about = {
        "home": [*HOME],
        "attitude, Hz": 20.0,
        "took off, m": 10.0,
        "up, m": 15.0,
        "velocity, m/s": [4.0, 1.0],
    }
    refused = {
        "float as whole": "WRONG_TYPE",
        "no such": "",
        "without a setpoint": "NO_SETPOINT_SET",
    }
    for name, value in about.items():
        assert found.pop(name) == pytest.approx(value, rel=0.2), name
    for name, words in refused.items():
        assert words in (said := found.pop(name)), name
        assert said
    assert found == {
        "version": [1, 17, 0],
        "parameters": [whole, len(FIRMWARE.table) - whole],
        "float": 2.5,
        "float then": 12.5,
        "whole": 0,
        "whole then": 5,
        "fence": [4, 25.0],
        "fence then": [],
        "return, m": 20.0,
        "mission, m": [15.0, 20.0, 15.0],
        "mission": [3, True],
        "offboard": True,
        "modes": ["TAKEOFF", "HOLD", "MISSION", "OFFBOARD", "HOLD", "RETURN_TO_LAUNCH"],
    }
    landed = vehicle.wait_until(lambda now: now["landed"] and not now["armed"])
    assert away_m(landed, *place(0.0, 0.0)) < 1.0
    flown = vehicle.track()
    for north_deg in (2e-4, 5e-4):
        assert min(away_m(row, HOME[0] + north_deg, HOME[1]) for row in flown) < 3.0
    assert max(map(height_m, flown)) < 25.0
