"""Telemetry logs (.tlog) read by pymavlink's parser alone, frame by frame."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as wire


def frames_of(data: bytes) -> Iterator[tuple[int, Any]]:
    """The stamp, in microseconds, and the message of each record: whole to the last byte."""
    parser, at = wire.MAVLink(None), 0
    while at < len(data):
        (stamp_us,) = struct.unpack_from(">Q", data, at)
        assert data[at + 8] == wire.PROTOCOL_MARKER_V2
        size = 12 + data[at + 9] + (13 if data[at + 10] & 1 else 0)  # signed
        yield stamp_us, parser.decode(bytearray(data[at + 8 : at + 8 + size]))
        at += 8 + size
    assert at == len(data)


def messages(folder: Path) -> list[Any]:
    """All of a run folder's log."""
    return [message for _, message in frames_of((folder / "flight.tlog").read_bytes())]
