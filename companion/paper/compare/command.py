"""`companion compare`: the paper's table and figures again, and rivals for whole routes."""

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
What = Literal["table-1", "figure-3", "figure-4", "routes"]
_WHAT = (
    "*table-1*: improved DE, classical DE, PSO and GA on two environments, two budgets. "
    "*figure-3*: climb over a ridge or go round it, by the weights of height and guide. "
    "*figure-4*: fly between two overlapping radars or round both, by d_overlap. "
    "*routes*: the planners that the paper's introduction names, beside ours, in both environments."
)
_RUNS = "Missions for each setting, each with a seed; by default 20, of routes 1."
_JOBS = "Processes to fly them in; by default one per processor, one without the extra campaign."
_FIGURE = "Picture to write, of a figure: .png, .svg or .pdf; by default FIGURE.png."
_PER_SECOND = f"Evaluations that stand for a second of T, but of routes; by default {PER_SECOND}."
_PLANNERS = "Of routes only these; by default ours and all that are installed.  May be repeated."


def compare_command(
    what: Annotated[What, typer.Argument(help=_WHAT)],
    runs: Annotated[int | None, Option(min=1, max=1000, help=_RUNS)] = None,
    jobs: Annotated[int | None, Option(min=1, help=_JOBS)] = None,
    seed: Annotated[
        int, Option(min=0, help="Seed of the first mission; the others count on from it.")
    ] = 1,
    json_file: Annotated[
        Path | None, Option("--json", metavar="FILE", help="Write all numbers to a JSON file.")
    ] = None,
    figure: Annotated[Path | None, Option(metavar="FILE", help=_FIGURE)] = None,
    per_second: Annotated[int | None, Option(min=1, help=_PER_SECOND)] = None,
    planners: Annotated[list[str] | None, Option("--planner", help=_PLANNERS)] = None,
) -> None:
    """Compute the paper's Table 1, Fig. 3 or Fig. 4 again; fly the planners that it names.

    A file that cannot be written is refused before anything is flown.
    """
    from companion.paper.compare import comparisons  # slow to import
    from companion.paper.compare.missions import fly_all

    is_figure, is_routes = what.startswith("figure"), what == "routes"
    for option, value, fits in (
        ("--figure", figure and str(figure), is_figure),
        ("--per-second", per_second, not is_routes),
        ("--planner", planners and planners[0], is_routes),
    ):
        if value and not fits:
            raise InputError(option, value, f"it has no effect on {what}", "Leave it out.")
    picture = picture_file("--figure", figure or Path(f"{what}.png")) if is_figure else None
    json_file = json_file and writable("--json", json_file)
    jobs = jobs or (1 if extras.missing("campaign") else processors())
    if is_routes:
        comparison = comparisons.routes(planners or ())
    else:
        comparison = getattr(comparisons, what.replace("-", "_"))(per_second or PER_SECOND)
    runs = runs or (1 if is_routes else 20)
    console, bar = plain_console(), plain_console(stderr=True)
    total = runs * len(comparison.cases)
    shown = partial(track, description="flying", total=total, console=bar, transient=True)
    outcomes = fly_all(comparison.cases, runs, seed, jobs, shown)
    for title, row in comparison.tables.items():
        console.print(comparisons.table(title, row, outcomes))
    for remark in comparison.remarks(outcomes):
        console.print(remark, highlight=False)
    if picture is not None:
        from companion.paper.compare import pictures  # slow to import

        with writing("--figure", picture):
            pictures.draw(comparison, outcomes, picture)
        console.out(f"picture: {picture}", highlight=False)
    if json_file is not None:
        results = [outcome.facts() for outcome in outcomes]
        numbers = {"runs": runs, "seed": seed, "results": results}
        with writing("--json", json_file):
            json_file.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
        console.out(f"numbers: {json_file}", highlight=False)
