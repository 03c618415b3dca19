"""The SIM_ parameters, what they mean in SI units, and the things that they make happen once.

Names and units are ArduPilot's (libraries/SITL) and PX4's (SIM_GPS_USED, SIM_BAT_*) where they have
one for it; the others are this simulator's own.  Every fault can be set like any other parameter.
"""

import dataclasses
import math
from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, final

from vehicle_sim.dynamics.battery import BatteryConditions
from vehicle_sim.dynamics.wind import WindConditions
from vehicle_sim.parameters import Kind, Parameter, Parameters
from vehicle_sim.sensors.gps import GpsConditions
from vehicle_sim.sensors.lidar import LidarConditions
from vehicle_sim.sensors.terrain_radar import RadarConditions

_MIN_SATELLITES = 4
"""With fewer PX4's simulated receiver has no fix (px4.md 8)."""

_FARTHEST = 1e5
"""Metres: the real simulators take anything; this one stays on the earth."""


Readable = Mapping[str, float] | Parameters


@final
@dataclass(frozen=True, slots=True)
class _Row:
    """One parameter, and the field of Conditions that it sets."""

    parameter: Parameter
    field: str = ""
    """SECTION.FIELD, or FIELD; none for what is read in a way of its own."""
    scale: float = 1.0
    """From the parameter's unit to the field's."""


def _row(
    name: str,
    field: str,
    default: float,
    least: float,
    most: float,
    *,
    kind: Kind = Kind.REAL32,
    scale: float = 1.0,
) -> _Row:
    row = Parameter(name=name, default=default, kind=kind, least=least, most=most)
    return _Row(row, field, scale)


def _switch(name: str, field: str, default: float = 0.0, most: float = 1.0) -> _Row:
    return _row(name, field, default, 0.0, most, kind=Kind.INT8)


def _far(name: str, field: str = "") -> _Row:
    return _row(name, field, 0.0, -_FARTHEST, _FARTHEST)


def _share(name: str, field: str, default: float = 0.0) -> _Row:
    return _row(name, field, default, 0.0, 100.0, scale=0.01)


_AXES = (("X", "north"), ("Y", "east"), ("Z", "up"))
_GPS = (
    _switch("SIM_GPS1_ENABLE", "gps.enabled", 1),
    _row("SIM_GPS1_LAG_MS", "gps.lag_s", 100, 0, 5000, kind=Kind.INT16, scale=1e-3),
    _row("SIM_GPS1_NUMSATS", "gps.satellites", 10, 0, 50, kind=Kind.INT8),
    _row("SIM_GPS1_GLTCH_X", "gps.glitch_latitude_deg", 0.0, -90.0, 90.0),
    _row("SIM_GPS1_GLTCH_Y", "gps.glitch_longitude_deg", 0.0, -180.0, 180.0),
    _far("SIM_GPS1_GLTCH_Z", "gps.glitch_up_m"),
    _far("SIM_GPS1_DRFTALT", "gps.swell_m"),
    _far("SIM_GPS1_NOISE", "gps.wave_m"),
    _row("SIM_GPS1_LCKTIME", "gps.lock_s", 0, 0, 32767, kind=Kind.INT16),
    _row("SIM_GPS1_ALT_OFS", "gps.offset_up_m", 0, -32768, 32767, kind=Kind.INT16),
    _row("SIM_GPS1_ACC", "gps.accuracy_m", 0.3, 0.0, 1000.0),
    *(
        _row(f"SIM_GPS1_VERR_{axis}", f"gps.velocity_error_{way}_m_s", 0.0, -1000.0, 1000.0)
        for axis, way in _AXES
    ),
    _switch("SIM_GPS1_JAM", "gps.jammed"),
    _switch("SIM_GPS1_FIXTYPE", "gps.fix_type", 6, 6),
    _far("SIM_GPS1_HNSE", "gps.circle_m"),
    *(
        _row(
            f"SIM_GPS1_GLTV_{axis}",
            f"gps.drift_{way}_m_s",
            0.0,
            -100.0,
            100.0,
            scale=-1.0 if way == "up" else 1.0,
        )
        for axis, way in _AXES
    ),
    _row("SIM_GPS_SIGMA", "gps.sigma_m", 0.0, 0.0, 1000.0),
)
_RADIANS = math.pi / 180.0
_WIND = (
    _row("SIM_WIND_SPD", "wind.speed_m_s", 0.0, 0.0, 100.0),
    _row("SIM_WIND_DIR", "wind.from_rad", 180.0, -3600.0, 3600.0, scale=_RADIANS),
    _row("SIM_WIND_TURB", "wind.turbulence_m_s", 0.0, 0.0, 50.0),
    _row("SIM_WIND_DIR_Z", "wind.rising_rad", 0.0, -90.0, 90.0, scale=_RADIANS),
    _switch("SIM_WIND_T", "wind.profile"),
    _row("SIM_WIND_T_ALT", "wind.full_height_m", 60.0, 0.0, _FARTHEST),
    _row("SIM_WIND_TC", "wind.settling_s", 5.0, 0.0, 60.0),
)
_BATTERY_ARDUPILOT = (
    _row("SIM_BATT_VOLTAGE", "battery.voltage_v", 12.6, 0.0, 60.0),
    _row("SIM_BATT_CAP_AH", "battery.capacity_ah", 0.0, 0.0, 1000.0),
)
_BATTERY_PX4 = (
    _row("SIM_BAT_DRAIN", "battery.drain_s", 60.0, 1.0, 86400.0),
    _share("SIM_BAT_MIN_PCT", "battery.least", 50.0),
)
_GPS_PX4 = (_row("SIM_GPS_USED", "gps.satellites", 10, 0, 50, kind=Kind.INT32),)
_OWN = (
    _share("SIM_BATT_MOST", "battery.most", 100.0),
    _switch("SIM_LNK_OFF", "link.off"),
    _share("SIM_LNK_LOSS", "link.lost"),
    _row("SIM_LNK_DELAY", "link.delay_us", 0.0, 0.0, 60_000.0, scale=1e3),
    _row("SIM_LNK_JITTER", "link.jitter_us", 0.0, 0.0, 60_000.0, scale=1e3),
    _share("SIM_LNK_DUP", "link.duplicated"),
    _share("SIM_LNK_REORD", "link.reordered"),
    _share("SIM_LNK_CORR", "link.corrupted"),
    _switch("SIM_LNK_WAY", "", 0.0, 2.0),
    _row("SIM_LNK_MASK", "link.mask", 0, 0, 2**24 - 1, kind=Kind.INT32),
    _switch("SIM_RDR_OFF", "radar.silent"),
    _switch("SIM_RDR_BLIND", "radar.blind"),
    _share("SIM_RDR_MISS", "radar.cells_missed"),
    _share("SIM_RDR_LOSS", "radar.frames_lost"),
    _row("SIM_RDR_NOISE", "radar.noise_m", 0.0, -10_000.0, 10_000.0),
    _row("SIM_RDR_DELAY", "radar.delay_s", 0.0, 0.0, 60_000.0, scale=1e-3),
    _row("SIM_RDR_HZ", "radar.rate_hz", 0.0, 0.0, 100.0),
    _switch("SIM_LDR_DEAD", "lidar.dead"),
    _switch("SIM_LDR_BLIND", "lidar.blind"),
    _switch("SIM_LDR_OFF", "lidar.silent"),
    _share("SIM_LDR_LOSS", "lidar.frames_lost"),
    _share("SIM_LDR_DUST", "lidar.dust"),
    _switch("SIM_LDR_STUCK", "lidar.stuck"),
    _row("SIM_LDR_YAW", "lidar.turned_rad", 0.0, -360.0, 360.0, scale=_RADIANS),
    _row("SIM_LDR_CLOCK", "lidar.clock_us", 0.0, -1e9, 1e9, scale=1e3),
    _row("SIM_LDR_JUMP", "lidar.clock_jump_us", 0.0, 0.0, 60_000.0, scale=1e3),
    _row("SIM_LDR_HZ", "lidar.rate_hz", 0.0, 0.0, 1000.0),
    _row("SIM_LDR_FRAME", "lidar.frame", 12, 0, 255, kind=Kind.INT16),
    _share("SIM_LDR_JUNK", "lidar.junk"),
    _switch("SIM_LDR_MIRROR", "lidar.mirrored"),
    _switch("SIM_RFND_OFF", "rangefinder_off"),
    _switch("SIM_SP_IGNORE", "setpoints_ignored"),
    _far("SIM_EKF_RST_N"),
    _far("SIM_EKF_RST_E"),
    *(_far(f"SIM_ORG_MOV_{axis}") for axis in "NEU"),
    _switch("SIM_PILOT", ""),
    _switch("SIM_REBOOT", ""),
)


def _parameters(*rows: _Row) -> tuple[Parameter, ...]:
    return tuple(row.parameter for row in rows)


SIM_PARAMETERS = _parameters(*_GPS, *_WIND, *_BATTERY_ARDUPILOT, *_OWN)
"""What both ArduPilots' tables end with."""


def _as_px4(row: Parameter) -> Parameter:
    """PX4 knows INT32 and FLOAT only, and its simulated receiver is never late."""
    default = 0.0 if row.name == "SIM_GPS1_LAG_MS" else row.default
    kind = Kind.REAL32 if row.kind is Kind.REAL32 else Kind.INT32
    return dataclasses.replace(row, kind=kind, default=default)


SIM_PARAMETERS_PX4: tuple[Parameter, ...] = (
    *_parameters(*_GPS_PX4, *_BATTERY_PX4),
    *(_as_px4(row) for row in _parameters(*_GPS, *_WIND, *_OWN)),
)
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
_GAUGE = _row("BATT_CAPACITY", "battery.gauge_mah", 3300.0, 0.0, 1e6)
"""A real parameter of ArduPilot's, to be found in its own table."""
_FIELDS: Final = tuple(
    row
    for row in (*_GPS, *_WIND, *_BATTERY_ARDUPILOT, *_BATTERY_PX4, *_OWN, *_GPS_PX4, _GAUGE)
    if row.field
)
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

OneShot = Literal["estimator_reset", "origin_move", "pilot", "reboot"]
"""The faults that happen at a moment: jumps of the estimate (north, east) and of its origin (north,
east, up; all in metres), the pilot takes over, the autopilot loses power."""
_TRIGGERS: Final[Mapping[OneShot, Sequence[str]]] = {
    "estimator_reset": ("SIM_EKF_RST_N", "SIM_EKF_RST_E"),
    "origin_move": ("SIM_ORG_MOV_N", "SIM_ORG_MOV_E", "SIM_ORG_MOV_U"),
    "pilot": ("SIM_PILOT",),
    "reboot": ("SIM_REBOOT",),
}


def take_one_shots(
    parameters: MutableMapping[str, float] | Parameters,
) -> list[tuple[OneShot, tuple[float, ...]]]:
    """What the triggers ask for; they are 0 again afterwards, ready for the next time."""
    taken = list[tuple[OneShot, tuple[float, ...]]]()
    for name, triggers in _TRIGGERS.items():
        values = tuple(value_of(parameters, trigger) for trigger in triggers)
        if any(values):
            taken.append((name, values))
            for trigger, value in zip(triggers, values, strict=True):
                if value:
                    parameters[trigger] = 0.0
    return taken
