"""`companion compare`: the paper's table and figures, computed again."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import track

from companion.errors import InputError
from companion.paper.compare.figures import figure_3, figure_4
from companion.paper.compare.missions import Comparison, fly_all, table
from companion.paper.compare.routes import routes
from companion.paper.compare.table_1 import PER_SECOND, table_1
from companion.runtime.worker_pool import processors
from companion.sources.files import picture_file, writable, writing
from companion.views.output import plain_console

compare_app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    help="Compute the paper's Table 1, Fig. 3 and Fig. 4 again; fly the planners that it names.",
)

RunsOption = Annotated[
    int, typer.Option(min=1, max=1000, help="Missions for each setting, each with a seed.")
]
JobsOption = Annotated[
    int | None,
    typer.Option(min=1, help="Processes to fly them in; by default one per processor."),
]
SeedOption = Annotated[
    int, typer.Option(min=0, help="Seed of the first mission; the others count on from it.")
]
JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write all numbers to a JSON file.")
]
FigureOption = Annotated[
    Path | None,
    typer.Option(
        "--figure",
        "--out",
        metavar="FILE",
        help="Picture to write: .png, .svg or .pdf; by default COMMAND.png.",
    ),
]


def _add(name: str, comparison_of: Callable[[int], Comparison]) -> None:
    @compare_app.command(name, help=comparison_of.__doc__)
    def command(
        runs: RunsOption = 20,
        jobs: JobsOption = None,
        seed: SeedOption = 1,
        json_file: JsonOption = None,
        figure: FigureOption = None,
        per_second: Annotated[
            int, typer.Option(min=1, help="Evaluations that stand for a second of T.")
        ] = PER_SECOND,
    ) -> None:
        picture = figure or Path(f"{name}.png")
        _compare(comparison_of(per_second), runs, jobs, seed, json_file, picture)


_add("table-1", table_1)
_add("figure-3", figure_3)
_add("figure-4", figure_4)


@compare_app.command("routes")
def routes_command(
    runs: RunsOption = 1,
    jobs: JobsOption = None,
    seed: SeedOption = 1,
    json_file: JsonOption = None,
    planners: Annotated[
        list[str] | None,
        typer.Option("--planner", help="Only these; by default ours and all that are installed."),
    ] = None,
) -> None:
    """The planners that the paper's introduction names, beside ours, in both environments."""
    _compare(routes(planners or ()), runs, jobs, seed, json_file, None)


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
    for title, columns in comparison.tables.items():
        console.print(table(title, columns, found))
    for remark in comparison.remarks(found):
        console.print(remark, highlight=False)
    if picture is not None:
        from companion.paper.compare import pictures  # slow to import

        with writing("--figure", picture):
            pictures.draw(comparison, found, picture)
        console.out(f"picture: {picture}", highlight=False)
    if json_file is not None:
        results = [outcome.facts() | comparison.more(outcome) for outcome in found]
        numbers = {"runs": runs, "seed": seed, "results": results}
        with writing("--json", json_file):
            json_file.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
        console.out(f"numbers: {json_file}", highlight=False)
