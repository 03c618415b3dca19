"""STATUSTEXT to the operator: short, in ASCII, at most one message a second (mavlink.md 2.3, 2.5).

A text is at most 50 characters.  Warnings may be longer: they are sent in chunks, which ground
stations reassemble (common.xml: id, chunk_seq; a chunk that is not full is the last).  Warnings go
first; of one kind only the newest is sent.
"""

import math
import textwrap
import unicodedata
from itertools import chain
from typing import NamedTuple, final

from companion.mavlink.dialect import Message, wire
from companion.mission.events import End, Outcome

_LONGEST = 50
_MAX_CHUNKS = 4
_PERIOD_S = 1.0
_REPEAT_S = 5.0  # the same text of a kind is not said again for so long
_STALE_S = 10.0  # what could not be said for so long is not news any more
_MAX_WAITING = 16
_LAST_CHUNKED = 0xFFFF  # id of the chunks of the last text of all
_ASCII = str.maketrans(
    {"≤": "<=", "≥": ">=", "–": "-", "—": "-", "−": "-", "²": "2", "…": "..", "°": "deg"}
)


class _Text(NamedTuple):
    text: str
    warning: bool
    queued_at_s: float


@final
class StatusTexts:
    """Queue of texts to send.  Pure: time is an argument."""

    def __init__(self) -> None:
        self._waiting: dict[str, _Text] = {}
        """By kind, in the order in which they were said."""
        self._sent: dict[str, tuple[str, float]] = {}
        """Of each kind, the text that was sent last, and when."""
        self._sent_s, self._lasts_s = -math.inf, 0.0
        """When a text was sent last, and for how long its chunks keep others waiting."""
        self._chunked = 0
        self._over = False

    def add(self, text: str, now_s: float, *, warning: bool = False, kind: str = "") -> None:
        """Queue a text; it replaces a queued one of the same kind, without a kind its equal."""
        ascii_text = to_ascii(text)
        self._waiting.pop(kind or ascii_text, None)
        before, at_s = self._sent.get(kind or ascii_text, ("", -math.inf))
        is_new = ascii_text != before or not 0.0 <= now_s - at_s < _REPEAT_S
        if is_new and not self._over and (warning or len(self._waiting) < _MAX_WAITING):
            self._waiting[kind or ascii_text] = _Text(ascii_text, warning, now_s)

    @property
    def due_s(self) -> float:
        """When `due` has something to say, at the latest."""
        return self._sent_s + self._lasts_s if self._waiting else math.inf

    def due(self, now_s: float) -> list[Message]:
        """The messages to send now: the first queued text, if it is time for one."""
        for kind, (_, warning, at_s) in tuple(self._waiting.items()):
            if not warning and abs(now_s - at_s) > _STALE_S:
                del self._waiting[kind]
        if not self._waiting or 0.0 <= now_s - self._sent_s < self._lasts_s:  # a clock may fall
            return []
        kind = min(self._waiting, key=lambda name: not self._waiting[name].warning)
        first = self._waiting.pop(kind)
        lately = {k: v for k, v in self._sent.items() if 0.0 <= now_s - v[1] < _REPEAT_S}
        self._sent = {**lately, kind: (first.text, now_s)}
        messages = self._messages(first)
        self._sent_s, self._lasts_s = now_s, _PERIOD_S * len(messages)
        return messages

    def end(self, end: End, *, held: bool, disarmed: bool = False) -> tuple[str, list[Message]]:
        """Text and messages for the end of the mission: the last ones, to be sent at once."""
        orders = f"; told to hold{' and disarm' if disarmed else ''}" if held else ""
        text = f"ended, {end.outcome.value}: {end.reason}{orders}"
        return text, self.last(text, warning=end.outcome is not Outcome.ARRIVED)

    def last(self, text: str, *, warning: bool = True) -> list[Message]:
        """The final text, to be sent at once, after any queued warnings."""
        left = [waiting for waiting in self._waiting.values() if waiting.warning]
        self._waiting, self._over = {}, True
        return [*chain(*map(self._messages, left)), *final_text(text, warning=warning)]

    def _messages(self, text: _Text) -> list[Message]:
        if text.warning and len(text.text) > _LONGEST:
            self._chunked = self._chunked % (_LAST_CHUNKED - 1) + 1  # 0 means: not in chunks
        return _encoded(text.text, self._chunked, warning=text.warning)


def final_text(text: str, *, warning: bool = True) -> list[Message]:
    """The messages of a final text, independent of any queue."""
    return _encoded(to_ascii(text), _LAST_CHUNKED, warning=warning)


def _encoded(text: str, chunked: int, *, warning: bool) -> list[Message]:
    """One message; of a long warning up to four chunks, and an empty one if the last is full."""
    message = wire.MAVLink_statustext_message
    severity = wire.MAV_SEVERITY_WARNING if warning else wire.MAV_SEVERITY_INFO
    if len(text) <= _LONGEST or not warning:
        return [message(severity, shortened(text, _LONGEST).encode("ascii"))]
    cut = shortened(text, _MAX_CHUNKS * _LONGEST - 1).encode("ascii")
    return [
        message(severity, cut[begin : begin + _LONGEST], chunked, number)
        for number, begin in enumerate(range(0, len(cut) + 1, _LONGEST))
    ]


def to_ascii(text: str) -> str:
    """On one line, in ASCII."""
    letters = unicodedata.normalize("NFKD", text.translate(_ASCII))
    kept = "".join(letter for letter in letters if not unicodedata.combining(letter))
    line = " ".join(kept.encode("ascii", errors="replace").decode("ascii").split())
    return "".join(letter if letter.isprintable() else "?" for letter in line)


def shortened(text: str, longest: int) -> str:
    """The text, or as many of its words as fit, and two dots."""
    if len(text) <= longest:
        return text
    first, *_ = textwrap.wrap(text, longest - 2, break_on_hyphens=False)
    return first.rstrip(" ,;:.-") + ".."
