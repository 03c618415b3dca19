"""An autopilot's parameters: a fixed table of names, types and defaults, and what is set now."""

import enum
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Final, Literal, final

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
    def bits(self) -> int:
        """That a value has."""
        return {Kind.INT8: 8, Kind.INT16: 16}.get(self, 32)

    @property
    def range(self) -> tuple[float, float]:
        """Least and greatest value."""
        half = 1 << self.bits - 1
        is_real = self is Kind.REAL32
        return (-_LARGEST_FLOAT, _LARGEST_FLOAT) if is_real else (-half, half - 1)


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
                rule = f"must be a number from {least:.8g} to {most:.10g}: it has {kind.bits} bits"
                raise InputError(f"parameter {name}", value, rule, "Give another one.")
            self[name] = value

    def _remedy(self, name: str) -> str:
        """What a name may stand for that is not in the table."""
        for was, now, note in RENAMED:
            known = re.sub(was, now, name) if re.fullmatch(was, name) else ""
            if known in self._rows:
                return f"It is called {known} here{note and ', '}{note}."
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

RENAMED: Final = (
    ("SYSID_THISMAV", "MAV_SYSID", ""),
    ("SYSID_THISMAV", "MAV_SYS_ID", ""),
    ("MAV_SYS_ID", "MAV_SYSID", ""),
    ("MAV_SYSID", "MAV_SYS_ID", ""),
    ("SYSID_MYGCS", "MAV_GCS_SYSID", ""),
    ("SYSID_ENFORCE", "MAV_OPTIONS", ""),
    (r"SR0_(\w+)", r"MAV1_\1", ""),
    (r"SR1_(\w+)", r"MAV2_\1", ""),
    (r"SR[2-9]_(\w+)", r"MAV2_\1", "for the second link; the others have none"),
    ("ARSPD_FBW_MIN", "AIRSPEED_MIN", ""),
    ("ARSPD_FBW_MAX", "AIRSPEED_MAX", ""),
    ("TRIM_ARSPD_CM", "AIRSPEED_CRUISE", "in m/s"),
    ("LIM_ROLL_CD", "ROLL_LIMIT_DEG", "in deg"),
    ("ALT_HOLD_RTL", "RTL_ALTITUDE", "in m"),
    ("FS_GCS_ENABLE", "FS_GCS_ENABL", ""),
    ("FS_GCS_ENABL", "FS_GCS_ENABLE", ""),
    ("ATC_ANGLE_MAX", "ANGLE_MAX", "in cdeg"),
    ("WP_SPD", "WPNAV_SPEED", "in cm/s"),
    ("WP_SPD_(UP|DN)", r"WPNAV_SPEED_\1", "in cm/s"),
    ("WP_ACC", "WPNAV_ACCEL", "in cm/s2"),
    ("WP_ACC_Z", "WPNAV_ACCEL_Z", "in cm/s2"),
    ("WP_RADIUS_M", "WPNAV_RADIUS", "in cm"),
    ("LAND_SPD_MS", "LAND_SPEED", "in cm/s"),
    ("PSC_JERK_NE", "PSC_JERK_XY", ""),
    ("PRX_TYPE", "PRX1_TYPE", ""),
    (r"RNGFND_(\w+)", r"RNGFND1_\1", ""),
    (r"SIM_GPS_(\w+)", r"SIM_GPS1_\1", ""),
    ("SIM_GPS_DISABLE", "SIM_GPS1_ENABLE", ""),
    ("COM_OBL_ACT", "COM_OBL_RC_ACT", ""),
)
"""Names that releases of the firmwares have or had, as patterns; the name that the simulated one
has; a word about it.  The first that it has counts."""


# --- the tables: *.parm, a row a line in the wire's order -----------------------------------------

_KINDS = {"i8": Kind.INT8, "i16": Kind.INT16, "i32": Kind.INT32, "real": Kind.REAL32}


def _row_of(name: str, default: str, kind: str = "real", *limits: str) -> Parameter:
    """The row that a line is: name, default, type (a float without one), least and most."""
    bounds = dict(zip(("least", "most"), map(float, limits), strict=False))
    return Parameter(name=name, default=float(default), kind=_KINDS[kind], **bounds)


def table(*names: str) -> tuple[Parameter, ...]:
    """The rows of these files; a later one replaces an earlier one of its name in its place."""
    folder = resources.files("vehicle_sim.autopilot")
    texts = [folder.joinpath(f"{name}.parm").read_text("utf-8") for name in names]
    lines = [
        line.split() for text in texts for line in text.splitlines() if not line.startswith("#")
    ]
    return tuple({words[0]: _row_of(*words) for words in lines}.values())
