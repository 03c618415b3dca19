"""Every fault in a flying simulation: what a client sees of it, and that a seed repeats it all."""

import functools
import itertools
import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from harness import GCS, KINDS, PLACE, QUIET, READY_S, Link, heartbeat, item, local, take_off
from harness import Heard as Frame
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.faults import FAULTS as ALL_FAULTS
from vehicle_sim.parameters import Firmware
from vehicle_sim.plans import PlanKind
from vehicle_sim.world import VehicleKind

FloatArray = NDArray[np.float64]
METRES_PER_DEG = (111_191.0, 75_470.0)
S = 1_000_000
RADAR = 100
STREAMS = {1: 5, 24: 10, 30: 10, 32: 10, 33: 10, 85: 10, 147: 5, 49: 1}
UNSEEN_M = -32768


class Flight(Link):
    """A ground station on link 1, and a companion on link 0 that flies out and back in a wave."""

    def __init__(
        self, firmware: Firmware, kind: VehicleKind, *, seed: int = 1, faults: str = ""
    ) -> None:
        super().__init__(
            kind, firmware, PLACE, links=2, scan_range_m=2000.0, seed=seed, faults=faults
        )
        self.heartbeats = (mavlink.MAV_TYPE_ONBOARD_CONTROLLER,)

    def setpoint(self, now_s: float) -> Any:
        if self.firmware == "ardupilot" and self.kind == "plane":
            north, east, _ = route(now_s)
            to = item(PLACE[:2], 192, 4.0 * north, 4.0 * east)
            where = (to.x, to.y, 80.0)
            return mavlink.MAVLink_command_int_message(1, 1, 3, 192, 0, 0, -1, 0, 60, 0, *where)
        here, soon = route(now_s), route(now_s + 1.0)
        return local(here, (soon[0] - here[0], soon[1] - here[1], 0.0))

    def ask(self) -> None:
        """What is asked of the radar and of the clock, five times a second."""
        tenth = math.floor(self.now_s * 10.0 + 1e-6)
        if tenth % 10 == 0:
            self.send(heartbeat(mavlink.MAV_TYPE_GCS), source=GCS, link=1)
        if tenth % 2 == 0:
            south_west = (round((PLACE[0] - 0.005) * 1e7), round((PLACE[1] - 0.008) * 1e7))
            self.send(mavlink.MAVLink_terrain_request_message(*south_west, 30, 0xF0F))
            self.send(mavlink.MAVLink_timesync_message(0, self.simulation.now_us * 1000))

    def fly(self, seconds: float) -> None:
        self.run(seconds, self.ask)

    def depart(self, seconds: float = 15.0) -> None:
        """Into the air, and on the way by setpoints for so long."""
        self.run(READY_S[self.firmware, self.kind] - 1.0)
        self.fly(1.0)
        for number, link in itertools.product(QUIET if self.firmware == "px4" else (), (0, 1)):
            self.command(511, number, -1, link=link)
        for number, hz in STREAMS.items():
            self.command(511, number, S / hz)
        take_off(self)
        self.aim = self.setpoint
        self.rate_hz = 2.0 if (self.firmware, self.kind) == ("ardupilot", "plane") else 10.0
        self.fly(1.0)
        if self.firmware == "px4":
            self.command(176, 1, 6, 0)
        self.fly(seconds)
        assert not self.simulation.landed, self.simulation.outcome()


def route(now_s: float) -> tuple[float, float, float]:
    """North, east, down, at some 5 m/s."""
    return 60.0 * math.sin(now_s / 12.0), 30.0 * math.sin(now_s / 6.0), -30.0


# --- what a client sees of each -------------------------------------------------------------------


class Heard:
    """What came by link 0 in the seconds after a fault began."""

    def __init__(self, flight: Flight, since: int) -> None:
        self.broken = 0
        self.frames: list[Frame] = []
        for frame in flight.heard[since:]:
            try:
                if frame.link == 0 and frame.message is not None:
                    self.frames.append(frame)
            except mavlink.MAVError:
                self.broken += 1
        self.numbers = [frame.frame[4] for frame in self.frames if frame.source == (1, 1)]
        self.truth = list(flight.simulation.take_truth())
        self.fence = flight.simulation.plans[PlanKind.FENCE]

    def timed(self, kind: str, component: int = 1) -> list[Frame]:
        return [f for f in self.frames if f.kind == kind and f.source[1] == component]

    def of(self, kind: str, component: int = 1) -> list[Any]:
        return [frame.message for frame in self.timed(kind, component)]

    def gps_m(self) -> FloatArray:
        """North, east, up of home of each GPS_RAW_INT."""
        fixes = [(m.lat / 1e7, m.lon / 1e7, m.alt / 1e3) for m in self.of("GPS_RAW_INT")]
        return (np.array(fixes) - PLACE) * (*METRES_PER_DEG, 1.0)

    def cells(self) -> NDArray[np.int64]:
        return np.array([m.data for m in self.of("TERRAIN_DATA", RADAR)], dtype=np.int64)


FAULTS = [each for each in ALL_FAULTS if not each.name.startswith(("lidar_", "rangefinder_"))]
"""Those of near sensing are seen in test_lidar.py: these vehicles have no lidar."""
Sees = Callable[[Heard, Heard], object]
"""Without and with the fault: something true if it can be seen."""


def _jump(a: Heard, b: Heard) -> FloatArray:
    """How far apart both begin in the local frame: north, east, down."""
    first = [heard.of("LOCAL_POSITION_NED")[0] for heard in (a, b)]
    without, fault = ((m.x, m.y, m.z) for m in first)
    return np.array(fault) - np.array(without)


def _gaps(heard: Heard) -> float:
    """Share of the autopilot's numbers that are missing."""
    steps = np.diff(heard.numbers) % 256
    return float((steps - 1).sum() / steps.sum())


def _lag_s(heard: Heard) -> float:
    late = [f.at_s - f.message.time_boot_ms / 1e3 for f in heard.timed("ATTITUDE")]
    return float(np.mean(late))


def _times_s(heard: Heard) -> list[float]:
    """Since boot, as the answers to TIMESYNC say."""
    return [m.tc1 * 1e-9 for m in heard.of("TIMESYNC") if m.tc1]


def _mode(heard: Heard) -> int:
    return int(heard.of("HEARTBEAT")[-1].custom_mode)


def _tilt(heard: Heard) -> FloatArray:
    return np.array([(m.roll, m.pitch) for m in heard.of("ATTITUDE")])


def _ahead_m(heard: Heard) -> tuple[float, float]:
    """How far the first item of the fence lies ahead of where it was put, and aside of its way."""
    there, row = heard.fence[0], json.loads(heard.truth[0])
    north_m, east_m = METRES_PER_DEG
    place_m = complex(
        (there.x / 1e7 - row["lat_deg"]) * north_m, (there.y / 1e7 - row["lon_deg"]) * east_m
    )
    way = complex(row["velocity_north_m_s"], row["velocity_east_m_s"])
    along = place_m * way.conjugate() / abs(way)
    return along.real, along.imag


def _origin(heard: Heard) -> float:
    return float(heard.of("GPS_GLOBAL_ORIGIN")[-1].latitude) / 1e7


SEES: dict[str, Sees] = {
    "gps_off": lambda a, b: (
        min(m.fix_type for m in a.of("GPS_RAW_INT")) >= 3
        and b.of("GPS_RAW_INT")[-1].fix_type in (0, 1)
    ),
    "gps_glitch 50 m north 10 m up": lambda a, b: (
        (b.gps_m() - a.gps_m())[8] == pytest.approx([50, 0, 10], abs=2.5)
    ),
    "gps_drift 2 m/s west": lambda a, b: np.ptp((b.gps_m() - a.gps_m())[:30, 1]) > 2.0,
    "gps_jam": lambda _, b: {m.fix_type for m in b.of("GPS_RAW_INT")} & {0, 1},
    "gps_noise 3 m": lambda a, b: (b.gps_m() - a.gps_m())[:20].std() > 0.5,
    "gps_delay 1000 ms": lambda a, b: np.abs((b.gps_m() - a.gps_m())[5:20]).max() > 1.5,
    "gps_satellites 5": lambda _, b: b.of("GPS_RAW_INT")[-1].satellites_visible == 5,
    "wind 8 m/s from 270 deg turbulence 2": lambda a, b: np.abs(_tilt(b) - _tilt(a)).max() > 0.05,
    "turbulence 4 m/s": lambda a, b: np.abs(_tilt(b) - _tilt(a))[20:].std() > 0.02,
    "battery 15 %": lambda _, b: (  # PX4's gauge creeps up to it, and rounds up
        b.of("SYS_STATUS")[-1].battery_remaining in (14, 15, 16)
    ),
    "battery_voltage 10.5 V": lambda _, b: (
        b.of("SYS_STATUS")[-1].voltage_battery == pytest.approx(10_500, abs=50)
    ),
    "link_off": lambda a, b: a.frames and not b.frames,
    "link_loss 20 %": lambda a, b: _gaps(a) == 0.0 and 0.12 < _gaps(b) < 0.28,
    "link_delay 300 ms jitter 50 ms": lambda a, b: (
        _lag_s(b) - _lag_s(a) == pytest.approx(0.33, abs=0.02)
    ),
    "link_duplication 20 %": lambda a, b: (
        0.1 < np.mean(np.diff(b.numbers) == 0) < 0.3 > np.mean(np.diff(a.numbers) == 0)
    ),
    "link_reordering 20 %": lambda a, b: (
        np.mean(np.diff(b.numbers) % 256 > 128) > 0.05
        and np.mean(np.diff(a.numbers) % 256 > 128) == 0.0
    ),
    "link_corruption 20 %": lambda a, b: (
        a.broken == 0 and 0.1 < b.broken / (b.broken + len(b.frames)) < 0.3
    ),
    "radar_off": lambda a, b: (
        a.of("HEARTBEAT", RADAR)
        and not b.of("HEARTBEAT", RADAR)
        and not b.of("TERRAIN_REPORT", RADAR)
    ),
    "radar_blind": lambda a, b: set(b.cells().ravel()) == {UNSEEN_M} != set(a.cells().ravel()),
    "radar_drop 30 %": lambda _, b: 0.2 < np.mean(b.cells() == UNSEEN_M) < 0.4,
    "radar_loss 50 %": lambda a, b: (
        len(b.cells()) < 0.7 * len(a.cells())
        and len(b.of("TERRAIN_REPORT", RADAR)) == len(a.of("TERRAIN_REPORT", RADAR))
    ),
    "radar_noise 5 m": lambda a, b: b.cells().min() >= a.cells().min() and b.cells().std() > 1.0,
    "radar_delay 450 ms": lambda a, b: (
        len(b.of("TERRAIN_REPORT", RADAR)) < 0.6 * len(a.of("TERRAIN_REPORT", RADAR))
    ),
    "radar_rate 1 Hz": lambda _, b: 3 <= len(b.of("TERRAIN_REPORT", RADAR)) <= 5,
    "setpoints_ignored": lambda a, b: (
        a.truth[-1] != b.truth[-1] and (_mode(a) == _mode(b)) == (_mode(a) < 1 << 16)
    ),  # PX4 leaves OFFBOARD, ArduPilot stays
    "estimator_reset 20 m north": lambda a, b: _jump(a, b) == pytest.approx([20, 0, 0], abs=1.0),
    "origin_move 20 m north 3 m up": lambda a, b: (
        (_origin(b) - _origin(a)) * METRES_PER_DEG[0] == pytest.approx(20.0, abs=0.1)
        and _jump(a, b) == pytest.approx([-20, 0, 3], abs=1.0)
    ),
    "pilot": lambda a, b: _mode(a) != _mode(b),
    "reboot": lambda a, b: min(_times_s(a)) > 30.0 and min(_times_s(b)) < 10.0,
    "ground_command 176 1 2 to_autopilot": lambda a, b: _mode(a) != _mode(b),
    "ground_target 50 m north 20 m west": lambda a, b: (
        not a.of("COMMAND_INT", 190) and [m.command for m in b.of("COMMAND_INT", 190)] == [192]
    ),
    "ground_fence 20 m 60 m ahead": lambda a, b: (
        len(b.fence) == 1 > len(a.fence) and _ahead_m(b) == pytest.approx((60.0, 0.0), abs=3.0)
    ),
    "set SIM_GPS1_ALT_OFS 30": lambda a, b: (
        (b.gps_m() - a.gps_m())[6, 2] == pytest.approx(30.0, abs=2.0)
    ),
}
LINES = {line.split()[0]: line for line in SEES}


@functools.cache
def _airborne(firmware: Firmware) -> Flight:
    flight = Flight(firmware, "copter")
    flight.depart()
    flight.simulation.take_truth()
    return flight


@functools.cache
def seen(firmware: Firmware, line: str | None = None, *, seconds: float = 4.0) -> Heard:
    flight = _airborne(firmware).copy()
    since = len(flight.heard)
    if line is not None:
        flight.simulation.add_fault(line)
    flight.fly(seconds)
    return Heard(flight, since)


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
def test_without_a_fault_a_copied_flight_is_the_same_flight(firmware: Firmware) -> None:
    assert seen(firmware, seconds=4).truth == seen(firmware).truth


@pytest.mark.parametrize(
    ("firmware", "name"),
    [
        pytest.param(firmware, fault.name, marks=pytest.mark.nightly if turn else ())
        for begin, firmware in enumerate(("ardupilot", "px4"))
        for turn, fault in zip(itertools.cycle((begin, 1 - begin)), FAULTS, strict=False)
        if (fault.name, firmware) != ("battery_voltage", "px4")
    ],
)
def test_a_client_sees_the_fault(firmware: Firmware, name: str) -> None:
    assert SEES[LINES[name]](seen(firmware), seen(firmware, LINES[name]))


def test_a_command_of_the_ground_station_reaches_the_companion_with_its_parameters() -> None:
    heard = seen("ardupilot", "ground_command 193 1 2 3").of("COMMAND_LONG", 190)
    assert [(m.command, m.param1, m.param2, m.param3) for m in heard] == [(193, 1.0, 2.0, 3.0)]


# --- the same seed, the same bytes ----------------------------------------------------------------


def whole_timeline(firmware: Firmware) -> list[str]:
    """Every fault once, half a second after one another, three seconds each; the reboot last."""
    return [
        f"{'' if fault.once else 'for 3 s: '}{LINES[fault.name]}"
        for fault in sorted(FAULTS, key=lambda fault: fault.name == "reboot")
        if (fault.name, firmware) != ("battery_voltage", "px4")
    ]


def test_every_fault_is_flown() -> None:
    assert set(LINES) == {fault.name for fault in FAULTS}


@pytest.mark.parametrize(
    ("firmware", "kind"),
    [
        *(pytest.param(*kind, marks=pytest.mark.nightly) for kind in KINDS[:3]),
        KINDS[3],
    ],
)
def test_two_runs_with_every_fault_say_the_same_bytes(
    firmware: Firmware, kind: VehicleKind
) -> None:
    def flown(seed: int) -> tuple[list[tuple[float, int, bytes]], list[str]]:
        flight = Flight(firmware, kind, seed=seed)
        flight.depart(1.0)
        for line in whole_timeline(firmware):
            flight.simulation.add_fault(line)
            flight.fly(0.5)
        out = [(frame.at_s, frame.link, frame.frame) for frame in flight.heard]
        return out, list(flight.simulation.take_truth())

    first, again = flown(7), flown(7)
    assert first == again
    assert len(first[0]) > 3000


def test_another_seed_is_another_vehicle() -> None:
    heard = []
    for seed in (7, 8):
        flight = Flight("ardupilot", "copter", seed=seed, faults="at 0 s: link_corruption 20 %")
        heard.append([frame.frame for frame in flight.run(20.0)])
    assert heard[0] != heard[1]
