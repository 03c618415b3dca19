"""Opens a log of any kind, by what is in it."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

from companion.errors import InputError
from companion.mavlink.frames import LONGEST
from companion.telemetry.logs import ardupilot, dataflash, px4, ulog
from companion.telemetry.logs.needed import Kind
from companion.telemetry.logs.record import Log, chosen
from companion.telemetry.logs.search import first_frame
from companion.telemetry.logs.tlog import open_tlog
from companion.telemetry.logs.translated import Source, Translation
from companion.telemetry.logs.window import Window

_HEAD_BYTES: Final = 4096
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
    kind = _kind_of(path)
    log = None if kind is None else _OPENERS[kind](path, size, system_id)
    if log is not None:
        return log
    for magic, (rule, remedy) in _OTHERS.items():
        if head.startswith(magic):
            raise InputError("log", str(path), rule, remedy)
    raise InputError("log", str(path), "nothing that can be read is in it", f"Give {_KINDS}.")


def _kind_of(path: Path) -> Kind | None:
    """The log type by its first unambiguous content; None: unknown."""
    with Window(path) as window:
        while True:
            data = window.data
            found = {kind: find(data) for kind, find in _SIGNS.items()}
            if known := {kind: at for kind, at in found.items() if at is not None}:
                return min(known, key=lambda kind: known[kind])
            if not window.more(max(len(data) - _SIGN_BYTES, 0)):
                return None


def _open_own(
    look: Callable[[Path], Source], path: Path, size: int, system_id: int | None
) -> Log | None:
    """A log that an autopilot has written itself."""
    source = look(path)
    if not source.entries:
        return None
    systems = (source.system_id,)
    return Log(
        kind=source.kind,
        path=path,
        size_bytes=size,
        systems=systems,
        system_id=chosen(path, systems, system_id),
        autopilot=source.autopilot,
        begin=partial(Translation, source),
    )


_SIGNS: Final[dict[Kind, Callable[[bytes], int | None]]] = {
    "ulg": ulog.first_format,
    "bin": dataflash.first_format,
    "tlog": first_frame,
}
"""Finds the first content that cannot be coincidence: a format description, or a frame with the
right checksum."""
_SIGN_BYTES: Final = max(LONGEST, ulog.SIGN_BYTES, dataflash.SIGN_BYTES)
_OPENERS: Final[dict[Kind, Callable[[Path, int, int | None], Log | None]]] = {
    "tlog": open_tlog,
    "bin": partial(_open_own, ardupilot.look),
    "ulg": partial(_open_own, px4.look),
}
