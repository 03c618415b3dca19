"""How fast a flight in one process is, without sockets, and what takes the time.

By processor time, a recorded flight of a bundled environment, the fastest of some.  Beside it what
it is made of: the plans; the simulator alone, told the same again; and the floor that messages set:
the same frames packed, found and decoded by either program's own code, and nothing else.
    scripts/bench one_process [--environment environment-1] [--repeats 3] [--json FILE]
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from running import Found, least, main

from companion.config import folder_of, load_mission, mission_text
from companion.mavlink.dialect import codec
from companion.mavlink.frames import Receiver
from companion.planner.plan import plan
from companion.planner.request import PlanOutcome, PlanRequest
from companion.runtime.compiler import load_kernel
from companion.runtime.in_process import fly_in_process
from companion.session import Session
from companion.telemetry.run_folder import RunFolder
from vehicle_sim.simulation import Simulation
from vehicle_sim.wire.frames import Packer, StreamParser, prepared
from vehicle_sim.world import read_world

Tick = tuple[int, list[bytes], list[bytes]]
"""Until when the vehicle flies, what it is told before, and what it says then."""


class Overheard:
    """A vehicle that notes what it is told and what it says."""

    def __init__(self, vehicle: Simulation) -> None:
        self.ticks: list[Tick] = []
        self._vehicle, self._told = vehicle, list[bytes]()
        self.send_heartbeat, self.begin = vehicle.send_heartbeat, vehicle.begin
        self.step, self.ask_for_sync = vehicle.step, vehicle.ask_for_sync

    @property
    def now_us(self) -> int:
        return self._vehicle.now_us

    @property
    def companion(self) -> object | None:
        return self._vehicle.companion

    def take_frames(self) -> list[tuple[int, bytes]]:
        frames = self._vehicle.take_frames()
        self.ticks.append((self.now_us, self._told, [frame for _, frame in frames]))
        self._told = []
        return frames

    def receive(self, link: int, data: bytes) -> None:
        self._told.append(data)
        self._vehicle.receive(link, data)


def flown(name: str, vehicle: Overheard | Simulation) -> tuple[float, float]:
    """Processor time of a recorded flight, and of its plans."""
    began_s, plans_s = time.process_time(), 0.0

    def planned(request: PlanRequest, is_late: Callable[[], bool]) -> PlanOutcome:
        nonlocal plans_s
        asked_s = time.process_time()
        outcome = plan(request, is_late)
        plans_s += time.process_time() - asked_s
        return outcome

    mission, text = load_mission(name), mission_text(name)
    session = Session(mission, seed=1, lockstep=True)
    with (
        TemporaryDirectory() as folder,
        RunFolder(Path(folder) / "run", mission_toml=text, epoch_us=1, durable=False) as run,
    ):
        fly_in_process(session, vehicle, planner=planned, folder=run)
    return time.process_time() - began_s, plans_s


def told_again(vehicle: Simulation, ticks: list[Tick]) -> float:
    """Processor time of the simulator alone, which says the same again."""
    began_s = time.process_time()
    for now_us, told, said in ticks:
        for data in told:
            vehicle.receive(0, data)
        if now_us == 0:
            vehicle.send_heartbeat()
        else:
            if vehicle.now_us == 0:
                vehicle.begin()
            while vehicle.now_us < now_us:
                vehicle.step()
            vehicle.ask_for_sync()
        assert [frame for _, frame in vehicle.take_frames()] == said
    return time.process_time() - began_s


def understood(ticks: Sequence[Tick]) -> tuple[list[list[Any]], list[list[Any]]]:
    """The messages of each tick: the vehicle's, ready to go out, and the companion's."""
    again, parser = Receiver(), StreamParser(datagrams=True)
    vehicles = [[prepared(m) for _, m in parser.feed(b"".join(said))] for _, _, said in ticks]
    return vehicles, [again.feed(b"".join(told)) for _, told, _ in ticks]


def frames_alone(ticks: Sequence[Tick]) -> float:
    """Processor time of packing, finding and decoding all frames on both sides."""
    vehicles, companions = understood(ticks)
    parser = StreamParser(datagrams=True)
    began_s, packer, link, receiver = time.process_time(), Packer(1, 1), codec(1), Receiver()
    for (_, told, said), theirs, ours in zip(ticks, vehicles, companions, strict=True):
        for message in theirs:
            packer.frame(message)
        receiver.read(b"".join(said), 0.0)
        for message in ours:
            message.pack(link)
        parser.feed(b"".join(told))
    return time.process_time() - began_s


def one_process(environment: str = "environment-1", repeats: int = 3) -> Found:
    """A flight of a bundled environment; the fastest of some counts."""
    load_kernel()
    world = read_world(folder_of(environment) / "world.toml")
    overheard = Overheard(Simulation(world))
    flown(environment, overheard)
    ticks, flight_s = overheard.ticks, overheard.now_us * 1e-6
    whole_s, plans_s = min(flown(environment, Simulation(world)) for _ in range(repeats))
    alone_s = min(told_again(Simulation(world), ticks) for _ in range(repeats))
    for what, took_s in {
        "the flight, recorded": whole_s,
        "its plans": plans_s,
        "the simulator alone, told the same": alone_s,
        "companion, control loop and recording": whole_s - plans_s - alone_s,
        "the frames alone, both ways and both sides": min(
            frames_alone(ticks) for _ in range(repeats)
        ),
    }.items():
        yield {
            f"{environment}: {flight_s:.0f} s in one process": what,
            "s|.2f": took_s,
            "us a tick|.0f": took_s / len(ticks) * 1e6,
            "times real time|.0f": flight_s / took_s,
        }
    yield least("in one process: times real time", flight_s / whole_s, 400.0)


if __name__ == "__main__":
    main(one_process)
