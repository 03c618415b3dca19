"""Flying by the wall clock or in lockstep; truth files and signals."""

import itertools
import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import TextIO, final

from vehicle_sim.errors import InputError, SimulatorError
from vehicle_sim.simulation import STEP_US, Simulation
from vehicle_sim.stations import Stations

_HELLO_S, _AGAIN_S = 0.05, 1.0
_SLIP_S = 0.25
_STEPS_DEAF = 10
"""Steps at most before sockets are read again: a client's stream has no gaps of our making."""


@contextmanager
def stopping_on_signals() -> Iterator[Event]:
    """Set by SIGINT and SIGTERM, even where a shell started us with SIGINT ignored."""
    stop, ends = Event(), (signal.SIGINT, signal.SIGTERM)
    before = [(number, signal.signal(number, lambda *_: stop.set())) for number in ends]
    try:
        yield stop
    finally:
        for number, handler in before:
            signal.signal(number, handler)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Server:
    """Runs one simulation or several against their links until it is over."""

    stations: Stations
    say: Callable[[str], None]
    lockstep: bool = False
    speedup: float = 1.0
    duration_s: float = math.inf
    """Simulated time after which to end."""
    strict: bool = False
    """End with an error when something came in that the real autopilot does not survive."""
    first_heartbeat_s: float = 300.0
    """Wall time that lockstep waits for the companions at the start: they may compile first."""
    silence_s: float = 30.0
    """Wall time without a word from a companion after which lockstep gives up."""

    def run(self) -> float:
        """Fly; returns the wall time that the flying took, in seconds."""
        try:
            return self._lockstep() if self.lockstep else self._real_time()
        finally:
            self._write()

    def _flying(self) -> list[Simulation]:
        """Those whose time is not over and whose companion, in lockstep, has not ended.

        The clock of a vehicle whose companion has ended stands, so each is asked for its own.
        """
        if self.stations.stop.is_set():
            return []
        until_us = self.duration_s * 1e6
        return [
            simulation
            for simulation in self.stations.simulations
            if simulation.now_us < until_us and not (self.lockstep and simulation.companion_ended)
        ]

    def _write(self) -> None:
        """Truth to its files, notices to the terminal."""
        for station in self.stations.all:
            simulation = station.simulation
            lines, notices = simulation.take_truth(), simulation.take_notices()
            if station.truth is not None:
                try:
                    station.truth.writelines(f"{line}\n" for line in lines)
                except OSError as error:  # a full disk does not end a flight
                    notices.append(f"{station.truth.name} stopped: {error.strerror or error}")
                    station.truth = None
            for notice in notices:
                self.say(notice)
            if self.strict and simulation.not_survived is not None:
                raise SimulatorError(simulation.not_survived)

    def _lockstep(self) -> float:
        stations = self.stations
        stations.wait(_HELLO_S, self.first_heartbeat_s)
        for simulation in stations.simulations:
            simulation.begin()
        start_s = time.monotonic()
        while self._flying():
            asked = False
            while not asked and (flying := self._flying()):
                for number, simulation in enumerate(flying):
                    if simulation.step():
                        simulation.ask_for_sync(number)
                        asked = True
            stations.send()
            self._write()
            stations.wait(_AGAIN_S, self.silence_s)
        return time.monotonic() - start_s

    def _real_time(self) -> float:
        stations, us_per_s = self.stations, self.speedup * 1e6
        start_s = origin_s = time.monotonic()  # origin: wall time of vehicle time 0, kept to
        while self._flying():
            behind_us = (time.monotonic() - origin_s) * us_per_s
            behind_us -= stations.simulations[0].now_us  # all of them have the same
            if behind_us > _SLIP_S * us_per_s:  # too slow a computer: let time slip
                origin_s += (behind_us - STEP_US) / us_per_s
                behind_us = STEP_US
            for k in itertools.count(1):
                if behind_us < STEP_US or not (flying := self._flying()):
                    break
                for simulation in flying:
                    simulation.step()
                behind_us -= STEP_US
                stations.send()
                if k % _STEPS_DEAF == 0:
                    stations.receive()
            self._write()
            stations.receive((STEP_US - behind_us) / us_per_s)
            stations.send()
        return time.monotonic() - start_s


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
