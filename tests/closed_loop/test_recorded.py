"""What real flights leave behind: whole, documented, and read by other people's programs."""

import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import geopandas
import pytest
from flights import HILLS, HILLS_MISSION, flown_here
from shown import MOST_BYTES, Shown
from tlog import frames_of

from companion.replay.command import Format, export
from companion.replay.exporting import recorded
from companion.telemetry.journal import Journal
from companion.telemetry.run_folder import whole_records

pytestmark = pytest.mark.closed_loop

SEED = ("--seed", "3")
IN_TURN = pytest.mark.xdist_group("hills")  # they look at the same flight


# --- the journal


@IN_TURN
def test_the_journal_of_a_real_flight_holds_nothing_that_is_not_documented(flown: Any) -> None:
    journal = Journal(flown(HILLS, HILLS_MISSION, *SEED).folder / "journal.jsonl")
    kinds = {entry.kind for entry in journal.entries()}
    assert journal.findings == ()
    assert {"scan done", "plan asked", "plan ready", "leg", "prepared", "end"} <= kinds


def test_nor_does_that_of_a_flight_with_faults(tmp_path: Path) -> None:
    """A fix that is lost, a radar that falls silent, and the holds that follow."""
    faults = "at 120 s for 20 s: gps_off\nat 190 s for 30 s: radar_off\n"
    flight = flown_here(tmp_path / "run", HILLS, HILLS_MISSION, faults=faults)
    journal = Journal(flight.folder / "journal.jsonl")
    codes = {entry.code for entry in journal.entries() if entry.kind == "phase"}
    assert journal.findings == ()
    assert "NO_FIX" in codes
    whole, _ = recorded(flight.folder)
    holds = [moment for moment in whole.moments if moment.what == "hold"]
    assert holds
    assert all(moment.why for moment in holds)
    export(flight.folder, "geojson")
    table = geopandas.read_file(flight.folder / "flight.geojson")
    assert list(table[table["what"] == "hold"]["why"]) == [moment.why for moment in holds]


# --- the log, in the hands of pymavlink's own reader

READER = """
import sys
from pymavlink import mavutil
log, count = mavutil.mavlink_connection(sys.argv[1]), 0
while (message := log.recv_match(type="GLOBAL_POSITION_INT")) is not None:
    count, last = count + 1, message
print(count, log.flightmode, last.get_srcSystem(), last.alt, last._timestamp)
"""


@IN_TURN
def test_mavutil_reads_it_as_a_ground_station_does(flown: Any) -> None:
    log = flown(HILLS, HILLS_MISSION, *SEED).folder / "flight.tlog"
    command = [sys.executable, "-W", "ignore", "-c", READER, str(log)]
    count, mode, system, altitude, time_s = subprocess.check_output(command, text=True).split()
    whole = frames_of(log.read_bytes()[: whole_records(log)])
    positions = [each for each in whole if each[1].get_type() == "GLOBAL_POSITION_INT"]
    stamp_us, last = positions[-1]
    assert (int(count), mode, system) == (len(positions), "BRAKE", "1")
    assert int(altitude) == last.alt
    assert float(time_s) == pytest.approx(stamp_us * 1e-6, abs=1e-5)


# --- a disk that is full


@IN_TURN
def test_a_flight_whose_disk_is_full_goes_on_says_so_and_leaves_whole_records(
    flown: Any, tmp_path: Path
) -> None:
    flight = flown(by=Shown)
    folder, said = flight.folder, flight.text
    assert flight.code == 0, said
    assert "arrived" in said
    assert "not recorded any more: File too large" in said
    assert "recording stopped: File too large" in said
    log = folder / "flight.tlog"
    assert MOST_BYTES - 300 < log.stat().st_size <= MOST_BYTES
    assert whole_records(log) == log.stat().st_size
    journal = Journal(folder / "journal.jsonl")
    entries = list(journal.entries())
    assert journal.findings == ()
    assert "end" not in {entry.kind for entry in entries}  # that was later
    for to in get_args(Format):
        export(folder, to, tmp_path / f"flight.{to}")
