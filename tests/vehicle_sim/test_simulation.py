"""The vehicle without its socket: who ends a run, its truth, reboots, and what has warmed up.

And vehicle_sim.testing as its users see it: the pasted example, the clock, and words of failure.
"""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clients import ROOT, Client, is_question
from harness import NAN, PLACE, Rig, command_long, heartbeat, setpoint
from pymavlink.dialects.v20 import all as mavlink
from wires import Speaker

from vehicle_sim import testing

DOWN_S = 1.1
"""The autopilot reboots for so long."""
RADAR = {"component_id": 100, "range_m": 5000.0}


def test_only_the_companion_that_was_heard_first_ends_the_run() -> None:
    vehicle = Rig("ideal")
    vehicle.send(heartbeat())
    for source, ended in (((255, 190), False), (vehicle.source, True)):
        vehicle.send(heartbeat(mavlink.MAV_TYPE_GCS, 7), source=source)
        assert vehicle.simulation.companion_ended is ended


def test_the_truth_is_a_header_and_ten_lines_a_second() -> None:
    vehicle = Rig("ideal", seed=3).climb(10.0)
    header, *rows = map(json.loads, vehicle.run(60.0 - vehicle.now_s).simulation.take_truth())
    assert (header["world"], header["seed"], header["schema"]) == ("flat", 3, 1)
    assert [row["t_s"] for row in rows] == pytest.approx(np.arange(601) / 10)
    assert set(rows[0]) == {
        *("t_s", "north_m", "east_m", "altitude_amsl_m", "lat_deg", "lon_deg"),
        *("velocity_north_m_s", "velocity_east_m_s", "velocity_up_m_s"),
        *("mode", "armed", "landed"),
    }
    assert (rows[0]["mode"], rows[0]["armed"], rows[0]["landed"]) == ("STABILIZE", False, True)
    assert (rows[-1]["mode"], rows[-1]["armed"], rows[-1]["landed"]) == ("GUIDED", True, False)
    assert rows[-1].keys() - rows[0].keys() == {"believed"}
    assert rows[0]["altitude_amsl_m"] == vehicle.home[2]
    speeds = np.diff([row["altitude_amsl_m"] for row in rows]) / 0.1
    assert speeds == pytest.approx([row["velocity_up_m_s"] for row in rows[1:]], abs=0.3)


def test_a_reboot_is_the_autopilots_alone() -> None:
    """Radar and lidar have their own power, and who has no autopilot is not armed and falls."""
    lidar = {"range_m": 20.0, "rate_hz": 5.0, "component_id": 196}
    flown = Rig("px4", scanner=RADAR, lidar=lidar).climb(4.0)
    flown.truth()
    flown.fault("reboot")
    flown.run(0.1).heard.clear()
    south_west = (round(1e7 * at) for at in flown.home[:2])
    flown.send(mavlink.MAVLink_terrain_request_message(*south_west, 100, 1))
    flown.run(0.9)
    assert (flown.simulation.armed, flown.simulation.armable) == (False, False)
    assert {heard.source[1] for heard in flown.heard} == {100, 196}
    assert 3 <= len(flown.all("OBSTACLE_DISTANCE")) <= 5
    assert {"TERRAIN_DATA", "TERRAIN_REPORT", "HEARTBEAT"} <= {each.kind for each in flown.heard}
    rows = flown.run(0.2).truth()
    landed = [row["landed"] for row in rows]
    assert not any(row["armed"] or "believed" in row for row in rows)
    assert landed == sorted(landed)
    assert landed[-1]
    assert "crash" in rows[-1]  # 4 m deep: 8.9 m/s


@pytest.mark.parametrize(("autopilot", "first_s"), [("ardupilot", 0.9), ("px4", 1.6)])
@pytest.mark.parametrize("kind", ["copter", "plane"])
def test_what_is_asked_at_the_first_beat_comes(kind: Any, autopilot: str, first_s: float) -> None:
    """At once, as most scripts do: after the start, after a reboot (ardupilot.md 1, px4.md 3)."""
    vehicle, began_s = Rig(autopilot, kind, scanner=RADAR), 0.0
    for _ in range(2):
        vehicle.heard.clear()
        vehicle.until(lambda: any(h.source[1] == 1 for h in vehicle.all("HEARTBEAT")), 3.0)
        assert vehicle.all("HEARTBEAT")[-1].at_s == pytest.approx(began_s + first_s, abs=0.011)
        assert vehicle.command(511, 30, 50_000) == 0
        assert len(vehicle.run(1.0).all("ATTITUDE")) >= 19
        vehicle.fault("reboot")
        began_s = vehicle.run(0.01).now_s + DOWN_S
        vehicle.run(DOWN_S)


_WARMED_UP = """
from pathlib import Path
from numba.core.event import install_recorder
from pymavlink.dialects.v20 import all as mavlink
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world

station = mavlink.MAVLink(None)
for name in ("street", "valley"):
    vehicle = Simulation(read_world(Path("companion/environments", name, "world.toml")))
    place = (round(1e7 * x) for x in (vehicle.vehicle.latitude_deg, vehicle.vehicle.longitude_deg))
    asked = station.terrain_request_encode(*place, 100, (1 << 56) - 1).pack(station)
    vehicle.warm_up()
    with install_recorder("numba:compile") as compiled:
        vehicle.receive(0, asked)
        for _ in range(120):
            vehicle.step()
    told = sum(frame[7:10] == b"\\x86\\0\\0" for _, frame in vehicle.take_frames())
    print(name, told, len(compiled.buffer))
"""


def test_what_has_warmed_up_compiles_nothing_even_with_no_place_to_write(tmp_path: Path) -> None:
    """Silent for the seconds that it takes, a vehicle is given up: a first flight failed so."""
    nowhere = tmp_path / "no folder"
    nowhere.touch()
    cold = {**os.environ, "NUMBA_CACHE_DIR": str(nowhere)}
    asked = (sys.executable, "-c", _WARMED_UP)
    said = subprocess.run(asked, check=True, capture_output=True, text=True, env=cold, cwd=ROOT)
    assert said.stdout.split() == ["street", "0", "0", "valley", "56", "0"]


# --- for users' tests -----------------------------------------------------------------------------

Start = Callable[..., testing.Simulator]
vehicle_sim = testing.vehicle_sim


def send(sim: testing.Simulator, *messages: Any) -> None:
    """By a companion, in a datagram."""
    sim.simulation.receive(0, b"".join(map(Speaker(srcComponent=191).frame, messages)))


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


def test_time_goes_on_as_asked_and_assertions_say_when_and_by_how_much(vehicle_sim: Start) -> None:
    sim, calls = vehicle_sim(), list[float]()
    with pytest.raises(AssertionError, match="no HEARTBEAT came in"):
        sim.assert_stream_gap(1.0, message="HEARTBEAT")
    sim.advance(1.0, meanwhile=lambda: calls.append(sim.now_s))
    assert calls == pytest.approx([0.05 + 0.05 * k for k in range(20)])
    for pause_s in (0.5, 0.5, 2.0, 0.5):
        send(sim, heartbeat())
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
    vehicle_sim: Start, companion: Client, monkeypatch: pytest.MonkeyPatch
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
def test_what_real_ones_do_not_survive_fails_if_strict(vehicle_sim: Start, strict: bool) -> None:
    sim = vehicle_sim(ready=True, strict=strict)
    send(sim, command_long(176, 1, 4), setpoint((NAN, 0.0, -20.0)))
    with pytest.raises(AssertionError, match="SIM:") if strict else nullcontext():
        sim.advance(1.0)


def test_a_crash_is_seen_however_short_faults_and_parameters_are_set(vehicle_sim: Start) -> None:
    sim = vehicle_sim(ready=True)
    sim.set_parameter("GUID_TIMEOUT", 1.5)
    with pytest.raises(KeyError):
        sim.set_parameter("GUID_TIMEOUTS", 1.5)
    orders = (176, 1, 4), (400, 1), (22, 0, 0, 0, 0, 0, 0, 30)
    send(sim, *(command_long(*order) for order in orders))
    sim.advance_until(lambda: sim.moment.above_ground_m > 25.0, within_s=30.0)
    sim.assert_not_crashed()
    sim.fault("reboot")  # in the air: it falls
    sim.advance(10.0)
    where = r"0 m north, 0 m east, 488 m AMSL.* hit the ground at 2\d\.\d m/s"
    with pytest.raises(AssertionError, match=where):
        sim.assert_not_crashed()
