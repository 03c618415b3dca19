"""inputs.msgpack of a run folder: all inputs of the session, in order (decision 0018).

A sequence of msgpack arrays: a header with schema and version, then one for each call of the
session: its name, then its arguments.

    start         what the session was made of; one more each time that the companion was resumed
    receive       frames without signatures, and when they arrived
    run           handle them; what follows from it is in flight.tlog and journal.jsonl
    deliver       the answer of the planner (`planner.request`)
    silence, stop, part_died, complain, farewell
    unsent        numbers of the frames of the last run that were not sent after all
    raised        the part that decides has ended with an error: the call of the session that it
                  came out of ("" if none), and the error; none of its last frames were sent
    held          so many frames were sent by the watchdog, past the session

It ends with the last whole record, however the flight ended.
"""

from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Final, final

import msgpack

from companion.errors import InputError

SCHEMA: Final = "companion-inputs"
VERSION: Final = 1
HEADER: Final = (SCHEMA, VERSION)
FILE: Final = "inputs.msgpack"
_PORTION: Final = 2**20
_READ: Final = 2**16  # at once: who asks for a few more each time reads it again
_LONGEST: Final = 64 * 2**20  # a start with a large map
_UNREADABLE: Final = (ValueError, TypeError, RecursionError, msgpack.exceptions.UnpackException)

Input = tuple[Any, ...]


def packed(calls: Iterable[Input]) -> list[bytes]:
    """The records of some inputs."""
    return [msgpack.packb(call) for call in calls]


@final
class InputsFile:
    """Reads them once, in order; memory is bounded by the longest record.

    Who iterates again gets what has been recorded since.
    """

    def __init__(self, path: Path) -> None:
        """InputError if it is another kind of file, or of an unsupported version."""
        self.path, self.read_bytes = path, 0
        self._is_broken = False
        try:
            head = next(iter(self), ())
        except OSError as error:
            rule = f"it cannot be read ({error.strerror})"
            remedy = "Give a run folder of a flight that was recorded with its inputs."
            raise InputError("RUN_DIR", str(path), rule, remedy) from error
        if head[:1] != (SCHEMA,):
            rule = "it does not begin like the inputs of a flight"
            raise InputError("RUN_DIR", str(path), rule, "Give a run folder.")
        if head != HEADER:
            rule = f"this companion reads version {VERSION} of inputs"
            raise InputError("RUN_DIR", head[1:], rule, "Replay it with the companion that flew.")

    @property
    def torn_bytes(self) -> int:
        """After the last whole record that was read."""
        return self.path.stat().st_size - self.read_bytes

    @property
    def is_damaged(self) -> bool:
        """Whether these are something else: nothing that a flight which ended there has left."""
        return self._is_broken and not is_hole(self.path, self.read_bytes)

    def __iter__(self) -> Iterator[Input]:
        """The next ones, up to the last whole one."""
        with self.path.open("rb") as file:
            for end, call in () if self._is_broken else _records(file, self.read_bytes):
                self._is_broken = call is None
                if call is not None:
                    self.read_bytes = end
                    yield call


def _records(file: BinaryIO, start: int) -> Iterator[tuple[int, Input | None]]:
    """Records from an offset on, each after where it ends; None: what follows is no input."""
    file.seek(start)
    unpacker = msgpack.Unpacker(file, read_size=_READ, max_buffer_size=_LONGEST)
    try:
        for record in unpacker:
            is_one = isinstance(record, list) and len(record) > 0 and type(record[0]) is str
            yield start + unpacker.tell(), tuple(record) if is_one else None
            if not is_one:
                return
    except _UNREADABLE:
        yield start, None


def whole_inputs(path: Path, start: int = 0) -> int:
    """End of the last whole record.

    start: the beginning of some record, to search from; 0 if the file is shorter.
    """
    with path.open("rb") as file:
        at = start if start <= path.stat().st_size else 0
        return max((end for end, call in _records(file, at) if call is not None), default=at)


def is_hole(path: Path, start: int) -> bool:
    """Whether a file has only zeros from an offset on, as after a power cut."""
    with path.open("rb") as file:
        file.seek(start)
        return not any(portion.strip(b"\0") for portion in iter(partial(file.read, _PORTION), b""))
