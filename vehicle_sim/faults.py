"""What may be wrong with a vehicle and its surroundings, and when.

`Conditions` say what is wrong now.  Parameters of the autopilot (ASKING) ask for them, and over
these the faults of a timeline, which is text with one fault (a row of FAULTS) a line:

    # comments begin with a hash
    at 120 s for 30 s: gps_off
    at 60 s: wind 8 m/s from 270 deg turbulence 2 m/s
    at 3 min: estimator_reset 20 m north

Times are of the simulation, which a reboot of the autopilot does not begin again.  A fault lasts
`for` so long, or stays; of those that set the same condition the one that began last counts.

A fault is one row, which also says how campaigns draw it and by what they judge a companion then;
they read both through vehicle_sim/in_process.py.
"""

import bisect
import math
import re
from collections.abc import Iterable
from itertools import cycle, pairwise
from typing import Any, Final, Literal, NamedTuple, final

from vehicle_sim.errors import InputError, did_you_mean
from vehicle_sim.parameters import Firmware, Kind, Parameter, Readable

Vector = tuple[float, float, float]
"""North, east, up; true."""
_ZERO: Final = (0.0, 0.0, 0.0)


# --- conditions: what is wrong now, by who minds it.  FAULTS says what each means, or ASKING ------


class GpsConditions(NamedTuple):
    """What is wrong with the receiver or the sky."""

    enabled: bool = True
    glitch_m: Vector = _ZERO
    glitch_latitude_deg: float = 0.0
    glitch_longitude_deg: float = 0.0
    glitch_up_m: float = 0.0
    offset_up_m: float = 0.0
    drift_m_s: Vector = _ZERO
    jammed: bool = False
    sigma_m: float = 0.0
    lag_s: float = 0.1
    satellites: int = 10


class WindConditions(NamedTuple):
    """The wind that is asked for, in ArduPilot's terms."""

    speed_m_s: float = 0.0
    from_rad: float = math.pi
    turbulence_m_s: float = 0.0
    rising_rad: float = 0.0


class BatteryConditions(NamedTuple):
    """What is asked of the battery."""

    most: float = 1.0
    voltage_v: float = 12.6
    capacity_ah: float = 0.0
    """Of which the voltage knows (ArduPilot); 0: it never falls by use."""
    drain_s: float = 60.0
    """From full to empty, armed (PX4)."""
    least: float = 0.5
    """Where that ends (PX4)."""
    gauge_mah: float = 3300.0
    """Which an ArduPilot believes it has: its own parameter BATT_CAPACITY."""


class LinkConditions(NamedTuple):
    """What is wrong with the links; shares are of the frames."""

    off: bool = False
    lost: float = 0.0
    delay_us: int = 0
    jitter_us: int = 0
    duplicated: float = 0.0
    way: str = ""
    """"to_vehicle" or "from_vehicle": the frames that are concerned; empty: all are."""
    only: int = -1
    """The link that is concerned; -1: all are."""

    @property
    def any(self) -> bool:
        """Something is wrong."""
        return any(self[:5])


class RadarConditions(NamedTuple):
    """What is wrong with the terrain radar."""

    silent: bool = False
    blind: bool = False
    cells_missed: float = 0.0
    frames_lost: float = 0.0
    noise_m: float = 0.0
    either_way: bool = False
    delay_s: float = 0.0
    rate_hz: float = 0.0


class LidarConditions(NamedTuple):
    """What is wrong with the lidar and its driver."""

    dead: bool = False
    blind: bool = False
    silent: bool = False
    frames_lost: float = 0.0
    dust: float = 0.0
    stuck: bool = False
    turned_rad: float = 0.0
    clock_us: int = 0
    rate_hz: float = 0.0


class AutopilotConditions(NamedTuple):
    """What is wrong with the autopilot."""

    rangefinder_off: bool = False
    setpoints_ignored: bool = False


class Conditions(NamedTuple):
    """All that is asked for."""

    gps: GpsConditions = GpsConditions()
    wind: WindConditions = WindConditions()
    battery: BatteryConditions = BatteryConditions()
    link: LinkConditions = LinkConditions()
    radar: RadarConditions = RadarConditions()
    lidar: LidarConditions = LidarConditions()
    autopilot: AutopilotConditions = AutopilotConditions()


_USUAL: Final = Conditions()


class Happening(NamedTuple):
    """What happens once; what its line does not say is as here."""

    name: str = ""
    by_m: Vector = _ZERO
    command: int = 0
    p1: float = 0.0
    p2: float = 0.0
    p3: float = 0.0
    to_autopilot: bool = False
    radius_m: float = 0.0
    ahead_m: float = 0.0


# --- faults ---------------------------------------------------------------------------------------

_WAYS: Final = {
    "north": (1.0, 0.0, 0.0),
    "east": (0.0, 1.0, 0.0),
    "south": (-1.0, 0.0, 0.0),
    "west": (0.0, -1.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
}
_PATTERNS: Final = {
    "[": "(?:",
    "]": ")?",
    "N": r"([-+]?(?:\d+(?:\.\d*)?|\.\d+))(?![\d.])\s*",  # "8m/s" is "8 m/s"
    "WHERE": rf"({'|'.join(_WAYS)})\s+",
    "SIDE": r"(north|east|south|west)\s+",
}
_RANGES: Final = {
    "%": (0.0, 100.0),
    "deg": (-360.0, 360.0),
    "m": (0.0, 1e5),
    "m/s": (0.0, 100.0),
    "ms": (0.0, 60_000.0),
    "Hz": (0.0, 1000.0),
    "V": (0.0, 60.0),
    "": (-1e9, 1e9),
    # of fields that have another one than their unit
    "lag_s": (0.0, 5000.0),
    "clock_us": (-1e9, 1e9),
    "radius_m": (0.1, 1e5),
    "satellites": (0.0, 50.0),
    "only": (0.0, 23.0),
    "command": (1.0, 65_535.0),
}
"""Of the numbers of a line, in its units."""


def _usual(group: str, key: str) -> Any:
    return getattr(getattr(_USUAL, group) if group else Happening(), key)


def _meant(group: str, key: str, number: float, unit: str) -> Any:
    """A number in this unit, as the field has it."""
    scales = {"ms": 1e-3 if key.endswith("_s") else 1e3, "deg": math.pi / 180.0, "%": 0.01}
    number, kind = number * scales.get(unit, 1.0), type(_usual(group, key))
    return round(number) if kind is int else kind(number)


@final
class Drawn(NamedTuple):
    """A way in which campaigns draw a fault, from some moment on."""

    number: int
    """Its place among all ways.  A new one takes the next: the first round of `single`
    draws the others as before."""
    line: str = ""
    """What its line says after its name; more lines follow after "; ".

    `3..90` is a number between, with as many decimals, -60..60 one of either sign; with L times the
    size of the vehicle, with V its speed.  `[a|b]` is one of them, `after 2.0..6.0 s: ` so long
    after the first line.
    Campaigns fill in {gale}, the wind that the vehicle can stand, and what `ground_command` needs
    to select the autopilot's modes {guided} and {returns}.
    """
    name: str = ""
    """What this way is called; else as the fault."""
    not_on: str = ""
    """Who cannot have it: a vehicle, as "ardupilot-copter", or the firmware of two."""


@final
class Known(NamedTuple):
    """What a companion could know of a fault, and what a flight may come to then.

    Of most it knows what the vehicle's position and mode tell, which campaigns compare with the
    truth anyway.
    """

    excuse: str = ""
    """Why nothing counts against it from the begin of the fault on."""
    excuse_needs: str = ""
    """The field that its line has to set for that."""
    out_of_reach: bool = False
    """No command can reach the vehicle meanwhile (after what happens once: for good), so it may
    end as it is, hovering in guided mode."""
    may_fall: bool = False
    """Without having landed it may end on the ground."""
    brings: Literal["", "fence", "target"] = ""
    """A ground station tells it of one more, which then counts."""


_PLAIN: Final = Known()


@final
class Fault:
    """One kind of fault: how its line is written, what it is, and the fields that it sets.

    In a line N is a number, WHERE is north, east, south, west, up or down, SIDE one of the first
    four; [...] may be left out, and its field is then as usual.  The fields are of a `group` of the
    conditions while the fault lasts, or of a Happening if it happens once.  `keys` are those of the
    numbers and of the words with an underscore, in order; a vector, to which numbers add, has one.
    `drawn` and `known` are for campaigns.
    """

    def __init__(
        self,
        group: str,
        usage: str,
        about: str,
        *keys: str,
        drawn: Iterable[Drawn] = (),
        known: Known = _PLAIN,
        **sets: bool,
    ) -> None:
        self.group, self.usage, self.about, self._keys = group, usage, about, keys
        self.once, self.drawn, self.known = not group, tuple(drawn), known
        self.sets = {key: _usual(group, key) for key in keys} | sets
        """The fields of its shortest line."""
        self.name, *tokens = re.findall(r"[][]|[^][\s]+", usage)
        forms = [_PATTERNS.get(t, rf"({t})\s+" if "_" in t else rf"{t}\s+") for t in tokens]
        self._pattern = re.compile(rf"{self.name}\s+{''.join(forms)}", re.IGNORECASE | re.ASCII)
        words = [*(token for token in tokens if token not in "[]"), ""]
        self._units = [unit for word, unit in pairwise(words) if word in _PATTERNS or "_" in word]
        """What stands after each number, way and switch."""

    def read(self, line: str, where: str) -> dict[str, Any]:
        """The fields that a line sets; InputError, with its place, if it does not fit."""
        match = self._pattern.fullmatch(f"{line} ")
        if match is None:
            raise InputError(where, line, f'reads "{self.usage}"', "Correct the line.")
        sets, number = dict(self.sets), 0.0
        # one key for all numbers and ways of a vector
        for key, unit, text in zip(cycle(self._keys), self._units, match.groups(""), strict=False):
            if way := _WAYS.get(text.lower()):
                sets[key] = tuple(a + number * b for a, b in zip(sets[key], way, strict=True))
            elif "_" in text:
                sets[key] = type(sets[key])(text.lower())
            elif text:
                number = float(text)
                least, most = _RANGES.get(key) or _RANGES.get(unit) or _RANGES[""]
                if not least <= number <= most:
                    rule = f"{number:g} must lie from {least:g} to {most:g}"
                    raise InputError(where, line, rule, "Correct the number.")
                if not isinstance(sets[key], tuple):
                    sets[key] = _meant(self.group, key, number, unit)
        return sets


COMPANION_OFF: Final = "companion_off"
"""The one that befalls the companion, and not its vehicle."""
_SIDE: Final = "[north|east|south|west]"
_WAY: Final = "[| to_vehicle| from_vehicle]"


def _link(line: str, about: str, *keys: str, **more: Any) -> Fault:
    """Of all frames on all links unless it says which."""
    usage = f"{line} [to_vehicle|from_vehicle] [on link N]"
    return Fault("link", usage, about, *keys, "way", "only", **more)


# fmt: off
FAULTS: Final = (
    Fault("gps", "gps_off", "The receiver loses its fix.", enabled=False,
        drawn=[Drawn(0, "for 0.5..25.0 s")]),
    Fault("gps", "gps_glitch N m WHERE [N m WHERE]",
        "The receiver's position is off by so much.", "glitch_m",
        drawn=[Drawn(1, f"3..90 m {_SIDE} for 1.0..30.0 s")]),
    Fault("gps", "gps_drift N m/s WHERE", "The receiver's position wanders off at this speed, and "
        "its velocity says so.", "drift_m_s",
        drawn=[Drawn(2, f"0.3..4.0 m/s {_SIDE} for 5.0..30.0 s")]),
    Fault("gps", "gps_jam",
        "The fix comes and goes, with wild positions and velocities.", jammed=True,
        drawn=[Drawn(3, "for 1.0..15.0 s")]),
    Fault("gps", "gps_noise N m", "A random error with this standard deviation on each horizontal "
        "axis, 1.5 times that in height, correlated over seconds.", "sigma_m",
        drawn=[Drawn(4, "0.3..3.0 m for 10..60 s")]),
    Fault("gps", "gps_delay N ms", "The receiver's solutions are this old.", "lag_s",
        drawn=[Drawn(5, "100..600 ms for 10..60 s")]),
    Fault("gps", "gps_satellites N",
        "The receiver sees so many satellites; PX4 has no fix with fewer than 4.", "satellites",
        drawn=[Drawn(6, "0..8 for 1.0..25.0 s"),
               Drawn(29, "3..8 for 2.0..25.0 s", "few satellites")]),
    Fault("wind", "wind N m/s from N deg [turbulence N [m/s]] [rising N deg]",
        "Wind from this true direction, full from 60 m above the ground on, with gusts of this "
        "standard deviation, rising by this angle.",
        "speed_m_s", "from_rad", "turbulence_m_s", "rising_rad", drawn=[
            Drawn(7, "3.0..{gale} m/s from 0..360 deg turbulence 0.0..1.5 m/s rising -5..5 deg")]),
    Fault("wind", "turbulence N m/s", "Gusts of this standard deviation.", "turbulence_m_s",
        drawn=[Drawn(8, "0.5..2.5 m/s")]),
    Fault("battery", "battery N %", "No more than this is left in the battery.", "most",
        drawn=[Drawn(9, "3..40 %")]),
    Fault("battery", "battery_voltage N V",
        "The battery's voltage at rest when full (ArduPilot).", "voltage_v",
        drawn=[Drawn(10, "9.5..12.0 V", not_on="px4")]),
    _link("link_off", "Nothing passes.", off=True, known=Known(out_of_reach=True),
        drawn=[Drawn(11, f"{_WAY} for 0.2..25.0 s"),
               Drawn(41, "for 30.0..60.0 s", "link lost for long")]),
    _link("link_loss N %", "This share of the frames is lost.", "lost",
        drawn=[Drawn(12, f"3..60 %{_WAY} for 10..60 s"),
               Drawn(16, f"1..40 %{_WAY}", "link_loss for good")]),
    _link("link_delay N ms [jitter N ms]", "Every frame is late by the delay and up to the jitter "
        "more; a frame may overtake another so.", "delay_us", "jitter_us",
        drawn=[Drawn(13, f"20..700 ms jitter 0..200 ms{_WAY} for 5.0..60.0 s"),
               Drawn(15, "0 ms jitter 5..60 ms", "frames overtake")]),
    _link("link_duplication N %", "This share of the frames arrives twice.", "duplicated",
        drawn=[Drawn(14, "5..80 %")]),
    Fault("radar", "radar_off", "The radar falls silent: no answers, no heartbeat.", silent=True,
        drawn=[Drawn(17, "for 2.0..40.0 s")]),
    Fault("radar", "radar_blind", "The radar answers and sees nothing.", blind=True,
        drawn=[Drawn(18, "for 2.0..40.0 s")]),
    Fault("radar", "radar_drop N %",
        "This share of the cells in sight is not seen all the same.", "cells_missed",
        drawn=[Drawn(19, "2..50 %")]),
    Fault("radar", "radar_loss N %",
        "This share of the radar's TERRAIN_DATA is never sent.", "frames_lost",
        drawn=[Drawn(20, "2..70 %")]),
    Fault("radar", "radar_noise N m [either_way]", "Heights have a normal error of this standard "
        "deviation; its size is added and the sum rounded up, so that no cell is told lower than "
        "it is.  With `either_way` a cell may be.", "noise_m", "either_way",
        known=Known("the radar told too low heights", excuse_needs="either_way"),
        drawn=[Drawn(21, "0.5..8.0 m[| either_way]")]),
    Fault("radar", "radar_delay N ms", "The radar's answers are late by this.", "delay_s",
        drawn=[Drawn(22, "50..1500 ms for 5.0..60.0 s")]),
    Fault("radar", "radar_rate N Hz", "The radar answers this many requests a second, at the beats "
        "of its own sweep; else each at the end of its tick.", "rate_hz",
        drawn=[Drawn(23, "0.5..8.0 Hz for 5.0..60.0 s")]),
    Fault("lidar", "lidar_dead", "It measures nothing any more; its driver is well.", dead=True),
    Fault("lidar", "lidar_blind", "It measures, and no echo comes back.", blind=True),
    Fault("lidar", "lidar_off", "The driver says nothing: no heartbeat either.", silent=True),
    Fault("lidar", "lidar_loss N %", "Lost between the driver and the autopilot.", "frames_lost"),
    Fault("lidar", "lidar_dust N %",
        "Share of the beams with a near echo of nothing: dust, rain, sun.", "dust"),
    Fault("lidar", "lidar_stuck", "The same distances for ever, with new stamps.", stuck=True),
    Fault("lidar", "lidar_turned N deg",
        "It is mounted turned by this, and nobody knows.", "turned_rad"),
    Fault("lidar", "lidar_clock N ms", "The driver's clock is ahead by this.", "clock_us"),
    Fault("lidar", "lidar_rate N Hz",
        "Of the driver's messages; else as in the world.  200: a flood.", "rate_hz"),
    Fault("autopilot", "rangefinder_off",
        "RANGEFINDER says 0, DISTANCE_SENSOR nothing.", rangefinder_off=True),
    Fault("autopilot", "setpoints_ignored",
        "The autopilot takes no setpoint, without a word.", setpoints_ignored=True,
        drawn=[Drawn(24, "for 0.5..15.0 s")]),
    Fault("companion", COMPANION_OFF, "The companion is killed, and started again afterwards: in "
        "campaigns, which fly one, with `for`.", known=Known(out_of_reach=True),
        drawn=[Drawn(42, "for 0.3..8.0 s", "companion killed, restarted")]),
    Fault("", "estimator_reset N m SIDE [N m SIDE]",
        "The estimator starts afresh, and its position jumps by this much.", "by_m",
        drawn=[Drawn(25, f"1..50 m {_SIDE}")]),
    Fault("", "origin_move N m WHERE [N m WHERE]",
        "The origin of the estimator's local frame moves by this much.", "by_m",
        drawn=[Drawn(26, f"2..60 m {_SIDE} 1..15 m [up|down]")]),
    Fault("", "pilot",
        "The pilot takes the vehicle: the mode changes to the one that pilots hold it in.",
        drawn=[Drawn(27), Drawn(31, "; after 2.0..6.0 s: ground_command [193 1|{guided}]",
                                "pilot, and back")]),
    Fault("", "reboot", "The autopilot starts again, wherever it is.", drawn=[Drawn(28)],
        known=Known("the autopilot rebooted", out_of_reach=True, may_fall=True)),
    Fault("", "ground_command N [N] [N] [N] [to_autopilot]",
        "A ground station sends this MAV_CMD with these first parameters to the companion, or to "
        "the autopilot.", "command", "p1", "p2", "p3", "to_autopilot", drawn=[
            Drawn(32, "{returns}", "station selects return"),
            Drawn(33, "20", "told to return"),
            Drawn(34, "21", "told to land"),
            # a person leaves it to the companion again
            Drawn(37, "207 1 to_autopilot; after 0.1..0.2 s: ground_fence 15..35L m 0..15L m ahead"
                "; after 8.0..30.0 s: ground_command 193 1", "stopped by its own fence, and back",
                not_on="ardupilot-copter"),  # whose fence is a cylinder as well
            Drawn(38, "193 0; after 1.0..15.0 s: ground_command 193 1", "pause and continue"),
            Drawn(40, "178 1 0.4..1.3V", "change of speed")]),
    Fault("", "ground_target N m SIDE [N m SIDE]",
        "A ground station gives the companion a target so far from where the vehicle is.", "by_m",
        known=Known(brings="target"), drawn=[
            Drawn(39, "30..200L m [north|south] 30..200L m [east|west]", "new target")]),
    Fault("", "ground_fence N m [N m ahead]", "The vehicle's fence gets one more circle to stay "
        "out of, so far ahead of where it is.", "radius_m", "ahead_m",
        known=Known(brings="fence"),
        drawn=[Drawn(35, "15..35L m 60..180L m ahead", "new fence ahead"),
               Drawn(36, "15..35L m 0..15L m ahead", "new fence around it")]),
)
# fmt: on
"""In the order of the documentation."""


def ways() -> list[Drawn]:
    """All ways in which campaigns draw faults, by their numbers, with whole names and lines."""
    every = ((fault, way) for fault in FAULTS for way in fault.drawn)
    return sorted(
        way._replace(name=way.name or fault.name, line=f"{fault.name} {way.line}")
        for fault, way in every
    )


# --- parameters that ask for them: those of ArduPilot's (libraries/SITL) and PX4's simulations ----


@final
class Asking(NamedTuple):
    """A parameter, and the field that it is the value of."""

    name: str
    of: str
    """Whose simulation has it."""
    group: str
    key: str
    usual: float
    least: float
    most: float
    type: Kind = Kind.REAL32
    unit: str = ""


_BOTH: Final = "ardupilot px4"
ASKING: Final = (
    Asking("SIM_GPS1_ENABLE", _BOTH, "gps", "enabled", 1, 0, 1, Kind.INT8),
    Asking("SIM_GPS1_GLTCH_X", _BOTH, "gps", "glitch_latitude_deg", 0, -90, 90),
    Asking("SIM_GPS1_GLTCH_Y", _BOTH, "gps", "glitch_longitude_deg", 0, -180, 180),
    Asking("SIM_GPS1_GLTCH_Z", _BOTH, "gps", "glitch_up_m", 0, -1e5, 1e5),
    Asking("SIM_GPS1_ALT_OFS", _BOTH, "gps", "offset_up_m", 0, -32_768, 32_767, Kind.INT16),
    Asking("SIM_GPS1_JAM", _BOTH, "gps", "jammed", 0, 0, 1, Kind.INT8),
    Asking("SIM_GPS1_LAG_MS", _BOTH, "gps", "lag_s", 100, 0, 5000, Kind.INT16, "ms"),
    Asking("SIM_GPS1_NUMSATS", _BOTH, "gps", "satellites", 10, 0, 50, Kind.INT8),
    Asking("SIM_WIND_SPD", _BOTH, "wind", "speed_m_s", 0, 0, 100),
    Asking("SIM_WIND_DIR", _BOTH, "wind", "from_rad", 180, -360, 360, unit="deg"),
    Asking("SIM_WIND_TURB", _BOTH, "wind", "turbulence_m_s", 0, 0, 50),
    Asking("SIM_WIND_DIR_Z", _BOTH, "wind", "rising_rad", 0, -90, 90, unit="deg"),
    Asking("SIM_BATT_VOLTAGE", "ardupilot", "battery", "voltage_v", 12.6, 0, 60),
    Asking("SIM_BATT_CAP_AH", "ardupilot", "battery", "capacity_ah", 0, 0, 1000),
    Asking("BATT_CAPACITY", "", "battery", "gauge_mah", 3300, 0, math.inf),
    Asking("SIM_GPS_USED", "px4", "gps", "satellites", 10, 0, 50, Kind.INT32),
    Asking("SIM_BAT_DRAIN", "px4", "battery", "drain_s", 60, 1, 86_400),
    Asking("SIM_BAT_MIN_PCT", "px4", "battery", "least", 50, 0, 100, unit="%"),
)
"""Of two for one field the later counts.  BATT_CAPACITY is a parameter of ArduPilots proper."""
_PX4_MIN_SATELLITES: Final = 4
"""With fewer PX4's simulated receiver has no fix (px4.md 8)."""


def sim_parameters(firmware: Firmware) -> tuple[Parameter, ...]:
    """What the tables of its autopilots end with."""
    asking, rows = (asked for asked in ASKING if firmware in asked.of), list[Parameter]()
    for parameter in asking:
        kind, usual = parameter.type, float(parameter.usual)
        if firmware == "px4":  # which knows INT32 and FLOAT only, and whose receiver is never late
            kind = kind if kind is Kind.REAL32 else Kind.INT32
            usual = 0.0 if parameter.key == "lag_s" else usual
        limits = {"least": parameter.least, "most": parameter.most}
        rows.append(Parameter(name=parameter.name, default=usual, kind=kind, **limits))
    return tuple(rows)


def conditions_of(parameters: Readable, lasting: Iterable["Entry"] = ()) -> Conditions:
    """What the parameters ask for, and over them each of these faults; the last one counts.

    A parameter that the table lacks, or that is not a number, has its usual value.
    """
    values: dict[str, dict[str, Any]] = {group: {} for group in Conditions._fields}
    for parameter in ASKING:
        if math.isfinite(value := parameters.get(parameter.name, math.nan)):
            values[parameter.group][parameter.key] = _meant(
                parameter.group, parameter.key, value, parameter.unit
            )
    for entry in lasting:
        values[entry.fault.group] |= entry.sets
    made = Conditions(**{key: getattr(_USUAL, key)._replace(**new) for key, new in values.items()})
    if "SIM_GPS_USED" not in parameters:
        return made
    seen = made.gps.satellites if made.gps.enabled else 0
    gps = made.gps._replace(satellites=seen, enabled=seen >= _PX4_MIN_SATELLITES)
    return made._replace(gps=gps)


def faults_page() -> str:
    """The table of docs/reference/faults.md."""
    same = {
        (parameter.group, parameter.key): f"`{parameter.name}`" for parameter in reversed(ASKING)
    }
    rows = ["| fault | parameters that do the same | what it does |\n|---|---|---|\n"]
    for fault in FAULTS:
        names = [same[at] for key in fault.sets if (at := (fault.group, key)) in same]
        usage = fault.usage.replace("|", r"\|")
        rows.append(f"| `{usage}` | {', '.join(names)} | {fault.about} |\n")
    return "".join(rows)


# --- the timeline ---------------------------------------------------------------------------------

NEVER_US: Final = 2**63 - 1
_TIME: Final = r"(\d{1,12}(?:\.\d*)?|\.\d+)\s*(us|ms|s|min|h)"
_LINE: Final = re.compile(rf"at\s+{_TIME}(?:\s+for\s+{_TIME})?\s*:\s*(\S.*)", re.I | re.ASCII)
_UNIT_US: Final = {"us": 1.0, "ms": 1e3, "s": 1e6, "min": 60e6, "h": 3600e6}


@final
class Entry(NamedTuple):
    """One line: what it sets, and from when to when; until the same moment if it happens once."""

    at_us: int
    until_us: int
    fault: Fault
    sets: dict[str, Any]
    where: str
    """Its line stands, for errors."""


@final
class Timeline:
    """Faults to come; one for each vehicle, for it remembers where it is."""

    def __init__(self, text: str, *, name: str = "timeline") -> None:
        """Those of this text; InputError names file (`name`), line and what is wrong."""
        self._entries: list[Entry] = []
        """Those that are not over, in order of their begin."""
        self.lasting: list[Entry] = []
        """Now, the last begun last."""
        self.next_us = NEVER_US
        """When something is due next: nothing is before."""
        for entry in entries(text, name):
            self._add(entry)

    def add(self, line: str, now_us: int) -> None:
        """A fault from now on: a line without its time, as "gps_off" or "for 30 s: gps_off"."""
        length, _, what = line.strip().rpartition(":")
        self._add(_entry(f"at {now_us} us {length}: {what}", "fault"))

    def _add(self, entry: Entry) -> None:
        if entry.fault.name == COMPANION_OFF:
            rule = "needs a companion, and only campaigns fly one"
            raise InputError(entry.where, COMPANION_OFF, rule, "Leave the line out.")
        bisect.insort(self._entries, entry, key=lambda entry: entry.at_us)
        self.next_us = min(self.next_us, entry.at_us)

    def step(self, now_us: int) -> list[Happening]:
        """Go on to this time of the simulation; returns what happens once, in order."""
        begun = [entry for entry in self._entries if entry.at_us <= now_us]
        self._entries = [entry for entry in self._entries if entry.until_us > now_us]
        self.lasting = [entry for entry in begun if entry.until_us > now_us]
        times_us = [t for entry in self._entries for t in entry[:2] if t > now_us]
        self.next_us = min(times_us, default=NEVER_US)
        once = [entry for entry in begun if entry.fault.once]
        return [Happening(**{"name": entry.fault.name} | entry.sets) for entry in once]


def entries(text: str, name: str = "timeline") -> list[Entry]:
    """The lines of a timeline; InputError names file (`name`), line and what is wrong."""
    lines = (raw.partition("#")[0].strip() for raw in text.splitlines())
    return [_entry(line, f"{name}:{k}") for k, line in enumerate(lines, start=1) if line]


def _entry(line: str, where: str) -> Entry:
    """One line of a timeline; `where` it stands, for errors."""
    if (match := _LINE.fullmatch(line)) is None:
        rule = 'reads "at TIME: FAULT" or "at TIME for TIME: FAULT", TIME with its unit'
        raise InputError(where, line, rule, "Write for example: at 120 s for 30 s: gps_off.")
    at, at_unit, length, length_unit, what = match.groups()
    at_us = round(float(at) * _UNIT_US[at_unit.lower()])
    length_us = NEVER_US if length is None else round(float(length) * _UNIT_US[length_unit.lower()])
    name, known = what.split()[0].lower(), {fault.name: fault for fault in FAULTS}
    if (fault := known.get(name)) is None:
        remedy = did_you_mean(name, known, f"Choose from: {', '.join(known)}.")
        raise InputError(where, name, "no such fault", remedy)
    if length is not None and fault.once:
        raise InputError(where, line, f"{name} happens once", 'Leave out "for".')
    if length is None and name == COMPANION_OFF:
        raise InputError(where, line, "lasts a time", 'Write "for 5 s" before the colon.')
    if length_us == 0:
        raise InputError(where, line, "lasts no time", "Write a longer time.")
    until_us = at_us if fault.once else min(at_us + length_us, NEVER_US)
    return Entry(at_us, until_us, fault, fault.read(what, where), where)
