"""Links to the vehicle by the connection strings that pymavlink's users know.

    udpin:HOST:PORT, udp:HOST:PORT   wait for the vehicle here, and answer where it is heard
    udpout:HOST:PORT                 call it there (a vehicle, or a router's server port)
    tcp:HOST:PORT                    connect to it there; connected again after a loss
    tcpin:HOST:PORT                  wait for its connection here; the newest one counts
    /dev/ttyACM0, COM3,57600, serial:/dev/ttyUSB0:921600   a serial port; 57600 baud if not said

A link loses what it cannot send at once, as a radio does, and never raises for what may come back:
a peer that is away, a device that was pulled out.  One thread receives, one other may send.
"""

import contextlib
import select
import socket
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Protocol, Self, final

from companion.runtime.connection import Address, Device, parsed, refused
from companion.runtime.stream_links import SerialLink, TcpClient, TcpServer

LARGEST_DATAGRAM = 1400  # stays below the usual MTU


class Link(Protocol):
    """A pipe of bytes to one vehicle."""

    @property
    def sender(self) -> object:
        """Who sent what was received last; an argument of answer_to."""
        ...

    def receive(self, timeout_s: float) -> bytes | None:
        """The next datagram or piece of a stream, or None if none came in time."""
        ...

    def answer_to(self, sender: object) -> None:
        """From now on send there: that was the vehicle."""
        ...

    def send(self, frames: list[bytes]) -> None:
        """Send frames, whole and in order, or lose them; never waits."""
        ...

    def close(self) -> None:
        """Let go of the port."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


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

    Answers are addressed to whom they are for.  Nothing that happens to one of these links is a
    reason for a flight to end, or to wait.
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


@final
class UdpLink:
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
        if not select.select([self._socket], (), (), timeout_s)[0]:
            return None
        try:
            data, self._sender = self._socket.recvfrom(65536)
        except (BlockingIOError, ConnectionError, InterruptedError):
            return None
        return data

    def answer_to(self, sender: object) -> None:
        """From now on send to that sender."""
        if isinstance(sender, tuple):
            self._peer = sender

    def send(self, frames: list[bytes]) -> None:
        """Frames in order, as few datagrams as they fit into.  Dropped while nobody was heard."""
        if self._peer is None:
            return
        batch = b""
        for frame in [*frames, b""]:
            if batch and (not frame or len(batch) + len(frame) > LARGEST_DATAGRAM):
                with contextlib.suppress(OSError):  # a datagram that is lost, like any other
                    self._socket.sendto(batch, self._peer)
                batch = b""
            batch += frame

    def close(self) -> None:
        """Let go of the port."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
