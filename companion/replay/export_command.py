"""`companion export`: a recorded flight for Google Earth, QGIS and spreadsheets."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from companion.errors import InputError
from companion.sources.files import answer, writable
from companion.telemetry.run_folder import RECORDED
from companion.views.output import plain_console

Format = Literal["kml", "geojson", "csv"]


def export(
    run_dir: Annotated[
        Path, typer.Argument(metavar="RUN_DIR", help="The run folder of a flight, ended or not.")
    ],
    to: Annotated[
        Format,
        typer.Option(
            "--format",
            help="*kml*: Google Earth. *geojson*: QGIS. *csv*: a row for each position.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="File to write; by default RUN_DIR/flight.FORMAT."),
    ] = None,
) -> None:
    """Write a recorded flight for other programs: track, subpaths, targets, threats, holds.

    A flight that was killed is exported as far as it was recorded.
    """
    from companion.replay.exporting import recorded, write  # slow to import

    file = out_file(out or run_dir / f"flight.{to}", run_dir)
    flight, notes = recorded(run_dir)
    write(flight, to, file)
    said = f"{len(flight.track)} positions, {len(flight.planned)} subpaths, "
    said += f"{len(flight.moments)} holds and events: {file}"
    for line in [*(f"note: {note}" for note in notes), said]:
        plain_console().out(line, highlight=False)


def out_file(file: Path, run_dir: Path) -> Path:
    """The file; refuse a file that cannot be written, or that holds what was recorded."""
    if file.parent != run_dir:  # of a run folder that is not there, others tell
        writable("--out", file)
    elif answer(file.is_dir):
        raise InputError("--out", str(file), "it is a folder", "Give a file.")
    if file.name in RECORDED and answer(lambda: file.absolute().parent.samefile(run_dir)):
        rule = "that is what the flight was recorded in"
        raise InputError("--out", str(file), rule, "Give another file.")
    return file
