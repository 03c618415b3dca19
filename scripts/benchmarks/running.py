"""What every benchmark does alike: its options, its processes, what it prints and stores."""

import json
import operator
import os
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.progress import track
from rich.table import Table


def begin(doc: str | None, *, width: int = 140, **declared: Any) -> tuple[Namespace, Console]:
    """The options of a run, --json among them, and where to print.

    Each is a default; a list of choices, the first of which is the default; a type, if there is no
    default; either in a pair with its help; or what argparse takes, as a dict.
    """
    parser = ArgumentParser(description=(doc or "").partition("\n")[0])
    for name, said in declared.items():
        value, about = said if isinstance(said, tuple) else (said, None)
        how: dict[str, Any] = {"type": type(value), "default": value}
        if isinstance(value, dict):
            how = value
        elif isinstance(value, bool):
            how = {"action": "store_true"}
        elif isinstance(value, type):
            how = {"type": value}
        elif isinstance(value, list):
            how = {"choices": value, "default": value[0]}
        parser.add_argument(f"--{name.replace('_', '-')}", help=about, **how)
    parser.add_argument("--json", type=Path, help="where the numbers are written")
    wide = None if sys.stdout.isatty() else width
    return parser.parse_args(), Console(highlight=False, width=wide)


def figures(title: str, first: str, *headings: str, **options: Any) -> Table:
    """A table of numbers: all columns but the first to the right."""
    table = Table(title=title, **{"box": None, "pad_edge": False} | options)
    table.add_column(first, no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right")
    return table


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


def ended(console: Console, path: Path | None, found: Any, bars: Sequence[Bar] = ()) -> int:
    """Print the bars, and write them and the numbers if that was asked for.  -> the exit code"""
    if bars:
        table = figures("", "", "bar", "measured", "")
        for bar in bars:
            table.add_row(bar.what, bar.bar, bar.measured, "met" if bar.kept else "missed")
        console.print(table)
    if path is not None:
        said = {"bars": bars, "found": found}
        path.write_text(json.dumps(said, indent=1, default=str) + "\n", encoding="utf-8")
    return 0 if all(bar.kept for bar in bars) else 1


def in_processes(
    task: Callable[..., Any],
    todo: Sequence[tuple[Any, ...]],
    jobs: int,
    what: str,
    console: Console,
) -> Iterator[tuple[tuple[Any, ...], Future[Any]]]:
    """Calls in processes of their own, one core for each: arguments and results, in their order."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        futures = [(each, pool.submit(task, *each)) for each in todo]
        yield from track(futures, what, console=console, transient=True)
