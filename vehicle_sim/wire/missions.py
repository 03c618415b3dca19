"""The mission protocol: uploads and downloads of missions, fences and rally points.

One server for all autopilots.  A list that comes is stored as it was sent, or refused as a whole:
with UNSUPPORTED for an item that nobody here flies or that belongs into another list,
UNSUPPORTED_FRAME, INVALID for a place that is not on earth, NO_SPACE, DENIED while somebody else
uploads, ERROR for a fence of which a part is missing.  The stored list stays until the new one is
whole.  Of the firmwares' own ways three are left, because clients rely on them: which request asks
for an item, that item 0 of ArduPilot's mission is home, and PX4's id of a list.
"""

import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import (
    Ack,
    Autopilot,
    Command,
    Reply,
    Sender,
    SendMessage,
    SendTelemetry,
)
from vehicle_sim.plans import (
    CIRCLE_IN,
    CIRCLE_OUT,
    DO_JUMP,
    POLYGON_IN,
    POLYGON_OUT,
    PlanItem,
    PlanKind,
)
from vehicle_sim.wire.frames import make

_FLOWN: Final = frozenset({16, 17, 19, 20, 21, 22})
"""What missions may do: WAYPOINT, LOITER_UNLIM and _TIME, RETURN_TO_LAUNCH, LAND, TAKEOFF.  Of what
takes no time (from DO_JUMP on) the rest is skipped."""
_CIRCLES: Final = frozenset({CIRCLE_IN, CIRCLE_OUT})
_POLYGONS: Final = frozenset({POLYGON_IN, POLYGON_OUT})
_OF_LISTS: Final = {
    PlanKind.FENCE: _POLYGONS | _CIRCLES | {mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT},
    PlanKind.RALLY: frozenset({mavlink.MAV_CMD_NAV_RALLY_POINT}),
}
_GLOBAL_FRAMES: Final = frozenset({0, 3, 5, 6, 10, 11})
_MOST: Final = {PlanKind.MISSION: 724, PlanKind.FENCE: 255, PlanKind.RALLY: 100}
"""As many as ArduPilot holds."""
_ALL_KINDS: Final = 255
_GUIDED: Final = 2
"""``current`` of an item that is not for the list: fly there now, as DroneKit says it."""
_ASK_AGAIN_US, _GIVE_UP_US = 500_000, 5_000_000
_LATITUDE_MAX_E7, _LONGITUDE_MAX_E7 = 900_000_000, 1_800_000_000
_DO_REPOSITION, _DO_SET_MISSION_CURRENT, _MISSION_CURRENT = 192, 224, 42


@final
@dataclass(slots=True, kw_only=True)
class _Upload:
    """A list on its way from a client."""

    sender: Sender
    count: int
    heard_us: int
    asked_us: int
    items: list[PlanItem] = field(default_factory=list)

    def is_from(self, sender: Sender) -> bool:
        """Whether this is who uploads; on which link does not matter."""
        return (sender.system, sender.component) == (self.sender.system, self.sender.component)


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
    """Uploads and downloads of one autopilot's three lists, over all links."""

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot, self._plans = autopilot, autopilot.plans
        self._is_px4 = autopilot.profile.firmware == "px4"
        self._uploads: dict[PlanKind, _Upload] = {}
        self._done: dict[PlanKind, _Upload] = {}
        """The last ones that ended well: their acknowledgement may have been lost."""

    @property
    def busy(self) -> bool:
        """Whether step() has anything to do."""
        return bool(self._uploads)

    def on_message(self, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        """Answer a message of the mission protocol that is for the autopilot."""
        name = message.get_type()
        if name == "MISSION_SET_CURRENT":
            told = SendTelemetry(message=_MISSION_CURRENT)  # ground stations take it for the answer
            return [*self._do(_DO_SET_MISSION_CURRENT, sender, float(message.seq)), told]
        if name in ("MISSION_ITEM", "MISSION_ITEM_INT") and message.current == _GUIDED:
            return self._on_guided(message, sender)
        if name == "MISSION_CLEAR_ALL" and message.mission_type == _ALL_KINDS:
            cleared = [reply for kind in PlanKind for reply in store(self._autopilot, kind, ())]
            return [*cleared, self._ack(mavlink.MAV_MISSION_ACCEPTED, _ALL_KINDS, sender)]
        if message.mission_type not in PlanKind.__members__.values():
            return [self._ack(mavlink.MAV_MISSION_UNSUPPORTED, message.mission_type, sender)]
        kind = PlanKind(message.mission_type)
        match name:
            case "MISSION_COUNT":
                return self._on_count(message.count, kind, sender, now_us)
            case "MISSION_ITEM" | "MISSION_ITEM_INT":
                return self._on_item(message, kind, sender, now_us)
            case "MISSION_REQUEST_LIST":
                count, list_id = len(self._plans[kind]), self._id_of(kind)
                fields = {"count": count, "mission_type": kind, "opaque_id": list_id}
                return [_said(sender, "MISSION_COUNT", **fields)]
            case "MISSION_REQUEST" | "MISSION_REQUEST_INT":
                return [self._item(message, kind, sender)]
            case "MISSION_CLEAR_ALL":
                return self._complete(kind, (), sender)
            case _:
                return []

    def step(self, now_us: int) -> list[Reply]:
        """Ask again for what did not come, and give up in the end."""
        answers = list[Reply]()
        for kind, upload in list(self._uploads.items()):
            if now_us - upload.heard_us > _GIVE_UP_US:
                del self._uploads[kind]
                given_up = mavlink.MAV_MISSION_OPERATION_CANCELLED
                answers.append(self._ack(given_up, kind, upload.sender))
            elif now_us - upload.asked_us > _ASK_AGAIN_US:
                answers.append(self._ask(kind, upload, now_us))
        return answers

    # --- upload -------------------------------------------------------------------------------

    def _on_count(self, count: int, kind: PlanKind, sender: Sender, now_us: int) -> list[Reply]:
        running = self._uploads.get(kind)
        if running is not None and not running.is_from(sender):
            return [self._ack(mavlink.MAV_MISSION_DENIED, kind, sender)]
        self._uploads.pop(kind, None)  # the same client may begin again
        self._done.pop(kind, None)
        if count > _MOST[kind]:
            return [self._ack(mavlink.MAV_MISSION_NO_SPACE, kind, sender)]
        if count == 0:
            return self._complete(kind, (), sender)
        upload = _Upload(sender=sender, count=count, heard_us=now_us, asked_us=now_us)
        self._uploads[kind] = upload
        return [self._ask(kind, upload, now_us)]

    def _ask(self, kind: PlanKind, upload: _Upload, now_us: int) -> Reply:
        """Ask for the next item."""
        upload.asked_us = now_us
        name = "MISSION_REQUEST_INT" if self._is_px4 else "MISSION_REQUEST"
        return _said(upload.sender, name, seq=len(upload.items), mission_type=kind)

    def _on_item(self, message: Any, kind: PlanKind, sender: Sender, now_us: int) -> list[Reply]:
        upload = self._uploads.get(kind)
        if upload is None:
            done = self._done.get(kind)
            again = done is not None and done.is_from(sender) and message.seq == done.count - 1
            result = mavlink.MAV_MISSION_ACCEPTED if again else mavlink.MAV_MISSION_ERROR
            return [self._ack(result, kind, sender)]
        if not upload.is_from(sender):
            return [self._ack(mavlink.MAV_MISSION_DENIED, kind, sender)]
        if message.seq != len(upload.items):
            return []  # the right one will be asked for again
        item = _read(message, kind)
        if not isinstance(item, PlanItem):
            del self._uploads[kind]
            return [self._ack(item, kind, sender)]
        upload.items.append(item)
        upload.heard_us = now_us
        if len(upload.items) < upload.count:
            return [self._ask(kind, upload, now_us)]
        del self._uploads[kind]
        if kind is PlanKind.FENCE and not _is_whole(upload.items):
            return [self._ack(mavlink.MAV_MISSION_ERROR, kind, sender)]
        self._done[kind] = upload
        return self._complete(kind, tuple(upload.items), sender)

    def _complete(self, kind: PlanKind, items: tuple[PlanItem, ...], sender: Sender) -> list[Reply]:
        stored = store(self._autopilot, kind, items)
        return [*stored, self._ack(mavlink.MAV_MISSION_ACCEPTED, kind, sender)]

    def _ack(self, result: int, kind: int, to: Sender) -> Reply:
        """How it ended, a MAV_MISSION_RESULT; the kind may be one that there is not."""
        accepted = result == mavlink.MAV_MISSION_ACCEPTED and kind in _MOST
        list_id = self._id_of(PlanKind(kind)) if accepted else 0
        return _said(to, "MISSION_ACK", type=result, mission_type=kind, opaque_id=list_id)

    def _id_of(self, kind: PlanKind) -> int:
        return opaque_id(self._plans[kind]) if self._is_px4 else 0

    # --- download, and what is not for a list -------------------------------------------------

    def _item(self, message: Any, kind: PlanKind, to: Sender) -> Reply:
        """Any item at any time, in integers or degrees as it is asked for."""
        seq, items = message.seq, self._plans[kind]
        is_mission = kind is PlanKind.MISSION
        if is_mission and seq == 0 and not self._is_px4:
            item = self._home_item()
        elif seq < len(items):
            item = items[seq]
        else:
            return self._ack(mavlink.MAV_MISSION_INVALID_SEQUENCE, kind, to)
        whole = message.get_type() == "MISSION_REQUEST_INT"
        p1, p2, p3, p4 = item.parameters
        return _said(
            to,
            "MISSION_ITEM_INT" if whole else "MISSION_ITEM",
            seq=seq,
            frame=item.frame,
            command=item.command,
            current=is_mission and seq == self._autopilot.status().mission_current,
            autocontinue=item.autocontinue,
            param1=p1,
            param2=p2,
            param3=p3,
            param4=p4,
            x=item.x if whole else item.x * 1e-7,
            y=item.y if whole else item.y * 1e-7,
            z=item.z_m,
            mission_type=kind,
        )

    def _home_item(self) -> PlanItem:
        """Item 0 of ArduPilot's mission, not what was uploaded; zero before home is set."""
        home = self._autopilot.home
        if home is None:
            return PlanItem(frame=0, command=mavlink.MAV_CMD_NAV_WAYPOINT)
        return PlanItem(
            frame=0,
            command=mavlink.MAV_CMD_NAV_WAYPOINT,
            x=round(home.latitude_deg * 1e7),
            y=round(home.longitude_deg * 1e7),
            z_m=home.altitude_amsl_m,
        )

    def _on_guided(self, message: Any, sender: Sender) -> list[Reply]:
        """A waypoint to fly to now."""
        item, kind = _read(message, PlanKind.MISSION), PlanKind.MISSION
        if not isinstance(item, PlanItem):
            return [self._ack(item, kind, sender)]
        to = (-1.0, 0.0, 0.0, math.nan, item.x / 1e7, item.y / 1e7, item.z_m)
        done = self._do(_DO_REPOSITION, sender, *to, frame=item.frame)
        return [*done, self._ack(mavlink.MAV_MISSION_ACCEPTED, kind, sender)]

    def _do(
        self, number: int, sender: Sender, *parameters: float, frame: int | None = None
    ) -> list[Reply]:
        """What a message asks for that means the same as this command: without a COMMAND_ACK."""
        p1, p2, p3, p4, p5, p6, p7 = (*parameters, *[0.0] * (7 - len(parameters)))
        command = Command(
            sender=sender,
            target_component=0,
            number=number,
            parameters=(p1, p2, p3, p4, p5, p6, p7),
            frame=frame,
        )
        return [each for each in self._autopilot.on_command(command) if not isinstance(each, Ack)]


def _said(to: Sender, name: str, **fields: float) -> SendMessage:
    """A message of the mission protocol."""
    message = make(name, target_system=to.system, target_component=to.component, **fields)
    return SendMessage(message=message, to=to)


def _read(message: Any, kind: PlanKind) -> PlanItem | int:
    """A MISSION_ITEM_INT, or a MISSION_ITEM with its place in degrees; or why it is refused."""
    command, frame, x, y = message.command, message.frame, message.x, message.y
    takes_no_time = kind is PlanKind.MISSION and command not in _FLOWN
    if kind is PlanKind.MISSION:
        of_others = any(command in others for others in _OF_LISTS.values())
        if of_others or (takes_no_time and command < DO_JUMP):
            return mavlink.MAV_MISSION_UNSUPPORTED
    elif command not in _OF_LISTS[kind]:
        return mavlink.MAV_MISSION_UNSUPPORTED
    if frame not in _GLOBAL_FRAMES and frame != mavlink.MAV_FRAME_MISSION:
        return mavlink.MAV_MISSION_UNSUPPORTED_FRAME
    if message.get_type() == "MISSION_ITEM":
        x, y = (value * 1e7 if math.isfinite(value) else math.inf for value in (x, y))
    if takes_no_time:
        x, y = (value if abs(value) < 2**31 else 0.0 for value in (x, y))
    elif not (abs(x) <= _LATITUDE_MAX_E7 and abs(y) <= _LONGITUDE_MAX_E7):
        return mavlink.MAV_MISSION_INVALID
    return PlanItem(
        frame=frame,
        command=command,
        parameters=(message.param1, message.param2, message.param3, message.param4),
        x=round(x),
        y=round(y),
        z_m=message.z,
        autocontinue=bool(message.autocontinue),
    )


def _is_whole(items: Sequence[PlanItem]) -> bool:
    """Whether each polygon of a fence has all its corners, and each circle a radius."""
    at = 0
    while at < len(items):
        command, size, number = items[at].command, items[at].parameters[0], 1
        if command in _CIRCLES and not size > 0.0:
            return False
        if command in _POLYGONS:
            if not 3.0 <= size <= len(items) - at:
                return False
            number = int(size)
            if any(each.command != command for each in items[at : at + number]):
                return False
        at += number
    return True
