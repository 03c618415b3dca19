"""A ground station that packs and reads its frames by hand, from the message definitions.

It shares nothing with the companion and with pymavlink: byte layouts are those of common.xml.
"""

import struct
from dataclasses import dataclass

from companion.mavlink.dialect import Message, codec

OURS = (7, 195)
PERSON = (255, 190)
_EXTRA = {75: 158, 76: 152, 77: 143, 253: 83}


def crc(data: bytes) -> int:
    """CRC-16/MCRF4XX, bit by bit."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0x8408 if value & 1 else 0)
    return value


def frame(number: int, payload: bytes, sender: tuple[int, int], extra: int | None = None) -> bytes:
    """A MAVLink 2 frame; zeros at the payload's end are left off."""
    payload = payload.rstrip(b"\0") or b"\0"
    head = struct.pack("<BBBBBB", len(payload), 0, 0, 0, *sender) + number.to_bytes(3, "little")
    checked = head + payload
    seed = _EXTRA[number] if extra is None else extra
    return b"\xfd" + checked + struct.pack("<H", crc(checked + bytes([seed])))


def parsed(data: bytes) -> Message:
    """What the companion reads."""
    [message] = codec(OURS[0]).parse_buffer(data)
    return message


def command_long(
    command: int,
    *parameters: float,
    target: tuple[int, int] = OURS,
    sender: tuple[int, int] = PERSON,
    confirmation: int = 0,
) -> Message:
    """COMMAND_LONG (76): parameters left out are 0."""
    seven = (*parameters, *[0.0] * (7 - len(parameters)))
    payload = struct.pack("<7fHBBB", *seven, command, *target, confirmation)
    return parsed(frame(76, payload, sender))


def command_int(
    command: int,
    *parameters: float,
    x: int = 0,
    y: int = 0,
    z: float = 0.0,
    frame_id: int = 0,
    target: tuple[int, int] = OURS,
    sender: tuple[int, int] = PERSON,
) -> Message:
    """COMMAND_INT (75): parameters 1 to 4 that are left out are 0."""
    four = (*parameters, *[0.0] * (4 - len(parameters)))
    payload = struct.pack("<4fiifHBBBBB", *four, x, y, z, command, *target, frame_id, 0, 0)
    return parsed(frame(75, payload, sender))


def payload_of(message: Message, number: int, length: int) -> bytes:
    """The payload of a message as it leaves the companion, with the zeros that were left off."""
    data = message.pack(codec(OURS[0]))
    assert data[0] == 0xFD
    assert int.from_bytes(data[7:10], "little") == number
    assert (data[5], data[6]) == OURS
    body = data[10 : 10 + data[1]]
    assert crc(data[1 : 10 + data[1]] + bytes([_EXTRA[number]])) == int.from_bytes(
        data[10 + data[1] :], "little"
    )
    return body.ljust(length, b"\0")


@dataclass(frozen=True)
class Ack:
    """COMMAND_ACK (77)."""

    command: int
    result: int
    target: tuple[int, int]


def ack(message: Message) -> Ack:
    command, result, _, _, system, component = struct.unpack("<HBBiBB", payload_of(message, 77, 10))
    return Ack(command, result, (system, component))


@dataclass(frozen=True)
class Text:
    """STATUSTEXT (253), one chunk."""

    severity: int
    text: bytes
    number: int
    chunk: int


def statustext(message: Message) -> Text:
    return Text(*struct.unpack("<B50sHB", payload_of(message, 253, 54)))
