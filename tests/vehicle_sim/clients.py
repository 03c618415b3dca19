"""Who is at the other end of a socket: a client of pymavlink's, a process, a server in a thread."""

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import pytest
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.errors import SimulatorError
from vehicle_sim.links import Link
from vehicle_sim.server import Server
from vehicle_sim.simulation import Simulation
from vehicle_sim.stations import Station, Stations
from vehicle_sim.world import parse_world

ROOT = Path(__file__).parents[2]


class Client:
    """The other end of a link: a few frames on a real socket, and nothing of our own code."""

    def __init__(self, link: socket.socket, ids: tuple[int, int] = (1, 195)) -> None:
        self.link, self.address = link, cast(Any, None)
        self.link.settimeout(20.0)
        self.mav, self.parser = mavlink.MAVLink(None, *ids), mavlink.MAVLink(None)
        self.parser.robust_parsing = True
        self.port = link.getsockname()[1]
        self.endpoint = f"udpout:127.0.0.1:{self.port}"

    def frame(self, message: Any) -> bytes:
        packed: bytes = message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) % 256
        return packed

    def command(self, number: int, *p: float, target: tuple[int, int] = (1, 1)) -> bytes:
        padded = [*p, *[0.0] * (7 - len(p))]
        return self.frame(mavlink.MAVLink_command_long_message(*target, number, 0, *padded))

    def heartbeat(self, status: int = 4) -> bytes:
        return self.frame(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, status, 3))

    def answer(self, question: Any) -> bytes:
        return self.frame(mavlink.MAVLink_timesync_message(question.ts1, question.ts1))

    def send(self, *frames: bytes) -> None:
        if self.address is None:
            self.link.sendall(b"".join(frames))
        else:
            self.link.sendto(b"".join(frames), self.address)

    def datagram(self) -> bytes:
        data, address = self.link.recvfrom(65535)
        self.address = self.address or address
        return data

    def messages(self) -> list[Any]:
        return self.parser.parse_buffer(self.datagram()) or []

    def begin(self, *frames: bytes) -> None:
        """Be found, and say so with a heartbeat."""
        self.datagram()
        self.send(self.heartbeat(), *frames)

    def tick(self, *frames: bytes) -> list[Any]:
        """Take one tick of lockstep and answer it, after these frames."""
        got: list[Any] = []
        while not (got and is_question(got[-1])):
            got += self.messages()
        self.send(*frames, self.answer(got[-1]))
        return got

    def wait_for(self, wanted: Callable[[Any], bool], within_s: float = 10.0) -> Any:
        """The first message for which this is so."""
        deadline_s = time.monotonic() + within_s
        while time.monotonic() < deadline_s:
            for message in filter(wanted, self.messages()):
                return message
        pytest.fail(f"it did not come within {within_s} s")


def is_question(message: Any) -> bool:
    """Of lockstep; an ArduPilot asks by itself too, each 10 s from 10 s on."""
    return bool(message.get_type() == "TIMESYNC" and message.tc1 == 0 and message.ts1)


@contextmanager
def udp_client(port: int = 0, ids: tuple[int, int] = (1, 195)) -> Iterator[Client]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", port))
        yield Client(link, ids)


@contextmanager
def tcp_client(port: int, ids: tuple[int, int] = (1, 195)) -> Iterator[Client]:
    with socket.create_connection(("127.0.0.1", port), timeout=20.0) as link:
        yield Client(link, ids)


class Process(subprocess.Popen[str]):
    def __init__(self, *arguments: object, **keywords: Any) -> None:
        command = [sys.executable, "-m", "vehicle_sim", *map(str, arguments)]
        pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        super().__init__(command, text=True, cwd=ROOT, **pipes | keywords)

    def result(self) -> tuple[int, str, str]:
        out, err = self.communicate(timeout=40)
        return self.returncode, out, err


class Running(threading.Thread):
    """A server of some vehicles on a link, or one each; and what became of it."""

    def __init__(
        self, tables: Sequence[dict[str, Any]], links: Sequence[Link], **settings: Any
    ) -> None:
        super().__init__(daemon=True)
        self.simulations = [Simulation(parse_world(table), seed=1) for table in tables]
        self.simulation, self.stop = self.simulations[0], threading.Event()
        self.port = links[0].endpoint.port
        self.error: Exception | None = None
        of_each = links if len(links) > 1 else [*links] * len(tables)
        pairs = zip(self.simulations, of_each, strict=True)
        stations = [Station(simulation=each, links=[link]) for each, link in pairs]
        ours = Stations(stations, self.stop)
        self._server = Server(stations=ours, say=lambda _: None, **settings)
        self.start()

    def run(self) -> None:
        try:
            self._server.run()
        except SimulatorError as error:
            self.error = error

    def ended(self, within_s: float = 10.0) -> bool:
        self.join(within_s)
        return not self.is_alive()
