"""Bytes of a link, in any portions and whatever they are, to the messages that they carry.

pymavlink decodes the messages; it does not find them, because in version 2.4.50 its parser
- throws away up to 280 bytes after a byte of noise that looks like a start, good frames and all;
- keeps everything in memory for as long as each portion ends within a frame;
- believes anything with the environment's MAV_IGNORE_CRC, and what it does not know in any case.
"""

import enum
from collections import Counter
from typing import final

from companion.mavlink.decoding import Decoder
from companion.mavlink.dialect import Message, wire
from companion.mavlink.frames import (
    checksum_is_right,
    find_marker,
    intact_end,
    number_of,
    plausible_end,
)
from companion.mavlink.needless import Unread
from companion.mavlink.signing import SECRETS, Signing, is_signed, strip_signature


class Passed(enum.Enum):
    """What was passed over."""

    GARBAGE = "bytes between frames"
    """Of frames with incompatible flags, too."""
    CHECKSUM = "frames with a wrong checksum"
    UNKNOWN = "messages of an unknown kind"
    SECRET = "messages with a key or password"


@final
class Receiver:
    """Finds the messages in what comes in on one link; nothing is ever raised.

    MAVLink 1 and 2.  Time is linear in the bytes; less than one frame is kept.  After what turns
    out not to be a frame the search goes on at its second byte, so a frame within is found.  An
    intact frame at the beginning of a portion shows that the frame before it was cut short: so a
    torn datagram holds nothing up.
    """

    def __init__(
        self, signing: Signing | None = None, needless: frozenset[int] = frozenset()
    ) -> None:
        """signing: None believes everybody, signed or not.

        needless: numbers of messages that nobody wants to read: they come as `Unread`.
        """
        self.passed: Counter[Passed] = Counter()
        """Bytes of garbage, and frames; what was not believed is in Signing.refused."""
        self.signed = 0
        """Frames that carried a signature, right or wrong."""
        self._signing = signing
        self._needless = needless
        self._decoder = Decoder()
        self._rest = b""

    def feed(self, data: bytes) -> list[Message]:
        """The messages that are complete now, in order; their get_msgbuf() is without signature."""
        portion_at = len(self._rest)
        data = self._rest + data
        messages: list[Message] = []
        at, size = 0, len(data)
        while (found := find_marker(data, at)) is not None:
            start = found.start()
            if start > at:
                self.passed[Passed.GARBAGE] += start - at
            at = start
            end = plausible_end(data, at)
            if end > size:
                if not (at < portion_at < size and intact_end(data, portion_at)):
                    break
                at = self._skip(at)
            elif end:
                at = self._take(data, at, end, messages)
            else:
                at = self._skip(at)
        else:
            if size > at:
                self.passed[Passed.GARBAGE] += size - at
            at = size
        self._rest = data[at:]
        return messages

    def _take(self, data: bytes, at: int, end: int, messages: list[Message]) -> int:
        """Add the message of the frame there, if it is intact; where to go on."""
        frame = data[at:end]
        number = number_of(frame)
        kind = wire.mavlink_map.get(number)
        if kind is None:
            self.passed[Passed.UNKNOWN] += 1
            return end
        if not checksum_is_right(frame, kind.crc_extra):
            self.passed[Passed.CHECKSUM] += 1
            return self._skip(at)
        signed = is_signed(frame)
        self.signed += signed
        if self._signing is not None and not self._signing.accepts(frame):
            return end
        if number in SECRETS:
            self.passed[Passed.SECRET] += 1
            return end
        plain = strip_signature(frame) if signed else frame
        if number in self._needless:
            messages.append(Unread(plain))
            return end
        try:
            message = self._decoder.decode(plain)
        except wire.MAVError:
            self.passed[Passed.CHECKSUM] += 1
            return end
        message._signed = signed and self._signing is not None
        messages.append(message)
        return end

    def _skip(self, at: int) -> int:
        self.passed[Passed.GARBAGE] += 1
        return at + 1


__all__ = ["Passed", "Receiver"]
