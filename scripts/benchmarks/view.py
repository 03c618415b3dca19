"""What it takes to look at a flight: for who looks, and for the flight.

    scripts/bench view [--speedup 4] [--seconds 60]

First an hour's run folder is opened by `companion view` in chromium, without a graphics processor,
and its slider is dragged there and back.  Then the gaps between setpoints with 0, 1 and 5 readers.

Real processes: the simulator, `companion fly --view`, and readers of its page that take all that a
browser is sent (without drawing it, which is another computer's work), at last one that never
reads.  One flight each; the gaps are those that `companion fly` notes itself, in run.json.
"""

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from argparse import Namespace
from contextlib import ExitStack, suppress
from pathlib import Path

import rich
import running
import viser
from playwright.sync_api import Page, sync_playwright
from tapped import BIN, ROOT, end, free_port, start_vehicle
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "telemetry"))
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "runtime"))
from recorded import record
from scripted_vehicle import Pair, Vehicle

from companion.config import load_mission, mission_text
from companion.session import Session
from companion.telemetry.inputs import HEADER, packed

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
_BACK_AND_FORTH = "".join(
    f"\n[[targets]]\nnorth_m = {there}\neast_m = {there}\n" for there in (0.0, 1e5, 0.0)
)
_LIMIT_S = 5000.0
_CHROMIUM = (
    *("--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--disable-background-networking"),
)
_COARSE = "fixedDpr=0.5"  # a quarter of the pixels, for want of a graphics processor
_DRAGGED_S = 10.0
_TIME_ROW = "tr:has(td:text-is('time'))"
_IS_READ = "!document.body.textContent.includes('the ground is read until')"
_READ_MS = 300_000.0
_COUNT = """() => {
    window.frames_drawn = 0; window.times_shown = new Set();
    const count = () => {
        window.frames_drawn += 1;
        const row = [...document.querySelectorAll("tr")].find(
            each => each.querySelector("td")?.textContent == "time");
        window.times_shown.add(row.textContent);
        requestAnimationFrame(count);
    };
    requestAnimationFrame(count);
}"""


def main() -> int:
    """A row for each number of readers."""
    seconds = (60.0, "of the wall clock, a flight")
    options, console = running.begin(__doc__, speedup=4.0, seconds=seconds)
    with tempfile.TemporaryDirectory() as folder:
        opened_s = _look_at(_hour(Path(folder)))
    headings = "setpoints", "gap p99.9, ms", "longest, ms", "position to setpoint p99, ms"
    table = running.figures("", "browsers", *headings)
    for name, readers, stalled in _READERS:
        with tempfile.TemporaryDirectory() as folder:
            facts = _flown(Path(folder) / "run", readers, stalled, options)
        keys = ("gap_p99_9_ms", "gap_max_ms", "position_to_setpoint_p99_ms")
        # a flight of a second or two sends no setpoints
        timing = ["none" if facts[key] is None else f"{facts[key]:.1f}" for key in keys]
        table.add_row(name, f"{facts['setpoints']:,}", *timing)
    console.print(table)
    bar = running.most("a flight of an hour is shown after, s", opened_s, 5.0)
    return running.ended(console, options.json, None, [bar])


def _hour(folder: Path) -> Path:
    """The run folder of a flight there and back across environment-1, flown in this process."""
    text = mission_text("environment-1") + _BACK_AND_FORTH
    file = folder / "mission.toml"
    file.write_text(text, encoding="utf-8")
    it = Pair(Session(load_mission(str(file)), seed=1, lockstep=True), Vehicle())
    it.run_until(lambda it: it.out.end is not None, _LIMIT_S)
    record(folder / "hour", it, text)
    (folder / "hour" / "inputs.msgpack").write_bytes(b"".join(packed([HEADER, *it.inputs])))
    print(f"a flight of {it.session.now_s / 60.0:.0f} minutes, {len(it.record):,} messages")
    return folder / "hour"


def _look_at(folder: Path) -> float:
    """Open a run folder in a browser, and drag its slider.  -> seconds until it was shown"""
    with sync_playwright() as playwright, ExitStack() as stack:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=list(_CHROMIUM)
        )
        stack.callback(browser.close)
        page = browser.new_page(viewport={"width": 1200, "height": 760})
        rich.get_console().quiet = True  # viser prints a box about itself
        bare = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        stack.callback(bare.stop)
        bare.gui.add_html("<table><tr><td>time</td></tr></table>")
        began_s = time.monotonic()
        _wait_for_row(page, f"http://127.0.0.1:{bare.get_port()}/")
        print(f"a bare page of viser is there after {time.monotonic() - began_s:.1f} s")
        began_s = time.monotonic()
        command = [BIN / "companion", "view", folder, "--view-port", "0"]
        view = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(view.terminate)
        assert view.stdout is not None
        address = view.stdout.readline().split()[1]
        served_s = time.monotonic() - began_s
        _wait_for_row(page, address)
        opened_s = time.monotonic() - began_s
        print(
            f"the flight is served after {served_s:.1f} s, shown after {opened_s:.1f} s; "
            f"companion view has computed {_processor_s(view.pid):.1f} s; "
            f"load {os.getloadavg()[0]:.1f}"
        )
        page.wait_for_function(_IS_READ, timeout=_READ_MS, polling=1000)
        print(f"all of its ground is read after {time.monotonic() - began_s:.1f} s")
        for name, is_dragged in (("at rest", False), ("dragged", True)):
            used_s = _processor_s(view.pid)
            frames_hz, places_hz = _watched(page, is_dragged=is_dragged)
            used_s = _processor_s(view.pid) - used_s
            print(
                f"slider {name}: {frames_hz:.1f} frames/s, {places_hz:.1f} moments shown/s, "
                f"{used_s / _DRAGGED_S:.0%} of a processor; load {os.getloadavg()[0]:.1f}"
            )
    return opened_s


def _wait_for_row(page: Page, address: str) -> None:
    page.goto(f"{address}?{_COARSE}")
    page.locator(_TIME_ROW).first.wait_for()


def _processor_s(pid: int) -> float:
    """What a process has computed so far."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _watched(page: Page, *, is_dragged: bool) -> tuple[float, float]:
    """Frames, and different moments of the flight, that the page shows in a second."""
    track = page.locator(".mantine-Slider-root").first.bounding_box()
    assert track is not None
    middle = track["y"] + 0.5 * track["height"]
    page.evaluate(_COUNT)
    began_s = time.monotonic()
    if is_dragged:
        page.mouse.move(track["x"] + 0.9 * track["width"], middle)
        page.mouse.down()
    while (passed_s := time.monotonic() - began_s) < _DRAGGED_S:
        if is_dragged:  # there and back in 4 s
            share = 0.1 + 0.8 * abs(1.0 - passed_s % 4.0 / 2.0)
            page.mouse.move(track["x"] + share * track["width"], middle)
        page.wait_for_timeout(10.0)
    page.mouse.up()
    shown = page.evaluate("[window.frames_drawn, window.times_shown.size - 1]")
    return shown[0] / passed_s, shown[1] / passed_s


def _flown(folder: Path, readers: int | None, stalled: int, options: Namespace) -> dict[str, float]:
    """What a flight says of its times."""
    port = free_port()
    view = () if readers is None else ("--view", "--view-port", "0")
    with ExitStack() as stack:
        speedup = ("--speedup", str(options.speedup))
        stack.callback(end, start_vehicle(_HILLS / "world.toml", port, *speedup))
        fly = [BIN / "companion", "fly", _HILLS / "mission.toml", "--start", "--out", folder, *view]
        fly += ["--connect", f"udpin:127.0.0.1:{port}"]
        flight = stack.enter_context(subprocess.Popen(fly, stdout=subprocess.PIPE, text=True))
        assert flight.stdout is not None
        if readers is not None:
            found = re.search(r"view: http://(\S+?)/", flight.stdout.readline())
            assert found is not None
            for _ in range(readers):
                reader = threading.Thread(target=_read, args=(found[1],), daemon=True)
                reader.start()
            for _ in range(stalled):
                stack.enter_context(_stalled(found[1]))
        flight.stdout.readline()  # it has begun: stopped before, it leaves no run.json
        with suppress(subprocess.TimeoutExpired):
            flight.wait(options.seconds)
        flight.send_signal(signal.SIGINT)
        flight.wait()
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
    sys.exit(main())
