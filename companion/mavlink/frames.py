"""Finds MAVLink frames in the bytes of a link, checks and decodes them.

pymavlink knows the messages; it does not find them, because in version 2.4.50 its parser
- throws away up to 280 bytes after a byte of noise that looks like a start, good frames and all;
- keeps everything in memory for as long as each portion ends within a frame;
- accepts any checksum with the environment's MAV_IGNORE_CRC, and unknown messages in any case.
Nor does it decode them: it parses header and checksum again and reorders the fields in a loop, at
three times the cost.
"""

import re
from collections.abc import Callable, Sequence
from functools import cache
from operator import itemgetter
from struct import Struct
from typing import Any, Final, NamedTuple, final

from fastcrc.crc16 import mcrf4xx

from companion.mavlink.dialect import KINDS, Message
from companion.mavlink.signing import SECRETS, Signing, strip_signature
from companion.printable import printable

V1: Final = 0xFE
V2: Final = 0xFD
LONGEST: Final = 10 + 255 + 2 + 13
"""Bytes of the longest frame: header, payload, checksum and signature."""
_HEADER_1, _HEADER_2 = 6, 10
_CHECKSUM, _SIGNATURE = 2, 13
_SIGNED: Final = 0x01
_BEGUN_AGAIN = 128
_CRC: Final = Struct("<H")
find_marker = re.compile(rb"\xfd(?:.[\x00\x01]|.?\Z)|\xfe", re.DOTALL).search
"""A possible start of frame: in MAVLink 2 only the signature flag may be set."""


# --- a frame


def frame_extent(data: bytes, at: int) -> tuple[int, int | None, bool]:
    """End of the frame with its header at `at`, its message number, and whether it is intact.

    Intact: whole, of a known kind, with the right checksum, without flags that are not understood.
    While the header is not all there: an end beyond the data, and None.
    """
    is_first = data[at] == V1
    head = at + (_HEADER_1 if is_first else _HEADER_2)
    if head > len(data):
        return head, None, False
    sealed, flags = head + data[at + 1], 0 if is_first else data[at + 2]
    number = data[at + 5] if is_first else data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
    end, kind = sealed + _CHECKSUM + _SIGNATURE * (flags & _SIGNED), KINDS.get(number)
    if kind is None or end > len(data) or flags > _SIGNED:
        return end, number, False
    if is_first and data[at + 1] > kind.unpacker.size:
        return end, number, False  # it knows no fields beyond those of the kind: this is noise
    checksum = mcrf4xx(data[at + 1 : sealed] + bytes((kind.crc_extra,)))
    return end, number, checksum == data[sealed] | data[sealed + 1] << 8


def intact_end(data: bytes, at: int) -> int:
    """End of the intact frame that begins at `at`; 0 if there is none, or it is incomplete."""
    if at >= len(data) or data[at] not in (V1, V2):
        return 0
    end, _, is_intact = frame_extent(data, at)
    return end if is_intact else 0


def number_of(frame: bytes) -> int:
    """The message number of a whole frame."""
    return frame[7] | frame[8] << 8 | frame[9] << 16 if frame[0] == V2 else frame[5]


def sender_of(frame: bytes) -> tuple[int, int]:
    """System and component id that a whole frame claims to come from."""
    return (frame[5], frame[6]) if frame[0] == V2 else (frame[3], frame[4])


def payload_of(frame: bytes, size: int) -> bytes:
    """The payload of a whole frame, with the trailing zeros that MAVLink 2 truncates.

    size: how many bytes are wanted at least.
    """
    head = _HEADER_2 if frame[0] == V2 else _HEADER_1
    return frame[head : head + frame[1]].ljust(size, b"\0")


def payload_as_sent(message: Message, size: int) -> bytes:
    """So many bytes of the payload that a message came in; empty if it came in none.

    For what its fields do not tell: extensions newer than the dialect, the bits of a float.
    """
    frame = bytes(message.get_msgbuf() or b"")
    return payload_of(frame, size)[:size] if frame else b""


def boot_ms_of(frame: bytes) -> int:
    """The time since boot at which a frame was sent, ms, if its message begins with that."""
    return int.from_bytes(payload_of(frame, 4)[:4], "little")


# --- messages

_IGNORED_NAMES: Final = """
    ACTUATOR_CONTROL_TARGET ACTUATOR_OUTPUT_STATUS AHRS AHRS2 ALTITUDE ATTITUDE_QUATERNION
    ATTITUDE_TARGET DISTANCE_SENSOR ESC_TELEMETRY_1_TO_4 GNSS_INTEGRITY HIGHRES_IMU HWSTATUS
    MCU_STATUS MEMINFO NAV_CONTROLLER_OUTPUT ODOMETRY OPEN_DRONE_ID_LOCATION
    OPEN_DRONE_ID_SYSTEM POWER_STATUS RAW_IMU RC_CHANNELS RC_CHANNELS_RAW SCALED_IMU SCALED_IMU2
    SCALED_IMU3 SCALED_PRESSURE SCALED_PRESSURE2 SCALED_PRESSURE3 SENSOR_OFFSETS SERVO_OUTPUT_RAW
    SIMSTATE SIM_STATE VFR_HUD VIBRATION WIND WIND_COV
"""
IGNORED_MESSAGES: Final = frozenset(
    number for number, kind in KINDS.items() if kind.msgname in _IGNORED_NAMES.split()
)
"""Message numbers that autopilots stream and the companion does not use: recorded, never decoded.

Half of what PX4 sends to an onboard computer by itself (px4.md 2).
"""


class Incoming(NamedTuple):
    """A message, where it came from and when."""

    frame: bytes
    """Without signature."""
    number: int
    """Which kind of message it is."""
    system: int
    component: int
    message: Message
    """None for a message that is not decoded."""
    at_s: float | None
    """Time of arrival, by the receiver's clock."""


def decoded(frame: bytes, kind: Any) -> Message:
    """The message of a frame that is whole, intact, of that kind and without signature.

    Its texts are fit to be shown: all that comes in by MAVLink comes in here.
    """
    size, head = kind.unpacker.size, _HEADER_2 if frame[0] == V2 else _HEADER_1
    payload = frame[head : head + frame[1]].ljust(size, b"\0")
    message = kind(*_in_order(kind)(kind.unpacker.unpack(payload[:size])))
    message._msgbuf = bytearray(frame)
    message._payload = message._msgbuf[6:-2]
    (message._crc,) = _CRC.unpack_from(frame, len(frame) - 2)
    header = message._header
    if frame[0] == V2:
        header.mlen, header.incompat_flags, header.compat_flags = frame[1:4]
        header.seq, header.srcSystem, header.srcComponent = frame[4:7]
    else:
        header.mlen, header.seq, header.srcSystem, header.srcComponent = frame[1:5]
    if b"c" in kind.native_format:
        for name in message.get_fieldnames():
            if isinstance(text := getattr(message, name), str):
                setattr(message, name, printable(text))
    return message


@cache
def _in_order(kind: Any) -> Callable[[tuple[Any, ...]], Sequence[Any]]:
    """Reorders what is unpacked, in wire order, for the constructor."""
    lengths = kind.lengths
    at = [sum(lengths[:order]) for order in kind.orders]
    if sum(lengths) == len(lengths) > 1 and b"c" not in kind.native_format:
        return itemgetter(*at)
    places = [(first, lengths[order]) for first, order in zip(at, kind.orders, strict=True)]

    def in_order(values: tuple[Any, ...]) -> list[Any]:
        fields = (
            values[first] if size == 1 else list(values[first : first + size])
            for first, size in places
        )
        return [field.rstrip(b"\0") if isinstance(field, bytes) else field for field in fields]

    return in_order


# --- bytes to messages


@final
class Receiver:
    """Finds the messages in what comes in on one link; nothing is ever raised.

    MAVLink 1 and 2.  Time is linear in the bytes; less than one frame is kept.  After what turns
    out not to be a frame the search goes on at its second byte, so a frame within is found.  An
    intact frame at the beginning of a portion shows that the frame before it was cut short: so a
    torn datagram holds nothing up.
    """

    def __init__(
        self, signing: Signing | None = None, ignored: frozenset[int] = frozenset()
    ) -> None:
        """signing: None accepts any frame, signed or not.

        ignored: numbers of messages that are passed on undecoded.
        """
        self.passed = 0
        """Bytes between frames, and frames not taken; those not believed are in Signing.refused."""
        self.signed = 0
        """Frames that carried a signature, right or wrong."""
        self.counted: dict[tuple[int, int], tuple[int, int, int]] = {}
        """System and component -> last sequence number, frames, gaps."""
        self._signing = signing
        self._ignored = ignored
        self._rest = b""

    def feed(self, data: bytes) -> list[Message]:
        """The messages that are complete now, in order; their get_msgbuf() is without signature."""
        return [heard.message for heard in self.read(data, None)]

    def read(self, data: bytes, at_s: float | None) -> list[Incoming]:
        """The same with the source of each; at_s: when these bytes arrived."""
        portion_at, data = len(self._rest), self._rest + data
        heard: list[Incoming] = []
        at, size, passed = 0, len(data), 0
        while (marker := find_marker(data, at)) is not None:
            passed += marker.start() - at
            at = marker.start()
            end, number, is_intact = frame_extent(data, at)
            kind = None if number is None else KINDS.get(number)
            if is_intact:
                self._take(data[at:end], kind, at_s, heard)
                at = end
                continue
            if kind is None and number is not None:  # no checksum: believed if a frame follows
                may_be = data[at] == V2 and (end >= size or data[end] in (V1, V2))
            else:
                may_be = kind is None or data[at] == V2 or data[at + 1] <= kind.unpacker.size
            if may_be and end > size:
                if not (at < portion_at < size and intact_end(data, portion_at)):
                    break
            elif may_be:
                passed += 1
                if kind is None:
                    at = end
                    continue
            passed += 1
            at += 1
        else:
            passed += size - at
            at = size
        self._rest = data[at:]
        self.passed += passed
        return heard

    def _take(self, frame: bytes, kind: Any, at_s: float | None, heard: list[Incoming]) -> None:
        """Add the message of an intact frame unless it is rejected."""
        signed = frame[0] == V2 and frame[2] & _SIGNED
        self.signed += signed
        if self._signing is not None and not self._signing.accepts(frame):
            return
        if kind.id in SECRETS:
            self.passed += 1
            return
        plain, message = strip_signature(frame) if signed else frame, None
        if kind.id not in self._ignored:
            message = decoded(plain, kind)
            message._signed = bool(signed) and self._signing is not None
        sequence, system, component = plain[4:7] if plain[0] == V2 else plain[2:5]
        before, frames, lost = self.counted.get((system, component), (sequence - 1, 0, 0))
        gap = (sequence - before - 1) & 0xFF
        # more than half of all numbers: it is late, came twice, or its sender began again
        lost += gap if gap < _BEGUN_AGAIN else 0
        self.counted[system, component] = sequence, frames + 1, lost
        heard.append(Incoming(plain, kind.id, system, component, message, at_s))
