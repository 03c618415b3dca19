"""Rows of the streams: which messages, how many, from when, how long silent, and how filled."""

import itertools
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from conformance.log import TimedFrame, message_name
from conformance.rows import NOTHING, Comparison, Row, interval_s, row

COUNT_PART = 0.02
"""Counts may differ by this part, or by COUNT_LEAST."""
COUNT_LEAST = 2.0
COMING_AND_GOING_S = 3.0
"""A stream that is not always there may be there this much longer or shorter."""
FIRST_S = 1.1
SILENCE_S = 0.5
_STREAM = 20
"""A message said less often than this is no stream."""
_SAMPLES = 400
_EXACT_PART = 1e-3
_READ = {0, 1, 2, 24, 30, 31, 32, 33, 42, 46, 49, 62, 74, 77, 85, 87, 111, 132, 141, 147, 148}
_READ |= {162, 168, 173, 193, 230, 231, 242, 245, 331, 436}
"""Messages that a companion, an SDK or a ground station flies by."""
_BY_OTHER_ROWS = {0, 49, 77, 148, 242}
"""Those of them whose fields are compared by other rows."""
_COMMAND_ACK = 77
"""Without a rate: its times are compared by other rows."""
_UNREAD = re.compile(
    "load|energy_consumed|temperature|direction|speed|speed_z|wind_[xy]|var_horiz|reset_counter|"
    "(pos_vert|compass|airspeed|terrain_alt)_variance|(pos_vert|mag|hagl|tas)_ratio|"
    ".*_covariance|pos_vert_accuracy|onboard_control_sensors_(present|enabled|health)"
)
"""Fields of these messages that nobody flies by, and that are not modelled."""
_VARYING = 5
"""A field with at least so many values is one that varies."""


def stream_rows(comparison: Comparison) -> Iterator[Row]:
    """Rows for every message of _READ that either side says."""
    numbers = _READ & (comparison.real.numbers | comparison.simulated.numbers)
    for number in sorted(numbers):
        real, simulated = (s.heard(number) for s in (comparison.real, comparison.simulated))
        yield _count_row(number, real, simulated)
        if number != _COMMAND_ACK and len(real) >= _STREAM and simulated:
            yield _first_row(number, real, simulated)
            yield _silence_row(number, real, simulated)
            if number not in _BY_OTHER_ROWS:
                yield _filling_row(comparison, number)


def _count_row(number: int, real: Sequence[TimedFrame], simulated: Sequence[TimedFrame]) -> Row:
    allowed = max(COUNT_LEAST, COUNT_PART * len(real))
    times = [h.time_s for h in real]
    usual_s = interval_s(times)
    streams = number != _COMMAND_ACK and len(real) >= _STREAM
    if streams and usual_s * len(real) < 0.95 * (times[-1] - times[0]):
        allowed = max(allowed, COMING_AND_GOING_S / usual_s)
    counts = (len(real), len(simulated))
    difference = math.inf if not all(counts) and any(counts) else abs(counts[0] - counts[1])
    shown = [str(count) for count in counts]
    return row("count", message_name(number), shown, f"{allowed:.0f}", difference / allowed)


def _first_row(number: int, real: Sequence[TimedFrame], simulated: Sequence[TimedFrame]) -> Row:
    ours, theirs = real[0].time_s, simulated[0].time_s
    tolerance_s = max(FIRST_S, interval_s([h.time_s for h in real]))
    return _seconds("first", number, ours, theirs, tolerance_s, ours)


def _silence_row(number: int, real: Sequence[TimedFrame], simulated: Sequence[TimedFrame]) -> Row:
    (at_s, ours), (_, theirs) = _longest(real), _longest(simulated)
    usual_s = interval_s([h.time_s for h in real])
    allowed_s = max(SILENCE_S, 1.1 * usual_s, 0.05 * ours)
    return _seconds("longest silence", number, ours, theirs, allowed_s, at_s)


def _seconds(
    kind: str, number: int, ours: float, theirs: float, tolerance_s: float, at_s: float
) -> Row:
    shown = [f"{seconds:.2f} s" for seconds in (ours, theirs)]
    apart = abs(ours - theirs) / tolerance_s
    return row(kind, message_name(number), shown, f"{tolerance_s:.1f} s", apart, at_s)


def _longest(heard: Sequence[TimedFrame]) -> tuple[float, float]:
    """When the longest gap between two of them began, and its length."""
    gaps = [(b.time_s - a.time_s, a.time_s) for a, b in itertools.pairwise(heard)]
    gap_s, at_s = max(gaps, default=(0.0, heard[0].time_s))
    return at_s, gap_s


# --- filling --------------------------------------------------------------------------------------


def _filling_row(comparison: Comparison, number: int) -> Row:
    """A field that has one value or few must have the same, or the same most of the time.

    One that varies must vary.
    """
    samples = [s.some(number, _SAMPLES) for s in (comparison.real, comparison.simulated)]
    names = [n for n in samples[0][0][1].fieldnames if not _UNREAD.fullmatch(n)]
    wrong = list[tuple[str, str, str]]()
    for name in names:
        real, simulated = (_values([getattr(m, name) for _, m in side]) for side in samples)
        shown = _unlike(real, simulated)
        if shown is not None:
            wrong.append((name, *shown))
    lists = [", ".join(f"{w[0]} {w[k]}" for w in wrong) or f"{len(names)} fields" for k in (1, 2)]
    tolerance = "constants equal to 0.1 %, others vary"
    return row("filling", message_name(number), lists, tolerance, bool(wrong))


def _values(values: Sequence[Any]) -> list[Any]:
    """The distinct ones, the commonest first; NaN is one value, and a list is what it shows."""
    return [value for value, _ in Counter(_plain(v) for v in values).most_common()]


def _plain(value: Any) -> Any:
    if isinstance(value, float) and math.isnan(value):
        return "nan"
    if isinstance(value, list):
        return str(value)
    return value


def _unlike(real: Sequence[Any], simulated: Sequence[Any]) -> tuple[str, str] | None:
    """What to show of a field that is not filled alike; None if it is."""
    if len(real) >= _VARYING:
        return ("varies", _shown(simulated)) if len(simulated) == 1 else None
    if len(real) == 1 and len(simulated) > 1:
        return _shown(real), f"{len(simulated)} values"
    return None if _same(real[0], simulated[0]) else (_shown(real), _shown(simulated))


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, int | float) and isinstance(other, int | float):
        return math.isclose(one, other, rel_tol=_EXACT_PART, abs_tol=1e-6)
    return bool(one == other)


def _shown(values: Sequence[Any]) -> str:
    text = str(values[0]) if values else NOTHING
    return text if len(text) <= 24 else text[:21] + "..."
