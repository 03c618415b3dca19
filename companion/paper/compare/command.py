"""`companion compare`: the paper's table and figures, computed again."""

import json
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.progress import track

from companion import extras
from companion.errors import InputError
from companion.paper.compare import PER_SECOND
from companion.runtime.processes import processors
from companion.sources.files import picture_file, writable, writing
from companion.views.output import plain_console

Option = typer.Option
What = Literal["table-1", "figure-3", "figure-4"]
_WHAT = (
    "*table-1*: improved DE, classical DE, PSO and GA on two environments, two budgets. "
    "*figure-3*: climb over a ridge or go round it, by the weights of height and guide. "
    "*figure-4*: fly between two overlapping radars or round both, by d_overlap."
)
_JOBS = "Processes to fly them in; by default one per processor, one without the extra campaign."
_FIGURE = "Picture to write, of a figure: .png, .svg or .pdf; by default FIGURE.png."


def compare_command(
    what: Annotated[What, typer.Argument(help=_WHAT)],
    runs: Annotated[
        int, Option(min=1, max=1000, help="Missions for each setting, each with a seed.")
    ] = 20,
    jobs: Annotated[int | None, Option(min=1, help=_JOBS)] = None,
    seed: Annotated[
        int, Option(min=0, help="Seed of the first mission; the others count on from it.")
    ] = 1,
    json_file: Annotated[
        Path | None, Option("--json", metavar="FILE", help="Write all numbers to a JSON file.")
    ] = None,
    figure: Annotated[
        Path | None, Option("--figure", "--out", metavar="FILE", help=_FIGURE)
    ] = None,
    per_second: Annotated[
        int, Option(min=1, help="Evaluations that stand for a second of T.")
    ] = PER_SECOND,
) -> None:
    """Compute the paper's Table 1, Fig. 3 or Fig. 4 again.

    A file that cannot be written is refused before anything is flown.
    """
    from companion.paper.compare import comparisons  # slow to import
    from companion.paper.compare.missions import fly_all

    picture = None if what == "table-1" else picture_file("--figure", figure or Path(f"{what}.png"))
    if figure is not None and picture is None:
        raise InputError("--figure", str(figure), "table-1 has no picture", "Leave it out.")
    json_file = json_file and writable("--json", json_file)
    jobs = jobs or (1 if extras.missing("campaign") else processors())
    comparison = getattr(comparisons, what.replace("-", "_"))(per_second)
    console, bar = plain_console(), plain_console(stderr=True)
    total = runs * len(comparison.cases)
    shown = partial(track, description="flying", total=total, console=bar, transient=True)
    found = fly_all(comparison.cases, runs, seed, jobs, shown)
    for title, row in comparison.tables.items():
        console.print(comparisons.table(title, row, found))
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
