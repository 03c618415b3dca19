"""Flights for tests: each looked at by many is flown once; none outlives the test that began it."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from flights import BAD_LINK, HILLS, RUNNING, Flight, launch


@pytest.fixture(autouse=True)
def _none_is_left_running() -> Iterator[None]:
    yield
    while RUNNING:
        RUNNING.pop().end()


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Any]:
    """Flights to their end, each flown once for all tests that look at it.

    by: flies it into a folder; world, mission and options are its arguments.
    """
    flights: dict[tuple[Any, ...], Any] = {}

    def fly(*arguments: Any, by: Callable[..., Any] = _to_its_end) -> Any:
        key = (by, *arguments)
        if key not in flights:
            flights[key] = by(tmp_path_factory.mktemp("flight") / "run", *arguments)
        return flights[key]

    return fly


def _to_its_end(folder: Path, *arguments: str) -> Flight:
    options = BAD_LINK if arguments[0] == HILLS else ()
    flight = launch(folder, *arguments, simulator_options=options)
    flight.wait()
    return flight
