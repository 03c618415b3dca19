"""How fast the simulator is, beside a bare pair of sockets in the same run, and its memory.

scripts/bench simulator [--seconds 300] [--hours 10] [--json FILE]
"""

import multiprocessing
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from pymavlink.dialects.v20 import all as mavlink
from running import Found, least, main
from tapped import messages

from vehicle_sim.simulation import Simulation
from vehicle_sim.world import flat_world

TICK_HZ = 20
HOME = {"latitude_deg": 47.397742, "longitude_deg": 8.545594, "altitude_amsl_m": 488.0}
COMMANDS = {900: (176, 1, 4, 0), 902: (400, 1, 0, 0), 904: (22, 0, 0, 30)}
"""By ticks: guided mode, arm, take off to 30 m."""


def frame(mav: Any, message: Any) -> bytes:
    packed: bytes = message.pack(mav)
    mav.seq = (mav.seq + 1) % 256
    return packed


def time_syncs(datagram: bytes) -> int | None:
    """ts1 of a TIMESYNC question in this datagram."""
    asked = [*messages(datagram, mavlink.MAVLink_timesync_message)]
    return next((each.ts1 for each in reversed(asked) if each.tc1 == 0), None)


def trivial_client(link: socket.socket, takeoff: bool) -> None:
    """Answers every TIMESYNC, and says what makes a copter take off: nothing more."""
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=195)
    ticks = 0
    while True:
        datagram, address = link.recvfrom(65535)
        asked = time_syncs(datagram)
        if asked is None:
            if ticks == 0:
                link.sendto(frame(mav, mav.heartbeat_encode(18, 8, 0, 0, 4, 3)), address)
            continue
        out = []
        if ticks == 0:
            out.append(mav.command_long_encode(1, 1, 511, 0, 33, 1e6 / TICK_HZ, 0, 0, 0, 0, 0))
        if ticks % TICK_HZ == 0:  # a heartbeat a second
            out.append(mav.heartbeat_encode(18, 8, 0, 0, 4, 3))
        if takeoff and ticks in COMMANDS:
            number, p1, p2, p7 = COMMANDS[ticks]
            out.append(mav.command_long_encode(1, 1, number, 0, p1, p2, 0, 0, 0, 0, p7))
        out.append(mav.timesync_encode(asked, asked))
        link.sendto(b"".join(frame(mav, each) for each in out), address)
        ticks += 1


def bare_server(port: int, seconds: float) -> float:
    """The same without a vehicle: a position and a TIMESYNC each tick.  -> x real time."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.connect(("127.0.0.1", port))
    mav, parser = mavlink.MAVLink(None, srcSystem=1, srcComponent=1), mavlink.MAVLink(None)
    start_s = time.perf_counter()
    for tick in range(1, round(seconds * TICK_HZ) + 1):
        asked = tick * 50_000_000
        position = mav.global_position_int_encode(tick, 1, 2, 3, 4, 5, 6, 7, 8)
        link.send(frame(mav, position) + frame(mav, mav.timesync_encode(0, asked)))
        answered = False
        while not answered:
            for message in parser.parse_buffer(link.recv(65535)) or []:
                answered = answered or (message.get_type() == "TIMESYNC" and message.ts1 == asked)
    return seconds / (time.perf_counter() - start_s)


def with_client(run: Callable[[int], float], *, takeoff: bool) -> float:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))  # bound before the client runs: nothing can come too early
        client = multiprocessing.Process(target=trivial_client, args=(link, takeoff), daemon=True)
        client.start()
        try:
            return run(link.getsockname()[1])
        finally:
            client.kill()
            client.join()


def lockstep(port: int, seconds: float) -> float:
    """vehicle-sim itself, as a process.  -> x real time, as it says"""
    command = [sys.executable, "-m", "vehicle_sim", "--lockstep", "--duration", str(seconds)]
    command += ["--connect", f"udpout:127.0.0.1:{port}"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return float(said.split("(")[-1].split(" x real time")[0])


def many(count: int, seconds: float, autopilot: str) -> float:
    """So many vehicles in this process, streaming what they stream unasked.  -> x real time"""
    vehicles = [
        Simulation(
            flat_world("copter", autopilot, heading_deg=0.0, system_id=k + 1, **HOME), seed=k
        )  # type: ignore[arg-type]
        for k in range(count)
    ]
    start_s = time.perf_counter()
    for _ in range(round(seconds * 100)):
        for vehicle in vehicles:
            vehicle.step()
            vehicle.take_frames()
    for vehicle in vehicles:
        vehicle.take_truth()
    return seconds / (time.perf_counter() - start_s)


def resident_mb(hours: float) -> Iterator[tuple[float, float]]:
    """Memory of one vehicle that flies and streams, by simulated hours."""
    vehicle = Simulation(flat_world("copter", "px4", heading_deg=0.0, **HOME))
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=195)
    for tenth in range(11):
        yield hours * tenth / 10, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        for _ in range(round(hours * 360)):
            vehicle.receive(0, frame(mav, mav.heartbeat_encode(18, 8, 0, 0, 4, 3)))
            vehicle.receive(0, frame(mav, mav.param_request_read_encode(1, 1, b"X", 0)))
            for _ in range(100):
                vehicle.step()
            vehicle.take_frames()
            vehicle.take_truth()
            vehicle.take_notices()


def simulator(seconds: float = 300.0, hours: float = 10.0) -> Found:
    """seconds: of vehicle time for each speed; hours: for the memory."""
    flying = with_client(lambda port: lockstep(port, seconds), takeoff=True)
    fleets = {name: many(50, 60.0, name) for name in ("ardupilot", "px4")}
    for what, times in {
        "bare pair of position and TIMESYNC, 20 Hz": with_client(
            lambda port: bare_server(port, seconds), takeoff=False
        ),
        "vehicle-sim in lockstep, on the ground": with_client(
            lambda port: lockstep(port, seconds), takeoff=False
        ),
        "vehicle-sim in lockstep, flying after 45 s": flying,
        **{f"50 vehicles in one process, {name}": times for name, times in fleets.items()},
    }.items():
        yield {"": what, "times real time|.1f": times}
    for at_hours, size in resident_mb(hours):
        yield {"after simulated hours": f"{at_hours:.1f}", "resident, MB|.1f": size}
    yield least("flying in lockstep: times real time", flying, 150.0)
    yield least("50 vehicles in one process", min(fleets.values()), 1.0)


if __name__ == "__main__":
    main(simulator)
