"""What-if: each subpath planned again from its recorded state, under other settings.

Nothing is flown: each plan starts where the recorded one started, with the same known map.
"""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar, final

from companion.mission.mission import Mission
from companion.planner.kernels import Kernel
from companion.planner.outcomes import outcome_of
from companion.planner.plan import plan
from companion.planner.request import Backtrack, NotPlanned, PlanOutcome, PlanRequest
from companion.planner.rules import newly_broken
from companion.planner.settings import Task
from companion.replay.reproduce import Replay
from companion.replay.session_inputs import MissionOf

_Part = TypeVar("_Part")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """The figures of one answer."""

    cost: float | None = None
    """Eq. 5; None: there is no subpath."""
    terms: dict[str, float] = field(default_factory=dict)
    """Of the cost, unweighted."""
    clearance_m: float | None = None
    """As proven."""
    length_m: float | None = None
    time_s: float | None = None
    """At V."""
    refusal: str = ""
    """Why there is none."""

    @staticmethod
    def of(outcome: PlanOutcome, speed_m_s: float) -> "Figures":
        """The figures of an answer."""
        if isinstance(outcome, Backtrack):
            return Figures()
        if isinstance(outcome, NotPlanned):
            return Figures(refusal=outcome.refusal.name)
        length_m = outcome.subpath.length_m
        return Figures(
            cost=outcome.cost,
            terms=outcome.terms,
            clearance_m=outcome.certificate.clearance_m,
            length_m=length_m,
            time_s=length_m / speed_m_s,
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class WhatIf:
    """A subpath as flown, and with the changed settings."""

    plan_id: int
    t_s: float
    """When it was asked for, vehicle time."""
    flown: Figures
    now: Figures


def what_if(
    folder: Path,
    mission_of: MissionOf,
    changed: Mission,
    *,
    seed: int | None,
    kernel: Kernel,
) -> Iterator[WhatIf]:
    """Each subpath of a flight, planned again.

    mission_of: the mission as flown; changed: the same with other settings; seed: another one.
    InputError if the folder holds no inputs, or if with the settings of that moment the changed
    ones break a rule.  It ends with the recording, or where the inputs can no longer be replayed.
    """
    replay = Replay(folder, mission_of, kernel=None, compares=False)
    asked: dict[int, tuple[float, PlanRequest]] = {}
    for step in replay.steps():
        session = step.session
        if step.output is not None and step.output.plan is not None:
            asked[step.output.plan.plan_id] = session.now_s, step.output.plan
        if step.recorded_input[0] != "deliver":
            continue
        recorded = outcome_of(step.recorded_input[1])
        time_s, request = asked.pop(recorded.plan_id, (0.0, None))
        if request is None or request.flown is not None:
            continue
        other = replace(
            request,
            task=with_changes(request.task, session.mission.task, changed.task),
            seed=request.seed if seed is None else seed,
        )
        if (error := newly_broken(request.task, other.task, (other.target_ne_m,))) is not None:
            raise error
        again = plan(other, kernel=kernel)
        yield WhatIf(
            plan_id=recorded.plan_id,
            t_s=time_s,
            flown=Figures.of(recorded, request.task.limits.speed_m_s),
            now=Figures.of(again, other.task.limits.speed_m_s),
        )


def with_changes(task: Task, before: Task, after: Task) -> Task:
    """A task of a flight with what has changed between two tasks of its mission.

    The rest is as it was at that moment: a fence of the vehicle, settings of a ground station.
    """
    zones = task.zones
    if before.zones != after.zones:
        zones = (*after.zones, *(zone for zone in task.zones if zone not in before.zones))
    return replace(
        task,
        limits=_with_changes(task.limits, before.limits, after.limits),
        settings=_with_changes(task.settings, before.settings, after.settings),
        radars=task.radars if before.radars == after.radars else after.radars,
        zones=zones,
    )


def _with_changes(value: _Part, before: _Part, after: _Part) -> _Part:
    fields = [each.name for each in dataclasses.fields(value) if each.init]  # type: ignore[arg-type]
    changes = {
        name: getattr(after, name)
        for name in fields
        if getattr(before, name) != getattr(after, name)
    }
    return dataclasses.replace(value, **changes)  # type: ignore[type-var]
