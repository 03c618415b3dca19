"""The vehicle without its socket: who ends a run, its truth, reboots, and what has warmed up."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from harness import Rig, heartbeat
from programs import ROOT
from pymavlink.dialects.v20 import all as mavlink

DOWN_S = 1.1
"""The autopilot reboots for so long."""
RADAR = {"component_id": 100, "range_m": 5000.0}


def test_only_the_companion_that_was_heard_first_ends_the_run() -> None:
    vehicle = Rig("ideal")
    vehicle.send(heartbeat())
    for source, ended in (((255, 190), False), (vehicle.source, True)):
        vehicle.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 7, 3), source=source)
        assert vehicle.simulation.companion_ended is ended


def test_the_truth_is_a_header_and_ten_lines_a_second() -> None:
    vehicle = Rig("ideal", seed=3).climb(10.0)
    header, *rows = map(json.loads, vehicle.run(60.0 - vehicle.now_s).simulation.take_truth())
    assert (header["world"], header["seed"], header["schema"]) == ("flat", 3, 1)
    assert [row["t_s"] for row in rows] == pytest.approx(np.arange(601) / 10)
    assert set(rows[0]) == {
        *("t_s", "north_m", "east_m", "altitude_amsl_m", "lat_deg", "lon_deg"),
        *("velocity_north_m_s", "velocity_east_m_s", "velocity_up_m_s"),
        *("mode", "armed", "landed"),
    }
    assert (rows[0]["mode"], rows[0]["armed"], rows[0]["landed"]) == ("STABILIZE", False, True)
    assert (rows[-1]["mode"], rows[-1]["armed"], rows[-1]["landed"]) == ("GUIDED", True, False)
    assert rows[0]["altitude_amsl_m"] == vehicle.home[2]
    speeds = np.diff([row["altitude_amsl_m"] for row in rows]) / 0.1
    assert speeds == pytest.approx([row["velocity_up_m_s"] for row in rows[1:]], abs=0.3)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_reboot_is_the_autopilots_alone(autopilot: str) -> None:
    """Radar and lidar have their own power, and who has no autopilot is not armed and falls."""
    lidar: dict[str, Any] = {}
    if autopilot == "px4":  # ArduPilot boots for 42 s
        lidar = {"lidar": {"range_m": 20.0, "rate_hz": 5.0, "component_id": 196}}
    flown = Rig(autopilot, scanner=RADAR, **lidar).climb(4.0)
    simulation = flown.simulation
    flown.truth()
    flown.fault("reboot")
    flown.run(0.1).heard.clear()
    south_west = (round(1e7 * at) for at in flown.home[:2])
    flown.send(mavlink.MAVLink_terrain_request_message(*south_west, 100, 1))
    for _ in range(90):
        flown.step()
        assert (simulation.armed, simulation.armable) == (False, False)
    assert {heard.source[1] for heard in flown.heard} == ({100, 196} if lidar else {100})
    assert 3 <= len(flown.all("OBSTACLE_DISTANCE")) <= 5 or not lidar
    assert {"TERRAIN_DATA", "TERRAIN_REPORT", "HEARTBEAT"} <= {each.kind for each in flown.heard}
    flown.run(0.2)
    rows = flown.truth()
    landed = [row["landed"] for row in rows]
    assert not any(row["armed"] for row in rows)
    assert landed == sorted(landed)
    assert landed[-1]
    assert "crash" in rows[-1]  # 4 m deep: 8.9 m/s


@pytest.mark.parametrize(("autopilot", "first_s"), [("ardupilot", 0.9), ("px4", 1.6)])
@pytest.mark.parametrize("kind", ["copter", "plane"])
def test_who_waits_for_a_heartbeat_and_then_asks_gets_what_it_asked_for(
    kind: Any, autopilot: str, first_s: float
) -> None:
    """At once, as most scripts do: after the start, after a reboot (ardupilot.md 1, px4.md 3)."""
    vehicle = Rig(autopilot, kind, scanner=RADAR)
    for began_s in (0.0, None):
        if began_s is None:
            vehicle.fault("reboot")
            vehicle.run(0.01)
            began_s = vehicle.now_s + DOWN_S
            vehicle.run(DOWN_S)
        vehicle.heard.clear()
        vehicle.until(lambda: any(h.source[1] == 1 for h in vehicle.all("HEARTBEAT")), 3.0)
        assert vehicle.all("HEARTBEAT")[-1].at_s == pytest.approx(began_s + first_s, abs=0.011)
        assert vehicle.command(511, 30, 50_000) == 0
        assert len(vehicle.run(1.0).all("ATTITUDE")) >= 19


_WARMED_UP = """
from pathlib import Path
from numba.core.event import install_recorder
from pymavlink.dialects.v20 import all as mavlink
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world

station = mavlink.MAVLink(None)
for name in ("street", "valley"):
    vehicle = Simulation(read_world(Path("companion/environments", name, "world.toml")))
    place = (round(1e7 * x) for x in (vehicle.vehicle.latitude_deg, vehicle.vehicle.longitude_deg))
    asked = station.terrain_request_encode(*place, 100, (1 << 56) - 1).pack(station)
    vehicle.warm_up()
    with install_recorder("numba:compile") as compiled:
        vehicle.receive(0, asked)
        for _ in range(120):
            vehicle.step()
    told = sum(frame[7:10] == b"\\x86\\0\\0" for _, frame in vehicle.take_frames())
    print(name, told, len(compiled.buffer))
"""


def test_what_has_warmed_up_compiles_nothing_in_flight_also_where_nothing_can_be_written(
    tmp_path: Path,
) -> None:
    """Silent for the seconds that it takes, a vehicle is given up: a first flight failed so."""
    nowhere = tmp_path / "no folder"
    nowhere.touch()
    cold = {**os.environ, "NUMBA_CACHE_DIR": str(nowhere)}
    asked = (sys.executable, "-c", _WARMED_UP)
    said = subprocess.run(asked, check=True, capture_output=True, text=True, env=cold, cwd=ROOT)
    assert said.stdout.split() == ["street", "0", "0", "valley", "56", "0"]
