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
_AS_WRITTEN = "Give the journal as the companion has written it."


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
        found = [f"{n} x kind {kind!r}, which is not known: left out" for kind, n in unknown]
        if self._torn_bytes:
            found.append(f"the last line is not whole ({self._torn_bytes} bytes): left out")
        return tuple(f"{self.path.name}: {each}" for each in found)

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
            if text.startswith(_HEADER):
                self.headers.append(_header(text, where))
                yield self.headers[-1]
            elif not self.headers:
                rule = f'a journal begins with a header, {{"schema":"{SCHEMA}",...}}'
                raise _refused(text, ValidationError(rule), where)
            elif (entry := self._entry(text, where)) is not None:
                yield entry

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
            raise InputError("journal", str(self.path), rule, "Give a run folder.") from error

    # --- lines

    def _entry(self, text: bytes, where: str) -> Entry | None:
        """The entry in a line; None if its kind is not known."""
        raw = _decoded(text, where)
        try:
            return entry_of(raw)
        except (ValidationError, LookupError, TypeError) as error:
            kind = raw.get("kind") if isinstance(raw, dict) else None
            if isinstance(kind, str) and kind not in KINDS:
                self._unknown[kind] += 1
                return None
            raise _refused(text, error, where) from None


def _header(text: bytes, where: str) -> Header:
    """The header in a line."""
    raw = _decoded(text, where)
    for field, only in (("schema", SCHEMA), ("version", VERSION)):
        found = raw.get(field)
        if type(found) is not type(only) or found != only:
            remedy = "Read it with the companion that has written it."
            raise InputError(f"{where}: {field}", found, f"only {only!r} can be read", remedy)
    try:
        return msgspec.convert(raw, Header)
    except ValidationError as error:
        raise _refused(text, error, where) from None


def _refused(text: bytes, error: Exception, where: str) -> InputError:
    """The error about the first rule that a line breaks."""
    words = str(error) if isinstance(error, ValidationError) else "an entry has a known kind"
    rule, _, path = words.partition(" - at `$")
    field = path.strip("`.")
    shown = text[:_SHOWN_BYTES].decode(errors="replace").rstrip("\n")
    return InputError(f"{where}{field and ': '}{field}", shown, rule, _AS_WRITTEN)


def _decoded(text: bytes, where: str) -> Any:
    try:
        values = msgspec.json.decode(text)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise _refused(text, ValidationError(f"it is not JSON ({error})"), where) from None
    return values if _NOT_PLAIN(text) is None else with_printable_texts(values)
