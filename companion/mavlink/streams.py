"""The messages that a flight needs of the autopilot: asked for, and asked for again.

A first request may get lost (ardupilot.md 0: the one in the first 60 ms after boot is acknowledged
and forgotten), a reboot forgets them all, and an acknowledgement is worth nothing (mavlink.md C3):
what counts is whether the message comes.
"""

import math
from typing import final

from companion.mavlink.autopilots import Autopilot
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire

_LOOK_S = 2.0
_ENOUGH = 0.5  # of what was asked for: the rest may have been lost
_QUIET_S = 10.0  # between requests of what may well have nothing to say


@final
class Streams:
    """What has been asked of one autopilot, and what came.  Sans-IO."""

    def __init__(self, system_id: int, autopilot: Autopilot, position_rate_hz: float) -> None:
        self._system_id, self._autopilot = system_id, autopilot
        self._wanted_hz = {
            wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: position_rate_hz,
            **autopilot.streams_hz,
        }
        self._heard: set[int] = set()
        self._count: dict[int, int] = {}
        """How often each has come since it was last looked at."""
        self._asked_s: dict[int, float] = {}
        self._looked_s = -math.inf
        self._wanted = False

    def begin(self, now_s: float) -> list[Message]:
        """Ask for everything that does not come by itself."""
        self._wanted, self._looked_s = True, now_s
        self._count = {}
        self._asked_s = dict.fromkeys(self._wanted_hz, now_s)
        asked = [self._request(each, rate_hz) for each, rate_hz in self._wanted_hz.items()]
        return asked + self._once()

    def forget(self) -> None:
        """The autopilot has rebooted: nothing that was asked for holds any more."""
        self._heard, self._count, self._asked_s, self._looked_s = set(), {}, {}, -math.inf

    def by_another_clock(self, shift_s: float) -> None:
        """Go on by a clock that shows so much more."""
        self._looked_s += shift_s
        self._asked_s = {key: at_s + shift_s for key, at_s in self._asked_s.items()}

    def on_message(self, message: Message) -> None:
        """A message of the autopilot."""
        number = message.get_msgId()
        self._heard.add(number)
        self._count[number] = self._count.get(number, 0) + 1

    def on_time(self, now_s: float) -> list[Message]:
        """Requests for what is missing or comes too seldom, every two seconds."""
        since_s = now_s - self._looked_s
        if not self._wanted or since_s < _LOOK_S:
            return []
        self._looked_s = now_s
        asked = [
            self._request(message_id, rate_hz)
            for message_id, rate_hz in self._wanted_hz.items()
            if self._is_missing(message_id, rate_hz, since_s, now_s)
        ]
        self._count = {}
        return asked + self._once()

    def _once(self) -> list[Message]:
        """Requests for what is never streamed, until it has come."""
        return [
            self._command(wire.MAV_CMD_REQUEST_MESSAGE, message_id)
            for message_id in self._autopilot.asked_once
            if message_id not in self._heard
        ]

    @property
    def missing(self) -> list[str]:
        """Names of what was asked for and never came, for people."""
        quiet = self._autopilot.silent_at_times
        return [
            wire.mavlink_map[message_id].msgname
            for message_id in self._wanted_hz
            if message_id not in self._heard and message_id not in quiet
        ]

    def _is_missing(self, message_id: int, rate_hz: float, since_s: float, now_s: float) -> bool:
        expected = _ENOUGH * rate_hz * min(since_s, _LOOK_S)
        if self._count.get(message_id, 0) >= max(expected, 1.0):
            return False
        again_s = _QUIET_S if message_id in self._autopilot.silent_at_times else _LOOK_S
        if now_s - self._asked_s.get(message_id, -math.inf) < again_s:
            return False
        self._asked_s[message_id] = now_s
        return True

    def _request(self, message_id: int, rate_hz: float) -> Message:
        return self._command(wire.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e6 / rate_hz)

    def _command(self, command: int, *parameters: float) -> Message:
        padded = (*parameters, *([0.0] * (7 - len(parameters))))
        return wire.MAVLink_command_long_message(
            self._system_id, AUTOPILOT_COMPONENT, command, 0, *padded
        )
