"""Serves the page: one address, and who may see and do what."""

import errno
import secrets
import socket
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, final
from urllib.parse import parse_qs, urlsplit

import rich
import viser

from companion.errors import InputError
from companion.live_view.command import Asked
from companion.live_view.control import GroundStation
from companion.live_view.orders import Orders, is_token
from companion.live_view.page import Flight, Page
from companion.sources.files import answer

_LOOPBACK: Final = ("127.0.0.1", "localhost", "::1")
_EVERYWHERE: Final = ("", "0.0.0.0", "::")
_REFUSED: Final = 1002  # the page then shows the reason, and does not try again
_POLL_S: Final = 0.1


def serve(asked: Asked, on_ready: Callable[[str], None], stopped: Callable[[], bool]) -> None:
    """Serve until stopped.  on_ready: told the address.  InputError if it cannot be served."""
    with ExitStack() as stack:
        flights = [] if asked.live else _flights(asked, stack)
        token = secrets.token_urlsafe(12)
        server = _server(asked.host, asked.port)
        stack.callback(server.stop)
        guard = _Guard(server, token, everybody=asked.host in _LOOPBACK)
        named = not guard.everybody or asked.ground is not None
        on_ready(_address(asked, server.get_port(), token, named=named))
        while not flights:
            files = (Path(asked.paths[0]) / name for name in ("mission.toml", "flight.tlog"))
            if all(answer(file.is_file) for file in files):
                flights = _flights(asked, stack)
            elif stopped():
                return
            else:
                time.sleep(_POLL_S)
        orders, mission = None, flights[0].recording.mission
        if asked.ground is not None and mission is not None:
            station = GroundStation(asked.ground, mission)
            stack.callback(station.close)
            orders = Orders(station, mission.frame, token, guard.is_trusted)
        Page(server, flights, orders=orders).run(stopped)


def _flights(asked: Asked, stack: ExitStack) -> list[Flight]:
    flights = []
    for path in asked.paths:
        flights.append(Flight.of(Path(path), asked.system_id))
        stack.enter_context(flights[-1].recording)
    return flights


def _server(host: str, port: int) -> viser.ViserServer:
    """Viser takes the next port if one is taken: people would look at another page."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            why = error.strerror or str(error)
            if isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
                rule, remedy = f"it is no address of this computer ({why})", "Give one, or 0.0.0.0."
                raise InputError("--view-host", host, rule, remedy) from error
            rule, remedy = f"{host} cannot be served there ({why})", "Give another port, or 0."
            raise InputError("--view-port", port, rule, remedy) from error
    rich.get_console().quiet = True  # it prints a box about itself
    server = viser.ViserServer(host=host, port=port, verbose=False)
    server.request_share_url = lambda **_: None  # type: ignore[method-assign]
    return server


def _address(asked: Asked, port: int, token: str, *, named: bool) -> str:
    host = socket.gethostname() if asked.host in _EVERYWHERE else asked.host
    place = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    page = f"http://{place}/"
    return f"{page}?websocket=ws://{place}/?token={token}" if named else page


@final
class _Guard:
    """Knows who has come with the token; from elsewhere nobody comes without."""

    def __init__(self, server: viser.ViserServer, token: str, *, everybody: bool) -> None:
        """everybody: whether those without it may look."""
        self.everybody, self._token = everybody, token
        self._sockets: Any = server._websock_server
        if not everybody:
            self._sockets.on_client_connect(self._admit)

    def is_trusted(self, client_id: int) -> bool:
        """Whether a client came with the token in its address."""
        connection = self._sockets._live_connections.get(client_id)
        return connection is not None and self._has_token(connection)

    async def _admit(self, client: Any) -> None:
        connection = self._sockets._live_connections[client.client_id]
        if not self._has_token(connection):
            why = "refused: open the address that the terminal has printed, with its token"
            await connection.close(_REFUSED, why)

    def _has_token(self, connection: Any) -> bool:
        given = parse_qs(urlsplit(connection.request.path).query).get("token", [""])
        return is_token(given[0], self._token)
