"""Vehicles on their links: what goes out, what comes in, and waiting for companions in lockstep."""

import select
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from threading import Event
from typing import TextIO, final

from vehicle_sim.errors import SimulatorError
from vehicle_sim.links import Link
from vehicle_sim.simulation import Simulation

_PATIENCE_S = 0.1
"""How long a wait may last before it looks whether it shall stop."""
_MAX_DATAGRAMS = 1000
"""Handled in one go: a flood does not stop the clock."""


@final
@dataclass(slots=True, kw_only=True, eq=False)
class Station:
    """One vehicle, the links that it is on, in its own order, and where its truth is written."""

    simulation: Simulation
    links: Sequence[Link]
    truth: TextIO | None = None


@final
class Stations:
    """One vehicle or several; links may be shared.  ``stop`` is set by whoever wants an end."""

    def __init__(self, stations: Sequence[Station], stop: Event | None = None) -> None:
        self.all, self.stop = stations, stop or Event()
        self.simulations = [station.simulation for station in stations]
        self._heard: dict[Link, list[tuple[Simulation, int]]] = {}
        """Who hears what comes in by a link, and as which of its own links."""
        for station in stations:
            for number, link in enumerate(station.links):
                self._heard.setdefault(link, []).append((station.simulation, number))

    def send(self) -> None:
        """All frames that are due."""
        for station in self.all:
            by_link: dict[int, list[bytes]] = {}
            for number, frame in station.simulation.take_frames():
                by_link.setdefault(number, []).append(frame)
            for number, frames in by_link.items():
                station.links[number].send(frames)

    def receive(self, wait_s: float = 0.0) -> None:
        """Handle what has come, waiting so long for the first."""
        ready, _, _ = select.select(self._heard, [], [], max(wait_s, 0.0))
        for link, hearers in self._heard.items() if ready else ():
            for _ in range(_MAX_DATAGRAMS):
                if (datagram := link.receive()) is None:
                    break
                for simulation, number in hearers:
                    simulation.receive(number, datagram)

    def wait(
        self, every_s: float, patience_s: float, meanwhile: Callable[[], object] = lambda: None
    ) -> None:
        """Handle messages until no vehicle waits for its companion; vehicle time is stopped.

        Each that does asks again every so often: it may have been lost, or its client has changed.
        """
        begun_s = asked_s = time.monotonic()
        while not self.stop.is_set():
            waiting = [simulation for simulation in self.simulations if simulation.waits]
            if not waiting:
                return
            meanwhile()
            self.receive(min(every_s, _PATIENCE_S))
            now_s = time.monotonic()
            if now_s - begun_s >= patience_s:
                raise SimulatorError(_silence(waiting[0], patience_s))
            if now_s - asked_s >= every_s:
                asked_s = now_s
                for simulation in waiting:
                    simulation.ask_again()
                self.send()


def _silence(simulation: Simulation, waited_s: float) -> str:
    """What is said of a companion that keeps a vehicle waiting."""
    if simulation.companion is None:
        return f"no heartbeat from a companion within {waited_s:.0f} s"
    return (
        f"no answer to TIMESYNC within {waited_s:.0f} s, at {simulation.now_us * 1e-6:.1f} s of "
        "vehicle time: in lockstep it has to come, and its tc1 to echo ts1"
    )
