"""What-if: each subpath planned again from its recorded state, under other settings.

Nothing is flown: each plan starts where the recorded one started, with the same known map.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import final

from msgspec import Struct
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from companion.mission.mission import Mission
from companion.planner.request import NotPlanned, Planned, PlanOutcome, PlanRequest
from companion.planner.rules import newly_broken
from companion.planner.settings import Task
from companion.planning import plan
from companion.replay.feed import MissionOf, arguments_of, outputs
from companion.views.words import metres_at_least


@final
class Figures(Struct, frozen=True):
    """The figures of one answer; those of a subpath are None if there is none."""

    cost: float | None = None
    """Eq. 5."""
    terms: dict[str, float] = {}
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
        if isinstance(outcome, Planned):
            length_m, clearance_m = outcome.subpath.length_m, outcome.certificate.clearance_m
            time_s = length_m / speed_m_s
            return Figures(outcome.cost, outcome.terms, clearance_m, length_m, time_s)
        return Figures(refusal=outcome.refusal.name if isinstance(outcome, NotPlanned) else "")

    def cells(self) -> list[str]:
        """Cost or why there is none, clearance, length and time, for people."""
        if self.cost is None or self.length_m is None:
            return [self.refusal.lower().replace("_", " ") or "-", "-", "-", "-"]
        clearance = metres_at_least(self.clearance_m or 0.0)
        length, time = f"{self.length_m / 1000.0:,.2f} km", f"{self.time_s:,.0f} s"
        return [f"{self.cost:.2f}", clearance, length, time]


@final
class WhatIf(Struct, frozen=True, kw_only=True):
    """A subpath as flown, and with the changed settings."""

    plan_id: int
    t_s: float
    """When it was asked for, vehicle time."""
    flown: Figures
    now: Figures


def what_if(
    folder: Path, mission_of: MissionOf, changed: Mission, *, seed: int | None
) -> Iterator[WhatIf]:
    """Each subpath of a flight, planned again.

    mission_of: the mission as flown; changed: the same with other settings; seed: another one.
    InputError if the folder holds no inputs, or if with the settings of that moment the changed
    ones break a rule.  It ends with the recording, or where the inputs can no longer be replayed.
    """
    asked: dict[int, tuple[float, PlanRequest]] = {}
    for call, session, output in outputs(folder, mission_of):
        if output is not None and output.plan is not None:
            asked[output.plan.plan_id] = session.now_s, output.plan
        if call[0] != "deliver":
            continue
        [recorded] = arguments_of(call)
        time_s, request = asked.pop(recorded.plan_id, (0.0, None))
        if request is None or request.flown is not None:
            continue
        task = with_changes(request.task, session.mission.task, changed.task)
        other = replace(request, task=task, seed=request.seed if seed is None else seed)
        if (error := newly_broken(request.task, task, other.target_ne_m)) is not None:
            raise error
        yield WhatIf(
            plan_id=recorded.plan_id,
            t_s=time_s,
            flown=Figures.of(recorded, request.task.limits.speed_m_s),
            now=Figures.of(plan(other), task.limits.speed_m_s),
        )


def with_changes(task: Task, before: Task, after: Task) -> Task:
    """A task of a flight with what has changed between two tasks of its mission.

    The rest is as it was at that moment: what a fence of the vehicle says of zones and limits.
    """
    zones, limits = task.zones, asdict(after.limits)
    if before.zones != after.zones:
        zones = (*after.zones, *(zone for zone in task.zones if zone not in before.zones))
    changed = {
        name: limits[name] for name, was in asdict(before.limits).items() if was != limits[name]
    }
    return replace(
        task,
        limits=replace(task.limits, **changed),
        settings=after.settings,
        radars=task.radars if before.radars == after.radars else after.radars,
        zones=zones,
    )


def what_if_table(plans: Sequence[WhatIf]) -> RenderableType:
    """Table of subpaths, as flown -> with the changed settings; below, both sums."""
    table = Table()
    for heading in ("plan", "at", "cost", "clearance", "length", "time"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("terms that differ")
    for one in plans:
        pairs = zip(one.flown.cells(), one.now.cells(), strict=True)
        cells = (was if was == now else f"{was} -> {now}" for was, now in pairs)
        terms = []
        for name in dict.fromkeys((*one.flown.terms, *one.now.terms)):
            was, now = (f"{side.terms.get(name, 0.0):.2f}" for side in (one.flown, one.now))
            terms += [f"{name} {was} -> {now}"] if was != now else []
        table.add_row(f"{one.plan_id}", f"{one.t_s:,.0f} s", *cells, ", ".join(terms))
    both = [one for one in plans if None not in (one.flown.cost, one.now.cost)]
    return Group(
        table,
        Text(f"{len(both)} whole subpaths, then: {_sums([one.flown for one in both])}"),
        Text(f"now: {_sums([one.now for one in both])}"),
    )


def _sums(figures: Sequence[Figures]) -> str:
    cost = sum(one.cost or 0.0 for one in figures)
    length_m = sum(one.length_m or 0.0 for one in figures)
    least = metres_at_least(min((one.clearance_m or 0.0 for one in figures), default=0.0))
    return f"cost {cost:.2f}, {length_m / 1000:,.2f} km, least proven clearance {least}"
