"""Who is at the other end of a socket: a client of pymavlink's, a process, a server in a thread."""

import itertools
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import pytest
from harness import command_long, heartbeat, world
from pymavlink.dialects.v20 import all as mavlink
from wires import Speaker

from vehicle_sim.errors import SimulatorError
from vehicle_sim.links import open_link, parse_endpoint
from vehicle_sim.server import Server
from vehicle_sim.simulation import Simulation
from vehicle_sim.stations import Station, Stations
from vehicle_sim.world import parse_world

ROOT = Path(__file__).parents[2]


class Client(Speaker):
    """The other end of a link: a few frames on a real socket, and nothing of our own code."""

    def __init__(self, link: socket.socket, ids: tuple[int, int] = (1, 195)) -> None:
        super().__init__(srcSystem=ids[0], srcComponent=ids[1])
        self.link, self.address, self.parser = link, cast(Any, None), mavlink.MAVLink(None)
        self.link.settimeout(20.0)
        self.parser.robust_parsing = True
        self.port = link.getsockname()[1]
        self.endpoint = f"udpout:127.0.0.1:{self.port}"

    def command(self, number: int, *p: float, target: tuple[int, int] = (1, 1)) -> bytes:
        return self.frame(command_long(number, *p, target=target))

    def heartbeat(self, status: int = 4) -> bytes:
        return self.frame(heartbeat(status=status))

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

    def wait_for(self, wanted: Callable[[Any], bool]) -> Any:
        """The first message for which this is so."""
        deadline_s = time.monotonic() + 10.0
        while time.monotonic() < deadline_s:
            for message in filter(wanted, self.messages()):
                return message
        pytest.fail("it did not come within 10 s")


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

    def close(self) -> None:
        with self:
            self.kill()


class Running(threading.Thread):
    """A server of vehicles with a radar, on one link or on one each ("A B"); what became of it."""

    def __init__(self, endpoints: str, count: int = 1, **settings: Any) -> None:
        super().__init__(daemon=True)
        scanner = {"component_id": 100, "range_m": 5000.0}
        tables = (world(scanner=scanner, system_id=k + 1) for k in range(count))
        self.simulations = [Simulation(parse_world(table), seed=1) for table in tables]
        self.simulation, self.stop = self.simulations[0], threading.Event()
        self.links = [open_link(parse_endpoint(each)) for each in endpoints.split()]
        self.port, self.error = self.links[0].endpoint.port, cast(Any, None)
        pairs = zip(self.simulations, itertools.cycle(self.links), strict=False)
        ours = Stations([Station(simulation=it, links=[link]) for it, link in pairs], self.stop)
        self._server = Server(stations=ours, say=lambda _: None, **settings)
        self.start()

    def close(self) -> None:
        self.stop.set()
        self.join(10.0)
        for link in self.links:
            link.close()

    def run(self) -> None:
        try:
            self._server.run()
        except SimulatorError as error:
            self.error = error

    def ended(self, within_s: float = 10.0) -> bool:
        self.join(within_s)
        return not self.is_alive()
