"""Message scheduling on each link: default rates, and requested intervals.

Sources: ardupilot.md 1, px4.md 2, and the handlers of SET_MESSAGE_INTERVAL in the two firmwares.
Intervals run on the vehicle's clock.
"""

import heapq
import math
from collections.abc import Mapping
from typing import Any, final

from vehicle_sim.autopilot.values import (
    Ack,
    Command,
    FirmwareProfile,
    Reply,
    Result,
    SendTelemetry,
    Text,
)
from vehicle_sim.parameters import Parameters

_SET_MESSAGE_INTERVAL, _REQUEST_MESSAGE = 511, 512
COMMANDS = frozenset({_SET_MESSAGE_INTERVAL, _REQUEST_MESSAGE})
"""These are answered here and never reach the autopilot."""
FORGOTTEN_US = 60_000
"""Since boot: ArduPilot sets up its streams at its first chance to send and wipes what an earlier
request, acknowledged all the same, has set (ardupilot.md 0, fact 10: 40 ms after the first byte,
which comes 20 ms after the start)."""
NEVER_US = 1 << 62
_HEARTBEAT, _FIXED_WING = 0, 1
_LONGEST_US, _SHORTEST_US = 60_000_000, 1_000
"""Of an interval on ArduPilot (GCS_Common.cpp: kept in 16 bits of milliseconds)."""
_PARAMETERS = {2: "EXT_STAT", 6: "POSITION", 10: "EXTRA1", 11: "EXTRA2", 12: "EXTRA3"}
"""By group of REQUEST_DATA_STREAM what the parameter of its rate is called after "MAV1_"."""


@final
class Streams:
    """The table of intervals of every link of one autopilot."""

    def __init__(self, profile: FirmwareProfile, parameters: Parameters) -> None:
        self.soonest_us = NEVER_US
        """Nothing is due before."""
        self._style, self._parameters = profile, parameters
        self._is_px4 = profile.firmware == "px4"
        self._usual_us: dict[tuple[int, int], int] = {}
        """By link and message number: of a link that was not asked for anything."""
        self._intervals_us: dict[tuple[int, int], int] = {}
        """The same as it is now; what is not in it is not sent."""
        self._due: list[tuple[int, int, int]] = []
        """A heap of time, message number and link."""
        self._booted_us: int | None = None

    # --- time ---------------------------------------------------------------------------------

    def open(self, link: int, now_us: int) -> None:
        """A link of an autopilot that boots: it has the default rates, or those of parameters."""
        self._booted_us = now_us
        usual_us = {n: round(1e6 / hz) for n, hz in self._style.rates_hz.items()}
        for group, name in self._rates_of(link).items():
            if self._parameters[name] != self._parameters.row(name).default:
                usual_us |= dict.fromkeys(self._members(group), _interval(self._parameters[name]))
        self._usual_us |= {(link, number): us for number, us in usual_us.items()}
        self._set(link, usual_us, now_us)
        first = (now_us + self._style.first_heartbeat_us, _HEARTBEAT, link)
        self._schedule([first, *(each for each in self._due if each[1:] != first[1:])])

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
        number = command.parameters[0]
        whole = round(number) if 0 <= number < 1 << 24 else -1
        if command.number == _SET_MESSAGE_INTERVAL:
            return self._on_set(command, whole, now_us)
        return self._on_request(command, whole)

    def on_data_stream(self, message: Any, link: int, now_us: int) -> None:
        """REQUEST_DATA_STREAM: a rate for a whole group.  It is not acknowledged.

        ArduPilot keeps the rate as a parameter; a plane over a reboot too.  Source:
        GCS_MAVLINK::handle_request_data_stream, persist_streamrates().
        """
        asked, rate_hz = message.req_stream_id, message.req_message_rate
        if message.start_stop > 1:
            return
        rate_hz = rate_hz if message.start_stop else 0
        groups = [asked] if asked else list(self._style.data_streams)
        members = [number for group in groups for number in self._members(group)]
        self._set(link, dict.fromkeys(members, _interval(rate_hz)), now_us)
        parameters, persists = self._parameters, self._style.vehicle_type == _FIXED_WING
        for group, name in self._rates_of(link).items():
            if group in groups:
                (parameters.__setitem__ if persists else parameters.set_until_reboot)(name, rate_hz)

    def _rates_of(self, link: int) -> dict[int, str]:
        """The parameter that has the default rate of each group on this link."""
        names = {group: f"MAV{link + 1}_{part}" for group, part in _PARAMETERS.items()}
        return {group: name for group, name in names.items() if name in self._parameters}

    def _members(self, group: int) -> Any:
        return self._style.data_streams.get(group, ())

    def _on_set(self, command: Command, number: int, now_us: int) -> list[Reply]:
        _, asked_us, p3, p4, _, _, p7 = command.parameters
        link, is_px4 = command.sender.link, self._is_px4
        reserved = any(abs(p) >= 0.5 for p in (p3, p4, p7)) if is_px4 else p3 != 0
        if reserved or number not in self._style.streamable:
            refused = _ack(command, Result.FAILED if is_px4 else Result.DENIED)
            text = Text(severity=6, text=f"No ap_message for mavlink id ({number})")
            return [refused] if reserved or is_px4 else [text, refused]
        if not math.isfinite(asked_us):
            return [_ack(command, Result.FAILED)]
        if abs(asked_us) < (1e-5 if is_px4 else 1.0):
            us = self._usual_us.get((link, number), 0)
        elif is_px4:
            us = max(1, round(asked_us)) if asked_us > 0 else 0
        else:
            whole_us = int(asked_us)
            us = min(max(whole_us // 1000 * 1000, _SHORTEST_US), _LONGEST_US)
            us = 0 if whole_us == -1 else us
        wiped = self._booted_us is not None and now_us - self._booted_us < FORGOTTEN_US
        if is_px4 or not wiped:
            self._set(link, {number: us}, now_us)
        return [_ack(command, Result.ACCEPTED)]

    def _on_request(self, command: Command, number: int) -> list[Reply]:
        if number not in self._style.requestable:
            return [_ack(command, Result.DENIED if self._is_px4 else Result.FAILED)]
        send, ack = SendTelemetry(message=number, to=command.sender), _ack(command, Result.ACCEPTED)
        return [send, ack] if self._is_px4 else [ack, send]  # as in the recorded flights

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


def _interval(rate_hz: float) -> int:
    """In us; 0 is none."""
    return round(1e6 / rate_hz) if rate_hz > 0.0 else 0


def _ack(command: Command, result: int) -> Ack:
    return Ack(to=command.sender, command=command.number, result=result)
