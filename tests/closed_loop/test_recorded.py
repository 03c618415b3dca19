"""What real flights leave behind: whole, documented, and read by other people's programs."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import geopandas
import pytest
from flights import HILLS, HILLS_MISSION, flown_as, flown_here
from tlog import frames_of

from companion.replay.command import export
from companion.replay.exporting import recorded
from companion.telemetry.journal import Journal
from companion.telemetry.run_folder import whole_records

pytestmark = pytest.mark.closed_loop
READER = """
import sys
from pymavlink import mavutil
log, count = mavutil.mavlink_connection(sys.argv[1]), 0
while (message := log.recv_match(type="GLOBAL_POSITION_INT")) is not None:
    count, last = count + 1, message
print(count, log.flightmode, last.get_srcSystem(), last.alt, last._timestamp)
"""


def test_the_journal_of_a_flight_with_faults_is_as_documented_and_tells_why_it_holds(
    tmp_path: Path,
) -> None:
    """A fix that is lost, a radar that falls silent, and the holds that follow."""
    faults = "at 120 s for 20 s: gps_off\nat 190 s for 30 s: radar_off\n"
    flight = flown_here(tmp_path / "run", HILLS, HILLS_MISSION, faults=faults)
    journal = Journal(flight.folder / "journal.jsonl")
    entries = list(journal.entries())
    assert journal.findings == ()
    assert "NO_FIX" in {entry.code for entry in entries if entry.kind == "phase"}
    assert {"scan done", "plan asked", "plan ready", "leg", "prepared", "end"} <= {
        entry.kind for entry in entries
    }
    whole, _ = recorded(flight.folder)
    holds = [moment.why for moment in whole.moments if moment.what == "hold"]
    assert holds
    assert all(holds)
    export(flight.folder, "geojson")
    table = geopandas.read_file(flight.folder / "flight.geojson")
    assert list(table[table["what"] == "hold"]["why"]) == holds


@pytest.mark.xdist_group("hills")
def test_mavutil_reads_the_log_as_a_ground_station_does(flown: Any) -> None:
    log = flown(*flown_as("hills")).folder / "flight.tlog"
    command = [sys.executable, "-W", "ignore", "-c", READER, str(log)]
    count, mode, system, altitude, time_s = subprocess.check_output(command, text=True).split()
    whole = frames_of(log.read_bytes()[: whole_records(log)])
    positions = [each for each in whole if each[1].get_type() == "GLOBAL_POSITION_INT"]
    stamp_us, last = positions[-1]
    assert (int(count), mode, system) == (len(positions), "BRAKE", "1")
    assert int(altitude) == last.alt
    assert float(time_s) == pytest.approx(stamp_us * 1e-6, abs=1e-5)
