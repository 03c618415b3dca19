"""Who looks at a flight does not slow it down: gaps between setpoints with 0, 1 and 5 readers.

    scripts/bench view [--speedup 4] [--seconds 60]

Real processes: the simulator, `companion fly --view`, and readers of its page that take all that a
browser is sent (without drawing it, which is another computer's work), at last one that never
reads.  One flight each; the gaps are those that `companion fly` notes itself, in run.json.
"""

import argparse
import json
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import viser
from rich.console import Console
from rich.table import Table
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

ROOT = Path(__file__).parents[2]
BIN = Path(sys.executable).parent
_HILLS = ROOT / "tests" / "closed_loop" / "hills"
_READERS = (
    ("no view", None, 0),
    ("0", 0, 0),
    ("1", 1, 0),
    ("5", 5, 0),
    ("1 that never reads", 0, 1),
)
_PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")
_STALLED_BYTES = 4096


def main() -> None:
    """A row for each number of readers."""
    parser = argparse.ArgumentParser(prog="scripts/bench view")
    parser.add_argument("--speedup", type=float, default=4.0)
    parser.add_argument("--seconds", type=float, default=60.0, help="of the wall clock, a flight")
    options = parser.parse_args()
    table = Table(
        "browsers", "setpoints", "gap p99.9, ms", "longest, ms", "position to setpoint p99"
    )
    for name, readers, stalled in _READERS:
        with tempfile.TemporaryDirectory() as folder:
            facts = _flown(Path(folder) / "run", readers, stalled, options)
        gaps = (f"{facts['gap_p99_9_ms']:.0f}", f"{facts['gap_max_ms']:.0f}")
        answers = f"{facts['position_to_setpoint_p99_ms']:.1f} ms"
        table.add_row(name, f"{facts['setpoints']:,}", *gaps, answers)
    Console(width=100).print(table)


def _flown(
    folder: Path, readers: int | None, stalled: int, options: argparse.Namespace
) -> dict[str, float]:
    """What a flight says of its times."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    view = () if readers is None else ("--view", "--view-port", "0")
    with ExitStack() as stack:
        simulator = [BIN / "vehicle-sim", _HILLS / "world.toml", "--speedup", str(options.speedup)]
        simulator += ["--connect", f"udpout:127.0.0.1:{port}"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        vehicle = stack.enter_context(subprocess.Popen(simulator, **quiet))
        stack.callback(vehicle.terminate)
        fly = [BIN / "companion", "fly", _HILLS / "mission.toml", "--out", folder, *view]
        fly += ["--connect", f"udpin:127.0.0.1:{port}"]
        flight = stack.enter_context(subprocess.Popen(fly, stdout=subprocess.PIPE, text=True))
        began_s = time.monotonic()
        if readers is not None:
            assert flight.stdout is not None
            found = re.search(r"view: http://(\S+?)/", flight.stdout.readline())
            assert found is not None
            for _ in range(readers):
                reader = threading.Thread(target=_read, args=(found[1],), daemon=True)
                reader.start()
            for _ in range(stalled):
                stack.enter_context(_stalled(found[1]))
        with suppress(subprocess.TimeoutExpired):
            flight.wait(max(began_s + options.seconds - time.monotonic(), 0.0))
        flight.send_signal(signal.SIGINT)
        flight.wait(30.0)
        latency: dict[str, float] = json.loads((folder / "run.json").read_bytes())["latency"]
        return latency


def _read(place: str) -> None:
    """Take all that a browser is sent."""
    with (
        suppress(ConnectionClosed),
        connect(f"ws://{place}/", subprotocols=[_PROTOCOL], max_size=None) as page,
    ):
        for _ in page:
            pass


def _stalled(place: str) -> socket.socket:
    """A browser that connects, and then reads nothing."""
    host, _, port = place.partition(":")
    link = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _STALLED_BYTES)
    link.connect((host, int(port)))
    lines = (
        "GET / HTTP/1.1",
        f"Host: {place}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
        "Sec-WebSocket-Version: 13",
        f"Sec-WebSocket-Protocol: {_PROTOCOL}",
    )
    link.sendall("\r\n".join([*lines, "", ""]).encode())
    return link


if __name__ == "__main__":
    main()
