"""Bytes of a link, in any portions and whatever they are, to the messages that they carry.

pymavlink decodes the messages; it does not find them, because in version 2.4.50 its parser
- throws away up to 280 bytes after a byte of noise that looks like a start, good frames and all;
- keeps everything in memory for as long as each portion ends within a frame;
- believes anything with the environment's MAV_IGNORE_CRC, and what it does not know in any case.
"""

import enum
import re
from collections import Counter
from typing import Final, final

from fastcrc.crc16 import mcrf4xx

from companion.mavlink.dialect import Message, wire
from companion.mavlink.signing import SECRETS, Signing, is_signed, strip_signature

_V1, _V2 = 0xFE, 0xFD
_HEADER_1, _HEADER_2 = 6, 10
_CHECKSUM, _SIGNATURE = 2, 13
_SIGNED: Final = 0x01
_find_marker = re.compile(rb"\xfd(?:.[\x00\x01]|.?\Z)|\xfe", re.DOTALL).search
"""What a frame can begin with: of the second protocol, no flags but the one of signatures."""


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

    def __init__(self, signing: Signing | None = None) -> None:
        """signing: None believes everybody, signed or not."""
        self.passed: Counter[Passed] = Counter()
        """Bytes of garbage, and frames; what was not believed is in Signing.refused."""
        self.signed = 0
        """Frames that carried a signature, right or wrong."""
        self._signing = signing
        self._decoder = wire.MAVLink(None)
        self._rest = b""

    def feed(self, data: bytes) -> list[Message]:
        """The messages that are complete now, in order; their get_msgbuf() is without signature."""
        portion_at = len(self._rest)
        data = self._rest + data
        messages: list[Message] = []
        at, size = 0, len(data)
        while (found := _find_marker(data, at)) is not None:
            start = found.start()
            if start > at:
                self.passed[Passed.GARBAGE] += start - at
            at = start
            end = _end(data, at)
            if end > size:
                if not (at < portion_at < size and _is_intact(data, portion_at)):
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
        number = _claim(data, at)[1]
        kind = wire.mavlink_map.get(number)
        if kind is None:
            self.passed[Passed.UNKNOWN] += 1
            return end
        frame = data[at:end]
        if not _checksum_is_right(frame, kind.crc_extra):
            self.passed[Passed.CHECKSUM] += 1
            return self._skip(at)
        signed = is_signed(frame)
        self.signed += signed
        if self._signing is not None and not self._signing.accepts(frame):
            return end
        if number in SECRETS:
            self.passed[Passed.SECRET] += 1
            return end
        try:
            message = self._decoder.decode(bytearray(strip_signature(frame)))
        except wire.MAVError:
            self.passed[Passed.CHECKSUM] += 1
            return end
        message._signed = signed and self._signing is not None
        messages.append(message)
        return end

    def _skip(self, at: int) -> int:
        self.passed[Passed.GARBAGE] += 1
        return at + 1


def _end(data: bytes, at: int) -> int:
    """Where the frame ends that seems to begin there; beyond the data if it is not all there.

    0: it is none, or none that may be read.
    """
    end, number = _claim(data, at)
    if number is None:
        return end
    kind = wire.mavlink_map.get(number)
    if data[at] == _V1:
        # The first protocol knows no fields beyond these: more is noise.
        return end if kind is not None and data[at + 1] <= kind.unpacker.size else 0
    if kind is None and end < len(data) and data[end] not in (_V1, _V2):
        return 0  # its checksum cannot be checked: its length is believed if a frame follows
    return end


def _claim(data: bytes, at: int) -> tuple[int, int | None]:
    """Where the frame ends whose header is there, and its message number.

    Beyond the data and None while the header is not all there.
    """
    if data[at] == _V1:
        if at + _HEADER_1 > len(data):
            return at + _HEADER_1, None
        return at + _HEADER_1 + data[at + 1] + _CHECKSUM, data[at + 5]
    if at + _HEADER_2 > len(data):
        return at + _HEADER_2, None
    signature = _SIGNATURE if data[at + 2] & _SIGNED else 0
    number = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
    return at + _HEADER_2 + data[at + 1] + _CHECKSUM + signature, number


def _is_intact(data: bytes, at: int) -> bool:
    """Whether a whole frame of a known kind with the right checksum begins there."""
    if data[at] not in (_V1, _V2):
        return False
    end, number = _claim(data, at)
    kind = wire.mavlink_map.get(number)
    return (
        kind is not None and end <= len(data) and _checksum_is_right(data[at:end], kind.crc_extra)
    )


def _checksum_is_right(frame: bytes, extra: int) -> bool:
    """Of a whole frame; extra: what the kind of message adds to its checksum."""
    end = (_HEADER_2 if frame[0] == _V2 else _HEADER_1) + frame[1]
    return bool(mcrf4xx(frame[1:end] + bytes((extra,))) == frame[end] | frame[end + 1] << 8)


__all__ = ["Passed", "Receiver"]
