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
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, final

from companion.telemetry.logs.anomalies import Anomaly, AnomalyCounter
from companion.telemetry.logs.search import find_entry
from companion.telemetry.logs.translated import Row
from companion.telemetry.logs.window import Window

MAGIC: Final = b"\xa3\x95"
FMT: Final = 0x80
_FMT_HEAD: Final = b"\xa3\x95\x80"
_FMT_BYTES: Final = 89
_HEAD: Final = 3
_LONGEST: Final = 255
SIGN_BYTES: Final = _FMT_BYTES
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
_WEEKS: Final = frozenset({"GWk", "Week"})
"""Beside these, until 3.2, TimeMS is the GPS's time of week, and the time since boot is T."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """One kind of entry."""

    name: str
    length: int
    """With the head."""
    packing: struct.Struct
    columns: tuple[str, ...]
    scaled: tuple[tuple[str, float], ...] = ()
    """Those that are to be divided, and by what."""
    texts: tuple[str, ...] = ()
    time: tuple[str, int] | None = None
    """The column of the time since boot, and its unit in microseconds."""

    def row(self, data: bytes, at: int, byte: int) -> Row:
        """The entry there."""
        payload = self.packing.unpack_from(data, at + _HEAD)
        values: dict[str, Any] = dict(zip(self.columns, payload, strict=True))
        for name, divisor in self.scaled:
            values[name] /= divisor
        for name in self.texts:
            values[name] = _text(values[name])
        time_us = None if self.time is None else values[self.time[0]] * self.time[1]
        return Row(self.name, time_us, values, byte)


def format_of(entry: bytes) -> tuple[int, Format] | None:
    """What an FMT entry says; None: it cannot be right."""
    number, length = entry[_HEAD], entry[_HEAD + 1]
    name = _text(entry[5:9])
    letters, listed = _text(entry[9:25]), _text(entry[25:89])
    names = listed.split(",") if listed else []
    if not name.isidentifier() or len(names) != len(letters) or len(set(names)) != len(names):
        return None
    if any(letter not in _LETTERS for letter in letters):
        return None
    packing = struct.Struct("<" + "".join(_LETTERS[letter][0] for letter in letters))
    if packing.size + _HEAD != length:
        return None
    columns = list(zip(names, letters, strict=True))
    divisors = [(each, _LETTERS[letter][1]) for each, letter in columns]
    return number, Format(
        name=name,
        length=length,
        packing=packing,
        columns=tuple(names),
        scaled=tuple((each, divisor) for each, divisor in divisors if divisor is not None),
        texts=tuple(each for each, letter in columns if letter in _TEXTS),
        time=_time_of(dict(columns)),
    )


def _time_of(letters: Mapping[str, str]) -> tuple[str, int] | None:
    """The column of the time since boot, by the letters of all columns."""
    old = "T" if _WEEKS & letters.keys() else "TimeMS"
    for name, unit_us in (("TimeUS", 1), (old, 1000)):
        if letters.get(name, " ") in "QqI":
            return name, unit_us
    return None


def first_format(data: bytes) -> int | None:
    """Where in these bytes the first FMT entry stands that can be right; None: there is none."""
    at = data.find(_FMT_HEAD)
    while at >= 0 and (
        at + _FMT_BYTES > len(data) or format_of(data[at : at + _FMT_BYTES]) is None
    ):
        at = data.find(_FMT_HEAD, at + 1)
    return at if at >= 0 else None


def _text(value: bytes) -> str:
    return value.split(b"\0", 1)[0].decode("ascii", "replace")


_FMT_FORMAT: Final = Format(
    name="FMT", length=_FMT_BYTES, packing=struct.Struct("<BB4s16s64s"), columns=()
)


def rows(
    window: Window,
    findings: AnomalyCounter,
    wanted: Collection[str],
    counts: Counter[str] | None = None,
) -> Iterator[Row]:
    """The entries of the kinds that are wanted; all are counted, by kind, if asked for.

    An entry that no other follows, nor the end, is not believed: bytes are missing in it, or it is
    none.  Time is linear in the bytes.
    """
    formats: dict[int, Format] = {FMT: _FMT_FORMAT}
    at, begun = 0, None  # what begins there, if that is known from the entry before
    while True:
        data = window.data
        if at + _AHEAD > len(data) and window.more(at):
            at = 0
            continue
        if at >= len(data):
            return
        kind = begun or _begun_at(data, at, formats)
        end = 0 if kind is None else at + kind.length
        if kind is None or end > len(data):
            at, begun = _resume(window, at, formats, findings, None), None
            continue
        known = formats
        if kind is _FMT_FORMAT and data[at + _HEAD] != FMT:  # it is known, whatever is said of it
            described = format_of(data[at:end])
            known = {**formats, described[0]: described[1]} if described else formats
        begun = _begun_at(data, end, known)
        if begun is None and not _begins(data, end, known):
            at = _resume(window, at, formats, findings, kind)
            continue
        if kind.name in wanted:
            yield kind.row(data, at, window.base + at)
        elif kind is _FMT_FORMAT and data[at + _HEAD] != FMT and known is formats:
            findings.note(Anomaly.DAMAGED, window.base + at, None)
        formats = known
        if counts is not None:
            counts[kind.name] += 1
        at = end


def _begun_at(data: bytes, at: int, formats: dict[int, Format]) -> Format | None:
    """What begins there, whole or not."""
    if at + _HEAD > len(data) or not data.startswith(MAGIC, at):
        return None
    return formats.get(data[at + 2])


def _begins(data: bytes, at: int, formats: dict[int, Format]) -> bool:
    """Whether an entry of a known kind begins there, as far as the file goes."""
    head = data[at : at + _HEAD]
    return head[:2] == MAGIC[: len(head)] and (len(head) < _HEAD or head[2] in formats)


def _resume(
    window: Window,
    at: int,
    formats: dict[int, Format],
    findings: AnomalyCounter,
    kind: Format | None,
) -> int:
    """Where in the window an entry begins that another follows; what is passed is noted."""
    byte, head = window.base + at, window.data[at : at + _HEAD]
    known = _begins(window.data, at, formats)

    def is_one(data: bytes, begin: int) -> bool:
        other = _begun_at(data, begin, formats)
        end = len(data) + 1 if other is None else begin + other.length
        return end <= len(data) and _begins(data, end, formats)

    begin = find_entry(window, at + 1, _find_head, _AHEAD, is_one)
    passed = window.base + begin - byte
    at_end = begin == len(window.data)
    if at_end and known and kind is None and passed < _LONGEST:
        findings.note(Anomaly.CUT_SHORT, byte, None, passed)
    elif passed <= (kind.length if kind is not None else _LONGEST) and head[:2] == MAGIC:
        findings.note(Anomaly.DAMAGED, byte, None)
    else:
        findings.note(Anomaly.GARBAGE, byte, None, passed)
    return begin
