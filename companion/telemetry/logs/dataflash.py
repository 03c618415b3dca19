"""ArduPilot's .bin: entries that FMT entries describe, as pymavlink's DFReader reads them.

Nothing in a .bin has a checksum: an entry is believed if another follows it, or the end.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, final

from pymavlink import DFReader

from companion.telemetry.logs.anomalies import Anomaly, AnomalyCounter
from companion.telemetry.logs.translated import Row

MAGIC: Final = b"\xa3\x95"
_LONGEST: Final = 255

DFReader.print = lambda *_, **__: None  # it prints each byte that it passes over


@final
class _Entries(DFReader.DFReader_binary):  # type: ignore[misc]  # it has no types
    """The entries in their order: no index, no clock, no state, which take longer than reading."""

    def init_arrays(self, progress_callback: None = None) -> None:
        """Called by the base class."""

    def init_arrays_fast(self, progress_callback: None = None) -> None:
        """Called by the base class."""

    def init_clock(self) -> None:
        """Called by the base class."""

    def _add_msg(self, entry: DFReader.DFMessage) -> None:
        """Called by the base class."""


def rows(
    path: Path,
    findings: AnomalyCounter,
    wanted: Collection[str],
    counts: Counter[str] | None = None,
) -> Iterator[Row]:
    """The entries of the kinds that are wanted; all are counted, by kind, if asked for."""
    log = _Entries(str(path))
    try:
        end, size = 0, log.data_len
        while True:
            try:
                entry = log.recv_msg()
            except RecursionError:  # it calls itself for each that does not fit its FMT
                continue
            if entry is None:
                break
            begin = log.offset - entry.fmt.len
            if begin > end:
                findings.note(Anomaly.GARBAGE, end, None, begin - end)
            end = log.offset
            if not MAGIC.startswith(log.data_map[end : end + 2]):
                findings.note(Anomaly.DAMAGED, begin, None)
                log.offset = end = begin + len(MAGIC)
                continue
            if counts is not None:
                counts[entry.fmt.name] += 1
            if entry.fmt.name in wanted:
                try:
                    values = entry.to_dict()
                except (TypeError, ValueError, IndexError):
                    findings.note(Anomaly.DAMAGED, begin, None)
                    continue
                yield Row(entry.fmt.name, _time_us(values), values, begin)
        if end < size:
            at_end = Anomaly.CUT_SHORT if size - end < _LONGEST else Anomaly.GARBAGE
            findings.note(at_end, end, None, size - end)
    finally:
        log.close()


def _time_us(values: Mapping[str, Any]) -> int | None:
    """The time since boot of an entry."""
    value = values.get("TimeUS")
    return value if isinstance(value, int) else None
