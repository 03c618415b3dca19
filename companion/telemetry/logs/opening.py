"""Opens a log of any kind, by what is in it."""

from functools import partial
from pathlib import Path
from typing import Final

from companion.errors import InputError
from companion.telemetry.logs.record import Log, chosen
from companion.telemetry.logs.tlog import open_tlog
from companion.telemetry.logs.translated import Source, Translation

_HEAD_BYTES: Final = 4096
_BIN: Final = b"\xa3\x95\x80"
_ULG: Final = b"ULog\x01\x12\x35"
"""What the logs begin with that autopilots write themselves."""
_KINDS: Final = "a .tlog of MAVLink frames, an ArduPilot .bin or a PX4 .ulg"
_OTHERS: Final = {
    b"\x1f\x8b": ("it is compressed", "Unpack it with gunzip."),
    b"PK\x03\x04": ("it is a zip archive", "Unpack it."),
    b"FMT, ": ("it is an ArduPilot log as text", "Give the .bin that it was made from."),
    b"ULogEnc": ("it is an encrypted PX4 log", "Decrypt it with the key of the vehicle."),
}
"""First bytes of what people may take for a log."""


def open_log(path: Path, *, system_id: int | None = None) -> Log:
    """Open a log; system_id: of the vehicle, if there are several.

    InputError if there is no such file, nothing in it can be read, or it is not clear whose log it
    is.  The whole file is scanned once, in bounded memory.
    """
    try:
        if not path.exists():
            raise InputError("log", str(path), "there is no such file", "Give the path of a log.")
        if path.is_dir():
            remedy = "Give a file in it, for instance its flight.tlog."
            raise InputError("log", str(path), "it is a directory", remedy)
        if not path.is_file():
            raise InputError("log", str(path), "it is no ordinary file", f"Give {_KINDS}.")
        size = path.stat().st_size
        if size == 0:
            raise InputError("log", str(path), "it is empty", f"Give {_KINDS}.")
        return _opened(path, size, system_id)
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the path
        why = getattr(error, "strerror", None) or str(error)
        raise InputError("log", str(path), f"it cannot be read: {why}", "Look at it.") from error


def _opened(path: Path, size: int, system_id: int | None) -> Log:
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    log = None
    if head.startswith(_BIN):
        from companion.telemetry.logs import ardupilot  # a second, for pymavlink's own dialects

        log = _opened_own(ardupilot.look(path), path, size, system_id)
    elif head.startswith(_ULG):
        from companion.telemetry.logs import px4

        log = _opened_own(px4.look(path), path, size, system_id)
    log = log or open_tlog(path, size, system_id)
    if log is not None:
        return log
    for magic, (rule, remedy) in _OTHERS.items():
        if head.startswith(magic):
            raise InputError("log", str(path), rule, remedy)
    raise InputError("log", str(path), "nothing that can be read is in it", f"Give {_KINDS}.")


def _opened_own(source: Source | None, path: Path, size: int, system_id: int | None) -> Log | None:
    """A log that an autopilot has written itself; None: nothing of use is in it."""
    if source is None or not source.entries:
        return None
    systems = (source.system_id,)
    return Log(
        kind=source.kind,
        path=path,
        size_bytes=size,
        systems=systems,
        system_id=chosen(path, systems, system_id),
        autopilot=source.autopilot,
        begin=partial(Translation, source, size),
    )
