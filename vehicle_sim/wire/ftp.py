"""MAVLink FTP of a vehicle without files: every request is refused.

So clients that look for files first (parameters, component metadata) go on at once with the plain
protocols.  Layout of the payload: mavlink.io, services/ftp.
"""

import struct
from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Sender, SendMessage

_HEAD: Final = struct.Struct("<HBBBBBxI")
"""Sequence, session, opcode, size, opcode that is answered, end of burst, offset."""
_PAYLOAD_BYTES: Final = 251
_ACK, _NAK = mavlink.MAV_FTP_OPCODE_ACK, mavlink.MAV_FTP_OPCODE_NAK
_REFUSALS: Final[dict[int, int]] = {
    getattr(mavlink, f"MAV_FTP_OPCODE_{opcode}"): getattr(mavlink, f"MAV_FTP_ERR_{error}")
    for error, opcodes in {
        "NONE": "NONE TERMINATESESSION RESETSESSION",
        "INVALIDSESSION": "READFILE WRITEFILE BURSTREADFILE",
        "FAIL": "CREATEFILE CREATEDIRECTORY OPENFILEWO",
        "FILENOTFOUND": "LISTDIRECTORY OPENFILERO REMOVEFILE REMOVEDIRECTORY TRUNCATEFILE RENAME "
        "CALCFILECRC",
    }.items()
    for opcode in opcodes.split()
}
"""By opcode: the first byte of the data; 0 is of those that can be done."""


def answer(message: Any, sender: Sender) -> SendMessage | None:
    """The answer to a FILE_TRANSFER_PROTOCOL; none to what is itself an answer."""
    payload = bytes(message.payload).ljust(_PAYLOAD_BYTES, b"\0")
    sequence, session, opcode, _, _, _, offset = _HEAD.unpack_from(payload)
    if opcode in (_ACK, _NAK):
        return None
    refusal = _REFUSALS.get(opcode, mavlink.MAV_FTP_ERR_UNKNOWNCOMMAND)
    result, size = (_NAK, 1) if refusal else (_ACK, 0)
    head = _HEAD.pack((sequence + 1) & 0xFFFF, session, result, size, opcode, 0, offset)
    reply = mavlink.MAVLink_file_transfer_protocol_message(
        *(0, sender.system, sender.component),
        list((head + bytes([refusal])).ljust(_PAYLOAD_BYTES, b"\0")),
    )
    return SendMessage(message=reply, to=sender)
