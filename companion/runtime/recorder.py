"""The recorder: the only writer of the run folder during a flight."""

import contextlib
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol, final

from companion.runtime.keys import SAVE_EVERY_S
from companion.runtime.watchdog import Clock, Failure, Worker
from companion.telemetry.run_folder import RunFolder
from companion.world.known_map import KnownMap

_DISK_S = 2.0
_MAX_UNWRITTEN = 32 * 2**20  # bytes
_ENTRY_BYTES = 500  # what a journal entry takes, about
_LEAVE_S = 5.0


@final
@dataclass(slots=True, kw_only=True)
class Batch:
    """The records of one iteration, or of several."""

    record: list[tuple[float, bytes]] = field(default_factory=list)
    journal: list[dict[str, Any]] = field(default_factory=list)
    inputs: list[tuple[Any, ...]] = field(default_factory=list)
    checkpoint: dict[str, Any] | None = None
    known: KnownMap | None = None

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to do."""
        told = self.record or self.journal or self.inputs
        return not (told or self.checkpoint or self.known)

    @property
    def size(self) -> int:
        """Bytes, about."""
        frames = sum(len(frame) for _, frame in self.record)
        told = sum(len(each[1]) for each in self.inputs if each[0] == "receive")
        return frames + told + _ENTRY_BYTES * len(self.journal)

    def add(self, more: "Batch") -> None:
        """Take in what came after; of checkpoint and map the newest count."""
        self.record += more.record
        self.journal += more.journal
        self.inputs += more.inputs
        self.checkpoint = more.checkpoint or self.checkpoint
        self.known = more.known or self.known


WRITER = "writer"
"""The name of the part."""
_STATE = "state for --resume"


class Writer(Protocol):
    """Where batches go."""

    def put(self, batch: Batch) -> None:
        """Record it, now or soon."""
        ...

    def close(self) -> None:
        """Write everything that can be written."""
        ...


@final
class NoWriter:
    """Records nothing."""

    def put(self, batch: Batch) -> None:
        """Nothing is kept."""

    def close(self) -> None:
        """Nothing is waiting."""


@final
class Recorder:
    """Writes batches into the run folder."""

    def __init__(self, folder: RunFolder, clock: Clock, persist: Callable[[], None] | None) -> None:
        """persist: called every SAVE_EVERY_S and at the end."""
        self.folder = folder
        self._clock, self._persist = clock, persist
        self._persisted_s = clock()

    def write(self, batch: Batch) -> None:
        """Write a batch: the map before the checkpoint that may build on it."""
        self.folder.frames(batch.record)
        self.folder.entries(batch.journal)
        self.folder.inputs(batch.inputs)
        if batch.known is not None:
            self.folder.known_map(batch.known)
        if batch.checkpoint is not None:
            self.folder.checkpoint(batch.checkpoint)
        if self._clock() - self._persisted_s >= SAVE_EVERY_S:
            self.persist()

    def persist(self) -> None:
        """Save what must outlive this process."""
        self._persisted_s = self._clock()
        if self._persist is not None:
            self._persist()


@final
class InlineWriter:
    """Writes in the control loop's thread."""

    def __init__(
        self, recorder: Recorder, on_loss: Callable[[Failure], None], portion: int = 0
    ) -> None:
        """portion: so many frames are written at once; 0: all that is put, when it is put."""
        self._recorder, self._on_loss, self._portion = recorder, on_loss, portion
        self._unwritten = Batch()
        self._failed = False

    def put(self, batch: Batch) -> None:
        """Write it, now or with what follows."""
        self._unwritten.add(batch)
        if len(self._unwritten.record) >= self._portion:
            self._write()

    def close(self) -> None:
        """Write what is left."""
        self._write()
        self._recorder.persist()

    def _write(self) -> None:
        batch, self._unwritten, folder = self._unwritten, Batch(), self._recorder.folder
        if self._failed or batch.is_empty:
            return
        try:
            self._recorder.write(batch)
        except Exception as error:  # noqa: BLE001 - no recording is worth a flight
            folder.failure = f"{type(error).__name__}: {error}"
        if folder.failure is not None:
            self._failed = True
            self._on_loss(Failure(part=WRITER, error=folder.failure))


@final
class WriterThread:
    """Writes in a thread of its own and never blocks the control loop."""

    def __init__(self, recorder: Recorder, on_loss: Callable[[Failure], None]) -> None:
        self.part = Worker(WRITER, vital=False)
        self._recorder, self._on_loss = recorder, on_loss
        self._batches: queue.SimpleQueue[Batch | None] = queue.SimpleQueue()
        self._put_bytes = self._written_bytes = 0  # each is changed by one thread only
        self._told = set[str]()
        self._done = threading.Event()

    def put(self, batch: Batch) -> None:
        """Queue a batch; once the queue is full nothing more is recorded."""
        folder = self._recorder.folder
        if batch.is_empty or (folder.failure is not None and batch.checkpoint is None):
            return
        if self._put_bytes - self._written_bytes > _MAX_UNWRITTEN:
            folder.failure = "the disk is too slow"
            return
        self._put_bytes += batch.size
        self._batches.put(batch)

    def run(self) -> None:
        """Write until stopped."""
        try:
            self.part.idle()
            while (batch := self._next()) is not None:
                self.part.beat(_DISK_S)
                self._recorder.write(batch)
                self._written_bytes += batch.size
                self.part.idle()
                self._tell()
            self._recorder.persist()
        except BaseException as error:
            self._recorder.folder.failure = f"{type(error).__name__}: {error}"
            raise
        finally:
            self._done.set()

    def _next(self) -> Batch | None:
        """All queued batches as one; None at the end."""
        first = self._batches.get()
        if first is None:
            return None
        with contextlib.suppress(queue.Empty):
            while True:
                more = self._batches.get_nowait()
                if more is None:
                    self._batches.put(None)
                    break
                first.add(more)
        return first

    def _tell(self) -> None:
        folder = self._recorder.folder
        for part, error in ((WRITER, folder.failure), (_STATE, folder.unsaved)):
            if error is not None and part not in self._told:
                self._told.add(part)
                self._on_loss(Failure(part=part, error=error))

    def close(self) -> None:
        """Wait until all is written, as long as there is progress."""
        self._batches.put(None)
        before = -1
        while not self._done.wait(_LEAVE_S):
            if self._written_bytes == before:
                self._recorder.folder.failure = "the disk does not answer"
                return
            before = self._written_bytes
