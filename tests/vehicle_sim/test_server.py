"""Lockstep and real time over real sockets: with the server in this process, and as a process."""

import hashlib
import json
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest
from clients import Client, Process, Running, is_question, tcp_client, udp_client
from pymavlink.dialects.v20 import all as mavlink

Serve, Start = Callable[..., Running], Callable[..., Process]
Table = dict[str, Any]


def numbered(table: Table, count: int) -> list[Table]:
    """So many vehicles, of systems that count up."""
    vehicle = table["vehicle"]
    return [table | {"vehicle": vehicle | {"system_id": k + 1}} for k in range(count)]


# --- lockstep -------------------------------------------------------------------------------------


def test_lockstep_stands_at_0_until_a_heartbeat_and_then_until_each_right_answer(
    serve: Serve, companion: Client
) -> None:
    run = serve(companion.endpoint, lockstep=True)
    hello = [*companion.messages(), *companion.messages()]
    assert {(m.get_type(), m.get_srcComponent()) for m in hello} == {
        *(("HEARTBEAT", component) for component in (1, 100))
    }
    assert run.simulation.now_us == 0
    companion.send(companion.heartbeat(), companion.command(511, 30, 100_000))  # heard at once
    times = [companion.tick(companion.command(511, 33, 100_000))[-1].ts1]
    for _ in range(29):
        got = [m for m in companion.tick() if m.get_type() != "HEARTBEAT"]
        times.append(got[-1].ts1)
    assert times == [100_000_000 * k for k in range(1, 31)]
    assert [m.get_type() for m in got] == ["ATTITUDE", "GLOBAL_POSITION_INT", "TIMESYNC"]
    question = companion.wait_for(is_question)
    wrong = companion.frame(mavlink.MAVLink_timesync_message(5, 5))
    companion.send(wrong, b"\xfd garbage \xfd\xff\x00")
    companion.link.settimeout(0.3)
    with pytest.raises(TimeoutError):
        companion.datagram()
    assert run.simulation.now_us == 3_100_000
    companion.send(companion.answer(question))
    assert companion.wait_for(is_question).ts1 == 3_200_000_000


def test_silence_in_lockstep_is_an_error_that_says_what_is_missing(
    serve: Serve, companion: Client
) -> None:
    run = serve(companion.endpoint, lockstep=True, silence_s=0.5)
    companion.begin()
    companion.tick()
    own = mavlink.MAVLink_timesync_message(1, companion.wait_for(is_question).ts1)
    companion.send(companion.frame(own))  # it answers with a time of its own
    assert run.ended()
    assert "at 0.2 s of vehicle time" in str(run.error)
    assert "tc1 to echo ts1" in str(run.error)
    run = serve(companion.endpoint, lockstep=True, first_heartbeat_s=0.3)
    assert run.ended()
    assert "no heartbeat" in str(run.error)


def test_vehicles_on_one_link_ask_different_questions_and_wait_for_all(
    serve: Serve, world_table: Table, companion: Client
) -> None:
    serve(companion.endpoint, *numbered(world_table, 3), lockstep=True)
    companion.begin()
    asked = list[tuple[int, int]]()
    while len(asked) < 15:
        for message in filter(is_question, companion.messages()):
            asked.append((message.ts1, message.get_srcSystem()))
            companion.send(companion.answer(message))
    assert len({question for question, _ in asked}) == len(asked)
    assert [system for _, system in asked[:6]] == [1, 2, 3, 1, 2, 3]


def test_each_of_several_vehicles_flies_its_own_time(serve: Serve, world_table: Table) -> None:
    """The clock of the one whose companion ends first stands, and the other's goes on."""
    with udp_client() as first, udp_client(ids=(2, 195)) as second:
        both = f"{first.endpoint} {second.endpoint}"
        run = serve(both, *numbered(world_table, 2), lockstep=True, duration_s=3.0)
        first.begin()
        second.begin()
        last_ns = 0
        while last_ns < 3_000_000_000:
            if run.simulations[0].now_us < 1_000_000:
                first.tick()
            elif not run.simulations[0].companion_ended:
                first.send(first.heartbeat(7))
            for message in filter(is_question, second.messages()):
                last_ns = message.ts1
                second.send(second.answer(message))
        assert run.ended()
    assert run.simulations[0].now_us <= 1_100_000
    assert run.simulations[1].now_us == 3_000_000


# --- real time ------------------------------------------------------------------------------------


def test_real_time_keeps_the_pace_whatever_the_companion_does(
    serve: Serve, companion: Client
) -> None:
    run = serve(companion.endpoint, speedup=20.0)
    companion.datagram()  # heard once, never answered
    start_s, start_us = time.monotonic(), run.simulation.now_us
    assert not run.ended(0.6)
    flown_s, passed_s = (run.simulation.now_us - start_us) * 1e-6, time.monotonic() - start_s
    assert 10.0 < flown_s / passed_s < 22.0  # a busy computer may let time slip, but gains none


# --- lockstep against all that disturbs it --------------------------------------------------------


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


def test_it_goes_on_through_a_reboot_over_udp(serve: Serve, companion: Client) -> None:
    run = serve(companion.endpoint, lockstep=True)
    companion.begin()
    follow(companion, 2.9)
    run.simulation.add_fault("reboot")
    follow(companion, 3.5, newest_ns=2_900_000_000)
    # the question counts from the boot, as all stamps do
    assert companion.wait_for(is_question).ts1 < 5e9
    companion.send(companion.heartbeat(7))
    assert run.ended()
    assert run.error is None


def test_over_tcp_a_client_that_was_cut_off_connects_again_and_it_goes_on(serve: Serve) -> None:
    run = serve("tcpin:127.0.0.1:0", lockstep=True)
    with tcp_client(run.port) as first:
        first.send(first.heartbeat())
        follow(first, 1.0)
    with tcp_client(run.port) as second:
        follow(second, 2.0)
        second.send(second.heartbeat(7))
        assert run.ended()
    assert run.error is None


@pytest.mark.parametrize(
    "bad",
    [
        ("link_duplication 30 %", "link_loss 20 %", "link_delay 50 ms jitter 30 ms"),
        pytest.param(("link_off",), marks=pytest.mark.nightly),
    ],
)
def test_links_that_are_bad_from_the_start_neither_stop_it_nor_depend_on_when_one_comes(
    serve: Serve, bad: tuple[str, ...]
) -> None:
    told = set[str]()
    for wait_s in (0.0, 0.7):
        with udp_client() as client:
            run = serve(client.endpoint, lockstep=True)
            for line in bad:
                run.simulation.add_fault(line)
            client.datagram()
            assert not run.ended(wait_s)
            client.send(client.heartbeat())
            told.add(follow(client, 3.9))
            run.stop.set()
            assert run.ended()
            assert run.error is None
    assert len(told) == 1


# --- as a process: several vehicles, several links ------------------------------------------------


def test_three_vehicles_on_one_port_are_told_apart_by_their_systems(
    start: Start, companion: Client, tmp_path: Path
) -> None:
    process = start(
        *("--count", 3, "--connect", companion.endpoint, "--speedup", 20),
        *("--duration", 20, "--autopilot", "px4", "--out", tmp_path),
    )
    companion.datagram()
    while True:  # until its estimator lets it
        companion.send(companion.command(400, 1, 21196, target=(2, 1)))
        accepted = [m for m in companion.messages() if getattr(m, "result", None) == 0]
        if accepted:
            break
    assert accepted[0].get_srcSystem() == 2
    code, out, err = process.result()
    assert (code, err) == (0, "")
    assert "as system 1 to 3" in out
    for number, name in enumerate(("truth.jsonl", "truth-2.jsonl", "truth-3.jsonl")):
        _, *rows = map(json.loads, (tmp_path / name).read_text("utf-8").splitlines())
        assert any(row["armed"] for row in rows) is (number == 1)
        assert rows[0]["east_m"] == pytest.approx(10.0 * number, abs=0.01)


def test_with_a_port_step_each_vehicle_has_its_own_ports(start: Start) -> None:
    with ExitStack() as stack:
        for _ in range(100):  # until there are two free ports in a row
            one = stack.enter_context(udp_client())
            with suppress(OSError):
                two = stack.enter_context(udp_client(one.port + 1))
                break
        start("--count", 2, "--port-step", 1, "--connect", one.endpoint)
        for client, system in ((one, 1), (two, 2)):
            beats = [client.wait_for(lambda m: m.get_type() == "HEARTBEAT") for _ in range(3)]
            assert {beat.get_srcSystem() for beat in beats} == {system}


def test_clients_on_shared_links_hear_each_other_once_through_the_vehicles(
    start: Start, companion: Client
) -> None:
    process = start(
        *("--count", 2, "--connect", companion.endpoint, "--connect", "tcpin:127.0.0.1:0")
    )
    assert process.stdout is not None
    port = int(process.stdout.readline().split("tcpin:127.0.0.1:")[1].split(",")[0])
    with tcp_client(port, (255, 190)) as ground:
        companion.begin()
        ground.send(ground.frame(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
        assert companion.wait_for(lambda m: m.get_srcSystem() == 255).type == 6
        ground.send(ground.command(42, 1, 2, 3, 4, 5, 6, 7, target=(1, 195)))
        got = companion.wait_for(lambda m: m.get_type() == "COMMAND_LONG")
        assert (got.command, got.param7, got.get_srcComponent()) == (42, 7.0, 190)
        companion.send(companion.heartbeat(5))  # a status that nobody else here has
        heard, until_s = 0, time.monotonic() + 10.0
        while time.monotonic() < until_s:
            found = sum(getattr(m, "system_status", 0) == 5 for m in ground.messages())
            if found and not heard:
                until_s = time.monotonic() + 1.5  # the vehicles' next heartbeats come after it
            heard += found
    assert heard == 1
    process.terminate()
    assert process.result()[::2] == (0, "")


def test_strict_ends_the_run_at_what_the_real_one_does_not_survive(
    start: Start, companion: Client
) -> None:
    how = "--vehicle", "plane", "--lockstep", "--strict"
    process = start("--connect", companion.endpoint, *how)
    nowhere = mavlink.MAVLink_command_int_message(
        *(1, 1, 3, 192, 0, 0), *(-1, 1, 0, 0), *(474_000_000, 85_000_000, float("nan"))
    )
    companion.begin(companion.frame(nowhere))
    companion.tick()
    code, _, err = process.result()
    assert (code, err.count("\n")) == (1, 1)
    assert err.startswith("error: SIM:")


@pytest.mark.parametrize("count", [1, 2])
def test_half_a_frame_of_a_client_that_has_gone_swallows_nothing_of_the_next(
    serve: Serve, world_table: Table, count: int
) -> None:
    """Of one vehicle and of a link that two share."""
    run = serve("tcpin:127.0.0.1:0", *numbered(world_table, count))
    for half in (b"\xfd\xff\0\0\0\1\1", b""):
        with tcp_client(run.port) as client:
            client.send(client.command(42, target=(count, 1)))
            assert client.wait_for(lambda m: m.get_type() == "COMMAND_ACK").get_srcSystem() == count
            client.send(half)
