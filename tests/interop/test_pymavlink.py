"""pymavlink's own tools: what its users write, and the programs that read its logs."""

import re
import socket
import subprocess
from pathlib import Path
from typing import Any

import pytest
from processes import away_m, environments, height_m, place
from programs import free_port

SPEEDUP = 20


def tool(name: str, *arguments: object, folder: Path) -> str:
    """What one of pymavlink's programs prints."""
    bin_folder = environments() / "mavproxy" / "bin"
    done = subprocess.run(
        [bin_folder / "python", bin_folder / name, *map(str, arguments)],
        cwd=folder,
        env={"HOME": str(folder), "MAVLINK20": "1"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def flown(fly: Any, client: Any, tmp_path: Path) -> tuple[Any, str, Path]:
    """A flight under a script of mavutil's high-level functions, and the log that it wrote."""
    port, log = free_port(socket.SOCK_STREAM), tmp_path / "flight.tlog"
    vehicle = fly("--connect", f"tcpin:127.0.0.1:{port}", speedup=SPEEDUP)
    other = client("mavproxy", "pymavlink_flight.py", f"tcp:127.0.0.1:{port}", log)
    assert other.wait(60.0) == 0, other.transcript
    return vehicle, other.transcript, log


def test_a_flight_with_the_high_level_functions_and_its_log(
    flown: tuple[Any, str, Path], tmp_path: Path
) -> None:
    vehicle, transcript, log = flown
    assert "flight complete" in transcript
    assert max(map(height_m, vehicle.track())) == pytest.approx(15.0, abs=1.0)
    assert away_m(vehicle.now(), *place(0.0, 0.0)) < 2.0

    types = tool("mavlogdump.py", "--show-types", log, folder=tmp_path)
    assert {"HEARTBEAT", "GLOBAL_POSITION_INT", "PARAM_VALUE", "MISSION_ITEM_INT"} <= set(
        types.split()
    )
    modes = tool("mavflightmodes.py", log, folder=tmp_path)
    assert re.search("GUIDED(.|\n)*RTL", modes), modes
    assert " 0 lost " in tool("mavloss.py", log, folder=tmp_path)
    saved = tmp_path / "mission.txt"
    tool("mavmission.py", "--output", saved, log, folder=tmp_path)
    assert saved.read_text().splitlines()[0] == "QGC WPL 110"
    assert len(saved.read_text().splitlines()) == 5
    parameters = tool("mavparms.py", log, folder=tmp_path)
    assert re.search(r"^GUID_TIMEOUT\s+1\.5", parameters, re.MULTILINE)
