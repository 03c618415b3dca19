"""Compiled or not, an inner loop says the same; and it needs no place for a cache on disk."""

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest
from programs import ROOT

from vehicle_sim.compiled import compiled

_WARMED_UP = """
from pathlib import Path
from numba.core.event import install_recorder
from pymavlink.dialects.v20 import all as mavlink
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world

station = mavlink.MAVLink(None)
for name in ("street", "valley"):
    vehicle = Simulation(read_world(Path("companion/environments", name, "world.toml")))
    place = (round(1e7 * x) for x in (vehicle.vehicle.latitude_deg, vehicle.vehicle.longitude_deg))
    asked = station.terrain_request_encode(*place, 100, (1 << 56) - 1).pack(station)
    vehicle.warm_up()
    with install_recorder("numba:compile") as compiled:
        vehicle.receive(0, asked)
        for _ in range(120):
            vehicle.step()
    told = sum(frame[7:10] == b"\\x86\\0\\0" for _, frame in vehicle.take_frames())
    print(name, told, len(compiled.buffer))
"""


def test_what_has_warmed_up_compiles_nothing_in_flight(tmp_path: Path) -> None:
    """Silent for the seconds that it takes, a vehicle is given up: a first flight failed so."""
    cold = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    asked = (sys.executable, "-c", _WARMED_UP)
    said = subprocess.run(asked, check=True, capture_output=True, text=True, env=cold, cwd=ROOT)
    assert said.stdout.split() == ["street", "0", "0", "valley", "56", "0"]


def test_where_nothing_can_be_written_it_is_compiled_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    njit = numba.njit

    def without_disk(*functions: object, cache: bool = False) -> object:
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return njit(*functions)

    monkeypatch.setattr(numba, "njit", without_disk)

    @compiled()
    def twice(x: float) -> float:
        return 2.0 * x

    assert twice(3.0) == 6.0
