"""The I/O half: wall clock, sockets, truth file and signals."""

import itertools
import math
import select
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import TextIO, final

from vehicle_sim.errors import CompanionSilent, InputError, NotSurvived
from vehicle_sim.links import Link
from vehicle_sim.simulation import STEP_US, Simulation

_HELLO_S = 0.05
_PATIENCE_S = 0.1
"""How long a wait may last before it looks whether it shall stop."""
_SLIP_S = 0.25
_FLUSH_S = 0.1
"""Wall time: who follows the truth file sees what was."""
_AGAIN_S = 1.0
_STEPS_DEAF = 10
"""Steps at most before sockets are read again: a client's stream has no gaps of our making."""
_MAX_DATAGRAMS = 1000
"""Handled in one go: a flood does not stop the clock."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """How to run."""

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

    def write(self, *, flush: bool) -> list[str]:
        """New lines of truth; returns what is wrong with their file, which then gets no more."""
        lines, file = self.simulation.take_truth(), self.truth
        if file is None:
            return []
        try:
            file.writelines(f"{line}\n" for line in lines)
            if flush:
                file.flush()
        except OSError as error:
            self.truth = None
            return [f"{file.name} stopped: {error.strerror or error}"]
        return []


@final
class Server:
    """Runs one simulation or several against their links until it is over."""

    def __init__(
        self,
        stations: Sequence[Station],
        settings: Settings,
        stop: Event,
        *,
        say: Callable[[str], None],
    ) -> None:
        self._settings, self._stop, self._say = settings, stop, say
        self._stations = stations
        self._simulations = [station.simulation for station in stations]
        self._flush_s = 0.0
        self._heard: dict[Link, list[tuple[Simulation, int]]] = {}
        """Who hears what comes in by a link, and as which of its own links."""
        for station in stations:
            for number, link in enumerate(station.links):
                self._heard.setdefault(link, []).append((station.simulation, number))

    def run(self) -> float:
        """Fly; returns the wall time that the flying took, in seconds."""
        try:
            if self._settings.lockstep:
                return self._lockstep()
            return self._real_time()
        finally:
            self._write()

    def _timed_out(self, simulation: Simulation) -> bool:
        return simulation.now_us >= self._settings.duration_s * 1e6

    def _over(self) -> bool:
        return self._stop.is_set() or all(map(self._timed_out, self._simulations))

    def _flying(self) -> list[Simulation]:
        """In lockstep: whose companion still flies, and whose time is not over.

        The clock of a vehicle whose companion has ended stands, so each is asked for its own.
        """
        return [s for s in self._simulations if not (s.companion_ended or self._timed_out(s))]

    # --- out ----------------------------------------------------------------------------------

    def _send(self) -> None:
        for station in self._stations:
            station.send()

    def _write(self) -> None:
        """Truth to its files, notices to the terminal."""
        now_s = time.monotonic()
        if flush := now_s >= self._flush_s:
            self._flush_s = now_s + _FLUSH_S
        for station in self._stations:
            simulation, wrong = station.simulation, station.write(flush=flush)
            for notice in (*simulation.take_notices(), *wrong):
                self._say(notice)
            if self._settings.strict and simulation.not_survived is not None:
                raise NotSurvived(simulation.not_survived)

    # --- in -----------------------------------------------------------------------------------

    def _listen(self, wait_s: float) -> None:
        """Handle what is there, waiting so long for the first."""
        sockets = [each for link in self._heard for each in link.sockets]
        ready, _, _ = select.select(sockets, [], [], max(wait_s, 0.0))
        if ready:
            self._receive()

    def _receive(self) -> None:
        for link, hearers in self._heard.items():
            for _ in range(_MAX_DATAGRAMS):
                if (datagram := link.receive()) is None:
                    break
                for simulation, number in hearers:
                    simulation.receive(number, datagram)

    # --- lockstep -----------------------------------------------------------------------------

    def _lockstep(self) -> float:
        self._ask(self._simulations)
        self._await(_HELLO_S, self._settings.first_heartbeat_s)
        for simulation in self._simulations:
            simulation.begin()
        start_s = time.monotonic()
        while not self._stop.is_set() and self._flying():
            asked = False
            while not asked and not self._stop.is_set() and (flying := self._flying()):
                for number, simulation in enumerate(flying):
                    if simulation.step():
                        simulation.ask_for_sync(number)
                        asked = True
            self._send()
            self._write()
            self._await(_AGAIN_S, self._settings.silence_s)
        return time.monotonic() - start_s

    def _await(self, every_s: float, patience_s: float) -> None:
        """Handle messages until no vehicle waits for its companion; vehicle time is stopped."""
        begun_s = asked_s = time.monotonic()
        while not self._stop.is_set():
            waiting = [each for each in self._simulations if each.waits]
            if not waiting:
                return
            self._listen(min(every_s, _PATIENCE_S))
            now_s = time.monotonic()
            if now_s - begun_s >= patience_s:
                raise CompanionSilent(_silence(waiting[0], patience_s))
            if now_s - asked_s >= every_s:  # it may have been lost, or its client has changed
                asked_s = now_s
                self._ask(waiting)

    def _ask(self, simulations: Sequence[Simulation]) -> None:
        for each in simulations:
            each.ask_again()
        self._send()

    # --- real time ----------------------------------------------------------------------------

    def _real_time(self) -> float:
        speedup = self._settings.speedup
        start_s = origin_s = time.monotonic()  # origin: wall time of vehicle time 0, kept to
        while not self._over():
            behind_us = (time.monotonic() - origin_s) * speedup * 1e6
            behind_us -= self._simulations[0].now_us  # all of them have the same
            if behind_us > _SLIP_S * speedup * 1e6:  # too slow a computer: let time slip
                origin_s += (behind_us - STEP_US) / (speedup * 1e6)
                behind_us = STEP_US
            for k in itertools.count(1):
                if behind_us < STEP_US or self._over():
                    break
                for simulation in self._simulations:
                    simulation.step()
                behind_us -= STEP_US
                self._send()
                if k % _STEPS_DEAF == 0:
                    self._receive()
            self._write()
            self._listen((STEP_US - behind_us) / (speedup * 1e6))
            self._send()
        return time.monotonic() - start_s


def _silence(simulation: Simulation, waited_s: float) -> str:
    """What is said of a companion that keeps a vehicle waiting."""
    if simulation.companion is None:
        return f"no heartbeat from a companion within {waited_s:.0f} s"
    at_s, why = simulation.now_us * 1e-6, ""
    if simulation.mistaken:
        why = "; it answered TIMESYNC with a time of its own: in lockstep tc1 must echo ts1"
    return f"the companion was silent for {waited_s:.0f} s at {at_s:.1f} s vehicle time{why}"


@contextmanager
def truth_file(folder: Path | None, name: str) -> Iterator[TextIO | None]:
    """FOLDER/NAME, empty; None without a folder.  Raises InputError."""
    if folder is None:
        yield None
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / name).open("a", encoding="utf-8", newline="\n")
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
