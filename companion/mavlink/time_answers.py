"""Answers to TIMESYNC: a simulator in lockstep waits for each, an autopilot asks now and then."""

from typing import final

from companion.mavlink.dialect import Message, wire

_LOCKSTEP = 50  # in 10 s; an autopilot's own come every 10 s
_EARLY_S = 10.0


@final
class TimeAnswers:
    """What is answered, and how often."""

    def __init__(self) -> None:
        self._count = 0

    def of(self, message: Message) -> Message | None:
        """The answer; None: it is no question."""
        if message.get_type() != "TIMESYNC" or message.tc1 != 0:
            return None
        self._count += 1
        return wire.MAVLink_timesync_message(message.ts1, message.ts1)

    def look_like_lockstep(self, now_s: float) -> bool:
        """Whether somebody asks as often as a simulator that waits; said once."""
        return self._count == _LOCKSTEP and now_s < _EARLY_S
