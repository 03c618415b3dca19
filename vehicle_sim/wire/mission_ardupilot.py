"""The mission protocol as ArduPilot speaks it: ardupilot.md 4, MissionItemProtocol*.cpp.

Each of the three lists has a protocol of its own; on each, one client uploads at a time.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, final

from vehicle_sim.autopilots import Autopilot, Command, Reply, Sender, SendTelemetry, Text
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.wire import mission_protocol as wire
from vehicle_sim.wire.mission_protocol import (
    GLOBAL_FRAMES,
    MissionProtocol,
    MissionResult,
    Upload,
    ack,
)

# --- Which items ArduPilot takes, and what it makes of them ---------------------------------------
# Sources: ardupilot.md 4, AP_Mission.cpp and AC_PolyFence_loader.cpp.

RETURN_POINT, INCLUSION, EXCLUSION, CIRCLE_IN, CIRCLE_OUT = 5000, 5001, 5002, 5003, 5004
"""MAV_CMD of fence items: polygon vertices and circles."""
RALLY_POINT: Final = 5100
_DO_JUMP: Final = 177
_POLYGONS: Final = frozenset({INCLUSION, EXCLUSION})
_CIRCLES: Final = frozenset({CIRCLE_IN, CIRCLE_OUT})
_SHAPE_NUMBERS: Final = {
    INCLUSION: 98,
    EXCLUSION: 97,
    RETURN_POINT: 95,
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
_INFO, _WARNING = 6, 4
"""MAV_SEVERITY."""


def stored(item: PlanItem, kind: PlanKind, last: int) -> PlanItem | MissionResult:
    """The item as ArduPilot stores it, so as it comes back; or why it does not take it.

    last: number of the last item of this upload, to which a jump may lead.
    """
    if kind is PlanKind.MISSION:
        if item.command == _DO_JUMP and not 0 < item.parameters[0] <= last:
            return MissionResult.ERROR
        return _stored_mission(item)
    if item.frame not in GLOBAL_FRAMES:
        return MissionResult.UNSUPPORTED_FRAME
    if kind is PlanKind.RALLY:
        if item.command != RALLY_POINT:
            return MissionResult.UNSUPPORTED
        return PlanItem(
            frame=_STORED_FRAME[item.frame],
            command=item.command,
            x=item.x,
            y=item.y,
            z_m=_finite(item.z_m),
        )
    if item.command not in _SHAPE_NUMBERS:
        return MissionResult.UNSUPPORTED
    shape = _finite(item.parameters[0])
    if item.command in _POLYGONS:
        shape = float(max(0, min(int(shape), 255)))  # a vertex count, in one byte
    return PlanItem(
        frame=0,
        command=item.command,
        parameters=(0.0 if item.command == RETURN_POINT else shape, 0.0, 0.0, 0.0),
        x=item.x,
        y=item.y,
        autocontinue=False,
    )


def _stored_mission(item: PlanItem) -> PlanItem | MissionResult:
    command = item.command
    if command not in _WITH_PLACE and command not in _WITHOUT_PLACE:
        return MissionResult.UNSUPPORTED
    for k, value in enumerate(item.parameters):
        allowed = k == 3 and command in _YAW_MAY_BE_NAN
        if math.isinf(value) or (math.isnan(value) and not allowed):
            return MissionResult(MissionResult.INVALID_PARAM1 + k)
    p1, p2, p3, p4 = (_finite(value) for value in item.parameters)
    frame, z_m = 0, item.z_m
    if command in _WITH_PLACE:
        if item.frame not in _STORED_FRAME:
            return MissionResult.UNSUPPORTED_FRAME
        if abs(item.x) > _LATITUDE_MAX_E7:
            return MissionResult.INVALID_PARAM5_X
        if abs(item.y) > _LONGITUDE_MAX_E7:
            return MissionResult.INVALID_PARAM6_Y
        if not abs(z_m) < _HIGHEST_M:  # so also what is not a number
            return MissionResult.INVALID_PARAM7
        frame = _STORED_FRAME[item.frame]
    return replace(
        item, frame=frame, parameters=(p1, p2, p3, p4), z_m=_finite(z_m), autocontinue=True
    )


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def fence_fault(items: Sequence[PlanItem]) -> Text | None:
    """What is wrong with a whole fence; a polygon that crosses itself is taken."""
    left, wanted, count = 0, 0, 0
    has_return_point = False
    for item in items:
        command, size = item.command, item.parameters[0]
        if command in _POLYGONS:
            if size < 3:
                return _warning(f"Invalid vertex count ({int(size)})")
            if not left:
                left, wanted, count = int(size), command, int(size)
            elif command != wanted:
                return _warning(_mixed("vertex type", wanted, command))
            elif int(size) != count:
                return _warning(f"Unexpected vertex count want={count} got={int(size)}")
            left -= 1
        elif left:
            return _warning(_mixed("type", wanted, command))
        elif command in _CIRCLES and not size > 0:
            return _warning("Non-positive circle radius")
        elif command == RETURN_POINT:
            if has_return_point:
                return _warning("Multiple return points")
            has_return_point = True
        if abs(item.x) > _LATITUDE_MAX_E7 or abs(item.y) > _LONGITUDE_MAX_E7:
            return _warning("Bad lat or lon")
    return Text(severity=_INFO, text="Incorrect item count") if left else None


def only_circles_after_polygons(items: Sequence[PlanItem], before: Sequence[PlanItem]) -> bool:
    """Whether a fence of circles alone takes the place of one with a polygon."""
    has_polygon = [any(item.command in _POLYGONS for item in each) for each in (items, before)]
    return bool(items) and has_polygon == [False, True]


def _mixed(what: str, wanted: int, got: int) -> str:
    return f"Received incorrect {what} (want={_SHAPE_NUMBERS[wanted]} got={_SHAPE_NUMBERS[got]})"


def _warning(text: str) -> Text:
    return Text(severity=_WARNING, text=text)


ERASED_AFTER_US: Final = 30_000
"""Circles straight after a polygon: ACKed and within 50 ms erased (ardupilot.md 4, found bug)."""
_MAX_ITEMS: Final = {PlanKind.MISSION: 724, PlanKind.FENCE: 255, PlanKind.RALLY: 100}
"""What the storage of the simulated board holds; of rally points not known."""
_NAMES: Final = {PlanKind.MISSION: "Mission", PlanKind.FENCE: "Fence", PlanKind.RALLY: "Rally"}
_RECEIVED: Final = {
    PlanKind.MISSION: "Flight plan received",
    PlanKind.RALLY: "Rally points received",
}
_GUIDED, _ALTITUDE = 2, 3
"""``current`` of items that are not for the list: fly there now, or to this height."""
_DO_REPOSITION, _WAYPOINT = 192, 16


@final
class ArduPilotMissions(MissionProtocol):
    """Uploads and downloads of one autopilot's three lists, over all links."""

    ask_again_us = 1_000_000
    give_up_us = 8_000_000

    def __init__(self, autopilot: Autopilot) -> None:
        super().__init__(autopilot)
        self._erase_fence_us: int | None = None

    @property
    def busy(self) -> bool:
        """Whether step() has anything to do."""
        return bool(self._uploads) or self._erase_fence_us is not None

    # --- in -----------------------------------------------------------------------------------

    def on_message(self, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        """Answer a message of the mission protocol that is for the autopilot."""
        name = message.get_type()
        if name == "MISSION_SET_CURRENT":
            # ground stations take a MISSION_CURRENT for the answer
            return [
                *self._do(wire.make_current(message.seq, sender)),
                SendTelemetry(message=wire.MISSION_CURRENT, to=sender),
            ]
        if name == "MISSION_ACK":
            return []
        kind = wire.kind_of(message)
        if name in ("MISSION_ITEM", "MISSION_ITEM_INT") and message.current in (_GUIDED, _ALTITUDE):
            return self._on_guided(message, sender)
        if kind is None:
            return [ack(MissionResult.UNSUPPORTED, message.mission_type, sender)]
        match name:
            case "MISSION_COUNT":
                return self._on_count(message.count, kind, sender, now_us)
            case "MISSION_ITEM" | "MISSION_ITEM_INT":
                return self._on_item(message, kind, sender, now_us)
            case "MISSION_REQUEST_LIST":
                if kind in self._uploads:
                    return [ack(MissionResult.DENIED, kind, sender)]
                return [wire.tell_count(len(self._plans[kind]), kind, sender)]
            case "MISSION_REQUEST" | "MISSION_REQUEST_INT":
                return self._on_request(message, kind, sender)
            case "MISSION_WRITE_PARTIAL_LIST":
                return self._on_partial(message, kind, sender, now_us)
            case "MISSION_CLEAR_ALL":
                return self._on_clear(kind, sender)
            case _:
                return []

    def step(self, now_us: int) -> list[Reply]:
        """Ask again for what did not come, and give up in the end."""
        answers = list[Reply]()
        if self._erase_fence_us is not None and now_us >= self._erase_fence_us:
            self._erase_fence_us = None
            answers += self.store(PlanKind.FENCE, ())
        return answers + self._repeat(now_us)

    def _whole(self, upload: Upload) -> bool:
        del upload
        return False

    def _gave_up(self, upload: Upload) -> list[Reply]:
        kind = upload.kind
        text = Text(severity=_WARNING, text=f"{_NAMES[kind]} upload timeout")
        return [text, ack(MissionResult.OPERATION_CANCELLED, kind, upload.sender)]

    # --- upload -------------------------------------------------------------------------------

    def _on_count(self, count: int, kind: PlanKind, sender: Sender, now_us: int) -> list[Reply]:
        running = self._uploads.get(kind)
        if running is not None and not running.is_from(sender):
            return [ack(MissionResult.DENIED, kind, sender)]
        self._uploads.pop(kind, None)  # the same client may begin again
        if count > _MAX_ITEMS[kind]:
            text = f"Only {_MAX_ITEMS[kind]} items are supported"
            return [
                ack(MissionResult.NO_SPACE, kind, sender),
                Text(severity=_WARNING, text=text),
            ]
        if count == 0:
            return self._complete(kind, (), sender, now_us)
        upload = Upload(sender=sender, kind=kind, last=count - 1, heard_us=now_us)
        return self._begin(kind, upload, now_us)

    def _on_partial(self, message: Any, kind: PlanKind, sender: Sender, now_us: int) -> list[Reply]:
        """MISSION_WRITE_PARTIAL_LIST: some items of the list as it is are to be replaced."""
        items, first, last = self._plans[kind], message.start_index, message.end_index
        if kind in self._uploads:
            return [ack(MissionResult.DENIED, kind, sender)]
        if not 0 <= first <= last <= len(items):
            return [
                Text(severity=_WARNING, text="Flight plan update rejected"),
                ack(MissionResult.ERROR, kind, sender),
            ]
        upload = Upload(sender=sender, kind=kind, last=last, heard_us=now_us, next=first)
        upload.items = list(items)
        return self._begin(kind, upload, now_us)

    def _on_item(self, message: Any, kind: PlanKind, sender: Sender, now_us: int) -> list[Reply]:
        upload = self._uploads.get(kind)
        if upload is None:
            return [ack(MissionResult.ERROR, kind, sender)]
        if message.seq != upload.next:
            return [ack(MissionResult.INVALID_SEQUENCE, kind, sender)]
        if not upload.is_from(sender):
            return [ack(MissionResult.DENIED, kind, sender)]
        item = wire.read_item(message)
        if isinstance(item, PlanItem):
            item = stored(item, kind, upload.last)
        if isinstance(item, MissionResult):
            del self._uploads[kind]
            return [ack(item, kind, sender)]
        upload.put(item)
        upload.heard_us = now_us
        if upload.next <= upload.last:
            return [self._ask(upload, now_us)]
        del self._uploads[kind]
        return self._complete(kind, tuple(upload.items), sender, now_us)

    def _complete(
        self, kind: PlanKind, items: tuple[PlanItem, ...], sender: Sender, now_us: int
    ) -> list[Reply]:
        """All items are there: the old list goes, if the new one is good as a whole."""
        if kind is PlanKind.FENCE:
            if fault := fence_fault(items):
                return [fault, ack(MissionResult.ERROR, kind, sender)]
            if only_circles_after_polygons(items, self._plans[kind]):
                self._erase_fence_us = now_us + ERASED_AFTER_US
        answers = self.store(kind, items)
        if kind in _RECEIVED:
            answers.append(Text(severity=_INFO, text=_RECEIVED[kind]))
        answers.append(ack(MissionResult.ACCEPTED, kind, sender))
        return answers

    def _on_clear(self, kind: PlanKind, sender: Sender) -> list[Reply]:
        if kind in self._uploads:
            return [ack(MissionResult.ERROR, kind, sender)]
        return [*self.store(kind, ()), ack(MissionResult.ACCEPTED, kind, sender)]

    # --- download -----------------------------------------------------------------------------

    def _on_request(self, message: Any, kind: PlanKind, sender: Sender) -> list[Reply]:
        """Any item at any time, whether a list was asked for or not."""
        if kind in self._uploads:
            return [ack(MissionResult.DENIED, kind, sender)]
        seq, items = message.seq, self._plans[kind]
        if kind is PlanKind.MISSION and seq == 0:
            item = self._home_item()
        elif seq < len(items):
            item = items[seq]
        elif kind is PlanKind.MISSION:  # it tells the client how many there are
            count = wire.tell_count(len(items), kind, sender)
            return [count, ack(MissionResult.ERROR, kind, sender)]
        else:
            beyond = kind is PlanKind.RALLY or seq > len(items)
            result = MissionResult.INVALID_SEQUENCE if beyond else MissionResult.ERROR
            return [ack(result, kind, sender)]
        whole = message.get_type() == "MISSION_REQUEST_INT"
        return [wire.tell_item(item, kind, seq, sender, whole=whole)]

    def _home_item(self) -> PlanItem:
        """Item 0 of a mission is always home, not what was uploaded; zero before home is set."""
        home = self._autopilot.home
        if home is None:
            return PlanItem(frame=0, command=_WAYPOINT)
        return PlanItem(
            frame=0,
            command=_WAYPOINT,
            x=round(home.latitude_deg * 1e7),
            y=round(home.longitude_deg * 1e7),
            z_m=home.altitude_amsl_m,
        )

    # --- not for a list -----------------------------------------------------------------------

    def _on_guided(self, message: Any, sender: Sender) -> list[Reply]:
        """A waypoint to fly to now, as old ground stations send it."""
        item = wire.read_item(message)
        if isinstance(item, MissionResult):
            return [ack(item, PlanKind.MISSION, sender)]
        if item.frame not in wire.GLOBAL_FRAMES:
            return [ack(MissionResult.UNSUPPORTED_FRAME, PlanKind.MISSION, sender)]
        if message.current == _ALTITUDE:
            return [ack(MissionResult.UNSUPPORTED, PlanKind.MISSION, sender)]
        place = (item.x / 1e7, item.y / 1e7, item.z_m)
        command = Command(
            sender=sender,
            target_component=0,
            number=_DO_REPOSITION,
            parameters=(-1.0, 0.0, 0.0, float("nan"), *place),
            frame=item.frame,
        )
        return [*self._do(command), ack(MissionResult.ACCEPTED, PlanKind.MISSION, sender)]
