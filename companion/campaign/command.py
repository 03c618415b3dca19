"""`companion campaign`: run one, go on with one that was interrupted, say what it came to."""

import contextlib
import hashlib
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from companion.campaign import bundled_campaigns
from companion.campaign.store import Facts, Row, Store
from companion.errors import InputError
from companion.extras import need
from companion.runtime.processes import processors
from companion.sources.files import writing
from companion.views.output import plain_console, table_console

if TYPE_CHECKING:
    from companion.campaign.file import Run

_INTERRUPTED = 130

campaign_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="markdown",
    help="Thousands of missions from one file, on all cores or on a cluster.",
)
Option = typer.Option
_BUNDLED = f"A campaign file, or a bundled name: {', '.join(bundled_campaigns())}."
_OUT = "Folder to write; by default campaigns/NAME.  What is there is gone on with."
_JOBS = "Runs at a time; by default as many as cores."
_SCHEDULER = "A Dask scheduler, tcp://host:8786, to fly on its workers."
_KEEP = "Run folders to keep: *all*, *failures* or *none*."
_SEEDS = "Runs of each combination, in place of the file's."
_MOST = "At most so many of the runs, evenly chosen."
_ONLY = "This run alone, by its number.  May be repeated."
_FOLDER = "The folder of a campaign, ended or not."
_BY = (
    "Group by this factor; may be repeated, for groups by several together. By default by each "
    "that varies."
)
_HTML = "Page to write; by default FOLDER/report.html."
_CSV = "Write all figures to FILE; the rows are in the folder, as Parquet."


@campaign_app.command("run")
def run_command(
    campaign: Annotated[str, typer.Argument(metavar="CAMPAIGN", help=_BUNDLED)],
    out: Annotated[Path | None, Option(help=_OUT)] = None,
    jobs: Annotated[int | None, Option(min=1, help=_JOBS)] = None,
    scheduler: Annotated[str | None, Option(metavar="ADDRESS", help=_SCHEDULER)] = None,
    keep: Annotated[str | None, Option(help=_KEEP)] = None,
    seeds: Annotated[int | None, Option(min=1, help=_SEEDS)] = None,
    most: Annotated[int | None, Option(min=1, help=_MOST)] = None,
    only: Annotated[list[int] | None, Option(min=0, help=_ONLY)] = None,
) -> None:
    """Fly all runs of a campaign; rows are written to a Parquet data set as they come.

    Interrupted, however rudely, the same command goes on.  Exit code: 0 all runs have a row, 2
    wrong input, 130 stopped by Ctrl-C.
    """
    from companion.campaign import execute, file, run  # slow to import

    if only and most is not None:
        rule, remedy = "--only says which runs are flown", "Leave out one of them."
        raise InputError("--most", most, rule, remedy)
    if scheduler is not None and jobs is not None:
        rule = "how many runs are flown at a time, the workers of --scheduler say"
        raise InputError("--jobs", jobs, rule, "Leave out one of them.")
    options = {"keep": keep, "seeds": seeds}
    given = {key: value for key, value in options.items() if value is not None}
    table, text, folder = file.load_campaign(campaign, given)
    runs = _chosen(file.runs_of(table, folder), most, only)
    run.check_runs(runs, campaign)
    console, began_s, counts = plain_console(soft_wrap=True), time.perf_counter(), Counter[str]()
    path = (out or Path("campaigns") / table.name).absolute()
    digest = hashlib.sha256("\n".join(map(repr, runs)).encode()).hexdigest()
    source = [campaign if campaign in bundled_campaigns() else str(Path(campaign).absolute())]
    source += [] if seeds is None else ["--seeds", str(seeds)]
    store = Store(path, text, Facts(digest=digest, runs=len(runs), source=source))
    todo = [run for run in runs if run.number not in store.done]
    if len(todo) < len(runs):
        console.print(f"{len(runs) - len(todo)} of {len(runs)} runs are there already")
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
               TimeRemainingColumn(), TextColumn("{task.fields[said]}"))  # fmt: skip
    rows = execute.fly(todo, path, scheduler, jobs or processors())
    bar = Progress(*columns, console=console, transient=True)
    shown = bar.add_task(table.name, total=len(runs), completed=len(store.done), said="")
    try:
        with store, contextlib.closing(rows), bar:
            for row in rows:
                store.add(row)
                counts[_what(row)] += 1
                bar.update(shown, advance=1, said=_counted(counts))
    except KeyboardInterrupt:
        there = f"{len(store.done)} of {len(runs)} runs are there"
        console.print(f"stopped: {there}. The same command goes on.")
        raise typer.Exit(_INTERRUPTED) from None
    except OSError as error:
        rule = f"{error.filename or path} cannot be written to ({error.strerror or error})"
        remedy = f"Make room: the same command goes on from {len(store.done)} of {len(runs)} runs."
        raise InputError("--out", str(path), rule, remedy) from error
    took_s = time.perf_counter() - began_s
    summary = _counted(counts) or "nothing to do"
    console.print(f"{len(todo)} runs in {took_s:.0f} s: {summary}", highlight=False)
    console.out(f"campaign: {path}", highlight=False)


def _chosen(runs: list["Run"], most: int | None, only: list[int] | None) -> list["Run"]:
    if only:
        if beyond := [number for number in only if number >= len(runs)]:
            rule = f"the campaign has runs 0 to {len(runs) - 1}"
            raise InputError("--only", beyond[0], rule, "Give one of them.")
        return [runs[number] for number in sorted(set(only))]
    most = min(most or len(runs), len(runs))
    return [runs[k * len(runs) // most] for k in range(most)]


def _what(row: Row) -> str:
    if row.get("error") is not None:
        return "errors"
    if row.get("violations"):
        return "with violations"
    return "arrived" if row["arrived"] else "not arrived"


def _counted(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))


@campaign_app.command("report")
def report_command(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help=_FOLDER)],
    by: Annotated[list[str] | None, Option(metavar="FACTOR", help=_BY)] = None,
    html: Annotated[Path | None, Option(metavar="FILE", help=_HTML)] = None,
    csv: Annotated[Path | None, Option(metavar="FILE", help=_CSV)] = None,
) -> None:
    """Say what a campaign came to: rates, costs, comparisons in pairs, the worst runs.

    Groups are compared with the first of the campaign, in runs of the same world and seed. The
    page is one file that opens without a network, and prints.
    """
    need("campaign", "FOLDER", str(folder))
    from companion.campaign import report as campaign  # slow to import

    console = table_console(soft_wrap=True)
    with plain_console(stderr=True).status("reading the campaign"):
        report = campaign.report_of(campaign.read_campaign(folder), by or ())
        files = [("--html", html or folder / "report.html", campaign.report_html(report))]
        files += [("--csv", csv, campaign.figures_csv(report))] if csv is not None else []
    for shown in campaign.terminal_tables(report):
        console.print(shown)
    for option, path, text in files:
        with writing(option, path):
            path.write_text(text, encoding="utf-8")
        console.out(f"written: {path}", highlight=False)
