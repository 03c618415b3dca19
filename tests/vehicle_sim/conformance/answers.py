"""Rows of what is answered: commands, mission exchanges, and messages said once."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from conformance.log import Side, decoded, enum_name, message_name
from conformance.rows import (
    NOTHING,
    Comparison,
    Row,
    paired,
    row,
    timed_rows,
)

ACK_S = 0.25
"""How much later or earlier than the real one's an answer may come."""
STREAMED = 20
"""Commands sent oftener than this are a stream: one row for all."""
_COMMANDS = {75, 76}
_COMMAND_ACK = 77
_ABOUT_MESSAGES = {510, 511, 512}
_SYSTEM_WIDE_FIELDS = {"time_usec", "time_boot_ms"}
_METRES_E7 = 90.0
"""1e-7 degrees of latitude in a metre."""


class _Sent(NamedTuple):
    time_s: float
    command: int
    about: int | None
    """The message number that 510, 511 and 512 are about."""


def ack_rows(comparison: Comparison) -> Iterator[Row]:
    """A row for each command: the results of its COMMAND_ACKs in order, and their times."""
    sent = [_sent(h.time_s, decoded(h)) for h in comparison.recording.sent if h.number in _COMMANDS]
    sides = (comparison.real, comparison.simulated)
    answers = [_answers(sent, side.of(_COMMAND_ACK)) for side in sides]
    often = Counter(s.command for s in sent)
    for place, command in enumerate(sent):
        if command.about is None and often[command.command] > STREAMED:
            continue
        yield _ack_row(_command_name(command), command.time_s, [a[place] for a in answers])
    for number in sorted(n for n, k in often.items() if k > STREAMED and n not in _ABOUT_MESSAGES):
        places = [i for i, s in enumerate(sent) if s.command == number]
        together = [[x for i in places for x in a[i]] for a in answers]
        name = f"command {number}, {len(places)} times"
        yield _ack_row(name, sent[places[0]].time_s, together)


def _sent(time_s: float, message: Any) -> _Sent:
    about = int(message.param1) if message.command in _ABOUT_MESSAGES else None
    return _Sent(time_s, message.command, about)


def _command_name(sent: _Sent) -> str:
    about = "" if sent.about is None else f" of {message_name(sent.about)}"
    return f"command {sent.command}{about}"


def _answers(
    sent: Sequence[_Sent], acks: Sequence[tuple[float, Any]]
) -> list[list[tuple[float, int]]]:
    """For each command its acknowledgements.

    Commands about messages are answered once each, in order; any other answer belongs to the
    newest command of its number.
    """
    answers: list[list[tuple[float, int]]] = [[] for _ in sent]
    for time_s, ack in acks:
        places = [i for i, s in enumerate(sent) if s.command == ack.command and s.time_s <= time_s]
        if ack.command in _ABOUT_MESSAGES:
            places = [i for i in places if not answers[i]][:1]
        if places:
            answers[places[-1]].append((time_s, ack.result))
    return answers


def _ack_row(name: str, at_s: float, answers: Sequence[Sequence[tuple[float, int]]]) -> Row:
    real, simulated = answers
    difference = math.inf
    if [r for _, r in real] == [r for _, r in simulated]:
        late = [abs(a[0] - b[0]) for a, b in zip(real, simulated, strict=True)]
        difference = max(late, default=0.0) / ACK_S
    shown = [_results(at_s, side) for side in answers]
    return row("ack", name, shown, f"same results, {ACK_S} s", difference, at_s)


def _results(at_s: float, answers: Sequence[tuple[float, int]]) -> str:
    if not answers:
        return NOTHING
    counted = Counter(enum_name("MAV_RESULT", r) for _, r in answers)
    if len(answers) > 4:
        return ", ".join(f"{n} x {name}" for name, n in counted.items())
    return ", ".join(
        f"{enum_name('MAV_RESULT', r)} +{1000 * (t - at_s):.0f} ms" for t, r in answers
    )


# --- exchanges and single answers -----------------------------------------------------------------

_EXCHANGES = {
    39: ("seq", "command", "mission_type"),
    40: ("seq", "mission_type"),
    44: ("count", "mission_type"),
    46: ("seq",),
    47: ("type", "mission_type"),
    51: ("seq", "mission_type"),
    73: ("seq", "command", "mission_type"),
}
"""Mission protocol: message number and the fields that tell what was said."""
_REACHED = 46


def exchange_rows(comparison: Comparison) -> Iterator[Row]:
    """A row for each message of a mission or fence exchange."""
    for number, fields in _EXCHANGES.items():
        if number == _REACHED:
            continue  # streamed by ArduPilot's plane: counted among the streams
        real, simulated = (
            [
                (t, (message_name(number), *(f"{f} {getattr(m, f)}" for f in fields)))
                for t, m in side.of(number)
            ]
            for side in (comparison.real, comparison.simulated)
        )
        yield from timed_rows(comparison, "exchange", paired(real, simulated), _exchange_label)


def _exchange_label(key: tuple[str, ...]) -> str:
    return f"{key[0]} {', '.join(key[1:])}"


_ONCE = (148, 49, 242)
"""AUTOPILOT_VERSION, GPS_GLOBAL_ORIGIN, HOME_POSITION."""
_TOLERANCES = {
    "latitude": 3.0 * _METRES_E7,
    "longitude": 3.0 * _METRES_E7 / 0.67,
    "altitude": 1500.0,  # mm
    "x": 1.0,
    "y": 1.0,
    "z": 1.0,
    "q": 0.05,
}
"""How much a field may differ, in its own unit; the others must be equal."""


_IDENTITY = {"uid", "uid2"}
"""Every vehicle has its own: only whether it gives one is compared."""


def _is_given(value: Any) -> str:
    return "given" if value and (not isinstance(value, list) or any(value)) else "not given"


def once_rows(comparison: Comparison) -> Iterator[Row]:
    """A row for each field of what is said once; of what is repeated, the first one."""
    for number in _ONCE:
        real, simulated = (_first(s, number) for s in (comparison.real, comparison.simulated))
        if real is None:
            continue
        for name in real.fieldnames:
            if name in _SYSTEM_WIDE_FIELDS:
                continue
            ours = getattr(real, name)
            theirs = None if simulated is None else getattr(simulated, name)
            tolerance = _TOLERANCES.get(name, 0.0)
            if name in _IDENTITY and simulated is not None:
                ours, theirs = (_is_given(x) for x in (ours, theirs))
            shown = (str(ours), NOTHING if theirs is None else str(theirs))
            allowed = f"{tolerance:g}" if tolerance else "equal"
            field, apart = f"{message_name(number)}.{name}", _apart(ours, theirs, tolerance)
            yield row("said once", field, shown, allowed, apart)


def _first(side: Side, number: int) -> Any | None:
    messages = side.of(number)
    return messages[0][1] if messages else None


def _apart(ours: Any, theirs: Any, tolerance: float) -> float:
    if isinstance(ours, list) and isinstance(theirs, list) and len(ours) == len(theirs):
        return max((_apart(a, b, tolerance) for a, b in zip(ours, theirs, strict=True)), default=0)
    if ours == theirs or (ours != ours and theirs != theirs):
        return 0.0
    if theirs is None or not tolerance or not isinstance(ours, int | float):
        return math.inf
    return abs(float(ours) - float(theirs)) / tolerance
