"""The vehicle's clock: the newest time_boot_ms of its autopilot (design 4).

Until it is known, and for what must go on in a silence, the silence itself counts.
"""

import enum
from typing import final

from companion.mavlink.dialect import Message

_REBOOT_S = 2.0  # a clock that falls by more has begun again
_BEAT_S = 1.0  # between two heartbeats of an autopilot
_OFTEN_MS = 50  # PX4 sends ATTITUDE every 10 ms, LOCAL_POSITION_NED every 33 ms
MERE_CLOCKS = frozenset({"ATTITUDE", "LOCAL_POSITION_NED"})
"""Nothing else is read of them."""
MESSAGES = ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE", "SYSTEM_TIME")
"""Those whose time_boot_ms is the time at which they were sent."""


class Reading(enum.Enum):
    """What a time means for the clock."""

    FIRST = "the clock is known from now on"
    LATER = "it has moved on"
    SAME = "it has not"
    REBOOTED = "it has begun again"
    DOUBTED = "it has fallen, for the first time: one such message may be a mistake"


@final
class VehicleClock:
    """Vehicle time, seconds since its boot."""

    def __init__(self, start_s: float) -> None:
        """start_s: what stands for the time until it is known."""
        self.now_s = start_s
        self.is_known = False
        self.passed_s = 0.0
        """How long it has been known, all boots together."""
        self._idle_s = 0.0
        self._fallen_s: float | None = None
        self._beat: tuple[float, float, int] | None = None
        """Time, idle time and sequence number at the last heartbeat."""
        self._told_ms: dict[str, int] = {}

    @property
    def going_on_s(self) -> float:
        """Vehicle time with the silence since on top: for what goes on meanwhile."""
        return self.now_s + self._idle_s

    def is_told_by(self, message: Message) -> bool:
        """Whether a mere clock of the autopilot says more than another of its kind did just before.

        That one is remembered.
        """
        kind = message.get_type()
        before_ms = self._told_ms.get(kind)
        if before_ms is not None and 0 <= message.time_boot_ms - before_ms < _OFTEN_MS:
            return False
        self._told_ms[kind] = message.time_boot_ms
        return True

    def read(self, time_s: float) -> Reading:
        """The vehicle says that it is this late."""
        if not self.is_known:
            self.is_known, self.now_s, self._idle_s = True, time_s, 0.0
            return Reading.FIRST
        if time_s < self.now_s - _REBOOT_S:
            before_s, self._fallen_s = self._fallen_s, time_s
            if before_s is None or not 0.0 <= time_s - before_s < _REBOOT_S:
                return Reading.DOUBTED
            self.now_s, self._idle_s, self._fallen_s = time_s, 0.0, None
            return Reading.REBOOTED
        self._fallen_s = None
        return self._later(time_s)

    def beat(self, heartbeat: Message) -> bool:
        """Whether the vehicle lives and no clock of it was heard since the heartbeat before.

        Two heartbeats without a time in between are a second apart, if no more is known; a copy
        has the sequence number of the first.
        """
        before, number = self._beat, heartbeat.get_seq()
        if before is not None and before[2] == number:
            return False
        stands = self.is_known and before is not None and before[0] == self.now_s
        if stands and before is not None:
            self._idle_s = max(self._idle_s, before[1] + _BEAT_S)
        self._beat = (self.now_s, self._idle_s, number)
        return stands

    def be_silent(self, more_s: float, *, counts: bool) -> Reading:
        """It has said nothing for so much longer; counts: before it is known, that is its time."""
        if self.is_known or not counts:
            self._idle_s += more_s
            return Reading.SAME
        return self._later(self.now_s + more_s)

    def _later(self, time_s: float) -> Reading:
        if time_s <= self.now_s:
            return Reading.SAME
        self.passed_s += time_s - self.now_s if self.is_known else 0.0
        self.now_s, self._idle_s = time_s, 0.0
        return Reading.LATER
