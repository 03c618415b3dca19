"""The simulator that campaigns fly: an entry point, for the companion imports none.

What may go wrong with its vehicles stands there, a row for each fault: how it is drawn, what its
line asks for, and by what a companion is judged then.
"""

import functools
from collections.abc import Mapping, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

from companion.errors import InputError
from companion.runtime.in_process import SimulatedVehicle


class Vehicle(SimulatedVehicle, Protocol):
    """One that flies in this process."""

    def take_truth(self) -> list[str]:
        """Where it really was since the last call: lines of JSON, after a header."""
        ...


class Known(Protocol):
    """By what a companion is judged, as `Known` in vehicle_sim/faults.py says."""

    excuse: str
    excuse_needs: str
    out_of_reach: bool
    may_fall: bool
    brings: str


class Fault(Protocol):
    """A kind of fault; `once`: it does not last."""

    name: str
    once: bool
    known: Known


class Happening(Protocol):
    """A line of a timeline, and what it asks for."""

    at_us: int
    until_us: int
    fault: Fault
    sets: Mapping[str, Any]


class Simulator(Protocol):
    """The module that an entry point in the group `companion.vehicles` names."""

    def vehicle(self, world: Path, *, seed: int, faults: str) -> Vehicle:
        """The vehicle of a world.toml, with a timeline of faults."""
        ...

    def entries(self, text: str) -> Sequence[Happening]:
        """The lines of a timeline."""
        ...

    def ways(self) -> Sequence[tuple[int, str, str, str]]:
        """Ways in which faults are drawn: `drawn_faults.Way`."""
        ...


@functools.cache
def simulator() -> Simulator:
    """The one that is installed; InputError if none is."""
    for point in entry_points(group="companion.vehicles"):
        found: Simulator = point.load()
        if hasattr(found, "ways"):  # of an older installation it is not the module
            return found
    rule, remedy = "no package brings one", "Install the project again: pip install ."
    raise InputError("companion.vehicles", None, rule, remedy)
