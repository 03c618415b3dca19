"""Bytes to messages and back: parsing that survives anything, and packing.

pymavlink's dialect `all` says what there is, and reads.  What the messages mean is elsewhere.
"""

import math
import re
import struct
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from operator import itemgetter
from typing import Any, final

from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import all as mavlink

_MARKER_1, MARKER_2, SIGNED = 0xFE, 0xFD, 0x01
"""First bytes of a frame of either version, and the flag of signed ones."""
_HEADER_1, _HEADER_2, _CHECKSUM_BYTES, SIGNATURE_BYTES = 6, 10, 2, 13
_HEAD = struct.Struct("<BBBxBBB")
"""Marker, length, flags, sequence, system, component; then comes the message number in 24 bits."""
_LARGEST_FLOAT = 3.4028234663852886e38
_find_marker = re.compile(rb"[\xfd\xfe]").search
_codes = re.compile(r"(\d*)([a-zA-Z])").findall
"""How many there are of each kind in the format of a struct."""
_reader = mavlink.MAVLink(None)


# --- in -------------------------------------------------------------------------------------------


@final
class StreamParser:
    """Parses the bytes of one link into frames and messages; never raises.

    MAVLink 1 and 2; time is linear in the bytes, and less than a frame of them is kept.  With
    ``datagrams`` a frame never goes on in the next call: so a cut one cannot swallow the next.
    After a broken frame the search goes on at its second byte: a frame hidden in it is found.
    Signatures are not looked at (signing.py): they are in the bytes of the frame.
    """

    def __init__(self, *, datagrams: bool) -> None:
        self._datagrams = datagrams
        self._rest = b""

    def feed(self, data: bytes) -> list[tuple[bytes, Any]]:
        """Every intact frame with its message, in order."""
        data, self._rest = self._rest + data, b""
        frames, at, size = list[tuple[bytes, Any]](), 0, len(data)
        while begin := _find_marker(data, at):
            at = begin.start()
            end = _end_of_frame(data, at)
            if end > size and not self._datagrams:
                self._rest = data[at:]
                break
            frame = data[at:end]
            at += 1
            if end > size or (frame[0] == MARKER_2 and frame[2] & ~SIGNED):
                continue
            kind = mavlink.mavlink_map.get(number_of(frame))
            if kind is None:
                # its checksum cannot be checked: believe its length only if a frame follows
                at = end if end == size or data[end] in (_MARKER_1, MARKER_2) else at
            elif (message := _read(frame, kind)) is not None:
                frames.append((frame, message))
                at = end
        return frames


def number_of(frame: bytes) -> int:
    """Which message it is."""
    return int.from_bytes(frame[7:10], "little") if frame[0] == MARKER_2 else frame[5]


def _read(frame: bytes, kind: Any) -> Any:
    """The message of a frame; None if the frame is not intact.

    As pymavlink decodes it, and in half the time where there are no arrays.
    """
    end = len(frame) - (SIGNATURE_BYTES if frame[0] == MARKER_2 and frame[2] else 0) - 2
    if mcrf4xx(frame[1:end] + bytes([kind.crc_extra])) != frame[end] | frame[end + 1] << 8:
        return None
    if frame[0] == _MARKER_1 or any(kind.array_lengths):
        return _reader.decode(bytearray(frame))
    values = kind.unpacker.unpack_from(frame[_HEADER_2:end].ljust(kind.unpacker.size, b"\0"))
    message = kind(*[values[place] for place in kind.orders])
    size, incompatible, compatible, *who = frame[1:7]
    message._header = mavlink.MAVLink_header(kind.id, incompatible, compatible, size, *who)
    message._msgbuf = frame
    return message


def _end_of_frame(data: bytes, at: int) -> int:
    """Where the frame that begins here ends, if it is one; beyond the data if it is cut."""
    if len(data) - at < _HEADER_1 + _CHECKSUM_BYTES:
        return len(data) + 1
    if data[at] == _MARKER_1:
        return at + _HEADER_1 + data[at + 1] + _CHECKSUM_BYTES
    signature = SIGNATURE_BYTES if data[at + 2] & SIGNED else 0
    return at + _HEADER_2 + data[at + 1] + _CHECKSUM_BYTES + signature


# --- out ------------------------------------------------------------------------------------------


Prepared = tuple[int, bytes]
"""A message that is only to be sent: its number and all of its payload; no object is made."""
_ENDS = {
    number: (number.to_bytes(3, "little"), bytes([kind.crc_extra]))
    for number, kind in mavlink.mavlink_map.items()
}
"""The last bytes of a header, and what the checksum covers beside the frame, by number."""


@cache
def _kind(name: str) -> tuple[Any, list[Any], Callable[[Sequence[Any]], Sequence[Any]], bool]:
    """What messages of this name are, and their zeros in MAVLink's order.

    Then how values go from that order into that of the payload; and whether some are lists.
    """
    kind: Any = getattr(mavlink, f"MAVLink_{name.lower()}_message")
    named, sent = kind.fieldnames, kind.ordered_fieldnames
    zeros = {
        field: b"" if code == "s" else [0] * int(count) if count else 0
        for field, (count, code) in zip(sent, _codes(kind.unpacker.format), strict=True)
    }
    reordered = itemgetter(*map(named.index, sent)) if len(sent) > 1 else list
    return kind, [zeros[field] for field in named], reordered, any(kind.array_lengths)


def make(name: str, *fields: Any) -> Prepared:
    """A message of this name, to be sent: its first fields in MAVLink's order, the others are zero.

    Texts are bytes, fields of several values are lists.
    """
    kind, zeros, reordered, has_lists = _kind(name)
    values = reordered((*fields, *zeros[len(fields) :]))
    if has_lists:
        values = [one for v in values for one in (v if isinstance(v, list) else (v,))]
    try:
        return kind.id, kind.unpacker.pack(*values)
    except (struct.error, OverflowError):
        return kind.id, kind.unpacker.pack(*_fitted(values, kind.unpacker.format))


def _fitted(values: Sequence[Any], form: str) -> Iterator[Any]:
    """The nearest values that these fields can carry, as a real autopilot casts; NaN becomes 0."""
    counted = ((code, 1 if code == "s" else int(count or 1)) for count, code in _codes(form))
    codes = (code for code, count in counted for _ in range(count))
    for value, code in zip(values, codes, strict=True):
        if code == "s" or (code in "fd" and not math.isfinite(value)):
            yield value
        elif code in "fd":
            yield min(max(value, -_LARGEST_FLOAT), _LARGEST_FLOAT)
        else:
            span = 1 << 8 * struct.calcsize(code)
            least = 0 if code.isupper() else -span // 2
            yield 0 if math.isnan(value) else int(min(max(value, least), least + span - 1))


def _prepared(message: Any) -> Prepared:
    """The same as this message of pymavlink's."""
    fields = (getattr(message, f"_{n}_raw", getattr(message, n)) for n in message.fieldnames)
    return make(message.msgname, *(list(v) if isinstance(v, tuple) else v for v in fields))


def framed(
    message: Any,
    sequence: int,
    system: int,
    component: int,
    signature: Callable[[bytes], bytes] | None = None,
) -> bytes:
    """A message, prepared or pymavlink's, as a frame of MAVLink 2; signed if there is a way to."""
    number, payload = message if type(message) is tuple else _prepared(message)
    payload = payload.rstrip(b"\0") or b"\0"
    flags = 0 if signature is None else SIGNED
    head = _HEAD.pack(MARKER_2, len(payload), flags, sequence, system, component)
    number_bytes, crc_extra = _ENDS[number]
    body = head + number_bytes + payload
    frame = body + mcrf4xx(body[1:] + crc_extra).to_bytes(2, "little")
    return frame if signature is None else frame + signature(frame)
