"""A run folder's flight as a report: what is there is read, what is missing is said."""

from contextlib import suppress
from pathlib import Path
from typing import Any

from companion.errors import InputError
from companion.replay.export_command import out_file
from companion.replay.exporting import recorded
from companion.replay.feed import flown_mission, outputs
from companion.sources.files import answer, json_table, writing
from companion.telemetry.export.health import FlightHealth
from companion.telemetry.run_folder import known_map
from companion.views.report import report_html
from companion.views.report_facts import FlightFacts
from companion.world.known_map import KnownMap


def write_report(run_dir: Path, out: Path | None) -> tuple[str, ...]:
    """Write the report of a run folder; what people should know of it.  Raises InputError."""
    file = run_dir / "report.html" if out is None else out_file(out, run_dir)
    facts = facts_of(run_dir)
    with writing("--out", file):
        file.write_text(report_html(facts), encoding="utf-8")
    return (*(f"note: {note}" for note in facts.notes), f"report: {file}")


def facts_of(run_dir: Path) -> FlightFacts:
    """What there is of the flight in a run folder.  Raises InputError without the essential."""
    health, odd = FlightHealth(), list[str]()
    flight, notes = recorded(run_dir, health.look)
    known, run = _known(run_dir, odd), _run(run_dir, odd)
    return FlightFacts(
        flight=flight,
        health=health,
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
