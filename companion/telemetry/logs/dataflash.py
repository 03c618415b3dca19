"""ArduPilot's .bin: entries that FMT entries describe; nothing in it has a checksum.

    A3 95 id payload             the length of each kind is fixed, and stands in its FMT
    A3 95 80 id length name[4] format[16] columns[64]

pymavlink's DFReader reads these too.  It is not used here: it maps and indexes the whole file
first, prints what it stumbles upon and goes on, so that what was damaged cannot be told, and brings
mavutil's global state along.  The tests compare with it, entry by entry.
"""

import re
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any, Final, final

from companion.telemetry.logs.findings import Findings, Oddity
from companion.telemetry.logs.search import find_entry
from companion.telemetry.logs.translated import Row
from companion.telemetry.logs.window import Window

MAGIC: Final = b"\xa3\x95"
FMT: Final = 0x80
_FMT_BYTES: Final = 89
_HEAD: Final = 3
_LONGEST: Final = 255
_AHEAD: Final = 2 * _LONGEST + _HEAD
_find_head = re.compile(rb"\xa3\x95").search
_LETTERS: Final = {
    "a": ("64s", None),
    "b": ("b", None),
    "B": ("B", None),
    "g": ("e", None),
    "h": ("h", None),
    "H": ("H", None),
    "i": ("i", None),
    "I": ("I", None),
    "f": ("f", None),
    "n": ("4s", None),
    "N": ("16s", None),
    "Z": ("64s", None),
    "c": ("h", 100.0),
    "C": ("H", 100.0),
    "e": ("i", 100.0),
    "E": ("I", 100.0),
    "L": ("i", None),
    "d": ("d", None),
    "M": ("B", None),
    "q": ("q", None),
    "Q": ("Q", None),
}
"""Of a column: its struct, and what its number is to be divided by.  Degrees stay times 1e7."""
_TEXTS: Final = frozenset("nNZ")
_UNITS_US: Final = {"TimeUS": 1, "TimeMS": 1000}


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """One kind of entry."""

    name: str
    length: int
    """With the head."""
    packing: struct.Struct
    columns: tuple[tuple[str, float | None, bool], ...]
    """Name, divisor, and whether it is a text."""
    time: tuple[str, int] | None
    """The column of the time since boot, and its unit in microseconds."""

    def row(self, data: bytes, at: int, byte: int) -> Row:
        """The entry there."""
        values: dict[str, Any] = {}
        payload = self.packing.unpack_from(data, at + _HEAD)
        for (name, divisor, is_text), value in zip(self.columns, payload, strict=True):
            if divisor is not None:
                values[name] = value / divisor
            elif is_text:
                values[name] = _text(value)
            else:
                values[name] = value
        time_us = None if self.time is None else values[self.time[0]] * self.time[1]
        return Row(self.name, time_us, values, byte)


def format_of(entry: bytes) -> tuple[int, Format] | None:
    """What an FMT entry says; None: it cannot be right."""
    number, length = entry[_HEAD], entry[_HEAD + 1]
    name = _text(entry[5:9])
    letters, columns = _text(entry[9:25]), _text(entry[25:89])
    names = columns.split(",") if columns else []
    if not name.isidentifier() or len(names) != len(letters) or len(set(names)) != len(names):
        return None
    if any(letter not in _LETTERS for letter in letters):
        return None
    packing = struct.Struct("<" + "".join(_LETTERS[letter][0] for letter in letters))
    if packing.size + _HEAD != length:
        return None
    told = tuple(
        (each, _LETTERS[letter][1], letter in _TEXTS)
        for each, letter in zip(names, letters, strict=True)
    )
    times = [
        (each, _UNITS_US[each])
        for each, letter in zip(names, letters, strict=True)
        if each in _UNITS_US and letter in "QqI"
    ]
    time = times[0] if times else None
    return number, Format(name=name, length=length, packing=packing, columns=told, time=time)


def _text(value: bytes) -> str:
    return value.split(b"\0", 1)[0].decode("ascii", "replace")


_FMT_FORMAT: Final = Format(
    name="FMT", length=_FMT_BYTES, packing=struct.Struct("<BB4s16s64s"), columns=(), time=None
)


def rows(
    window: Window,
    findings: Findings,
    wanted: Collection[str],
    counts: Counter[str] | None = None,
) -> Iterator[Row]:
    """The entries of the kinds that are wanted; all are counted, by kind, if asked for.

    An entry that no other follows, nor the end, is not believed: bytes are missing in it, or it is
    none.  Time is linear in the bytes.
    """
    formats: dict[int, Format] = {FMT: _FMT_FORMAT}
    at = 0
    while True:
        data = window.data
        if at + _AHEAD > len(data) and window.more(at):
            at = 0
            continue
        if at >= len(data):
            return
        kind = _kind_at(data, at, formats)
        end = at + kind.length if kind is not None else 0
        described = format_of(data[at:end]) if kind is _FMT_FORMAT else None
        known = formats if described is None else {**formats, described[0]: described[1]}
        if kind is not None and (end == len(data) or _begins(data, end, known)):
            if kind is _FMT_FORMAT:
                _describe(described, formats, findings, window.base + at)
            elif kind.name in wanted:
                yield kind.row(data, at, window.base + at)
            if counts is not None:
                counts[kind.name] += 1
            at = end
            continue
        at = _resume(window, at, formats, findings, kind)


def _describe(
    described: tuple[int, Format] | None,
    formats: dict[int, Format],
    findings: Findings,
    byte: int,
) -> None:
    """Take what an FMT entry says; that of FMT itself is known."""
    if described is None:
        findings.note(Oddity.DAMAGED, byte, None)
    elif described[0] != FMT:
        formats[described[0]] = described[1]


def _kind_at(data: bytes, at: int, formats: dict[int, Format]) -> Format | None:
    """What begins there, if it is whole."""
    if data[at : at + 2] != MAGIC or at + _HEAD > len(data):
        return None
    kind = formats.get(data[at + 2])
    return kind if kind is not None and at + kind.length <= len(data) else None


def _begins(data: bytes, at: int, formats: dict[int, Format]) -> bool:
    """Whether an entry of a known kind begins there, as far as the file goes."""
    head = data[at : at + _HEAD]
    return head[:2] == MAGIC[: len(head)] and (len(head) < _HEAD or head[2] in formats)


def _resume(
    window: Window,
    at: int,
    formats: dict[int, Format],
    findings: Findings,
    kind: Format | None,
) -> int:
    """Where in the window an entry begins that another follows; what is passed is noted."""
    byte, head = window.base + at, window.data[at : at + _HEAD]
    known = _begins(window.data, at, formats)

    def is_one(data: bytes, begin: int) -> bool:
        other = _kind_at(data, begin, formats)
        if other is None:
            return False
        end = begin + other.length
        return end == len(data) or _begins(data, end, formats)

    begin = find_entry(window, at + 1, _find_head, _AHEAD, is_one)
    passed = window.base + begin - byte
    at_end = begin == len(window.data)
    if at_end and known and kind is None and passed < _LONGEST:
        findings.note(Oddity.CUT_SHORT, byte, None, passed)
    elif passed <= (kind.length if kind is not None else _LONGEST) and head[:2] == MAGIC:
        findings.note(Oddity.DAMAGED, byte, None)
    else:
        findings.note(Oddity.GARBAGE, byte, None, passed)
    return begin
