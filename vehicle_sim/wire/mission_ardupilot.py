"""The mission protocol as ArduPilot speaks it: ardupilot.md 4, MissionItemProtocol*.cpp.

Each of the three lists has a protocol of its own; on each, one client uploads at a time.
"""

from typing import Any, Final, final

from vehicle_sim.autopilots import Autopilot, Command, Reply, Send, Sender, Text
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.wire import mission_items as wire
from vehicle_sim.wire import mission_rules as rules
from vehicle_sim.wire.mission_items import MissionResult, Upload, ack
from vehicle_sim.wire.mission_protocol import MissionProtocol

ERASED_AFTER_US: Final = 30_000
"""Circles straight after a polygon: ACKed and within 50 ms erased (ardupilot.md 4, found bug)."""
_MOST_ITEMS: Final = {PlanKind.MISSION: 724, PlanKind.FENCE: 255, PlanKind.RALLY: 100}
"""What the storage of the simulated board holds; of rally points not known."""
_NAMES: Final = {PlanKind.MISSION: "Mission", PlanKind.FENCE: "Fence", PlanKind.RALLY: "Rally"}
_RECEIVED: Final = {
    PlanKind.MISSION: "Flight plan received",
    PlanKind.RALLY: "Rally points received",
}
_GUIDED, _ALTITUDE = 2, 3
"""``current`` of items that are not for the list: fly there now, or to this height."""
_DO_REPOSITION, _WAYPOINT = 192, 16
_INFO, _WARNING = 6, 4


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
                Send(message=wire.MISSION_CURRENT, to=sender),
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
            answers += self._store(PlanKind.FENCE, ())
        return answers + self._repeat(now_us)

    def _whole(self, upload: Upload) -> bool:
        del upload
        return self._autopilot.style.requests_mission_int

    def _gave_up(self, upload: Upload) -> list[Reply]:
        kind = upload.kind
        text = Text(severity=_WARNING, text=f"{_NAMES[kind]} upload timeout")
        return [text, ack(MissionResult.OPERATION_CANCELLED, kind, upload.sender)]

    # --- upload -------------------------------------------------------------------------------

    def _on_count(self, count: int, kind: PlanKind, sender: Sender, now_us: int) -> list[Reply]:
        running = self._uploads.get(kind)
        if running is not None and not running.is_from(sender):
            return [ack(MissionResult.DENIED, kind, sender)]
        self._uploads.pop(kind, None)  # whoever uploads may begin again
        if count > _MOST_ITEMS[kind]:
            text = f"Only {_MOST_ITEMS[kind]} items are supported"
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
            item = rules.stored(item, kind, upload.last)
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
            if fault := rules.fence_fault(items):
                return [fault, ack(MissionResult.ERROR, kind, sender)]
            if rules.only_circles_after_polygons(items, self._plans[kind]):
                self._erase_fence_us = now_us + ERASED_AFTER_US
        answers = self._store(kind, items)
        if kind in _RECEIVED:
            answers.append(Text(severity=_INFO, text=_RECEIVED[kind]))
        answers.append(ack(MissionResult.ACCEPTED, kind, sender))
        return answers

    def _on_clear(self, kind: PlanKind, sender: Sender) -> list[Reply]:
        if kind in self._uploads:
            return [ack(MissionResult.ERROR, kind, sender)]
        return [*self._store(kind, ()), ack(MissionResult.ACCEPTED, kind, sender)]

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
        """Item 0 of a mission is home, whatever was uploaded; zero before there is one."""
        home = self._autopilot.status().home
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
