"""`companion replay` and `companion export`: a recorded flight once more, or for other programs."""

from pathlib import Path
from typing import Annotated, Final, Literal

import typer

from companion.errors import InputError
from companion.sources.files import answer, writable
from companion.telemetry.run_folder import RECORDED
from companion.views.output import plain_console

ProfileName = Literal["flight", "paper"]
"""Profiles of the planner."""
_TAKES: Final = {
    "a shadow (--shadow)": ("--shadow", "--mission", "--system", "--json"),
    "what if (--set, --seed, --profile)": ("--set", "--seed", "--profile", "--json"),
    "the replay of a log alone": ("--mission", "--seed", "--profile", "--system", "--json"),
    "the replay of a run folder": ("--plans", "--json"),
}
"""What can be done with a flight, and the options of each."""
_SHADOW, _WHAT_IF, _LOG, _RUN = _TAKES


def replay_command(
    context: typer.Context,
    flight: Annotated[
        Path,
        typer.Argument(
            metavar="RUN_DIR|LOG", help="A run folder, or a telemetry log: .tlog, .bin or .ulg."
        ),
    ],
    mission: Annotated[
        str | None,
        typer.Option(metavar="MISSION", help="Of a log: the mission that was, or is to be, flown."),
    ] = None,
    shadow: Annotated[
        bool, typer.Option("--shadow", help="What the companion would have done on that flight.")
    ] = False,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="What if: plan each subpath again under this setting of the mission.",
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="What if: plan with other random numbers.")
    ] = None,
    profile: Annotated[
        ProfileName | None,
        typer.Option(help="What if: plan with another profile: flight or paper."),
    ] = None,
    plans: Annotated[
        bool,
        typer.Option("--plans/--no-plans", help="Compute each plan again and compare it too."),
    ] = True,
    system: Annotated[
        int | None,
        typer.Option(min=1, max=255, help="System id of the vehicle, of several in a log."),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the report to a JSON file.")
    ] = None,
) -> None:
    """Feed a recorded flight through the same decisions, and compare: 0 if identical, 1 if not.

    Or run another's flight in shadow (--shadow), or plan it again under other settings (--set,
    --seed, --profile).
    """
    if not answer(flight.exists):
        remedy = "Give a run folder, or a .tlog, .bin or .ulg."
        raise InputError("RUN_DIR|LOG", str(flight), "there is no such file or folder", remedy)
    is_log = not flight.is_dir() and not settings  # then it has to be said how it was flown
    changes = settings or seed is not None or profile
    way = _SHADOW if shadow else _LOG if is_log else _WHAT_IF if changes else _RUN
    _refuse_others(context, way)
    from companion.replay import actions  # so that `companion fly` starts without it

    if way == _SHADOW:
        actions.shadow(flight, mission, system, json_file)
    elif way == _LOG:
        actions.same_log(flight, mission, profile, 1 if seed is None else seed, system, json_file)
    elif way == _WHAT_IF:
        actions.changed(flight, settings or [], seed, profile, json_file)
    else:
        actions.same_run(flight, json_file, plans=plans)


def _refuse_others(context: typer.Context, way: str) -> None:
    """No option is passed over silently."""
    for known in context.command.params:
        source, option = context.get_parameter_source(known.name or ""), max(known.opts, key=len)
        given = source is not None and source.name == "COMMANDLINE"
        if given and known.param_type_name == "option" and option not in _TAKES[way]:
            value, takes = context.params[known.name or ""], ", ".join(_TAKES[way])
            shown = value if type(value) is bool else str(value)
            raise InputError(
                option, shown, f"{way} does not take it", f"Leave it out. It takes {takes}."
            )


# --- export: for Google Earth, QGIS and spreadsheets

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
    summary = f"{len(flight.track)} positions, {len(flight.planned)} subpaths, "
    summary += f"{len(flight.moments)} holds and events: {file}"
    for line in [*(f"note: {note}" for note in notes), summary]:
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
