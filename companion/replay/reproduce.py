"""Replays the recorded inputs of a flight and compares all decisions.

The mission machine uses the recorded plans, so its decisions can be compared on any computer.  Each
plan is also computed again and compared; with another kernel than the flight's, or other
arithmetic, it may differ, which does not count as a difference.
"""

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from companion.errors import InputError
from companion.mavlink.frames import Receiver
from companion.mavlink.link import Input, Output
from companion.mission.start import Start
from companion.planner.kernels import Kernel
from companion.planner.outcomes import values_of
from companion.planner.plan import plan
from companion.planner.request import PlanOutcome, PlanRequest
from companion.replay.differences import NOTHING, Difference, Recording, values_differ
from companion.replay.session_inputs import (
    RUNTIME_RECORDS,
    SESSION_CALLS,
    DamagedInputError,
    MissionOf,
    RecordedError,
    answer_of,
    feed,
    session_of,
    start_of,
)
from companion.session import Session
from companion.telemetry import inputs
from companion.telemetry.inputs import InputsFile

REMEMBERED: Final = 12  # inputs before a difference
_BEGUN_AGAIN_S: Final = 10.0  # earlier: the autopilot has rebooted, or another one was taken


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PlanDiffers:
    """A plan that differs from the recorded one."""

    plan_id: int
    t_s: float
    field: str
    recorded: Any
    computed: Any
    words: str
    """How far apart the two are."""
    kernels: tuple[str, str]
    """What computed the recorded one, and this one."""

    @property
    def is_excused(self) -> bool:
        """Whether the kernels differ, so that the last bits may."""
        return self.kernels[0] != self.kernels[1]

    def __str__(self) -> str:
        by = f" ({self.kernels[0]}, now {self.kernels[1]})" if self.is_excused else ""
        first = f"first {self.field}: recorded {self.recorded!r}, computed {self.computed!r}"
        return f"t {self.t_s:.3f} s: plan {self.plan_id}{by}: {self.words}; {first}"


@final
@dataclass(slots=True, kw_only=True)
class Replayed:
    """The result of a replay so far."""

    difference: Difference | None = None
    """The first one."""
    plans_differ: list[PlanDiffers] = field(default_factory=list)
    starts: int = 0
    """How often the companion was started."""
    inputs: int = 0
    frames: int = 0
    """Frames, both ways, that were the same."""
    entries: int = 0
    unrecorded: int = 0
    """Frames and entries after the end of the recording."""
    torn: str = ""
    """Why it ended before the end of the file."""
    plans: int = 0
    plans_computed: int = 0
    ended_by: RecordedError | None = None
    """The error that ended the flight's control loop, if any."""
    damaged: str = ""
    """What in the recording is not a valid input; nothing after it was replayed."""
    began_s: float | None = None
    """Vehicle time of the first input that told it."""
    now_s: float = 0.0
    flown_s: float = 0.0
    """Duration replayed, vehicle time; continues across reboots."""
    took_s: float = 0.0
    _newest_s: float = 0.0

    def go_on_to(self, now_s: float) -> None:
        """Advance to this vehicle time."""
        self.now_s = now_s
        if self.began_s is None:
            if now_s <= 0.0:
                return
            self.began_s = self._newest_s = now_s
        if now_s > self._newest_s:
            self.flown_s += now_s - self._newest_s
            self._newest_s = now_s
        elif now_s < self._newest_s - _BEGUN_AGAIN_S:
            self._newest_s = now_s

    @property
    def compared(self) -> int:
        """How many frames and entries were the same."""
        return self.frames + self.entries

    @property
    def is_identical(self) -> bool:
        """Whether all decisions and plans equal the recorded ones, and there were any."""
        same = self.difference is None and all(each.is_excused for each in self.plans_differ)
        return same and self.compared > 0 and not self.damaged


@final
@dataclass(slots=True, kw_only=True)
class Step:
    """One input, its output, and the session after it."""

    recorded_input: Input
    output: Output | None
    session: Session


@final
class Replay:
    """Feeds the inputs of a run folder to equal sessions."""

    def __init__(
        self,
        folder: Path,
        mission_of: MissionOf,
        *,
        kernel: Kernel | None,
        from_s: float = 0.0,
        compares: bool = True,
    ) -> None:
        """kernel: computes the plans again; None: they are taken as recorded.

        from_s: seconds of the flight before which nothing is compared; compares: False if nothing
        is at all.  InputError if the folder has no inputs, or of another version.
        """
        self.found = Replayed()
        self.inputs = InputsFile(folder / inputs.FILE)
        self._recording = Recording(folder) if compares else None
        self._mission_of, self._kernel, self._from_s = mission_of, kernel, from_s
        self._session: Session | None = None
        self._asked: dict[int, PlanRequest] = {}
        self._raised: RecordedError | None = None
        """What the session has just raised, until it is known whether it did so in flight."""
        self._given: Output | None = None
        """Of the last run, until it is known what of it was sent."""
        self._before: deque[tuple[float, Input]] = deque(maxlen=REMEMBERED)

    def steps(self) -> Iterator[Step]:
        """Replay, input by input, until the first difference or the end."""
        began_s = time.perf_counter()
        try:
            for recorded_input in self.inputs:
                self.found.took_s = time.perf_counter() - began_s
                if recorded_input[0] not in RUNTIME_RECORDS:
                    self._compare()
                if self.found.difference is not None:
                    return
                if (step := self._step(recorded_input)) is None:
                    return
                yield step
            self._compare()
        except DamagedInputError as error:
            self._compare()
            self.found.damaged = str(error)
        finally:
            if self._recording is not None:
                self._recording.close()
        if self.inputs.is_damaged:
            self.found.damaged = f"{self.inputs.torn_bytes:,} bytes that are no inputs"
        elif self.inputs.torn_bytes:
            self.found.torn = f"{self.inputs.torn_bytes} bytes of a record that is not whole"
        self.found.took_s = time.perf_counter() - began_s

    def _step(self, recorded_input: Input) -> Step | None:
        output = None
        self.found.inputs += 1
        match recorded_input:
            case ("start", *_):
                if not self._begin(start_of(recorded_input)):
                    return None
            case ("unsent", list(numbers)):
                self._leave_out(numbers)
            case ("raised", str(call), str(error)):
                self._hold_against(RecordedError(call=call, error=error))
            case ("held", int(frames)):
                self._compare()
                if self._recording is not None:
                    self._recording.pass_over(frames)
            case _:
                output = self._tell(recorded_input)
        if self._session is None:
            raise DamagedInputError(f"{recorded_input[0]!r} before any start")
        self._before.append((self._session.now_s, recorded_input))
        return Step(recorded_input=recorded_input, output=output, session=self._session)

    def _tell(self, recorded_input: Input) -> Output | None:
        session, found = self._session, self.found
        if session is None:
            return None
        if recorded_input[0] == "deliver" and len(recorded_input) > 1:
            self._plan_again(answer_of(recorded_input[1]), session.now_s)
        try:
            output = feed(session, recorded_input)
        except DamagedInputError:
            raise
        except Exception as error:  # noqa: BLE001 - the session's own: the flight's end, perhaps
            output, self._raised = session.take_output(), RecordedError.of(recorded_input[0], error)
        if output is not None:
            self._given = output
            if output.plan is not None:
                self._asked[output.plan.plan_id] = output.plan
        found.go_on_to(session.now_s)
        return output

    def _leave_out(self, numbers: list[Any]) -> None:
        """Frames of the last run that were not sent."""
        if self._given is not None:
            if not all(type(each) is int for each in numbers):
                raise DamagedInputError("numbers of frames that are none")
            there = range(len(self._given.frames))  # else it has sent fewer: that will differ
            self._given.leave_out(number for number in numbers if number in there)

    def _begin(self, start: Start) -> bool:
        """Begin a session; whether that succeeded."""
        self._asked.clear()
        try:
            self._session = session_of(start, self._mission_of)
        except (DamagedInputError, InputError):
            raise
        except Exception as error:  # noqa: BLE001 - its own
            self._raised = RecordedError.of("start", error)
            self._compare()
            return False
        if self._recording is not None:
            self._recording.begin_again()
        self.found.starts += 1
        return True

    def _hold_against(self, ended: RecordedError) -> None:
        """The flight ended with an error here: the replay must, too."""
        self._compare_output()
        raised, self._raised = self._raised, None
        again = raised is not None and (raised.call, raised.error) == (ended.call, ended.error)
        self.found.ended_by = raised if again else ended
        if not again and (raised is not None or ended.call in SESSION_CALLS):
            self._differ_in_error(ended, raised)

    def _differ_in_error(self, ended: RecordedError | None, raised: RecordedError | None) -> None:
        call = (ended or raised or RecordedError(call="", error="")).call
        self.found.difference = self.found.difference or Difference(
            t_s=self.found.now_s,
            what=call or "flight",
            field="error",
            recorded=NOTHING if ended is None else str(ended),
            replayed=NOTHING if raised is None else str(raised),
            before=tuple(map(in_words, self._before)),
        )

    def _compare(self) -> None:
        """Compare the output of the last input with the recording."""
        self._compare_output()
        if self._raised is not None:
            self._differ_in_error(None, self._raised)

    def _compare_output(self) -> None:
        given, self._given = self._given, None
        recording, found = self._recording, self.found
        if given is None or recording is None:
            return
        if found.flown_s < self._from_s:
            recording.pass_by(given.record, given.journal)
            return
        difference = recording.first_difference(given.record, given.journal)
        found.frames, found.entries = recording.frames, recording.entries
        found.unrecorded = recording.unrecorded
        if difference is not None:
            found.difference = replace(difference, before=tuple(map(in_words, self._before)))

    def _plan_again(self, answer: PlanOutcome, now_s: float) -> None:
        """Compute a plan again, only to compare it."""
        self.found.plans += 1
        request = self._asked.pop(answer.plan_id, None)
        if request is None or self._kernel is None:
            return
        self.found.plans_computed += 1
        values, stopped_after = values_of(answer), getattr(answer, "stopped_after", None)
        name = self._kernel.signature
        kernels = str(values.get("kernel", name)), name
        where: tuple[str, Any, Any] | None
        try:
            again = values_of(computed_again(request, stopped_after, self._kernel))
        except Exception as error:  # noqa: BLE001 - the planner's own: in flight it had an answer
            where, kernels = ("error", NOTHING, f"{type(error).__name__}: {error}"), (name, name)
            words = "it cannot be computed"
        else:
            where = values_differ({**values, "kernel": None}, {**again, "kernel": None})
            words = "" if where is None else _apart(values, again)
        if where is not None:
            self.found.plans_differ.append(
                PlanDiffers(
                    plan_id=answer.plan_id,
                    t_s=now_s,
                    field=where[0],
                    recorded=where[1],
                    computed=where[2],
                    words=words,
                    kernels=kernels,
                )
            )


def computed_again(request: PlanRequest, stopped_after: int | None, kernel: Kernel) -> PlanOutcome:
    """The answer to a request, with the search budget of the recorded one.

    stopped_after: how often that search was allowed to go on; None: to its end.
    """
    asked = 0

    def stop() -> bool:
        nonlocal asked
        asked += 1
        return stopped_after is not None and asked > stopped_after

    return plan(request, stop, kernel)


def _apart(recorded: dict[str, Any], computed: dict[str, Any]) -> str:
    """The difference of two answers, as text."""
    if recorded["kind"] != computed["kind"]:
        return f"{recorded['kind']}, now {computed['kind']}"
    if recorded["kind"] != "planned":
        return str(recorded["kind"])
    costs = f"cost {recorded['cost']:.3f}, now {computed['cost']:.3f}"
    was, now = (np.asarray(each["control_nea_m"]) for each in (recorded, computed))
    if was.shape != now.shape:
        return f"{costs}, of {len(was)} control points, now {len(now)}"
    farthest_m = float(np.linalg.norm(was - now, axis=-1).max())
    apart = f"{farthest_m:,.0f}" if farthest_m >= 10.0 else f"{farthest_m:.2g}"
    return f"{costs}, control points up to {apart} m apart"


def in_words(event: tuple[float, Input]) -> str:
    """An input, as text."""
    now_s, recorded_input = event
    if recorded_input[0] == "receive":
        names = [str(message.get_type()) for message in Receiver().feed(recorded_input[1])]
        what = "heard " + (", ".join(names) or "nothing")
    elif recorded_input[0] == "deliver":
        what = (
            f"plan {recorded_input[1].get('plan_id')} came"
            if isinstance(recorded_input[1], dict)
            else "a plan came"
        )
    elif recorded_input[0] == "start":
        what = "the companion was started"
    else:
        what = " ".join([recorded_input[0].replace("_", " "), *map(str, recorded_input[1:])])
    return f"t {now_s:.3f} s  {what}"
