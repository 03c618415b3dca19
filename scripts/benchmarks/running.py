"""What every benchmark does alike: its options, its processes, what it prints and stores."""

import json
import os
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

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


def store(path: Path | None, found: Any) -> None:
    """Write the numbers, if that was asked for."""
    if path is not None:
        path.write_text(json.dumps(found, indent=1, default=str) + "\n", encoding="utf-8")


def ended(console: Console, *, kept: bool) -> int:
    """Say whether the bars are kept.  -> the exit code"""
    console.print("the bar is kept" if kept else "the bar is broken", style="bold")
    return 0 if kept else 1


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
