"""The SIM_ parameters, what they mean in SI units, and the things that they make happen once.

Names and units are ArduPilot's (libraries/SITL) and PX4's (SIM_GPS_USED, SIM_BAT_*) where they have
one for it; the others are this simulator's own.  Every fault can be set like any other parameter.
"""

import math
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, NamedTuple, final

from vehicle_sim.dynamics.battery import BatteryConditions
from vehicle_sim.dynamics.wind import WindConditions
from vehicle_sim.parameters import Kind, Parameter, Parameters, Readable
from vehicle_sim.sensors.gps import GpsConditions
from vehicle_sim.sensors.lidar import LidarConditions
from vehicle_sim.sensors.terrain_radar import RadarConditions


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


# --- the parameters: a row each, by the condition that it sets ------------------------------------

_MIN_SATELLITES = 4
"""With fewer PX4's simulated receiver has no fix (px4.md 8)."""
_FAR: Final = 1e5
"""Of places and heights, in metres."""


@final
class _Row(NamedTuple):
    parameter: Parameter
    means: Callable[[float], float | bool]
    """The condition, of the parameter's value."""


def _real(name: str, least: float, most: float, default: float = 0.0, means: Any = float) -> _Row:
    return _Row(Parameter(name=name, default=default, least=float(least), most=float(most)), means)


def _whole(
    name: str,
    least: float,
    most: float,
    default: float = 0.0,
    means: Any = round,
    kind: Kind = Kind.INT16,
) -> _Row:
    return _Row(
        Parameter(name=name, default=default, kind=kind, least=float(least), most=float(most)),
        means,
    )


def _switch(name: str, default: float = 0.0) -> _Row:
    return _whole(name, 0, 1, default, bool, Kind.INT8)


def _share(name: str, default: float = 0.0) -> _Row:
    return _real(name, 0, 100, default, lambda percent: percent * 0.01)


def _seconds(milliseconds: float) -> float:
    return milliseconds * 1e-3


def _microseconds(milliseconds: float) -> int:
    return round(milliseconds * 1e3)


_GPS: Final = {
    "enabled": _switch("SIM_GPS1_ENABLE", 1),
    "lag_s": _whole("SIM_GPS1_LAG_MS", 0, 5000, 100, _seconds),
    "satellites": _whole("SIM_GPS1_NUMSATS", 0, 50, 10, kind=Kind.INT8),
    "glitch_latitude_deg": _real("SIM_GPS1_GLTCH_X", -90, 90),
    "glitch_longitude_deg": _real("SIM_GPS1_GLTCH_Y", -180, 180),
    "glitch_up_m": _real("SIM_GPS1_GLTCH_Z", -_FAR, _FAR),
    "swell_m": _real("SIM_GPS1_DRFTALT", -_FAR, _FAR, means=lambda m: max(m, 0.0)),
    "wave_m": _real("SIM_GPS1_NOISE", -_FAR, _FAR),
    "lock_s": _whole("SIM_GPS1_LCKTIME", 0, 32_767, means=float),
    "offset_up_m": _whole("SIM_GPS1_ALT_OFS", -32_768, 32_767, means=float),
    "accuracy_m": _real("SIM_GPS1_ACC", 0, 1000, 0.3),
    "velocity_error_north_m_s": _real("SIM_GPS1_VERR_X", -1000, 1000),
    "velocity_error_east_m_s": _real("SIM_GPS1_VERR_Y", -1000, 1000),
    "velocity_error_up_m_s": _real("SIM_GPS1_VERR_Z", -1000, 1000),
    "jammed": _switch("SIM_GPS1_JAM"),
    "fix_type": _whole("SIM_GPS1_FIXTYPE", 0, 6, 6, kind=Kind.INT8),
    "circle_m": _real("SIM_GPS1_HNSE", -_FAR, _FAR),
    "drift_north_m_s": _real("SIM_GPS1_GLTV_X", -100, 100),
    "drift_east_m_s": _real("SIM_GPS1_GLTV_Y", -100, 100),
    "drift_up_m_s": _real("SIM_GPS1_GLTV_Z", -100, 100, means=lambda down_m_s: -down_m_s),
    "sigma_m": _real("SIM_GPS_SIGMA", 0, 1000),
}
_WIND: Final = {
    "speed_m_s": _real("SIM_WIND_SPD", 0, 100),
    "from_rad": _real("SIM_WIND_DIR", -3600, 3600, 180, math.radians),
    "turbulence_m_s": _real("SIM_WIND_TURB", 0, 50),
    "rising_rad": _real("SIM_WIND_DIR_Z", -90, 90, means=math.radians),
    "profile": _whole("SIM_WIND_T", 0, 1, kind=Kind.INT8),
    "full_height_m": _real("SIM_WIND_T_ALT", 0, _FAR, 60),
    "settling_s": _real("SIM_WIND_TC", 0, 60, 5),
}
_BATTERY: Final = {"most": _share("SIM_BATT_MOST", 100)}
_LINK: Final = {
    "off": _switch("SIM_LNK_OFF"),
    "lost": _share("SIM_LNK_LOSS"),
    "delay_us": _real("SIM_LNK_DELAY", 0, 60_000, means=_microseconds),
    "jitter_us": _real("SIM_LNK_JITTER", 0, 60_000, means=_microseconds),
    "duplicated": _share("SIM_LNK_DUP"),
    "reordered": _share("SIM_LNK_REORD"),
    "corrupted": _share("SIM_LNK_CORR"),
    "way": _whole("SIM_LNK_WAY", 0, 2, kind=Kind.INT8),
    "mask": _whole("SIM_LNK_MASK", 0, 2**24 - 1, kind=Kind.INT32),
}
_RADAR: Final = {
    "silent": _switch("SIM_RDR_OFF"),
    "blind": _switch("SIM_RDR_BLIND"),
    "cells_missed": _share("SIM_RDR_MISS"),
    "frames_lost": _share("SIM_RDR_LOSS"),
    "noise_m": _real("SIM_RDR_NOISE", -10_000, 10_000),
    "delay_s": _real("SIM_RDR_DELAY", 0, 60_000, means=_seconds),
    "rate_hz": _real("SIM_RDR_HZ", 0, 100),
}
_LIDAR: Final = {
    "dead": _switch("SIM_LDR_DEAD"),
    "blind": _switch("SIM_LDR_BLIND"),
    "silent": _switch("SIM_LDR_OFF"),
    "frames_lost": _share("SIM_LDR_LOSS"),
    "dust": _share("SIM_LDR_DUST"),
    "stuck": _switch("SIM_LDR_STUCK"),
    "turned_rad": _real("SIM_LDR_YAW", -360, 360, means=math.radians),
    "clock_us": _real("SIM_LDR_CLOCK", -1e9, 1e9, means=_microseconds),
    "clock_jump_us": _real("SIM_LDR_JUMP", 0, 60_000, means=_microseconds),
    "rate_hz": _real("SIM_LDR_HZ", 0, 1000),
    "frame": _whole("SIM_LDR_FRAME", 0, 255, 12),
    "junk": _share("SIM_LDR_JUNK"),
    "mirrored": _switch("SIM_LDR_MIRROR"),
}
_REST: Final = {
    "rangefinder_off": _switch("SIM_RFND_OFF"),
    "setpoints_ignored": _switch("SIM_SP_IGNORE"),
}
_ONCE: Final = (
    *(_real(f"SIM_EKF_RST_{axis}", -_FAR, _FAR) for axis in "NE"),
    *(_real(f"SIM_ORG_MOV_{axis}", -_FAR, _FAR) for axis in "NEU"),
    _switch("SIM_PILOT"),
    _switch("SIM_REBOOT"),
    _whole("SIM_GCS_CMD", 0, 65_535, kind=Kind.INT32),
    *(_real(f"SIM_GCS_P{number}", -1e9, 1e9) for number in (1, 2, 3)),
    _switch("SIM_GCS_TO"),
    *(_real(f"SIM_GCS_TGT_{axis}", -_FAR, _FAR) for axis in "NE"),
    _real("SIM_GCS_FNC_R", 0, _FAR),
    _real("SIM_GCS_FNC_A", 0, _FAR),
)
"""They set no condition: take_one_shots() reads them."""
_ARDUPILOT_BATTERY: Final = {
    "voltage_v": _real("SIM_BATT_VOLTAGE", 0, 60, 12.6),
    "capacity_ah": _real("SIM_BATT_CAP_AH", 0, 1000),
}
_PX4_GPS: Final = {"satellites": _whole("SIM_GPS_USED", 0, 50, 10, kind=Kind.INT32)}
_PX4_BATTERY: Final = {
    "drain_s": _real("SIM_BAT_DRAIN", 1, 86_400, 60),
    "least": _share("SIM_BAT_MIN_PCT", 50),
}
_SECTIONS: Final = (_GPS, _WIND, _BATTERY, _LINK, _RADAR, _LIDAR, _REST)
_OF_BOTH: Final = tuple(
    row.parameter for row in (*(row for section in _SECTIONS for row in section.values()), *_ONCE)
)


def _as_px4(row: Parameter) -> Parameter:
    """PX4 knows INT32 and FLOAT only, and its simulated receiver is never late."""
    default = 0.0 if row.name == "SIM_GPS1_LAG_MS" else row.default
    kind = Kind.REAL32 if row.kind is Kind.REAL32 else Kind.INT32
    return replace(row, kind=kind, default=default)


SIM_PARAMETERS = (*_OF_BOTH, *(row.parameter for row in _ARDUPILOT_BATTERY.values()))
"""What both ArduPilots' tables end with."""
SIM_PARAMETERS_PX4 = (
    *(row.parameter for row in (*_PX4_GPS.values(), *_PX4_BATTERY.values())),
    *map(_as_px4, _OF_BOTH),
)
"""What both PX4s' tables end with."""


def conditions_of(parameters: Readable) -> Conditions:
    """What the parameters ask for now; one that the table lacks has its usual value."""

    def asked(rows: Mapping[str, _Row]) -> dict[str, Any]:
        return {
            condition: row.means(value_of(parameters, row.parameter.name, row.parameter.default))
            for condition, row in rows.items()
        }

    gps, link = asked(_GPS), asked(_LINK)
    if "SIM_GPS_USED" in parameters:
        gps |= asked(_PX4_GPS)
        gps["enabled"] &= gps["satellites"] >= _MIN_SATELLITES
    battery = asked(_BATTERY | _ARDUPILOT_BATTERY | _PX4_BATTERY)
    battery["gauge_mah"] = value_of(parameters, "BATT_CAPACITY", BatteryConditions().gauge_mah)
    way = link.pop("way")
    return Conditions(
        gps=GpsConditions(**gps),
        wind=WindConditions(**asked(_WIND)),
        battery=BatteryConditions(**battery),
        link=LinkConditions(**link, to_vehicle=way != 2, from_vehicle=way != 1),
        radar=RadarConditions(**asked(_RADAR)),
        lidar=LidarConditions(**asked(_LIDAR)),
        **asked(_REST),
    )


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
