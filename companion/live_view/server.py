"""Serves the page, at an address of this computer alone."""

import socket
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import rich
import viser

from companion.errors import InputError
from companion.live_view.command import Asked
from companion.live_view.page import Page
from companion.live_view.recording import Recording
from companion.sources.files import answer

_HOST: Final = "127.0.0.1"
_POLL_S: Final = 0.1


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
