"""STATUSTEXT to the operator, short and rate-limited (mavlink.md 2.3, 2.5).

A text is at most 50 characters of ASCII.  Warnings may be longer: they are sent in chunks, which
ground stations reassemble (common.xml: id, chunk_seq; a chunk that is not full is the last).  At
most one message a second; of one kind only the newest is sent.
"""

import math
import unicodedata
from dataclasses import dataclass
from typing import final

from companion.mavlink.dialect import Message, wire
from companion.mission.events import End, Outcome

_LONGEST = 50
_MAX_CHUNKS = 4
_PERIOD_S = 1.0
_REPEAT_S = 5.0  # the same text of a kind is not said again for so long
_STALE_S = 10.0  # what could not be said for so long is not news any more
_MAX_WAITING = 16
_LAST_CHUNKED = 0xFFFF  # id of the chunks of the last text of all
_ASCII = {"≤": "<=", "≥": ">=", "–": "-", "—": "-", "−": "-", "²": "2", "…": "..", "°": "deg"}


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _QueuedText:
    text: str
    severity: int
    kind: str
    queued_at_s: float


@final
class StatusTexts:
    """Queue of texts to send.  Pure: time is an argument."""

    def __init__(self) -> None:
        self._waiting: list[_QueuedText] = []
        self._sent: dict[str, tuple[str, float]] = {}
        """Of each kind, the text that was sent last, and when."""
        self._free_at_s = -math.inf
        self._chunked = 0
        self._over = False

    def add(self, text: str, severity: int, now_s: float, kind: str = "") -> None:
        """Queue a text; severity is a MAV_SEVERITY.

        It replaces a queued text of the same kind.  A text without a kind replaces none.
        """
        if self._over:
            return
        text = to_ascii(text)
        kind = kind or text
        before, at_s = self._sent.get(kind, ("", -math.inf))
        others = [waiting for waiting in self._waiting if waiting.kind != kind]
        if text == before and 0.0 <= now_s - at_s < _REPEAT_S:
            self._waiting = others  # what it would have replaced is no longer so
            return
        new = _QueuedText(text=text, severity=severity, kind=kind, queued_at_s=now_s)
        in_order = sorted([*others, new], key=lambda waiting: waiting.severity)
        self._waiting = in_order[:_MAX_WAITING]

    @property
    def is_waiting(self) -> bool:
        """Whether texts are queued."""
        return bool(self._waiting)

    def due(self, now_s: float) -> list[Message]:
        """The messages to send now: the most severe queued text, if one is due."""
        if now_s < self._free_at_s - _MAX_CHUNKS * _PERIOD_S:  # the clock began again
            self._free_at_s = now_s
        self._waiting = [
            waiting
            for waiting in self._waiting
            if waiting.severity <= wire.MAV_SEVERITY_WARNING
            or abs(now_s - waiting.queued_at_s) <= _STALE_S
        ]
        if not self._waiting or now_s < self._free_at_s:
            return []
        first = self._waiting.pop(0)
        self._sent = {
            kind: (text, at_s)
            for kind, (text, at_s) in self._sent.items()
            if 0.0 <= now_s - at_s < _REPEAT_S
        }
        self._sent[first.kind] = (first.text, now_s)
        messages = self._messages(first)
        self._free_at_s = now_s + _PERIOD_S * len(messages)
        return messages

    def end(self, end: End, *, held: bool, disarmed: bool = False) -> tuple[str, list[Message]]:
        """Text and messages for the end of the mission: the last ones, to be sent at once."""
        told = f"; told to hold{' and disarm' if disarmed else ''}" if held else ""
        text = f"ended, {end.outcome.value}: {end.reason}{told}"
        return text, self.last(text, warning=end.outcome is not Outcome.ARRIVED)

    def last(self, text: str, *, warning: bool = True) -> list[Message]:
        """The final text, to be sent at once, after any queued warnings."""
        grave = [each for each in self._waiting if each.severity <= wire.MAV_SEVERITY_WARNING]
        self._waiting, self._over = [], True
        before = [message for each in grave for message in self._messages(each)]
        return [*before, *final_text(text, warning=warning)]

    def _messages(self, waiting: _QueuedText) -> list[Message]:
        if len(waiting.text) > _LONGEST and waiting.severity <= wire.MAV_SEVERITY_WARNING:
            self._chunked = self._chunked % (_LAST_CHUNKED - 1) + 1  # 0 means: not in chunks
        return _in_chunks(waiting.text, waiting.severity, self._chunked)


def final_text(text: str, *, warning: bool = True) -> list[Message]:
    """The messages of a final text, independent of any queue."""
    return _in_chunks(to_ascii(text), severity_of(warning=warning), _LAST_CHUNKED)


def severity_of(*, warning: bool) -> int:
    """MAV_SEVERITY of a text."""
    return int(wire.MAV_SEVERITY_WARNING if warning else wire.MAV_SEVERITY_INFO)


def _in_chunks(text: str, severity: int, chunked: int) -> list[Message]:
    """Encode a text: a warning in up to four chunks."""
    grave = severity <= wire.MAV_SEVERITY_WARNING
    if len(text) <= _LONGEST or not grave:
        return [
            wire.MAVLink_statustext_message(severity, shortened(text, _LONGEST).encode("ascii"))
        ]
    cut = shortened(text, _MAX_CHUNKS * _LONGEST - 1).encode("ascii")
    # one that is full is never the last: a text of 100 ends with an empty third
    return [
        wire.MAVLink_statustext_message(severity, cut[begin : begin + _LONGEST], chunked, number)
        for number, begin in enumerate(range(0, len(cut) + 1, _LONGEST))
    ]


def to_ascii(text: str) -> str:
    """On one line, in ASCII."""
    for sign, written in _ASCII.items():
        text = text.replace(sign, written)
    letters = unicodedata.normalize("NFKD", text)
    kept = "".join(letter for letter in letters if not unicodedata.combining(letter))
    line = " ".join(kept.encode("ascii", errors="replace").decode("ascii").split())
    return "".join(letter if letter.isprintable() else "?" for letter in line)


def shortened(text: str, longest: int) -> str:
    """The text, or as many of its words as fit, and two dots."""
    if len(text) <= longest:
        return text
    room = longest - 2
    cut = text[:room]
    if not text[room].isspace() and " " in cut[room // 2 :]:
        cut = cut[: cut.rindex(" ")]
    return cut.rstrip(" ,;:.-") + ".."
