"""Replays a recorded flight and compares all decisions.

Of a run folder its inputs are replayed.  The mission machine uses the recorded plans, so its
decisions can be compared on any computer.  Each plan is also computed again and compared; with
another kernel than the flight's, or other arithmetic, it may differ, which does not count as a
difference.

A telemetry log alone has the frames, both ways, but neither silences, nor which frames came
together, nor how long plans took: each frame is handled by itself, and each plan is ready at once,
as in lockstep.  So only flights in lockstep are reproduced from it.
"""

import math
import time
import traceback
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain, count, islice, starmap
from pathlib import Path
from typing import Final, final

from msgspec import Struct

from companion.errors import InputError
from companion.mavlink.dialect import COMPANION_COMPONENT
from companion.mavlink.frames import sender_of
from companion.mavlink.link import Input, Output
from companion.mission.journal import Told
from companion.mission.mission import Mission
from companion.mission.start import Start
from companion.planner import kernels
from companion.planner.request import PlanOutcome, PlanRequest, values_of
from companion.planning import plan
from companion.replay.differences import (
    NOTHING,
    Difference,
    entries_differ,
    frames_differ,
    name_of,
    values_differ,
)
from companion.replay.feed import (
    RUNTIME_RECORDS,
    SESSION_CALLS,
    DamagedInputError,
    Feeder,
    MissionOf,
    answer_of,
    arguments_of,
    start_of,
    why_not_recorded,
)
from companion.session import Session
from companion.sources.files import file_of_run
from companion.telemetry.inputs import FILE, InputsFile, is_hole
from companion.telemetry.logs import Log, Record, open_log
from companion.telemetry.run_folder import LONGEST_RECORD, Records, journal_line

_HEADER: Final = b'{"schema"'
"""How the line of a journal begins with which a companion begins."""
_MOST_AHEAD: Final = 1000
"""Frames that are still sent in the replay of a log alone when the companion in it sends no more:
so many may just not have been recorded any more."""
_LEAP_S: Final = 1.0
"""If vehicle time leaps by more once the recording had stopped, what came between is missing: every
autopilot tells its time more often, and its silence would be an input."""


@final
class Replayed(Struct, kw_only=True):
    """The result of a replay so far."""

    difference: Difference | None = None
    """The first one."""
    plans_differ: list[Difference] = []
    """Of each plan that was computed otherwise: the cost, or the first value that differs."""
    plans_excused: int = 0
    """How many of them another kernel had computed: the last bits of its results may differ."""
    starts: int = 0
    """How often the companion was started."""
    flown_by: str = ""  # the companion's version; empty: a log does not tell
    inputs: int = 0
    frames: int = 0
    """Frames that were the same: both ways, of a log alone the companion's."""
    entries: int = 0
    unrecorded: int = 0
    """Frames and entries after the end of the recording: it was killed, or the disk was full."""
    of_no_input: int = 0
    """Frames and entries before a restart that are of no input: it was killed while it wrote."""
    stops: list[str] = []
    """When the recording had stopped, why, and from when to when nothing is known."""
    torn: str = ""
    """Why it ended before the end of the file."""
    plans: int = 0
    plans_computed: int = 0
    ended_by: str = ""
    """The error that ended the flight's control loop; and where, if it ended the replay, too."""
    damaged: str = ""
    """What in the recording is not a valid input; nothing after it was replayed."""
    now_s: float = 0.0
    flown_s: float = 0.0
    """Vehicle time that was replayed, of all starts and boots together."""
    took_s: float = 0.0

    @property
    def differs(self) -> bool:
        """Whether a decision differs, or a plan of the same kernel."""
        return self.difference is not None or len(self.plans_differ) > self.plans_excused

    @property
    def is_identical(self) -> bool:
        """Whether all decisions and plans equal the recorded ones, and there were any."""
        return not self.differs and self.frames + self.entries > 0 and not self.damaged

    def __str__(self) -> str:
        speed = f", {self.flown_s / self.took_s:,.0f}x real time" if self.took_s > 0.0 else ""
        counted = f"{self.frames:,} frames, {self.entries:,} journal entries"
        if self.plans_computed:
            same = self.plans_computed - len(self.plans_differ)
            counted += f", {same} of {self.plans_computed} plans computed again"
        elif self.plans:
            counted += f"; {self.plans} plans taken as recorded"
        there = " up to there" if self.damaged else ""
        lines = [
            (self.difference, f"first difference at {self.difference}"),
            (True, f"the same: {counted} ({self.flown_s:,.1f} s of flight{speed})"),
            (self.entries and not self.frames, "no frame was compared: flight.tlog holds none"),
            (self.starts > 1, f"the companion was started {self.starts} times"),
            *((True, f"the recording had stopped {stop}") for stop in self.stops),
            *((True, f"plans differ, the first at {first}") for first in self.plans_differ[:1]),
            (self.of_no_input, f"{self.of_no_input} frames and entries are of no recorded input"),
            (self.unrecorded, f"{self.unrecorded} frames and entries came after its end"),
            (self.ended_by, f"the flight ended with an error of the companion's: {self.ended_by}"),
            (self.torn, f"the recording ends early: {self.torn}"),
            (self.damaged, f"the recording is damaged from there on: {self.damaged}"),
            (True, "not identical" if self.differs else f"identical{there}"),
        ]
        return "\n".join(line for is_so, line in lines if is_so)


@final
class Replay:
    """Feeds recorded inputs to equal sessions, and compares what they decide."""

    def __init__(
        self,
        inputs: Iterable[Input],
        recorded: "Recorded",
        mission_of: MissionOf,
        *,
        plans: bool = True,
        asked: dict[int, PlanRequest] | None = None,
    ) -> None:
        """plans: they are computed again, too; False: they are taken as recorded.

        asked: requests whose answer is still to come: who makes the inputs may take them.
        """
        self.found, self._inputs, self._recorded = recorded.found, inputs, recorded
        self._feeder, self._plans = Feeder(mission_of), plans
        self._asked = {} if asked is None else asked
        self._flown_before_s = 0.0
        """By the sessions before this one."""
        self._stop: tuple[str, int] | None = None
        """When and why the recording had stopped, and in which start; None: nothing is missing."""
        self._known_s = math.nan
        """Vehicle time up to which all is known; nan: there is none, or the vehicle is silent."""
        self._is_lost = False
        """Whether inputs of this session are missing: what it decides cannot be compared."""

    def steps(self) -> Iterator[None]:
        """Replay, input by input, until the first difference or the end."""
        began_s, replayed = time.perf_counter(), self.found
        try:
            for call, *remarks in _turns(self._inputs):
                replayed.inputs += 1 + len(remarks)
                output, error = self._feed(call)
                if not self._is_lost:
                    self._compare(call[0], output, error, remarks)
                replayed.took_s = time.perf_counter() - began_s
                if replayed.difference is not None:
                    break
                yield
            else:
                self._recorded.end()
        except DamagedInputError as error:
            replayed.damaged = str(error)
        self._go_on()

    def _feed(self, call: Input) -> tuple[Output | None, Exception | None]:
        """Feed one input; what the session gave and what it raised."""
        replayed, feeder, raised = self.found, self._feeder, None
        if call[0] == "start":
            self._begin(start_of(call))
        elif call[0] == "deliver":
            self._compare_plan(answer_of(call))
        try:
            output = feeder.take(call)
        except (DamagedInputError, InputError):
            raise
        except Exception as error:  # noqa: BLE001 - the session's own: the flight's end, perhaps
            if call[0] == "start":
                return None, error
            raised, output = error, feeder.session.take_output()
        session = feeder.session
        replayed.now_s = session.now_s
        replayed.flown_s = self._flown_before_s + session.clock.passed_s
        if output is not None and output.plan is not None:
            self._asked[output.plan.plan_id] = output.plan
        self._look_for_a_gap(call, session)
        return output, raised

    def _begin(self, start: Start) -> None:
        """A companion begins: what it begins with is recorded whole."""
        self._recorded.begin()
        self._asked.clear()
        replayed, self._is_lost = self.found, False
        replayed.starts += 1
        replayed.flown_by, self._flown_before_s = start.companion, replayed.flown_s

    def _look_for_a_gap(self, call: Input, session: Session) -> None:
        """Note from when to when nothing is known, once the recording had stopped."""
        replayed, now_s = self.found, session.now_s
        if (why := why_not_recorded(call)) is not None:
            self._go_on()
            self._stop = f"at t {now_s:.1f} s ({why})", replayed.starts
        elif self._stop and session.clock.is_known and abs(now_s - self._known_s) > _LEAP_S:
            (where, start), self._stop = self._stop, None
            unknown = f"nothing is known from t {self._known_s:.1f} s to t {now_s:.1f} s"
            replayed.stops.append(f"{where}: {unknown}")
            self._is_lost = start == replayed.starts
        if call[0] == "silence":
            self._known_s = math.nan
        elif session.clock.is_known:
            self._known_s = now_s

    def _go_on(self) -> None:
        """Note that nothing is missing since the recording had stopped, if it had."""
        if self._stop is not None:
            self.found.stops.append(f"{self._stop[0]}, and went on: nothing is missing")

    def _compare(
        self, call: str, output: Output | None, error: Exception | None, remarks: list[Input]
    ) -> None:
        """Compare what came of an input with the recording, and with the runtime's remarks.

        If the flight ended with an error here, the replay must, too.
        """
        replayed, remarked = self.found, [(remark[0], arguments_of(remark)) for remark in remarks]
        if output is not None:
            there = range(len(output.frames))  # else it has sent fewer: that differs
            unsent = (k for name, of in remarked if name == "unsent" for k in of[0] if k in there)
            output.leave_out(unsent)
            self._recorded.compare(output)
        for frames in (of[0] for name, of in remarked if name == "held"):
            self._recorded.pass_over(frames)
        was = next((of for name, of in remarked if name == "raised"), (call, ""))
        now = call, "" if error is None else f"{type(error).__name__}: {error}"
        place = "" if error is None else f"{now[1]} ({_place_of(error)})"
        replayed.ended_by = (place if was == now else was[1]) or replayed.ended_by
        if (
            was != now
            and (error is not None or was[0] in SESSION_CALLS)
            and not replayed.difference
        ):
            both = was[1] or NOTHING, place or NOTHING
            replayed.difference = Difference(replayed.now_s, was[0] or "flight", "error", *both)

    def _compare_plan(self, answer: PlanOutcome) -> None:
        """Compute a plan again, only to compare it."""
        replayed, request = self.found, self._asked.pop(answer.plan_id, None)
        replayed.plans += 1
        if request is None or self._is_lost or not self._plans:
            return
        replayed.plans_computed += 1
        was, kernel = values_of(answer), kernels.signature()
        recorded_by = str(was.pop("kernel", kernel))
        patience, asked = getattr(answer, "stopped_after", None), count(1)
        try:  # with the search budget of the recorded one
            made = plan(request, lambda: patience is not None and next(asked) > patience)
            now = values_of(made)
        except Exception as error:  # noqa: BLE001 - the planner's own: in flight it had an answer
            now, recorded_by = {"error": f"{type(error).__name__}: {error}"}, kernel
        now.pop("kernel", None)
        what, first = f"plan {answer.plan_id}", dict.fromkeys(("error", "kind", "cost"))
        if (place := values_differ(first | was, first | now)) is None:  # the first say most
            return
        if recorded_by != kernel:
            what += f" ({recorded_by}, now {kernel})"
            replayed.plans_excused += 1
        replayed.plans_differ.append(Difference(replayed.now_s, what, *place))


def _turns(inputs: Iterable[Input]) -> Iterator[list[Input]]:
    """Each input of a session, and what the runtime then remarked about it."""
    turn: list[Input] = []
    for call in inputs:
        if turn and call[0] not in RUNTIME_RECORDS:
            yield turn
            turn = []
        turn.append(call)
    if turn:
        yield turn


def _place_of(error: Exception) -> str:
    """Where in the code it was raised."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(last.filename).stem}.{last.name}, line {last.lineno}"


# --- what was recorded


@final
class Recorded:
    """Recorded frames and entries, in order, to hold those of a replay against."""

    def __init__(
        self, frames: Iterator[Record], lines: Iterable[bytes] = (), *, alone: bool = False
    ) -> None:
        """lines: of the journal, its headers too.

        alone: there are only frames, and only of the companion, by whatever clock.
        """
        self.found, self._alone = Replayed(), alone
        self._frames, self._lines = frames, deque(lines)
        self._epoch_us: int | None = None
        """The stamp of vehicle time 0, by the first frame that is compared."""
        self._searches = False
        """Whether the next frame may be the first of a companion that begins again."""
        self._ahead: Difference | None = None
        """The first frame that was sent after the last recorded one."""

    def begin(self) -> None:
        """A companion begins, perhaps again: then the vehicle's clock may differ.

        What the one before has written last may be of no input: it was killed while it wrote.
        """
        self._epoch_us, self._searches = None, self.found.starts > 0
        while self._searches and self._next_line() is not None:
            self.found.of_no_input += 1
        while self._lines and self._lines[0].startswith(_HEADER):  # or it had been killed at once
            self._lines.popleft()

    def compare(self, output: Output) -> None:
        """Compare the output of one run with the next records."""
        frames = starmap(self._frame_differs, output.record)
        entries = () if self._alone else map(self._entry_differs, output.journal)
        self.found.difference = next(filter(None, chain(frames, entries)), None)

    def pass_over(self, frames: int) -> None:
        """Skip what the watchdog sent: so many frames, and one entry."""
        next(islice(self._frames, frames, frames), None)
        self._next_line()

    def end(self) -> None:
        """The replay is over: a companion in a log may have sent no more than it did."""
        replayed, left = self.found, next(self._frames, None) if self._alone else None
        if left is not None:
            replayed.difference = frames_differ(replayed.now_s, left.frame, None)

    def _next_line(self) -> bytes | None:
        """The next entry of this companion."""
        has_one = self._lines and not self._lines[0].startswith(_HEADER)
        return self._lines.popleft() if has_one else None

    def _entry_differs(self, entry: Told) -> Difference | None:
        if (line := self._next_line()) is None:
            self.found.unrecorded += 1
            return None
        difference = entries_differ(entry["t_s"], line, journal_line(entry))
        self.found.entries += difference is None
        return difference

    def _frame_differs(self, time_s: float, frame: bytes) -> Difference | None:
        if self._alone and not _is_of_companion(frame):
            return None
        if self._searches:
            self._search(frame)
        if (record := next(self._frames, None)) is None:
            self.found.unrecorded += 1
            self._ahead = self._ahead or frames_differ(time_s, None, frame)
            too_many = self._alone and self.found.unrecorded > _MOST_AHEAD
            return self._ahead if too_many else None
        if (difference := frames_differ(time_s, record.frame, frame)) is not None:
            return difference
        at_us = round(time_s * 1e6)
        self._epoch_us = record.time_us - at_us if self._epoch_us is None else self._epoch_us
        late_us = record.time_us - self._epoch_us - at_us
        if late_us and not self._alone:
            return Difference(time_s, name_of(frame), "time", time_s + late_us * 1e-6, time_s)
        self.found.frames += 1
        return None

    def _search(self, frame: bytes) -> None:
        """Pass over what comes before a frame; nothing, if it does not come."""
        passed, self._searches = list[Record](), False
        for record in self._frames:
            passed.append(record)
            if record.frame == frame:
                self.found.of_no_input += len(passed) - 1
                passed = [record]
                break
        self._frames = chain(passed, self._frames)


def replay_of_folder(folder: Path, mission_of: MissionOf, *, plans: bool = True) -> Replay:
    """The replay of a run folder.  plans: they are computed again, too.

    InputError if the folder has no inputs, or of another version.
    """
    inputs, journal = InputsFile(folder / FILE), file_of_run(folder, "journal.jsonl").read_bytes()
    lines = journal[: journal.rfind(b"\n") + 1].splitlines(keepends=True)
    recorded = Recorded(_frames_of(file_of_run(folder, "flight.tlog")), lines)
    return Replay(_to_the_end(inputs, recorded.found), recorded, mission_of, plans=plans)


def _to_the_end(inputs: InputsFile, replayed: Replayed) -> Iterator[Input]:
    """All of them, and why they end there.  DamagedInputError: what follows are none."""
    yield from inputs
    torn = f"{inputs.torn_bytes:,} bytes"
    if inputs.is_damaged:
        raise DamagedInputError(f"{torn} that are no inputs")
    replayed.torn = f"{torn} of a record that is not whole" if inputs.torn_bytes else ""


def _frames_of(tlog: Path) -> Iterator[Record]:
    """The whole records of a log.  DamagedInputError: what follows are none."""
    records = Records(tlog)
    yield from starmap(Record, records)
    left = tlog.stat().st_size - records.end
    if left > LONGEST_RECORD and not is_hole(tlog, records.end):
        raise DamagedInputError(f"{left:,} bytes of {tlog.name} that are no frames")


# --- a telemetry log alone


def replay_of_log(
    path: Path, mission: Mission, *, seed: int, version: str, system_id: int | None = None
) -> tuple[Replay, Log]:
    """The replay of a log by itself, and the log, for what is odd about it.

    InputError if it is no log, has several vehicles and none is chosen, or no companion.
    """
    log = open_log(path, system_id=system_id)
    flown = replace(mission, system_id=log.system_id or mission.system_id)
    session = Session(flown, seed=seed, lockstep=True, version=version)
    again = open_log(path, system_id=log.system_id).records()
    sent = (record for record in again if _is_of_companion(record.frame))
    if (first := next(sent, None)) is None:
        rule = "nothing in it was sent by a companion: there is nothing to compare with"
        remedy = "Give --shadow to see what it would have done."
        raise InputError("RUN_DIR|LOG", str(path), rule, remedy)
    recorded = Recorded(chain([first], sent), alone=True)
    asked = dict[int, PlanRequest]()
    inputs = chain(session.take_output().inputs, _inputs_of(log, asked, recorded.found))
    return Replay(inputs, recorded, lambda _: mission, asked=asked), log


def _inputs_of(log: Log, asked: dict[int, PlanRequest], replayed: Replayed) -> Iterator[Input]:
    """Each frame of others by itself, and at once the answer to what was asked."""
    replayed.flown_by = ""
    for record in log.records():
        if _is_of_companion(record.frame):
            continue
        yield "receive", record.frame, record.time_us * 1e-6
        yield ("run",)
        while asked:
            replayed.plans_computed += 1
            yield "deliver", values_of(plan(asked.popitem()[1]))
            yield ("run",)
    yield ("farewell",)


def _is_of_companion(frame: bytes) -> bool:
    return sender_of(frame)[1] == COMPANION_COMPONENT
