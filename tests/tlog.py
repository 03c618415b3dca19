"""Telemetry logs (.tlog), frame by frame: read by pymavlink's parser alone, or as we read ours."""

import struct
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pymavlink import mavutil  # noqa: TID251 - the reader that users have is the oracle
from pymavlink.dialects.v20 import all as wire

from companion.telemetry.run_folder import Records


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


def read_by_pymavlink(path: Path) -> list[tuple[int, bytes]]:
    """Stamp, in microseconds, and frame of each record, as users' own programs find them."""
    log, found = mavutil.mavlink_connection(str(path), dialect="all"), []
    while (message := log.recv_msg()) is not None:
        found.append((round(message._timestamp * 1e6), bytes(message.get_msgbuf())))
    log.close()
    return found


def messages(folder: Path) -> list[Any]:
    """All of a run folder's log."""
    return [message for _, message in frames_of((folder / "flight.tlog").read_bytes())]


def recorded_frames(path: Path) -> list[tuple[int, bytes]]:
    """Stamp, in microseconds, and frame of each record, as the companion reads its own log."""
    return list(Records(path))


def written(path: Path, records: Iterable[tuple[int, bytes]]) -> Path:
    """A log of these."""
    path.write_bytes(b"".join(struct.pack(">Q", us) + frame for us, frame in records))
    return path
