"""Fault scripts drawn at random: what goes wrong, when, how badly and for how long.

A script is a function of (family, seed, index) and of the vehicle.  It is a timeline of the
simulator's (docs/reference/faults.md), whose rows say in which ways a fault is drawn.
"""

import re
from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from companion.campaign.in_process import simulator
from companion.mavlink.autopilots import named
from companion.mission.events import Mode

FAMILIES: Final = ("single", "combined")
"""One thing after the other from a list; two or three of them."""
_FROM_S: Final = 35.0
"""About when vehicles are in the air."""
_UNTIL_S: Final = {"copter": 110.0, "plane": 140.0}
_PLANES_SIZE: Final = 3.5
"""Of fences and distances: planes need more room."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FaultScript:
    """Which one of a family."""

    family: str
    seed: int
    index: int

    def __str__(self) -> str:
        return f"{self.family}-{self.seed}/{self.index}"


class Way(NamedTuple):
    """In which a fault is drawn: lines of a timeline, one after the other, from some moment on."""

    number: int
    """Its place among all."""
    line: str
    """Words of the fault and further lines, as vehicle_sim/faults.py `Drawn` says."""
    name: str
    not_on: str
    """Who cannot have it: a vehicle, or the firmware of two."""


_NOTHING: Final = Way(30, "", "nothing", "")
"""Among so many flights some in which nothing goes wrong."""
_RANGE: Final = re.compile(r"(-?[\d.]+)\.\.([\d.]+)([LV]?)")
_CHOICE: Final = re.compile(r"\[([^]]*)\]")


def drawn(script: FaultScript, vehicle: str, speed_m_s: float) -> tuple[str, str]:
    """What it is called, and its timeline.  vehicle: `ardupilot-copter`, ..."""
    lines_of = {w.name: w.line for w in ways() if not (w.not_on and vehicle.startswith(w.not_on))}
    names = list(lines_of)
    rng = np.random.default_rng((FAMILIES.index(script.family), script.seed, script.index))
    chosen = [names[script.index % len(names)]]
    if script.family == "combined":
        chosen = list(rng.choice(names, int(rng.integers(2, 4)), replace=False))
    lines = [line for name in chosen for line in _lines(lines_of[name], vehicle, speed_m_s, rng)]
    return " + ".join(chosen), "\n".join(lines)


def ways() -> list[Way]:
    """All of them, in order."""
    return sorted([*map(Way._make, simulator().ways()), _NOTHING])


def _lines(row: str, vehicle: str, speed_m_s: float, rng: np.random.Generator) -> list[str]:
    autopilot, kind = vehicle.split("-")
    strategy, size = named(autopilot, kind), 1.0 if kind == "copter" else _PLANES_SIZE
    returns, guided = (
        f"176 1 {' '.join(map(str, strategy.modes.asked(mode)))} to_autopilot"
        for mode in (Mode.RETURN, Mode.GUIDED)
    )
    if strategy.traits.needs_setpoints_before_offboard:
        guided = "193 1"  # it is told to continue: the autopilot would refuse the mode
    gale = "9.0" if kind == "copter" else "7.0"
    row = row.format(gale=gale, returns=returns, guided=guided)

    def number(match: re.Match[str]) -> str:
        low, high, scale = match.groups()
        value = {"": 1.0, "L": size, "V": speed_m_s}[scale] * rng.uniform(float(low), float(high))
        return f"{value:.{len(high.partition('.')[2])}f}"

    at_s, lines = rng.uniform(_FROM_S, _UNTIL_S[kind]), list[str]()
    row = _CHOICE.sub(lambda match: str(rng.choice(match[1].split("|"))), row)
    for line in filter(None, _RANGE.sub(number, row).split("; ")):
        after, _, what = " ".join(line.split()).rpartition(": ")
        what, lasts, length = what.partition(" for ")
        later_s = float(after.split()[1]) if after else 0.0
        lines.append(f"at {at_s + later_s:.1f} s{lasts}{length}: {what}")
    return lines
