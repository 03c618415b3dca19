"""`companion compare`: the paper's table and figures, computed again."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from companion.compare import effects, table_1
from companion.compare.missions import Case, Run
from companion.compare.pool import fly_all, processors
from companion.errors import InputError
from companion.sources.files import picture_file, writable

compare_app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    help="Compute the paper's Table 1, Fig. 3 and Fig. 4 again, beside what the paper says.",
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
    picture, numbers = _files(figure or Path("table-1.png"), json_file)
    found = table_1.rows(_flown(table_1.cases(runs, seed, per_second), jobs))
    remarks = table_1.remarks(found, per_second)
    _show([table_1.table(found), table_1.violations_table(found)], remarks)

    def draw() -> None:
        from companion.compare.pictures import compose_table  # slow to import
        from companion.views.figure import save

        save(compose_table(found, remarks), picture)

    _write("--figure", picture, draw)
    _write_numbers(numbers, table_1.facts(found, per_second), runs, seed)


def _add_figure(name: str, words: str, effect_of: Callable[[], effects.Effect]) -> None:
    @compare_app.command(name, help=words)
    def figure_command(
        runs: RunsOption = 20,
        jobs: JobsOption = None,
        seed: SeedOption = 1,
        json_file: JsonOption = None,
        figure: FigureOption = None,
    ) -> None:
        effect = effect_of()
        picture, numbers = _files(figure or Path(f"{effect.name}.png"), json_file)
        found = effects.outcomes(effect, _flown(effects.cases(effect, runs, seed), jobs))
        remarks = effects.remarks(effect)
        _show([effects.table(effect, found)], remarks)

        def draw() -> None:
            from companion.compare.pictures import compose_effect  # slow to import
            from companion.views.figure import save

            save(compose_effect(effect, found, remarks[-1]), picture)

        _write("--figure", picture, draw)
        _write_numbers(numbers, effects.facts(effect, found), runs, seed)


_add_figure(
    "figure-3",
    "Fig. 3: climb over a ridge or go round it, by the weights of height and guide.",
    effects.figure_3,
)
_add_figure(
    "figure-4",
    "Fig. 4: fly between two overlapping radars or round both, by d_overlap.",
    effects.figure_4,
)


def _flown(cases: Sequence[Case], jobs: int | None) -> list[Run]:
    """Fly them all, with a bar that shows how far it is."""
    columns = (TextColumn("flying"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("", total=len(cases))
        return fly_all(cases, jobs or processors(), lambda: progress.advance(bar))


def _show(tables: Sequence[Table], remarks: Sequence[str]) -> None:
    console = Console()
    for table in tables:
        console.print(table)
    for remark in remarks:
        console.print(remark, highlight=False, markup=False)


def _files(picture: Path, json_file: Path | None) -> tuple[Path, Path | None]:
    """The picture's file and that of the numbers: both can be written, and they are two."""
    if json_file is not None and json_file.absolute() == picture.absolute():
        rule = "the picture goes there (--figure)"
        raise InputError("--json", str(json_file), rule, "Name another file.")
    return picture_file("--figure", picture), json_file and writable("--json", json_file)


def _write(option: str, path: Path, writer: Callable[[], object]) -> None:
    try:
        writer()
    except OSError as error:
        remedy = "Give a file that can be written."
        raise InputError(option, str(path), f"not written ({error})", remedy) from error
    what = {"--figure": "picture", "--json": "numbers"}[option]
    Console().print(f"{what}: {path}", highlight=False, markup=False, soft_wrap=True)


def _write_numbers(path: Path | None, facts: list[dict[str, object]], runs: int, seed: int) -> None:
    if path is not None:
        text = json.dumps({"runs": runs, "seed": seed, "results": facts}, indent=1)
        _write("--json", path, lambda: path.write_text(text + "\n", encoding="utf-8"))
