"""vehicle-sim as a process with several vehicles and several links."""

import json
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest
from clients import Client, Process, tcp_client, udp_client
from pymavlink.dialects.v20 import all as mavlink

Start = Callable[..., Process]


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
