"""The timeline: text with one fault a line, and what is due when.

    # comments begin with a hash
    at 120 s for 30 s: gps_off
    at 60 s: wind 8 m/s from 270 deg turbulence 2 m/s
    at 3 min: estimator_reset 20 m north

Times are of the simulation, which a reboot of the autopilot does not begin again.  A fault sets
SIM_ parameters.  One with `for` gives them back afterwards what they were before; where several
set the same parameter, the one that began last counts.  One without `for` stays.
"""

import bisect
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self, final

from vehicle_sim.errors import InputError, did_you_mean
from vehicle_sim.faults.catalogue import BY_NAME, FAULTS, Context, Fault, Line
from vehicle_sim.faults.conditions import value_of
from vehicle_sim.parameters import Firmware, Readable

NEVER_US = 2**63 - 1
_LINE = re.compile(r"at\s+(?P<at>.+?)(?:\s+for\s+(?P<length>.+?))?\s*:\s*(?P<what>\S.*)", re.I)
_TIME = re.compile(r"(?P<number>[-+]?(?:\d+\.?\d*|\.\d+))\s*(?P<unit>us|ms|s|min|h)?", re.I)
_UNIT_US = {"us": 1.0, "ms": 1e3, "s": 1e6, "min": 60e6, "h": 3600e6}
_LONGEST_US = 10**15
_FORM = 'reads "at TIME: FAULT" or "at TIME for TIME: FAULT"'
_EXAMPLE = "Write for example: at 120 s for 30 s: gps_off."
_NOTHING: tuple[tuple[str, float], ...] = ()
_ANYWHERE = Context(firmware="ardupilot", latitude_deg=0.0)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One line."""

    line: int
    at_us: int
    until_us: int | None
    """None: it stays, or happens once."""
    sets: Mapping[str, float]


@final
@dataclass(slots=True)
class _Layers:
    """Who sets one parameter now, and what it was before."""

    before: float
    active: list[tuple[int, float]] = field(default_factory=list)
    """Entry and value, the last begun last."""

    @property
    def value(self) -> float:
        return self.active[-1][1] if self.active else self.before


@final
class Timeline:
    """Faults to come; one for each vehicle, for it remembers where it is."""

    def __init__(self, entries: Sequence[Entry] = (), context: Context = _ANYWHERE) -> None:
        self._context = context
        self.entries: list[Entry] = []
        """In the order of their beginnings."""
        self._edges: list[tuple[int, int, int]] = []
        """What is still to come: time, 0 for an end and 1 for a beginning, which entry."""
        self._layers: dict[str, _Layers] = {}
        self.next_us = NEVER_US
        """When something is due next: nothing is before."""
        for entry in sorted(entries, key=lambda entry: (entry.at_us, entry.line)):
            self._add(entry)

    def _add(self, entry: Entry) -> None:
        which = len(self.entries)
        self.entries.append(entry)
        bisect.insort(self._edges, (entry.at_us, 1, which))
        if entry.until_us is not None:
            bisect.insort(self._edges, (entry.until_us, 0, which))
        self.next_us = self._edges[0][0]

    @classmethod
    def parse(
        cls,
        text: str,
        *,
        name: str = "timeline",
        firmware: Firmware = "ardupilot",
        latitude_deg: float = 0.0,
    ) -> Self:
        """The timeline of this text; InputError names file (`name`), line and what is wrong.

        The latitude is that of the flight: where metres east have to be said in degrees.
        """
        context = Context(firmware=firmware, latitude_deg=latitude_deg)
        entries = list[Entry]()
        for number, raw in enumerate(text.splitlines(), start=1):
            line = raw.partition("#")[0].strip()
            if line:
                entries.append(_entry(line, number, f"{name}:{number}", context))
        return cls(entries, context)

    def add(self, line: str, now_us: int) -> None:
        """A fault from now on: a line without its time, as "gps_off" or "for 30 s: gps_off"."""
        length, colon, what = line.strip().rpartition(":")
        text = f"at {now_us} us {length}{colon or ':'} {what}"
        self._add(_entry(text, len(self.entries) + 1, "fault", self._context))

    def step(self, now_us: int, parameters: Readable) -> Sequence[tuple[str, float]]:
        """What to set now (time of the simulation), given what the parameters are: in order."""
        if now_us < self.next_us:
            return _NOTHING
        touched = dict[str, None]()
        due = bisect.bisect_right(self._edges, (now_us, 2, 0))
        for _, begins, k in self._edges[:due]:
            for parameter, value in self.entries[k].sets.items():
                if begins:
                    self._begin(k, parameter, value, parameters)
                    touched[parameter] = None
                elif self._end(k, parameter):
                    touched[parameter] = None
        del self._edges[:due]
        self.next_us = self._edges[0][0] if self._edges else NEVER_US
        changes = [(parameter, self._layers[parameter].value) for parameter in touched]
        for parameter in touched:
            if not self._layers[parameter].active:
                del self._layers[parameter]
        return changes

    def _begin(self, k: int, name: str, value: float, parameters: Readable) -> None:
        layers = self._layers.get(name)
        if layers is None:
            layers = self._layers[name] = _Layers(value_of(parameters, name))
        if self.entries[k].until_us is None:  # it stays: nothing below it can show again
            layers.before = value
            layers.active.clear()
        else:
            layers.active.append((k, value))

    def _end(self, k: int, name: str) -> bool:
        """False if it was buried under one that stays."""
        layers = self._layers.get(name)
        kept = [] if layers is None else [item for item in layers.active if item[0] != k]
        if layers is None or len(kept) == len(layers.active):
            return False
        layers.active = kept
        return True


def _entry(line: str, number: int, where: str, context: Context) -> Entry:
    match = _LINE.fullmatch(line)
    if match is None:
        raise InputError(where, line, _FORM, _EXAMPLE)
    at_us = _time_us(match["at"], where)
    length_us = None if match["length"] is None else _time_us(match["length"], where)
    what = match["what"].strip()
    fault = _fault(what.split()[0], where)
    if length_us is not None and fault.once:
        raise InputError(where, line, f"{fault.name} happens once", 'Leave out "for".')
    if length_us == 0:
        raise InputError(where, line, "lasts no time", "Write a longer time.")
    if fault.only is not None and fault.only != context.firmware:
        rule = f"{fault.name} is for {fault.only}, and this is {context.firmware}"
        raise InputError(where, line, rule, "Leave it out.")
    return Entry(
        line=number,
        at_us=at_us,
        until_us=None if length_us is None else at_us + length_us,
        sets=_sets(fault, what, where, context),
    )


def _time_us(text: str, where: str) -> int:
    match = _TIME.fullmatch(text.strip())
    if match is None:
        raise InputError(where, text, "is not a time", "Write for example 120 s.")
    if match["unit"] is None:
        raise InputError(where, text, "a time names its unit", f"Write {text.strip()} s.")
    time_us = round(float(match["number"]) * _UNIT_US[match["unit"].lower()])
    if not 0 <= time_us <= _LONGEST_US:
        raise InputError(where, text, "lies outside the run", "Write a time from 0 s on.")
    return time_us


def _fault(name: str, where: str) -> Fault:
    fault = BY_NAME.get(name.lower())
    if fault is not None:
        return fault
    remedy = did_you_mean(name.lower(), BY_NAME, f"Choose from: {', '.join(BY_NAME)}.")
    raise InputError(where, name, "no such fault", remedy)


def _sets(fault: Fault, what: str, where: str, context: Context) -> Mapping[str, float]:
    match = fault.pattern.fullmatch(what)
    if match is None:
        raise InputError(where, what, f'reads "{fault.usage}"', "Correct the line.")
    words = {key: value for key, value in match.groupdict().items() if value is not None}
    numbers = dict[str, float]()
    for key, (least, most) in fault.limits.items():
        if key not in words:
            continue
        numbers[key] = float(words.pop(key))
        if not least <= numbers[key] <= most:
            rule = f"{key} must lie from {least:g} to {most:g}"
            raise InputError(where, what, rule, "Correct the number.")
    wrong = fault.objection(words, context)
    if wrong is not None:
        raise InputError(where, what, *wrong)
    return fault.sets(Line(numbers=numbers, words=words, context=context))


def faults_table() -> str:
    """All faults as a Markdown table, for the documentation."""
    rows = ["| fault | parameters | what it does |", "|---|---|---|"]
    for fault in FAULTS:
        names = ", ".join(f"`{name}`" for name in fault.values)
        usage = fault.usage.replace("|", "\\|")
        rows.append(f"| `{usage}` | {names} | {fault.about} |")
    return "\n".join(rows) + "\n"


def faults_page() -> str:
    """docs/reference/faults.md."""
    return _PAGE + faults_table()


_PAGE = """# Faults

Made from `vehicle_sim/faults/catalogue.py` by `scripts/docs`. A line of a timeline reads
`at TIME: FAULT` or `at TIME for TIME: FAULT`, with units (`ms`, `s`, `min`, `h`).
`estimator_reset`, `origin_move`, `pilot`, `reboot` and what a ground station does happen once and
take no `for`.
Of overlapping faults the latest counts.
`SIM_GPS_USED` is PX4's only, `SIM_BATT_VOLTAGE` and `battery_voltage` are ArduPilot's only.

"""
