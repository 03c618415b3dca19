"""A flight as far as it is recorded: read from its run folder while that grows, or from any log.

Nothing here asks the companion: whoever watches a flight cannot slow it down.
"""

import json
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, Self, final

import numpy as np

from companion.errors import InputError
from companion.geodesy import FloatArray, LocalFrame
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.mavlink.frames import decoded, number_of, sender_of
from companion.mission import journal as noted
from companion.mission.journal import Entry
from companion.mission.mission import Mission
from companion.replay.exporting import mission_of
from companion.sources.files import answer, file_of_run
from companion.telemetry.export import shapes
from companion.telemetry.export.flight import Decided, FlightBuilder, decided
from companion.telemetry.export.track import Track, TrackBuilder
from companion.telemetry.journal import Journal
from companion.telemetry.logs import open_log
from companion.telemetry.run_folder import Records
from companion.views.words import entry_words
from companion.world.zones import Zone

BATTERY: Final = wire.MAVLINK_MSG_ID_SYS_STATUS
SECTORS: Final = wire.MAVLINK_MSG_ID_OBSTACLE_DISTANCE
_TEXT: Final = wire.MAVLINK_MSG_ID_STATUSTEXT
_NEW_BOOT_S: Final = 1.0  # shown between the last position before a reboot and the first after it
_RATE_OVER_S: Final = 5.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something worth a line in the list of events."""

    time_s: float
    """Since the first position."""
    kind: str
    """plan, hold, or empty: neither."""
    text: str


@final
class Recording:
    """One flight.  Times are seconds since its first position; they go on across reboots."""

    def __init__(self, path: Path, system_id: int | None = None) -> None:
        """path: a run folder, or a log of any kind.  InputError if it is neither."""
        self.path = path
        self.mission: Mission | None = None
        self._journal: Journal | None = None
        self._tlog: Records | None = None
        self._vehicle = system_id
        self._kept: dict[int, tuple[list[float], list[bytes]]] = {
            each: ([], []) for each in (BATTERY, SECTORS, _TEXT)
        }
        if path.is_dir():
            self.mission = mission_of(path)
            file_of_run(path, "flight.tlog", "RUN_DIR|LOG")
            self._journal = Journal(path / "journal.jsonl")
            self._builder = FlightBuilder(self.mission)
            self._positions: TrackBuilder | None = None
        else:
            log = open_log(path, system_id=system_id)
            self._positions, self._vehicle = TrackBuilder(log.system_id), log.system_id
            for record in log.records():
                self._take(record.time_us, record.frame)
        self.track: Track = TrackBuilder(None).track()
        self.times_s: FloatArray = np.empty(0)
        self.places_nea_m: FloatArray = np.empty((0, 3))
        self._begins_s: FloatArray = np.zeros(1)
        """Of each boot, what its clock is behind."""
        self._decided: tuple[list[float], list[Decided]] = ([], [])
        self.events: list[Event] = []
        self.plans: list[tuple[float, noted.PlanReady]] = []
        """All subpaths that were found, by the time from which they were known."""
        self.asked_ids: list[int] = []
        """Of all that the planner was asked for."""
        self.frame: LocalFrame | None = self.mission and self.mission.frame
        self._settle()
        if self._journal is None and not len(self.track):
            rule, remedy = "there is no position in it", "Give the log of a flight."
            raise InputError("RUN_DIR|LOG", str(path), rule, remedy)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._tlog is not None:
            self._tlog.close()

    def read(self) -> bool:
        """Read what has been recorded since; whether anything was."""
        if self._journal is None:
            return False
        more = False
        for line in self._journal.new_lines() if answer(self._journal.path.is_file) else ():
            self._builder.take(line)
            more = True
        system_id = self._builder.system_id
        if self._tlog is None:
            if system_id is None:
                return more
            self._tlog = Records(self.path / "flight.tlog")
            self._positions, self._vehicle = TrackBuilder(system_id), system_id
        while (record := self._tlog.take()) is not None:
            self._take(*record)
            more = True
        if more:
            self._settle()
        return more

    def _take(self, time_us: int, frame: bytes) -> None:
        assert self._positions is not None
        number = number_of(frame)
        if (kept := self._kept.get(number)) is not None:
            if number == SECTORS or sender_of(frame) == (self._vehicle, AUTOPILOT_COMPONENT):
                kept[0].append(time_us * 1e-6)
                kept[1].append(frame)
        else:
            self._positions.take(time_us, frame)

    def _settle(self) -> None:
        """Bring all that is derived up to date."""
        if self._positions is None:
            return
        before, self.track = len(self.track), self._positions.track()
        if not len(self.track):
            return
        if self.frame is None:
            self.frame = LocalFrame(
                latitude_deg=float(self.track.latitude_deg[0]),
                longitude_deg=float(self.track.longitude_deg[0]),
            )
        same = max(
            min(before, len(self.track)) - 2, 0
        )  # of the last ones one may have been a stray
        fresh = self.track.part(slice(same, None))
        fresh_nea_m = shapes.local_nea_m(fresh, self.frame)
        self.places_nea_m = np.concatenate([self.places_nea_m[:same], fresh_nea_m])
        first = np.flatnonzero(np.diff(self.track.boot, prepend=-1))
        begins = [-float(self.track.t_s[0])]
        for row in first[1:].tolist():
            ended_s = float(self.track.t_s[row - 1]) + begins[-1]
            begins.append(ended_s + _NEW_BOOT_S - float(self.track.t_s[row]))
        self._begins_s = np.array(begins)
        self.times_s = self.track.t_s + self._begins_s[self.track.boot]
        if self._journal is not None:
            self._settle_decisions()
        else:
            self.events = [
                Event(time_s=at_s, kind="", text=message.text)
                for at_s, message in self._messages(_TEXT)
            ]

    def time_of(self, boot: int, t_s: float) -> float:
        """A vehicle time as seconds since the first position."""
        begin_s = self._begins_s[min(boot, len(self._begins_s) - 1)]
        return max(t_s + float(begin_s), 0.0)

    def _settle_decisions(self) -> None:
        assert self.mission is not None
        times, states = [0.0], [Decided(targets_ne_m=self.mission.targets_ne_m)]
        events, plans = list[Event](), list[tuple[float, noted.PlanReady]]()
        asked = list[int]()
        for boot, t_s, entry, after in decided(self.mission, self._builder.timed):
            time_s = self.time_of(boot, t_s)
            if after is not states[-1]:
                times.append(time_s)
                states.append(after)
            if isinstance(entry, noted.PlanReady):
                plans.append((time_s, entry))
            if isinstance(entry, noted.PlanAsked):
                asked.append(entry.plan_id)
            if (told := entry_words(entry)) is not None:
                events.append(Event(time_s=time_s, kind=_kind(entry), text=told[0]))
        self._decided, self.events, self.plans = (times, states), events, plans
        self.asked_ids = asked

    # --- what is asked of it

    @property
    def ends_s(self) -> float:
        """When its last position was."""
        return float(self.times_s[-1]) if len(self.times_s) else 0.0

    def row_at(self, time_s: float) -> int:
        """The position that was the newest; there is one."""
        return max(int(np.searchsorted(self.times_s, time_s, "right")) - 1, 0)

    def decided_at(self, time_s: float) -> Decided:
        """What was decided."""
        times, states = self._decided
        return states[max(bisect_right(times, time_s) - 1, 0)] if states else Decided()

    def zones_at(self, time_s: float) -> tuple[Zone, ...]:
        """The mission's, and the vehicle's own."""
        return () if self.mission is None else self.decided_at(time_s).zones_of(self.mission)

    def rate_hz(self, time_s: float) -> float:
        """How often positions came, lately."""
        after, until = np.searchsorted(self.times_s, [time_s - _RATE_OVER_S, time_s], "right")
        return float(until - after) / _RATE_OVER_S

    def newest(self, number: int, time_s: float) -> tuple[float, Message] | None:
        """The newest message of a kind that is kept, and how old it was, seconds."""
        stamps, frames = self._kept[number]
        row = self.row_at(time_s)
        now_s = self.track.time_us[row] * 1e-6 + (time_s - self.times_s[row])
        at = bisect_right(stamps, now_s) - 1
        if at < 0:
            return None
        return now_s - stamps[at], decoded(frames[at], wire.mavlink_map[number])

    def _messages(self, number: int) -> Iterator[tuple[float, Message]]:
        began_s = self.track.time_us[0] * 1e-6
        for at_s, frame in zip(*self._kept[number], strict=True):
            yield max(at_s - began_s, 0.0), decoded(frame, wire.mavlink_map[number])

    @cached_property
    def planning_s(self) -> list[float]:
        """How long each answer took, if the flight is over and has noted it."""
        with suppress(OSError, ValueError, AttributeError):
            noted_s = json.loads((self.path / "run.json").read_bytes()).get("planning_s")
            return [float(each) for each in noted_s or ()]
        return []


def _kind(entry: Entry) -> str:
    match entry:
        case noted.Phase(phase="holding" | "faulted"):
            return "hold"
        case noted.PlanReady():
            return "plan"
        case _:
            return ""
