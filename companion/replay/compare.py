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
import traceback
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain, count, groupby, islice, starmap, tee
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
    first_difference,
    name_of,
    values_differ,
)
from companion.replay.feed import (
    RUNTIME_RECORDS,
    SESSION_CALLS,
    DamagedInputError,
    Feeder,
    MissionOf,
    arguments_of,
)
from companion.session import Session
from companion.sources.files import file_of_run
from companion.telemetry.inputs import FILE, InputsFile, is_hole
from companion.telemetry.logs import open_log
from companion.telemetry.run_folder import LONGEST_RECORD, Records, journal_line

_HEADER: Final = b'{"schema"'
"""How the line of a journal begins with which a companion begins."""
_NOT_RECORDED: Final = "not recorded any more: "
"""So the runtime complains once a disk fails or stands still (`runtime.loop`)."""


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
    flown_by: str = ""
    """The companion's version; empty: a log does not tell."""
    inputs: int = 0
    frames: int = 0
    """Frames that were the same, both ways."""
    entries: int = 0
    unrecorded: int = 0
    """Frames and entries after the end of the recording: it was killed, or the disk was full."""
    of_no_input: int = 0
    """Frames and entries before a restart that are of no input: it was killed while it wrote."""
    stops: list[str] = []
    """When the recording had stopped, why, and up to when there is one nevertheless."""
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
        self.replayed, self._inputs, self._recorded = recorded.replayed, inputs, recorded
        self._feeder, self._plans = Feeder(mission_of), plans
        self._asked = {} if asked is None else asked
        self._flown_before_s = 0.0
        """By the sessions before this one."""
        self._stop = ""
        """When and why the recording of this companion had stopped."""

    def steps(self) -> Iterator[None]:
        """Replay, input by input, until the first difference or the end."""
        began_s, replayed = time.perf_counter(), self.replayed
        try:
            for call, *remarks in _turns(self._inputs):
                replayed.inputs += 1 + len(remarks)
                output, error = self._feed(call)
                self._compare(call[0], output, error, remarks)
                replayed.took_s = time.perf_counter() - began_s
                if replayed.difference is not None:
                    break
                yield
        except DamagedInputError as error:
            replayed.damaged = str(error)
        self._end_companion()

    def _feed(self, call: Input) -> tuple[Output | None, Exception | None]:
        """Feed one input; what the session gave and what it raised."""
        replayed, feeder, raised = self.replayed, self._feeder, None
        match call:
            case ["start", *_]:
                self._end_companion()
                self._asked.clear()
                self._recorded.begin(*arguments_of(call))
            case ["deliver", *_]:
                self._compare_plan(*arguments_of(call))
            case ["complain", str(text)] if text.startswith(_NOT_RECORDED):
                self._stop = f"at t {replayed.now_s:.1f} s ({text.removeprefix(_NOT_RECORDED)})"
        try:
            output = feeder.take(call)
        except (DamagedInputError, InputError):
            raise
        except Exception as error:  # noqa: BLE001 - the session's own: the flight's end, perhaps
            if call[0] == "start":  # there is no session
                return None, error
            raised, output = error, feeder.session.take_output()
        clock = feeder.session.clock
        replayed.now_s, replayed.flown_s = clock.now_s, self._flown_before_s + clock.passed_s
        if output is not None and output.plan is not None:
            self._asked[output.plan.plan_id] = output.plan
        return output, raised

    def _end_companion(self) -> None:
        """All that one companion has recorded is replayed."""
        replayed = self.replayed
        self._flown_before_s = replayed.flown_s
        if self._stop:
            replayed.stops.append(f"{self._stop}; what there is ends at t {replayed.now_s:.1f} s")
            self._stop = ""

    def _compare(
        self, call: str, output: Output | None, error: Exception | None, remarks: list[Input]
    ) -> None:
        """Compare what came of an input with the recording, and with the runtime's remarks.

        If the flight ended with an error here, the replay must, too.
        """
        replayed, told = self.replayed, [(remark[0], arguments_of(remark)) for remark in remarks]
        unsent = {number for name, of in told if name == "unsent" for number in of[0]}
        if output is not None:  # which may hold fewer frames: that differs
            output.leave_out(unsent.intersection(range(len(output.frames))))
            self._recorded.compare(output)
        for frames in (of[0] for name, of in told if name == "held"):
            self._recorded.pass_over(frames)
        was_in, was = next((of for name, of in told if name == "raised"), (call, ""))
        now = "" if error is None else f"{type(error).__name__}: {error}"
        place = "" if error is None else f"{now} ({_place_of(error)})"
        is_same = (was_in, was) == (call, now)
        replayed.ended_by = (place if is_same else was) or replayed.ended_by
        if not is_same and (now or was_in in SESSION_CALLS) and replayed.difference is None:
            both = was or NOTHING, place or NOTHING
            replayed.difference = Difference(replayed.now_s, was_in or "flight", "error", *both)

    def _compare_plan(self, answer: PlanOutcome) -> None:
        """Compute a plan again, only to compare it."""
        replayed, request = self.replayed, self._asked.pop(answer.plan_id, None)
        replayed.plans += 1
        if request is None or not self._plans:
            return
        replayed.plans_computed += 1
        was, kernel = values_of(answer), kernels.signature()
        recorded_by = str(was.pop("kernel", kernel))
        patience, asked = getattr(answer, "stopped_after", None), count(1)
        try:  # with the search budget of the recorded one
            now = values_of(plan(request, lambda: patience is not None and next(asked) > patience))
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

    def __init__(self, frames: Iterator[tuple[int, bytes]], lines: Iterable[bytes] | None) -> None:
        """frames: with their stamps; lines: of the journal, its headers too.

        None: of a log alone, which may have been stamped by any clock.
        """
        self.replayed, self._frames, self._alone = Replayed(), frames, lines is None
        of_companions = groupby(lines or (), lambda line: line.startswith(_HEADER))
        self._journals = iter([[*group] for is_header, group in of_companions if not is_header])
        """The entries of each companion; one that was killed at once has none."""
        self._entries = deque[bytes]()
        self._epoch_us: int | None = None
        """The stamp of vehicle time 0, by the first frame that is compared."""
        self._searches = False
        """Whether the next frame may be the first of a companion that begins again."""

    def begin(self, start: Start) -> None:
        """A companion begins, perhaps again: then the vehicle's clock may differ.

        What the one before has written last may be of no input: it was killed while it wrote.
        """
        replayed = self.replayed
        replayed.flown_by = "" if self._alone else start.companion
        replayed.of_no_input += len(self._entries)
        self._entries = deque(next(self._journals, ()))
        self._epoch_us, self._searches = None, replayed.starts > 0
        replayed.starts += 1

    def compare(self, output: Output) -> None:
        """Compare the output of one run with the next records."""
        frames = starmap(self._frame_differs, output.record)
        entries = () if self._alone else map(self._entry_differs, output.journal)
        self.replayed.difference = next(filter(None, chain(frames, entries)), None)

    def pass_over(self, frames: int) -> None:
        """Skip what the watchdog sent: so many frames, and one entry."""
        next(islice(self._frames, frames, frames), None)
        if self._entries:
            self._entries.popleft()

    def _entry_differs(self, entry: Told) -> Difference | None:
        if not self._entries:
            self.replayed.unrecorded += 1
            return None
        difference = first_difference(entry["t_s"], self._entries.popleft(), journal_line(entry))
        self.replayed.entries += difference is None
        return difference

    def _frame_differs(self, time_s: float, frame: bytes) -> Difference | None:
        if self._searches:
            self._search(frame)
        if (record := next(self._frames, None)) is None:
            self.replayed.unrecorded += 1
            return None
        stamp_us, recorded = record
        if (difference := first_difference(time_s, recorded, frame)) is not None:
            return difference
        epoch_us = stamp_us - round(time_s * 1e6)
        self._epoch_us = epoch_us if self._epoch_us is None else self._epoch_us
        if epoch_us != self._epoch_us and not self._alone:
            recorded_s = time_s + (epoch_us - self._epoch_us) * 1e-6
            return Difference(time_s, name_of(frame), "time", recorded_s, time_s)
        self.replayed.frames += 1
        return None

    def _search(self, frame: bytes) -> None:
        """Pass over what comes before a frame; nothing, if it does not come."""
        ahead, self._frames = tee(self._frames)
        passed = next((k for k, (_, other) in enumerate(ahead) if other == frame), 0)
        next(islice(self._frames, passed, passed), None)
        self.replayed.of_no_input += passed
        self._searches = False


def replay_of_folder(folder: Path, mission_of: MissionOf, *, plans: bool = True) -> Replay:
    """The replay of a run folder.  plans: they are computed again, too.

    InputError if the folder has no inputs, or of another version.
    """
    inputs, journal = InputsFile(folder / FILE), file_of_run(folder, "journal.jsonl").read_bytes()
    lines = journal[: journal.rfind(b"\n") + 1].splitlines(keepends=True)
    recorded = Recorded(_frames_of(file_of_run(folder, "flight.tlog")), lines)
    return Replay(_to_the_end(inputs, recorded.replayed), recorded, mission_of, plans=plans)


def _to_the_end(inputs: InputsFile, replayed: Replayed) -> Iterator[Input]:
    """All of them, and why they end there.  DamagedInputError: what follow are none."""
    yield from inputs
    torn = f"{inputs.torn_bytes:,} bytes"
    if inputs.is_damaged:
        raise DamagedInputError(f"{torn} that are no inputs")
    replayed.torn = f"{torn} of a record that is not whole" if inputs.torn_bytes else ""


def _frames_of(tlog: Path) -> Iterator[tuple[int, bytes]]:
    """The whole records of a log.  DamagedInputError: what follows are none."""
    records = Records(tlog)
    yield from records
    left = tlog.stat().st_size - records.end
    if left > LONGEST_RECORD and not is_hole(tlog, records.end):
        raise DamagedInputError(f"{left:,} bytes of {tlog.name} that are no frames")


# --- a telemetry log alone


def replay_of_log(
    path: Path, mission: Mission, *, seed: int, version: str, system_id: int | None = None
) -> Replay:
    """The replay of a flight's own log by itself.

    InputError if it is no log, has several vehicles and none is chosen, or no companion.
    """
    wanted = system_id or mission.system_id
    open_log(path, system_id=wanted)
    if not any(_is_of_companion(frame) for _, frame in Records(path)):
        rule = "nothing in it was sent by a companion: there is nothing to compare with"
        remedy = "Give --shadow to see what it would have done."
        raise InputError("RUN_DIR|LOG", str(path), rule, remedy)
    flown, asked = replace(mission, system_id=wanted), dict[int, PlanRequest]()
    session = Session(flown, seed=seed, lockstep=True, version=version)
    recorded = Recorded(_frames_of(path), lines=None)
    inputs = chain(session.take_output().inputs, _inputs_of(path, asked, recorded.replayed))
    return Replay(inputs, recorded, lambda _: mission, asked=asked)


def _inputs_of(path: Path, asked: dict[int, PlanRequest], replayed: Replayed) -> Iterator[Input]:
    """Each frame of others by itself, and at once the answer to what was asked."""
    for time_us, frame in Records(path):
        if _is_of_companion(frame):
            continue
        yield "receive", frame, time_us * 1e-6
        yield ("run",)
        while asked:
            replayed.plans_computed += 1
            yield "deliver", values_of(plan(asked.popitem()[1]))
            yield ("run",)
    yield ("farewell",)


def _is_of_companion(frame: bytes) -> bool:
    return sender_of(frame)[1] == COMPANION_COMPONENT
