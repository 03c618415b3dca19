"""MAVLink 2 signing as ArduPilot does it: ardupilot.md 5, GCS_Signing.cpp and mavlink_helpers.h.

Timestamps count 10 microseconds since 2015; the vehicle has no clock for them of its own, but
counts on from what it was given with every frame, and keeps up with what it hears.
"""

import hashlib
import hmac
from typing import Any, Final, final

from vehicle_sim.autopilot.values import Text

AHEAD: Final = 60 * 100_000
"""The vehicle starts a minute after the time stamp of its key, and takes a new stream that is at
most a minute behind its own time."""
_MAX_STREAMS: Final = 16
_TAIL, _HASH = 13, 6
_SIGNED: Final = 0x01
_MARKER_2: Final = 0xFD
_TIME_MASK: Final = (1 << 48) - 1
_RADIO_STATUS: Final = (109, 166)
"""Taken unsigned on any link, as its older form is."""
_TRUSTED_LINK: Final = 0
"""USB, on real boards: takes anything, signed or not, and wrongly signed."""


@final
class LinkSigner:
    """Signs what goes out on one link, while there is a key; frames.Packer asks it."""

    def __init__(self, link: int) -> None:
        self.secret = b""
        """Empty: nothing is signed."""
        self.timestamp = 0
        """Of the next frame."""
        self._link = bytes([link])

    def signature(self, frame: bytes) -> bytes:
        """Link id, time and hash: the 13 bytes after a frame."""
        tail = self._link + self.timestamp.to_bytes(6, "little")
        self.timestamp = (self.timestamp + 1) & _TIME_MASK
        return tail + _hash(self.secret, frame + tail)


@final
class Signing:
    """The key of one vehicle, on all its links; it is kept over a reboot."""

    def __init__(self, *, links: int) -> None:
        self._signers = [LinkSigner(link) for link in range(links)]
        self._streams: dict[tuple[int, int, int], int] = {}
        """Newest time of each stream: link id, system and component."""

    def signer(self, link: int) -> LinkSigner:
        """Who signs for this link; it stays the same one."""
        return self._signers[link]

    def restart(self) -> None:
        """Boot: who spoke before is forgotten, and the time that was reached is not."""
        self._streams.clear()

    def setup(self, message: Any, *, armed: bool) -> Text | None:
        """SETUP_SIGNING; it is never acknowledged.  A text if it is refused.

        All zero: signing is not in use.
        """
        if armed:
            return Text(severity=6, text="ERROR: Won't setup signing when armed")
        secret, timestamp = bytes(message.secret_key), message.initial_timestamp & _TIME_MASK
        for signer in self._signers:
            signer.secret = secret if timestamp or any(secret) else b""
            signer.timestamp = (timestamp + AHEAD) & _TIME_MASK
        return None

    def accepts(self, frame: bytes, link: int) -> bool:
        """Whether an intact frame may come in by this link."""
        signer = self._signers[link]
        if not signer.secret:
            return True
        is_2 = frame[0] == _MARKER_2
        if is_2 and frame[2] & _SIGNED and self._is_good(frame, signer):
            return True
        number = int.from_bytes(frame[7:10], "little") if is_2 else frame[5]
        return link == _TRUSTED_LINK or number in _RADIO_STATUS

    def _is_good(self, frame: bytes, signer: LinkSigner) -> bool:
        if not hmac.compare_digest(_hash(signer.secret, frame[:-_HASH]), frame[-_HASH:]):
            return False
        timestamp = int.from_bytes(frame[-_TAIL + 1 : -_HASH], "little")
        stream = (frame[-_TAIL], frame[5], frame[6])
        newest = self._streams.get(stream)
        if newest is None:
            if len(self._streams) >= _MAX_STREAMS or timestamp + AHEAD < signer.timestamp:
                return False
        elif timestamp <= newest:
            return False
        self._streams[stream] = timestamp
        signer.timestamp = max(signer.timestamp, timestamp)
        return True


def _hash(secret: bytes, signed: bytes) -> bytes:
    return hashlib.sha256(secret + signed).digest()[:_HASH]
