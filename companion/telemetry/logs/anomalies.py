"""Anomalies of a log: counted by kind, with the place of the first."""

import enum
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, final


class Anomaly(enum.Enum):
    """Kinds of anomalies; the value is the text, with `{}` for the count."""

    GARBAGE = "{} bytes that belong to nothing were passed over"
    CHECKSUM = "{} messages with a wrong checksum were left out"
    DAMAGED = "{} entries that cannot be what the log says they are were left out"
    UNKNOWN = "{} messages of kinds that this program does not know: their checksum is not checked"
    CUT_SHORT = "the end is cut short: its last {} bytes are no whole entry"
    CORRUPT = "parts of it are damaged, and left out"
    UNREADABLE = "the file could not be read on from here"
    SECRET = "{} messages with a key or password were left out"
    SIGNED = "{} messages are signed: no signature was checked"
    MAVLINK_1 = "{} messages are of MAVLink 1"
    OTHER_VEHICLE = "{} messages of other vehicles were left out"
    NO_STAMPS = "no time stamps: time is the vehicle's clock"
    NO_STAMP = "{} messages without a time stamp: each has the time of the one before"
    ZERO_STAMP = "{} time stamps are 0: not believed"
    WRONG_STAMP = "{} time stamps make no sense: not believed"
    LITTLE_ENDIAN = "time stamps are little-endian, as of an old QGroundControl"
    MILLISECONDS = "time stamps are in milliseconds"
    NO_DATE = "nothing tells the date: time counts from the vehicle's boot, as if in 1970"
    TIME_BACK = "time falls back by more than a second, {} in all: read on without a step"
    TIME_JITTER = "{} time stamps are up to a second before the one before"
    TIME_GAP = "{} gaps of more than ten minutes"
    LOST_TIME = "the vehicle says that it could not write its log for {} milliseconds"
    LOST_ENTRIES = "the vehicle says that it could not write {} entries of its log"
    SUBSTITUTED = "{}"
    """Derived from other data than usual; the detail says which."""

    def __str__(self) -> str:
        return self.name.lower().replace("_", " ")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LogAnomaly:
    """One kind of anomaly in one log."""

    oddity: Anomaly
    count: int
    first_byte: int
    """Its first place in the file; 0: it is of the whole log, or the place is not known."""
    first_time_us: int | None
    """The log's time then, microseconds since 1970; None: before its first time."""
    detail: str = ""
    """Detail of `oddity`."""

    def __str__(self) -> str:
        said = self.oddity.value.format(self.detail or f"{self.count:,}")
        where = [f"byte {self.first_byte:,}"] if self.first_byte else []
        if self.first_time_us is not None:
            where.append(shown_time(self.first_time_us))
        return f"{said} (first at {', '.join(where)})" if where else said

    def as_json(self) -> dict[str, Any]:
        """For `--json`."""
        return {
            "kind": str(self.oddity),
            "count": self.count,
            "first_byte": self.first_byte,
            "first_time_us": self.first_time_us,
            "text": str(self),
        }


@final
class AnomalyCounter:
    """Counts anomalies."""

    def __init__(self) -> None:
        self._kinds: dict[tuple[Anomaly, str], LogAnomaly] = {}

    def note(
        self, oddity: Anomaly, byte: int, time_us: int | None, count: int = 1, detail: str = ""
    ) -> None:
        """Count `count` occurrences; the first says where."""
        if known := self._kinds.get((oddity, detail)):
            self._kinds[oddity, detail] = replace(known, count=known.count + count)
        else:
            self._kinds[oddity, detail] = LogAnomaly(
                oddity=oddity, count=count, first_byte=byte, first_time_us=time_us, detail=detail
            )

    def all(self) -> tuple[LogAnomaly, ...]:
        """In order of first occurrence."""
        return tuple(self._kinds.values())


def shown_time(time_us: int) -> str:
    """For people, in UTC; time_us: microseconds since 1970."""
    try:
        return f"{datetime.fromtimestamp(time_us / 1e6, UTC):%Y-%m-%d %H:%M:%S}Z"
    except (OverflowError, OSError, ValueError):  # beyond the year 9999
        return f"{time_us} us"
