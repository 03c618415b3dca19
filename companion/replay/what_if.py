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
from companion.planner.request import Backtrack, NotPlanned, PlanOutcome, PlanRequest
from companion.planner.rules import newly_broken
from companion.planner.settings import Task
from companion.planning import plan
from companion.replay.feed import MissionOf, answer_of, outputs


@final
class Figures(Struct, frozen=True, kw_only=True):
    """The figures of one answer."""

    cost: float | None = None
    """Eq. 5; None: there is no subpath."""
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
class WhatIf(Struct, frozen=True, kw_only=True):
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
) -> Iterator[WhatIf]:
    """Each subpath of a flight, planned again.

    mission_of: the mission as flown; changed: the same with other settings; seed: another one.
    InputError if the folder holds no inputs, or if with the settings of that moment the changed
    ones break a rule.  It ends with the recording, or where the inputs can no longer be replayed.
    """
    asked: dict[int, tuple[float, PlanRequest]] = {}
    for told, session, output in outputs(folder, mission_of):
        if output is not None and output.plan is not None:
            asked[output.plan.plan_id] = session.now_s, output.plan
        if told[0] != "deliver":
            continue
        recorded = answer_of(told)
        time_s, request = asked.pop(recorded.plan_id, (0.0, None))
        if request is None or request.flown is not None:
            continue
        other = replace(
            request,
            task=with_changes(request.task, session.mission.task, changed.task),
            seed=request.seed if seed is None else seed,
        )
        if (error := newly_broken(request.task, other.task, other.target_ne_m)) is not None:
            raise error
        again = plan(other)
        yield WhatIf(
            plan_id=recorded.plan_id,
            t_s=time_s,
            flown=Figures.of(recorded, request.task.limits.speed_m_s),
            now=Figures.of(again, other.task.limits.speed_m_s),
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


# --- for people


def what_if_table(found: Sequence[WhatIf]) -> RenderableType:
    """Table of subpaths, as flown -> with the changed settings; below, both sums."""
    table = Table()
    for heading in ("plan", "at", "cost", "clearance", "length", "time"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("terms that differ")
    for each in found:
        both = zip(_cells(each.flown), _cells(each.now), strict=True)
        cells = (was if was == now else f"{was} -> {now}" for was, now in both)
        terms = _terms(each.flown.terms, each.now.terms)
        table.add_row(f"{each.plan_id}", f"{each.t_s:,.0f} s", *cells, terms)
    there = [(each.flown.cost is not None, each.now.cost is not None) for each in found]
    both_there = [each for each, both in zip(found, there, strict=True) if all(both)]
    lines = [
        f"{len(both_there)} subpaths as flown: {_sums([each.flown for each in both_there])}",
        f"now: {_sums([each.now for each in both_there])}",
    ]
    lost, gained = there.count((True, False)), there.count((False, True))
    if lost or gained:
        lines.append(f"{lost} that were flown would not be found; {gained} the other way round")
    return Group(table, *map(Text, lines))


def _cells(figures: Figures) -> list[str]:
    """Cost or why there is none, clearance, length and time of an answer."""
    length_km = None if figures.length_m is None else figures.length_m / 1000.0
    cells = {
        "{:.2f}": figures.cost,
        "{:,.0f} m": figures.clearance_m,
        "{:,.2f} km": length_km,
        "{:,.0f} s": figures.time_s,
    }
    told = ["-" if value is None else form.format(value) for form, value in cells.items()]
    return [figures.refusal.lower().replace("_", " ") or told[0], *told[1:]]


def _terms(was: dict[str, float], now: dict[str, float]) -> str:
    pairs = ((name, was.get(name, 0.0), now.get(name, 0.0)) for name in dict.fromkeys((*was, *now)))
    shown = ((name, f"{old:.2f}", f"{new:.2f}") for name, old, new in pairs)
    return ", ".join(f"{name} {old} -> {new}" for name, old, new in shown if old != new)


def _sums(figures: Sequence[Figures]) -> str:
    cost = sum(each.cost or 0.0 for each in figures)
    length_m = sum(each.length_m or 0.0 for each in figures)
    least_m = min((each.clearance_m or 0.0 for each in figures), default=0.0)
    return f"cost {cost:.2f}, {length_m / 1000:,.2f} km, least proven clearance {least_m:,.0f} m"
