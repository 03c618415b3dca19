"""The SIM_ parameters, what they mean in SI units, and the things that they make happen once.

Names and units are ArduPilot's (libraries/SITL) and PX4's (SIM_GPS_USED, SIM_BAT_*) where they have
one for it; the others are this simulator's own.  Every fault can be set like any other parameter.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, Protocol, final

from vehicle_sim.dynamics.battery import BatteryConditions
from vehicle_sim.dynamics.wind import WindConditions
from vehicle_sim.parameters import Kind, Parameter
from vehicle_sim.sensors.gps import GpsConditions
from vehicle_sim.sensors.radar_component import RadarConditions

Firmware = Literal["ardupilot", "px4"]

_LEAST_SATELLITES = 4
"""With fewer PX4's simulated receiver has no fix (px4.md 8)."""

_FARTHEST = 1e5
"""Metres: the real simulators take anything; this one stays on the earth."""


class Readable(Protocol):
    """autopilots.parameters.Parameters, or a mapping."""

    def __getitem__(self, name: str, /) -> float:
        """The value; KeyError for a name not in the table."""
        ...

    def __contains__(self, name: object, /) -> bool:
        """Whether the table has this name."""
        ...


class Settable(Readable, Protocol):
    """The same, to be changed."""

    def __setitem__(self, name: str, value: float, /) -> None:
        """Set it."""
        ...


@final
@dataclass(frozen=True, slots=True)
class _Row:
    """One parameter, and the field of Conditions that it sets."""

    parameter: Parameter
    field: str = ""
    """SECTION.FIELD, or FIELD; none for what is read in a way of its own."""
    scale: float = 1.0
    """From the parameter's unit to the field's."""


def _switch(name: str, field: str, default: float = 0.0, most: float = 1.0) -> _Row:
    return _Row(Parameter(name=name, default=default, kind=Kind.INT8, least=0.0, most=most), field)


def _real(
    name: str, field: str, default: float, least: float, most: float, *, scale: float = 1.0
) -> _Row:
    return _Row(Parameter(name=name, default=default, least=least, most=most), field, scale)


def _far(name: str, field: str = "") -> _Row:
    return _real(name, field, 0.0, -_FARTHEST, _FARTHEST)


def _share(name: str, field: str, default: float = 0.0) -> _Row:
    return _real(name, field, default, 0.0, 100.0, scale=0.01)


def _whole(
    name: str,
    field: str,
    default: float,
    kind: Kind,
    least: float,
    most: float,
    *,
    scale: float = 1.0,
) -> _Row:
    row = Parameter(name=name, default=default, kind=kind, least=least, most=most)
    return _Row(row, field, scale)


_AXES = (("X", "north"), ("Y", "east"), ("Z", "up"))
_GPS = (
    _switch("SIM_GPS1_ENABLE", "gps.enabled", 1),
    _whole("SIM_GPS1_LAG_MS", "gps.lag_s", 100, Kind.INT16, 0, 5000, scale=1e-3),
    _whole("SIM_GPS1_NUMSATS", "gps.satellites", 10, Kind.INT8, 0, 50),
    _real("SIM_GPS1_GLTCH_X", "gps.glitch_latitude_deg", 0.0, -90.0, 90.0),
    _real("SIM_GPS1_GLTCH_Y", "gps.glitch_longitude_deg", 0.0, -180.0, 180.0),
    _far("SIM_GPS1_GLTCH_Z", "gps.glitch_up_m"),
    _far("SIM_GPS1_DRFTALT", "gps.swell_m"),
    _far("SIM_GPS1_NOISE", "gps.wave_m"),
    _whole("SIM_GPS1_LCKTIME", "gps.lock_s", 0, Kind.INT16, 0, 32767),
    _whole("SIM_GPS1_ALT_OFS", "gps.offset_up_m", 0, Kind.INT16, -32768, 32767),
    _real("SIM_GPS1_ACC", "gps.accuracy_m", 0.3, 0.0, 1000.0),
    *(
        _real(f"SIM_GPS1_VERR_{axis}", f"gps.velocity_error_{way}_m_s", 0.0, -1000.0, 1000.0)
        for axis, way in _AXES
    ),
    _switch("SIM_GPS1_JAM", "gps.jammed"),
    _switch("SIM_GPS1_FIXTYPE", "gps.fix_type", 6, 6),
    _far("SIM_GPS1_HNSE", "gps.circle_m"),
    *(
        _real(
            f"SIM_GPS1_GLTV_{axis}",
            f"gps.drift_{way}_m_s",
            0.0,
            -100.0,
            100.0,
            scale=-1.0 if way == "up" else 1.0,
        )
        for axis, way in _AXES
    ),
    _real("SIM_GPS_SIGMA", "gps.sigma_m", 0.0, 0.0, 1000.0),
)
_RADIANS = math.pi / 180.0
_WIND = (
    _real("SIM_WIND_SPD", "wind.speed_m_s", 0.0, 0.0, 100.0),
    _real("SIM_WIND_DIR", "wind.from_rad", 180.0, -3600.0, 3600.0, scale=_RADIANS),
    _real("SIM_WIND_TURB", "wind.turbulence_m_s", 0.0, 0.0, 50.0),
    _real("SIM_WIND_DIR_Z", "wind.rising_rad", 0.0, -90.0, 90.0, scale=_RADIANS),
    _switch("SIM_WIND_T", "wind.profile"),
    _real("SIM_WIND_T_ALT", "wind.full_height_m", 60.0, 0.0, _FARTHEST),
    _real("SIM_WIND_TC", "wind.settling_s", 5.0, 0.0, 60.0),
)
_BATTERY_ARDUPILOT = (
    _real("SIM_BATT_VOLTAGE", "battery.voltage_v", 12.6, 0.0, 60.0),
    _real("SIM_BATT_CAP_AH", "battery.capacity_ah", 0.0, 0.0, 1000.0),
)
_BATTERY_PX4 = (
    _real("SIM_BAT_DRAIN", "battery.drain_s", 60.0, 1.0, 86400.0),
    _share("SIM_BAT_MIN_PCT", "battery.least", 50.0),
)
_GPS_PX4 = (_whole("SIM_GPS_USED", "gps.satellites", 10, Kind.INT32, 0, 50),)
_OWN = (
    _share("SIM_BATT_MOST", "battery.most", 100.0),
    _switch("SIM_LNK_OFF", "link.off"),
    _share("SIM_LNK_LOSS", "link.lost"),
    _real("SIM_LNK_DELAY", "link.delay_us", 0.0, 0.0, 60_000.0, scale=1e3),
    _real("SIM_LNK_JITTER", "link.jitter_us", 0.0, 0.0, 60_000.0, scale=1e3),
    _share("SIM_LNK_DUP", "link.duplicated"),
    _share("SIM_LNK_REORD", "link.reordered"),
    _share("SIM_LNK_CORR", "link.corrupted"),
    _switch("SIM_LNK_WAY", "", 0.0, 2.0),
    _whole("SIM_LNK_MASK", "link.mask", 0, Kind.INT32, 0, 2**24 - 1),
    _switch("SIM_RDR_OFF", "radar.silent"),
    _switch("SIM_RDR_BLIND", "radar.blind"),
    _share("SIM_RDR_MISS", "radar.cells_missed"),
    _share("SIM_RDR_LOSS", "radar.frames_lost"),
    _real("SIM_RDR_NOISE", "radar.noise_m", 0.0, -10_000.0, 10_000.0),
    _real("SIM_RDR_DELAY", "radar.delay_s", 0.0, 0.0, 60_000.0, scale=1e-3),
    _real("SIM_RDR_HZ", "radar.rate_hz", 0.0, 0.0, 100.0),
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
        return bool(
            self.off
            or self.lost
            or self.delay_us
            or self.jitter_us
            or self.duplicated
            or self.reordered
            or self.corrupted
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """All that the SIM_ parameters ask for, by who minds it."""

    gps: GpsConditions = field(default_factory=GpsConditions)
    wind: WindConditions = field(default_factory=WindConditions)
    battery: BatteryConditions = field(default_factory=BatteryConditions)
    link: LinkConditions = field(default_factory=LinkConditions)
    radar: RadarConditions = field(default_factory=RadarConditions)
    setpoints_ignored: bool = False


_FIELDS: Final = tuple(
    row
    for row in (*_GPS, *_WIND, *_BATTERY_ARDUPILOT, *_BATTERY_PX4, *_OWN, *_GPS_PX4)
    if row.field
)
_FAIR: Final = Conditions()


def conditions_of(parameters: Readable) -> Conditions:
    """What the parameters ask for now.  A parameter that the table lacks has no effect."""
    asked: dict[str, dict[str, Any]] = {"gps": {}, "wind": {}, "battery": {}, "link": {}}
    asked |= {"radar": {}, "": {}}
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
    if "SIM_GPS_USED" in parameters and gps["satellites"] < _LEAST_SATELLITES:
        gps["enabled"] = False
    if "swell_m" in gps:
        gps["swell_m"] = max(gps["swell_m"], 0.0)
    way = round(value_of(parameters, "SIM_LNK_WAY"))
    link["to_vehicle"], link["from_vehicle"] = way != 2, way != 1
    gauge_mah = value_of(parameters, "BATT_CAPACITY", _FAIR.battery.gauge_mah)
    return Conditions(
        gps=GpsConditions(**gps),
        wind=WindConditions(**asked["wind"]),
        battery=BatteryConditions(gauge_mah=gauge_mah, **asked["battery"]),
        link=LinkConditions(**link),
        radar=RadarConditions(**asked["radar"]),
        **asked[""],
    )


def value_of(parameters: Readable, name: str, otherwise: float = 0.0) -> float:
    """The value of a parameter that the table may lack, or that is not a number."""
    try:
        value = parameters[name]
    except KeyError:
        return otherwise
    return value if math.isfinite(value) else otherwise


# --- what happens once ----------------------------------------------------------------------------


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorReset:
    """Autopilot.reset_estimate."""

    north_m: float
    east_m: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class OriginMove:
    """Autopilot.move_origin."""

    north_m: float
    east_m: float
    up_m: float


@final
@dataclass(frozen=True, slots=True)
class PilotTakes:
    """Autopilot.pilot_takes."""


@final
@dataclass(frozen=True, slots=True)
class Reboot:
    """The autopilot loses power for a moment."""


Happening = EstimatorReset | OriginMove | PilotTakes | Reboot


def take_happenings(parameters: Settable) -> Sequence[Happening]:
    """What the triggers ask for; they are 0 again afterwards, ready for the next time."""

    def take(name: str) -> float:
        value = value_of(parameters, name)
        if value:
            parameters[name] = 0.0
        return value

    happenings: list[Happening] = []
    north_m, east_m = take("SIM_EKF_RST_N"), take("SIM_EKF_RST_E")
    if north_m or east_m:
        happenings.append(EstimatorReset(north_m=north_m, east_m=east_m))
    north_m, east_m, up_m = (take(f"SIM_ORG_MOV_{axis}") for axis in "NEU")
    if north_m or east_m or up_m:
        happenings.append(OriginMove(north_m=north_m, east_m=east_m, up_m=up_m))
    if take("SIM_PILOT"):
        happenings.append(PilotTakes())
    if take("SIM_REBOOT"):
        happenings.append(Reboot())
    return happenings
