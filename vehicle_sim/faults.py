"""Every fault, and the timeline of those that are to come.

A fault is a row of FAULTS: how it is written, what it does, and which SIM_ parameters it sets.  A
timeline is text with one fault a line:

    # comments begin with a hash
    at 120 s for 30 s: gps_off
    at 60 s: wind 8 m/s from 270 deg turbulence 2 m/s
    at 3 min: estimator_reset 20 m north

Times are of the simulation, which a reboot of the autopilot does not begin again.  A fault with
`for` gives its parameters back afterwards what they were before; where several set the same
parameter, the one that began last counts.  One without `for` stays.
"""

import bisect
import functools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Self, final

from vehicle_sim.conditions import SIM_PARAMETERS, SIM_PARAMETERS_PX4, value_of
from vehicle_sim.errors import InputError, did_you_mean
from vehicle_sim.geodesy import metres_per_degree
from vehicle_sim.parameters import Firmware, Parameter, Readable

_ROWS: Final[Mapping[Firmware, Mapping[str, Parameter]]] = {
    "ardupilot": {row.name: row for row in SIM_PARAMETERS},
    "px4": {row.name: row for row in SIM_PARAMETERS_PX4},
}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
_LIMITS: Final = {
    "LENGTH": (0.0, 1e5),
    "LENGTH2": (0.0, 1e5),
    "SPEED": (0.0, 100.0),
    "SIGMA": (0.0, 1000.0),
    "COUNT": (0.0, 50.0),
    "RATE": (0.1, 100.0),
    "FLOOD": (0.1, 1000.0),
    "LINK": (0.0, 23.0),
    "COMMAND": (1.0, 65_535.0),
    "RADIUS": (0.1, 1e5),
}
"""Of the numbers in a form; any other has those of the parameter that it is the value of."""
_FOUR = "north|east|south|west"
_WORDS: Final = {
    "SIDE": _FOUR,
    "SIDE2": _FOUR,
    "WHERE": f"{_FOUR}|up|down",
    "WHERE2": f"{_FOUR}|up|down",
    "WAY": "to_vehicle|from_vehicle",
    "SIGN": "either_way",
    "TO": "to_autopilot",
    "NAME": r"\w+",
}
_UNIT: Final = {
    "north": (1.0, 0.0, 0.0),
    "south": (-1.0, 0.0, 0.0),
    "east": (0.0, 1.0, 0.0),
    "west": (0.0, -1.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
}


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """What a line says, and of which flight."""

    numbers: Mapping[str, float]
    words: Mapping[str, str]
    firmware: Firmware
    latitude_deg: float

    def along(self, axis: int) -> float:
        """North (0), east (1) or up (2) of "20 m north 5 m east", or of a speed."""
        size, total = "SPEED" if "SPEED" in self.numbers else "LENGTH", 0.0
        for suffix in ("", "2"):
            word = self.words.get(f"WHERE{suffix}") or self.words.get(f"SIDE{suffix}")
            if word is not None:
                total += _UNIT[word.lower()][axis] * self.numbers[size + suffix]
        return total

    def degrees(self, axis: int) -> float:
        """The same as degrees of latitude or longitude."""
        return self.along(axis) / metres_per_degree(self.latitude_deg)[axis]


Value = float | str | Callable[[Line], float | None]
"""Of a parameter: itself, a placeholder's number (0 where it is left out), or made of the line
(None: it is not to be set)."""


@final
@dataclass(frozen=True)
class Fault:
    """One kind of fault."""

    name: str
    form: str
    """What follows the name: CAPITALS are numbers or one of several words, [...] may be left
    out."""
    about: str
    values: Mapping[str, Value]
    """What it sets, by parameter."""
    once: bool = False
    """It happens at a moment and has no length."""
    only: Firmware | None = None

    @property
    def usage(self) -> str:
        """How it is written."""
        words = [t if t == "NAME" else _WORDS.get(t, t) for t in _tokens(self.form)]
        return " ".join([self.name, *words]).replace("[ ", "[").replace(" ]", "]")

    @functools.cached_property
    def pattern(self) -> re.Pattern[str]:
        """The whole text of the fault, with a group for each placeholder."""
        parts, space = [re.escape(self.name)], r"\s+"
        for token in _tokens(self.form):
            match token:
                case "[" | "]":
                    parts.append("(?:" if token == "[" else ")?")
                    continue
                case _ if _is_placeholder(token):
                    parts.append(f"{space}(?P<{token}>{_WORDS.get(token, _NUMBER)})")
                case _:
                    parts.append(space + re.escape(token))
            is_number = _is_placeholder(token) and token not in _WORDS
            space = r"\s*" if is_number else r"\s+"  # "8m/s" is "8 m/s"
        return re.compile("".join(parts), re.I)

    def sets(self, line: Line) -> dict[str, float]:
        """The parameters that such a line sets, in order."""
        if "NAME" in line.words:
            return {line.words["NAME"].upper(): line.numbers["VALUE"]}
        made = dict[str, float]()
        for name, value in self.values.items():
            of_line = value(line) if callable(value) else value
            if isinstance(of_line, str):
                of_line = line.numbers.get(of_line, 0.0)
            if of_line is not None:
                made[name] = of_line
        return made

    def limits(self, number: str, row: Parameter | None) -> tuple[float, float]:
        """Least and most of one of its numbers; `row`: the parameter that `set` names."""
        if number not in _LIMITS and row is None:
            name = next(name for name, value in self.values.items() if value == number)
            row = next(rows[name] for rows in _ROWS.values() if name in rows)
        return _LIMITS.get(number) or (row.least, row.most)  # type: ignore[union-attr]


def _tokens(form: str) -> list[str]:
    return re.findall(r"\[|\]|[^\s\[\]]+", form)


def _is_placeholder(token: str) -> bool:
    return token.isupper() and len(token) > 1  # V is a unit


# --- the list -------------------------------------------------------------------------------------


def _along(axis: int, sign: float = 1.0) -> Callable[[Line], float]:
    return lambda line: sign * line.along(axis)


def _only(firmware: Firmware, value: float | str) -> Callable[[Line], float | None]:
    """For this firmware alone."""

    def made(line: Line) -> float | None:
        if line.firmware != firmware:
            return None
        return line.numbers[value] if isinstance(value, str) else value

    return made


def _link(name: str, form: str, about: str, values: Mapping[str, Value]) -> Fault:
    """Of both ways and all links unless it says which."""
    ways = {"": 0.0, "to_vehicle": 1.0, "from_vehicle": 2.0}
    which: dict[str, Value] = {
        "SIM_LNK_WAY": lambda line: ways[line.words.get("WAY", "").lower()],
        "SIM_LNK_MASK": lambda line: (
            float(1 << round(line.numbers["LINK"])) if "LINK" in line.numbers else 0.0
        ),
    }
    return Fault(name, f"{form} [WAY] [on link LINK]".strip(), about, {**values, **which})


# fmt: off
FAULTS: Final = (
    Fault("gps_off", "", "The receiver loses its fix.",
        {"SIM_GPS1_ENABLE": _only("ardupilot", 0), "SIM_GPS_USED": _only("px4", 0)}),
    Fault("gps_glitch", "LENGTH m WHERE [LENGTH2 m WHERE2]",
        "The receiver's position is off by so much.",
        {"SIM_GPS1_GLTCH_X": lambda line: line.degrees(0),
         "SIM_GPS1_GLTCH_Y": lambda line: line.degrees(1), "SIM_GPS1_GLTCH_Z": _along(2)}),
    Fault("gps_drift", "SPEED m/s WHERE",
        "The receiver's position wanders off at this speed, and its velocity says so.",
        {"SIM_GPS1_GLTV_X": _along(0), "SIM_GPS1_GLTV_Y": _along(1),
         "SIM_GPS1_GLTV_Z": _along(2, -1.0)}),
    Fault("gps_jam", "", "The fix comes and goes, with wild positions and velocities.",
        {"SIM_GPS1_JAM": 1}),
    Fault("gps_noise", "SIGMA m",
        "A random error with this standard deviation on each horizontal axis, 1.5 times that in "
        "height, correlated over seconds.",
        {"SIM_GPS_SIGMA": "SIGMA"}),
    Fault("gps_delay", "LAG ms", "The receiver's solutions are this old.",
        {"SIM_GPS1_LAG_MS": "LAG"}),
    Fault("gps_satellites", "COUNT",
        "The receiver sees so many satellites; PX4 has no fix with fewer than 4.",
        {"SIM_GPS1_NUMSATS": _only("ardupilot", "COUNT"), "SIM_GPS_USED": _only("px4", "COUNT")}),
    Fault("wind", "SPEED m/s from DIRECTION deg [turbulence GUST [m/s]] [rising ANGLE deg]",
        "Wind from this true direction, full from 60 m above the ground on, with gusts of this "
        "standard deviation, rising by this angle.",
        {"SIM_WIND_SPD": "SPEED", "SIM_WIND_DIR": "DIRECTION", "SIM_WIND_TURB": "GUST",
         "SIM_WIND_DIR_Z": "ANGLE"}),
    Fault("turbulence", "GUST m/s", "Gusts of this standard deviation.", {"SIM_WIND_TURB": "GUST"}),
    Fault("battery", "PERCENT %", "No more than this is left in the battery.",
        {"SIM_BATT_MOST": "PERCENT"}),
    Fault("battery_voltage", "VOLTAGE V", "The battery's voltage at rest when full.",
        {"SIM_BATT_VOLTAGE": "VOLTAGE"}, only="ardupilot"),
    _link("link_off", "", "Nothing passes.", {"SIM_LNK_OFF": 1}),
    _link("link_loss", "PERCENT %", "This share of the frames is lost.",
        {"SIM_LNK_LOSS": "PERCENT"}),
    _link("link_delay", "DELAY ms [jitter JITTER ms]",
        "Every frame is late by the delay and up to the jitter more.",
        {"SIM_LNK_DELAY": "DELAY", "SIM_LNK_JITTER": "JITTER"}),
    _link("link_duplication", "PERCENT %", "This share of the frames arrives twice.",
        {"SIM_LNK_DUP": "PERCENT"}),
    _link("link_reordering", "PERCENT %",
        "This share of the frames is overtaken by those after it.",
        {"SIM_LNK_REORD": "PERCENT"}),
    _link("link_corruption", "PERCENT %", "This share of the frames arrives with a few bits wrong.",
        {"SIM_LNK_CORR": "PERCENT"}),
    Fault("radar_off", "", "The radar falls silent: no answers, no heartbeat.", {"SIM_RDR_OFF": 1}),
    Fault("radar_blind", "", "The radar answers and sees nothing.", {"SIM_RDR_BLIND": 1}),
    Fault("radar_drop", "PERCENT %", "This share of the cells in sight is not seen all the same.",
        {"SIM_RDR_MISS": "PERCENT"}),
    Fault("radar_loss", "PERCENT %", "This share of the radar's TERRAIN_DATA is never sent.",
        {"SIM_RDR_LOSS": "PERCENT"}),
    Fault("radar_noise", "SIGMA m [SIGN]",
        "Heights have an error of this size (standard deviation of the normal law it is drawn "
        "from), never downwards unless it says either_way.",
        {"SIM_RDR_NOISE": lambda line:
            -line.numbers["SIGMA"] if "SIGN" in line.words else line.numbers["SIGMA"]}),
    Fault("radar_delay", "DELAY ms", "The radar's answers are late by this.",
        {"SIM_RDR_DELAY": "DELAY"}),
    Fault("radar_rate", "RATE Hz", "The radar answers this many requests a second.",
        {"SIM_RDR_HZ": "RATE"}),
    Fault("lidar_dead", "", "No more measurements; the driver lives.", {"SIM_LDR_DEAD": 1}),
    Fault("lidar_blind", "", "No echoes.", {"SIM_LDR_BLIND": 1}),
    Fault("lidar_off", "", "The driver falls silent.", {"SIM_LDR_OFF": 1}),
    Fault("lidar_loss", "PERCENT %", "Lost between driver and autopilot.",
        {"SIM_LDR_LOSS": "PERCENT"}),
    Fault("lidar_dust", "PERCENT %", "Near echoes of nothing.", {"SIM_LDR_DUST": "PERCENT"}),
    Fault("lidar_stuck", "", "Old distances, new stamps.", {"SIM_LDR_STUCK": 1}),
    Fault("lidar_turned", "TURN deg", "Mounted so, unknown to all.", {"SIM_LDR_YAW": "TURN"}),
    Fault("lidar_clock", "AHEAD ms [jumping JITTER ms]", "Wrong stamps.",
        {"SIM_LDR_CLOCK": "AHEAD", "SIM_LDR_JUMP": "JITTER"}),
    Fault("lidar_rate", "FLOOD Hz", "The driver's; 200: a flood.", {"SIM_LDR_HZ": "FLOOD"}),
    Fault("lidar_frame", "FRAME", "The driver claims this MAV_FRAME.", {"SIM_LDR_FRAME": "FRAME"}),
    Fault("lidar_junk", "PERCENT %", "Distances of 0, 65535, beyond limits; NaN angles.",
        {"SIM_LDR_JUNK": "PERCENT"}),
    Fault("lidar_mirror", "",
        "Clients' obstacle messages come back; the driver's come also as the companion's.",
        {"SIM_LDR_MIRROR": 1}),
    Fault("rangefinder_off", "", "RANGEFINDER says 0, DISTANCE_SENSOR nothing.",
        {"SIM_RFND_OFF": 1}),
    Fault("setpoints_ignored", "", "The autopilot takes no setpoint, without a word.",
        {"SIM_SP_IGNORE": 1}),
    Fault("estimator_reset", "LENGTH m SIDE [LENGTH2 m SIDE2]",
        "The estimator starts afresh, and its position jumps by this much.",
        {"SIM_EKF_RST_N": _along(0), "SIM_EKF_RST_E": _along(1)}, once=True),
    Fault("origin_move", "LENGTH m WHERE [LENGTH2 m WHERE2]",
        "The origin of the estimator's local frame moves by this much.",
        {"SIM_ORG_MOV_N": _along(0), "SIM_ORG_MOV_E": _along(1),
         "SIM_ORG_MOV_U": _along(2)}, once=True),
    Fault("pilot", "",
        "The pilot takes the vehicle: the mode changes to the one that pilots hold it in.",
        {"SIM_PILOT": 1}, once=True),
    Fault("reboot", "", "The autopilot starts again, wherever it is.",
        {"SIM_REBOOT": 1}, once=True),
    Fault("ground_command", "COMMAND [P1] [P2] [P3] [TO]",
        "A ground station sends this MAV_CMD with these first parameters to the companion, or to "
        "the autopilot.",
        {"SIM_GCS_CMD": "COMMAND", "SIM_GCS_P1": "P1", "SIM_GCS_P2": "P2", "SIM_GCS_P3": "P3",
         "SIM_GCS_TO": lambda line: float("TO" in line.words)}, once=True),
    Fault("ground_target", "LENGTH m SIDE [LENGTH2 m SIDE2]",
        "A ground station gives the companion a target so far from where the vehicle is.",
        {"SIM_GCS_TGT_N": _along(0), "SIM_GCS_TGT_E": _along(1)}, once=True),
    Fault("ground_fence", "RADIUS m [LENGTH m ahead]",
        "The vehicle's fence gets one more circle to stay out of, so far ahead of where it is.",
        {"SIM_GCS_FNC_R": "RADIUS", "SIM_GCS_FNC_A": "LENGTH"}, once=True),
    Fault("set", "NAME VALUE", "Any other parameter whose name begins with SIM_.", {}),
)
# fmt: on
"""In the order of the documentation."""
BY_NAME: Final = {fault.name: fault for fault in FAULTS}


def faults_page() -> str:
    """docs/reference/faults.md."""
    rows = list[str]()
    for fault in FAULTS:
        usage = fault.usage.replace("|", r"\|")
        names = ", ".join(f"`{name}`" for name in fault.values)
        rows.append(f"| `{usage}` | {names} | {fault.about} |\n")
    return _PAGE + "".join(rows)


_PAGE: Final = """# Faults

Made from `vehicle_sim/faults.py` by `scripts/docs`. A line of a timeline reads
`at TIME: FAULT` or `at TIME for TIME: FAULT`, with units (`ms`, `s`, `min`, `h`).
`estimator_reset`, `origin_move`, `pilot`, `reboot` and what a ground station does happen once and
take no `for`.
Of overlapping faults the latest counts.
`SIM_GPS_USED` is PX4's only, `SIM_BATT_VOLTAGE` and `battery_voltage` are ArduPilot's only.

| fault | parameters | what it does |
|---|---|---|
"""


# --- the timeline ---------------------------------------------------------------------------------

NEVER_US: Final = 2**63 - 1
_LINE = re.compile(r"at\s+(?P<at>.+?)(?:\s+for\s+(?P<length>.+?))?\s*:\s*(?P<what>\S.*)", re.I)
_TIME = re.compile(rf"(?P<number>{_NUMBER})\s*(?P<unit>us|ms|s|min|h)?", re.I)
_UNIT_US = {"us": 1.0, "ms": 1e3, "s": 1e6, "min": 60e6, "h": 3600e6}
_LONGEST_US = 10**15
_FORM = 'reads "at TIME: FAULT" or "at TIME for TIME: FAULT"'
_EXAMPLE = "Write for example: at 120 s for 30 s: gps_off."
_NOTHING: tuple[tuple[str, float], ...] = ()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One line."""

    at_us: int
    until_us: int | None
    """None: it stays, or happens once."""
    sets: Mapping[str, float]


@final
class Timeline:
    """Faults to come; one for each vehicle, for it remembers where it is.

    The latitude is that of the flight: where metres east have to be said in degrees.
    """

    def __init__(self, firmware: Firmware = "ardupilot", latitude_deg: float = 0.0) -> None:
        self._firmware, self._latitude_deg = firmware, latitude_deg
        self.entries: list[Entry] = []
        self._edges: list[tuple[int, int, int]] = []
        """What is still to come: time, 0 for an end and 1 for a beginning, which entry."""
        self._layers: dict[str, list[tuple[int, float]]] = {}
        """Of each parameter that a fault sets for a time: what it was before (-1) or what one that
        stays has set, and then the entries that set it now, the last begun last."""
        self.next_us = NEVER_US
        """When something is due next: nothing is before."""

    @classmethod
    def parse(
        cls,
        text: str,
        *,
        name: str = "timeline",
        firmware: Firmware = "ardupilot",
        latitude_deg: float = 0.0,
    ) -> Self:
        """The timeline of this text; InputError names file (`name`), line and what is wrong."""
        timeline = cls(firmware, latitude_deg)
        entries = list[Entry]()
        for number, raw in enumerate(text.splitlines(), start=1):
            if line := raw.partition("#")[0].strip():
                entries.append(timeline._entry(line, f"{name}:{number}"))
        for entry in sorted(entries, key=lambda entry: entry.at_us):
            timeline._add(entry)
        return timeline

    def add(self, line: str, now_us: int) -> None:
        """A fault from now on: a line without its time, as "gps_off" or "for 30 s: gps_off"."""
        length, colon, what = line.strip().rpartition(":")
        self._add(self._entry(f"at {now_us} us {length}{colon or ':'} {what}", "fault"))

    def _add(self, entry: Entry) -> None:
        which = len(self.entries)
        self.entries.append(entry)
        bisect.insort(self._edges, (entry.at_us, 1, which))
        if entry.until_us is not None:
            bisect.insort(self._edges, (entry.until_us, 0, which))
        self.next_us = self._edges[0][0]

    def step(self, now_us: int, parameters: Readable) -> Sequence[tuple[str, float]]:
        """What to set now (time of the simulation), given what the parameters are: in order."""
        if now_us < self.next_us:
            return _NOTHING
        touched = dict[str, None]()
        due = bisect.bisect_right(self._edges, (now_us, 2, 0))
        for _, begins, which in self._edges[:due]:
            for name, value in self.entries[which].sets.items():
                layers = self._layers.setdefault(name, [(-1, value_of(parameters, name))])
                if not begins:
                    kept = [layer for layer in layers if layer[0] != which]
                    if len(kept) == len(layers):  # buried under one that stays
                        continue
                    self._layers[name] = kept
                elif self.entries[which].until_us is None:  # nothing below can show again
                    self._layers[name] = [(-1, value)]
                else:
                    layers.append((which, value))
                touched[name] = None
        del self._edges[:due]
        self.next_us = self._edges[0][0] if self._edges else NEVER_US
        changes = [(name, self._layers[name][-1][1]) for name in touched]
        self._layers = {name: each for name, each in self._layers.items() if len(each) > 1}
        return changes

    def _entry(self, line: str, where: str) -> Entry:
        match = _LINE.fullmatch(line)
        if match is None:
            raise InputError(where, line, _FORM, _EXAMPLE)
        at_us = _time_us(match["at"], where)
        length_us = None if match["length"] is None else _time_us(match["length"], where)
        what = match["what"].strip()
        name = what.split()[0]
        fault = BY_NAME.get(name.lower())
        if fault is None:
            remedy = did_you_mean(name.lower(), BY_NAME, f"Choose from: {', '.join(BY_NAME)}.")
            raise InputError(where, name, "no such fault", remedy)
        if length_us is not None and fault.once:
            raise InputError(where, line, f"{fault.name} happens once", 'Leave out "for".')
        if length_us == 0:
            raise InputError(where, line, "lasts no time", "Write a longer time.")
        if fault.only not in (None, self._firmware):
            rule = f"{fault.name} is for {fault.only}, and this is {self._firmware}"
            raise InputError(where, line, rule, "Leave it out.")
        until_us = None if length_us is None else at_us + length_us
        return Entry(at_us=at_us, until_us=until_us, sets=self._sets(fault, what, where))

    def _sets(self, fault: Fault, what: str, where: str) -> Mapping[str, float]:
        match = fault.pattern.fullmatch(what)
        if match is None:
            raise InputError(where, what, f'reads "{fault.usage}"', "Correct the line.")
        said = {key: value for key, value in match.groupdict().items() if value is not None}
        words = {key: value for key, value in said.items() if key in _WORDS}
        known, row = _ROWS[self._firmware], None
        if "NAME" in words and (row := known.get(words["NAME"].upper())) is None:
            remedy = did_you_mean(words["NAME"].upper(), known, "Choose one that begins with SIM_.")
            raise InputError(where, what, f"{self._firmware} has no such parameter", remedy)
        numbers = {key: float(value) for key, value in said.items() if key not in _WORDS}
        for key, value in numbers.items():
            least, most = fault.limits(key, row)
            if not least <= value <= most:
                rule = f"{key} must lie from {least:g} to {most:g}"
                raise InputError(where, what, rule, "Correct the number.")
        line = Line(
            numbers=numbers,
            words=words,
            firmware=self._firmware,
            latitude_deg=self._latitude_deg,
        )
        return fault.sets(line)


def _time_us(text: str, where: str) -> int:
    match = _TIME.fullmatch(text.strip())
    if match is None:
        raise InputError(where, text, "is not a time", "Write for example 120 s.")
    if match["unit"] is None:
        raise InputError(where, text, "a time names its unit", f"Write {text.strip()} s.")
    time_us = round(float(match["number"]) * _UNIT_US[match["unit"].lower()])
    if not 0 <= time_us <= _LONGEST_US:
        raise InputError(where, text, "lies outside the run", "Write a time from 0 s on.")
    return time_us
