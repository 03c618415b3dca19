"""The same flight, the same decisions: what was told, told again, and what follows compared.

The plans that were recorded are what the machine flies by, whatever computes them now: so its
decisions can be compared on any machine.  Each is computed again beside it, and compared too; on
another kernel than the flight's it may differ in its last bits, and then that is no difference.
"""

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from companion.mavlink.outbox import Input, Output
from companion.mavlink.receiver import Receiver
from companion.mission.renewed import replace
from companion.planner.kernels import Kernel
from companion.planner.outcomes import values_of
from companion.planner.plan import plan
from companion.planner.request import PlanOutcome, PlanRequest
from companion.replay.differences import Difference, Recording, values_differ
from companion.replay.told import OUTSIDE, MissionOf, TornError, session_of, start_of, tell
from companion.session import Session
from companion.telemetry import inputs
from companion.telemetry.inputs import InputsFile

_REMEMBERED: Final = 12  # inputs before a difference


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
    began_s: float | None = None
    """Vehicle time of the first input that told it."""
    now_s: float = 0.0
    took_s: float = 0.0

    @property
    def flown_s(self) -> float:
        """How much of the flight was replayed, vehicle time."""
        return 0.0 if self.began_s is None else self.now_s - self.began_s

    @property
    def is_identical(self) -> bool:
        """Whether all decisions and plans were the recorded ones."""
        return self.difference is None and all(each.is_excused for each in self.plans_differ)


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

        from_s: vehicle time before which nothing is compared; compares: False if nothing is at
        all.  InputError if the folder has no inputs, or of another version.
        """
        self.found = Replayed()
        self.told = InputsFile(folder / inputs.FILE)
        self._recording = Recording(folder) if compares else None
        self._mission_of, self._kernel, self._from_s = mission_of, kernel, from_s
        self._session: Session | None = None
        self._asked: dict[int, PlanRequest] = {}
        self._given: Output | None = None
        """Of the last run, until it is known what of it was sent."""
        self._before: deque[tuple[float, Input]] = deque(maxlen=_REMEMBERED)

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
                yield self._step(told)
            self._compare()
        except TornError as error:
            self._compare()
            self.found.torn = str(error)
        finally:
            if self._recording is not None:
                self._recording.close()
        if self.told.torn_bytes and not self.found.torn:
            self.found.torn = f"{self.told.torn_bytes} bytes of a record that is not whole"
        self.found.took_s = time.perf_counter() - began_s

    def _step(self, told: Input) -> Step:
        output = None
        self.found.told += 1
        match told:
            case ("start", *_):
                self._session = session_of(start_of(told), self._mission_of)
                self._asked.clear()
                if self._recording is not None:
                    self._recording.begin_again()
                self.found.starts += 1
            case ("unsent", list(numbers)):
                if self._given is not None:
                    self._given.leave_out(numbers)
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
        if told[0] == "deliver":
            self._plan_again(told[1], session.now_s)
        output = tell(session, told)
        if output is not None:
            self._given = output
            if output.plan is not None:
                self._asked[output.plan.plan_id] = output.plan
        found.now_s = session.now_s
        if found.began_s is None and found.now_s > 0.0:
            found.began_s = found.now_s
        return output

    def _compare(self) -> None:
        """Hold what the last run gave against what was recorded."""
        given, self._given = self._given, None
        recording, found = self._recording, self.found
        if given is None or recording is None:
            return
        difference = recording.first_difference(given.record, given.journal)
        found.frames, found.entries = recording.frames, recording.entries
        found.unrecorded = recording.unrecorded
        if difference is not None and difference.time_s >= self._from_s:
            found.difference = replace(difference, before=tuple(map(_in_words, self._before)))

    def _plan_again(self, values: Any, now_s: float) -> None:
        """Compute a plan once more; it is not flown by."""
        self.found.plans += 1
        plan_id = values.get("plan_id") if isinstance(values, dict) else None
        request = None if not isinstance(plan_id, int) else self._asked.pop(plan_id, None)
        if request is None or self._kernel is None:
            return
        self.found.plans_computed += 1
        again = computed_again(request, values.get("stopped_after"), self._kernel)
        kernels = str(values.get("kernel", self._kernel.name)), self._kernel.name
        differs = values_differ({**values, "kernel": None}, {**_plain(again), "kernel": None})
        if differs is not None:
            where, was, now = differs
            self.found.plans_differ.append(
                PlanDiffers(
                    plan_id=request.plan_id,
                    time_s=now_s,
                    field=where,
                    recorded=was,
                    replayed=now,
                    words=_apart(values, _plain(again)),
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


def _plain(outcome: PlanOutcome) -> dict[str, Any]:
    """As it is read back from a file: lists instead of tuples."""
    values = values_of(outcome)
    if isinstance(values.get("certificate"), dict):
        certificate = values["certificate"]
        values["certificate"] = {**certificate, "broken": list(certificate["broken"])}
    return values


def _in_words(event: tuple[float, Input]) -> str:
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
