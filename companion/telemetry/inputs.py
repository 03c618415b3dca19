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
_UNREADABLE: Final = (ValueError, TypeError, RecursionError, msgpack.exceptions.UnpackException)

Input = tuple[Any, ...]


def packed(told: Iterable[Input]) -> list[bytes]:
    """The records of some inputs."""
    return [msgpack.packb(each) for each in told]


@final
class InputsFile:
    """Reads them once, in order; memory is bounded by the longest record.

    Who iterates again gets what has been recorded since.
    """

    def __init__(self, path: Path) -> None:
        """InputError if it is another kind of file, or of an unsupported version."""
        self.path = path
        self.size_bytes = self.read_bytes = 0
        """Of the file, as far as it was seen; how much of it was read."""
        self._unpacker = msgpack.Unpacker(max_buffer_size=_LONGEST)
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
        """At the end of what was seen of the file, of a record that is not whole."""
        return self.size_bytes - self.read_bytes

    @property
    def is_damaged(self) -> bool:
        """Whether these are something else: nothing that a flight which ended there has left."""
        return self._is_broken and not is_hole(self.path, self.read_bytes)

    def __iter__(self) -> Iterator[Input]:
        """The next ones, up to the last whole one."""
        while not self._is_broken:
            try:
                told = next(self._unpacker, None)
                if told is None and not self._seen_more():
                    return
            except _UNREADABLE:
                self._is_broken = True
                return
            if told is None:
                continue
            self._is_broken = not (isinstance(told, list) and told and type(told[0]) is str)
            if not self._is_broken:
                self.read_bytes = self._unpacker.tell()
                yield tuple(told)

    def _seen_more(self) -> bool:
        with self.path.open("rb") as file:
            file.seek(self.size_bytes)
            portion = file.read(_PORTION)
        self.size_bytes += len(portion)
        self._unpacker.feed(portion)
        return bool(portion)


def whole_inputs(path: Path, start: int = 0) -> int:
    """End of the last whole record.

    start: the beginning of some record, to search from; 0 if the file is shorter.
    """
    at = start if start <= path.stat().st_size else 0
    with path.open("rb") as file:
        file.seek(at)
        unpacker = msgpack.Unpacker(file, read_size=_PORTION, max_buffer_size=_LONGEST)
        end = 0
        with suppress(*_UNREADABLE):
            for _ in unpacker:
                end = unpacker.tell()
    return at + end


def is_hole(path: Path, start: int) -> bool:
    """Whether a file has only zeros from an offset on, as after a power cut."""
    with path.open("rb") as file:
        file.seek(start)
        return not any(portion.strip(b"\0") for portion in iter(partial(file.read, _PORTION), b""))
