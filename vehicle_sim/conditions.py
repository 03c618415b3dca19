"""What may be wrong with a vehicle and its surroundings.  Every condition is a SIM_ parameter.

Names and units of the parameters are ArduPilot's (libraries/SITL) and PX4's (SIM_GPS_USED,
SIM_BAT_*) where they have one for it; the others are this simulator's own.  A share is 0 to 1 as a
condition and percent as a parameter; times and angles change their units likewise.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, final

from vehicle_sim.parameters import Kind, Parameter, Parameters, Readable

_FAR: Final = 1e5
"""Of places and heights, in metres."""
_MIN_SATELLITES: Final = 4
"""With fewer PX4's simulated receiver has no fix (px4.md 8)."""


def _real(
    name: str,
    least: float,
    most: float,
    default: float = 0.0,
    means: Callable[[float], Any] = float,
    kind: Kind = Kind.REAL32,
) -> Any:
    """A condition, and the parameter whose value `means` it."""
    row = Parameter(name=name, default=default, kind=kind, least=float(least), most=float(most))
    return field(default=means(default), metadata={"row": row, "means": means})


def _whole(
    name: str, least: float, most: float, default: float = 0.0, means: Any = round, bits: int = 16
) -> Any:
    kind = {8: Kind.INT8, 16: Kind.INT16, 32: Kind.INT32}[bits]
    return _real(name, least, most, default, means, kind)


def _switch(name: str, default: float = 0.0) -> Any:
    return _whole(name, 0, 1, default, bool, bits=8)


def _share(name: str, default: float = 0.0) -> Any:
    return _real(name, 0, 100, default, lambda percent: percent * 0.01)


def _seconds(milliseconds: float) -> float:
    return milliseconds * 1e-3


def _microseconds(milliseconds: float) -> int:
    return round(milliseconds * 1e3)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class GpsConditions:
    """What is wrong with the receiver or the sky.  North, east and up, true."""

    enabled: bool = _switch("SIM_GPS1_ENABLE", 1)
    lag_s: float = _whole("SIM_GPS1_LAG_MS", 0, 5000, 100, _seconds)
    satellites: int = _whole("SIM_GPS1_NUMSATS", 0, 50, 10, bits=8)
    glitch_latitude_deg: float = _real("SIM_GPS1_GLTCH_X", -90, 90)
    glitch_longitude_deg: float = _real("SIM_GPS1_GLTCH_Y", -180, 180)
    glitch_up_m: float = _real("SIM_GPS1_GLTCH_Z", -_FAR, _FAR)
    offset_up_m: float = _whole("SIM_GPS1_ALT_OFS", -32_768, 32_767, means=float)
    jammed: bool = _switch("SIM_GPS1_JAM")
    fix_type: int = _whole("SIM_GPS1_FIXTYPE", 0, 6, 6, bits=8)
    """The best that it reaches."""
    drift_north_m_s: float = _real("SIM_GPS1_GLTV_X", -100, 100)
    """The position moves away at this speed, and the velocity says so, until all three are 0."""
    drift_east_m_s: float = _real("SIM_GPS1_GLTV_Y", -100, 100)
    drift_up_m_s: float = _real("SIM_GPS1_GLTV_Z", -100, 100, means=lambda down_m_s: -down_m_s)
    sigma_m: float = _real("SIM_GPS_SIGMA", 0, 1000)
    """Standard deviation of a random error of each horizontal axis; 1.5 times that in height."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class WindConditions:
    """The wind that is asked for, in ArduPilot's terms."""

    speed_m_s: float = _real("SIM_WIND_SPD", 0, 100)
    from_rad: float = _real("SIM_WIND_DIR", -360, 360, 180, math.radians)
    """True direction that it comes from, as weather reports have it."""
    turbulence_m_s: float = _real("SIM_WIND_TURB", 0, 50)
    """Standard deviation of the horizontal gusts."""
    rising_rad: float = _real("SIM_WIND_DIR_Z", -90, 90, means=math.radians)
    """Above the horizontal, positive upwards."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BatteryConditions:
    """What is asked of the battery."""

    most: float = _share("SIM_BATT_MOST", 100)
    """Upper limit of the reported charge."""
    voltage_v: float = _real("SIM_BATT_VOLTAGE", 0, 60, 12.6)
    """Full, at rest (ArduPilot)."""
    capacity_ah: float = _real("SIM_BATT_CAP_AH", 0, 1000)
    """Of which the voltage knows (ArduPilot); 0: it never falls by use."""
    drain_s: float = _real("SIM_BAT_DRAIN", 1, 86_400, 60)
    """From full to empty, armed (PX4)."""
    least: float = _share("SIM_BAT_MIN_PCT", 50)
    """Where that ends (PX4)."""
    gauge_mah: float = 3300.0
    """Which an ArduPilot believes it has: its own parameter BATT_CAPACITY."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConditions:
    """What is wrong with the links."""

    off: bool = _switch("SIM_LNK_OFF")
    lost: float = _share("SIM_LNK_LOSS")
    delay_us: int = _real("SIM_LNK_DELAY", 0, 60_000, means=_microseconds)
    jitter_us: int = _real("SIM_LNK_JITTER", 0, 60_000, means=_microseconds)
    """Up to this much more for each frame; a frame may overtake another so."""
    duplicated: float = _share("SIM_LNK_DUP")
    reordered: float = _share("SIM_LNK_REORD")
    corrupted: float = _share("SIM_LNK_CORR")
    to_vehicle: bool = _whole("SIM_LNK_WAY", 0, 2, means=lambda way: way != 2, bits=8)
    """Whether frames to the vehicle are concerned, and those from it."""
    from_vehicle: bool = _whole("SIM_LNK_WAY", 0, 2, means=lambda way: way != 1, bits=8)
    mask: int = _whole("SIM_LNK_MASK", 0, 2**24 - 1, bits=32)
    """Bit n: link n is concerned; 0: all are."""

    @property
    def any(self) -> bool:
        """Something is wrong."""
        shares = (self.lost, self.duplicated, self.reordered, self.corrupted)
        return any((self.off, self.delay_us, self.jitter_us, *shares))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RadarConditions:
    """What is wrong with the terrain radar."""

    silent: bool = _switch("SIM_RDR_OFF")
    """Answers nothing and has no heartbeat."""
    blind: bool = _switch("SIM_RDR_BLIND")
    """Answers, and sees nothing."""
    cells_missed: float = _share("SIM_RDR_MISS")
    """Share of cells in sight that it does not see all the same."""
    frames_lost: float = _share("SIM_RDR_LOSS")
    """Share of TERRAIN_DATA that is never sent."""
    noise_m: float = _real("SIM_RDR_NOISE", -10_000, 10_000)
    """Standard deviation of the normal law that each height's error is drawn from.  Positive: its
    size is added and the sum rounded up, so that no cell is told lower than it is, and on average
    0.8 of this too high: what a radar reports whose maker counts errors against it.  Negative: the
    error goes either way, and a cell may be told lower than it is."""
    delay_s: float = _real("SIM_RDR_DELAY", 0, 60_000, means=_seconds)
    rate_hz: float = _real("SIM_RDR_HZ", 0, 100)
    """Requests answered a second, at the beats of its own sweep; 0: each at the end of its tick."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LidarConditions:
    """What is wrong with the lidar and its driver."""

    dead: bool = _switch("SIM_LDR_DEAD")
    """It measures nothing any more; its driver is well."""
    blind: bool = _switch("SIM_LDR_BLIND")
    """It measures, and no echo comes back."""
    silent: bool = _switch("SIM_LDR_OFF")
    """The driver says nothing: no heartbeat either."""
    frames_lost: float = _share("SIM_LDR_LOSS")
    """Between the driver and the autopilot."""
    dust: float = _share("SIM_LDR_DUST")
    """Share of the beams with a near echo of nothing: dust, rain, sun."""
    stuck: bool = _switch("SIM_LDR_STUCK")
    """The same distances for ever, with new stamps."""
    turned_rad: float = _real("SIM_LDR_YAW", -360, 360, means=math.radians)
    """It is mounted turned by this, and nobody knows."""
    clock_us: int = _real("SIM_LDR_CLOCK", -1e9, 1e9, means=_microseconds)
    """The driver's clock is ahead by this."""
    clock_jump_us: int = _real("SIM_LDR_JUMP", 0, 60_000, means=_microseconds)
    """Each stamp is wrong by up to this, either way."""
    rate_hz: float = _real("SIM_LDR_HZ", 0, 1000)
    """Of the driver's messages; 0: as in the world."""
    frame: int = _whole("SIM_LDR_FRAME", 0, 255, 12)
    """MAV_FRAME that the driver claims."""
    junk: float = _share("SIM_LDR_JUNK")
    """Share of the distances that are 0, 65535 or beyond the limits, and of messages whose
    increment or offset is NaN."""
    mirrored: bool = _switch("SIM_LDR_MIRROR")
    """What a client says of obstacles comes back to it, and all that the driver says is said in the
    companion's name too."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """All that the parameters ask for, by who minds it."""

    gps: GpsConditions = field(default_factory=GpsConditions)
    wind: WindConditions = field(default_factory=WindConditions)
    battery: BatteryConditions = field(default_factory=BatteryConditions)
    link: LinkConditions = field(default_factory=LinkConditions)
    radar: RadarConditions = field(default_factory=RadarConditions)
    lidar: LidarConditions = field(default_factory=LidarConditions)
    rangefinder_off: bool = _switch("SIM_RFND_OFF")
    setpoints_ignored: bool = _switch("SIM_SP_IGNORE")


def conditions_of(parameters: Readable) -> Conditions:
    """What the parameters ask for now; one that the table lacks has its usual value."""
    asked: Conditions = _asked(Conditions, parameters)
    gauge_mah = value_of(parameters, "BATT_CAPACITY", asked.battery.gauge_mah)
    gps = asked.gps
    if _PX4_SATELLITES.name in parameters:
        used = round(value_of(parameters, _PX4_SATELLITES.name))
        gps = replace(gps, satellites=used, enabled=gps.enabled and used >= _MIN_SATELLITES)
    return replace(asked, gps=gps, battery=replace(asked.battery, gauge_mah=gauge_mah))


def _asked(kind: Any, parameters: Readable) -> Any:
    """A class of conditions, from the parameters of its fields."""
    values = {}
    for each in dataclasses.fields(kind):
        if row := each.metadata.get("row"):
            value = value_of(parameters, row.name, row.default)
            values[each.name] = each.metadata["means"](value)
        elif dataclasses.is_dataclass(each.type):
            values[each.name] = _asked(each.type, parameters)
    return kind(**values)


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


def _rows(names: str, least: float, most: float, kind: Kind = Kind.REAL32) -> list[Parameter]:
    return [
        Parameter(name=name, default=0.0, kind=kind, least=least, most=most)
        for name in names.split()
    ]


_TRIGGERS: Final[Mapping[OneShot, list[Parameter]]] = {
    "estimator_reset": _rows("SIM_EKF_RST_N SIM_EKF_RST_E", -_FAR, _FAR),
    "origin_move": _rows("SIM_ORG_MOV_N SIM_ORG_MOV_E SIM_ORG_MOV_U", -_FAR, _FAR),
    "pilot": _rows("SIM_PILOT", 0.0, 1.0, Kind.INT8),
    "reboot": _rows("SIM_REBOOT", 0.0, 1.0, Kind.INT8),
    "ground_command": [
        *_rows("SIM_GCS_CMD", 0.0, 65_535.0, Kind.INT32),
        *_rows("SIM_GCS_P1 SIM_GCS_P2 SIM_GCS_P3", -1e9, 1e9),
        *_rows("SIM_GCS_TO", 0.0, 1.0, Kind.INT8),
    ],
    "ground_target": _rows("SIM_GCS_TGT_N SIM_GCS_TGT_E", -_FAR, _FAR),
    "ground_fence": _rows("SIM_GCS_FNC_R SIM_GCS_FNC_A", 0.0, _FAR),
}
_BY_THE_FIRST: Final = ("ground_command", "ground_fence")
"""Their first trigger alone makes them happen: the others may be set before it."""


def take_one_shots(
    parameters: MutableMapping[str, float] | Parameters,
) -> list[tuple[OneShot, tuple[float, ...]]]:
    """What the triggers ask for; they are 0 again afterwards, ready for the next time."""
    taken = list[tuple[OneShot, tuple[float, ...]]]()
    for name, triggers in _TRIGGERS.items():
        values = tuple(value_of(parameters, trigger.name) for trigger in triggers)
        if any(values[:1] if name in _BY_THE_FIRST else values):
            taken.append((name, values))
            for trigger, value in zip(triggers, values, strict=True):
                if value:
                    parameters[trigger.name] = 0.0
    return taken


# --- the tables of the autopilots -----------------------------------------------------------------


def _all_rows(kind: Any) -> Iterator[Parameter]:
    for each in dataclasses.fields(kind):
        if row := each.metadata.get("row"):
            yield row
        elif dataclasses.is_dataclass(each.type):
            yield from _all_rows(each.type)


def _as_px4(row: Parameter) -> Parameter:
    """PX4 knows INT32 and FLOAT only, and its simulated receiver is never late."""
    default = 0.0 if row.name == "SIM_GPS1_LAG_MS" else row.default
    kind = Kind.REAL32 if row.kind is Kind.REAL32 else Kind.INT32
    return replace(row, kind=kind, default=default)


_PX4_SATELLITES: Final = Parameter(
    name="SIM_GPS_USED", default=10.0, kind=Kind.INT32, least=0.0, most=50.0
)
_ONLY_ARDUPILOT: Final = ("SIM_BATT_VOLTAGE", "SIM_BATT_CAP_AH")
_ONLY_PX4: Final = ("SIM_BAT_DRAIN", "SIM_BAT_MIN_PCT")
_ALL: Final = {row.name: row for row in _all_rows(Conditions)} | {
    row.name: row for rows in _TRIGGERS.values() for row in rows
}
SIM_PARAMETERS: Final = tuple(row for name, row in _ALL.items() if name not in _ONLY_PX4)
"""What both ArduPilots' tables end with."""
SIM_PARAMETERS_PX4: Final = (
    _PX4_SATELLITES,
    *(_as_px4(row) for name, row in _ALL.items() if name not in _ONLY_ARDUPILOT),
)
"""What both PX4s' tables end with."""
