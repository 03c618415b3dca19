"""Every fault that a timeline knows: how it is written, what it sets, what it does."""

import difflib
import functools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import final

from vehicle_sim.faults.conditions import SIM_PARAMETERS, SIM_PARAMETERS_PX4, Firmware
from vehicle_sim.geodesy import metres_per_degree

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


@final
@dataclass(frozen=True, kw_only=True)
class Fault:
    """One kind of fault."""

    name: str
    form: str = ""
    """What follows the name: CAPITALS are numbers or one of several words, [...] may be left out, a
    unit with a question mark too."""
    about: str
    parameters: tuple[str, ...]
    sets: Callable[[Numbers, Words, Context], Sets]
    once: bool = False
    """It happens at a moment and has no length."""
    only: Firmware | None = None

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
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
        remedy = f"Did you mean {near[0]}?" if near else "Choose one that begins with SIM_."
        return f"{context.firmware} has no such parameter", remedy


def _fixed(**sets: float) -> Callable[[Numbers, Words, Context], Sets]:
    return lambda _numbers, _words, _context: dict(sets)


def _scaled(parameter: str, placeholder: str) -> Callable[[Numbers, Words, Context], Sets]:
    return lambda numbers, _words, _context: {parameter: numbers[placeholder]}


def _vector(numbers: Numbers, words: Words, length: str = "LENGTH") -> tuple[float, float, float]:
    """North, east, up of "20 m north 5 m east"."""
    unit = {
        "north": (1.0, 0.0, 0.0),
        "south": (-1.0, 0.0, 0.0),
        "east": (0.0, 1.0, 0.0),
        "west": (0.0, -1.0, 0.0),
        "up": (0.0, 0.0, 1.0),
        "down": (0.0, 0.0, -1.0),
    }
    total = [0.0, 0.0, 0.0]
    for suffix in ("", "2"):
        word = words.get(f"WHERE{suffix}") or words.get(f"SIDE{suffix}")
        if word is not None:
            for axis in range(3):
                total[axis] += unit[word.lower()][axis] * numbers[length + suffix]
    return total[0], total[1], total[2]


def _gps_off(_numbers: Numbers, _words: Words, context: Context) -> Sets:
    return {"SIM_GPS_USED": 0.0} if context.firmware == "px4" else {"SIM_GPS1_ENABLE": 0.0}


def _gps_satellites(numbers: Numbers, _words: Words, context: Context) -> Sets:
    name = "SIM_GPS_USED" if context.firmware == "px4" else "SIM_GPS1_NUMSATS"
    return {name: numbers["COUNT"]}


def _gps_glitch(numbers: Numbers, words: Words, context: Context) -> Sets:
    north_m, east_m, up_m = _vector(numbers, words)
    per_north_m, per_east_m = metres_per_degree(context.latitude_deg)
    return {
        "SIM_GPS1_GLTCH_X": north_m / per_north_m,
        "SIM_GPS1_GLTCH_Y": east_m / per_east_m,
        "SIM_GPS1_GLTCH_Z": up_m,
    }


def _gps_drift(numbers: Numbers, words: Words, _context: Context) -> Sets:
    north, east, up = _vector(numbers, words, "SPEED")
    return {"SIM_GPS1_GLTV_X": north, "SIM_GPS1_GLTV_Y": east, "SIM_GPS1_GLTV_Z": -up}


def _wind(numbers: Numbers, _words: Words, _context: Context) -> Sets:
    sets = {"SIM_WIND_SPD": numbers["SPEED"], "SIM_WIND_DIR": numbers["DIRECTION"]}
    sets["SIM_WIND_TURB"] = numbers.get("GUST", 0.0)
    sets["SIM_WIND_DIR_Z"] = numbers.get("ANGLE", 0.0)
    return sets


def _link(**parameters: str) -> Callable[[Numbers, Words, Context], Sets]:
    """A fault of the links: parameter by placeholder, and which way and link."""

    def sets(numbers: Numbers, words: Words, _context: Context) -> Sets:
        made = {p: numbers[key] for key, p in parameters.items() if key in numbers}
        if not parameters:
            made["SIM_LNK_OFF"] = 1.0
        way = words.get("WAY", "").lower()  # not named: both ways, all links, whatever was before
        made["SIM_LNK_WAY"] = {"": 0.0, "to_vehicle": 1.0, "from_vehicle": 2.0}[way]
        made["SIM_LNK_MASK"] = float(1 << round(numbers["LINK"])) if "LINK" in numbers else 0.0
        return made

    return sets


def _radar_noise(numbers: Numbers, words: Words, _context: Context) -> Sets:
    return {"SIM_RDR_NOISE": -numbers["SIGMA"] if "SIGN" in words else numbers["SIGMA"]}


def _estimator_reset(numbers: Numbers, words: Words, _context: Context) -> Sets:
    north_m, east_m, _ = _vector(numbers, words)
    return {"SIM_EKF_RST_N": north_m, "SIM_EKF_RST_E": east_m}


def _origin_move(numbers: Numbers, words: Words, _context: Context) -> Sets:
    north_m, east_m, up_m = _vector(numbers, words)
    return {"SIM_ORG_MOV_N": north_m, "SIM_ORG_MOV_E": east_m, "SIM_ORG_MOV_U": up_m}


def _set(numbers: Numbers, words: Words, _context: Context) -> Sets:
    return {words["NAME"].upper(): numbers["VALUE"]}


_ON = "[WAY] [on link LINK]"
_WAY = ("SIM_LNK_WAY", "SIM_LNK_MASK")

FAULTS: tuple[Fault, ...] = (
    Fault(
        name="gps_off",
        about="The receiver loses its fix.",
        parameters=("SIM_GPS1_ENABLE", "SIM_GPS_USED"),
        sets=_gps_off,
    ),
    Fault(
        name="gps_glitch",
        form="LENGTH m WHERE [LENGTH2 m WHERE2]",
        about="The receiver's position is off by so much.",
        parameters=("SIM_GPS1_GLTCH_X", "SIM_GPS1_GLTCH_Y", "SIM_GPS1_GLTCH_Z"),
        sets=_gps_glitch,
    ),
    Fault(
        name="gps_drift",
        form="SPEED m/s WHERE",
        about="The receiver's position wanders off at this speed, and its velocity says so.",
        parameters=("SIM_GPS1_GLTV_X", "SIM_GPS1_GLTV_Y", "SIM_GPS1_GLTV_Z"),
        sets=_gps_drift,
    ),
    Fault(
        name="gps_jam",
        about="The fix comes and goes, with wild positions and velocities.",
        parameters=("SIM_GPS1_JAM",),
        sets=_fixed(SIM_GPS1_JAM=1.0),
    ),
    Fault(
        name="gps_noise",
        form="SIGMA m",
        about="A random error with this standard deviation on each horizontal axis, 1.5 times that "
        "in height, correlated over seconds.",
        parameters=("SIM_GPS_SIGMA",),
        sets=_scaled("SIM_GPS_SIGMA", "SIGMA"),
    ),
    Fault(
        name="gps_delay",
        form="LAG ms",
        about="The receiver's solutions are this old.",
        parameters=("SIM_GPS1_LAG_MS",),
        sets=_scaled("SIM_GPS1_LAG_MS", "LAG"),
    ),
    Fault(
        name="gps_satellites",
        form="COUNT",
        about="The receiver sees so many satellites; PX4 has no fix with fewer than 4.",
        parameters=("SIM_GPS1_NUMSATS", "SIM_GPS_USED"),
        sets=_gps_satellites,
    ),
    Fault(
        name="wind",
        form="SPEED m/s from DIRECTION deg [turbulence GUST m/s?] [rising ANGLE deg]",
        about="Wind from this true direction, full from 60 m above the ground on, with gusts of "
        "this standard deviation, rising by this angle.",
        parameters=("SIM_WIND_SPD", "SIM_WIND_DIR", "SIM_WIND_TURB", "SIM_WIND_DIR_Z"),
        sets=_wind,
    ),
    Fault(
        name="turbulence",
        form="GUST m/s",
        about="Gusts of this standard deviation.",
        parameters=("SIM_WIND_TURB",),
        sets=_scaled("SIM_WIND_TURB", "GUST"),
    ),
    Fault(
        name="battery",
        form="PERCENT %",
        about="No more than this is left in the battery.",
        parameters=("SIM_BATT_MOST",),
        sets=_scaled("SIM_BATT_MOST", "PERCENT"),
    ),
    Fault(
        name="battery_voltage",
        form="VOLTAGE V",
        about="The battery's voltage at rest when full.",
        parameters=("SIM_BATT_VOLTAGE",),
        sets=_scaled("SIM_BATT_VOLTAGE", "VOLTAGE"),
        only="ardupilot",
    ),
    Fault(
        name="link_off",
        form=_ON,
        about="Nothing passes.",
        parameters=("SIM_LNK_OFF", *_WAY),
        sets=_link(),
    ),
    Fault(
        name="link_loss",
        form=f"PERCENT % {_ON}",
        about="This share of the frames is lost.",
        parameters=("SIM_LNK_LOSS", *_WAY),
        sets=_link(PERCENT="SIM_LNK_LOSS"),
    ),
    Fault(
        name="link_delay",
        form=f"DELAY ms [jitter JITTER ms] {_ON}",
        about="Every frame is late by the delay and up to the jitter more.",
        parameters=("SIM_LNK_DELAY", "SIM_LNK_JITTER", *_WAY),
        sets=_link(DELAY="SIM_LNK_DELAY", JITTER="SIM_LNK_JITTER"),
    ),
    Fault(
        name="link_duplication",
        form=f"PERCENT % {_ON}",
        about="This share of the frames arrives twice.",
        parameters=("SIM_LNK_DUP", *_WAY),
        sets=_link(PERCENT="SIM_LNK_DUP"),
    ),
    Fault(
        name="link_reordering",
        form=f"PERCENT % {_ON}",
        about="This share of the frames is overtaken by those after it.",
        parameters=("SIM_LNK_REORD", *_WAY),
        sets=_link(PERCENT="SIM_LNK_REORD"),
    ),
    Fault(
        name="link_corruption",
        form=f"PERCENT % {_ON}",
        about="This share of the frames arrives with a few bits wrong.",
        parameters=("SIM_LNK_CORR", *_WAY),
        sets=_link(PERCENT="SIM_LNK_CORR"),
    ),
    Fault(
        name="radar_off",
        about="The radar falls silent: no answers, no heartbeat.",
        parameters=("SIM_RDR_OFF",),
        sets=_fixed(SIM_RDR_OFF=1.0),
    ),
    Fault(
        name="radar_blind",
        about="The radar answers and sees nothing.",
        parameters=("SIM_RDR_BLIND",),
        sets=_fixed(SIM_RDR_BLIND=1.0),
    ),
    Fault(
        name="radar_drop",
        form="PERCENT %",
        about="This share of the cells in sight is not seen all the same.",
        parameters=("SIM_RDR_MISS",),
        sets=_scaled("SIM_RDR_MISS", "PERCENT"),
    ),
    Fault(
        name="radar_loss",
        form="PERCENT %",
        about="This share of the radar's TERRAIN_DATA is never sent.",
        parameters=("SIM_RDR_LOSS",),
        sets=_scaled("SIM_RDR_LOSS", "PERCENT"),
    ),
    Fault(
        name="radar_noise",
        form="SIGMA m [SIGN]",
        about="Heights have an error of this size (standard deviation of the normal law it is "
        "drawn from), never downwards unless it says either_way.",
        parameters=("SIM_RDR_NOISE",),
        sets=_radar_noise,
    ),
    Fault(
        name="radar_delay",
        form="DELAY ms",
        about="The radar's answers are late by this.",
        parameters=("SIM_RDR_DELAY",),
        sets=_scaled("SIM_RDR_DELAY", "DELAY"),
    ),
    Fault(
        name="radar_rate",
        form="RATE Hz",
        about="The radar answers this many requests a second.",
        parameters=("SIM_RDR_HZ",),
        sets=_scaled("SIM_RDR_HZ", "RATE"),
    ),
    Fault(
        name="setpoints_ignored",
        about="The autopilot takes no setpoint, without a word.",
        parameters=("SIM_SP_IGNORE",),
        sets=_fixed(SIM_SP_IGNORE=1.0),
    ),
    Fault(
        name="estimator_reset",
        form="LENGTH m SIDE [LENGTH2 m SIDE2]",
        about="The estimator starts afresh, and its position jumps by this much.",
        parameters=("SIM_EKF_RST_N", "SIM_EKF_RST_E"),
        sets=_estimator_reset,
        once=True,
    ),
    Fault(
        name="origin_move",
        form="LENGTH m WHERE [LENGTH2 m WHERE2]",
        about="The origin of the estimator's local frame moves by this much.",
        parameters=("SIM_ORG_MOV_N", "SIM_ORG_MOV_E", "SIM_ORG_MOV_U"),
        sets=_origin_move,
        once=True,
    ),
    Fault(
        name="pilot",
        about="The pilot takes the vehicle: the mode changes to the one that pilots hold it in.",
        parameters=("SIM_PILOT",),
        sets=_fixed(SIM_PILOT=1.0),
        once=True,
    ),
    Fault(
        name="reboot",
        about="The autopilot starts again, wherever it is.",
        parameters=("SIM_REBOOT",),
        sets=_fixed(SIM_REBOOT=1.0),
        once=True,
    ),
    Fault(
        name="set",
        form="NAME VALUE",
        about="Any other parameter whose name begins with SIM_.",
        parameters=(),
        sets=_set,
    ),
)
"""In the order of the documentation."""

BY_NAME: Mapping[str, Fault] = {fault.name: fault for fault in FAULTS}
