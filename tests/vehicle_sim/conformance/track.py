"""Rows of the flight itself, one for each 10 s: where, how fast, how inclined, aimed at what."""

import bisect
import enum
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, final

from conformance.log import TimedFrame, decoded, message_name
from conformance.rows import NOTHING, Comparison, Row, changes, row
from vehicle_sim.geodesy import metres_per_degree

# --- Which part of the flight a second belongs to, as the real autopilot told it; and tolerances

_GLITCH = 0x8000
"""EKF_GPS_GLITCHING of ArduPilot's EKF_STATUS_REPORT."""
_FIX_2D = 2
_RECOVERY_S = 20.0
"""So long after the estimate is good again the vehicle may still be on its way back."""
_LANDING_MODES = {
    "ardupilot copter": {9, 6},
    "ardupilot plane": {11, 20},
    "px4 copter": {0x06040000, 0x05040000},
    "px4 plane": {0x06040000, 0x05040000},
}
_TAKEOFF_S = 5.0
_NO_POSITION = 0x07
FAR_M = 10.0
_SETTLING_S = 5.0


class Phase(enum.Enum):
    """What it is doing."""

    GROUND = "ground"
    TAKEOFF = "take-off"
    FLIGHT = "flight"
    CHASE = "chase"
    """Far from where it shall be, and flying there: a setpoint that jumped."""
    LANDING = "landing"
    BLIND = "blind"
    """Without satellites or with wrong ones, and until it is back."""


class Tolerances(NamedTuple):
    """How near the simulated vehicle must be to the real one."""

    horizontal_m: float
    vertical_m: float
    speed_m_s: float
    climb_m_s: float
    heading_deg: float
    tilt_deg: float


_NEARNESS = {
    "copter": {
        Phase.GROUND: Tolerances(2.0, 1.5, 0.5, 0.3, 10.0, 2.0),
        Phase.TAKEOFF: Tolerances(3.0, 3.0, 1.0, 0.7, 20.0, 6.0),
        Phase.FLIGHT: Tolerances(2.0, 1.5, 1.0, 0.7, 15.0, 6.0),
        Phase.CHASE: Tolerances(10.0, 2.0, 2.5, 1.0, 25.0, 10.0),
        Phase.LANDING: Tolerances(3.0, 3.0, 1.0, 0.7, 20.0, 6.0),
        Phase.BLIND: Tolerances(35.0, 6.0, 4.0, 1.5, 45.0, 12.0),
    },
    "plane": {
        Phase.GROUND: Tolerances(15.0, 3.0, 3.0, 0.5, 15.0, 6.0),
        Phase.TAKEOFF: Tolerances(25.0, 10.0, 3.0, 2.0, 20.0, 12.0),
        Phase.FLIGHT: Tolerances(20.0, 8.0, 2.5, 1.5, 20.0, 12.0),
        **dict.fromkeys(
            (Phase.CHASE, Phase.LANDING, Phase.BLIND), Tolerances(25.0, 10.0, 3.0, 1.5, 30.0, 12.0)
        ),
    },
}


def tolerances_for(kind: str, phase: Phase) -> Tolerances:
    """The tolerance for a vehicle in a phase."""
    return _NEARNESS[kind][phase]


@final
class Phases:
    """The phase at any vehicle time of a recorded flight."""

    def __init__(self, comparison: Comparison) -> None:
        real, recording = comparison.real, comparison.recording
        self._landed = changes(real.of(245), lambda m: m.landed_state)
        self._mode = changes(real.of(0), lambda m: m.custom_mode)
        self._landing_modes = _LANDING_MODES[f"{recording.firmware} {recording.kind}"]
        self._blind = _blind_times(comparison)
        self._chases = _chase_times(comparison) if recording.kind == "copter" else []
        airborne = [t for t, state in self._landed if state in (2, 3)]
        self._airborne_s = airborne[0] if airborne else float("inf")

    def at(self, time_s: float) -> Phase:
        """What the real vehicle was doing then."""
        if _is_within(self._blind, time_s):
            return Phase.BLIND
        landed = _value_at(self._landed, time_s)
        if landed in (None, 0, 1):
            return Phase.GROUND
        if _value_at(self._mode, time_s) in self._landing_modes:
            return Phase.LANDING
        if landed == 3 or time_s < self._airborne_s + _TAKEOFF_S:
            return Phase.TAKEOFF
        return Phase.CHASE if _is_within(self._chases, time_s) else Phase.FLIGHT


def _is_within(spans: Sequence[tuple[float, float]], time_s: float) -> bool:
    return any(begin <= time_s < end for begin, end in spans)


def _value_at(events: Sequence[tuple[float, Any]], time_s: float) -> Any:
    place = bisect.bisect_right([t for t, _ in events], time_s) - 1
    return None if place < 0 else events[place][1]


def _blind_times(comparison: Comparison) -> list[tuple[float, float]]:
    """While there was no fix after there had been one, or the estimator called it wrong."""
    real = comparison.real
    fixes = changes(real.of(24), lambda m: m.fix_type > _FIX_2D)
    first = next((i for i, (_, good) in enumerate(fixes) if good), len(fixes))
    bad = [(t, not good) for t, good in fixes[first:]]
    glitches = changes(real.of(193), lambda m: bool(m.flags & _GLITCH))
    end_s = comparison.recording.end_s
    spans = list[tuple[float, float]]()
    for events in (bad, glitches):
        for place, (begin_s, is_bad) in enumerate(events):
            if is_bad:
                over_s = events[place + 1][0] if place + 1 < len(events) else end_s
                spans.append((begin_s - 2.0, over_s + _RECOVERY_S))
    return spans


def _chase_times(comparison: Comparison) -> list[tuple[float, float]]:
    """While its target was more than FAR_M away, and for a while afterwards."""
    positions = comparison.real.of(_LOCAL)
    times = [t for t, _ in positions]
    spans = list[tuple[float, float]]()
    for time_s, target in comparison.real.of(_LOCAL_TARGET):
        place = bisect.bisect_left(times, time_s)
        if target.type_mask & _NO_POSITION or place >= len(times) or target.x != target.x:
            continue
        here = positions[place][1]
        if math.hypot(target.x - here.x, target.y - here.y) > FAR_M:
            if spans and time_s <= spans[-1][1]:
                spans[-1] = (spans[-1][0], time_s + _SETTLING_S)
            else:
                spans.append((time_s, time_s + _SETTLING_S))
    return spans


BIN_S = 10.0
_STEP_S = 1.0
_BESIDE_S = 0.35
"""A sample further from the second than this does not count as one."""
_ATTITUDE, _LOCAL, _GLOBAL, _LOCAL_TARGET, _GLOBAL_TARGET, _BATTERY = 30, 32, 33, 85, 87, 147
_UNKNOWN_HEADING = 65535
_SILENT_S = 2
_DATUM_M = 1.5
"""How far apart home and the sea may be believed to be: the height of PX4's home follows each GPS
solution for two minutes after boot (HOME_POSITION of px4-offboard-8mps.tlog)."""
_VOLTS, _PER_CENT, _AMPERES = 0.5, 8.0, 10.0
_ECHO = {  # tolerance of each field of POSITION_TARGET_LOCAL_NED
    **dict.fromkeys(("vx", "vy", "vz"), 1.0),
    **dict.fromkeys(("afx", "afy", "afz"), 1.5),
    **dict.fromkeys(("yaw", "yaw_rate"), 0.4),
}


class _Apart(NamedTuple):
    """A difference between two messages of the same time."""

    difference: float
    """In tolerances."""
    shown: str


Measure = Callable[[Any, Any, Tolerances], _Apart]


class _Look(NamedTuple):
    """One comparison at each second."""

    message: int
    measure: Measure
    is_worst: bool
    """The worst second but one of the bin counts, or else the middle one."""


def track_rows(comparison: Comparison) -> Iterator[Row]:
    """All rows of the flight itself."""
    phases = Phases(comparison)
    earth = metres_per_degree(comparison.flight.home.latitude_deg)

    def away_m(lat_1: int, lon_1: int, lat_2: int, lon_2: int) -> float:
        return math.hypot((lat_1 - lat_2) * 1e-7 * earth[0], (lon_1 - lon_2) * 1e-7 * earth[1])

    def horizontally(a: Any, b: Any, near: Tolerances) -> _Apart:
        return _apart(away_m(a.lat, a.lon, b.lat, b.lon), near.horizontal_m, "m")

    def aimed(a: Any, b: Any, near: Tolerances) -> _Apart:
        apart_m = away_m(a.lat_int, a.lon_int, b.lat_int, b.lon_int)
        return max(
            _apart(apart_m, near.horizontal_m, "m"),
            _apart(a.alt - b.alt, near.vertical_m, "m of height"),
        )

    kinds = {
        "track": (
            _Look(_GLOBAL, horizontally, True),
            _Look(_LOCAL, _local_track, True),
            _Look(_GLOBAL, _global_height, True),
            _Look(_LOCAL, _local_height, True),
        ),
        "motion": (
            _Look(_GLOBAL, _speed, False),
            _Look(_GLOBAL, _climb, False),
            _Look(_GLOBAL, _heading, False),
            _Look(_ATTITUDE, _tilt, False),
        ),
        "target": (_Look(_LOCAL_TARGET, _echo, False), _Look(_GLOBAL_TARGET, aimed, False)),
    }
    for kind, looks in kinds.items():
        yield from _binned(comparison, phases, kind, looks)


def _binned(
    comparison: Comparison, phases: Phases, kind: str, looks: Sequence[_Look]
) -> Iterator[Row]:
    recording = comparison.recording
    sides = (comparison.real, comparison.simulated)
    samplers = {
        look.message: [_Sampler(side.heard(look.message)) for side in sides] for look in looks
    }
    first = math.floor(recording.begin_s / BIN_S)
    for number in range(first, math.ceil(recording.end_s / BIN_S)):
        at_s = number * BIN_S
        if comparison.is_left_out(at_s) or comparison.is_left_out(at_s + BIN_S):
            continue
        seconds = [at_s + k * _STEP_S for k in range(int(BIN_S / _STEP_S))]
        found = [(k, _bin(samplers[k.message], k, seconds, phases, recording.kind)) for k in looks]
        there = [(k, x) for k, x in found if x is not None]
        if there:
            yield _bin_row(kind, at_s, there, _tolerance(kind, recording.kind, phases, seconds))


def _bin(
    samplers: "Sequence[_Sampler]", look: _Look, seconds: Sequence[float], phases: Phases, kind: str
) -> _Apart | None:
    """The difference in this bin; None if neither side says anything."""
    apart, only_real, only_simulated = list[_Apart](), 0, 0
    for second in seconds:
        real, simulated = (s.at(second) for s in samplers)
        if real is not None and simulated is not None:
            apart.append(look.measure(real, simulated, tolerances_for(kind, phases.at(second))))
        else:
            only_real += real is not None
            only_simulated += simulated is not None
    if max(only_real, only_simulated) > _SILENT_S:
        return _Apart(
            math.inf,
            f"silent for {only_real} s" if only_real > only_simulated else "the real one is silent",
        )
    if not apart:
        return None
    apart.sort()
    if look.is_worst:
        # A step of one side may come a moment later on the other: that is a matter of times.
        return apart[-2] if len(apart) > 1 else apart[-1]
    return apart[len(apart) // 2]


def _bin_row(kind: str, at_s: float, found: Sequence[tuple[_Look, _Apart]], tolerance: str) -> Row:
    look, apart = max(found, key=lambda x: x[1])
    what = "worst second but one" if look.is_worst else "middle of the seconds"
    shown = (f"{message_name(look.message)}, {what}", apart.shown)
    name = f"{at_s:.0f} s to {at_s + BIN_S:.0f} s"
    return row(kind, name, shown, tolerance, apart.difference, at_s)


def _tolerance(kind: str, vehicle: str, phases: Phases, seconds: Sequence[float]) -> str:
    parts = []
    for phase in sorted({phases.at(s) for s in seconds}, key=lambda p: p.value):
        near = tolerances_for(vehicle, phase)
        limits = {
            "track": f"{near.horizontal_m:g} m, height {near.vertical_m:g} m",
            "motion": f"{near.speed_m_s:g} m/s, climb {near.climb_m_s:g} m/s, "
            f"heading {near.heading_deg:g} deg, tilt {near.tilt_deg:g} deg",
            "target": f"{near.horizontal_m:g} m, 1 m/s, 1.5 m/s2, 0.4 rad",
        }
        parts.append(f"{phase.value}: {limits[kind]}")
    return "; ".join(parts)


@final
class _Sampler:
    """The message nearest to a time."""

    def __init__(self, heard: Sequence[TimedFrame]) -> None:
        self._heard = heard
        self._times = [h.time_s for h in heard]

    def at(self, time_s: float) -> Any | None:
        """None if there is none beside it."""
        place = bisect.bisect_left(self._times, time_s)
        near = [i for i in (place - 1, place) if 0 <= i < len(self._times)]
        best = min(near, key=lambda i: abs(self._times[i] - time_s), default=None)
        if best is None or abs(self._times[best] - time_s) > _BESIDE_S:
            return None
        return decoded(self._heard[best])


# --- measures -------------------------------------------------------------------------------------


def _apart(difference: float, tolerance: float, unit: str) -> _Apart:
    return _Apart(abs(difference) / tolerance, f"{abs(difference):.2f} {unit} apart")


def _local_track(a: Any, b: Any, near: Tolerances) -> _Apart:
    return _apart(math.hypot(a.x - b.x, a.y - b.y), near.horizontal_m, "m")


def _global_height(a: Any, b: Any, near: Tolerances) -> _Apart:
    """Above home and above mean sea level: the receiver's error is in both."""
    return max(
        _apart(
            (a.relative_alt - b.relative_alt) * 1e-3, near.vertical_m + _DATUM_M, "m above home"
        ),
        _apart((a.alt - b.alt) * 1e-3, near.vertical_m + _DATUM_M, "m AMSL"),
    )


def _local_height(a: Any, b: Any, near: Tolerances) -> _Apart:
    return _apart(a.z - b.z, near.vertical_m, "m of height")


def _speed(a: Any, b: Any, near: Tolerances) -> _Apart:
    ours, theirs = (math.hypot(m.vx, m.vy) / 100.0 for m in (a, b))
    return _apart(ours - theirs, near.speed_m_s, "m/s")


def _climb(a: Any, b: Any, near: Tolerances) -> _Apart:
    return _apart((a.vz - b.vz) / 100.0, near.climb_m_s, "m/s of climb")


def _heading(a: Any, b: Any, near: Tolerances) -> _Apart:
    if _UNKNOWN_HEADING in (a.hdg, b.hdg):
        same = a.hdg == b.hdg
        return _Apart(0.0 if same else math.inf, "no heading")
    apart_deg = math.remainder((a.hdg - b.hdg) / 100.0, 360.0)
    return _apart(apart_deg, near.heading_deg, "deg of heading")


def _tilt(a: Any, b: Any, near: Tolerances) -> _Apart:
    ours, theirs = (math.degrees(math.acos(math.cos(m.roll) * math.cos(m.pitch))) for m in (a, b))
    return _apart(ours - theirs, near.tilt_deg, "deg of tilt")


def _echo(a: Any, b: Any, near: Tolerances) -> _Apart:
    places = {"x": near.horizontal_m, "y": near.horizontal_m, "z": near.vertical_m}
    return max(
        _field(name, getattr(a, name), getattr(b, name), tolerance)
        for name, tolerance in {**places, **_ECHO}.items()
    )


def _field(name: str, one: float, other: float, tolerance: float) -> _Apart:
    """NaN is equal to NaN only."""
    if math.isnan(one) or math.isnan(other):
        same = math.isnan(one) and math.isnan(other)
        return _Apart(0.0 if same else math.inf, f"{name}: {one:.2f} and {other:.2f}")
    difference = math.remainder(one - other, math.tau) if name == "yaw" else one - other
    return _apart(difference, tolerance, f"of {name}")


# --- battery --------------------------------------------------------------------------------------


def battery_rows(comparison: Comparison) -> Iterator[Row]:
    """Voltage and charge near the beginning, in the middle and before the end of the flight."""
    recording = comparison.recording
    sides = [s.of(_BATTERY) for s in (comparison.real, comparison.simulated)]
    length_s = recording.end_s - recording.begin_s
    for name, part in (("begin", 0.1), ("middle", 0.5), ("end", 0.9)):
        at_s = recording.begin_s + part * length_s
        real, simulated = (_nearest(side, at_s) for side in sides)
        if real is not None:
            yield _battery_row(name, at_s, real, simulated)


def _battery_row(name: str, at_s: float, real: Any, simulated: Any | None) -> Row:
    difference = math.inf
    if simulated is not None:
        volts = abs(real.voltages[0] - simulated.voltages[0]) / 1000.0
        percent = abs(real.battery_remaining - simulated.battery_remaining)
        amperes = abs(real.current_battery - simulated.current_battery) / 100.0
        difference = max(volts / _VOLTS, percent / _PER_CENT, amperes / _AMPERES)
    shown = [NOTHING if side is None else _charge(side) for side in (real, simulated)]
    tolerance = f"{_VOLTS} V, {_PER_CENT:g} %, {_AMPERES:g} A"
    return row("battery", name, shown, tolerance, difference, at_s)


def _nearest(messages: Sequence[tuple[float, Any]], at_s: float) -> Any | None:
    return min(messages, key=lambda x: abs(x[0] - at_s))[1] if messages else None


def _charge(m: Any) -> str:
    return f"{m.voltages[0] / 1000:.2f} V, {m.battery_remaining} %, {m.current_battery / 100:.1f} A"
