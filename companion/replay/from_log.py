"""Replays a flight from its telemetry log alone.

A log has the frames, both ways, but neither silences, nor which frames came together, nor how long
plans took: each frame is handled by itself, and each plan is ready at once, as in lockstep.  So
only flights in lockstep are reproduced, which nobody had to say go to.
"""

import math
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final, final

from companion.errors import InputError
from companion.mavlink.dialect import COMPANION_COMPONENT, wire
from companion.mavlink.frames import number_of, sender_of
from companion.mission.mission import Mission
from companion.planning import plan
from companion.replay.differences import frames_differ
from companion.replay.report import Replayed
from companion.session import Session
from companion.telemetry.logs import Log, open_log

_SILENT_S: Final = 0.2
_LOOKED_AT: Final = 3000  # frames that tell whether a flight was flown in lockstep
_OFTEN: Final = 50
_MAX_AHEAD: Final = 1000  # frames of the one that the other does not have
_TIMESYNC: Final = wire.MAVLINK_MSG_ID_TIMESYNC


@final
class LogReplay:
    """Feeds a log's frames of the vehicle to a new session, and compares what it sends."""

    def __init__(
        self,
        path: Path,
        mission: Mission,
        *,
        seed: int,
        version: str,
        system_id: int | None = None,
    ) -> None:
        """InputError if it is no log, or has several vehicles and none is chosen."""
        self.found = Replayed(starts=1)
        self.inputs: Log = open_log(path, system_id=system_id)
        self._lockstep = _was_in_lockstep(self.inputs)
        self.session = Session(
            replace(mission, system_id=self.inputs.system_id or mission.system_id),
            seed=seed,
            lockstep=self._lockstep,
            go=True,
            version=version,
        )
        self._made: deque[tuple[float, bytes]] = deque()
        self._sent: deque[bytes] = deque()

    def steps(self) -> Iterator[None]:
        """Replay, frame by frame, to the first difference or the end.

        InputError if no companion was there.
        """
        began_s, before_us, session, found = time.perf_counter(), math.inf, self.session, self.found
        if not self._lockstep:
            session.silence(0.0)
        for record in self.inputs.records():
            if sender_of(record.frame)[1] == COMPANION_COMPONENT:
                self._sent.append(record.frame)
            else:
                gap_s, before_us = (record.time_us - before_us) * 1e-6, record.time_us
                if gap_s > _SILENT_S and not self._lockstep:
                    session.silence(gap_s)
                found.inputs += 1
                session.receive(record.frame, record.time_us * 1e-6)
                self._run()
            self._compare()
            found.go_on_to(session.now_s)
            found.took_s = time.perf_counter() - began_s
            yield
            if found.difference is not None:
                break
        else:
            if self._sent:
                self._made += [(session.now_s, frame) for frame in session.farewell().frames]
                self._compare()
            self._end()

    def _run(self) -> None:
        """What follows from what the session was told; plans are computed at once."""
        while True:
            out = self.session.run()
            self._made += [(self.session.now_s, frame) for frame in out.frames]
            if out.plan is None:
                return
            self.found.plans += 1
            self.found.plans_computed += 1
            self.session.deliver(plan(out.plan))

    def _compare(self) -> None:
        """Hold what was sent then and now against each other, as far as both are there."""
        while self._made and self._sent and self.found.difference is None:
            (time_s, now), was = self._made.popleft(), self._sent.popleft()
            self.found.difference = frames_differ(time_s, was, now)
            self.found.frames += self.found.difference is None
        if max(len(self._made), len(self._sent)) > _MAX_AHEAD:
            self._end()

    def _end(self) -> None:
        """End of either side.  InputError if nothing can be compared."""
        found = self.found
        if found.difference is not None:
            return
        if self._sent:
            found.difference = frames_differ(self.session.now_s, self._sent[0], None)
        elif len(self._made) > _MAX_AHEAD and found.frames:
            found.difference = frames_differ(self._made[0][0], None, self._made[0][1])
        elif not found.frames:
            rule = "nothing in it was sent by a companion: there is nothing to compare with"
            remedy = "Give --shadow to see what it would have done."
            raise InputError("RUN_DIR|LOG", str(self.inputs.path), rule, remedy)
        found.unrecorded = len(self._made)


def _was_in_lockstep(log: Log) -> bool:
    """Whether the simulator sent a TIMESYNC after each step."""
    asked = 0
    for count, record in enumerate(log.records()):
        from_vehicle = sender_of(record.frame)[1] != COMPANION_COMPONENT
        asked += from_vehicle and number_of(record.frame) == _TIMESYNC
        if count > _LOOKED_AT or asked > _OFTEN:
            break
    return asked > _OFTEN
