"""`companion compare`: the paper's table and figures, computed again."""

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich import box
from rich.progress import track
from rich.table import Table

from companion import extras
from companion.errors import InputError
from companion.paper.compare import PER_SECOND
from companion.runtime.processes import processors
from companion.sources.files import picture_file, writable, writing
from companion.views.output import plain_console

if TYPE_CHECKING:
    from companion.paper.compare.comparisons import Comparison, Row
    from companion.paper.compare.missions import Outcome

compare_app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    help="Compute the paper's Table 1, Fig. 3 and Fig. 4 again; fly the planners that it names.",
)
Option = typer.Option
Runs = Annotated[int, Option(min=1, max=1000, help="Missions for each setting, each with a seed.")]
_JOBS = "Processes to fly them in; by default one per processor, one without the extra campaign."
Jobs = Annotated[int | None, Option(min=1, help=_JOBS)]
_SEED = "Seed of the first mission; the others count on from it."
Seed = Annotated[int, Option(min=0, help=_SEED)]
_JSON = "Write all numbers to a JSON file."
Json = Annotated[Path | None, Option("--json", metavar="FILE", help=_JSON)]
_FIGURE = "Picture to write: .png, .svg or .pdf; by default COMMAND.png."
Picture = Annotated[Path | None, Option("--figure", "--out", metavar="FILE", help=_FIGURE)]
_EVALUATIONS = "Evaluations that stand for a second of T."
_PLANNERS = "Only these; by default ours and all that are installed."
_OF_THE_PAPER = {
    "table-1": "Table 1: improved DE, classical DE, PSO and GA on two environments, two budgets.",
    "figure-3": "Fig. 3: climb over a ridge or go round it, by the weights of height and guide.",
    "figure-4": "Fig. 4: fly between two overlapping radars or round both, by d_overlap.",
}


def _add(name: str, says: str) -> None:
    @compare_app.command(name, help=says)
    def command(
        runs: Runs = 20,
        jobs: Jobs = None,
        seed: Seed = 1,
        json_file: Json = None,
        figure: Picture = None,
        per_second: Annotated[int, Option(min=1, help=_EVALUATIONS)] = PER_SECOND,
    ) -> None:
        from companion.paper.compare import comparisons  # slow to import

        comparison = getattr(comparisons, name.replace("-", "_"))(per_second)
        _compare(comparison, runs, jobs, seed, json_file, figure or Path(f"{name}.png"))


for _name, _says in _OF_THE_PAPER.items():
    _add(_name, _says)


@compare_app.command("routes")
def routes_command(
    runs: Runs = 1,
    jobs: Jobs = None,
    seed: Seed = 1,
    json_file: Json = None,
    planners: Annotated[list[str] | None, Option("--planner", help=_PLANNERS)] = None,
) -> None:
    """The planners that the paper's introduction names, beside ours, in both environments."""
    from companion.paper.compare import comparisons  # slow to import

    _compare(comparisons.routes(planners or ()), runs, jobs, seed, json_file, None)


def _compare(
    comparison: "Comparison",
    runs: int,
    jobs: int | None,
    seed: int,
    json_file: Path | None,
    picture: Path | None,
) -> None:
    """Fly the cases with a bar that shows how far it is; print the tables, and write the files.

    A file that cannot be written is refused before anything is flown.
    """
    from companion.paper.compare.missions import fly_all  # slow to import

    if picture is not None and json_file is not None and json_file.absolute() == picture.absolute():
        rule = "the picture goes there (--figure)"
        raise InputError("--json", str(json_file), rule, "Name another file.")
    picture = picture and picture_file("--figure", picture)
    json_file = json_file and writable("--json", json_file)
    jobs = jobs or (1 if extras.missing("campaign") else processors())
    console, bar = plain_console(), plain_console(stderr=True)
    total = runs * len(comparison.cases)
    shown = partial(track, description="flying", total=total, console=bar, transient=True)
    found = fly_all(comparison.cases, runs, seed, jobs, shown)
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


def table(title: str, row: "Row", found: "Sequence[Outcome]") -> Table:
    """A row for each outcome, and one for each heading if there are several.

    Its cells stay whole in a terminal of 80 columns.
    """
    result = Table(title=title, box=box.SIMPLE_HEAD, padding=0)
    result.add_column("", no_wrap=True)
    for name in row(found[0]):
        result.add_column(name, justify="right")
    heading, several = "", len({outcome.case.heading for outcome in found}) > 1
    for outcome in found:
        if several and outcome.case.heading != heading:
            result.add_row(heading := outcome.case.heading)
        result.add_row("  " * several + outcome.case.label, *row(outcome).values())
    return result
