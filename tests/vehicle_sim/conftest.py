"""A companion on UDP, processes and servers that end with the test."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from clients import Client, Process, Running, udp_client
from harness import world

from vehicle_sim.links import open_link, parse_endpoint


@pytest.fixture
def companion() -> Iterator[Client]:
    with udp_client() as client:
        yield client


@pytest.fixture
def start() -> Iterator[Callable[..., Process]]:
    """Start vehicle-sim with these arguments; whatever still runs afterwards is killed."""
    running: list[Process] = []

    def begin(*arguments: object, **keywords: Any) -> Process:
        running.append(Process(*arguments, **keywords))
        return running[-1]

    yield begin
    for process in running:
        process.kill()
        process.communicate()


@pytest.fixture
def serve() -> Iterator[Callable[..., Running]]:
    """Serve so many vehicles with a radar, on one link or on one each ("A B"), until the test
    ends."""
    with ExitStack() as stack:

        def begin(endpoints: str, count: int = 1, **settings: Any) -> Running:
            links = [open_link(parse_endpoint(each)) for each in endpoints.split()]
            for link in links:
                stack.callback(link.close)
            scanner = {"component_id": 100, "range_m": 5000.0}
            tables = [world(scanner=scanner, system_id=k + 1) for k in range(count)]
            running = Running(tables, links, **settings)
            stack.callback(running.ended)
            stack.callback(running.stop.set)
            return running

        yield begin
