"""Lockstep of whole processes against everything that could stop or disturb it."""

import hashlib
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from clients import Client, Process, is_question, tcp_client, udp_client

Start = Callable[..., Process]


def follow(client: Client, for_s: float, newest_ns: int = 0) -> str:
    """Answer for so much vehicle time, all boots together; a digest of what came."""
    digest, passed_ns = hashlib.sha256(), 0
    while passed_ns < for_s * 1e9:
        for message in client.messages():
            if newest_ns:
                digest.update(message.get_msgbuf())
            if is_question(message):
                since_ns = newest_ns if message.ts1 >= newest_ns else 0
                newest_ns, passed_ns = message.ts1, passed_ns + message.ts1 - since_ns
                client.send(client.answer(message))
    return digest.hexdigest()


def faults(folder: Path, text: str) -> tuple[str, str]:
    (folder / "faults.txt").write_text(text, encoding="utf-8")
    return "--faults", str(folder / "faults.txt")


def test_it_goes_on_through_a_reboot_over_udp(
    start: Start, companion: Client, tmp_path: Path
) -> None:
    process = start(
        *("--autopilot", "px4", "--lockstep", *faults(tmp_path, "at 3 s: reboot")),
        *("--connect", companion.endpoint, "--duration", 7),
    )
    companion.datagram()
    companion.send(companion.heartbeat())
    follow(companion, 2.9)
    before = companion.address
    follow(companion, 3.5, newest_ns=2_900_000_000)
    assert companion.address != before  # another source port, as the real one's
    # the question counts from the boot, as all stamps do
    assert companion.wait_for(is_question).ts1 < 5e9
    companion.send(companion.heartbeat(7))
    assert process.result()[::2] == (0, "")


def test_over_tcp_a_client_that_was_cut_off_connects_again_and_it_goes_on(
    start: Start, tmp_path: Path
) -> None:
    process = start(
        *("--lockstep", *faults(tmp_path, "at 1 s: reboot")),
        *("--connect", "tcpin:127.0.0.1:0", "--duration", 4),
    )
    port = process.port_of("tcpin")
    with tcp_client(port) as first:
        first.send(first.heartbeat())
        with pytest.raises((ConnectionError, TimeoutError)):  # the reboot ends the connection
            follow(first, 4.0)
    with tcp_client(port) as second:
        follow(second, 1.0)
        second.send(second.heartbeat(7))
        assert process.result()[::2] == (0, "")


def run_late(start: Start, wait_s: float, *options: str) -> str:
    """What a client gets from the first question on, if it comes so late."""
    with udp_client() as client:
        process = start("--lockstep", "--connect", client.endpoint, "--duration", 4, *options)
        client.datagram()
        threading.Event().wait(wait_s)
        client.send(client.heartbeat())
        digest = follow(client, 3.9)
        process.terminate()
        assert process.result()[::2] == (0, "")
    return digest


BAD_LINKS = {
    "lossy and late": """at 0 s: link_duplication 30 %
        at 0 s: link_loss 20 %
        at 0 s: link_corruption 20 %
        at 0 s: link_reordering 30 %
        at 0 s: link_delay 50 ms""",
    "off": "at 0 s: link_off",
}


@pytest.mark.sample(2)
@pytest.mark.parametrize("bad", BAD_LINKS)
def test_links_that_are_bad_from_the_start_neither_stop_it_nor_depend_on_when_one_comes(
    start: Start, bad: str, tmp_path: Path
) -> None:
    options = faults(tmp_path, BAD_LINKS[bad])
    assert run_late(start, 0.0, *options) == run_late(start, 0.7, *options)
