"""Latency statistics of a flight, in a few hundred counters."""

import math
from typing import final

_MIN_S = 1e-5
_PER_DECADE = 20  # neighbouring bounds differ by 12 %
_DECADES = 7


@final
class Histogram:
    """Durations, counted in classes whose bounds grow geometrically from 10 us to 100 s."""

    def __init__(self) -> None:
        self._counts = [0] * (_PER_DECADE * _DECADES + 1)
        self.count = 0
        self.longest_s = 0.0

    def add(self, duration_s: float) -> None:
        """One more."""
        place = 0
        if duration_s > _MIN_S:
            place = math.ceil(_PER_DECADE * math.log10(duration_s / _MIN_S))
        self._counts[min(place, len(self._counts) - 1)] += 1
        self.count += 1
        self.longest_s = max(self.longest_s, duration_s)

    def percentile_s(self, percent: float) -> float | None:
        """A bound that so many percent stay below, at most 12 % too high; None of nothing."""
        if self.count == 0:
            return None
        wanted = math.ceil(self.count * percent / 100.0)
        reached = 0
        for place, count in enumerate(self._counts):
            reached += count
            if reached >= wanted:
                return min(_MIN_S * 10.0 ** (place / _PER_DECADE), self.longest_s)
        return self.longest_s


@final
class StreamTimes:
    """From a message in to the setpoint out, and from each setpoint to the next."""

    def __init__(self) -> None:
        self.answers = Histogram()
        self.gaps = Histogram()
        self.turns = Histogram()
        """Time to handle the events of one iteration."""
        self.silences = Histogram()
        """From one word of the autopilot to the next: the stream can have no fewer gaps."""
        self._last_s: float | None = None
        self._heard_s: float | None = None

    def heard(self, at_s: float) -> None:
        """The autopilot spoke."""
        if self._heard_s is not None:
            self.silences.add(at_s - self._heard_s)
        self._heard_s = at_s

    def sent(self, now_s: float, arrived_s: float | None) -> None:
        """A setpoint left now, in answer to what had arrived then."""
        if arrived_s is not None:
            self.answers.add(now_s - arrived_s)
        if self._last_s is not None:
            self.gaps.add(now_s - self._last_s)
        self._last_s = now_s

    def paused(self) -> None:
        """The stream stops or starts on purpose here: not a gap."""
        self._last_s = None

    def summary(self) -> dict[str, float | int | None]:
        """For run.json; milliseconds."""
        return {
            "setpoints": self.answers.count,
            "position_to_setpoint_p50_ms": _ms(self.answers.percentile_s(50.0)),
            "position_to_setpoint_p99_ms": _ms(self.answers.percentile_s(99.0)),
            "position_to_setpoint_max_ms": _ms(self.answers.longest_s),
            "gap_p50_ms": _ms(self.gaps.percentile_s(50.0)),
            "gap_p99_9_ms": _ms(self.gaps.percentile_s(99.9)),
            "gap_max_ms": _ms(self.gaps.longest_s),
            "silence_p99_9_ms": _ms(self.silences.percentile_s(99.9)),
            "silence_max_ms": _ms(self.silences.longest_s),
            "turn_p99_ms": _ms(self.turns.percentile_s(99.0)),
            "turn_max_ms": _ms(self.turns.longest_s),
        }


def _ms(duration_s: float | None) -> float | None:
    return None if duration_s is None else round(1e3 * duration_s, 3)
