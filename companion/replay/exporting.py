"""A run folder's flight, put together for export, and written in one of the formats."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from companion.config import elevation_file, load_mission, refuse_older
from companion.errors import InputError
from companion.mission.mission import Mission
from companion.sources.files import file_of_run, writing
from companion.telemetry.export.flight import FlightBuilder, RecordedFlight
from companion.telemetry.export.geojson import write_geojson
from companion.telemetry.export.kml import write_kml
from companion.telemetry.export.table import write_csv
from companion.telemetry.export.track import Track, track_of
from companion.telemetry.journal import Journal
from companion.telemetry.logs import Record, open_log


def recorded(
    run_dir: Path, look: Callable[[Record], None] | None = None
) -> tuple[RecordedFlight, tuple[str, ...]]:
    """The flight in a run folder, and what was odd about it.  Raises InputError.

    look: is shown each frame of the log, in order.
    """
    mission = mission_of(run_dir)
    journal = Journal(run_dir / "journal.jsonl")
    builder = FlightBuilder(mission)
    for line in journal.lines():
        builder.take(line)
    track, notes = _track(file_of_run(run_dir, "flight.tlog"), builder.system_id, look)
    if not len(track):
        notes += ("flight.tlog: no position was recorded",)
    if track.left_out:
        notes += (
            f"flight.tlog: {track.left_out} positions without a fix or in no order: left out",
        )
    return builder.flight(track), (*journal.findings, *notes)


def write(flight: RecordedFlight, to: str, file: Path) -> None:
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


_NO_VEHICLE_BYTES = 1000  # a few heartbeats of a companion that has met nobody
_NOT_NEEDED = "terrain={highest_amsl_m = -500.0}"


def _track(
    file: Path, system_id: int | None, look: Callable[[Record], None] | None
) -> tuple[Track, tuple[str, ...]]:
    """The positions in the log, and what was odd about it."""
    try:
        log = open_log(file, system_id=system_id)
    except InputError:
        if file.stat().st_size > _NO_VEHICLE_BYTES:
            raise
        return track_of((), None), ()  # it ended before there was anything to record
    records = log.records() if look is None else _shown(log.records(), look)
    track = track_of(records, log.system_id)
    return track, tuple(f"{file.name}: {finding}" for finding in log.findings)


def _shown(records: Iterable[Record], look: Callable[[Record], None]) -> Iterator[Record]:
    for record in records:
        look(record)
        yield record
