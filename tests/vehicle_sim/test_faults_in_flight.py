"""Faults in a flying simulation: what a client sees of them, and that a seed repeats them all.

What each asks for is in test_faults.py, what a sensor or a link makes of it in the tests of these.
"""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from harness import GCS, KINDS, Rig, copied, flying, heartbeat, setpoint
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.faults import FAULTS
from vehicle_sim.geodesy import FloatArray, LocalFrame, metres_per_degree
from vehicle_sim.parameters import Firmware
from vehicle_sim.plans import PlanKind
from vehicle_sim.world import VehicleKind

approx = pytest.approx


@copied
def under_way(firmware: str) -> Rig:
    """Northwards by setpoints, at 5 m/s."""
    vehicle = flying(firmware, "copter")
    for number in (49, 32):
        vehicle.command(511, number, 100_000)
    vehicle.streamed = setpoint(None, (5.0, 0.0, 0.0))
    vehicle.run(1.0)
    if firmware == "px4":
        assert vehicle.set_mode("Offboard") == 0
    return vehicle.run(5.0)


def flown(firmware: Firmware, line: str | None = None) -> Rig:
    """Four seconds on, with a fault or without."""
    vehicle = under_way(firmware)
    vehicle.heard.clear()
    if line is not None:
        vehicle.fault(line)
    return vehicle.run(4.0)


without = functools.cache(flown)


def messages(it: Rig, kind: str, *source: int) -> list[Any]:
    return [each.message for each in it.all(kind) if each.source == (source or (1, 1))]


def begins_m(it: Rig) -> FloatArray:
    """North, east, down in the local frame."""
    first = messages(it, "LOCAL_POSITION_NED")[0]
    return np.array((first.x, first.y, first.z))


def fence_ahead_m(it: Rig) -> tuple[float, float]:
    """How far its first item lies to the north and east of where it was put."""
    here = under_way(it.firmware).vehicle
    frame = LocalFrame(latitude_deg=here.latitude_deg, longitude_deg=here.longitude_deg)
    (there,) = it.simulation.plans[PlanKind.FENCE]
    return frame.to_local(there.x / 1e7, there.y / 1e7)


def mode(it: Rig) -> int:
    return int(it.last("HEARTBEAT").custom_mode)


SEES: dict[str, Callable[[Rig, Rig], object]] = {
    # without and with the fault: something true if it can be seen
    "setpoints_ignored": lambda a, b: (
        a.simulation.vehicle.latitude_deg > b.simulation.vehicle.latitude_deg + 1e-6
        and (mode(a) == mode(b)) == (mode(a) < 1 << 16)
    ),  # PX4 leaves OFFBOARD, ArduPilot stays
    "estimator_reset 20 m north": lambda a, b: (
        begins_m(b) - begins_m(a) == approx([20, 0, 0], abs=1)
    ),
    "origin_move 20 m north 3 m up": lambda a, b: (
        begins_m(b) - begins_m(a) == approx([-20, 0, 3], abs=1.0)
        and [b.last("GPS_GLOBAL_ORIGIN").latitude - a.last("GPS_GLOBAL_ORIGIN").latitude]
        == approx([20.0 / metres_per_degree(47.0)[0] * 1e7], abs=10.0)
    ),
    "pilot": lambda a, b: mode(a) != mode(b),
    "ground_command 176 1 2 to_autopilot": lambda a, b: mode(a) != mode(b),
    "ground_command 193 1 2 3": lambda _, b: (
        [(m.command, m.param1, m.param2, m.param3) for m in messages(b, "COMMAND_LONG", *GCS)]
        == [(193, 1.0, 2.0, 3.0)]
    ),
    "ground_target 50 m north 20 m west": lambda a, b: (
        not a.all("COMMAND_INT") and [m.command for m in messages(b, "COMMAND_INT", *GCS)] == [192]
    ),
    "ground_fence 20 m 60 m ahead": lambda a, b: (
        not a.simulation.plans[PlanKind.FENCE] and fence_ahead_m(b) == approx((60.0, 0.0), abs=3.0)
    ),
}


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
@pytest.mark.parametrize("line", SEES)
def test_a_client_sees_the_fault(firmware: Firmware, line: str) -> None:
    assert SEES[line](without(firmware), flown(firmware, line))


OTHERS = (
    *("gps_off", "gps_glitch 50 m north 10 m up", "gps_drift 2 m/s west", "gps_jam"),
    *("gps_noise 3 m", "gps_delay 1000 ms", "gps_satellites 5", "turbulence 4 m/s", "battery 15 %"),
    *("wind 8 m/s from 270 deg turbulence 2", "link_off", "link_delay 300 ms jitter 50 ms"),
    *("link_loss 20 %", "link_duplication 20 %", "radar_blind", "radar_drop 30 %", "radar_off"),
    *("radar_loss 50 %", "radar_noise 5 m", "radar_delay 450 ms", "radar_rate 1 Hz", "reboot"),
)
"""Those of near sensing are in test_lidar.py: these vehicles have no lidar."""


@pytest.mark.sample(4)
@pytest.mark.parametrize(("firmware", "kind"), KINDS[::-1])
def test_two_runs_with_every_fault_say_the_same_bytes(
    firmware: Firmware, kind: VehicleKind
) -> None:
    """Every fault, half a second after one another, three seconds each; the reboot last."""
    once = {fault.name for fault in FAULTS if fault.once}

    def run() -> tuple[list[tuple[float, int, bytes]], list[str]]:
        radar = {"component_id": 100, "range_m": 2000.0}
        vehicle = Rig(firmware, kind, links=2, scanner=radar, seed=7)
        vehicle.source, vehicle.beat = GCS, heartbeat(mavlink.MAV_TYPE_GCS)
        vehicle.climb(30.0)
        for number in (1, 24, 30, 32, 33, 85, 147, 193):
            vehicle.command(511, number, 20_000)
        south_west = (
            round((at - off) * 1e7) for at, off in zip(vehicle.home, (5e-3, 8e-3), strict=False)
        )
        asked = mavlink.MAVLink_terrain_request_message(*south_west, 30, 0xF0F)
        for line in sorted([*OTHERS, *SEES], key="reboot".__eq__):
            vehicle.fault(("" if line.split()[0] in once else "for 3 s: ") + line)
            vehicle.send(asked)
            vehicle.run(0.5)
        assert vehicle.all("TERRAIN_DATA")
        out = [(heard.at_s, heard.link, heard.frame) for heard in vehicle.heard]
        return out, list(vehicle.simulation.take_truth())

    first, again = run(), run()
    assert first == again
    assert len(first[0]) > 3000
