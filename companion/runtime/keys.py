"""The signing key's file, and beside it the time stamp, which must never decrease.

FILE        a phrase, or 64 hexadecimal digits, on one line; nobody else may read it
FILE.time   the newest time stamp, and the clock (microseconds since 1970) when it was kept
"""

import contextlib
import math
import os
import stat
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, final

from companion.errors import InputError
from companion.mavlink.signing import TICKS_PER_S, Signing, key_of, timestamp_of

SAVE_EVERY_S: Final = 30.0
"""How often the time stamp is to be kept; and at the end."""
_LONGEST_S: Final = 60.0
"""No process runs on for longer than this after it saved its last time stamp."""
_MARGIN_S: Final = 1.0
_LARGEST: Final = 4096
_LAST: Final = (1 << 48) - 1
_ONE_LINE: Final = "Give a file that holds a phrase, or 64 hexadecimal digits, on one line."


StoredTimestamp = tuple[int, float]
"""What FILE.time holds: a time stamp, and the clock in seconds."""


def _clock_s() -> float:
    return datetime.now(UTC).timestamp()


@final
class SigningKey:
    """A key from its file, and what signs by it from now on."""

    def __init__(self, path: Path, clock: Callable[[], float] = _clock_s) -> None:
        """clock: seconds since 1970, as far as this computer knows.

        InputError if the file, or FILE.time beside it, cannot be used.
        """
        key, self._kept_in, self._clock = key_of(_phrase(path)), Path(f"{path}.time"), clock
        self.signing = Signing(key=key, timestamp=first_timestamp(clock(), _kept(self._kept_in)))
        try:
            self._save()
        except OSError as error:
            rule = f"the time stamp cannot be kept beside it ({error.strerror})"
            raise _wrong(self._kept_in, rule, "Let the folder be written.") from None

    def save(self) -> None:
        """Keep the time stamp for the next process; never raises: the flight goes on."""
        with contextlib.suppress(OSError):
            self._save()

    def _save(self) -> None:
        """Atomically."""
        new = self._kept_in.with_name(f"{self._kept_in.name}.{os.getpid()}")
        with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
            file.write(f"{self.signing.timestamp} {round(self._clock() * 1e6)}\n")
            file.flush()
            os.fsync(file.fileno())
        new.replace(self._kept_in)


def first_timestamp(clock_s: float, kept: StoredTimestamp | None) -> int:
    """A time stamp above all used ones: by the clock, unless that is behind the saved one.

    A process that died may have run on after it saved its time stamp: by the clock, but no longer
    than a minute, and a minute if the clock has gone back since.
    """
    now = timestamp_of(clock_s)
    if kept is None:
        return now
    timestamp, kept_s = kept
    since_s = clock_s - kept_s
    ran_s = min(since_s, _LONGEST_S) if since_s >= 0.0 else _LONGEST_S
    return max(now, timestamp + math.ceil((ran_s + _MARGIN_S) * TICKS_PER_S))


def _phrase(path: Path) -> str:
    """The key file's one line."""
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            content = file.read(_LARGEST + 1)
    except OSError as error:
        raise _wrong(path, f"it cannot be read ({error.strerror})", _ONE_LINE) from None
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        rule = f"others may read or change it (mode {stat.S_IMODE(mode):04o})"
        raise _wrong(path, rule, f"Run: chmod 600 {path}")
    text = content.decode(errors="replace").removesuffix("\n").removesuffix("\r")
    if not text.strip() or len(content) > _LARGEST or "\n" in text or "\ufffd" in text:
        raise _wrong(path, "a key is one line of text", _ONE_LINE)
    return text


def _kept(path: Path) -> StoredTimestamp | None:
    """What was kept; None if nothing was yet."""
    try:
        timestamp, clock_us = (int(word) for word in path.read_bytes()[:_LARGEST].split())
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        timestamp = clock_us = -1
    if not (0 <= timestamp <= _LAST and 0 <= clock_us <= 1 << 62):
        rule = "no time stamp and clock can be read"
        raise _wrong(path, rule, "Delete it if the clock here is right.")
    return timestamp, clock_us * 1e-6


def _wrong(path: Path, rule: str, remedy: str) -> InputError:
    return InputError("signing key", str(path), rule, remedy)
