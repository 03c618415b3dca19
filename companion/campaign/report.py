"""What a campaign came to, as tables for a page and for the terminal, and as CSV."""

import shlex
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Final, NamedTuple

import polars as pl
from rich.console import JustifyMethod
from rich.table import Table
from rich.text import Text

from companion.campaign.families import SPREAD
from companion.campaign.statistics import (
    CONFIDENCE,
    FACTORS,
    MEASURES,
    TASK,
    Figure,
    groups,
    pairs,
    varying,
)
from companion.campaign.store import Facts, Row, facts_of, read_rows
from companion.errors import InputError

_MOST_VALUES: Final = 24
"""Of a factor that has a table without being asked for."""
_WORST: Final = 10
_FEW: Final = 20
_DRAWN_BY: Final = ("family_seed", "family_index")
_PAIRS_HEAD: Final = (
    *("group", "against", "measure", "pairs", "difference"),
    *("better", "alike", "worse", "p", "p, Holm"),
)


class Campaign(NamedTuple):
    """A campaign as far as it has come."""

    folder: Path
    rows: pl.DataFrame
    """By their numbers; `store.COLUMNS`."""
    facts: Facts


class Sheet(NamedTuple):
    """A table of the report, in words."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1
    """So many columns from the left are words, the others numbers."""
    notes: Sequence[str] = ()


class Report(NamedTuple):
    """What there is to say of a campaign."""

    campaign: Campaign
    notes: Sequence[str]
    figures: Sequence[Figure]
    tables: Sequence[Sheet]
    worst: Sequence[Sheet]


def read_campaign(folder: Path) -> Campaign:
    """The data set of a campaign.  Raises InputError."""
    campaign = Campaign(folder, read_rows("FOLDER", folder), facts_of(folder))
    if campaign.rows.is_empty() and campaign.facts.runs is None:
        remedy = "Give the folder that companion campaign has written."
        raise InputError("FOLDER", str(folder), "it holds no campaign", remedy)
    return campaign


def report_of(campaign: Campaign, by: Sequence[str] = ()) -> Report:
    """Tables by each factor that varies, or by some factors together.  Raises InputError."""
    for factor in by:
        if factor not in FACTORS:
            remedy = f"Choose from: {', '.join(FACTORS)}."
            raise InputError("--by", factor, "no such factor", remedy)
    rows, notes = campaign.rows, _notes(campaign)
    chosen = [tuple(dict.fromkeys(by))] if by else []
    for factor, count in varying(rows).items() if not by else ():
        if factor in _DRAWN_BY and set(rows["family"]) - {None, SPREAD}:
            continue
        if count <= _MOST_VALUES:
            chosen.append((factor,))
        else:
            notes.append(f"{factor} has {count} values; a table by it: --by {factor}.")
    figures = groups(rows, ())
    tables = [_of_groups(figures)]
    for factors in chosen:
        of_groups, (of_pairs, pair_notes) = groups(rows, factors), pairs(rows, factors)
        figures += [*of_groups, *of_pairs]
        tables.append(_of_groups(of_groups))
        if of_pairs or pair_notes:
            tables.append(_of_pairs(of_pairs, pair_notes))
    return Report(campaign, notes, figures, tables, _worst(campaign))


def _notes(campaign: Campaign) -> list[str]:
    rows, runs = campaign.rows, campaign.facts.runs or 0
    missing = max(runs - len(rows), 0)
    errors, unchecked = rows["error"].count(), rows["violations"].null_count()
    versions = rows["version"].unique().sort().to_list()
    warnings = {
        f"Not finished: {missing:,} of {runs:,} runs have no row yet. What is "
        "missing may differ from what is here; the command that began it goes on.": missing,
        f"{len(rows)} runs are few: intervals by bootstrap are then too narrow.": (
            0 < len(rows) < _FEW
        ),
        f"{errors:,} runs raised an error; they count as not arrived.": errors,
        f"{unchecked:,} runs were not checked for violations: in no rate of them.": unchecked,
        f"Flown by several versions: {', '.join(versions)}.": len(versions) > 1,
    }
    return [note for note, applies in warnings.items() if applies]


# --- tables


def _of_groups(figures: Sequence[Figure]) -> Sheet:
    """One row for each group, with all its measures."""
    of = {(figure.group, figure.measure.name): figure for figure in figures}
    shown = [measure for measure in MEASURES if any(f.measure is measure for f in figures)]
    rows = []
    for group in dict.fromkeys(figure.group for figure in figures):
        count = of[group, "arrived"].n  # every run has one
        rows.append((group, f"{count:,}", *(_cell(of.get((group, m.name)), count) for m in shown)))
    by = figures[0].by if figures else ""
    title = f"By {by}" if by else "All runs" if rows else "No run has a row yet"
    units = (f"{measure.words}{measure.unit and ', '}{measure.unit}" for measure in shown)
    return Sheet(title=title, head=(by, "runs", *units), rows=rows)


def _cell(figure: Figure | None, runs: int) -> str:
    if figure is None:
        return "–"
    of = f" of {figure.n:,}" if figure.measure.is_rate and figure.n != runs else ""
    return value_text(figure) + of


def value_text(figure: Figure) -> str:
    """A figure with its interval; a rate in per cent, of some never 0, of nearly all not 100."""
    digits, measure = figure.measure.digits, figure.measure
    ends = [figure.value, figure.low, figure.high]
    if measure.is_rate:
        ends = [None if end is None else 100.0 * end for end in ends]
        if 0.0 < figure.value < 1.0:
            ends[0] = min(max(100.0 * figure.value, 10.0**-digits), 100.0 - 10.0**-digits)
    elif figure.against and measure.in_percent:
        digits = 1
    value, *interval = (f"{end + 0.0:,.{digits}f}" for end in ends if end is not None)
    return f"{value} [{', '.join(interval)}]" if interval else value


def _of_pairs(figures: Sequence[Figure], notes: Sequence[str]) -> Sheet:
    rows = [
        (
            *(figure.group, figure.against or "", figure.measure.words, f"{figure.n:,}"),
            f"{value_text(figure)} {'%' if figure.measure.in_percent else figure.measure.unit}",
            *(f"{figure.wins:,}", f"{figure.ties:,}", f"{figure.losses:,}", f"{figure.p:.2g}"),
            f"{figure.p_holm:.2g}{' ●' if (figure.p_holm or 0.0) < 1.0 - CONFIDENCE else ''}",
        )
        for figure in figures
    ]
    return Sheet(title="In pairs", head=_PAIRS_HEAD, rows=rows, words=3, notes=notes)


def _worst(campaign: Campaign) -> list[Sheet]:
    """The worst runs of each kind, the worst first; no kind of which there is none."""
    rows, cost, why = campaign.rows, pl.col("cost"), ("outcome", "reason")
    failed = rows.filter(~pl.col("arrived"), pl.col("error").is_null())
    failed = failed.with_columns(runs=pl.len().over(why))
    arrived = rows.filter(pl.col("arrived"), cost > 0.0)
    arrived = arrived.with_columns(ratio=cost / cost.median().over(TASK), runs=pl.len().over(TASK))
    nearest, at_s = pl.col("clearance_least_m"), pl.col("clearance_least_t_s")
    reason = pl.col("reason").fill_null("no reason given")
    # of each kind: the runs, how bad they are, and what is said of one
    worst: dict[str, tuple[pl.DataFrame, pl.Expr, pl.Expr]] = {
        "Violations": (
            rows.filter(pl.col("violations") > 0),
            pl.col("violations"),
            pl.format("{}: {}", "violations", pl.col("violated").fill_null("not said which")),
        ),
        "Errors": (rows.drop_nulls("error"), -pl.col("run"), pl.col("error")),
        "Not arrived": (
            failed.unique(why, keep="first", maintain_order=True),
            pl.col("runs"),
            pl.format("{}: {} ({} runs)", "outcome", reason, "runs"),
        ),
        "Dearest": (
            arrived.filter(pl.col("runs") > 1),
            pl.col("ratio"),
            pl.format("{} times the median of {} runs", pl.col("ratio").round(3), "runs"),
        ),
        "Least clearance": (
            rows.drop_nulls("clearance_least_m"),
            -nearest,
            pl.format("{} m", nearest.round(1))
            + pl.format(" at {} s", at_s.round().cast(int, strict=False)).fill_null(""),
        ),
    }
    sheets = []
    for kind, (runs, badness, says) in worst.items():
        first = runs.sort(badness, descending=True, maintain_order=True).head(_WORST)
        shown = [
            (str(row["run"]), row["key"], row["says"], replay_command(campaign, row))
            for row in first.with_columns(says=says).iter_rows(named=True)
        ]
        title = f"{kind}: {len(shown)} of {len(runs):,}" if len(runs) > len(shown) else kind
        head = ("run", "factors", "what", "see it again")
        sheets += [Sheet(title=title, head=head, rows=shown, words=4)] if shown else []
    return sheets


def replay_command(campaign: Campaign, row: Row) -> str:
    """The command that shows a run again: its folder replayed, or the run flown again."""
    if row["folder"] and row["over"] == "process":
        return shlex.join(["companion", "replay", str(campaign.folder / row["folder"])])
    again = f"{campaign.folder}-run-{row['run']}"
    asked = ["--only", str(row["run"]), "--keep", "all", "--out", again]
    source = campaign.facts.source or [str(campaign.folder / "campaign.toml")]
    return shlex.join(["companion", "campaign", "run", *source, *asked])


# --- for whom


def terminal_tables(report: Report) -> list[Table | str]:
    """The report: tables, and between them lines; of the worst runs the first of each kind."""
    shown: list[Table | str] = [f"note: {note}" for note in report.notes]
    for sheet in report.tables:
        table = Table(title=Text(sheet.title), title_justify="left")
        for at, name in enumerate(sheet.head):
            justify: JustifyMethod = "left" if at < sheet.words else "right"
            table.add_column(Text(name), justify=justify, overflow="fold")
        for row in sheet.rows:
            table.add_row(*map(Text, row))
        shown += [table, *(f"  {note}" for note in sheet.notes)]
    for sheet in report.worst:
        _, factors, what, command = sheet.rows[0]
        shown += [f"{sheet.title}, first: {factors}: {what}", f"  {command}"]
    return shown


def report_html(report: Report) -> str:
    """The page: one file that loads nothing."""
    from companion.views.page import page  # slow to import

    return page("campaign.html.j2", "campaign", report=report)


def figures_csv(report: Report) -> str:
    """Every figure of the report: rates, medians, and differences in pairs."""
    figures = [
        asdict(figure) | {"by": figure.by or None, "measure": figure.measure.name}
        for figure in report.figures
    ]
    columns = [field.name for field in fields(Figure)]
    return pl.DataFrame(figures, columns, infer_schema_length=None).write_csv()
