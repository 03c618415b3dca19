"""The two ends of a session's link: what was received and waits, and what is to be sent."""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final, final

from companion.mavlink.clock import TIME_ONLY_MESSAGES
from companion.mavlink.dialect import Message, codec
from companion.mavlink.frames import IGNORED_MESSAGES, Incoming, Receiver, sequence_of
from companion.mavlink.signing import Signing, strip_signature
from companion.mavlink.who import DuplicateIdDetector
from companion.mission.checkpoint import Values
from companion.mission.entries import Entry
from companion.mission.events import End
from companion.planner.request import PlanRequest
from companion.world.known_map import KnownMap

_UNDECODED: Final = IGNORED_MESSAGES | TIME_ONLY_MESSAGES
_BEGUN_AGAIN = 128
_MAX_WAITING = 5000  # messages: 1.5 s of the busiest autopilot, and then the oldest go

Stamped = tuple[float, bytes]
"""Vehicle time, seconds, and a frame."""
Input = tuple[Any, ...]
"""A recorded call of the session: its name, and its arguments as plain values."""


@final
class Inbox:
    """Received messages that have not been handled yet, in order."""

    def __init__(self, signing: Signing | None, wanted: frozenset[int] = frozenset()) -> None:
        """wanted: numbers of messages to decode that are not by default."""
        self.receiver = Receiver(signing, _UNDECODED - wanted)
        self.waiting: deque[Incoming] = deque(maxlen=_MAX_WAITING)
        self.dropped = 0
        """How many were too many."""
        self.counted: dict[tuple[int, int], tuple[int, int, int]] = {}
        """System and component -> last sequence number, frames, gaps."""

    def feed(self, data: bytes, at_s: float | None) -> list[Incoming]:
        """Parse these bytes and queue the messages that are complete."""
        heard = self.receiver.read(data, at_s)
        self.dropped += max(len(self.waiting) + len(heard) - _MAX_WAITING, 0)
        self.waiting.extend(heard)
        for each in heard:
            sender, number = (each.system, each.component), sequence_of(each.frame)
            before, frames, lost = self.counted.get(sender, (number - 1, 0, 0))
            gap = (number - before - 1) & 0xFF
            # more than half of all numbers: it is late, came twice, or its sender began again
            lost += gap if gap < _BEGUN_AGAIN else 0
            self.counted[sender] = number, frames + 1, lost
        return heard


@final
@dataclass(slots=True, kw_only=True)
class Output:
    """The result of one run(): what to send, record and compute."""

    frames: list[bytes] = field(default_factory=list)
    """To be sent, in order."""
    record: list[Stamped] = field(default_factory=list)
    """Vehicle time and frame, both directions, for the telemetry log."""
    journal: list[Entry] = field(default_factory=list)
    inputs: list[Input] = field(default_factory=list)
    """All inputs of the run, in order: replayed to an equal session they give the same output."""
    plan: PlanRequest | None = None
    """To be computed and delivered."""
    awaits_plan: bool = False
    checkpoint: Values | None = None
    """To be saved, so that a companion restarted in flight can resume."""
    known: KnownMap | None = None
    """The known map, to be saved too, if it has changed."""
    end: End | None = None
    """Set once the mission is over."""
    settled: bool = False
    """Whether the vehicle is then in the requested mode, or gone."""

    def leave_out(self, numbers: Iterable[int]) -> None:
        """Remove frames that were not sent, by index in `frames`, from the record."""
        unsent = {strip_signature(self.frames[number]) for number in numbers}
        self.record = [each for each in self.record if each[1] not in unsent]


@final
class FrameEncoder:
    """Encodes messages into frames to send; records all frames, both ways, unsigned."""

    def __init__(self, system_id: int | None, signing: Signing | None) -> None:
        self._codec, self._unsent = codec(system_id or 1), codec(system_id or 1)
        self._signing = signing
        self.duplicates = DuplicateIdDetector()
        """Hears of other processes with our ids."""
        self.out = Output()
        """What has come together since it was last taken."""

    def set_system_id(self, system_id: int) -> None:
        """Use this vehicle's system id from now on."""
        for each in (self._codec, self._unsent):
            each.srcSystem = system_id

    def send(self, messages: Iterable[Message], now_s: float) -> None:
        """Send messages in order."""
        for message in messages:
            frame = message.pack(self._codec)
            self._codec.seq = (self._codec.seq + 1) % 256
            self.out.frames.append(frame if self._signing is None else self._signing.sign(frame))
            self.duplicates.sent(frame)
            self.out.record.append((now_s, frame))

    def encode_unsent(self, messages: Iterable[Message]) -> list[bytes]:
        """Encode messages that may never be sent, unsigned: no sequence numbers are used up."""
        frames, self._unsent.seq = [], self._codec.seq
        for message in messages:
            frames.append(message.pack(self._unsent))
            self._unsent.seq = (self._unsent.seq + 1) % 256
        return frames

    def signed(self, frames: Iterable[bytes]) -> list[bytes]:
        """Frames of `encode_unsent` as they are sent now, however long ago they were made."""
        return [*frames] if self._signing is None else [*map(self._signing.sign, frames)]
