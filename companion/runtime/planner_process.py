"""Planner process: no plan ever delays a setpoint, and one that hangs is killed.

In the same process it would: numba holds the interpreter lock for seconds while it compiles, and
what guidance and search do between their compiled parts holds it for some milliseconds each.

The protocol is pickles over the child's standard input and output: requests and "enough" in,
"ready" and answers out.  A child whose parent has died reads the end of its input, and ends.
Arrays follow the pickle of what is asked: that of a near mission's map, 28 MB, would hold the
interpreter lock for 15 ms.
"""

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import IO, Any, final

from companion.planner.request import PlanOutcome, PlanRequest
from companion.planning import plan
from companion.runtime.compiler import load_kernel, load_libraries

_LOOK_S = 0.02
_READY = "ready"


class PlannerEndedError(Exception):
    """The planner process has ended or failed."""


@final
class PlannerProcess:
    """Answers plan requests as `plan` does, from another process."""

    def __init__(self, module: str = "companion.runtime.planner_process") -> None:
        """module: what the process runs."""
        self._module = module
        self._child: subprocess.Popen[bytes] | None = None
        self._answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.on_end: Callable[[PlannerEndedError], None] = lambda _error: None
        """Told at once, in a thread of its own, when the process has ended."""
        self.is_ready = False

    @property
    def pid(self) -> int | None:
        """Of the process, once there is one."""
        return None if self._child is None else self._child.pid

    def start(self) -> None:
        """Start the process and wait until its kernel is loaded; PlannerEndedError if it fails."""
        if self.is_ready:
            return
        places = os.pathsep.join(place for place in sys.path if place)
        self._child = subprocess.Popen(
            [sys.executable, "-P", "-m", self._module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": places},
            start_new_session=True,  # Ctrl-C is the parent's to decide about
        )
        threading.Thread(target=self._listen, args=(self._child,), daemon=True).start()
        if (word := self._answers.get()) != _READY:
            raise PlannerEndedError(str(word))
        self.is_ready = True

    def __call__(self, request: PlanRequest, stop: Callable[[], bool]) -> PlanOutcome:
        """One plan; PlannerEndedError if the process does not survive it."""
        if self._child is None:
            self.start()
        self._say(request)
        stopped = False
        while True:
            try:
                answer = self._answers.get(timeout=_LOOK_S)
            except queue.Empty:
                if not stopped and stop():
                    stopped = True
                    self._say(request.plan_id)
                continue
            if isinstance(answer, PlannerEndedError):
                raise answer
            outcome: PlanOutcome = answer
            return outcome

    def close(self) -> None:
        """Kill the process."""
        child = self._child
        if child is not None:
            child.kill()
            child.wait()
            for pipe in (child.stdin, child.stdout):
                if pipe is not None:
                    with contextlib.suppress(OSError):
                        pipe.close()

    def _say(self, word: PlanRequest | int) -> None:
        assert self._child is not None
        assert self._child.stdin is not None
        arrays: list[pickle.PickleBuffer] = []
        text = pickle.dumps(word, pickle.HIGHEST_PROTOCOL, buffer_callback=arrays.append)
        views = [array.raw() for array in arrays]
        head = pickle.dumps((text, [view.nbytes for view in views]), pickle.HIGHEST_PROTOCOL)
        with contextlib.suppress(OSError):  # the listener has noticed
            self._child.stdin.write(head)
            for view in views:
                self._child.stdin.write(view)
            self._child.stdin.flush()

    def _listen(self, child: subprocess.Popen[bytes]) -> None:
        assert child.stdout is not None
        try:
            while True:
                self._answers.put(pickle.load(child.stdout))
        except Exception:  # noqa: BLE001 - however the stream ends, the child is of no use
            ended = PlannerEndedError(f"its process has ended ({_how(child)})")
            self._answers.put(ended)
            self.on_end(ended)


def _how(child: subprocess.Popen[bytes]) -> str:
    try:
        code = child.wait(timeout=1.0)
    except subprocess.TimeoutExpired:
        return "it says nothing that can be read"
    if code >= 0:
        return f"exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


# --- the child


def main() -> None:
    """Answer requests until the input ends."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends with its parent, who says farewell
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # printed output must not mix with the answers
    questions: queue.SimpleQueue[PlanRequest | None] = queue.SimpleQueue()
    enough: set[int] = set()
    threading.Thread(target=_hear, args=(sys.stdin.buffer, questions, enough), daemon=True).start()
    load_libraries()
    load_kernel()
    with contextlib.suppress(BrokenPipeError):
        _tell(answers, _READY)
        while (request := questions.get()) is not None:
            _tell(answers, _answer(request, enough))


def _answer(request: PlanRequest, enough: set[int]) -> PlanOutcome | PlannerEndedError:
    try:
        return plan(request, lambda: request.plan_id in enough)
    except Exception as error:  # noqa: BLE001 - the parent puts the vehicle on hold
        return PlannerEndedError(f"{type(error).__name__}: {error}")


def _tell(answers: IO[bytes], word: object) -> None:
    answers.write(pickle.dumps(word, pickle.HIGHEST_PROTOCOL))
    answers.flush()


def _hear(
    words: IO[bytes], questions: "queue.SimpleQueue[PlanRequest | None]", enough: set[int]
) -> None:
    try:
        while True:
            text, sizes = pickle.load(words)
            arrays = [bytearray(size) for size in sizes]
            for array in arrays:
                words.readinto(array)  # type: ignore[attr-defined]
            word = pickle.loads(text, buffers=arrays)
            if isinstance(word, int):
                enough.add(word)
            else:
                questions.put(word)
    except Exception:  # noqa: BLE001 - the parent has ended, however it ended
        questions.put(None)
        os._exit(0)  # even in the middle of a plan


if __name__ == "__main__":
    main()
