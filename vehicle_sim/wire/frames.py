"""Bytes to messages and back: parsing that survives anything, packing, and the sequence numbers.

What the messages mean is in messages.py.  Telemetry is made in telemetry.py.
"""

import math
import re
import struct
from collections.abc import Sequence
from typing import Any, final

from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.wire.dialect import Layout, Prepared, layout_of
from vehicle_sim.wire.signing import LinkSigner

DATAGRAM_BYTES = 1400
_MARKER_1, _MARKER_2 = 0xFE, 0xFD
_HEADER_1, _HEADER_2 = 6, 10
_CHECKSUM_BYTES, _SIGNATURE_BYTES = 2, 13
_SIGNED = 0x01
_HEAD = struct.Struct("<BBBBBBBHB")
"""Marker, length, two flag bytes, sequence, system, component, message number in 24 bits."""
_INT32_MAX = 2**31 - 1
_find_marker = re.compile(rb"[\xfd\xfe]").search


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

    def forget(self) -> None:
        """Whoever spoke is gone: half a frame of theirs is none."""
        self._rest = b""

    def feed(self, data: bytes) -> list[tuple[bytes, Any]]:
        """Every intact frame with its message, in order."""
        data, self._rest = self._rest + data, b""
        found, at, size = list[tuple[bytes, Any]](), 0, len(data)
        while begin := _find_marker(data, at):
            at = begin.start()
            end = _end_of_frame(data, at)
            if end > size and not self._datagrams:
                self._rest = data[at:]
                break
            frame = data[at:end]
            at += 1
            is_2 = frame[0] == _MARKER_2
            if end > size or (is_2 and frame[2] & ~_SIGNED):
                continue
            kind = mavlink.mavlink_map.get(
                int.from_bytes(frame[7:10], "little") if is_2 else frame[5]
            )
            if kind is None:
                # its checksum cannot be checked: believe its length only if a frame follows
                at = end if end == size or data[end] in (_MARKER_1, _MARKER_2) else at
            elif (message := _read(frame, layout_of(kind))) is not None:
                found.append((frame, message))
                at = end
        return found


def _read(frame: bytes, layout: Layout) -> Any:
    """The message of a frame, with its header; None if the frame is not intact."""
    begin = _HEADER_2 if frame[0] == _MARKER_2 else _HEADER_1
    end = begin + frame[1]
    if mcrf4xx(frame[1:end] + layout.crc_extra) != frame[end] | frame[end + 1] << 8:
        return None
    message = layout.message(frame[begin:end])
    header = message.get_header()
    header.mlen = frame[1]
    if begin == _HEADER_2:
        header.incompat_flags, header.compat_flags, *source = frame[2:7]
    else:
        source = [*frame[2:5]]
    header.seq, header.srcSystem, header.srcComponent = source
    message._msgbuf = frame
    return message


def _end_of_frame(data: bytes, at: int) -> int:
    """Where the frame that begins here ends, if it is one; beyond the data if it is cut."""
    if len(data) - at < _HEADER_1 + _CHECKSUM_BYTES:
        return len(data) + 1
    if data[at] == _MARKER_1:
        return at + _HEADER_1 + data[at + 1] + _CHECKSUM_BYTES
    signature = _SIGNATURE_BYTES if data[at + 2] & _SIGNED else 0
    return at + _HEADER_2 + data[at + 1] + _CHECKSUM_BYTES + signature


# --- out ------------------------------------------------------------------------------------------


@final
class Packer:
    """Messages of one component on one link into MAVLink 2 frames, numbered in sequence.

    Three to four times as fast as the messages' own ``pack``: what can be looked up about a type
    is looked up once.
    """

    def __init__(self, system: int, component: int) -> None:
        self.signer: LinkSigner | None = None
        """While it is active, everything is signed."""
        self._system, self._component = system, component
        self._sequence = 0

    def restart(self) -> None:
        """Begin the sequence numbers again."""
        self._sequence = 0

    def frame(self, message: Any) -> bytes:
        """The message as a frame with the next sequence number."""
        sequence = self._sequence
        self._sequence = (sequence + 1) & 255
        if type(message) is Prepared:
            layout, payload = message
        else:
            kind: Any = type(message)
            layout = layout_of(kind)
            payload = layout.payload(message)
        payload = payload.rstrip(b"\0") or b"\0"
        number, signer = layout.number, self.signer
        signed = signer is not None and signer.active
        body = (
            _HEAD.pack(
                _MARKER_2,
                len(payload),
                _SIGNED if signed else 0,
                0,
                sequence,
                self._system,
                self._component,
                number & 0xFFFF,
                number >> 16,
            )
            + payload
        )
        frame = body + mcrf4xx(body[1:] + layout.crc_extra).to_bytes(2, "little")
        return frame + signer.signature(frame) if signer is not None and signed else frame


def datagrams(frames: Sequence[bytes]) -> list[bytes]:
    """Frames in order, as many to a datagram as fit."""
    packed, batch, size = list[bytes](), list[bytes](), 0
    for frame in frames:
        if size + len(frame) > DATAGRAM_BYTES:
            packed.append(b"".join(batch))
            batch, size = [], 0
        batch.append(frame)
        size += len(frame)
    if batch:
        packed.append(b"".join(batch))
    return packed


# --- numbers --------------------------------------------------------------------------------------


def degrees_e7(angle_deg: float) -> int:
    """Degrees -> MAVLink's 1e-7 degrees, as far as they go; zero for what is not a number."""
    return bounded(angle_deg * 1e7, _INT32_MAX)


def bounded(value: float, most: int) -> int:
    """The nearest whole number within +-most: what an integer field can carry."""
    if -most <= value <= most:
        return round(value)
    return (most if value > 0.0 else -most) if math.isfinite(value) else 0
