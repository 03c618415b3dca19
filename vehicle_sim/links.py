"""Sockets for MAVLink, which know no messages.

A link is an address as in pymavlink: udpout:HOST:PORT sends there and receives the answers,
udpin:HOST:PORT listens and answers all senders, tcpin:HOST:PORT serves one client at a time.  None
of them ever blocks: what cannot be sent now is lost, as on a radio.
"""

import re
import socket
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal, final

from vehicle_sim.errors import InputError

_DATAGRAM_BYTES = 1400
"""Of one that is sent: it passes through every network in one piece."""
_LARGEST_DATAGRAM_BYTES = 65535
_LAST_PORT = 65535
_MAX_PEERS = 16
_PENDING_BYTES = 262_144
"""What a TCP client may leave unread before frames for it are dropped."""
_SOCKET_BYTES = 4 * 1024 * 1024
_LONGEST_FRAME = 280
"""Bytes of a frame of MAVLink 2."""
_FORM = re.compile(
    r"(udpout|udpin|tcpin):(?://)?(\[[^\[\]/@?]+\]|[^:\[\]/@?]+):(\d{1,5})", re.ASCII
)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Endpoint:
    """One --connect."""

    kind: Literal["udpout", "udpin", "tcpin"]
    host: str
    port: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.kind}:{host}:{self.port}"

    def shifted(self, by: int) -> "Endpoint":
        """The same on another port; one that is to be found (0) stays so."""
        if self.port + by > _LAST_PORT:
            rule = f"there is no port {self.port + by}"
            raise InputError("--port-step", by, rule, "Begin at a lower port.")
        return replace(self, port=self.port + by) if self.port else self


def parse_endpoint(text: str) -> Endpoint:
    """KIND:HOST:PORT, or KIND://HOST:PORT; InputError says what is wrong with it."""
    match = _FORM.fullmatch(text)
    kind, host, port = match.groups() if match else ("", "", "0")
    if int(port) > _LAST_PORT or (int(port) == 0 and kind not in ("udpin", "tcpin")):
        rule = "must be udpout:HOST:PORT, udpin:HOST:PORT or tcpin:HOST:PORT, an IPv6 HOST in []"
        raise InputError("--connect", text, rule, "Try udpout:127.0.0.1:14540.")
    return Endpoint(kind=kind, host=host.strip("[]"), port=int(port))  # type: ignore[arg-type]


class Link:
    """An open endpoint of UDP: it hears one address only, or answers the newest senders."""

    _type = socket.SOCK_DGRAM

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        resolved = socket.getaddrinfo(endpoint.host, endpoint.port, type=self._type)[0]
        self._socket = socket.socket(*resolved[:3])
        self._socket.setblocking(False)
        try:
            self._attach(resolved[4])
        except OSError:
            self._socket.close()
            raise

    def _attach(self, address: Any) -> None:
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_BYTES)
        self._listens = self._endpoint.kind == "udpin"
        self._peers: dict[Any, None] = {} if self._listens else {address: None}
        if self._listens:
            self._socket.bind(address)

    def fileno(self) -> int:
        """For select, to wait until something comes."""
        return self._socket.fileno()

    @property
    def endpoint(self) -> Endpoint:
        """What was opened, with the port that was found for 0."""
        if self._endpoint.kind == "udpout":
            return self._endpoint
        return replace(self._endpoint, port=int(self._socket.getsockname()[1]))

    def send(self, frames: Sequence[bytes]) -> None:
        """Send these frames in order, as many to a datagram as fit, or lose them."""
        packed = [b""]
        for frame in frames:
            if len(packed[-1]) + len(frame) > _DATAGRAM_BYTES:
                packed.append(b"")
            packed[-1] += frame
        for datagram in filter(None, packed):
            for peer in self._peers:
                with suppress(OSError):  # no route or no room for the moment: as good as lost
                    self._socket.sendto(datagram, peer)

    def receive(self) -> bytes | None:
        """The next datagram or piece of stream, None if there is none now."""
        with suppress(OSError):
            while True:
                datagram, peer = self._socket.recvfrom(_LARGEST_DATAGRAM_BYTES)
                if self._listens:
                    self._peers.setdefault(peer)
                    if len(self._peers) > _MAX_PEERS:
                        del self._peers[next(iter(self._peers))]
                if peer in self._peers:
                    return datagram
        return None

    def close(self) -> None:
        """Close the sockets."""
        self._socket.close()


@final
class _TcpIn(Link):
    """Serves one client at a time, as ArduPilot's serial ports over TCP do."""

    _type = socket.SOCK_STREAM

    def _attach(self, address: Any) -> None:
        self._client: socket.socket | None = None
        self._pending = b""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.bind(address)
        self._socket.listen(1)

    def fileno(self) -> int:
        return (self._client or self._socket).fileno()

    def send(self, frames: Sequence[bytes]) -> None:
        if self._client is None:
            return
        if len(self._pending) < _PENDING_BYTES:  # a client that does not read loses whole frames
            self._pending += b"".join(frames)
        try:
            self._pending = self._pending[self._client.send(self._pending) :]
        except BlockingIOError:
            return
        except OSError:
            self._hang_up()

    def receive(self) -> bytes | None:
        try:
            if self._client is None:
                self._client, _ = self._socket.accept()
                self._client.setblocking(False)
                self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                return bytes(_LONGEST_FRAME)  # so ends what the last client began to say
            data = self._client.recv(_LARGEST_DATAGRAM_BYTES)
        except BlockingIOError:
            return None
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data or None

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client, self._pending = None, b""

    def close(self) -> None:
        self._hang_up()
        super().close()


def open_link(endpoint: Endpoint) -> Link:
    """InputError if the address cannot be used."""
    try:
        return _TcpIn(endpoint) if endpoint.kind == "tcpin" else Link(endpoint)
    except (OSError, UnicodeError) as error:
        rule = f"cannot be used ({(getattr(error, 'strerror', None) or str(error)).lower()})"
        remedy = "Choose a free port of this machine, or for udpout the companion's host and port."
        raise InputError("--connect", str(endpoint), rule, remedy) from None
