"""Real sockets on the loopback."""

import socket
import time
from collections.abc import Iterator

import pytest

from companion.errors import InputError
from companion.runtime.link import Link, open_link

PATIENCE_S = 5.0


@pytest.fixture
def other() -> Iterator[socket.socket]:
    """The vehicle's end: a socket of the test's own."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", 0))
        end.settimeout(PATIENCE_S)
        yield end


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", 0))
        port: int = end.getsockname()[1]
        return port


def calling(other: socket.socket) -> Link:
    return open_link(f"udpout:127.0.0.1:{other.getsockname()[1]}")


def test_datagrams_arrive_whole_and_in_order_both_ways(other: socket.socket) -> None:
    port = free_port()
    with open_link(f"udpin:127.0.0.1:{port}") as link:
        for number in range(100):
            other.sendto(b"to %d" % number, ("127.0.0.1", port))
        assert [link.receive(PATIENCE_S) for _ in range(100)] == [b"to %d" % n for n in range(100)]
        link.answer_to(link.sender)
        for number in range(100):
            link.send([b"from %d" % number])
        assert [other.recv(2000) for _ in range(100)] == [b"from %d" % n for n in range(100)]


def test_what_is_sent_before_anybody_was_heard_is_dropped(other: socket.socket) -> None:
    port = free_port()
    with open_link(f"udpin:127.0.0.1:{port}") as link:
        link.send([b"lost"])
        other.sendto(b"hello", ("127.0.0.1", port))
        assert link.receive(PATIENCE_S) == b"hello"
        link.answer_to(link.sender)
        link.send([b"heard"])
        assert other.recv(2000) == b"heard"


def test_answers_go_to_the_sender_that_was_chosen_last(other: socket.socket) -> None:
    """The source port of a rebooted vehicle is another one; a stranger does not take its place."""
    port = free_port()
    with open_link(f"udpin:127.0.0.1:{port}") as link:
        other.sendto(b"before", ("127.0.0.1", port))
        link.receive(PATIENCE_S)
        link.answer_to(link.sender)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as rebooted:
            rebooted.settimeout(PATIENCE_S)
            rebooted.sendto(b"after", ("127.0.0.1", port))
            assert link.receive(PATIENCE_S) == b"after"
            link.send([b"to the first"])
            assert other.recv(2000) == b"to the first"
            link.answer_to(link.sender)
            link.send([b"answer"])
            assert rebooted.recv(2000) == b"answer"


@pytest.mark.parametrize(
    "sizes",
    [[20] * 200, [1400], [1399, 1, 1], [700, 700, 700], [280] * 11, [1, 1400, 1], [2000, 10]],
    ids=str,
)
def test_frames_are_batched_in_order_and_whole_into_datagrams_of_1400_bytes(
    other: socket.socket, sizes: list[int]
) -> None:
    frames = [bytes([number % 256]) * size for number, size in enumerate(sizes)]
    with calling(other) as link:
        link.send([])  # nothing to send sends nothing
        link.send(frames)
        datagrams: list[bytes] = []
        while sum(map(len, datagrams)) < sum(sizes):
            datagrams.append(other.recv(65536))
    assert b"".join(datagrams) == b"".join(frames)
    assert all(len(datagram) <= max(1400, *sizes) for datagram in datagrams)
    ends = {sum(sizes[: count + 1]) for count in range(len(sizes))}
    at = 0
    for datagram, following in zip(datagrams, [*datagrams[1:], b"\0" * 1401], strict=True):
        at += len(datagram)
        assert at in ends  # no frame is cut in two
        first_of_following = sizes[sum(end <= at for end in ends)] if at < sum(sizes) else 1401
        assert len(datagram) + first_of_following > 1400 or following == b""


def test_a_vehicle_that_is_not_there_yet_is_no_error() -> None:
    with open_link(f"udpout:127.0.0.1:{free_port()}") as link:
        for _ in range(3):
            link.send([b"anybody?"])
            assert link.receive(0.02) is None


def test_a_network_that_refuses_a_datagram_loses_it_and_nothing_else() -> None:
    """In flight nothing unwinds the stack: sending to a broadcast address is not permitted."""
    with open_link("udpout:255.255.255.255:14550") as link:
        link.send([b"lost"])


def test_a_port_in_use_is_an_input_error_with_its_remedy(other: socket.socket) -> None:
    text = f"udpin:127.0.0.1:{other.getsockname()[1]}"
    with pytest.raises(InputError) as caught:
        open_link(text)
    assert caught.value.field == "--connect"
    message = str(caught.value)
    assert text in message
    assert "in use" in message
    assert "choose another port" in message
    assert "\n" not in message
    with pytest.raises(InputError, match="cannot be opened"):
        open_link("udpin:192.0.2.1:14540")  # of another machine


def has_ipv6() -> bool:
    try:
        with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as end:
            end.bind(("::1", 0))
    except OSError:
        return False
    return True


@pytest.mark.skipif(not has_ipv6(), reason="this computer has no IPv6")
def test_ipv6_is_a_network_like_any_other() -> None:
    port = free_port()
    with open_link(f"udpin:[::1]:{port}") as here, open_link(f"udpout:[::1]:{port}") as there:
        for sends, hears in ((there, here), (here, there)):
            heard, until_s = None, time.monotonic() + PATIENCE_S
            while heard is None and time.monotonic() < until_s:
                sends.send([b"hello"])
                sends.receive(0.01)
                heard = hears.receive(0.01)
            assert heard is not None
            assert heard.startswith(b"hello")
            hears.answer_to(hears.sender)


def test_a_link_gives_its_port_back() -> None:
    port = free_port()
    for _ in range(2):
        with open_link(f"udpin:127.0.0.1:{port}") as link:
            assert link.receive(0.01) is None  # nothing heard is no error
            assert link.receive(0.0) is None


def test_an_ipv4_address_or_a_name_is_understood(other: socket.socket) -> None:
    with open_link(f"udpout:localhost:{other.getsockname()[1]}") as link:
        link.send([b"by name"])
        assert other.recv(2000) == b"by name"
