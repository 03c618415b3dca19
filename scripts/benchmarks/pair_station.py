"""A ground station on the vehicle's other link: heartbeats, fences, modes, commands."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, final

from pair_processes import number_of
from pymavlink.dialects.v20 import all as wire

from companion.world.threats import CircleZone, Zone
from vehicle_sim.geodesy import LocalFrame

SYSTEM, COMPONENT = 255, 190
PLANNER_COMPONENT = 195
_REQUEST, _REQUEST_INT, _ACK, _COMMAND_ACK, _STATUSTEXT = 40, 51, 47, 77, 253
_READ = frozenset({_REQUEST, _REQUEST_INT, _ACK, _COMMAND_ACK, _STATUSTEXT})
CHATTER = (27, 29, 30, 31, 32, 36, 65, 74, 83, 105, 132, 141, 231, 331, 340)
"""What PX4 streams unasked and no companion of ours listens to: four fifths of all its frames."""
_TELEMETRY = (1, 24, 33, 85, 111, 147, 230, 242, 245)
_HEARTBEAT_S = 1.0
_AGAIN_S = 2.0
_FENCE = 1
_DENIED = 14  # MAV_MISSION_DENIED: somebody else transfers


@final
class Station:
    """Says what a person at a ground station would have it say."""

    def __init__(self, frame: LocalFrame, system: int = 1) -> None:
        self.acks: list[tuple[int, int, int]] = []
        """Component, command and result of every COMMAND_ACK to it."""
        self.texts: list[tuple[int, str]] = []
        """Component and text."""
        self.heard: Counter[int] = Counter()
        self._frame, self._system = frame, system
        self._mav = wire.MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPONENT)
        self._out: list[bytes] = []
        self._items: list[tuple[Any, ...]] | None = None
        self._uploaded: Callable[[], None] | None = None
        self._beat_s = self._asked_s = -math.inf
        self._begin = False

    @property
    def idle(self) -> bool:
        """Whether no upload is under way."""
        return self._items is None

    def say(self, now_s: float) -> list[bytes]:
        """What is to be sent now."""
        if now_s - self._beat_s >= _HEARTBEAT_S:
            self._beat_s = now_s
            self._send(wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        if self._items is not None and (self._begin or now_s - self._asked_s >= _AGAIN_S):
            self._begin, self._asked_s = False, now_s
            self._send(
                wire.MAVLink_mission_count_message(self._system, 1, len(self._items), _FENCE)
            )
        out, self._out = self._out, []
        return out

    def hear(self, frame: bytes) -> None:
        """One frame of the vehicle's, or of what is behind it."""
        number = number_of(frame)
        if number not in _READ:
            return
        for message in self._mav.parse_buffer(frame) or ():
            self.heard[number] += 1
            match message.get_msgId():
                case 40 | 51 if message.mission_type == _FENCE:
                    self._on_request(message.seq)
                case 47 if message.mission_type == _FENCE:
                    self._on_ack(message.type)
                case 77:
                    self.acks.append((message.get_srcComponent(), message.command, message.result))
                case 253:
                    self.texts.append((message.get_srcComponent(), message.text))

    # --- what it does

    def upload(self, zones: Sequence[Zone], uploaded: Callable[[], None]) -> None:
        """Give the vehicle this fence, and say when it has it."""
        self._items = [item for zone in zones for item in self.items_of(zone)]
        self._uploaded, self._begin = uploaded, True

    def command(self, command: int, *parameters: float, component: int = PLANNER_COMPONENT) -> None:
        """COMMAND_LONG to the companion, or to another component of the vehicle."""
        values = [*parameters, *[0.0] * (7 - len(parameters))]
        self._send(wire.MAVLink_command_long_message(self._system, component, command, 0, *values))

    def be_left_alone(self) -> None:
        """Stop all streams of this link but heartbeats and texts."""
        for number in (*CHATTER, *_TELEMETRY):
            self.command(511, float(number), -1.0, component=1)

    def _send(self, message: Any) -> None:
        self._out.append(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256

    def _on_request(self, seq: int) -> None:
        if self._items is not None and seq < len(self._items):
            command, first, latitude, longitude = self._items[seq]
            self._send(
                wire.MAVLink_mission_item_int_message(
                    self._system, 1, seq, 0, command, 0, 1, first, 0.0, 0.0, 0.0,
                    round(latitude * 1e7), round(longitude * 1e7), 0.0, _FENCE,
                )
            )  # fmt: skip

    def _on_ack(self, result: int) -> None:
        if self._items is None or result == _DENIED:
            return
        if result != 0:
            raise AssertionError(f"the vehicle does not take the fence: {result}")
        self._items = None
        if self._uploaded is not None:
            self._uploaded()

    def items_of(self, zone: Zone) -> list[tuple[Any, ...]]:
        """Command, first parameter, latitude and longitude of each item of a zone."""
        if isinstance(zone, CircleZone):
            place = self._frame.to_geographic(zone.north_m, zone.east_m)
            return [(5003 if zone.keep_in else 5004, zone.radius_m, *place)]
        corners = [self._frame.to_geographic(*corner) for corner in zone.vertices_ne_m]
        command = 5001 if zone.keep_in else 5002
        return [(command, float(len(corners)), *corner) for corner in corners]
