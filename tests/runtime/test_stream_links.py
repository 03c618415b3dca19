"""Real TCP sockets on the loopback, and pseudo-terminals for serial ports."""

import contextlib
import os
import pty
import select
import socket
import termios
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from programs import free_port
from pymavlink.dialects.v20 import all as wire
from stub_session import HEARTBEAT, HOLD, packed, setpoint

from companion.errors import InputError
from companion.runtime import link as links
from companion.runtime.link import Link, open_link

PATIENCE_S = 10.0
NO_DEVICE = 99_999
"""A number that no open file has."""


def until(done: Callable[[], Any]) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < until_s


def heard(link: Link, count: int) -> bytes:
    """So many bytes, in whatever pieces."""
    pieces: list[bytes] = []
    until(lambda: pieces.append(link.receive(0.05) or b"") or sum(map(len, pieces)) >= count)
    return b"".join(pieces)


def arriving(link: Link, far: int, enough: Callable[[bytes], bool], *goes_on: bytes) -> bytes:
    """What comes out at the far end, until it is enough; meanwhile frames go on being sent."""
    data = [b""]
    os.set_blocking(far, False)

    def comes() -> bool:
        link.send([*goes_on])
        assert link.receive(0.01) is None
        with contextlib.suppress(BlockingIOError):
            data[0] += os.read(far, 1 << 20)
        return enough(data[0])

    until(comes)
    os.set_blocking(far, True)
    return data[0]


class Server:
    """The vehicle's end of tcp:, which waits for the call."""

    computers = 2 * 2048 + 1024
    """Bytes that computers take: as much again is what it says that it takes."""

    def __init__(self, port: int = 0) -> None:
        self.listener = socket.create_server(("127.0.0.1", port))
        self.listener.settimeout(PATIENCE_S)
        self.listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)  # the least
        self.name = f"tcp:127.0.0.1:{self.listener.getsockname()[1]}"
        self._peers: list[socket.socket] = []

    def answers(self, link: Link) -> int:
        """The connection that the link makes, once it calls and learns that it is answered."""
        until(lambda: link.receive(0.02) is None and select.select([self.listener], (), (), 0)[0])
        self._peers.append(self.listener.accept()[0])
        assert link.receive(0.02) is None
        return self._peers[-1].fileno()

    def goes(self) -> None:
        self._peers.pop().close()

    def comes_back(self) -> None:
        """It has never stopped to listen."""

    def close(self) -> None:
        for each in (*self._peers, self.listener):
            each.close()


class Terminal:
    """That of a serial port, a pseudo-terminal under a name of its own: it can be pulled out."""

    computers = 5 * 4096
    """Bytes: it holds 4 kB at its end, and some more of small pieces on the way."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "ttyACM0"
        self.name = str(self.path)
        self.comes_back()

    def comes_back(self) -> None:
        self.far, self._near = pty.openpty()
        tty.setraw(self._near)
        self.path.symlink_to(os.ttyname(self._near))

    def goes(self) -> None:
        self.path.unlink()
        os.close(self._near)
        os.close(self.far)

    def answers(self, link: Link) -> int:
        """The far end, once the link has opened the port."""
        arriving(link, self.far, lambda data: data.endswith(b"?"), b"?")
        return self.far

    close = goes


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is lost is reached for again without a wait."""
    monkeypatch.setattr(links, "_AGAIN_S", 0.0)


@pytest.fixture
def server() -> Iterator[Server]:
    with contextlib.closing(Server()) as made:
        yield made


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    with contextlib.closing(Terminal(tmp_path)) as made:
        yield made


@pytest.fixture(params=["server", "terminal"])
def end(request: pytest.FixtureRequest) -> Any:
    return request.getfixturevalue(request.param)


def test_bytes_go_both_ways_and_one_that_is_lost_is_reached_again_until_the_link_is_closed(
    end: Server | Terminal,
) -> None:
    """And nothing is raised."""
    with open_link(end.name) as link:
        for number in range(3):
            far = end.answers(link)
            data = bytes([number]) * 256
            os.write(far, data)
            assert heard(link, 256) == data
            link.send([data, b"one"])
            link.answer_to(link.sender)
            assert arriving(link, far, lambda got: b"one" in got).endswith(data + b"one")
            end.goes()
            for _ in range(3):
                assert link.receive(0.02) is None
                link.send([data])
            end.comes_back()
        end.answers(link)
    for _ in range(3):
        assert link.receive(0.01) is None
    if isinstance(end, Server):
        assert not select.select([end.listener], (), (), 0.0)[0]  # it is left alone


def question(number: int) -> bytes:
    """One of many, of which none makes another needless."""
    return packed(wire.MAVLink_param_request_read_message(1, 1, b"%d" % number, -1))


def test_after_a_stall_the_newest_setpoint_comes_and_no_older(end: Server | Terminal) -> None:
    """Ten minutes of a flight in which nobody reads; then it is told to hold.

    No more setpoints come than the computers on the way had taken, and at last the newest; of other
    messages none is lost or torn, and an order comes where it was given.
    """
    newest = setpoint(600.0)
    with open_link(end.name) as link:
        far = end.answers(link)
        for number in range(6_000):
            link.send([setpoint(0.1 * number), HEARTBEAT])
            if number % 100 == 0:
                link.send([question(number // 100)])
        link.send([HOLD])
        data = arriving(link, far, lambda data: newest in data, newest)
    told = wire.MAVLink(None).parse_buffer(data) or []
    assert b"".join(bytes(message.get_msgbuf()) for message in told) == data
    kinds = [message.get_type() for message in told]
    hold = kinds.index("COMMAND_LONG")
    assert {m.time_boot_ms for m in told[hold + 1 :]} == {600_000}
    for kind in ("SET_POSITION_TARGET_GLOBAL_INT", "HEARTBEAT"):
        assert kinds[:hold].count(kind) <= 2 + end.computers / len(newest)
    asked = [m.param_id for m in told if m.get_type() == "PARAM_REQUEST_READ"]
    assert asked == [str(number) for number in range(60)]


def test_an_order_is_given_to_the_computer_at_once_but_no_setpoint_that_has_waited(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s, newest = [1_000.0], setpoint(10.0)
    with open_link(server.name) as link:
        far = server.answers(link)
        monkeypatch.setattr(links.time, "monotonic", lambda: now_s[0])
        link.send([question(number) for number in range(100)])  # more than is to be under way
        link.send([newest])
        now_s[0] += 0.6
        link.send([HOLD])
        monkeypatch.undo()
        got = b""
        while HOLD not in got:  # nobody pushes any more
            got += os.read(far, 4096)
    assert newest not in got


def test_of_many_orders_to_a_port_that_takes_no_more_none_is_lost(terminal: Terminal) -> None:
    orders = [packed(wire.MAVLink_command_long_message(1, 1, 176, 0, *[k] * 7)) for k in range(20)]
    with open_link(terminal.name) as link:
        for number, order in enumerate(orders):
            link.send([*map(question, range(200 * number, 200 * number + 200)), order])
        got = arriving(link, terminal.far, lambda data: orders[-1] in data)
        assert all(order in got for order in orders)


@pytest.mark.parametrize("listens", [False, True])
def test_a_tcp_peer_that_is_not_there_yet_is_no_error_and_kept_no_order(listens: bool) -> None:
    with contextlib.ExitStack() as stack:
        port = free_port(socket.SOCK_STREAM)
        peer = stack.enter_context(contextlib.closing(Server(port))) if listens else None
        link = stack.enter_context(open_link(f"tcp:127.0.0.1:{port}"))
        for _ in range(1 if listens else 5):
            assert link.receive(0.0 if listens else 0.02) is None  # it calls
            link.send([HOLD])
        peer = peer or stack.enter_context(contextlib.closing(Server(port)))
        far = peer.answers(link)
        link.send([b"after"])
        assert os.read(far, 100) == b"after"


def test_a_serial_port_has_its_baud_rate_for_one_program_alone(
    terminal: Terminal, tmp_path: Path
) -> None:
    (tmp_path / "a-file").write_text("", encoding="utf-8")
    for text, speed in (("", termios.B57600), (",921600", termios.B921600)):
        with open_link(f"{terminal.name}{text}"):
            assert termios.tcgetattr(terminal.far)[4:6] == [speed, speed]
            for name, remedy in (
                ("nothing-here", r"No such file.*plug a device in"),
                ("a-file", "Give"),
                (terminal.path.name, "end the program that uses it"),
            ):
                with pytest.raises(InputError, match=remedy) as caught:
                    open_link(str(tmp_path / name))
                assert "\n" not in str(caught.value)


@pytest.mark.parametrize("step", ["tcsetattr", "tcflush"])
def test_a_device_that_vanishes_while_it_is_opened_again_is_opened_once_more(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    """As the USB of a flight controller does; of a port that is gone this is no OSError."""
    really = getattr(termios, step)
    with open_link(terminal.name) as link:
        terminal.goes()
        assert link.receive(0.02) is None
        terminal.comes_back()
        with monkeypatch.context() as meanwhile:
            meanwhile.setattr(termios, step, lambda _, *arguments: really(NO_DEVICE, *arguments))
            assert link.receive(0.02) is None
        os.write(terminal.answers(link), b"back")
        assert heard(link, 4) == b"back"
