"""A world for the tests, a companion on UDP, processes and servers that end with them."""

import copy
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from clients import Client, Process, Running, udp_client

from vehicle_sim.links import open_link, parse_endpoint

ORIGIN_DEG = (47.0, 8.0)
METRES_PER_DEG_NORTH = 111_181.0  # of the meridian near 47 N: the tests stay within 1 km of it
WORLD: dict[str, Any] = {
    "schema": 1,
    "name": "test",
    "origin": {"latitude_deg": ORIGIN_DEG[0], "longitude_deg": ORIGIN_DEG[1]},
    "terrain": {
        "combine": "maximum",
        "ground_amsl_m": 100.0,
        "peaks": [
            {
                "north_m": 3000.0,
                "east_m": 4000.0,
                "height_amsl_m": 1200.0,
                "spread_north_m": 600.0,
                "spread_east_m": 800.0,
            }
        ],
    },
    "radars": [
        {
            "name": "radar 1",
            "north_m": 5e3,
            "east_m": 6e3,
            "altitude_amsl_m": 0.0,
            "range_m": 1e3,
        }
    ],
    "vehicle": {
        "kind": "copter",
        "autopilot": "ideal",
        "system_id": 1,
        "north_m": 0.0,
        "east_m": 0.0,
        "heading_deg": 45.0,
        "speed_max_m_s": 170.0,
        "acceleration_max_m_s2": 10.0,
        "speed_vertical_max_m_s": 25.0,
        "acceleration_vertical_max_m_s2": 5.0,
        "parameters": {"GUID_TIMEOUT": 3.0},
    },
    "scanner": {"component_id": 100, "range_m": 5000.0},
}


def as_toml(table: dict[str, Any], path: str = "") -> str:
    """A table as TOML; its nested tables after its values."""
    lines, later = [], []
    for key, value in table.items():
        name = f"{path}{key}"
        if isinstance(value, dict):
            later.append(f"[{name}]\n{as_toml(value, name + '.')}")
        elif isinstance(value, list):
            later += [f"[[{name}]]\n{as_toml(item, name + '.')}" for item in value]
        else:
            text = f'"{value}"' if isinstance(value, str) else str(value).lower()
            lines.append(f"{key} = {text}")
    return "\n".join([*lines, *later]) + "\n"


@pytest.fixture
def world_table() -> dict[str, Any]:
    """A world as TOML gives it, to be changed at will."""
    return copy.deepcopy(WORLD)


@pytest.fixture
def world_file(tmp_path: Path) -> Path:
    path = tmp_path / "world.toml"
    path.write_text(as_toml(WORLD), encoding="utf-8")
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
