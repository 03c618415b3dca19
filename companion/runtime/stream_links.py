"""Links that are streams: TCP both ways round, and serial ports.

What comes in is passed on in the pieces in which it comes.  What goes out is frames, each whole or
not at all: a peer that does not read loses the newest, and a loss of the stream loses all that was
waiting.
"""

import contextlib
import math
import os
import select
import socket
import threading
import time
from collections.abc import Callable
from functools import partial
from types import TracebackType
from typing import Protocol, Self, final

import serial

from companion.runtime.connection import Address, Device, refused

try:
    from termios import error as _TerminalError
except ImportError:  # Windows has no terminals of this kind
    _TerminalError = OSError  # type: ignore[assignment,misc]

_AGAIN_S = 0.5
"""Between attempts to connect or to open again."""
_PENDING_BYTES = 2048
"""What may wait for a peer that reads slowly: half a second of setpoints, not more."""
_PIECE_BYTES = 65536
_UNANSWERED_MS = 5000  # a TCP peer that is gone without a word


@final
class _Outbox:
    """Bytes on their way into a stream that takes as many as it has room for."""

    def __init__(self) -> None:
        self._pending = b""
        self.lock = threading.Lock()
        """Held while bytes are written: a stream that is closed under it is not written to."""

    def put(self, frames: list[bytes], write: Callable[[bytes], int | None]) -> None:
        """Write what waits and then frames; whatever `write` raises leaves nothing waiting."""
        with self.lock:
            for frame in frames:
                if len(self._pending) + len(frame) > _PENDING_BYTES:
                    self._flush(write)
                if len(self._pending) + len(frame) <= _PENDING_BYTES:
                    self._pending += frame
            self._flush(write)

    def clear(self) -> None:
        """The stream is gone: a new one begins with a whole frame."""
        with self.lock:
            self._pending = b""

    def _flush(self, write: Callable[[bytes], int | None]) -> None:
        try:
            while self._pending:
                taken = write(self._pending) or 0
                if taken == 0:
                    return
                self._pending = self._pending[taken:]
        except BlockingIOError:
            return
        except OSError:
            self._pending = b""
            raise


@final
class _Attempts:
    """When to connect or to open again: at once, then every _AGAIN_S, and never once it is over."""

    def __init__(self) -> None:
        self._next_s = -math.inf
        self._over = threading.Event()

    def is_due(self, timeout_s: float) -> bool:
        """Whether to try now; if it is too early, waits until it is due, at most timeout_s."""
        wait_s = self._next_s - time.monotonic()
        if wait_s > 0.0:
            self._over.wait(min(wait_s, timeout_s))
            return False
        self._next_s = time.monotonic() + _AGAIN_S
        return not self._over.is_set()

    def end(self) -> None:
        """No more of them; whoever waits for the next one goes on at once."""
        self._over.set()


class _Closable(Protocol):
    def close(self) -> None: ...


class _Context:
    """What all links do as context managers."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self: _Closable,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class _TcpStream(_Context):
    """The part that is the same whoever called whom: one stream, or none at the moment."""

    def __init__(self) -> None:
        self._stream: socket.socket | None = None
        self._outbox = _Outbox()

    @property
    def sender(self) -> object:
        """There is only one."""
        return None

    def answer_to(self, sender: object) -> None:
        """There is only one."""

    def send(self, frames: list[bytes]) -> None:
        """Frames in order; dropped while nobody is connected."""
        stream = self._stream
        if stream is not None:
            with contextlib.suppress(OSError):  # the receiving side notices, too
                self._outbox.put(frames, stream.send)

    def _adopt(self, stream: socket.socket) -> None:
        stream.setblocking(False)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNANSWERED_MS)
        self._drop()
        self._stream = stream

    def _read(self, stream: socket.socket) -> bytes | None:
        try:
            data = stream.recv(_PIECE_BYTES)
        except (BlockingIOError, InterruptedError):
            return None
        except OSError:
            data = b""
        if not data:
            self._drop()
        return data or None

    def _drop(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()
        self._outbox.clear()

    def close(self) -> None:
        """Let go of the stream."""
        self._drop()


@final
class TcpClient(_TcpStream):
    """tcp:HOST:PORT.  A peer that is not there (yet, or any more) is called again and again."""

    def __init__(self, place: Address) -> None:
        super().__init__()
        self._address = place.resolved()
        self._calling: socket.socket | None = None
        self._attempts = _Attempts()

    def receive(self, timeout_s: float) -> bytes | None:
        """The next piece of the stream; spends the time connecting if there is none."""
        if self._stream is None:
            self._connect(timeout_s)
            return None
        if not select.select([self._stream], (), (), timeout_s)[0]:
            return None
        return self._read(self._stream)

    def _connect(self, timeout_s: float) -> None:
        if self._calling is None:
            if not self._attempts.is_due(timeout_s):
                return
            self._calling = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            self._calling.setblocking(False)
            self._calling.connect_ex(self._address)
        calling = self._calling
        answered = select.select((), [calling], [calling], timeout_s)
        if not (answered[1] or answered[2]):
            return
        self._calling = None
        if calling.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            calling.close()
        else:
            self._adopt(calling)

    def close(self) -> None:
        """Let go of the stream, or of the attempt to get one; it is not called again."""
        self._attempts.end()
        calling, self._calling = self._calling, None
        if calling is not None:
            calling.close()
        self._drop()


@final
class TcpServer(_TcpStream):
    """tcpin:HOST:PORT.  Whoever connects is the vehicle; a newer connection replaces an older."""

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
        wanted = [self._listener] if stream is None else [self._listener, stream]
        ready = select.select(wanted, (), (), timeout_s)[0]
        if self._listener in ready:
            with contextlib.suppress(OSError):  # it has gone again already
                self._adopt(self._listener.accept()[0])
            return None
        return self._read(stream) if stream is not None and ready else None

    def close(self) -> None:
        """Let go of the port and the stream."""
        self._listener.close()
        self._drop()


@final
class SerialLink(_Context):
    """A serial port.  One that vanishes (a cable, a rebooting autopilot) is opened again."""

    def __init__(self, place: Device) -> None:
        self._place = place
        self._outbox = _Outbox()
        self._attempts = _Attempts()
        self._port: serial.Serial | None
        try:
            self._port = self._opened()
        except OSError as error:  # SerialException is one
            raise refused(place, _cause(error)) from error
        except ValueError as error:
            raise refused(place, OSError(0, str(error))) from error

    def _opened(self) -> serial.Serial:
        """The port, with nothing left in it from before; OSError or ValueError if there is none."""
        name, baud = self._place.name, self._place.baud
        try:
            return serial.Serial(name, baud, timeout=0.0, write_timeout=0.0, exclusive=True)
        except _TerminalError as error:  # it vanished while it was being opened: no OSError
            raise serial.SerialException(*error.args) from error

    @property
    def sender(self) -> object:
        """There is only one."""
        return None

    def answer_to(self, sender: object) -> None:
        """There is only one."""

    def receive(self, timeout_s: float) -> bytes | None:
        """What has arrived, as soon as anything has; None if nothing came in time."""
        port = self._port
        if port is None:
            self._open_again(timeout_s)
            return None
        try:
            if port.timeout != timeout_s:
                port.timeout = timeout_s
            data = port.read(1)
            return data + port.read(port.in_waiting) if data else None
        except (OSError, _TerminalError, TypeError):  # TypeError: of a port that was just closed
            self._drop(port)
            return None

    def _open_again(self, timeout_s: float) -> None:
        if self._attempts.is_due(timeout_s):
            with contextlib.suppress(OSError, ValueError):
                self._port = self._opened()

    def _drop(self, port: serial.Serial) -> None:
        self._port = None
        self._outbox.clear()
        with self._outbox.lock, contextlib.suppress(OSError):
            port.close()

    def send(self, frames: list[bytes]) -> None:
        """Frames in order; dropped while the device is away."""
        port = self._port
        if port is not None:
            with contextlib.suppress(OSError, TypeError):  # the receiving side notices, too
                self._outbox.put(frames, partial(_write, port))

    def close(self) -> None:
        """Let go of the device; it is not opened again."""
        self._attempts.end()
        if self._port is not None:
            self._drop(self._port)


def _write(port: serial.Serial, data: bytes) -> int:
    """Write what there is room for: pyserial's own write spins until there is room for all."""
    if os.name == "posix":
        return os.write(port.fileno(), data)
    return port.write(data) or 0


def _cause(error: OSError) -> OSError:
    """What the operating system said: pyserial wraps it in words of its own."""
    inner = error.__context__
    return inner if isinstance(inner, OSError) and inner.strerror else error
