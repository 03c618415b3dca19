"""The I/O half: wall clock, sockets, truth file and signals."""

import itertools
import math
import select
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import TextIO, final

from vehicle_sim.errors import InputError, SimulatorError
from vehicle_sim.links import Link
from vehicle_sim.simulation import STEP_US, Simulation

_HELLO_S = 0.05
_PATIENCE_S = 0.1
"""How long a wait may last before it looks whether it shall stop."""
_SLIP_S = 0.25
_AGAIN_S = 1.0
_STEPS_DEAF = 10
"""Steps at most before sockets are read again: a client's stream has no gaps of our making."""
_MAX_DATAGRAMS = 1000
"""Handled in one go: a flood does not stop the clock."""


@contextmanager
def stopping_on_signals() -> Iterator[Event]:
    """Set by SIGINT and SIGTERM, even where a shell started us with SIGINT ignored."""
    stop, ends = Event(), (signal.SIGINT, signal.SIGTERM)
    before = [(each, signal.signal(each, lambda *_: stop.set())) for each in ends]
    try:
        yield stop
    finally:
        for number, handler in before:
            signal.signal(number, handler)


@final
@dataclass(slots=True, kw_only=True, eq=False)
class Station:
    """One vehicle, the links that it is on, in its own order, and where its truth is written."""

    simulation: Simulation
    links: Sequence[Link]
    truth: TextIO | None = None

    def send(self) -> None:
        """What is due."""
        by_link: dict[int, list[bytes]] = {}
        for number, frame in self.simulation.take_frames():
            by_link.setdefault(number, []).append(frame)
        for number, frames in by_link.items():
            self.links[number].send(frames)

    def write(self) -> list[str]:
        """New lines of truth; returns what a person watching would want to know."""
        lines, notices = self.simulation.take_truth(), self.simulation.take_notices()
        if self.truth is not None:
            try:
                self.truth.writelines(f"{line}\n" for line in lines)
            except OSError as error:  # a full disk does not end a flight
                notices.append(f"{self.truth.name} stopped: {error.strerror or error}")
                self.truth = None
        return notices


@final
@dataclass(slots=True, kw_only=True, eq=False)
class Server:
    """Runs one simulation or several against their links until it is over."""

    stations: Sequence[Station]
    stop: Event = field(default_factory=Event)
    """Set by whoever wants it to end."""
    say: Callable[[str], None] = lambda _: None
    lockstep: bool = False
    speedup: float = 1.0
    duration_s: float = math.inf
    """Simulated time after which to end."""
    strict: bool = False
    """End with an error when something came in that the real autopilot does not survive."""
    first_heartbeat_s: float = 60.0
    """Wall time that lockstep waits for the companions at the start."""
    silence_s: float = 30.0
    """Wall time without a word from a companion after which lockstep gives up."""

    _heard: dict[Link, list[tuple[Simulation, int]]] = field(init=False, default_factory=dict)
    """Who hears what comes in by a link, and as which of its own links."""

    def __post_init__(self) -> None:
        for station in self.stations:
            for number, link in enumerate(station.links):
                self._heard.setdefault(link, []).append((station.simulation, number))

    def run(self) -> float:
        """Fly; returns the wall time that the flying took, in seconds."""
        try:
            return self._lockstep() if self.lockstep else self._real_time()
        finally:
            self._write()

    @property
    def _simulations(self) -> list[Simulation]:
        return [station.simulation for station in self.stations]

    def _flying(self) -> list[Simulation]:
        """Those whose time is not over and whose companion, in lockstep, has not ended.

        The clock of a vehicle whose companion has ended stands, so each is asked for its own.
        """
        if self.stop.is_set():
            return []
        until_us = self.duration_s * 1e6
        return [
            each
            for each in self._simulations
            if each.now_us < until_us and not (self.lockstep and each.companion_ended)
        ]

    # --- out and in ---------------------------------------------------------------------------

    def send(self) -> None:
        """All frames that are due."""
        for station in self.stations:
            station.send()

    def _write(self) -> None:
        """Truth to its files, notices to the terminal."""
        for station in self.stations:
            for notice in station.write():
                self.say(notice)
            if self.strict and station.simulation.not_survived is not None:
                raise SimulatorError(station.simulation.not_survived)

    def receive(self, wait_s: float = 0.0) -> None:
        """Handle what has come, waiting so long for the first."""
        ready, _, _ = select.select(self._heard, [], [], max(wait_s, 0.0))
        for link, hearers in self._heard.items() if ready else ():
            for _ in range(_MAX_DATAGRAMS):
                if (datagram := link.receive()) is None:
                    break
                for simulation, number in hearers:
                    simulation.receive(number, datagram)

    # --- lockstep -----------------------------------------------------------------------------

    def _lockstep(self) -> float:
        self._ask(self._simulations)
        self.wait(_HELLO_S, self.first_heartbeat_s)
        for simulation in self._simulations:
            simulation.begin()
        start_s = time.monotonic()
        while self._flying():
            asked = False
            while not asked and (flying := self._flying()):
                for number, simulation in enumerate(flying):
                    if simulation.step():
                        simulation.ask_for_sync(number)
                        asked = True
            self.send()
            self._write()
            self.wait(_AGAIN_S, self.silence_s)
        return time.monotonic() - start_s

    def wait(
        self, every_s: float, patience_s: float, meanwhile: Callable[[], object] = lambda: None
    ) -> None:
        """Handle messages until no vehicle waits for its companion; vehicle time is stopped.

        Each that does asks again every so often: it may have been lost, or its client has changed.
        """
        begun_s = asked_s = time.monotonic()
        while not self.stop.is_set():
            waiting = [each for each in self._simulations if each.waits]
            if not waiting:
                return
            meanwhile()
            self.receive(min(every_s, _PATIENCE_S))
            now_s = time.monotonic()
            if now_s - begun_s >= patience_s:
                raise SimulatorError(_silence(waiting[0], patience_s))
            if now_s - asked_s >= every_s:
                asked_s = now_s
                self._ask(waiting)

    def _ask(self, simulations: Sequence[Simulation]) -> None:
        for each in simulations:
            each.ask_again()
        self.send()

    # --- real time ----------------------------------------------------------------------------

    def _real_time(self) -> float:
        us_per_s = self.speedup * 1e6
        start_s = origin_s = time.monotonic()  # origin: wall time of vehicle time 0, kept to
        while self._flying():
            behind_us = (time.monotonic() - origin_s) * us_per_s
            behind_us -= self.stations[0].simulation.now_us  # all of them have the same
            if behind_us > _SLIP_S * us_per_s:  # too slow a computer: let time slip
                origin_s += (behind_us - STEP_US) / us_per_s
                behind_us = STEP_US
            for k in itertools.count(1):
                if behind_us < STEP_US or not (flying := self._flying()):
                    break
                for simulation in flying:
                    simulation.step()
                behind_us -= STEP_US
                self.send()
                if k % _STEPS_DEAF == 0:
                    self.receive()
            self._write()
            self.receive((STEP_US - behind_us) / us_per_s)
            self.send()
        return time.monotonic() - start_s


def _silence(simulation: Simulation, waited_s: float) -> str:
    """What is said of a companion that keeps a vehicle waiting."""
    if simulation.companion is None:
        return f"no heartbeat from a companion within {waited_s:.0f} s"
    return (
        f"no answer to TIMESYNC within {waited_s:.0f} s, at {simulation.now_us * 1e-6:.1f} s of "
        "vehicle time: in lockstep it has to come, and its tc1 to echo ts1"
    )


@contextmanager
def truth_file(folder: Path | None, name: str) -> Iterator[TextIO | None]:
    """FOLDER/NAME, empty, written line by line; None without a folder.  Raises InputError."""
    if folder is None:
        yield None
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / name).open("a", buffering=1, encoding="utf-8", newline="\n")
    except OSError as error:
        rule = f"cannot be written to ({error.strerror})"
        raise InputError("--out", str(folder), rule, "Name another folder.") from None
    try:
        if file.tell():
            rule = f"has the {name} of another flight"
            raise InputError("--out", str(folder), rule, "Name another folder.")
        yield file
    finally:
        with suppress(OSError):  # of a full disk it has been told
            file.close()
