"""What a campaign came to, as a page, a table for the terminal and CSV."""

import csv
import io
import math
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from statistics import median
from typing import Any, Final, final

import numpy as np
from markupsafe import Markup
from rich.table import Table
from rich.text import Text

from companion.campaign.families import SPREAD
from companion.campaign.row import TIMING, Row
from companion.campaign.statistics import (
    FACTORS,
    MEASURES,
    RATES,
    SIZES,
    TASK,
    Comparison,
    Difference,
    Group,
    Interval,
    Label,
    Measure,
    compare,
    group,
    split,
    varying,
)
from companion.campaign.store import facts_of, read_rows
from companion.errors import InputError
from companion.extras import need

_MOST_VALUES: Final = 24
"""Of a factor that has a table without being asked for."""
_WORST: Final = 10
_FEW: Final = 20
_DRAWN_BY: Final = ("family_seed", "family_index")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """The rows of a campaign as far as it has come."""

    folder: Path
    rows: tuple[Row, ...]
    """By their numbers."""
    expected: int | None
    """Runs that it has in all; None: that is not known."""
    repeated: int
    """Rows that were left out: their run has one already."""
    source: tuple[str, ...]
    """What the command is asked for to fly one of these runs again."""

    @property
    def missing(self) -> int:
        """Runs that have no row yet."""
        return 0 if self.expected is None else max(self.expected - len(self.rows), 0)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Worst:
    """The worst runs of a kind."""

    kind: str
    total: int
    """How many there are; the first ones are shown."""
    shown: tuple[tuple[Row, str, str], ...]
    """Run, what is bad about it, the command that shows it again."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """The groups by some factors, and their comparisons in pairs."""

    by: tuple[str, ...]
    groups: tuple[Group, ...]
    comparisons: tuple[Comparison, ...]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignReport:
    """What there is to say of a campaign."""

    campaign: Campaign
    overall: Group
    sections: tuple[Section, ...]
    worst: tuple[Worst, ...]
    notes: tuple[str, ...]


# --- reading


def read_campaign(folder: Path) -> Campaign:
    """The data set of a campaign.  Raises InputError."""
    need("campaign", "FOLDER", str(folder))
    found = read_rows("FOLDER", folder, [field.name for field in fields(Row)])
    facts = facts_of(folder)
    expected = facts.get("runs")
    if not found and expected is None:
        remedy = "Give the folder that companion campaign has written."
        raise InputError("FOLDER", str(folder), "it holds no campaign", remedy)
    rows = {row["run"]: Row(**row) for row in reversed(found)}
    return Campaign(
        folder=folder,
        rows=tuple(rows[run] for run in sorted(rows)),
        expected=expected if isinstance(expected, int) else None,
        repeated=len(found) - len(rows),
        source=tuple(map(str, facts.get("source") or [folder / "campaign.toml"])),
    )


# --- what there is to say


def report_of(campaign: Campaign, by: Sequence[str] = ()) -> CampaignReport:
    """Tables by each factor that varies, or by some factors together.  Raises InputError."""
    for factor in by:
        if factor not in FACTORS:
            remedy = f"Choose from: {', '.join(FACTORS)}."
            raise InputError("--by", factor, "no such factor", remedy)
    rows, counts = campaign.rows, varying(campaign.rows)
    chosen = [tuple(dict.fromkeys(by))] if by else []
    notes = _notes(campaign)
    for factor, count in counts.items() if not by else ():
        if factor in _DRAWN_BY and any(row.family != SPREAD for row in rows if row.family):
            continue
        if count <= _MOST_VALUES:
            chosen.append((factor,))
        else:
            notes.append(f"{factor} has {count} values; a table by it: --by {factor}.")
    return CampaignReport(
        campaign=campaign,
        overall=group((), rows),
        sections=tuple(
            Section(
                by=each,
                groups=tuple(group(*item) for item in split(rows, each).items()),
                comparisons=tuple(compare(rows, each)),
            )
            for each in chosen
        ),
        worst=tuple(_worst(campaign)),
        notes=tuple(notes),
    )


def _notes(campaign: Campaign) -> list[str]:
    notes, rows = [], campaign.rows
    if campaign.missing:
        notes.append(
            f"Not finished: {campaign.missing:,} of {campaign.expected:,} runs have no row yet. "
            "What is missing may differ from what is here; the command that began the campaign "
            "goes on with it."
        )
    if campaign.repeated:
        notes.append(f"{campaign.repeated:,} rows repeat a run that has one, and were left out.")
    if 0 < len(rows) < _FEW:
        notes.append(f"{len(rows)} runs are few: intervals by bootstrap are then too narrow.")
    if errors := sum(row.error is not None for row in rows):
        notes.append(f"{errors:,} runs raised an error; they count as not arrived.")
    if unchecked := sum(row.violations is None for row in rows):
        notes.append(f"{unchecked:,} runs were not checked for violations: in no rate of them.")
    if len(versions := {row.version for row in rows}) > 1:
        notes.append(f"Flown by several versions: {', '.join(sorted(versions))}.")
    return notes


def _worst(campaign: Campaign) -> list[Worst]:
    """The worst runs of each kind; no kind of which there is none."""
    rows = campaign.rows
    least = [row for row in rows if row.clearance_least_m is not None]
    violated = [row for row in rows if row.violations]
    errors = [row for row in rows if row.error is not None]
    not_arrived = [row for row in rows if not row.arrived and row.error is None]
    dearest = sorted(_dearness(rows), key=lambda item: (-item[1], item[0].run))
    kinds: list[tuple[str, list[tuple[Row, str]]]] = [
        (
            "Violations",
            [
                (row, f"{row.violations}: {row.violated or 'not said which'}")
                for row in sorted(violated, key=lambda row: (-(row.violations or 0), row.run))
            ],
        ),
        ("Errors", [(row, row.error or "") for row in errors]),
        ("Not arrived", _by_turns(not_arrived)),
        ("Dearest", [(row, f"{ratio:.3f} times {of}") for row, ratio, of in dearest]),
        (
            "Least clearance",
            [
                (row, f"{row.clearance_least_m:.1f} m{_at(row.clearance_least_t_s)}")
                for row in sorted(least, key=lambda row: (row.clearance_least_m, row.run))
            ],
        ),
    ]
    return [
        Worst(
            kind=kind,
            total=len(found),
            shown=tuple((r, said, replay_command(campaign, r)) for r, said in found[:_WORST]),
        )
        for kind, found in kinds
        if found
    ]


def _at(time_s: float | None) -> str:
    return "" if time_s is None else f" at {time_s:,.0f} s"


def _by_turns(rows: Iterable[Row]) -> list[tuple[Row, str]]:
    """One run of each reason, the commonest first, then another of each."""
    reasons: dict[str, list[Row]] = {}
    for row in rows:
        reasons.setdefault(f"{row.outcome}: {row.reason or 'no reason given'}", []).append(row)
    ordered = sorted(reasons.items(), key=lambda item: -len(item[1]))
    turns = [
        (turn, at, row, f"{reason} ({len(found):,} runs)")
        for at, (reason, found) in enumerate(ordered)
        for turn, row in enumerate(found)
    ]
    return [(row, said) for _, _, row, said in sorted(turns, key=lambda item: item[:2])]


def _dearness(rows: Iterable[Row]) -> list[tuple[Row, float, str]]:
    """Arrived runs by cost: against the median of their task, or its least if full knowledge."""
    found, tasks = [], split((r for r in rows if r.arrived and r.cost), TASK)
    for runs in tasks.values():
        best = [row.cost for row in runs if row.knowledge == "full" and row.cost]
        against = min(best) if best else median(row.cost or 0.0 for row in runs)
        said = "the least cost with full knowledge" if best else f"the median of {len(runs)} runs"
        if len(runs) > 1:
            found += [(row, (row.cost or 0.0) / against, said) for row in runs]
    return found


def replay_command(campaign: Campaign, row: Row) -> str:
    """The command that shows a run again: its folder replayed, or the run flown again."""
    if row.folder:
        return shlex.join(["companion", "replay", str(campaign.folder / row.folder)])
    again = f"{campaign.folder}-run-{row.run}"
    asked = ["--only", str(row.run), "--over", row.over, "--keep", "all", "--out", again]
    return shlex.join(["companion", "campaign", "run", *campaign.source, *asked])


# --- in words


def label_text(label: Label) -> str:
    """The values of a group's factors."""
    return ", ".join("none" if value is None else str(value) for value in label) or "all"


def interval_text(
    found: Interval | None,
    digits: int = 2,
    scale: float = 1.0,
    is_rate: bool = False,
) -> str:
    """An estimate and its interval; of a rate some are never none, and nearly all never all."""
    if found is None or not math.isfinite(found.value):
        return "–"
    shown = scale * found.value + 0.0
    if is_rate and 0.0 < found.value < 1.0:
        least = 10.0**-digits
        shown = min(max(shown, least), scale - least)
    value = f"{shown:,.{digits}f}"
    if found.low is None or found.high is None:
        return value
    return (
        f"{value} [{scale * found.low + 0.0:,.{digits}f}, {scale * found.high + 0.0:,.{digits}f}]"
    )


def verdict(difference: Difference, comparison: Comparison) -> str:
    """What follows from a comparison, and what does not."""
    measure, d = difference.measure, difference
    ours, theirs = label_text(comparison.reference), label_text(comparison.other)
    name, apart = measure.words, d.wins + d.losses
    p = f"p = {d.p_holm:.2g}"
    if not apart:
        return f"{name}: the same in all {d.pairs} pairs."
    if not d.can_tell:
        best = min(d.tests * 2.0 ** (1 - apart), 1.0)
        return (
            f"{name}: nothing follows, too few pairs differ ({apart} of {d.pairs}); even if all "
            f"pointed one way p would not be below {best:.2g}."
        )
    shown = d.relative
    said = interval_text(shown or d.medians, 1, 100.0 if shown or measure.is_rate else 1.0)
    unit = "%" if shown else "percentage points" if measure.is_rate else measure.unit
    if not d.is_told:
        return (
            f"{name}: no difference can be told ({said} {unit}, {p}); that is no proof that "
            "there is none, the interval says what may be."
        )
    sign = (shown or d.medians).value * (1.0 if measure.better == "more" else -1.0)
    if sign * (d.wins - d.losses) < 0.0 or d.wins == d.losses:
        return (
            f"{name}: they differ ({said} {unit}, {p}), but size and number point different "
            f"ways ({d.wins} better, {d.losses} worse): neither is simply better."
        )
    first, second = (theirs, ours) if d.wins > d.losses else (ours, theirs)
    return (
        f"{name}: {first} is better than {second}: {said} {unit}, better in "
        f"{max(d.wins, d.losses)} of {d.pairs} pairs, worse in {min(d.wins, d.losses)}, {p}."
    )


def caveats(comparison: Comparison) -> list[str]:
    """What the reader of a comparison has to know."""
    said = [
        f"{factor} differs with it ({label_text((ours,))}, {label_text((theirs,))}): what is seen "
        "may come from either."
        for factor, ours, theirs in comparison.entailed
    ]
    if any(comparison.alone):
        ours, theirs = comparison.alone
        said.append(
            f"Without a partner and left out: {ours} runs of {label_text(comparison.reference)}, "
            f"{theirs} of {label_text(comparison.other)}."
        )
        if not comparison.pairs:
            said.append("Nothing to pair: more differs. Name that too: --by FACTOR --by FACTOR.")
    if any(comparison.ambiguous):
        said.append(
            f"Left out, as they have several partners: {sum(comparison.ambiguous)} runs. Name "
            "what else they differ in with --by."
        )
    if dropped := max((comparison.pairs - d.pairs for d in comparison.differences), default=0):
        said.append(
            f"Costs, lengths and times are compared only where both arrived: up to {dropped} of "
            f"{comparison.pairs} pairs are left out of them, hardly the easiest."
        )
    return said


def terminal_tables(report: CampaignReport) -> list[Table]:
    """The report in short."""
    found = [_table("all", [report.overall])]
    found += [_table(" × ".join(each.by), each.groups) for each in report.sections]
    return found


def _table(by: str, groups: Sequence[Group]) -> Table:
    sizes = [m for m in shown_sizes(groups) if m.in_short]
    table = Table(title=Text(f"by {by}" if by != "all" else "all runs"), title_justify="left")
    table.add_column(Text(by))
    for name in ("runs", *(m.words + ", %" for m in RATES), *(m.words for m in sizes)):
        table.add_column(name, justify="right")
    for each in groups:
        rates = [interval_text(each.rates[m.name][0], 1, 100.0, True) for m in RATES]
        spreads = [(each.spreads[m.name], m.digits) for m in sizes]
        medians = [interval_text(s and s.median, digits) for s, digits in spreads]
        table.add_row(Text(label_text(each.label)), f"{each.runs:,}", *rates, *medians)
    return table


def shown_sizes(groups: Sequence[Group]) -> list[Measure]:
    """The measures that some run of some group has."""
    return [m for m in SIZES if any(each.spreads[m.name] for each in groups)]


def report_lines(report: CampaignReport) -> list[str]:
    """Notes, verdicts and worst cases, for the terminal."""
    lines = [f"note: {note}" for note in report.notes]
    for section in report.sections:
        for each in section.comparisons:
            pair = f"{label_text(each.other)} against {label_text(each.reference)}"
            lines.append(f"{' × '.join(section.by)}: {pair}, {each.pairs} pairs")
            lines += [f"  {said}" for said in caveats(each)]
            lines += [f"  {verdict(d, each)}" for d in each.differences]
    for worst in report.worst:
        row, said, command = worst.shown[0]
        lines += [f"{worst.kind} ({worst.total:,}), first: {row.key}: {said}", f"  {command}"]
    return lines


# --- the page


def report_html(report: CampaignReport) -> str:
    """The page: one file that loads nothing."""
    from companion.views.page import page  # slow to import

    return page(
        "campaign.html.j2",
        "campaign",
        report=report,
        rates=RATES,
        figures=[Markup(_figure(at, each)) for at, each in enumerate(report.sections)],
        label=label_text,
        interval=_unbroken,
        shown_sizes=shown_sizes,
        verdict=verdict,
        caveats=caveats,
        timing=TIMING,
    )


def _unbroken(*asked: Any) -> str:
    """An interval whose brackets stay on one line."""
    return interval_text(*asked).replace(", ", ",\u00a0")


def _figure(at: int, section: Section) -> str:
    """Rates, costs and clearances of the groups side by side, with their intervals."""
    from matplotlib import rc_context
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from companion.views.figure import PATH
    from companion.views.page import STYLE, THEME_OF_CHARTS, svg

    groups = section.groups[:_MOST_VALUES]
    names = ("cost", "clearance_least_m")
    sizes = [m for m in shown_sizes(groups) if m.name in names]
    rows = np.arange(len(groups))

    def mark(axes: Axes, found: Sequence[Interval | None]) -> None:
        for row, each in zip(rows.tolist(), found, strict=True):
            if each is None or not math.isfinite(each.value):
                continue
            if each.low is not None and each.high is not None:
                axes.plot([each.low, each.high], [row, row], color=PATH, lw=2.2)
            axes.plot([each.value], [row], "o", color=PATH, ms=6)

    def draw(canvas: Figure) -> None:
        all_axes: list[Axes] = canvas.subplots(
            1, len(RATES) + len(sizes), sharey=True, squeeze=False
        )[0].tolist()
        for axes, measure in zip(all_axes, (*RATES, *sizes), strict=True):
            if measure.is_rate:
                mark(axes, [each.rates[measure.name][0].over(0.01) for each in groups])
                axes.set(xlim=(-3.0, 103.0), xlabel=f"{measure.words}, %")
                continue
            spreads = [each.spreads[measure.name] for each in groups]
            for row, found in zip(rows.tolist(), spreads, strict=True):
                if found is not None:  # the middle 80 % of the runs
                    ends = [found.tenth, found.ninetieth]
                    axes.plot(ends, [row, row], color="#888888", lw=7, alpha=0.4)
            mark(axes, [found and found.median for found in spreads])
            axes.set_xlabel(f"{measure.words}{measure.unit and ', '}{measure.unit}")
        for axes in all_axes:
            axes.grid(axis="x", color="#888888", alpha=0.3, lw=0.6)
            axes.set_ylim(len(groups) - 0.5, -0.5)
        labels = [label_text(each.label)[:28].replace("$", r"\$") for each in groups]
        all_axes[0].set_yticks(rows, labels)
        canvas.subplots_adjust(left=0.2, right=0.985, top=0.97, bottom=0.5 / height, wspace=0.12)

    height = 0.9 + 0.34 * len(groups)
    with rc_context(STYLE):
        return svg(f"section-{at}", (11.0, height), draw, THEME_OF_CHARTS)


# --- CSV


def rows_csv(rows: Iterable[Row]) -> str:
    """All columns of all rows."""
    return _csv([field.name for field in fields(Row)], (list(asdict(row).values()) for row in rows))


_SUMMARY: Final = (
    *("kind", "by", "group", "against", "measure", "n", "value", "low", "high", "mean"),
    *("wins", "ties", "losses", "p", "p_holm", "alone", "alone_against"),
)


def summary_csv(report: CampaignReport) -> str:
    """Every figure of the report: rates, medians, and differences in pairs."""
    records: list[dict[str, Any]] = []
    for by, groups in [((), (report.overall,)), *((s.by, s.groups) for s in report.sections)]:
        for each in groups:
            place = {"by": " × ".join(by), "group": label_text(each.label)}
            for measure in MEASURES:
                if measure.is_rate:
                    share, count = each.rates[measure.name]
                    found = {"kind": "rate", "n": count, **asdict(share)}
                elif (spread := each.spreads[measure.name]) is not None:
                    of_median = asdict(spread.median) | {"mean": spread.mean.value}
                    found = {"kind": "median", "n": spread.runs, **of_median}
                else:
                    continue
                records.append(place | found | {"measure": measure.name})
    for section in report.sections:
        for comparison in section.comparisons:
            alone_against, alone = comparison.alone
            place = {
                "by": " × ".join(section.by),
                "group": label_text(comparison.other),
                "against": label_text(comparison.reference),
            }
            for d in comparison.differences:
                tested = ("wins", "ties", "losses", "p", "p_holm")
                found = {name: getattr(d, name) for name in tested}
                found |= {"kind": "pairs", "measure": d.measure.name, "n": d.pairs}
                found |= asdict(d.medians) | {"mean": d.means.value}
                found |= {"alone": alone, "alone_against": alone_against}
                records.append(place | found)
    return _csv(_SUMMARY, ([record.get(name) for name in _SUMMARY] for record in records))


def _csv(names: Sequence[str], lines: Iterable[Sequence[Any]]) -> str:
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(lines)
    return file.getvalue()
