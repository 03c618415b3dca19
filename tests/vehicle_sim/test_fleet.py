"""vehicle-sim as a process with several vehicles, several links, and things going wrong."""

import json
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

Start = Callable[..., "subprocess.Popen[str]"]
HOME = "47.397742,8.545594,488,0"


def wait_until(other: Any, reached: Callable[[Any], bool], most: int = 20_000) -> Any:
    """The first message for which this is so."""
    for _ in range(most):
        for message in other.messages():
            if reached(message):
                return message
    pytest.fail("it never came")


def neighbours() -> tuple[socket.socket, socket.socket]:
    """Two sockets on free ports in a row."""
    for _ in range(100):
        one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        two = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        one.bind(("127.0.0.1", 0))
        try:
            two.bind(("127.0.0.1", one.getsockname()[1] + 1))
        except OSError:
            one.close()
            two.close()
            continue
        return one, two
    pytest.fail("no two free ports in a row")


def ended(process: "subprocess.Popen[str]") -> tuple[int, str, str]:
    out, err = process.communicate(timeout=20)
    return process.returncode, out, err


def test_three_vehicles_on_one_port_are_told_apart_by_their_systems(
    start: Start, companion: Any, tmp_path: Path
) -> None:
    process = start(
        *("--count", 3, "--connect", f"udpout:127.0.0.1:{companion.port}", "--speedup", 20),
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
    code, out, err = ended(process)
    assert (code, err) == (0, "")
    assert "as system 1 to 3" in out
    armed = {}
    for number, name in enumerate(("truth.jsonl", "truth-2.jsonl", "truth-3.jsonl"), start=1):
        _, *rows = map(json.loads, (tmp_path / name).read_text("utf-8").splitlines())
        armed[number] = any(row["armed"] for row in rows)
        assert rows[0]["east_m"] == pytest.approx(10.0 * (number - 1), abs=0.01)
    assert armed == {1: False, 2: True, 3: False}


@pytest.mark.parametrize("leaves", [None, 1])
def test_with_a_port_step_each_vehicle_has_its_own_ports_and_its_own_lockstep(
    start: Start, leaves: int | None
) -> None:
    """Also when the companion of one says that it ends: the others fly on as long as was asked."""
    one, two = neighbours()
    with one, two:
        process = start(
            *("--count", 2, "--port-step", 1, "--lockstep", "--duration", 2),
            *("--connect", f"udpout:127.0.0.1:{one.getsockname()[1]}", "--autopilot", "px4"),
        )
        ticks = {1: 0, 2: 0}
        clients = {1: one, 2: two}
        macs = {k: mavlink.MAVLink(None, srcSystem=k, srcComponent=195) for k in clients}
        greeted: set[int] = set()
        for client in clients.values():
            client.settimeout(0.05)
        while process.poll() is None:
            for system, client in clients.items():
                try:
                    data, address = client.recvfrom(65535)
                except TimeoutError:
                    continue
                parser = mavlink.MAVLink(None)
                parser.robust_parsing = True
                for message in parser.parse_buffer(data) or []:
                    assert message.get_srcSystem() in (system, 0)  # 0: not in pymavlink's dialect
                    if message.get_type() == "TIMESYNC" and message.tc1 == 0 and message.ts1:
                        answer = mavlink.MAVLink_timesync_message(message.ts1, message.ts1)
                        client.sendto(answer.pack(macs[system]), address)
                        ticks[system] += 1
                        if system == leaves:
                            beat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 7, 3)
                            client.sendto(beat.pack(macs[system]), address)
                            client.settimeout(1e-3)
                if system not in greeted:
                    beat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
                    client.sendto(beat.pack(macs[system]), address)
                    greeted.add(system)
        code, _, err = ended(process)
    assert (code, err) == (0, "")
    if leaves is None:
        assert ticks[1] == pytest.approx(ticks[2], abs=1)
    else:
        assert ticks[leaves] < 5
    assert ticks[2] > 50  # PX4 streams its position at 50 Hz unasked


def test_clients_on_two_links_hear_each_other_through_the_vehicle(
    start: Start, companion: Any
) -> None:
    process = start(
        *("--connect", f"udpout:127.0.0.1:{companion.port}", "--connect", "tcpin:127.0.0.1:0"),
        *("--duration", 60),
    )
    assert process.stdout is not None
    opening = process.stdout.readline()
    port = int(opening.split("tcpin:127.0.0.1:")[1].split(",")[0])
    with socket.create_connection(("127.0.0.1", port), timeout=10.0) as ground:
        mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        companion.datagram()
        companion.send(companion.heartbeat())
        beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        ground.sendall(beat.pack(mav))
        got = wait_until(companion, lambda m: m.get_srcSystem() == 255)
        assert got.get_type() == "HEARTBEAT"
        command = mavlink.MAVLink_command_long_message(1, 195, 42, 0, 1, 2, 3, 4, 5, 6, 7)
        ground.sendall(command.pack(mav))
        got = wait_until(companion, lambda m: m.get_type() == "COMMAND_LONG")
        assert (got.command, got.param7, got.get_srcComponent()) == (42, 7.0, 190)
    process.terminate()
    code, _, err = ended(process)
    assert (code, err) == (0, "")


def test_strict_ends_the_run_at_what_the_real_one_does_not_survive(
    start: Start, companion: Any
) -> None:
    process = start(
        *("--connect", f"udpout:127.0.0.1:{companion.port}", "--lockstep", "--strict"),
    )
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
    code, _, err = ended(process)
    assert code == 1
    assert err.startswith("error: SIM:")
    assert err.count("\n") == 1
