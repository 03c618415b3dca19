"""The mission protocol: uploads and downloads of missions, fences and rally points.

Sources: ardupilot.md 4 with MissionItemProtocol*.cpp, AP_Mission.cpp and AC_PolyFence_loader.cpp;
px4.md 7 and mavlink_mission.cpp.
"""

import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
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
    Text,
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
from vehicle_sim.wire.dialect import make

_RETURN_POINT, _RALLY_POINT, _WAYPOINT = 5000, 5100, 16
_POLYGONS: Final = frozenset({POLYGON_IN, POLYGON_OUT})
_CIRCLES: Final = frozenset({CIRCLE_IN, CIRCLE_OUT})
_FENCE: Final = _POLYGONS | _CIRCLES | {_RETURN_POINT}
_DO_REPOSITION, _DO_SET_MISSION_CURRENT, _MISSION_CURRENT = 192, 224, 42
_CRITICAL, _WARNING, _INFO = 2, 4, 6
"""MAV_SEVERITY."""
_GLOBAL_FRAMES: Final = frozenset({0, 3, 5, 6, 10, 11})
_NOBODY: Final = Sender(system=0, component=0, link=-1)


# --- what both firmwares read and say -------------------------------------------------------------


@final
@dataclass(slots=True, kw_only=True)
class _Transfer:
    """A list on its way from a client, or (PX4) to it; the stored one stays until it is whole."""

    sender: Sender = _NOBODY
    kind: PlanKind = PlanKind.MISSION
    count: int = 0
    next: int = 0
    """The next item requested, by either side."""
    items: list[PlanItem] = field(default_factory=list)
    """Of an upload: so far."""
    whole: bool = False
    """Whether items go as integers (MISSION_ITEM_INT)."""
    heard_us: int = 0
    asked_us: int = 0
    receiving: bool = False
    sending: bool = False
    last_id: int = 0
    """Of the list that PX4 received last."""

    def is_from(self, sender: Sender) -> bool:
        """Whether this is who uploads; on which link does not matter."""
        return (sender.system, sender.component) == (self.sender.system, self.sender.component)

    def ask(self, now_us: int) -> Reply:
        """Ask for the next item."""
        self.asked_us = now_us
        name = "MISSION_REQUEST_INT" if self.whole else "MISSION_REQUEST"
        return _said(self.sender, name, seq=self.next, mission_type=self.kind)


def _said(to: Sender, name: str, **fields: float) -> SendMessage:
    """A message of the mission protocol."""
    message = make(name, target_system=to.system, target_component=to.component, **fields)
    return SendMessage(message=message, to=to)


def _ack(result: int, kind: int, to: Sender, opaque_id: int = 0) -> SendMessage:
    """How it ended, a MAV_MISSION_RESULT; the kind may be one that there is not."""
    return _said(to, "MISSION_ACK", type=result, mission_type=kind, opaque_id=opaque_id)


def _count(count: int, kind: PlanKind, to: Sender, opaque_id: int = 0) -> SendMessage:
    """So many items are there to be asked for."""
    return _said(to, "MISSION_COUNT", count=count, mission_type=kind, opaque_id=opaque_id)


def _item(
    item: PlanItem, kind: PlanKind, seq: int, to: Sender, *, whole: bool, current: bool = False
) -> SendMessage:
    """The item as a MISSION_ITEM_INT (whole), or as a MISSION_ITEM."""
    return _said(
        to,
        "MISSION_ITEM_INT" if whole else "MISSION_ITEM",
        seq=seq,
        frame=item.frame,
        command=item.command,
        current=current,
        autocontinue=item.autocontinue,
        **dict(zip(("param1", "param2", "param3", "param4"), item.parameters, strict=True)),
        x=item.x if whole else item.x * 1e-7,
        y=item.y if whole else item.y * 1e-7,
        z=item.z_m,
        mission_type=kind,
    )


def _kind_of(message: Any) -> PlanKind | None:
    """Which list a message is about; None if there is no such list."""
    number = message.mission_type
    return PlanKind(number) if number in PlanKind.__members__.values() else None


def _read(message: Any) -> PlanItem | int:
    """A MISSION_ITEM_INT, or a MISSION_ITEM with its place in degrees; or what is wrong with it."""
    x, y = message.x, message.y
    if message.get_type() == "MISSION_ITEM":
        x, y = (value * 1e7 if math.isfinite(value) else math.inf for value in (x, y))
        if abs(x) >= 2**31:
            return mavlink.MAV_MISSION_INVALID_PARAM5_X
        if abs(y) >= 2**31:
            return mavlink.MAV_MISSION_INVALID_PARAM6_Y
    return PlanItem(
        frame=message.frame,
        command=message.command,
        parameters=(message.param1, message.param2, message.param3, message.param4),
        x=round(x),
        y=round(y),
        z_m=message.z,
        autocontinue=bool(message.autocontinue),
    )


def store(autopilot: Autopilot, kind: PlanKind, items: tuple[PlanItem, ...]) -> list[Reply]:
    """Replace a list, and tell the autopilot."""
    autopilot.plans[kind] = items
    return list(autopilot.on_plan(kind))


def _do(
    autopilot: Autopilot, number: int, sender: Sender, *parameters: float, frame: int | None = None
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
    return [each for each in autopilot.on_command(command) if not isinstance(each, Ack)]


def _set_current(
    autopilot: Autopilot, seq: int, sender: Sender, told: Sender | None
) -> list[Reply]:
    """MISSION_SET_CURRENT: ground stations take a MISSION_CURRENT for the answer."""
    done = _do(autopilot, _DO_SET_MISSION_CURRENT, sender, float(seq))
    return [*done, SendTelemetry(message=_MISSION_CURRENT, to=told)]


# --- ArduPilot: which items it takes, and what it makes of them -----------------------------------

_SHAPE_NUMBERS: Final = {
    POLYGON_IN: 98,
    POLYGON_OUT: 97,
    _RETURN_POINT: 95,
    CIRCLE_OUT: 93,
    CIRCLE_IN: 92,
}
"""AC_PolyFenceType, as its texts show it."""
_STORED_FRAME: Final = {0: 0, 5: 0, 2: 0, 3: 3, 6: 3, 10: 10, 11: 10}
"""Of items with a place: the frame that they come back in."""
_WITH_PLACE: Final = frozenset(
    {16, 17, 18, 19, 21, 22, 30, 31, 82, 84, 85, 94, 179, 188, 189, 191, 195, 201}
)
_WITHOUT_PLACE: Final = frozenset(
    {
        *(20, 83, 92, 93, 112, 114, 115, 177, 178, 181, 182, 183, 184, 194, 196, 197),
        *(202, 203, 205, 206, 207, 208, 210, 211, 212, 213, 215, 216, 217, 218, 222, 223),
        *(600, 601, 1000, 2000, 2001, 2500, 2501, 3000, 42600, 42702, 42703),
    }
)
_YAW_MAY_BE_NAN: Final = frozenset({16, 17, 18, 19, 21, 22, 31, 84, 85})
_HIGHEST_M: Final = 83_000.0
_LATITUDE_MAX_E7, _LONGITUDE_MAX_E7 = 900_000_000, 1_800_000_000


def _stored(item: PlanItem, kind: PlanKind, count: int) -> PlanItem | int:
    """The item as ArduPilot stores it, so as it comes back; or why it does not take it.

    count: of the items of this upload, to which a jump may lead.
    """
    if kind is PlanKind.MISSION:
        if item.command == DO_JUMP and not 0 < item.parameters[0] < count:
            return mavlink.MAV_MISSION_ERROR
        return _stored_mission(item)
    if item.frame not in _GLOBAL_FRAMES:
        return mavlink.MAV_MISSION_UNSUPPORTED_FRAME
    if item.command not in ({_RALLY_POINT} if kind is PlanKind.RALLY else _FENCE):
        return mavlink.MAV_MISSION_UNSUPPORTED
    kept = PlanItem(frame=0, command=item.command, x=item.x, y=item.y, autocontinue=False)
    if kind is PlanKind.RALLY:
        frame, z_m = _STORED_FRAME[item.frame], _finite(item.z_m)
        return replace(kept, frame=frame, z_m=z_m, autocontinue=True)
    shape = _finite(item.parameters[0])
    if item.command in _POLYGONS:
        shape = float(max(0, min(int(shape), 255)))  # a vertex count, in one byte
    elif item.command == _RETURN_POINT:
        shape = 0.0
    return replace(kept, parameters=(shape, 0.0, 0.0, 0.0))


def _stored_mission(item: PlanItem) -> PlanItem | int:
    command = item.command
    if command not in _WITH_PLACE | _WITHOUT_PLACE:
        return mavlink.MAV_MISSION_UNSUPPORTED
    for k, value in enumerate(item.parameters):
        allowed = k == 3 and command in _YAW_MAY_BE_NAN
        if math.isinf(value) or (math.isnan(value) and not allowed):
            return int(mavlink.MAV_MISSION_INVALID_PARAM1 + k)
    frame = 0
    if command in _WITH_PLACE:
        if item.frame not in _STORED_FRAME:
            return mavlink.MAV_MISSION_UNSUPPORTED_FRAME
        if abs(item.x) > _LATITUDE_MAX_E7:
            return mavlink.MAV_MISSION_INVALID_PARAM5_X
        if abs(item.y) > _LONGITUDE_MAX_E7:
            return mavlink.MAV_MISSION_INVALID_PARAM6_Y
        if not abs(item.z_m) < _HIGHEST_M:  # so also what is not a number
            return mavlink.MAV_MISSION_INVALID_PARAM7
        frame = _STORED_FRAME[item.frame]
    p1, p2, p3, p4 = map(_finite, item.parameters)
    z_m = _finite(item.z_m)
    return replace(item, frame=frame, parameters=(p1, p2, p3, p4), z_m=z_m, autocontinue=True)


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _fence_fault(items: Sequence[PlanItem]) -> Text | None:
    """What is wrong with a whole fence; a polygon that crosses itself is taken."""
    left, wanted, count, return_points = 0, 0, 0, 0
    for item in items:
        command, size, fault = item.command, item.parameters[0], ""
        return_points += command == _RETURN_POINT
        if command in _POLYGONS:
            if size < 3:
                fault = f"Invalid vertex count ({int(size)})"
            elif not left:
                left, wanted, count = int(size), command, int(size)
            elif command != wanted:
                fault = _mixed("vertex type", wanted, command)
            elif int(size) != count:
                fault = f"Unexpected vertex count want={count} got={int(size)}"
            left -= 1
        elif left:
            fault = _mixed("type", wanted, command)
        elif command in _CIRCLES and not size > 0:
            fault = "Non-positive circle radius"
        elif return_points > 1:
            fault = "Multiple return points"
        if not fault and (abs(item.x) > _LATITUDE_MAX_E7 or abs(item.y) > _LONGITUDE_MAX_E7):
            fault = "Bad lat or lon"
        if fault:
            return Text(severity=_WARNING, text=fault)
    return Text(severity=_INFO, text="Incorrect item count") if left else None


def _mixed(what: str, wanted: int, got: int) -> str:
    return f"Received incorrect {what} (want={_SHAPE_NUMBERS[wanted]} got={_SHAPE_NUMBERS[got]})"


# --- ArduPilot: each of the three lists has a protocol of its own; one client uploads at a time ---

_ERASED_AFTER_US: Final = 30_000
"""Circles straight after a polygon: ACKed and within 50 ms erased (ardupilot.md 4, found bug)."""
_ARDUPILOT_MOST: Final = {PlanKind.MISSION: 724, PlanKind.FENCE: 255, PlanKind.RALLY: 100}
"""What the storage of the simulated board holds; of rally points not known."""
_RECEIVED: Final = {
    PlanKind.MISSION: "Flight plan received",
    PlanKind.RALLY: "Rally points received",
}
_GUIDED, _ALTITUDE = 2, 3
"""``current`` of items that are not for the list: fly there now, or to this height."""


@final
class ArduPilotMissions:
    """Uploads and downloads of one autopilot's three lists, over all links."""

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot, self._plans = autopilot, autopilot.plans
        self._uploads: dict[PlanKind, _Transfer] = {}
        self._erase_fence_us: int | None = None

    @property
    def busy(self) -> bool:
        """Whether step() has anything to do."""
        return bool(self._uploads) or self._erase_fence_us is not None

    def on_message(self, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        """Answer a message of the mission protocol that is for the autopilot."""
        name = message.get_type()
        if name == "MISSION_SET_CURRENT":
            return _set_current(self._autopilot, message.seq, sender, sender)
        if name == "MISSION_ACK":
            return []
        if name.startswith("MISSION_ITEM") and message.current in (_GUIDED, _ALTITUDE):
            return self._on_guided(message, sender)
        kind = _kind_of(message)
        if kind is None:
            return [_ack(mavlink.MAV_MISSION_UNSUPPORTED, message.mission_type, sender)]
        match name:
            case "MISSION_COUNT":
                return self._on_count(message.count, kind, sender, now_us)
            case "MISSION_ITEM" | "MISSION_ITEM_INT":
                return self._on_item(message, kind, sender, now_us)
            case "MISSION_REQUEST_PARTIAL_LIST":
                return []
            case _ if kind in self._uploads:
                is_clear = name == "MISSION_CLEAR_ALL"
                result = mavlink.MAV_MISSION_ERROR if is_clear else mavlink.MAV_MISSION_DENIED
                return [_ack(result, kind, sender)]
            case "MISSION_REQUEST_LIST":
                return [_count(len(self._plans[kind]), kind, sender)]
            case "MISSION_REQUEST" | "MISSION_REQUEST_INT":
                return self._on_request(message, kind, sender)
            case "MISSION_WRITE_PARTIAL_LIST":
                return self._on_partial(message, kind, sender, now_us)
            case _:  # MISSION_CLEAR_ALL
                return [
                    *store(self._autopilot, kind, ()),
                    _ack(mavlink.MAV_MISSION_ACCEPTED, kind, sender),
                ]

    def step(self, now_us: int) -> list[Reply]:
        """Ask again for what did not come, and give up in the end."""
        answers = list[Reply]()
        if self._erase_fence_us is not None and now_us >= self._erase_fence_us:
            self._erase_fence_us = None
            answers += store(self._autopilot, PlanKind.FENCE, ())
        for kind, upload in list(self._uploads.items()):
            if now_us - upload.heard_us > 8_000_000:
                del self._uploads[kind]
                answers += [
                    Text(severity=_WARNING, text=f"{kind.name.capitalize()} upload timeout"),
                    _ack(mavlink.MAV_MISSION_OPERATION_CANCELLED, kind, upload.sender),
                ]
            elif now_us - upload.asked_us > 1_000_000:
                answers.append(upload.ask(now_us))
        return answers

    # --- upload -------------------------------------------------------------------------------

    def _on_count(self, count: int, kind: PlanKind, sender: Sender, now_us: int) -> list[Reply]:
        running = self._uploads.get(kind)
        if running is not None and not running.is_from(sender):
            return [_ack(mavlink.MAV_MISSION_DENIED, kind, sender)]
        self._uploads.pop(kind, None)  # the same client may begin again
        most = _ARDUPILOT_MOST[kind]
        if count > most:
            text = Text(severity=_WARNING, text=f"Only {most} items are supported")
            return [_ack(mavlink.MAV_MISSION_NO_SPACE, kind, sender), text]
        if count == 0:
            return self._complete(kind, (), sender, now_us)
        return self._begin(_Transfer(sender=sender, kind=kind, count=count), now_us)

    def _begin(self, upload: _Transfer, now_us: int) -> list[Reply]:
        self._uploads[upload.kind] = upload
        upload.heard_us = now_us
        return [upload.ask(now_us)]

    def _on_partial(self, message: Any, kind: PlanKind, sender: Sender, now_us: int) -> list[Reply]:
        """MISSION_WRITE_PARTIAL_LIST: some items of the list as it is are to be replaced."""
        items, first, last = self._plans[kind], message.start_index, message.end_index
        if not 0 <= first <= last <= len(items):
            text = Text(severity=_WARNING, text="Flight plan update rejected")
            return [text, _ack(mavlink.MAV_MISSION_ERROR, kind, sender)]
        upload = _Transfer(sender=sender, kind=kind, count=last + 1, next=first, items=list(items))
        return self._begin(upload, now_us)

    def _on_item(self, message: Any, kind: PlanKind, sender: Sender, now_us: int) -> list[Reply]:
        upload = self._uploads.get(kind)
        if upload is None:
            return [_ack(mavlink.MAV_MISSION_ERROR, kind, sender)]
        if message.seq != upload.next:
            return [_ack(mavlink.MAV_MISSION_INVALID_SEQUENCE, kind, sender)]
        if not upload.is_from(sender):
            return [_ack(mavlink.MAV_MISSION_DENIED, kind, sender)]
        item = _read(message)
        if isinstance(item, PlanItem):
            item = _stored(item, kind, upload.count)
        if not isinstance(item, PlanItem):
            del self._uploads[kind]
            return [_ack(item, kind, sender)]
        upload.items[upload.next : upload.next + 1] = [item]
        upload.next += 1
        upload.heard_us = now_us
        if upload.next < upload.count:
            return [upload.ask(now_us)]
        del self._uploads[kind]
        return self._complete(kind, tuple(upload.items), sender, now_us)

    def _complete(
        self, kind: PlanKind, items: tuple[PlanItem, ...], sender: Sender, now_us: int
    ) -> list[Reply]:
        """All items are there: the old list goes, if the new one is good as a whole."""
        if kind is PlanKind.FENCE:
            if fault := _fence_fault(items):
                return [fault, _ack(mavlink.MAV_MISSION_ERROR, kind, sender)]
            new, old = (
                any(item.command in _POLYGONS for item in each)
                for each in (items, self._plans[kind])
            )
            if items and old and not new:
                self._erase_fence_us = now_us + _ERASED_AFTER_US
        answers = store(self._autopilot, kind, items)
        if kind in _RECEIVED:
            answers.append(Text(severity=_INFO, text=_RECEIVED[kind]))
        return [*answers, _ack(mavlink.MAV_MISSION_ACCEPTED, kind, sender)]

    # --- download, and what is not for a list -------------------------------------------------

    def _on_request(self, message: Any, kind: PlanKind, sender: Sender) -> list[Reply]:
        """Any item at any time, whether a list was asked for or not."""
        seq, items = message.seq, self._plans[kind]
        if kind is PlanKind.MISSION and seq == 0:
            item = self._home_item()
        elif seq < len(items):
            item = items[seq]
        elif kind is PlanKind.MISSION:  # it tells the client how many there are
            count = _count(len(items), kind, sender)
            return [count, _ack(mavlink.MAV_MISSION_ERROR, kind, sender)]
        else:
            beyond = kind is PlanKind.RALLY or seq > len(items)
            result = mavlink.MAV_MISSION_INVALID_SEQUENCE if beyond else mavlink.MAV_MISSION_ERROR
            return [_ack(result, kind, sender)]
        whole = message.get_type() == "MISSION_REQUEST_INT"
        return [_item(item, kind, seq, sender, whole=whole)]

    def _home_item(self) -> PlanItem:
        """Item 0 of a mission is always home, not what was uploaded; zero before home is set."""
        home, item = self._autopilot.home, PlanItem(frame=0, command=_WAYPOINT)
        if home is None:
            return item
        x, y = round(home.latitude_deg * 1e7), round(home.longitude_deg * 1e7)
        return replace(item, x=x, y=y, z_m=home.altitude_amsl_m)

    def _on_guided(self, message: Any, sender: Sender) -> list[Reply]:
        """A waypoint to fly to now, as old ground stations send it."""
        item = _read(message)
        if not isinstance(item, PlanItem):
            return [_ack(item, PlanKind.MISSION, sender)]
        if item.frame not in _GLOBAL_FRAMES:
            return [_ack(mavlink.MAV_MISSION_UNSUPPORTED_FRAME, PlanKind.MISSION, sender)]
        if message.current == _ALTITUDE:
            return [_ack(mavlink.MAV_MISSION_UNSUPPORTED, PlanKind.MISSION, sender)]
        to = (-1.0, 0.0, 0.0, math.nan, item.x / 1e7, item.y / 1e7, item.z_m)
        done = _do(self._autopilot, _DO_REPOSITION, sender, *to, frame=item.frame)
        return [*done, _ack(mavlink.MAV_MISSION_ACCEPTED, PlanKind.MISSION, sender)]


# --- PX4: each link is idle, receives a list or hands one out; one list is received at a time -----

_PX4_MOST: Final = {PlanKind.MISSION: 2000, PlanKind.FENCE: 256, PlanKind.RALLY: 128}
_PX4_ASK_AGAIN_US, _PX4_GIVE_UP_US = 250_000, 5_000_000
_ALL_KINDS: Final = 255
_PLACE_FRAMES: Final = frozenset({0, 3, 5, 6})
_RELATIVE_FRAMES: Final = frozenset({3, 6})
_FRAMES: Final = {(False, False): 0, (False, True): 5, (True, False): 3, (True, True): 6}
"""By whether the height is above home, and whether the place is in integers."""
_PX4_WITH_PLACE: Final = _FENCE | {
    *(_RALLY_POINT, 16, 17, 19, 21, 22, 31, 80, 84, 85, 195, 201, 212, 400, 4501),
}
_PX4_WITHOUT_PLACE: Final = frozenset(
    {
        *(20, 80, 93, 112, 114, 177, 178, 179, 187, 189, 196, 197, 200, 201, 203, 204, 205, 206),
        *(211, 212, 214, 260, 400, 530, 532, 534, 1000, 1001, 2000, 2001, 2003, 2500, 2501, 3000),
        42600,
    }
)
_TAKEN: Final = {
    **dict.fromkeys(_PLACE_FRAMES, _PX4_WITH_PLACE),
    mavlink.MAV_FRAME_MISSION: _PX4_WITHOUT_PLACE,
}
_KEPT: Final = {16: "124", 17: "34", 19: "1234", 21: "24", 22: "4", 31: "124", 84: "4", 85: "4"}
"""Of items with a place: the parameters that PX4 keeps; of fences the first, of others none."""


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


@final
class Px4Missions:
    """Uploads and downloads of one autopilot's three lists, over all links."""

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot, self._plans = autopilot, autopilot.plans
        self._links: dict[int, _Transfer] = {}

    @property
    def busy(self) -> bool:
        """Whether step() has anything to do."""
        return any(link.receiving or link.sending for link in self._links.values())

    def on_message(self, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        """Answer a message of the mission protocol that is for the autopilot."""
        link = self._links.setdefault(sender.link, _Transfer(whole=True))
        busy, name = link.receiving or link.sending, message.get_type()
        if name.startswith("MISSION_ITEM") or name in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
            link.whole = name.endswith("_INT")
        match name:
            case "MISSION_COUNT":
                return self._on_count(link, message, sender, now_us)
            case "MISSION_ITEM" | "MISSION_ITEM_INT":
                return self._on_item(link, message, sender, now_us)
            case "MISSION_REQUEST_LIST":
                return self._on_request_list(link, message, sender, now_us)
            case "MISSION_REQUEST" | "MISSION_REQUEST_INT":
                return self._on_request(link, message, sender, now_us)
            case "MISSION_ACK":
                return self._on_ack(link, message, sender, now_us)
            case "MISSION_CLEAR_ALL" if busy:
                return [_critical("WPM: IGN CLEAR CMD: Busy")]
            case "MISSION_CLEAR_ALL":
                return self._on_clear(message, sender)
            case "MISSION_SET_CURRENT" if busy:
                return [_critical("WPM: IGN WP CURR CMD: Busy")]
            case "MISSION_SET_CURRENT" if message.seq >= len(self._plans[PlanKind.MISSION]):
                return [_critical("WPM: WP CURR CMD: Not in list")]
            case "MISSION_SET_CURRENT":
                return _set_current(self._autopilot, message.seq, sender, None)
            case _:
                return []

    def step(self, now_us: int) -> list[Reply]:
        """Ask again for what did not come, and give up in the end; so with what is not fetched."""
        answers = list[Reply]()
        for link in self._links.values():
            if not (link.receiving or link.sending):
                continue
            if now_us - link.heard_us > _PX4_GIVE_UP_US:
                link.receiving = link.sending = False
                answers.append(_critical("Operation timeout"))
            elif link.receiving and now_us - link.asked_us > _PX4_ASK_AGAIN_US:
                answers.append(link.ask(now_us))
        return answers

    # --- upload -------------------------------------------------------------------------------

    def _on_count(self, link: _Transfer, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        asked, kind = message.mission_type, _kind_of(message)
        refused = _ack(mavlink.MAV_MISSION_ERROR, asked, sender)
        link.heard_us = now_us
        if link.sending:
            return [_critical("WPM: IGN MISSION_COUNT: Busy"), refused]
        if link.receiving and sender == link.sender:
            if link.next == 0:
                return [link.ask(now_us)]  # the request was lost
            return [_critical("WPM: REJ. CMD: Busy"), refused]
        if any(each.receiving for each in self._links.values()):
            return [refused]
        if kind is None:
            return [_ack(mavlink.MAV_MISSION_INVALID, asked, sender)]
        if message.count > _PX4_MOST[kind]:
            return [_ack(mavlink.MAV_MISSION_NO_SPACE, asked, sender)]
        link.sender, link.kind, link.next, link.count = sender, kind, 0, message.count
        if message.count == 0:
            return [
                *store(self._autopilot, kind, ()),
                _ack(mavlink.MAV_MISSION_ACCEPTED, asked, sender),
            ]
        link.receiving, link.items = True, []
        return [link.ask(now_us)]

    def _on_item(self, link: _Transfer, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        if sender != link.sender:
            return [_critical("REJ. MIS ITEM: partner id mismatch")]
        kind = link.kind
        refused = _ack(mavlink.MAV_MISSION_ERROR, kind, sender)
        if message.mission_type != kind:
            return [refused]
        if link.sending:
            return [_critical("IGN MISSION_ITEM: Busy"), refused]
        if not link.receiving:
            if link.next == message.seq + 1:  # the acknowledgement of the last item was lost
                return [_ack(mavlink.MAV_MISSION_ACCEPTED, kind, sender, link.last_id)]
            return [_critical("IGN MISSION_ITEM: No transfer"), refused]
        link.heard_us = now_us
        if message.seq != link.next:
            return []  # the right one will be asked for again
        item = _read(message)
        result = _judged(item, kind) if isinstance(item, PlanItem) else item
        if not isinstance(item, PlanItem) or result != mavlink.MAV_MISSION_ACCEPTED:
            link.receiving = False
            invalid = [_critical("IGN MISSION_ITEM: Invalid item")]
            told = [] if result == mavlink.MAV_MISSION_ERROR else invalid
            return [*told, _ack(result, kind, sender)]
        link.items.append(item)
        link.next += 1
        if link.next < link.count:
            return [link.ask(now_us)]
        link.receiving, items = False, tuple(link.items)
        link.last_id = opaque_id(items)
        # the same list again changes nothing
        answers = (
            store(self._autopilot, kind, items)
            if link.last_id != opaque_id(self._plans[kind])
            else []
        )
        return [*answers, _ack(mavlink.MAV_MISSION_ACCEPTED, kind, sender, link.last_id)]

    def _on_clear(self, message: Any, sender: Sender) -> list[Reply]:
        asked, kind = message.mission_type, _kind_of(message)
        kinds = list(PlanKind) if asked == _ALL_KINDS else [kind] if kind is not None else []
        answers = [answer for each in kinds for answer in store(self._autopilot, each, ())]
        return [*answers, _ack(mavlink.MAV_MISSION_ACCEPTED, asked, sender)]

    # --- download -----------------------------------------------------------------------------

    def _on_request_list(
        self, link: _Transfer, message: Any, sender: Sender, now_us: int
    ) -> list[Reply]:
        kind = _kind_of(message)
        if link.sending and link.next == link.count:
            link.sending = False  # all was sent; the acknowledgement never came
        others = link.sending and (link.sender, link.kind) != (sender, kind)
        if kind is None or link.receiving or others:
            return [Text(severity=_INFO, text="Mission download request ignored, already active")]
        items = self._plans[kind]
        link.sending, link.kind, link.sender, link.heard_us = True, kind, sender, now_us
        link.next, link.count = 0, len(items)
        return [_count(link.count, kind, sender, opaque_id(items))]

    def _on_request(
        self, link: _Transfer, message: Any, sender: Sender, now_us: int
    ) -> list[Reply]:
        """In order, or the last one again."""
        if sender != link.sender:
            return [_critical("WPM: REJ. CMD: partner id mismatch")]
        if link.receiving:
            return [_critical("WPM: REJ. CMD: Busy")]
        if not link.sending or message.mission_type != link.kind:
            return []
        link.heard_us = now_us
        kind, seq, items = link.kind, message.seq, self._plans[link.kind]
        if seq == link.next < link.count:
            link.next += 1
        elif seq != link.next - 1:
            seq = len(items)
        if seq >= len(items):
            link.sending = False
            refused = _ack(mavlink.MAV_MISSION_ERROR, kind, sender)
            return [refused, _critical("WPM: REJ. CMD: Req. WP was unexpected")]
        current = kind is PlanKind.MISSION and self._autopilot.status().mission_current == seq
        item = _handed_out(items[seq], kind, whole=link.whole)
        return [_item(item, kind, seq, sender, whole=link.whole, current=current)]

    def _on_ack(self, link: _Transfer, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        if sender != link.sender:
            return [_critical("REJ. WP CMD: partner id mismatch")]
        if link.sending and message.mission_type == link.kind:
            link.sending = False
        elif link.receiving and message.type == mavlink.MAV_MISSION_UNSUPPORTED:
            link.whole = not link.whole  # the other form, then
            return [link.ask(now_us)]
        elif message.type == mavlink.MAV_MISSION_OPERATION_CANCELLED:
            link.receiving = False
        return []


def _judged(item: PlanItem, kind: PlanKind) -> int:
    """Whether PX4 takes this item into this list; frames stay as they were sent."""
    taken = _TAKEN.get(item.frame)
    if taken is None:
        return mavlink.MAV_MISSION_UNSUPPORTED_FRAME
    if item.command not in taken:
        return mavlink.MAV_MISSION_UNSUPPORTED
    misplaced = kind is PlanKind.MISSION and item.command in _FENCE | {_RALLY_POINT}
    too_few = kind is PlanKind.FENCE and item.command in _POLYGONS and not item.parameters[0] >= 3
    wrong = misplaced or too_few
    return mavlink.MAV_MISSION_ERROR if wrong else mavlink.MAV_MISSION_ACCEPTED


def _handed_out(item: PlanItem, kind: PlanKind, *, whole: bool) -> PlanItem:
    """As it comes back: in the frame's form for integers or degrees, without what is not kept."""
    if item.frame not in _PLACE_FRAMES:
        return item
    relative = item.frame in _RELATIVE_FRAMES and kind is not PlanKind.FENCE
    kept = "1" if item.command in _FENCE else _KEPT.get(item.command, "")
    p1, p2, p3, p4 = (v if k in kept else 0.0 for k, v in zip("1234", item.parameters, strict=True))
    return replace(item, frame=_FRAMES[relative, whole], parameters=(p1, p2, p3, p4))


def _critical(text: str) -> Text:
    """A text with the tab at its end that says that an event tells the same."""
    return Text(severity=_CRITICAL, text=text + "\t")
