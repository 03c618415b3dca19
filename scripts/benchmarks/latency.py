"""How long the companion thinks, and how even its stream is: real processes, real time, loaded.

    scripts/bench latency [--autopilot ardupilot|px4] [--rates 20 200] [--idle] [--json FILE]

vehicle-sim and `companion fly` run as processes over UDP with a tap between them, and one more
process keeps a core busy.  The tap tells when a position went in and when the setpoint that answers
it (it carries the position's time) came out, and how long the gaps of the stream are.  Beside it,
in the same run and through the same kind of socket, a bare echo answers as many datagrams of the
same size.  What the companion itself measured, from the datagram's arrival to the setpoint's
departure, stands in its run.json.
"""

import multiprocessing
import select
import socket
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, final

import numpy as np
import tapped
from pymavlink.dialects.v20 import all as wire
from running import Bar, Found, OneOf, main, most
from tapped import TO_COMPANION, Tapped, messages

from companion.campaign import families
from companion.mission.mission import AutopilotName

_POSITION = wire.MAVLink_global_position_int_message
_SETPOINT = wire.MAVLink_set_position_target_global_int_message
_PATIENCE_S = 400.0
_BARS_HZ = 20.0


@final
@dataclass(slots=True)
class Clock:
    """When positions went in and setpoints came out."""

    in_s: dict[int, float] = field(default_factory=dict)
    out_s: list[float] = field(default_factory=list)
    waits_s: list[float] = field(default_factory=list)

    def seen(self, way: int, at_s: float, datagram: bytes) -> None:
        kind = _POSITION if way == TO_COMPANION else _SETPOINT
        for message in messages(datagram, kind):
            if kind is _POSITION:
                self.in_s[message.time_boot_ms] = at_s
                continue
            self.out_s.append(at_s)
            asked_s = self.in_s.get(message.time_boot_ms)
            if asked_s is not None:
                self.waits_s.append(at_s - asked_s)


def echo(link: socket.socket) -> None:
    """Sends everything back."""
    while True:
        data, sender = link.recvfrom(2048)
        link.sendto(data, sender)


def busy() -> None:
    """Keeps a core."""
    number = 1
    while True:
        number = number * 16807 % 2147483647


@final
class Echo:
    """Asks the bare echo as often as positions come in, and times its answers."""

    def __init__(self, port: int, rate_hz: float) -> None:
        self.link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.link.connect(("127.0.0.1", port))
        self.link.setblocking(False)
        self.waits_s: list[float] = []
        self._period_s, self._next_s, self._asked_s = 1.0 / rate_hz, 0.0, 0.0

    def work(self) -> None:
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s, self._asked_s = now_s + self._period_s, now_s
            self.link.send(bytes(40))
        while select.select([self.link], [], [], 0.0)[0]:
            self.link.recv(2048)
            self.waits_s.append(time.monotonic() - self._asked_s)


def measure(
    autopilot: AutopilotName, rate_hz: float, folder: Path, *, loaded: bool
) -> dict[str, Any]:
    """One mission at this rate of positions: times in seconds."""
    drawn = families.world("short-copter", 1, 1)
    clock, link = Clock(), tapped.udp_socket()
    helpers = [multiprocessing.Process(target=echo, args=(link,), daemon=True)]
    helpers += [multiprocessing.Process(target=busy, daemon=True)] if loaded else []
    asker = Echo(link.getsockname()[1], rate_hz)
    began_s = time.monotonic()
    with Tapped(drawn, autopilot, folder, clock.seen, rate_hz=rate_hz) as pair:
        try:
            for helper in helpers:
                helper.start()
            while pair.companion.poll() is None and time.monotonic() - began_s < _PATIENCE_S:
                pair.tap.pump(0.25 / rate_hz)
                asker.work()
            code = pair.companion.poll()
        finally:
            for helper in helpers:
                helper.kill()
            link.close()
            asker.link.close()
    if code != 0:
        raise SystemExit(f"the companion did not arrive ({code}):\n{pair.said()}")
    return {
        "rate_hz": rate_hz,
        "waits_s": clock.waits_s,
        "gaps_s": np.diff(clock.out_s).tolist(),
        "echo_s": asker.waits_s,
    }


def _ms(values: list[float], share: float) -> float | None:
    return 1e3 * float(np.quantile(values, share)) if values else None


def latency(
    autopilot: str = OneOf("ardupilot", "px4"),
    rates: tuple[float, ...] = (20.0, 200.0),
    idle: bool = False,
) -> Found:
    """One mission for each rate of positions; idle: the other core is left alone."""
    bars, found = list[Bar](), list[dict[str, Any]]()
    yield "Position in to setpoint out, a bare echo, gaps of the stream: ms"
    for rate_hz in rates:
        with tempfile.TemporaryDirectory() as folder:
            it = measure(autopilot, rate_hz, Path(folder), loaded=not idle)
        waits, gaps, echoes = it["waits_s"], it["gaps_s"], it["echo_s"]
        yield {
            "Hz|g": rate_hz,
            "setpoints": len(waits),
            "p50|.2f": _ms(waits, 0.5),
            "p99|.2f": _ms(waits, 0.99),
            "p99.9|.2f": _ms(waits, 0.999),
            "most|.2f": _ms(waits, 1.0),
            "echo p50|.2f": _ms(echoes, 0.5),
            "echo p99|.2f": _ms(echoes, 0.99),
            "echo p99.9|.2f": _ms(echoes, 0.999),
            "gap p50|.2f": _ms(gaps, 0.5),
            "gap p99.9|.2f": _ms(gaps, 0.999),
            "gap, most|.2f": _ms(gaps, 1.0),
        }
        if rate_hz == _BARS_HZ:
            gap_ms, wait_ms = 1e3 * np.quantile(gaps, 0.999), 1e3 * np.quantile(waits, 0.99)
            bars.append(most("gaps of the stream, 99.9 %, ms", gap_ms, 100.0))
            bars.append(most("position to setpoint, 99 %, ms", wait_ms, 5.0))
        found.append(it)
    yield found
    yield from bars


if __name__ == "__main__":
    main(latency)
