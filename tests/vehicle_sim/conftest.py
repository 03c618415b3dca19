"""A world for the tests, a companion on UDP, processes and servers that end with them."""

import tomllib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from clients import Client, Process, Running, udp_client

from vehicle_sim.links import open_link, parse_endpoint

WORLD = """schema = 1
name = "test"
origin = { latitude_deg = 47.0, longitude_deg = 8.0 }
scanner = { component_id = 100, range_m = 5000.0 }
radars = [{ name = "radar 1", north_m = 5e3, east_m = 6e3, altitude_amsl_m = 0.0, range_m = 1e3 }]
terrain.ground_amsl_m = 100.0

[vehicle]
kind = "copter"
autopilot = "ideal"
acceleration_max_m_s2 = 10.0
speed_vertical_max_m_s = 25.0
acceleration_vertical_max_m_s2 = 5.0
"""


@pytest.fixture
def world_table() -> dict[str, Any]:
    """A world as TOML gives it, to be changed at will."""
    return tomllib.loads(WORLD)


@pytest.fixture
def world_file(tmp_path: Path) -> Path:
    path = tmp_path / "world.toml"
    path.write_text(WORLD, encoding="utf-8")
    return path


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
def serve(world_table: dict[str, Any]) -> Iterator[Callable[..., Running]]:
    """Serve the world, or some, by a link or by one each ("A B"), until the test ends."""
    with ExitStack() as stack:

        def begin(endpoints: str, *tables: dict[str, Any], **settings: Any) -> Running:
            links = [open_link(parse_endpoint(each)) for each in endpoints.split()]
            for link in links:
                stack.callback(link.close)
            running = Running(tables or [world_table], links, **settings)
            stack.callback(running.ended)
            stack.callback(running.stop.set)
            return running

        yield begin
