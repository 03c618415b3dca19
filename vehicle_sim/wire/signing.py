"""MAVLink 2 signing as ArduPilot does it: ardupilot.md 5, GCS_Signing.cpp and mavlink_helpers.h.

Timestamps count 10 microseconds since 2015; the vehicle has no clock for them of its own, but
counts on from what it was given with every frame, and keeps up with what it hears.
"""

import hashlib
import hmac
from dataclasses import dataclass, replace
from typing import Any, Final, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Text

AHEAD: Final = 60 * 100_000
"""The vehicle starts a minute after the time stamp of its key, and takes a new stream that is at
most a minute behind its own time."""
_SAVE_US: Final = 30_000_000
"""Period of storing the key with the current time stamp."""
_MAX_STREAMS: Final = 16
_TAIL, _HASH = 13, 6
_SIGNED: Final = 0x01
_MARKER_2: Final = 0xFD
_TIME_MASK: Final = (1 << 48) - 1
_ALWAYS: Final = frozenset({mavlink.MAVLINK_MSG_ID_RADIO_STATUS, mavlink.MAVLINK_MSG_ID_RADIO})
"""Taken unsigned on any link."""
_TRUSTED_LINK: Final = 0
"""USB, on real boards: takes anything, signed or not, and wrongly signed."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """What is kept in storage over a reboot."""

    secret: bytes
    timestamp: int

    @property
    def is_off(self) -> bool:
        """All zero: signing is not in use."""
        return not self.timestamp and not any(self.secret)


_NO_KEY: Final = Key(secret=bytes(32), timestamp=0)


@final
class LinkSigner:
    """Signs what goes out on one link, while there is a key; frames.Packer asks it."""

    def __init__(self, link: int) -> None:
        self.active = False
        self.secret = b""
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
    """The key of one vehicle, on all its links."""

    def __init__(self, *, links: int, key: Key = _NO_KEY) -> None:
        self._key = key
        self._signers = [LinkSigner(link) for link in range(links)]
        self._streams: dict[tuple[int, int, int], int] = {}
        """Newest time of each stream: link id, system and component."""
        self._saved_us: int | None = None
        self._load()

    @property
    def key(self) -> Key:
        """As it is in storage now."""
        return self._key

    def signer(self, link: int) -> LinkSigner:
        """Who signs for this link; it stays the same one."""
        return self._signers[link]

    def restart(self) -> None:
        """Boot: the key is read from storage, and who spoke before is forgotten."""
        self._streams.clear()
        self._saved_us = None
        self._load()

    def setup(self, message: Any, *, armed: bool) -> Text | None:
        """SETUP_SIGNING; it is never acknowledged.  A text if it is refused."""
        if armed:
            return Text(severity=6, text="ERROR: Won't setup signing when armed")
        secret, timestamp = bytes(message.secret_key), message.initial_timestamp
        self._key = Key(secret=secret, timestamp=timestamp & _TIME_MASK)
        self._load()
        return None

    def accepts(self, frame: bytes, link: int, now_us: int) -> bool:
        """Whether an intact frame may come in by this link."""
        if self._key.is_off:
            return True
        if self._saved_us is None:
            self._saved_us = now_us
        elif now_us - self._saved_us >= _SAVE_US:
            self._save(now_us)
        good = frame[0] == _MARKER_2 and frame[2] & _SIGNED and self._is_good(frame, link)
        return bool(good or link == _TRUSTED_LINK or _number(frame) in _ALWAYS)

    def _is_good(self, frame: bytes, link: int) -> bool:
        if not hmac.compare_digest(_hash(self._key.secret, frame[:-_HASH]), frame[-_HASH:]):
            return False
        timestamp = int.from_bytes(frame[-_TAIL + 1 : -_HASH], "little")
        stream = (frame[-_TAIL], frame[5], frame[6])
        signer = self._signers[link]
        newest = self._streams.get(stream)
        if newest is None:
            if len(self._streams) >= _MAX_STREAMS or timestamp + AHEAD < signer.timestamp:
                return False
        elif timestamp <= newest:
            return False
        self._streams[stream] = timestamp
        signer.timestamp = max(signer.timestamp, timestamp)
        return True

    def _load(self) -> None:
        for signer in self._signers:
            signer.active = not self._key.is_off
            signer.secret = self._key.secret
            signer.timestamp = (self._key.timestamp + AHEAD) & _TIME_MASK

    def _save(self, now_us: int) -> None:
        self._saved_us = now_us
        reached = max(signer.timestamp for signer in self._signers)
        self._key = replace(self._key, timestamp=max(self._key.timestamp, reached))


def _hash(secret: bytes, signed: bytes) -> bytes:
    return hashlib.sha256(secret + signed).digest()[:_HASH]


def _number(frame: bytes) -> int:
    return int.from_bytes(frame[7:10], "little") if frame[0] == _MARKER_2 else frame[5]
