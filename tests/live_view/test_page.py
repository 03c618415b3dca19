"""The page in a real browser: what it shows of a flight while it is flown, and what can be done."""

import io
import re
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from flights import HILLS, HILLS_MISSION, Flight, launch
from PIL import Image
from playwright.sync_api import Page, expect, sync_playwright

from companion.geodesy import FloatArray

_OPTIONS = (
    *("--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--disable-background-networking", "--mute-audio"),
)
_PATIENCE_MS = 60_000.0
_COARSE = "fixedDpr=0.5"  # a quarter of the pixels: there is no graphics processor
_SCENE = "canvas[data-engine]"  # the charts have canvases too
_ENDURING = ("--param", "BATT_CAPACITY=100000")
expect.set_options(timeout=_PATIENCE_MS)


@pytest.fixture(scope="module")
def blank(chromium: Path) -> Iterator[tuple[Page, list[str]]]:
    """The browser before anything is flown, and what its console says of errors.

    A busy machine may take a minute to start it.  All tests look at one page: without a graphics
    processor it draws one, never another.
    """
    errors = list[str]()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=list(_OPTIONS))
        page = browser.new_page(viewport={"width": 1000, "height": 640})
        page.set_default_timeout(_PATIENCE_MS)
        page.on("console", lambda told: errors.append(told.text) if told.type == "error" else None)
        page.on("pageerror", lambda error: errors.append(str(error)))
        yield page, errors
        browser.close()


@pytest.fixture(scope="module")
def flight(
    blank: tuple[Page, list[str]], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Flight]:
    """It flies, and its page shows it.

    In real time, four times: a vehicle that waits is somewhere else after a look at it.
    """
    folder = tmp_path_factory.mktemp("viewed") / "run"
    view = ("--view", "--view-port", "0")
    flying = launch(folder, HILLS, HILLS_MISSION, *view, clock=("--speedup", "4", *_ENDURING))
    address = flying.companion.expect(r"view: (\S+)").group(1)
    flying.companion.expect("taking off")
    blank[0].goto(f"{address}?{_COARSE}")
    expect(blank[0].get_by_text("flying", exact=True)).to_be_visible()
    yield flying
    flying.kill()


@pytest.fixture
def page(blank: tuple[Page, list[str]], flight: Flight) -> Page:
    """The page of the flight, which flies."""
    del flight
    return blank[0]


def row(page: Page, name: str) -> str:
    """What a row of the panel says."""
    return page.locator("tr", has_text=re.compile(f"^{name}")).first.inner_text()


def scene_rgb(page: Page) -> FloatArray:
    """The picture of the scene.  -> (3, rows, columns)."""
    picture = Image.open(io.BytesIO(page.locator(_SCENE).screenshot())).convert("RGB")
    return np.moveaxis(np.asarray(picture, dtype=np.float64), -1, 0)


def drawn(page: Page) -> dict[str, float]:
    """Shares of the pixels of the scene that can only be of one thing."""
    red, green, blue = scene_rgb(page)
    shares = {
        "path": (blue > red + 90.0) & (blue > green + 60.0),
        "radar": (red > green + 10.0) & (blue > green + 10.0),
        "proven ground": (red > blue + 12.0) & (green > blue + 4.0) & (red < green + 60.0),
        "unknown ground": (abs(red - green) < 8.0) & (abs(blue - green) < 10.0) & (red < 215.0),
    }
    return {name: float(those.mean()) for name, those in shares.items()}


def test_what_is_flown_is_on_the_page_and_changes(page: Page) -> None:
    expect(page.get_by_text("newest plan")).to_be_visible()
    before = row(page, "to go")
    expect(page.locator("tr", has_text=re.compile("^to go")).first).not_to_have_text(before)
    until_s = time.monotonic() + _PATIENCE_MS / 1e3
    while min((shares := drawn(page)).values()) < 2e-4:
        assert time.monotonic() < until_s, shares


def test_an_event_that_is_clicked_is_shown_where_it_happened_though_it_flies_on(
    page: Page,
) -> None:
    clock, shown = page.locator("tr", has_text=re.compile("^time")), ""
    for _ in range(3):  # the list moves on under a finger that is slow
        page.get_by_role("tab", name="events").press("Enter")
        line = page.get_by_role("button", name=re.compile(r"^\d+:\d\d ")).nth(5).inner_text()
        page.get_by_role("button", name=line, exact=True).first.press("Enter")
        page.get_by_role("tab", name="flight").press("Enter")
        shown = f"time{line.split()[0]}"
        with suppress(AssertionError):
            expect(clock).to_have_text(shown, timeout=_PATIENCE_MS / 3)
            break
    expect(clock).to_have_text(shown)
    page.get_by_role("button", name="newest").press("Enter")
    expect(clock).not_to_have_text(shown)


def test_the_console_of_the_browser_tells_of_no_error(
    page: Page, blank: tuple[Page, list[str]]
) -> None:
    page.get_by_role("button", name="play", exact=True).press("Enter")
    expect(page.get_by_role("button", name="pause", exact=True)).to_be_visible()
    assert blank[1] == []
