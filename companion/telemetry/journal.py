"""Reads journal.jsonl: headers and entries, checked, of every version (docs/journal.md).

    journal = Journal(run_dir / "journal.jsonl")
    for entry in journal.entries():          # streaming: a journal of days takes no more memory
        match entry:
            case PlanReady(): ...
    journal.headers, journal.findings        # filled while it is read

A flight that was killed, or whose disk was full, leaves a last line that is not whole: reading
stops before it.  Anything else that is not as documented is an InputError that names the line, or,
where it does no harm (a kind or a field that is not known), a finding.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn, final

from pydantic import TypeAdapter, ValidationError
from pydantic_core import from_json

from companion.errors import InputError
from companion.mission.state import Reason
from companion.telemetry.journal_entries import Entry, Fence
from companion.telemetry.journal_lines import SCHEMA, VERSION, Header, Line
from companion.telemetry.journal_plans import PlanReady

_HEADER = b'{"schema":'
_MOST_BYTES = 64 * 2**20  # of a line: a fence of 100,000 corners takes 4 MB
_AS_WRITTEN = "Give the journal as the companion has written it."

_Raw = dict[str, Any]
_ENTRY: TypeAdapter[Entry] = TypeAdapter(Entry)

_CODES = {reason.text: reason.name for reason in Reason}


def _with_code(entry: _Raw) -> _Raw:
    """Version 1 to 2: a phase names its reason, which was only there in words."""
    if entry.get("kind") == "phase" and "code" not in entry:
        entry["code"] = _CODES.get(str(entry.get("reason")))
    return entry


def _without_stops(entry: _Raw) -> _Raw:
    """Version 2 to 3: the planner is not told how often the vehicle has stopped."""
    if entry.get("kind") == "plan asked":
        entry.pop("stops", None)
    return entry


_TO_NEXT: dict[int, Callable[[_Raw], _Raw]] = {1: _with_code, 2: _without_stops}
"""How an entry of a version becomes one of the next."""


@final
class Journal:
    """A journal.jsonl, read in one go from its beginning, as often as one likes."""

    def __init__(self, path: Path) -> None:
        """Nothing is opened before it is read."""
        self.path = path
        self.headers: list[Header] = []
        """One for each time that the companion was started; none if nothing was recorded."""
        self._unknown: Counter[str] = Counter()
        self._torn_bytes = 0

    @property
    def findings(self) -> tuple[str, ...]:
        """What was not as documented, each once, for people."""
        found = [f"{count} x {what}: left out" for what, count in self._unknown.items()]
        if self._torn_bytes:
            found.append(f"the last line is not whole ({self._torn_bytes} bytes): left out")
        return tuple(f"{self.path.name}: {each}" for each in found)

    def entries(self) -> Iterator[Entry]:
        """The entries in their order; raises InputError, also while it is read."""
        return (line for line in self.lines() if not isinstance(line, Header))

    def lines(self) -> Iterator[Header | Entry]:
        """Headers and entries in their order; raises InputError, also while it is read."""
        self.headers.clear()
        self._unknown.clear()
        self._torn_bytes = 0
        read: Callable[[bytes, str], Entry | None] = self._before_any_header
        for number, text in enumerate(self._whole_lines(), start=1):
            where = f"{self.path.name} line {number}"
            if text.startswith(_HEADER):
                header = _header_of(text, where)
                read = self._reader_of(header.version)
                self._count_unknown(header, "header")
                self.headers.append(header)
                yield header
            elif (entry := read(text, where)) is not None:
                yield entry

    def _whole_lines(self) -> Iterator[bytes]:
        try:
            with self.path.open("rb") as file:
                while line := file.readline(_MOST_BYTES):
                    if line.endswith(b"\n"):
                        yield line
                    elif len(line) == _MOST_BYTES:
                        rule = f"a line has no end within {_MOST_BYTES // 2**20} MB"
                        raise InputError("journal", str(self.path), rule, _AS_WRITTEN)
                    else:
                        self._torn_bytes = len(line)
        except OSError as error:
            rule = f"it cannot be read ({error.strerror or error})"
            raise InputError("journal", str(self.path), rule, "Give a run folder.") from error

    # --- lines

    def _before_any_header(self, text: bytes, where: str) -> NoReturn:
        rule = f'a journal begins with a header, {{"schema":"{SCHEMA}",...}}'
        raise InputError(where, text[:80].decode(errors="replace"), rule, _AS_WRITTEN)

    def _reader_of(self, version: int) -> Callable[[bytes, str], Entry | None]:
        """What reads the entries of a version; older ones are brought up step by step."""
        steps = [_TO_NEXT[each] for each in range(version, VERSION)]

        def read(text: bytes, where: str) -> Entry | None:
            try:
                if not steps:
                    return self._known(_ENTRY.validate_json(text))
                raw = from_json(text)
                for step in steps if isinstance(raw, dict) else ():
                    raw = step(raw)
                return self._known(_ENTRY.validate_python(raw))
            except ValidationError as error:
                self._pass_over(error, text, where)
                return None
            except ValueError as error:
                raise _not_json(text, where, error) from None

        return read

    def _known(self, entry: Entry) -> Entry:
        self._count_unknown(entry, entry.kind)
        if isinstance(entry, PlanReady):
            self._count_unknown(entry.certificate, "plan ready.certificate")
        elif isinstance(entry, Fence):
            for zone in entry.zones:
                self._count_unknown(zone, "fence.zones")
        return entry

    def _count_unknown(self, line: Line, name: str) -> None:
        for field in line.model_extra or ():
            self._unknown[f"field {name}.{field}, which is not known"] += 1

    def _pass_over(self, error: ValidationError, text: bytes, where: str) -> None:
        """Pass over an entry of a kind that is not known; raise InputError for any other."""
        first = error.errors(include_url=False)[0]
        if first["type"] == "union_tag_invalid":
            kind = first["ctx"]["tag"]
            self._unknown[f"kind {kind!r}, which is not known"] += 1
            return
        if first["type"] == "json_invalid":
            raise _not_json(text, where, first["ctx"]["error"]) from None
        raise _refused(first, where) from None


def _header_of(text: bytes, where: str) -> Header:
    """The header in a line, of a version that can be read."""
    try:
        raw = from_json(text)
    except ValueError as error:
        raise _not_json(text, where, error) from None
    if raw.get("schema") != SCHEMA:
        rule = f"only {SCHEMA!r} can be read"
        raise InputError(f"{where}: schema", raw.get("schema"), rule, _AS_WRITTEN)
    version = raw.get("version")
    if type(version) is not int or not 1 <= version <= VERSION:
        rule = f"versions 1 to {VERSION} can be read"
        remedy = "Read it with a companion as new as the one that has written it."
        raise InputError(f"{where}: version", version, rule, remedy)
    try:
        return Header.model_validate(raw)
    except ValidationError as error:
        raise _refused(error.errors(include_url=False)[0], where) from None


def _refused(first: Any, where: str) -> InputError:
    """The error about the first rule that a line breaks."""
    names = [str(part) for part in first["loc"]]
    if len(names) > 1 and names[0] in _KINDS:
        names = names[1:]  # the kind, which pydantic puts in front
    field = ".".join(names) or "kind"
    if first["type"] in ("missing", "union_tag_not_found"):
        return InputError(f"{where}: {field}", None, "it is missing", _AS_WRITTEN)
    rule = str(first["msg"])
    return InputError(f"{where}: {field}", first["input"], rule[:1].lower() + rule[1:], _AS_WRITTEN)


def _not_json(text: bytes, where: str, error: object) -> InputError:
    shown = text[:80].decode(errors="replace").rstrip("\n")
    return InputError(where, shown, f"it is not JSON ({error})", _AS_WRITTEN)


_KINDS = frozenset(_ENTRY.json_schema()["discriminator"]["mapping"])
