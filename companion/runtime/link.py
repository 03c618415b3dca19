"""Links to the vehicle, by connection strings as in pymavlink.

    udpin:HOST:PORT, udp:HOST:PORT   wait for the vehicle here, and answer where it is heard
    udpout:HOST:PORT                 call it there (a vehicle, or a router's server port)
    tcp:HOST:PORT                    connect to it there; connected again after a loss
    /dev/ttyACM0,57600, serial:/dev/ttyUSB0:921600   a serial port; 57600 baud if not said

A link drops what it cannot send at once, as a radio does, and never raises for temporary failures:
an absent peer, an unplugged device.  One thread receives, another may send.  Bytes of a stream
(TCP, serial) are passed on as they come; frames are sent whole or not at all, in order.  What a
peer that does not read makes wait is what is still true: the newest setpoint and not those before,
and of equal messages the last.  With the loss of a stream all of it goes.
"""

import contextlib
import fcntl
import math
import os
import select
import socket
import sys
import termios
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Final, Protocol, Self, final

import serial

from companion.runtime.connection import Connection, parsed

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
_UNANSWERED_MS = 5000  # a TCP peer that is gone without a word
_PIECE_BYTES = 65536
_SETPOINTS, _COMMAND_INT = (84, 86), 75
_ORDERS = (11, _COMMAND_INT, 76)
"""SET_MODE, COMMAND_INT, COMMAND_LONG."""
_REPOSITION, _NO_SWITCH = (192).to_bytes(2, "little"), bytes(4)
_LOST: Final = (OSError, ValueError, termios.error)
"""What a stream that is lost raises; ValueError if it is closed."""


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


class Link(Protocol):
    """A pipe of bytes to one vehicle; a context manager that closes it."""

    is_stream: bool = False
    """Whether all that has arrived is received in one piece."""
    sender: object = None
    """Sender of the last data, an argument of answer_to; None: there is only one peer."""

    def receive(self, timeout_s: float) -> bytes | None:
        """The next datagram or piece of a stream, or None if none came in time."""

    def answer_to(self, sender: object) -> None:
        """From now on send to this sender: the vehicle."""
        del sender

    def send(self, frames: list[bytes]) -> None:
        """Send frames, whole and in order, or drop them; never blocks."""

    def close(self) -> None:
        """Close the port, the device or the connection for good."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_link(connection: str) -> Link:
    """The link that a connection string names; InputError, about --connect, if it cannot be."""
    place = parsed(connection)
    return StreamLink(place) if place.kind in ("serial", "tcp") else UdpLink(place)


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

    def __init__(self, place: Connection) -> None:
        family, address = place.resolved()
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
        self._peer: tuple[str, int] | None = None
        try:
            if place.kind == "udpin":
                self._socket.bind(address)
            else:
                self._peer = address
        except OSError as error:
            self._socket.close()
            raise place.refused(error) from error

    def receive(self, timeout_s: float) -> bytes | None:
        """The next datagram, or None if none came in time."""
        try:
            if not select.select([self._socket], (), (), timeout_s)[0]:
                return None
            data, self.sender = self._socket.recvfrom(_PIECE_BYTES)
        except _LOST:  # what the network says of a datagram sent before, or closed just now
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


@final
class StreamLink(Link):
    """A link over TCP or a serial port; while there is none, receive() opens it again."""

    is_stream = True

    def __init__(self, place: Connection) -> None:
        """InputError if a serial port cannot be opened, or there is no such host."""
        self._place = place
        self._network = place.resolved() if place.kind == "tcp" else None
        self._stream: socket.socket | serial.Serial | None = None
        self._is_answered = False
        """Whether it carries what is sent: of TCP, once the call was answered."""
        self._begun = b""
        """The rest of a frame of which a part is sent."""
        self._waiting: dict[object, tuple[bytes, float]] = {}
        """Whole frames by what they say, in order, and since when they wait."""
        self._lock = threading.Lock()
        """Held while bytes are written: a stream that is closed under it is not written to."""
        self._next_s = -math.inf
        """When it is opened again, if it is lost; inf: never, it was closed."""
        if self._network is None:
            try:
                self._stream, self._is_answered = self._opened(), True
            except _LOST as error:
                raise place.refused(error) from error

    def _opened(self) -> socket.socket | serial.Serial:
        """A new stream, that does not block; one of _LOST if there is none."""
        if self._network is None:  # with nothing left in it from before
            name, baud = self._place.name, self._place.number
            return serial.Serial(name, baud, timeout=0.0, write_timeout=0.0, exclusive=True)
        family, address = self._network
        stream = socket.socket(family, socket.SOCK_STREAM)
        stream.setblocking(False)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNANSWERED_MS)
        stream.connect_ex(address)
        return stream

    def receive(self, timeout_s: float) -> bytes | None:
        """What has arrived, as soon as anything has; None if nothing came in time."""
        stream = self._stream
        if stream is None:
            self._reopen(timeout_s)
            return None
        if self._begun or self._waiting:
            timeout_s = min(timeout_s, _PUSH_S)
            with self._lock:
                self._flush(stream)
        try:
            if not self._is_answered:  # a call that is refused can be written to as well
                self._is_answered = bool(select.select((), [stream], (), timeout_s)[1])
                return None
            if not select.select([stream], (), (), timeout_s)[0]:
                return None
            data = os.read(stream.fileno(), _PIECE_BYTES)
        except BlockingIOError:
            return None
        except _LOST:
            data = b""
        if not data:
            self._drop()
        return data or None

    def send(self, frames: list[bytes]) -> None:
        """Frames in order, each in the place of one that says the same; dropped without a stream.

        Of what finds no room the oldest goes, but for orders.
        """
        stream = self._stream
        if stream is None or not self._is_answered:
            return
        with self._lock:
            for frame in frames:
                self._waiting.pop(says := _says(frame), None)
                self._waiting[says] = frame, time.monotonic()
            self._flush(stream)
            size = sum(len(frame) for frame, _ in self._waiting.values())
            for says, (frame, _) in tuple(self._waiting.items()):
                if size > _WAITING_BYTES and not _is_order(frame):
                    del self._waiting[says]
                    size -= len(frame)

    def _flush(self, stream: socket.socket | serial.Serial, *, all_of_it: bool = False) -> None:
        """Write what waits, in order, as far as the computer is to hold it.

        A setpoint that has waited for too long goes.  An order has to get out: with all that waits
        it is given to the computer as far as that takes it.
        """
        setpoint = self._waiting.get(True)
        if setpoint is not None and time.monotonic() - setpoint[1] > _STALE_S:
            del self._waiting[True]
        urgent = all_of_it or any(_is_order(frame) for frame, _ in self._waiting.values())
        try:
            room = math.inf if urgent else _UNDER_WAY_BYTES - _under_way(stream)
            while room > 0 and (self._begun or self._waiting):
                if not self._begun:
                    self._begun, _ = self._waiting.pop(next(iter(self._waiting)))
                taken = os.write(stream.fileno(), self._begun)
                self._begun = self._begun[taken:]
                room -= taken
        except BlockingIOError:
            return
        except _LOST:  # the receiving side notices, too
            self._begun = b""
            self._waiting.clear()

    def close(self) -> None:
        """Close the stream for good, after what waits."""
        self._next_s, stream = math.inf, self._stream
        if stream is not None:
            with self._lock:
                self._flush(stream, all_of_it=True)
        self._drop()

    def _drop(self) -> None:
        """The stream is lost: a new one begins with a whole frame."""
        stream, self._stream, self._is_answered = self._stream, None, False
        with self._lock, contextlib.suppress(OSError):
            self._begun = b""
            self._waiting.clear()
            if stream is not None:
                stream.close()

    def _reopen(self, timeout_s: float) -> None:
        """Open the stream: at once, then every _AGAIN_S; never once closed."""
        wait_s = self._next_s - time.monotonic()
        if wait_s > 0.0:
            time.sleep(min(wait_s, timeout_s))
            return
        self._next_s = time.monotonic() + _AGAIN_S
        with contextlib.suppress(*_LOST):
            self._stream = self._opened()


def _under_way(stream: socket.socket | serial.Serial) -> int:
    """How many bytes this computer still holds of what was written; 0 if it does not tell."""
    try:
        held = fcntl.ioctl(stream.fileno(), termios.TIOCOUTQ, bytes(4))
    except BlockingIOError:
        return 0
    return int.from_bytes(held, sys.byteorder)
