"""Vehicle time: the newest time stamp of the autopilot, and how long it has been silent since."""

import enum
from typing import Final, final

from companion.mavlink.dialect import Message, wire

TIME_ONLY_MESSAGES: Final = frozenset(
    {wire.MAVLINK_MSG_ID_ATTITUDE, wire.MAVLINK_MSG_ID_LOCAL_POSITION_NED}
)
"""Messages of which only time_boot_ms is used: not decoded."""
_REBOOT_S = 2.0  # a clock that falls by more has begun again; one that leaps by more is doubted
_BEAT_S = 1.0  # between two heartbeats of an autopilot
_OFTEN_MS = 50  # PX4 sends ATTITUDE every 10 ms, LOCAL_POSITION_NED every 33 ms


class ClockReading(enum.Enum):
    """Effect of a time stamp on the clock."""

    FIRST = "the clock is known from now on"
    LATER = "it has moved on"
    SAME = "it has not"
    REBOOTED = "it has begun again"
    DOUBTED = "it has fallen or leapt, for the first time: one such message may be a mistake"


@final
class VehicleClock:
    """Vehicle time, seconds since its boot."""

    def __init__(self, start_s: float) -> None:
        """start_s: used as the time until it is known."""
        self.now_s = self.going_on_s = start_s
        """What it shows; with the silence since on top: for what goes on meanwhile."""
        self.is_known = False
        self.passed_s = 0.0
        """How long it has been known, all boots together."""
        self._doubted_s: float | None = None
        """The time stamp just before, if it was doubted."""
        self._read_at_s: float | None = None
        """When the newest time stamp arrived."""
        self._beat: tuple[float, float, int] | None = None
        """Time, time with the silence and sequence number at the last heartbeat."""
        self._told_ms: dict[int, int] = {}

    def is_newer(self, number: int, time_boot_ms: int) -> bool:
        """Whether a time-only message is newer than the last one of its kind.

        That one is remembered.
        """
        before_ms = self._told_ms.get(number)
        if before_ms is not None and 0 <= time_boot_ms - before_ms < _OFTEN_MS:
            return False
        self._told_ms[number] = time_boot_ms
        return True

    def believes(self, time_s: float, at_s: float | None = None) -> bool:
        """Whether read() would take this time stamp.

        It fits what has passed by the vehicle's time stamps, by the silence or by the arrival; or
        the one before did not fit either, and this one goes on from it.
        """
        if not self.is_known:
            return True
        passed_s = 0.0 if at_s is None or self._read_at_s is None else at_s - self._read_at_s
        latest_s = max(self.going_on_s, self.now_s + passed_s) + _REBOOT_S
        if self.now_s - _REBOOT_S <= time_s <= latest_s:
            return True
        # Two messages of one stamp, or two copies of one, are one mistake.
        return self._doubted_s is not None and 0.0 < time_s - self._doubted_s < _REBOOT_S

    def read(self, time_s: float, at_s: float | None = None) -> ClockReading:
        """Take a time stamp of the vehicle; at_s: of its arrival, by any monotonic clock."""
        goes_on = self.is_known and 0.0 <= time_s - self.now_s <= _REBOOT_S
        if not goes_on and not self.believes(time_s, at_s):
            self._doubted_s = time_s
            return ClockReading.DOUBTED
        self._doubted_s = None
        before_s = self.now_s
        if self.is_known and before_s - _REBOOT_S <= time_s <= before_s:
            return ClockReading.SAME
        self._read_at_s = at_s
        self.now_s = self.going_on_s = time_s
        if not self.is_known:
            self.is_known = True
            return ClockReading.FIRST
        if time_s < before_s:
            return ClockReading.REBOOTED
        self.passed_s += time_s - before_s
        return ClockReading.LATER

    def beat(self, heartbeat: Message) -> bool:
        """Whether this is a new heartbeat, with no time stamp since the last one.

        Two heartbeats without a time in between are a second apart, if no more is known; a copy
        has the sequence number of the first.
        """
        before, number = self._beat, heartbeat.get_seq()
        if before is not None and before[2] == number:
            return False
        stands = self.is_known and before is not None and before[0] == self.now_s
        if stands and before is not None:
            self.going_on_s = max(self.going_on_s, before[1] + _BEAT_S)
        self._beat = (self.now_s, self.going_on_s, number)
        return stands

    def on_silence(self, more_s: float, *, counts: bool) -> ClockReading:
        """Advance the clock in a silence; counts: also before the vehicle's time is known."""
        if self.is_known or not counts:
            self.going_on_s += more_s
            return ClockReading.SAME
        if more_s <= 0.0:
            return ClockReading.SAME
        self.now_s = self.going_on_s = self.now_s + more_s
        return ClockReading.LATER
