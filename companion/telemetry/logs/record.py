"""What every log is read as: a stream of timed MAVLink frames."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, final

from companion.telemetry.logs.findings import Finding

Kind = Literal["tlog", "bin", "ulg"]


@final
@dataclass(frozen=True, slots=True)
class Record:
    """One MAVLink frame of a log, and when it was logged."""

    time_us: int
    """Microseconds since 1970; it never falls from one record to the next."""
    frame: bytes
    """As it stood in the log, MAVLink 1 or 2, signed or not."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Missing:
    """A message that the companion listens to and a log never has."""

    message: str
    """Its MAVLink name; of several that serve alike, joined by "or"."""
    without: str
    """What cannot be told or done without it."""
    remedy: str
    """How to have it recorded."""
    vital: bool
    """Whether the companion cannot fly without it."""

    def __str__(self) -> str:
        return f"{self.message} is missing: {self.without}. {self.remedy}"


class Log(Protocol):
    """A log of any kind, opened."""

    @property
    def kind(self) -> Kind:
        """tlog: MAVLink frames; bin: ArduPilot's own log; ulg: PX4's own."""
        ...

    @property
    def path(self) -> Path:
        """The file."""
        ...

    @property
    def size_bytes(self) -> int:
        """Of the file, when it was opened."""
        ...

    @property
    def read_bytes(self) -> int:
        """How far `records` has come."""
        ...

    @property
    def systems(self) -> tuple[int, ...]:
        """System ids of all autopilots in it."""
        ...

    @property
    def system_id(self) -> int | None:
        """The vehicle that is read; None: there is no heartbeat of an autopilot in it."""
        ...

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is odd, as far as `records` has come."""
        ...

    def records(self) -> Iterator[Record]:
        """All of it, in order, in bounded memory; each call begins again, and the findings too."""
        ...

    def missing(self) -> tuple[Missing, ...]:
        """What the companion listens to and never came; once `records` has come to the end."""
        ...
