"""The mission protocol as PX4 speaks it: px4.md 7 and mavlink_mission.cpp.

Every link has its own state, which is idle, receiving a list or handing one out; only one list is
received at a time on all links together.
"""

import enum
import struct
import zlib
from dataclasses import dataclass, field, replace
from typing import Any, Final, final

from vehicle_sim.autopilots import Autopilot, Send, Sender, Text
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.wire import mission_items as wire
from vehicle_sim.wire.answers import Answer, Deliver, PlanReplaced
from vehicle_sim.wire.mission_items import MissionResult, Upload

ASK_AGAIN_US: Final = 250_000
GIVE_UP_US: Final = 5_000_000
_MOST_ITEMS: Final = {PlanKind.MISSION: 2000, PlanKind.FENCE: 256, PlanKind.RALLY: 128}
_ALL_KINDS: Final = 255
_MISSION_FRAME: Final = 2
_PLACE_FRAMES: Final = frozenset({0, 3, 5, 6})
_RELATIVE_FRAMES: Final = frozenset({3, 6})
_FRAMES: Final = {(False, False): 0, (False, True): 5, (True, False): 3, (True, True): 6}
"""By whether the height is above home, and whether the place is in integers."""
_FENCE: Final = frozenset({5000, 5001, 5002, 5003, 5004})
_POLYGONS: Final = frozenset({5001, 5002})
_RALLY_POINT: Final = 5100
_WITH_PLACE: Final = _FENCE | {
    *(_RALLY_POINT, 16, 17, 19, 21, 22, 31, 80, 84, 85, 195, 201, 212, 400, 4501),
}
_WITHOUT_PLACE: Final = frozenset(
    {
        *(20, 80, 93, 112, 114, 177, 178, 179, 187, 189, 196, 197, 200, 201, 203, 204, 205, 206),
        *(211, 212, 214, 260, 400, 530, 532, 534, 1000, 1001, 2000, 2001, 2003, 2500, 2501, 3000),
        42600,
    }
)
_KEPT: Final = {16: "124", 17: "34", 19: "1234", 21: "24", 22: "4", 31: "124", 84: "4", 85: "4"}
"""Of items with a place: the parameters that PX4 keeps; of fences the first, of others none."""
_CRITICAL, _INFO = 2, 6
"""MAV_SEVERITY."""


class _Doing(enum.Enum):
    IDLE = enum.auto()
    RECEIVING = enum.auto()
    SENDING = enum.auto()


@final
@dataclass(slots=True)
class _Link:
    """What goes on on one link."""

    doing: _Doing = _Doing.IDLE
    partner: tuple[int, int] | None = None
    kind: PlanKind = PlanKind.MISSION
    next: int = 0
    """The item that is asked for next, by whichever side."""
    count: int = 0
    whole: bool = True
    """Whether items go as integers (MISSION_ITEM_INT) now."""
    heard_us: int = 0
    upload: Upload | None = None
    last_id: int = 0
    """Of the list that was received last."""


@final
@dataclass(slots=True)
class _Shared:
    """What all links have in common."""

    receiving: bool = False
    ids: dict[PlanKind, int] = field(default_factory=lambda: dict.fromkeys(PlanKind, 0))


def opaque_id(items: tuple[PlanItem, ...]) -> int:
    """PX4's id of a list: a CRC-32 of all items, begun at zero and not inverted.

    Confirmed by the ids in the recorded uploads (px4-offboard-8mps, px4-gps-loss).
    """
    crc = 0
    for item in items:
        raw = struct.pack(
            "<BHB4fiif",
            item.frame,
            item.command,
            item.autocontinue,
            *item.parameters,
            item.x,
            item.y,
            item.z_m,
        )
        crc = zlib.crc32(raw, crc ^ 0xFFFFFFFF) ^ 0xFFFFFFFF
    return crc


@final
class Px4Missions:
    """Uploads and downloads of one autopilot's three lists, over all links."""

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot = autopilot
        self._plans = autopilot.plans
        self._links: dict[int, _Link] = {}
        self._shared = _Shared(ids={kind: opaque_id(autopilot.plans[kind]) for kind in PlanKind})

    @property
    def busy(self) -> bool:
        """Whether step() has anything to do."""
        return any(link.doing is not _Doing.IDLE for link in self._links.values())

    # --- in -----------------------------------------------------------------------------------

    def on_message(self, message: Any, sender: Sender, now_us: int) -> list[Answer]:
        """Answer a message of mission_items.MESSAGES that is for the autopilot."""
        link = self._links.setdefault(sender.link, _Link())
        match message.get_msgId():
            case wire.COUNT:
                return self._on_count(link, message, sender, now_us)
            case wire.ITEM | wire.ITEM_INT:
                link.whole = message.get_msgId() == wire.ITEM_INT
                return self._on_item(link, message, sender, now_us)
            case wire.REQUEST_LIST:
                return self._on_request_list(link, message, sender, now_us)
            case wire.REQUEST | wire.REQUEST_INT:
                link.whole = message.get_msgId() == wire.REQUEST_INT
                return self._on_request(link, message, sender, now_us)
            case wire.ACK:
                return self._on_ack(link, message, sender, now_us)
            case wire.CLEAR_ALL:
                return self._on_clear(link, message, sender)
            case wire.SET_CURRENT:
                return self._on_set_current(link, message, sender)
            case _:
                return []

    def step(self, now_us: int) -> list[Answer]:
        """Ask again for what did not come, and give up in the end."""
        answers = list[Answer]()
        for link in self._links.values():
            if link.doing is _Doing.IDLE:
                continue
            upload = link.upload
            if now_us - link.heard_us > GIVE_UP_US:
                self._end(link)
                answers.append(_critical("Operation timeout"))
            elif upload is not None and now_us - upload.asked_us > ASK_AGAIN_US:
                answers.append(self._ask(link, upload, now_us))
        return answers

    def _end(self, link: _Link) -> None:
        """To idle; what was half received is forgotten."""
        if link.doing is _Doing.RECEIVING:
            self._shared.receiving = False
        link.doing, link.upload = _Doing.IDLE, None

    # --- upload -------------------------------------------------------------------------------

    def _on_count(self, link: _Link, message: Any, sender: Sender, now_us: int) -> list[Answer]:
        asked = message.mission_type
        source = (sender.system, sender.component)
        link.heard_us = now_us
        if link.doing is _Doing.SENDING:
            return [
                _critical("WPM: IGN MISSION_COUNT: Busy"),
                _ack(MissionResult.ERROR, asked, sender),
            ]
        if link.doing is _Doing.RECEIVING:
            if source != link.partner:
                return [_ack(MissionResult.ERROR, asked, sender)]
            if link.upload is not None and link.upload.next == 0:
                return [self._ask(link, link.upload, now_us)]  # the request was lost
            return [
                _critical("WPM: REJ. CMD: Busy"),
                _ack(MissionResult.ERROR, asked, sender),
            ]
        if self._shared.receiving:  # on another link
            return [_ack(MissionResult.ERROR, asked, sender)]
        kind = wire.kind_of(message)
        if kind is None:
            return [_ack(MissionResult.INVALID, asked, sender)]
        if message.count > _MOST_ITEMS[kind]:
            return [_ack(MissionResult.NO_SPACE, asked, sender)]
        link.partner, link.kind, link.next, link.count = source, kind, 0, message.count
        if message.count == 0:
            return [*self._store(kind, ()), _ack(MissionResult.ACCEPTED, asked, sender)]
        link.doing, self._shared.receiving = _Doing.RECEIVING, True
        link.upload = Upload(
            sender=sender,
            kind=kind,
            last=message.count - 1,
            heard_us=now_us,
            asked_us=now_us,
        )
        return [self._ask(link, link.upload, now_us)]

    def _ask(self, link: _Link, upload: Upload, now_us: int) -> Answer:
        upload.asked_us = now_us
        return Deliver(message=wire.request_message(upload, whole=link.whole), to=upload.sender)

    def _on_item(self, link: _Link, message: Any, sender: Sender, now_us: int) -> list[Answer]:
        if (sender.system, sender.component) != link.partner:
            return [_critical("REJ. MIS ITEM: partner id mismatch")]
        asked = message.mission_type
        if asked != link.kind:
            return [_ack(MissionResult.ERROR, link.kind, sender)]
        upload = link.upload
        if upload is None:
            if link.doing is _Doing.IDLE and link.next == message.seq + 1:
                # the acknowledgement of the last item was lost
                return [_ack(MissionResult.ACCEPTED, asked, sender, link.last_id)]
            why = "No transfer" if link.doing is _Doing.IDLE else "Busy"
            return [
                _critical(f"IGN MISSION_ITEM: {why}"),
                _ack(MissionResult.ERROR, asked, sender),
            ]
        link.heard_us = now_us
        if message.seq != upload.next:
            return []  # the right one will be asked for again
        item = wire.read_item(message)
        result = item if isinstance(item, MissionResult) else _judge(item, link.kind)
        if isinstance(item, MissionResult) or result is not MissionResult.ACCEPTED:
            self._end(link)
            answers: list[Answer] = [_ack(MissionResult(result), asked, sender)]
            if result is not MissionResult.ERROR:
                answers.insert(0, _critical("IGN MISSION_ITEM: Invalid item"))
            return answers
        upload.put(item)
        link.next = upload.next
        if upload.next <= upload.last:
            return [self._ask(link, upload, now_us)]
        return self._complete(link, upload, sender)

    def _complete(self, link: _Link, upload: Upload, sender: Sender) -> list[Answer]:
        items = tuple(upload.items)
        self._end(link)
        link.last_id = opaque_id(items)
        # the same list again changes nothing
        changed = link.last_id != self._shared.ids[link.kind]
        answers = self._store(link.kind, items) if changed else []
        answers.append(_ack(MissionResult.ACCEPTED, link.kind, sender, link.last_id))
        return answers

    def _store(self, kind: PlanKind, items: tuple[PlanItem, ...]) -> list[Answer]:
        self._plans[kind] = items
        self._shared.ids[kind] = opaque_id(items)
        return [PlanReplaced(kind=kind)]

    def _on_clear(self, link: _Link, message: Any, sender: Sender) -> list[Answer]:
        asked = message.mission_type
        if link.doing is not _Doing.IDLE:
            return [_critical("WPM: IGN CLEAR CMD: Busy")]
        kind = wire.kind_of(message)
        kinds = list(PlanKind) if asked == _ALL_KINDS else [kind] if kind is not None else []
        answers = [answer for each in kinds for answer in self._store(each, ())]
        return [*answers, _ack(MissionResult.ACCEPTED, asked, sender)]

    # --- download -----------------------------------------------------------------------------

    def _on_request_list(
        self, link: _Link, message: Any, sender: Sender, now_us: int
    ) -> list[Answer]:
        source, kind = (sender.system, sender.component), wire.kind_of(message)
        if link.doing is _Doing.SENDING and link.next == link.count:
            self._end(link)  # all was sent; the acknowledgement never came
        again = link.doing is _Doing.SENDING and (link.partner, link.kind) == (source, kind)
        if kind is None or not (link.doing is _Doing.IDLE or again):
            return [Text(severity=_INFO, text="Mission download request ignored, already active")]
        link.doing, link.kind, link.partner, link.heard_us = _Doing.SENDING, kind, source, now_us
        link.next, link.count = 0, len(self._plans[kind])
        count = wire.count_message(link.count, kind, sender, self._shared.ids[kind])
        return [Deliver(message=count, to=sender)]

    def _on_request(self, link: _Link, message: Any, sender: Sender, now_us: int) -> list[Answer]:
        """In order, or the last one again."""
        if (sender.system, sender.component) != link.partner:
            return [_critical("WPM: REJ. CMD: partner id mismatch")]
        if link.doing is _Doing.IDLE:
            return []
        if link.doing is _Doing.RECEIVING:
            return [_critical("WPM: REJ. CMD: Busy")]
        if message.mission_type != link.kind:
            return []
        link.heard_us = now_us
        seq, items = message.seq, self._plans[link.kind]
        if seq == link.next < link.count:
            link.next += 1
        elif seq != link.next - 1:
            seq = len(items)
        if seq >= len(items):
            self._end(link)
            return [
                _ack(MissionResult.ERROR, link.kind, sender),
                _critical("WPM: REJ. CMD: Req. WP was unexpected"),
            ]
        current = link.kind is PlanKind.MISSION and (
            self._autopilot.status().mission_current == seq
        )
        handed = _handed_out(items[seq], link.kind, whole=link.whole)
        item = wire.item_message(handed, link.kind, seq, sender, whole=link.whole, current=current)
        return [Deliver(message=item, to=sender)]

    def _on_ack(self, link: _Link, message: Any, sender: Sender, now_us: int) -> list[Answer]:
        if (sender.system, sender.component) != link.partner:
            return [_critical("REJ. WP CMD: partner id mismatch")]
        if link.doing is _Doing.SENDING and message.mission_type == link.kind:
            self._end(link)
        elif link.upload is not None:
            if message.type == MissionResult.UNSUPPORTED:  # the other form, then
                link.whole = not link.whole
                return [self._ask(link, link.upload, now_us)]
            if message.type == MissionResult.OPERATION_CANCELLED:
                self._end(link)
        return []

    def _on_set_current(self, link: _Link, message: Any, sender: Sender) -> list[Answer]:
        if link.doing is not _Doing.IDLE:
            return [_critical("WPM: IGN WP CURR CMD: Busy")]
        if message.seq >= len(self._plans[PlanKind.MISSION]):
            return [_critical("WPM: WP CURR CMD: Not in list")]
        return [
            wire.make_current(message.seq, sender),
            Send(message=wire.MISSION_CURRENT, to=None),
        ]


def _judge(item: PlanItem, kind: PlanKind) -> MissionResult:
    """Whether PX4 takes this item into this list; frames stay as they were sent."""
    if item.frame in _PLACE_FRAMES:
        if item.command not in _WITH_PLACE:
            return MissionResult.UNSUPPORTED
    elif item.frame == _MISSION_FRAME:
        if item.command not in _WITHOUT_PLACE:
            return MissionResult.UNSUPPORTED
    else:
        return MissionResult.UNSUPPORTED_FRAME
    if kind is PlanKind.MISSION and item.command in _FENCE | {_RALLY_POINT}:
        return MissionResult.ERROR
    if kind is PlanKind.FENCE and item.command in _POLYGONS and not item.parameters[0] >= 3:
        return MissionResult.ERROR  # too few vertices
    return MissionResult.ACCEPTED


def _handed_out(item: PlanItem, kind: PlanKind, *, whole: bool) -> PlanItem:
    """As it comes back: in the frame's form for integers or degrees, without what is not kept."""
    if item.frame not in _PLACE_FRAMES:
        return item
    relative = item.frame in _RELATIVE_FRAMES and kind is not PlanKind.FENCE
    kept = "1" if item.command in _FENCE else _KEPT.get(item.command, "")
    p1, p2, p3, p4 = (
        value if str(k) in kept else 0.0 for k, value in enumerate(item.parameters, start=1)
    )
    return replace(
        item,
        frame=_FRAMES[relative, whole],
        parameters=(p1, p2, p3, p4),
    )


def _critical(text: str) -> Text:
    """A text with the tab at its end that says that an event tells the same."""
    return Text(severity=_CRITICAL, text=text + "\t")


def _ack(result: MissionResult, kind: int, to: Sender, opaque: int = 0) -> Answer:
    return Deliver(message=wire.ack_message(result, kind, to, opaque), to=to)
