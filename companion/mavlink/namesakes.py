"""Another process with our own ids on the link, told from our own frames that the link sends back.

Routers and radios reflect what they are given.  A frame of ours that comes back is one that we have
sent: the same sequence number, message and payload, whatever became of its signature and version.
What carries our ids and is none of these was sent by somebody else.  What a companion before this
one has left in buffers comes in one burst; who goes on for longer than that is there.
"""

from dataclasses import dataclass
from typing import final

from companion.mavlink.dialect import COMPANION_COMPONENT, Message, wire
from companion.mission.events import Namesake

_KEPT = 2048  # frames that may still come back: 10 s at 200 Hz
_HEARTBEATS = 3  # or other frames
_SPAN_S = 1.5  # from the first of them to the last, at the least
_GAP_S = 3.0  # after so long without any it begins anew,
_GONE_S = 10.0  # and so long for one that was certain
_TELL_S = 0.5

_Key = tuple[int, int, bytes]
"""Sequence number, message, payload."""


@final
@dataclass(slots=True)
class _Heard:
    """What was heard of one stranger."""

    first_s: float
    last_s: float
    count: int = 0
    told_s: float | None = None
    certain: bool = False

    @property
    def patience_s(self) -> float:
        """How long it may say nothing and still be the same."""
        return _GONE_S if self.certain else _GAP_S


@final
class Namesakes:
    """Knows what was sent, so what was not.  Pure: time is an argument."""

    def __init__(self) -> None:
        self._sent: dict[_Key, None] = {}
        self._heard: dict[int, _Heard] = {}
        """By system id: whose companion we are may not be known yet."""

    def sent(self, frame: bytes) -> None:
        """A frame of ours, signed or not."""
        key = _key(frame)
        self._sent.pop(key, None)
        self._sent[key] = None
        if len(self._sent) > _KEPT:
            del self._sent[next(iter(self._sent))]

    def heard(self, message: Message, system_id: int | None, now_s: float) -> Namesake | None:
        """What a message means, if it is none of ours with our ids, and it is time to say so.

        system_id: ours, None as long as it is not known.
        """
        system = message.get_srcSystem()
        if message.get_srcComponent() != COMPANION_COMPONENT:
            return None
        if _key(bytes(message.get_msgbuf())) in self._sent:
            return None
        heard = self._heard.get(system)
        if heard is None or not 0.0 <= now_s - heard.last_s <= heard.patience_s:
            heard = self._heard[system] = _Heard(now_s, now_s)
        heard.last_s, heard.count = now_s, heard.count + 1
        news = not heard.certain and (
            heard.count >= _HEARTBEATS and now_s - heard.first_s >= _SPAN_S
        )
        heard.certain = heard.certain or news
        lately = heard.told_s is not None and now_s - heard.told_s < _TELL_S
        if system != system_id or (lately and not news):
            return None
        first = heard.told_s is None or news
        heard.told_s = now_s
        return Namesake(time_s=now_s, certain=heard.certain, news=first and heard.certain)


def _key(frame: bytes) -> _Key:
    """What of a frame stays the same on its way there and back; MAVLink 1 or 2."""
    if frame[0] == wire.PROTOCOL_MARKER_V2:
        number = frame[7] | frame[8] << 8 | frame[9] << 16
        return frame[4], number, frame[10 : 10 + frame[1]].rstrip(b"\0")
    return frame[2], frame[5], frame[6 : 6 + frame[1]].rstrip(b"\0")
