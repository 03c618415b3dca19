"""MAVSDK-Python against the PX4 personality: the present package, and the last that spoke gRPC."""

import json
from functools import partial
from typing import Any

import pytest
from processes import HOME, away_m, height_m, place
from programs import free_port

from vehicle_sim.autopilot.px4copter import FIRMWARE
from vehicle_sim.parameters import Kind

about = partial(pytest.approx, rel=0.2)
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
    assert "WRONG_TYPE" in found.pop("float as whole")
    assert found.pop("no such")
    assert "NO_SETPOINT_SET" in found.pop("without a setpoint")
    assert found == {
        "home": about([*HOME]),
        "attitude, Hz": about(20.0),
        "took off, m": about(10.0),
        "up, m": about(15.0),
        "velocity, m/s": about([4.0, 1.0]),
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
