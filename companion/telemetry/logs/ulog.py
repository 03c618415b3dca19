"""PX4's .ulg: messages with a length each, described by the messages before them; no checksums.

    "ULog" 01 12 35, version, microseconds since boot; then: length[2] kind[1] content
    kinds: F format, A subscription, D data, P parameter, L and C text, O drop-out, I information,
    S synchronisation, B flags; M, Q, R: of no use here

pyulog reads these too, the whole file into memory, topic by topic: without bound, and without the
order in which things were said.  It is not used here; the tests compare with it.
"""

import re
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, final

from companion.telemetry.logs.anomalies import Anomaly, AnomalyCounter
from companion.telemetry.logs.search import find_entry
from companion.telemetry.logs.translated import Row
from companion.telemetry.logs.window import Window

MAGIC: Final = b"ULog\x01\x12\x35"
HEADER_BYTES: Final = 16
PARAMETER: Final = "(parameter)"
TEXT: Final = "(text)"
INFORMATION: Final = "(information)"
"""Names of the rows that are of no topic."""
_SYNC: Final = bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12))
_HEAD: Final = 3
_LONGEST: Final = 0xFFFF
_AHEAD: Final = 2 * (_LONGEST + _HEAD) + _HEAD
_KINDS: Final = frozenset(b"FADPLCOISBMQR")
_DATA: Final = ord("D")
_DESCRIBING: Final = frozenset(b"FA")
SIGN_BYTES: Final = 100
_find_sign = re.compile(rb"\AULog|F\w{2,60}:uint64_t timestamp;").search
_find_head = re.compile(rb"[^\x00]\x00[ADPLCOISFBMQR]|.[\x01-\x27][DFLCIMPQR]", re.DOTALL).search
"""What a message may begin with: no kind but these is longer than 255 bytes."""
_TYPES: Final = {
    "int8_t": "b",
    "uint8_t": "B",
    "int16_t": "h",
    "uint16_t": "H",
    "int32_t": "i",
    "uint32_t": "I",
    "int64_t": "q",
    "uint64_t": "Q",
    "float": "f",
    "double": "d",
    "bool": "?",
    "char": "c",
}
_FIELD = re.compile(r"([A-Za-z_]\w*)(?:\[(\d{1,5})\])? ([A-Za-z_]\w*)")
_MAX_NESTED: Final = 8
_MAX_FIELDS: Final = 512
_MAX_DESCRIPTIONS: Final = 4 << 20
"""Bytes of formats and subscriptions that are kept; a log has 100 kB of them."""


def first_format(data: bytes) -> int | None:
    """Where in the beginning of a file, or in any part of it, its head or a format stands."""
    found = _find_sign(data)
    return None if found is None else found.start()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """What a subscription has in its messages."""

    name: str
    instance: int
    packing: struct.Struct
    """With the padding at the end, which may be left out."""
    least_bytes: int
    single: tuple[tuple[str, int], ...]
    """The fields of one value, and which of all values that is."""
    arrays: tuple[tuple[str, int, int], ...]
    """The other fields, with where each begins and ends."""

    def values(self, data: bytes) -> dict[str, Any]:
        """The message whose content that is, by field; arrays are tuples."""
        if len(data) < self.packing.size:
            data = data.ljust(self.packing.size, b"\0")
        numbers = self.packing.unpack_from(data)
        values: dict[str, Any] = {name: numbers[at] for name, at in self.single}
        for name, begin, end in self.arrays:
            values[name] = numbers[begin:end]
        return values


class _Part(NamedTuple):
    """One field of a format."""

    kind: str
    length: int | None
    """None: it is no array."""
    name: str


@final
@dataclass(slots=True)
class _Described:
    """What the log has said of itself."""

    formats: dict[str, tuple[_Part, ...]] = field(default_factory=dict)
    topics: dict[int, Topic] = field(default_factory=dict)
    _room: int = _MAX_DESCRIPTIONS
    _sizes: dict[str, int | None] = field(default_factory=dict)

    def on_format(self, content: bytes) -> bool:
        """Take a format; False: it makes no sense."""
        self._room -= len(content)
        name, colon, listed = content.decode("ascii", "replace").partition(":")
        matches = [_FIELD.fullmatch(each) for each in listed.split(";") if each]
        if not colon or not name.isidentifier() or None in matches or self._room < 0:
            return False
        if len(matches) > _MAX_FIELDS or any(
            each and each[2] and not int(each[2]) for each in matches
        ):
            return False
        self._sizes.clear()
        self.formats[name] = tuple(
            _Part(each[1], None if each[2] is None else int(each[2]), each[3])
            for each in matches
            if each is not None
        )
        return True

    def on_subscription(self, content: bytes) -> bool:
        """Take a subscription; False: it makes no sense."""
        self._room -= len(content)
        if len(content) < 4 or self._room < 0:
            return False
        name = content[3:].decode("ascii", "replace")
        topic = self._topic(name, content[0])
        if topic is None:
            return False
        self.topics[content[1] | content[2] << 8] = topic
        return True

    def _topic(self, name: str, instance: int) -> Topic | None:
        parts = self.formats.get(name)
        if not parts or parts[0] != _Part("uint64_t", None, "timestamp"):
            return None
        codes, padding, at = list[str](), 0, 0
        single, arrays = list[tuple[str, int]](), list[tuple[str, int, int]]()
        for part in parts:
            size = self._size(part.kind, 0)
            if size is None:
                return None
            count = 1 if part.length is None else part.length
            if count * size > _LONGEST:
                return None
            code = _TYPES.get(part.kind)
            if part.name.startswith("_padding") or code is None or code == "c":
                codes.append(f"{count * size}x")
                padding = padding + count * size if part.name.startswith("_padding") else 0
            else:
                codes.append(f"{count}{code}")
                if part.length is None:
                    single.append((part.name, at))
                else:
                    arrays.append((part.name, at, at + count))
                at, padding = at + count, 0
        packing = struct.Struct("<" + "".join(codes))
        if packing.size > _LONGEST:
            return None
        return Topic(
            name=name,
            instance=instance,
            packing=packing,
            least_bytes=packing.size - padding,
            single=tuple(single),
            arrays=tuple(arrays),
        )

    def _size(self, kind: str, depth: int) -> int | None:
        """Bytes of a type, also one that is made of others; None: it is not known, or too large."""
        if kind in _TYPES:
            return struct.calcsize("<" + _TYPES[kind])
        if kind in self._sizes:
            return self._sizes[kind]
        parts = self.formats.get(kind)
        if parts is None or depth > _MAX_NESTED:
            return None
        total = 0
        for part in parts:
            size = self._size(part.kind, depth + 1)
            total += _LONGEST + 1 if size is None else size * (part.length or 1)
            if total > _LONGEST:
                break
        self._sizes[kind] = total if total <= _LONGEST else None
        return self._sizes[kind]


def rows(
    window: Window,
    findings: AnomalyCounter,
    wanted: Collection[str],
    counts: Counter[str] | None = None,
) -> Iterator[Row]:
    """Data of the topics that are wanted, first instance, parameters, texts and information.

    Data is counted by topic, wanted or not, if asked for.

    A message that none follows, nor the end, is not believed.  Time is linear in the bytes.
    """
    described = _Described()
    if not window.data:
        window.more(0)
    at, size = HEADER_BYTES, 0  # of the message there, if that is known from the one before
    while True:
        data = window.data
        if at + _AHEAD > len(data) and window.more(at):
            at = 0
            continue
        if at >= len(data):
            return
        end = at + size if size else _end(data, at, described)
        following = _end(data, end, described) if end else 0
        if not following and not (end and _is_cut_short(data, end)):
            at, size = _resume(window, at, described, findings), 0
            continue
        kind, size = data[at + 2], following - end if following else 0
        topic = described.topics.get(data[at + 3] | data[at + 4] << 8) if kind == _DATA else None
        if topic is None:
            row = _row(data[at:end], window.base + at, described, findings)
            if row is not None:
                yield row
            if kind in _DESCRIBING:  # what follows may be judged by it
                size = 0
        elif topic.instance == 0:
            if counts is not None:
                counts[topic.name] += 1
            if topic.name in wanted:
                values = topic.values(data[at + _HEAD + 2 : end])
                yield Row(topic.name, values["timestamp"], values, window.base + at)
        at = end


def _end(data: bytes, at: int, described: _Described) -> int:
    """Where the message ends that begins there; 0: there is none, or not all of it."""
    if at + _HEAD > len(data) or data[at + 2] not in _KINDS:
        return 0
    size = data[at] | data[at + 1] << 8
    end = at + _HEAD + size
    if size == 0 or end > len(data):
        return 0
    kind = data[at + 2]
    if kind == _DATA:
        if size < 2:
            return 0
        topic = described.topics.get(data[at + 3] | data[at + 4] << 8)
        if topic is not None:
            return end if topic.least_bytes <= size - 2 <= topic.packing.size else 0
    elif kind == 0x53:  # S
        return end if data[at + _HEAD : end] == _SYNC else 0
    elif kind == 0x4F:  # O
        return end if size == 2 else 0
    return end


def _is_cut_short(data: bytes, at: int) -> bool:
    """Whether the file ends there, or in a message that begins there."""
    if at + _HEAD > len(data):
        return True
    size = data[at] | data[at + 1] << 8
    return at + _HEAD + size > len(data) and data[at + 2] in _KINDS


def _row(message: bytes, byte: int, described: _Described, findings: AnomalyCounter) -> Row | None:
    """What a whole message is for others, other than data of a topic that is known."""
    kind, content = message[2:3], message[_HEAD:]
    sound: bool = True
    match kind:
        case b"D":
            sound = False
        case b"F":
            sound = described.on_format(content)
        case b"A":
            sound = described.on_subscription(content)
        case b"P" | b"I":
            pair = _key_value(content)
            if pair is not None:
                name = PARAMETER if kind == b"P" else INFORMATION
                return Row(name, None, {"key": pair[0], "value": pair[1]}, byte)
            sound = kind == b"I"  # texts and lists are of no use here
        case b"L" | b"C":
            head = 9 if kind == b"L" else 11
            sound = len(content) >= head
            if sound:
                values = {"level": content[0], "text": content[head:].decode("utf-8", "replace")}
                (time_us,) = struct.unpack_from("<Q", content, head - 8)
                return Row(TEXT, time_us, values, byte)
        case b"O":
            findings.note(Anomaly.LOST_TIME, byte, None, content[0] | content[1] << 8)
        case _:
            pass
    if not sound:
        findings.note(Anomaly.DAMAGED, byte, None)
    return None


def _key_value(content: bytes) -> tuple[str, float | int] | None:
    """Key and number; None: it is none."""
    size = content[0]
    kind, _, name = content[1 : 1 + size].decode("ascii", "replace").partition(" ")
    code, raw = _TYPES.get(kind), content[1 + size :]
    if code is None or code == "c" or not name or struct.calcsize("<" + code) != len(raw):
        return None
    (value,) = struct.unpack("<" + code, raw)
    return name, value


def _resume(window: Window, at: int, described: _Described, findings: AnomalyCounter) -> int:
    """Where in the window a message begins that another follows; what is passed is noted."""
    byte = window.base + at
    size = (window.data[at] | window.data[at + 1] << 8) if at + 1 < len(window.data) else 0
    cut_short = at + _HEAD + size > len(window.data)

    def is_one(data: bytes, begin: int) -> bool:
        end = _end(data, begin, described)
        return end > 0 and (_end(data, end, described) > 0 or _is_cut_short(data, end))

    begin = find_entry(window, at + 1, _find_head, _AHEAD, is_one)
    passed = window.base + begin - byte
    if begin == len(window.data) and cut_short:
        findings.note(Anomaly.CUT_SHORT, byte, None, passed)
    elif passed == size + _HEAD:
        findings.note(Anomaly.DAMAGED, byte, None)
    else:
        findings.note(Anomaly.GARBAGE, byte, None, passed)
    return begin
