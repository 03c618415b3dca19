"""Real TCP sockets on the loopback, and pseudo-terminals for serial ports."""

import contextlib
import os
import pty
import select
import socket
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from programs import free_port
from pymavlink.dialects.v20 import all as wire
from stub_session import HEARTBEAT, HOLD, packed

from companion.errors import InputError
from companion.runtime import link as links
from companion.runtime.link import Link, open_link

PATIENCE_S = 10.0
FRAME = bytes(range(64))


def heard(link: Link, count: int) -> bytes:
    """So many bytes, in whatever pieces."""
    data, until_s = b"", time.monotonic() + PATIENCE_S
    while len(data) < count:
        assert time.monotonic() < until_s, f"only {len(data)} bytes"
        data += link.receive(0.05) or b""
    return data


def arriving(link: Link, far: int, enough: Callable[[bytes], bool], *goes_on: bytes) -> bytes:
    """What comes out at the far end, which does not block, until it is enough.

    Meanwhile these frames go on being sent.
    """
    data, until_s = b"", time.monotonic() + PATIENCE_S
    os.set_blocking(far, False)
    while not enough(data):
        assert time.monotonic() < until_s, f"only {len(data)} bytes"
        link.send([*goes_on])
        assert link.receive(0.01) is None
        with contextlib.suppress(BlockingIOError):
            data += os.read(far, 1 << 20)
    return data


def until(done: Callable[[], bool]) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < until_s


# --- TCP


class Server:
    """The vehicle's end of tcp:."""

    def __init__(self, port: int = 0) -> None:
        self.listener = socket.create_server(("127.0.0.1", port))
        self.listener.settimeout(PATIENCE_S)
        self.port: int = self.listener.getsockname()[1]

    def accept(self, link: Link) -> socket.socket:
        """The connection that the link makes; what it was sent meanwhile is nothing."""
        made: list[socket.socket] = []
        thread = threading.Thread(target=lambda: made.append(self.listener.accept()[0]))
        thread.start()
        while thread.is_alive():
            assert link.receive(0.02) is None
        assert link.receive(0.02) is None
        made[0].settimeout(PATIENCE_S)
        return made[0]


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    with made.listener:
        yield made


def test_tcp_carries_bytes_both_ways(server: Server) -> None:
    with open_link(f"tcp:127.0.0.1:{server.port}") as link, server.accept(link) as peer:
        peer.sendall(b"to the companion")
        assert heard(link, 16) == b"to the companion"
        link.send([b"one", b"two"])
        link.answer_to(link.sender)
        link.send([b"three"])
        assert peer.recv(11, socket.MSG_WAITALL) == b"onetwothree"


def test_a_tcp_peer_that_is_lost_is_called_again_and_nothing_is_raised(server: Server) -> None:
    with open_link(f"tcp:127.0.0.1:{server.port}") as link:
        for number in range(3):
            with server.accept(link) as peer:
                peer.sendall(b"%d" % number)
                assert heard(link, 1) == b"%d" % number
            until(lambda: link.receive(0.02) is None)
            link.send([FRAME])


def test_a_tcp_peer_that_is_not_there_yet_is_no_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with open_link(f"tcp:127.0.0.1:{port}") as link:
        for _ in range(5):
            link.send([FRAME])
            assert link.receive(0.02) is None
        late = Server(port)
        with late.listener, late.accept(link) as peer:
            peer.sendall(b"here")
            assert heard(link, 4) == b"here"


def test_an_order_that_was_given_before_anybody_answered_is_not_kept_for_later(
    server: Server,
) -> None:
    with open_link(f"tcp:127.0.0.1:{server.port}") as link:
        assert link.receive(0.0) is None  # it calls
        link.send([HOLD])
        with server.accept(link) as peer:
            link.send([b"after"])
            assert peer.recv(100) == b"after"


def test_a_tcp_link_that_was_closed_calls_nobody(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links, "_AGAIN_S", 0.0)
    link = open_link(f"tcp:127.0.0.1:{server.port}")
    link.close()
    for _ in range(3):
        assert link.receive(0.01) is None
    server.listener.setblocking(False)
    with pytest.raises(BlockingIOError):
        server.listener.accept()


def test_a_tcp_peer_that_does_not_read_loses_whole_frames_and_makes_nobody_wait(
    server: Server,
) -> None:
    with open_link(f"tcp:127.0.0.1:{server.port}") as link:
        server.listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        with server.accept(link) as peer:
            frames = [bytes([number % 251]) * 100 for number in range(200)]
            for _ in range(500):  # 10 MB, far more than all buffers hold
                link.send(frames)
            got = b""
            peer.settimeout(0.2)
            with contextlib.suppress(TimeoutError):
                while True:
                    got += peer.recv(1 << 20)
            link.send([b"!" * 100])
            got += arriving(link, peer.fileno(), lambda data: data.endswith(b"!" * 100))
    assert len(got) < 10_000_000
    assert len(got) % 100 == 0
    assert all(len(set(got[at : at + 100])) == 1 for at in range(0, len(got), 100))


def setpoint(at_s: float) -> bytes:
    return packed(
        wire.MAVLink_set_position_target_global_int_message(
            round(at_s * 1000), 1, 1, 5, 2496, 1, 1, 500.0, 1.0, 2.0, 0.5, 0.0, 0.0, 0.0, 0.3, 0.0
        )
    )


def stalled(link: Link) -> None:
    """Ten minutes of a flight in which nobody reads; then it is told to hold."""
    for number in range(6_000):
        link.send([setpoint(0.1 * number), HEARTBEAT])
        if number % 100 == 0:
            asked = b"%d" % (number // 100)
            link.send([packed(wire.MAVLink_param_request_read_message(1, 1, asked, -1))])
    link.send([HOLD])


NEWEST = setpoint(600.0)


def assert_nothing_stale(data: bytes, computers: int) -> None:
    """No more setpoints than the computers on the way had taken, bytes; at last the newest.

    Of other messages none is lost, and an order comes where it was given.
    """
    messages = wire.MAVLink(None).parse_buffer(data) or []
    kinds = [message.get_type() for message in messages]
    until_hold = kinds[: kinds.index("COMMAND_LONG")]
    assert {m.time_boot_ms for m in messages[len(until_hold) + 1 :]} == {600_000}
    assert until_hold.count("SET_POSITION_TARGET_GLOBAL_INT") <= 2 + computers / len(NEWEST)
    assert until_hold.count("HEARTBEAT") <= 2 + computers / len(NEWEST)
    asked = [m.param_id for m in messages if m.get_type() == "PARAM_REQUEST_READ"]
    assert asked == [str(number) for number in range(60)]


def test_after_a_stall_the_newest_setpoint_comes_and_not_those_that_waited(
    server: Server,
) -> None:
    takes = 2048  # the least; as much again is what it says that it takes
    server.listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, takes)
    with open_link(f"tcp:127.0.0.1:{server.port}") as link, server.accept(link) as peer:
        stalled(link)
        got = arriving(link, peer.fileno(), lambda data: NEWEST in data, NEWEST)
    assert_nothing_stale(got, 2 * takes + 1024)


def test_a_setpoint_that_has_waited_too_long_is_not_sent(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = [1_000.0]
    monkeypatch.setattr(links.time, "monotonic", lambda: now_s[0])
    server.listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    with open_link(f"tcp:127.0.0.1:{server.port}") as link, server.accept(link) as peer:
        for number in range(100):
            link.send([setpoint(0.1 * number)])
        newest = setpoint(10.0)
        link.send([newest])
        now_s[0] += 0.6
        link.send([HOLD])
        monkeypatch.undo()
        assert newest not in arriving(link, peer.fileno(), lambda data: HOLD in data)


@pytest.mark.parametrize("looked", [False, True])
@pytest.mark.parametrize("kind", ["udpin", "tcp", "tcp, calling"])
def test_a_link_that_is_closed_under_its_reader_ends_its_wait_with_nothing(
    server: Server, monkeypatch: pytest.MonkeyPatch, kind: str, looked: bool
) -> None:
    """Just before the reader looks whether something has come in, or just after."""
    scheme = kind.partition(",")[0]
    port = server.port if scheme == "tcp" else free_port(socket.SOCK_STREAM)
    link = open_link(f"{scheme}:127.0.0.1:{port}")
    with contextlib.ExitStack() as peers:
        if kind == "tcp":
            peers.enter_context(server.accept(link)).sendall(b"late")

        def close_and_select(*arguments: Any) -> Any:
            ready = select.select(*arguments) if looked else None
            link.close()
            return ready or select.select(*arguments)

        monkeypatch.setattr(links, "select", SimpleNamespace(select=close_and_select))
        for _ in range(3):
            assert link.receive(0.02) is None
            link.send([FRAME])


# --- serial


class Terminal:
    """A pseudo-terminal under a name of its own, as udev gives one: it can be pulled out."""

    def __init__(self, name: Path) -> None:
        self.name = name
        self.plug()

    def plug(self) -> None:
        self.far, self._near = pty.openpty()
        tty.setraw(self._near)
        self.name.symlink_to(os.ttyname(self._near))

    def pull(self) -> None:
        self.name.unlink()
        os.close(self._near)
        os.close(self.far)


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    made = Terminal(tmp_path / "ttyACM0")
    yield made
    made.pull()


def test_a_serial_port_carries_bytes_both_ways(terminal: Terminal) -> None:
    with open_link(f"{terminal.name},115200") as link:
        os.write(terminal.far, bytes(range(256)))
        assert heard(link, 256) == bytes(range(256))
        link.send([FRAME, b"end"])
        link.answer_to(link.sender)
        assert os.read(terminal.far, 100) == FRAME + b"end"
        assert link.receive(0.01) is None


def test_a_serial_port_is_opened_at_the_baud_rate_that_is_asked_for(terminal: Terminal) -> None:
    for text, speed in (("", termios.B57600), (",921600", termios.B921600)):
        with open_link(f"{terminal.name}{text}"):
            assert termios.tcgetattr(terminal.far)[4:6] == [speed, speed]


def test_a_device_that_vanishes_and_returns_is_opened_again(terminal: Terminal) -> None:
    with open_link(str(terminal.name)) as link:
        for number in range(3):
            os.write(terminal.far, b"%d" % number)
            assert heard(link, 1) == b"%d" % number
            terminal.pull()
            for _ in range(3):
                assert link.receive(0.02) is None
                link.send([FRAME])
            terminal.plug()
            until(lambda: link.receive(0.02) is None and _is_open(terminal, link))


SETTING_UP = ("tcsetattr", "tcflush")
"""What is done to a port that is open already: of one that is gone it is no OSError."""


def vanishes_at(terminal: Terminal, step: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next time that it is opened, it is pulled out in the middle."""
    real = getattr(termios, step)

    def pulled(*arguments: object) -> None:
        monkeypatch.setattr(termios, step, real)
        terminal.pull()
        real(*arguments)

    monkeypatch.setattr(termios, step, pulled)


@pytest.mark.parametrize("step", SETTING_UP)
def test_a_device_that_vanishes_while_it_is_opened_again_is_opened_once_more(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    """As the USB of a flight controller does, which is a bootloader for some seconds."""
    monkeypatch.setattr(links, "_AGAIN_S", 0.0)
    with open_link(str(terminal.name)) as link:
        terminal.pull()
        assert link.receive(0.02) is None
        terminal.plug()
        vanishes_at(terminal, step, monkeypatch)
        assert link.receive(0.02) is None
        assert not terminal.name.exists()
        terminal.plug()
        until(lambda: link.receive(0.02) is None and _is_open(terminal, link))
        os.write(terminal.far, b"back")
        assert heard(link, 4) == b"back"


def test_a_serial_link_that_was_closed_leaves_its_device_to_others(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links, "_AGAIN_S", 0.0)
    link = open_link(str(terminal.name))
    link.close()
    for _ in range(3):
        assert link.receive(0.01) is None
    open_link(str(terminal.name)).close()


def test_a_serial_link_that_is_closed_while_it_opens_its_device_again_leaves_it_to_others(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links, "_AGAIN_S", 0.0)
    link = open_link(str(terminal.name))
    terminal.pull()
    assert link.receive(0.02) is None
    terminal.plug()
    real = termios.tcsetattr

    def closing(*arguments: Any) -> None:
        monkeypatch.setattr(termios, "tcsetattr", real)
        link.close()
        real(*arguments)

    monkeypatch.setattr(termios, "tcsetattr", closing)
    assert link.receive(0.02) is None
    open_link(str(terminal.name)).close()


def _is_open(terminal: Terminal, link: Link) -> bool:
    link.send([b"?"])
    os.set_blocking(terminal.far, False)
    with contextlib.suppress(BlockingIOError):
        return os.read(terminal.far, 1000).endswith(b"?")
    return False


def test_a_port_that_takes_nothing_makes_nobody_wait_and_cuts_no_frame(terminal: Terminal) -> None:
    frames = [bytes([number]) * 50 for number in range(1, 250)]
    with open_link(str(terminal.name)) as link:
        for _ in range(20):
            link.send(frames)
        got = b""
        os.set_blocking(terminal.far, False)
        for _ in range(100):
            with contextlib.suppress(BlockingIOError):
                got += os.read(terminal.far, 65536)
            link.send([])
    assert len(got) % 50 == 0
    assert 0 < len(got) < 20 * 50 * len(frames)
    assert all(len(set(got[at : at + 50])) == 1 for at in range(0, len(got), 50))


def test_after_a_stall_of_a_serial_port_the_newest_setpoint_comes_and_not_those_that_waited(
    terminal: Terminal,
) -> None:
    """A pseudo-terminal holds 4 kB at its end, and some more of small pieces on the way."""
    with open_link(str(terminal.name)) as link:
        stalled(link)
        data = arriving(link, terminal.far, lambda data: NEWEST in data, NEWEST)
    assert_nothing_stale(data, 5 * 4096)


def requests(first: int, count: int) -> list[bytes]:
    """So many frames of which none makes another needless."""
    names = (b"%d" % number for number in range(first, first + count))
    return [packed(wire.MAVLink_param_request_read_message(1, 1, name, -1)) for name in names]


def test_an_order_is_given_to_the_computer_at_once_and_never_dropped(
    server: Server, terminal: Terminal
) -> None:
    with open_link(f"tcp:127.0.0.1:{server.port}") as link, server.accept(link) as peer:
        link.send(requests(0, 100))  # more than is to be under way
        link.send([HOLD])
        got = b""
        while HOLD not in got:  # nobody pushes any more
            got += peer.recv(4096)
    orders = [packed(wire.MAVLink_command_long_message(1, 1, 176, 0, *[k] * 7)) for k in range(20)]
    with open_link(str(terminal.name)) as link:
        for number, order in enumerate(orders):  # this port takes no more after a while
            link.send([*requests(200 * number, 200), order])
        got = arriving(link, terminal.far, lambda data: orders[-1] in data)
        assert all(order in got for order in orders)


def test_a_device_is_opened_by_one_program_only(terminal: Terminal) -> None:
    with (
        open_link(str(terminal.name)),
        pytest.raises(InputError, match="End the program that uses the device"),
    ):
        open_link(str(terminal.name))


def test_what_is_no_serial_port_is_an_input_error_with_its_remedy(tmp_path: Path) -> None:
    (tmp_path / "a-file").write_text("", encoding="utf-8")
    for name, remedy in (("nothing-here", r"No such file.*Plug the device in"), ("a-file", "Give")):
        with pytest.raises(InputError, match=remedy) as caught:
            open_link(str(tmp_path / name))
        assert "\n" not in str(caught.value)
