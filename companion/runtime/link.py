"""Links to the vehicle, by connection strings as in pymavlink.

    udpin:HOST:PORT, udp:HOST:PORT   wait for the vehicle here, and answer where it is heard
    udpout:HOST:PORT                 call it there (a vehicle, or a router's server port)
    tcp:HOST:PORT                    connect to it there; connected again after a loss
    /dev/ttyACM0, COM3,57600, serial:/dev/ttyUSB0:921600   a serial port; 57600 baud if not said

A link drops what it cannot send at once, as a radio does, and never raises for temporary failures:
an absent peer, an unplugged device.  One thread receives, another may send.  Bytes of a stream
(TCP, serial) are passed on as they come; frames are sent whole or not at all, in order.  What a
peer that does not read makes wait is what is still true: the newest setpoint and not those before,
and of equal messages the last.  With the loss of a stream all of it goes.
"""

import contextlib
import math
import os
import select
import socket
import sys
import threading
import time
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Generic, Protocol, Self, TypeVar, final

import serial

from companion.runtime.connection import Address, Device, parsed, refused

try:
    from fcntl import ioctl as _ioctl
    from termios import TIOCOUTQ as _UNSENT
    from termios import error as _TerminalError
except ImportError:  # Windows has no terminals of this kind
    _UNSENT, _TerminalError = 0, OSError  # type: ignore[assignment,misc]

LARGEST_DATAGRAM = 1400  # stays below the usual MTU
_AGAIN_S = 0.5
"""Between attempts to connect or to open again."""
_WAITING_BYTES = 6144
"""What may wait for a peer that reads slowly, orders apart: a second at 57600 baud."""
_UNDER_WAY_BYTES = 1024
"""What this computer may hold of what was sent: unsent in its serial port, unacknowledged by TCP.

It cannot be taken back.  A dozen setpoints; at 10 Hz enough for a round trip of a second.
"""
_PUSH_S = 0.01
"""Between two looks whether there is room again: 1 kB in each is the fastest serial port."""
_STALE_S = 0.5
"""A setpoint that has waited for longer is not sent: a newer one, or an order, comes."""
_SETPOINTS, _COMMAND_INT = (84, 86), 75
_ORDERS = (11, _COMMAND_INT, 76)
"""SET_MODE, COMMAND_INT, COMMAND_LONG."""
_REPOSITION, _NO_SWITCH = (192).to_bytes(2, "little"), bytes(4)
_PIECE_BYTES = 65536
_UNANSWERED_MS = 5000  # a TCP peer that is gone without a word
_LOST = (OSError, _TerminalError, TypeError, ValueError)
"""Exceptions of a lost stream; the last two if it was just closed."""
_Stream = TypeVar("_Stream", socket.socket, serial.Serial)


def is_setpoint(frame: bytes) -> bool:
    """Whether a MAVLink 2 frame tells a vehicle where to be: SET_POSITION_TARGET_*, DO_REPOSITION.

    DO_REPOSITION with a mode change (parameter 2) is a hold command, no setpoint.
    COMMAND_INT holds its command after four parameters, two coordinates and a height (28 bytes).
    """
    message_id = _number_of(frame)
    if message_id == _COMMAND_INT:
        return frame[38:40] == _REPOSITION and frame[14:18] == _NO_SWITCH
    return message_id in _SETPOINTS


def _number_of(frame: bytes) -> int | None:
    """Which message a MAVLink 2 frame holds; None: it is none."""
    if len(frame) < 12 or frame[0] != 0xFD:
        return None
    return int.from_bytes(frame[7:10], "little")


def _is_order(frame: bytes) -> bool:
    return _number_of(frame) in _ORDERS and not is_setpoint(frame)


def _says(frame: bytes) -> object:
    """What makes a frame needless that waits: a newer one of an equal value.

    Setpoints are all equal; other messages are if their sender and content are, whatever their
    sequence number and signature.
    """
    if _number_of(frame) is None:
        return object()
    return is_setpoint(frame) or frame[:2] + frame[5 : 10 + frame[1]]


def _readable(sockets: list[socket.socket], timeout_s: float) -> list[socket.socket]:
    """Those with something to read, as soon as there is one; none if one was closed just now."""
    try:
        return select.select(sockets, (), (), timeout_s)[0]
    except _LOST:
        return []


class Link(Protocol):
    """A pipe of bytes to one vehicle."""

    is_stream: bool = False
    """Whether all that has arrived is received in one piece."""

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


def open_link(connection: str) -> Link:
    """The link that a connection string names; InputError, about --connect, if it cannot be."""
    place = parsed(connection)
    if isinstance(place, Device):
        return SerialLink(place)
    return TcpClient(place) if place.kind == "tcp" else UdpLink(place)


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
        family, address = place.resolved()
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
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

    is_stream = True

    def __init__(self) -> None:
        self._stream: _Stream | None = None
        self._begun = b""
        """The rest of a frame of which a part is sent."""
        self._waiting: dict[object, tuple[bytes, float]] = {}
        """Whole frames by what they say, in order, and since when they wait."""
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
        if self._begun or self._waiting:
            with self._lock:
                self._flush(stream)
            if self._begun or self._waiting:
                timeout_s = min(timeout_s, _PUSH_S)
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
        """Frames in order, each in the place of one that says the same; dropped without a stream.

        Where there is no room, the computer is first given all that it takes.
        """
        stream = self._stream
        if stream is None:
            return
        with self._lock:
            tried = False
            for frame in frames:
                self._waiting.pop(says := _says(frame), None)
                if not (tried or self._has_room(frame)):
                    self._flush(stream, all_of_it=True)
                    tried = True
                if self._has_room(frame):
                    self._waiting[says] = frame, time.monotonic()
            self._flush(stream)

    def _has_room(self, frame: bytes) -> bool:
        size = sum(len(each) for each, _ in self._waiting.values())
        return _is_order(frame) or size + len(frame) <= _WAITING_BYTES

    def _flush(self, stream: _Stream, *, all_of_it: bool = False) -> None:
        """Write what waits, as far as there is room; a lost stream clears it."""
        try:
            while data := self._next(stream, all_of_it=all_of_it):
                taken = self._write(stream, data)
                rest, self._begun = taken - len(self._begun), self._begun[taken:]
                while rest > 0:
                    frame, _ = self._waiting.pop(next(iter(self._waiting)))
                    rest, self._begun = rest - len(frame), frame[rest:]
                if taken < len(data):
                    return
        except BlockingIOError:
            return
        except _LOST:  # the receiving side notices, too
            self._clear()

    def _next(self, stream: _Stream, *, all_of_it: bool) -> bytes:
        """What is to be written now, in front of which nothing waits.

        A setpoint that has waited for too long goes.  An order has to get out: with all that waits
        it is given to the computer as far as that takes it.
        """
        setpoint = self._waiting.get(True)
        if setpoint is not None and time.monotonic() - setpoint[1] > _STALE_S:
            del self._waiting[True]
        frames = [frame for frame, _ in self._waiting.values()]
        if all_of_it or any(map(_is_order, frames)):
            room = sys.maxsize
        else:
            room = _UNDER_WAY_BYTES - self._under_way(stream)
        data = self._begun if room > 0 else b""
        for frame in frames:
            if len(data) >= room:
                break
            data += frame
        return data

    def _clear(self) -> None:
        self._begun = b""
        self._waiting.clear()

    def close(self) -> None:
        """Close the stream for good, after what waits; a thread waiting for one returns."""
        self._over.set()
        stream = self._stream
        if stream is not None:
            with self._lock:
                self._flush(stream, all_of_it=True)
        self._drop()

    def _drop(self) -> None:
        """The stream is lost: a new one begins with a whole frame."""
        stream, self._stream = self._stream, None
        with self._lock, contextlib.suppress(OSError):
            self._clear()
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
        """Try to open the stream, for up to a time."""

    @abstractmethod
    def _read(self, stream: _Stream, timeout_s: float) -> bytes | None:
        """Received bytes; None: time-out; b"" or one of _LOST: the stream is lost."""

    @abstractmethod
    def _write(self, stream: _Stream, data: bytes) -> int:
        """Write what there is room for; how many bytes that was."""

    @abstractmethod
    def _under_way(self, stream: _Stream) -> int:
        """How many bytes this computer still holds of what was written; 0 if it does not tell."""


@final
class TcpClient(_StreamLink[socket.socket]):
    """tcp:HOST:PORT.  Connects again and again while the peer is absent."""

    def __init__(self, place: Address) -> None:
        super().__init__()
        self._family, self._address = place.resolved()
        self._calling: socket.socket | None = None

    def _open(self, timeout_s: float) -> None:
        calling = self._calling
        with contextlib.suppress(*_LOST):  # it was closed just now
            if calling is None:
                if not self._is_due(timeout_s):
                    return
                calling = self._calling = socket.socket(self._family, socket.SOCK_STREAM)
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

    def _adopt(self, stream: socket.socket) -> None:
        stream.setblocking(False)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNANSWERED_MS)
        if not sys.platform.startswith("linux"):  # it would not tell how much it holds
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2 * _UNDER_WAY_BYTES)
        self._drop()
        self._stream = stream

    def _read(self, stream: socket.socket, timeout_s: float) -> bytes | None:
        return stream.recv(_PIECE_BYTES) if _readable([stream], timeout_s) else None

    def _write(self, stream: socket.socket, data: bytes) -> int:
        return stream.send(data)

    def _under_way(self, stream: socket.socket) -> int:
        if not sys.platform.startswith("linux"):
            return 0
        return int.from_bytes(_ioctl(stream.fileno(), _UNSENT, bytes(4)), sys.byteorder)

    def close(self) -> None:
        """Close the stream, or stop connecting, for good."""
        calling, self._calling = self._calling, None
        if calling is not None:
            calling.close()
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

    def _under_way(self, stream: serial.Serial) -> int:
        return int(stream.out_waiting)
