"""Message scheduling on each link: default rates, and requested intervals.

Sources: ardupilot.md 1, px4.md 2, and the handlers of SET_MESSAGE_INTERVAL in the two firmwares.
Intervals run on the vehicle's clock.
"""

import heapq
import math
from collections.abc import Iterable, Mapping
from typing import Any, Final, final

from vehicle_sim.autopilot.core import Firmware
from vehicle_sim.autopilot.values import (
    Ack,
    Command,
    Reply,
    Result,
    SendTelemetry,
    Text,
)
from vehicle_sim.parameters import Parameters

_SET_MESSAGE_INTERVAL, _REQUEST_MESSAGE = 511, 512
COMMANDS = frozenset({_SET_MESSAGE_INTERVAL, _REQUEST_MESSAGE})
"""These are answered here and never reach the autopilot."""
NEVER_US = 1 << 62
_HEARTBEAT: Final = 0
_LONGEST_MS: Final = 60_000
"""Of an interval on ArduPilot (GCS_Common.cpp: kept in 16 bits of milliseconds)."""
_PARAMETERS = {2: "EXT_STAT", 6: "POSITION", 10: "EXTRA1", 11: "EXTRA2", 12: "EXTRA3"}
"""By group of REQUEST_DATA_STREAM what the parameter of its rate is called after "MAV1_"."""


@final
class Streams:
    """The table of intervals of every link of one autopilot, which boots now.

    A link has the default rates, or those of parameters.
    """

    def __init__(
        self, profile: Firmware, parameters: Parameters, links: Iterable[int], now_us: int
    ) -> None:
        self.soonest_us = NEVER_US
        """Nothing is due before."""
        self._profile = profile
        self._is_px4 = profile.family == "px4"
        self._usual_us: dict[tuple[int, int], int] = {}
        """By link and message number: of a link that was not asked for anything."""
        self._intervals_us: dict[tuple[int, int], int] = {}
        """The same as it is now; what is not in it is not sent."""
        self._due: list[tuple[int, int, int]] = []
        """A heap of time, message number and link."""
        for link in links:
            usual_us = {number: _interval_us(hz) for number, hz in profile.rates_hz.items()}
            for group, part in _PARAMETERS.items():
                name = f"MAV{link + 1}_{part}"
                if name in parameters and parameters[name] != parameters.rows[name].default:
                    members = profile.data_streams[group]
                    usual_us |= dict.fromkeys(members, _interval_us(parameters[name]))
            self._usual_us |= {(link, number): us for number, us in usual_us.items()}
            self._set(link, usual_us, now_us)
            first = (now_us + profile.first_heartbeat_us, _HEARTBEAT, link)
            self._schedule([first, *(each for each in self._due if each[1:] != first[1:])])

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
        (number, asked_us, *_), sender, profile = command.parameters, command.sender, self._profile
        accepted = Ack(to=sender, command=command.number, result=Result.ACCEPTED)
        if command.number == _REQUEST_MESSAGE:
            if number not in profile.requestable:
                refused = Result.DENIED if self._is_px4 else Result.FAILED
                return [Ack(to=sender, command=command.number, result=refused)]
            send = SendTelemetry(message=int(number), to=sender)
            return [send, accepted] if self._is_px4 else [accepted, send]
        if number not in profile.streamable or not math.isfinite(asked_us):
            if self._is_px4:
                return [Ack(to=sender, command=command.number, result=Result.FAILED)]
            text = Text(severity=6, text=f"No ap_message for mavlink id ({number:.0f})")
            return [text, Ack(to=sender, command=command.number, result=Result.DENIED)]
        us = max(round(asked_us), 0)
        if not round(asked_us):
            us = self._usual_us.get((sender.link, int(number)), 0)
        elif us and not self._is_px4:
            us = min(max(us // 1000, 1), _LONGEST_MS) * 1000
        self._set(sender.link, {int(number): us}, now_us)
        return [accepted]

    def on_data_stream(self, message: Any, link: int, now_us: int) -> None:
        """REQUEST_DATA_STREAM: a rate for a whole group, or for all.  It is not acknowledged."""
        rate_hz = message.req_message_rate if message.start_stop else 0
        for group, members in sorted(self._profile.data_streams.items()):
            if message.req_stream_id in (0, group):
                self._set(link, dict.fromkeys(members, _interval_us(rate_hz)), now_us)

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

    def _schedule(self, due: list[tuple[int, int, int]]) -> None:
        self._due = due
        heapq.heapify(due)
        self.soonest_us = due[0][0] if due else NEVER_US


def _interval_us(rate_hz: float) -> int:
    """Of a rate; 0 is none."""
    return round(1e6 / rate_hz) if rate_hz > 0.0 else 0
