"""What the recordings do not say of themselves, and why rows differ: flights.toml, read once.

A row that does not agree and has no reason fails the suite, and so does a reason that no row of a
recording needs.
"""

import fnmatch
import functools
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import final

import msgspec

from vehicle_sim.conformance.log import Place, Recording

_FILE = Path(__file__).with_name("flights.toml")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """Seconds after the first record that are not compared."""

    begin_s: float
    end_s: float
    why: str


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """The simulated vehicle is put where the real one was, with its course and speed, once."""

    at_s: float
    """Seconds after the first record."""
    why: str


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """Something that was done to the simulator and not by a client's frame."""

    begin_s: float
    """Seconds after the first record, as is the end."""
    end_s: float
    what: str
    """As in a timeline file (faults/timeline.py)."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Reason:
    """Why some rows of some recordings do not agree."""

    recordings: str
    """Shell pattern of the file's name."""
    kind: str
    names: str
    """Regular expression for the whole name of the row."""
    why: str
    shown: str = ".*"
    """The same for what the simulated one shows."""
    most: float = math.inf
    """It explains differences up to so many tolerances."""

    def explains(self, kind: str, name: str, simulated: str, difference: float) -> bool:
        """Whether such a row of its recordings is one of them."""
        return (
            kind == self.kind
            and re.fullmatch(self.names, name) is not None
            and re.fullmatch(self.shown, simulated) is not None
            and difference <= self.most
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """The circumstances of one recording."""

    home: Place
    recording: str = ""
    """Name of its file."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()
    left_out: tuple[Stretch, ...] = ()
    placements: tuple[Placement, ...] = ()
    reasons: tuple[Reason, ...] = ()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Known:
    """The whole file."""

    flights: tuple[Flight, ...]
    reasons: tuple[Reason, ...]


@functools.cache
def _known() -> _Known:
    return msgspec.convert(tomllib.loads(_FILE.read_text(encoding="utf-8")), _Known)


def flight_of(recording: Recording) -> Flight:
    """What is known of this recording; of a strange one, what it says of itself."""
    known = _known()
    name = recording.name
    strange = Flight(home=recording.home, recording=name)
    flight = next((each for each in known.flights if each.recording == name), strange)
    reasons = tuple(r for r in known.reasons if fnmatch.fnmatchcase(name, r.recordings))
    return replace(flight, reasons=reasons)
