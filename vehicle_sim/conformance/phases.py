"""Which part of the flight a second belongs to, as the real autopilot told it; and tolerances."""

import bisect
import enum
import math
from collections.abc import Sequence
from typing import Any, NamedTuple, final

from vehicle_sim.conformance.rows import Comparison, changes

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
_LOCAL, _TARGET, _NO_POSITION = 32, 85, 0x07
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


class Nearness(NamedTuple):
    """How near the simulated vehicle must be to the real one."""

    horizontal_m: float
    vertical_m: float
    speed_m_s: float
    climb_m_s: float
    heading_deg: float
    tilt_deg: float


_NEARNESS = {
    "copter": {
        Phase.GROUND: Nearness(2.0, 1.5, 0.5, 0.3, 10.0, 2.0),
        Phase.TAKEOFF: Nearness(3.0, 3.0, 1.0, 0.7, 20.0, 6.0),
        Phase.FLIGHT: Nearness(2.0, 1.5, 1.0, 0.7, 15.0, 6.0),
        Phase.CHASE: Nearness(10.0, 2.0, 2.5, 1.0, 25.0, 10.0),
        Phase.LANDING: Nearness(3.0, 3.0, 1.0, 0.7, 20.0, 6.0),
        Phase.BLIND: Nearness(35.0, 6.0, 4.0, 1.5, 45.0, 12.0),
    },
    "plane": {
        Phase.GROUND: Nearness(15.0, 3.0, 3.0, 0.5, 15.0, 6.0),
        Phase.TAKEOFF: Nearness(25.0, 10.0, 3.0, 2.0, 20.0, 12.0),
        Phase.FLIGHT: Nearness(20.0, 8.0, 2.5, 1.5, 20.0, 12.0),
        **dict.fromkeys(
            (Phase.CHASE, Phase.LANDING, Phase.BLIND), Nearness(25.0, 10.0, 3.0, 1.5, 30.0, 12.0)
        ),
    },
}


def nearness(kind: str, phase: Phase) -> Nearness:
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
    for time_s, target in comparison.real.of(_TARGET):
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
