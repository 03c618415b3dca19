"""Requests the message streams that a flight needs, and repeats the requests.

A request may get lost (ardupilot.md 0: one in the first 60 ms after boot is acknowledged and
dropped), a reboot clears them all, and ACKs are not reliable (mavlink.md C3): only the arrival of
the message counts.
"""

import math
from collections.abc import Mapping
from typing import final

from companion.mavlink.autopilots import Autopilot
from companion.mavlink.autopilots.messages import command_long
from companion.mavlink.dialect import Message, wire

_LOOK_S = 2.0
_ENOUGH = 0.5  # of what was asked for: the rest may have been lost
_QUIET_S = 10.0  # between requests of what may well have nothing to say


@final
class StreamRequests:
    """The stream requests to one autopilot, and the messages received.  Sans-IO."""

    def __init__(
        self,
        system_id: int,
        autopilot: Autopilot,
        position_rate_hz: float,
        more_hz: Mapping[int, float],
    ) -> None:
        """more_hz: what else the mission needs, by message number."""
        self._system_id, self._autopilot = system_id, autopilot
        self._wanted_hz = {
            wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: position_rate_hz,
            **autopilot.streams_hz,
            **more_hz,
        }
        self._quiet = autopilot.intermittent | {wire.MAVLINK_MSG_ID_DISTANCE_SENSOR}
        self.count: dict[int, int] = {}
        """How often each message was received since the autopilot booted; counted by the caller."""
        self._before: dict[int, int] = {}
        """The same when it was last looked at."""
        self._asked_s: dict[int, float] = {}
        self._looked_s = -math.inf
        self._wanted = False

    def begin(self, now_s: float) -> list[Message]:
        """Request everything that is not streamed by default."""
        self._wanted, self._looked_s, self._before = True, now_s, dict(self.count)
        self._asked_s = dict.fromkeys(self._wanted_hz, now_s)
        asked = [self._request(each, rate_hz) for each, rate_hz in self._wanted_hz.items()]
        return asked + self._once()

    def forget(self) -> None:
        """The autopilot has rebooted: all requests are void."""
        self.count, self._before, self._asked_s, self._looked_s = {}, {}, {}, -math.inf

    def rebase_time(self, shift_s: float) -> None:
        """Shift all stored times by this much: the clock was replaced."""
        self._looked_s += shift_s
        self._asked_s = {key: at_s + shift_s for key, at_s in self._asked_s.items()}

    @property
    def due_s(self) -> float:
        """When they are looked at again, at the latest."""
        return self._looked_s + _LOOK_S if self._wanted else math.inf

    def on_time(self, now_s: float) -> list[Message]:
        """Requests for messages that are missing or too slow, every two seconds."""
        since_s = now_s - self._looked_s
        if not self._wanted or since_s < _LOOK_S:
            return []
        self._looked_s = now_s
        asked = [
            self._request(message_id, rate_hz)
            for message_id, rate_hz in self._wanted_hz.items()
            if self._is_missing(message_id, rate_hz, since_s, now_s)
        ]
        self._before = dict(self.count)
        return asked + self._once()

    def _once(self) -> list[Message]:
        """Requests for what is never streamed, until it has come."""
        return [
            self._command(wire.MAV_CMD_REQUEST_MESSAGE, message_id)
            for message_id in self._autopilot.requested_once
            if message_id not in self.count
        ]

    @property
    def missing(self) -> list[str]:
        """Names of requested messages that never came."""
        return [
            wire.mavlink_map[message_id].msgname
            for message_id in self._wanted_hz
            if message_id not in self.count and message_id not in self._quiet
        ]

    def _is_missing(self, message_id: int, rate_hz: float, since_s: float, now_s: float) -> bool:
        expected = _ENOUGH * rate_hz * min(since_s, _LOOK_S)
        came = self.count.get(message_id, 0) - self._before.get(message_id, 0)
        if came >= max(expected, 1.0):
            return False
        again_s = _QUIET_S if message_id in self._quiet else _LOOK_S
        if now_s - self._asked_s.get(message_id, -math.inf) < again_s:
            return False
        self._asked_s[message_id] = now_s
        return True

    def _request(self, message_id: int, rate_hz: float) -> Message:
        return self._command(wire.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e6 / rate_hz)

    def _command(self, command: int, *parameters: float) -> Message:
        return command_long(self._system_id, command, *parameters)
