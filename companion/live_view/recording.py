"""A flight as far as it is recorded: read from its run folder while that grows, or from any log.

Nothing here asks the companion: whoever watches a flight cannot slow it down.
"""

from pathlib import Path
from typing import Final, NamedTuple, final

from companion.errors import InputError
from companion.mavlink.dialect import wire
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
_KEPT: Final = (BATTERY, SECTORS, _TEXT)


class Event(NamedTuple):
    """Something worth a line in the list of events; seconds since the first position."""

    time_s: float
    text: str


@final
class Recording:
    """One flight, and what has happened in it."""

    def __init__(self, path: Path, system_id: int | None = None) -> None:
        """path: a run folder, or a log of any kind.  InputError if it is neither."""
        self.path, self.name = path, path.name
        self.events: list[Event] = []
        self._journal: Journal | None = None
        self._tlog: Records | None = None
        if path.is_dir():
            self.flight = Flight(mission_of(path), keeps=_KEPT)
            self.name = self.flight.mission.name
            file_of_run(path, "flight.tlog", "RUN_DIR|LOG")
            self._journal = Journal(path / "journal.jsonl")
            self.read()
            return
        log = open_log(path, system_id=system_id)
        self.flight = Flight(None, log.system_id, keeps=_KEPT)
        for record in log.records():
            self.flight.look(*record)
        self.flight.settle()
        if not len(self.flight.track):
            rule, remedy = "there is no position in it", "Give the log of a flight."
            raise InputError("RUN_DIR|LOG", str(path), rule, remedy)
        self.events = [Event(at_s, m.text) for at_s, m in self.flight.kept(_TEXT)]

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
        for record in self._tlog or ():
            flight.look(*record)
            more = True
        if more:
            flight.settle()
            worded = ((time_s, entry_words(entry)) for time_s, entry in flight.entries)
            self.events = [Event(time_s, words[0]) for time_s, words in worded if words is not None]

    @property
    def ends_s(self) -> float:
        """When its last position was."""
        return float(self.flight.times_s[-1]) if len(self.flight.times_s) else 0.0
