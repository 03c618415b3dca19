"""MAVProxy, driven as by a person at its prompt."""

import re
import socket
from pathlib import Path
from typing import Any

import pytest
from processes import away_m, height_m, place
from programs import BIN, Program, free_port

from vehicle_sim.autopilot.arducopter import FIRMWARE

READY_S = 60.0


def at(north_m: float, east_m: float) -> str:
    return "{:.7f} {:.7f}".format(*place(north_m, east_m))


NORTH, EAST, THERE = (60.0, 0.0), (60.0, 60.0), (20.0, -15.0)
PLANS = {
    "wp": f"""QGC WPL 110
0 1 0 16 0 0 0 0 {at(0, 0)} 488 1
1 0 3 22 0 0 0 0 0 0 25 1
2 0 3 16 0 0 0 0 {at(*NORTH)} 30 1
3 0 3 16 0 0 0 0 {at(*EAST)} 30 1
4 0 3 178 0 4 0 0 0 0 0 1
5 0 3 20 0 0 0 0 0 0 0 1
""",
    "fence": f"""QGC WPL 110
0 0 0 5001 4 0 0 0 {at(140, 140)} 0 1
1 0 0 5001 4 0 0 0 {at(-140, 140)} 0 1
2 0 0 5001 4 0 0 0 {at(-140, -140)} 0 1
3 0 0 5001 4 0 0 0 {at(140, -140)} 0 1
4 0 0 5004 20 0 0 0 {at(0, 80)} 0 1
""",
    "rally": f"""QGC WPL 110
0 0 3 5100 0 0 0 0 {at(-50, 10)} 40 1
""",
}
KINDS = {"wp": "MISSION", "fence": "FENCE", "rally": "RALLY"}


def ends(ground: Program) -> None:
    """Hang up; MAVProxy ends by itself, with 1 as always (and its threads may trip then)."""
    assert "Traceback" not in ground.transcript
    ground.hang_up()
    assert ground.wait(10.0) == 1


def loads(ground: Program, command: str, folder: Path) -> Path:
    """Write a plan, and have it sent."""
    file = folder / f"{command}.txt"
    file.write_text(PLANS[command], encoding="utf-8")
    ground.ask(f"{command} load {file}", f"Got MISSION_ACK: TYPE_{KINDS[command]}: ACCEPTED")
    return file


def items(file: Path) -> list[list[float]]:
    """The rows of a QGC WPL file, without who is current."""
    rows = [line.split() for line in file.read_text(encoding="utf-8").splitlines()[1:]]
    return [[float(value) for value in row[:1] + row[2:11]] for row in rows]


def test_a_copter_is_refused_armed_guided_and_flies_a_mission_home(
    fly: Any, mavproxy: Any, tmp_path: Path
) -> None:
    here = f"127.0.0.1:{free_port()}"
    ground = mavproxy(f"udp:{here}")
    ground.expect("Waiting for heartbeat")
    vehicle = fly("--connect", f"udpout:{here}", speedup=10)
    ground.expect("online system 1")
    ground.type("set streamrate 2")  # which makes it ask for streams now, not in 15 s
    ground.ask("mode GUIDED", "DO_SET_MODE: ACCEPTED")
    ground.ask("arm throttle", "FAILED(.|\n)*Need Position|Need Position(.|\n)*FAILED")
    loads(ground, "wp", tmp_path)
    if "is using GPS" not in ground.transcript:
        ground.expect("EKF3 IMU0 is using GPS")
    ground.ask("arm throttle", "COMPONENT_ARM_DISARM: ACCEPTED")
    ground.expect("ARMED")
    ground.ask("takeoff 10", "NAV_TAKEOFF: ACCEPTED")
    vehicle.wait_until(lambda now: height_m(now) > 9.5)
    ground.ask(f"guided {at(*THERE)} 15", "DO_REPOSITION: ACCEPTED")
    there = vehicle.wait_until(lambda now: away_m(now, *place(*THERE)) < 1.0 and height_m(now) > 14)
    assert there["mode"] == "GUIDED"
    ground.ask("mode AUTO", "AUTO> ")
    for number in (3, 5):
        ground.expect(f"waypoint {number}", 30.0)
    ground.expect("DISARMED", 40.0)
    landed = vehicle.wait_until(lambda now: now["landed"] and not now["armed"], 30.0)
    assert away_m(landed, *place(0.0, 0.0)) < 1.5
    track = vehicle.track()
    for where in (NORTH, EAST):
        assert min(away_m(row, *place(*where)) for row in track) < 3.0
    assert max(map(height_m, track)) == pytest.approx(30.0, abs=1.0)
    ends(ground)


def test_parameters_and_plans_come_back_as_they_went(
    fly: Any, mavproxy: Any, tmp_path: Path
) -> None:
    """Not much faster than real time: the vehicle waits 8 s of its own for each item."""
    here = f"127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    vehicle = fly("--connect", f"tcpin:{here}", speedup=2)
    ground = mavproxy(f"tcp:{here}")
    ground.expect("online system 1")
    ground.expect(r"Saved \d+ parameters to .*\n")
    [count] = re.findall(r"Received (\d+) parameters", ground.transcript)
    assert int(count) == len(FIRMWARE.table)
    ground.ask("param show GUID_TIMEOUT", r"GUID_TIMEOUT\s+3\.0")
    ground.type("param set GUID_TIMEOUT 1.5")  # it says nothing when it is done
    while ground.ask("param fetch GUID_TIMEOUT", r"GUID_TIMEOUT = ([\d.]+)")[1] == "3.0000000":
        pass
    ground.ask("param set NO_SUCH_NAME 1", "Unable to find parameter 'NO_SUCH_NAME'")
    saved = tmp_path / "saved.txt"
    ground.ask(f"param save {saved}", rf"Saved {count} parameters to {saved}")
    assert re.search(r"^GUID_TIMEOUT +1\.5", saved.read_text(), re.MULTILINE)
    for command, kind in KINDS.items():
        file, back = loads(ground, command, tmp_path), tmp_path / f"{command}-back.txt"
        ground.ask(f"{command} save {back}", rf"Saved \d+ [a-z ]+ to {back}")
        sent, got = items(file), items(back)
        assert [row[0] for row in got] == [row[0] for row in sent]
        for before, after in zip(sent[1:], got[1:], strict=True):  # item 0 of a mission is home
            assert after[2:] == pytest.approx(before[2:], abs=2e-6)
            assert after[1] in (before[1], 0.0)  # frames of what has no place come back as 0
        ground.ask(f"{command} clear", f"Got MISSION_ACK: TYPE_{kind}: ACCEPTED")
        ground.ask(f"{command} list", "Requesting 0 ")
    assert vehicle.track()[-1]["mode"] == "STABILIZE"
    ends(ground)


def test_once_there_is_a_key_who_has_it_not_is_heard_on_the_first_link_only(
    fly: Any, mavproxy: Any
) -> None:
    ports = free_port(), free_port()
    to = [part for port in ports for part in ("--connect", f"udpout:127.0.0.1:{port}")]
    first = mavproxy(f"udp:127.0.0.1:{ports[0]}", name="first")
    second = mavproxy(f"udp:127.0.0.1:{ports[1]}", "--source-system=254", name="second")
    for ground in (first, second):
        ground.expect("Waiting for heartbeat")
    vehicle = fly(*to, speedup=20)
    for ground in (first, second):
        ground.expect("online system 1")
        ground.expect(r"Received (\d+) parameters")
    second.ask("mode GUIDED", "DO_SET_MODE: ACCEPTED")
    vehicle.wait_until(lambda now: now["mode"] == "GUIDED")

    first.ask("signing setup secret", "Setup signing key")
    first.type("set allow_unsigned False")  # from here on it believes signed frames only
    first.ask("mode STABILIZE", "DO_SET_MODE: ACCEPTED")
    refused_s = vehicle.wait_until(lambda now: now["mode"] == "STABILIZE")["t_s"]
    for key in ("", "signing key other"):
        if key:
            second.ask(key, "Setup signing key")
        second.type("mode GUIDED")
        until_s = vehicle.track()[-1]["t_s"] + 10.0
        vehicle.wait_until(lambda now, until_s=until_s: now["t_s"] > until_s)
        assert {r["mode"] for r in vehicle.track() if r["t_s"] > refused_s} == {"STABILIZE"}
    second.ask("signing key secret", "Setup signing key")
    second.ask("mode GUIDED", "DO_SET_MODE: ACCEPTED")
    vehicle.wait_until(lambda now: now["mode"] == "GUIDED")
    first.ask("signing remove", "Removed signing")
    ends(first)
    ends(second)


def test_what_is_typed_at_a_mavproxy_on_another_link_of_the_vehicle_is_for_the_companion(
    programs: Any, mavproxy: Any, tmp_path: Path
) -> None:
    """As docs/connecting.md has it typed; the vehicle, a PX4, forwards it."""
    ours, theirs = (f"127.0.0.1:{free_port()}" for _ in range(2))
    person = mavproxy(f"udpin:{theirs}")
    links = f"--connect=udpout:{ours}", f"--connect=udpout:{theirs}"
    programs("vehicle", BIN / "vehicle-sim", "sitl-px4", *links)
    fly = "fly", "sitl-px4", "--connect", f"udpin:{ours}", "--out", tmp_path / "run", "--start"
    # at home, where its planner is compiled already
    programs("companion", BIN / "companion", *fly, folder=Path.home())
    person.expect("Detected vehicle 1:195", READY_S)
    # a whole number, which PX4 sends with its bits in the place of a float's
    person.ask("param fetch COM_OBL_RC_ACT", r"COM_OBL_RC_ACT = 0\s")
    person.type("set target_system 1")
    person.type("set target_component 195")
    person.expect("fence: 0 zones", READY_S)  # its word, once it knows the vehicle
    person.ask("long DO_PAUSE_CONTINUE 0", "DO_PAUSE_CONTINUE: (TEMPORARILY_REJECTED|ACCEPTED)")
