"""vehicle_sim.testing as its users see it: the pasted example, the clock, and words of failure."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

import pytest
from clients import ROOT, Client, is_question
from harness import NAN, PLACE, setpoint
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.testing import Simulator, vehicle_sim  # noqa: F401

Start = Callable[..., Simulator]


def send(sim: Simulator, *messages: Any) -> None:
    """By a companion, in a datagram."""
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    sim.simulation.receive(0, b"".join(message.pack(mav) for message in messages))


def command(number: int, p1: float, p2: float = 0.0, p7: float = 0.0) -> Any:
    return mavlink.MAVLink_command_long_message(1, 1, number, 0, p1, p2, 0, 0, 0, 0, p7)


def test_the_example_of_the_page_passes_when_it_is_pasted(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "simulator.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (tmp_path / "conftest.py").write_text('pytest_plugins = ["vehicle_sim.testing"]\n', "utf-8")
    (tmp_path / "test_mine.py").write_text(example, "utf-8")
    pasted = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path)]
    alone = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}  # to load them takes a second
    run = subprocess.run(pasted, cwd=tmp_path, capture_output=True, text=True, env=alone)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "1 passed" in run.stdout


def test_time_goes_on_by_as_much_as_is_asked_and_assertions_say_when_and_by_how_much(
    vehicle_sim: Start,  # noqa: F811
) -> None:
    sim, calls = vehicle_sim(), list[float]()
    with pytest.raises(AssertionError, match="no HEARTBEAT came in"):
        sim.assert_stream_gap(1.0, message="HEARTBEAT")
    sim.advance(1.0, meanwhile=lambda: calls.append(sim.now_s))
    assert calls == pytest.approx([0.05 + 0.05 * k for k in range(20)])
    for pause_s in (0.5, 0.5, 2.0, 0.5):
        send(sim, mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
        sim.advance(pause_s)
    sim.assert_stream_gap(2.0, message="HEARTBEAT")
    with pytest.raises(AssertionError, match=r"2\.00 s without HEARTBEAT from 2\.00 s on"):
        sim.assert_stream_gap(1.9, message="HEARTBEAT")
    there = (PLACE[0] + 100.0 / 111_200.0, PLACE[1])
    sim.assert_never_inside(*there, 99.0)
    with pytest.raises(AssertionError, match=r"inside at 0\.0 s: (100|99)\.. m from the middle"):
        sim.assert_never_inside(*there, 101.0)
    sim.assert_arrived(*there, within_m=101.0, within_s=3.0)
    with pytest.raises(AssertionError, match=r"not nearer than (100|99)\.. m by 3 s"):
        sim.assert_arrived(*there, within_m=50.0, within_s=3.0)
    with pytest.raises(AssertionError, match=r"within 2 s; at 6\.5 s: .* on the ground"):
        sim.advance_until(lambda: sim.armed, within_s=2.0)


def test_in_lockstep_every_tick_waits_for_the_clients_answer_and_not_for_ever(
    vehicle_sim: Start,  # noqa: F811
    companion: Client,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sim, asked = vehicle_sim(lockstep=True), list[int]()
    companion.link.setblocking(False)
    companion.address = ("127.0.0.1", sim.port)
    companion.send(companion.heartbeat())

    def answer() -> None:
        with suppress(BlockingIOError):
            for message in filter(is_question, companion.messages()):
                asked.append(message.ts1)
                companion.send(companion.answer(message))

    sim.advance(3.0, meanwhile=answer)
    ticks = [each for each in asked if each % 50_000_000 == 0]
    assert sorted(set(ticks)) == [50_000_000 * k for k in range(2, 61)]  # heard in the first
    monkeypatch.setattr("vehicle_sim.testing._PATIENCE_S", 0.3)
    with pytest.raises(AssertionError, match=r"no answer to TIMESYNC within 0 s, at 3\.\d s"):
        sim.advance(1.0)


@pytest.mark.parametrize("strict", [True, False])
def test_what_the_real_one_does_not_survive_fails_the_test_unless_it_is_not_to(
    vehicle_sim: Start,  # noqa: F811
    strict: bool,
) -> None:
    sim = vehicle_sim(ready=True, strict=strict)
    send(sim, command(176, 1, 4), setpoint((NAN, 0.0, -20.0)))
    with pytest.raises(AssertionError, match="SIM:") if strict else nullcontext():
        sim.advance(1.0)


def test_a_crash_is_seen_however_short_it_is_and_faults_and_parameters_can_be_set(
    vehicle_sim: Start,  # noqa: F811
) -> None:
    sim = vehicle_sim(ready=True)
    sim.set_parameter("GUID_TIMEOUT", 1.5)
    with pytest.raises(KeyError):
        sim.set_parameter("GUID_TIMEOUTS", 1.5)
    send(sim, command(176, 1, 4), command(400, 1), command(22, 0, p7=30))
    sim.advance_until(lambda: sim.moment.above_ground_m > 25.0, within_s=30.0)
    sim.assert_not_crashed()
    sim.fault("reboot")  # in the air: it falls
    sim.advance(10.0)
    where = r"0 m north, 0 m east, 488 m AMSL.* hit the ground at 2\d\.\d m/s"
    with pytest.raises(AssertionError, match=where):
        sim.assert_not_crashed()
