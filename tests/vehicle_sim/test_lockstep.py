"""Lockstep against everything that could stop or disturb it: real sockets, real processes."""

import hashlib
import math
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.links import open_link, parse_endpoint
from vehicle_sim.server import Server, Settings, Station, Stop
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import flat_world

Start = Callable[..., "subprocess.Popen[str]"]
MARKER, TIMESYNC = 0xFD, 111


def question_of(message: Any, endings: tuple[int, ...]) -> int | None:
    """The time that a lockstep question carries; ArduPilot asks others that end in 1."""
    if message.get_type() == "TIMESYNC" and message.tc1 == 0 and message.ts1 % 1000 in endings:
        return int(message.ts1)
    return None


class Follower:
    """Answers every question of lockstep, over UDP or TCP, and remembers what came."""

    def __init__(self, link: socket.socket, address: Any = None) -> None:
        self.link, self.address = link, address
        self.link.settimeout(20.0)
        self.mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=195)
        self.parser = mavlink.MAVLink(None)
        self.parser.robust_parsing = True
        self.digest = hashlib.sha256()
        self.newest_ns = self.passed_ns = 0
        self.endings: tuple[int, ...] = (0,)

    def say(self, message: Any) -> None:
        data = message.pack(self.mav)
        if self.address is None:
            self.link.sendall(data)
        else:
            self.link.sendto(data, self.address)

    def beat(self, status: int = 4) -> None:
        self.say(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, status, 3))

    def read(self) -> list[Any]:
        data, address = self.link.recvfrom(65535)
        if address is not None:
            self.address = address
        if not data:
            raise ConnectionError
        return self.parser.parse_buffer(data) or []

    def follow(self, until_s: float) -> "Follower":
        """Answer until so much vehicle time has passed, all boots together."""
        while self.passed_ns < until_s * 1e9:
            for message in self.read():
                if self.newest_ns:
                    self.digest.update(message.get_msgbuf())
                asked_ns = question_of(message, self.endings)
                if asked_ns:
                    since_ns = self.newest_ns if asked_ns >= self.newest_ns else 0
                    self.passed_ns += asked_ns - since_ns
                    self.newest_ns = asked_ns
                    self.say(mavlink.MAVLink_timesync_message(asked_ns, asked_ns))
        return self


@contextmanager
def udp() -> Iterator[tuple[Follower, int]]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        yield Follower(link), link.getsockname()[1]


def ended(process: "subprocess.Popen[str]") -> tuple[int, str, str]:
    out, err = process.communicate(timeout=40)
    return process.returncode, out, err


def test_it_goes_on_through_a_reboot_over_udp(start: Start, tmp_path: Path) -> None:
    faults = tmp_path / "faults.txt"
    faults.write_text("at 3 s: reboot\n", encoding="utf-8")
    with udp() as (follower, port):
        process = start(
            *("--autopilot", "px4", "--lockstep", "--faults", faults),
            *("--connect", f"udpout:127.0.0.1:{port}", "--duration", 7),
        )
        follower.read()
        follower.beat()
        before = follower.follow(2.9).address
        after = follower.follow(6.8).address
        assert before != after  # another source port, as the real one's
        assert follower.newest_ns < 5e9  # the question counts from the boot, as all stamps do
        follower.beat(7)
        code, _, err = ended(process)
    assert (code, err) == (0, "")


def test_over_tcp_a_client_that_was_cut_off_connects_again_and_it_goes_on(
    start: Start, tmp_path: Path
) -> None:
    faults = tmp_path / "faults.txt"
    faults.write_text("at 1 s: reboot\n", encoding="utf-8")
    process = start(
        *("--lockstep", "--faults", faults, "--connect", "tcpin:127.0.0.1:0", "--duration", 4),
    )
    assert process.stdout is not None
    opening = process.stdout.readline()
    port = int(opening.split("tcpin:127.0.0.1:")[1].split(",")[0])
    with socket.create_connection(("127.0.0.1", port), timeout=20.0) as link:
        first = Follower(link)
        first.beat()
        with pytest.raises((ConnectionError, TimeoutError)):  # the reboot ends the connection
            first.follow(4.0)
    with socket.create_connection(("127.0.0.1", port), timeout=20.0) as link:
        second = Follower(link).follow(1.0)
        second.beat(7)
        code, _, err = ended(process)
    assert (code, err) == (0, "")


def run_late(start: Start, wait_s: float, *options: object) -> str:
    """What a client gets from the first question on, if it comes so late."""
    with udp() as (follower, port):
        process = start(
            *("--lockstep", "--connect", f"udpout:127.0.0.1:{port}", "--duration", 4, *options)
        )
        follower.read()
        threading.Event().wait(wait_s)
        follower.beat()
        digest = follower.follow(3.9).digest.hexdigest()
        process.terminate()
        code, _, err = ended(process)
    assert (code, err) == (0, "")
    return digest


BAD_LINKS = {
    "lossy and late": "link_duplication 30 % link_loss 20 % link_corruption 20 % "
    "link_reordering 30 % link_delay 50 ms",
    "off": "link_off",
}


@pytest.mark.sample(2)
@pytest.mark.parametrize("faults", BAD_LINKS)
def test_links_that_are_bad_from_the_start_neither_stop_it_nor_depend_on_when_one_comes(
    start: Start, faults: str, tmp_path: Path
) -> None:
    file = tmp_path / "faults.txt"
    file.write_text(BAD_LINKS[faults].replace("link_", "\nat 0 s: link_"), encoding="utf-8")
    options = ("--faults", str(file))
    assert run_late(start, 0.0, *options) == run_late(start, 0.7, *options)


def test_who_answers_with_a_time_of_its_own_is_told_so(serve: Any, companion: Any) -> None:
    with serve(companion.port, lockstep=True, silence_s=0.5) as run:
        companion.datagram()
        companion.send(companion.heartbeat())
        deadline_s = time.monotonic() + 20.0
        while not run.ended(0.0) and time.monotonic() < deadline_s:
            companion.socket.settimeout(0.2)
            try:
                messages = companion.messages()
            except TimeoutError:
                continue
            for message in messages:
                if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                    own = mavlink.MAVLink_timesync_message(time.time_ns(), message.ts1)
                    companion.send(companion.frame(own), companion.heartbeat())
        assert "tc1 must echo ts1" in str(run.error)


def test_vehicles_on_one_port_ask_different_questions_and_wait_for_all(start: Start) -> None:
    with udp() as (follower, port):
        process = start(
            *("--count", 3, "--lockstep", "--connect", f"udpout:127.0.0.1:{port}"),
            *("--duration", 3),
        )
        asked: list[tuple[int, int]] = []
        companions = {k: mavlink.MAVLink(None, srcSystem=k, srcComponent=195) for k in (1, 2, 3)}
        follower.read()
        for mav in companions.values():
            follower.mav = mav
            follower.beat()
        while not asked or max(asked)[0] < 2.8e9:
            for message in follower.read():
                if message.get_type() == "TIMESYNC" and message.tc1 == 0 and message.ts1:
                    asked.append((message.ts1, message.get_srcSystem()))
                    follower.mav = companions[message.get_srcSystem()]
                    follower.say(mavlink.MAVLink_timesync_message(message.ts1, message.ts1))
        questions = [ts1 for ts1, _ in asked]
        assert len(set(questions)) == len(questions)
        systems = [system for _, system in sorted(asked)]
        assert systems[:6] == [1, 2, 3, 1, 2, 3]
        process.terminate()
        ended(process)


def test_each_of_several_vehicles_flies_its_own_time() -> None:
    """The clock of the one whose companion ends first stands, and the other's goes on."""
    with udp() as (first, first_port), udp() as (second, second_port):
        home = {"latitude_deg": 47.0, "longitude_deg": 8.0, "altitude_amsl_m": 0.0}
        stations = []
        for port in (first_port, second_port):
            world = flat_world("copter", "px4", heading_deg=0.0, **home)
            link = open_link(parse_endpoint(f"udpout:127.0.0.1:{port}"))
            stations.append(Station(simulation=Simulation(world), links=[link]))
        second.endings = (0, 1)
        settings = Settings(lockstep=True, duration_s=3.0)
        server = Server(stations, settings, Stop(), say=lambda _: None)
        flight = threading.Thread(target=server.run)
        flight.start()
        for follower in (first, second):
            follower.read()
            follower.beat()
        answers = threading.Thread(target=second.follow, args=[3.0])
        answers.start()
        first.follow(1.0).beat(7)
        for thread in (answers, flight):
            thread.join(20.0)
            assert not thread.is_alive()
        for station in stations:
            station.links[0].close()
    times_us = [station.simulation.now_us for station in stations]
    assert times_us[0] <= 1_100_000
    assert times_us[1] == 3_000_000


def test_half_a_frame_of_a_client_that_has_gone_swallows_nothing_of_the_next(start: Start) -> None:
    process = start("--connect", "tcpin:127.0.0.1:0", "--duration", 40)
    assert process.stdout is not None
    port = int(process.stdout.readline().split("tcpin:127.0.0.1:")[1].split(",")[0])
    with socket.create_connection(("127.0.0.1", port), timeout=20.0) as link:
        link.sendall(b"\xfd\xff\x00\x00")
        link.recv(1)  # it has been served
    with socket.create_connection(("127.0.0.1", port), timeout=20.0) as link:
        client = Follower(link)
        client.say(mavlink.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0))
        deadline_s = time.monotonic() + 10.0
        answered = False
        while not answered and time.monotonic() < deadline_s:
            answered = any(m.get_type() == "AUTOPILOT_VERSION" for m in client.read())
        assert answered
    process.terminate()
    ended(process)


def test_on_shared_links_a_heartbeat_is_passed_on_once(start: Start, companion: Any) -> None:
    process = start(
        *("--count", 2, "--connect", f"udpout:127.0.0.1:{companion.port}"),
        *("--connect", "udpin:127.0.0.1:0", "--duration", 60),
    )
    assert process.stdout is not None
    opening = process.stdout.readline()
    endpoint = parse_endpoint("udpin:" + opening.split("udpin:")[1].split(",")[0])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.connect((endpoint.host, endpoint.port))
        station = Follower(other)
        station.mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        other.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(station.mav))
        station.read()
        companion.datagram()
        companion.send(companion.heartbeat(5))  # a status that nobody else here has
        got: list[Any] = []
        deadline_s = math.inf
        while time.monotonic() < deadline_s and len(got) < 2:
            got += [m for m in station.read() if m.get_type() == "HEARTBEAT" and m.type == 18]
            if got:
                deadline_s = min(deadline_s, time.monotonic() + 0.5)
    assert len(got) == 1
    process.terminate()
    ended(process)
