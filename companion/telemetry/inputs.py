"""inputs.msgpack of a run folder: all inputs of the session, in order (decision 0018).

A sequence of msgpack arrays: a header with schema and version, then one for each call of the
session: its name, then its arguments.

    start         what the session was made of; one more each time that the companion was resumed
    receive       frames without signatures, and when they arrived
    run           handle them; what follows from it is in flight.tlog and journal.jsonl
    deliver       the answer of the planner (`planner.request`)
    silence, stop, part_died, recording_stopped, complain, farewell
    unsent        numbers of the frames of the last run that were not sent after all
    raised        the part that decides has ended with an error: the call of the session that it
                  came out of ("" if none), and the error; none of its last frames were sent
    held          so many frames were sent by the watchdog, past the session

It ends with the last whole record, however the flight ended.
"""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Final, final

import msgpack

from companion.errors import InputError

SCHEMA: Final = "companion-inputs"
VERSION: Final = 1
HEADER: Final = (SCHEMA, VERSION)
FILE: Final = "inputs.msgpack"
_PORTION: Final = 2**20
_LONGEST: Final = 64 * 2**20  # a start with a large map
UNREADABLE = (ValueError, TypeError, RecursionError, msgpack.exceptions.UnpackException)

Input = tuple[Any, ...]


def packed(told: Iterable[Input]) -> list[bytes]:
    """The records of some inputs."""
    return [msgpack.packb(each) for each in told]


@final
class InputsFile:
    """Reads them again, as often as it is asked; memory is bounded by the longest record."""

    def __init__(self, path: Path) -> None:
        """InputError if it is another kind of file, or of an unsupported version."""
        self.path = path
        self.size_bytes = self.read_bytes = 0
        """Of the file, when it was read last; how much of it was read so far."""
        self.torn_bytes = 0
        """At the end of the file, of a record that is not whole; once it was read to there."""
        self.is_damaged = False
        """Whether these are something else: nothing that a flight which ended there has left."""
        try:
            head = next(self._records(), ())
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

    def __iter__(self) -> Iterator[Input]:
        """The inputs up to the last whole one."""
        return islice(self._records(), 1, None)

    def _records(self) -> Iterator[Input]:
        size, end, is_whole = self.path.stat().st_size, 0, True
        self.size_bytes = size
        with self.path.open("rb") as file:
            unpacker = msgpack.Unpacker(file, read_size=_PORTION, max_buffer_size=_LONGEST)
            try:
                for told in unpacker:
                    is_whole = isinstance(told, list) and told[:1] != [] and type(told[0]) is str
                    if not is_whole:
                        break
                    self.read_bytes = end = unpacker.tell()
                    yield tuple(told)
            except UNREADABLE:
                is_whole = False
        self.torn_bytes = max(size - end, 0)  # it may have grown meanwhile
        self.is_damaged = not is_whole and not is_hole(self.path, end)


def whole_inputs(path: Path, start: int = 0) -> int:
    """End of the last whole record.

    start: the beginning of some record, to search from; 0 if the file is shorter.
    """
    at = start if start <= path.stat().st_size else 0
    with path.open("rb") as file:
        file.seek(at)
        unpacker = msgpack.Unpacker(file, read_size=_PORTION, max_buffer_size=_LONGEST)
        end = 0
        with suppress(*UNREADABLE):
            for _ in unpacker:
                end = unpacker.tell()
    return at + end


def is_hole(path: Path, start: int) -> bool:
    """Whether a file has only zeros from an offset on, as after a power cut."""
    with path.open("rb") as file:
        file.seek(start)
        return not any(portion.strip(b"\0") for portion in iter(partial(file.read, _PORTION), b""))
