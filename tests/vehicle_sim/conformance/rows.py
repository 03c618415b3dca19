"""What a row of the comparison is, and how events of two flights are paired."""

import bisect
import itertools
import math
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar, final

from conformance.flights import Flight, Reason
from conformance.log import Recording, Side, decoded

Key = TypeVar("Key", bound=Hashable)
Event = tuple[float, Key]
Match = tuple[Event[Key] | None, Event[Key] | None]

MIN_S = 1.1
"""No event has to be nearer than this: a change may be seen with the next heartbeat only."""
FLOWN = 0.1
"""What follows from flying may come this part of the time since its cause earlier or later."""
FLOWN_MOST_S = 5.0
WINDOW_S = 10.0
"""Events further apart than this are not the same event."""
NOTHING = "-"
_TELEMETRY_COMMANDS = {510, 511, 512}
_COMMANDS = {75, 76, 11}
"""COMMAND_INT, COMMAND_LONG and SET_MODE."""
_SET_MODE = 11
_PARAM_SET = 23
_SETPOINTS = {84, 86}
_STREAM_GAP_S = 0.8


@final
@dataclass(frozen=True, slots=True)
class Row:
    """One thing that a client can tell, on both sides."""

    kind: str
    name: str
    at_s: float | None
    """Vehicle time of the real one; None: the whole flight."""
    real: str
    simulated: str
    tolerance: str
    difference: float
    """In tolerances: agrees up to 1; inf where one side has nothing to compare."""
    reason: str | None = None

    @property
    def agrees(self) -> bool:
        """Whether a client could not tell, within the tolerance."""
        return self.difference <= 1.0

    def is_explained_by(self, reason: Reason) -> bool:
        """Whether this is why it does not agree."""
        return reason.explains(self.kind, self.name, self.simulated, self.difference)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Two sides of the same flight, and when what was caused."""

    recording: Recording
    flight: Flight
    real: Side
    simulated: Side
    causes: tuple[float, ...] = field(repr=False)
    """Vehicle times of boot, commands and faults, ascending."""

    @classmethod
    def of(cls, recording: Recording, flight: Flight, simulated: Side) -> "Comparison":
        """The recorded flight against what a simulation said."""
        return cls(
            recording=recording,
            flight=flight,
            real=recording.side,
            simulated=simulated,
            causes=tuple(sorted(_causes(recording, flight))),
        )

    def patience_s(self, at_s: float, interval_s: float = 0.0) -> float:
        """How much earlier or later an event of this time may come.

        A tenth of the time since the last cause, up to 5 s (a landing that takes 35 s may take
        3.5 s more), and the interval of the message that it is seen in; in all 1.1 s at least.
        During boot nothing has caused anything yet.
        """
        place = bisect.bisect_right(self.causes, at_s) - 1
        flown_s = 0.0 if place < 0 else min(FLOWN * (at_s - self.causes[place]), FLOWN_MOST_S)
        return max(MIN_S, flown_s + interval_s)

    def is_left_out(self, at_s: float | None) -> bool:
        """Whether this vehicle time lies in a stretch that is not compared."""
        if at_s is None:
            return False
        log_s = self.recording.clock.log_s(at_s)
        return any(s.begin_s <= log_s < s.end_s for s in self.flight.left_out)


def _causes(recording: Recording, flight: Flight) -> Iterator[float]:
    """The first of each streak of equal commands, parameters, setpoints, and timeline faults."""
    before = None
    for h in recording.sent:
        if h.number in _COMMANDS:
            message = decoded(h)
            number = -1 if h.number == _SET_MODE else message.command
            if number not in _TELEMETRY_COMMANDS and (number != before or number == 176):
                yield h.time_s
                before = number
        elif h.number == _PARAM_SET:
            yield h.time_s
    yield from _setpoint_causes(recording)
    for fault in flight.faults:
        yield recording.clock.vehicle_s(fault.begin_s)
        yield recording.clock.vehicle_s(fault.end_s)


def _setpoint_causes(recording: Recording) -> Iterator[float]:
    """When a stream of setpoints begins, ends or changes its kind.

    The last end counts only if a command follows it: clients stop when the vehicle has disarmed.
    """
    before_s, before = -math.inf, None
    for h in recording.sent:
        if h.number in _COMMANDS and before is not None and h.time_s - before_s > _STREAM_GAP_S:
            yield before_s
        if h.number not in _SETPOINTS:
            continue
        message = decoded(h)
        kind = (h.number, message.coordinate_frame, message.type_mask)
        if h.time_s - before_s > _STREAM_GAP_S:
            if before is not None:
                yield before_s
            yield h.time_s
        elif kind != before:
            yield h.time_s
        before_s, before = h.time_s, kind


def row(
    kind: str,
    name: str,
    shown: Sequence[str],
    tolerance: str,
    difference: float | bool,
    at_s: float | None = None,
) -> Row:
    """One row; shown: real and simulated; True: it differs altogether; None: the whole flight."""
    if isinstance(difference, bool):
        difference = math.inf if difference else 0.0
    real, simulated = shown
    return Row(kind, name, at_s, real, simulated, tolerance, difference)


# --- pairing --------------------------------------------------------------------------------------


def changes(messages: Sequence[tuple[float, Any]], value: Callable[[Any], Key]) -> list[Event[Key]]:
    """When a value appeared first, and every time that it changed."""
    found = list[Event[Key]]()
    for time_s, message in messages:
        now = value(message)
        if not found or found[-1][1] != now:
            found.append((time_s, now))
    return found


def paired(
    real: Sequence[Event[Key]], simulated: Sequence[Event[Key]], window_s: float = WINDOW_S
) -> list[Match[Key]]:
    """Equal events of both sides, the nearest with the nearest; then what is left of each."""
    by_key = dict[Key, tuple[list[int], list[int]]]()
    for side, events in enumerate((real, simulated)):
        for place, (_, key) in enumerate(events):
            by_key.setdefault(key, ([], []))[side].append(place)
    partner = dict[int, int]()
    for ours, theirs in by_key.values():
        near = sorted(
            (abs(real[i][0] - simulated[j][0]), i, j)
            for i in ours
            for j in theirs
            if abs(real[i][0] - simulated[j][0]) <= window_s
        )
        taken = set[int]()
        for _, i, j in near:
            if i not in partner and j not in taken:
                partner[i] = j
                taken.add(j)
    used = set(partner.values())
    matches: list[Match[Key]] = [
        (event, simulated[partner[i]] if i in partner else None) for i, event in enumerate(real)
    ]
    matches += [(None, event) for j, event in enumerate(simulated) if j not in used]
    return sorted(matches, key=_time_of)


def _time_of(match: Match[Any]) -> float:
    event = match[0] or match[1]
    assert event is not None
    return float(event[0])


def timed_rows(
    comparison: Comparison,
    kind: str,
    matches: Sequence[Match[Key]],
    label: Callable[[Key], str],
    *,
    interval_s: float = 0.0,
) -> Iterator[Row]:
    """A row for each pair: agrees if both are there, at the same time but for the patience.

    interval_s: how often it can be seen at most.
    """
    for match in matches:
        real, simulated = match
        event = real or simulated
        assert event is not None
        at_s = event[0]
        tolerance_s = comparison.patience_s(at_s, interval_s)
        difference = math.inf
        if real is not None and simulated is not None:
            difference = abs(simulated[0] - real[0]) / tolerance_s
        shown = [NOTHING if each is None else f"{each[0]:.2f} s" for each in match]
        yield row(kind, label(event[1]), shown, f"{tolerance_s:.1f} s", difference, at_s)


def interval_s(times: Sequence[float]) -> float:
    """The usual time between two of these."""
    if len(times) < 2:
        return 0.0
    steps = sorted(b - a for a, b in itertools.pairwise(times))
    return steps[len(steps) // 2]
