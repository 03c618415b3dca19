"""What may be wrong with a vehicle and its surroundings.

Each condition is one row: a field with the line of a timeline that asks for it, what that means,
within which limits, and the SIM_ parameter that does the same where ArduPilot (libraries/SITL) or
PX4 has one.  In a line N is a number: the first is the row's own field, the others those that it
names (`also`), in order.  WHERE is north, east, south, west, up or down, SIDE one of the first
four; [...] may be left out, and a field then has its usual value.  A word with an underscore is a
switch: a field of this name.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple, final

from vehicle_sim.parameters import Kind, Parameter, Readable

_FAR_M: Final = 1e5
_PX4_MIN_SATELLITES: Final = 4
"""With fewer PX4's simulated receiver has no fix (px4.md 8)."""
Vector = tuple[float, float, float]
"""North, east, up."""


@final
class Row(NamedTuple):
    """How a condition is asked for."""

    line: str
    about: str
    also: Sequence[str]
    least: float
    most: float
    means: Callable[[float], Any]
    """The condition, of a number of the line and of the parameter."""
    parameter: Parameter | None


def _number(
    line: str = "",
    about: str = "",
    least: float = 0.0,
    most: float = 100.0,
    *,
    usual: float = 0.0,
    means: Callable[[float], Any] = float,
    also: str = "",
    parameter: str = "",
    kind: Kind = Kind.REAL32,
) -> Any:
    named = Parameter(name=parameter, default=usual, kind=kind, least=least, most=most)
    row = Row(line, about, also.split(), least, most, means, named if parameter else None)
    return field(default=means(usual), metadata={"row": row})


def _switch(line: str = "", about: str = "", *, usual: bool = False, parameter: str = "") -> Any:
    """The line turns it to the other value."""
    limits, kind = (0.0, 1.0), Kind.INT8
    return _number(line, about, *limits, usual=usual, means=bool, parameter=parameter, kind=kind)


def _share(line: str = "", about: str = "", *, usual: float = 0.0, parameter: str = "") -> Any:
    return _number(line, about, usual=usual, means=_of_percent, parameter=parameter)


def _link(line: str, about: str, *, also: str = "", **how: Any) -> Any:
    """Of both ways and all links unless it says which."""
    line += " [to_vehicle|from_vehicle] [on link N]"
    return _number(line, about, also=f"{also} mask", **how)


def _vector(line: str, about: str, most: float) -> Any:
    row = Row(line, about, [], 0.0, most, float, None)
    return field(default=(0.0, 0.0, 0.0), metadata={"row": row})


def _of_percent(percent: float) -> float:
    return percent * 0.01


def _seconds(milliseconds: float) -> float:
    return milliseconds * 1e-3


def _microseconds(milliseconds: float) -> int:
    return round(milliseconds * 1e3)


# fmt: off
@final
@dataclass(frozen=True, slots=True, kw_only=True)
class GpsConditions:
    """What is wrong with the receiver or the sky.  North, east and up, true."""

    enabled: bool = _switch(
        "gps_off", "The receiver loses its fix.", usual=True, parameter="SIM_GPS1_ENABLE")
    glitch_m: tuple[float, float, float] = _vector(
        "gps_glitch N m WHERE [N m WHERE]", "The receiver's position is off by so much.", _FAR_M)
    glitch_latitude_deg: float = _number(least=-90, most=90, parameter="SIM_GPS1_GLTCH_X")
    glitch_longitude_deg: float = _number(least=-180, most=180, parameter="SIM_GPS1_GLTCH_Y")
    glitch_up_m: float = _number(least=-_FAR_M, most=_FAR_M, parameter="SIM_GPS1_GLTCH_Z")
    offset_up_m: float = _number(
        least=-32_768, most=32_767, parameter="SIM_GPS1_ALT_OFS", kind=Kind.INT16)
    drift_m_s: tuple[float, float, float] = _vector(
        "gps_drift N m/s WHERE",
        "The receiver's position wanders off at this speed, and its velocity says so.", 100)
    jammed: bool = _switch(
        "gps_jam", "The fix comes and goes, with wild positions and velocities.",
        parameter="SIM_GPS1_JAM")
    sigma_m: float = _number(
        "gps_noise N m", "A random error with this standard deviation on each horizontal axis, 1.5 "
        "times that in height, correlated over seconds.", most=1000)
    lag_s: float = _number(
        "gps_delay N ms", "The receiver's solutions are this old.", most=5000, usual=100,
        means=_seconds, parameter="SIM_GPS1_LAG_MS", kind=Kind.INT16)
    satellites: int = _number(
        "gps_satellites N", "The receiver sees so many satellites; PX4 has no fix with fewer than "
        "4.", most=50, usual=10, means=round, parameter="SIM_GPS1_NUMSATS", kind=Kind.INT8)
    fix_type: int = 6
    """The best that it reaches."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class WindConditions:
    """The wind that is asked for, in ArduPilot's terms."""

    speed_m_s: float = _number(
        "wind N m/s from N deg [turbulence N [m/s]] [rising N deg]",
        "Wind from this true direction, full from 60 m above the ground on, with gusts of this "
        "standard deviation, rising by this angle.",
        also="from_rad turbulence_m_s rising_rad", parameter="SIM_WIND_SPD")
    from_rad: float = _number(
        least=-360, most=360, usual=180, means=math.radians, parameter="SIM_WIND_DIR")
    turbulence_m_s: float = _number(
        "turbulence N m/s", "Gusts of this standard deviation.", most=50,
        parameter="SIM_WIND_TURB")
    rising_rad: float = _number(
        least=-90, most=90, means=math.radians, parameter="SIM_WIND_DIR_Z")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BatteryConditions:
    """What is asked of the battery."""

    most: float = _share("battery N %", "No more than this is left in the battery.", usual=100)
    voltage_v: float = _number(
        "battery_voltage N V", "The battery's voltage at rest when full (ArduPilot).", most=60,
        usual=12.6, parameter="SIM_BATT_VOLTAGE")
    capacity_ah: float = _number(most=1000, parameter="SIM_BATT_CAP_AH")
    """Of which the voltage knows (ArduPilot); 0: it never falls by use."""
    drain_s: float = _number(least=1, most=86_400, usual=60, parameter="SIM_BAT_DRAIN")
    """From full to empty, armed (PX4)."""
    least: float = _share(usual=50, parameter="SIM_BAT_MIN_PCT")
    """Where that ends (PX4)."""
    gauge_mah: float = 3300.0
    """Which an ArduPilot believes it has: its own parameter BATT_CAPACITY."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConditions:
    """What is wrong with the links."""

    off: bool = _link("link_off", "Nothing passes.", means=bool)
    lost: float = _link(
        "link_loss N %", "This share of the frames is lost.", means=_of_percent)
    delay_us: int = _link(
        "link_delay N ms [jitter N ms]",
        "Every frame is late by the delay and up to the jitter more; a frame may overtake another "
        "so.", most=60_000, means=_microseconds, also="jitter_us")
    jitter_us: int = _number(most=60_000, means=_microseconds)
    duplicated: float = _link(
        "link_duplication N %", "This share of the frames arrives twice.",
        means=_of_percent)
    reordered: float = _link(
        "link_reordering N %", "This share of the frames is overtaken by those after it.",
        means=_of_percent)
    corrupted: float = _link(
        "link_corruption N %", "This share of the frames arrives with a few bits wrong.",
        means=_of_percent)
    to_vehicle: bool = True
    """Whether frames to the vehicle are concerned, and those from it."""
    from_vehicle: bool = True
    mask: int = field(
        default=0, metadata={"row": Row("", "", [], 0, 23, lambda link: 1 << round(link), None)})
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

    silent: bool = _switch("radar_off", "The radar falls silent: no answers, no heartbeat.")
    blind: bool = _switch("radar_blind", "The radar answers and sees nothing.")
    cells_missed: float = _share(
        "radar_drop N %", "This share of the cells in sight is not seen all the same.")
    frames_lost: float = _share(
        "radar_loss N %", "This share of the radar's TERRAIN_DATA is never sent.")
    noise_m: float = _number(
        "radar_noise N m [either_way]", "Heights have an error drawn from the normal law of this "
        "standard deviation.  Its size is added and the sum rounded up, so that no cell is told "
        "lower than it is, and on average 0.8 of this too high: what a radar reports whose maker "
        "counts errors against it.  With `either_way` a cell may be told lower.", most=10_000)
    either_way: bool = False
    delay_s: float = _number(
        "radar_delay N ms", "The radar's answers are late by this.", most=60_000, means=_seconds)
    rate_hz: float = _number(
        "radar_rate N Hz", "The radar answers this many requests a second, at the beats of its own "
        "sweep; else each at the end of its tick.")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LidarConditions:
    """What is wrong with the lidar and its driver."""

    dead: bool = _switch("lidar_dead", "It measures nothing any more; its driver is well.")
    blind: bool = _switch("lidar_blind", "It measures, and no echo comes back.")
    silent: bool = _switch("lidar_off", "The driver says nothing: no heartbeat either.")
    frames_lost: float = _share("lidar_loss N %", "Lost between the driver and the autopilot.")
    dust: float = _share(
        "lidar_dust N %", "Share of the beams with a near echo of nothing: dust, rain, sun.")
    stuck: bool = _switch("lidar_stuck", "The same distances for ever, with new stamps.")
    turned_rad: float = _number(
        "lidar_turned N deg", "It is mounted turned by this, and nobody knows.", -360, 360,
        means=math.radians)
    clock_us: int = _number(
        "lidar_clock N ms [jumping N ms]", "The driver's clock is ahead by this, and each stamp "
        "wrong by up to so much more, either way.", -1e9, 1e9, means=_microseconds,
        also="clock_jump_us")
    clock_jump_us: int = _number(most=60_000, means=_microseconds)
    rate_hz: float = _number(
        "lidar_rate N Hz", "Of the driver's messages; else as in the world.  200: a flood.",
        most=1000)
    frame: int = _number(
        "lidar_frame N", "The driver claims this MAV_FRAME.", most=255, usual=12, means=round)
    junk: float = _share(
        "lidar_junk N %", "Share of the distances that are 0, 65535 or beyond the limits, and of "
        "messages whose increment or offset is NaN.")
    mirrored: bool = _switch(
        "lidar_mirror", "What a client says of obstacles comes back to it, and all that the driver "
        "says is said in the companion's name too.")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotConditions:
    """What is wrong with the autopilot."""

    rangefinder_off: bool = _switch(
        "rangefinder_off", "RANGEFINDER says 0, DISTANCE_SENSOR nothing.")
    setpoints_ignored: bool = _switch(
        "setpoints_ignored", "The autopilot takes no setpoint, without a word.")
# fmt: on


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """All that is asked for, by who minds it."""

    gps: GpsConditions = field(default_factory=GpsConditions)
    wind: WindConditions = field(default_factory=WindConditions)
    battery: BatteryConditions = field(default_factory=BatteryConditions)
    link: LinkConditions = field(default_factory=LinkConditions)
    radar: RadarConditions = field(default_factory=RadarConditions)
    lidar: LidarConditions = field(default_factory=LidarConditions)
    autopilot: AutopilotConditions = field(default_factory=AutopilotConditions)


Changes = Mapping[str, Mapping[str, Any]]
"""New values of fields, by group of the conditions and name."""
GROUPS: Final[dict[str, Any]] = {each.name: each.type for each in dataclasses.fields(Conditions)}
ROWS: Final[dict[tuple[str, str], Row]] = {
    (group, each.name): each.metadata["row"]
    for group, kind in GROUPS.items()
    for each in dataclasses.fields(kind)
    if each.metadata
}
"""By group and field."""
_PX4_SATELLITES: Final = "SIM_GPS_USED"
FIELDS: Final = {row.parameter.name: at for at, row in ROWS.items() if row.parameter}
"""Group and field that each parameter is the value of."""
FIELDS[_PX4_SATELLITES] = FIELDS["SIM_GPS1_NUMSATS"]  # and its own is the one that counts


def conditions_of(parameters: Readable, faults: Iterable[Changes] = ()) -> Conditions:
    """What the parameters ask for, and over them each of these faults; the last one counts.

    A parameter that the table lacks, or that is not a number, has its usual value.
    """
    values: dict[str, dict[str, Any]] = {group: {} for group in GROUPS}
    for name, (group, key) in FIELDS.items():
        if name in parameters and math.isfinite(value := parameters[name]):
            values[group][key] = ROWS[group, key].means(value)
    if "BATT_CAPACITY" in parameters:
        values["battery"]["gauge_mah"] = parameters["BATT_CAPACITY"]
    for changes in faults:
        for group, changed in changes.items():
            values[group] |= changed
    made = Conditions(**{group: kind(**values[group]) for group, kind in GROUPS.items()})
    if _PX4_SATELLITES not in parameters:
        return made
    seen = made.gps.satellites if made.gps.enabled else 0
    return replace(
        made, gps=replace(made.gps, satellites=seen, enabled=seen >= _PX4_MIN_SATELLITES)
    )


# --- the tables of the autopilots -----------------------------------------------------------------


def _as_px4(row: Parameter) -> Parameter:
    """PX4 knows INT32 and FLOAT only, and its simulated receiver is never late."""
    default = 0.0 if row.name == "SIM_GPS1_LAG_MS" else row.default
    return replace(row, kind=row.kind if row.kind is Kind.REAL32 else Kind.INT32, default=default)


_PARAMETERS: Final = [row.parameter for row in ROWS.values() if row.parameter]
SIM_PARAMETERS: Final = tuple(
    row for row in _PARAMETERS if row.name not in ("SIM_BAT_DRAIN", "SIM_BAT_MIN_PCT")
)
"""What both ArduPilots' tables end with."""
SIM_PARAMETERS_PX4: Final = (
    Parameter(name=_PX4_SATELLITES, default=10.0, kind=Kind.INT32, least=0.0, most=50.0),
    *(_as_px4(row) for row in _PARAMETERS if not row.name.startswith("SIM_BATT_")),
)
"""What both PX4s' tables end with."""
