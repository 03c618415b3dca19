"""Lockstep and real time over real sockets, with the server in this process."""

import json
import socket
import time
from collections.abc import Callable, Sequence
from typing import Any

import pytest
from clients import Client, Running, is_question, tcp_client, udp_client
from pymavlink.dialects.v20 import all as mavlink

Serve = Callable[..., Running]
Table = dict[str, Any]


def with_system(table: Table, system: int) -> Table:
    return table | {"vehicle": table["vehicle"] | {"system_id": system}}


def begun(
    serve: Serve, companion: Client, *frames: bytes, tables: Sequence[Table] = (), **settings: Any
) -> Running:
    """A lockstep whose companion has been heard."""
    run = serve(companion.endpoint, *tables, lockstep=True, **settings)
    companion.datagram()
    companion.send(companion.heartbeat(), *frames)
    return run


# --- lockstep -------------------------------------------------------------------------------------


def test_lockstep_stands_at_0_until_a_heartbeat_then_advances_tick_by_tick(
    serve: Serve, companion: Client
) -> None:
    run = serve(companion.endpoint, lockstep=True)
    hello = [*companion.messages(), *companion.messages()]
    assert {m.get_type() for m in hello} == {"HEARTBEAT"}
    assert {m.get_srcComponent() for m in hello} == {1, 100}
    assert run.simulation.now_us == 0
    companion.send(companion.heartbeat(), companion.command(511, 30, 100_000))  # heard at once
    times = [companion.tick(companion.command(511, 33, 100_000))[-1].ts1]
    for _ in range(29):
        got = [m for m in companion.tick() if m.get_type() != "HEARTBEAT"]
        times.append(got[-1].ts1)
    assert times == [100_000_000 * k for k in range(1, 31)]
    assert [m.get_type() for m in got] == ["ATTITUDE", "GLOBAL_POSITION_INT", "TIMESYNC"]


def test_lockstep_waits_for_the_right_answer(serve: Serve, companion: Client) -> None:
    run = begun(serve, companion)
    question = companion.wait_for(is_question)
    wrong = companion.frame(mavlink.MAVLink_timesync_message(5, 5))
    companion.send(wrong, b"\xfd garbage \xfd\xff\x00")
    companion.link.settimeout(0.3)
    with pytest.raises(TimeoutError):
        companion.datagram()
    assert run.simulation.now_us == 100_000
    companion.send(companion.answer(question))
    assert companion.wait_for(is_question).ts1 == 200_000_000


def test_a_companion_that_has_ended_ends_the_run(serve: Serve, companion: Client) -> None:
    run = begun(serve, companion)
    companion.tick()
    companion.wait_for(is_question)  # and it is not answered any more
    companion.send(companion.heartbeat(7))
    assert run.ended()
    assert run.error is None
    last = json.loads(run.truth.getvalue().splitlines()[-1])
    assert last["t_s"] == pytest.approx(run.simulation.now_us * 1e-6)


def test_silence_in_lockstep_is_an_error_that_says_when(serve: Serve, companion: Client) -> None:
    run = begun(serve, companion, silence_s=0.3)
    companion.tick()
    companion.tick()
    assert run.ended()
    assert "at 0.3 s vehicle time" in str(run.error)


def test_no_companion_at_all_is_an_error_too(serve: Serve, companion: Client) -> None:
    run = serve(companion.endpoint, lockstep=True, first_heartbeat_s=0.3)
    assert run.ended()
    assert "no heartbeat" in str(run.error)


def test_who_answers_with_a_time_of_its_own_is_told_so(serve: Serve, companion: Client) -> None:
    run = begun(serve, companion, silence_s=0.5)
    question = companion.wait_for(is_question)
    own = mavlink.MAVLink_timesync_message(time.time_ns(), question.ts1)
    companion.send(companion.frame(own))
    assert run.ended()
    assert "tc1 must echo ts1" in str(run.error)


@pytest.mark.parametrize("every_us", [100_000, 2e9])
def test_lockstep_lasts_as_long_as_was_asked(
    serve: Serve, companion: Client, every_us: float
) -> None:
    """Also if positions, which end its ticks, are asked for once an hour only."""
    run = begun(serve, companion, duration_s=1.0)
    companion.tick(companion.command(511, 33, every_us))
    for _ in range(9 if every_us < 1e6 else 0):
        companion.tick()
    assert run.ended()
    assert run.simulation.now_us == 1_000_000


def test_vehicles_on_one_link_ask_different_questions_and_wait_for_all(
    serve: Serve, world_table: Table, companion: Client
) -> None:
    tables = [with_system(world_table, system) for system in (1, 2, 3)]
    begun(serve, companion, tables=tables)
    asked = list[tuple[int, int]]()
    while len(asked) < 15:
        for message in companion.messages():
            if message.get_type() == "TIMESYNC" and message.tc1 == 0 and message.ts1:
                asked.append((message.ts1, message.get_srcSystem()))
                companion.send(companion.answer(message))
    assert len({question for question, _ in asked}) == len(asked)
    assert [system for _, system in asked[:6]] == [1, 2, 3, 1, 2, 3]


def test_each_of_several_vehicles_flies_its_own_time(serve: Serve, world_table: Table) -> None:
    """The clock of the one whose companion ends first stands, and the other's goes on."""
    with udp_client() as first, udp_client((2, 195)) as second:
        tables = [with_system(world_table, system) for system in (1, 2)]
        both = f"{first.endpoint} {second.endpoint}"
        run = serve(both, *tables, lockstep=True, duration_s=3.0)
        for client in (first, second):
            client.datagram()
            client.send(client.heartbeat())
        last_ns = 0
        while last_ns < 3_000_000_000:
            if run.simulations[0].now_us < 1_000_000:
                first.tick()
            elif not run.simulations[0].companion_ended:
                first.send(first.heartbeat(7))
            for message in second.messages():
                if message.get_type() == "TIMESYNC" and message.tc1 == 0 and message.ts1:
                    last_ns = message.ts1
                    second.send(second.answer(message))
        assert run.ended()
    assert run.simulations[0].now_us <= 1_100_000
    assert run.simulations[1].now_us == 3_000_000


def test_a_scan_of_56_blocks_comes_whole_in_few_datagrams(serve: Serve, companion: Client) -> None:
    request = mavlink.MAVLink_terrain_request_message(470000000, 80000000, 100, (1 << 56) - 1)
    begun(serve, companion, companion.frame(request))
    sizes, got = [], []
    while not (got and is_question(got[-1])):
        data = companion.datagram()
        sizes.append(len(data))
        got += companion.parser.parse_buffer(data) or []
    assert max(sizes) <= 1400
    assert len(sizes) <= 4
    assert [m.gridbit for m in got if m.get_type() == "TERRAIN_DATA"] == list(range(56))


# --- real time ------------------------------------------------------------------------------------


@pytest.mark.parametrize("speedup", [1.0, 20.0])
def test_real_time_keeps_the_pace_whatever_the_companion_does(
    serve: Serve, companion: Client, speedup: float
) -> None:
    run = serve(companion.endpoint, speedup=speedup)
    companion.datagram()  # heard once, never answered
    start_s, start_us = time.monotonic(), run.simulation.now_us
    assert not run.ended(0.6)
    flown_s = (run.simulation.now_us - start_us) * 1e-6
    share = flown_s / ((time.monotonic() - start_s) * speedup)
    assert 0.5 < share < 1.1  # a busy computer may let time slip, but never gains any


def test_real_time_does_not_need_anybody_and_finds_who_comes_later(serve: Serve) -> None:
    with udp_client() as probe:
        port = probe.port
    run = serve(f"udpout:127.0.0.1:{port}", speedup=10.0)  # every datagram is refused
    deadline_s = time.monotonic() + 5.0
    while run.simulation.now_us < 3_000_000 and time.monotonic() < deadline_s:
        assert not run.ended(0.01)
    assert run.simulation.now_us >= 3_000_000
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", port))
        client = Client(link)
        client.wait_for("HEARTBEAT")
        client.send(client.heartbeat(), client.command(511, 33, 100_000))
        assert client.wait_for("COMMAND_ACK").result == 0
        assert client.wait_for("GLOBAL_POSITION_INT").time_boot_ms > 3000


@pytest.mark.parametrize("count", [1, 2])
def test_half_a_frame_of_a_client_that_has_gone_swallows_nothing_of_the_next(
    serve: Serve, world_table: Table, count: int
) -> None:
    """Of one vehicle and of a link that two share."""
    tables = [with_system(world_table, system) for system in range(1, count + 1)]
    run = serve("tcpin:127.0.0.1:0", *tables)
    for half in (b"\xfd\xff\0\0\0\1\1", b""):
        with tcp_client(run.ports[0], (9, 9)) as client:
            asked = mavlink.MAVLink_command_long_message(count, 1, 42, 0, *[0] * 7)
            client.send(client.frame(asked))
            assert client.wait_for("COMMAND_ACK").get_srcSystem() == count
            client.send(half)
