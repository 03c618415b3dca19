"""Companion and vehicle as processes of their own, over UDP, with a tap on the wire."""

import contextlib
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, final

from companion.campaign.drawn_world import DrawnWorld, write
from companion.mavlink.dialect import Message
from companion.mavlink.frames import decoded, frame_extent
from companion.mission.mission import AutopilotName

BIN = Path(sys.executable).parent
ROOT = Path(__file__).parents[2]
TO_COMPANION, TO_VEHICLE = 0, 1
Seen = Callable[[int, float, bytes], None]
"""Direction, time (monotonic seconds), datagram."""


def messages(datagram: bytes, *kinds: Any) -> Iterator[Message]:
    """The messages of these kinds in a datagram of whole frames."""
    wanted, at = {kind.id: kind for kind in kinds}, 0
    while at < len(datagram):
        end, number, _ = frame_extent(datagram, at)
        if number in wanted:
            yield decoded(datagram[at:end], wanted[number])
        at = end


def udp_socket() -> socket.socket:
    """Bound to a port of this machine that nobody uses."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind(("127.0.0.1", 0))
    return link


def start_vehicle(
    world: Path, port: int, *options: str, log: Path | None = None
) -> subprocess.Popen[bytes]:
    """vehicle-sim, in real time unless the options say otherwise."""
    command = [BIN / "vehicle-sim", world, "--connect", f"udpout:127.0.0.1:{port}", *options]
    return _start(command, log)


def start_companion(
    mission: Path, port: int, out: Path, *options: str, log: Path | None = None
) -> subprocess.Popen[bytes]:
    """companion fly, waiting for the vehicle on this port."""
    command = [BIN / "companion", "fly", mission, "--start", "--connect", f"udpin:127.0.0.1:{port}"]
    return _start([*command, "--out", out, *options], log)


def _start(command: list[Any], log: Path | None = None) -> subprocess.Popen[bytes]:
    with Path(log or os.devnull).open("ab") as where:
        return subprocess.Popen(
            list(map(str, command)), cwd=ROOT,
            stdin=subprocess.DEVNULL, stdout=where, stderr=subprocess.STDOUT,
        )  # fmt: skip


def end(process: subprocess.Popen[bytes]) -> None:
    """Make an end of it, if there has been none."""
    if process.poll() is None:
        process.kill()
    process.wait()


def fly_campaign(folder: Path, text: str, *options: str) -> Path:
    """A campaign file without its head, flown.  -> what it has written, in `folder`"""
    file, out = folder / "campaign.toml", folder / "campaign"
    file.write_text(f'schema = 1\nname = "bench"\n{text}', encoding="utf-8")
    command = [BIN / "companion", "campaign", "run", file, "--out", out, *options]
    subprocess.run(command, check=True, cwd=ROOT)
    return out


@final
class Tapped:
    """A drawn world flown by both programs; all end with the `with`."""

    def __init__(
        self, drawn: DrawnWorld, autopilot: AutopilotName, folder: Path, seen: Seen,
        *, rate_hz: float = 10.0,
    ) -> None:  # fmt: skip
        """seen: is told of every datagram.  rate_hz: of positions."""
        self._seen, self._peer = seen, ("127.0.0.1", 0)
        self._vehicle, self._companion = udp_socket(), udp_socket()
        with udp_socket() as free:
            self.port = int(free.getsockname()[1])
        rate = {"position_rate_hz": rate_hz}
        world, self.mission = write(drawn, folder, autopilot, rate)
        self.run, self.log = folder / "run", folder / "companion.log"
        self.vehicle = start_vehicle(world, int(self._vehicle.getsockname()[1]))
        self.start()

    def start(self, *options: str) -> None:
        """The companion, for the first time or once more."""
        self.companion = start_companion(self.mission, self.port, self.run, *options, log=self.log)

    def pump(self, seconds: float) -> None:
        """Pass on what comes within so long."""
        until_s = time.monotonic() + seconds
        while (left_s := until_s - time.monotonic()) > 0.0:
            for source in select.select([self._vehicle, self._companion], [], [], left_s)[0]:
                try:
                    data, sender = source.recvfrom(65535)
                except OSError:  # what was sent before has come to nobody
                    continue
                at_s, is_vehicle = time.monotonic(), source is self._vehicle
                self._peer = sender if is_vehicle else self._peer
                with contextlib.suppress(OSError):  # nobody there at the moment
                    if is_vehicle:
                        self._companion.sendto(data, ("127.0.0.1", self.port))
                    else:
                        self._vehicle.sendto(data, self._peer)
                self._seen(TO_COMPANION if is_vehicle else TO_VEHICLE, at_s, data)

    def last_printed(self) -> str:
        """The last of what the companion printed."""
        return self.log.read_text(encoding="utf-8")[-3000:]

    def __enter__(self) -> "Tapped":
        return self

    def __exit__(self, *_: object) -> None:
        end(self.companion)
        end(self.vehicle)
        self._vehicle.close()
        self._companion.close()
