"""The recorder: the only writer of the run folder during a flight."""

import math
import queue
import threading
from collections.abc import Callable
from typing import Final, final

from companion.mavlink.link import Output
from companion.runtime.keys import SAVE_EVERY_S
from companion.runtime.watchdog import Clock, Failure
from companion.telemetry.run_folder import RunFolder

WRITER: Final = "writer"
"""The name of the part."""
_STATE: Final = "state for --resume"
_DISK_S = 2.0  # for one output: more is too slow
_LOOK_S: Final = 0.1  # between two outputs, or the computer was asleep
_MOST_WAITING = 32 * 2**20  # bytes
_LEAVE_S = 5.0


@final
class Recorder:
    """Writes outputs into the run folder, in the caller's thread.  Never ends a flight."""

    def __init__(
        self,
        folder: RunFolder,
        clock: Clock,
        on_loss: Callable[[Failure], None],
        persist: Callable[[], None] = lambda: None,
        portion: int = 1,
    ) -> None:
        """on_loss: told of each failure once.  persist: called every SAVE_EVERY_S, at the end too.

        portion: so many outputs are written at once.
        """
        self.folder, self.clock = folder, clock
        self._on_loss, self._persist = on_loss, persist
        self._persisted_s = clock()
        self._unwritten: list[Output] = []
        self._portion = portion
        self._parts_told = set[str]()

    def put(self, out: Output) -> None:
        """Write an output, now or with those that follow."""
        self._unwritten.append(out)
        if len(self._unwritten) >= self._portion:
            self._write()

    def close(self) -> None:
        """Write what is left, and save what must outlive this process."""
        self._write()
        self._persist()

    def tell(self, part: str, why: str | None) -> None:
        """Tell of a loss, unless there is none or it was told."""
        if why is not None and part not in self._parts_told:
            self._parts_told.add(part)
            self._on_loss(Failure(part, why))

    def _write(self) -> None:
        """The newest map comes before the newest checkpoint, which may build on it."""
        outs, self._unwritten, folder = self._unwritten, [], self.folder
        try:
            folder.frames([stamped for out in outs for stamped in out.record])
            folder.entries([entry for out in outs for entry in out.journal])
            folder.inputs([call for out in outs for call in out.inputs])
            if known := [out.known for out in outs if out.known is not None]:
                folder.known_map(known[-1])
            if kept := [out.checkpoint for out in outs if out.checkpoint is not None]:
                folder.checkpoint(kept[-1])
            if self.clock() - self._persisted_s >= SAVE_EVERY_S:
                self._persisted_s = self.clock()
                self._persist()
        except Exception as error:  # noqa: BLE001 - no recording is worth a flight
            folder.failure = f"{type(error).__name__}: {error}"
        self.tell(WRITER, folder.failure)
        self.tell(_STATE, folder.unsaved)


@final
class WriterThread:
    """Writes in a thread of its own and never blocks the loop."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._outputs: queue.SimpleQueue[Output | None] = queue.SimpleQueue()
        self._last_bytes = math.inf  # so much is recorded: once the queue was full, what waited
        self._put_bytes = self._written_bytes = 0  # each is changed by one thread only
        self._seen_bytes, self._seen_s, self._still_s = 0, recorder.clock(), 0.0
        self._thread = threading.Thread(target=self._run, name=WRITER, daemon=True)
        self._thread.start()

    def put(self, out: Output) -> None:
        """Queue an output; once the queue is full, what waits is the last that is recorded."""
        self._look()
        if self._put_bytes - self._written_bytes > _MOST_WAITING:
            self._last_bytes = min(self._last_bytes, self._put_bytes)
            return
        stopped = self._recorder.folder.failure is not None or self._last_bytes < math.inf
        if stopped and out.checkpoint is None:
            return
        self._put_bytes += out.size
        self._outputs.put(out)

    def close(self) -> None:
        """Wait until all is written, as long as there is progress."""
        self._outputs.put(None)
        before = -1
        while self._thread.is_alive() and self._written_bytes != before:
            before = self._written_bytes
            self._thread.join(_LEAVE_S)
        if self._thread.is_alive():
            self._recorder.folder.failure = "the disk does not answer"

    def _look(self) -> None:
        """Tell of a disk that has stood still for too long."""
        now_s = self._recorder.clock()
        waits = self._written_bytes == self._seen_bytes < self._put_bytes
        self._still_s = waits * (self._still_s + min(now_s - self._seen_s, _LOOK_S))
        self._seen_bytes, self._seen_s = self._written_bytes, now_s
        if self._still_s > _DISK_S:
            self._recorder.tell(WRITER, f"it has stood still for {self._still_s:.1f} s")

    def _run(self) -> None:
        out = self._outputs.get()
        while out is not None:
            self._recorder.put(out)
            self._written_bytes += out.size
            out = self._outputs.get()
            if self._written_bytes >= self._last_bytes and self._recorder.folder.failure is None:
                self._recorder.folder.failure = "the disk is too slow"
        self._recorder.close()
