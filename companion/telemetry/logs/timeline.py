"""Converts time stamps to a monotonic time and notes their anomalies."""

import itertools
from collections.abc import Sequence
from typing import Final, final

from companion.telemetry.logs.anomalies import Anomaly, AnomalyCounter

YEAR_2000_US: Final = 946_684_800_000_000
YEAR_2100_US: Final = 4_102_444_800_000_000
BACK_US: Final = 1_000_000
"""A clock that falls by more was set, or replaced."""
JITTER_US: Final = 1_000
"""Programs that log in several threads, or a link's number in the last bits, make less."""
_GAP_US: Final = 600_000_000


@final
class Timeline:
    """Follows one log's clock.

    A stamp after a jump is accepted once the next one agrees with it: until then the previous time
    continues.  After a jump back time continues from where it was.
    """

    def __init__(
        self,
        findings: AnomalyCounter,
        *,
        first_us: int,
        last_us: int,
        start_us: int,
        is_sure: bool = True,
        jitter_us: int = JITTER_US,
    ) -> None:
        """first_us, last_us: the stamps that make sense at all; start_us: the time until one comes.

        is_sure: the log is known to begin there, so that a first stamp far from it is doubted;
        jitter_us: a step back by less is not worth a word.
        """
        self._jitter_us = jitter_us
        self._findings = findings
        self._first_us, self._last_us, self._start_us = first_us, last_us, start_us
        self._stamp_us = start_us if is_sure else None
        self._doubted_us: int | None = None
        self._shift_us = 0
        self.now_us = start_us if is_sure else None
        """None: before the first stamp that makes sense."""

    def read(self, stamp_us: int, byte: int) -> tuple[int, bool]:
        """The time of what has this stamp, and whether the stamp is believed."""
        before_us, now_us = self._stamp_us, self.now_us
        if before_us is None or now_us is None:
            return self._first(stamp_us, byte)
        step_us = stamp_us - before_us
        if not -BACK_US <= step_us <= _GAP_US:
            return self._leap(stamp_us, byte)
        if step_us < -self._jitter_us:
            self._findings.note(Anomaly.TIME_JITTER, byte, now_us)
        if self._doubted_us is not None:
            self._drop_doubt(byte)
        self._stamp_us = stamp_us
        now_us = max(now_us, stamp_us + self._shift_us)
        self.now_us = now_us
        return now_us, True

    def _first(self, stamp_us: int, byte: int) -> tuple[int, bool]:
        if not self._first_us <= stamp_us < self._last_us:
            self._note_senseless(stamp_us, byte)
            return self._start_us, False
        self._stamp_us, self.now_us = stamp_us, max(stamp_us, self._start_us)
        return self.now_us, True

    def _leap(self, stamp_us: int, byte: int) -> tuple[int, bool]:
        assert self.now_us is not None
        assert self._stamp_us is not None
        if stamp_us == 0 or not self._first_us <= stamp_us < self._last_us:
            self._note_senseless(stamp_us, byte)
            return self.now_us, False
        doubted_us = self._doubted_us
        if doubted_us is None or not -BACK_US <= stamp_us - doubted_us <= _GAP_US:
            if doubted_us is not None:
                self._drop_doubt(byte)
            self._doubted_us = stamp_us
            return self.now_us, False
        if stamp_us < self._stamp_us:
            self._findings.note(Anomaly.TIME_BACK, byte, self.now_us)
        else:
            self._findings.note(Anomaly.TIME_GAP, byte, self.now_us)
        # No more of a shift than keeps it from falling: what leaps again and again stays bounded.
        self._shift_us = max(self.now_us - stamp_us, 0)
        self._stamp_us, self._doubted_us = stamp_us, None
        self.now_us = stamp_us + self._shift_us
        return self.now_us, True

    @property
    def last_us(self) -> int:
        """The newest time, or that before the first."""
        return self._start_us if self.now_us is None else self.now_us

    def finish(self, byte: int) -> None:
        """End of the log: a jump still in doubt was wrong."""
        if self._doubted_us is not None:
            self._drop_doubt(byte)

    def _drop_doubt(self, byte: int) -> None:
        self._doubted_us = None
        self._findings.note(Anomaly.WRONG_STAMP, byte, self.now_us)

    def _note_senseless(self, stamp_us: int, byte: int) -> None:
        kind = Anomaly.ZERO_STAMP if stamp_us == 0 else Anomaly.WRONG_STAMP
        self._findings.note(kind, byte, self.now_us)


def earliest(stamps_us: Sequence[int]) -> int:
    """Where a log begins, by its first stamps: the first that the one after it agrees with."""
    for stamp_us, after_us in itertools.pairwise(stamps_us):
        if -BACK_US <= after_us - stamp_us <= _GAP_US:
            return stamp_us
    return stamps_us[0]
