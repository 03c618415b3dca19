"""One flight of a campaign: what it is flown by, and what it left.

It leaves a journal and the truth, and only these are looked at afterwards.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from companion.mission.mission import Mission

_OVER = ("landing", "handing over", "done", "faulted")
"""Phases in which no subpath is flown any more."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FlightFiles:
    """What a flight is flown by; all that it writes is written into the folder."""

    world: Path
    mission: Path
    faults: str
    """A timeline, with when the companion is killed (`drawn_faults.split`)."""
    folder: Path
    drawn: str = ""
    """What the drawn faults are called."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """What a flight left."""

    mission: Mission
    journal: list[dict[str, Any]]
    truth: list[dict[str, Any]]
    plans_s: list[float]
    folder: Path
    """With the log of what was said, if it was recorded."""


def truth_of(folder: Path) -> list[dict[str, Any]]:
    """Where the vehicle really was: the rows without the header."""
    lines = (folder / "truth.jsonl").read_text(encoding="utf-8").splitlines()
    return [row for line in lines if "t_s" in (row := json.loads(line))]


def in_the_air(flight: Flight) -> list[dict[str, Any]]:
    """The truth while subpaths were flown.

    Until the vehicle is told to land or is let go.  Of a flight whose vehicle's clock began again,
    the whole time in the air.
    """
    rows = [row for row in flight.truth if not row["landed"]]
    begun_s = next((e["t_s"] for e in flight.journal if e["kind"] == "leg"), math.inf)
    over = (e["t_s"] for e in flight.journal if e.get("phase") in _OVER and e["t_s"] >= begun_s)
    until_s = next(over, math.inf)
    if until_s < math.inf:
        rows = [row for row in rows if begun_s <= row["t_s"] <= until_s]
    return rows
