"""A companion on UDP, processes and servers that end with the test."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from clients import Client, Process, Running, udp_client


@pytest.fixture
def companion() -> Iterator[Client]:
    with udp_client() as client:
        yield client


@pytest.fixture
def start() -> Iterator[Callable[..., Process]]:
    """Start vehicle-sim with these arguments; whatever still runs afterwards is killed."""
    with ExitStack() as stack:

        def begin(*arguments: object, **keywords: Any) -> Process:
            process = stack.enter_context(Process(*arguments, **keywords))
            stack.callback(process.kill)
            return process

        yield begin


@pytest.fixture
def serve() -> Iterator[Callable[..., Running]]:
    """Serve so many vehicles until the test ends."""
    with ExitStack() as stack:

        def begin(endpoints: str, count: int = 1, **settings: Any) -> Running:
            running = Running(endpoints, count, **settings)
            stack.callback(running.end)
            return running

        yield begin
