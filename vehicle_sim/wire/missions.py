"""The mission protocol: uploads and downloads of missions, fences and rally points.

One server for all autopilots.  A list that comes is stored as it was sent, or refused as a whole,
for an item that nobody here flies, that belongs into another list or is not on earth, and for a
fence of which a part is missing.  The stored list stays until the new one is whole.
"""

import math
import struct
import zlib
from collections.abc import Sequence
from typing import Any, Final, NamedTuple, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.core import Autopilot
from vehicle_sim.autopilot.values import (
    Ack,
    Command,
    Place,
    Reply,
    Sender,
    SendMessage,
    SendTelemetry,
)
from vehicle_sim.plans import FENCE_COMMANDS, PlanItem, PlanKind, is_whole_fence
from vehicle_sim.wire.frames import make

_FLOWN: Final = frozenset({16, 17, 19, 20, 21, 22})
"""What missions may do: WAYPOINT, LOITER_UNLIM and _TIME, RETURN_TO_LAUNCH, LAND, TAKEOFF.  Of what
takes no time (from 177, DO_JUMP, on) the rest is skipped."""
_RALLY: Final = frozenset({mavlink.MAV_CMD_NAV_RALLY_POINT})
_OF_LISTS: Final = {
    PlanKind.MISSION: _FLOWN.union(range(177, 1 << 16)) - FENCE_COMMANDS - _RALLY,
    PlanKind.FENCE: FENCE_COMMANDS,
    PlanKind.RALLY: _RALLY,
}
_FRAMES: Final = frozenset({0, 2, 3, 5, 6, 10, 11})
"""The global ones, and that of items without a place."""
_NOWHERE: Final = 0x7FFFFFFF
"""For an angle in degrees that is none."""
_MOST: Final = 724
"""Items of a list: as many as a mission of ArduPilot's holds."""
_ALL_KINDS: Final = 255
_AGAIN_US, _GIVES_UP_US = 1_000_000, 8_000_000
"""Without the item that it waits for it asks again, and gives up: ArduPilot's times
(ardupilot.md 4); PX4's were not measured."""
_GUIDED: Final = 2
"""``current`` of an item that is not for the list: fly there now, as DroneKit says it."""
_WAYPOINT, _DO_REPOSITION, _MISSION_CURRENT = 16, 192, 42
_ACCEPTED, _ERROR = mavlink.MAV_MISSION_ACCEPTED, mavlink.MAV_MISSION_ERROR
_BEFORE_ID: Final = {"MISSION_COUNT": 5, "MISSION_ACK": 4}
"""Bytes of the payload before opaque_id, which came to MAVLink after the dialect."""


@final
class _Upload(NamedTuple):
    """A list on its way from a client."""

    sender: Sender
    kind: PlanKind
    size: int
    items: list[PlanItem]


def opaque_id(items: Sequence[PlanItem]) -> int:
    """PX4's id of a list: a CRC-32 of all items, begun at zero and not inverted.

    Confirmed by the ids in the recorded uploads (px4-offboard-8mps, px4-gps-loss).
    """
    crc = 0
    for item in items:
        head = (item.frame, item.command, item.autocontinue)
        raw = struct.pack("<BHB4fiif", *head, *item.parameters, item.x, item.y, item.z_m)
        crc = zlib.crc32(raw, crc ^ 0xFFFFFFFF) ^ 0xFFFFFFFF
    return crc


def store(autopilot: Autopilot, kind: PlanKind, items: tuple[PlanItem, ...]) -> list[Reply]:
    """Replace a list, and tell the autopilot."""
    autopilot.plans[kind] = items
    return list(autopilot.on_plan(kind))


@final
class Missions:
    """Uploads, one at a time, and downloads of one autopilot's three lists, over all links."""

    MESSAGES: Final = (
        *("MISSION_COUNT", "MISSION_ITEM", "MISSION_ITEM_INT", "MISSION_REQUEST_LIST"),
        *("MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_CLEAR_ALL", "MISSION_SET_CURRENT"),
    )

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot, self._plans = autopilot, autopilot.plans
        self._upload: _Upload | None = None
        self._asked_us = self._heard_us = 0
        """When it asked last, and when what it waited for came."""
        self._last: tuple[Sender, PlanKind, int] | None = None
        """The item that completed the newest upload."""

    def on_message(self, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        """Answer one of MESSAGES."""
        name = message.get_type()
        if name == "MISSION_SET_CURRENT":
            self._autopilot.jump(message.seq)
            # ground stations take this for the answer
            return [*self._autopilot.taken(), SendTelemetry(_MISSION_CURRENT)]
        number, clears = message.mission_type, name == "MISSION_CLEAR_ALL"
        kinds = [kind for kind in PlanKind if number == kind or (clears and number == _ALL_KINDS)]
        if not kinds:
            return [_ack(sender, mavlink.MAV_MISSION_UNSUPPORTED, number)]
        kind = kinds[0]
        match name:
            case "MISSION_COUNT":
                return self._on_count(message.count, kind, sender, now_us)
            case "MISSION_ITEM" | "MISSION_ITEM_INT":
                return self._on_item(message, kind, sender, now_us)
            case "MISSION_REQUEST_LIST":
                fields = (len(self._plans[kind]), kind)
                return [_to_client(sender, "MISSION_COUNT", *fields, identity=self._id_of(kind))]
            case "MISSION_REQUEST" | "MISSION_REQUEST_INT":
                return [self._on_request(message, kind, sender)]
            case _:  # MISSION_CLEAR_ALL
                cleared = [reply for kind in kinds for reply in store(self._autopilot, kind, ())]
                return [*cleared, _ack(sender, _ACCEPTED, number)]

    # --- upload -------------------------------------------------------------------------------

    def _on_count(self, count: int, kind: PlanKind, sender: Sender, now_us: int) -> list[Reply]:
        self._upload = self._last = None  # who begins again, or another client, takes its place
        if count > _MOST:
            return [_ack(sender, mavlink.MAV_MISSION_NO_SPACE, kind)]
        if count == 0:
            return self._complete(kind, (), sender)
        self._upload, self._heard_us = _Upload(sender, kind, count, []), now_us
        return self._ask(self._upload, now_us)

    def step(self, now_us: int) -> list[Reply]:
        """Ask again for what did not come, and give up in the end."""
        if self._upload is None or now_us - self._asked_us < _AGAIN_US:
            return []
        if now_us - self._heard_us > _GIVES_UP_US:
            return self._fail(self._upload, mavlink.MAV_MISSION_OPERATION_CANCELLED)
        return self._ask(self._upload, now_us)

    def _ask(self, upload: _Upload, now_us: int) -> list[Reply]:
        """Ask for the next item."""
        self._asked_us = now_us
        asks = "MISSION_REQUEST_INT" if self._autopilot.is_px4 else "MISSION_REQUEST"
        return [_to_client(upload.sender, asks, len(upload.items), upload.kind)]

    def _fail(self, upload: _Upload, why: int) -> list[Reply]:
        """The old list stays."""
        self._upload = None
        return [_ack(upload.sender, why, upload.kind)]

    def _on_item(self, message: Any, kind: PlanKind, sender: Sender, now_us: int) -> list[Reply]:
        upload, item, this = self._upload, _read(message, kind), (sender, kind, message.seq)
        if message.current == _GUIDED and isinstance(item, PlanItem):
            to = (-1.0, 0.0, 0.0, math.nan, item.x / 1e7, item.y / 1e7, item.z_m)
            command = Command(sender, 0, _DO_REPOSITION, to, item.frame)
            replies = [
                reply for reply in self._autopilot.on_command(command) if type(reply) is not Ack
            ]
            return [*replies, _ack(sender, _ACCEPTED, kind)]
        if upload is None and this == self._last:  # the acknowledgement was lost
            return [_ack(sender, _ACCEPTED, kind, self._id_of(kind))]
        if upload is None or this[:2] != (upload.sender, upload.kind):
            return [_ack(sender, _ERROR, kind)]
        if message.seq != len(upload.items):  # it comes twice
            return []
        if not isinstance(item, PlanItem):
            return self._fail(upload, item)
        upload.items.append(item)
        self._heard_us = now_us
        if len(upload.items) < upload.size:
            return self._ask(upload, now_us)
        if kind is PlanKind.FENCE and not is_whole_fence(upload.items):
            return self._fail(upload, _ERROR)
        self._upload, self._last = None, this
        return self._complete(kind, tuple(upload.items), sender)

    def _complete(self, kind: PlanKind, items: tuple[PlanItem, ...], sender: Sender) -> list[Reply]:
        stored = store(self._autopilot, kind, items)
        return [*stored, _ack(sender, _ACCEPTED, kind, self._id_of(kind))]

    def _id_of(self, kind: PlanKind) -> int:
        """Of a list; ArduPilot has none."""
        return opaque_id(self._plans[kind]) if self._autopilot.is_px4 else 0

    # --- download -----------------------------------------------------------------------------

    def _on_request(self, message: Any, kind: PlanKind, to: Sender) -> Reply:
        """Any item at any time, in integers or degrees as it is asked for.

        Item 0 of an ArduPilot's mission is home, whatever was uploaded; zero before it is set.
        """
        autopilot, seq, items = self._autopilot, message.seq, self._plans[kind]
        is_mission = kind is PlanKind.MISSION
        if is_mission and seq < autopilot.firmware.first_item:
            home = autopilot.home or Place(0.0, 0.0, 0.0)
            x, y = round(home.latitude_deg * 1e7), round(home.longitude_deg * 1e7)
            items = (PlanItem(frame=0, command=_WAYPOINT, x=x, y=y, z_m=home.altitude_amsl_m),)
        if seq >= len(items):
            return _ack(to, mavlink.MAV_MISSION_INVALID_SEQUENCE, kind)
        item, whole = items[seq], message.get_type() == "MISSION_REQUEST_INT"
        current = is_mission and seq == autopilot.route.current
        return _to_client(
            to,
            "MISSION_ITEM_INT" if whole else "MISSION_ITEM",
            *(seq, item.frame, item.command, current, item.autocontinue, *item.parameters),
            *((item.x, item.y) if whole else (item.x * 1e-7, item.y * 1e-7)),
            *(item.z_m, kind),
        )


def _to_client(to: Sender, name: str, *fields: float, identity: int = 0) -> SendMessage:
    """A message of the mission protocol: what comes after its target."""
    number, payload = make(name, to.system, to.component, *fields)
    if identity:
        payload = payload[: _BEFORE_ID[name]] + identity.to_bytes(4, "little")
    return SendMessage((number, payload), to)


def _ack(to: Sender, result: int, kind: int, identity: int = 0) -> SendMessage:
    return _to_client(to, "MISSION_ACK", result, kind, identity=identity)


def _read(message: Any, kind: PlanKind) -> PlanItem | int:
    """A MISSION_ITEM_INT, or a MISSION_ITEM with its place in degrees; or why it is refused."""
    command, x, y = message.command, message.x, message.y
    if command not in _OF_LISTS[kind]:
        return mavlink.MAV_MISSION_UNSUPPORTED
    if message.frame not in _FRAMES:
        return mavlink.MAV_MISSION_UNSUPPORTED_FRAME
    if message.get_type() == "MISSION_ITEM":
        x, y = (round(deg * 1e7) if abs(deg) <= 180.0 else _NOWHERE for deg in (x, y))
    has_place = kind is not PlanKind.MISSION or command in _FLOWN
    if has_place and not (abs(x) <= 90e7 and abs(y) <= 180e7):
        return mavlink.MAV_MISSION_INVALID
    return PlanItem(
        frame=message.frame,
        command=command,
        parameters=(message.param1, message.param2, message.param3, message.param4),
        x=x,
        y=y,
        z_m=message.z,
        autocontinue=bool(message.autocontinue),
    )
