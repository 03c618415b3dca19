"""Lockstep and real time over real UDP sockets, with the server in this process."""

import json
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.errors import InputError
from vehicle_sim.links import Endpoint, open_link
from vehicle_sim.server import Server, Settings, Station, Stop
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import parse_world

Serve = Callable[..., Any]


def test_lockstep_stands_at_0_until_a_heartbeat_then_advances_tick_by_tick(
    serve: Serve, companion: Any
) -> None:
    with serve(companion.port, lockstep=True) as run:
        first, second = companion.messages(), companion.messages()
        assert {m.get_type() for m in first + second} == {"HEARTBEAT"}
        assert {m.get_srcComponent() for m in first} == {1, 100}
        assert run.simulation.now_us == 0
        companion.send(companion.heartbeat())
        times = [companion.tick(companion.command(511, 33, 100_000))[-1].ts1]
        for _ in range(29):
            got = [m for m in companion.tick() if m.get_type() != "HEARTBEAT"]
            times.append(got[-1].ts1)
        assert times == [100_000_000 * k for k in range(1, 31)]
        assert [m.get_type() for m in got] == ["GLOBAL_POSITION_INT", "TIMESYNC"]


def test_lockstep_waits_for_the_right_answer(serve: Serve, companion: Any) -> None:
    with serve(companion.port, lockstep=True) as run:
        companion.datagram()
        companion.send(companion.heartbeat())
        companion.wait_for("TIMESYNC")
        wrong = mavlink.MAVLink_timesync_message(5, 5)
        companion.send(companion.frame(wrong), b"\xfd garbage \xfd\xff\x00")
        companion.socket.settimeout(0.3)
        with pytest.raises(TimeoutError):
            companion.datagram()
        assert run.simulation.now_us == 100_000
        right = mavlink.MAVLink_timesync_message(100_000_000, 100_000_000)
        companion.send(companion.frame(right))
        assert companion.wait_for("TIMESYNC").ts1 == 200_000_000


def test_a_companion_that_has_ended_ends_the_run(serve: Serve, companion: Any) -> None:
    with serve(companion.port, lockstep=True) as run:
        companion.datagram()
        companion.send(companion.heartbeat())
        companion.tick()
        companion.send(companion.heartbeat(7))
        assert run.ended()
        assert run.error is None
        rows = run.truth.getvalue().splitlines()
        assert json.loads(rows[-1])["t_s"] == pytest.approx(run.simulation.now_us * 1e-6)


def test_silence_in_lockstep_is_an_error_that_says_when(serve: Serve, companion: Any) -> None:
    with serve(companion.port, lockstep=True, silence_s=0.3) as run:
        companion.datagram()
        companion.send(companion.heartbeat())
        companion.tick()
        companion.tick()
        assert run.ended()
        assert "at 0.3 s vehicle time" in str(run.error)


def test_no_companion_at_all_is_an_error_too(serve: Serve, companion: Any) -> None:
    with serve(companion.port, lockstep=True, first_heartbeat_s=0.3) as run:
        assert run.ended()
        assert "no heartbeat" in str(run.error)


def test_lockstep_lasts_as_long_as_was_asked(serve: Serve, companion: Any) -> None:
    with serve(companion.port, lockstep=True, duration_s=1.0) as run:
        companion.datagram()
        companion.send(companion.heartbeat())
        for _ in range(10):
            companion.tick()
        assert run.ended()
        assert run.simulation.now_us == 1_000_000


def test_who_asks_at_the_first_heartbeat_gets_it_in_lockstep_too(
    serve: Serve, companion: Any
) -> None:
    ask = mavlink.MAVLink_command_long_message(1, 1, 511, 0, 30, 1e5, 0, 0, 0, 0, 0)
    with serve(companion.port, lockstep=True, duration_s=1.0) as run:
        companion.datagram()
        companion.send(companion.heartbeat(), companion.frame(ask))
        got = [m.get_type() for _ in range(10) for m in companion.tick()]
        assert run.ended()
        assert got.count("ATTITUDE") == 10


def test_positions_that_are_asked_for_once_an_hour_do_not_make_it_last(
    serve: Serve, companion: Any
) -> None:
    hourly = mavlink.MAVLink_command_long_message(1, 1, 511, 0, 33, 2e9, 0, 0, 0, 0, 0)
    with serve(companion.port, lockstep=True, duration_s=3.0) as run:
        companion.datagram()
        companion.send(companion.heartbeat())
        companion.tick()
        companion.tick(companion.frame(hourly))
        assert run.ended()
        assert run.simulation.now_us == 3_000_000


@pytest.mark.parametrize("speedup", [1.0, 20.0])
def test_real_time_keeps_the_pace_whatever_the_companion_does(
    serve: Serve, companion: Any, speedup: float
) -> None:
    with serve(companion.port, speedup=speedup) as run:
        companion.datagram()  # heard once, never answered
        start_s, start_us = time.monotonic(), run.simulation.now_us
        assert not run.ended(0.6)
        flown_s = (run.simulation.now_us - start_us) * 1e-6
        share = flown_s / ((time.monotonic() - start_s) * speedup)
        assert 0.5 < share < 1.1  # a busy computer may let time slip, but never gains any


def test_real_time_does_not_need_anybody_and_finds_who_comes_later(
    serve: Serve, companion: Any
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with serve(port, speedup=10.0) as run:  # nobody listens there: every datagram is refused
        deadline_s = time.monotonic() + 5.0
        while run.simulation.now_us < 3_000_000 and time.monotonic() < deadline_s:
            assert not run.ended(0.01)
        assert run.simulation.now_us >= 3_000_000
        companion.socket.close()
        companion.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        companion.socket.settimeout(10.0)
        companion.socket.bind(("127.0.0.1", port))
        companion.wait_for("HEARTBEAT")
        companion.send(companion.heartbeat(), companion.command(511, 33, 100_000))
        assert companion.wait_for("COMMAND_ACK").result == 0
        assert companion.wait_for("GLOBAL_POSITION_INT").time_boot_ms > 3000


def test_a_scan_of_56_blocks_comes_whole_in_few_datagrams(serve: Serve, companion: Any) -> None:
    with serve(companion.port, lockstep=True):
        companion.datagram()
        request = mavlink.MAVLink_terrain_request_message(470000000, 80000000, 100, (1 << 56) - 1)
        companion.send(companion.heartbeat(), companion.frame(request))
        sizes, got = [], []
        while not got or got[-1].get_type() != "TIMESYNC":
            data = companion.datagram()
            sizes.append(len(data))
            got += companion.parser.parse_buffer(data) or []
        assert max(sizes) <= 1400
        assert len(sizes) <= 4
        blocks = [m.gridbit for m in got if m.get_type() == "TERRAIN_DATA"]
        assert blocks == list(range(56))


def test_a_host_that_cannot_be_found_is_named() -> None:
    with pytest.raises(InputError, match=r"--connect = 'udpout:no\.such\.host\.invalid:9'"):
        open_link(Endpoint(kind="udpout", host="no.such.host.invalid", port=9))


def test_what_one_client_of_a_shared_link_began_to_say_the_next_does_not_finish(
    world_table: dict[str, Any],
) -> None:
    vehicle = world_table["vehicle"]
    tables = [world_table | {"vehicle": vehicle | {"system_id": system}} for system in (1, 2)]
    link = open_link(Endpoint(kind="tcpin", host="127.0.0.1", port=0))
    stations = [Station(simulation=Simulation(parse_world(t)), links=[link]) for t in tables]
    stop = Stop()
    server = Server(stations, Settings(), stop, say=lambda _: None)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    try:
        for half in (b"\xfd\xff\0\0\0\1\1", b""):
            with socket.create_connection(("127.0.0.1", link.endpoint.port), 10.0) as client:
                mav, parser = mavlink.MAVLink(None, 9, 9), mavlink.MAVLink(None)
                asked = mavlink.MAVLink_command_long_message(2, 1, 42, 0, *[0] * 7)
                client.sendall(asked.pack(mav))
                got: list[str] = []
                while "COMMAND_ACK" not in got:
                    assert got.count("HEARTBEAT") < 6
                    got += [m.get_type() for m in parser.parse_buffer(client.recv(9999)) or []]
                client.sendall(half)
    finally:
        stop()
        thread.join(10.0)
        link.close()
