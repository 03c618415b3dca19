"""vehicle_sim.testing as its users see it: the pasted example, the clock, and words of failure."""

import os
import re
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from clients import Client, is_question
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.testing import Simulator, vehicle_sim  # noqa: F401

ROOT = Path(__file__).parents[2]
Start = Callable[..., Simulator]
HOME = (47.397742, 8.545594)


def said(mav: Any, *messages: Any) -> bytes:
    return b"".join(message.pack(mav) for message in messages)


@pytest.fixture(name="sim")
def sim_fixture(vehicle_sim: Start) -> Simulator:  # noqa: F811
    return vehicle_sim()


def test_the_example_of_the_page_passes_when_it_is_pasted(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "simulator.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (tmp_path / "conftest.py").write_text('pytest_plugins = ["vehicle_sim.testing"]\n', "utf-8")
    (tmp_path / "test_mine.py").write_text(example, "utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path)]
    alone = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}  # to load them takes a second
    run = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, timeout=120, env=alone
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert "1 passed" in run.stdout


def test_time_stands_still_between_calls_and_goes_on_by_as_much_as_is_asked(sim: Simulator) -> None:
    assert sim.now_s == 0.0
    sim.advance(3.0)
    assert sim.now_s == pytest.approx(3.0)
    calls: list[float] = []
    sim.advance(1.0, meanwhile=lambda: calls.append(sim.now_s))
    assert calls == pytest.approx([3.05 + 0.05 * k for k in range(20)])


def test_what_never_comes_is_told_with_where_it_is(sim: Simulator) -> None:
    with pytest.raises(AssertionError, match=r"within 2 s; at 2\.0 s: .* on the ground"):
        sim.advance_until(lambda: sim.armed, within_s=2.0)


def test_the_assertions_say_when_and_by_how_much(sim: Simulator) -> None:
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    beat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    with pytest.raises(AssertionError, match="no HEARTBEAT came in"):
        sim.assert_stream_gap(1.0, message="HEARTBEAT")
    for pause_s in (0.5, 0.5, 2.0, 0.5):
        sim.simulation.receive(0, said(mav, beat))
        sim.advance(pause_s)
    sim.assert_stream_gap(2.0, message="HEARTBEAT")
    with pytest.raises(AssertionError, match=r"2\.00 s without HEARTBEAT from 1\.00 s on"):
        sim.assert_stream_gap(1.9, message="HEARTBEAT")
    sim.assert_stream_gap(0.5, message="HEARTBEAT", before_s=1.0)
    north_deg = HOME[0] + 100.0 / 111_200.0
    sim.assert_never_inside(north_deg, HOME[1], 99.0)
    with pytest.raises(AssertionError, match=r"inside at 0\.0 s: (100|99)\.. m from the middle"):
        sim.assert_never_inside(north_deg, HOME[1], 101.0)
    sim.assert_arrived(north_deg, HOME[1], within_m=101.0, within_s=3.0)
    with pytest.raises(AssertionError, match=r"not nearer than (100|99)\.. m by 3 s"):
        sim.assert_arrived(north_deg, HOME[1], within_m=50.0, within_s=3.0)
    sim.assert_clear_of_ground(10.0)  # it has not flown


def test_faults_and_parameters_can_be_set_on_the_way(vehicle_sim: Start) -> None:  # noqa: F811
    sim = vehicle_sim(autopilot="px4", ready=True)
    sim.fault("for 12 s: gps_off")
    for seconds, armable in ((11.0, False), (10.0, True)):
        sim.advance(seconds)
        assert sim.simulation.armable == armable
    sim.set_parameter("SIM_GPS_USED", 3)
    sim.advance(11.0)
    assert not sim.simulation.armable
    with pytest.raises(KeyError):
        sim.set_parameter("GUID_TIMEOUTS", 1.5)


def work(client: Client, asked: list[int]) -> None:
    """Read what is there, and answer the questions of lockstep."""
    with suppress(BlockingIOError):
        while True:
            for message in client.messages():
                if is_question(message):
                    asked.append(message.ts1)
                    client.send(client.answer(message))


@pytest.fixture(name="answering")
def answering_fixture(companion: Client) -> Callable[[Simulator], Client]:
    def begin(sim: Simulator) -> Client:
        companion.link.setblocking(False)
        companion.address = ("127.0.0.1", sim.port)
        companion.send(companion.heartbeat())
        return companion

    return begin


Answering = Callable[[Simulator], Client]


@pytest.mark.parametrize("own_thread", [False, True], ids=["meanwhile", "thread"])
def test_in_lockstep_every_tick_waits_for_the_clients_answer(
    vehicle_sim: Start,  # noqa: F811
    answering: Answering,
    own_thread: bool,
) -> None:
    sim, asked, ended = vehicle_sim(lockstep=True), list[int](), threading.Event()
    client = answering(sim)

    def run() -> None:
        while not ended.wait(0.001):
            work(client, asked)

    thread = threading.Thread(target=run)
    try:
        if own_thread:
            thread.start()
        sim.advance(3.0, meanwhile=None if own_thread else lambda: work(client, asked))
    finally:
        ended.set()
        if own_thread:
            thread.join()
    ticks = [each for each in asked if each % 50_000_000 == 0]
    assert sorted(set(ticks)) == [50_000_000 * k for k in range(2, 61)]  # heard in the first


def test_in_lockstep_a_client_that_does_not_answer_is_an_error(
    vehicle_sim: Start,  # noqa: F811
    answering: Answering,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("vehicle_sim.testing._PATIENCE_S", 0.3)
    sim = vehicle_sim(lockstep=True)
    sim.advance(1.0)  # nobody has come yet
    answering(sim)
    with pytest.raises(AssertionError, match=r"no answer to TIMESYNC within 0 s; at 1\.\d s"):
        sim.advance(1.0)


def test_what_the_real_one_does_not_survive_fails_the_test_unless_it_is_not_to(
    vehicle_sim: Start,  # noqa: F811
) -> None:
    wild = mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 0xDF8, float("nan"), 0, -20, *[0.0] * 8
    )
    guided = mavlink.MAVLink_command_long_message(1, 1, 176, 0, 1, 4, 0, 0, 0, 0, 0)
    for strict in (True, False):
        sim = vehicle_sim(ready=True, strict=strict)
        sim.simulation.receive(0, said(mavlink.MAVLink(None, 1, 191), guided, wild))
        if strict:
            with pytest.raises(AssertionError, match="SIM:"):
                sim.advance(1.0)
        else:
            sim.advance(1.0)


def test_a_crash_is_seen_however_short_it_is(vehicle_sim: Start) -> None:  # noqa: F811
    sim = vehicle_sim(ready=True)
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    for number, p1, p2, p7 in ((176, 1, 4, 0), (400, 1, 0, 0), (22, 0, 0, 30)):
        command = mavlink.MAVLink_command_long_message(1, 1, number, 0, p1, p2, 0, 0, 0, 0, p7)
        sim.simulation.receive(0, said(mav, command))
    sim.advance_until(lambda: sim.moment.above_ground_m > 25.0, within_s=30.0)
    sim.assert_not_crashed()
    sim.fault("reboot")  # in the air: it falls
    sim.advance(10.0)
    with pytest.raises(
        AssertionError,
        match=r"hit the ground at 2\d\.\d m/s at .* s, 0 m north, 0 m east, 488 m AMSL",
    ):
        sim.assert_not_crashed()
    with pytest.raises(AssertionError, match="hit the ground"):
        sim.assert_clear_of_ground(1.0)
