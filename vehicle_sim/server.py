"""The touching half: the only socket, the only clock, the truth file and the signals."""

import signal
import socket
import time
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO, final

from vehicle_sim.errors import CompanionSilent, InputError
from vehicle_sim.simulation import STEP_US, Simulation
from vehicle_sim.wire import datagrams

FIRST_HEARTBEAT_S = 60.0
SILENCE_S = 30.0
_HELLO_S = 0.2
_PATIENCE_S = 0.1
"""How long a wait may last before it looks whether it shall stop."""
_LARGEST_DATAGRAM_BYTES = 65535
_SLIP_S = 0.25
_FLUSH_US = 1_000_000


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """How to run."""

    host: str
    port: int
    lockstep: bool = False
    speedup: float = 1.0
    duration_s: float | None = None
    """Vehicle time after which to end; None: when told."""
    first_heartbeat_s: float = FIRST_HEARTBEAT_S
    """Wall time that lockstep waits for the companion at the start."""
    silence_s: float = SILENCE_S
    """Wall time without a word from the companion after which lockstep gives up."""


class Stop:
    """Whether somebody has asked to end."""

    requested = False

    def __call__(self, *_: object) -> None:
        """Be asked, as a signal handler is."""
        self.requested = True


@contextmanager
def stopping_on_signals() -> Iterator[Stop]:
    """Stop on SIGINT and SIGTERM, even where a shell started us with SIGINT ignored."""
    stop = Stop()
    before = [(s, signal.signal(s, stop)) for s in (signal.SIGINT, signal.SIGTERM)]
    try:
        yield stop
    finally:
        for number, handler in before:
            signal.signal(number, handler)


@final
class Link:
    """A UDP socket that sends to one address and hears only that."""

    def __init__(self, host: str, port: int) -> None:
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
            family, kind, protocol, _, address = found[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.connect(address)
        except OSError as error:
            rule = f"cannot be reached ({error.strerror})"
            remedy = "Name the host and port that the companion listens on."
            raise InputError("--connect", f"udpout:{host}:{port}", rule, remedy) from None
        self._timeout_s: float | None = None

    def __enter__(self) -> "Link":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: types.TracebackType | None,
    ) -> None:
        self._socket.close()

    def send(self, frames: list[bytes]) -> None:
        """Send these frames; nobody listening yet is no error."""
        for datagram in datagrams(frames):
            try:
                self._socket.send(datagram)
            except ConnectionRefusedError:
                self._resend(datagram)
            except OSError:
                return  # no route for the moment: as good as a lost datagram

    def _resend(self, datagram: bytes) -> None:
        """The refusal was about an earlier datagram and kept this one from being sent."""
        try:
            self._socket.send(datagram)
        except OSError:
            return

    def receive(self, timeout_s: float) -> bytes | None:
        """The next datagram, None if there is none in time."""
        if timeout_s != self._timeout_s:
            self._socket.settimeout(timeout_s)
            self._timeout_s = timeout_s
        try:
            return self._socket.recv(_LARGEST_DATAGRAM_BYTES)
        except (TimeoutError, BlockingIOError):
            return None
        except OSError:  # the refusal of an earlier datagram
            time.sleep(min(timeout_s, 0.01))
            return None


@final
class Server:
    """Runs a simulation against a link until it is over."""

    def __init__(
        self,
        simulation: Simulation,
        link: Link,
        settings: Settings,
        stop: Stop,
        *,
        truth: TextIO | None,
        say: Callable[[str], None],
    ) -> None:
        self._simulation = simulation
        self._link = link
        self._settings = settings
        self._stop = stop
        self._truth = truth
        self._say = say
        self._flush_us = 0

    def run(self) -> float:
        """Fly; returns the wall time that the flying took, in seconds."""
        try:
            if self._settings.lockstep:
                return self._lockstep()
            return self._real_time()
        finally:
            self._write()

    def _over(self) -> bool:
        duration_s = self._settings.duration_s
        timed_out = duration_s is not None and self._simulation.now_us >= duration_s * 1e6
        return self._stop.requested or timed_out

    def _write(self) -> None:
        """Truth to its file, notices to the terminal."""
        simulation = self._simulation
        lines = simulation.take_truth()
        if self._truth is not None and lines:
            try:
                self._truth.write("\n".join(lines) + "\n")
                if simulation.now_us >= self._flush_us:
                    self._truth.flush()
                    self._flush_us = simulation.now_us + _FLUSH_US
            except OSError as error:
                self._say(f"truth.jsonl stopped: {error}")
                self._truth = None
        for notice in simulation.take_notices():
            self._say(notice)

    # --- lockstep -----------------------------------------------------------------------------

    def _lockstep(self) -> float:
        simulation, link = self._simulation, self._link
        self._await_companion()
        simulation.begin()
        start_s = time.monotonic()
        while not (self._over() or simulation.companion_ended):
            while not simulation.step():
                pass
            question_ns = simulation.ask_for_sync()
            link.send(simulation.take_frames())
            self._write()
            self._await_answer(question_ns)
        return time.monotonic() - start_s

    def _await_companion(self) -> None:
        """Say hello until somebody says hello; vehicle time stands still."""
        simulation, link = self._simulation, self._link
        give_up_s = time.monotonic() + self._settings.first_heartbeat_s
        hello_s = 0.0
        while simulation.companion is None and not self._stop.requested:
            now_s = time.monotonic()
            if now_s >= give_up_s:
                waited_s = self._settings.first_heartbeat_s
                raise CompanionSilent(f"no heartbeat from a companion within {waited_s:.0f} s")
            if now_s >= hello_s:
                simulation.say_hello()
                link.send(simulation.take_frames())
                hello_s = now_s + _HELLO_S
            datagram = link.receive(_PATIENCE_S)
            if datagram is not None:
                simulation.receive(datagram)

    def _await_answer(self, question_ns: int) -> None:
        """Handle what comes until the answer to this question has come."""
        simulation, link, silence_s = self._simulation, self._link, self._settings.silence_s
        heard_s: float | None = None
        while simulation.answered_ns != question_ns:
            if self._stop.requested or simulation.companion_ended:
                return
            datagram = link.receive(_PATIENCE_S)
            if datagram is not None:
                simulation.receive(datagram)
                heard_s = None
                continue
            now_s = time.monotonic()
            heard_s = now_s - _PATIENCE_S if heard_s is None else heard_s
            if now_s - heard_s >= silence_s:
                at_s = simulation.now_us * 1e-6
                what = (
                    f"the companion was silent for {silence_s:.0f} s at {at_s:.1f} s vehicle time"
                )
                raise CompanionSilent(what)

    # --- real time ----------------------------------------------------------------------------

    def _real_time(self) -> float:
        simulation, link, speedup = self._simulation, self._link, self._settings.speedup
        simulation.say_hello()
        start_s = origin_s = time.monotonic()  # origin: wall time of vehicle time 0, kept to
        while not self._over():
            behind_us = (time.monotonic() - origin_s) * speedup * 1e6 - simulation.now_us
            if behind_us > _SLIP_S * speedup * 1e6:  # too slow a computer: let time slip
                origin_s += (behind_us - STEP_US) / (speedup * 1e6)
                behind_us = STEP_US
            while behind_us >= STEP_US and not self._over():
                simulation.step()
                behind_us -= STEP_US
                link.send(simulation.take_frames())
            self._write()
            self._listen((STEP_US - behind_us) / (speedup * 1e6))
            link.send(simulation.take_frames())
        return time.monotonic() - start_s

    def _listen(self, for_s: float) -> None:
        """Handle what comes in this time, and what is already there."""
        end_s = time.monotonic() + for_s
        wait_s = for_s
        while (datagram := self._link.receive(max(wait_s, 0.0))) is not None:
            self._simulation.receive(datagram)
            wait_s = end_s - time.monotonic()
            if wait_s < -_SLIP_S:  # a flood does not stop the clock
                return


@contextmanager
def truth_file(folder: Path | None) -> Iterator[TextIO | None]:
    """FOLDER/truth.jsonl, opened for writing; None without a folder."""
    if folder is None:
        yield None
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / "truth.jsonl").open("w", encoding="utf-8", newline="\n")
    except OSError as error:
        rule = f"cannot be written to ({error.strerror})"
        raise InputError("--out", str(folder), rule, "Name another folder.") from None
    with file:
        yield file
