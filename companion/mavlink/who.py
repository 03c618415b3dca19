"""Who is who on a link: which system is our vehicle, and whether somebody else uses our ids."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, final

from companion.mavlink.dialect import AUTOPILOT_COMPONENT, wire
from companion.mavlink.frames import Incoming, number_of, payload_of, sender_of, sequence_of
from companion.mission.events import DuplicateId

TO_COMPONENT_1: Final = "Set the autopilot's component id to 1 (MAV_COMP_ID)."
_HEARTBEATS = 3  # of one system, and of no other, at one a second: then it is the vehicle
_ENOUGH = 10  # of any: then it will not become clear by itself
_NO_AUTOPILOTS = (wire.MAV_TYPE_GCS, wire.MAV_TYPE_ONBOARD_CONTROLLER)

_KEPT = 2048  # frames that may still come back: 10 s at 200 Hz
_STRANGE = 3  # heartbeats, or other frames
_SPAN_S = 1.5  # from the first of them to the last, at the least
_GAP_S = 3.0  # after so long without any it begins anew,
_GONE_S = 10.0  # and so long for one that was certain
_TELL_S = 0.5


def ids_in_words(ids: Iterable[tuple[int, int]]) -> str:
    """Such as: component 50 of system 1, component 51 of system 1."""
    return ", ".join(f"component {component} of system {system}" for system, component in ids)


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
        self._heard: dict[int, int] = {}

    @property
    def ambiguity(self) -> str:
        """A warning once several autopilots have been heard for a while; empty: unambiguous."""
        if self.system_id is not None or sum(self._heard.values()) < _ENOUGH:
            return ""
        names = ", ".join(str(system) for system in sorted(self.others))
        return f"systems {names} are heard, choose one with --system"

    def is_ours(self, heard: Incoming) -> bool:
        """Whether our autopilot sent this; before one is selected: whether any autopilot did."""
        if self.system_id is None:
            return heard.component == AUTOPILOT_COMPONENT and _is_an_autopilots(heard)
        return heard.system == self.system_id and heard.component == AUTOPILOT_COMPONENT

    def on_heartbeat(self, heard: Incoming) -> bool:
        """Whether this heartbeat completes the selection."""
        system = heard.system
        if not _is_an_autopilots(heard):
            return False
        if heard.component != AUTOPILOT_COMPONENT:
            self.elsewhere.add((system, heard.component))
            return False
        if system == self.system_id:
            return False
        self.others.add(system)
        if self.system_id is not None:
            return False
        self._heard[system] = self._heard.get(system, 0) + 1
        if len(self._heard) > 1 or self._heard[system] < _HEARTBEATS:
            return False
        self.system_id = system
        self.others.clear()
        return True


def _is_an_autopilots(heard: Incoming) -> bool:
    """Whether this heartbeat tells of an autopilot, of whatever component."""
    message = heard.message
    if heard.number != wire.MAVLINK_MSG_ID_HEARTBEAT or message is None:
        return False
    return message.type not in _NO_AUTOPILOTS and message.autopilot != wire.MAV_AUTOPILOT_INVALID


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
        self._sent: dict[tuple[int, int, bytes], None] = {}
        self._strangers: dict[int, _Stranger] = {}
        """By system id: whose companion we are may not be known yet."""

    def sent(self, frame: bytes) -> None:
        """A frame of ours, signed or not."""
        key = _key(frame)
        self._sent.pop(key, None)
        self._sent[key] = None
        if len(self._sent) > _KEPT:
            del self._sent[next(iter(self._sent))]

    def heard(self, frame: bytes, system_id: int | None, now_s: float) -> DuplicateId | None:
        """The event for a companion's frame that is not ours, if one is due.

        system_id: ours, None as long as it is not known.
        """
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


def _key(frame: bytes) -> tuple[int, int, bytes]:
    """The part of a frame that a reflection does not change, MAVLink 1 or 2."""
    return sequence_of(frame), number_of(frame), payload_of(frame, 0).rstrip(b"\0")
