"""The mission protocol as PX4 speaks it: px4.md 7 and mavlink_mission.cpp.

Every link has its own state, which is idle, receiving a list or handing one out; only one list is
received at a time on all links together.
"""

import struct
import zlib
from dataclasses import dataclass, replace
from typing import Any, Final, final

from vehicle_sim.autopilots import Autopilot, Reply, Sender, SendTelemetry, Text
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.wire import mission_protocol as wire
from vehicle_sim.wire.mission_protocol import MissionProtocol, MissionResult, Upload, ack

_MAX_ITEMS: Final = {PlanKind.MISSION: 2000, PlanKind.FENCE: 256, PlanKind.RALLY: 128}
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


@final
@dataclass(slots=True)
class _Link:
    """What goes on on one link, beside an upload."""

    partner: tuple[int, int] | None = None
    kind: PlanKind = PlanKind.MISSION
    sending: bool = False
    """A list is handed out."""
    next: int = 0
    """The next item requested, by either side."""
    count: int = 0
    whole: bool = True
    """Whether items go as integers (MISSION_ITEM_INT) now."""
    heard_us: int = 0
    last_id: int = 0
    """Of the list that was received last."""


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
class Px4Missions(MissionProtocol):
    """Uploads and downloads of one autopilot's three lists, over all links."""

    ask_again_us = 250_000
    give_up_us = 5_000_000

    def __init__(self, autopilot: Autopilot) -> None:
        super().__init__(autopilot)
        self._links: dict[int, _Link] = {}
        self._ids = {kind: opaque_id(autopilot.plans[kind]) for kind in PlanKind}

    @property
    def busy(self) -> bool:
        """Whether step() has anything to do."""
        return bool(self._uploads) or any(link.sending for link in self._links.values())

    # --- in -----------------------------------------------------------------------------------

    def on_message(self, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        """Answer a message of the mission protocol that is for the autopilot."""
        link = self._links.setdefault(sender.link, _Link())
        upload = self._uploads.get(sender.link)
        match message.get_type():
            case "MISSION_COUNT":
                return self._on_count(link, upload, message, sender, now_us)
            case "MISSION_ITEM" | "MISSION_ITEM_INT" as name:
                link.whole = name == "MISSION_ITEM_INT"
                return self._on_item(link, upload, message, sender, now_us)
            case "MISSION_REQUEST_LIST":
                return self._on_request_list(link, upload, message, sender, now_us)
            case "MISSION_REQUEST" | "MISSION_REQUEST_INT" as name:
                link.whole = name == "MISSION_REQUEST_INT"
                return self._on_request(link, upload, message, sender, now_us)
            case "MISSION_ACK":
                return self._on_ack(link, upload, message, sender, now_us)
            case "MISSION_CLEAR_ALL" if upload or link.sending:
                return [_critical("WPM: IGN CLEAR CMD: Busy")]
            case "MISSION_CLEAR_ALL":
                return self._on_clear(message, sender)
            case "MISSION_SET_CURRENT" if upload or link.sending:
                return [_critical("WPM: IGN WP CURR CMD: Busy")]
            case "MISSION_SET_CURRENT":
                return self._on_set_current(message, sender)
            case _:
                return []

    def step(self, now_us: int) -> list[Reply]:
        """Ask again for what did not come, and give up in the end; so with what is not fetched."""
        answers = self._repeat(now_us)
        for link in self._links.values():
            if link.sending and now_us - link.heard_us > self.give_up_us:
                link.sending = False
                answers.append(_critical("Operation timeout"))
        return answers

    def _whole(self, upload: Upload) -> bool:
        return self._links[upload.sender.link].whole

    def _gave_up(self, upload: Upload) -> list[Reply]:
        del upload
        return [_critical("Operation timeout")]

    # --- upload -------------------------------------------------------------------------------

    def _on_count(
        self, link: _Link, upload: Upload | None, message: Any, sender: Sender, now_us: int
    ) -> list[Reply]:
        asked = message.mission_type
        source = (sender.system, sender.component)
        refused = ack(MissionResult.ERROR, asked, sender)
        link.heard_us = now_us
        if link.sending:
            return [_critical("WPM: IGN MISSION_COUNT: Busy"), refused]
        if upload is not None:
            upload.heard_us = now_us
            if source != link.partner:
                return [refused]
            if upload.next == 0:
                return [self._ask(upload, now_us)]  # the request was lost
            return [_critical("WPM: REJ. CMD: Busy"), refused]
        if self._uploads:  # on another link
            return [refused]
        kind = wire.kind_of(message)
        if kind is None:
            return [ack(MissionResult.INVALID, asked, sender)]
        if message.count > _MAX_ITEMS[kind]:
            return [ack(MissionResult.NO_SPACE, asked, sender)]
        link.partner, link.kind, link.next, link.count = source, kind, 0, message.count
        if message.count == 0:
            return [*self.store(kind, ()), ack(MissionResult.ACCEPTED, asked, sender)]
        upload = Upload(sender=sender, kind=kind, last=message.count - 1, heard_us=now_us)
        return self._begin(sender.link, upload, now_us)

    def _on_item(
        self, link: _Link, upload: Upload | None, message: Any, sender: Sender, now_us: int
    ) -> list[Reply]:
        if (sender.system, sender.component) != link.partner:
            return [_critical("REJ. MIS ITEM: partner id mismatch")]
        asked = message.mission_type
        if asked != link.kind:
            return [ack(MissionResult.ERROR, link.kind, sender)]
        if upload is None:
            if not link.sending and link.next == message.seq + 1:
                # the acknowledgement of the last item was lost
                return [ack(MissionResult.ACCEPTED, asked, sender, link.last_id)]
            why = "Busy" if link.sending else "No transfer"
            refused = ack(MissionResult.ERROR, asked, sender)
            return [_critical(f"IGN MISSION_ITEM: {why}"), refused]
        upload.heard_us = now_us
        if message.seq != upload.next:
            return []  # the right one will be asked for again
        item = wire.read_item(message)
        result = item if isinstance(item, MissionResult) else _judge(item, link.kind)
        if isinstance(item, MissionResult) or result is not MissionResult.ACCEPTED:
            del self._uploads[sender.link]
            answers: list[Reply] = [ack(result, asked, sender)]
            if result is not MissionResult.ERROR:
                answers.insert(0, _critical("IGN MISSION_ITEM: Invalid item"))
            return answers
        upload.put(item)
        link.next = upload.next
        if upload.next <= upload.last:
            return [self._ask(upload, now_us)]
        del self._uploads[sender.link]
        items = tuple(upload.items)
        link.last_id = opaque_id(items)
        # the same list again changes nothing
        answers = self.store(link.kind, items) if link.last_id != self._ids[link.kind] else []
        return [*answers, ack(MissionResult.ACCEPTED, link.kind, sender, link.last_id)]

    def store(self, kind: PlanKind, items: tuple[PlanItem, ...]) -> list[Reply]:
        """Replace the list, and its opaque id."""
        self._ids[kind] = opaque_id(items)
        return super().store(kind, items)

    def _on_clear(self, message: Any, sender: Sender) -> list[Reply]:
        asked, kind = message.mission_type, wire.kind_of(message)
        kinds = list(PlanKind) if asked == _ALL_KINDS else [kind] if kind is not None else []
        answers = [answer for each in kinds for answer in self.store(each, ())]
        return [*answers, ack(MissionResult.ACCEPTED, asked, sender)]

    # --- download -----------------------------------------------------------------------------

    def _on_request_list(
        self, link: _Link, upload: Upload | None, message: Any, sender: Sender, now_us: int
    ) -> list[Reply]:
        source, kind = (sender.system, sender.component), wire.kind_of(message)
        if link.sending and link.next == link.count:
            link.sending = False  # all was sent; the acknowledgement never came
        others = link.sending and (link.partner, link.kind) != (source, kind)
        if kind is None or upload is not None or others:
            return [Text(severity=_INFO, text="Mission download request ignored, already active")]
        link.sending, link.kind, link.partner, link.heard_us = True, kind, source, now_us
        link.next, link.count = 0, len(self._plans[kind])
        return [wire.tell_count(link.count, kind, sender, self._ids[kind])]

    def _on_request(
        self, link: _Link, upload: Upload | None, message: Any, sender: Sender, now_us: int
    ) -> list[Reply]:
        """In order, or the last one again."""
        if (sender.system, sender.component) != link.partner:
            return [_critical("WPM: REJ. CMD: partner id mismatch")]
        if upload is not None:
            return [_critical("WPM: REJ. CMD: Busy")]
        if not link.sending or message.mission_type != link.kind:
            return []
        link.heard_us = now_us
        seq, items = message.seq, self._plans[link.kind]
        if seq == link.next < link.count:
            link.next += 1
        elif seq != link.next - 1:
            seq = len(items)
        if seq >= len(items):
            link.sending = False
            refused = ack(MissionResult.ERROR, link.kind, sender)
            return [refused, _critical("WPM: REJ. CMD: Req. WP was unexpected")]
        current = link.kind is PlanKind.MISSION and (
            self._autopilot.status().mission_current == seq
        )
        handed = _handed_out(items[seq], link.kind, whole=link.whole)
        return [wire.tell_item(handed, link.kind, seq, sender, whole=link.whole, current=current)]

    def _on_ack(
        self, link: _Link, upload: Upload | None, message: Any, sender: Sender, now_us: int
    ) -> list[Reply]:
        if (sender.system, sender.component) != link.partner:
            return [_critical("REJ. WP CMD: partner id mismatch")]
        if link.sending and message.mission_type == link.kind:
            link.sending = False
        elif upload is not None:
            if message.type == MissionResult.UNSUPPORTED:  # the other form, then
                link.whole = not link.whole
                return [self._ask(upload, now_us)]
            if message.type == MissionResult.OPERATION_CANCELLED:
                del self._uploads[sender.link]
        return []

    def _on_set_current(self, message: Any, sender: Sender) -> list[Reply]:
        if message.seq >= len(self._plans[PlanKind.MISSION]):
            return [_critical("WPM: WP CURR CMD: Not in list")]
        return [
            *self._do(wire.make_current(message.seq, sender)),
            SendTelemetry(message=wire.MISSION_CURRENT, to=None),
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
