"""The frame of every benchmark: a function that yields what it measures.

A dict is a row of a table: of each heading (with the format of its numbers after `|`) the value.
Rows of the same headings that follow each other make one table.  A `Bar` is held, a text is printed
at once, and whatever else is yielded goes to the file of --json alone, as rows and bars do too.
The parameters of the function are the options of its command; a Literal names the choices.
"""

import inspect
import json
import operator
import os
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import groupby
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

Found = Iterator[Any]
"""What a benchmark yields."""
CONSOLE = Console(
    highlight=False, markup=False, emoji=False, width=None if sys.stdout.isatty() else 150
)


class Bar(NamedTuple):
    """What was asked of something, and what it came to."""

    what: str
    bar: str
    measured: str
    kept: bool


def most(what: str, measured: Sequence[float] | float, bars: Sequence[float] | float) -> Bar:
    """No value may be above its bar; without values the bar is missed."""
    values, limits = (
        numbers if isinstance(numbers, Sequence) else [numbers] for numbers in (measured, bars)
    )
    kept = len(values) == len(limits) and all(map(operator.le, values, limits))
    words = (", ".join(f"{value:.4g}" for value in numbers) for numbers in (limits, values))
    return Bar(what, *words, kept)


def least(what: str, measured: float, bar: float) -> Bar:
    """The value may not be below its bar."""
    return Bar(what, f"{bar:g} or more", f"{measured:.4g}", measured >= bar)


def main(measure: Callable[..., Found]) -> None:
    """Run a benchmark as a command; it ends with 1 if a bar is missed."""
    about = sys.modules[measure.__module__].__doc__
    parser = ArgumentParser(description=about, formatter_class=RawDescriptionHelpFormatter)
    for name, parameter in inspect.signature(measure).parameters.items():
        default, (inner, *_) = parameter.default, (*get_args(parameter.annotation), None)
        several = isinstance(default, tuple)
        among = get_args(inner if several else parameter.annotation)
        parser.add_argument(
            f"--{name.replace('_', '-')}", default=default,
            **{"action": "store_true"} if isinstance(default, bool) else
            {"type": type(default[0] if several else default), "nargs": "+" if several else None,
             "choices": among if str in map(type, among) else None},
        )  # fmt: skip
    parser.add_argument("--json", type=Path, help="where the numbers are written")
    options = vars(parser.parse_args())
    path = options.pop("json")
    results = shown(measure(**options))
    bars: list[Bar] = results["bars"]
    if bars:
        _print([bar._asdict() | {"kept": "met" if bar.kept else "missed"} for bar in bars])
    if path is not None:
        path.write_text(json.dumps(results, indent=1, default=_plain) + "\n", encoding="utf-8")
    sys.exit(not all(bar.kept for bar in bars))


def _plain(value: Any) -> Any:
    """What JSON has in place of a number of numpy, or of anything else."""
    return value.item() if isinstance(value, np.generic) else str(value)


def shown(results: Iterable[Any]) -> dict[str, list[Any]]:
    """Print what a benchmark yields.  -> its rows, its bars and its other figures"""
    kept: dict[str, list[Any]] = {"bars": [], "rows": [], "found": []}
    for headings, some in groupby(results, lambda it: tuple(it) if isinstance(it, dict) else ()):
        if headings:
            rows = list(some)
            _print(rows)
            kept["rows"] += [{name.partition("|")[0]: row[name] for name in row} for row in rows]
            continue
        for result in some:
            if isinstance(result, str):
                CONSOLE.print(result)
            else:
                kept["bars" if isinstance(result, Bar) else "found"].append(result)
    return kept


def _print(rows: Sequence[dict[str, Any]]) -> None:
    """A table, as Markdown: all columns but the first to the right."""
    table, forms = Table(box=box.MARKDOWN), [heading.partition("|")[2] for heading in rows[0]]
    for number, heading in enumerate(rows[0]):
        justify: Any = "right" if number else "left"
        table.add_column(heading.partition("|")[0], justify=justify, no_wrap=not number)
    for row in rows:
        cells = zip(row.values(), forms, strict=True)
        table.add_row(*("" if value is None else format(value, form) for value, form in cells))
    CONSOLE.print(table)


def in_processes(
    task: Callable[..., Any], todo: Sequence[tuple[Any, ...]], jobs: int
) -> Iterator[Any]:
    """What calls return, in their order, each made in a process of one core."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(task, *arguments) for arguments in todo]
        for future in track(futures, "measuring", console=CONSOLE, transient=True):
            yield future.result()
