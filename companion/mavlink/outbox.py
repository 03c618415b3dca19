"""What the companion sends, records and asks for; messages become frames, signed if need be."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, final

from companion.mavlink.dialect import Message, codec, wire
from companion.mavlink.namesakes import Namesakes
from companion.mavlink.signing import Signing, strip_signature
from companion.mission.checkpoint import Values
from companion.mission.entries import Entry
from companion.mission.events import End, Namesake
from companion.planner.request import PlanRequest
from companion.world.known_map import KnownMap

Stamped = tuple[float, bytes]
"""Vehicle time, seconds, and a frame."""
Input = tuple[Any, ...]
"""Something that the session was told: the name of the call, and its arguments as plain values."""


@final
@dataclass(slots=True, kw_only=True)
class Output:
    """What one run() asks of the outside."""

    frames: list[bytes] = field(default_factory=list)
    """To be sent, in order."""
    to_ground: list[bytes] = field(default_factory=list)
    """To be sent over every link to ground stations; not in the record."""
    record: list[Stamped] = field(default_factory=list)
    """Vehicle time and frame, both directions, for the telemetry log."""
    journal: list[Entry] = field(default_factory=list)
    inputs: list[Input] = field(default_factory=list)
    """All that this follows from, in order: told again to a session like this, it does the same."""
    plan: PlanRequest | None = None
    """To be computed and delivered."""
    awaits_plan: bool = False
    checkpoint: Values | None = None
    """To be kept for a companion that is started again in flight, if this one dies."""
    known: KnownMap | None = None
    """The known map, to be kept as well, when it has changed."""
    end: End | None = None
    """Set once the mission is over."""
    settled: bool = False
    """Whether the vehicle is in the mode that it was last asked for, or gone."""

    def leave_out(self, numbers: Iterable[int]) -> None:
        """Take frames, by their places in `frames`, out of the record: they were not sent."""
        unsent = {strip_signature(self.frames[number]) for number in numbers}
        self.record = [each for each in self.record if each[1] not in unsent]


@final
class Outbox:
    """Frames on their way out, and the record of all frames, both ways, without signatures."""

    def __init__(self, system_id: int | None, signing: Signing | None, *, has_ground: bool) -> None:
        """has_ground: whether there are links to ground stations besides the vehicle's."""
        self._codec, self._grounds = codec(system_id or 1), codec(system_id or 1)
        self._has_ground = has_ground
        self._to_ground: list[bytes] = []
        self._system_id = system_id
        self._namesakes = Namesakes()
        if signing is not None:
            signing.attach(self._codec)
            signing.attach(self._grounds)
        self._frames: list[bytes] = []
        self._record: list[Stamped] = []

    def speak_as(self, system_id: int) -> None:
        """Go on as the companion of this vehicle."""
        self._codec.srcSystem = self._grounds.srcSystem = self._system_id = system_id

    def send(self, messages: Iterable[Message], now_s: float, *, to_ground: bool = False) -> None:
        """Messages, in order; to_ground: not to the vehicle's link alone."""
        for message in messages:
            self.send_frame(self.packed(message), now_s)
            if to_ground:
                self.tell_ground([message])

    def tell_ground(self, messages: Iterable[Message]) -> None:
        """Messages to the links to ground stations alone, which count on by themselves."""
        if self._has_ground:
            for message in messages:
                frame = _packed(message, self._grounds)
                self._to_ground.append(frame)
                self._namesakes.sent(frame)  # a router may bring it to the vehicle's link

    def send_frame(self, frame: bytes, now_s: float) -> None:
        """A frame that is packed already."""
        self._frames.append(frame)
        self._namesakes.sent(frame)
        self._record.append((now_s, strip_signature(frame)))

    def note_received(self, message: Message, now_s: float) -> Namesake | None:
        """A message came in; whether another process with our ids has sent it."""
        self._record.append((now_s, bytes(message.get_msgbuf())))
        return self._namesakes.heard(message, self._system_id, now_s)

    def packed(self, message: Message) -> bytes:
        """A message as a frame; it is not sent."""
        return _packed(message, self._codec)

    def spare(self, messages: Iterable[Message]) -> list[bytes]:
        """Messages as frames that are perhaps never sent: they take no sequence numbers."""
        before = self._codec.seq
        frames = [self.packed(message) for message in messages]
        self._codec.seq = before
        return frames

    def take_into(self, out: Output) -> None:
        """What is to be sent and recorded since the last time."""
        out.frames, out.record, out.to_ground = self._frames, self._record, self._to_ground
        self._frames, self._record, self._to_ground = [], [], []


def _packed(message: Message, by: wire.MAVLink) -> bytes:
    frame: bytes = message.pack(by)
    by.seq = (by.seq + 1) % 256
    return frame
