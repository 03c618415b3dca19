"""A session's link: what was received, which vehicle it is of, its time, and what is sent."""

import enum
import math
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final, final

from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, codec, wire
from companion.mavlink.frames import (
    IGNORED_MESSAGES,
    V2,
    Incoming,
    number_of,
    payload_of,
    sender_of,
)
from companion.mavlink.signing import Signing, strip_signature
from companion.mission.checkpoint import Values
from companion.mission.events import DuplicateId, End
from companion.mission.journal import Told
from companion.planner.request import PlanRequest
from companion.world.known_map import KnownMap

TIME_ONLY_MESSAGES: Final = frozenset(
    {wire.MAVLINK_MSG_ID_ATTITUDE, wire.MAVLINK_MSG_ID_LOCAL_POSITION_NED}
)
"""Messages of which only time_boot_ms is used, with which they begin: not decoded."""
UNDECODED_MESSAGES: Final = IGNORED_MESSAGES | TIME_ONLY_MESSAGES

_HEARTBEATS = 3  # of one system, and of no other, at one a second: then it is the vehicle
_ENOUGH = 10  # of any: then it will not become clear by itself
_NO_AUTOPILOTS = (wire.MAV_TYPE_GCS, wire.MAV_TYPE_ONBOARD_CONTROLLER)

TO_COMPONENT_1: Final = "Set the autopilot's component id to 1 (MAV_COMP_ID)."
_KEPT = 2048  # frames that may still come back: 10 s at 200 Hz
_STRANGE = 3  # heartbeats, or other frames
_SPAN_S = 1.5  # from the first of them to the last, at the least
_GAP_S = 3.0  # after so long without any it begins anew,
_GONE_S = 10.0  # and so long for one that was certain
_TELL_S = 0.5

_REBOOT_S = 2.0  # a clock that falls by more has begun again; one that leaps by more is doubted
_BEAT_S = 1.0  # between two heartbeats of an autopilot
_OFTEN_MS = 50  # PX4 sends ATTITUDE every 10 ms, LOCAL_POSITION_NED every 33 ms

_ENTRY_BYTES = 500  # what a journal entry takes, about
Stamped = tuple[float, bytes]
"""Vehicle time, seconds, and a frame."""
Input = tuple[Any, ...]
"""A recorded call of the session: its name, and its arguments as plain values."""


@final
class VehicleSelector:
    """Selects our vehicle: the one that the mission names, or the only one heard.

    Counts heartbeats of autopilots instead of measuring time, so that a replay of the same messages
    selects the same vehicle.
    """

    def __init__(self, system_id: int | None) -> None:
        self.system_id = system_id
        """Of our vehicle; None: not known yet."""
        self.others: set[int] = set()
        """Systems with an autopilot that are not ours, or may not be."""
        self.elsewhere: set[tuple[int, int]] = set()
        """System and component of what sends an autopilot's heartbeat and is not component 1."""
        self._heard = Counter[int]()

    @property
    def ambiguity(self) -> str:
        """A warning once several autopilots have been heard for a while; empty: unambiguous."""
        if self.system_id is not None or self._heard.total() < _ENOUGH:
            return ""
        names = ", ".join(str(system) for system in sorted(self.others))
        return f"systems {names} are heard, choose one with --system"

    def may_be_ours(self, heard: Incoming) -> bool:
        """Whether an autopilot sent this, as long as none is selected."""
        is_first = heard.component == AUTOPILOT_COMPONENT
        return self.system_id is None and is_first and _is_an_autopilots(heard)

    def on_heartbeat(self, heard: Incoming) -> bool:
        """Whether this heartbeat completes the selection."""
        system = heard.system
        if not _is_an_autopilots(heard):
            return False
        if heard.component != AUTOPILOT_COMPONENT:
            self.elsewhere.add((system, heard.component))
        elif system != self.system_id:
            self.others.add(system)
            self._heard[system] += 1
            if self.system_id is None and [*self._heard.values()] == [_HEARTBEATS]:
                self.system_id = system
                self.others.clear()
                return True
        return False


def _is_an_autopilots(heard: Incoming) -> bool:
    """Whether this heartbeat tells of an autopilot, of whatever component."""
    message = heard.message
    if heard.number != wire.MAVLINK_MSG_ID_HEARTBEAT or message is None:
        return False
    return message.type not in _NO_AUTOPILOTS and message.autopilot != wire.MAV_AUTOPILOT_INVALID


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
    told_s: float = -math.inf
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
        if system != system_id or (now_s - it.told_s < _TELL_S and not news):
            return None
        first, it.told_s = news or math.isinf(it.told_s), now_s
        return DuplicateId(time_s=now_s, certain=it.certain, news=first and it.certain)


def _key(frame: bytes) -> _Key:
    """The part of a frame that a reflection does not change, MAVLink 1 or 2."""
    sequence = frame[4] if frame[0] == V2 else frame[2]
    return sequence, number_of(frame), payload_of(frame, 0).rstrip(b"\0")


class ClockReading(enum.Enum):
    """Effect of a time stamp on the clock."""

    FIRST = "the clock is known from now on"
    LATER = "it has moved on"
    SAME = "it has not"
    REBOOTED = "it has begun again"
    DOUBTED = "it has fallen or leapt, for the first time: one such message may be a mistake"


@final
class VehicleClock:
    """Vehicle time, seconds since its boot."""

    def __init__(self, start_s: float) -> None:
        """start_s: used as the time until it is known."""
        self.now_s = self.going_on_s = start_s
        """What it shows; with the silence since on top: for what goes on meanwhile."""
        self.is_known = False
        self.passed_s = 0.0
        """How long it has been known, all boots together."""
        self._doubted_s = math.nan
        """The time stamp just before, if it was doubted."""
        self._read_at_s: float | None = None
        """When the newest time stamp arrived."""
        self._beat = math.nan, math.nan, -1
        """Time, time with the silence and sequence number at the last heartbeat."""
        self._told_ms: dict[int, int] = {}

    def is_newer(self, number: int, time_boot_ms: int) -> bool:
        """Whether a time-only message is newer than the last one of its kind.

        That one is remembered.
        """
        before_ms = self._told_ms.get(number)
        if before_ms is not None and 0 <= time_boot_ms - before_ms < _OFTEN_MS:
            return False
        self._told_ms[number] = time_boot_ms
        return True

    def believes(self, time_s: float, at_s: float | None = None) -> bool:
        """Whether read() would take this time stamp.

        It fits what has passed by the vehicle's time stamps, by the silence or by the arrival; or
        the one before did not fit either, and this one goes on from it.
        """
        if not self.is_known:
            return True
        passed_s = 0.0 if at_s is None or self._read_at_s is None else at_s - self._read_at_s
        latest_s = max(self.going_on_s, self.now_s + passed_s) + _REBOOT_S
        if self.now_s - _REBOOT_S <= time_s <= latest_s:
            return True
        # Two messages of one stamp, or two copies of one, are one mistake.
        return 0.0 < time_s - self._doubted_s < _REBOOT_S

    def read(self, time_s: float, at_s: float | None = None) -> ClockReading:
        """Take a time stamp of the vehicle; at_s: of its arrival, by any monotonic clock."""
        goes_on = self.is_known and 0.0 <= time_s - self.now_s <= _REBOOT_S
        if not goes_on and not self.believes(time_s, at_s):
            self._doubted_s = time_s
            return ClockReading.DOUBTED
        self._doubted_s, before_s = math.nan, self.now_s
        if self.is_known and before_s - _REBOOT_S <= time_s <= before_s:
            return ClockReading.SAME
        self._read_at_s = at_s
        self.now_s = self.going_on_s = time_s
        if not self.is_known:
            self.is_known = True
            return ClockReading.FIRST
        if time_s < before_s:
            return ClockReading.REBOOTED
        self.passed_s += time_s - before_s
        return ClockReading.LATER

    def beat(self, heartbeat: Message) -> bool:
        """Whether this is a new heartbeat, with no time stamp since the last one.

        Two heartbeats without a time in between are a second apart, if no more is known; a copy
        has the sequence number of the first.
        """
        before_s, going_on_s, before = self._beat
        if (number := heartbeat.get_seq()) == before:
            return False
        stands = self.is_known and before_s == self.now_s
        if stands:
            self.going_on_s = max(self.going_on_s, going_on_s + _BEAT_S)
        self._beat = self.now_s, self.going_on_s, number
        return stands

    def on_silence(self, more_s: float, *, counts: bool) -> ClockReading:
        """Advance the clock in a silence; counts: also before the vehicle's time is known."""
        if self.is_known or not counts:
            self.going_on_s += more_s
            return ClockReading.SAME
        if more_s <= 0.0:
            return ClockReading.SAME
        self.now_s = self.going_on_s = self.now_s + more_s
        return ClockReading.LATER


@final
@dataclass(slots=True, kw_only=True)
class Output:
    """The result of one run(): what to send, record and compute."""

    frames: list[bytes] = field(default_factory=list)
    """To be sent, in order."""
    record: list[Stamped] = field(default_factory=list)
    """Vehicle time and frame, both directions, for the telemetry log."""
    journal: list[Told] = field(default_factory=list)
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

    @property
    def size(self) -> int:
        """Bytes to be recorded, about."""
        frames = sum(len(frame) for _, frame in self.record)
        received = sum(len(call[1]) for call in self.inputs if call[0] == "receive")
        return frames + received + _ENTRY_BYTES * len(self.journal)

    def leave_out(self, numbers: Iterable[int]) -> None:
        """Remove frames that were not sent, by index in `frames`, from the record."""
        unsent = {strip_signature(self.frames[number]) for number in numbers}
        self.record = [stamped for stamped in self.record if stamped[1] not in unsent]


@final
class FrameEncoder:
    """Encodes messages into frames to send; records all frames, both ways, unsigned."""

    def __init__(self, system_id: int | None, signing: Signing | None) -> None:
        self._codec, self._unsent = codec(system_id or 1), codec(system_id or 1)
        """The second is used by the watchdog's thread too, when the first may be in use."""
        self._signing = signing
        self.duplicates = DuplicateIdDetector()
        """Hears of other processes with our ids."""
        self.out = Output()
        """What has come together since it was last taken."""

    def set_system_id(self, system_id: int) -> None:
        """Use this vehicle's system id from now on."""
        for encoder in (self._codec, self._unsent):
            encoder.srcSystem = system_id

    def send(self, messages: Iterable[Message], now_s: float) -> None:
        """Send messages in order."""
        for message in messages:
            frame = message.pack(self._codec)
            self._codec.seq = (self._codec.seq + 1) % 256
            self.out.frames.append(frame if self._signing is None else self._signing.sign(frame))
            self.duplicates.sent.append(frame)
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
