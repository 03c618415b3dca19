"""An intact frame as pymavlink's message, at a third of the price of its own decoder.

That one reads the header and checks the checksum again, and puts each field in its place in a loop:
it was the largest single part of all that a session does.  What is uncommon is left to it: kinds
with texts, and frames that are not as they should be.
"""

from collections.abc import Callable, Sequence
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
def _in_order(kind: Any) -> Callable[[tuple[Any, ...]], Sequence[Any]] | None:
    """The fields of a kind from the order of the wire in that of its arguments.

    None: it has texts, or a single field.
    """
    lengths = kind.lengths
    if len(kind.orders) == 1 or b"c" in kind.native_format:
        return None
    at = [sum(lengths[:order]) for order in kind.orders]
    if sum(lengths) == len(lengths):
        return itemgetter(*at)
    fields = itemgetter(
        *(
            slice(first, first + lengths[order]) if lengths[order] > 1 else first
            for first, order in zip(at, kind.orders, strict=True)
        )
    )
    return lambda values: [
        list(field) if isinstance(field, tuple) else field for field in fields(values)
    ]
