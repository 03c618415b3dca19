"""Lengths, numbers, times and the entries of a journal in words, for people."""

import math
from collections.abc import Callable
from typing import Final

from companion.mission import events
from companion.mission import journal as noted
from companion.mission.journal import Entry
from companion.mission.state import Phase

_KM_FROM_M: Final = 10_000.0
_BAD_PHASES: Final = [phase.value for phase in (Phase.HOLDING, Phase.FAULTED, Phase.HANDING_OVER)]
_WORDS: Final[dict[type[Entry], str]] = {
    noted.LegBegun: "begins subpath {0.number}",
    noted.PathLeft: "beside its path, {0.left_path_m:.2g} m more than its tracking error",
    noted.StopsOnPath: "stops on its path: {0.reason}",
    noted.Resumed: "the companion was started again",
    events.StopAsked: "a person asked for the end",
    events.End: "{0.outcome.value}: {0.reason}",
    noted.ScanDone: "scan: {0.blocks_answered} of {0.blocks_asked} blocks answered",
    noted.PlanReady: "plan {0.plan_id}: {0.length_m:,.0f} m, {0.evaluations:,} candidates",
    noted.PlanRefused: "plan {0.plan_id} refused: {0.reason}",
    events.PlanLate: "plan {0.plan_id} was not ready in time",
    noted.CommandHeard: "{0.sender} sends command {0.command}",
    noted.OrderGiven: "order of {0.sender}: {0.order}",
    noted.VehicleFound: "found {0.name}, system {0.system_id}",
    noted.VehicleSays: "vehicle: {0.text}",
    events.Rebooted: "the autopilot has rebooted",
    events.LinkLost: "link lost: nothing was heard for {0.silent_s:g} s",
    noted.AnotherCompanion: "another companion uses the same ids",
    events.SetMode: "asks for the mode {0.mode.value}",
    events.Arm: "arms the vehicle",
    events.Disarm: "disarms the vehicle",
    events.TakeOff: "takes off, to {0.above_home_m:.0f} m above home",
    noted.SetpointRefused: "a setpoint out of range was not sent: {0.setpoint}",
    events.StatusText: "companion: {0.text}",
    events.PlannerDied: "a part of the companion has died: {0.error}",
}
"""Of those that people would miss; fence, targets and preparations are said, too."""
_BAD: Final = (
    *(noted.Resumed, events.StopAsked, noted.PlanRefused, events.PlanLate, events.Rebooted),
    *(events.LinkLost, noted.AnotherCompanion, noted.SetpointRefused),
    events.PlannerDied,
)


def entry_words(entry: Entry) -> tuple[str, bool] | None:
    """What an entry says, and whether it is bad; None: nothing that people would miss."""
    after = ""
    match entry:
        case noted.Phase(phase=phase, reason=reason):
            return f"{phase}: {reason}" if reason else phase, phase in _BAD_PHASES
        case events.Prepared(item=item, refusal=refusal) if refusal:
            return f"{item.value}: {refusal}", True
        case noted.PlanRefused(out_of_time=True, evaluations=count):
            is_bad, after = True, f"; time was up after {count:,} candidates"
        case events.StatusText(warning=is_bad):
            pass
        case events.End(outcome=outcome):
            is_bad = outcome.value != "arrived"
        case _:
            is_bad = isinstance(entry, _BAD)
    words = _WORDS.get(type(entry))
    return None if words is None else (words.format(entry) + after, is_bad)


# --- numbers


def counted(count: int, thing: str) -> str:
    """How many there are, of one or of several."""
    return f"{count:,} {thing}" if count == 1 else f"{count:,} {thing}s"


def number(value: float | None, digits: int = 0) -> str:
    """A number, or a dash if it is not known or unbounded."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{round(value, digits) + 0.0:,.{digits}f}"


def at_least(value: float, digits: int = 0) -> str:
    """Likewise, rounded down: a clearance must not look larger than it is."""
    return number(_rounded_down(value, digits), digits)


def at_most(value: float, digits: int = 0) -> str:
    """Likewise, rounded up: a risk must not look smaller than it is."""
    return number(-_rounded_down(-value, digits), digits)


def _rounded_down(value: float, digits: int) -> float:
    scale = 10.0**digits
    return math.floor(value * scale + 1e-6) / scale if math.isfinite(value) else value


def metres(length_m: float) -> str:
    """A length as people read it."""
    return _length(length_m, number)


def metres_at_least(length_m: float) -> str:
    """As `metres`, rounded down."""
    return _length(length_m, at_least)


def _length(length_m: float, rounded: Callable[[float, int], str]) -> str:
    if not math.isfinite(length_m):
        return "-"
    size_m = abs(length_m)
    if size_m >= _KM_FROM_M:
        return f"{rounded(length_m / 1000.0, 1)} km"
    return f"{rounded(length_m, 0 if size_m >= 50.0 else 1 if size_m >= 5.0 else 2)} m"


def clock_text(time_s: float) -> str:
    """Minutes and seconds, or hours and minutes too."""
    minutes, seconds = divmod(int(time_s), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
