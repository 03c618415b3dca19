"""Flights for tests: started on demand, or flown once and looked at by many."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from flights import Flight, Launch, launch


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Launch]:
    """Start flights that end with the test at the latest."""
    flights: list[Flight] = []

    def begin(*arguments: Any, name: str = "run", **keywords: Any) -> Flight:
        flights.append(launch(tmp_path / name, *arguments, **keywords))
        return flights[-1]

    yield begin
    for flight in flights:
        flight.kill()


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Launch]:
    """Flights to their end, each flown once for all tests that look at it."""
    flights: dict[tuple[str, ...], Flight] = {}

    def fly(*arguments: str) -> Flight:
        if arguments not in flights:
            flight = launch(tmp_path_factory.mktemp("flight") / "run", *arguments)
            flights[arguments] = flight
            flight.wait()
        return flights[arguments]

    yield fly
    for flight in flights.values():
        flight.kill()
