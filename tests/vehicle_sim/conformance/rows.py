"""What a row is, how events are paired, and the rows of what is answered, changes and streams."""

import bisect
import itertools
import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from conformance.flights import Flight, Reason, Recording, Side

Event = tuple[float, Any]
"""When, and what."""

MIN_S = 1.1
"""No event has to be nearer than this: a change may be seen with the next heartbeat only."""
FLOWN, FLOWN_MOST_S = 0.1, 5.0
"""What follows from flying may come this part of the time since its cause earlier or later."""
WINDOW_S = 10.0
"""Events further apart than this are not the same event."""
NOTHING = "-"
_MODE, _PARAM_SET, _ACK, _REQUESTS = 11, 23, 77, {510, 511, 512}
_COMMANDS, _SETPOINTS = {75, 76}, {84, 86}
_STREAM_GAP_S = 0.8


class Row(NamedTuple):
    """One thing that a client can tell, on both sides."""

    kind: str
    name: str
    shown: Sequence[str]
    """Of the real one and of the simulated one."""
    difference: float
    """In tolerances: agrees up to 1; inf where one side has nothing to compare."""
    at_s: float | None = None
    """Vehicle time of the real one; None: the whole flight."""
    reason: Reason | None = None
    """Why it does not agree; None if it does, or if nobody knows."""

    @property
    def agrees(self) -> bool:
        return self.difference <= 1.0


def apart(real: Any, simulated: Any, tolerance: Any) -> float:
    """How far, in tolerances, and of several the most; inf where one side has nothing.

    NaN is like NaN only, and without a tolerance they are equal or not.
    """
    if real is None or simulated is None:
        return math.inf
    a, b = np.array(real, float), np.array(simulated, float)
    unlike = (a != b) & ~(np.isnan(a) & np.isnan(b))
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.where(unlike, np.abs(a - b) / tolerance, 0.0)
    return float(np.where(np.isnan(off), math.inf, off).max(initial=0.0))


class Comparison:
    """Two sides of the same flight, and when what was caused."""

    def __init__(self, recording: Recording, flight: Flight, simulated: Side) -> None:
        self.recording, self.flight = recording, flight
        self.real, self.simulated = self.sides = (recording.side, simulated)
        self._causes_s = sorted(_causes(recording, flight))

    def patience_s(self, at_s: float, interval_s: float) -> float:
        """How much earlier or later an event of this time may come.

        A tenth of the time since the last cause, up to 5 s (a landing that takes 35 s may take
        3.5 s more), and the interval of the message that it is seen in; in all 1.1 s at least.
        During boot nothing has caused anything yet.
        """
        place = bisect.bisect_right(self._causes_s, at_s) - 1
        flown_s = FLOWN * (at_s - self._causes_s[place]) if place >= 0 else 0.0
        return max(MIN_S, min(flown_s, FLOWN_MOST_S) + interval_s)

    def is_left_out(self, at_s: float | None) -> bool:
        """Whether this vehicle time lies in a stretch that is not compared."""
        if at_s is None:
            return False
        log_s = self.recording.clock.log_s(at_s)
        return any(span.begin_s <= log_s < span.end_s for span in self.flight.left_out)


def _causes(recording: Recording, flight: Flight) -> Iterator[float]:
    """Vehicle times of faults, of the first of each streak of equal commands, of parameters, and
    when a stream of setpoints begins, ends or changes its kind.

    The last end counts only if a command follows it: clients stop when the vehicle has disarmed.
    """
    before, stream, stream_s = None, None, -math.inf
    for one in recording.sent:
        pauses = one.at_s - stream_s > _STREAM_GAP_S
        if one.number in _COMMANDS or one.number == _MODE:
            number = -1 if one.number == _MODE else one.message.command
            if number not in _REQUESTS and (number != before or number == 176):
                yield one.at_s
                before = number
        elif one.number == _PARAM_SET:
            yield one.at_s
        if pauses and stream is not None and one.number in {*_COMMANDS, _MODE, *_SETPOINTS}:
            yield stream_s
        if one.number in _SETPOINTS:
            message = one.message
            kind = (one.number, message.coordinate_frame, message.type_mask)
            if pauses or kind != stream:
                yield one.at_s
            stream, stream_s = kind, one.at_s
    for fault in flight.faults:
        yield from map(recording.clock.vehicle_s, (fault.begin_s, fault.end_s))


# --- pairing --------------------------------------------------------------------------------------


def changes(messages: Iterable[Event], value: Callable[[Any], Any]) -> list[Event]:
    """When a value appeared first, and every time that it changed."""
    told = [(time_s, value(message)) for time_s, message in messages]
    return [event for k, event in enumerate(told) if not k or told[k - 1][1] != event[1]]


def paired(
    real: Sequence[Event], simulated: Sequence[Event]
) -> list[tuple[Any, float | None, float | None]]:
    """What, and when on each side: equal events, the nearest with the nearest; then what is left.

    None: not on this side.
    """
    of_key = defaultdict[Any, list[int]](list)
    for j, (_, key) in enumerate(simulated):
        of_key[key].append(j)
    apart_s = (
        (abs(at_s - simulated[j][0]), i, j)
        for i, (at_s, key) in enumerate(real)
        for j in of_key[key]
    )
    partner, alone = dict[int, float](), dict(enumerate(simulated))
    for _, i, j in sorted(each for each in apart_s if each[0] <= WINDOW_S):
        if i not in partner and j in alone:
            partner[i], _ = alone.pop(j)
    return [
        *((key, at_s, partner.get(i)) for i, (at_s, key) in enumerate(real)),
        *((key, None, at_s) for at_s, key in alone.values()),
    ]


def timed_rows(
    comparison: Comparison, kind: str, sides: Iterable[Sequence[Event]], seen_s: float = 0.0
) -> Iterator[Row]:
    """A row for each event: agrees if it is on both sides, at the same time but for the patience.

    seen_s: how often it can be seen at most.
    """
    for name, real_s, simulated_s in paired(*sides):
        at_s = real_s if real_s is not None else simulated_s or 0.0
        difference = apart(real_s, simulated_s, comparison.patience_s(at_s, seen_s))
        shown = [NOTHING if t is None else f"{t:.2f} s" for t in (real_s, simulated_s)]
        yield Row(kind, name, shown, difference, at_s)


def interval_s(times: Sequence[float]) -> float:
    steps = sorted(after - before for before, after in itertools.pairwise(times))
    return steps[len(steps) // 2] if steps else 0.0


def message_name(number: int) -> str:
    known = mavlink.mavlink_map.get(number)
    return known.msgname if known else f"message {number}"


def enum_name(enum: str, value: int) -> str:
    """The short name of a value, or the number where it has none."""
    entry = mavlink.enums[enum].get(value)
    return entry.name.removeprefix(f"{enum}_") if entry else str(value)


# --- commands -------------------------------------------------------------------------------------

ACK_S = 0.25
"""How much later or earlier than the real one's an answer may come."""
STREAMED = 20
"""Commands sent oftener than this are a stream: one row for all."""
Answers = list[tuple[float, int]]


def ack_rows(comparison: Comparison) -> Iterator[Row]:
    """A row for each command: the results of its COMMAND_ACKs in order, and their times."""
    sent = [(one.at_s, one.message) for one in comparison.recording.sent if one.number in _COMMANDS]
    answers = [_answers(sent, side.of(_ACK)) for side in comparison.sides]
    often = Counter(message.command for _, message in sent)
    rows = defaultdict[tuple[str, int], list[int]](list)
    for k, (_, message) in enumerate(sent):
        name, number = f"command {message.command}", k
        if message.command in _REQUESTS:
            name += f" of {message_name(int(message.param1))}"
        elif often[message.command] > STREAMED:
            name, number = f"{name}, {often[message.command]} times", -1
        rows[name, number].append(k)
    for (name, _), places in rows.items():
        real, simulated = ([each for k in places for each in side[k]] for side in answers)
        at_s, difference = sent[places[0]][0], math.inf
        if [result for _, result in real] == [result for _, result in simulated]:
            difference = apart([t for t, _ in real], [t for t, _ in simulated], ACK_S)
        shown = [
            ", ".join(f"{enum_name('MAV_RESULT', r)} +{t - at_s:.2f} s" for t, r in side[:5])
            for side in (real, simulated)
        ]
        yield Row("ack", name, [each or NOTHING for each in shown], difference, at_s)


def _answers(sent: Sequence[Event], acks: Sequence[Event]) -> list[Answers]:
    """Time and result of each command's acknowledgements.

    Commands about messages are answered once each, in order; any other answer belongs to the
    newest command of its number.
    """
    answers: list[Answers] = [[] for _ in sent]
    for time_s, ack in acks:
        orders = enumerate(sent)
        asked = [k for k, (at_s, m) in orders if m.command == ack.command and at_s <= time_s]
        if ack.command in _REQUESTS:
            asked = [k for k in asked if not answers[k]][:1]
        if asked:
            answers[asked[-1]].append((time_s, ack.result))
    return answers


# --- single answers -------------------------------------------------------------------------------

_ONCE = (148, 49, 242)
"""AUTOPILOT_VERSION, GPS_GLOBAL_ORIGIN, HOME_POSITION."""
_METRES_E7 = 90.0
"""1e-7 degrees of latitude in a metre."""
_TOLERANCES = {"latitude": 3.0 * _METRES_E7, "longitude": 3.0 * _METRES_E7 / 0.67, "q": 0.05}
_TOLERANCES |= {"altitude": 1500.0, "x": 1.0, "y": 1.0, "z": 1.0}
"""How much a field may differ, in its own unit (of altitude mm); the others must be equal."""
_IDENTITY = {"uid", "uid2"}
"""Every vehicle has its own: only whether it gives one is compared."""


def once_rows(comparison: Comparison) -> Iterator[Row]:
    """A row for each field of what is said once; of what is repeated, the first one."""
    for number in _ONCE:
        real, simulated = (next((m for _, m in s.of(number)), None) for s in comparison.sides)
        for field in real.fieldnames if real else ():
            if field in ("time_usec", "time_boot_ms"):
                continue
            told = [getattr(m, field, None) for m in (real, simulated)]
            if field in _IDENTITY:
                told = [each and bool(np.any(each)) for each in told]
            difference = apart(told[0], told[1], _TOLERANCES.get(field, 0.0))
            name = f"{message_name(number)}.{field}"
            yield Row("said once", name, [str(each) for each in told], difference)


# --- what changes: modes, arming, landing, fixes, estimators; and what is exchanged ---------------

_SLOWEST_S = 2.1
_MODES = {("ardupilot", "copter"): "COPTER_MODE", ("ardupilot", "plane"): "PLANE_MODE"}
_EXCHANGES = (39, 40, 44, 47, 51, 73)
_EXCHANGED = ("seq", "command", "count", "type", "mission_type")
"""Mission protocol: messages, and of each what there is of these."""
_ECHO = "coordinate_frame {0.coordinate_frame}, type_mask {0.type_mask:#x}"
_VEHICLE = "type {0.type}, autopilot {0.autopilot}, mavlink {0.mavlink_version}"
Told = Callable[[Any], str]


def _enum(enum: str, name: str) -> Told:
    return lambda m: enum_name(enum, getattr(m, name))


def _exchanged(message: Any) -> str:
    said = (name for name in _EXCHANGED if name in message.fieldnames)
    return ", ".join(f"{name} {getattr(message, name)}" for name in said)


def state_rows(comparison: Comparison) -> Iterator[Row]:
    """A row for each change of each state, and for all that is said in an exchange."""
    modes = _MODES.get((comparison.recording.firmware, comparison.recording.kind))

    def mode(name: str) -> Told:
        return _enum(modes, name) if modes else f"{{0.{name}:#010x}}".format

    states: tuple[tuple[str, int, Told], ...] = (
        ("mode", 0, mode("custom_mode")),
        ("armed", 0, lambda m: "armed" if m.base_mode & 0x80 else "disarmed"),
        ("base mode", 0, lambda m: f"{m.base_mode & ~0x80:#x}"),
        ("system status", 0, _enum("MAV_STATE", "system_status")),
        ("vehicle", 0, _VEHICLE.format),
        ("landed", 245, _enum("MAV_LANDED_STATE", "landed_state")),
        ("vtol", 245, "{0.vtol_state:#x}".format),
        ("fix", 24, _enum("GPS_FIX_TYPE", "fix_type")),
        ("estimator", 193, "{0.flags:#x}".format),
        ("estimator", 230, "{0.flags:#x}".format),
        ("current mode", 436, mode("custom_mode")),
        ("intended mode", 436, mode("intended_custom_mode")),
        ("mission", 42, "{0.seq} of {0.total}, {0.mission_state}, {0.mission_mode}".format),
        ("echo", 85, _ECHO.format),
        ("echo", 87, _ECHO.format),
    )
    for kind, number, told in states:
        changed = (changes(side.of(number), told) for side in comparison.sides)
        seen_s = interval_s([one.at_s for one in comparison.real.heard(number)])
        yield from timed_rows(comparison, kind, changed, min(seen_s, _SLOWEST_S))
    for number in _EXCHANGES:
        said = ([(t, _exchanged(m)) for t, m in side.of(number)] for side in comparison.sides)
        yield from timed_rows(comparison, "exchange", said)


# --- streams: which messages, how many, from when, how long silent, and how filled ----------------

COUNT_PART, COUNT_LEAST = 0.02, 2.0
"""Counts may differ by this part of them, or by so many."""
COMING_AND_GOING_S = 3.0
"""A stream that is not always there may be there this much longer or shorter."""
FIRST_S, SILENCE_S = 1.1, 0.5
_STREAM = 20
"""A message said less often than this is no stream."""
_SAMPLES, _VARYING = 400, 5
"""Of a message at most, evenly spread; a field with at least so many values is one that varies."""
_READ = {0, 1, 2, 24, 30, 31, 32, 33, 42, 46, 49, 62, 74, 77, 85, 87, 111, 132, 141, 147, 148}
_READ |= {162, 168, 173, 193, 230, 231, 242, 245, 331, 436}
"""Messages that a companion, an SDK or a ground station flies by."""
_BY_OTHER_ROWS = {0, 49, 77, 148, 242}
"""Those of them whose fields are compared by other rows."""
_UNREAD = re.compile(
    "load|energy_consumed|temperature|direction|speed|speed_z|wind_[xy]|var_horiz|reset_counter|"
    "(pos_vert|compass|airspeed|terrain_alt)_variance|(pos_vert|mag|hagl|tas)_ratio|"
    ".*_covariance|pos_vert_accuracy|onboard_control_sensors_(present|enabled|health)"
)
"""Fields of these messages that nobody flies by, and that are not modelled."""


def stream_rows(comparison: Comparison) -> Iterator[Row]:
    """Rows for every message of _READ that either side says."""
    for number in sorted(_READ & (comparison.real.numbers | comparison.simulated.numbers)):
        name = message_name(number)
        real, simulated = ([o.at_s for o in s.heard(number)] for s in comparison.sides)
        usual_s = interval_s(real)
        is_stream = number != _ACK and len(real) >= _STREAM
        allowed = max(COUNT_LEAST, COUNT_PART * len(real))
        if is_stream and usual_s * len(real) < 0.95 * (real[-1] - real[0]):
            allowed = max(allowed, COMING_AND_GOING_S / usual_s)
        counts = len(real), len(simulated)
        off = abs(counts[0] - counts[1]) / allowed if real and simulated else math.inf
        yield Row("count", name, [str(n) for n in counts], off)
        if not is_stream or not simulated:
            continue
        gaps = [_longest_gap(times) for times in (real, simulated)]
        allowed_s = max(SILENCE_S, 1.1 * usual_s, 0.05 * gaps[0][0])
        for kind, seconds, within_s, at_s in (
            ("first", (real[0], simulated[0]), max(FIRST_S, usual_s), real[0]),
            ("longest silence", (gaps[0][0], gaps[1][0]), allowed_s, gaps[0][1]),
        ):
            shown = [f"{each:.2f} s" for each in seconds]
            yield Row(kind, name, shown, apart(*seconds, within_s), at_s)
        if number not in _BY_OTHER_ROWS:
            heard = (side.heard(number) for side in comparison.sides)
            samples = ([one.message for one in h[:: -(-len(h) // _SAMPLES)]] for h in heard)
            yield _filling_row(name, *samples)


def _longest_gap(times: Sequence[float]) -> tuple[float, float]:
    """Its length, and when it began."""
    gaps = ((after - before, before) for before, after in itertools.pairwise(times))
    return max(gaps, default=(0.0, times[0]))


def _filling_row(name: str, real: Sequence[Any], simulated: Sequence[Any]) -> Row:
    """A field that has one value or few must have the same, or the same most of the time; one
    that varies must vary."""
    wrong = []
    for field in real[0].fieldnames:
        ours, theirs = (_values(side, field) for side in (real, simulated))
        varies = len(ours) >= _VARYING
        if len(ours) == 1 and len(theirs) > 1:
            wrong.append((field, ours[0], f"{len(theirs)} values"))
        elif not varies and not _same(ours[0], theirs[0]):
            wrong.append((field, ours[0], theirs[0]))
        elif varies and len(theirs) == 1:
            wrong.append((field, "varies", theirs[0]))
    wrong = [each for each in wrong if not _UNREAD.fullmatch(each[0])]
    shown = [", ".join(f"{each[0]} {each[k]}" for each in wrong) for k in (1, 2)]
    return Row("filling", name, shown, math.inf if wrong else 0.0)


def _values(messages: Sequence[Any], field: str) -> list[Any]:
    """The distinct ones, the commonest first; NaN is one value, and a list is what it shows."""
    values = (getattr(message, field) for message in messages)
    plain = (str(v) if isinstance(v, list) or v != v else v for v in values)
    return [value for value, _ in Counter(plain).most_common()]


def _same(one: Any, other: Any) -> bool:
    """Constants are equal to 0.1 %."""
    are_numbers = not (isinstance(one, str) or isinstance(other, str))
    return one == other or (are_numbers and math.isclose(one, other, rel_tol=1e-3, abs_tol=1e-6))
