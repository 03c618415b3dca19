"""vehicle-sim as a process: lockstep against all that disturbs it, several vehicles and links."""

import hashlib
import json
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest
from clients import Client, Process, is_question, tcp_client, udp_client
from pymavlink.dialects.v20 import all as mavlink

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


# --- several vehicles, several links --------------------------------------------------------------


def test_three_vehicles_on_one_port_are_told_apart_by_their_systems(
    start: Start, companion: Client, tmp_path: Path
) -> None:
    process = start(
        *("--count", 3, "--connect", companion.endpoint, "--speedup", 20),
        *("--duration", 20, "--autopilot", "px4", "--out", tmp_path),
    )
    seen: set[int] = set()
    while seen != {1, 2, 3}:
        seen |= {m.get_srcSystem() for m in companion.messages()}
    arm = mavlink.MAVLink_command_long_message(2, 1, 400, 0, 1, 21196, 0, 0, 0, 0, 0)
    answered = None
    while answered is None:  # until its estimator lets it
        companion.send(companion.frame(arm))
        for message in companion.messages():
            if message.get_type() == "COMMAND_ACK" and message.result == 0:
                answered = message
    assert answered.get_srcSystem() == 2
    code, out, err = process.result()
    assert (code, err) == (0, "")
    assert "as system 1 to 3" in out
    armed = {}
    for number, name in enumerate(("truth.jsonl", "truth-2.jsonl", "truth-3.jsonl"), start=1):
        _, *rows = map(json.loads, (tmp_path / name).read_text("utf-8").splitlines())
        armed[number] = any(row["armed"] for row in rows)
        assert rows[0]["east_m"] == pytest.approx(10.0 * (number - 1), abs=0.01)
    assert armed == {1: False, 2: True, 3: False}


def test_with_a_port_step_each_vehicle_has_its_own_ports(start: Start) -> None:
    with ExitStack() as stack:
        for _ in range(100):  # until there are two free ports in a row
            one = stack.enter_context(udp_client())
            with suppress(OSError):
                two = stack.enter_context(udp_client(port=one.port + 1))
                break
        start("--count", 2, "--port-step", 1, "--connect", one.endpoint)
        for client, system in ((one, 1), (two, 2)):
            beats = [client.wait_for("HEARTBEAT") for _ in range(3)]
            assert {beat.get_srcSystem() for beat in beats} == {system}


def test_clients_on_shared_links_hear_each_other_once_through_the_vehicles(
    start: Start, companion: Client
) -> None:
    process = start(
        *("--count", 2, "--connect", companion.endpoint, "--connect", "tcpin:127.0.0.1:0"),
    )
    with tcp_client(process.port_of("tcpin"), (255, 190)) as ground:
        companion.datagram()
        companion.send(companion.heartbeat())
        ground.send(ground.frame(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
        assert companion.wait_for(lambda m: m.get_srcSystem() == 255).type == 6
        command = mavlink.MAVLink_command_long_message(1, 195, 42, 0, 1, 2, 3, 4, 5, 6, 7)
        ground.send(ground.frame(command))
        got = companion.wait_for("COMMAND_LONG")
        assert (got.command, got.param7, got.get_srcComponent()) == (42, 7.0, 190)
        ground.parser = mavlink.MAVLink(None)
        companion.send(companion.heartbeat(5))  # a status that nobody else here has
        heard: list[Any] = []
        until_s = time.monotonic() + 10.0
        while time.monotonic() < until_s:
            found = [m for m in ground.messages() if getattr(m, "system_status", 0) == 5]
            if found and not heard:
                until_s = time.monotonic() + 1.5  # the vehicles' next heartbeats come after it
            heard += found
    assert len(heard) == 1
    process.terminate()
    assert process.result()[::2] == (0, "")


def test_strict_ends_the_run_at_what_the_real_one_does_not_survive(
    start: Start, companion: Client
) -> None:
    process = start("--connect", companion.endpoint, "--lockstep", "--strict")
    companion.datagram()
    companion.send(companion.heartbeat())
    for k in range(460):
        frames = [companion.heartbeat()] if k % 10 == 0 else []
        if k == 440:
            frames.append(companion.command(176, 1, 4))
        companion.tick(*frames)
    wild = mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 0xDF8, float("nan"), 0, -20, *[0.0] * 8
    )
    companion.tick(companion.frame(wild))
    companion.tick()
    code, _, err = process.result()
    assert code == 1
    assert err.startswith("error: SIM:")
    assert err.count("\n") == 1
