"""Where MAVLink frames lie in bytes, and whether they are intact: found, not decoded."""

import re
from typing import Final

from fastcrc.crc16 import mcrf4xx

from companion.mavlink.dialect import wire

V1: Final = 0xFE
V2: Final = 0xFD
LONGEST: Final = 10 + 255 + 2 + 13
"""Bytes of the longest frame: header, payload, checksum and signature."""
_HEADER_1, _HEADER_2 = 6, 10
_CHECKSUM, _SIGNATURE = 2, 13
_SIGNED: Final = 0x01
find_marker = re.compile(rb"\xfd(?:.[\x00\x01]|.?\Z)|\xfe", re.DOTALL).search
"""What a frame can begin with: of the second protocol, no flags but the one of signatures."""


def claim(data: bytes, at: int) -> tuple[int, int | None]:
    """Where the frame ends whose header is there, and its message number.

    Beyond the data and None while the header is not all there.
    """
    if data[at] == V1:
        if at + _HEADER_1 > len(data):
            return at + _HEADER_1, None
        return at + _HEADER_1 + data[at + 1] + _CHECKSUM, data[at + 5]
    if at + _HEADER_2 > len(data):
        return at + _HEADER_2, None
    signature = _SIGNATURE if data[at + 2] & _SIGNED else 0
    number = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
    return at + _HEADER_2 + data[at + 1] + _CHECKSUM + signature, number


def plausible_end(data: bytes, at: int) -> int:
    """Where the frame ends that seems to begin there; beyond the data if it is not all there.

    0: it is none, or none that may be read.
    """
    end, number = claim(data, at)
    if number is None:
        return end
    kind = wire.mavlink_map.get(number)
    if data[at] == V1:
        # The first protocol knows no fields beyond these: more is noise.
        return end if kind is not None and data[at + 1] <= kind.unpacker.size else 0
    if kind is None and end < len(data) and data[end] not in (V1, V2):
        return 0  # its checksum cannot be checked: its length is believed if a frame follows
    return end


def intact_end(data: bytes, at: int) -> int:
    """Where the intact frame ends that begins there; 0 if there is none, or not all of it.

    Intact: of a known kind, with the right checksum, without flags that are not understood.
    """
    size = len(data)
    if at >= size or data[at] not in (V1, V2):
        return 0
    end, number = claim(data, at)
    if number is None or end > size:
        return 0
    kind = wire.mavlink_map.get(number)
    if kind is None or (data[at] == V2 and data[at + 2] > _SIGNED):
        return 0
    if data[at] == V1 and data[at + 1] > kind.unpacker.size:
        return 0
    return end if checksum_is_right(data[at:end], kind.crc_extra) else 0


def checksum_is_right(frame: bytes, extra: int) -> bool:
    """Of a whole frame; extra: what the kind of message adds to its checksum."""
    end = (_HEADER_2 if frame[0] == V2 else _HEADER_1) + frame[1]
    return bool(mcrf4xx(frame[1:end] + bytes((extra,))) == frame[end] | frame[end + 1] << 8)


def number_of(frame: bytes) -> int:
    """The message number of a whole frame."""
    return frame[7] | frame[8] << 8 | frame[9] << 16 if frame[0] == V2 else frame[5]


def sender_of(frame: bytes) -> tuple[int, int]:
    """System and component id that a whole frame claims to come from."""
    return (frame[5], frame[6]) if frame[0] == V2 else (frame[3], frame[4])


def payload_of(frame: bytes, size: int) -> bytes:
    """The payload of a whole frame, with the zeros that the second protocol leaves out.

    size: how many bytes are wanted at least.
    """
    head = _HEADER_2 if frame[0] == V2 else _HEADER_1
    return frame[head : head + frame[1]].ljust(size, b"\0")
