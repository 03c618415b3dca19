"""MAVProxy, driven as by a person at its prompt."""

import re
import socket
from pathlib import Path
from typing import Any

import pytest
from processes import Vehicle, away_m, height_m, place
from programs import Program, free_port

from vehicle_sim.autopilot.arducopter import FIRMWARE

SPEEDUP = 20
MISSION = """QGC WPL 110
0 1 0 16 0 0 0 0 {home} 488 1
1 0 3 22 0 0 0 0 0 0 25 1
2 0 3 16 0 0 0 0 {north} 30 1
3 0 3 16 0 0 0 0 {east} 30 1
4 0 3 178 0 4 0 0 0 0 0 1
5 0 3 20 0 0 0 0 0 0 0 1
"""
FENCE = """QGC WPL 110
0 0 0 5001 4 0 0 0 {a} 0 1
1 0 0 5001 4 0 0 0 {b} 0 1
2 0 0 5001 4 0 0 0 {c} 0 1
3 0 0 5001 4 0 0 0 {d} 0 1
4 0 0 5004 20 0 0 0 {circle} 0 1
"""
RALLY = """QGC WPL 110
0 0 3 5100 0 0 0 0 {rally} 40 1
"""


def at(north_m: float, east_m: float) -> str:
    return "{:.7f} {:.7f}".format(*place(north_m, east_m))


PLACES = {
    "home": at(0, 0),
    "north": at(60, 0),
    "east": at(60, 60),
    "a": at(140, 140),
    "b": at(-140, 140),
    "c": at(-140, -140),
    "d": at(140, -140),
    "circle": at(0, 80),
    "rally": at(-50, 10),
}


@pytest.fixture
def connect(fly: Any, mavproxy: Any) -> Any:
    """A vehicle, and a MAVProxy that has found it over this kind of link and has its parameters."""

    def start(
        how: str, *arguments: object, speedup: float = SPEEDUP, ready: bool = True
    ) -> tuple[Vehicle, Program]:
        # what it fetches as a file it asks for once: of a fast vehicle the refusal may be lost
        plainly = () if speedup < SPEEDUP else ("--cmd=set param_ftp False",)
        here = f"127.0.0.1:{free_port(socket.SOCK_STREAM if how == 'tcpin' else socket.SOCK_DGRAM)}"
        if how == "udpout":
            ground = mavproxy(f"udp:{here}", *plainly)
            ground.expect("Waiting for heartbeat")
            vehicle = fly("--connect", f"udpout:{here}", *arguments, speedup=speedup)
        else:
            vehicle = fly("--connect", f"{how}:{here}", *arguments, speedup=speedup)
            ground = mavproxy(f"{'tcp' if how == 'tcpin' else 'udpout'}:{here}", *plainly)
        ground.expect("online system 1")
        if ready:
            ground.expect(r"Received (\d+) parameters")
            ground.expect(r"Saved \d+ parameters to .*\n")
        ground.type("set streamrate 2")  # which makes it ask for streams now, not in 15 s
        return vehicle, ground

    return start


def finish(ground: Program) -> None:
    """Hang up; MAVProxy ends by itself, with 1 as always (and its threads may trip then)."""
    assert "Traceback" not in ground.transcript
    ground.hang_up()
    assert ground.wait(10.0) == 1


def take_off(vehicle: Vehicle, ground: Program, metres: float) -> None:
    if vehicle.now()["mode"] != "GUIDED":
        ground.ask("mode GUIDED", "DO_SET_MODE: ACCEPTED")
    if "is using GPS" not in ground.transcript:
        ground.expect("EKF3 IMU0 is using GPS")
    ground.ask("arm throttle", "COMPONENT_ARM_DISARM: ACCEPTED")
    ground.expect("ARMED")
    ground.ask(f"takeoff {metres}", "NAV_TAKEOFF: ACCEPTED")
    vehicle.wait_until(lambda now: height_m(now) > metres - 0.5)


def write(ground_folder: Path, **texts: str) -> dict[str, Path]:
    files = {name: ground_folder / f"{name}.txt" for name in texts}
    for name, text in texts.items():
        files[name].write_text(text.format(**PLACES), encoding="utf-8")
    return files


def items(file: Path) -> list[list[float]]:
    """The rows of a QGC WPL file, without who is current."""
    rows = [line.split() for line in file.read_text(encoding="utf-8").splitlines()[1:]]
    return [[float(value) for value in row[:1] + row[2:11]] for row in rows]


def test_a_guided_flight(connect: Any) -> None:
    """Refused before there is a position; then mode, arm, take-off, there, and home again."""
    vehicle, ground = connect("udpout", speedup=10, ready=False)
    ground.ask("mode GUIDED", "DO_SET_MODE: ACCEPTED")
    ground.ask("arm throttle", "FAILED(.|\n)*Need Position|Need Position(.|\n)*FAILED")
    take_off(vehicle, ground, 10.0)
    there = place(20.0, -15.0)
    ground.ask(f"guided {there[0]:.7f} {there[1]:.7f} 15", "DO_REPOSITION: ACCEPTED")
    arrived = vehicle.wait_until(lambda now: away_m(now, *there) < 1.0 and height_m(now) > 14.0)
    assert arrived["mode"] == "GUIDED"
    ground.ask("mode RTL", "DO_SET_MODE: ACCEPTED")
    ground.expect("DISARMED", 30.0)
    landed = vehicle.wait_until(lambda now: now["landed"] and not now["armed"], 30.0)
    assert away_m(landed, *place(0.0, 0.0)) < 1.5
    finish(ground)


def test_parameters(connect: Any, tmp_path: Path) -> None:
    """All of them, one of them, one that is set, one that does not exist."""
    _, ground = connect("tcpin")
    found = re.search(r"Received (\d+) parameters", ground.transcript)
    assert found
    count = int(found[1])
    assert count == len(FIRMWARE.table)
    ground.ask("param show GUID_TIMEOUT", r"GUID_TIMEOUT\s+3\.0")
    ground.type("param set GUID_TIMEOUT 1.5")  # it says nothing when it is done
    while ground.ask("param fetch GUID_TIMEOUT", r"GUID_TIMEOUT = ([\d.]+)")[1] == "3.0000000":
        pass
    ground.ask("param show GUID_TIMEOUT", r"GUID_TIMEOUT\s+1\.5")
    ground.ask("param set NO_SUCH_NAME 1", "Unable to find parameter 'NO_SUCH_NAME'")
    saved = tmp_path / "saved.txt"
    ground.ask(f"param save {saved}", rf"Saved (\d+) parameters to {saved}")
    rows = dict(line.split()[:2] for line in saved.read_text().splitlines() if line[:1].isalpha())
    assert float(rows["GUID_TIMEOUT"]) == 1.5
    assert len(rows) == count
    finish(ground)


def test_mission_fence_and_rally_come_back_as_they_went(connect: Any, tmp_path: Path) -> None:
    """Not much faster than real time: the vehicle waits 8 s of its own for each item."""
    vehicle, ground = connect("udpin", speedup=2)
    files = write(tmp_path, mission=MISSION, fence=FENCE, rally=RALLY)
    for command, name in (("wp", "mission"), ("fence", "fence"), ("rally", "rally")):
        ground.ask(
            f"{command} load {files[name]}", f"Got MISSION_ACK: TYPE_{name.upper()}: ACCEPTED"
        )
        back = tmp_path / f"{name}-back.txt"
        ground.ask(f"{command} save {back}", rf"Saved \d+ [a-z ]+ to {back}")
        sent, got = items(files[name]), items(back)
        assert [row[0] for row in got] == [row[0] for row in sent]
        for before, after in zip(sent[1:], got[1:], strict=True):  # item 0 of a mission is home
            assert after[2:] == pytest.approx(before[2:], abs=2e-6)
            assert after[1] in (before[1], 0.0)  # frames of what has no place come back as 0
        ground.ask(f"{command} clear", f"Got MISSION_ACK: TYPE_{name.upper()}: ACCEPTED")
        ground.type(f"{command} list")
        ground.expect("Requesting 0 ")
    assert vehicle.now()["mode"] == "STABILIZE"
    finish(ground)


@pytest.mark.nightly
def test_a_mission_is_flown(connect: Any, tmp_path: Path) -> None:
    vehicle, ground = connect("udpout")
    files = write(tmp_path, mission=MISSION)
    ground.ask(f"wp load {files['mission']}", "Got MISSION_ACK: TYPE_MISSION: ACCEPTED")
    take_off(vehicle, ground, 10.0)
    ground.ask("mode AUTO", "AUTO> ")
    ground.expect("waypoint 3", 30.0)
    ground.expect("waypoint 5", 30.0)
    ground.expect("DISARMED", 40.0)
    track = [row for row in vehicle.track() if row["armed"]]
    for name in ("north", "east"):
        where = [float(value) for value in PLACES[name].split()]
        assert min(away_m(row, *where) for row in track) < 3.0
    assert max(map(height_m, track)) == pytest.approx(30.0, abs=1.0)
    finish(ground)


@pytest.mark.nightly
def test_the_fence_holds(connect: Any, tmp_path: Path) -> None:
    """A target beyond an exclusion is taken, flown straight at, breached, and the way home."""
    vehicle, ground = connect("udpout")
    files = write(tmp_path, fence=FENCE)
    ground.ask(f"fence load {files['fence']}", "Got MISSION_ACK: TYPE_FENCE: ACCEPTED")
    ground.ask("fence enable", "DO_FENCE_ENABLE: ACCEPTED")
    take_off(vehicle, ground, 20.0)
    beyond = place(0.0, 120.0)
    ground.ask(f"guided {beyond[0]:.7f} {beyond[1]:.7f} 20", "DO_REPOSITION: ACCEPTED")
    ground.expect("AP: .*[Ff]ence.*[Bb]reached", 30.0)
    ground.expect("RTL> ")
    vehicle.wait_until(lambda now: now["landed"] and not now["armed"], 60.0)
    inside = min(away_m(row, *place(0.0, 80.0)) for row in vehicle.track())
    assert 0.0 < inside < 20.0  # it notices when it is inside, and turns back
    finish(ground)


@pytest.mark.nightly
def test_the_ground_station_dies_in_flight(connect: Any) -> None:
    """Its heartbeats stop, and the vehicle comes home."""
    vehicle, ground = connect("udpout", "--param", "FS_GCS_ENABLE=1")
    ground.type("set heartbeat 20")  # a second, or two in one of the vehicle's
    take_off(vehicle, ground, 10.0)
    ground.kill()
    before_s = vehicle.now()["t_s"]
    vehicle.wait_until(lambda now: now["mode"] == "RTL")
    returned_s = next(row["t_s"] for row in vehicle.track() if row["mode"] == "RTL")
    assert 3.0 < returned_s - before_s < 8.0  # 4.9 s, and what the file lags behind
    vehicle.wait_until(lambda now: now["landed"] and not now["armed"], 30.0)


@pytest.mark.nightly
def test_a_plane(connect: Any) -> None:
    vehicle, ground = connect("tcpin", "--vehicle", "plane")
    ground.ask("mode TAKEOFF", "TAKEOFF> ")
    vehicle.wait_until(lambda now: now["t_s"] > 23.0)
    ground.ask("arm throttle", "COMPONENT_ARM_DISARM: ACCEPTED")
    ground.expect("ARMED")
    vehicle.wait_until(lambda now: height_m(now) > 35.0)
    ground.ask("mode GUIDED", "GUIDED> ")
    there = place(400.0, 0.0)
    ground.ask(f"guided {there[0]:.7f} {there[1]:.7f} 80", "DO_REPOSITION: ACCEPTED")
    vehicle.wait_until(lambda now: height_m(now) > 70.0 and away_m(now, *there) < 120.0, 30.0)
    ground.ask("mode RTL", "RTL> ")
    vehicle.wait_until(lambda now: away_m(now, *place(0.0, 0.0)) < 150.0, 30.0)
    finish(ground)


@pytest.mark.nightly
def test_whole_numbers_of_px4(connect: Any) -> None:
    """Which PX4 sends with their bits in the place of a float's.

    Not much faster than real time: MAVProxy cannot read 5000 messages a second, and loses some.
    """
    _, ground = connect("udpin", "--autopilot", "px4", speedup=2)
    # what it asked for before the first heartbeat told it of PX4, it has read as floats: 0.0
    ground.ask("param fetch COM_OBL_RC_ACT", r"COM_OBL_RC_ACT = 0\s")
    ground.ask("param show COM_OBL_RC_ACT", r"COM_OBL_RC_ACT\s+0\s")
    ground.type("param set COM_OBL_RC_ACT 5")
    while ground.ask("param fetch COM_OBL_RC_ACT", r"COM_OBL_RC_ACT = ([\d.]+)")[1] == "0":
        pass
    ground.ask("param show COM_OBL_RC_ACT", r"COM_OBL_RC_ACT\s+5\s")
    ground.ask("param show MIS_TAKEOFF_ALT", r"MIS_TAKEOFF_ALT\s+2\.5\s")
    finish(ground)


def test_signing(fly: Any, mavproxy: Any) -> None:
    """Once there is a key, who has it is heard on every link, and who has not on the first only."""
    ports = free_port(), free_port()
    to = [part for port in ports for part in ("--connect", f"udpout:127.0.0.1:{port}")]
    first = mavproxy(f"udp:127.0.0.1:{ports[0]}", name="first")
    second = mavproxy(f"udp:127.0.0.1:{ports[1]}", "--source-system=254", name="second")
    for ground in (first, second):
        ground.expect("Waiting for heartbeat")
    vehicle = fly(*to, speedup=SPEEDUP)
    for ground in (first, second):
        ground.expect("online system 1")
        ground.expect(r"Received (\d+) parameters")
    second.ask("mode GUIDED", "DO_SET_MODE: ACCEPTED")
    vehicle.wait_until(lambda now: now["mode"] == "GUIDED")

    first.ask("signing setup secret", "Setup signing key")
    first.type("set allow_unsigned False")  # from here on it believes signed frames only
    first.ask("mode STABILIZE", "DO_SET_MODE: ACCEPTED")
    refused_s = vehicle.wait_until(lambda now: now["mode"] == "STABILIZE")["t_s"]
    second.type("mode GUIDED")
    vehicle.wait_until(lambda now: now["t_s"] > refused_s + 10.0)
    assert {row["mode"] for row in vehicle.track() if row["t_s"] > refused_s} == {"STABILIZE"}
    second.ask("signing key other", "Setup signing key")
    second.type("mode GUIDED")
    vehicle.wait_until(lambda now: now["t_s"] > refused_s + 20.0)
    assert {row["mode"] for row in vehicle.track() if row["t_s"] > refused_s} == {"STABILIZE"}
    second.ask("signing key secret", "Setup signing key")
    second.ask("mode GUIDED", "DO_SET_MODE: ACCEPTED")
    vehicle.wait_until(lambda now: now["mode"] == "GUIDED")
    first.ask("signing remove", "Removed signing")
    finish(first)
    finish(second)
