"""Message scheduling on each link: default rates, and requested intervals.

Sources: ardupilot.md 1, px4.md 2, and the handlers of SET_MESSAGE_INTERVAL in the two firmwares.
Intervals run on the vehicle's clock.
"""

import heapq
import math
from collections.abc import Mapping, Sequence
from typing import Any, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import (
    Ack,
    Command,
    FirmwareProfile,
    Reply,
    Result,
    SendMessage,
    SendTelemetry,
    Text,
)

GET_MESSAGE_INTERVAL = 510
SET_MESSAGE_INTERVAL = 511
REQUEST_MESSAGE = 512
COMMANDS = frozenset({GET_MESSAGE_INTERVAL, SET_MESSAGE_INTERVAL, REQUEST_MESSAGE})
"""These are answered here and never reach the autopilot."""
FORGOTTEN_US = 60_000
"""Since boot: ArduPilot sets up its streams at its first chance to send and wipes what an earlier
request, acknowledged all the same, has set (ardupilot.md 0, fact 10: 40 ms after the first byte,
which comes 20 ms after the start)."""
NEVER_US = 1 << 62
_HEARTBEAT = 0
_LONGEST_US, _SHORTEST_US = 60_000_000, 1_000
"""Of an interval on ArduPilot (GCS_Common.cpp: kept in 16 bits of milliseconds)."""


@final
class Streams:
    """The table of intervals of every link of one autopilot."""

    def __init__(self, profile: FirmwareProfile) -> None:
        self.soonest_us = NEVER_US
        """Nothing is due before."""
        self._style = profile
        self._is_px4 = profile.firmware == "px4"
        self._intervals_us: dict[tuple[int, int], int] = {}
        """By link and message number; what is not in it is not sent."""
        self._usual_us: dict[tuple[int, int], int] = {}
        """By link and message number, where parameters ask for another default."""
        self._due: list[tuple[int, int, int]] = []
        """A heap of time, message number and link.  Changed entries are rebuilt."""
        self._booted_us: int | None = None

    # --- time ---------------------------------------------------------------------------------

    def set_default(self, link: int, group: int, rate_hz: float) -> None:
        """The default rate of a group of REQUEST_DATA_STREAM on a link that is not open yet."""
        interval_us = round(1e6 / rate_hz) if rate_hz > 0.0 else 0
        for number in self._style.data_streams.get(group, ()):
            self._usual_us[link, number] = interval_us

    def open(self, link: int, now_us: int) -> None:
        """A fresh link: it gets what it has not asked for, at the default rates.

        The first one is opened when the autopilot boots.
        """
        self._booted_us = now_us if self._booted_us is None else self._booted_us
        self._intervals_us = {key: us for key, us in self._intervals_us.items() if key[0] != link}
        usual = {number for on, number in self._usual_us if on == link}
        fresh = {n: self._default_us(link, n) for n in usual.union(self._style.rates_hz)}
        self._set(link, fresh, now_us)
        first_us = self._booted_us + self._style.first_heartbeat_us
        self._due = [
            (first_us if (number, on) == (_HEARTBEAT, link) else due_us, number, on)
            for due_us, number, on in self._due
        ]
        heapq.heapify(self._due)
        self.soonest_us = self._due[0][0] if self._due else NEVER_US

    def begin(self) -> None:
        """Something has been sent: what is asked for from now on is kept."""
        self._booted_us = None

    def due(self, now_us: int) -> list[tuple[int, int]]:
        """Link and message number of what is due, oldest first; each at most once."""
        found = list[tuple[int, int]]()
        heap, intervals_us = self._due, self._intervals_us
        while heap and heap[0][0] <= now_us:
            due_us, number, link = heap[0]
            interval_us = intervals_us[link, number]
            found.append((link, number))
            missed = (now_us - due_us) // interval_us
            heapq.heapreplace(heap, (due_us + (missed + 1) * interval_us, number, link))
        self.soonest_us = heap[0][0] if heap else NEVER_US
        return found

    def interval_us(self, link: int, number: int) -> int | None:
        """Of this message on this link; None if it is not streamed."""
        return self._intervals_us.get((link, number))

    # --- what clients ask for -----------------------------------------------------------------

    def on_command(self, command: Command, now_us: int) -> list[Reply]:
        """Answer a command of COMMANDS."""
        if command.number == SET_MESSAGE_INTERVAL:
            return self._on_set(command, now_us)
        if command.number == GET_MESSAGE_INTERVAL:
            return self._on_get(command)
        return self._on_request(command)

    def on_data_stream(self, message: Any, link: int, now_us: int) -> None:
        """REQUEST_DATA_STREAM: a rate for a whole group.  It is not acknowledged."""
        groups, asked = self._style.data_streams, message.req_stream_id
        if message.start_stop > 1:
            return
        rate_hz = message.req_message_rate if message.start_stop else 0
        members = groups.get(asked, ()) if asked else {n for g in groups.values() for n in g}
        self._set(link, dict.fromkeys(members, round(1e6 / rate_hz) if rate_hz else 0), now_us)

    def _on_set(self, command: Command, now_us: int) -> list[Reply]:
        number, interval_us, *rest = command.parameters
        known = _whole(number)
        refused = _ack(command, Result.FAILED if self._is_px4 else Result.DENIED)
        if self._uses_reserved(rest):
            return [refused]
        if known not in self._style.streamable:
            text = Text(severity=6, text=f"No ap_message for mavlink id ({known})")
            return [refused] if self._is_px4 else [text, refused]
        wanted_us = self._wanted_us(command.sender.link, known, interval_us)
        if wanted_us is None:
            return [_ack(command, Result.FAILED)]
        began_us = self._booted_us
        if self._is_px4 or began_us is None or now_us - began_us >= FORGOTTEN_US:
            self._set(command.sender.link, {known: wanted_us}, now_us)
        return [_ack(command, Result.ACCEPTED)]

    def _uses_reserved(self, rest: Sequence[float]) -> bool:
        """Whether one of p3 to p7 is used that must be zero; to PX4, NaN is zero."""
        if not self._is_px4:
            return rest[0] != 0
        return any(not math.isnan(value) and abs(value) >= 0.5 for value in (*rest[:2], rest[4]))

    def _wanted_us(self, link: int, number: int, interval_us: float) -> int | None:
        """The interval that is meant; 0 is none at all, None is an error."""
        if not math.isfinite(interval_us):
            return None
        if self._is_px4:
            if abs(interval_us) < 1e-5:
                return self._default_us(link, number)
            return max(1, round(interval_us)) if interval_us > 0 else 0
        whole_us = int(interval_us)
        if whole_us == 0:
            return self._default_us(link, number)
        if whole_us == -1:
            return 0
        return min(max(whole_us // 1000 * 1000, _SHORTEST_US), _LONGEST_US)

    def _on_get(self, command: Command) -> list[Reply]:
        number = _whole(command.parameters[0])
        interval_us = self.interval_us(command.sender.link, number)
        known = number in self._style.streamable
        if interval_us is None:
            interval_us = -1 if known and not self._is_px4 else 0
        shown = number & 0xFFFF  # the field has 16 bits
        message = mavlink.MAVLink_message_interval_message(shown, interval_us)
        result = Result.ACCEPTED if known or self._is_px4 else Result.FAILED
        return [SendMessage(message=message, to=command.sender), _ack(command, result)]

    def _on_request(self, command: Command) -> list[Reply]:
        number = _whole(command.parameters[0])
        if number not in self._style.requestable:
            return [_ack(command, Result.DENIED if self._is_px4 else Result.FAILED)]
        send, ack = SendTelemetry(message=number, to=command.sender), _ack(command, Result.ACCEPTED)
        return [send, ack] if self._is_px4 else [ack, send]  # as in the recorded flights

    # --- the table ----------------------------------------------------------------------------

    def _default_us(self, link: int, number: int) -> int:
        rate_hz = self._style.rates_hz.get(number, 0.0)
        return self._usual_us.get((link, number), round(1e6 / rate_hz) if rate_hz else 0)

    def _set(self, link: int, wanted_us: Mapping[int, int], now_us: int) -> None:
        """Intervals by message number, 0 for none: each is first due one interval from now.

        What stays as it is keeps its phase: clients ask for the same again and again.
        """
        intervals_us = self._intervals_us
        changed = {
            (link, number): us
            for number, us in wanted_us.items()
            if us != intervals_us.get((link, number), 0)
        }
        self._intervals_us = {key: us for key, us in (intervals_us | changed).items() if us}
        kept = self._intervals_us.keys() - changed
        self._due = [each for each in self._due if (each[2], each[1]) in kept]
        self._due += [(now_us + us, number, link) for (_, number), us in changed.items() if us]
        heapq.heapify(self._due)
        self.soonest_us = self._due[0][0] if self._due else NEVER_US


def _ack(command: Command, result: int) -> Ack:
    return Ack(to=command.sender, command=command.number, result=result)


def _whole(value: float) -> int:
    """A message number that came as a float; -1 for what cannot be one."""
    return round(value) if 0 <= value < 1 << 24 else -1
