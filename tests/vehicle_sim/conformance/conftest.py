"""The recorded flights, read once."""

import functools
from collections.abc import Callable

import pytest
from recordings import recording

from conformance import AGREED
from conformance.flights import Recording, read_recording


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "name" in metafunc.fixturenames:
        metafunc.parametrize(
            "name", [pytest.param(f, marks=pytest.mark.xdist_group(f)) for f in AGREED]
        )


@functools.cache
def _read(name: str) -> Recording:
    return read_recording(recording(name))


@pytest.fixture(scope="session")
def recorded() -> Callable[[str], Recording]:
    """The flight in the file of this name."""
    return _read
