"""Rows of the flight itself, one for each 10 s: where, how fast, how inclined, aimed at what."""

import bisect
import cmath
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from harness import Heard

from conformance.rows import NOTHING, Comparison, Row, apart, changes, message_name
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
    landed = changes(real.of(245), attrgetter("landed_state"))
    modes = changes(real.of(0), attrgetter("custom_mode"))
    vehicle = f"{recording.firmware} {recording.kind}"
    landing_modes = _LANDING_MODES.get(vehicle, _PX4_LANDING_MODES)
    blind = list(_blind_times(comparison))
    chases = list(_chase_times(comparison)) if recording.kind == "copter" else []
    airborne_s = next((t for t, state in landed if state in (2, 3)), math.inf)

    def at(time_s: float) -> str:
        def is_within(spans: Sequence[Span]) -> bool:
            return any(begin_s <= time_s < end_s for begin_s, end_s in spans)

        state, mode = (
            next((value for at_s, value in reversed(events) if at_s <= time_s), None)
            for events in (landed, modes)
        )
        if is_within(blind):
            return "blind"
        if state in (None, 0, 1):
            return "ground"
        if mode in landing_modes:
            return "landing"
        if state == 3 or time_s < airborne_s + _TAKEOFF_S:
            return "take-off"
        return "chase" if is_within(chases) else "flight"

    return at


def _blind_times(comparison: Comparison) -> Iterator[Span]:
    """While there was no fix after there had been one, or the estimator called it wrong."""
    fixes = changes(comparison.real.of(24), lambda m: m.fix_type <= _FIX_2D)
    fixes = [*itertools.dropwhile(lambda each: each[1], fixes)]
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
        if math.dist((target.x, target.y), (here.x, here.y)) > FAR_M:
            yield time_s, time_s + _SETTLING_S


# --- measures: what is compared of a message ------------------------------------------------------

_DATUM_M = 1.5
"""How far apart home and the sea may be believed to be: the height of PX4's home follows each GPS
solution for two minutes after boot (HOME_POSITION of px4-offboard-8mps.tlog)."""


class Measure(NamedTuple):
    """A number of a message, or north + east j; NaN is like NaN only."""

    of: Callable[[Any], complex]
    near: str | float
    """Its tolerance, or the name of one."""
    unit: str
    more: float = 0.0
    """Added to the tolerance."""
    round: float = math.inf
    """An angle's full circle."""

    def apart(self, one: Any, other: Any, near: Tolerances) -> tuple[float, str]:
        """How far in tolerances, and in words."""
        tolerance = getattr(near, self.near) if isinstance(self.near, str) else self.near
        a, b = self.of(one), self.of(other)
        if cmath.isnan(a) or cmath.isnan(b):
            return 0.0 if a != a and b != b else math.inf, f"{a:.2f} and {b:.2f} {self.unit}"
        off = a - b
        off = abs(off if isinstance(off, complex) else math.remainder(off, self.round))
        return off / (tolerance + self.more), f"{off:.2f} {self.unit} apart"


def _tilt_deg(message: Any) -> float:
    return math.degrees(math.acos(math.cos(message.roll) * math.cos(message.pitch)))


def _heading_deg(message: Any) -> float:
    return math.nan if message.hdg == _UNKNOWN_HEADING else message.hdg / 100.0


def _measures(comparison: Comparison) -> dict[str, list[tuple[int, list[Measure]]]]:
    """By kind of row the messages that are looked at, and of these the worst measure each."""
    north_m, east_m = metres_per_degree(comparison.flight.home[0])

    def level(latitude: str, longitude: str) -> Measure:
        """In metres: the angles are told in 1e-7 degrees."""
        place = attrgetter(latitude, longitude)
        scale = np.array((north_m, east_m)) * 1e-7
        return Measure(lambda m: complex(*place(m) * scale), "horizontal_m", "m")

    height = Measure(attrgetter("z"), "vertical_m", "m of height")
    echoed = {"vx": 1.0, "vy": 1.0, "vz": 1.0, "afx": 1.5, "afy": 1.5, "afz": 1.5, "yaw_rate": 0.4}
    echo = [Measure(attrgetter(name), near, f"of {name}") for name, near in echoed.items()]
    echo += [Measure(attrgetter(name), "horizontal_m", f"of {name}") for name in "xy"]
    echo += [height, Measure(attrgetter("yaw"), 0.4, "of yaw", round=math.tau)]
    above = [  # the receiver's error is in both
        Measure(lambda m: m.relative_alt * 1e-3, "vertical_m", "m above home", _DATUM_M),
        Measure(lambda m: m.alt * 1e-3, "vertical_m", "m AMSL", _DATUM_M),
    ]
    target = [level("lat_int", "lon_int"), Measure(attrgetter("alt"), "vertical_m", "m of height")]
    return {
        "track": [
            (_GLOBAL, [level("lat", "lon")]),
            (_LOCAL, [Measure(lambda m: complex(m.x, m.y), "horizontal_m", "m")]),
            *((_GLOBAL, above), (_LOCAL, [height])),
        ],
        "motion": [
            (_GLOBAL, [Measure(lambda m: math.hypot(m.vx, m.vy) / 100.0, "speed_m_s", "m/s")]),
            (_GLOBAL, [Measure(lambda m: m.vz / 100.0, "climb_m_s", "m/s of climb")]),
            (_GLOBAL, [Measure(_heading_deg, "heading_deg", "deg of heading", round=360.0)]),
            (_ATTITUDE, [Measure(_tilt_deg, "tilt_deg", "deg of tilt")]),
        ],
        "target": [(_LOCAL_TARGET, echo), (_GLOBAL_TARGET, target)],
    }


# --- rows -----------------------------------------------------------------------------------------


def track_rows(comparison: Comparison) -> Iterator[Row]:
    """A row for each kind and 10 s: of what is looked at what is farthest apart."""
    recording, phase_at = comparison.recording, phases_of(comparison)
    first, last = (math.floor(recording.begin_s / BIN_S), math.ceil(recording.end_s / BIN_S))
    for kind, looks in _measures(comparison).items():
        said = {n: [_beside(side.heard(n)) for side in comparison.sides] for n, _ in looks}
        for begin_s in range(first * BIN_S, last * BIN_S, BIN_S):
            if comparison.is_left_out(begin_s) or comparison.is_left_out(begin_s + BIN_S):
                continue
            seconds = range(begin_s, begin_s + BIN_S)
            nearness = [_NEARNESS[recording.kind, phase_at(second)] for second in seconds]
            found = list[tuple[float, str, str]]()
            for number, measures in looks:
                sides = ([at(second) for second in seconds] for at in said[number])
                apart = _apart(kind, measures, nearness, *sides)
                found += [(*each, message_name(number)) for each in apart]
            if found:
                difference, shown, message = max(found, key=lambda each: each[0])
                name = f"{begin_s} s to {begin_s + BIN_S} s"
                yield Row(kind, name, (message, shown), difference, begin_s)


def _apart(
    kind: str, measures: Sequence[Measure], nearness: Sequence[Tolerances], *sides: Sequence[Any]
) -> Iterator[tuple[float, str]]:
    """Of these seconds the middle one; of the track the worst but one: a step of one side may come
    a moment later on the other, which is a matter of times.
    """
    pairs = [pair for pair in zip(*sides, nearness, strict=True) if None not in pair]
    alone, without = (len(side) - side.count(None) - len(pairs) for side in sides)
    apart = sorted(max(measure.apart(*pair) for measure in measures) for pair in pairs)
    if max(alone, without) > _SILENT_S:
        yield math.inf, f"silent for {alone} s" if alone > without else "the real one is silent"
    elif apart:
        yield apart[-2:][0] if kind == "track" else apart[len(apart) // 2]


def _beside(said: Sequence[Heard], within_s: float = _BESIDE_S) -> Callable[[float], Any]:
    """The message nearest to a time; None if there is none beside it."""
    times = [one.at_s for one in said]

    def at(time_s: float) -> Any:
        place = bisect.bisect_left(times, time_s)
        near = said[max(place - 1, 0) : place + 1]
        best = min(near, key=lambda one: abs(one.at_s - time_s), default=None)
        return best.message if best and abs(best.at_s - time_s) <= within_s else None

    return at


# --- battery --------------------------------------------------------------------------------------

_CHARGE = (0.5, 8.0, 10.0)
"""Tolerances of volts, per cent, amperes."""


def battery_rows(comparison: Comparison) -> Iterator[Row]:
    """Voltage and charge near the beginning, in the middle and before the end of the flight."""
    begin_s, end_s = comparison.recording.begin_s, comparison.recording.end_s
    nearest = [_beside(side.heard(_BATTERY), within_s=math.inf) for side in comparison.sides]
    for name, part in (("begin", 0.1), ("middle", 0.5), ("end", 0.9)):
        at_s = begin_s + part * (end_s - begin_s)
        told = [
            m and (m.voltages[0] / 1e3, m.battery_remaining, m.current_battery / 1e2)
            for m in (at(at_s) for at in nearest)
        ]
        if told[0] is not None:
            shown = ["{:.2f} V, {} %, {:.1f} A".format(*each) if each else NOTHING for each in told]
            yield Row("battery", name, shown, apart(told[0], told[1], _CHARGE), at_s)
