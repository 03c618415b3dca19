"""MAVSDK-Python against the PX4 personality: the present package, and the last that spoke gRPC."""

import re
from typing import Any

import pytest
from processes import HOME, Vehicle, away_m, height_m, place
from programs import free_port

from vehicle_sim.autopilot.px4copter import FIRMWARE
from vehicle_sim.parameters import Kind

SPEEDUP = 10


OLDER = pytest.param("mavsdk-3", marks=pytest.mark.nightly)


@pytest.fixture(params=["mavsdk", OLDER])
def session(request: pytest.FixtureRequest, fly: Any, client: Any) -> Any:
    """Run one of the sessions to its end; the vehicle and the client's transcript."""

    def run(script: str) -> tuple[Vehicle, str]:
        port = free_port()
        url = f"udpin://127.0.0.1:{port}"
        other = client(request.param, f"mavsdk_{script}.py", url, free_port())
        to = f"udpout:127.0.0.1:{port}"
        vehicle = fly("--autopilot", "px4", "--connect", to, speedup=SPEEDUP)
        code = other.wait(60.0)
        assert code == 0, other.transcript
        assert "session complete" in other.transcript
        return vehicle, other.transcript

    return run


def said(transcript: str, what: str) -> str:
    found = re.search(rf"^{re.escape(what)}: (.*)$", transcript, re.MULTILINE)
    assert found, f"no line {what!r} in:\n{transcript}"
    return found[1]


def test_telemetry_parameters_mission_and_geofence(session: Any) -> None:
    _, transcript = session("ground")
    assert said(transcript, "version") == "1.17.0"
    assert said(transcript, "position") == "47.39774 8.54559"
    assert said(transcript, "home") == "47.39774 8.54559 488"
    assert said(transcript, "flight_mode").endswith("HOLD") or "3" in said(
        transcript, "flight_mode"
    )
    assert float(said(transcript, "attitude at 5 Hz")) == pytest.approx(5.0, rel=0.1)
    assert float(said(transcript, "attitude at 20 Hz")) == pytest.approx(20.0, rel=0.1)
    count, whole = map(int, re.findall(r"\d+", said(transcript, "parameters")))
    kinds = [row.kind is not Kind.REAL32 for row in FIRMWARE.table]
    assert (count, whole) == (len(kinds), sum(kinds))
    assert said(transcript, "MIS_TAKEOFF_ALT") == "2.5 then 12.5"
    assert said(transcript, "COM_OBL_RC_ACT") == "0 then 5"
    assert said(transcript, "take-off altitude") == "7.5"
    assert "WRONG_TYPE" in said(transcript, "MIS_TAKEOFF_ALT as whole number")
    assert said(transcript, "mission").count(" m'") == 4
    assert said(transcript, "circle").endswith("47.4007 25 m")
    assert "after clearing: 0 polygons, 0 circles" in transcript
    assert "after clearing: 0 mission items" in transcript


def test_offboard(session: Any) -> None:
    vehicle, transcript = session("offboard")
    if not re.search("mavsdk: 4", transcript):  # the older one notes PX4's second answer to a mode
        assert transcript.count("Received ack for not-existing command: 176!") == 2
    assert "NO_SETPOINT_SET" in said(transcript, "start without a setpoint")
    assert said(transcript, "offboard is active") == "True"
    assert "Disarmed by landing" in said(transcript, "texts")
    landed = vehicle.wait_until(lambda now: now["landed"] and not now["armed"])
    assert landed["mode"] == "Hold"  # the last that was commanded, but for the landing
    assert away_m(landed, *place(20.0, 20.0)) < 15.0
    flown = vehicle.track()
    assert 10.0 < max(map(height_m, flown)) < 25.0
    assert min(away_m(row, *place(20.0, 0.0)) for row in flown) < 1.0


@pytest.mark.nightly
def test_takeoff_goto_mission_and_return(session: Any) -> None:
    vehicle, transcript = session("mission")
    assert float(said(transcript, "height").split()[0]) == pytest.approx(10.0, abs=1.0)
    assert said(transcript, "return altitude") == "20.0"
    assert "3/3" in said(transcript, "progress")
    assert said(transcript, "finished") == "True"
    landed = vehicle.wait_until(lambda now: now["landed"] and not now["armed"])
    assert away_m(landed, *place(0.0, 0.0)) < 1.0
    flown = vehicle.track()
    assert max(map(height_m, flown)) == pytest.approx(20.0, abs=1.0)
    for north_deg in (0.0002, 0.0005):
        assert min(away_m(row, HOME[0] + north_deg, HOME[1]) for row in flown) < 3.0


@pytest.mark.nightly
def test_the_companion_dies_in_flight(fly: Any, client: Any) -> None:
    """The stream ends in the middle of a flight; PX4 does what COM_OBL_RC_ACT says, here: hold."""
    port = free_port()
    other = client("mavsdk", "mavsdk_offboard.py", f"udpin://127.0.0.1:{port}", free_port())
    to = ("--connect", f"udpout:127.0.0.1:{port}", "--param", "COM_OBL_RC_ACT=5")
    vehicle = fly("--autopilot", "px4", *to, speedup=4)
    other.expect("heading: ", 40.0)
    assert vehicle.now()["mode"] == "Offboard"
    other.kill()
    before_s = vehicle.now()["t_s"]
    vehicle.wait_until(lambda now: now["mode"] == "Hold")
    holding_s = next(
        row["t_s"] for row in vehicle.track() if row["mode"] == "Hold" and row["t_s"] > before_s
    )
    # 4 s, for PX4's start script stretches COM_OF_LOSS_T with the pace; and the truth file's lag
    assert 3.0 < holding_s - before_s < 7.0
    later = vehicle.wait_until(lambda now: now["t_s"] > holding_s + 5.0)
    assert later["mode"] == "Hold"
    assert later["armed"]
    assert height_m(later) > 9.0
