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
_LARGEST = 3.4028234663852886e38


class Kind(enum.IntEnum):
    """MAV_PARAM_TYPE, as far as autopilots use it."""

    INT8 = 2
    INT16 = 4
    INT32 = 6
    REAL32 = 9


_MOST = {Kind.INT8: 127.0, Kind.INT16: 32767.0, Kind.INT32: 2147483647.0, Kind.REAL32: _LARGEST}


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One row of the table.  The name is the autopilot's own, at most 16 characters."""

    name: str
    default: float
    kind: Kind = Kind.REAL32
    least: float = -math.inf
    most: float = math.inf

    @property
    def limits(self) -> tuple[float, float]:
        """Least and greatest value, also by its type."""
        most = _MOST[self.kind]
        least = -most if self.kind is Kind.REAL32 else -most - 1.0
        return max(self.least, least), min(self.most, most)


@final
class Parameters(UserDict[str, float]):
    """The table as it stands; the order of the rows is the order of the wire's indices.

    InputError for an override that is not in the table, with the nearest known name, and for one
    that its row does not hold.
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
            (least, most), whole = self.rows[name].limits, self.rows[name].kind is not Kind.REAL32
            if not least <= value <= most or (whole and value % 1.0):  # nor is NaN
                number = f"a {'whole ' * whole}number"
                rule = f"must be {number} from {least:.10g} to {most:.10g}"
                raise InputError(f"parameter {name}", value, rule, "Give another one.")
            self[name] = value

    def __setitem__(self, name: str, value: float) -> None:
        """Set within the limits of the row, rounded to its type.

        KeyError for a name not in it.  Neither firmware takes what is not a finite number: nothing
        changes.
        """
        row = self.rows[name]
        if math.isfinite(value):
            value = min(max(value, row.limits[0]), row.limits[1])
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
