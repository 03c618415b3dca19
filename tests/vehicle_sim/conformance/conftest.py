"""The recorded flights, read once."""

import functools
from collections.abc import Callable

import pytest
from recordings import recording

from conformance.flights import Recording, read_recording

FILES = (
    "arducopter-gps-loss.tlog",
    "arducopter-guided-10mps.tlog",
    "arducopter-lidar.tlog",
    "arduplane-guided-reposition.tlog",
    "arducopter-guided-global-stream-faults.tlog",
    "px4-fixedwing-offboard.tlog",
    "px4-offboard-short.tlog",
    "px4-offboard-8mps.tlog",
    "px4-gps-loss.tlog",
)
"""Every third one of another autopilot."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "name" in metafunc.fixturenames:
        metafunc.parametrize(
            "name", [pytest.param(f, marks=pytest.mark.xdist_group(f)) for f in FILES]
        )


@functools.cache
def _read(name: str) -> Recording:
    return read_recording(recording(name))


@pytest.fixture(scope="session")
def recorded() -> Callable[[str], Recording]:
    """The flight in the file of this name."""
    return _read
