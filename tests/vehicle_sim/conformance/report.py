"""The comparison as tables."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import final

from rich.console import Group, RenderableType
from rich.table import Table

from conformance.log import Recording
from conformance.rows import Row


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """How many rows agree."""

    rows: int
    agree: int
    unexplained: int
    """Disagreeing rows without an explanation."""

    @property
    def share(self) -> float:
        """Of the rows that agree, 0 to 1."""
        return self.agree / self.rows if self.rows else 1.0

    @classmethod
    def of(cls, rows: Iterable[Row]) -> "Summary":
        """Count."""
        listed = list(rows)
        return cls(
            rows=len(listed),
            agree=sum(row.agrees for row in listed),
            unexplained=sum(not row.agrees and row.reason is None for row in listed),
        )


_BEGIN, _END = "<!-- measured: begin -->\n", "<!-- measured: end -->\n"
_HEAD = (
    "| recording | rows | agree | | worst difference that agrees | do not agree |\n"
    "|---|---|---|---|---|---|\n"
)
_REASONS_HEAD = "| recording | rows | do not agree | because |\n|---|---|---|---|\n"


def markdown_row(recording: Recording, rows: Sequence[Row]) -> str:
    """One line of the summary in docs/results/conformance.md."""
    summary = Summary.of(rows)
    near = max((row for row in rows if row.agrees), key=lambda row: row.difference)
    apart = Counter(row.kind for row in rows if not row.agrees)
    kinds = ", ".join(f"{n} {kind}" for kind, n in apart.items()) or "none"
    return (
        f"| {recording.name} | {summary.rows} | {summary.agree} | {100 * summary.share:.1f} % "
        f"| {near.difference:.2f} of the tolerance ({near.kind}: {near.name}) | {kinds} |\n"
    )


def markdown_reasons(recording: Recording, rows: Sequence[Row]) -> str:
    """The rows that do not agree, as lines of the second table there."""
    apart: dict[str, list[str]] = {}
    for row in rows:
        if not row.agrees:
            reason = row.reason or "none is known"
            apart.setdefault(reason, []).append(f"{row.kind} ({row.name})")
    return "".join(
        f"| {recording.name} | {len(names)} | {', '.join(dict.fromkeys(names))} | {reason} |\n"
        for reason, names in apart.items()
    )


def with_tables(page: str, lines: Sequence[str], reasons: Sequence[str]) -> str:
    """The page with these lines as its tables.  ValueError if it has no place for them."""
    before, begin, rest = page.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    if not begin or not end:
        raise ValueError(f"no place for the tables: {_BEGIN.strip()} and {_END.strip()}")
    tables = _HEAD + "".join(lines) + "\n" + _REASONS_HEAD + "".join(reasons)
    return before + begin + tables + end + after


def as_table(recording: Recording, rows: Sequence[Row], *, everything: bool) -> RenderableType:
    """One line a kind of row, and every row that does not agree (or every row)."""
    summary = Summary.of(rows)
    title = (
        f"{recording.name}: {summary.agree} of {summary.rows} rows agree "
        f"({100 * summary.share:.1f} %), {summary.unexplained} without a reason"
    )
    shown = [row for row in rows if everything or not row.agrees]
    parts: list[RenderableType] = [title, _kinds(rows)]
    if shown:
        parts.append(_details(recording, shown, everything=everything))
    return Group(*parts)


def _kinds(rows: Sequence[Row]) -> Table:
    table = Table()
    for name in ("kind", "rows", "agree", "worst, in tolerances", "of"):
        table.add_column(name, justify="left" if name in ("kind", "of") else "right")
    for kind in dict.fromkeys(row.kind for row in rows):
        of_kind = [row for row in rows if row.kind == kind]
        worst = max(of_kind, key=lambda row: row.difference)
        table.add_row(
            kind,
            str(len(of_kind)),
            str(sum(row.agrees for row in of_kind)),
            _times(worst.difference),
            worst.name if worst.difference > 0.0 else "",
        )
    return table


def _details(recording: Recording, rows: Sequence[Row], *, everything: bool) -> Table:
    title = "every row" if everything else "rows that do not agree"
    table = Table(title=title, title_justify="left", show_lines=False)
    for name in ("kind", "name", "at, s of the log", "real", "simulated", "tolerance"):
        table.add_column(name, overflow="fold")
    table.add_column("x tolerance", justify="right")
    table.add_column("reason", overflow="fold")
    for row in rows:
        at_s = None if row.at_s is None else recording.clock.log_s(row.at_s)
        reason = row.reason or ("" if row.agrees else "none is known")
        table.add_row(
            row.kind,
            row.name,
            "" if at_s is None else f"{at_s:.1f}",
            row.real,
            row.simulated,
            row.tolerance,
            _times(row.difference),
            reason,
        )
    return table


def _times(difference: float) -> str:
    return f"{difference:.2f}" if math.isfinite(difference) else "not there or unequal"
