"""The three kinds of endpoint, on real sockets."""

import threading
from collections.abc import Callable, Iterator

import pytest
from clients import tcp_client, udp_client

from vehicle_sim.errors import InputError
from vehicle_sim.links import Link, open_link, parse_endpoint

Open = Callable[[str], Link]


@pytest.fixture
def opened() -> Iterator[Open]:
    links: list[Link] = []

    def begin(text: str) -> Link:
        links.append(open_link(parse_endpoint(text)))
        return links[-1]

    yield begin
    for link in links:
        link.close()


def received(link: Link) -> bytes:
    """What comes next, within a deadline."""
    for _ in range(200):
        data = link.receive()
        if data is not None and any(data):  # zeros come first, of a new client
            return data
        threading.Event().wait(0.01)
    pytest.fail("nothing came")


@pytest.mark.parametrize(
    "text",
    [
        *("", "x", "udp:1:2", "udpin:host", "tcpin:h:99999", "udpout:h:0", "udpout:::1:14540"),
        *("tcp:127.0.0.1:5760", "udp://:14540", "UDPOUT:127.0.0.1:14540", "/dev/ttyACM0,57600"),
        *("udpin:a@b:1", "udpin:h:²", "udpout:h:1 ", "udpin:[::1:5"),
    ],
)
def test_what_is_not_an_endpoint_is_said_to_be_none(text: str) -> None:
    with pytest.raises(InputError, match=r"udpin:HOST:PORT or tcpin:.*Try udpout:127.0.0.1:14540"):
        parse_endpoint(text)


def test_with_two_slashes_it_is_the_same_endpoint() -> None:
    for host in ("127.0.0.1", "[::1]", "vehicle.local"):
        assert str(parse_endpoint(f"udpin://{host}:14540")) == f"udpin:{host}:14540"


def test_a_port_in_use_is_named(opened: Open) -> None:
    taken = opened("udpin:127.0.0.1:0").endpoint
    with pytest.raises(InputError, match=f"udpin:127.0.0.1:{taken.port}"):
        opened(str(taken))


def test_udpin_finds_a_port_and_answers_everybody_who_was_heard(opened: Open) -> None:
    link = opened("udpin:127.0.0.1:0")
    assert link.endpoint.port > 0
    link.send([b"nobody hears this"])
    with udp_client() as one, udp_client() as two:
        for client, words in ((one.link, b"one"), (two.link, b"two")):
            client.sendto(words, ("127.0.0.1", link.endpoint.port))
            assert received(link) == words
        link.send([b"for ", b"both"])
        assert one.datagram() == two.datagram() == b"for both"


def test_what_is_sent_after_a_refusal_is_not_lost_with_it(opened: Open) -> None:
    with udp_client() as probe:
        link = opened(probe.endpoint)
    link.send([b"nobody is there"])
    with udp_client(probe.port) as client:
        link.send([b"now"])
        assert client.datagram() == b"now"


def test_tcpin_serves_one_client_after_the_other(opened: Open) -> None:
    link = opened("tcpin:127.0.0.1:0")
    for words in (b"first", b"second"):
        with tcp_client(link.endpoint.port) as client:
            client.send(words)
            assert received(link) == words
            link.send([words, b"!"])
            assert client.datagram() == words + b"!"
        while link.receive() is not None:
            pass
    link.send([b"nobody is there"])


def test_a_tcp_client_that_does_not_read_costs_bounded_memory_and_gets_whole_frames(
    opened: Open,
) -> None:
    link = opened("tcpin:127.0.0.1:0")
    frame, got = bytes(range(200)) * 5, bytearray()
    with tcp_client(link.endpoint.port) as client:
        client.send(b"x")
        received(link)
        for _ in range(20_000):
            link.send([frame])
        assert len(link._pending) < 1_000_000  # type: ignore[attr-defined]
        while len(got) < 1_000_000:
            got += client.datagram()
        assert bytes(got[:1_000_000]) == frame * 1000
    while link.receive() is not None:
        pass
    with tcp_client(link.endpoint.port) as client:
        client.send(b"x")
        received(link)
        link.send([b"only this"])
        assert client.datagram() == b"only this"
