"""The vehicle without its socket: streams, ticks, scans, and the same bytes every time."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from clients import Client
from harness import Flown
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.rng import generator
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import parse_world

Table = dict[str, Any]


class Other(Client):
    """A companion in memory."""

    def __init__(self, table: Table, seed: int = 0) -> None:
        self.simulation = Simulation(parse_world(table), seed=seed)
        self.mav, self.parser = mavlink.MAVLink(None, 1, 195), mavlink.MAVLink(None)

    def send(self, *frames: bytes) -> None:
        self.simulation.receive(0, b"".join(frames))

    def datagram(self) -> bytes:
        return b"".join(frame for _, frame in self.simulation.take_frames())

    def tick(self, *_: bytes) -> list[Any]:
        while not self.simulation.step():
            pass
        return self.messages()

    def run(self, ticks: int) -> list[Any]:
        return [message for _ in range(ticks) for message in self.tick()]


@pytest.fixture
def other(world_table: Table) -> Other:
    return Other(world_table)


def kinds(messages: list[Any]) -> list[str]:
    return [message.get_type() for message in messages]


def test_unasked_there_are_only_heartbeats_of_both_components(other: Other) -> None:
    got = other.run(500)  # 50 s, through the whole boot: the origin is sent once by itself
    beats = [m for m in got if m.get_type() == "HEARTBEAT"]
    for component in (1, 100):
        assert sum(m.get_srcComponent() == component for m in beats) == 50
    assert {m.autopilot for m in beats if m.get_srcComponent() == 100} == {8}
    others = set(kinds(got)) - {"HEARTBEAT", "PARAM_VALUE"}  # parameters that it sets by itself
    assert others == {"GPS_GLOBAL_ORIGIN", "HOME_POSITION", "TIMESYNC"}


def test_a_tick_is_one_position_period(other: Other) -> None:
    assert other.simulation.now_us == 0
    other.tick()
    assert other.simulation.now_us == 100_000
    other.send(other.command(511, 33, 50_000))
    got = other.tick()
    assert other.simulation.now_us == 150_000
    assert kinds(got) == ["COMMAND_ACK", "GLOBAL_POSITION_INT"]
    assert got[-1].time_boot_ms == 150
    other.tick()
    assert other.simulation.now_us == 200_000


def test_only_the_companion_that_was_heard_first_ends_the_run(other: Other) -> None:
    other.send(other.heartbeat())
    gcs = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    other.simulation.receive(0, mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 7, 3).pack(gcs))
    assert not other.simulation.companion_ended
    other.send(other.heartbeat(7))
    assert other.simulation.companion_ended


def test_the_truth_is_a_header_and_ten_lines_a_second(world_table: Table) -> None:
    other = Other(world_table, 3)
    other.run(430)
    for command in ((176, 1, 4), (400, 1), (22, 0, 0, 0, 0, 0, 0, 30)):
        other.send(other.command(*command))
    other.run(170)
    header, *rows = map(json.loads, other.simulation.take_truth())
    assert (header["world"], header["seed"], header["schema"]) == ("test", 3, 1)
    assert [row["t_s"] for row in rows] == pytest.approx(np.arange(601) / 10)
    assert set(rows[0]) == {
        *("t_s", "north_m", "east_m", "altitude_amsl_m", "lat_deg", "lon_deg"),
        *("velocity_north_m_s", "velocity_east_m_s", "velocity_up_m_s"),
        *("mode", "armed", "landed"),
    }
    assert (rows[0]["mode"], rows[0]["armed"], rows[0]["landed"]) == ("STABILIZE", False, True)
    assert (rows[-1]["mode"], rows[-1]["armed"], rows[-1]["landed"]) == ("GUIDED", True, False)
    assert rows[0]["altitude_amsl_m"] == 100.0
    speeds = np.diff([row["altitude_amsl_m"] for row in rows]) / 0.1
    assert speeds == pytest.approx([row["velocity_up_m_s"] for row in rows[1:]], abs=0.3)


def test_the_purposes_of_chance_do_not_share_numbers() -> None:
    draws: Callable[[int, str], list[float]] = lambda seed, purpose: list(  # noqa: E731
        generator(seed, purpose).random(4)
    )
    assert draws(1, "gps") == draws(1, "gps")
    assert draws(1, "gps") != draws(1, "wind")
    assert draws(1, "gps") != draws(2, "gps")


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_reboot_is_the_autopilots_alone(autopilot: str) -> None:
    """Radar and lidar have their own power, and who has no autopilot is not armed."""
    lidar: Table = {}
    if autopilot == "px4":  # ArduPilot boots for 42 s
        lidar = {"lidar": {"range_m": 20.0, "rate_hz": 5.0, "component_id": 196}}
    flown = Flown(
        "copter",
        autopilot,
        scanner={"range_m": 500.0, "component_id": 100},
        **lidar,
    )
    simulation, parser = flown.simulation, mavlink.MAVLink(None)
    flown.into_the_air(4.0)
    assert simulation.armed
    simulation.take_frames()
    simulation.take_truth()
    simulation.add_fault("reboot")
    ask = mavlink.MAVLink_terrain_request_message(470000000, 80000000, 100, 1)
    heard: list[Any] = []
    for k in range(120):
        if k == 20:
            flown.send(ask)
        simulation.step()
        frames = [frame for _, frame in simulation.take_frames()]
        if 10 <= k < 100:  # the autopilot is down for 1.1 s
            heard += parser.parse_buffer(b"".join(frames)) or []
            assert not simulation.armed
            assert not simulation.armable
    assert {m.get_srcComponent() for m in heard} == ({100, 196} if lidar else {100})
    said = kinds(heard)
    assert 3 <= said.count("OBSTACLE_DISTANCE") <= 5 or not lidar
    assert {"TERRAIN_DATA", "TERRAIN_REPORT", "HEARTBEAT"} <= set(said)
    rows = [json.loads(line) for line in simulation.take_truth()]
    assert not any(row["armed"] for row in rows[1:])
    assert [row["landed"] for row in rows[1:]] == sorted(row["landed"] for row in rows[1:])
    assert rows[-1]["landed"]
    assert "crash" in rows[-1]  # 4 m deep: 8.9 m/s


@pytest.mark.parametrize(("autopilot", "first_s"), [("ardupilot", 0.9), ("px4", 1.6)])
@pytest.mark.parametrize("kind", ["copter", "plane"])
def test_who_waits_for_a_heartbeat_and_then_asks_gets_what_it_asked_for(
    world_table: Table, kind: str, autopilot: str, first_s: float
) -> None:
    """At once, as most scripts do: after the start, after a reboot (ardupilot.md 1, px4.md 3)."""
    vehicle = {"kind": kind, "autopilot": autopilot, "north_m": 0.0, "east_m": 0.0}
    it = Other(world_table | {"vehicle": vehicle | {"heading_deg": 0.0}})
    simulation, began_s = it.simulation, 0.0
    for faults in ("reboot", ""):
        beats: list[tuple[float, int]] = []
        while not any(component == 1 for _, component in beats):
            simulation.step()
            beats += [
                (simulation.now_us * 1e-6, m.get_srcComponent())
                for m in it.messages()
                if m.get_type() == "HEARTBEAT"
            ]
        assert beats[-1][0] == pytest.approx(began_s + first_s, abs=0.011)
        if not began_s:  # of the radar's too none is within the 60 ms that forget
            assert beats[0][0] == pytest.approx(min(first_s, 1.0), abs=0.011)
        it.send(it.command(511, 30, 50_000))
        got: list[Any] = []
        for _ in range(100):
            simulation.step()
            got += it.messages()
        assert kinds(got).count("ATTITUDE") >= 19
        if faults:
            simulation.add_fault(faults)
            simulation.step()
            began_s = simulation.now_us * 1e-6 + 1.1
            for _ in range(110):
                simulation.step()
            it.messages()
