"""The report of shadow mode, as text and tables."""

from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from itertools import groupby
from typing import Final

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from companion.replay.shadow_report import (
    Hold,
    NearThings,
    Observed,
    Place,
    PlanAttempt,
    ShadowReport,
    TrackDeviation,
    VehicleReport,
)
from companion.world.near_map import Sight

_MAX_ROWS: Final = 30
_NEAR_S: Final = 60.0
_MAX_SAID: Final = 8
_MOMENT_S: Final = 1.0
_SHORT_REASONS: Final = 3


def renderables(report: ShadowReport) -> list[RenderableType]:
    """The report, part by part, in the order in which a person wants to know."""
    parts: list[RenderableType] = [Text(line) for line in _head(report)]
    if report.holds:
        parts.append(_holds(report))
    if report.health:
        parts.append(_observed("health", report.health, report))
    if report.outside:
        parts.append(_observed("where the mission does not allow it to be", report.outside, report))
    if report.plans:
        parts.append(_plans(report))
    parts += [Text(line) for line in _tail(report)]
    return parts


def _head(report: ShadowReport) -> list[str]:
    air = f", {report.in_air_s:,.0f} s of it in the air" if report.in_air_s else ""
    lines = [
        f"{report.file}: {report.vehicle}, system {report.system_id}; {_began(report)}"
        f"{report.length_s:,.1f} s{air}",
        "times: seconds after the log's first record; places: latitude, longitude, altitude AMSL",
    ]
    if report.mission is None:
        lines.append("no mission was given: only the vehicle's health was looked at")
    elif not report.planned:
        lines.append(f"mission {report.mission}: nothing was planned")
    else:
        lines.append(f"mission {report.mission}")
    if report.watched_from_s is None:
        lines.append("the companion would never have been ready")
    else:
        lines.append(f"ready, with a position to be believed, at {report.watched_from_s:,.1f} s")
        if not report.holds:
            lines.append("it would never have let go: the position could always be believed")
    return lines


def _began(report: ShadowReport) -> str:
    try:
        when = datetime.fromtimestamp(report.began_us * 1e-6, UTC)
    except (OverflowError, OSError, ValueError):
        return ""
    return f"{when:%Y-%m-%d %H:%M:%S}Z, " if when.year > 1970 else ""


def _holds(report: ShadowReport) -> Table:
    """When it would have held, and what the vehicle did meanwhile."""
    headings = ("let go", "why", "position good", "goes on", "the vehicle itself")
    table = _table(
        "where it would have held", headings, len(report.holds), report.left_out["holds"]
    )
    for hold in report.holds[:_MAX_ROWS]:
        table.add_row(
            f"{hold.let_go_s:,.2f} s" + ("" if hold.in_air else "\n(on the ground)"),
            _why(hold),
            "never" if hold.trusted_s is None else f"{hold.trusted_s:,.1f} s",
            "never" if hold.went_on_s is None else f"{hold.went_on_s:,.1f} s",
            Text(_itself(hold, report)),
        )
    return table


def _why(hold: Hold) -> str:
    """The reasons one after the other; those that come and go are told once more and counted."""
    if not hold.why:
        return ""
    first, *later = hold.why
    lines = [first.text]
    counted = Counter(why.text for why in later if why.text != first.text)
    begins = {why.text: why.at_s for why in reversed(later)}
    for text, count in counted.most_common(_SHORT_REASONS):
        times = f", {count} times" if count > 1 else ""
        lines.append(f"{begins[text]:,.1f} s: {text}{times}")
    lines.append(f"-> {first.remedy}")
    return "\n".join(lines)


def _itself(hold: Hold, report: ShadowReport) -> str:
    """What the vehicle did and said by itself meanwhile."""
    until_s = hold.went_on_s if hold.went_on_s is not None else hold.let_go_s + _NEAR_S
    said = [each for each in report.said if hold.let_go_s - _MOMENT_S <= each.at_s <= until_s]
    lines = [_said(each) for each in said[:_MAX_SAID]]
    if len(said) > _MAX_SAID:
        lines.append(f"{len(said) - _MAX_SAID} more")
    return "\n".join(lines) or "nothing"


def _said(said: VehicleReport) -> str:
    match said.what:
        case "mode":
            return f"{said.at_s:,.1f} s mode {said.text}"
        case "says":
            return f"{said.at_s:,.1f} s “{said.text}”"
        case _:
            return f"{said.at_s:,.1f} s {said.what}"


def _observed(title: str, found: Sequence[Observed], report: ShadowReport) -> Table:
    """Times at which something was so; those of one kind that follow at once are one row."""
    rows = list(_runs(found))
    table = _table(title, ("from", "to", "what", "where"), len(rows))
    table.columns[0].justify = table.columns[1].justify = "right"
    for run in rows[:_MAX_ROWS]:
        first, last, count = run[0], run[-1], len(run)
        worst_m = max((each.worst_m for each in run if each.worst_m is not None), default=None)
        far = "" if worst_m is None else f", by {worst_m:,.1f} m" + " at most" * (count > 1)
        times = f", {count} times" if count > 1 else ""
        ground = "" if first.in_air else " (on the ground)"
        until_s = report.length_s if last.until_s is None else last.until_s
        moment = until_s - first.from_s < 0.05
        end = "" if moment else f"{until_s:,.1f} s"
        table.add_row(
            f"{first.from_s:,.1f} s",
            f"{end} (end)" if last.until_s is None else end,
            Text(f"{first.kind}{far}{times}{ground}"),
            _where(first.place),
        )
    return table


def _runs(found: Sequence[Observed]) -> Iterator[list[Observed]]:
    for _, group in groupby(found, key=lambda each: (each.kind, each.in_air)):
        run: list[Observed] = []
        for each in group:
            before = run[-1].until_s if run else None
            if run and (before is None or each.from_s - before > _MOMENT_S):
                yield run
                run = []
            run.append(each)
        yield run


def _plans(report: ShadowReport) -> Table:
    """Where it would have planned, and how far the flown track was from that.

    Plans one after the other for the same reason, with the same answer, are one row.
    """
    runs = [list(run) for _, run in groupby(report.plans, key=_alike)]
    headings = ("at", "where", "why", "answer", "flown track off it, max / rms")
    title = "where it would have planned"
    table = _table(title, headings, len(runs), report.left_out["plans"])
    for run in runs[:_MAX_ROWS]:
        first, last = run[0], run[-1]
        at = f"{first.at_s:,.1f} s"
        if len(run) > 1:
            at += f" to {last.at_s:,.1f} s\n{len(run)} times"
        off = _off_words(TrackDeviation.of_all(asked.off for asked in run))
        table.add_row(at, _where(first.place), Text(_reasons(run)), Text(_answers(run)), off)
    return table


def _alike(asked: PlanAttempt) -> tuple[str, str, str]:
    return "".join(c for c in asked.why if not c.isdigit()), asked.outcome, asked.reason


def _reasons(run: list[PlanAttempt]) -> str:
    """Why it planned: with the numbers of the first and the last."""
    first, last = run[0].why, run[-1].why
    return first if first == last else f"{first} ... {last}"


def _answers(run: list[PlanAttempt]) -> str:
    first = run[0]
    if first.outcome == "refused":
        return "refused: " + first.reason.lower().replace("_", " ")
    lengths = [asked.length_m for asked in run if asked.length_m is not None]
    if first.outcome != "ready" or not lengths:
        return first.outcome
    low, high = f"{min(lengths):,.0f}", f"{max(lengths):,.0f}"
    words = f"{low} m" if low == high else f"{low} to {high} m"
    if all(asked.reaches_target for asked in run):
        words += ", to the target"
    clear = [asked.clearance_m for asked in run if asked.clearance_m is not None]
    return words + (f", clear by {min(clear):,.0f} m" if clear else "")


def _off_words(off: TrackDeviation | None) -> str:
    if off is None:
        return ""
    return (
        f"{off.max_m:,.1f} / {off.rms_m:,.1f} m\n{off.from_s:,.1f} to {off.until_s:,.1f} s, "
        f"{off.from_m:,.0f} to {off.until_m:,.0f} m"
    )


def _tail(report: ShadowReport) -> list[str]:
    lines = []
    if report.plans:
        answers = Counter(asked.outcome for asked in report.plans)
        counted = ", ".join(f"{count} {name}" for name, count in answers.most_common())
        lines.append(f"{len(report.plans)} subpaths asked for: {counted}")
        refused = {asked.reason: asked.remedy for asked in report.plans if asked.reason}
        lines += [f"  {reason.lower().replace('_', ' ')}: {why}" for reason, why in refused.items()]
    if (own := report.own_path) is not None:
        lines.append(
            f"flown track off its own paths: {own.max_m:,.1f} m at most (at {own.max_at_s:,.1f} "
            f"s), {own.rms_m:,.1f} m rms, over {own.positions:,} positions and "
            f"{own.until_m:,.0f} m of path"
        )
    for near in report.near_things:
        lines += _near_words(near)
    lines += [f"could not {each}" for each in report.could_not]
    recorded_input = {each.message for each in report.could_not}
    for missing in sorted(report.missing, key=lambda each: not each.vital):
        if missing.message not in recorded_input:
            lines.append(f"{missing}")
    lines += [f"note: {note}" for note in report.notes]
    lines += [f"log: {finding}" for finding in report.log_findings]
    left = {kind: count for kind, count in report.left_out.items() if count}
    lines += [f"{count:,} more of: {kind}" for kind, count in left.items()]
    heard = f"{report.heard:,} of {report.records:,} messages were of use"
    lines.append(f"{heard}; {report.times_real_time:,.0f}x real time")
    return lines


def _near_words(near: NearThings) -> Iterator[str]:
    times = [f"{Sight[name].value} for {s:,.0f} s" for name, s in near.seconds.items() if s]
    yield (
        f"near things, by {near.sensor}, up to {near.range_m:g} m, {near.sweeps:,} sweeps: "
        f"{near.free_m2:,.0f} m2 free, {near.occupied_m2:,.0f} m2 where something stands"
    )
    yield f"  {'; '.join(times)}"
    yield from (f"  {why}: {count:,} times" for why, count in near.refused.items())


def _where(place: Place | None) -> str:
    if place is None:
        return ""
    return f"{place.latitude_deg:.5f}, {place.longitude_deg:.5f}, {place.altitude_amsl_m:,.0f} m"


def _table(title: str, headings: Sequence[str], rows: int, left_out: int = 0) -> Table:
    """An empty table for the first of so many rows."""
    table = Table(*headings, title=title, title_justify="left")
    if (more := rows + left_out - _MAX_ROWS) > 0:
        table.caption = f"{more} more: --json has them"
    return table
