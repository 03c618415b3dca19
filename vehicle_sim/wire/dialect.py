"""pymavlink's dialect `all`, what it lacks, and how each type of message lies in its frames."""

import math
import re
import struct
from collections.abc import Callable, Sequence
from operator import attrgetter, itemgetter
from typing import Any, Final, NamedTuple, final

from pymavlink.dialects.v20 import all as mavlink

_LARGEST_FLOAT: Final = 3.4028234663852886e38
_WHOLE: Final = "bBhHiIqQ"
"""Codes of struct for integers; the capital ones are unsigned."""


# --- what the dialect lacks -----------------------------------------------------------------------


class _Declared(mavlink.MAVLink_message):  # type: ignore[misc]  # pymavlink has no types
    def __init__(self, *values: Any, **named: Any) -> None:
        super().__init__(self.id, self.msgname)
        self._fieldnames = self.fieldnames
        for name, value in (dict(zip(self.fieldnames, values, strict=False)) | named).items():
            setattr(self, name, value)


def _declare(number: int, name: str, extra: int, layout: str) -> Any:
    """A class of messages, by number, name, CRC_EXTRA and fields: codes of struct and names.

    Of a message that the dialect knows, the fields come after its own; if it has them all, the
    class is the dialect's.
    """
    fields = {name: code for code, name in (each.split() for each in layout.split(", "))}
    known = mavlink.mavlink_map.get(number, mavlink.MAVLink_message)
    if set(fields) <= set(known.fieldnames):
        return known
    types = {"B": "uint8_t", "H": "uint16_t", "I": "uint32_t", "Q": "uint64_t", "i": "int32_t"}
    counts = [int(code[:-1] or 0) for code in fields.values()]
    names = (*known.fieldnames, *fields)
    table = {
        "id": number,
        "msgname": name,
        "crc_extra": extra,
        "fieldnames": names,
        "ordered_fieldnames": (*known.ordered_fieldnames, *fields),
        "fieldtypes": (*known.fieldtypes, *(types[code[-1]] for code in fields.values())),
        "lengths": (*known.lengths, *(count or 1 for count in counts)),
        "array_lengths": (*known.array_lengths, *counts),
        "unpacker": struct.Struct((known.unpacker.format or "<") + "".join(fields.values())),
    }
    return type(name, (_Declared,), table)


_DECLARED: Final = {
    kind.msgname: kind
    for kind in (
        # added later, at the end of the payload: clients that do not know them read the rest
        _declare(44, "MISSION_COUNT", 221, "I opaque_id"),
        _declare(47, "MISSION_ACK", 153, "I opaque_id"),
        _declare(111, "TIMESYNC", 34, "B target_system, B target_component"),
        # of PX4's dialect `development`, checked against recorded frames
        _declare(
            *(8, "LINK_NODE_STATUS", 117),
            "Q timestamp, I tx_rate, I rx_rate, I messages_sent, I messages_received, "
            "I messages_lost, H rx_parse_err, H tx_overflows, H rx_overflows, B tx_buf, B rx_buf",
        ),
        _declare(
            *(300, "PROTOCOL_VERSION", 217),
            "H version, H min_version, H max_version, 8B spec_version_hash, "
            "8B library_version_hash",
        ),
        _declare(
            *(380, "TIME_ESTIMATE_TO_TARGET", 232),
            "i safe_return, i land, i mission_next_item, i mission_end, i commanded_action",
        ),
        _declare(
            *(410, "EVENT", 160),
            "I id, I event_time_boot_ms, H sequence, B destination_component, "
            "B destination_system, B log_levels, 40B arguments",
        ),
        _declare(411, "CURRENT_EVENT_SEQUENCE", 106, "H sequence, B flags"),
    )
}


def message_class(name: str) -> Any:
    """The class of the messages of this name; its fields by name, or in MAVLink's order."""
    return _DECLARED.get(name) or getattr(mavlink, f"MAVLink_{name.lower()}_message")


# --- between messages and payloads ----------------------------------------------------------------


@final
class Layout:
    """How the messages of one class are read and packed: found out once for each."""

    def __init__(self, kind: Any) -> None:
        self.number: int = kind.id
        self.crc_extra = bytes([kind.crc_extra])
        self.size: int = kind.unpacker.size
        self._names: Sequence[str] = kind.ordered_fieldnames
        self._pack = _packing(kind)
        self._unpack: Callable[[bytes], tuple[Any, ...]] = kind.unpacker.unpack_from
        self._make: Callable[..., Any] = kind
        types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
        self._attributes = _getting(
            attrgetter,
            [
                f"_{name}_raw" if length and types[name] == "char" else name  # as bytes
                for name, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True)
            ],
        )
        order, lengths = getattr(kind, "orders", ()), kind.lengths
        starts = [sum(lengths[:k]) for k in range(len(lengths))]
        places = [(starts[k], starts[k] + lengths[k]) for k in order]

        def plain(values: tuple[Any, ...]) -> list[Any]:
            return [values[k] for k in order]

        def with_arrays_and_texts(values: tuple[Any, ...]) -> list[Any]:
            picked = [values[at] if end - at == 1 else list(values[at:end]) for at, end in places]
            return [v.rstrip(b"\0") if isinstance(v, bytes) else v for v in picked]

        is_plain = len(kind.unpacker.format) == 1 + len(order) and "char" not in kind.fieldtypes
        self._fields = plain if is_plain else with_arrays_and_texts

    def message(self, payload: bytes) -> Any:
        """The message that this payload carries; what was left off at its end is zero."""
        if len(payload) < self.size:
            payload = payload.ljust(self.size, b"\0")
        return self._make(*self._fields(self._unpack(payload)))

    def payload(self, message: Any) -> bytes:
        """All of the payload of a message; zeros at its end may be left off."""
        return self._pack(self._attributes(message))

    def preparing(self, names: Sequence[str]) -> Callable[[Sequence[Any]], "Prepared"]:
        """What makes messages to be sent, of values by these names of fields; texts as bytes.

        Of a name that comes twice the later value counts.
        """
        places = {name: place for place, name in enumerate(names)}
        in_order = _getting(itemgetter, [places[name] for name in self._names])
        pack = self._pack
        return lambda values: Prepared(self, pack(in_order(values)))


@final
class Prepared(NamedTuple):
    """A message that is only to be sent: telemetry, of which no object needs to be made."""

    layout: Layout
    payload: bytes
    """All of it."""


_layouts: dict[Any, Layout] = {}


def layout_of(kind: Any) -> Layout:
    """The layout of this class of messages."""
    layout = _layouts.get(kind)
    if layout is None:
        layout = _layouts[kind] = Layout(kind)
    return layout


def _getting(getter: Callable[..., Any], which: Sequence[Any]) -> Callable[[Any], Sequence[Any]]:
    """What gets these attributes or items of something, even if it is only one."""
    get: Callable[[Any], Any] = getter(*which)
    return get if len(which) > 1 else lambda whole: (get(whole),)


def _packing(kind: Any) -> Callable[[Sequence[Any]], bytes]:
    """What packs the values of a message's fields, in the order of its payload."""
    pack, lengths = kind.unpacker.pack, kind.lengths
    codes = [
        code
        for count, code in re.findall(r"(\d*)([a-zA-Z])", kind.unpacker.format)
        for _ in range(1 if code == "s" else int(count or 1))
    ]

    def payload(values: Sequence[Any]) -> bytes:
        try:
            return pack(*values)
        except (struct.error, OverflowError):
            return pack(*map(_fitted, values, codes))

    def payload_with_arrays(values: Sequence[Any]) -> bytes:
        flat = list[Any]()
        for value, length in zip(values, lengths, strict=True):
            if length == 1:
                flat.append(value)
            else:
                flat.extend(value)
        return payload(flat)

    return payload_with_arrays if any(length > 1 for length in lengths) else payload


def _fitted(value: Any, code: str) -> Any:
    """The nearest value that this field can carry; zero for NaN.

    A real autopilot casts, and sends some value.
    """
    if isinstance(value, bytes):
        return value
    if code in _WHOLE:
        if not math.isfinite(value):
            return 0
        bits = 8 * struct.calcsize("<" + code)
        least = 0 if code.isupper() else -(1 << bits - 1)
        return min(max(int(value), least), least + (1 << bits) - 1)
    if code == "f" and math.isfinite(value):
        return min(max(value, -_LARGEST_FLOAT), _LARGEST_FLOAT)
    return value
