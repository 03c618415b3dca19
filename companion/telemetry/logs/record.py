"""The common interface of logs: a stream of timed MAVLink frames."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, final

from companion.errors import InputError
from companion.mavlink.dialect import KINDS, wire
from companion.mavlink.who import TO_COMPONENT_1, ids_in_words
from companion.telemetry.logs.anomalies import Anomaly, AnomalyCounter, LogAnomaly
from companion.telemetry.logs.needed import Kind, Missing, missing_of
from companion.telemetry.logs.timeline import Timeline
from companion.telemetry.logs.window import Window


@final
@dataclass(frozen=True, slots=True)
class Record:
    """One MAVLink frame of a log, and when it was logged."""

    time_us: int
    """Microseconds since 1970; it never falls from one record to the next."""
    frame: bytes
    """As it stood in the log, MAVLink 1 or 2, signed or not."""


class LogReader(Protocol):
    """One pass through a log of some kind."""

    byte: int
    """How far it has come."""
    timeline: Timeline

    def records(self, window: Window) -> Iterator[Record]:
        """All of it, in order."""
        ...


@final
@dataclass(slots=True, kw_only=True)
class Log:
    """A log of any kind, opened."""

    kind: Kind
    """tlog: MAVLink frames; bin: ArduPilot's own log; ulg: PX4's own."""
    path: Path
    size_bytes: int
    """Of the file, when it was opened."""
    systems: tuple[int, ...]
    """System ids of all autopilots in it."""
    system_id: int | None
    """The vehicle that is read; None: there is no heartbeat of an autopilot in it."""
    autopilot: int | None
    """MAV_AUTOPILOT; None: nothing tells."""
    begin: Callable[[AnomalyCounter, set[int]], LogReader]
    """Begin a pass: notes anomalies, and the numbers of the autopilot's messages."""
    elsewhere: frozenset[tuple[int, int]] = frozenset()
    """System and component of what sends an autopilot's heartbeat and is not component 1."""
    read_bytes: int = 0
    """How far `records` has come."""
    _findings: AnomalyCounter = field(default_factory=AnomalyCounter)
    _heard: set[int] = field(default_factory=set)

    @property
    def findings(self) -> tuple[LogAnomaly, ...]:
        """Anomalies, as far as `records` has come."""
        return self._findings.all()

    def missing(self) -> tuple[Missing, ...]:
        """What the companion listens to and never came; once `records` has come to the end."""
        names = {KINDS[each].msgname for each in self._heard if each in wire.mavlink_map}
        return missing_of(self.kind, self.autopilot, names)

    def records(self) -> Iterator[Record]:
        """All of it, in order, in bounded memory; each call begins again, and the findings too.

        Frames of other vehicles, and those with secrets, are left out.
        """
        self._findings, self._heard, self.read_bytes = AnomalyCounter(), set(), 0
        findings, heard = self._findings, self._heard
        reading = self.begin(findings, heard)
        with Window(self.path) as window:
            for record in reading.records(window):
                self.read_bytes = reading.byte
                yield record
            self.read_bytes = byte = reading.byte
            reading.timeline.finish(byte)
            if window.failed:
                findings.note(Anomaly.UNREADABLE, byte, reading.timeline.now_us)


def chosen(
    path: Path,
    systems: tuple[int, ...],
    asked: int | None,
    elsewhere: frozenset[tuple[int, int]] = frozenset(),
) -> int | None:
    """The selected vehicle; InputError if it is ambiguous.  elsewhere: as of `Log`."""
    those = ", ".join(str(each) for each in systems)
    if asked is not None:
        if asked not in systems:
            rule = f"there is no such vehicle in {path.name}"
            if those_elsewhere := sorted(each for each in elsewhere if each[0] == asked):
                rule += f": its autopilot is {ids_in_words(those_elsewhere)}, not component 1"
                raise InputError("--system", asked, rule, TO_COMPONENT_1)
            there = f"There is system {those}" if len(systems) == 1 else f"There are {those}"
            none = "There is no autopilot's heartbeat in it: leave --system out"
            raise InputError("--system", asked, rule, f"{there if systems else none}.")
        return asked
    if len(systems) > 1:
        rule = f"several vehicles are in it, systems {those}"
        raise InputError("log", str(path), rule, "Choose one with --system.")
    return systems[0] if systems else None
