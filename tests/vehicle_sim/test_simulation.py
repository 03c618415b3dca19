"""The vehicle without its socket: ticks, the truth, who ends a run, and what a reboot is not."""

import json
from typing import Any

import numpy as np
import pytest
from harness import Rig, heartbeat
from pymavlink.dialects.v20 import all as mavlink

DOWN_S = 1.1
"""The autopilot reboots for so long."""


RADAR = {"component_id": 100, "range_m": 5000.0}


def fresh(seed: int = 0) -> Rig:
    """With a radar, and a companion as the client."""
    return Rig("ideal", scanner=RADAR, seed=seed)


def tick(vehicle: Rig) -> list[str]:
    """What comes until a tick of lockstep is complete, by kind."""
    begun = len(vehicle.heard)
    while not vehicle.step():
        pass
    return [heard.kind for heard in vehicle.heard[begun:]]


def test_a_tick_is_one_position_period() -> None:
    vehicle = fresh()
    tick(vehicle)
    assert vehicle.simulation.now_us == 100_000
    assert vehicle.command(511, 33, 50_000) == 0
    assert tick(vehicle) == ["GLOBAL_POSITION_INT"]
    assert vehicle.last("GLOBAL_POSITION_INT").time_boot_ms == 150
    tick(vehicle)
    assert vehicle.simulation.now_us == 200_000


def test_only_the_companion_that_was_heard_first_ends_the_run() -> None:
    vehicle = fresh()
    vehicle.send(heartbeat())
    for source, ended in (((255, 190), False), (vehicle.source, True)):
        vehicle.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 7, 3), source=source)
        assert vehicle.simulation.companion_ended is ended


def test_the_truth_is_a_header_and_ten_lines_a_second() -> None:
    vehicle = fresh(seed=3)
    vehicle.climb(10.0).run(60.0 - vehicle.now_s)
    header, *rows = map(json.loads, vehicle.simulation.take_truth())
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
        beats = vehicle.all("HEARTBEAT")
        assert beats[-1].at_s == pytest.approx(began_s + first_s, abs=0.011)
        if not began_s:  # of the radar's too none is within the 60 ms that forget
            assert beats[0].at_s == pytest.approx(min(first_s, 1.0), abs=0.011)
        assert vehicle.command(511, 30, 50_000) == 0
        assert len(vehicle.run(1.0).all("ATTITUDE")) >= 19
