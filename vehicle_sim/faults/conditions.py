"""The SIM_ parameters, what they mean in SI units, and the things that they make happen once.

Names and units are ArduPilot's (libraries/SITL) and PX4's (SIM_GPS_USED, SIM_BAT_*) where they have
one for it; the others are this simulator's own.  Every fault can be set like any other parameter.
The parameters are data: sim.parm.
"""

import math
from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, NamedTuple, final

from vehicle_sim.dynamics.battery import BatteryConditions
from vehicle_sim.dynamics.wind import WindConditions
from vehicle_sim.parameters import Kind, Parameter, Parameters, Readable, lines_of, row_of
from vehicle_sim.sensors.gps import GpsConditions
from vehicle_sim.sensors.lidar import LidarConditions
from vehicle_sim.sensors.terrain_radar import RadarConditions

_MIN_SATELLITES = 4
"""With fewer PX4's simulated receiver has no fix (px4.md 8)."""


class _Row(NamedTuple):
    """One parameter of sim.parm, and the field of Conditions that it sets."""

    parameter: Parameter
    field: str = "-"
    """SECTION.FIELD, or FIELD; - for what is read in a way of its own."""
    scale: float = 1.0
    """From the parameter's unit to the field's."""
    firmware: str = "ardupilot px4"
    """Which have it."""


def _row(words: list[str]) -> _Row:
    field, scale, firmware, *_ = (*words[5:], *("-", "1", "ardupilot px4")[len(words) - 5 :])
    factor = math.radians(1.0) if scale == "deg" else float(scale)
    return _Row(row_of(*words[:5]), field, factor, firmware)


_ROWS: Final = tuple(_row(words) for words in lines_of("sim.parm", beside="faults"))

SIM_PARAMETERS = tuple(row.parameter for row in _ROWS if "ardupilot" in row.firmware)
"""What both ArduPilots' tables end with."""


def _as_px4(row: _Row) -> Parameter:
    """PX4 knows INT32 and FLOAT only, and its simulated receiver is never late."""
    parameter = row.parameter
    default = 0.0 if parameter.name == "SIM_GPS1_LAG_MS" else parameter.default
    kind = Kind.REAL32 if parameter.kind is Kind.REAL32 else Kind.INT32
    return replace(parameter, kind=kind, default=default)


SIM_PARAMETERS_PX4 = tuple(_as_px4(row) for row in _ROWS if "px4" in row.firmware)
"""What both PX4s' tables end with."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConditions:
    """What is wrong with the links.  Shares are 0 to 1."""

    off: bool = False
    lost: float = 0.0
    delay_us: int = 0
    jitter_us: int = 0
    """Up to this much more for each frame; a frame may overtake another so."""
    duplicated: float = 0.0
    reordered: float = 0.0
    corrupted: float = 0.0
    to_vehicle: bool = True
    """Whether frames to the vehicle are concerned, and those from it."""
    from_vehicle: bool = True
    mask: int = 0
    """Bit n: link n is concerned; 0: all are."""

    @property
    def any(self) -> bool:
        """Something is wrong."""
        shares = (self.lost, self.duplicated, self.reordered, self.corrupted)
        return any((self.off, self.delay_us, self.jitter_us, *shares))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """All that the SIM_ parameters ask for, by who minds it."""

    gps: GpsConditions = field(default_factory=GpsConditions)
    wind: WindConditions = field(default_factory=WindConditions)
    battery: BatteryConditions = field(default_factory=BatteryConditions)
    link: LinkConditions = field(default_factory=LinkConditions)
    radar: RadarConditions = field(default_factory=RadarConditions)
    lidar: LidarConditions = field(default_factory=LidarConditions)
    rangefinder_off: bool = False
    setpoints_ignored: bool = False


_SECTIONS: Final = ("gps", "wind", "battery", "link", "radar", "lidar")
_GAUGE = _Row(row_of("BATT_CAPACITY", "3300"), "battery.gauge_mah")
"""A real parameter of ArduPilot's, to be found in its own table."""
_FIELDS: Final = tuple(row for row in (_GAUGE, *reversed(_ROWS)) if row.field != "-")
"""Backwards: of two rows for one field the firmware's own counts, which comes first."""
_FAIR: Final = Conditions()


def conditions_of(parameters: Readable) -> Conditions:
    """What the parameters ask for now.  A parameter that the table lacks has no effect."""
    asked: dict[str, dict[str, Any]] = {section: {} for section in ("", *_SECTIONS)}
    for row in _FIELDS:
        section, _, name = row.field.rpartition(".")
        value = value_of(parameters, row.parameter.name, math.nan)
        if math.isnan(value):
            continue
        usual = getattr(getattr(_FAIR, section) if section else _FAIR, name)
        if isinstance(usual, bool):
            asked[section][name] = value != 0.0
        else:
            scaled = value * row.scale
            asked[section][name] = round(scaled) if isinstance(usual, int) else scaled
    gps, link = asked["gps"], asked["link"]
    if "SIM_GPS_USED" in parameters and gps["satellites"] < _MIN_SATELLITES:
        gps["enabled"] = False
    gps["swell_m"] = max(gps.get("swell_m", 0.0), 0.0)
    way = round(value_of(parameters, "SIM_LNK_WAY"))
    link["to_vehicle"], link["from_vehicle"] = way != 2, way != 1
    sections = {name: replace(getattr(_FAIR, name), **asked[name]) for name in _SECTIONS}
    return Conditions(**sections, **asked[""])


def value_of(parameters: Readable, name: str, otherwise: float = 0.0) -> float:
    """The value of a parameter that the table may lack, or that is not a number."""
    try:
        value = parameters[name]
    except KeyError:
        return otherwise
    return value if math.isfinite(value) else otherwise


# --- what happens once ----------------------------------------------------------------------------

OneShot = Literal[
    "estimator_reset", "origin_move", "pilot", "reboot",
    "ground_command", "ground_target", "ground_fence",
]  # fmt: skip
"""The faults that happen at a moment: jumps of the estimate (north, east) and of its origin (north,
east, up; all in metres), the pilot takes over, the autopilot loses power, a ground station sends a
command (number, three parameters, whether to the autopilot), a target (north, east, metres), a
fence (radius, how far ahead, metres)."""
_TRIGGERS: Final[Mapping[OneShot, Sequence[str]]] = {
    "estimator_reset": ("SIM_EKF_RST_N", "SIM_EKF_RST_E"),
    "origin_move": ("SIM_ORG_MOV_N", "SIM_ORG_MOV_E", "SIM_ORG_MOV_U"),
    "pilot": ("SIM_PILOT",),
    "reboot": ("SIM_REBOOT",),
    "ground_command": ("SIM_GCS_CMD", "SIM_GCS_P1", "SIM_GCS_P2", "SIM_GCS_P3", "SIM_GCS_TO"),
    "ground_target": ("SIM_GCS_TGT_N", "SIM_GCS_TGT_E"),
    "ground_fence": ("SIM_GCS_FNC_R", "SIM_GCS_FNC_A"),
}
_BY_THE_FIRST: Final = ("ground_command", "ground_fence")
"""Their first trigger alone makes them happen: the others may be set before it."""


def take_one_shots(
    parameters: MutableMapping[str, float] | Parameters,
) -> list[tuple[OneShot, tuple[float, ...]]]:
    """What the triggers ask for; they are 0 again afterwards, ready for the next time."""
    taken = list[tuple[OneShot, tuple[float, ...]]]()
    for name, triggers in _TRIGGERS.items():
        values = tuple(value_of(parameters, trigger) for trigger in triggers)
        if any(values[:1] if name in _BY_THE_FIRST else values):
            taken.append((name, values))
            for trigger, value in zip(triggers, values, strict=True):
                if value:
                    parameters[trigger] = 0.0
    return taken
