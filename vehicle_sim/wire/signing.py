"""MAVLink 2 signing as ArduPilot does it: ardupilot.md 5, GCS_Signing.cpp and mavlink_helpers.h.

Timestamps count 10 microseconds since 2015; the vehicle has no clock for them of its own, but
counts on from what it was given with every frame, and keeps up with what it hears.
"""

import hashlib
from typing import Any, Final, final

from vehicle_sim.autopilot.values import Text
from vehicle_sim.wire.frames import MARKER_2, SIGNATURE_BYTES, SIGNED

AHEAD: Final = 60 * 100_000
"""The vehicle starts a minute after the time stamp of its key, and takes a new stream that is at
most a minute behind its own time."""
_HASH_BYTES: Final = 6
_TIME_MASK: Final = (1 << 48) - 1
_TRUSTED_LINK: Final = 0
"""USB, on real boards: takes anything, signed or not, and wrongly signed."""


@final
class Signing:
    """The key of one vehicle, on all its links; that and what was heard are kept over a reboot."""

    def __init__(self) -> None:
        self.secret = b""
        """Empty: nothing is signed, and everything comes in."""
        self._timestamp = 0
        """Of the next frame."""
        self._streams: dict[bytes, int] = {}
        """Newest time of each stream, by link id, system and component."""

    def setup(self, message: Any, *, armed: bool) -> list[Text]:
        """SETUP_SIGNING; it is never acknowledged.  A text if it is refused.

        All zero: signing is not in use.
        """
        if armed:
            return [Text(severity=6, text="ERROR: Won't setup signing when armed")]
        secret, timestamp = bytes(message.secret_key), message.initial_timestamp
        self.secret = secret if timestamp or any(secret) else b""
        self._timestamp = timestamp + AHEAD
        return []

    def signature(self, frame: bytes, link: int) -> bytes:
        """Link id, time and hash: the 13 bytes after a frame."""
        tail = bytes([link]) + (self._timestamp & _TIME_MASK).to_bytes(6, "little")
        self._timestamp += 1
        return tail + self._hash(frame + tail)

    def accepts(self, frame: bytes, link: int) -> bool:
        """Whether an intact frame may come in by this link."""
        return not self.secret or self._is_good(frame) or link == _TRUSTED_LINK

    def _is_good(self, frame: bytes) -> bool:
        """Signed with the key, and newer than all that came of its stream."""
        if frame[0] != MARKER_2 or not frame[2] & SIGNED:
            return False
        tail = frame[-SIGNATURE_BYTES:]
        stream, timestamp = tail[:1] + frame[5:7], int.from_bytes(tail[1:-_HASH_BYTES], "little")
        newest = self._streams.get(stream, self._timestamp - AHEAD - 1)
        if timestamp <= newest or self._hash(frame[:-_HASH_BYTES]) != tail[-_HASH_BYTES:]:
            return False
        self._streams[stream] = timestamp
        self._timestamp = max(self._timestamp, timestamp)
        return True

    def _hash(self, signed: bytes) -> bytes:
        return hashlib.sha256(self.secret + signed).digest()[:_HASH_BYTES]
