"""What was heard over each link and has not been handled yet, in the order in which it came."""

from collections import deque
from typing import Final, NamedTuple, final

from companion.mavlink.dialect import Message
from companion.mavlink.needless import NEEDLESS
from companion.mavlink.receiver import Receiver
from companion.mavlink.signing import Signing

VEHICLE: Final = 0
"""The number of the link to the vehicle; those to ground stations count on from 1."""
_MOST_WAITING = 5000  # messages: 1.5 s of the busiest autopilot, and then the oldest go


class Heard(NamedTuple):
    """A message."""

    message: Message
    at_s: float | None
    """When it arrived, by the clock of whoever received it."""
    link: int


@final
class Inbox:
    """Messages, found in the bytes of each link by a receiver of its own."""

    def __init__(self, signing: Signing | None) -> None:
        self.receivers = {VEHICLE: Receiver(signing, NEEDLESS)}
        """By the number of the link."""
        self._signing = signing
        self._waiting: deque[Heard] = deque(maxlen=_MOST_WAITING)
        self._dropped = 0

    def feed(self, data: bytes, at_s: float | None, link: int) -> list[Message]:
        """The messages that are complete with these bytes; they wait from now on."""
        if link not in self.receivers:
            self.receivers[link] = Receiver(self._signing, NEEDLESS)
        messages = self.receivers[link].feed(data)
        for message in messages:
            self._dropped += len(self._waiting) == _MOST_WAITING
            self._waiting.append(Heard(message, at_s, link))
        return messages

    def dropped(self) -> int:
        """How many were too many since this was last asked."""
        count, self._dropped = self._dropped, 0
        return count

    def first(self) -> Heard | None:
        """The one that has waited longest; it goes on waiting."""
        return self._waiting[0] if self._waiting else None

    def take(self) -> Heard:
        """The same, and it waits no longer."""
        return self._waiting.popleft()
