"""Lockstep and real time over real sockets, endpoints, and several vehicles as a process."""

import hashlib
import json
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import pytest
from clients import Client, Process, Running, is_question, tcp_client, udp_client
from harness import heartbeat
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.errors import InputError
from vehicle_sim.links import Link, open_link, parse_endpoint

Serve, Start = Callable[..., Running], Callable[..., Process]


# --- lockstep -------------------------------------------------------------------------------------


def test_lockstep_waits_for_a_beat_and_each_right_answer(serve: Serve, companion: Client) -> None:
    run = serve(companion.endpoint, lockstep=True)
    hello = [*companion.messages(), *companion.messages()]
    beats = {("HEARTBEAT", 1), ("HEARTBEAT", 100)}
    assert {(m.get_type(), m.get_srcComponent()) for m in hello} == beats
    assert run.simulation.now_us == 0
    companion.send(companion.heartbeat(), companion.command(511, 30, 100_000))  # heard at once
    companion.tick(companion.command(511, 33, 100_000))
    ticks = [companion.tick() for _ in range(29)]
    assert [tick[-1].ts1 for tick in ticks] == [100_000_000 * k for k in range(2, 31)]
    said = [m.get_type() for m in ticks[-1] if m.get_type() != "HEARTBEAT"]
    assert said == ["ATTITUDE", "GLOBAL_POSITION_INT", "TIMESYNC"]
    question = companion.wait_for(is_question)
    wrong = companion.frame(mavlink.MAVLink_timesync_message(5, 5))
    companion.send(wrong, b"\xfd garbage \xfd\xff\x00")
    companion.link.settimeout(0.3)
    with pytest.raises(TimeoutError):
        companion.datagram()
    assert run.simulation.now_us == 3_100_000
    companion.send(companion.answer(question))
    assert companion.wait_for(is_question).ts1 == 3_200_000_000


def test_silence_in_lockstep_is_an_error_that_says_why(serve: Serve, companion: Client) -> None:
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


def test_each_of_several_vehicles_flies_its_own_time(serve: Serve) -> None:
    """The clock of the one whose companion ends first stands, and the other's goes on."""
    with udp_client() as first, udp_client(ids=(2, 195)) as second:
        both = f"{first.endpoint} {second.endpoint}"
        run = serve(both, count=2, lockstep=True, duration_s=3.0)
        first.begin()
        second.begin()
        for k in range(30):
            if k < 10:
                first.tick()
            elif k == 10:
                first.send(first.heartbeat(7))
            second.tick()
        assert run.ended()
    assert run.simulations[0].now_us <= 1_100_000
    assert run.simulations[1].now_us == 3_000_000


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


def test_it_goes_on_through_a_reboot_and_when_a_tcp_client_connects_again(serve: Serve) -> None:
    run = serve("tcpin:127.0.0.1:0", lockstep=True)
    with tcp_client(run.port) as first:
        first.send(first.heartbeat())
        follow(first, 2.9)
    run.simulation.add_fault("reboot")
    with tcp_client(run.port) as second:
        follow(second, 3.5, newest_ns=2_900_000_000)
        # the question counts from the boot, as all stamps do
        assert second.wait_for(is_question).ts1 < 5e9
        second.send(second.heartbeat(7))
        assert run.ended()
    assert run.error is None


BAD = "link_duplication 30 %", "link_loss 20 %", "link_delay 50 ms jitter 30 ms"


@pytest.mark.sample(2)
@pytest.mark.parametrize("bad", [BAD, ("link_off",)])
def test_bad_links_neither_stop_it_nor_make_it_random(serve: Serve, bad: tuple[str, ...]) -> None:
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


def test_real_time_keeps_pace_whatever_the_companion_does(serve: Serve, companion: Client) -> None:
    run = serve(companion.endpoint, speedup=20.0)
    companion.datagram()  # heard once, never answered
    start_s, start_us = time.monotonic(), run.simulation.now_us
    assert not run.ended(0.6)
    flown_s, passed_s = (run.simulation.now_us - start_us) * 1e-6, time.monotonic() - start_s
    assert 10.0 < flown_s / passed_s < 22.0  # a busy computer may let time slip, but gains none


# --- as a process: several vehicles, several links ------------------------------------------------


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
    start: Start, companion: Client, tmp_path: Path
) -> None:
    how = ("--count", 2, "--connect", companion.endpoint, "--connect", "tcpin:127.0.0.1:0")
    process = start(*how, "--out", tmp_path)
    assert process.stdout is not None
    port = int(process.stdout.readline().split("tcpin:127.0.0.1:")[1].split(",")[0])
    with tcp_client(port, (255, 190)) as ground:
        companion.begin()
        ground.send(ground.frame(heartbeat(mavlink.MAV_TYPE_GCS)))
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
    for number, name in enumerate(("truth.jsonl", "truth-2.jsonl")):
        _, first, *_ = map(json.loads, (tmp_path / name).read_text("utf-8").splitlines())
        assert first["east_m"] == pytest.approx(10.0 * number, abs=0.01)


def test_strict_ends_at_what_the_real_one_does_not_survive(start: Start, companion: Client) -> None:
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


# --- endpoints ------------------------------------------------------------------------------------


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


def test_udpin_finds_a_port_and_answers_everybody_who_was_heard() -> None:
    with closing(open_link(parse_endpoint("udpin://127.0.0.1:0"))) as link:
        assert link.endpoint.port > 0
        with pytest.raises(InputError, match=str(link.endpoint)):  # it is in use
            open_link(link.endpoint)
        link.send([b"nobody hears this"])
        with udp_client() as one, udp_client() as two:
            for client, words in ((one.link, b"one"), (two.link, b"two")):
                client.sendto(words, ("127.0.0.1", link.endpoint.port))
                assert received(link) == words
            link.send([b"for ", b"both"])
            assert one.datagram() == two.datagram() == b"for both"


def test_what_is_sent_after_a_refusal_is_not_lost_with_it() -> None:
    with udp_client() as probe:
        link = open_link(parse_endpoint(probe.endpoint))
    with closing(link), udp_client(probe.port) as client:
        link.send([b"now"])
        assert client.datagram() == b"now"


def test_tcp_clients_come_one_after_the_other_and_who_does_not_read_loses_whole_frames() -> None:
    frame, got = bytes(range(200)) * 5, bytearray()
    with closing(open_link(parse_endpoint("tcpin:127.0.0.1:0"))) as link:
        for words in (b"first", b"second"):
            with tcp_client(link.endpoint.port) as client:
                client.send(words)
                assert received(link) == words
                link.send([words, b"!"])
                assert client.datagram() == words + b"!"
                for _ in range(20_000):
                    link.send([frame])
                assert len(link._pending) < 1_000_000  # type: ignore[attr-defined]
                while len(got) < 1_000_000:
                    got += client.datagram()
                assert bytes(got[:1_000_000]) == frame * 1000
            while link.receive() is not None:
                pass
        link.send([b"nobody is there"])


@pytest.mark.parametrize("count", [1, 2])
def test_half_a_frame_of_one_client_swallows_nothing_of_the_next(serve: Serve, count: int) -> None:
    """Of one vehicle and of a link that two share."""
    run = serve("tcpin:127.0.0.1:0", count)
    for half in (b"\xfd\xff\0\0\0\1\1", b""):
        with tcp_client(run.port) as client:
            client.send(client.command(42, target=(count, 1)))
            assert client.wait_for(lambda m: m.get_type() == "COMMAND_ACK").get_srcSystem() == count
            client.send(half)
