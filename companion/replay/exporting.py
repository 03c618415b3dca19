"""A run folder's flight, put together: exported in one of the formats, or explained on a page."""

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from companion.config import read_mission, refuse_older
from companion.errors import InputError
from companion.mission.mission import Mission
from companion.replay.command import out_file
from companion.replay.feed import flown_mission, outputs
from companion.sources.files import answer, file_of_run, json_table, writing
from companion.telemetry.export.formats import write_csv, write_geojson, write_kml
from companion.telemetry.flight import Flight
from companion.telemetry.journal import Journal
from companion.telemetry.logs import open_log
from companion.telemetry.run_folder import known_map
from companion.world.known_map import KnownMap

if TYPE_CHECKING:
    from companion.views.report import FlightFacts

_NO_VEHICLE_BYTES: Final = 1000  # a few heartbeats of a companion that has met nobody
_NOT_NEEDED: Final = "terrain={highest_amsl_m = -500.0}"


def recorded(run_dir: Path) -> tuple[Flight, tuple[str, ...]]:
    """The flight in a run folder, and what was odd about it.  Raises InputError."""
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
    read = read_mission(str(file))  # an elevation file may be on another computer
    return read.mission(settings=() if read.elevation_file is None else (_NOT_NEEDED,))


# --- on a page


def write_report(run_dir: Path, out: Path | None) -> tuple[str, ...]:
    """Write the report of a run folder; what people should know of it.  Raises InputError."""
    file = run_dir / "report.html" if out is None else out_file(out, run_dir)
    from companion.views.report import report_html  # slow to import

    facts = facts_of(run_dir)
    with writing("--out", file):
        file.write_text(report_html(facts), encoding="utf-8")
    return (*(f"note: {note}" for note in facts.notes), f"report: {file}")


def facts_of(run_dir: Path) -> "FlightFacts":
    """What there is of the flight in a run folder.  Raises InputError without the essential."""
    from companion.views.report import FlightFacts  # slow to import

    (flight, notes), odd = recorded(run_dir), list[str]()
    known, run = _known(run_dir, odd), _run(run_dir, odd)
    return FlightFacts(
        flight,
        known=known,
        run=run,
        mission_toml=(run_dir / "mission.toml").read_text(encoding="utf-8", errors="replace"),
        notes=(*notes, *odd),
    )


def _known(run_dir: Path, odd: list[str]) -> KnownMap | None:
    """The known map at the end, if need be as it grows again in a replay; a note without it."""
    try:
        return known_map(run_dir)
    except (OSError, ValueError) as error:
        damage = "" if isinstance(error, FileNotFoundError) else f"known.npz: {error}"
    known: KnownMap | None = None
    try:  # a map of near things is not kept
        for _, session, _ in outputs(run_dir, flown_mission(run_dir)):
            known = session.state.flight.known
    except InputError as error:
        damage = damage or f"{error}"
    if damage:
        odd.append(damage)
    if known is None:
        odd.append("the known map was not recorded: neither terrain nor clearance is shown")
    return known


def _run(run_dir: Path, odd: list[str]) -> dict[str, Any]:
    """What run.json says; a note if it cannot be read."""
    file = run_dir / "run.json"
    with suppress(InputError):
        return json_table(file, "RUN_DIR", "")
    known = "it is damaged" if answer(file.is_file) else "it is missing"
    odd.append(f"run.json: {known}; when and how fast it was flown and planned is not known")
    return {}
