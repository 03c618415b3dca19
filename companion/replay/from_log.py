"""The same flight from its telemetry log alone: what a log does not say has to be assumed.

A log holds the frames, both ways, and neither silences, nor which frames came together, nor how
long plans took: each frame is handled by itself, and each plan is there when it is asked for, as in
lockstep.  So only flights that were flown in lockstep come out the same.
"""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final, final

from companion.errors import InputError
from companion.mavlink.dialect import COMPANION_COMPONENT, wire
from companion.mavlink.frames import number_of, sender_of
from companion.mavlink.link import Output
from companion.mission.mission import Mission
from companion.planner.kernels import Kernel
from companion.planner.plan import plan
from companion.replay.differences import frames_differ, name_of
from companion.replay.same import Replayed
from companion.session import Session
from companion.telemetry.logs import Log, open_log

_SILENT_S: Final = 0.2
_LOOKED_AT: Final = 3000  # frames that tell whether a flight was flown in lockstep
_OFTEN: Final = 50
_REMEMBERED: Final = 12  # frames before a difference
_MOST_AHEAD: Final = 1000  # frames of the one that the other does not have
_TIMESYNC: Final = wire.MAVLINK_MSG_ID_TIMESYNC


@final
class LogReplay:
    """Feeds what a log has of the vehicle to a new session, and compares what it sends."""

    def __init__(
        self,
        path: Path,
        mission: Mission,
        *,
        seed: int,
        kernel: Kernel,
        version: str,
        system_id: int | None = None,
    ) -> None:
        """InputError if it is no log, or has several vehicles and none is chosen."""
        self.found = Replayed(starts=1)
        self.log: Log = open_log(path, system_id=system_id)
        self._lockstep = _was_in_lockstep(self.log)
        self._kernel = kernel
        self.session = Session(
            replace(mission, system_id=self.log.system_id or mission.system_id),
            seed=seed,
            lockstep=self._lockstep,
            version=version,
        )
        self._made: deque[tuple[float, bytes]] = deque()
        self._sent: deque[bytes] = deque()
        self._heard: deque[tuple[float, bytes]] = deque(maxlen=_REMEMBERED)

    def run(self, on_progress: Callable[[], None] = lambda: None, until_s: float = 1e18) -> None:
        """Replay to the first difference, the end, or so many seconds of the flight.

        InputError if no companion was there.
        """
        self._run(on_progress, until_s)
        if (difference := self.found.difference) is not None:
            before = tuple(f"t {at_s:.3f} s  heard {name_of(each)}" for at_s, each in self._heard)
            self.found.difference = replace(difference, before=before)

    def _run(self, on_progress: Callable[[], None], until_s: float) -> None:
        began_s, before_us = time.perf_counter(), None
        session, found = self.session, self.found
        if not self._lockstep:
            session.silence(0.0)
        for record in self.log.records():
            if sender_of(record.frame)[1] == COMPANION_COMPONENT:
                self._sent.append(record.frame)
                self._compare()
            else:
                if before_us is not None and not self._lockstep:
                    gap_s = (record.time_us - before_us) * 1e-6
                    if gap_s > _SILENT_S:
                        session.silence(gap_s)
                before_us = record.time_us
                found.told += 1
                session.receive(record.frame, record.time_us * 1e-6)
                self._handle()
                self._heard.append((session.now_s, record.frame))
            found.go_on_to(session.now_s)
            found.took_s = time.perf_counter() - began_s
            on_progress()
            if found.difference is not None or found.flown_s > until_s:
                return
        if self._sent:
            self._take(session.farewell())
        self._end()

    def _handle(self) -> None:
        self._take(out := self.session.run())
        while out.plan is not None:
            self.found.plans += 1
            self.found.plans_computed += 1
            self.session.deliver(plan(out.plan, kernel=self._kernel))
            self._take(out := self.session.run())

    def _take(self, out: Output) -> None:
        self._made += [(self.session.now_s, frame) for frame in out.frames]
        self._compare()

    def _compare(self) -> None:
        """Hold what was sent then and now against each other, as far as both are there."""
        while self._made and self._sent and self.found.difference is None:
            (time_s, now), was = self._made.popleft(), self._sent.popleft()
            self.found.difference = frames_differ(time_s, was, now)
            self.found.frames += self.found.difference is None
        if max(len(self._made), len(self._sent)) > _MOST_AHEAD:
            self._end()

    def _end(self) -> None:
        """No more is coming of the one or the other.  InputError if nothing can be compared."""
        found = self.found
        if found.difference is not None:
            return
        if self._sent:
            found.difference = frames_differ(self.session.now_s, self._sent[0], None)
        elif len(self._made) > _MOST_AHEAD and found.frames:
            found.difference = frames_differ(self._made[0][0], None, self._made[0][1])
        elif not found.frames:
            rule = "nothing in it was sent by a companion: there is nothing to compare with"
            remedy = "Give --shadow to see what it would have done."
            raise InputError("RUN_DIR|LOG", str(self.log.path), rule, remedy)
        found.unrecorded = len(self._made)


def _was_in_lockstep(log: Log) -> bool:
    """Whether the simulator asked for the time after each step."""
    asked = 0
    for count, record in enumerate(log.records()):
        from_vehicle = sender_of(record.frame)[1] != COMPANION_COMPONENT
        asked += from_vehicle and number_of(record.frame) == _TIMESYNC
        if count > _LOOKED_AT or asked > _OFTEN:
            break
    return asked > _OFTEN
