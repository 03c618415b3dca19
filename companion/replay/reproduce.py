"""Replays the recorded inputs of a flight and compares all decisions.

The mission machine uses the recorded plans, so its decisions can be compared on any computer.  Each
plan is also computed again and compared; with another kernel than the flight's, or other
arithmetic, it may differ, which does not count as a difference.
"""

import time
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any, final

import numpy as np
from msgspec import Struct

from companion.errors import InputError
from companion.mavlink.link import Input, Output
from companion.mission.start import Start
from companion.planner import kernels
from companion.planner.request import PlanOutcome, PlanRequest, values_of
from companion.planning import plan
from companion.replay.differences import NOTHING, Difference, Recording, values_differ
from companion.replay.report import PlanDiffers, Replayed
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


@final
class Step(Struct, kw_only=True):
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
        plans: bool = True,
        compares: bool = True,
    ) -> None:
        """plans: they are computed again, too; False: they are taken as recorded.

        compares: False if nothing is compared.  InputError if the folder has no inputs, or of
        another version.
        """
        self.found = Replayed()
        self.inputs = InputsFile(folder / inputs.FILE)
        self._recording = Recording(folder) if compares else None
        self._mission_of, self._plans = mission_of, plans
        self._session: Session | None = None
        self._asked: dict[int, PlanRequest] = {}
        self._raised: RecordedError | None = None
        """What the session has just raised, until it is known whether it did so in flight."""
        self._given: Output | None = None
        """Of the last run, until it is known what of it was sent."""

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
            case ("unsent", list(numbers)) if all(type(each) is int for each in numbers):
                if self._given is not None:
                    there = range(len(self._given.frames))  # else it has sent fewer: that differs
                    self._given.leave_out(number for number in numbers if number in there)
            case ("raised", str(call), str(error)):
                self._compare(RecordedError(call=call, error=error))
            case ("held", int(frames)):
                self._compare()
                if self._recording is not None:
                    self._recording.pass_over(frames)
            case _:
                output = self._tell(recorded_input)
        if self._session is None:
            raise DamagedInputError(f"{recorded_input[0]!r} before any start")
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

    def _compare(self, ended: RecordedError | None = None) -> None:
        """Compare what came of the last input with the recording.

        ended: the error that the flight ended with here; then the replay must, too.
        """
        self._compare_output()
        found, raised, self._raised = self.found, self._raised, None
        if raised and ended and (raised.call, raised.error) == (ended.call, ended.error):
            found.ended_by = raised
            return
        found.ended_by, last = ended or found.ended_by, ended or raised
        if last is not None and (raised is not None or last.call in SESSION_CALLS):
            found.difference = found.difference or Difference(
                t_s=found.now_s,
                what=last.call or "flight",
                field="error",
                recorded=NOTHING if ended is None else str(ended),
                replayed=NOTHING if raised is None else str(raised),
            )

    def _compare_output(self) -> None:
        given, self._given = self._given, None
        recording, found = self._recording, self.found
        if given is None or recording is None:
            return
        found.difference = recording.first_difference(given.record, given.journal)
        found.frames, found.entries = recording.frames, recording.entries
        found.unrecorded = recording.unrecorded

    def _plan_again(self, answer: PlanOutcome, now_s: float) -> None:
        """Compute a plan again, only to compare it."""
        self.found.plans += 1
        request = self._asked.pop(answer.plan_id, None)
        if request is None or not self._plans:
            return
        self.found.plans_computed += 1
        values, stopped_after = values_of(answer), getattr(answer, "stopped_after", None)
        name = kernels.signature()
        by = str(values.get("kernel", name)), name
        where: tuple[str, Any, Any] | None
        try:
            again = values_of(computed_again(request, stopped_after))
        except Exception as error:  # noqa: BLE001 - the planner's own: in flight it had an answer
            where, by = ("error", NOTHING, f"{type(error).__name__}: {error}"), (name, name)
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
                    kernels=by,
                )
            )


def computed_again(request: PlanRequest, stopped_after: int | None) -> PlanOutcome:
    """The answer to a request, with the search budget of the recorded one.

    stopped_after: how often that search was allowed to go on; None: to its end.
    """
    asked = count(1)
    return plan(request, lambda: stopped_after is not None and next(asked) > stopped_after)


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
