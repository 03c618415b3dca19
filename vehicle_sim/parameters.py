"""An autopilot's parameters: a fixed table of names, types and defaults, and what is set now."""

import enum
import functools
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Literal, final

from vehicle_sim.errors import InputError, did_you_mean

Firmware = Literal["ardupilot", "px4"]
_LARGEST_FLOAT = 3.4028234663852886e38


class Kind(enum.IntEnum):
    """MAV_PARAM_TYPE, as far as autopilots use it."""

    INT8 = 2
    INT16 = 4
    INT32 = 6
    REAL32 = 9

    @property
    def range(self) -> tuple[float, float]:
        """Least and greatest value."""
        if self is Kind.REAL32:
            return -_LARGEST_FLOAT, _LARGEST_FLOAT
        most = {Kind.INT8: 2**7, Kind.INT16: 2**15, Kind.INT32: 2**31}[self]
        return -most, most - 1


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One row of the table.  The name is the autopilot's own, at most 16 characters."""

    name: str
    default: float
    kind: Kind = Kind.REAL32
    least: float = -math.inf
    most: float = math.inf


@final
class Parameters:
    """The table as it stands; the order of the rows is the order of the wire's indices.

    InputError for an override that is not in the table, with the nearest known name, and for one
    that its type does not hold.
    """

    def __init__(self, table: Iterable[Parameter], overrides: Mapping[str, float]) -> None:
        self._rows = {row.name: row for row in table}
        self._values = {name: row.default for name, row in self._rows.items()}
        self._saved: dict[str, float] = {}
        """Of those that have another value until the next boot."""
        self.version = 0
        """Increases with every change, to invalidate derived values."""
        for name, value in overrides.items():
            if name not in self._rows:
                rule = "this autopilot has no such one"
                raise InputError(f"parameter {name}", value, rule, self._remedy(name))
            kind = self._rows[name].kind
            least, most = kind.range
            if not least <= value <= most:  # nor is NaN
                bits = 8 if kind is Kind.INT8 else 16 if kind is Kind.INT16 else 32
                rule = f"must be a number from {least:.8g} to {most:.10g}: it has {bits} bits"
                raise InputError(f"parameter {name}", value, rule, "Give another one.")
            self[name] = value

    def _remedy(self, name: str) -> str:
        """What a name may stand for that is not in the table."""
        for was, now, *note in lines_of("renamed.table", 2):
            known = re.sub(was, now, name) if re.fullmatch(was, name) else ""
            if known in self._rows:
                return f"It is called {known} here{', ' if note else ''}{''.join(note)}."
        return did_you_mean(name, self._rows, "Leave it out.")

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __setitem__(self, name: str, value: float) -> None:
        """Set within the limits of the row and its type, rounded to that.

        KeyError for a name not in it.  Neither firmware takes what is not a finite number: nothing
        changes.
        """
        row = self._rows[name]
        if not math.isfinite(value):
            return
        self._saved.pop(name, None)
        least, most = row.kind.range
        value = min(max(value, row.least, least), row.most, most)
        self._values[name] = value if row.kind is Kind.REAL32 else float(round(value))
        self.version += 1

    def set_until_reboot(self, name: str, value: float) -> None:
        """The same, of a change that is not saved."""
        saved = self._saved.get(name, self._values[name])
        self[name] = value
        self._saved[name] = saved

    def __contains__(self, name: object) -> bool:
        return name in self._rows

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def rows(self) -> tuple[Parameter, ...]:
        """All rows, in order."""
        return tuple(self._rows.values())

    def row(self, name: str) -> Parameter:
        """The row of this name; KeyError if there is none."""
        return self._rows[name]

    def values(self) -> dict[str, float]:
        """A copy, by name: what a reboot keeps."""
        return self._values | self._saved


Readable = Mapping[str, float] | Parameters


# --- the tables: *.parm, a row a line in the wire's order -----------------------------------------

_KINDS = {"i8": Kind.INT8, "i16": Kind.INT16, "i32": Kind.INT32, "real": Kind.REAL32}


def lines_of(name: str, splits: int = -1) -> Iterator[list[str]]:
    """The words of each line of a table of the autopilots, split so often at most."""
    text = resources.files("vehicle_sim.autopilots").joinpath(name).read_text("utf-8")
    for line in text.splitlines():
        if not line.startswith("#"):
            yield line.split(None, splits)


@functools.cache
def without_effect() -> frozenset[str]:
    """Parameters that are there to be read and written, because clients do, and do nothing."""
    return frozenset(name for names in lines_of("without_effect.table") for name in names)


def _row_of(name: str, default: str, kind: str = "real", *limits: str) -> Parameter:
    """The row that a line is: name, default, type (a float without one), least and most."""
    bounds = dict(zip(("least", "most"), map(float, limits), strict=False))
    return Parameter(name=name, default=float(default), kind=_KINDS[kind], **bounds)


def table(*names: str) -> tuple[Parameter, ...]:
    """The rows of these files; a later one replaces an earlier one of its name in its place."""
    rows = {words[0]: _row_of(*words) for name in names for words in lines_of(f"{name}.parm")}
    return tuple(rows.values())
