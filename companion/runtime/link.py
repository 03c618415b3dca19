"""UDP links by the connection strings that MAVLink users know: udpin: and udpout:HOST:PORT."""

import contextlib
import errno
import socket
from types import TracebackType
from typing import Self, final

from companion.errors import InputError

_LARGEST_DATAGRAM = 1400  # stays below the usual MTU
_REMEDY = "Write udpin:127.0.0.1:14540 (wait for the vehicle) or udpout:HOST:PORT (call it)."


@final
class UdpLink:
    """Datagrams to and from one peer: for udpin, the sender that turned out to be the vehicle."""

    def __init__(self, connection: str) -> None:
        kind, host, port = _parsed(connection)
        try:
            address = (socket.gethostbyname(host), port)
        except (OSError, UnicodeError) as error:
            raise InputError("--connect", connection, "no such host", _REMEDY) from error
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
        self._peer: tuple[str, int] | None = None
        self._sender: tuple[str, int] | None = None
        try:
            if kind == "udpin":
                self._socket.bind(address)
            else:
                self._peer = address
        except OSError as error:
            self._socket.close()
            raise _refused(connection, error) from error

    def receive(self, timeout_s: float) -> bytes | None:
        """The next datagram, or None if none came in time."""
        self._socket.settimeout(max(timeout_s, 1e-6))
        try:
            data, sender = self._socket.recvfrom(65536)
        except (TimeoutError, BlockingIOError, ConnectionRefusedError, InterruptedError):
            return None
        self._sender = sender
        return data

    def answer_to_sender(self) -> None:
        """From now on send to whoever sent the last datagram: it was the vehicle."""
        self._peer = self._sender

    def send(self, frames: list[bytes]) -> None:
        """Frames in order, as few datagrams as they fit into.  Dropped while nobody was heard."""
        if self._peer is None:
            return
        batch = b""
        for frame in [*frames, b""]:
            if batch and (not frame or len(batch) + len(frame) > _LARGEST_DATAGRAM):
                with contextlib.suppress(OSError):  # a datagram that is lost, like any other
                    self._socket.sendto(batch, self._peer)
                batch = b""
            batch += frame

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._socket.close()


def _parsed(connection: str) -> tuple[str, str, int]:
    parts = connection.split(":")
    if len(parts) != 3 or parts[0] not in ("udpin", "udpout") or not parts[1]:
        raise InputError("--connect", connection, "not a UDP connection string", _REMEDY)
    lowest = 0 if parts[0] == "udpin" else 1
    number = parts[2].isascii() and parts[2].isdecimal() and len(parts[2]) <= 5
    if not number or not lowest <= int(parts[2]) <= 65535:
        raise InputError("--connect", connection, "a port is a number up to 65535", _REMEDY)
    return parts[0], parts[1], int(parts[2])


def _refused(connection: str, error: OSError) -> InputError:
    rule = f"it cannot be opened ({error.strerror})"
    remedy = "Give an address of this computer."
    if error.errno == errno.EADDRINUSE:
        remedy = "End the program that uses the port, or choose another port on both sides."
    return InputError("--connect", connection, rule, remedy)
