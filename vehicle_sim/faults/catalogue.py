"""Every fault that a timeline knows: how it is written, what it sets, what it does.

A fault is a row of FAULTS.
"""

import functools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, final

from vehicle_sim.errors import did_you_mean
from vehicle_sim.faults.conditions import SIM_PARAMETERS, SIM_PARAMETERS_PX4
from vehicle_sim.geodesy import metres_per_degree
from vehicle_sim.parameters import Firmware

_LIMITS = {
    "PERCENT": (0.0, 100.0),
    "SPEED": (0.0, 100.0),
    "GUST": (0.0, 50.0),
    "DIRECTION": (-360.0, 360.0),
    "ANGLE": (-90.0, 90.0),
    "DELAY": (0.0, 60_000.0),
    "LAG": (0.0, 5000.0),
    "JITTER": (0.0, 60_000.0),
    "LENGTH": (0.0, 100_000.0),
    "LENGTH2": (0.0, 100_000.0),
    "SIGMA": (0.0, 1000.0),
    "COUNT": (0.0, 50.0),
    "VOLTAGE": (0.0, 60.0),
    "RATE": (0.1, 100.0),
    "TURN": (-360.0, 360.0),
    "AHEAD": (-1e9, 1e9),
    "FLOOD": (0.1, 1000.0),
    "FRAME": (0.0, 255.0),
    "LINK": (0.0, 23.0),
    "VALUE": (-1e9, 1e9),
    "RADIUS": (0.1, 100_000.0),
    "COMMAND": (1.0, 65_535.0),
    "P1": (-1e9, 1e9),
    "P2": (-1e9, 1e9),
    "P3": (-1e9, 1e9),
}
_FOUR = "north|east|south|west"
_WORDS = {
    "SIDE": _FOUR,
    "SIDE2": _FOUR,
    "WHERE": f"{_FOUR}|up|down",
    "WHERE2": f"{_FOUR}|up|down",
    "WAY": "to_vehicle|from_vehicle",
    "SIGN": "either_way",
    "TO": "to_autopilot",
    "NAME": r"\w+",
}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
_TOKENS = re.compile(r"\[|\]|[^\s\[\]]+")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """What a line's meaning depends on."""

    firmware: Firmware
    latitude_deg: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """What a line says, and where."""

    numbers: Mapping[str, float]
    words: Mapping[str, str]
    context: Context

    def along(self, axis: int) -> float:
        """North (0), east (1) or up (2) of "20 m north 5 m east", or of a speed."""
        total = 0.0
        length = "SPEED" if "SPEED" in self.numbers else "LENGTH"
        for suffix in ("", "2"):
            word = self.words.get(f"WHERE{suffix}") or self.words.get(f"SIDE{suffix}")
            if word is not None:
                total += _UNIT[word.lower()][axis] * self.numbers[length + suffix]
        return total

    def degrees(self, axis: int) -> float:
        """The same as degrees of latitude or longitude."""
        return self.along(axis) / metres_per_degree(self.context.latitude_deg)[axis]


Value = float | str | Callable[[Line], float | None]
"""Of a parameter: itself, a placeholder's number (0 where it is left out), or made of the line
(None: it is not to be set)."""


@final
@dataclass(frozen=True, kw_only=True)
class Fault:
    """One kind of fault."""

    name: str
    form: str
    """What follows the name: CAPITALS are numbers or one of several words, [...] may be left out, a
    unit with a question mark too."""
    about: str
    values: Mapping[str, Value]
    """What it sets, by parameter."""
    once: bool = False
    """It happens at a moment and has no length."""
    only: Firmware | None = None

    def sets(self, line: Line) -> dict[str, float]:
        """The parameters that such a line sets, in order."""
        if "NAME" in line.words:
            return {line.words["NAME"].upper(): line.numbers["VALUE"]}
        made = dict[str, float]()
        for name, value in self.values.items():
            if isinstance(value, str):
                made[name] = line.numbers.get(value, 0.0)
            elif not callable(value):
                made[name] = value
            elif (of_line := value(line)) is not None:
                made[name] = of_line
        return made

    @property
    def usage(self) -> str:
        """How it is written."""
        tokens = _TOKENS.findall(self.form)
        words = [_WORDS[t] if t in _WORDS and t != "NAME" else t.rstrip("?") for t in tokens]
        return " ".join([self.name, *words]).replace("[ ", "[").replace(" ]", "]")

    @functools.cached_property
    def pattern(self) -> re.Pattern[str]:
        """The whole text of the fault, with a group for each placeholder."""
        parts, after_number = [re.escape(self.name)], False
        for token in _TOKENS.findall(self.form):
            space = r"\s*" if after_number else r"\s+"
            after_number = token in _LIMITS
            if token in "[]":
                parts.append("(?:" if token == "[" else ")?")
            elif token in _LIMITS:
                parts.append(rf"{space}(?P<{token}>{_NUMBER})")
            elif token in _WORDS:
                parts.append(rf"{space}(?P<{token}>{_WORDS[token]})")
            elif token.endswith("?"):
                parts.append(rf"(?:{space}{re.escape(token[:-1])})?")
            else:
                parts.append(space + re.escape(token))
        return re.compile("".join(parts), re.I)

    @property
    def limits(self) -> Mapping[str, tuple[float, float]]:
        """Of each number in the form."""
        return {token: _LIMITS[token] for token in _TOKENS.findall(self.form) if token in _LIMITS}

    def objection(self, words: Mapping[str, str], context: Context) -> tuple[str, str] | None:
        """What is wrong with a name that is set outright: rule and remedy."""
        if "NAME" not in words:
            return None
        table = SIM_PARAMETERS if context.firmware == "ardupilot" else SIM_PARAMETERS_PX4
        known = [row.name for row in table]
        name = words["NAME"].upper()
        if name in known:
            return None
        remedy = did_you_mean(name, known, "Choose one that begins with SIM_.")
        return f"{context.firmware} has no such parameter", remedy


_UNIT = {
    "north": (1.0, 0.0, 0.0),
    "south": (-1.0, 0.0, 0.0),
    "east": (0.0, 1.0, 0.0),
    "west": (0.0, -1.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
}


def _along(axis: int) -> Callable[[Line], float]:
    return lambda line: line.along(axis)


_NORTH, _EAST, _UP = (_along(axis) for axis in range(3))


def _only(firmware: Firmware, value: float | str) -> Callable[[Line], float | None]:
    """For this firmware alone."""

    def made(line: Line) -> float | None:
        if line.context.firmware != firmware:
            return None
        return line.numbers[value] if isinstance(value, str) else value

    return made


_WAYS: Final = {"": 0.0, "to_vehicle": 1.0, "from_vehicle": 2.0}


def _way(line: Line) -> float:
    """Default: both ways, regardless of the state before."""
    return _WAYS[line.words.get("WAY", "").lower()]


def _mask(line: Line) -> float:
    """Not named: all links."""
    return float(1 << round(line.numbers["LINK"])) if "LINK" in line.numbers else 0.0


def _either_way(line: Line) -> float:
    return -line.numbers["SIGMA"] if "SIGN" in line.words else line.numbers["SIGMA"]


def _fault(
    name: str,
    form: str,
    about: str,
    *,
    once: bool = False,
    only: Firmware | None = None,
    **values: Value,
) -> Fault:
    return Fault(name=name, form=form, about=about, values=values, once=once, only=only)


def _link(name: str, form: str, about: str, **values: Value) -> Fault:
    form = f"{form} [WAY] [on link LINK]".strip()
    values |= {"SIM_LNK_WAY": _way, "SIM_LNK_MASK": _mask}
    return Fault(name=name, form=form, about=about, values=values)


# fmt: off
FAULTS: Final = (
    _fault("gps_off", "", "The receiver loses its fix.",
        SIM_GPS1_ENABLE=_only("ardupilot", 0), SIM_GPS_USED=_only("px4", 0)),
    _fault("gps_glitch", "LENGTH m WHERE [LENGTH2 m WHERE2]",
        "The receiver's position is off by so much.",
        SIM_GPS1_GLTCH_X=lambda line: line.degrees(0),
        SIM_GPS1_GLTCH_Y=lambda line: line.degrees(1), SIM_GPS1_GLTCH_Z=_UP),
    _fault("gps_drift", "SPEED m/s WHERE",
        "The receiver's position wanders off at this speed, and its velocity says so.",
        SIM_GPS1_GLTV_X=_NORTH, SIM_GPS1_GLTV_Y=_EAST, SIM_GPS1_GLTV_Z=lambda line: -line.along(2)),
    _fault("gps_jam", "", "The fix comes and goes, with wild positions and velocities.",
        SIM_GPS1_JAM=1),
    _fault("gps_noise", "SIGMA m",
        "A random error with this standard deviation on each horizontal axis, 1.5 times that in "
        "height, correlated over seconds.",
        SIM_GPS_SIGMA="SIGMA"),
    _fault("gps_delay", "LAG ms", "The receiver's solutions are this old.", SIM_GPS1_LAG_MS="LAG"),
    _fault("gps_satellites", "COUNT",
        "The receiver sees so many satellites; PX4 has no fix with fewer than 4.",
        SIM_GPS1_NUMSATS=_only("ardupilot", "COUNT"), SIM_GPS_USED=_only("px4", "COUNT")),
    _fault("wind", "SPEED m/s from DIRECTION deg [turbulence GUST m/s?] [rising ANGLE deg]",
        "Wind from this true direction, full from 60 m above the ground on, with gusts of this "
        "standard deviation, rising by this angle.",
        SIM_WIND_SPD="SPEED", SIM_WIND_DIR="DIRECTION", SIM_WIND_TURB="GUST",
        SIM_WIND_DIR_Z="ANGLE"),
    _fault("turbulence", "GUST m/s", "Gusts of this standard deviation.", SIM_WIND_TURB="GUST"),
    _fault("battery", "PERCENT %", "No more than this is left in the battery.",
        SIM_BATT_MOST="PERCENT"),
    _fault("battery_voltage", "VOLTAGE V", "The battery's voltage at rest when full.",
        SIM_BATT_VOLTAGE="VOLTAGE", only="ardupilot"),
    _link("link_off", "", "Nothing passes.", SIM_LNK_OFF=1),
    _link("link_loss", "PERCENT %", "This share of the frames is lost.", SIM_LNK_LOSS="PERCENT"),
    _link("link_delay", "DELAY ms [jitter JITTER ms]",
        "Every frame is late by the delay and up to the jitter more.",
        SIM_LNK_DELAY="DELAY", SIM_LNK_JITTER="JITTER"),
    _link("link_duplication", "PERCENT %", "This share of the frames arrives twice.",
        SIM_LNK_DUP="PERCENT"),
    _link("link_reordering", "PERCENT %",
        "This share of the frames is overtaken by those after it.",
        SIM_LNK_REORD="PERCENT"),
    _link("link_corruption", "PERCENT %", "This share of the frames arrives with a few bits wrong.",
        SIM_LNK_CORR="PERCENT"),
    _fault("radar_off", "", "The radar falls silent: no answers, no heartbeat.", SIM_RDR_OFF=1),
    _fault("radar_blind", "", "The radar answers and sees nothing.", SIM_RDR_BLIND=1),
    _fault("radar_drop", "PERCENT %", "This share of the cells in sight is not seen all the same.",
        SIM_RDR_MISS="PERCENT"),
    _fault("radar_loss", "PERCENT %", "This share of the radar's TERRAIN_DATA is never sent.",
        SIM_RDR_LOSS="PERCENT"),
    _fault("radar_noise", "SIGMA m [SIGN]",
        "Heights have an error of this size (standard deviation of the normal law it is drawn "
        "from), never downwards unless it says either_way.",
        SIM_RDR_NOISE=_either_way),
    _fault("radar_delay", "DELAY ms", "The radar's answers are late by this.",
        SIM_RDR_DELAY="DELAY"),
    _fault("radar_rate", "RATE Hz", "The radar answers this many requests a second.",
        SIM_RDR_HZ="RATE"),
    _fault("lidar_dead", "", "No more measurements; the driver lives.", SIM_LDR_DEAD=1),
    _fault("lidar_blind", "", "No echoes.", SIM_LDR_BLIND=1),
    _fault("lidar_off", "", "The driver falls silent.", SIM_LDR_OFF=1),
    _fault("lidar_loss", "PERCENT %", "Lost between driver and autopilot.", SIM_LDR_LOSS="PERCENT"),
    _fault("lidar_dust", "PERCENT %", "Near echoes of nothing.", SIM_LDR_DUST="PERCENT"),
    _fault("lidar_stuck", "", "Old distances, new stamps.", SIM_LDR_STUCK=1),
    _fault("lidar_turned", "TURN deg", "Mounted so, unknown to all.", SIM_LDR_YAW="TURN"),
    _fault("lidar_clock", "AHEAD ms [jumping JITTER ms]", "Wrong stamps.",
        SIM_LDR_CLOCK="AHEAD", SIM_LDR_JUMP="JITTER"),
    _fault("lidar_rate", "FLOOD Hz", "The driver's; 200: a flood.", SIM_LDR_HZ="FLOOD"),
    _fault("lidar_frame", "FRAME", "The driver claims this MAV_FRAME.", SIM_LDR_FRAME="FRAME"),
    _fault("lidar_junk", "PERCENT %", "Distances of 0, 65535, beyond limits; NaN angles.",
        SIM_LDR_JUNK="PERCENT"),
    _fault("lidar_mirror", "",
        "Clients' obstacle messages come back; the driver's come also as the companion's.",
        SIM_LDR_MIRROR=1),
    _fault("rangefinder_off", "", "RANGEFINDER says 0, DISTANCE_SENSOR nothing.", SIM_RFND_OFF=1),
    _fault("setpoints_ignored", "", "The autopilot takes no setpoint, without a word.",
        SIM_SP_IGNORE=1),
    _fault("estimator_reset", "LENGTH m SIDE [LENGTH2 m SIDE2]",
        "The estimator starts afresh, and its position jumps by this much.",
        SIM_EKF_RST_N=_NORTH, SIM_EKF_RST_E=_EAST, once=True),
    _fault("origin_move", "LENGTH m WHERE [LENGTH2 m WHERE2]",
        "The origin of the estimator's local frame moves by this much.",
        SIM_ORG_MOV_N=_NORTH, SIM_ORG_MOV_E=_EAST, SIM_ORG_MOV_U=_UP, once=True),
    _fault("pilot", "",
        "The pilot takes the vehicle: the mode changes to the one that pilots hold it in.",
        SIM_PILOT=1, once=True),
    _fault("reboot", "", "The autopilot starts again, wherever it is.", SIM_REBOOT=1, once=True),
    _fault("ground_command", "COMMAND [P1] [P2] [P3] [TO]",
        "A ground station sends this MAV_CMD with these first parameters to the companion, or to "
        "the autopilot.",
        SIM_GCS_CMD="COMMAND", SIM_GCS_P1="P1", SIM_GCS_P2="P2", SIM_GCS_P3="P3",
        SIM_GCS_TO=lambda line: float("TO" in line.words), once=True),
    _fault("ground_target", "LENGTH m SIDE [LENGTH2 m SIDE2]",
        "A ground station gives the companion a target so far from where the vehicle is.",
        SIM_GCS_TGT_N=_NORTH, SIM_GCS_TGT_E=_EAST, once=True),
    _fault("ground_fence", "RADIUS m [LENGTH m ahead]",
        "The vehicle's fence gets one more circle to stay out of, so far ahead of where it is.",
        SIM_GCS_FNC_R="RADIUS", SIM_GCS_FNC_A="LENGTH", once=True),
    _fault("set", "NAME VALUE", "Any other parameter whose name begins with SIM_."),
)
# fmt: on
"""In the order of the documentation."""
BY_NAME: Final = {fault.name: fault for fault in FAULTS}
