"""Rows of the flight itself, one for each 10 s: where, how fast, how inclined, aimed at what."""

import bisect
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from harness import Heard

from conformance.rows import NOTHING, Comparison, Row, changes, message_name
from vehicle_sim.geodesy import metres_per_degree

BIN_S = 10
_BESIDE_S = 0.35
"""A sample further from the second than this does not count as one."""
_SILENT_S = 2
_ATTITUDE, _LOCAL, _GLOBAL, _LOCAL_TARGET, _GLOBAL_TARGET, _BATTERY = 30, 32, 33, 85, 87, 147
_UNKNOWN_HEADING = 65535
Span = tuple[float, float]

# --- which part of the flight a second belongs to, as the real autopilot told it; and tolerances --

_GLITCH, _FIX_2D = 0x8000, 2
"""EKF_GPS_GLITCHING of ArduPilot's EKF_STATUS_REPORT; fix_type."""
_RECOVERY_S = 20.0
"""So long after the estimate is good again the vehicle may still be on its way back."""
_LANDING_MODES = {"ardupilot copter": {9, 6}, "ardupilot plane": {11, 20}}
_PX4_LANDING_MODES = {0x06040000, 0x05040000}
_TAKEOFF_S, _SETTLING_S = 5.0, 5.0
_NO_POSITION, FAR_M = 0x07, 10.0


class Tolerances(NamedTuple):
    """How near the simulated vehicle must be to the real one."""

    horizontal_m: float
    vertical_m: float
    speed_m_s: float
    climb_m_s: float
    heading_deg: float
    tilt_deg: float


_NEARNESS = {
    ("copter", "ground"): Tolerances(2.0, 1.5, 0.5, 0.3, 10.0, 2.0),
    ("copter", "take-off"): Tolerances(3.0, 3.0, 1.0, 0.7, 20.0, 6.0),
    ("copter", "flight"): Tolerances(2.0, 1.5, 1.0, 0.7, 15.0, 6.0),
    # far from where it shall be, and flying there: a setpoint that jumped
    ("copter", "chase"): Tolerances(10.0, 2.0, 2.5, 1.0, 25.0, 10.0),
    ("copter", "landing"): Tolerances(3.0, 3.0, 1.0, 0.7, 20.0, 6.0),
    # without satellites or with wrong ones, and until it is back
    ("copter", "blind"): Tolerances(35.0, 6.0, 4.0, 1.5, 45.0, 12.0),
    ("plane", "ground"): Tolerances(15.0, 3.0, 3.0, 0.5, 15.0, 6.0),
    ("plane", "take-off"): Tolerances(25.0, 10.0, 3.0, 2.0, 20.0, 12.0),
    ("plane", "flight"): Tolerances(20.0, 8.0, 2.5, 1.5, 20.0, 12.0),
    ("plane", "landing"): Tolerances(25.0, 10.0, 3.0, 1.5, 30.0, 12.0),
    ("plane", "blind"): Tolerances(25.0, 10.0, 3.0, 1.5, 30.0, 12.0),
}


def phases_of(comparison: Comparison) -> Callable[[float], str]:
    """The phase at any vehicle time of a recorded flight."""
    real, recording = comparison.real, comparison.recording
    landed = changes(real.of(245), lambda m: m.landed_state)
    modes = changes(real.of(0), lambda m: m.custom_mode)
    vehicle = f"{recording.firmware} {recording.kind}"
    landing_modes = _LANDING_MODES.get(vehicle, _PX4_LANDING_MODES)
    blind = list(_blind_times(comparison))
    chases = list(_chase_times(comparison)) if recording.kind == "copter" else []
    airborne_s = next((t for t, state in landed if state in (2, 3)), math.inf)

    def at(time_s: float) -> str:
        state = _value_at(landed, time_s)
        if _is_within(blind, time_s):
            return "blind"
        if state in (None, 0, 1):
            return "ground"
        if _value_at(modes, time_s) in landing_modes:
            return "landing"
        if state == 3 or time_s < airborne_s + _TAKEOFF_S:
            return "take-off"
        return "chase" if _is_within(chases, time_s) else "flight"

    return at


def _is_within(spans: Sequence[Span], time_s: float) -> bool:
    return any(begin_s <= time_s < end_s for begin_s, end_s in spans)


def _value_at(events: Sequence[tuple[float, Any]], time_s: float) -> Any:
    return next((value for at_s, value in reversed(events) if at_s <= time_s), None)


def _blind_times(comparison: Comparison) -> Iterator[Span]:
    """While there was no fix after there had been one, or the estimator called it wrong."""
    fixes = changes(comparison.real.of(24), lambda m: m.fix_type <= _FIX_2D)
    while fixes and fixes[0][1]:
        del fixes[0]
    glitches = changes(comparison.real.of(193), lambda m: bool(m.flags & _GLITCH))
    for events in (fixes, glitches):
        till = [*events, (comparison.recording.end_s, False)]
        for (begin_s, is_bad), (over_s, _) in itertools.pairwise(till):
            if is_bad:
                yield begin_s - 2.0, over_s + _RECOVERY_S


def _chase_times(comparison: Comparison) -> Iterator[Span]:
    """While its target was more than FAR_M away, and for a while afterwards."""
    positions = comparison.real.of(_LOCAL)
    times = [time_s for time_s, _ in positions]
    for time_s, target in comparison.real.of(_LOCAL_TARGET):
        place = bisect.bisect_left(times, time_s)
        if target.type_mask & _NO_POSITION or place >= len(times):
            continue
        here = positions[place][1]
        if math.hypot(target.x - here.x, target.y - here.y) > FAR_M:
            yield time_s, time_s + _SETTLING_S


# --- measures: how far apart in tolerances, and how to show it ------------------------------------

Apart = tuple[float, str]
Measure = Callable[[Any, Any, Tolerances], Apart]
_DATUM_M = 1.5
"""How far apart home and the sea may be believed to be: the height of PX4's home follows each GPS
solution for two minutes after boot (HOME_POSITION of px4-offboard-8mps.tlog)."""
_ECHO = {"vx": 1.0, "vy": 1.0, "vz": 1.0, "afx": 1.5, "afy": 1.5, "afz": 1.5}
_ECHO |= {"yaw": 0.4, "yaw_rate": 0.4}
"""Tolerance of each field of POSITION_TARGET_LOCAL_NED but the place."""


def _apart(difference: float, tolerance: float, unit: str) -> Apart:
    return abs(difference) / tolerance, f"{abs(difference):.2f} {unit} apart"


def _global_height(a: Any, b: Any, near: Tolerances) -> Apart:
    """Above home and above mean sea level: the receiver's error is in both."""
    home_m, sea_m = (a.relative_alt - b.relative_alt) * 1e-3, (a.alt - b.alt) * 1e-3
    allowed_m = near.vertical_m + _DATUM_M
    return max(_apart(home_m, allowed_m, "m above home"), _apart(sea_m, allowed_m, "m AMSL"))


def _speed(a: Any, b: Any, near: Tolerances) -> Apart:
    return _apart((math.hypot(a.vx, a.vy) - math.hypot(b.vx, b.vy)) / 100.0, near.speed_m_s, "m/s")


def _heading(a: Any, b: Any, near: Tolerances) -> Apart:
    if _UNKNOWN_HEADING in (a.hdg, b.hdg):
        return 0.0 if a.hdg == b.hdg else math.inf, "no heading"
    off_deg = math.remainder((a.hdg - b.hdg) / 100.0, 360.0)
    return _apart(off_deg, near.heading_deg, "deg of heading")


def _tilt(a: Any, b: Any, near: Tolerances) -> Apart:
    ours, theirs = (math.degrees(math.acos(math.cos(m.roll) * math.cos(m.pitch))) for m in (a, b))
    return _apart(ours - theirs, near.tilt_deg, "deg of tilt")


def _echo(a: Any, b: Any, near: Tolerances) -> Apart:
    """NaN is equal to NaN only."""
    tolerances = {"x": near.horizontal_m, "y": near.horizontal_m, "z": near.vertical_m, **_ECHO}
    found = list[Apart]()
    for name, tolerance in tolerances.items():
        one, other = getattr(a, name), getattr(b, name)
        if math.isnan(one) or math.isnan(other):
            same = math.isnan(one) and math.isnan(other)
            found.append((0.0 if same else math.inf, f"{name}: {one:.2f} and {other:.2f}"))
        else:
            off = math.remainder(one - other, math.tau) if name == "yaw" else one - other
            found.append(_apart(off, tolerance, f"of {name}"))
    return max(found)


# --- rows -----------------------------------------------------------------------------------------


def track_rows(comparison: Comparison) -> Iterator[Row]:
    north_m, east_m = metres_per_degree(comparison.flight.home.latitude_deg)

    def level(latitude_e7: int, longitude_e7: int, near: Tolerances) -> Apart:
        away_m = math.hypot(latitude_e7 * 1e-7 * north_m, longitude_e7 * 1e-7 * east_m)
        return _apart(away_m, near.horizontal_m, "m")

    looks: dict[str, list[tuple[int, Measure]]] = {
        # of these the worst second but one of each bin counts: a step of one side may come a
        # moment later on the other, which is a matter of times; of the others the middle one
        "track": [
            (_GLOBAL, lambda a, b, near: level(a.lat - b.lat, a.lon - b.lon, near)),
            (
                _LOCAL,
                lambda a, b, near: _apart(math.hypot(a.x - b.x, a.y - b.y), near.horizontal_m, "m"),
            ),
            (_GLOBAL, _global_height),
            (_LOCAL, lambda a, b, near: _apart(a.z - b.z, near.vertical_m, "m of height")),
        ],
        "motion": [
            (_GLOBAL, _speed),
            (
                _GLOBAL,
                lambda a, b, near: _apart((a.vz - b.vz) / 100.0, near.climb_m_s, "m/s of climb"),
            ),
            (_GLOBAL, _heading),
            (_ATTITUDE, _tilt),
        ],
        "target": [
            (_LOCAL_TARGET, _echo),
            (
                _GLOBAL_TARGET,
                lambda a, b, near: max(
                    level(a.lat_int - b.lat_int, a.lon_int - b.lon_int, near),
                    _apart(a.alt - b.alt, near.vertical_m, "m of height"),
                ),
            ),
        ],
    }
    phase_at = phases_of(comparison)
    for kind, measures in looks.items():
        yield from _binned(comparison, phase_at, kind, measures)


def _binned(
    comparison: Comparison,
    phase_at: Callable[[float], str],
    kind: str,
    looks: Sequence[tuple[int, Measure]],
) -> Iterator[Row]:
    recording = comparison.recording
    said = {n: [_beside(side.heard(n)) for side in comparison.sides] for n, _ in looks}
    first, last = (math.floor(recording.begin_s / BIN_S), math.ceil(recording.end_s / BIN_S))
    for begin_s in range(first * BIN_S, last * BIN_S, BIN_S):
        if comparison.is_left_out(begin_s) or comparison.is_left_out(begin_s + BIN_S):
            continue
        seconds = range(begin_s, begin_s + BIN_S)
        nearness = [_NEARNESS[recording.kind, phase_at(second)] for second in seconds]
        found = list[tuple[Apart, str]]()
        for number, measure in looks:
            real, simulated = ([at(second) for second in seconds] for at in said[number])
            pairs = [
                (a, b, near)
                for a, b, near in zip(real, simulated, nearness, strict=True)
                if a is not None and b is not None
            ]
            apart = sorted(measure(*pair) for pair in pairs)
            alone, without = (BIN_S - side.count(None) - len(apart) for side in (real, simulated))
            if max(alone, without) > _SILENT_S:
                silent = f"silent for {alone} s" if alone > without else "the real one is silent"
                found.append(((math.inf, silent), message_name(number)))
            elif apart:
                worst = apart[-2:][0] if kind == "track" else apart[len(apart) // 2]
                found.append((worst, message_name(number)))
        if found:
            (difference, shown), message = max(found, key=lambda each: each[0])
            name = f"{begin_s} s to {begin_s + BIN_S} s"
            yield Row(kind, name, (message, shown), difference, begin_s)


def _beside(said: Sequence[Heard]) -> Callable[[float], Any]:
    """The message nearest to a time; None if there is none beside it."""
    times = [one.at_s for one in said]

    def at(time_s: float) -> Any:
        place = bisect.bisect_left(times, time_s)
        near = said[max(place - 1, 0) : place + 1]
        best = min(near, key=lambda one: abs(one.at_s - time_s), default=None)
        return best.message if best and abs(best.at_s - time_s) <= _BESIDE_S else None

    return at


# --- battery --------------------------------------------------------------------------------------

_CHARGE = (0.5, 8.0, 10.0)
"""Tolerances of volts, per cent, amperes."""


def battery_rows(comparison: Comparison) -> Iterator[Row]:
    """Voltage and charge near the beginning, in the middle and before the end of the flight."""
    begin_s, end_s = comparison.recording.begin_s, comparison.recording.end_s
    for name, part in (("begin", 0.1), ("middle", 0.5), ("end", 0.9)):
        at_s = begin_s + part * (end_s - begin_s)
        real, simulated = (
            min(side.of(_BATTERY), key=lambda each: abs(each[0] - at_s), default=None)
            for side in comparison.sides
        )
        if real:
            told = [each and _charge(each[1]) for each in (real, simulated)]
            apart = math.inf
            if simulated:
                pairs = zip(_charge(real[1]), _charge(simulated[1]), _CHARGE, strict=True)
                apart = max(abs(a - b) / allowed for a, b, allowed in pairs)
            shown = [f"{e[0]:.2f} V, {e[1]} %, {e[2]:.1f} A" if e else NOTHING for e in told]
            yield Row("battery", name, shown, apart, at_s)


def _charge(message: Any) -> tuple[float, float, float]:
    volts, amperes = message.voltages[0] / 1e3, message.current_battery / 1e2
    return volts, message.battery_remaining, amperes
