"""The run folder of a flight: all that replay, report and resume need (design section 9).

    flight.tlog    every frame, both ways: 8 bytes of microseconds since 1970 (big-endian), frame
    journal.jsonl  a header, then events and decisions; a function of mission, seed and vehicle
    mission.toml   the mission as flown (seed and profile: the journal's header)
    run.json       what differs from run to run: when, where, how long plans took
    flight.png     the picture

Whatever was recorded stays readable to the last whole record, however the flight ends: each
batch is handed to the operating system as soon as it is there.  The known map is in the
TERRAIN_DATA frames of the log, the path in the journal: a restart needs nothing else.
"""

import io
import json
import math
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self, final

from companion.errors import InputError

JOURNAL_SCHEMA = "companion-journal"
JOURNAL_VERSION = 1
_WRITTEN = ("journal.jsonl", "flight.tlog", "mission.toml", "run.json")


@final
class RunFolder:
    """Writes a run folder; frames and entries in the order in which they happened."""

    def __init__(self, path: Path, *, mission_toml: str, epoch_us: int) -> None:
        """epoch_us: microseconds since 1970 at vehicle time 0, for the log's stamps."""
        self.path = path
        self.failure: str | None = None
        """Why recording has stopped; the flight goes on."""
        self._epoch_us = epoch_us
        try:
            path.mkdir(parents=True, exist_ok=True)
            for name in _WRITTEN:
                if (path / name).exists():
                    rule = f"it holds a flight already ({name})"
                    raise InputError("--out", str(path), rule, "Give a new folder.")
            (path / "mission.toml").write_text(mission_toml, encoding="utf-8")
            self._tlog = (path / "flight.tlog").open("wb", buffering=0)
            self._journal = (path / "journal.jsonl").open("wb", buffering=0)
        except OSError as error:
            rule = f"it cannot be written to ({error.strerror})"
            raise InputError("--out", str(path), rule, "Give a folder that can be.") from error

    def header(self, values: Mapping[str, Any]) -> None:
        """The first line of the journal: schema and version, and what the flight depends on."""
        head = {"schema": JOURNAL_SCHEMA, "version": JOURNAL_VERSION, **values}
        self._write(self._journal, _line(head))

    def frames(self, stamped: Iterable[tuple[float, bytes]]) -> None:
        """Frames with their vehicle times, seconds."""
        batch = b"".join(
            struct.pack(">Q", self._epoch_us + round(time_s * 1e6)) + frame
            for time_s, frame in stamped
        )
        self._write(self._tlog, batch)

    def entries(self, entries: Iterable[Mapping[str, Any]]) -> None:
        """Journal entries."""
        self._write(self._journal, b"".join(_line(entry) for entry in entries))

    def run_json(self, values: Mapping[str, Any]) -> None:
        """What differs from run to run."""
        text = json.dumps(_plain(values), indent=2) + "\n"
        with (self.path / "run.json").open("wb", buffering=0) as file:
            self._write(file, text.encode())

    def _write(self, file: io.FileIO, batch: bytes) -> None:
        """Write, unless the disk has failed before: it must not end a flight."""
        if not batch or self.failure is not None:
            return
        try:
            file.write(batch)
        except OSError as error:
            self.failure = str(error)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._tlog.close()
        self._journal.close()


def _line(entry: Mapping[str, Any]) -> bytes:
    text = json.dumps(_plain(entry), separators=(",", ":"), allow_nan=False, default=float)
    return text.encode() + b"\n"


def _plain(value: Any) -> Any:
    """The value with null for numbers that JSON does not have: infinite, or none at all."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value
