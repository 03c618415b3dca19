"""Every fault that a timeline knows: how it is written, what it sets, what it does."""

import functools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import final

from vehicle_sim.errors import did_you_mean
from vehicle_sim.faults.conditions import SIM_PARAMETERS, SIM_PARAMETERS_PX4
from vehicle_sim.geodesy import metres_per_degree
from vehicle_sim.parameters import Firmware

Numbers = Mapping[str, float]
Words = Mapping[str, str]
Sets = dict[str, float]

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
}
_FOUR = "north|east|south|west"
_WORDS = {
    "SIDE": _FOUR,
    "SIDE2": _FOUR,
    "WHERE": f"{_FOUR}|up|down",
    "WHERE2": f"{_FOUR}|up|down",
    "WAY": "to_vehicle|from_vehicle",
    "SIGN": "either_way",
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


Make = Callable[[Numbers, Words, Context], float | None]
Value = float | str | Make


@final
@dataclass(frozen=True)
class Fault:
    """One kind of fault."""

    name: str
    form: str
    """What follows the name: CAPITALS are numbers or one of several words, [...] may be left out, a
    unit with a question mark too."""
    about: str
    values: Mapping[str, Value]
    """What it sets: parameter -> number, the placeholder whose number it is, or how it is made."""
    once: bool = False
    """It happens at a moment and has no length."""
    only: Firmware | None = None

    @property
    def parameters(self) -> tuple[str, ...]:
        """All that it may set."""
        return tuple(self.values)

    def sets(self, numbers: Numbers, words: Words, context: Context) -> Sets:
        """The parameters that such a line sets, in order."""
        if "NAME" in words:
            return {words["NAME"].upper(): numbers["VALUE"]}
        sets = Sets()
        for name, value in self.values.items():
            if callable(value):
                made = value(numbers, words, context)
            else:
                made = numbers.get(value) if isinstance(value, str) else value
            if made is not None:
                sets[name] = made
        return sets

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

    def objection(self, words: Words, context: Context) -> tuple[str, str] | None:
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


def _along(
    axis: int, length: str = "LENGTH", sign: float = 1.0
) -> Callable[[Numbers, Words, Context], float]:
    """North (0), east (1) or up (2) of "20 m north 5 m east"."""

    def made(numbers: Numbers, words: Words, _: Context) -> float:
        total = 0.0
        for suffix in ("", "2"):
            word = words.get(f"WHERE{suffix}") or words.get(f"SIDE{suffix}")
            if word is not None:
                total += _UNIT[word.lower()][axis] * numbers[length + suffix]
        return sign * total

    return made


def _degrees(axis: int) -> Make:
    """The same as degrees of latitude or longitude."""
    metres = _along(axis)
    return lambda n, words, to: metres(n, words, to) / metres_per_degree(to.latitude_deg)[axis]


def _on(firmware: Firmware, value: float | str) -> Make:
    """For this firmware only: the number, or the placeholder's."""
    return lambda numbers, _, to: (
        None if to.firmware != firmware else numbers[value] if isinstance(value, str) else value
    )


def _or_zero(placeholder: str) -> Make:
    return lambda numbers, _words, _context: numbers.get(placeholder, 0.0)


def _way(_: Numbers, words: Words, __: Context) -> float:
    """Default: both ways, regardless of the state before."""
    return {"": 0.0, "to_vehicle": 1.0, "from_vehicle": 2.0}[words.get("WAY", "").lower()]


def _mask(numbers: Numbers, _: Words, __: Context) -> float:
    """Not named: all links."""
    return float(1 << round(numbers["LINK"])) if "LINK" in numbers else 0.0


def _either_way(numbers: Numbers, words: Words, _: Context) -> float:
    return -numbers["SIGMA"] if "SIGN" in words else numbers["SIGMA"]


_ON = "[WAY] [on link LINK]"
_WHICH: Mapping[str, Value] = {"SIM_LNK_WAY": _way, "SIM_LNK_MASK": _mask}

FAULTS: tuple[Fault, ...] = (
    Fault(
        "gps_off",
        "",
        "The receiver loses its fix.",
        {"SIM_GPS1_ENABLE": _on("ardupilot", 0.0), "SIM_GPS_USED": _on("px4", 0.0)},
    ),
    Fault(
        "gps_glitch",
        "LENGTH m WHERE [LENGTH2 m WHERE2]",
        "The receiver's position is off by so much.",
        {
            "SIM_GPS1_GLTCH_X": _degrees(0),
            "SIM_GPS1_GLTCH_Y": _degrees(1),
            "SIM_GPS1_GLTCH_Z": _along(2),
        },
    ),
    Fault(
        "gps_drift",
        "SPEED m/s WHERE",
        "The receiver's position wanders off at this speed, and its velocity says so.",
        {
            "SIM_GPS1_GLTV_X": _along(0, "SPEED"),
            "SIM_GPS1_GLTV_Y": _along(1, "SPEED"),
            "SIM_GPS1_GLTV_Z": _along(2, "SPEED", -1.0),
        },
    ),
    Fault(
        "gps_jam",
        "",
        "The fix comes and goes, with wild positions and velocities.",
        {"SIM_GPS1_JAM": 1.0},
    ),
    Fault(
        "gps_noise",
        "SIGMA m",
        "A random error with this standard deviation on each horizontal axis, 1.5 times that "
        "in height, correlated over seconds.",
        {"SIM_GPS_SIGMA": "SIGMA"},
    ),
    Fault(
        "gps_delay", "LAG ms", "The receiver's solutions are this old.", {"SIM_GPS1_LAG_MS": "LAG"}
    ),
    Fault(
        "gps_satellites",
        "COUNT",
        "The receiver sees so many satellites; PX4 has no fix with fewer than 4.",
        {"SIM_GPS1_NUMSATS": _on("ardupilot", "COUNT"), "SIM_GPS_USED": _on("px4", "COUNT")},
    ),
    Fault(
        "wind",
        "SPEED m/s from DIRECTION deg [turbulence GUST m/s?] [rising ANGLE deg]",
        "Wind from this true direction, full from 60 m above the ground on, with gusts of "
        "this standard deviation, rising by this angle.",
        {
            "SIM_WIND_SPD": "SPEED",
            "SIM_WIND_DIR": "DIRECTION",
            "SIM_WIND_TURB": _or_zero("GUST"),
            "SIM_WIND_DIR_Z": _or_zero("ANGLE"),
        },
    ),
    Fault("turbulence", "GUST m/s", "Gusts of this standard deviation.", {"SIM_WIND_TURB": "GUST"}),
    Fault(
        "battery",
        "PERCENT %",
        "No more than this is left in the battery.",
        {"SIM_BATT_MOST": "PERCENT"},
    ),
    Fault(
        "battery_voltage",
        "VOLTAGE V",
        "The battery's voltage at rest when full.",
        {"SIM_BATT_VOLTAGE": "VOLTAGE"},
        only="ardupilot",
    ),
    Fault("link_off", _ON, "Nothing passes.", {"SIM_LNK_OFF": 1.0, **_WHICH}),
    Fault(
        "link_loss",
        f"PERCENT % {_ON}",
        "This share of the frames is lost.",
        {"SIM_LNK_LOSS": "PERCENT", **_WHICH},
    ),
    Fault(
        "link_delay",
        f"DELAY ms [jitter JITTER ms] {_ON}",
        "Every frame is late by the delay and up to the jitter more.",
        {"SIM_LNK_DELAY": "DELAY", "SIM_LNK_JITTER": "JITTER", **_WHICH},
    ),
    Fault(
        "link_duplication",
        f"PERCENT % {_ON}",
        "This share of the frames arrives twice.",
        {"SIM_LNK_DUP": "PERCENT", **_WHICH},
    ),
    Fault(
        "link_reordering",
        f"PERCENT % {_ON}",
        "This share of the frames is overtaken by those after it.",
        {"SIM_LNK_REORD": "PERCENT", **_WHICH},
    ),
    Fault(
        "link_corruption",
        f"PERCENT % {_ON}",
        "This share of the frames arrives with a few bits wrong.",
        {"SIM_LNK_CORR": "PERCENT", **_WHICH},
    ),
    Fault(
        "radar_off",
        "",
        "The radar falls silent: no answers, no heartbeat.",
        {"SIM_RDR_OFF": 1.0},
    ),
    Fault("radar_blind", "", "The radar answers and sees nothing.", {"SIM_RDR_BLIND": 1.0}),
    Fault(
        "radar_drop",
        "PERCENT %",
        "This share of the cells in sight is not seen all the same.",
        {"SIM_RDR_MISS": "PERCENT"},
    ),
    Fault(
        "radar_loss",
        "PERCENT %",
        "This share of the radar's TERRAIN_DATA is never sent.",
        {"SIM_RDR_LOSS": "PERCENT"},
    ),
    Fault(
        "radar_noise",
        "SIGMA m [SIGN]",
        "Heights have an error of this size (standard deviation of the normal law it is "
        "drawn from), never downwards unless it says either_way.",
        {"SIM_RDR_NOISE": _either_way},
    ),
    Fault(
        "radar_delay",
        "DELAY ms",
        "The radar's answers are late by this.",
        {"SIM_RDR_DELAY": "DELAY"},
    ),
    Fault(
        "radar_rate",
        "RATE Hz",
        "The radar answers this many requests a second.",
        {"SIM_RDR_HZ": "RATE"},
    ),
    Fault(
        "lidar_dead",
        "",
        "No more measurements; the driver lives.",
        {"SIM_LDR_DEAD": 1.0},
    ),
    Fault("lidar_blind", "", "No echoes.", {"SIM_LDR_BLIND": 1.0}),
    Fault(
        "lidar_off",
        "",
        "The driver falls silent.",
        {"SIM_LDR_OFF": 1.0},
    ),
    Fault(
        "lidar_loss",
        "PERCENT %",
        "Lost between driver and autopilot.",
        {"SIM_LDR_LOSS": "PERCENT"},
    ),
    Fault(
        "lidar_dust",
        "PERCENT %",
        "Near echoes of nothing.",
        {"SIM_LDR_DUST": "PERCENT"},
    ),
    Fault(
        "lidar_stuck",
        "",
        "Old distances, new stamps.",
        {"SIM_LDR_STUCK": 1.0},
    ),
    Fault(
        "lidar_turned",
        "TURN deg",
        "Mounted so, unknown to all.",
        {"SIM_LDR_YAW": "TURN"},
    ),
    Fault(
        "lidar_clock",
        "AHEAD ms [jumping JITTER ms]",
        "Wrong stamps.",
        {"SIM_LDR_CLOCK": "AHEAD", "SIM_LDR_JUMP": _or_zero("JITTER")},
    ),
    Fault(
        "lidar_rate",
        "FLOOD Hz",
        "The driver's; 200: a flood.",
        {"SIM_LDR_HZ": "FLOOD"},
    ),
    Fault(
        "lidar_frame",
        "FRAME",
        "The driver claims this MAV_FRAME.",
        {"SIM_LDR_FRAME": "FRAME"},
    ),
    Fault(
        "lidar_junk",
        "PERCENT %",
        "Distances of 0, 65535, beyond limits; NaN angles.",
        {"SIM_LDR_JUNK": "PERCENT"},
    ),
    Fault(
        "lidar_mirror",
        "",
        "Clients' obstacle messages come back; the driver's come also as the companion's.",
        {"SIM_LDR_MIRROR": 1.0},
    ),
    Fault(
        "rangefinder_off",
        "",
        "RANGEFINDER says 0, DISTANCE_SENSOR nothing.",
        {"SIM_RFND_OFF": 1.0},
    ),
    Fault(
        "setpoints_ignored",
        "",
        "The autopilot takes no setpoint, without a word.",
        {"SIM_SP_IGNORE": 1.0},
    ),
    Fault(
        "estimator_reset",
        "LENGTH m SIDE [LENGTH2 m SIDE2]",
        "The estimator starts afresh, and its position jumps by this much.",
        {"SIM_EKF_RST_N": _along(0), "SIM_EKF_RST_E": _along(1)},
        once=True,
    ),
    Fault(
        "origin_move",
        "LENGTH m WHERE [LENGTH2 m WHERE2]",
        "The origin of the estimator's local frame moves by this much.",
        {"SIM_ORG_MOV_N": _along(0), "SIM_ORG_MOV_E": _along(1), "SIM_ORG_MOV_U": _along(2)},
        once=True,
    ),
    Fault(
        "pilot",
        "",
        "The pilot takes the vehicle: the mode changes to the one that pilots hold it in.",
        {"SIM_PILOT": 1.0},
        once=True,
    ),
    Fault(
        "reboot",
        "",
        "The autopilot starts again, wherever it is.",
        {"SIM_REBOOT": 1.0},
        once=True,
    ),
    Fault("set", "NAME VALUE", "Any other parameter whose name begins with SIM_.", {}),
)
"""In the order of the documentation."""

BY_NAME: Mapping[str, Fault] = {fault.name: fault for fault in FAULTS}
