"""Sockets for MAVLink over UDP, which know no messages.

A link is an address as in pymavlink: udpout:HOST:PORT sends there and receives the answers,
udpin:HOST:PORT listens and answers all senders.  Neither ever blocks: what cannot be sent now is
lost, as on a radio.
"""

import re
import socket
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, final

from vehicle_sim.errors import InputError

_DATAGRAM_BYTES = 1400
"""Of one that is sent: it passes through every network in one piece."""
_LARGEST_DATAGRAM_BYTES = 65535
_LAST_PORT = 65535
_MAX_PEERS = 16
_SOCKET_BYTES = 4 * 1024 * 1024

_FORM = re.compile(r"(udpout|udpin):(?://)?(\[[^\[\]/@?]+\]|[^:\[\]/@?]+):(\d{1,5})", re.ASCII)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Endpoint:
    """One --connect."""

    kind: Literal["udpout", "udpin"]
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
        return replace(self, port=port) if self.port else self


def parse_endpoint(text: str) -> Endpoint:
    """KIND:HOST:PORT, or KIND://HOST:PORT; InputError says what is wrong with it."""
    found = _FORM.fullmatch(text)
    kind, host, port = found.groups() if found else ("", "", "0")
    if int(port) > _LAST_PORT or (int(port) == 0 and kind != "udpin"):
        rule = "must be udpout:HOST:PORT or udpin:HOST:PORT, an IPv6 HOST in []"
        raise InputError("--connect", text, rule, "Try udpout:127.0.0.1:14540.")
    return Endpoint(kind=kind, host=host.strip("[]"), port=int(port))  # type: ignore[arg-type]


def datagrams(frames: Sequence[bytes]) -> list[bytes]:
    """Frames in order, as many to a datagram as fit."""
    packed = [b""]
    for frame in frames:
        if len(packed[-1]) + len(frame) > _DATAGRAM_BYTES:
            packed.append(b"")
        packed[-1] += frame
    return [each for each in packed if each]


@final
class Link:
    """An open endpoint: it hears one address only, or answers the newest senders.

    InputError if the address cannot be used.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._listens = endpoint.kind == "udpin"
        self._peers: dict[Any, None] = {}
        """Who was heard, the oldest first."""
        try:
            self._open()
        except (OSError, UnicodeError) as error:
            rule = f"cannot be used ({(getattr(error, 'strerror', None) or str(error)).lower()})"
            remedy = "Name the host and port that the companion listens on."
            if self._listens:
                remedy = "Choose a free port of this machine."
            raise InputError("--connect", str(endpoint), rule, remedy) from None

    def _open(self) -> None:
        wanted = self._endpoint
        found = socket.getaddrinfo(wanted.host, wanted.port, type=socket.SOCK_DGRAM)[0]
        self.socket = socket.socket(*found[:3])
        """What to wait for."""
        try:
            self.socket.setblocking(False)
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_BYTES)
            attach = self.socket.bind if self._listens else self.socket.connect
            attach(found[4])
        except OSError:
            self.socket.close()
            raise

    @property
    def endpoint(self) -> Endpoint:
        """What was opened, with the port that was found for 0."""
        if not self._listens:
            return self._endpoint
        return replace(self._endpoint, port=int(self.socket.getsockname()[1]))

    def send(self, frames: Sequence[bytes]) -> None:
        """Send these frames, or lose them."""
        for datagram in datagrams(frames):
            for peer in self._peers if self._listens else (None,):
                self._send(datagram, peer)

    def _send(self, datagram: bytes, peer: Any) -> None:
        for _ in range(2):  # a refusal is about an earlier one, but it keeps this one back
            try:
                if peer is None:
                    self.socket.send(datagram)
                else:
                    self.socket.sendto(datagram, peer)
            except ConnectionRefusedError:
                continue
            except OSError:
                pass  # no route or no room for the moment: as good as a lost datagram
            return

    def receive(self) -> bytes | None:
        """The next datagram, None if there is none now."""
        while True:
            try:
                datagram, peer = self.socket.recvfrom(_LARGEST_DATAGRAM_BYTES)
            except ConnectionRefusedError:
                continue
            except OSError:
                return None
            if self._listens and peer not in self._peers:
                self._peers[peer] = None
                if len(self._peers) > _MAX_PEERS:
                    del self._peers[next(iter(self._peers))]
            return datagram

    def move(self) -> None:
        """Send from another port from now on: what a rebooted ArduPilot does.

        A port that others were told of stays.
        """
        if not self._listens:
            self.socket.close()
            self._open()

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()
