"""scripts/conformance LOG: how like the recorded autopilot the simulated one is."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from conformance.compare import compare
from conformance.flights import flight_of, play
from conformance.log import Recording, Side, read_recording
from conformance.report import (
    Summary,
    as_table,
    markdown_reasons,
    markdown_row,
    with_tables,
)
from conformance.rows import Row
from vehicle_sim.terminal import run

app = typer.Typer(add_completion=False, rich_markup_mode=None)
_WIDE = 200


@app.command()
def conformance(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="A .tlog of a flight, or .tlog.xz.")
    ],
    markdown: Annotated[
        Path | None,
        typer.Option(
            "--markdown", metavar="FILE", help="Bring the tables in this page up to date."
        ),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Show rows that agree too.")] = False,
    seed: Annotated[int, typer.Option(help="Of all that is random.", metavar="S")] = 0,
) -> None:
    """Play the client of a recorded flight into the simulator and compare what comes back.

    Ends with 1 if a row does not agree and no reason for that is known.
    """
    flights = [_flown(log, seed) for log in logs]
    if markdown is not None:
        page = markdown.read_text(encoding="utf-8")
        summaries = [markdown_row(*flight) for flight in flights]
        reasons = [markdown_reasons(*flight) for flight in flights]
        markdown.write_text(with_tables(page, summaries, reasons), encoding="utf-8")
    else:
        console = Console()
        console = console if console.is_terminal else Console(width=_WIDE)
        for flight in flights:
            console.print(as_table(*flight, everything=every))
    if any(Summary.of(rows).unexplained for _, rows in flights):
        raise typer.Exit(1)


def _flown(log: Path, seed: int) -> tuple[Recording, list[Row]]:
    recording = read_recording(log)
    flight = flight_of(recording)
    return recording, compare(recording, flight, Side(play(recording, flight, seed=seed)))


def main() -> None:
    """Entry of scripts/conformance."""
    run(app, "scripts/conformance")


if __name__ == "__main__":
    main()
