"""Every fault, and the timeline of those that are to come.

A fault is a row of the conditions, or of ONCE.  A timeline is text with one fault a line:

    # comments begin with a hash
    at 120 s for 30 s: gps_off
    at 60 s: wind 8 m/s from 270 deg turbulence 2 m/s
    at 3 min: estimator_reset 20 m north

Times are of the simulation, which a reboot of the autopilot does not begin again.  A fault lasts
`for` so long, or stays; of those that set the same condition the one that began last counts.
"""

import bisect
import functools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self, final

from vehicle_sim.conditions import (
    FIELDS,
    GROUPS,
    ROWS,
    SIM_PARAMETERS,
    SIM_PARAMETERS_PX4,
    Changes,
    Vector,
)
from vehicle_sim.errors import InputError, did_you_mean
from vehicle_sim.parameters import Firmware

_WAYS: Final = {
    "north": (1.0, 0.0, 0.0),
    "east": (0.0, 1.0, 0.0),
    "south": (-1.0, 0.0, 0.0),
    "west": (0.0, -1.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
}
_PATTERNS: Final = {
    "N": r"[-+]?(?:\d+\.?\d*|\.\d+)",
    "WHERE": "|".join(_WAYS),
    "SIDE": "north|east|south|west",
    "PARAMETER": r"\w+",
}
_FAR: Final = (0.0, 1e5)
_ANY: Final = (-1e9, 1e9)
Limits = tuple[float, float]


@final
@dataclass(frozen=True)
class Fault:
    """One kind of fault."""

    usage: str
    """How it is written, as the rows of the conditions say it."""
    about: str
    limits: Sequence[Limits] = ()
    """Least and most of each N."""
    fields: Sequence[tuple[str, str]] = ()
    """Group and field of the conditions that each N is; none: it happens once."""

    @property
    def name(self) -> str:
        """Its first word."""
        return self.usage.split()[0]

    @property
    def once(self) -> bool:
        """It happens at a moment and has no length."""
        return not self.fields and self.name != "set"

    @functools.cached_property
    def _pattern(self) -> re.Pattern[str]:
        """The whole text of the fault, with a group for each placeholder and each switch."""
        parts, space = list[str](), ""
        for k, token in enumerate(re.findall(r"\[|\]|[^\s\[\]]+", self.usage)):
            if token in "[]":
                parts.append("(?:" if token == "[" else ")?")
                continue
            kind = token if token in _PATTERNS else "switch" if "_" in token and k else ""
            text = _PATTERNS.get(token, token)
            parts.append(f"{space}(?P<{kind}{k}>{text})" if kind else space + re.escape(token))
            space = r"\s*" if token == "N" else r"\s+"  # "8m/s" is "8 m/s"
        return re.compile("".join(parts), re.I)

    def read(self, what: str, where: str) -> tuple[list[float | None], list[str]]:
        """Numbers (None: left out) and words of a text; InputError if it does not fit."""
        match = self._pattern.fullmatch(what)
        if match is None:
            raise InputError(where, what, f'reads "{self.usage}"', "Correct the line.")
        said = match.groupdict()
        numbers = [float(value) if value else None for key, value in said.items() if key[0] == "N"]
        for value, (least, most) in zip(numbers, self.limits, strict=True):
            if value is not None and not least <= value <= most:
                rule = f"{value:g} must lie from {least:g} to {most:g}"
                raise InputError(where, what, rule, "Correct the number.")
        return numbers, [value.lower() for key, value in said.items() if value and key[0] != "N"]

    def changes(self, numbers: Sequence[float | None], words: Sequence[str]) -> Changes:
        """What such a line asks for; what it leaves out is as usual."""
        group, first = self.fields[0]
        usual = GROUPS[group]()
        if " WHERE" in self.usage:
            return {group: {first: vector(numbers, words)}}
        changed, is_switch = dict[str, Any](), ROWS[self.fields[0]].means is bool
        if is_switch:
            changed[first] = not getattr(usual, first)
        for (_, key), value in zip(self.fields[is_switch:], numbers, strict=True):
            changed[key] = getattr(usual, key) if value is None else ROWS[group, key].means(value)
        for switches in re.findall(r"\[(\w+_[\w|]+)\]", self.usage):
            for each in switches.split("|"):
                changed[each] = each in words if words else getattr(usual, each)
        return {group: changed}


def vector(numbers: Sequence[float | None], words: Sequence[str]) -> Vector:
    """North, east and up of "20 m north 5 m up"."""
    sizes = [size for size in numbers if size is not None]
    said = [(size, _WAYS[word]) for size, word in zip(sizes, words, strict=True)]
    north, east, up = (sum(size * way[axis] for size, way in said) for axis in range(3))
    return north, east, up


def _of_rows() -> Iterator[Fault]:
    """The faults that the conditions' rows are."""
    for (group, key), row in ROWS.items():
        if row.line:
            fields = [(group, each) for each in (key, *row.also)]
            limits = [ROWS[at][3:5] for at in fields[row.means is bool :]]
            if " WHERE" in row.line:
                limits *= row.line.count("WHERE")
            yield Fault(row.line, row.about, limits, fields)


# fmt: off
FAULTS: Final = (
    *_of_rows(),
    Fault("estimator_reset N m SIDE [N m SIDE]",
        "The estimator starts afresh, and its position jumps by this much.", (_FAR, _FAR)),
    Fault("origin_move N m WHERE [N m WHERE]",
        "The origin of the estimator's local frame moves by this much.", (_FAR, _FAR)),
    Fault("pilot",
        "The pilot takes the vehicle: the mode changes to the one that pilots hold it in."),
    Fault("reboot", "The autopilot starts again, wherever it is."),
    Fault("ground_command N [N] [N] [N] [to_autopilot]",
        "A ground station sends this MAV_CMD with these first parameters to the companion, or to "
        "the autopilot.", ((1.0, 65_535.0), _ANY, _ANY, _ANY)),
    Fault("ground_target N m SIDE [N m SIDE]",
        "A ground station gives the companion a target so far from where the vehicle is.",
        (_FAR, _FAR)),
    Fault("ground_fence N m [N m ahead]",
        "The vehicle's fence gets one more circle to stay out of, so far ahead of where it is.",
        ((0.1, 1e5), _FAR)),
    Fault("set PARAMETER N",
        "Any parameter whose name begins with SIM_, as if it had this value.", (_ANY,)),
)
# fmt: on
"""In the order of the documentation."""
BY_NAME: Final = {fault.name: fault for fault in FAULTS}


def faults_page() -> str:
    """docs/reference/faults.md."""
    rows = list[str]()
    for fault in FAULTS:
        usage = fault.usage.replace("|", r"\|")
        named = (ROWS[at].parameter for at in fault.fields)
        names = ", ".join(f"`{row.name}`" for row in named if row)
        rows.append(f"| `{usage}` | {names} | {fault.about} |\n")
    return _PAGE + "".join(rows)


_PAGE: Final = """# Faults

Made from `vehicle_sim/conditions.py` and `vehicle_sim/faults.py` by `scripts/docs`. A line of a
timeline reads `at TIME: FAULT` or `at TIME for TIME: FAULT`, with units (`ms`, `s`, `min`, `h`);
what happens once (from `estimator_reset` on) takes no `for`. N is a number, WHERE is north, east,
south, west, up or down, SIDE one of the first four; `[...]` may be left out. Of overlapping faults
the latest counts, and before parameters: a fault does not change them. On PX4 `SIM_GPS_USED` takes
the place of `SIM_GPS1_NUMSATS`; `battery_voltage` is ArduPilot's only.

| fault | parameters that do the same | what it does |
|---|---|---|
"""


# --- the timeline ---------------------------------------------------------------------------------

NEVER_US: Final = 2**63 - 1
_LINE: Final = re.compile(
    r"at\s+(?P<at>.+?)(?:\s+for\s+(?P<length>.+?))?\s*:\s*(?P<what>\S.*)", re.I
)
_TIME: Final = re.compile(rf"({_PATTERNS['N']})\s*(us|ms|s|min|h)?", re.I)
_UNIT_US: Final = {"us": 1.0, "ms": 1e3, "s": 1e6, "min": 60e6, "h": 3600e6}
_LONGEST_US: Final = 10**15


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One line."""

    at_us: int
    until_us: int = NEVER_US
    name: str
    changes: Changes
    """Of the conditions, while it lasts; none: it happens once."""
    values: Sequence[float] = ()
    """Of what happens once: its numbers (0: left out), and 1 for a switch; or its vector."""


@final
class Timeline:
    """Faults to come; one for each vehicle, for it remembers where it is."""

    def __init__(self, firmware: Firmware = "ardupilot") -> None:
        self._firmware = firmware
        self.entries: list[Entry] = []
        """Those that have not begun yet, in order of time."""
        self._lasting: list[Entry] = []
        self.next_us = NEVER_US
        """When something is due next: nothing is before."""

    @classmethod
    def parse(cls, text: str, *, name: str = "timeline", firmware: Firmware = "ardupilot") -> Self:
        """The timeline of this text; InputError names file (`name`), line and what is wrong."""
        timeline = cls(firmware)
        for number, raw in enumerate(text.splitlines(), start=1):
            if line := raw.partition("#")[0].strip():
                timeline._add(timeline._entry(line, f"{name}:{number}"))
        return timeline

    def add(self, line: str, now_us: int) -> None:
        """A fault from now on: a line without its time, as "gps_off" or "for 30 s: gps_off"."""
        length, colon, what = line.strip().rpartition(":")
        self._add(self._entry(f"at {now_us} us {length}{colon or ':'} {what}", "fault"))

    def _add(self, entry: Entry) -> None:
        bisect.insort(self.entries, entry, key=lambda each: each.at_us)
        self.next_us = min(self.next_us, entry.at_us)

    def step(self, now_us: int) -> list[Entry]:
        """Go on to this time of the simulation; returns what happens once, in order."""
        begun = bisect.bisect_right(self.entries, now_us, key=lambda each: each.at_us)
        new, self.entries = self.entries[:begun], self.entries[begun:]
        lasting = [*self._lasting, *(each for each in new if each.changes)]
        self._lasting = [each for each in lasting if each.until_us > now_us]
        ends = [each.until_us for each in self._lasting]
        self.next_us = min([each.at_us for each in self.entries[:1]] + ends, default=NEVER_US)
        return [each for each in new if not each.changes]

    @property
    def changes(self) -> list[Changes]:
        """Of the conditions, now: by each fault that lasts, the last begun last."""
        return [each.changes for each in self._lasting]

    def _entry(self, line: str, where: str) -> Entry:
        match = _LINE.fullmatch(line)
        if match is None:
            rule = 'reads "at TIME: FAULT" or "at TIME for TIME: FAULT"'
            raise InputError(where, line, rule, "Write for example: at 120 s for 30 s: gps_off.")
        at_us = _time_us(match["at"], where)
        length_us = NEVER_US if match["length"] is None else _time_us(match["length"], where)
        what = match["what"].strip()
        name = what.split()[0].lower()
        if (fault := BY_NAME.get(name)) is None:
            remedy = did_you_mean(name, BY_NAME, f"Choose from: {', '.join(BY_NAME)}.")
            raise InputError(where, name, "no such fault", remedy)
        if match["length"] is not None and fault.once:
            raise InputError(where, line, f"{fault.name} happens once", 'Leave out "for".')
        if length_us == 0:
            raise InputError(where, line, "lasts no time", "Write a longer time.")
        if (name, self._firmware) == ("battery_voltage", "px4"):
            rule = "battery_voltage is for ardupilot, and this is px4"
            raise InputError(where, line, rule, "Leave it out.")
        numbers, words = fault.read(what, where)
        if fault.once:
            is_vector = " SIDE" in fault.usage or " WHERE" in fault.usage
            known = [value or 0.0 for value in numbers] + [1.0] * len(words)
            values = vector(numbers, words) if is_vector else known
            return Entry(at_us=at_us, name=name, changes={}, values=values)
        is_set = fault.name == "set"
        changes = (
            self._set(words[0], numbers[0], where) if is_set else fault.changes(numbers, words)
        )
        until_us = min(at_us + length_us, NEVER_US)
        return Entry(at_us=at_us, until_us=until_us, name=name, changes=changes)

    def _set(self, parameter: str, value: float | None, where: str) -> Changes:
        """What a parameter asks for that has this value."""
        table = SIM_PARAMETERS if self._firmware == "ardupilot" else SIM_PARAMETERS_PX4
        rows = {row.name: row for row in table}
        if (row := rows.get(name := parameter.upper())) is None:
            remedy = did_you_mean(name, rows, "Choose one that begins with SIM_.")
            raise InputError(where, name, f"{self._firmware} has no such parameter", remedy)
        if not row.least <= (value or 0.0) <= row.most:
            rule = f"must lie from {row.least:g} to {row.most:g}"
            raise InputError(where, f"{name} {value:g}", rule, "Correct the number.")
        group, key = FIELDS[name]
        if (name, self._firmware) == ("SIM_GPS1_NUMSATS", "px4"):
            return {group: {}}  # SIM_GPS_USED counts
        return {group: {key: ROWS[group, key].means(value or 0.0)}}


def _time_us(text: str, where: str) -> int:
    match = _TIME.fullmatch(text.strip())
    if match is None:
        raise InputError(where, text, "is not a time", "Write for example 120 s.")
    if match[2] is None:
        raise InputError(where, text, "a time names its unit", f"Write {text.strip()} s.")
    time_us = round(float(match[1]) * _UNIT_US[match[2].lower()])
    if not 0 <= time_us <= _LONGEST_US:
        raise InputError(where, text, "lies outside the run", "Write a time from 0 s on.")
    return time_us
