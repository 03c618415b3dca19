"""Faults in a flying simulation: what a client sees of them, and that a seed repeats them all.

What each asks for is in test_faults.py, what a sensor or a link makes of it in the tests of these.
"""

import functools
import itertools
import json
import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from harness import GCS, KINDS, PLACE, QUIET, READY_S, Heard, Link, heartbeat, item, local, take_off
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.faults import FAULTS
from vehicle_sim.geodesy import FloatArray
from vehicle_sim.parameters import Firmware
from vehicle_sim.plans import PlanKind
from vehicle_sim.world import VehicleKind

NORTH_M, EAST_M = 111_191.0, 75_470.0
"""Of a degree."""
RADAR = 100
INTERVALS_US = {1: 200_000, 49: 1_000_000} | dict.fromkeys((24, 30, 32, 33, 85), 100_000)


class Flight(Link):
    """A ground station on link 1, and a companion on link 0 that flies out and back in a wave."""

    def __init__(self, firmware: Firmware, kind: VehicleKind, *, seed: int = 1) -> None:
        super().__init__(kind, firmware, PLACE, links=2, scan_range_m=2000.0, seed=seed)
        self.heartbeats = (mavlink.MAV_TYPE_ONBOARD_CONTROLLER,)
        self.is_arduplane = (firmware, kind) == ("ardupilot", "plane")

    def setpoint(self, now_s: float) -> Any:
        here, soon = route(now_s), route(now_s + 1.0)
        if self.is_arduplane:
            to = item(PLACE[:2], 192, 4.0 * here[0], 4.0 * here[1])
            where = (to.x, to.y, 80.0)
            return mavlink.MAVLink_command_int_message(1, 1, 3, 192, 0, 0, -1, 0, 60, 0, *where)
        return local(here, (soon[0] - here[0], soon[1] - here[1], 0.0))

    def fly(self, seconds: float) -> None:
        """With questions to the radar and about the clock, five times a second."""
        self.run(seconds, self._ask)

    def _ask(self) -> None:
        tenth = math.floor(self.now_s * 10.0 + 1e-6)
        if tenth % 10 == 0:
            self.send(heartbeat(mavlink.MAV_TYPE_GCS), source=GCS, link=1)
        if tenth % 2 == 0:
            south_west = (round((PLACE[0] - 0.005) * 1e7), round((PLACE[1] - 0.008) * 1e7))
            self.send(mavlink.MAVLink_terrain_request_message(*south_west, 30, 0xF0F))
            self.send(mavlink.MAVLink_timesync_message(0, self.simulation.now_us * 1000))

    def depart(self, seconds: float = 15.0) -> None:
        """Into the air, and on the way by setpoints for so long."""
        self.run(READY_S[self.firmware, self.kind] - 1.0)
        self.fly(1.0)
        for number, link in itertools.product(QUIET if self.firmware == "px4" else (), (0, 1)):
            self.command(511, number, -1, link=link)
        for number, interval_us in INTERVALS_US.items():
            self.command(511, number, interval_us)
        take_off(self)
        self.aim, self.rate_hz = self.setpoint, 2.0 if self.is_arduplane else 10.0
        self.fly(1.0)
        if self.firmware == "px4":
            self.command(176, 1, 6, 0)
        self.fly(seconds)
        assert not self.simulation.landed, self.simulation.outcome()


def route(now_s: float) -> tuple[float, float, float]:
    """North, east, down, at some 5 m/s."""
    return 60.0 * math.sin(now_s / 12.0), 30.0 * math.sin(now_s / 6.0), -30.0


class Seen:
    """What came by link 0 in the seconds after a fault began."""

    def __init__(self, flight: Flight, since: int) -> None:
        self.frames: list[Heard] = [heard for heard in flight.heard[since:] if heard.link == 0]
        numbers = [heard.frame[4] for heard in self.frames if heard.source == (1, 1)]
        self.steps = np.diff(numbers) % 256
        """Of the autopilot's sequence numbers."""
        self.truth = [json.loads(line) for line in flight.simulation.take_truth()]
        self.fence = flight.simulation.plans[PlanKind.FENCE]

    def of(self, kind: str, component: int = 1) -> list[Any]:
        return [f.message for f in self.frames if (f.kind, f.source[1]) == (kind, component)]

    def last(self, kind: str) -> Any:
        return self.of(kind)[-1]

    def gps_m(self) -> FloatArray:
        """North, east, up of home of each GPS_RAW_INT."""
        fixes = [(m.lat / 1e7, m.lon / 1e7, m.alt / 1e3) for m in self.of("GPS_RAW_INT")]
        return (np.array(fixes) - PLACE) * (NORTH_M, EAST_M, 1.0)

    def begins_m(self) -> FloatArray:
        """North, east, down in the local frame."""
        first = self.of("LOCAL_POSITION_NED")[0]
        return np.array((first.x, first.y, first.z))

    def booted_s(self) -> float:
        """Ago, as the answers to TIMESYNC say."""
        return min(m.tc1 * 1e-9 for m in self.of("TIMESYNC") if m.tc1)

    def mode(self) -> int:
        return int(self.last("HEARTBEAT").custom_mode)

    def tilt(self) -> FloatArray:
        return np.array([(m.roll, m.pitch) for m in self.of("ATTITUDE")])

    def fence_ahead_m(self) -> tuple[float, float]:
        """How far its first item lies ahead of where it was put, and aside of its way."""
        there, row = self.fence[0], self.truth[0]
        place_m = complex(
            (there.x / 1e7 - row["lat_deg"]) * NORTH_M, (there.y / 1e7 - row["lon_deg"]) * EAST_M
        )
        way = complex(row["velocity_north_m_s"], row["velocity_east_m_s"])
        along = place_m * way.conjugate() / abs(way)
        return along.real, along.imag


approx = pytest.approx
SEES: dict[str, Callable[[Seen, Seen], object]] = {
    # without and with the fault: something true if it can be seen
    "gps_glitch 50 m north 10 m up": lambda a, b: (
        (b.gps_m() - a.gps_m())[8] == approx([50, 0, 10], abs=2.5)
    ),
    "wind 8 m/s from 270 deg turbulence 2": lambda a, b: np.abs(b.tilt() - a.tilt()).max() > 0.05,
    # PX4's gauge creeps up to it, and rounds up
    "battery 15 %": lambda _, b: b.last("SYS_STATUS").battery_remaining in (14, 15, 16),
    "link_loss 20 %": lambda a, b: (
        set(a.steps) == {1} and 0.12 < 1.0 - len(b.steps) / b.steps.sum() < 0.28
    ),
    "radar_off": lambda a, b: (
        a.of("HEARTBEAT", RADAR)
        and a.of("TERRAIN_REPORT", RADAR)
        and not b.of("HEARTBEAT", RADAR)
        and not b.of("TERRAIN_REPORT", RADAR)
    ),
    "setpoints_ignored": lambda a, b: (
        a.truth[-1] != b.truth[-1] and (a.mode() == b.mode()) == (a.mode() < 1 << 16)
    ),  # PX4 leaves OFFBOARD, ArduPilot stays
    "estimator_reset 20 m north": lambda a, b: (
        b.begins_m() - a.begins_m() == approx([20, 0, 0], abs=1.0)
    ),
    "origin_move 20 m north 3 m up": lambda a, b: (
        [b.last("GPS_GLOBAL_ORIGIN").latitude - a.last("GPS_GLOBAL_ORIGIN").latitude]
        == approx([20.0 / NORTH_M * 1e7], abs=0.1 / NORTH_M * 1e7)
        and b.begins_m() - a.begins_m() == approx([-20, 0, 3], abs=1.0)
    ),
    "pilot": lambda a, b: a.mode() != b.mode(),
    "reboot": lambda a, b: a.booted_s() > 30.0 and b.booted_s() < 10.0,
    "ground_command 176 1 2 to_autopilot": lambda a, b: a.mode() != b.mode(),
    "ground_command 193 1 2 3": lambda _, b: (
        [(m.command, m.param1, m.param2, m.param3) for m in b.of("COMMAND_LONG", 190)]
        == [(193, 1.0, 2.0, 3.0)]
    ),
    "ground_target 50 m north 20 m west": lambda a, b: (
        not a.of("COMMAND_INT", 190) and [m.command for m in b.of("COMMAND_INT", 190)] == [192]
    ),
    "ground_fence 20 m 60 m ahead": lambda a, b: (
        len(b.fence) == 1 > len(a.fence) and b.fence_ahead_m() == approx((60.0, 0.0), abs=3.0)
    ),
}


@functools.cache
def _airborne(firmware: Firmware) -> Flight:
    flight = Flight(firmware, "copter")
    flight.depart()
    flight.simulation.take_truth()
    return flight


def flown(firmware: Firmware, line: str | None = None) -> Seen:
    flight = _airborne(firmware).copy()
    since = len(flight.heard)
    if line is not None:
        flight.simulation.add_fault(line)
    flight.fly(4.0)
    return Seen(flight, since)


without = functools.cache(flown)


@pytest.mark.parametrize(
    ("firmware", "line"),
    [
        pytest.param(firmware, line, marks=pytest.mark.nightly if turn else ())
        for begin, firmware in enumerate(("ardupilot", "px4"))
        for turn, line in zip(itertools.cycle((begin, 1 - begin)), SEES, strict=False)
    ],
)
def test_a_client_sees_the_fault(firmware: Firmware, line: str) -> None:
    assert SEES[line](without(firmware), flown(firmware, line))


OTHERS = """gps_off, gps_drift 2 m/s west, gps_jam, gps_noise 3 m, gps_delay 1000 ms
gps_satellites 5, turbulence 4 m/s, link_off, link_delay 300 ms jitter 50 ms, link_duplication 20 %
radar_blind, radar_drop 30 %, radar_loss 50 %, radar_noise 5 m, radar_delay 450 ms, radar_rate 1 Hz
"""
"""Those of near sensing are in test_lidar.py: these vehicles have no lidar."""


@pytest.mark.parametrize(
    ("firmware", "kind"),
    [*(pytest.param(*kind, marks=pytest.mark.nightly) for kind in KINDS[:3]), KINDS[3]],
)
def test_two_runs_with_every_fault_say_the_same_bytes(
    firmware: Firmware, kind: VehicleKind
) -> None:
    """Every fault, half a second after one another, three seconds each; the reboot last."""
    others = [*re.split(r"[,\n]\s*", OTHERS.strip()), "battery_voltage 10.5 V"]
    lines = sorted([*others[: None if firmware == "ardupilot" else -1], *SEES], key="reboot".__eq__)
    faults = {fault.name: fault for fault in FAULTS}

    def run() -> tuple[list[tuple[float, int, bytes]], list[str]]:
        flight = Flight(firmware, kind, seed=7)
        flight.depart(1.0)
        for line in lines:
            lasts = "" if faults[line.split()[0]].once else "for 3 s: "
            flight.simulation.add_fault(lasts + line)
            flight.fly(0.5)
        out = [(heard.at_s, heard.link, heard.frame) for heard in flight.heard]
        return out, list(flight.simulation.take_truth())

    first, again = run(), run()
    assert first == again
    assert len(first[0]) > 3000
