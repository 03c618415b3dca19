"""`companion view`, and the view that `companion fly --view` starts."""

import contextlib
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from companion import extras
from companion.errors import InputError
from companion.runtime.terminal import stop_signals

VIEW_PORT = 8080
PortOption = Annotated[
    int, typer.Option(min=0, max=65535, help="Port of the page; 0: any that is free.")
]
_END_S, _POLL_S = 5.0, 0.2
_NICE = 5
_PROGRAM = "from companion.cli import main; main()"


def view_command(
    flight: Annotated[
        Path, typer.Argument(metavar="RUN_DIR|LOG", help="A run folder, or a .tlog, .bin or .ulg.")
    ],
    view_port: PortOption = VIEW_PORT,
    system: Annotated[
        int | None,
        typer.Option(min=1, max=255, help="System id of the vehicle, of several in a log."),
    ] = None,
    live: Annotated[bool, typer.Option("--live", hidden=True)] = False,
) -> None:
    """Show a flight in the browser: the ground as it was known, plans, charts and events over time.

    A run folder that is still written is shown as it grows.  Ends with Ctrl-C.
    """
    extras.need("view", "companion view")
    from companion.live_view.page import serve  # slow to import

    def on_ready(address: str) -> None:
        print(f"view: {address}", flush=True)  # noqa: T201 - `started_view` reads it

    with stop_signals() as stop_asked:
        if live:  # whoever has started it flies: it ends with its input
            os.nice(_NICE)

        def stopped() -> bool:
            is_left = live and bool(select.select([sys.stdin], [], [], 0.0)[0])
            return is_left or bool(stop_asked)

        serve(flight, view_port, on_ready, stopped, system_id=system, is_flown=live)


@contextlib.contextmanager
def started_view(folder: Path, port: int, console: Console) -> Iterator[None]:
    """Show a flight that is about to begin, from a process of its own: it cannot slow it down.

    InputError if it cannot be shown.
    """
    extras.need("view", "--view")
    asked = ("view", str(folder), "--view-port", str(port), "--live")
    with subprocess.Popen(
        [sys.executable, "-c", _PROGRAM, *asked],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C is for the flight
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            line = process.stdout.readline()
            if not line:
                raise InputError("--view", True, "it did not start", "Look above for the reason.")
            console.print(line.rstrip(), highlight=False, soft_wrap=True, markup=False)
            yield
        finally:
            process.stdin.close()
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()


def stay(console: Console) -> None:
    """Keep the page of a flight that is over, until Ctrl-C."""
    console.print("the flight is over; Ctrl-C closes its page", highlight=False)
    with stop_signals() as stop_asked:
        while not stop_asked:
            time.sleep(_POLL_S)
