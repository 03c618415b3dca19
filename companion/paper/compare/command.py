"""`companion compare`: the paper's table and figures, computed again."""

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.progress import track
from rich.table import Table

from companion.errors import InputError
from companion.paper.compare import comparisons
from companion.paper.compare.comparisons import PER_SECOND, Comparison, Row, by_heading
from companion.paper.compare.missions import Outcome, fly_all
from companion.runtime.worker_pool import processors
from companion.sources.files import picture_file, writable, writing
from companion.views.output import plain_console

compare_app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    help="Compute the paper's Table 1, Fig. 3 and Fig. 4 again; fly the planners that it names.",
)
Option = typer.Option
Runs = Annotated[int, Option(min=1, max=1000, help="Missions for each setting, each with a seed.")]
_JOBS = "Processes to fly them in; by default one per processor."
Jobs = Annotated[int | None, Option(min=1, help=_JOBS)]
_SEED = "Seed of the first mission; the others count on from it."
Seed = Annotated[int, Option(min=0, help=_SEED)]
_JSON = "Write all numbers to a JSON file."
Json = Annotated[Path | None, Option("--json", metavar="FILE", help=_JSON)]
_FIGURE = "Picture to write: .png, .svg or .pdf; by default COMMAND.png."
Picture = Annotated[Path | None, Option("--figure", "--out", metavar="FILE", help=_FIGURE)]
_EVALUATIONS = "Evaluations that stand for a second of T."
_PLANNERS = "Only these; by default ours and all that are installed."


def _add(name: str, comparison_of: Callable[[int], Comparison]) -> None:
    @compare_app.command(name, help=comparison_of.__doc__)
    def command(
        runs: Runs = 20,
        jobs: Jobs = None,
        seed: Seed = 1,
        json_file: Json = None,
        figure: Picture = None,
        per_second: Annotated[int, Option(min=1, help=_EVALUATIONS)] = PER_SECOND,
    ) -> None:
        picture = figure or Path(f"{name}.png")
        _compare(comparison_of(per_second), runs, jobs, seed, json_file, picture)


_add("table-1", comparisons.table_1)
_add("figure-3", comparisons.figure_3)
_add("figure-4", comparisons.figure_4)


@compare_app.command("routes")
def routes_command(
    runs: Runs = 1,
    jobs: Jobs = None,
    seed: Seed = 1,
    json_file: Json = None,
    planners: Annotated[list[str] | None, Option("--planner", help=_PLANNERS)] = None,
) -> None:
    """The planners that the paper's introduction names, beside ours, in both environments."""
    _compare(comparisons.routes(planners or ()), runs, jobs, seed, json_file, None)


def _compare(
    comparison: Comparison,
    runs: int,
    jobs: int | None,
    seed: int,
    json_file: Path | None,
    picture: Path | None,
) -> None:
    """Fly the cases with a bar that shows how far it is; print the tables, and write the files.

    A file that cannot be written is refused before anything is flown.
    """
    if picture is not None and json_file is not None and json_file.absolute() == picture.absolute():
        rule = "the picture goes there (--figure)"
        raise InputError("--json", str(json_file), rule, "Name another file.")
    picture = picture and picture_file("--figure", picture)
    json_file = json_file and writable("--json", json_file)
    console, bar = plain_console(), plain_console(stderr=True)
    total = runs * len(comparison.cases)
    shown = partial(track, description="flying", total=total, console=bar, transient=True)
    found = fly_all(comparison.cases, runs, seed, jobs or processors(), shown)
    for title, row in comparison.tables.items():
        console.print(table(title, row, found))
    for remark in comparison.remarks(found):
        console.print(remark, highlight=False)
    if picture is not None:
        from companion.paper.compare import pictures  # slow to import

        with writing("--figure", picture):
            pictures.draw(comparison, found, picture)
        console.out(f"picture: {picture}", highlight=False)
    if json_file is not None:
        results = [outcome.facts() for outcome in found]
        numbers = {"runs": runs, "seed": seed, "results": results}
        with writing("--json", json_file):
            json_file.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
        console.out(f"numbers: {json_file}", highlight=False)


def table(title: str, row: Row, found: Sequence[Outcome]) -> Table:
    """A row for each outcome, and one for each heading if there are several.

    Its cells stay whole in a terminal of 80 columns.
    """
    result = Table(title=title, box=box.SIMPLE_HEAD, padding=0)
    result.add_column("", no_wrap=True)
    for name in row(found[0]):
        result.add_column(name, justify="right")
    parts = by_heading(found)
    indent = "  " if len(parts) > 1 else ""
    for part in parts:
        if indent:
            result.add_row(part[0].case.heading)
        for outcome in part:
            result.add_row(indent + outcome.case.label, *row(outcome).values())
    return result
