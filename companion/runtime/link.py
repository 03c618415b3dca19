"""Links to the vehicle, by connection strings as in pymavlink.

    udpin:HOST:PORT, udp:HOST:PORT   wait for the vehicle here, and answer where it is heard
    udpout:HOST:PORT                 call it there (a vehicle, or a router's server port)
    tcp:HOST:PORT                    connect to it there; connected again after a loss
    tcpin:HOST:PORT                  wait for its connection here; the newest one counts
    /dev/ttyACM0, COM3,57600, serial:/dev/ttyUSB0:921600   a serial port; 57600 baud if not said

A link drops what it cannot send at once, as a radio does, and never raises for temporary failures:
an absent peer, an unplugged device.  One thread receives, another may send.  Bytes of a stream
(TCP, serial) are passed on as they come; frames are sent whole or not at all: if the peer does not
read the newest are dropped, and with the loss of a stream all that are buffered.
"""

import contextlib
import math
import os
import select
import socket
import threading
import time
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Generic, Protocol, Self, TypeVar, final

import serial

from companion.runtime.connection import Address, Device, parsed, refused

try:
    from termios import error as _TerminalError
except ImportError:  # Windows has no terminals of this kind
    _TerminalError = OSError  # type: ignore[assignment,misc]

LARGEST_DATAGRAM = 1400  # stays below the usual MTU
_AGAIN_S = 0.5
"""Between attempts to connect or to open again."""
_PENDING_BYTES = 2048
"""Buffer for a peer that reads slowly: half a second of setpoints, not more."""
_PIECE_BYTES = 65536
_UNANSWERED_MS = 5000  # a TCP peer that is gone without a word
_LOST = (OSError, _TerminalError, TypeError, ValueError)
"""Exceptions of a lost stream; the last two if it was just closed."""
_Stream = TypeVar("_Stream", socket.socket, serial.Serial)


def _readable(sockets: list[socket.socket], timeout_s: float) -> list[socket.socket]:
    """Those with something to read, as soon as there is one; none if one was closed just now."""
    try:
        return select.select(sockets, (), (), timeout_s)[0]
    except _LOST:
        return []


class Link(Protocol):
    """A pipe of bytes to one vehicle."""

    @property
    def sender(self) -> object:
        """Sender of the last data, an argument of answer_to; None: there is only one peer."""
        return None

    def receive(self, timeout_s: float) -> bytes | None:
        """The next datagram or piece of a stream, or None if none came in time."""
        ...

    def answer_to(self, sender: object) -> None:
        """From now on send to this sender: the vehicle."""
        del sender

    def send(self, frames: list[bytes]) -> None:
        """Send frames, whole and in order, or drop them; never blocks."""
        ...

    def close(self) -> None:
        """Close the port, the device or the connection for good."""
        ...

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def open_link(connection: str, option: str = "--connect") -> Link:
    """The link that a connection string names; InputError, about the option, if it cannot be."""
    place = parsed(connection, option)
    if isinstance(place, Device):
        return SerialLink(place)
    if place.kind == "tcp":
        return TcpClient(place)
    return TcpServer(place) if place.kind == "tcpin" else UdpLink(place)


@contextlib.contextmanager
def open_links(connections: Sequence[str], option: str) -> Iterator[list[Link]]:
    """Links by their connection strings, all of them closed in the end; InputError as above."""
    with contextlib.ExitStack() as links:
        yield [links.enter_context(open_link(each, option)) for each in connections]


@final
class GroundLinks:
    """Links to ground stations, besides the vehicle's: all are sent the same.

    Answers carry target ids.  No failure of these links ends or delays a flight.
    """

    def __init__(self, links: Sequence[Link]) -> None:
        self._links = tuple(links)

    def answer_to(self, sender: object, number: int) -> None:
        """From now on send there over one of them, counted from 1."""
        with contextlib.suppress(Exception):
            self._links[number - 1].answer_to(sender)

    def send(self, frames: Sequence[bytes]) -> None:
        """Send frames over each link, or lose them."""
        for link in self._links if frames else ():
            with contextlib.suppress(Exception):
                link.send([*frames])


def datagrams(frames: Sequence[bytes]) -> Iterator[bytes]:
    """Frames in their order, as many in each datagram as go over a network in one piece."""
    batch = b""
    for frame in frames:
        if batch and len(batch) + len(frame) > LARGEST_DATAGRAM:
            yield batch
            batch = b""
        batch += frame
    if batch:
        yield batch


@final
class UdpLink(Link):
    """Datagrams to and from one peer: for udpin, the sender that turned out to be the vehicle."""

    def __init__(self, place: Address) -> None:
        address = place.resolved()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
        self._peer: tuple[str, int] | None = None
        self._sender: object = None
        try:
            if place.kind == "udpin":
                self._socket.bind(address)
            else:
                self._peer = address
        except OSError as error:
            self._socket.close()
            raise refused(place, error) from error

    @property
    def sender(self) -> object:
        """Host and port of the last datagram."""
        return self._sender

    def receive(self, timeout_s: float) -> bytes | None:
        """The next datagram, or None if none came in time."""
        if not _readable([self._socket], timeout_s):
            return None
        try:
            data, self._sender = self._socket.recvfrom(65536)
        except OSError:  # what the network says of a datagram sent before, or closed just now
            return None
        return data

    def answer_to(self, sender: object) -> None:
        """From now on send to that sender."""
        if isinstance(sender, tuple):
            self._peer = sender

    def send(self, frames: list[bytes]) -> None:
        """Send frames in order, in few datagrams; dropped before a peer was heard."""
        if self._peer is None:
            return
        for datagram in datagrams(frames):
            with contextlib.suppress(OSError):  # a datagram that is lost, like any other
                self._socket.sendto(datagram, self._peer)

    def close(self) -> None:
        """Close the port."""
        self._socket.close()


class _StreamLink(Link, Generic[_Stream]):
    """A link over a stream; while there is none, receive() tries to open it."""

    def __init__(self) -> None:
        self._stream: _Stream | None = None
        self._pending = b""
        self._lock = threading.Lock()
        """Held while bytes are written: a stream that is closed under it is not written to."""
        self._next_s = -math.inf
        self._over = threading.Event()

    def receive(self, timeout_s: float) -> bytes | None:
        """What has arrived, as soon as anything has; None if nothing came in time."""
        stream = self._stream
        if stream is None:
            self._open(timeout_s)
            if self._over.is_set():  # it was closed meanwhile
                self._drop()
            return None
        try:
            data = self._read(stream, timeout_s)
        except (BlockingIOError, InterruptedError):
            return None
        except _LOST:
            data = b""
        if data == b"":
            self._drop()
        return data or None

    def send(self, frames: list[bytes]) -> None:
        """Frames in order; dropped while there is no stream."""
        stream = self._stream
        if stream is None:
            return
        with self._lock:
            for frame in frames:
                if len(self._pending) + len(frame) > _PENDING_BYTES:
                    self._flush(stream)
                if len(self._pending) + len(frame) <= _PENDING_BYTES:
                    self._pending += frame
            self._flush(stream)

    def _flush(self, stream: _Stream) -> None:
        """Write the buffer, as far as there is room; a lost stream clears it."""
        try:
            while self._pending and (taken := self._write(stream, self._pending)):
                self._pending = self._pending[taken:]
        except BlockingIOError:
            return
        except _LOST:  # the receiving side notices, too
            self._pending = b""

    def close(self) -> None:
        """Close the stream for good; a thread waiting for one returns."""
        self._over.set()
        self._drop()

    def _drop(self) -> None:
        """The stream is lost: a new one begins with a whole frame."""
        stream, self._stream = self._stream, None
        with self._lock, contextlib.suppress(OSError):
            self._pending = b""
            if stream is not None:
                stream.close()

    def _is_due(self, timeout_s: float) -> bool:
        """Whether to try to open the stream now: at once, then every _AGAIN_S; never once closed.

        If it is too early, waits until it is due, at most timeout_s.
        """
        wait_s = self._next_s - time.monotonic()
        if wait_s > 0.0:
            self._over.wait(min(wait_s, timeout_s))
            return False
        self._next_s = time.monotonic() + _AGAIN_S
        return not self._over.is_set()

    def _open(self, timeout_s: float) -> None:
        """Try to open the stream, for up to a time.  A server waits for a connection."""

    @abstractmethod
    def _read(self, stream: _Stream, timeout_s: float) -> bytes | None:
        """Received bytes; None: time-out; b"" or one of _LOST: the stream is lost."""

    @abstractmethod
    def _write(self, stream: _Stream, data: bytes) -> int:
        """Write what there is room for; how many bytes that was."""


class _TcpLink(_StreamLink[socket.socket]):
    """Common part of TCP client and server."""

    def _adopt(self, stream: socket.socket) -> None:
        stream.setblocking(False)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNANSWERED_MS)
        self._drop()
        self._stream = stream

    def _read(self, stream: socket.socket, timeout_s: float) -> bytes | None:
        return stream.recv(_PIECE_BYTES) if _readable([stream], timeout_s) else None

    def _write(self, stream: socket.socket, data: bytes) -> int:
        return stream.send(data)


@final
class TcpClient(_TcpLink):
    """tcp:HOST:PORT.  Connects again and again while the peer is absent."""

    def __init__(self, place: Address) -> None:
        super().__init__()
        self._address = place.resolved()
        self._calling: socket.socket | None = None

    def _open(self, timeout_s: float) -> None:
        calling = self._calling
        with contextlib.suppress(*_LOST):  # it was closed just now
            if calling is None:
                if not self._is_due(timeout_s):
                    return
                calling = self._calling = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
                calling.setblocking(False)
                calling.connect_ex(self._address)
            answered = select.select((), [calling], [calling], timeout_s)
            if not (answered[1] or answered[2]):
                return
            self._calling = None
            if calling.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                calling.close()
            else:
                self._adopt(calling)

    def close(self) -> None:
        """Close the stream, or stop connecting, for good."""
        calling, self._calling = self._calling, None
        if calling is not None:
            calling.close()
        super().close()


@final
class TcpServer(_TcpLink):
    """tcpin:HOST:PORT.  The newest connection is the vehicle."""

    def __init__(self, place: Address) -> None:
        super().__init__()
        address = place.resolved()
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setblocking(False)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind(address)
            self._listener.listen(1)
        except OSError as error:
            self._listener.close()
            raise refused(place, error) from error

    def receive(self, timeout_s: float) -> bytes | None:
        """The next piece of the stream, or None if none came in time."""
        stream = self._stream
        ready = _readable([self._listener, *([] if stream is None else [stream])], timeout_s)
        if self._listener in ready:
            with contextlib.suppress(OSError):  # it has gone again already
                self._adopt(self._listener.accept()[0])
            return None
        return super().receive(0.0) if ready else None

    def close(self) -> None:
        """Close the port and the stream."""
        self._listener.close()
        super().close()


@final
class SerialLink(_StreamLink[serial.Serial]):
    """A serial port.  Reopened after it vanished (a cable, a rebooting autopilot)."""

    def __init__(self, place: Device) -> None:
        super().__init__()
        self._place = place
        try:
            self._stream = self._opened()
        except OSError as error:  # SerialException is one
            inner = error.__context__  # the words of the operating system, not pyserial's
            plain = inner if isinstance(inner, OSError) and inner.strerror else error
            raise refused(place, plain) from error
        except ValueError as error:
            raise refused(place, OSError(0, str(error))) from error

    def _opened(self) -> serial.Serial:
        """The port, with nothing left in it from before; OSError or ValueError if there is none."""
        name, baud = self._place.name, self._place.baud
        try:
            return serial.Serial(name, baud, timeout=0.0, write_timeout=0.0, exclusive=True)
        except _TerminalError as error:  # it vanished while it was being opened: no OSError
            raise serial.SerialException(*error.args) from error

    def _open(self, timeout_s: float) -> None:
        if self._is_due(timeout_s):
            with contextlib.suppress(OSError, ValueError):
                self._stream = self._opened()

    def _read(self, stream: serial.Serial, timeout_s: float) -> bytes | None:
        if stream.timeout != timeout_s:
            stream.timeout = timeout_s
        data = stream.read(1)
        return data + stream.read(stream.in_waiting) if data else None

    def _write(self, stream: serial.Serial, data: bytes) -> int:
        """Pyserial's own write would block until there is room for all."""
        if os.name == "posix":
            return os.write(stream.fileno(), data)
        return stream.write(data) or 0
