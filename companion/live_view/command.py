"""`companion view`, and the view that `companion fly --view` starts."""

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, final

import msgspec
import typer
from rich.console import Console

from companion import extras
from companion.errors import InputError
from companion.runtime.terminal import stop_signals
from companion.views.output import plain_console

VIEW_PORT = 8080
PortOption = Annotated[
    int, typer.Option(min=0, max=65535, help="Port of the page; 0: any that is free.")
]
_END_S, _POLL_S = 5.0, 0.2


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """What is to be served, and how."""

    path: str
    port: int = VIEW_PORT
    """0: any that is free."""
    system_id: int | None = None
    """Of the vehicle, of several in a log."""
    live: bool = False
    """Whether the flight is flown now: it may not have begun to be recorded."""


def view_command(
    flight: Annotated[
        Path, typer.Argument(metavar="RUN_DIR|LOG", help="A run folder, or a .tlog, .bin or .ulg.")
    ],
    view_port: PortOption = VIEW_PORT,
    system: Annotated[
        int | None,
        typer.Option(min=1, max=255, help="System id of the vehicle, of several in a log."),
    ] = None,
) -> None:
    """Show a flight in the browser: the ground as it was known, plans, charts and events over time.

    A run folder that is still written is shown as it grows.  Ends with Ctrl-C.
    """
    extras.need("view", "companion view")
    from companion.live_view.server import serve  # slow to import

    asked = Asked(path=str(flight), port=view_port, system_id=system)
    with stop_signals() as stop_asked:
        serve(asked, partial(_say_address, plain_console()), lambda: bool(stop_asked))


def _say_address(console: Console, address: str) -> None:
    console.print(f"view: {address}", highlight=False, soft_wrap=True, markup=False)


@contextlib.contextmanager
def started_view(asked: Asked, console: Console) -> Iterator[None]:
    """Show a flight from a process of its own.  InputError if it cannot be shown."""
    extras.need("view", "--view")
    command = [sys.executable, "-m", "companion.live_view.server"]
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C is for the flight
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(f"{msgspec.json.encode(asked).decode()}\n")
            process.stdin.flush()
            said: dict[str, Any] = json.loads(process.stdout.readline() or "{}")
            if "address" not in said:
                nothing = ("--view", True, "it did not start", "Look above for the reason.")
                raise InputError(*said.get("error", nothing))
            _say_address(console, said["address"])
            yield
        finally:
            with contextlib.suppress(OSError):
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
