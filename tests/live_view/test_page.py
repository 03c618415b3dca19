"""The page in a real browser: what it shows of a flight while it is flown, and what can be done.

The flight is recorded already, and its run folder grows as the tests say: nothing hangs on how
long a busy machine takes.
"""

import io
import re
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from golden import GOLDENS, run_folder_of
from PIL import Image
from playwright.sync_api import Page, expect, sync_playwright
from rich.console import Console

from companion.geodesy import FloatArray
from companion.live_view.command import started_view

_OPTIONS = (
    *("--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--disable-background-networking", "--mute-audio"),
)
_PATIENCE_MS = 60_000.0
_COARSE = "fixedDpr=0.5"  # a quarter of the pixels: there is no graphics processor
_SCENE = "canvas[data-engine]"  # the charts have canvases too
_GROWING = ("inputs.msgpack", "journal.jsonl", "flight.tlog")
expect.set_options(timeout=_PATIENCE_MS)
Grow = Callable[[float], None]
"""Record the flight on, to a share of it."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the flight is being recorded; nothing is yet."""
    return tmp_path_factory.mktemp("viewed")


@pytest.fixture(scope="module")
def grow(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Grow:
    whole = run_folder_of(GOLDENS / "copter-loses-gps", tmp_path_factory.mktemp("flown") / "run")
    shutil.copy(whole / "mission.toml", folder)

    def to(share: float) -> None:
        """Of the inputs more: the ground is read from them, and is shown once it has caught up."""
        for name in _GROWING:
            more = share + 0.1 * (name == "inputs.msgpack")
            data = (whole / name).read_bytes()[: round(more * (whole / name).stat().st_size)]
            with (folder / name).open("ab") as file:
                file.write(data[file.tell() :])

    return to


@pytest.fixture(scope="module")
def errors() -> list[str]:
    """What the console of the browser says of errors."""
    return []


@pytest.fixture(scope="module")
def page(chromium: Path, folder: Path, grow: Grow, errors: list[str]) -> Iterator[Page]:
    """The page of the flight, which flies.

    All tests look at one: without a graphics processor a browser draws one, never another.
    """
    said = Console(file=io.StringIO())
    with started_view(folder, 0, said), sync_playwright() as playwright:
        address = said.file.getvalue().split()[-1]
        browser = playwright.chromium.launch(executable_path=chromium, args=list(_OPTIONS))
        page = browser.new_page(viewport={"width": 1000, "height": 640})
        page.set_default_timeout(_PATIENCE_MS)
        page.on("console", lambda told: errors.append(told.text) if told.type == "error" else None)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(f"{address}?{_COARSE}")
        grow(0.65)
        expect(page.get_by_text("flying", exact=True)).to_be_visible()
        yield page
        browser.close()


def row(page: Page, name: str) -> str:
    """What a row of the panel says."""
    return page.locator("tr", has_text=re.compile(f"^{name}")).first.inner_text()


def drawn(page: Page) -> dict[str, float]:
    """Shares of the pixels of the scene that can only be of one thing."""
    picture = Image.open(io.BytesIO(page.locator(_SCENE).screenshot())).convert("RGB")
    rgb: FloatArray = np.asarray(picture, dtype=np.float64)
    red, green, blue = np.moveaxis(rgb, -1, 0)
    shares = {
        "path": (blue > red + 90.0) & (blue > green + 60.0),
        "radar": (red > green + 10.0) & (blue > green + 10.0),
        "proven ground": (red > blue + 12.0) & (green > blue + 4.0) & (red < green + 60.0),
        "unknown ground": (abs(red - green) < 8.0) & (abs(blue - green) < 10.0) & (red < 215.0),
    }
    return {name: float(those.mean()) for name, those in shares.items()}


def test_what_is_flown_is_on_the_page_and_changes(page: Page, grow: Grow) -> None:
    expect(page.get_by_text("newest plan")).to_be_visible()
    before = row(page, "to go")
    grow(0.75)
    expect(page.locator("tr", has_text=re.compile("^to go")).first).not_to_have_text(before)
    until_s = time.monotonic() + _PATIENCE_MS / 1e3
    while min((shares := drawn(page)).values()) < 2e-4:
        assert time.monotonic() < until_s, shares


def test_an_event_that_is_clicked_is_shown_where_it_happened_though_it_flies_on(
    page: Page, grow: Grow
) -> None:
    clock = page.locator("tr", has_text=re.compile("^time"))
    page.get_by_role("tab", name="events").press("Enter")
    line = page.get_by_role("button", name=re.compile(r"^\d+:\d\d ")).nth(5).inner_text()
    page.get_by_role("button", name=line, exact=True).first.press("Enter")
    page.get_by_role("tab", name="flight").press("Enter")
    shown = f"time{line.split()[0]}"
    expect(clock).to_have_text(shown)
    grow(0.85)
    expect(clock).to_have_text(shown)
    page.get_by_role("button", name="newest").press("Enter")
    expect(clock).not_to_have_text(shown)


def test_the_console_of_the_browser_tells_of_no_error(page: Page, errors: list[str]) -> None:
    page.get_by_role("button", name="play", exact=True).press("Enter")
    expect(page.get_by_role("button", name="pause", exact=True)).to_be_visible()
    assert errors == []
