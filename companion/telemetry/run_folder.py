"""The run folder of a flight: all that replay, report and resume need (design section 9).

    flight.tlog    every frame, both ways: 8 bytes of microseconds since 1970 (big-endian), frame
    journal.jsonl  a header, then events and decisions; a function of mission, seed and vehicle;
                   one more header for each time that the companion was started again
    mission.toml   the mission as flown (seed and profile: the journal's header)
    run.json       what differs from run to run: when, where, how long plans took
    flight.png     the picture
    resume.json    where the mission stands, and known.npz, the known map: for a restart in flight

Whatever was recorded stays readable to the last whole record, however the flight ends: each batch
is handed to the operating system as soon as it is there.  resume.json, known.npz and run.json are
replaced as a whole, and forced to the disk: there is always a whole one, older or newer.
"""

import io
import json
import math
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self, final

import numpy as np

from companion.errors import InputError
from companion.world.known_map import KnownMap

JOURNAL_SCHEMA = "companion-journal"
JOURNAL_VERSION = 1
RESUME_SCHEMA = "companion-resume"
RESUME_VERSION = 1
_WRITTEN = ("journal.jsonl", "flight.tlog", "mission.toml", "run.json")
_STAMP_BYTES = 8
_SIGNED, _SIGNATURE_BYTES = 0x01, 13


class Checkpoint(NamedTuple):
    """What a companion that is started again in flight finds in its run folder."""

    values: dict[str, Any]
    known: KnownMap | None


@final
class RunFolder:
    """Writes a run folder; frames and entries in the order in which they happened."""

    def __init__(
        self, path: Path, *, mission_toml: str, epoch_us: int, resume: bool = False
    ) -> None:
        """epoch_us: microseconds since 1970 at vehicle time 0, for the log's stamps.

        resume: go on after whatever the folder holds.  InputError if it cannot be written to, or
        holds a flight that is not to be resumed.
        """
        self.path = path
        self.failure: str | None = None
        """Why recording has stopped; the flight goes on."""
        self.facts: dict[str, Any] = {}
        """More for run.json."""
        self.epoch_us = epoch_us
        self._starts = 0
        try:
            path.mkdir(parents=True, exist_ok=True)
            held = [name for name in _WRITTEN if (path / name).exists()]
            if held and not resume:
                rule = f"it holds a flight already ({held[0]})"
                raise InputError("--out", str(path), rule, "Give a new folder, or --resume.")
            if "mission.toml" not in held:
                _replace(path / "mission.toml", mission_toml.encode())
            if held:
                self._go_on()
            self._tlog = (path / "flight.tlog").open("ab", buffering=0)
            self._journal = (path / "journal.jsonl").open("ab", buffering=0)
        except OSError as error:
            rule = f"it cannot be written to ({error.strerror})"
            raise InputError("--out", str(path), rule, "Give a folder that can be.") from error

    def _go_on(self) -> None:
        """Cut what a companion that was killed has left half written."""
        head = _resume_json(self.path) or {}
        self.epoch_us = int(head.get("epoch_us", self.epoch_us))
        self._starts = int(head.get("starts", 0)) + 1
        tlog, journal = self.path / "flight.tlog", self.path / "journal.jsonl"
        if tlog.exists():
            _cut(tlog, whole_records(tlog, int(head.get("tlog_bytes", 0))))
        if journal.exists():
            _cut(journal, _whole_lines(journal))

    # --- what grows

    def header(self, values: Mapping[str, Any]) -> None:
        """The journal's first line: schema and version, and what the flight depends on."""
        head: dict[str, Any] = {"schema": JOURNAL_SCHEMA, "version": JOURNAL_VERSION, **values}
        if self._starts:
            head["resumed"] = self._starts
        self._write(self._journal, [_line(head)])

    def frames(self, stamped: Iterable[tuple[float, bytes]]) -> None:
        """Frames with their vehicle times, seconds."""
        self._write(
            self._tlog,
            [
                struct.pack(">Q", self.epoch_us + round(time_s * 1e6)) + frame
                for time_s, frame in stamped
            ],
        )

    def entries(self, entries: Iterable[Mapping[str, Any]]) -> None:
        """Journal entries."""
        self._write(self._journal, [_line(entry) for entry in entries])

    def _write(self, file: io.FileIO, records: Sequence[bytes]) -> None:
        """Write records, unless the disk has failed before: it must not end a flight."""
        batch = b"".join(records)
        if not batch or self.failure is not None:
            return
        written = 0
        try:
            while written < len(batch):  # a disk that is nearly full takes a part of it
                written += file.write(batch[written:])
        except OSError as error:
            self.failure = error.strerror or str(error)
            _drop_torn(file, records, written)

    # --- what is replaced

    def checkpoint(self, values: Mapping[str, Any]) -> None:
        """Where the mission stands.  A disk that is full leaves the one before."""
        head = {
            "schema": RESUME_SCHEMA,
            "version": RESUME_VERSION,
            "epoch_us": self.epoch_us,
            "starts": self._starts,
            "tlog_bytes": self._tlog.tell(),
            "values": values,
        }
        self._replace("resume.json", lambda: _line(head))

    def known_map(self, known: KnownMap) -> None:
        """What is known of the terrain.  A disk that is full leaves the one before."""
        self._replace("known.npz", lambda: _npz(known))

    def run_json(self, values: Mapping[str, Any]) -> None:
        """What differs from run to run."""
        text = json.dumps(_plain({**values, **self.facts}), indent=2, default=float) + "\n"
        if self.failure is None:
            self.failure = self._replace("run.json", text.encode)

    def _replace(self, name: str, content: Callable[[], bytes]) -> str | None:
        try:
            _replace(self.path / name, content())
        except OSError as error:
            return error.strerror or str(error)
        return None

    def close(self) -> None:
        """Let go of the files."""
        self._tlog.close()
        self._journal.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


# --- reading it again


def read_checkpoint(path: Path) -> Checkpoint | None:
    """What a run folder says about where its mission stands; None if it says nothing."""
    head = _resume_json(path)
    if head is None or not isinstance(head.get("values"), dict):
        return None
    return Checkpoint(values=head["values"], known=_known(path / "known.npz"))


def _resume_json(path: Path) -> dict[str, Any] | None:
    try:
        head = json.loads((path / "resume.json").read_bytes())
    except (OSError, ValueError):
        return None
    ours = isinstance(head, dict) and head.get("schema") == RESUME_SCHEMA
    return head if ours and head.get("version") == RESUME_VERSION else None


def whole_records(path: Path, start: int = 0) -> int:
    """Where the last whole record of a telemetry log ends.

    start: where some record begins, to look no further back; 0 if the file is shorter than that.
    """
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        at = start if start <= size else 0
        file.seek(at)
        data = memoryview(file.read())
    end = 0
    while (length := _record_bytes(data[end:])) and end + length <= len(data):
        end += length
    return at + end


def _record_bytes(data: memoryview) -> int:
    """Length of the record that begins here; 0 if none does."""
    frame = data[_STAMP_BYTES : _STAMP_BYTES + 3]
    if len(frame) < 3 or frame[0] not in (0xFD, 0xFE):
        return 0
    if frame[0] == 0xFE:
        return _STAMP_BYTES + 8 + frame[1]
    signature = _SIGNATURE_BYTES if frame[2] & _SIGNED else 0
    return _STAMP_BYTES + 12 + frame[1] + signature


def _whole_lines(path: Path) -> int:
    """Where the last whole line ends."""
    with path.open("rb") as file:
        end = file.seek(0, os.SEEK_END)
        while end > 0:
            begin = max(end - 65536, 0)
            file.seek(begin)
            found = file.read(end - begin).rfind(b"\n")
            if found >= 0:
                return begin + found + 1
            end = begin
    return 0


def _known(path: Path) -> KnownMap | None:
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as held:
            cell_m, north_m, east_m, registration_m = held["lattice"].tolist()
            return KnownMap(
                cell_m=cell_m,
                north_min_m=north_m,
                east_min_m=east_m,
                upper_m=held["upper_m"],
                seen=held["seen"],
                registration_m=registration_m,
            )
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None


# --- bytes


def _npz(known: KnownMap) -> bytes:
    buffer = io.BytesIO()
    lattice = [known.cell_m, known.north_min_m, known.east_min_m, known.registration_m]
    np.savez_compressed(buffer, lattice=lattice, upper_m=known.upper_m, seen=known.seen)
    return buffer.getvalue()


def _replace(path: Path, content: bytes) -> None:
    """Write a file so that at every moment there is a whole one under its name."""
    new = path.with_name(f".{path.name}.new")
    try:
        with new.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    except OSError:
        new.unlink(missing_ok=True)
        raise


def _cut(path: Path, size: int) -> None:
    if path.stat().st_size != size:
        os.truncate(path, size)


def _drop_torn(file: io.FileIO, records: Sequence[bytes], written: int) -> None:
    """Take back the record of which only a part has been written."""
    torn = written
    for record in records:
        if torn < len(record):
            break
        torn -= len(record)
    try:
        file.truncate(file.seek(0, os.SEEK_END) - torn)
    except OSError:
        return  # whoever reads it stops at the last whole record


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
