"""The report of a replay, as text."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from companion.replay.reproduce import Replayed
from companion.replay.what_if import Figures, WhatIf

_MAX_PLANS = 5
_LATE_S = 10.0
"""A flight that begins later by the vehicle's clock has other times than seconds of the flight."""


def replay_text(found: Replayed) -> list[str]:
    """Report of a replay, line by line."""
    speed = f", {found.flown_s / found.took_s:,.0f}x real time" if found.took_s > 0.0 else ""
    lines = []
    if found.difference is not None:
        lines += [f"first difference at {found.difference}"]
        if found.difference.before:
            lines += ["what led there:", *(f"  {line}" for line in found.difference.before)]
    counted = f"{found.frames:,} frames, {found.entries:,} journal entries"
    if found.plans_computed:
        same = found.plans_computed - len(found.plans_differ)
        counted += f", {same} of {found.plans_computed} plans computed again"
    elif found.plans:
        counted += f"; {found.plans} plans taken as recorded"
    begun = (
        f" from vehicle time {found.began_s:,.1f} s" if (found.began_s or 0.0) >= _LATE_S else ""
    )
    lines.append(f"the same: {counted} ({found.flown_s:,.1f} s of flight{begun}{speed})")
    if found.compared and not found.frames:
        lines.append("no frame was compared: flight.tlog holds none")
    if found.starts > 1:
        lines.append(f"the companion was started {found.starts} times")
    lines += [str(each) for each in found.plans_differ[:_MAX_PLANS]]
    if (more := len(found.plans_differ) - _MAX_PLANS) > 0:
        lines.append(f"{more} more plans differ")
    if found.unrecorded:
        lines.append(f"{found.unrecorded} frames and entries came after the end of the recording")
    if found.ended_by is not None:
        lines.append(f"the flight ended with an error of the companion's: {found.ended_by}")
    if found.torn:
        lines.append(f"the recording ends early: {found.torn}")
    if found.damaged:
        lines.append(f"the recording is damaged from there on: {found.damaged}")
    return [*lines, _verdict(found)]


def _verdict(found: Replayed) -> str:
    if found.is_identical:
        return "identical"
    if found.difference is not None or not all(each.is_excused for each in found.plans_differ):
        return "not identical"
    return "identical up to there" if found.compared else "nothing was compared"


def replay_json(found: Replayed) -> dict[str, Any]:
    """Report of a replay for a JSON file."""
    names = [each.name for each in fields(found) if each.name not in ("_newest_s", "ended_by")]
    ended_by = None if found.ended_by is None else found.ended_by.error
    values = {name: getattr(found, name) for name in names}
    return {"identical": found.is_identical, "ended_by": ended_by, **values}


def what_if_table(found: Sequence[WhatIf]) -> RenderableType:
    """Table of subpaths, as flown -> with the changed settings; below, both sums."""
    table = Table()
    for heading in ("plan", "at", "cost", "clearance", "length", "time"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("terms that differ")
    for each in found:
        flown, now = each.flown, each.now
        table.add_row(
            f"{each.plan_id}",
            f"{each.t_s:,.0f} s",
            _both(flown.cost, now.cost, "{:.2f}", flown.refusal, now.refusal),
            _both(flown.clearance_m, now.clearance_m, "{:,.0f} m"),
            _both(_km(flown.length_m), _km(now.length_m), "{:,.2f} km"),
            _both(flown.time_s, now.time_s, "{:,.0f} s"),
            _terms(flown.terms, now.terms),
        )
    both = [each for each in found if each.flown.cost is not None and each.now.cost is not None]
    flown_sum, now_sum = _sums([each.flown for each in both]), _sums([each.now for each in both])
    lost = sum(1 for each in found if each.flown.cost is not None and each.now.cost is None)
    gained = sum(1 for each in found if each.flown.cost is None and each.now.cost is not None)
    lines = [f"{len(both)} subpaths as flown: {flown_sum}", f"now: {now_sum}"]
    if lost or gained:
        lines.append(f"{lost} that were flown would not be found; {gained} the other way round")
    return Group(table, *(Text(line) for line in lines))


def _both(was: float | None, now: float | None, form: str, *why: str) -> str:
    """Both values, or one if they are shown alike."""
    texts = ["-" if value is None else form.format(value) for value in (was, now)]
    for place, refusal in enumerate(why):
        if refusal:
            texts[place] = refusal.lower().replace("_", " ")
    return texts[0] if texts[0] == texts[1] else " -> ".join(texts)


def _km(length_m: float | None) -> float | None:
    return None if length_m is None else length_m / 1000.0


def _terms(was: dict[str, float], now: dict[str, float]) -> str:
    pairs = ((name, was.get(name, 0.0), now.get(name, 0.0)) for name in dict.fromkeys((*was, *now)))
    shown = ((name, f"{old:.2f}", f"{new:.2f}") for name, old, new in pairs)
    return ", ".join(f"{name} {old} -> {new}" for name, old, new in shown if old != new)


def _sums(figures: Sequence[Figures]) -> str:
    cost = sum(each.cost or 0.0 for each in figures)
    length_m = sum(each.length_m or 0.0 for each in figures)
    least_m = min((each.clearance_m or 0.0 for each in figures), default=0.0)
    return f"cost {cost:.2f}, {length_m / 1000:,.2f} km, least proven clearance {least_m:,.0f} m"
