"""The same flight, the same decisions: what was told, told again, and what follows compared.

The plans that were recorded are what the machine flies by, whatever computes them now: so its
decisions can be compared on any machine.  Each is computed again beside it, and compared too; on
another kernel than the flight's, or in other arithmetic, it may differ: that is no difference.
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
from companion.replay.told import (
    OUTSIDE,
    TOLD,
    MissionOf,
    Raised,
    TornError,
    answer_of,
    session_of,
    start_of,
    tell,
)
from companion.session import Session
from companion.telemetry import inputs
from companion.telemetry.inputs import InputsFile

REMEMBERED: Final = 12  # inputs before a difference
_BEGUN_AGAIN_S: Final = 10.0  # earlier: the autopilot has rebooted, or another one was taken


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PlanDiffers:
    """A plan that came out otherwise."""

    plan_id: int
    time_s: float
    field: str
    recorded: Any
    replayed: Any
    words: str
    """How far apart the two are."""
    kernels: tuple[str, str]
    """What computed the recorded one, and this one."""

    @property
    def is_excused(self) -> bool:
        """Whether two kernels are behind it, which may differ in the last bits."""
        return self.kernels[0] != self.kernels[1]

    def __str__(self) -> str:
        by = f" ({self.kernels[0]}, now {self.kernels[1]})" if self.is_excused else ""
        first = f"first {self.field}: recorded {self.recorded!r}, computed {self.replayed!r}"
        return f"t {self.time_s:.3f} s: plan {self.plan_id}{by}: {self.words}; {first}"


@final
@dataclass(slots=True, kw_only=True)
class Replayed:
    """What a replay has shown so far."""

    difference: Difference | None = None
    """The first one."""
    plans_differ: list[PlanDiffers] = field(default_factory=list)
    starts: int = 0
    """How often the companion was started."""
    told: int = 0
    frames: int = 0
    """Frames, both ways, that were the same."""
    entries: int = 0
    unrecorded: int = 0
    """Frames and entries that came out after the end of what was recorded."""
    torn: str = ""
    """Why it ended before the end of the file."""
    plans: int = 0
    plans_computed: int = 0
    ended_by: Raised | None = None
    """The error with which the flight's deciding part ended, if it did."""
    damaged: str = ""
    """What in the recording is nothing that a session is told; nothing after it was replayed."""
    began_s: float | None = None
    """Vehicle time of the first input that told it."""
    now_s: float = 0.0
    flown_s: float = 0.0
    """How much of the flight was replayed, vehicle time; it goes on when that begins again."""
    took_s: float = 0.0
    _newest_s: float = 0.0

    def go_on_to(self, now_s: float) -> None:
        """It is so late now, vehicle time."""
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
        """Whether all decisions and plans were the recorded ones, and there were any."""
        same = self.difference is None and all(each.is_excused for each in self.plans_differ)
        return same and self.compared > 0 and not self.damaged


@final
@dataclass(slots=True, kw_only=True)
class Step:
    """One input, what followed from it, and the session after it."""

    told: Input
    output: Output | None
    session: Session


@final
class Replay:
    """Feeds the inputs of a run folder to sessions like those that flew."""

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
        self.told = InputsFile(folder / inputs.FILE)
        self._recording = Recording(folder) if compares else None
        self._mission_of, self._kernel, self._from_s = mission_of, kernel, from_s
        self._session: Session | None = None
        self._asked: dict[int, PlanRequest] = {}
        self._raised: Raised | None = None
        """What the session has just raised, until it is known whether it did so in flight."""
        self._given: Output | None = None
        """Of the last run, until it is known what of it was sent."""
        self._before: deque[tuple[float, Input]] = deque(maxlen=REMEMBERED)

    def steps(self) -> Iterator[Step]:
        """Replay, input by input, until the first difference or the end."""
        began_s = time.perf_counter()
        try:
            for told in self.told:
                self.found.took_s = time.perf_counter() - began_s
                if told[0] not in OUTSIDE:
                    self._compare()
                if self.found.difference is not None:
                    return
                if (step := self._step(told)) is None:
                    return
                yield step
            self._compare()
        except TornError as error:
            self._compare()
            self.found.damaged = str(error)
        finally:
            if self._recording is not None:
                self._recording.close()
        if self.told.is_damaged:
            self.found.damaged = f"{self.told.torn_bytes:,} bytes that are no inputs"
        elif self.told.torn_bytes:
            self.found.torn = f"{self.told.torn_bytes} bytes of a record that is not whole"
        self.found.took_s = time.perf_counter() - began_s

    def _step(self, told: Input) -> Step | None:
        output = None
        self.found.told += 1
        match told:
            case ("start", *_):
                if not self._begin(start_of(told)):
                    return None
            case ("unsent", list(numbers)):
                self._leave_out(numbers)
            case ("raised", str(call), str(error)):
                self._hold_against(Raised(call=call, error=error))
            case ("held", int(frames)):
                self._compare()
                if self._recording is not None:
                    self._recording.pass_over(frames)
            case _:
                output = self._tell(told)
        if self._session is None:
            raise TornError(f"{told[0]!r} before any start")
        self._before.append((self._session.now_s, told))
        return Step(told=told, output=output, session=self._session)

    def _tell(self, told: Input) -> Output | None:
        session, found = self._session, self.found
        if session is None:
            return None
        if told[0] == "deliver" and len(told) > 1:
            self._plan_again(answer_of(told[1]), session.now_s)
        try:
            output = tell(session, told)
        except TornError:
            raise
        except Exception as error:  # noqa: BLE001 - the session's own: the flight's end, perhaps
            output, self._raised = session.taken(), Raised.of(told[0], error)
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
                raise TornError("numbers of frames that are none")
            there = range(len(self._given.frames))  # else it has sent fewer: that will differ
            self._given.leave_out(number for number in numbers if number in there)

    def _begin(self, start: Start) -> bool:
        """A session like that; whether there is one, if it raises nothing."""
        self._asked.clear()
        try:
            self._session = session_of(start, self._mission_of)
        except (TornError, InputError):
            raise
        except Exception as error:  # noqa: BLE001 - its own
            self._raised = Raised.of("start", error)
            self._compare()
            return False
        if self._recording is not None:
            self._recording.begin_again()
        self.found.starts += 1
        return True

    def _hold_against(self, ended: Raised) -> None:
        """The flight ended with an error there: so does the replay."""
        self._compare_output()
        raised, self._raised = self._raised, None
        again = raised is not None and (raised.call, raised.error) == (ended.call, ended.error)
        self.found.ended_by = raised if again else ended
        if not again and (raised is not None or ended.call in TOLD):
            self._differ_in_error(ended, raised)

    def _differ_in_error(self, ended: Raised | None, raised: Raised | None) -> None:
        call = (ended or raised or Raised(call="", error="")).call
        self.found.difference = self.found.difference or Difference(
            time_s=self.found.now_s,
            what=call or "flight",
            field="error",
            recorded=NOTHING if ended is None else str(ended),
            replayed=NOTHING if raised is None else str(raised),
            before=tuple(map(in_words, self._before)),
        )

    def _compare(self) -> None:
        """Hold what the last input led to against what was recorded."""
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
        """Compute a plan once more; it is not flown by."""
        self.found.plans += 1
        request = self._asked.pop(answer.plan_id, None)
        if request is None or self._kernel is None:
            return
        self.found.plans_computed += 1
        values, stopped_after = values_of(answer), getattr(answer, "stopped_after", None)
        name = self._kernel.signature
        try:
            again = values_of(computed_again(request, stopped_after, self._kernel))
        except Exception as error:  # noqa: BLE001 - the planner's own: in flight it had an answer
            words = "it cannot be computed"
            differs = "error", NOTHING, f"{type(error).__name__}: {error}"
            self._plan_differs(answer, now_s, differs, words, (name, name))
            return
        found = values_differ({**values, "kernel": None}, {**again, "kernel": None})
        if found is not None:
            kernels = str(values.get("kernel", name)), name
            self._plan_differs(answer, now_s, found, _apart(values, again), kernels)

    def _plan_differs(
        self,
        answer: PlanOutcome,
        time_s: float,
        where: tuple[str, Any, Any],
        words: str,
        kernels: tuple[str, str],
    ) -> None:
        name, was, now = where
        self.found.plans_differ.append(
            PlanDiffers(
                plan_id=answer.plan_id,
                time_s=time_s,
                field=name,
                recorded=was,
                replayed=now,
                words=words,
                kernels=kernels,
            )
        )


def computed_again(request: PlanRequest, stopped_after: int | None, kernel: Kernel) -> PlanOutcome:
    """The answer to a request, given as much time as the recorded one had.

    stopped_after: how often that search was allowed to go on; None: to its end.
    """
    asked = 0

    def stop() -> bool:
        nonlocal asked
        asked += 1
        return stopped_after is not None and asked > stopped_after

    return plan(request, stop, kernel)


def _apart(recorded: dict[str, Any], computed: dict[str, Any]) -> str:
    """How far two answers are apart, for people."""
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
    """An input, for people."""
    now_s, told = event
    if told[0] == "receive":
        names = [str(message.get_type()) for message in Receiver().feed(told[1])]
        what = "heard " + (", ".join(names) or "nothing")
    elif told[0] == "deliver":
        what = f"plan {told[1].get('plan_id')} came" if isinstance(told[1], dict) else "a plan came"
    elif told[0] == "start":
        what = "the companion was started"
    else:
        what = " ".join([told[0].replace("_", " "), *map(str, told[1:])])
    return f"t {now_s:.3f} s  {what}"
