"""Sockets for MAVLink, which know no messages.

A link is an address as in pymavlink: udpout:HOST:PORT sends there and receives the answers,
udpin:HOST:PORT listens and answers all senders, tcpin:HOST:PORT serves one client at a time.  None
of them ever blocks: what cannot be sent now is lost, as on a radio.
"""

import contextlib
import socket
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, final

from vehicle_sim.errors import InputError

_DATAGRAM_BYTES = 1400
"""Of one that is sent: it passes through every network in one piece."""
_LARGEST_DATAGRAM_BYTES = 65535
_LAST_PORT = 65535
_MAX_PEERS = 16
_PENDING_BYTES = 262_144
"""What a TCP client may leave unread before frames for it are dropped."""
_SOCKET_BYTES = 4 * 1024 * 1024

Address = tuple[str, int] | tuple[str, int, int, int]


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
        """The same on another port; one that is to be found (0) stays so.

        InputError if there is no such port.
        """
        port = self.port + by
        if port > _LAST_PORT:
            rule = f"with --count and --port-step the last vehicle would need port {port}"
            raise InputError("--connect", str(self), rule, "Begin at a lower port.")
        return self.at(port) if self.port else self

    def at(self, port: int) -> "Endpoint":
        """The same with this port."""
        return Endpoint(kind=self.kind, host=self.host, port=port)


_OTHERS = {
    "udpout": ("udpout", "udpc", "udpclient", "udp"),
    "udpin": ("udpin", "udps", "udpserver"),
    "tcpin": ("tcpin", "tcps", "tcp-l", "tcpserver", "tcp", "tcpout", "tcpc"),
}
"""How others call them; the simulator connects to nobody by TCP, clients connect to it."""


def parse_endpoint(text: str) -> Endpoint:
    """KIND:HOST:PORT, or KIND://HOST:PORT; InputError says what is wrong with it."""
    kind, _, address = text.partition(":")
    host, _, port = address.removeprefix("//").rpartition(":")
    well_formed = port.isdecimal() and 0 <= int(port[:6]) < 65536 and not set(host) & set("/@?")
    listens = kind in ("udpin", "tcpin")
    is_ours = kind in ("udpout", "udpin", "tcpin") and host and (listens or port.strip("0"))
    if ":" in host and "@" not in host and not (host.startswith("[") and host.endswith("]")):
        well_formed = False
        rule = f"an IPv6 address stands in brackets: {kind}:[{host}]:{port}"
    elif text.startswith(("serial", "/dev/", "tty")):
        rule = "the simulator has no serial port, only UDP and TCP"
    else:
        rule = "must be udpout:HOST:PORT, udpin:HOST:PORT or tcpin:HOST:PORT"
        if well_formed:
            called = kind.lower() if host not in ("", "0.0.0.0") or kind != "udp" else "udpin"
            heres = [here for here, names in _OTHERS.items() if called in names]
            where = f"{host or '0.0.0.0'}:{port}"
            rule += f"; this one is written {heres[0]}:{where}" if heres and port != "0" else ""
    if not (well_formed and is_ours):
        raise InputError("--connect", text, rule, "Try udpout:127.0.0.1:14540.")
    return Endpoint(kind=kind, host=host.strip("[]"), port=int(port))  # type: ignore[arg-type]


class Link(ABC):
    """One open endpoint.  OSError if it cannot be opened."""

    _kind: ClassVar = socket.SOCK_DGRAM

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._reopened = False
        self._open()

    def _open(self) -> None:
        found = socket.getaddrinfo(self._endpoint.host, self._endpoint.port, type=self._kind)
        family, kind, protocol, _, address = found[0]
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setblocking(False)
        try:
            self._attach(address)
        except OSError:
            self._socket.close()
            raise

    @abstractmethod
    def _attach(self, address: Any) -> None:
        """Connect the socket to this address, or bind it there."""

    @property
    def sockets(self) -> Sequence[socket.socket]:
        """What to wait for."""
        return (self._socket,)

    @property
    def endpoint(self) -> Endpoint:
        """What was opened, with the port that was found for 0."""
        return self._endpoint.at(int(self._socket.getsockname()[1]))

    @abstractmethod
    def send(self, frames: Sequence[bytes]) -> None:
        """Send these frames, or lose them."""

    @abstractmethod
    def receive(self) -> bytes | None:
        """The next datagram or piece of stream, None if there is none now."""

    def _datagram(self) -> tuple[bytes, Any] | None:
        """The next one, and from whom; a refusal is about an earlier one that was sent."""
        while True:
            try:
                return self._socket.recvfrom(_LARGEST_DATAGRAM_BYTES)
            except ConnectionRefusedError:
                continue
            except OSError:
                return None

    @abstractmethod
    def move(self) -> None:
        """Send from another port from now on: what a rebooted ArduPilot does."""

    def take_reopened(self) -> bool:
        """Whether another client has connected."""
        reopened, self._reopened = self._reopened, False
        return reopened

    def close(self) -> None:
        """Close the sockets."""
        self._socket.close()


def datagrams(frames: Sequence[bytes]) -> list[bytes]:
    """Frames in order, as many to a datagram as fit."""
    packed = [b""]
    for frame in frames:
        if len(packed[-1]) + len(frame) > _DATAGRAM_BYTES:
            packed.append(b"")
        packed[-1] += frame
    return [each for each in packed if each]


def open_link(endpoint: Endpoint) -> Link:
    """InputError if the address cannot be used."""
    try:
        if endpoint.kind == "udpout":
            return _UdpOut(endpoint)
        return _UdpIn(endpoint) if endpoint.kind == "udpin" else _TcpIn(endpoint)
    except (OSError, UnicodeError) as error:
        reason = (getattr(error, "strerror", None) or str(error)).lower()
        remedy = (
            "Name the host and port that the companion listens on."
            if endpoint.kind == "udpout"
            else "Choose a free port of this machine."
        )
        rule = f"cannot be used ({reason})"
        raise InputError("--connect", str(endpoint), rule, remedy) from None


@final
class _UdpOut(Link):
    """Sends to one address and hears only that."""

    def _attach(self, address: Any) -> None:
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_BYTES)
        self._socket.connect(address)

    @property
    def endpoint(self) -> Endpoint:
        return self._endpoint

    def send(self, frames: Sequence[bytes]) -> None:
        for datagram in datagrams(frames):
            try:
                self._socket.send(datagram)
            except ConnectionRefusedError:  # about an earlier one, but it kept this one back
                with contextlib.suppress(OSError):
                    self._socket.send(datagram)
            except OSError:
                return  # no route or no room for the moment: as good as a lost datagram

    def receive(self) -> bytes | None:
        found = self._datagram()
        return None if found is None else found[0]

    def move(self) -> None:
        self._socket.close()
        self._open()


@final
class _UdpIn(Link):
    """Listens, and answers the sixteen newest senders."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._peers: dict[Address, None] = {}
        super().__init__(endpoint)

    def _attach(self, address: Any) -> None:
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_BYTES)
        self._socket.bind(address)

    def send(self, frames: Sequence[bytes]) -> None:
        for datagram in datagrams(frames):
            for peer in self._peers:
                with contextlib.suppress(OSError):
                    self._socket.sendto(datagram, peer)

    def receive(self) -> bytes | None:
        found = self._datagram()
        if found is None:
            return None
        datagram, peer = found
        if peer not in self._peers:
            self._peers[peer] = None
            while len(self._peers) > _MAX_PEERS:
                del self._peers[next(iter(self._peers))]
        return datagram

    def move(self) -> None:
        """A port that others were told of stays."""


@final
class _TcpIn(Link):
    """Serves one client at a time, as ArduPilot's serial ports over TCP do."""

    _kind = socket.SOCK_STREAM

    def __init__(self, endpoint: Endpoint) -> None:
        self._client: socket.socket | None = None
        self._pending = b""
        super().__init__(endpoint)

    def _attach(self, address: Any) -> None:
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.bind(address)
        self._socket.listen(1)

    @property
    def sockets(self) -> Sequence[socket.socket]:
        return (self._socket,) if self._client is None else (self._client,)

    def send(self, frames: Sequence[bytes]) -> None:
        if self._client is None:
            return
        if len(self._pending) < _PENDING_BYTES:  # a client that does not read loses whole frames
            self._pending += b"".join(frames)
        try:
            sent = self._client.send(self._pending) if self._pending else 0
            self._pending = self._pending[sent:]
        except BlockingIOError:
            return
        except OSError:
            self._drop()

    def receive(self) -> bytes | None:
        if self._client is None:
            self._accept()
        if self._client is None:
            return None
        try:
            data = self._client.recv(_LARGEST_DATAGRAM_BYTES)
        except BlockingIOError:
            return None
        except OSError:
            data = b""
        if not data:
            self._drop()
            return None
        return data

    def _accept(self) -> None:
        try:
            self._client, _ = self._socket.accept()
        except OSError:
            return
        self._client.setblocking(False)
        self._reopened = True
        self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client, self._pending = None, b""

    def move(self) -> None:
        """The client sees the connection end."""
        self._drop()

    def close(self) -> None:
        self._drop()
        super().close()
