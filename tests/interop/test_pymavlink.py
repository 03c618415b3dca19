"""pymavlink's own tools: what its users write, and the programs that read its logs."""

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

    def tool(name: str, *options: object) -> str:
        """What one of pymavlink's programs prints."""
        python = python_of("mavproxy")
        command = [python, python.with_name(name), *map(str, options), log]
        environment = {"HOME": str(tmp_path), "MAVLINK20": "1"}
        return subprocess.check_output(
            command, cwd=tmp_path, env=environment, text=True, timeout=60, stderr=subprocess.DEVNULL
        )

    types = {"HEARTBEAT", "GLOBAL_POSITION_INT", "PARAM_VALUE", "MISSION_ITEM_INT"}
    assert types <= set(tool("mavlogdump.py", "--show-types").split())
    assert re.search("GUIDED(.|\n)*RTL", tool("mavflightmodes.py"))
    assert " 0 lost " in tool("mavloss.py")
    assert re.search(r"^GUID_TIMEOUT\s+1\.5", tool("mavparms.py"), re.MULTILINE)
    saved = tmp_path / "mission.txt"
    tool("mavmission.py", "--output", saved)
    title, *items = saved.read_text().splitlines()
    assert (title, len(items)) == ("QGC WPL 110", 4)
