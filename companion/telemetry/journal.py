"""Reads journal.jsonl: headers and entries, checked (docs/reference/journal.md).

    journal = Journal(run_dir / "journal.jsonl")
    for entry in journal.entries():          # streaming: a journal of days takes no more memory
        match entry:
            case PlanReady(): ...
    journal.headers, journal.findings        # filled while it is read

A flight that was killed, or whose disk was full, leaves a last line that is not whole: reading
stops before it.  A kind that is not known is passed over, and a finding; fields that are not known
are passed over.  Anything else that is not as documented is an InputError that names the line.
"""

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, final

import msgspec
from msgspec import ValidationError

from companion.errors import InputError
from companion.mission.journal import KINDS, SCHEMA, VERSION, Entry, Header, entry_of
from companion.printable import with_printable_texts

_NOT_PLAIN = re.compile(rb"\\|[^\x20-\x7e\n]").search
"""What may have to be cleaned: escapes, and more than ASCII."""
_HEADER = b'{"schema":'
_SHOWN_BYTES = 80  # of a line that is refused
_MAX_BYTES = 64 * 2**20  # of a line: a fence of 100,000 corners takes 4 MB
_NO_LINE = (msgspec.DecodeError, UnicodeDecodeError, LookupError, TypeError)
_AS_WRITTEN = "Give the journal as the companion has written it."
_OF_A_RUN = "Give the run folder of a flight: the one that was given to companion fly --out."


@final
class Journal:
    """A journal.jsonl, read from its beginning; asked again, what has been written since."""

    def __init__(self, path: Path) -> None:
        """Nothing is opened before it is read."""
        self.path = path
        self.headers: list[Header] = []
        """One for each time that the companion was started; none if nothing was recorded."""
        self._unknown: Counter[str] = Counter()
        self._torn_bytes = self._read_bytes = self._read_lines = 0

    @property
    def findings(self) -> tuple[str, ...]:
        """What was not as documented, each once, as text."""
        unknown = self._unknown.items()
        oddities = [f"{n} x kind {kind!r}, which is not known: left out" for kind, n in unknown]
        if self._torn_bytes:
            oddities.append(f"the last line is not whole ({self._torn_bytes} bytes): left out")
        return tuple(f"{self.path.name}: {oddity}" for oddity in oddities)

    def entries(self) -> Iterator[Entry]:
        """Likewise without headers."""
        return (line for line in self.lines() if not isinstance(line, Header))

    def lines(self) -> Iterator[Header | Entry]:
        """Headers and entries in their order, after the last one that was read before.

        Raises InputError, also while it is read.
        """
        for text in self._whole_lines():
            self._read_bytes += len(text)
            self._read_lines += 1
            where = f"{self.path.name} line {self._read_lines}"
            try:
                line = self._line(text, where)
            except _NO_LINE as error:
                raise _refused(text, error, where) from None
            if line is not None:
                yield line

    def _whole_lines(self) -> Iterator[bytes]:
        try:
            with self.path.open("rb") as file:
                file.seek(self._read_bytes)
                self._torn_bytes = 0
                while line := file.readline(_MAX_BYTES):
                    if line.endswith(b"\n"):
                        yield line
                    elif len(line) == _MAX_BYTES:
                        rule = f"a line has no end within {_MAX_BYTES // 2**20} MB"
                        raise InputError("journal", str(self.path), rule, _AS_WRITTEN)
                    else:
                        self._torn_bytes = len(line)
        except OSError as error:
            rule = f"it cannot be read ({error.strerror or error})"
            raise InputError("journal", str(self.path), rule, _OF_A_RUN) from error

    def _line(self, text: bytes, where: str) -> Header | Entry | None:
        """What a line says; None: an entry of a kind that is not known.  Raises one of _NO_LINE."""
        values = msgspec.json.decode(text)
        if _NOT_PLAIN(text) is not None:
            values = with_printable_texts(values)
        if text.startswith(_HEADER):
            self.headers.append(_header(values, where))
            return self.headers[-1]
        if not self.headers:
            raise ValidationError(f'a journal begins with a header, {{"schema":"{SCHEMA}",...}}')
        kind = values["kind"]
        if isinstance(kind, str) and kind not in KINDS:
            self._unknown[kind] += 1
            return None
        return entry_of(values)


def _header(values: dict[str, Any], where: str) -> Header:
    """A header of the schema and version that are known."""
    for field, only in (("schema", SCHEMA), ("version", VERSION)):
        value = values.get(field)
        if type(value) is not type(only) or value != only:
            remedy = "Read it with the companion that has written it."
            raise InputError(f"{where}: {field}", value, f"only {only!r} can be read", remedy)
    return msgspec.convert(values, Header)


def _refused(text: bytes, error: Exception, where: str) -> InputError:
    """The error about the first rule that a line breaks."""
    rule, field = "an entry has a known kind", ""
    if isinstance(error, ValidationError):
        rule, _, path = str(error).partition(" - at `$")
        field = path.strip("`.")
    elif isinstance(error, ValueError):
        rule = f"it is not JSON ({error})"
    shown = text[:_SHOWN_BYTES].decode(errors="replace").rstrip("\n")
    return InputError(f"{where}{field and ': '}{field}", shown, rule, _AS_WRITTEN)
