"""A companion on UDP, processes and servers that end with the test."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing

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
        yield lambda *how, **pipes: stack.enter_context(closing(Process(*how, **pipes)))


@pytest.fixture
def serve() -> Iterator[Callable[..., Running]]:
    """Serve so many vehicles until the test ends."""
    with ExitStack() as stack:
        yield lambda *how, **settings: stack.enter_context(closing(Running(*how, **settings)))
