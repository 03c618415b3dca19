"""What users of pymavlink write, as DroneKit does: a flight, and a log that lost nothing."""

import re
import socket
import subprocess
from pathlib import Path
from typing import Any

import pytest
from processes import away_m, height_m, place, python_of
from programs import free_port


def test_a_flight_with_the_high_level_functions_and_its_log(
    fly: Any, client: Any, tmp_path: Path
) -> None:
    port, log = free_port(socket.SOCK_STREAM), tmp_path / "flight.tlog"
    vehicle = fly("--connect", f"tcpin:127.0.0.1:{port}", speedup=20)
    other = client("mavproxy", "pymavlink_flight.py", f"tcp:127.0.0.1:{port}", log)
    assert other.wait(60.0) == 0, other.transcript
    assert "flight complete" in other.transcript
    track = vehicle.track()
    assert max(map(height_m, track)) == pytest.approx(15.0, abs=1.0)
    assert away_m(track[-1], *place(0.0, 0.0)) < 2.0
    python = python_of("mavproxy")
    command = [python, python.with_name("mavloss.py"), log]
    environment = {"HOME": str(tmp_path), "MAVLINK20": "1"}
    said = subprocess.check_output(command, env=environment, text=True, timeout=60)
    assert re.search(r"Total: [1-9]\d+ packets, 0 lost", said)
