"""The SIM_ parameters, what they mean in SI units, and the things that they make happen once.

Names and units are ArduPilot's (libraries/SITL) and PX4's (SIM_GPS_USED, SIM_BAT_*) where they have
one for it; the others are this simulator's own.  Every fault can be set like any other parameter.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, final

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


def _switch(name: str, default: float = 0.0, most: float = 1.0) -> Parameter:
    return Parameter(name=name, default=default, kind=Kind.INT8, least=0.0, most=most)


def _count(name: str, default: float = 0.0, most: float = 32767.0) -> Parameter:
    return Parameter(name=name, default=default, kind=Kind.INT16, least=0.0, most=most)


def _real(
    name: str, default: float = 0.0, least: float = -math.inf, most: float = math.inf
) -> Parameter:
    return Parameter(name=name, default=default, least=least, most=most)


def _share(name: str, default: float = 0.0) -> Parameter:
    return _real(name, default, 0.0, 100.0)


_GPS = (
    _switch("SIM_GPS1_ENABLE", 1),
    _count("SIM_GPS1_LAG_MS", 100, 5000),
    Parameter(name="SIM_GPS1_NUMSATS", default=10, kind=Kind.INT8, least=0, most=50),
    _real("SIM_GPS1_GLTCH_X", 0.0, -90.0, 90.0),
    _real("SIM_GPS1_GLTCH_Y", 0.0, -180.0, 180.0),
    _real("SIM_GPS1_GLTCH_Z", 0.0, -_FARTHEST, _FARTHEST),
    _real("SIM_GPS1_DRFTALT", 0.0, -_FARTHEST, _FARTHEST),
    _real("SIM_GPS1_NOISE", 0.0, -_FARTHEST, _FARTHEST),
    _count("SIM_GPS1_LCKTIME"),
    Parameter(name="SIM_GPS1_ALT_OFS", default=0, kind=Kind.INT16, least=-32768, most=32767),
    _real("SIM_GPS1_ACC", 0.3, 0.0, 1000.0),
    *(_real(f"SIM_GPS1_VERR_{axis}", 0.0, -1000.0, 1000.0) for axis in "XYZ"),
    _switch("SIM_GPS1_JAM"),
    _switch("SIM_GPS1_FIXTYPE", 6, 6),
    _real("SIM_GPS1_HNSE", 0.0, -_FARTHEST, _FARTHEST),
    *(_real(f"SIM_GPS1_GLTV_{axis}", 0.0, -100.0, 100.0) for axis in "XYZ"),
    _real("SIM_GPS_SIGMA", 0.0, 0.0, 1000.0),
)
_WIND = (
    _real("SIM_WIND_SPD", 0.0, 0.0, 100.0),
    _real("SIM_WIND_DIR", 180.0, -3600.0, 3600.0),
    _real("SIM_WIND_TURB", 0.0, 0.0, 50.0),
    _real("SIM_WIND_DIR_Z", 0.0, -90.0, 90.0),
    _switch("SIM_WIND_T"),
    _real("SIM_WIND_T_ALT", 60.0, 0.0, _FARTHEST),
    _real("SIM_WIND_TC", 5.0, 0.0, 60.0),
)
_BATTERY_ARDUPILOT = (
    _real("SIM_BATT_VOLTAGE", 12.6, 0.0, 60.0),
    _real("SIM_BATT_CAP_AH", 0.0, 0.0, 1000.0),
)
_BATTERY_PX4 = (_real("SIM_BAT_DRAIN", 60.0, 1.0, 86400.0), _real("SIM_BAT_MIN_PCT", 50.0, 0, 100))
_GPS_PX4 = (Parameter(name="SIM_GPS_USED", default=10, kind=Kind.INT32, least=0, most=50),)
_OWN = (
    _share("SIM_BATT_MOST", 100.0),
    _switch("SIM_LNK_OFF"),
    _share("SIM_LNK_LOSS"),
    _real("SIM_LNK_DELAY", 0.0, 0.0, 60_000.0),
    _real("SIM_LNK_JITTER", 0.0, 0.0, 60_000.0),
    _share("SIM_LNK_DUP"),
    _share("SIM_LNK_REORD"),
    _share("SIM_LNK_CORR"),
    _switch("SIM_LNK_WAY", 0.0, 2.0),
    Parameter(name="SIM_LNK_MASK", default=0, kind=Kind.INT32, least=0, most=2**24 - 1),
    _switch("SIM_RDR_OFF"),
    _switch("SIM_RDR_BLIND"),
    _share("SIM_RDR_MISS"),
    _share("SIM_RDR_LOSS"),
    _real("SIM_RDR_NOISE", 0.0, -10_000.0, 10_000.0),
    _real("SIM_RDR_DELAY", 0.0, 0.0, 60_000.0),
    _real("SIM_RDR_HZ", 0.0, 0.0, 100.0),
    _switch("SIM_SP_IGNORE"),
    _real("SIM_EKF_RST_N", 0.0, -_FARTHEST, _FARTHEST),
    _real("SIM_EKF_RST_E", 0.0, -_FARTHEST, _FARTHEST),
    *(_real(f"SIM_ORG_MOV_{axis}", 0.0, -_FARTHEST, _FARTHEST) for axis in "NEU"),
    _switch("SIM_PILOT"),
    _switch("SIM_REBOOT"),
)

SIM_PARAMETERS: tuple[Parameter, ...] = (*_GPS, *_WIND, *_BATTERY_ARDUPILOT, *_OWN)
"""What both ArduPilots' tables end with."""


def _as_px4(row: Parameter) -> Parameter:
    """PX4 knows INT32 and FLOAT only, and its simulated receiver is never late."""
    default = 0.0 if row.name == "SIM_GPS1_LAG_MS" else row.default
    kind = Kind.REAL32 if row.kind is Kind.REAL32 else Kind.INT32
    return dataclasses.replace(row, kind=kind, default=default)


SIM_PARAMETERS_PX4: tuple[Parameter, ...] = (
    *_GPS_PX4,
    *_BATTERY_PX4,
    *(_as_px4(row) for row in (*_GPS, *_WIND, *_OWN)),
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


def conditions_of(parameters: Readable) -> Conditions:
    """What the parameters ask for now.  A parameter that the table lacks has no effect."""
    return Conditions(
        gps=_gps(parameters),
        wind=_wind(parameters),
        battery=_battery(parameters),
        link=_link(parameters),
        radar=_radar(parameters),
        setpoints_ignored=value_of(parameters, "SIM_SP_IGNORE") != 0.0,
    )


def value_of(parameters: Readable, name: str, otherwise: float = 0.0) -> float:
    """The value of a parameter that the table may lack, or that is not a number."""
    try:
        value = parameters[name]
    except KeyError:
        return otherwise
    return value if math.isfinite(value) else otherwise


def _gps(parameters: Readable) -> GpsConditions:
    used = round(
        value_of(parameters, "SIM_GPS_USED", value_of(parameters, "SIM_GPS1_NUMSATS", 10.0))
    )
    enough = "SIM_GPS_USED" not in parameters or used >= _LEAST_SATELLITES

    def of(name: str, otherwise: float = 0.0) -> float:
        return value_of(parameters, f"SIM_GPS1_{name}", otherwise)

    return GpsConditions(
        enabled=of("ENABLE", 1.0) != 0.0 and enough,
        satellites=used,
        fix_type=round(of("FIXTYPE", 6.0)),
        lock_s=of("LCKTIME"),
        lag_s=of("LAG_MS", 100.0) * 1e-3,
        jammed=of("JAM") != 0.0,
        glitch_latitude_deg=of("GLTCH_X"),
        glitch_longitude_deg=of("GLTCH_Y"),
        glitch_up_m=of("GLTCH_Z"),
        drift_north_m_s=of("GLTV_X"),
        drift_east_m_s=of("GLTV_Y"),
        drift_up_m_s=-of("GLTV_Z"),
        circle_m=of("HNSE"),
        wave_m=of("NOISE"),
        swell_m=max(of("DRFTALT"), 0.0),
        offset_up_m=of("ALT_OFS"),
        accuracy_m=of("ACC", 0.3),
        sigma_m=value_of(parameters, "SIM_GPS_SIGMA"),
        velocity_error_north_m_s=of("VERR_X"),
        velocity_error_east_m_s=of("VERR_Y"),
        velocity_error_up_m_s=of("VERR_Z"),
    )


def _wind(parameters: Readable) -> WindConditions:
    return WindConditions(
        speed_m_s=value_of(parameters, "SIM_WIND_SPD"),
        from_rad=math.radians(value_of(parameters, "SIM_WIND_DIR")),
        rising_rad=math.radians(value_of(parameters, "SIM_WIND_DIR_Z")),
        turbulence_m_s=value_of(parameters, "SIM_WIND_TURB"),
        profile=round(value_of(parameters, "SIM_WIND_T")),
        full_height_m=value_of(parameters, "SIM_WIND_T_ALT", 60.0),
        settling_s=value_of(parameters, "SIM_WIND_TC", 5.0),
    )


def _battery(parameters: Readable) -> BatteryConditions:
    return BatteryConditions(
        voltage_v=value_of(parameters, "SIM_BATT_VOLTAGE", 12.6),
        capacity_ah=value_of(parameters, "SIM_BATT_CAP_AH"),
        gauge_mah=value_of(parameters, "BATT_CAPACITY", 3300.0),
        drain_s=value_of(parameters, "SIM_BAT_DRAIN", 60.0),
        least=value_of(parameters, "SIM_BAT_MIN_PCT", 50.0) * 0.01,
        most=value_of(parameters, "SIM_BATT_MOST", 100.0) * 0.01,
    )


def _link(parameters: Readable) -> LinkConditions:
    way = round(value_of(parameters, "SIM_LNK_WAY"))
    return LinkConditions(
        off=value_of(parameters, "SIM_LNK_OFF") != 0.0,
        lost=value_of(parameters, "SIM_LNK_LOSS") * 0.01,
        delay_us=round(value_of(parameters, "SIM_LNK_DELAY") * 1e3),
        jitter_us=round(value_of(parameters, "SIM_LNK_JITTER") * 1e3),
        duplicated=value_of(parameters, "SIM_LNK_DUP") * 0.01,
        reordered=value_of(parameters, "SIM_LNK_REORD") * 0.01,
        corrupted=value_of(parameters, "SIM_LNK_CORR") * 0.01,
        to_vehicle=way != 2,
        from_vehicle=way != 1,
        mask=round(value_of(parameters, "SIM_LNK_MASK")),
    )


def _radar(parameters: Readable) -> RadarConditions:
    return RadarConditions(
        silent=value_of(parameters, "SIM_RDR_OFF") != 0.0,
        blind=value_of(parameters, "SIM_RDR_BLIND") != 0.0,
        cells_missed=value_of(parameters, "SIM_RDR_MISS") * 0.01,
        frames_lost=value_of(parameters, "SIM_RDR_LOSS") * 0.01,
        noise_m=value_of(parameters, "SIM_RDR_NOISE"),
        delay_s=value_of(parameters, "SIM_RDR_DELAY") * 1e-3,
        rate_hz=value_of(parameters, "SIM_RDR_HZ"),
    )


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
