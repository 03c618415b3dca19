"""Whether another process with our ids is on the link, and ids in words."""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, final

from companion.mavlink.frames import number_of, payload_of, sender_of, sequence_of
from companion.mission.events import DuplicateId

TO_COMPONENT_1: Final = "Set the autopilot's component id to 1 (MAV_COMP_ID)."
_KEPT = 2048  # frames that may still come back: 10 s at 200 Hz
_STRANGE = 3  # heartbeats, or other frames
_SPAN_S = 1.5  # from the first of them to the last, at the least
_GAP_S = 3.0  # after so long without any it begins anew,
_GONE_S = 10.0  # and so long for one that was certain
_TELL_S = 0.5


def ids_in_words(ids: Iterable[tuple[int, int]]) -> str:
    """Such as: component 50 of system 1, component 51 of system 1."""
    return ", ".join(f"component {component} of system {system}" for system, component in ids)


_Key = tuple[int, int, bytes]
"""Sequence number, message, payload."""


@final
@dataclass(slots=True)
class _Stranger:
    """Another process with our ids."""

    first_s: float
    last_s: float
    count: int = 0
    told_s: float | None = None
    certain: bool = False


@final
class DuplicateIdDetector:
    """Detects another process with our ids, as opposed to our own frames reflected by the link.

    Routers and radios may reflect frames.  A reflected frame has the sequence number, message and
    payload of one that we sent, though signature and version may differ.  Any other frame with our
    ids comes from another process.  Frames that a previous companion left in buffers arrive in one
    burst; a process that goes on for longer is alive.
    """

    def __init__(self) -> None:
        self.sent: deque[bytes] = deque(maxlen=_KEPT)
        """Frames of ours, signed or not, since any companion's was last heard."""
        self._sent: deque[_Key] = deque(maxlen=_KEPT)
        self._strangers: dict[int, _Stranger] = {}
        """By system id: whose companion we are may not be known yet."""

    def heard(self, frame: bytes, system_id: int | None, now_s: float) -> DuplicateId | None:
        """The event for a companion's frame that is not ours, if one is due.

        system_id: ours, None as long as it is not known.
        """
        self._sent.extend(map(_key, self.sent))
        self.sent.clear()
        if _key(frame) in self._sent:
            return None
        system, _ = sender_of(frame)
        it = self._strangers.get(system)
        patience_s = _GONE_S if it is not None and it.certain else _GAP_S
        if it is None or not 0.0 <= now_s - it.last_s <= patience_s:
            it = self._strangers[system] = _Stranger(now_s, now_s)
        it.last_s, it.count = now_s, it.count + 1
        news = not it.certain and it.count >= _STRANGE and now_s - it.first_s >= _SPAN_S
        it.certain = it.certain or news
        lately = it.told_s is not None and now_s - it.told_s < _TELL_S
        if system != system_id or (lately and not news):
            return None
        first = it.told_s is None or news
        it.told_s = now_s
        return DuplicateId(time_s=now_s, certain=it.certain, news=first and it.certain)


def _key(frame: bytes) -> _Key:
    """The part of a frame that a reflection does not change, MAVLink 1 or 2."""
    return sequence_of(frame), number_of(frame), payload_of(frame, 0).rstrip(b"\0")
