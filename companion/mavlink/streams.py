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
        return [*map(self._rate, self._wanted_hz), *self._once()]

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
        late = [number for number in self._wanted_hz if self._is_late(number, since_s, now_s)]
        self._asked_s |= dict.fromkeys(late, now_s)
        self._before = dict(self.count)
        return [*map(self._rate, late), *self._once()]

    @property
    def missing(self) -> list[str]:
        """Names of requested messages that never came."""
        return [
            wire.mavlink_map[number].msgname
            for number in self._wanted_hz
            if number not in self.count and number not in self._quiet
        ]

    def _is_late(self, number: int, since_s: float, now_s: float) -> bool:
        """Whether too few have come, and enough time has passed since it was asked for."""
        expected = _ENOUGH * self._wanted_hz[number] * min(since_s, _LOOK_S)
        came = self.count.get(number, 0) - self._before.get(number, 0)
        again_s = _QUIET_S if number in self._quiet else _LOOK_S
        asked_s = self._asked_s.get(number, -math.inf)
        return came < max(expected, 1.0) and now_s - asked_s >= again_s

    def _rate(self, number: int) -> Message:
        interval_us = 1e6 / self._wanted_hz[number]
        command = wire.MAV_CMD_SET_MESSAGE_INTERVAL
        return command_long(self._system_id, command, number, interval_us)

    def _once(self) -> list[Message]:
        """Requests for what is never streamed, until it has come."""
        return [
            command_long(self._system_id, wire.MAV_CMD_REQUEST_MESSAGE, number)
            for number in self._autopilot.requested_once
            if number not in self.count
        ]
