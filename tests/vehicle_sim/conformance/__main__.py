"""scripts/conformance LOG: how like the recorded autopilot the simulated one is, as Markdown."""

from collections import Counter, defaultdict
from pathlib import Path
from typing import Annotated

import typer

from conformance import compare
from conformance.flights import Side, flight_of, play, read_recording
from conformance.rows import Row
from vehicle_sim.cli import run

app = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
def conformance(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="LOG...", exists=True, dir_okay=False, help="A .tlog or .tlog.xz."),
    ],
) -> None:
    """Play the client of a recorded flight into the simulator and compare what comes back.

    Ends with 1 if a row does not agree and no reason for that is known.
    """
    flown = dict[str, list[Row]]()
    for log in logs:
        flight = flight_of(log.name.removesuffix(".xz"))
        recording = read_recording(log)
        flown[recording.name] = compare(recording, flight, Side(play(recording, flight)))
    typer.echo(tables(flown))
    if any(not row.agrees and row.reason is None for rows in flown.values() for row in rows):
        raise typer.Exit(1)


def tables(flown: dict[str, list[Row]]) -> str:
    """The two tables of docs/lab/conformance.md: how much agrees, and why the rest does not."""
    lines = [
        "| recording | rows | agree | | worst difference that agrees | do not agree |",
        "|---|---|---|---|---|---|",
    ]
    reasons = ["", "| recording | rows | do not agree | because |", "|---|---|---|---|"]
    for name, rows in flown.items():
        agree, apart = ([row for row in rows if row.agrees is wanted] for wanted in (True, False))
        near = max(agree, key=lambda row: row.difference)
        worst = f"{near.difference:.2f} of the tolerance ({near.kind}: {near.name})"
        kinds = Counter(row.kind for row in apart).items()
        told = ", ".join(f"{n} {kind}" for kind, n in kinds) or "none"
        share = f"{100.0 * len(agree) / len(rows):.1f} %"
        lines.append(f"| {name} | {len(rows)} | {len(agree)} | {share} | {worst} | {told} |")
        because = defaultdict[str, list[str]](list)
        for row in apart:
            because[row.reason.why if row.reason else "none is known"].append(
                f"{row.kind} ({row.name})"
            )
        for why, names in because.items():
            listed = ", ".join(dict.fromkeys(names))
            reasons.append(f"| {name} | {len(names)} | {listed} | {why} |")
    return "\n".join(lines + reasons)


if __name__ == "__main__":
    run(app, "scripts/conformance")
