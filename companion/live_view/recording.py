"""A flight as far as it is recorded: read from its run folder while that grows, or from any log.

Nothing here asks the companion: whoever watches a flight cannot slow it down.
"""

import json
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple, Self, final

import numpy as np

from companion.errors import InputError
from companion.mavlink.dialect import wire
from companion.mission import journal as noted
from companion.mission.journal import Entry
from companion.replay.exporting import mission_of
from companion.sources.files import answer, file_of_run
from companion.telemetry.flight import Flight
from companion.telemetry.journal import Journal
from companion.telemetry.logs import open_log
from companion.telemetry.run_folder import Records
from companion.views.words import entry_words

BATTERY: Final = wire.MAVLINK_MSG_ID_SYS_STATUS
SECTORS: Final = wire.MAVLINK_MSG_ID_OBSTACLE_DISTANCE
_TEXT: Final = wire.MAVLINK_MSG_ID_STATUSTEXT
_RATE_OVER_S: Final = 5.0


class Event(NamedTuple):
    """Something worth a line in the list of events; seconds since the first position."""

    time_s: float
    kind: str
    """plan, hold, or empty: neither."""
    text: str


@final
class Recording:
    """One flight, and what has happened in it."""

    def __init__(self, path: Path, system_id: int | None = None) -> None:
        """path: a run folder, or a log of any kind.  InputError if it is neither."""
        self.path = path
        self.events: list[Event] = []
        self.planning_s: dict[int, float] = {}
        """How long each answer took, by the plan's number: noted once the flight is over."""
        self._journal: Journal | None = None
        self._tlog: Records | None = None
        kept = (BATTERY, SECTORS, _TEXT)
        if path.is_dir():
            self.flight = Flight(mission_of(path), keeps=kept)
            file_of_run(path, "flight.tlog", "RUN_DIR|LOG")
            self._journal = Journal(path / "journal.jsonl")
            return
        log = open_log(path, system_id=system_id)
        self.flight = Flight(None, log.system_id, keeps=kept)
        for record in log.records():
            self.flight.look(*record)
        self.flight.settle()
        if not len(self.flight.track):
            rule, remedy = "there is no position in it", "Give the log of a flight."
            raise InputError("RUN_DIR|LOG", str(path), rule, remedy)
        self.events = [Event(at_s, "", m.text) for at_s, m in self.flight.kept(_TEXT)]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._tlog is not None:
            self._tlog.close()

    def read(self) -> None:
        """Read what has been recorded since."""
        if self._journal is None:
            return
        flight, more = self.flight, False
        for line in self._journal.lines() if answer(self._journal.path.is_file) else ():
            flight.take(line)
            more = True
        if self._tlog is None and flight.system_id is not None:
            self._tlog = Records(self.path / "flight.tlog")
        while self._tlog is not None and (record := self._tlog.take()) is not None:
            flight.look(*record)
            more = True
        if more:
            flight.settle()
            timed = ((flight.time_of(boot, t), entry) for boot, t, entry in flight.entries)
            self.events = [
                Event(time_s, _kind(entry), words[0])
                for time_s, entry in timed
                if (words := entry_words(entry)) is not None
            ]
        if not self.planning_s:
            asked = [e.plan_id for _, _, e in flight.entries if isinstance(e, noted.PlanAsked)]
            with suppress(OSError, ValueError, AttributeError, TypeError):
                took_s = json.loads((self.path / "run.json").read_bytes()).get("planning_s")
                self.planning_s = dict(zip(asked, map(float, took_s), strict=True))

    @property
    def name(self) -> str:
        """The mission's, or the file's."""
        return self.flight.mission.name if self.flight.has_mission else self.path.name

    @property
    def ends_s(self) -> float:
        """When its last position was."""
        times_s = self.flight.times_s
        return float(times_s[-1]) if len(times_s) else 0.0

    def rate_hz(self, time_s: float) -> float:
        """How often positions came, lately."""
        times_s = [time_s - _RATE_OVER_S, time_s]
        after, until = np.searchsorted(self.flight.times_s, times_s, "right")
        return float(until - after) / _RATE_OVER_S


def _kind(entry: Entry) -> str:
    match entry:
        case noted.Phase(phase="holding" | "faulted"):
            return "hold"
        case noted.PlanReady():
            return "plan"
        case _:
            return ""
