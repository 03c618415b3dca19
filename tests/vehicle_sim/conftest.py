"""Things that several of the simulator's tests need: a world, a pilot, a companion on UDP."""

import copy
import io
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.errors import SimulatorError
from vehicle_sim.links import Endpoint, open_link
from vehicle_sim.server import Server, Settings, Station, Stop
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import parse_world

ROOT = Path(__file__).parents[2]
ORIGIN_DEG = (47.0, 8.0)
METRES_PER_DEG_NORTH = 111_181.0  # of the meridian near 47 N: the tests stay within 1 km of it
WORLD: dict[str, Any] = {
    "schema": 1,
    "name": "test",
    "origin": {"latitude_deg": ORIGIN_DEG[0], "longitude_deg": ORIGIN_DEG[1]},
    "terrain": {
        "combine": "maximum",
        "ground_amsl_m": 100.0,
        "peaks": [
            {
                "north_m": 3000.0,
                "east_m": 4000.0,
                "height_amsl_m": 1200.0,
                "spread_north_m": 600.0,
                "spread_east_m": 800.0,
            }
        ],
    },
    "radars": [
        {
            "name": "radar 1",
            "north_m": 5e3,
            "east_m": 6e3,
            "altitude_amsl_m": 0.0,
            "range_m": 1e3,
        }
    ],
    "vehicle": {
        "kind": "copter",
        "autopilot": "ideal",
        "system_id": 1,
        "north_m": 0.0,
        "east_m": 0.0,
        "heading_deg": 45.0,
        "speed_max_m_s": 170.0,
        "acceleration_max_m_s2": 10.0,
        "speed_vertical_max_m_s": 25.0,
        "acceleration_vertical_max_m_s2": 5.0,
        "parameters": {"GUID_TIMEOUT": 3.0},
    },
    "scanner": {"component_id": 100, "range_m": 5000.0},
}


def as_toml(table: dict[str, Any], path: str = "") -> str:
    """A table as TOML; its nested tables after its values."""
    lines, later = [], []
    for key, value in table.items():
        name = f"{path}{key}"
        if isinstance(value, dict):
            later.append(f"[{name}]\n{as_toml(value, name + '.')}")
        elif isinstance(value, list):
            later += [f"[[{name}]]\n{as_toml(item, name + '.')}" for item in value]
        else:
            text = f'"{value}"' if isinstance(value, str) else str(value).lower()
            lines.append(f"{key} = {text}")
    return "\n".join([*lines, *later]) + "\n"


@pytest.fixture
def world_table() -> dict[str, Any]:
    """A world as TOML gives it, to be changed at will."""
    return copy.deepcopy(WORLD)


@pytest.fixture
def world_file(tmp_path: Path) -> Path:
    path = tmp_path / "world.toml"
    path.write_text(as_toml(WORLD), encoding="utf-8")
    return path


class Companion:
    """The other end of the link: a few frames on a real socket, and nothing of our own code."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(60.0)
        self.port = self.socket.getsockname()[1]
        self.mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=195)
        self.parser = mavlink.MAVLink(None)
        self.parser.robust_parsing = True
        self.address: Any = None

    def frame(self, message: Any) -> bytes:
        packed: bytes = message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) % 256
        return packed

    def command(self, number: int, *parameters: float) -> bytes:
        padded = [*parameters, *[0.0] * (7 - len(parameters))]
        return self.frame(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded))

    def heartbeat(self, status: int = 4) -> bytes:
        return self.frame(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, status, 3))

    def send(self, *frames: bytes) -> None:
        self.socket.sendto(b"".join(frames), self.address)

    def datagram(self) -> bytes:
        data, self.address = self.socket.recvfrom(65535)
        return data

    def messages(self) -> list[Any]:
        return self.parser.parse_buffer(self.datagram()) or []

    def tick(self, *frames: bytes) -> list[Any]:
        """Take one tick of lockstep and answer it, after these frames."""
        got: list[Any] = []
        while not got or got[-1].get_type() != "TIMESYNC":
            got += self.messages()
        asked = got[-1].ts1
        self.send(*frames, self.frame(mavlink.MAVLink_timesync_message(asked, asked)))
        return got

    def wait_for(self, kind: str, within_s: float = 10.0) -> Any:
        deadline_s = time.monotonic() + within_s
        while time.monotonic() < deadline_s:
            for message in self.messages():
                if message.get_type() == kind:
                    return message
        pytest.fail(f"no {kind} within {within_s} s")


@pytest.fixture
def companion() -> Iterator[Companion]:
    other = Companion()
    yield other
    other.socket.close()


Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start() -> Iterator[Start]:
    """Start vehicle-sim with these arguments; whatever still runs afterwards is killed."""
    running: list[subprocess.Popen[str]] = []

    def begin(*arguments: object, **keywords: Any) -> "subprocess.Popen[str]":
        process = subprocess.Popen(
            [sys.executable, "-m", "vehicle_sim.cli", *map(str, arguments)],
            **{"stdout": subprocess.PIPE, **keywords},
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        running.append(process)
        return process

    yield begin
    for process in running:
        if process.poll() is None:
            process.kill()
        process.communicate()


class Running:
    """A server in a thread of its own, and what became of it."""

    def __init__(self, table: dict[str, Any], port: int, **settings: Any) -> None:
        self.simulation = Simulation(parse_world(table), seed=1)
        self.stop = Stop()
        self.truth = io.StringIO()
        self.said: list[str] = []
        self.error: Exception | None = None
        self._endpoint = Endpoint(kind="udpout", host="127.0.0.1", port=port)
        self._settings = Settings(**settings)
        self.thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        link = open_link(self._endpoint)
        station = Station(simulation=self.simulation, links=[link], truth=self.truth)
        try:
            Server([station], self._settings, self.stop, say=self.said.append).run()
        except SimulatorError as error:
            self.error = error
        finally:
            link.close()

    def ended(self, within_s: float = 10.0) -> bool:
        self.thread.join(within_s)
        return not self.thread.is_alive()


Serve = Callable[..., Any]


@pytest.fixture
def serve(world_table: dict[str, Any]) -> Iterator[Serve]:
    running: list[Running] = []

    @contextmanager
    def begin(port: int, **settings: Any) -> Iterator[Running]:
        run = Running(world_table, port, **settings)
        running.append(run)
        run.thread.start()
        yield run

    yield begin
    for run in running:
        run.stop()
        assert run.ended(), "a server was left behind"
