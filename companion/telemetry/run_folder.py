"""The run folder of a flight: all that replay, report and resume need (design section 9).

    flight.tlog    every frame, both ways: 8 bytes of microseconds since 1970 (big-endian), frame
    journal.jsonl  a header, then events and decisions; a function of mission, seed and vehicle;
                   one more header for each time that the companion was started again
    inputs.msgpack all that the session was told: replayed, it does the same (`inputs`)
    mission.toml   the mission as flown (seed and profile: the journal's header)
    terrain.tif    the elevation file that it names, if it does; of SRTM by the tile's own name
    run.json       what differs from run to run: when, where, how long plans took
    flight.png     the picture
    resume.json    where the mission stands, and known.npz, the known map: for a restart in flight
    *.damaged      a growing file with a wrong byte in its middle, as a restart found it

Recorded data stays readable to the last whole record, however the flight ends: each batch is
handed to the operating system at once.  resume.json, known.npz and run.json are
replaced as a whole: there is always a whole one, older or newer.  They are forced to the disk too,
so that a power cut does not take them, except where the vehicle is simulated and waits (`durable`).
"""

import fcntl
import io
import os
import shutil
import struct
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import accumulate
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Literal, Self, final

import msgspec
from msgspec import Meta, Struct

from companion.errors import InputError
from companion.mavlink.frames import V1, V2, frame_extent
from companion.mission.journal import SCHEMA, VERSION, plain
from companion.telemetry import inputs
from companion.world.known_map import KnownMap, packed_map, unpacked_map

_TLOG, _JOURNAL = "flight.tlog", "journal.jsonl"
_GROWING = (_TLOG, _JOURNAL, inputs.FILE)
_WRITTEN = (_JOURNAL, _TLOG, "mission.toml", "run.json", inputs.FILE)
RECORDED = (*_WRITTEN, "resume.json", "known.npz", "truth.jsonl")
"""The files of a flight that cannot be made again."""
_STAMP = struct.Struct(">Q")
_PORTION = 2**20
LONGEST_RECORD = 288  # bytes, of the telemetry log
_LONGEST_TORN = 2**26  # a start with a large map
_MOST = 2**62
_Count = Annotated[int, Meta(ge=0, lt=_MOST)]


@final
class ResumeHead(Struct, frozen=True, kw_only=True):
    """What resume.json holds."""

    schema: Literal["companion-resume"] = "companion-resume"
    version: Literal[1] = 1
    epoch_us: _Count
    tlog_bytes: _Count
    inputs_bytes: _Count
    values: dict[str, Any]
    """Where the mission stands (`mission.checkpoint`); what they mean is not looked at here."""


@final
class RunFolder:
    """Writes a run folder; frames and entries in the order in which they happened."""

    def __init__(
        self,
        path: Path,
        *,
        mission_toml: str,
        beside: Mapping[str, Path] | None = None,
        epoch_us: int,
        resume: bool = False,
        durable: bool = True,
    ) -> None:
        """beside: files that the mission names, to be copied, by their names in the folder.

        epoch_us: microseconds since 1970 at vehicle time 0, for the log's stamps.

        durable: replaced files survive a power cut, not only this process.

        resume: append to the folder's contents.  InputError if it cannot be written to, is
        written to by another process, or holds a flight that is not to be resumed; a resumed
        flight goes on without being recorded (`failure`).
        """
        self.path, self.epoch_us, self._durable = path, epoch_us, durable
        self.failure: str | None = None
        """Why recording has stopped; the flight goes on."""
        self.unsaved: str | None = None
        """Why the flight's state could not be saved for a restart; what grows is still recorded."""
        self._starts = 0
        self._files: dict[str, io.FileIO] = {}
        """Those that grow, and mission.toml, which is locked."""
        held: list[str] = []
        try:
            path.mkdir(parents=True, exist_ok=True)
            held = [name for name in _WRITTEN if (path / name).exists()]
            if held and not resume:
                rule = f"it holds a flight already ({held[0]})"
                raise InputError("--out", str(path), rule, "Give a new folder, or --resume.")
            if "mission.toml" not in held:
                for name, file in (beside or {}).items():
                    with replacing(path / name, durable=durable) as copy, file.open("rb") as source:
                        shutil.copyfileobj(source, copy)
                with replacing(path / "mission.toml", durable=durable) as text:
                    text.write(mission_toml.encode())
            self._lock()
            if held:
                self._go_on()
            for name in _GROWING:
                self._files[name] = (path / name).open("ab", buffering=0)
        except OSError as error:
            if resume and held:  # the vehicle may be in the air
                self.failure = error.strerror or str(error)
                return
            if error.filename in map(str, (beside or {}).values()):
                rule, remedy = f"it cannot be read ({error.strerror})", "Put the file there again."
                raise InputError("terrain.file", error.filename, rule, remedy) from error
            rule = f"it cannot be written to ({error.strerror})"
            raise InputError("--out", str(path), rule, "Give a folder that can be.") from error

    def _lock(self) -> None:
        """Keep others from appending to the same files, until it is closed or this process ends."""
        file = self._files["mission.toml"] = (self.path / "mission.toml").open("rb", buffering=0)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.close()
            rule, remedy = "another companion records its flight there", "End it, or give another."
            raise InputError("--out", str(self.path), rule, remedy) from error
        except OSError:
            return  # a file system without locks

    def _go_on(self) -> None:
        """Truncate the incomplete records of a killed companion."""
        head = None
        with suppress(OSError, ValueError):
            head = resume_head(self.path)
        tlog, journal, calls = (self.path / name for name in _GROWING)
        self.epoch_us = self.epoch_us if head is None else head.epoch_us
        if tlog.exists():
            if head is None:  # the log's first record tells where vehicle time began
                first_us, _ = next(iter(Records(tlog)), (0, b""))
                self.epoch_us = first_us if 0 < first_us < _MOST else self.epoch_us
            whole = whole_records(tlog, 0 if head is None else head.tlog_bytes)
            _cut(tlog, whole, longest_torn=LONGEST_RECORD)
        if journal.exists():
            with journal.open("rb") as file:
                self._starts = sum(line.startswith(b'{"schema":') for line in file)
            _cut(journal, _whole_lines(journal))
        if calls.exists():
            _cut(calls, inputs.whole_inputs(calls, 0 if head is None else head.inputs_bytes))

    # --- what grows

    def header(self, values: Mapping[str, Any]) -> None:
        """The journal's first line: schema and version, and what the flight depends on."""
        head: dict[str, Any] = {"schema": SCHEMA, "version": VERSION, **values}
        if self._starts:
            head["resumed"] = self._starts
        self._write(_JOURNAL, [journal_line(head)])

    def frames(self, stamped: Iterable[tuple[float, bytes]]) -> None:
        """Frames with their vehicle times, seconds."""
        epoch_us = self.epoch_us
        self._write(
            _TLOG, [_STAMP.pack(epoch_us + round(at_s * 1e6)) + frame for at_s, frame in stamped]
        )

    def entries(self, entries: Iterable[Mapping[str, Any]]) -> None:
        """Journal entries."""
        self._write(_JOURNAL, [journal_line(entry) for entry in entries])

    def inputs(self, calls: Sequence[inputs.Input]) -> None:
        """What the session was told."""
        if calls and self._size(inputs.FILE) == 0:
            calls = (inputs.HEADER, *calls)
        self._write(inputs.FILE, inputs.packed(calls))

    def _size(self, name: str) -> int:
        return self._files[name].tell() if name in self._files else 0

    def _write(self, name: str, records: Sequence[bytes]) -> None:
        """Write records, unless the disk has failed before; never ends a flight."""
        batch, written = b"".join(records), 0
        if not batch or self.failure is not None:
            return
        file = self._files[name]
        try:
            while written < len(batch):  # a disk that is nearly full takes a part of it
                written += file.write(batch[written:])
        except OSError as error:
            self.failure = error.strerror or str(error)
            whole = max(end for end in accumulate(map(len, records), initial=0) if end <= written)
            with suppress(OSError):  # else whoever reads it stops at the last whole record
                file.truncate(file.seek(0, os.SEEK_END) - (written - whole))

    # --- what is replaced

    def checkpoint(self, values: Mapping[str, Any]) -> None:
        """Replace the checkpoint.  A full disk leaves the previous one."""
        head = ResumeHead(
            epoch_us=self.epoch_us,
            tlog_bytes=self._size(_TLOG),
            inputs_bytes=self._size(inputs.FILE),
            values=dict(values),
        )
        self.unsaved = self.unsaved or self._replace("resume.json", journal_line(head))

    def known_map(self, known: KnownMap) -> None:
        """Replace the known map.  A full disk leaves the previous one."""
        self._replace("known.npz", packed_map(known))

    def run_json(self, values: Mapping[str, Any]) -> None:
        """What differs from run to run."""
        text = msgspec.json.format(journal_line(values), indent=2) + b"\n"
        if self.failure is None:
            self.failure = self._replace("run.json", text)

    def _replace(self, name: str, content: bytes) -> str | None:
        """Replace a file; why it could not be."""
        try:
            with replacing(self.path / name, durable=self._durable) as file:
                file.write(content)
        except OSError as error:
            return error.strerror or str(error)
        return None

    def close(self) -> None:
        """Close the files."""
        for file in self._files.values():
            file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


# --- reading it again


def resume_head(path: Path) -> ResumeHead:
    """What resume.json holds.  OSError; ValueError, saying what is wrong with it."""
    try:
        return msgspec.json.decode((path / "resume.json").read_bytes(), type=ResumeHead)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"it is no checkpoint of a flight that can be read ({error})") from error


def whole_records(path: Path, start: int = 0) -> int:
    """Where the last whole record of a telemetry log ends.

    start: where some record begins, to look no further back; 0 if the file is shorter than that.
    """
    records = Records(path, start if start <= path.stat().st_size else 0)
    for _ in records:
        pass
    return records.end


@final
class Records:
    """The records of a telemetry log of ours, to the last whole one: stamp (microseconds), frame.

    Who iterates again gets what has been recorded since.  A log of a long flight is larger than
    the memory of a small computer: it is read in portions.
    """

    def __init__(self, path: Path, start: int = 0) -> None:
        """start: where some record begins."""
        self.path = path
        self.end = start
        """Where in the file the last record that was taken ends."""

    def __iter__(self) -> Generator[tuple[int, bytes]]:
        with self.path.open("rb") as file:
            file.seek(self.end)
            data, at = b"", 0
            while True:
                if len(data) - at < LONGEST_RECORD:
                    data, at = data[at:] + file.read(_PORTION), 0
                begin = at + _STAMP.size
                is_frame = begin < len(data) and data[begin] in (V1, V2)
                end = frame_extent(data, begin)[0] if is_frame else len(data) + 1
                if end > len(data):
                    return
                (stamp_us,) = _STAMP.unpack_from(data, at)
                self.end += end - at
                at = end
                yield stamp_us, data[begin:end]


def _whole_lines(path: Path) -> int:
    """Where the last whole line ends."""
    return path.read_bytes().rfind(b"\n") + 1


def known_map(path: Path) -> KnownMap:
    """The known map of a run folder.  OSError; ValueError if it cannot be read."""
    return unpacked_map((path / "known.npz").read_bytes())


# --- bytes


@contextmanager
def replacing(path: Path, *, durable: bool = True) -> Iterator[BinaryIO]:
    """Write a file so that at every moment there is a whole one under its name.

    If that fails, it is the one before.  durable: a power cut leaves a whole one too.
    """
    new = path.with_name(f".{path.name}.new")
    try:
        with new.open("wb") as file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)


def _cut(path: Path, size: int, *, longest_torn: int = _LONGEST_TORN) -> None:
    """Truncate after the last whole record: a torn one, or zeros after a power cut.

    If there is more than that, it is renamed, and begun anew.
    """
    torn = path.stat().st_size - size
    if torn > longest_torn and not inputs.is_hole(path, size):
        path.replace(path.with_name(f"{path.name}.damaged"))
    elif torn:
        os.truncate(path, size)


def journal_line(entry: Mapping[str, Any] | ResumeHead) -> bytes:
    """An entry as a line of the journal: null for numbers that JSON does not have."""
    return msgspec.json.encode(entry, enc_hook=plain) + b"\n"
