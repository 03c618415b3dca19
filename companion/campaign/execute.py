"""Where runs are flown: on the cores of this machine, or on a Dask cluster.

Both take runs and give rows as they come, in any order; a worker that is lost takes no run with it.
"""

import os
from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path

from companion.campaign.file import Run
from companion.campaign.row import Row
from companion.campaign.run import fly_run, lost_run
from companion.errors import FlightInterrupted, InputError
from companion.runtime.compiler import load_kernel
from companion.runtime.worker_pool import worker_pool

_RETRIES = 3
"""How often a run may lose its worker until that is held against it."""
_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
_AHEAD = 4
"""Runs to a worker that are handed out before they are needed."""


def fly_locally(runs: Sequence[Run], out: Path, jobs: int) -> Iterator[Row]:
    """On so many cores, each run in one of as many processes.  OSError: no room for a folder."""
    for name in _ONE_THREAD:
        os.environ.setdefault(name, "1")
    if runs:
        load_kernel()  # compiled once, before all look for it
    left, lost = list(reversed(runs)), dict[int, int]()
    while left:
        left = yield from _until_broken(left, lost, out, jobs)


def _until_broken(
    left: list[Run], lost: dict[int, int], out: Path, jobs: int
) -> Generator[Row, None, list[Run]]:
    """Fly until all are done or a worker is lost -> what is left, the next one last."""
    # After a loss nobody knows whose it was: so many fly that few are suspected.
    ahead = jobs if lost else _AHEAD * jobs
    waiting: dict[Future[Row], Run] = {}
    # by Ctrl-C: what is being flown is flown again another time
    with worker_pool(jobs) as submit:
        try:
            while left or waiting:
                while left and len(waiting) < ahead:
                    run = left.pop()
                    waiting[submit(fly_run, run, out)] = run
                done, _ = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    if isinstance(error := future.exception(), OSError):
                        raise error
                    if error is None:
                        del waiting[future]
                        yield future.result()
                if waiting.keys() & done:
                    return (yield from _left(left, waiting.values(), lost))
        except BrokenProcessPool:  # while one was handed out
            left.append(run)
            return (yield from _left(left, waiting.values(), lost))
    return []


def _left(
    left: list[Run], flown: Iterable[Run], lost: dict[int, int]
) -> Generator[Row, None, list[Run]]:
    """Count a lost worker against all that it may have flown, and give up those that lose many."""
    again = []
    for run in flown:
        lost[run.number] = lost.get(run.number, 0) + 1
        if lost[run.number] < _RETRIES:
            again.append(run)
        else:
            yield lost_run(run, f"its worker died {_RETRIES} times")
    return [*left, *reversed(again)]


def fly_on_cluster(runs: Sequence[Run], out: Path, scheduler: str) -> Iterator[Row]:
    """On the workers of a Dask scheduler, which sees to those that it loses.

    OSError: no room for a folder.
    """
    from distributed import Client, as_completed

    try:
        client = Client(scheduler, timeout="10s")
    except (OSError, ValueError) as error:
        rule = f"no Dask scheduler answers there ({' '.join(str(error).split())})"
        remedy = "Start one with: dask scheduler. See docs/campaigns.md."
        raise InputError("--scheduler", scheduler, rule, remedy) from None
    with client:
        futures = client.map(
            partial(fly_run, out=out), runs, pure=False, retries=_RETRIES, batch_size=1_000
        )
        by_key = {future.key: run for future, run in zip(futures, runs, strict=True)}
        try:
            for future in as_completed(futures):
                if future.status == "finished":
                    yield future.result()
                elif future.status == "error":
                    lost = future.exception()
                    if isinstance(lost, OSError) and lost.errno is not None:
                        raise lost  # no room for its folder: no result, as on this machine
                    yield lost_run(by_key[future.key], repr(lost))
                else:
                    text = "the Dask scheduler is gone, or has cancelled the campaign"
                    raise FlightInterrupted(text, "Give the same command again to go on.")
                future.release()
        finally:
            client.cancel(futures)
