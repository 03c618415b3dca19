"""How fast a flight over UDP is in lockstep, and its replay, beside bare frames in the same run.

    scripts/bench lockstep [--repeats 3] [--json FILE]

vehicle-sim and `companion fly` as processes, an ArduPilot and a PX4 flight; the fastest counts.
Then `companion replay --no-plans` of each.  The bare frames are those of the first flight: two
processes that pack, send, receive and decode the same, tick by tick, and decide nothing.
"""

import multiprocessing
import re
import socket
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from one_process import Overheard, Tick, flown, understood
from replay import replayed
from running import Found, least, main
from tapped import end, free_port, start_companion, start_vehicle, udp_socket

from companion.config import folder_of
from companion.mavlink.dialect import codec
from companion.mavlink.frames import Receiver
from companion.runtime.compiler import load_kernel
from vehicle_sim.simulation import Simulation
from vehicle_sim.wire.frames import Packer, StreamParser
from vehicle_sim.world import read_world

MISSIONS = ("environment-1", "sitl-px4")
_SAID = re.compile(rb"\((\d+\.\d) x real time\)")
_PATIENCE_S = 600.0


def flight(name: str, folder: Path) -> float:
    """Both programs in lockstep, recorded in `folder`.  -> times real time, as the vehicle says."""
    port, log = free_port(), folder / "vehicle.log"
    vehicle = start_vehicle(folder_of(name) / "world.toml", port, "--lockstep", log=log)
    mission = folder_of(name) / "mission.toml"
    companion = start_companion(mission, port, folder / "run", "--lockstep")
    try:
        if (code := companion.wait(_PATIENCE_S)) != 0:
            raise SystemExit(f"{name}: the companion ended with {code}")
        vehicle.wait(_PATIENCE_S)
    finally:
        end(companion)
        end(vehicle)
    said = _SAID.search(log.read_bytes())
    assert said is not None
    return float(said[1])


def again(folder: Path) -> float:
    """The decisions of a flight once more, without its plans.  -> times real time"""
    found = replayed(folder / "run", "--no-plans")
    if not found["identical"]:
        raise SystemExit(f"the replay differs: {found['difference']}")
    return float(found["flown_s"] / found["took_s"])


def bare(ticks: Sequence[Tick]) -> float:
    """Seconds in which two processes exchange the frames of a flight."""
    theirs, ours = understood(ticks)
    link = udp_socket()
    answering = multiprocessing.Process(target=_answer, args=(link, ours), daemon=True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        vehicle.connect(link.getsockname())
        vehicle.settimeout(_PATIENCE_S)
        packer, parser = Packer(1, 1), StreamParser(datagrams=True)
        answering.start()
        began_s = time.perf_counter()
        for messages in theirs:
            vehicle.send(b"".join(map(packer.frame, messages)))
            parser.feed(vehicle.recv(65_535))
        took_s = time.perf_counter() - began_s
    answering.join()
    link.close()
    return took_s


def _answer(link: socket.socket, ours: Sequence[Sequence[object]]) -> None:
    """The companion's side: each datagram read, what it said then packed and sent."""
    receiver, own = Receiver(), codec(1)
    for messages in ours:
        data, sender = link.recvfrom(65_535)
        receiver.read(data, 0.0)
        link.sendto(b"".join(message.pack(own) for message in messages), sender)


def lockstep(repeats: int = 3) -> Found:
    """Flights and their replays by both autopilots, and the bare frames; the fastest counts."""
    flights, replays = dict[str, float](), dict[str, float]()
    with TemporaryDirectory() as scratch:
        for name in MISSIONS:
            folders = [Path(scratch) / f"{name}-{k}" for k in range(repeats)]
            for folder in folders:
                folder.mkdir()
            flights[name] = max(flight(name, folder) for folder in folders)
            replays[name] = max(again(folder) for folder in folders)
    overheard = Overheard(Simulation(read_world(folder_of(MISSIONS[0]) / "world.toml")))
    load_kernel()
    flown(MISSIONS[0], overheard)
    took_s = min(bare(overheard.ticks) for _ in range(repeats))
    times = overheard.now_us * 1e-6 / took_s
    for what, rates in (("over UDP", flights), ("replay", replays), ("the bare frames", {})):
        ardupilot, px4 = (rates.get(name) for name in MISSIONS)
        ardupilot = ardupilot or times
        yield {"times real time": what, f"{MISSIONS[0]}|.0f": ardupilot, f"{MISSIONS[1]}|.0f": px4}
    flies = flights[MISSIONS[0]]
    yield least("over UDP in lockstep: times real time", flies, 150.0)
    yield least("over UDP in lockstep: of bare frames", flies / times, 0.7)
    yield least("replay without planning: times real time", replays[MISSIONS[0]], 600.0)
    yield least("the same, PX4", replays[MISSIONS[1]], 300.0)


if __name__ == "__main__":
    main(lockstep)
