"""What our decoder makes of a frame is what pymavlink's own makes of it, whatever the kind."""

import math
import random
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as wire

from companion.mavlink.frames import decoded
from companion.printable import printable

KINDS = sorted(wire.mavlink_map)


def frame_of(kind: Any, rng: random.Random, *, version_1: bool) -> bytes:
    """A frame with random bytes as its payload, sometimes with zeros at its end."""
    size = kind.unpacker.size
    payload = rng.randbytes(rng.randint(0, size)).ljust(size, b"\0")
    sender = wire.MAVLink(None, srcSystem=rng.randrange(1, 256), srcComponent=rng.randrange(1, 256))
    sender.seq = rng.randrange(256)
    message = wire.MAVLink_message(kind.id, kind.msgname)
    return bytes(message._pack(sender, kind.crc_extra, payload, force_mavlink1=version_1))


def told(message: Any) -> dict[str, Any]:
    """All that there is to know of a message, numbers that are none included; texts made fit."""
    values = {
        name: repr(printable(value) if isinstance(value, str) else value)
        for name, value in vars(message).items()
        if name != "_header"
    }
    return {**values, "header": vars(message.get_header())}


@pytest.mark.parametrize("version_1", [False, True], ids=["MAVLink 2", "MAVLink 1"])
def test_every_kind_is_decoded_as_by_pymavlink(version_1: bool) -> None:
    rng, theirs = random.Random(1), wire.MAVLink(None)
    compared = 0
    for number in KINDS:
        kind = wire.mavlink_map[number]
        if version_1 and number > 255:
            continue
        for _ in range(20):
            frame = frame_of(kind, rng, version_1=version_1)
            message = decoded(frame, kind)
            assert told(message) == told(theirs.decode(bytearray(frame)))
            texts = (getattr(message, name) for name in message.get_fieldnames())
            assert all(text.isprintable() for text in texts if isinstance(text, str))
            compared += 1
    assert compared > 3000


def test_fields_that_are_not_numbers_stay_so() -> None:
    message = wire.MAVLink_attitude_message(1, math.nan, math.inf, -math.inf, 0, 0, 0)
    frame = message.pack(wire.MAVLink(None))
    message = decoded(frame, wire.MAVLink_attitude_message)
    assert math.isnan(message.roll)
    assert (message.pitch, message.yaw) == (math.inf, -math.inf)
