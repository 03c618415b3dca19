"""Datagrams over real sockets on the loopback."""

import contextlib
import socket
from collections.abc import Iterator

import pytest
from programs import free_port

from companion.errors import InputError
from companion.runtime.link import datagrams, open_link

PATIENCE_S = 10.0


@pytest.fixture
def other() -> Iterator[socket.socket]:
    """The vehicle's end: a socket of the test's own."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", 0))
        end.settimeout(PATIENCE_S)
        yield end


def test_datagrams_arrive_whole_in_order_and_answers_go_to_who_was_chosen_last(
    other: socket.socket,
) -> None:
    """What is sent before anybody was heard is dropped; the port is given back.

    The source port of a rebooted vehicle is another one; a stranger does not take its place.
    """
    port = free_port()
    for _ in range(2):
        with open_link(f"udpin:127.0.0.1:{port}") as link, socket.socket(type=other.type) as later:
            later.settimeout(PATIENCE_S)
            assert link.receive(0.0) is None  # nothing heard is no error
            link.send([b"lost"])
            for number in range(100):
                other.sendto(b"to %d" % number, ("127.0.0.1", port))
            got = [link.receive(PATIENCE_S) for _ in range(100)]
            assert got == [b"to %d" % number for number in range(100)]
            link.answer_to(link.sender)
            later.sendto(b"after", ("127.0.0.1", port))
            assert link.receive(PATIENCE_S) == b"after"
            for number in range(100):
                link.send([b"from %d" % number])
            assert [other.recv(2000) for _ in range(100)] == [b"from %d" % n for n in range(100)]
            link.answer_to(link.sender)
            link.send([b"answer"])
            assert later.recv(2000) == b"answer"


@pytest.mark.parametrize(
    "sizes",
    [[], [20] * 200, [1400], [1399, 1, 1], [700, 700, 700], [280] * 11, [1, 1400, 1], [2000, 10]],
    ids=str,
)
def test_frames_are_batched_into_as_few_datagrams_of_1400_bytes(sizes: list[int]) -> None:
    """In order and whole; each as full as it can be."""
    frames = [bytes([number % 256]) * size for number, size in enumerate(sizes)]
    expected = list[bytes]()
    for frame in frames:
        if not expected or len(expected[-1]) + len(frame) > 1400:
            expected.append(b"")
        expected[-1] += frame
    assert [*datagrams(frames)] == expected


def test_a_vehicle_that_is_not_there_or_a_network_that_refuses_is_no_error() -> None:
    """In flight nothing unwinds the stack: sending to a broadcast address is not permitted."""
    for place in (f"127.0.0.1:{free_port()}", "255.255.255.255:14550"):
        with open_link(f"udpout:{place}") as link:
            for _ in range(3):
                link.send([b"anybody?"])
                assert link.receive(0.02) is None


def test_a_port_in_use_is_an_input_error_with_its_remedy(other: socket.socket) -> None:
    text = f"udpin:127.0.0.1:{other.getsockname()[1]}"
    with pytest.raises(InputError, match=r"in use.*choose another port") as caught:
        open_link(text)
    assert caught.value.field == "--connect"
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="cannot be opened"):
        open_link("udpin:192.0.2.1:14540")  # of another machine


def has_ipv6() -> bool:
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as end:
        end.bind(("::1", 0))
        return True
    return False


@pytest.mark.skipif(not has_ipv6(), reason="this computer has no IPv6")
def test_ipv6_is_a_network_like_any_other() -> None:
    port = free_port()
    with open_link(f"udpin:[::1]:{port}") as here, open_link(f"udpout:[::1]:{port}") as there:
        for sends, hears in ((there, here), (here, there)):
            sends.send([b"hello"])
            assert hears.receive(PATIENCE_S) == b"hello"
            hears.answer_to(hears.sender)
