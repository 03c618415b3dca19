"""`companion compare`: the paper's table and figures, computed again."""

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.progress import track
from rich.table import Table

from companion.errors import InputError
from companion.paper.compare import figures, routes, table_1
from companion.paper.compare.missions import Case, Outcome, fly_all
from companion.runtime.worker_pool import processors
from companion.sources.files import picture_file, writable, writing
from companion.views.output import plain_console

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


@compare_app.command("table-1")
def table_1_command(
    runs: RunsOption = 20,
    jobs: JobsOption = None,
    seed: SeedOption = 1,
    json_file: JsonOption = None,
    figure: FigureOption = None,
    per_second: Annotated[
        int, typer.Option(min=1, help="Evaluations that stand for a second of T.")
    ] = table_1.PER_SECOND,
) -> None:
    """Table 1: improved DE, classical DE, PSO and GA on two environments with two budgets."""
    files = _files(figure or Path("table-1.png"), json_file)
    found = _flown(table_1.cases(per_second), runs, seed, jobs)
    remarks = table_1.remarks(found, per_second)
    _tell(table_1.tables(found), remarks)
    _draw(lambda pictures: pictures.compose_table(found, remarks), files[0])
    _write({"runs": runs, "seed": seed, "results": table_1.facts(found)}, files[1])


def _add_figure(name: str, words: str, effect_of: Callable[[], figures.Effect]) -> None:
    @compare_app.command(name, help=words)
    def figure_command(
        runs: RunsOption = 20,
        jobs: JobsOption = None,
        seed: SeedOption = 1,
        json_file: JsonOption = None,
        figure: FigureOption = None,
    ) -> None:
        effect = effect_of()
        files = _files(figure or Path(f"{effect.name}.png"), json_file)
        found, remarks = _flown(effect.cases, runs, seed, jobs), figures.remarks(effect)
        _tell([figures.table(effect, found)], remarks)
        _draw(lambda pictures: pictures.compose_effect(effect, found, remarks[-1]), files[0])
        numbers = {"runs": runs, "seed": seed, "results": figures.facts(effect, found)}
        _write(numbers, files[1])


_add_figure(
    "figure-3",
    "Fig. 3: climb over a ridge or go round it, by the weights of height and guide.",
    figures.figure_3,
)
_add_figure(
    "figure-4",
    "Fig. 4: fly between two overlapping radars or round both, by d_overlap.",
    figures.figure_4,
)


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
    json_file = json_file and writable("--json", json_file)
    found = _flown(routes.cases(planners or routes.installed()), runs, seed, jobs)
    _tell([routes.table(found)], [routes.REMARK])
    results = [outcome.facts() for outcome in found]
    _write({"runs": runs, "seed": seed, "results": results}, json_file)


def _flown(cases: Sequence[Case], runs: int, seed: int, jobs: int | None) -> list[Outcome]:
    """Fly them all, with a bar that shows how far it is."""
    shown = partial(
        track,
        description="flying",
        total=runs * len(cases),
        console=plain_console(stderr=True),
        transient=True,
    )
    return fly_all(cases, runs, seed, jobs or processors(), shown)


def _files(picture: Path, json_file: Path | None) -> tuple[Path, Path | None]:
    """The picture's file and that of the numbers: both can be written, and they are two."""
    if json_file is not None and json_file.absolute() == picture.absolute():
        rule = "the picture goes there (--figure)"
        raise InputError("--json", str(json_file), rule, "Name another file.")
    return picture_file("--figure", picture), json_file and writable("--json", json_file)


def _tell(tables: Sequence[Table], remarks: Sequence[str]) -> None:
    """Print tables, and what they cannot say."""
    for table in tables:
        plain_console().print(table)
    for remark in remarks:
        plain_console().print(remark, highlight=False, markup=False)


def _draw(compose: Callable[[Any], "Figure"], picture: Path) -> None:
    """Write a picture; compose makes it with the module `pictures`."""
    from companion.paper.compare import pictures  # slow to import
    from companion.views.figure import save

    with writing("--figure", picture):
        save(compose(pictures), picture)
    plain_console().out(f"picture: {picture}", highlight=False)


def _write(numbers: dict[str, Any], json_file: Path | None) -> None:
    if json_file is not None:
        with writing("--json", json_file):
            json_file.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
        plain_console().out(f"numbers: {json_file}", highlight=False)
