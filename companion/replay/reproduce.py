"""Replays a recorded flight and compares all decisions.

Of a run folder its inputs are replayed.  The mission machine uses the recorded plans, so its
decisions can be compared on any computer.  Each plan is also computed again and compared; with
another kernel than the flight's, or other arithmetic, it may differ, which does not count as a
difference.

A telemetry log alone has the frames, both ways, but neither silences, nor which frames came
together, nor how long plans took: each frame is handled by itself, and each plan is ready at once,
as in lockstep.  So only flights in lockstep are reproduced from it.
"""

import time
from collections.abc import Generator, Iterable, Iterator
from dataclasses import replace
from itertools import chain, count, starmap
from pathlib import Path
from typing import Final, final

from companion.errors import InputError
from companion.mavlink.dialect import COMPANION_COMPONENT
from companion.mavlink.frames import sender_of
from companion.mavlink.link import Input, Output, Stamped
from companion.mission.journal import Told
from companion.mission.mission import Mission
from companion.planner import kernels
from companion.planner.request import PlanOutcome, PlanRequest, values_of
from companion.planning import plan
from companion.replay.differences import (
    NOTHING,
    Difference,
    Replayed,
    entries_differ,
    frames_differ,
    name_of,
    place_of,
    values_differ,
)
from companion.replay.feed import (
    RUNTIME_RECORDS,
    SESSION_CALLS,
    DamagedInputError,
    Feeder,
    MissionOf,
    answer_of,
    start_of,
)
from companion.session import Session
from companion.sources.files import file_of_run
from companion.telemetry.inputs import FILE, InputsFile, is_hole
from companion.telemetry.logs import Log, open_log
from companion.telemetry.run_folder import LONGEST_RECORD, Records, journal_line

_MAX_AHEAD: Final = 1000
"""Frames that the companion still sends in a replay when the recorded one sends no more: so many
may just not have been recorded any more."""


# --- a run folder


@final
class Replay:
    """Feeds the inputs of a run folder to equal sessions, and compares what they decide."""

    def __init__(self, folder: Path, mission_of: MissionOf, *, plans: bool = True) -> None:
        """plans: they are computed again, too; False: they are taken as recorded.

        InputError if the folder has no inputs, or of another version.
        """
        self.found = Replayed()
        self.inputs = InputsFile(folder / FILE)
        self._recording, self._feeder = _Recording(folder, self.found), Feeder(mission_of)
        self._plans, self._asked = plans, dict[int, PlanRequest]()
        self._flown_before_s = 0.0
        """By the sessions before this one."""

    def steps(self) -> Iterator[None]:
        """Replay, input by input, until the first difference or the end."""
        began_s, found = time.perf_counter(), self.found
        try:
            for told, remarks in _with_remarks(self.inputs):
                found.inputs += 1 + len(remarks)
                self._compare(told[0], *self._feed(told), remarks)
                found.took_s = time.perf_counter() - began_s
                if found.difference is not None:
                    break
                yield
        except DamagedInputError as error:
            found.damaged = str(error)
        finally:
            self._recording.close()
        if self.inputs.is_damaged:
            found.damaged = f"{self.inputs.torn_bytes:,} bytes that are no inputs"
        elif self.inputs.torn_bytes and found.difference is None and not found.damaged:
            found.torn = f"{self.inputs.torn_bytes} bytes of a record that is not whole"

    def _feed(self, told: Input) -> tuple[Output | None, Exception | None]:
        """Feed one input; what the session gave and what it raised."""
        found, feeder, raised = self.found, self._feeder, None
        if told[0] == "start":
            self._asked.clear()
            found.flown_by = start_of(told).companion
            self._recording.epoch_us = None  # the companion was restarted: its clock may differ
            self._flown_before_s = found.flown_s
        elif told[0] == "deliver":
            self._plan_again(answer_of(told), feeder.session.now_s)
        try:
            output = feeder.take(told)
        except (DamagedInputError, InputError):
            raise
        except Exception as error:  # noqa: BLE001 - the session's own: the flight's end, perhaps
            if told[0] == "start":
                return None, error
            raised, output = error, feeder.session.take_output()
        found.starts += told[0] == "start"
        if output is not None and output.plan is not None:
            self._asked[output.plan.plan_id] = output.plan
        session = feeder.session
        found.now_s, found.flown_s = session.now_s, self._flown_before_s + session.clock.passed_s
        return output, raised

    def _compare(
        self, call: str, given: Output | None, raised: Exception | None, remarks: list[Input]
    ) -> None:
        """Compare what came of an input with the recording, and with the runtime's remarks.

        If the flight ended with an error here, the replay must, too.
        """
        found, ended, ended_call = self.found, "", call
        for remark in remarks:
            match remark:
                case ("unsent", list(numbers)) if given and all(type(n) is int for n in numbers):
                    there = range(len(given.frames))  # else it has sent fewer: that differs
                    given.leave_out(number for number in numbers if number in there)
                case ("raised", str(of), str(error)):
                    ended_call, ended = of, error
                case _:
                    pass
        if given is not None:
            found.difference = self._recording.first_difference(given.record, given.journal)
        for name, *told in remarks:
            if name == "held" and told and type(told[0]) is int:
                self._recording.pass_over(told[0])
        error = "" if raised is None else f"{type(raised).__name__}: {raised}"
        placed = error if raised is None else f"{error} ({place_of(raised)})"
        if error and (ended_call, ended) == (call, error):
            found.ended_by = placed
            return
        found.ended_by = ended or found.ended_by
        if error or (ended and ended_call in SESSION_CALLS):
            what, was, now = ended_call or "flight", ended or NOTHING, placed or NOTHING
            found.difference = found.difference or Difference(found.now_s, what, "error", was, now)

    def _plan_again(self, answer: PlanOutcome, now_s: float) -> None:
        """Compute a plan again, only to compare it."""
        found, request = self.found, self._asked.pop(answer.plan_id, None)
        found.plans += 1
        if request is None or not self._plans:
            return
        found.plans_computed += 1
        was, kernel = values_of(answer), kernels.signature()
        recorded_by = str(was.pop("kernel", kernel))
        try:
            now = values_of(_computed_again(request, getattr(answer, "stopped_after", None)))
        except Exception as error:  # noqa: BLE001 - the planner's own: in flight it had an answer
            now, recorded_by = {"error": f"{type(error).__name__}: {error}"}, kernel
        now.pop("kernel", None)
        what, first = f"plan {answer.plan_id}", ("error", "kind", "cost")  # they say most
        if (place := values_differ(dict.fromkeys(first) | was, dict.fromkeys(first) | now)) is None:
            return
        if recorded_by != kernel:
            what += f" ({recorded_by}, now {kernel})"
            found.plans_excused += 1
        found.plans_differ.append(Difference(now_s, what, *place))


def _with_remarks(inputs: Iterable[Input]) -> Iterator[tuple[Input, list[Input]]]:
    """Each input of a session with what the runtime then remarked about it."""
    told: Input | None = None
    remarks: list[Input] = []
    for each in chain(inputs, [None]):
        if each is not None and told is not None and each[0] in RUNTIME_RECORDS:
            remarks.append(each)
            continue
        if told is not None:
            yield told, remarks
        told, remarks = each, []


def _computed_again(request: PlanRequest, stopped_after: int | None) -> PlanOutcome:
    """The answer to a request, with the search budget of the recorded one.

    stopped_after: how often that search was allowed to go on; None: to its end.
    """
    asked = count(1)
    return plan(request, lambda: stopped_after is not None and next(asked) > stopped_after)


@final
class _Recording:
    """The recorded frames and entries of a run folder, compared with a replay's in order."""

    def __init__(self, folder: Path, found: Replayed) -> None:
        """found: what is the same is counted there.  InputError: nothing is there to compare."""
        self._found = found
        self._path = file_of_run(folder, "flight.tlog")
        self._lines = _entry_lines(file_of_run(folder, "journal.jsonl"))
        self._records = Records(self._path)
        self._log = iter(self._records)
        self.epoch_us: int | None = None
        """The stamp of vehicle time 0, by the first frame that is compared."""
        self._has_ended = False

    def close(self) -> None:
        """Close the files."""
        self._log.close()
        self._lines.close()

    def first_difference(self, record: list[Stamped], journal: list[Told]) -> Difference | None:
        """Compare the output of one run with the next records."""
        found = chain(starmap(self._frame_differs, record), map(self._entry_differs, journal))
        return next((each for each in found if each is not None), None)

    def pass_over(self, frames: int) -> None:
        """Skip what the watchdog sent: this many frames, and one entry."""
        while frames > 0 and next(self._log, None) is not None:
            frames -= 1
        next(self._lines, None)

    def _frame_differs(self, time_s: float, frame: bytes) -> Difference | None:
        if (held := next(self._log, None)) is None:
            self._found.unrecorded += 1
            return self._is_damaged(time_s, frame)
        stamp_us, recorded = held
        if (difference := frames_differ(time_s, recorded, frame)) is not None:
            return difference
        at_us = round(time_s * 1e6)
        self.epoch_us = stamp_us - at_us if self.epoch_us is None else self.epoch_us
        if stamp_us != self.epoch_us + at_us:
            was_s = time_s + (stamp_us - self.epoch_us - at_us) * 1e-6
            return Difference(time_s, name_of(frame), "time", was_s, time_s)
        self._found.frames += 1
        return None

    def _is_damaged(self, time_s: float, frame: bytes) -> Difference | None:
        """Whether the log ends here because the data after it is damaged; checked once."""
        has_ended, self._has_ended = self._has_ended, True
        left = self._path.stat().st_size - self._records.end
        if has_ended or left <= LONGEST_RECORD or is_hole(self._path, self._records.end):
            return None
        what = f"{left:,} bytes that are no frames"
        return Difference(time_s, "flight.tlog", "", what, name_of(frame))

    def _entry_differs(self, entry: Told) -> Difference | None:
        if (held := next(self._lines, None)) is None:
            self._found.unrecorded += 1
            return None
        line, time_s, kind = journal_line(entry), float(entry["t_s"]), str(entry["kind"])
        difference = entries_differ(held, line, time_s, kind)
        self._found.entries += difference is None
        return difference


def _entry_lines(path: Path) -> Generator[bytes]:
    """The lines of a journal but for its headers, to the last whole one."""
    with path.open("rb") as file:
        for line in file:
            if line.endswith(b"\n") and not line.startswith(b'{"schema"'):
                yield line


# --- a telemetry log alone


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
        self._session = Session(
            replace(mission, system_id=self.inputs.system_id or mission.system_id),
            seed=seed,
            lockstep=True,
            version=version,
        )
        again = open_log(path, system_id=self.inputs.system_id)
        self._sent = (each.frame for each in again.records() if _is_of_companion(each.frame))

    def steps(self) -> Iterator[None]:
        """Replay, frame by frame, to the first difference or the end.

        InputError if no companion was there.
        """
        began_s, found = time.perf_counter(), self.found
        ahead: list[Stamped] = []
        for time_s, frame in self._made():
            if (recorded := next(self._sent, None)) is None:
                ahead.append((time_s, frame))
            else:
                self._compare(time_s, recorded, frame)
            found.took_s, found.unrecorded = time.perf_counter() - began_s, len(ahead)
            yield
            if found.difference is not None or found.unrecorded > _MAX_AHEAD:
                break
        else:  # what it says in the end may not have been recorded
            for frame, recorded in zip(self._session.farewell().frames, self._sent, strict=False):
                self._compare(found.now_s, recorded, frame)
            if (left := next(self._sent, None)) is not None:
                self._compare(found.now_s, left, None)
        if not found.frames and found.difference is None:
            rule = "nothing in it was sent by a companion: there is nothing to compare with"
            remedy = "Give --shadow to see what it would have done."
            raise InputError("RUN_DIR|LOG", str(self.inputs.path), rule, remedy)
        if found.unrecorded > _MAX_AHEAD:
            found.difference = frames_differ(ahead[0][0], None, ahead[0][1])

    def _compare(self, time_s: float, recorded: bytes, frame: bytes | None) -> None:
        difference = frames_differ(time_s, recorded, frame)
        self.found.frames += difference is None
        self.found.difference = self.found.difference or difference

    def _made(self) -> Iterator[Stamped]:
        """The frames that the session sends, with their vehicle times."""
        session, found = self._session, self.found
        for record in self.inputs.records():
            if _is_of_companion(record.frame):
                continue
            found.inputs += 1
            session.receive(record.frame, record.time_us * 1e-6)
            while True:
                out = session.run()
                yield from ((session.now_s, frame) for frame in out.frames)
                if out.plan is None:
                    break
                found.plans += 1
                found.plans_computed += 1
                session.deliver(plan(out.plan))  # at once
            found.now_s, found.flown_s = session.now_s, session.clock.passed_s


def _is_of_companion(frame: bytes) -> bool:
    return sender_of(frame)[1] == COMPANION_COMPONENT
