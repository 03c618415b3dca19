"""Serves the page, at an address of this computer alone.

`python -m companion.live_view.server` is the view of a flight that is flown: a process of its own,
so that it cannot slow the flight down.  The first line of its input says what is to be served; its
own first line says where it is, or why it is not.  It ends with its input.
"""

import json
import os
import select
import socket
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import msgspec
import rich
import viser

from companion.errors import InputError
from companion.live_view.command import Asked
from companion.live_view.page import Page
from companion.live_view.recording import Recording
from companion.sources.files import answer

_HOST: Final = "127.0.0.1"
_POLL_S: Final = 0.1
_NICE: Final = 5


def serve(asked: Asked, on_ready: Callable[[str], None], stopped: Callable[[], bool]) -> None:
    """Serve until stopped.  on_ready: told the address.  InputError if it cannot be served."""
    path = Path(asked.path)
    with ExitStack() as stack:

        def read() -> Recording:
            recording = stack.enter_context(Recording(path, asked.system_id))
            recording.read()
            return recording

        recording = None if asked.live else read()
        server = _server(asked.port)
        stack.callback(server.stop)
        on_ready(f"http://{_HOST}:{server.get_port()}/")
        while recording is None:
            if all(answer((path / name).is_file) for name in ("mission.toml", "flight.tlog")):
                recording = read()
            elif stopped():
                return
            else:
                time.sleep(_POLL_S)
        Page(server, recording).run(stopped)


def _server(port: int) -> viser.ViserServer:
    """Viser takes the next port if one is taken: people would look at another page."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((_HOST, port))
        except OSError as error:
            why = error.strerror or str(error)
            rule, remedy = f"{_HOST} cannot be served there ({why})", "Give another port, or 0."
            raise InputError("--view-port", port, rule, remedy) from error
    rich.get_console().quiet = True  # it prints a box about itself
    server = viser.ViserServer(host=_HOST, port=port, verbose=False)
    server.request_share_url = lambda **_: None  # type: ignore[method-assign]
    return server


def main() -> None:
    """Serve what the first line of the input asks for, as long as that is open."""
    os.nice(_NICE)
    asked = msgspec.json.decode(sys.stdin.readline(), type=Asked)
    addresses = list[str]()

    def say(address: str) -> None:
        addresses.append(address)
        print(json.dumps({"address": address}), flush=True)  # noqa: T201 - who has asked reads it

    try:
        serve(asked, say, lambda: bool(select.select([sys.stdin], [], [], 0.0)[0]))
    except InputError as error:
        if addresses:  # nobody reads a second line
            sys.stderr.write(f"warning: no view any more: {error}\n")
        else:
            values = [error.field, error.value, error.rule, error.remedy]
            print(json.dumps({"error": values}), flush=True)  # noqa: T201 - likewise


if __name__ == "__main__":
    main()
