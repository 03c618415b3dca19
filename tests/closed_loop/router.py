"""What mavlink-router does on one UDP port: everybody who was heard gets what all others say."""

import contextlib
import select
import socket
import threading
from types import TracebackType
from typing import Self

_POLL_S = 0.05


class Router:
    """Passes every datagram on to all other peers, and keeps a copy of each."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
        self.passed: list[bytes] = []
        self._peers: set[tuple[str, int]] = set()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="router", daemon=True)

    @property
    def port(self) -> int:
        return int(self._socket.getsockname()[1])

    def _run(self) -> None:
        while not self._over.is_set():
            if select.select([self._socket], [], [], _POLL_S)[0]:
                with contextlib.suppress(ConnectionRefusedError):  # somebody has gone
                    self._pass_on(*self._socket.recvfrom(65535))

    def _pass_on(self, data: bytes, sender: tuple[str, int]) -> None:
        self._peers.add(sender)
        self.passed.append(data)
        for peer in self._peers - {sender}:
            self._socket.sendto(data, peer)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._over.set()
        self._thread.join()
        self._socket.close()
