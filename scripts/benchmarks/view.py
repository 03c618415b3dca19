"""What it takes to look at a flight.

    scripts/bench view

An hour's run folder is opened by `companion view` in chromium, without a graphics processor, and
its slider is dragged there and back.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from playwright.sync_api import Page, sync_playwright
from running import Found, main, most
from tapped import BIN

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "telemetry"))
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "runtime"))
from recorded import record
from scripted_vehicle import Pair, Vehicle

from companion.config import load_mission, read_mission
from companion.session import Session
from companion.telemetry.inputs import HEADER, packed

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


def _hour(folder: Path) -> Path:
    """The run folder of a flight there and back across environment-1, flown in this process."""
    text = read_mission("environment-1").text + _BACK_AND_FORTH
    file = folder / "mission.toml"
    file.write_text(text, encoding="utf-8")
    it = Pair(Session(load_mission(str(file)), seed=1, lockstep=True), Vehicle())
    it.run_until(lambda it: it.out.end is not None, _LIMIT_S)
    record(folder / "hour", it, text)
    (folder / "hour" / "inputs.msgpack").write_bytes(b"".join(packed([HEADER, *it.inputs])))
    return folder / "hour"


def view() -> Found:
    """Open its run folder in a browser, and drag the slider."""
    with sync_playwright() as playwright, ExitStack() as stack:
        folder = _hour(Path(stack.enter_context(tempfile.TemporaryDirectory())))
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=list(_CHROMIUM)
        )
        stack.callback(browser.close)
        page = browser.new_page(viewport={"width": 1200, "height": 760})
        began_s = time.monotonic()
        command = [BIN / "companion", "view", folder, "--view-port", "0"]
        view = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(view.terminate)
        assert view.stdout is not None
        address = view.stdout.readline().split()[1]
        yield {"there after": "the flight, served", "s|.1f": time.monotonic() - began_s}
        page.goto(f"{address}?{_COARSE}")
        page.locator(_TIME_ROW).first.wait_for()
        opened_s = time.monotonic() - began_s
        yield {"there after": "the flight, shown", "s|.1f": opened_s}
        page.wait_for_function(_IS_READ, timeout=_READ_MS, polling=1000)
        yield {"there after": "all of its ground", "s|.1f": time.monotonic() - began_s}
        for slider, is_dragged in (("at rest", False), ("dragged", True)):
            frames_hz, places_hz = _watched(page, is_dragged=is_dragged)
            yield {
                "slider": slider,
                "frames/s|.1f": frames_hz,
                "moments shown/s|.1f": places_hz,
                "load|.1f": os.getloadavg()[0],
            }
    yield most("a flight of an hour is shown after, s", opened_s, 4.0)


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


if __name__ == "__main__":
    main(view)
