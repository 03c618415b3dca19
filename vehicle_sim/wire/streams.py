"""Message scheduling on each link: default rates, and requested intervals.

Sources: ardupilot.md 1, px4.md 2, and the handlers of SET_MESSAGE_INTERVAL in the two firmwares.
Intervals run on the vehicle's clock.
"""

import heapq
import math
from collections.abc import Iterable
from typing import Any, Final, final

from vehicle_sim.autopilot.core import Firmware
from vehicle_sim.autopilot.values import Ack, Command, Reply, Result, Sender, SendTelemetry

_SET_MESSAGE_INTERVAL, _REQUEST_MESSAGE = 511, 512
NEVER_US = 1 << 62
_HEARTBEAT: Final = 0


@final
class Streams:
    """What is due when on every link of one autopilot, which boots now."""

    COMMANDS: Final = (_SET_MESSAGE_INTERVAL, _REQUEST_MESSAGE)
    """These are answered here and never reach the autopilot."""

    def __init__(self, firmware: Firmware, links: Iterable[int], now_us: int) -> None:
        self._firmware, self._is_px4 = firmware, firmware.family == "px4"
        self._usual_us = {number: _interval_us(hz) for number, hz in firmware.rates_hz.items()}
        """By message number: of a link that was not asked for anything."""
        first_us = self._usual_us | {_HEARTBEAT: firmware.first_heartbeat_us}
        self._heap = [
            (now_us + first_us[number], number, link, interval_us)
            for link in links
            for number, interval_us in self._usual_us.items()
        ]
        """When it is due, message number, link and interval of all that is sent."""
        self._order()

    def _order(self) -> None:
        heapq.heapify(self._heap)
        self.soonest_us = self._heap[0][0] if self._heap else NEVER_US
        """Nothing is due before."""

    def due(self, now_us: int) -> list[tuple[int, int]]:
        """Link and message number of what is due, oldest first; each at most once."""
        due, heap = list[tuple[int, int]](), self._heap
        while heap and heap[0][0] <= now_us:
            due_us, number, link, interval_us = heap[0]
            due.append((link, number))
            missed = (now_us - due_us) // interval_us
            due_us += (missed + 1) * interval_us
            heapq.heapreplace(heap, (due_us, number, link, interval_us))
        self.soonest_us = heap[0][0] if heap else NEVER_US
        return due

    def interval_us(self, link: int, number: int) -> int:
        """Of this message on this link; 0 if it is not streamed."""
        return next((us for _, *what, us in self._heap if what == [number, link]), 0)

    def _set(self, link: int, number: int, interval_us: int, now_us: int) -> None:
        """0 for none: it is first due one interval from now.

        What stays as it is keeps its phase: clients ask for the same again and again.
        """
        if interval_us != self.interval_us(link, number):
            self._heap = [entry for entry in self._heap if entry[1:3] != (number, link)]
            if interval_us:
                self._heap.append((now_us + interval_us, number, link, interval_us))
            self._order()

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
        self._set(to.link, int(number), us, now_us)
        return [accepted]

    def on_data_stream(self, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        """REQUEST_DATA_STREAM: a rate for a whole group, or for all.  It is not acknowledged."""
        rate_hz = message.req_message_rate if message.start_stop else 0
        for group, members in self._firmware.data_streams.items():
            if message.req_stream_id in (0, group):
                for number in members:
                    self._set(sender.link, number, _interval_us(rate_hz), now_us)
        return []


def _interval_us(rate_hz: float) -> int:
    """Of a rate; 0 is none."""
    return round(1e6 / rate_hz) if rate_hz > 0.0 else 0
