"""Every fault that a timeline knows: how it is written, what it sets, what it does.

The faults are data: catalogue.table says how to read it.
"""

import functools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import final

from vehicle_sim.errors import did_you_mean
from vehicle_sim.faults.conditions import SIM_PARAMETERS, SIM_PARAMETERS_PX4
from vehicle_sim.geodesy import metres_per_degree
from vehicle_sim.parameters import Firmware, lines_of

Numbers = Mapping[str, float]
Words = Mapping[str, str]
Sets = dict[str, float]

_LIMITS = {
    "PERCENT": (0.0, 100.0),
    "SPEED": (0.0, 100.0),
    "GUST": (0.0, 50.0),
    "DIRECTION": (-360.0, 360.0),
    "ANGLE": (-90.0, 90.0),
    "DELAY": (0.0, 60_000.0),
    "LAG": (0.0, 5000.0),
    "JITTER": (0.0, 60_000.0),
    "LENGTH": (0.0, 100_000.0),
    "LENGTH2": (0.0, 100_000.0),
    "SIGMA": (0.0, 1000.0),
    "COUNT": (0.0, 50.0),
    "VOLTAGE": (0.0, 60.0),
    "RATE": (0.1, 100.0),
    "TURN": (-360.0, 360.0),
    "AHEAD": (-1e9, 1e9),
    "FLOOD": (0.1, 1000.0),
    "FRAME": (0.0, 255.0),
    "LINK": (0.0, 23.0),
    "VALUE": (-1e9, 1e9),
    "RADIUS": (0.1, 100_000.0),
    "COMMAND": (1.0, 65_535.0),
    "P1": (-1e9, 1e9),
    "P2": (-1e9, 1e9),
    "P3": (-1e9, 1e9),
}
_FOUR = "north|east|south|west"
_WORDS = {
    "SIDE": _FOUR,
    "SIDE2": _FOUR,
    "WHERE": f"{_FOUR}|up|down",
    "WHERE2": f"{_FOUR}|up|down",
    "WAY": "to_vehicle|from_vehicle",
    "SIGN": "either_way",
    "TO": "to_autopilot",
    "NAME": r"\w+",
}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
_TOKENS = re.compile(r"\[|\]|[^\s\[\]]+")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """What a line's meaning depends on."""

    firmware: Firmware
    latitude_deg: float


Make = Callable[[Numbers, Words, Context], float | None]
"""A value from the line's numbers and words; None: not to be set."""


@final
@dataclass(frozen=True, kw_only=True)
class Fault:
    """One kind of fault."""

    name: str
    form: str
    """What follows the name: CAPITALS are numbers or one of several words, [...] may be left out, a
    unit with a question mark too."""
    about: str
    values: Mapping[str, Make]
    """What it sets, by parameter."""
    once: bool = False
    """It happens at a moment and has no length."""
    only: Firmware | None = None

    @property
    def parameters(self) -> tuple[str, ...]:
        """All that it may set."""
        return tuple(self.values)

    def sets(self, numbers: Numbers, words: Words, context: Context) -> Sets:
        """The parameters that such a line sets, in order."""
        if "NAME" in words:
            return {words["NAME"].upper(): numbers["VALUE"]}
        made = {name: make(numbers, words, context) for name, make in self.values.items()}
        return {name: value for name, value in made.items() if value is not None}

    @property
    def usage(self) -> str:
        """How it is written."""
        tokens = _TOKENS.findall(self.form)
        words = [_WORDS[t] if t in _WORDS and t != "NAME" else t.rstrip("?") for t in tokens]
        return " ".join([self.name, *words]).replace("[ ", "[").replace(" ]", "]")

    @functools.cached_property
    def pattern(self) -> re.Pattern[str]:
        """The whole text of the fault, with a group for each placeholder."""
        parts, after_number = [re.escape(self.name)], False
        for token in _TOKENS.findall(self.form):
            space = r"\s*" if after_number else r"\s+"
            after_number = token in _LIMITS
            if token in "[]":
                parts.append("(?:" if token == "[" else ")?")
            elif token in _LIMITS:
                parts.append(rf"{space}(?P<{token}>{_NUMBER})")
            elif token in _WORDS:
                parts.append(rf"{space}(?P<{token}>{_WORDS[token]})")
            elif token.endswith("?"):
                parts.append(rf"(?:{space}{re.escape(token[:-1])})?")
            else:
                parts.append(space + re.escape(token))
        return re.compile("".join(parts), re.I)

    @property
    def limits(self) -> Mapping[str, tuple[float, float]]:
        """Of each number in the form."""
        return {token: _LIMITS[token] for token in _TOKENS.findall(self.form) if token in _LIMITS}

    def objection(self, words: Words, context: Context) -> tuple[str, str] | None:
        """What is wrong with a name that is set outright: rule and remedy."""
        if "NAME" not in words:
            return None
        table = SIM_PARAMETERS if context.firmware == "ardupilot" else SIM_PARAMETERS_PX4
        known = [row.name for row in table]
        name = words["NAME"].upper()
        if name in known:
            return None
        remedy = did_you_mean(name, known, "Choose one that begins with SIM_.")
        return f"{context.firmware} has no such parameter", remedy


_UNIT = {
    "north": (1.0, 0.0, 0.0),
    "south": (-1.0, 0.0, 0.0),
    "east": (0.0, 1.0, 0.0),
    "west": (0.0, -1.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
}


def _along(axis: int) -> Callable[[Numbers, Words, Context], float]:
    """North (0), east (1) or up (2) of "20 m north 5 m east", or of a speed."""

    def made(numbers: Numbers, words: Words, _: Context) -> float:
        total = 0.0
        length = "SPEED" if "SPEED" in numbers else "LENGTH"
        for suffix in ("", "2"):
            word = words.get(f"WHERE{suffix}") or words.get(f"SIDE{suffix}")
            if word is not None:
                total += _UNIT[word.lower()][axis] * numbers[length + suffix]
        return total

    return made


def _degrees(axis: int) -> Make:
    """The same as degrees of latitude or longitude."""
    metres = _along(axis)
    return lambda n, words, to: metres(n, words, to) / metres_per_degree(to.latitude_deg)[axis]


def _way(_: Numbers, words: Words, __: Context) -> float:
    """Default: both ways, regardless of the state before."""
    return {"": 0.0, "to_vehicle": 1.0, "from_vehicle": 2.0}[words.get("WAY", "").lower()]


_NORTH, _EAST, _UP = (_along(axis) for axis in range(3))
_MADE: Mapping[str, Make] = {
    "north": _NORTH,
    "east": _EAST,
    "up": _UP,
    "down": lambda numbers, words, to: -_UP(numbers, words, to),
    "latitude": _degrees(0),
    "longitude": _degrees(1),
    "way": _way,
    # not named: all links
    "mask": lambda n, _words, _to: float(1 << round(n["LINK"])) if "LINK" in n else 0.0,
    "to_autopilot": lambda _n, words, _to: float("TO" in words),
    "either_way": lambda n, words, _to: -n["SIGMA"] if "SIGN" in words else n["SIGMA"],
}
"""The names of catalogue.table."""


def _make(text: str) -> Make:
    """How a value is made that is written there."""
    firmware, _, what = text.rpartition(":")
    if firmware:
        always = _make(what)
        return lambda n, words, to: always(n, words, to) if to.firmware == firmware else None
    if what in _MADE:
        return _MADE[what]
    name = what.rstrip("?")
    if name in _LIMITS:
        return lambda numbers, _words, _to: numbers.get(name, 0.0 if what != name else None)
    number = float(what)
    return lambda _numbers, _words, _to: number


def _fault(usage: str, sets: str, about: str) -> Fault:
    name, _, form = usage.partition(" ")
    pairs = [word.split("=") for word in sets.split()]
    return Fault(
        name=name,
        form=form,
        about=about,
        values={pair[0]: _make(pair[1]) for pair in pairs if len(pair) == 2},
        once=["once"] in pairs,
        only=next((firmware for firmware in _FIRMWARES if [f"only:{firmware}"] in pairs), None),
    )


_FIRMWARES: tuple[Firmware, ...] = ("ardupilot", "px4")
FAULTS: tuple[Fault, ...] = tuple(
    _fault(*(part.strip() for part in parts))
    for parts in lines_of("catalogue.table", separator="|", beside="faults")
)
"""In the order of the documentation."""

BY_NAME: Mapping[str, Fault] = {fault.name: fault for fault in FAULTS}
