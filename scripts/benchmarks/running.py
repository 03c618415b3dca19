"""The frame of every benchmark: a function that yields what it measures.

A dict is a row of a table: of each heading (with the format of its numbers after `|`) the value.
Rows of the same headings that follow each other make one table.  A `Bar` is held, a text is printed
at once, and whatever else is yielded goes to the file of --json alone, as rows and bars do too.
The parameters of the function are the options of its command.
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
from typing import Any, NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

Found = Iterator[Any]
"""What a benchmark yields."""
_WIDTH = None if sys.stdout.isatty() else 150
CONSOLE = Console(highlight=False, markup=False, emoji=False, width=_WIDTH)


class OneOf(str):
    """The default of an option that is one of some words."""

    __slots__ = ("among",)

    def __new__(cls, default: str, *others: str) -> "OneOf":
        """The first word is the default."""
        it = super().__new__(cls, default)
        it.among = (default, *others)
        return it


class Some(tuple[Any, ...]):
    """The default of an option that is several values: all of the words that it may be."""

    __slots__ = ()


class Bar(NamedTuple):
    """What was asked of something, and what it came to."""

    what: str
    bar: str
    measured: str
    kept: bool


def most(what: str, measured: Sequence[float] | float, bars: Sequence[float] | float) -> Bar:
    """No value may be above its bar; without values the bar is missed."""
    values, limits = (each if isinstance(each, Sequence) else [each] for each in (measured, bars))
    kept = len(values) == len(limits) and all(map(operator.le, values, limits))
    return Bar(what, _listed(limits), _listed(values), kept)


def least(what: str, measured: float, bar: float) -> Bar:
    """The value may not be below its bar."""
    return Bar(what, f"{bar:g} or more", f"{measured:.4g}", measured >= bar)


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.4g}" for value in values)


def main(measure: Callable[..., Found]) -> None:
    """Run a benchmark as a command; it ends with 1 if a bar is missed."""
    about = sys.modules[measure.__module__].__doc__
    parser = ArgumentParser(description=about, formatter_class=RawDescriptionHelpFormatter)
    for name, parameter in inspect.signature(measure).parameters.items():
        option = f"--{name.rstrip('_').replace('_', '-')}"
        parser.add_argument(option, dest=name, **_declared(parameter))
    parser.add_argument("--json", type=Path, help="where the numbers are written")
    options = vars(parser.parse_args())
    path = options.pop("json")
    found = shown(measure(**options))
    bars: list[Bar] = found["bars"]
    if bars:
        _print([bar._asdict() | {"kept": "met" if bar.kept else "missed"} for bar in bars])
    if path is not None:
        path.write_text(json.dumps(found, indent=1, default=_plain) + "\n", encoding="utf-8")
    sys.exit(not all(bar.kept for bar in bars))


def _plain(value: Any) -> Any:
    """What JSON has in place of a number of numpy, or of anything else."""
    return value.item() if isinstance(value, np.generic) else str(value)


def _declared(parameter: inspect.Parameter) -> dict[str, Any]:
    """What argparse is told of an option."""
    default, kind = parameter.default, parameter.annotation
    if default is parameter.empty:
        return {"type": kind, "required": True}
    if isinstance(default, bool):
        return {"action": "store_true"}
    if isinstance(default, OneOf):
        return {"choices": default.among, "default": str(default)}
    if isinstance(default, tuple):
        among = default if isinstance(default, Some) else None
        return {"type": type(default[0]), "nargs": "+", "choices": among, "default": default}
    return {"type": type(default), "default": default}


def shown(results: Iterable[Any]) -> dict[str, list[Any]]:
    """Print what a benchmark yields.  -> its rows, its bars and its other figures"""
    kept: dict[str, list[Any]] = {"bars": [], "rows": [], "found": []}
    for headings, some in groupby(results, lambda it: tuple(it) if isinstance(it, dict) else ()):
        if headings:
            rows = list(some)
            _print(rows)
            kept["rows"] += [{_parts(name)[0]: row[name] for name in row} for row in rows]
            continue
        for each in some:
            if isinstance(each, str):
                CONSOLE.print(each)
            else:
                kept["bars" if isinstance(each, Bar) else "found"].append(each)
    return kept


def _print(rows: Sequence[dict[str, Any]]) -> None:
    """A table, as Markdown: all columns but the first to the right."""
    table = Table(box=box.MARKDOWN)
    for heading in rows[0]:
        first = not table.columns
        table.add_column(_parts(heading)[0], justify="left" if first else "right", no_wrap=first)
    for row in rows:
        cells = ((value, _parts(heading)[1]) for heading, value in row.items())
        table.add_row(*("" if value is None else format(value, form) for value, form in cells))
    CONSOLE.print(table)


def _parts(heading: str) -> tuple[str, str]:
    """A heading, and the format of the numbers below it."""
    name, _, form = heading.partition("|")
    return name, form


def in_processes(
    task: Callable[..., Any], todo: Sequence[tuple[Any, ...]], jobs: int
) -> Iterator[Any]:
    """What calls return, in their order, each made in a process of one core."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(task, *each) for each in todo]
        for future in progress(futures):
            yield future.result()


def progress(todo: Sequence[Any]) -> Iterable[Any]:
    """The same, with a bar that shows how far it is."""
    return track(todo, "measuring", console=CONSOLE, transient=True)
