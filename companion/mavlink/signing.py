"""MAVLink 2 signing: verifies received frames, signs ours.  mavlink.md 2.6, ardupilot.md 5.

A signature is 13 bytes after the checksum: link id, a time stamp of 48 bits that counts 10
microseconds since 2015, and the first 48 bits of SHA-256(key + frame + link id + time stamp).  Each
stream (link id, system, component) must rise; a new one may be a minute behind us.  A time stamp
ahead of ours is accepted, and ours follows it: ArduPilot's runs a minute ahead.

pymavlink 2.4.50 does not check what comes in: it lets messages that its dialect lacks pass
unchecked, and lets a forged frame move a stream's time before its signature has been looked at,
which locks out the real sender.  Nor can it sign a frame that was packed before.
"""

import hashlib
import hmac
import math
from typing import Final, final

from fastcrc.crc16 import mcrf4xx

from companion.mavlink.dialect import wire

KEY_BYTES: Final = 32
TICKS_PER_S: Final = 100_000
"""Time stamps count 10 microseconds."""
_EPOCH_S: Final = 1_420_070_400
"""1 January 2015, UTC, in seconds since 1970."""
_LAST: Final = (1 << 48) - 1
_BEHIND: Final = 60 * TICKS_PER_S
_MAX_STREAMS: Final = 256
_COMPLAIN_S: Final = 60.0
_LINK_ID: Final = b"\0"
"""Of all that we sign: a stream's time stamps rise, and a companion has one link."""
_MARKER: Final = 0xFD
_SIGNED: Final = 0x01
_HEADER, _TAIL, _HASH = 10, 13, 6

ACCEPTED_UNSIGNED: Final = frozenset({wire.MAVLINK_MSG_ID_RADIO_STATUS})
"""Accepted unsigned: telemetry radios cannot sign."""
SECRETS: Final = frozenset(
    {
        wire.MAVLINK_MSG_ID_SETUP_SIGNING,
        wire.MAVLINK_MSG_ID_AUTH_KEY,
        wire.MAVLINK_MSG_ID_CHANGE_OPERATOR_CONTROL,
        wire.MAVLINK_MSG_ID_WIFI_CONFIG_AP,
        wire.MAVLINK_MSG_ID_AIRLINK_AUTH,
    }
)
"""Messages that carry a key or a password: never logged, forwarded or answered."""


def key_of(text: str) -> bytes:
    """The 32 bytes of a key: 64 hexadecimal digits, or any other phrase by its SHA-256.

    Ground stations (QGroundControl, MAVProxy, Mission Planner) make a key of a phrase like this.
    """
    if len(text) == 2 * KEY_BYTES and all(digit in "0123456789abcdefABCDEF" for digit in text):
        return bytes.fromhex(text)
    return hashlib.sha256(text.encode()).digest()


def timestamp_of(clock_s: float) -> int:
    """The time stamp of a clock that counts seconds since 1970."""
    return _bounded((clock_s - _EPOCH_S) * TICKS_PER_S)


def is_signed(frame: bytes) -> bool:
    """Whether a whole frame carries a signature."""
    return frame[0] == _MARKER and bool(frame[2] & _SIGNED)


def strip_signature(frame: bytes) -> bytes:
    """The same frame unsigned, as logs keep it: the flag cleared, the checksum right again."""
    if not is_signed(frame):
        return frame
    return _flag_flipped(frame[:-_TAIL])


def _flag_flipped(frame: bytes) -> bytes:
    """A frame without a signature, with the flag that tells of one flipped."""
    end = len(frame) - 2
    # A checksum is linear: flipping one bit changes it by the checksum of that bit alone, which
    # needs neither the payload nor the dialect.  One byte more: the dialect's, which is not sent.
    change = mcrf4xx(bytes((0, _SIGNED)) + bytes(end - 2), 0)
    checksum = int.from_bytes(frame[end:], "little") ^ change
    return frame[:2] + bytes((frame[2] ^ _SIGNED,)) + frame[3:end] + checksum.to_bytes(2, "little")


@final
class Signing:
    """Signs the frames that one companion sends, and verifies those it receives."""

    def __init__(self, *, key: bytes, timestamp: int) -> None:
        """timestamp: of the first frame; higher than any that was ever used with this key."""
        if len(key) != KEY_BYTES:
            raise ValueError(f"a key has {KEY_BYTES} bytes")
        self.refused = 0
        """Frames that were not believed: unsigned, wrongly signed, replayed, or too old."""
        self._complained, self._complained_at_s = 0, -math.inf
        self._streams: dict[tuple[int, int, int], int] = {}
        """The newest time stamp of each link id, system and component."""
        self._next = timestamp
        self._hash = hashlib.sha256(key)
        self._began: tuple[float, int] | None = None

    @property
    def timestamp(self) -> int:
        """Of the next frame: to be kept, so that it never falls."""
        return min(self._next, _LAST)

    def sign(self, frame: bytes) -> bytes:
        """A whole unsigned MAVLink 2 frame signed: newer than any before.  For any thread."""
        if frame[0] != _MARKER or is_signed(frame):
            return frame
        timestamp = self.timestamp
        self._raise_to(timestamp + 1)
        stamp = _LINK_ID + timestamp.to_bytes(6, "little")
        signed = _flag_flipped(frame) + stamp
        return signed + self._signature(signed)

    def on_time(self, at_s: float) -> None:
        """Advance the time stamp by a clock, of which only differences matter, seconds."""
        if self._began is None:
            self._began = (at_s, self.timestamp)
        began_s, first = self._began
        self._raise_to(_bounded(first + (at_s - began_s) * TICKS_PER_S))

    def accepts(self, frame: bytes) -> bool:
        """Whether to accept a whole frame with the right checksum; rejections are counted.

        Only a frame with the right signature changes anything.
        """
        if not is_signed(frame):
            number = frame[7] | frame[8] << 8 | frame[9] << 16 if frame[0] == _MARKER else frame[5]
            believed = number in ACCEPTED_UNSIGNED
        else:
            signature = self._signature(frame[:-_HASH])
            believed = hmac.compare_digest(signature, frame[-_HASH:]) and self._is_news(frame)
        self.refused += not believed
        return believed

    def _is_news(self, frame: bytes) -> bool:
        """Whether a frame with the right signature is newer than all of its stream."""
        timestamp = int.from_bytes(frame[1 - _TAIL : -_HASH], "little")
        stream = (frame[-_TAIL], frame[5], frame[6])
        if (newest := self._streams.get(stream)) is None:  # one too many is refused as well
            oldest = self.timestamp - _BEHIND
            is_news = timestamp >= oldest and len(self._streams) < _MAX_STREAMS
        else:
            is_news = timestamp > newest
        if is_news:
            self._streams[stream] = timestamp
            self._raise_to(timestamp)
        return is_news

    def complaint(self, now_s: float) -> str | None:
        """Rejections since the last text: at most once a minute, short enough for a STATUSTEXT."""
        new = self.refused - self._complained
        if not new or 0.0 <= now_s - self._complained_at_s < _COMPLAIN_S:  # a clock may begin again
            return None
        self._complained, self._complained_at_s = self.refused, now_s
        return f"refused: {new} frames unsigned or wrongly signed"

    def _raise_to(self, timestamp: int) -> None:
        self._next = max(self._next, timestamp)

    def _signature(self, signed: bytes) -> bytes:
        """The last bytes of a frame, over all before them."""
        digest = self._hash.copy()
        digest.update(signed)
        return digest.digest()[:_HASH]


def _bounded(timestamp: float) -> int:
    return min(max(int(timestamp), 0), _LAST) if math.isfinite(timestamp) else 0
