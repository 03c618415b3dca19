"""Any telemetry log as a stream of timed MAVLink frames: docs/replay.md.

log = open_log(path)
for record in log.records(): ...   # record.time_us, record.frame
log.findings, log.missing()        # what was odd about it, and what it lacks
"""

from pathlib import Path
from typing import Final

from companion.errors import InputError
from companion.telemetry.logs.log import HOW_TO_RECORD, Log, Odd, Record

__all__ = ["HOW_TO_RECORD", "Log", "Odd", "Record", "open_log"]

_KINDS: Final = "Give a .tlog of MAVLink frames, an ArduPilot .bin or a PX4 .ulg."
_OTHERS: Final = {
    b"\x1f\x8b": ("it is compressed", "Unpack it with gunzip."),
    b"PK\x03\x04": ("it is a zip archive", "Unpack it."),
    b"FMT, ": ("it is an ArduPilot log as text", "Give the .bin that it was made from."),
    b"ULogEnc": ("it is an encrypted PX4 log", "Decrypt it with the key of the vehicle."),
    b"": ("nothing that can be read is in it", _KINDS),
}
"""First bytes of what people may take for a log."""


def open_log(path: Path, *, system_id: int | None = None) -> Log:
    """Open a log of any kind, by what is in it; system_id: of the vehicle, if there are several.

    InputError if there is no such file, nothing in it can be read, or it is not clear whose log it
    is.  The whole file is scanned once.
    """
    try:
        if not path.is_file():
            raise InputError("log", str(path), "there is no file of that name", _KINDS)
        with path.open("rb") as file:
            head = file.read(8)
        log = _opened(path, head) if head else None
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the path
        why = getattr(error, "strerror", None) or str(error)
        raise InputError("log", str(path), f"it cannot be read: {why}", "Look at it.") from error
    if log is None:
        words = next(words for begins, words in _OTHERS.items() if head.startswith(begins))
        raise InputError("log", str(path), *words)
    log.choose(system_id)
    return log


def _opened(path: Path, head: bytes) -> Log | None:
    """The log, by its first bytes; the libraries of the others are not loaded."""
    log = None
    if head.startswith(b"\xa3\x95\x80"):
        from companion.telemetry.logs import dataflash

        log = dataflash.opened(path)
    elif head.startswith(b"ULog\x01\x12\x35"):
        from companion.telemetry.logs import ulog

        log = ulog.opened(path)
    if log is None:
        from companion.telemetry.logs import tlog

        log = tlog.opened(path)
    return log
