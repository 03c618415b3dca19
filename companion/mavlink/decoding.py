"""An intact frame as pymavlink's message, at a third of the price of its own decoder.

That one reads the header and checks the checksum again, and puts each field in its place in a loop:
it was the largest single part of all that a session does.  What is uncommon is left to it: kinds
with arrays or texts, and frames that are not as they should be.
"""

from functools import cache
from operator import itemgetter
from struct import Struct
from typing import Any, final

from companion.mavlink.dialect import Message, wire
from companion.mavlink.frames import V2, number_of, payload_of

_CHECKSUM = Struct("<H")


@final
class Decoder:
    """Frames to messages; nothing is kept from one to the next."""

    def __init__(self) -> None:
        self._thorough = wire.MAVLink(None)

    def decode(self, frame: bytes) -> Message:
        """The message of a frame that is whole, intact, of a known kind and without signature.

        Raises MAVError for one that pymavlink refuses.
        """
        kind = wire.mavlink_map[number_of(frame)]
        in_order = _in_order(kind)
        if in_order is None:
            return self._thorough.decode(bytearray(frame))
        size = kind.unpacker.size
        message = kind(*in_order(kind.unpacker.unpack(payload_of(frame, size)[:size])))
        message._msgbuf = bytearray(frame)
        message._payload = message._msgbuf[6:-2]
        (message._crc,) = _CHECKSUM.unpack_from(frame, len(frame) - 2)
        header = message._header
        if frame[0] == V2:
            _, header.mlen, header.incompat_flags, header.compat_flags = frame[:4]
            header.seq, header.srcSystem, header.srcComponent = frame[4:7]
        else:
            _, header.mlen, header.seq, header.srcSystem, header.srcComponent = frame[:5]
        return message


@cache
def _in_order(kind: Any) -> "itemgetter[Any] | None":
    """The fields of a kind from the order of the wire in that of its arguments.

    None: it has arrays, texts, or a single field.
    """
    plain = all(length == 1 for length in kind.lengths) and b"c" not in kind.native_format
    return itemgetter(*kind.orders) if plain and len(kind.orders) > 1 else None
