"""What may be wrong with a vehicle and its surroundings, and when.

`Conditions` say what is wrong now.  Parameters of the autopilot ask for them, and over these the
faults of a timeline, which is text with one fault (a row of FAULTS) a line:

    # comments begin with a hash
    at 120 s for 30 s: gps_off
    at 60 s: wind 8 m/s from 270 deg turbulence 2 m/s
    at 3 min: estimator_reset 20 m north

Times are of the simulation, which a reboot of the autopilot does not begin again.  A fault lasts
`for` so long, or stays; of those that set the same condition the one that began last counts.
"""

import bisect
import functools
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple, Self, final

from vehicle_sim.errors import InputError, did_you_mean
from vehicle_sim.parameters import Firmware, Kind, Parameter, Readable

Vector = tuple[float, float, float]
"""North, east, up; true."""
_ZERO: Final = (0.0, 0.0, 0.0)


# --- conditions: what is wrong now, by who minds it.  FAULTS says what each means -----------------


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
    to_vehicle: bool = True
    """Whether frames to the vehicle are concerned, and those from it."""
    from_vehicle: bool = True
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
Changes = Mapping[str, Mapping[str, Any]]
"""New values of fields, by group of the conditions and name."""
_UNITS: Final = {"deg": math.pi / 180.0, "%": 0.01}


def _meant(group: str, key: str, value: float, unit: str) -> Any:
    """A number of a line or a parameter, in this unit, as the field has it."""
    if unit == "ms":
        value *= 1e-3 if key.endswith("_s") else 1e3
    elif unit in _UNITS:
        value *= _UNITS[unit]
    kind = type(getattr(getattr(_USUAL, group), key))
    return round(value) if kind is int else kind(value)


# --- parameters that ask for them: those of ArduPilot's (libraries/SITL) and PX4's simulations ----


@final
class Asking(NamedTuple):
    """A parameter, and the field that it is the value of."""

    name: str
    group: str
    key: str
    usual: float
    least: float
    most: float
    unit: str = ""
    kind: Kind = Kind.REAL32

    def row(self, firmware: Firmware) -> Parameter:
        """PX4 knows INT32 and FLOAT only, and its simulated receiver is never late."""
        kind, usual = self.kind, self.usual
        if firmware == "px4":
            kind = kind if kind is Kind.REAL32 else Kind.INT32
            usual = 0.0 if self.key == "lag_s" else usual
        return Parameter(name=self.name, default=usual, kind=kind, least=self.least, most=self.most)


_FAR_M: Final = 1e5
_OF_PX4: Final = (
    Asking("SIM_GPS_USED", "gps", "satellites", 10, 0, 50, kind=Kind.INT32),
    Asking("SIM_BAT_DRAIN", "battery", "drain_s", 60, 1, 86_400),
    Asking("SIM_BAT_MIN_PCT", "battery", "least", 50, 0, 100, "%"),
)
_OF_BOTH: Final = (
    Asking("SIM_GPS1_ENABLE", "gps", "enabled", 1, 0, 1, kind=Kind.INT8),
    Asking("SIM_GPS1_GLTCH_X", "gps", "glitch_latitude_deg", 0, -90, 90),
    Asking("SIM_GPS1_GLTCH_Y", "gps", "glitch_longitude_deg", 0, -180, 180),
    Asking("SIM_GPS1_GLTCH_Z", "gps", "glitch_up_m", 0, -_FAR_M, _FAR_M),
    Asking("SIM_GPS1_ALT_OFS", "gps", "offset_up_m", 0, -32_768, 32_767, kind=Kind.INT16),
    Asking("SIM_GPS1_JAM", "gps", "jammed", 0, 0, 1, kind=Kind.INT8),
    Asking("SIM_GPS1_LAG_MS", "gps", "lag_s", 100, 0, 5000, "ms", Kind.INT16),
    Asking("SIM_GPS1_NUMSATS", "gps", "satellites", 10, 0, 50, kind=Kind.INT8),
    Asking("SIM_WIND_SPD", "wind", "speed_m_s", 0, 0, 100),
    Asking("SIM_WIND_DIR", "wind", "from_rad", 180, -360, 360, "deg"),
    Asking("SIM_WIND_TURB", "wind", "turbulence_m_s", 0, 0, 50),
    Asking("SIM_WIND_DIR_Z", "wind", "rising_rad", 0, -90, 90, "deg"),
)
_OF_ARDUPILOT: Final = (
    Asking("SIM_BATT_VOLTAGE", "battery", "voltage_v", 12.6, 0, 60),
    Asking("SIM_BATT_CAP_AH", "battery", "capacity_ah", 0, 0, 1000),
)
_GAUGE: Final = Asking("BATT_CAPACITY", "battery", "gauge_mah", 3300, 0, math.inf)
"""A parameter of an ArduPilot proper."""
ASKING: Final = (*_OF_BOTH, *_OF_ARDUPILOT, _GAUGE, *_OF_PX4)
"""Of two for one field the later counts."""
SIM_PARAMETERS: Final = tuple(each.row("ardupilot") for each in (*_OF_BOTH, *_OF_ARDUPILOT))
"""What both ArduPilots' tables end with."""
SIM_PARAMETERS_PX4: Final = tuple(each.row("px4") for each in (_OF_PX4[0], *_OF_BOTH, *_OF_PX4[1:]))
"""What both PX4s' tables end with."""
_PX4_MIN_SATELLITES: Final = 4
"""With fewer PX4's simulated receiver has no fix (px4.md 8)."""


def conditions_of(parameters: Readable, faults: Iterable[Changes] = ()) -> Conditions:
    """What the parameters ask for, and over them each of these faults; the last one counts.

    A parameter that the table lacks, or that is not a number, has its usual value.
    """
    values: dict[str, dict[str, Any]] = {}
    for name, group, key, *_, unit, _ in ASKING:
        if name in parameters and math.isfinite(value := parameters[name]):
            values.setdefault(group, {})[key] = _meant(group, key, value, unit)
    for changes in faults:
        for group, changed in changes.items():
            values.setdefault(group, {}).update(changed)
    groups = {group: getattr(_USUAL, group)._replace(**new) for group, new in values.items()}
    made = _USUAL._replace(**groups)
    if "SIM_GPS_USED" not in parameters:
        return made
    seen = made.gps.satellites if made.gps.enabled else 0
    gps = made.gps._replace(satellites=seen, enabled=seen >= _PX4_MIN_SATELLITES)
    return made._replace(gps=gps)


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
    "N": r"[-+]?(?:\d+\.?\d*|\.\d+)",
    "WHERE": "|".join(_WAYS),
    "SIDE": "north|east|south|west",
}
_NUMBER: Final = re.compile(r"\{(\w*):?([^:}]*):?([^:}]*)\}(?: (ms|deg|%))?")


@final
class _Number(NamedTuple):
    """A number of a line."""

    key: str
    """The field that it is; none: of what happens once."""
    least: float
    most: float
    unit: str


@final
class Fault:
    """One kind of fault.

    The line is how it is written.  A number is {FIELD:LEAST:MOST}, where LEAST may be left out (0),
    and MOST too (100); what happens once has no fields.  WHERE is north, east, south, west, up or
    down, SIDE one of the first four; [...] may be left out, and its fields are then as usual.  A
    word with an underscore is a switch: a field of this name.  `sets` is the field that the line
    gives the other value than usual, or the vector that the line is.
    """

    def __init__(self, group: str, line: str, about: str, sets: str = "") -> None:
        self.group, self.about, self._sets = group, about, sets
        self.usage = re.sub(r"\{.*?\}", "N", line)
        """The line for people."""
        self.name = line.split()[0]
        self.once = not group
        """It happens at a moment and has no length."""
        self._numbers = [
            _Number(key, float(first) if last else 0.0, float(last or first or 100.0), unit)
            for key, first, last, unit in _NUMBER.findall(line)
        ]
        self.fields = [each for each in (sets, *(n.key for n in self._numbers)) if each]
        """Those that it sets, but for its switches."""

    @functools.cached_property
    def _pattern(self) -> re.Pattern[str]:
        """The whole text of the fault, with a group for each placeholder and each switch."""
        parts, space = list[str](), ""
        for k, token in enumerate(re.findall(r"\[|\]|[^\s\[\]]+", self.usage)):
            if token in "[]":
                parts.append("(?:" if token == "[" else ")?")
                continue
            kind = token if token in _PATTERNS else "switch" if "_" in token and k else ""
            text = _PATTERNS.get(token, token)
            parts.append(f"{space}(?P<{kind}{k}>{text})" if kind else space + re.escape(token))
            space = r"\s*" if token == "N" else r"\s+"  # "8m/s" is "8 m/s"
        return re.compile("".join(parts), re.I)

    def read(self, what: str, where: str) -> tuple[Changes, Sequence[float]]:
        """The conditions that a text asks for; of what happens once its values.

        These are its vector, or its numbers (0: left out) and 1 for a switch.  InputError if the
        text does not fit.
        """
        match = self._pattern.fullmatch(what)
        if match is None:
            raise InputError(where, what, f'reads "{self.usage}"', "Correct the line.")
        said = match.groupdict()
        numbers = [float(value) if value else None for key, value in said.items() if key[0] == "N"]
        words = [value.lower() for key, value in said.items() if value and key[0] != "N"]
        for value, number in zip(numbers, self._numbers, strict=True):
            if value is not None and not number.least <= value <= number.most:
                rule = f"{value:g} must lie from {number.least:g} to {number.most:g}"
                raise InputError(where, what, rule, "Correct the number.")
        if " WHERE" in self.usage or " SIDE" in self.usage:
            sizes = [size for size in numbers if size is not None]
            ways = [(size, _WAYS[word]) for size, word in zip(sizes, words, strict=True)]
            vector = tuple(sum(size * way[axis] for size, way in ways) for axis in range(3))
            return {self.group: {self._sets: vector}} if self.group else {}, vector
        if not self.group:
            return {}, [value or 0.0 for value in numbers] + [1.0] * len(words)
        usual = getattr(_USUAL, self.group)
        changed = {self._sets: not getattr(usual, self._sets)} if self._sets else {}
        for value, (key, _, _, unit) in zip(numbers, self._numbers, strict=True):
            is_usual = value is None
            changed[key] = (
                getattr(usual, key) if is_usual else _meant(self.group, key, value or 0.0, unit)
            )
        for switches in re.findall(r"\[(\w+_[\w|]+)\]", self.usage):
            for each in switches.split("|"):
                changed[each] = each in words if words else getattr(usual, each)
        return {self.group: changed}, ()


def _link(line: str, about: str, sets: str = "") -> Fault:
    """Of both ways and all links unless it says which."""
    return Fault("link", f"{line} [to_vehicle|from_vehicle] [on link {{only:23}}]", about, sets)


# fmt: off
FAULTS: Final = (
    Fault("gps", "gps_off", "The receiver loses its fix.", "enabled"),
    Fault("gps", "gps_glitch {:1e5} m WHERE [{:1e5} m WHERE]",
        "The receiver's position is off by so much.", "glitch_m"),
    Fault("gps", "gps_drift {} m/s WHERE", "The receiver's position wanders off at this speed, "
        "and its velocity says so.", "drift_m_s"),
    Fault("gps", "gps_jam", "The fix comes and goes, with wild positions and velocities.",
        "jammed"),
    Fault("gps", "gps_noise {sigma_m:1000} m", "A random error with this standard deviation on "
        "each horizontal axis, 1.5 times that in height, correlated over seconds."),
    Fault("gps", "gps_delay {lag_s:5000} ms", "The receiver's solutions are this old."),
    Fault("gps", "gps_satellites {satellites:50}",
        "The receiver sees so many satellites; PX4 has no fix with fewer than 4."),
    Fault("wind", "wind {speed_m_s} m/s from {from_rad:-360:360} deg "
        "[turbulence {turbulence_m_s:50} [m/s]] [rising {rising_rad:-90:90} deg]",
        "Wind from this true direction, full from 60 m above the ground on, with gusts of this "
        "standard deviation, rising by this angle."),
    Fault("wind", "turbulence {turbulence_m_s:50} m/s", "Gusts of this standard deviation."),
    Fault("battery", "battery {most} %", "No more than this is left in the battery."),
    Fault("battery", "battery_voltage {voltage_v:60} V",
        "The battery's voltage at rest when full (ArduPilot)."),
    _link("link_off", "Nothing passes.", "off"),
    _link("link_loss {lost} %", "This share of the frames is lost."),
    _link("link_delay {delay_us:60000} ms [jitter {jitter_us:60000} ms]", "Every frame is late by "
        "the delay and up to the jitter more; a frame may overtake another so."),
    _link("link_duplication {duplicated} %", "This share of the frames arrives twice."),
    Fault("radar", "radar_off", "The radar falls silent: no answers, no heartbeat.", "silent"),
    Fault("radar", "radar_blind", "The radar answers and sees nothing.", "blind"),
    Fault("radar", "radar_drop {cells_missed} %",
        "This share of the cells in sight is not seen all the same."),
    Fault("radar", "radar_loss {frames_lost} %",
        "This share of the radar's TERRAIN_DATA is never sent."),
    Fault("radar", "radar_noise {noise_m:10000} m [either_way]",
        "Heights have an error drawn from the normal law of this "
        "standard deviation.  Its size is added and the sum rounded up, so that no cell is told "
        "lower than it is, and on average 0.8 of this too high: what a radar reports whose maker "
        "counts errors against it.  With `either_way` a cell may be told lower."),
    Fault("radar", "radar_delay {delay_s:60000} ms", "The radar's answers are late by this."),
    Fault("radar", "radar_rate {rate_hz} Hz", "The radar answers this many requests a second, at "
        "the beats of its own sweep; else each at the end of its tick."),
    Fault("lidar", "lidar_dead", "It measures nothing any more; its driver is well.", "dead"),
    Fault("lidar", "lidar_blind", "It measures, and no echo comes back.", "blind"),
    Fault("lidar", "lidar_off", "The driver says nothing: no heartbeat either.", "silent"),
    Fault("lidar", "lidar_loss {frames_lost} %", "Lost between the driver and the autopilot."),
    Fault("lidar", "lidar_dust {dust} %",
        "Share of the beams with a near echo of nothing: dust, rain, sun."),
    Fault("lidar", "lidar_stuck", "The same distances for ever, with new stamps.", "stuck"),
    Fault("lidar", "lidar_turned {turned_rad:-360:360} deg",
        "It is mounted turned by this, and nobody knows."),
    Fault("lidar", "lidar_clock {clock_us:-1e9:1e9} ms", "The driver's clock is ahead by this."),
    Fault("lidar", "lidar_rate {rate_hz:1000} Hz",
        "Of the driver's messages; else as in the world.  200: a flood."),
    Fault("autopilot", "rangefinder_off", "RANGEFINDER says 0, DISTANCE_SENSOR nothing.",
        "rangefinder_off"),
    Fault("autopilot", "setpoints_ignored", "The autopilot takes no setpoint, without a word.",
        "setpoints_ignored"),
    Fault("", "estimator_reset {:1e5} m SIDE [{:1e5} m SIDE]",
        "The estimator starts afresh, and its position jumps by this much."),
    Fault("", "origin_move {:1e5} m WHERE [{:1e5} m WHERE]",
        "The origin of the estimator's local frame moves by this much."),
    Fault("", "pilot",
        "The pilot takes the vehicle: the mode changes to the one that pilots hold it in."),
    Fault("", "reboot", "The autopilot starts again, wherever it is."),
    Fault("", "ground_command {:1:65535} [{:-1e9:1e9}] [{:-1e9:1e9}] [{:-1e9:1e9}] "
        "[to_autopilot]", "A ground station sends this MAV_CMD with these first parameters to the "
        "companion, or to the autopilot."),
    Fault("", "ground_target {:1e5} m SIDE [{:1e5} m SIDE]",
        "A ground station gives the companion a target so far from where the vehicle is."),
    Fault("", "ground_fence {:0.1:1e5} m [{:1e5} m ahead]",
        "The vehicle's fence gets one more circle to stay out of, so far ahead of where it is."),
)
# fmt: on
"""In the order of the documentation."""
BY_NAME: Final = {fault.name: fault for fault in FAULTS}


def faults_page() -> str:
    """The table of docs/reference/faults.md."""
    same = {(each.group, each.key): f"`{each.name}`" for each in reversed(ASKING)}
    rows = ["| fault | parameters that do the same | what it does |\n|---|---|---|\n"]
    for fault in FAULTS:
        names = [same[at] for key in fault.fields if (at := (fault.group, key)) in same]
        usage = fault.usage.replace("|", r"\|")
        rows.append(f"| `{usage}` | {', '.join(names)} | {fault.about} |\n")
    return "".join(rows)


# --- the timeline ---------------------------------------------------------------------------------

NEVER_US: Final = 2**63 - 1
_LINE: Final = re.compile(
    r"at\s+(?P<at>.+?)(?:\s+for\s+(?P<length>.+?))?\s*:\s*(?P<what>\S.*)", re.I
)
_TIME: Final = re.compile(rf"({_PATTERNS['N']})\s*(us|ms|s|min|h)?", re.I)
_UNIT_US: Final = {"us": 1.0, "ms": 1e3, "s": 1e6, "min": 60e6, "h": 3600e6}
_LONGEST_US: Final = 10**15


@final
class Entry(NamedTuple):
    """One line."""

    at_us: int
    until_us: int
    name: str
    changes: Changes
    """Of the conditions, while it lasts; none: it happens once."""
    values: Sequence[float]
    """Of what happens once."""


@final
class Timeline:
    """Faults to come; one for each vehicle, for it remembers where it is."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []
        """Those that have not begun yet, in order of time."""
        self._lasting: list[Entry] = []
        self.next_us = NEVER_US
        """When something is due next: nothing is before."""

    @classmethod
    def parse(cls, text: str, *, name: str = "timeline") -> Self:
        """The timeline of this text; InputError names file (`name`), line and what is wrong."""
        timeline = cls()
        for number, raw in enumerate(text.splitlines(), start=1):
            if line := raw.partition("#")[0].strip():
                timeline._add(_entry(line, f"{name}:{number}"))
        return timeline

    def add(self, line: str, now_us: int) -> None:
        """A fault from now on: a line without its time, as "gps_off" or "for 30 s: gps_off"."""
        length, colon, what = line.strip().rpartition(":")
        self._add(_entry(f"at {now_us} us {length}{colon or ':'} {what}", "fault"))

    def _add(self, entry: Entry) -> None:
        bisect.insort(self.entries, entry, key=lambda each: each.at_us)
        self.next_us = min(self.next_us, entry.at_us)

    def step(self, now_us: int) -> list[Entry]:
        """Go on to this time of the simulation; returns what happens once, in order."""
        begun = bisect.bisect_right(self.entries, now_us, key=lambda each: each.at_us)
        new, self.entries = self.entries[:begun], self.entries[begun:]
        lasting = [*self._lasting, *(each for each in new if each.changes)]
        self._lasting = [each for each in lasting if each.until_us > now_us]
        ends = [each.until_us for each in self._lasting]
        self.next_us = min([each.at_us for each in self.entries[:1]] + ends, default=NEVER_US)
        return [each for each in new if not each.changes]

    @property
    def changes(self) -> list[Changes]:
        """Of the conditions, now: by each fault that lasts, the last begun last."""
        return [each.changes for each in self._lasting]


def _entry(line: str, where: str) -> Entry:
    """One line of a timeline; `where` it stands, for errors."""
    match = _LINE.fullmatch(line)
    if match is None:
        rule = 'reads "at TIME: FAULT" or "at TIME for TIME: FAULT"'
        raise InputError(where, line, rule, "Write for example: at 120 s for 30 s: gps_off.")
    at_us, length_us = _time_us(match["at"], where), NEVER_US
    if match["length"] is not None:
        length_us = _time_us(match["length"], where)
    what = match["what"].strip()
    name = what.split()[0].lower()
    if (fault := BY_NAME.get(name)) is None:
        remedy = did_you_mean(name, BY_NAME, f"Choose from: {', '.join(BY_NAME)}.")
        raise InputError(where, name, "no such fault", remedy)
    if match["length"] is not None and fault.once:
        raise InputError(where, line, f"{name} happens once", 'Leave out "for".')
    if length_us == 0:
        raise InputError(where, line, "lasts no time", "Write a longer time.")
    changes, values = fault.read(what, where)
    return Entry(at_us, min(at_us + length_us, NEVER_US), name, changes, values)


def _time_us(text: str, where: str) -> int:
    match = _TIME.fullmatch(text.strip())
    if match is None:
        raise InputError(where, text, "is not a time", "Write for example 120 s.")
    if match[2] is None:
        raise InputError(where, text, "a time names its unit", f"Write {text.strip()} s.")
    time_us = round(float(match[1]) * _UNIT_US[match[2].lower()])
    if not 0 <= time_us <= _LONGEST_US:
        raise InputError(where, text, "lies outside the run", "Write a time from 0 s on.")
    return time_us
