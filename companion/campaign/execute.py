"""Where runs are flown: on the workers of a Dask scheduler, of this machine by default.

Rows come in any order; a worker that is lost takes no run with it.
"""

import logging
import signal
from collections.abc import Generator, Sequence
from contextlib import ExitStack
from functools import partial
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

from companion.campaign.file import Run
from companion.campaign.run import fly_run, lost_run
from companion.campaign.store import Row
from companion.errors import FlightInterrupted, InputError
from companion.runtime.compiler import load_kernel

_RETRIES = 3
"""How often a run may lose its worker until that is held against it; Dask's own number."""


def fly(runs: Sequence[Run], out: Path, *, scheduler: str | None, jobs: int) -> Generator[Row]:
    """Fly runs on a scheduler's workers; None: on so many processes of this machine.

    OSError: there is no room for a folder.  InputError: no scheduler answers there.
    """
    from distributed import KilledWorker, as_completed  # slow to import

    if not runs:
        return
    with ExitStack() as ended:
        where: Any = scheduler
        if scheduler is None:
            load_kernel()  # compiled once, before all look for it
            where = ended.enter_context(_workers_here(jobs))
        client = ended.enter_context(_client(where))
        futures = client.map(
            partial(fly_run, out=out), runs, pure=False, retries=_RETRIES, batch_size=1_000
        )
        ended.callback(client.cancel, futures)
        by_key = {future.key: run for future, run in zip(futures, runs, strict=True)}
        for future in as_completed(futures):
            if future.status == "finished":
                yield future.result()
            elif future.status == "error":
                lost = future.exception()
                if isinstance(lost, OSError) and lost.errno is not None:
                    raise lost  # no room for its folder: no result of the run
                died = isinstance(lost, KilledWorker)
                text = f"its worker died {_RETRIES} times and more" if died else repr(lost)
                yield lost_run(by_key[future.key], text)
            else:
                text = "the Dask scheduler is gone, or has cancelled the campaign"
                raise FlightInterrupted(text, "Give the same command again to go on.")
            future.release()


def _workers_here(jobs: int) -> Any:
    """A cluster of processes that fly one run at a time, and end with this one."""
    from distributed import LocalCluster

    # Ctrl-C is for this process alone: what starts meanwhile never hears of it.  The tracker would
    # let it through again when it begins.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return LocalCluster(
            n_workers=jobs, threads_per_worker=1, memory_limit=0, dashboard_address=None,
            silence_logs=logging.CRITICAL,
        )  # fmt: skip
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _client(where: Any) -> Any:
    """A client of a scheduler's address, or of a cluster."""
    from distributed import Client

    try:
        return Client(where, timeout="10s")
    except (OSError, ValueError) as error:
        rule = f"no Dask scheduler answers there ({' '.join(str(error).split())})"
        remedy = "Start one with: dask scheduler. See docs/campaigns.md."
        raise InputError("--scheduler", str(where), rule, remedy) from None
