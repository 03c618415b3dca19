"""Serves the page, at an address of this computer alone."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import rich
import viser

from companion.errors import InputError
from companion.live_view.page import Page
from companion.live_view.recording import Recording
from companion.sources.files import answer

_HOST: Final = "127.0.0.1"
_POLL_S: Final = 0.1


def serve(
    path: Path,
    port: int,
    on_ready: Callable[[str], None],
    stopped: Callable[[], bool],
    *,
    system_id: int | None = None,
    is_flown: bool = False,
) -> None:
    """Serve a run folder or a log until stopped.  InputError if that cannot be done.

    port: 0: any that is free.  on_ready: told the address.  system_id: of the vehicle, of several
    in a log.  is_flown: the flight is flown now: it may not have begun to be recorded.
    """
    server = _server(port)
    try:
        recording = None if is_flown else Recording(path, system_id)
        on_ready(f"http://{_HOST}:{server.get_port()}/")
        while recording is None:
            if all(answer((path / name).is_file) for name in ("mission.toml", "flight.tlog")):
                recording = Recording(path, system_id)
            elif stopped():
                return
            else:
                time.sleep(_POLL_S)
        Page(server, recording).run(stopped)
    finally:
        server.stop()


def _server(port: int) -> viser.ViserServer:
    """Viser takes the next port if one is taken: people would look at another page."""
    rich.get_console().quiet = True  # it prints a box about itself
    server = viser.ViserServer(host=_HOST, port=port, verbose=False)
    server.request_share_url = lambda **_: None  # type: ignore[method-assign]
    if port not in (0, server.get_port()):
        server.stop()
        rule = f"{_HOST} cannot be served there: the port is taken, or not for users"
        raise InputError("--view-port", port, rule, "Give another port, or 0.")
    return server
