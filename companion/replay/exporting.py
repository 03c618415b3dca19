"""A run folder's flight, put together for export, and written in one of the formats."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

from companion.config import elevation_file, load_mission, refuse_older
from companion.errors import InputError
from companion.mission.mission import Mission
from companion.sources.files import file_of_run, writing
from companion.telemetry.export.formats import write_csv, write_geojson, write_kml
from companion.telemetry.flight import Flight
from companion.telemetry.journal import Journal
from companion.telemetry.logs import Record, open_log

_NO_VEHICLE_BYTES: Final = 1000  # a few heartbeats of a companion that has met nobody
_NOT_NEEDED: Final = "terrain={highest_amsl_m = -500.0}"


def recorded(
    run_dir: Path, look: Callable[[Record], None] = lambda _: None
) -> tuple[Flight, tuple[str, ...]]:
    """The flight in a run folder, and what was odd about it.  Raises InputError.

    look: is shown each frame of the log, in order.
    """
    flight, notes = Flight(mission_of(run_dir)), list[str]()
    journal = Journal(run_dir / "journal.jsonl")
    for line in journal.lines():
        flight.take(line)
    file = file_of_run(run_dir, "flight.tlog")
    try:
        log = open_log(file, system_id=flight.system_id)
    except InputError:
        if file.stat().st_size > _NO_VEHICLE_BYTES:
            raise
    else:
        flight.system_id = log.system_id
        for record in log.records():
            look(record)
            flight.look(*record)
        notes += (f"{file.name}: {finding}" for finding in log.findings)
    flight.settle()
    if not len(flight.track):
        notes.append("flight.tlog: no position was recorded")
    if flight.left_out:
        left = f"{flight.left_out} positions without a fix or in no order"
        notes.append(f"flight.tlog: {left}: left out")
    return flight, (*journal.findings, *notes)


def write(flight: Flight, to: str, file: Path) -> None:
    """Write a flight as kml, geojson or csv.  Raises InputError about the file."""
    writers = {"kml": write_kml, "geojson": write_geojson, "csv": write_csv}
    with writing("--out", file):
        writers[to](flight, file)


def mission_of(run_dir: Path) -> Mission:
    """The mission as it was flown; what is known of its terrain does not matter here."""
    refuse_older(run_dir)
    file = file_of_run(run_dir, "mission.toml")
    known = elevation_file(str(file))  # it may be on another computer
    return load_mission(str(file), settings=() if known is None else (_NOT_NEEDED,))
