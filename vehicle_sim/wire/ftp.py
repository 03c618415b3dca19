"""MAVLink FTP of a vehicle without files: every question has its answer, and it is no.

So clients that look for files first (parameters, component metadata) go on at once with the plain
protocols.  Layout of the payload: mavlink.io, services/ftp.
"""

import enum
import struct
from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Sender
from vehicle_sim.wire.answers import Deliver

_HEAD: Final = struct.Struct("<HBBBBBxI")
"""Sequence, session, opcode, size, opcode that is answered, end of burst, offset."""
_PAYLOAD_BYTES: Final = 251
_ACK, _NAK = 128, 129


class Opcode(enum.IntEnum):
    """What a client asks for, as far as it is answered in a way of its own."""

    NONE = 0
    TERMINATE_SESSION = 1
    RESET_SESSIONS = 2
    LIST_DIRECTORY = 3
    OPEN_FILE_RO = 4
    READ_FILE = 5
    CREATE_FILE = 6
    WRITE_FILE = 7
    REMOVE_FILE = 8
    CREATE_DIRECTORY = 9
    REMOVE_DIRECTORY = 10
    OPEN_FILE_WO = 11
    TRUNCATE_FILE = 12
    RENAME = 13
    CALC_FILE_CRC32 = 14
    BURST_READ_FILE = 15


class Refusal(enum.IntEnum):
    """The first byte of what a NAK says."""

    FAIL = 1
    INVALID_SESSION = 4
    UNKNOWN_COMMAND = 7
    FILE_NOT_FOUND = 10


_DONE: Final = frozenset({Opcode.NONE, Opcode.TERMINATE_SESSION, Opcode.RESET_SESSIONS})
_NEED_A_SESSION: Final = frozenset({Opcode.READ_FILE, Opcode.WRITE_FILE, Opcode.BURST_READ_FILE})
_KNOWN: Final = frozenset(int(opcode) for opcode in Opcode)
_WOULD_WRITE: Final = frozenset({Opcode.CREATE_FILE, Opcode.CREATE_DIRECTORY, Opcode.OPEN_FILE_WO})


def answer(message: Any, sender: Sender) -> Deliver | None:
    """The answer to a FILE_TRANSFER_PROTOCOL; none to what is itself an answer."""
    payload = bytes(message.payload).ljust(_PAYLOAD_BYTES, b"\0")
    sequence, session, opcode, _, _, _, offset = _HEAD.unpack_from(payload)
    if opcode in (_ACK, _NAK):
        return None
    refusal = _refusal(opcode)
    head = _HEAD.pack(
        (sequence + 1) & 0xFFFF,
        session,
        _ACK if refusal is None else _NAK,
        0 if refusal is None else 1,
        opcode,
        0,
        offset,
    )
    data = b"" if refusal is None else bytes([refusal])
    reply = mavlink.MAVLink_file_transfer_protocol_message(
        target_network=0,
        target_system=sender.system,
        target_component=sender.component,
        payload=list((head + data).ljust(_PAYLOAD_BYTES, b"\0")),
    )
    return Deliver(message=reply, to=sender)


def _refusal(opcode: int) -> Refusal | None:
    """Why not; None for what can be done."""
    if opcode in _DONE:
        return None
    if opcode in _NEED_A_SESSION:
        return Refusal.INVALID_SESSION
    if opcode in _WOULD_WRITE:
        return Refusal.FAIL
    return Refusal.FILE_NOT_FOUND if opcode in _KNOWN else Refusal.UNKNOWN_COMMAND
