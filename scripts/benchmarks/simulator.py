"""How fast simulated flights are, and what the simulator takes.

    scripts/bench simulator [--seconds 300] [--hours 2] [--repeats 3] [--json FILE]

Times real time, the fastest of some: `vehicle-sim` alone, in lockstep with a client that only
answers it; with `companion fly` over UDP; both in one process (processor time); and the replay of
what was flown.  Then of the simulator its start-up, its memory, and what is called in a step.
"""

import json
import multiprocessing
import re
import socket
import subprocess
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import all as mavlink
from running import Found, least, main
from stepped import Called, Flight
from tapped import BIN, end, messages, start_companion, start_vehicle, udp_socket

from companion.config import folder_of, load_mission, read_mission
from companion.planner.plan import plan
from companion.runtime.compiler import load_kernel
from companion.runtime.in_process import fly_in_process
from companion.session import Session
from companion.telemetry.run_folder import RunFolder
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world

MISSIONS = ("environment-1", "sitl-px4")
_TICK_HZ = 20
_COMMANDS = {900: (176, 1, 4, 0), 902: (400, 1, 0, 0), 904: (22, 0, 0, 30)}
"""By ticks: guided mode, arm, take off to 30 m."""
_SAID = re.compile(rb"\((\d+\.\d) x real time\)")
_PATIENCE_S = 600.0


def world_of(name: str) -> Path:
    """The file of a bundled world."""
    return folder_of(name) / "world.toml"


def client(link: socket.socket) -> None:
    """Answers every TIMESYNC, and says what makes a copter take off: nothing more."""
    mav, ticks = mavlink.MAVLink(None, srcSystem=1, srcComponent=195), 0
    while True:
        datagram, address = link.recvfrom(65535)
        heartbeat = mav.heartbeat_encode(18, 8, 0, 0, 4, 3)
        asked = [
            it.ts1 for it in messages(datagram, mavlink.MAVLink_timesync_message) if not it.tc1
        ]
        out = [heartbeat] if (ticks == 0 or (asked and ticks % _TICK_HZ == 0)) else []
        if asked and ticks == 0:
            out.append(mav.command_long_encode(1, 1, 511, 0, 33, 1e6 / _TICK_HZ, 0, 0, 0, 0, 0))
        if asked and ticks in _COMMANDS:
            number, p1, p2, p7 = _COMMANDS[ticks]
            out.append(mav.command_long_encode(1, 1, number, 0, p1, p2, 0, 0, 0, 0, p7))
        out += [mav.timesync_encode(asked[-1], asked[-1])] if asked else []
        for message in out:
            link.sendto(message.pack(mav), address)
        ticks += len(asked) > 0


def alone(seconds: float) -> tuple[float, float]:
    """vehicle-sim with that client.  -> times real time, as it says; memory at its end, MB"""
    with udp_socket() as link:
        answering = multiprocessing.Process(target=client, args=(link,), daemon=True)
        answering.start()
        command = [BIN / "vehicle-sim", "--lockstep", "--duration", str(seconds)]
        command += ["--connect", f"udpout:127.0.0.1:{link.getsockname()[1]}"]
        size_mb = 0.0
        with subprocess.Popen(command, stdout=subprocess.PIPE) as vehicle:
            status = Path(f"/proc/{vehicle.pid}/status")
            while vehicle.poll() is None:
                if resident := re.search(r"VmRSS:\s+(\d+)", status.read_text(encoding="ascii")):
                    size_mb = int(resident[1]) / 1024
                time.sleep(0.1)
            printed = vehicle.communicate()[0]
        answering.kill()
    return float(_SAID.findall(printed)[-1]), size_mb


def over_udp(name: str, folder: Path) -> float:
    """Both programs in lockstep, recorded in `folder`.  -> times real time, as the vehicle says"""
    with udp_socket() as free:
        port = int(free.getsockname()[1])
    folder.mkdir()
    vehicle = start_vehicle(world_of(name), port, "--lockstep", log=folder / "vehicle.log")
    mission = folder_of(name) / "mission.toml"
    companion = start_companion(mission, port, folder / "run", "--lockstep")
    try:
        if (code := companion.wait(_PATIENCE_S)) != 0:
            raise SystemExit(f"{name}: the companion ended with {code}")
        vehicle.wait(_PATIENCE_S)
    finally:
        end(companion)
        end(vehicle)
    return float(_SAID.findall((folder / "vehicle.log").read_bytes())[-1])


def replayed(folder: Path, *options: str) -> float:
    """The decisions of a flight once more, which must be the same.  -> times real time"""
    report = folder / "replay.json"
    command = [BIN / "companion", "replay", folder / "run", "--json", report, *options]
    subprocess.run(list(map(str, command)), check=True, stdout=subprocess.DEVNULL)
    replayed: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    return float(replayed["flown_s"] / replayed["took_s"])


def in_one_process(name: str) -> float:
    """Both programs in this process, recorded.  -> times real time, by processor time"""
    vehicle = Simulation(read_world(world_of(name)))
    session, began_s = Session(load_mission(name), seed=1, lockstep=True), time.process_time()
    with (
        TemporaryDirectory() as folder,
        RunFolder(
            Path(folder) / "run", mission_toml=read_mission(name).text, epoch_us=1, durable=False
        ) as run,
    ):
        fly_in_process(session, vehicle, planner=plan, folder=run)
    return vehicle.now_us * 1e-6 / (time.process_time() - began_s)


def start_up_s() -> float:
    """vehicle-sim, from the start of its process to the first datagram that it sends."""
    with udp_socket() as link:
        began_s = time.perf_counter()
        vehicle = start_vehicle(world_of(MISSIONS[0]), int(link.getsockname()[1]))
        link.recv(2048)
        took_s = time.perf_counter() - began_s
        end(vehicle)
    return took_s


def called(name: str, seconds: float = 60.0) -> list[tuple[int, int]]:
    """Calls of the simulator's own functions in each step of a flight, and modules."""
    it, counts = Flight(load_mission(name), read_world(world_of(name)), seed=1), []
    while it.now_s < seconds:
        with Called("/vehicle_sim/") as mine:
            it.simulation.step()
            frames = it.simulation.take_frames()
        counts.append((mine.calls, len(mine.files)))
        for answer in (answer for _, frame in frames for answer in it.answers(frame)):
            it.simulation.receive(0, answer)
    return counts


def simulator(seconds: float = 300.0, hours: float = 2.0, repeats: int = 3) -> Found:
    """seconds: of vehicle time alone; hours: for the memory; repeats: the fastest counts."""
    load_kernel()
    runs = [alone(seconds) for _ in range(repeats)]
    times = {"vehicle-sim alone in lockstep": max(runs)[0]}
    for name in MISSIONS:
        with TemporaryDirectory() as scratch:
            folders = [Path(scratch) / str(k) for k in range(repeats)]
            times[f"{name}: over UDP in lockstep"] = max(
                over_udp(name, folder) for folder in folders
            )
            times[f"{name}: replay, plans too"] = replayed(folders[0])
            again = max(replayed(folder, "--no-plans") for folder in folders)
            times[f"{name}: replay without planning"] = again
        one = max(in_one_process(name) for _ in range(repeats))
        times[f"{name}: in one process, by processor time"] = one
    for what, value in times.items():
        yield {"": what, "times real time|.0f": value}
    counts = np.array(called(MISSIONS[0]))
    start_s = min(start_up_s() for _ in range(repeats))
    for what, figure in {
        "start to the first datagram, s": start_s,
        f"resident after {seconds:g} simulated seconds, MB": runs[0][1],
        f"resident after {hours:g} simulated hours, MB": alone(3600.0 * hours)[1],
        "calls of its own functions in a step, median": np.median(counts[:, 0]),
        "the same, most": counts[:, 0].max(),
        "modules of these, median": np.median(counts[:, 1]),
    }.items():
        yield {"the simulator": what, "|.4g": figure}
    yield least(
        "over UDP in lockstep: times real time",
        times[f"{MISSIONS[0]}: over UDP in lockstep"],
        180.0,
    )
    one = times[f"{MISSIONS[0]}: in one process, by processor time"]
    yield least("in one process: times real time", one, 400.0)
    for name, bar in zip(MISSIONS, (600.0, 300.0), strict=True):
        again = times[f"{name}: replay without planning"]
        yield least(f"{name}: replay without planning, times real time", again, bar)


if __name__ == "__main__":
    main(simulator)
