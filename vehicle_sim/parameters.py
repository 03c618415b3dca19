"""An autopilot's parameters: a fixed table of names, types and defaults, and what is set now."""

import enum
import math
from collections import UserDict
from collections.abc import Iterable, Mapping
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
        half = 1 << {Kind.INT8: 7, Kind.INT16: 15, Kind.INT32: 31}[self]
        return -half, half - 1


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
class Parameters(UserDict[str, float]):
    """The table as it stands; the order of the rows is the order of the wire's indices.

    InputError for an override that is not in the table, with the nearest known name, and for one
    that its type does not hold.
    """

    def __init__(self, table: Iterable[Parameter], overrides: Mapping[str, float]) -> None:
        self.rows = {row.name: row for row in table}
        self.data = {name: row.default for name, row in self.rows.items()}
        self.version = 0
        """Increases with every change, to invalidate derived values."""
        for name, value in overrides.items():
            if name not in self.rows:
                rule = "this autopilot has no such one"
                remedy = did_you_mean(name, self.rows, "Leave it out.")
                raise InputError(f"parameter {name}", value, rule, remedy)
            least, most = self.rows[name].kind.range
            if not least <= value <= most:  # nor is NaN
                rule = f"must be a number from {least:.8g} to {most:.10g}"
                raise InputError(f"parameter {name}", value, rule, "Give another one.")
            self[name] = value

    def __setitem__(self, name: str, value: float) -> None:
        """Set within the limits of the row and its type, rounded to that.

        KeyError for a name not in it.  Neither firmware takes what is not a finite number: nothing
        changes.
        """
        row = self.rows[name]
        if not math.isfinite(value):
            return
        least, most = row.kind.range
        value = min(max(value, row.least, least), row.most, most)
        self.data[name] = value if row.kind is Kind.REAL32 else float(round(value))
        self.version += 1


Readable = Mapping[str, float]

# --- the tables: *.parm, a row a line in the wire's order -----------------------------------------

_KINDS = {"i8": Kind.INT8, "i16": Kind.INT16, "i32": Kind.INT32, "real": Kind.REAL32}


def table(*names: str) -> tuple[Parameter, ...]:
    """The rows of these files; a later one replaces an earlier one of its name in its place.

    A line: name, default, type (a float without one), least and most.
    """
    folder, rows = resources.files("vehicle_sim.autopilot"), dict[str, Parameter]()
    for file in names:
        for line in folder.joinpath(f"{file}.parm").read_text("utf-8").splitlines():
            if not line.startswith("#"):
                name, default, *rest = line.split()
                kind, least, most = (*rest, *("real", "-inf", "inf")[len(rest) :])
                rows[name] = Parameter(
                    name=name,
                    default=float(default),
                    kind=_KINDS[kind],
                    least=float(least),
                    most=float(most),
                )
    return tuple(rows.values())
