"""Translates the autopilots' own logs into the MAVLink messages that they would have sent."""

import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, final

from companion.errors import InputError
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.telemetry.logs.anomalies import Anomaly, AnomalyCounter
from companion.telemetry.logs.record import Record
from companion.telemetry.logs.timeline import BACK_US, Timeline
from companion.telemetry.logs.window import Window

LONGEST_US: Final = 366 * 86_400 * 1_000_000
"""No vehicle is up for longer than a year."""
_TEXT_BYTES: Final = 50
_MAX_CHUNKS: Final = 6


class Row(NamedTuple):
    """One entry of a log."""

    name: str
    """Of its kind: GPS, vehicle_status."""
    time_us: int | None
    """Microseconds since boot; None: that of the entry before."""
    values: dict[str, Any]
    byte: int
    """Where in the file it begins; 0: not known."""


OnRow = Callable[[Row, int], Iterable[Message]]
"""Messages of one entry; the number: microseconds since boot, now.

ValueError, KeyError, TypeError, ArithmeticError or struct.error if an entry cannot be so.
"""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """One log of an autopilot, looked through once."""

    kind: Literal["bin", "ulg"]
    autopilot: int
    """MAV_AUTOPILOT."""
    system_id: int
    entries: int
    """How many of use there are."""
    epoch_us: int | None
    """When it booted, microseconds since 1970; None: nothing tells."""
    start_us: int
    """When the log begins, microseconds since boot."""
    substitutes: tuple[str, ...]
    """What is made of something else than usual."""
    rows: Callable[[AnomalyCounter], Iterator[Row]]
    """The entries that are translated, in order."""
    translator: Callable[[], OnRow]
    """A new one, for a pass through the file."""


def refuse_older(
    path: Path, firmware: str, version: tuple[int, int] | None, oldest: tuple[int, int]
) -> None:
    """InputError if a log is of a version before the oldest that is known; None: it tells none."""
    if version is not None and version < oldest:
        rule = f"it is of {firmware} {version[0]}.{version[1]}"
        rule += f", and logs are read from {oldest[0]}.{oldest[1]} on"
        remedy = "Fly newer firmware, or use companion 0.2.0 for it."
        raise InputError("log", str(path), rule, remedy)


@final
class Translation:
    """One pass through such a log; see `record.Reading`."""

    def __init__(
        self, source: Source, size: int, findings: AnomalyCounter, heard: set[int]
    ) -> None:
        """size: of the file, in bytes."""
        self._size = size
        self._source, self._findings, self._heard = source, findings, heard
        for text in source.substitutes:
            findings.note(Anomaly.SUBSTITUTED, 0, None, detail=text)
        if source.epoch_us is None:
            findings.note(Anomaly.NO_DATE, 0, None)
        self.byte, self._epoch_us = 0, source.epoch_us or 0
        self.timeline = Timeline(
            findings,
            first_us=self._epoch_us,
            last_us=self._epoch_us + LONGEST_US,
            start_us=self._epoch_us + source.start_us,
            jitter_us=BACK_US,
        )
        self._on_row = source.translator()
        self._codec = wire.MAVLink(
            None, srcSystem=source.system_id, srcComponent=AUTOPILOT_COMPONENT
        )

    def records(self, window: Window) -> Iterator[Record]:
        """What the vehicle would have sent."""
        if window.failed:
            return
        for count, row in enumerate(self._source.rows(self._findings)):
            self.byte = row.byte or min(self._size * count // self._source.entries, self._size)
            yield from self._messages_of(row)
        self.byte = self._size

    def _messages_of(self, row: Row) -> list[Record]:
        """Messages of one entry; none if it is damaged."""
        time_us = self.timeline.last_us
        if row.time_us is not None:
            time_us, believed = self.timeline.read(self._epoch_us + row.time_us, row.byte)
            if not believed:
                return []
        try:
            messages = list(self._on_row(row, time_us - self._epoch_us))
            if not messages:
                return []
            frames = [self._packed(message) for message in messages]
        except (ArithmeticError, KeyError, TypeError, ValueError, struct.error):
            # A damaged entry, which nothing protects: numbers that fit into no message, or texts.
            self._findings.note(Anomaly.DAMAGED, row.byte, time_us)
            return []
        self._heard.update(message.get_msgId() for message in messages)
        return [Record(time_us, frame) for frame in frames]

    def _packed(self, message: Message) -> bytes:
        frame = bytes(message.pack(self._codec))
        self._codec.seq = (self._codec.seq + 1) % 256
        return frame


@final
@dataclass(slots=True)
class RateLimiter:
    """Limits the rate of messages to that of a link."""

    sent_us: dict[str, int] = field(default_factory=dict)

    def is_due(self, what: str, time_us: int, period_us: int) -> bool:
        """Whether its period has passed; then it counts as sent now."""
        before_us = self.sent_us.get(what)
        if before_us is not None and 0 <= time_us - before_us < period_us:
            return False
        self.sent_us[what] = time_us
        return True


@final
@dataclass(slots=True)
class NumberedMessages:
    """Builds parameters and texts, which are numbered, for any log."""

    parameters: int
    """How many there are."""
    _indices: dict[str, int] = field(default_factory=dict)
    _texts: int = 0

    def parameter(
        self, name: str, value: float, kind: int = wire.MAV_PARAM_TYPE_REAL32
    ) -> list[Message]:
        """PARAM_VALUE."""
        index = self._indices.setdefault(name, len(self._indices))
        said = name.encode("ascii", "replace")[:16]
        return [wire.MAVLink_param_value_message(said, value, kind, self.parameters, index)]

    def text(self, text: str, severity: int) -> list[Message]:
        """STATUSTEXTs of a text of any length."""
        self._texts += 1
        content = "".join(c for c in text if c.isprintable()).encode("ascii", "replace")
        content = content[: _MAX_CHUNKS * _TEXT_BYTES - 1]
        if len(content) <= _TEXT_BYTES:
            return [wire.MAVLink_statustext_message(severity, content)] if content else []
        identity = self._texts % 0xFFFF + 1
        return [
            wire.MAVLink_statustext_message(
                severity, content[begin : begin + _TEXT_BYTES], identity, begin // _TEXT_BYTES
            )
            for begin in range(0, len(content) + 1, _TEXT_BYTES)
        ]


def battery(
    volts: float, centi_a: int, used_mah: int, percent: int, *, load: int = 0
) -> list[Message]:
    """SYS_STATUS and BATTERY_STATUS; -1: not known.  load: of the processor, in tenths of a %."""
    milli_v = whole(volts * 1e3, 0, 65534)
    cells = [milli_v, *[65535] * 9]
    return [
        wire.MAVLink_sys_status_message(0, 0, 0, load, milli_v, centi_a, percent, *[0] * 6),
        wire.MAVLink_battery_status_message(0, 0, 0, 32767, cells, centi_a, used_mah, -1, percent),
    ]


def system_time(epoch_us: int | None, boot_us: int) -> Message:
    """SYSTEM_TIME; epoch_us: when it booted, microseconds since 1970."""
    unix_us = 0 if epoch_us is None else epoch_us + boot_us
    return wire.MAVLink_system_time_message(unix_us, boot_ms(boot_us))


def boot_ms(boot_us: int) -> int:
    """As MAVLink has it: 32 bits, which begin again after 49.7 days."""
    return boot_us // 1000 & 0xFFFFFFFF


def whole(value: float, least: int, most: int) -> int:
    """Rounded, for a field that says only so much.  ValueError if it is not finite."""
    return min(max(round(value), least), most)
