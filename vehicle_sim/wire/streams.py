"""Message scheduling on each link: default rates, and requested intervals.

Sources: ardupilot.md 1, px4.md 2, and the handlers of SET_MESSAGE_INTERVAL in the two firmwares.
Intervals run on the vehicle's clock.
"""

import heapq
import math
from collections.abc import Iterable, Mapping
from typing import Any, Final, final

from vehicle_sim.autopilot.core import Firmware
from vehicle_sim.autopilot.values import Ack, Command, Reply, Result, Sender, SendTelemetry

_SET_MESSAGE_INTERVAL, _REQUEST_MESSAGE = 511, 512
COMMANDS = frozenset({_SET_MESSAGE_INTERVAL, _REQUEST_MESSAGE})
"""These are answered here and never reach the autopilot."""
NEVER_US = 1 << 62
_HEARTBEAT: Final = 0


@final
class Streams:
    """What is due when on every link of one autopilot, which boots now."""

    def __init__(self, firmware: Firmware, links: Iterable[int], now_us: int) -> None:
        self.soonest_us = NEVER_US
        """Nothing is due before."""
        self._firmware, self._is_px4 = firmware, firmware.family == "px4"
        self._usual_us = {number: _interval_us(hz) for number, hz in firmware.rates_hz.items()}
        """By message number: of a link that was not asked for anything."""
        self._intervals_us: dict[tuple[int, int], int] = {}
        """By link and message number; what is not in it is not sent."""
        self._due: list[tuple[int, int, int]] = []
        """A heap of time, message number and link."""
        for link in links:
            self._set(link, self._usual_us, now_us)
        beat_us = now_us + firmware.first_heartbeat_us
        self._schedule((beat_us if n == _HEARTBEAT else us, n, link) for us, n, link in self._due)

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
        """Answer a command of COMMANDS; the answers are in the order of the recorded flights."""
        (number, asked_us, *_), to = command.parameters, command.sender
        is_request, firmware = command.number == _REQUEST_MESSAGE, self._firmware
        known = firmware.requestable if is_request else firmware.streamable
        if number not in known or not (is_request or math.isfinite(asked_us)):
            refused = Result.DENIED if is_request is self._is_px4 else Result.FAILED
            return [Ack(to=to, command=command.number, result=refused)]
        accepted = Ack(to=to, command=command.number, result=Result.ACCEPTED)
        if is_request:
            send = SendTelemetry(message=int(number), to=to)
            return [send, accepted] if self._is_px4 else [accepted, send]
        us = max(round(asked_us), 0)
        if not round(asked_us):
            us = self._usual_us.get(int(number), 0)
        elif us and not self._is_px4:
            us = max(us // 1000, 1) * 1000  # whole milliseconds
        self._set(to.link, {int(number): us}, now_us)
        return [accepted]

    def on_data_stream(self, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        """REQUEST_DATA_STREAM: a rate for a whole group, or for all.  It is not acknowledged."""
        rate_hz = message.req_message_rate if message.start_stop else 0
        for group, members in self._firmware.data_streams.items():
            if message.req_stream_id in (0, group):
                self._set(sender.link, dict.fromkeys(members, _interval_us(rate_hz)), now_us)
        return []

    # --- the table ----------------------------------------------------------------------------

    def _set(self, link: int, wanted_us: Mapping[int, int], now_us: int) -> None:
        """Intervals by message number, 0 for none: each is first due one interval from now.

        What stays as it is keeps its phase: clients ask for the same again and again.
        """
        now = self._intervals_us
        changed = {(link, n): us for n, us in wanted_us.items() if us != now.get((link, n), 0)}
        self._intervals_us = {key: us for key, us in (now | changed).items() if us}
        kept = [each for each in self._due if (each[2], each[1]) not in changed]
        fresh = [(now_us + us, number, link) for (_, number), us in changed.items() if us]
        self._schedule([*kept, *fresh])

    def _schedule(self, due: Iterable[tuple[int, int, int]]) -> None:
        self._due = list(due)
        heapq.heapify(self._due)
        self.soonest_us = self._due[0][0] if self._due else NEVER_US


def _interval_us(rate_hz: float) -> int:
    """Of a rate; 0 is none."""
    return round(1e6 / rate_hz) if rate_hz > 0.0 else 0
