"""Where runs are flown: on the workers of a Dask scheduler, of this machine by default.

Rows come in any order; a worker that is lost takes no run with it.
"""

import logging
import signal
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, closing
from functools import partial
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

from companion.campaign.file import Run
from companion.campaign.run import error_of, fly_run, row_of
from companion.campaign.store import Row
from companion.errors import CompanionError, FlightInterrupted, InputError
from companion.runtime.compiler import load_kernel

_RETRIES = 3  # how often a run may lose its worker until that is held against it, as Dask has it


def fly(runs: Sequence[Run], out: Path, scheduler: str | None, jobs: int) -> Generator[Row]:
    """Fly runs on a scheduler's workers; None: on so many processes of this machine.

    OSError: there is no room for a folder.  InputError: no scheduler answers there.
    """
    flying = worked(partial(fly_run, out=out), runs, scheduler=scheduler, jobs=jobs)
    with closing(flying) as results:
        for number, row in results:
            if isinstance(row, OSError) and row.errno is not None:
                raise row  # no room for its folder: no result of the run
            if isinstance(row, Exception):
                text = str(row) if isinstance(row, CompanionError) else repr(row)
                row = row_of(runs[number], error_of(text))
            yield row


def worked(
    work: Callable[[Any], Any], items: Sequence[Any], *, scheduler: str | None = None, jobs: int
) -> Generator[tuple[int, Any]]:
    """The number of each item and what came of it, or why nothing did; as they come."""
    from distributed import Client, KilledWorker, as_completed  # slow to import

    if not items:
        return
    with ExitStack() as ended:
        where: Any = scheduler or ended.enter_context(_workers_here(jobs))
        try:
            client = ended.enter_context(Client(where, timeout="10s"))
        except (OSError, ValueError) as error:
            rule = f"no Dask scheduler answers there ({' '.join(str(error).split())})"
            remedy = "Start one with: dask scheduler. See docs/campaigns.md."
            raise InputError("--scheduler", scheduler, rule, remedy) from None
        futures = client.map(work, items, pure=False, retries=_RETRIES, batch_size=1_000)
        ended.callback(client.cancel, futures)
        numbers = {future.key: number for number, future in enumerate(futures)}
        for future in as_completed(futures):
            if future.status == "finished":
                result = future.result()
            elif future.status == "error":
                result = future.exception()
                if isinstance(result, KilledWorker):
                    result = CompanionError(f"its worker died {_RETRIES} times and more")
            else:
                text = "the Dask scheduler is gone, or has cancelled the campaign"
                raise FlightInterrupted(text, "Give the same command again to go on.")
            yield numbers[future.key], result
            future.release()


def _workers_here(jobs: int) -> Any:
    """A cluster of processes that fly one run at a time, and end with this one."""
    from distributed import LocalCluster

    load_kernel()  # compiled once, before all look for it
    # Ctrl-C is for this process alone: what starts meanwhile never hears of it.  The tracker would
    # let it through again when it begins.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return LocalCluster(
            n_workers=jobs, threads_per_worker=1, memory_limit=0, silence_logs=logging.CRITICAL,
            dashboard_address="127.0.0.1:0",  # beside whatever else flies here
        )  # fmt: skip
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
