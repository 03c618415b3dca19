"""Every fault in a flying simulation: what a client sees of it, and that a seed repeats it all."""

import copy
import copyreg
import functools
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.faults.catalogue import FAULTS
from vehicle_sim.parameters import Firmware
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import VehicleKind, flat_world

copyreg.pickle(struct.Struct, lambda made: (struct.Struct, (made.format,)))  # to copy simulations

FloatArray = NDArray[np.float64]
HOME = (47.397742, 8.545594, 488.0)
METRES_PER_DEG = (111_191.0, 75_470.0)
STEP_US = 10_000
S = 1_000_000
RADAR = 100
STREAMS = {1: 5, 24: 10, 30: 10, 32: 10, 33: 10, 85: 10, 147: 5, 49: 1}
UNSEEN_M = -32768
STREAM_S = {"ardupilot": 57, "px4": 22}
"""When the setpoints begin: ArduPilot has no position before 42 s."""
FAULTS_S = {"ardupilot": 75, "px4": 40}


@dataclass(slots=True, kw_only=True)
class Client:
    """A ground station on link 1, and a companion on link 0 that flies by the clock."""

    firmware: Firmware
    kind: VehicleKind
    sequence: dict[tuple[int, int], int] = field(default_factory=dict)

    def frame(self, message: Any, component: int = 191, system: int = 1) -> bytes:
        packer = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        packer.seq = self.sequence.get((system, component), 0)
        self.sequence[system, component] = (packer.seq + 1) % 256
        return bytes(message.pack(packer))

    def command(self, number: int, *parameters: float) -> bytes:
        padded = [*parameters, *[0.0] * (7 - len(parameters))]
        return self.frame(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded))

    def position(self, now_us: int) -> tuple[float, float, float]:
        """North, east, down of the route: out and back in a wave, at some 5 m/s."""
        t = max(now_us / S - STREAM_S[self.firmware] - 13.0, 0.0)
        return 60.0 * np.sin(t / 12.0), 30.0 * np.sin(t / 6.0), -30.0

    def setpoint(self, now_us: int) -> bytes:
        if self.firmware == "ardupilot" and self.kind == "plane":
            north, east, _ = self.position(now_us)
            x = round((HOME[0] + 4.0 * north / METRES_PER_DEG[0]) * 1e7)
            y = round((HOME[1] + 4.0 * east / METRES_PER_DEG[1]) * 1e7)
            place = (x, y, 80.0)
            message = mavlink.MAVLink_command_int_message(1, 1, 3, 192, 0, 0, -1, 0, 60, 0, *place)
            return self.frame(message)
        here, soon = self.position(now_us), self.position(now_us + S)
        velocity = [b - a for a, b in zip(here, soon, strict=True)]
        return self.frame(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, 1, 0xDC0, *here, *velocity, 0, 0, 0, 0, 0
            )
        )

    def taking_off(self, second: int) -> list[bytes]:
        """What is sent once, at these whole seconds."""
        streams = [self.command(511, number, S / hz) for number, hz in STREAMS.items()]
        if self.firmware == "px4":
            offboard = self.command(176, 1, 6, 0)
            plan = {10: [self.command(22, 0, 0, 0, float("nan"), HOME[0] + 0.003, HOME[1], 540.0)]}
            plan |= {11: [self.command(400, 1)], 25: [offboard], 27: [offboard], 3: streams}
        elif self.kind == "plane":
            plan = {3: streams, 30: [self.command(176, 1, 13)], 31: [self.command(400, 1)]}
            plan |= {55: [self.command(176, 1, 15)]}
        else:
            plan = {3: streams, 45: [self.command(176, 1, 4)], 46: [self.command(400, 1)]}
            plan |= {47: [self.command(22, 0, 0, 0, 0, 0, 0, 30)]}
        return plan.get(second, [])

    def says(self, now_us: int) -> list[tuple[int, bytes]]:
        """Link and frame, at this step."""
        said = list[tuple[int, bytes]]()
        if now_us % S == 0:
            beat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
            ground = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
            said += [(0, self.frame(beat)), (1, self.frame(ground, 190, 255))]
            said += [(0, frame) for frame in self.taking_off(now_us // S)]
        if now_us % 200_000 == 0:
            south_west = (round((HOME[0] - 0.005) * 1e7), round((HOME[1] - 0.008) * 1e7))
            ask = mavlink.MAVLink_terrain_request_message(*south_west, 30, 0xF0F)
            said.append((0, self.frame(ask)))
            said.append((0, self.frame(mavlink.MAVLink_timesync_message(0, now_us * 1000))))
        slow = self.firmware == "ardupilot" and self.kind == "plane"
        if now_us >= STREAM_S[self.firmware] * S and now_us % (500_000 if slow else 100_000) == 0:
            said.append((0, self.setpoint(now_us)))
        return said


class Flight:
    """A simulation with its client, and all that came out of it."""

    def __init__(
        self, firmware: Firmware, kind: VehicleKind, *, seed: int, faults: str = ""
    ) -> None:
        world = flat_world(
            kind,
            firmware,
            latitude_deg=HOME[0],
            longitude_deg=HOME[1],
            altitude_amsl_m=HOME[2],
            heading_deg=0.0,
            scan_range_m=2000.0,
        )
        self.simulation = Simulation(world, seed=seed, links=2, faults=faults)
        self.client = Client(firmware=firmware, kind=kind)
        self.out: list[tuple[int, int, bytes]] = []
        """Vehicle time, link, frame."""
        self.truth: list[str] = []

    def until(self, time_s: float) -> None:
        simulation = self.simulation
        while simulation.now_us < time_s * S:
            simulation.step()
            now_us = simulation.now_us
            self.truth += simulation.take_truth()
            for link, frame in self.client.says(now_us):
                simulation.receive(link, frame)
            self.out += [(now_us, link, frame) for link, frame in simulation.take_frames()]


@functools.cache
def _airborne(firmware: Firmware, kind: VehicleKind) -> Flight:
    flight = Flight(firmware, kind, seed=1)
    flight.until(FAULTS_S[firmware] + 5.0)
    assert not flight.simulation.landed, flight.simulation.outcome()
    flight.out, flight.truth = [], []
    return flight


# --- the same seed, the same bytes ----------------------------------------------------------------

LINES = {
    "gps_off": "gps_off",
    "gps_glitch": "gps_glitch 50 m north 10 m up",
    "gps_drift": "gps_drift 2 m/s west",
    "gps_jam": "gps_jam",
    "gps_noise": "gps_noise 3 m",
    "gps_delay": "gps_delay 1000 ms",
    "gps_satellites": "gps_satellites 5",
    "wind": "wind 8 m/s from 270 deg turbulence 2",
    "turbulence": "turbulence 4 m/s",
    "battery": "battery 15 %",
    "battery_voltage": "battery_voltage 10.5 V",
    "link_off": "link_off",
    "link_loss": "link_loss 20 %",
    "link_delay": "link_delay 300 ms jitter 50 ms",
    "link_duplication": "link_duplication 20 %",
    "link_reordering": "link_reordering 20 %",
    "link_corruption": "link_corruption 20 %",
    "radar_off": "radar_off",
    "radar_blind": "radar_blind",
    "radar_drop": "radar_drop 30 %",
    "radar_loss": "radar_loss 50 %",
    "radar_noise": "radar_noise 5 m",
    "radar_delay": "radar_delay 450 ms",
    "radar_rate": "radar_rate 1 Hz",
    "setpoints_ignored": "setpoints_ignored",
    "estimator_reset": "estimator_reset 20 m north",
    "origin_move": "origin_move 20 m north 3 m up",
    "pilot": "pilot",
    "reboot": "reboot",
    "set": "set SIM_GPS1_ALT_OFS 30",
}


def whole_timeline(firmware: Firmware) -> str:
    """Every fault once, two seconds after one another, five seconds each; the reboot last."""
    lines, at = list[str](), FAULTS_S[firmware]
    for fault in sorted(FAULTS, key=lambda fault: fault.name == "reboot"):
        if fault.only in (None, firmware):
            length = "" if fault.once else " for 5 s"
            lines.append(f"at {at} s{length}: {LINES[fault.name]}")
            at += 2
    return "\n".join(lines)


def test_every_fault_is_flown() -> None:
    assert set(LINES) == {fault.name for fault in FAULTS}


@pytest.mark.parametrize(
    ("firmware", "kind"),
    [
        ("ardupilot", "copter"),
        ("px4", "plane"),
        pytest.param("ardupilot", "plane", marks=pytest.mark.nightly),
        pytest.param("px4", "copter", marks=pytest.mark.nightly),
    ],
)
def test_two_runs_with_every_fault_say_the_same_bytes(
    firmware: Firmware, kind: VehicleKind
) -> None:
    def flown(seed: int, lasting_s: float = 70.0) -> Flight:
        flight = Flight(firmware, kind, seed=seed, faults=whole_timeline(firmware))
        flight.until(FAULTS_S[firmware] + lasting_s)
        return flight

    first, again = flown(7), flown(7)
    assert first.out == again.out
    assert first.truth == again.truth
    assert len(first.out) > 5000
    other = flown(8, lasting_s=15.0)
    assert other.out != first.out[: len(other.out)]


# --- what a client sees of each -------------------------------------------------------------------


class Heard:
    """What came by link 0 in the seconds after a fault began."""

    def __init__(self, flight: Flight, since_us: int) -> None:
        self.since_us = since_us
        self.simulation = flight.simulation
        frames = [(time_us, frame) for time_us, link, frame in flight.out if link == 0]
        decoder = mavlink.MAVLink(None)
        self.messages: list[tuple[int, Any]] = []
        self.broken = 0
        self.numbers: list[int] = []
        """Of the autopilot's frames."""
        for time_us, frame in frames:
            try:
                message = decoder.decode(bytearray(frame))
            except mavlink.MAVError:
                self.broken += 1
                continue
            self.messages.append((time_us, message))
            if frame[6] == 1:
                self.numbers.append(frame[4])
        self.truth = flight.truth

    def of(self, kind: str, component: int = 1) -> list[Any]:
        return [message for _, message in self.timed(kind, component)]

    def timed(self, kind: str, component: int = 1) -> list[tuple[int, Any]]:
        return [
            (time_us, message)
            for time_us, message in self.messages
            if message.get_type() == kind and message.get_srcComponent() == component
        ]

    def gps_m(self) -> FloatArray:
        """North, east, up of home of each GPS_RAW_INT."""
        return np.array(
            [
                (
                    (m.lat / 1e7 - HOME[0]) * METRES_PER_DEG[0],
                    (m.lon / 1e7 - HOME[1]) * METRES_PER_DEG[1],
                    m.alt / 1e3 - HOME[2],
                )
                for m in self.of("GPS_RAW_INT")
            ]
        )

    def cells(self) -> NDArray[np.int64]:
        return np.array([m.data for m in self.of("TERRAIN_DATA", RADAR)], dtype=np.int64)


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
    late = [t / S - m.time_boot_ms / 1e3 for t, m in heard.timed("ATTITUDE")]
    return float(np.mean(late))


def _times_s(heard: Heard) -> list[float]:
    """Since boot, as the answers to TIMESYNC say."""
    return [m.tc1 * 1e-9 for m in heard.of("TIMESYNC") if m.tc1]


def _mode(heard: Heard) -> int:
    return int(heard.of("HEARTBEAT")[-1].custom_mode)


def _tilt(heard: Heard) -> FloatArray:
    return np.array([(m.roll, m.pitch) for m in heard.of("ATTITUDE")])


def _origin(heard: Heard) -> float:
    return float(heard.of("GPS_GLOBAL_ORIGIN")[-1].latitude) / 1e7


SEES: dict[str, Sees] = {
    "gps_off": lambda a, b: (
        min(m.fix_type for m in a.of("GPS_RAW_INT")) >= 3
        and b.of("GPS_RAW_INT")[-1].fix_type in (0, 1)
    ),
    "gps_glitch": lambda a, b: (b.gps_m() - a.gps_m())[8] == pytest.approx([50, 0, 10], abs=2.5),
    "gps_drift": lambda a, b: np.ptp((b.gps_m() - a.gps_m())[:30, 1]) > 2.0,
    "gps_jam": lambda _, b: {m.fix_type for m in b.of("GPS_RAW_INT")} & {0, 1},
    "gps_noise": lambda a, b: (b.gps_m() - a.gps_m())[:20].std() > 0.5,
    "gps_delay": lambda a, b: np.abs((b.gps_m() - a.gps_m())[5:20]).max() > 1.5,
    "gps_satellites": lambda _, b: b.of("GPS_RAW_INT")[-1].satellites_visible == 5,
    "wind": lambda a, b: np.abs(_tilt(b) - _tilt(a)).max() > 0.1,
    "turbulence": lambda a, b: np.abs(_tilt(b) - _tilt(a))[20:].std() > 0.02,
    "battery": lambda _, b: (  # PX4's gauge creeps up to it, and rounds up
        b.of("SYS_STATUS")[-1].battery_remaining in (14, 15, 16)
    ),
    "battery_voltage": lambda _, b: (
        b.of("SYS_STATUS")[-1].voltage_battery == pytest.approx(10_500, abs=50)
    ),
    "link_off": lambda a, b: a.messages and not b.messages,
    "link_loss": lambda a, b: _gaps(a) == 0.0 and 0.12 < _gaps(b) < 0.28,
    "link_delay": lambda a, b: _lag_s(b) - _lag_s(a) == pytest.approx(0.33, abs=0.02),
    "link_duplication": lambda a, b: (
        0.1 < np.mean(np.diff(b.numbers) == 0) < 0.3 > np.mean(np.diff(a.numbers) == 0)
    ),
    "link_reordering": lambda a, b: (
        np.mean(np.diff(b.numbers) % 256 > 128) > 0.05
        and np.mean(np.diff(a.numbers) % 256 > 128) == 0.0
    ),
    "link_corruption": lambda a, b: (
        a.broken == 0 and 0.1 < b.broken / (b.broken + len(b.messages)) < 0.3
    ),
    "radar_off": lambda a, b: (
        a.of("HEARTBEAT", RADAR)
        and not b.of("HEARTBEAT", RADAR)
        and not b.of("TERRAIN_REPORT", RADAR)
    ),
    "radar_blind": lambda a, b: set(b.cells().ravel()) == {UNSEEN_M} != set(a.cells().ravel()),
    "radar_drop": lambda _, b: 0.2 < np.mean(b.cells() == UNSEEN_M) < 0.4,
    "radar_loss": lambda a, b: (
        len(b.cells()) < 0.7 * len(a.cells())
        and len(b.of("TERRAIN_REPORT", RADAR)) == len(a.of("TERRAIN_REPORT", RADAR))
    ),
    "radar_noise": lambda a, b: b.cells().min() >= a.cells().min() and b.cells().std() > 1.0,
    "radar_delay": lambda a, b: (
        len(b.of("TERRAIN_REPORT", RADAR)) < 0.6 * len(a.of("TERRAIN_REPORT", RADAR))
    ),
    "radar_rate": lambda _, b: 5 <= len(b.of("TERRAIN_REPORT", RADAR)) <= 7,
    "setpoints_ignored": lambda a, b: (
        a.truth[-1] != b.truth[-1] and (_mode(a) == _mode(b)) == (_mode(a) < 1 << 16)
    ),  # PX4 leaves OFFBOARD, ArduPilot stays
    "estimator_reset": lambda a, b: _jump(a, b) == pytest.approx([20, 0, 0], abs=1.0),
    "origin_move": lambda a, b: (
        (_origin(b) - _origin(a)) * METRES_PER_DEG[0] == pytest.approx(20.0, abs=0.1)
        and _jump(a, b) == pytest.approx([-20, 0, 3], abs=1.0)
    ),
    "pilot": lambda a, b: _mode(a) != _mode(b),
    "reboot": lambda a, b: min(_times_s(a)) > 40.0 and min(_times_s(b)) < 10.0,
    "set": lambda a, b: (b.gps_m() - a.gps_m())[6, 2] == pytest.approx(30.0, abs=2.0),
}


def seen(firmware: Firmware, line: str, *, seconds: float = 6.0) -> Heard:
    flight = copy.deepcopy(_airborne(firmware, "copter"))
    since_us = flight.simulation.now_us
    if line:
        flight.simulation.add_fault(line)
    flight.until(since_us / S + seconds)
    return Heard(flight, since_us)


@functools.cache
def undisturbed(firmware: Firmware) -> Heard:
    return seen(firmware, "")


def test_without_a_fault_a_copied_flight_is_the_same_flight() -> None:
    assert seen("ardupilot", "").truth == undisturbed("ardupilot").truth


@pytest.mark.parametrize("name", LINES)
@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
def test_a_client_sees_the_fault(firmware: Firmware, name: str) -> None:
    fault = next(fault for fault in FAULTS if fault.name == name)
    if fault.only not in (None, firmware):
        return
    assert SEES[name](undisturbed(firmware), seen(firmware, LINES[name]))
