"""The companion beside MAVProxy on one autopilot, as docs/connecting.md has it, and who hears it.

The ground stations are made of pymavlink's messages, on sockets of their own.
"""

import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from programs import Program, free_port
from pymavlink.dialects.v20 import ardupilotmega as wire

BIN = Path(sys.executable).parent
VEHICLE, COMPANION = (1, 1), (1, 195)
_READY_S = 60.0


class Ground:
    """A ground station on UDP: waits at a port, or calls one."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.2)
        self.port: int = self._socket.getsockname()[1]
        self.peers: set[tuple[str, int]] = set()
        self.heard: list[Any] = []
        self._codec = wire.MAVLink(None, srcSystem=255, srcComponent=190)
        self._codec.robust_parsing = True
        self._beat_s = 0.0

    def close(self) -> None:
        self._socket.close()

    def say(self, message: Any) -> None:
        frame = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) % 256
        for peer in self.peers:
            self._socket.sendto(frame, peer)

    def listen(self, until: Any, within_s: float) -> Any:
        """The first message that is so; None: there was none."""
        deadline_s, looked = time.monotonic() + within_s, len(self.heard)
        while time.monotonic() < deadline_s:
            if time.monotonic() - self._beat_s > 1.0:
                self._beat_s = time.monotonic()
                self.say(wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            try:
                data, peer = self._socket.recvfrom(65535)
            except TimeoutError:
                continue
            self.peers.add(peer)
            self.heard += self._codec.parse_buffer(data) or ()
            for message in self.heard[looked:]:
                looked += 1
                if until(message):
                    return message
        return None

    def hears(self, who: tuple[int, int], kind: str, within_s: float, **values: Any) -> Any:
        def so(message: Any) -> bool:
            matches = all(getattr(message, key, None) == value for key, value in values.items())
            return sender(message) == who and message.get_type() == kind and matches

        return self.listen(so, within_s)

    def count(self, who: tuple[int, int]) -> int:
        return sum(sender(message) == who for message in self.heard)


def sender(message: Any) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


@pytest.fixture
def station() -> Iterator[Any]:
    made: list[Ground] = []

    def make() -> Ground:
        made.append(Ground())
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.fixture
def companion(programs: Any, tmp_path: Path) -> Any:
    def start(connect: str, *options: str) -> Program:
        arguments = "fly", "sitl-px4", "--connect", connect, "--out", tmp_path / "run"
        return programs(
            "companion",
            BIN / "companion",
            *arguments,
            "--start",
            *options,
            folder=tmp_path / "home",
        )

    return start


@pytest.fixture
def vehicle(programs: Any, tmp_path: Path) -> Any:
    def start(port: int) -> Program:
        link = "--connect", f"udpout:127.0.0.1:{port}"
        return programs(
            *("vehicle", BIN / "vehicle-sim", "sitl-px4", *link), folder=tmp_path / "vehicle"
        )

    return start


def orders_are_answered(ground: Ground) -> None:
    """By the companion, and by it alone."""
    ground.say(wire.MAVLink_command_long_message(*COMPANION, 512, 0, 148.0, *[0.0] * 6))
    ack = ground.hears(COMPANION, "COMMAND_ACK", 10.0, command=512)
    assert ack is not None
    assert (ack.result, ack.target_system, ack.target_component) == (0, 255, 190)
    answers = [m for m in ground.heard if m.get_type() == "COMMAND_ACK" and m.command == 512]
    assert {sender(message) for message in answers} == {COMPANION}


def test_a_ground_station_behind_ground_hears_the_companion_and_is_answered(
    station: Any, companion: Any, vehicle: Any, mavproxy: Any
) -> None:
    """Behind a second --out of MAVProxy it hears the vehicle alone."""
    to_proxy, to_companion, ground, behind = free_port(), free_port(), station(), station()
    mavproxy(
        *(f"udpin:127.0.0.1:{to_proxy}", f"--out=127.0.0.1:{to_companion}"),
        *(f"--out=127.0.0.1:{behind.port}", "--streamrate=-1"),
    )
    vehicle(to_proxy)
    companion(
        f"udpin:127.0.0.1:{to_companion}",
        *("--ground", f"udpout:127.0.0.1:{ground.port}"),
    )
    assert ground.hears(COMPANION, "HEARTBEAT", _READY_S) is not None
    assert ground.hears(COMPANION, "STATUSTEXT", _READY_S) is not None
    orders_are_answered(ground)
    assert ground.count(VEHICLE) == 0
    assert behind.hears(VEHICLE, "HEARTBEAT", 10.0) is not None
    behind.listen(lambda _: False, 2.0)  # the companion's heartbeats come once a second
    assert behind.count(COMPANION) == 0


def test_what_is_typed_at_a_mavproxy_behind_ground_is_for_the_companion(
    companion: Any, vehicle: Any, mavproxy: Any
) -> None:
    """As docs/connecting.md has it typed."""
    to_companion, to_ground = free_port(), free_port()
    person = mavproxy(f"udpin:127.0.0.1:{to_ground}")
    vehicle(to_companion)
    companion(f"udpin:127.0.0.1:{to_companion}", *("--ground", f"udpout:127.0.0.1:{to_ground}"))
    person.expect("mission sitl-px4", _READY_S)
    person.type("set target_system 1")
    person.type("set target_component 195")
    person.ask("long REQUEST_MESSAGE 148", "REQUEST_MESSAGE: ACCEPTED")
    person.ask("long DO_PAUSE_CONTINUE 0", "DO_PAUSE_CONTINUE: TEMPORARILY_REJECTED")
