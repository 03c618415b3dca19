"""A ground station that draws fences: the mission protocol on a socket, none of our own code."""

import contextlib
import math
import socket
import threading
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any, final

from pymavlink.dialects.v20 import common as wire
from pyproj import Geod

_PATIENCE_S = 30.0
_POLL_S = 0.5
_FENCE = wire.MAV_MISSION_TYPE_FENCE
_INCLUSION = wire.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
_EXCLUSION = wire.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION
_POSITION = wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_GEOD = Geod(ellps="WGS84")

Place = tuple[float, float]


@final
@dataclass(frozen=True, kw_only=True)
class Circle:
    """Never to be entered: metres from the origin."""

    north_m: float
    east_m: float
    radius_m: float


@final
@dataclass(frozen=True, kw_only=True)
class Box:
    """Never to be left: metres from the origin."""

    south_m: float
    north_m: float
    west_m: float
    east_m: float

    @property
    def corners(self) -> list[Place]:
        """In order around it."""
        return [
            (self.south_m, self.west_m),
            (self.south_m, self.east_m),
            (self.north_m, self.east_m),
            (self.north_m, self.west_m),
        ]


@final
class GroundStation:
    """Connects to a vehicle that listens on a port of loopback."""

    def __init__(self, port: int, origin_deg: Place) -> None:
        self._origin_deg = origin_deg
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(_POLL_S)
        self._socket.connect(("127.0.0.1", port))
        self._codec = wire.MAVLink(None, srcSystem=255, srcComponent=190)
        self._codec.robust_parsing = True
        self._heard: list[Any] = []
        self._watcher: threading.Thread | None = None
        self._stop = threading.Event()
        self.vehicle_s = 0.0
        """The vehicle's clock, as far as it is known here."""
        self.error: Exception | None = None
        self._ask()

    def close(self) -> None:
        """Let go of the vehicle."""
        self._stop.set()
        if self._watcher is not None:
            self._watcher.join(_PATIENCE_S)
        self._socket.close()

    def draw(self, inside: Box, circles: Sequence[Circle]) -> None:
        """Upload a fence; returns when the vehicle has taken it."""
        corners = [(_INCLUSION, float(len(inside.corners)), each) for each in inside.corners]
        rounds = [(_EXCLUSION, each.radius_m, (each.north_m, each.east_m)) for each in circles]
        items = corners + rounds
        self._send(wire.MAVLink_mission_count_message(1, 1, len(items), _FENCE))
        kinds = {"MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"}
        while (asked := self._need(kinds, mission_type=_FENCE)).get_type() != "MISSION_ACK":
            command, parameter, place = items[asked.seq]
            head = 1, 1, asked.seq, wire.MAV_FRAME_GLOBAL, command, 0, 1, parameter, 0.0, 0.0, 0.0
            e7 = self._degrees_e7(place)
            self._send(wire.MAVLink_mission_item_int_message(*head, *e7, 0.0, _FENCE))
        assert asked.type == wire.MAV_MISSION_ACCEPTED, asked

    def when_near(self, place: Place, within_m: float, act: Callable[[], None]) -> None:
        """Do something, once, when the vehicle is in the air and comes near a place."""
        self._watcher = threading.Thread(target=self._watch, args=(place, within_m, act))
        self._watcher.start()

    def _watch(self, place: Place, within_m: float, act: Callable[[], None]) -> None:
        latitude_e7, longitude_e7 = self._degrees_e7(place)
        self._ask()
        try:
            while not self._stop.is_set():
                here = self._next({"GLOBAL_POSITION_INT"})
                if here is None:
                    self._ask()
                    continue
                at = (longitude_e7 * 1e-7, latitude_e7 * 1e-7, here.lon * 1e-7, here.lat * 1e-7)
                if here.relative_alt > 10_000 and _GEOD.inv(*at)[2] < within_m:
                    return act()
        except (AssertionError, OSError) as error:
            self.error = error

    def _ask(self) -> None:
        """Say that somebody is here, and ask for positions."""
        self._send(wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        values = _POSITION, 1e5, 0.0, 0.0, 0.0, 0.0, 0.0
        interval = wire.MAV_CMD_SET_MESSAGE_INTERVAL
        self._send(wire.MAVLink_command_long_message(1, 1, interval, 0, *values))

    def _need(self, kinds: Collection[str], **match: int) -> Any:
        give_up_s = time.monotonic() + _PATIENCE_S
        while time.monotonic() < give_up_s:
            message = self._next(kinds)
            if message and all(getattr(message, key) == value for key, value in match.items()):
                return message
        raise AssertionError(f"the vehicle sent no {' or '.join(kinds)}")

    def _next(self, kinds: Collection[str]) -> Any:
        """The next message of these kinds; None: none for a while."""
        give_up_s = time.monotonic() + _POLL_S
        while time.monotonic() < give_up_s:
            while self._heard:
                message = self._heard.pop(0)
                if message.get_type() == "GLOBAL_POSITION_INT":
                    self.vehicle_s = message.time_boot_ms * 1e-3
                if message.get_type() in kinds:
                    return message
            try:
                self._heard += self._codec.parse_buffer(self._socket.recv(65535)) or []
            except (TimeoutError, ConnectionRefusedError):
                return None
        return None

    def _send(self, message: Any) -> None:
        with contextlib.suppress(ConnectionRefusedError):  # the vehicle has ended
            self._socket.send(message.pack(self._codec))

    def _degrees_e7(self, place: Place) -> tuple[int, int]:
        """Latitude, longitude of metres north and east (azimuthal equidistant frame)."""
        north_m, east_m = place
        azimuth_deg = math.degrees(math.atan2(east_m, north_m))
        latitude, longitude = self._origin_deg
        east, north, _ = _GEOD.fwd(longitude, latitude, azimuth_deg, math.hypot(*place))
        return round(north * 1e7), round(east * 1e7)
