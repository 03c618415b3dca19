"""The command line: fly, plan, check, compare."""

import contextlib
import errno
import io
import json
import os
import platform
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, NamedTuple, TextIO, cast, final

import typer
from rich.console import Console

from companion import library
from companion.campaign.command import campaign_app
from companion.config import (
    MissionFile,
    bundled,
    load_mission,
    load_world,
    read_mission,
    refuse_older,
)
from companion.errors import CompanionError, FlightFailed, FlightInterrupted, InputError
from companion.live_view.command import VIEW_PORT, PortOption, started_view, stay, view_command
from companion.mavlink.checks import CheckStatus
from companion.mavlink.preflight import checks_of, not_heard
from companion.mavlink.signing import Signing
from companion.mission.events import Outcome
from companion.mission.mission import Mission
from companion.mission.state import Reason
from companion.paper.compare.command import compare_command
from companion.printable import printable
from companion.replay.command import ProfileName, export, replay_command
from companion.runtime.compiler import load_kernel
from companion.runtime.keys import SigningKey
from companion.runtime.link import open_link
from companion.runtime.loop import fly
from companion.runtime.preflight import preflight
from companion.runtime.terminal import Terminal, stop_signals
from companion.schemas import Document, schema_of
from companion.session import Session
from companion.sources.files import picture_file, writing
from companion.telemetry.flight_status import (
    LOADS,
    SCHEMA,
    VERSION,
    FlightBegun,
    flight_status,
)
from companion.telemetry.flight_summary import FlightSummary
from companion.telemetry.resume import ResumeData, load_resume_data
from companion.telemetry.run_folder import RunFolder
from companion.views.live import MachineLines, Progress
from companion.views.output import PatientOutput, plain_console
from companion.views.text import checks_table, flight_table, mission_summary, plans_table
from companion.views.words import counted
from companion.world.simulated import true_map

_INTERRUPTED, _CRASHED = 130, 70
_NO_OUTPUT = (errno.ENOSPC, errno.EPIPE, errno.EIO)
_USAGE_ERROR = cast("tuple[type[Exception], ...]", typer.BadParameter.__bases__)
"""The class of all of them, for which typer has no name."""

_CONNECT = "udpin:127.0.0.1:14540"

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help=(
        "Plans a drone's path online, past mountains and radars that it knows only in part, "
        "and flies it over MAVLink.\n\n"
        "Start with **companion plan environment-1**: no vehicle needed. "
        "Then fly it: start **vehicle-sim environment-1 --lockstep** in one terminal and "
        "**companion fly environment-1 --lockstep** in another."
    ),
)

app.add_typer(campaign_app, name="campaign")
app.command("compare", no_args_is_help=True)(compare_command)
app.command("replay")(replay_command)
app.command("export")(export)
app.command("view")(view_command)


MissionArgument = Annotated[
    str,
    typer.Argument(
        metavar="MISSION",
        help=f"A mission.toml, a QGroundControl .plan, or a bundled name: {', '.join(bundled())}.",
    ),
]
_PROFILE_HELP = (
    "*flight*: checked before it is flown (the default). *paper*: as published; not safe."
)
_SEED_HELP = "Seed of the search: the same seed plans the same path."
_CONNECT_HELP = (
    "Where the vehicle is: udpin:HOST:PORT waits for it, udpout:HOST:PORT and tcp:HOST:PORT call "
    "it; or a serial device and its baud rate: /dev/ttyACM0,57600."
)
_SYSTEM_HELP = "MAVLink system id of the vehicle; by default the mission's, or the only one heard."
_KEY_HELP = "File with the key of a signed link: a phrase or 64 hexadecimal digits, for you alone."
_LOCKSTEP_HELP = "Let a simulator that was started with --lockstep run as fast as both can."
_START_HELP = "Take off once ready, without a go: for scripts. --lockstep implies it."
_SHADOW_HELP = "Plan and say what would be done, never command."
_OUT_HELP = "Run folder to write; by default runs/DATE-MISSION."
_RESUME_HELP = "Go on with the flight in the run folder --out, if one was interrupted there."
_JSON_HELP = (
    "Print how the flight stands as lines of JSON; what is for people goes to standard error."
)
_VIEW_HELP = "Show the flight in the browser while it is flown."
ProfileOption = Annotated[ProfileName | None, typer.Option(help=_PROFILE_HELP)]
SeedOption = Annotated[int, typer.Option(min=0, help=_SEED_HELP)]
ConnectOption = Annotated[str, typer.Option(help=_CONNECT_HELP)]
SystemOption = Annotated[int | None, typer.Option(min=1, max=255, help=_SYSTEM_HELP)]
KeyOption = Annotated[Path | None, typer.Option(help=_KEY_HELP)]


@app.command("fly")
def fly_command(
    mission: MissionArgument,
    connect: ConnectOption = _CONNECT,
    system: SystemOption = None,
    lockstep: Annotated[bool, typer.Option("--lockstep", help=_LOCKSTEP_HELP)] = False,
    start: Annotated[bool, typer.Option("--start", help=_START_HELP)] = False,
    shadow: Annotated[bool, typer.Option("--shadow", help=_SHADOW_HELP)] = False,
    out: Annotated[Path | None, typer.Option(help=_OUT_HELP)] = None,
    resume: Annotated[bool, typer.Option("--resume", help=_RESUME_HELP)] = False,
    signing_key: KeyOption = None,
    seed: SeedOption = 1,
    profile: ProfileOption = None,
    as_json: Annotated[bool, typer.Option("--json", help=_JSON_HELP)] = False,
    view: Annotated[bool, typer.Option("--view", help=_VIEW_HELP)] = False,
    view_port: PortOption = VIEW_PORT,
) -> None:
    """Fly a mission: find the vehicle, take off (or take over), follow subpaths to the target.

    On the ground it waits, ready, for somebody to say go: MISSION_START from a ground station,
    or **yes** in the terminal. A vehicle that flies already is taken over at once.

    Writes a run folder with the telemetry log, the journal of all decisions and a picture.
    Exit code: 0 arrived, 1 the flight failed, 2 the input was wrong, 75 it may go on (--resume),
    70 a crash, 130 stopped by Ctrl-C.
    """
    with contextlib.ExitStack() as stack:
        output = stack.enter_context(PatientOutput(sys.stderr if as_json else sys.stdout))
        lines = stack.enter_context(PatientOutput(sys.stdout)) if as_json else None
        machine = stack.enter_context(MachineLines(lines))
        console = plain_console(file=cast("TextIO", output))
        shows = _Shows(console=console, output=output, machine=machine)
        file = _as_begun(mission, out) if resume else read_mission(mission)
        chosen = _chosen(file, profile, system, console)
        folder_path = out or Path("runs") / f"{datetime.now(UTC):%Y%m%d-%H%M%S}-{chosen.name}"
        signing, keep_time = _signing(signing_key)
        recalled = load_resume_data(folder_path, chosen) if resume else None
        for line in () if recalled is None else recalled.said:
            console.out(f"warning: {line}", highlight=False)
        session = Session(
            chosen,
            seed=seed,
            lockstep=lockstep,
            shadow=shadow,
            signing=signing,
            resume=recalled and recalled.resume,
            go=start,
            version=version("companion"),
        )
        if view:
            stack.enter_context(started_view(folder_path, view_port, console))
        flown = _flown(session, connect, folder_path, file, keep_time, recalled, shows)
        stopped = flown.end is not None and flown.end.outcome is Outcome.STOPPED
        if view and console.is_terminal and not stopped:
            stay(console)
        _exit_as_it_ended(flown, connect)


@app.command("preflight")
def preflight_command(
    mission: MissionArgument,
    connect: ConnectOption = _CONNECT,
    system: SystemOption = None,
    signing_key: KeyOption = None,
    profile: ProfileOption = None,
) -> None:
    """Check a vehicle against a mission, every point with its reason and remedy; never arms.

    What `fly` refuses is refused here. Exit code: 0 it may fly, 1 it may not, 2 wrong input,
    130 stopped by Ctrl-C.
    """
    console = plain_console(soft_wrap=True)
    chosen = _chosen(read_mission(mission), profile, system, console)
    signing, keep_time = _signing(signing_key)
    session = Session(chosen, seed=1, lockstep=False, shadow=True, signing=signing)
    with open_link(connect) as link, console.status("") as status, stop_signals() as stop_asked:
        for waits_for in preflight(session, link):
            status.update(f"waiting for {waits_for}")
            if stop_asked:
                break
    keep_time()
    checks = checks_of(session)
    refused = [check for check in checks if check.status is CheckStatus.REFUSED]
    console.print(checks_table(checks))
    if stop_asked:
        raise typer.Exit(_INTERRUPTED)
    if refused:
        raise FlightFailed(f"{len(refused)} of {len(checks)} checks refuse the flight", "")


@app.command("plan")
def plan_command(
    world: Annotated[str, typer.Argument(metavar="WORLD", help="A world.toml or a bundled name.")],
    mission: Annotated[
        str | None,
        typer.Argument(
            metavar="MISSION", help="A mission.toml; by default the bundled one of WORLD."
        ),
    ] = None,
    figure: Annotated[
        Path, typer.Option("--figure", "--out", metavar="FILE", help="A .png, .svg or .pdf.")
    ] = Path("plan.png"),
    seed: SeedOption = 1,
    profile: ProfileOption = None,
) -> None:
    """Plan a mission without a vehicle: simulated scans of the world, perfect tracking.

    Writes a picture: the path in three dimensions, from above, and as a vertical profile.
    """
    console, picture = plain_console(), picture_file("--figure", figure)
    place, mission = load_world(world), mission or world
    chosen = load_mission(mission, profile)
    rule = remedy = ""
    if place.origin_deg != (chosen.frame.latitude_deg, chosen.frame.longitude_deg):
        rule = f"the mission's origin differs from that of the world, {place.origin_deg}"
        remedy = "Give the mission of this world."
    elif chosen.near is not None:
        rule = "its scanner is a sensor of near things, and only a terrain radar is simulated here"
        remedy = f"Fly it: scripts/fly {mission}."
    elif not chosen.targets_ne_m:
        rule = "its targets come from the vehicle, and there is none here"
        remedy = "Give one with [[targets]]."
    if rule:
        raise InputError("MISSION", mission, rule, remedy)
    with console.status(LOADS):
        load_kernel()
    began_s, task = time.perf_counter(), chosen.task
    start_nea_m, targets_ne_m = (*place.start_ne_m, task.take_off_amsl_m), chosen.targets_ne_m
    flown = library.fly(
        place.terrain, task, start_nea_m=start_nea_m, targets_ne_m=targets_ne_m,
        known=chosen.known, seed=seed,
    )  # fmt: skip
    flight, took_s = flown.details, time.perf_counter() - began_s
    console.print(plans_table(tuple(flight.plans)))
    from companion.views.figure import draw_offline  # slow to import

    with writing("--figure", picture):
        length_m = draw_offline(flight, chosen, true_map(place.terrain, flight.known), picture)
    legs = counted(len(flight.legs), "subpath")
    summary = f"{legs}, {length_m / 1000:.1f} km, planned in {took_s:.1f} s"
    console.out(f"{summary}; picture: {picture}", highlight=False)
    if flown.why:
        raise FlightFailed(flown.why, "")


@app.command("report")
def report_command(
    run_dir: Annotated[Path, typer.Argument(metavar="RUN_DIR", help="Of a flight, ended or not.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="By default RUN_DIR/report.html.")
    ] = None,
) -> None:
    """Explain a flight on one page: how it went and why, maps, plans, health, events.

    The page is one file that opens without a network, and prints.
    """
    from companion.replay.exporting import write_report  # slow to import

    with plain_console(stderr=True).status("reading the flight"):
        lines = write_report(run_dir, out)
    for line in lines:
        plain_console().out(line, highlight=False)


@app.command("check")
def check_command(mission: MissionArgument, profile: ProfileOption = None) -> None:
    """Check a mission file and say in words what the mission will do."""
    console = plain_console(soft_wrap=True)
    chosen = load_mission(mission, profile)
    console.print(mission_summary(chosen), highlight=False, markup=False)
    for note in chosen.notes:
        console.out(f"note: {note}", highlight=False)


@app.command("schema")
def schema_command(
    document: Annotated[
        Document,
        typer.Argument(metavar="WHAT", help="mission, journal or status.", show_default=False),
    ],
) -> None:
    """Print a JSON schema: of mission.toml, of a line of journal.jsonl, or of `fly --json`.

    An editor that knows it completes and checks a mission as it is written. Of world.toml:
    **vehicle-sim --schema**.
    """
    typer.echo(json.dumps(schema_of(document), indent=2))


def _print_version(wanted: bool) -> None:
    if wanted:
        plain_console().print(version("companion"), highlight=False)
        raise typer.Exit


_VERSION = typer.Option(
    "--version", is_eager=True, callback=_print_version, help="Print the version and exit."
)


@app.callback()
def _common(*, _version: Annotated[bool, _VERSION] = False) -> None:
    """Options that come before the command."""


def _make_streams_usable() -> None:
    """Closed standard streams become empty ones; what they cannot encode is written as numbers."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115, PTH123 - kept
        elif isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="backslashreplace")


def main() -> None:
    """Entry point: every expected failure is one line and an exit code."""
    _make_streams_usable()
    try:
        code = app(standalone_mode=False)
    except CompanionError as error:
        sys.stderr.write(f"error: {error}\n")
        sys.exit(error.exit_code)
    except typer.Abort:
        sys.exit(_INTERRUPTED)
    except _USAGE_ERROR as error:
        message = str(getattr(error, "format_message", error.__str__)())
        text = printable(" ".join(message.split()))
        if text:  # without: the help has been shown
            sys.stderr.write(f"error: {text.rstrip('.')}. See companion --help.\n")
        sys.exit(InputError.exit_code)
    except Exception as error:  # noqa: BLE001 - whatever it is, a crash has a code of its own
        if isinstance(error, OSError) and error.filename is None and error.errno in _NO_OUTPUT:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # for what is not yet written
            sys.stderr.write(f"error: the output cannot be written ({error.strerror})\n")
            sys.exit(InputError.exit_code)
        traceback.print_exc()
        sys.exit(_CRASHED)
    sys.exit(code if isinstance(code, int) else 0)


# --- the beginning of a command


@final
class _Shows(NamedTuple):
    """Who is told of a flight."""

    console: Console
    output: PatientOutput  # what the console writes to
    machine: MachineLines


def _chosen(
    mission: MissionFile, profile: ProfileName | None, system: int | None, console: Console
) -> Mission:
    """The mission, for the vehicle that was asked for; what was assumed or left out is said."""
    chosen = mission.mission(profile)
    for note in chosen.notes:
        console.out(f"note: {note}", highlight=False)
    return chosen if system is None else replace(chosen, system_id=system)


def _as_begun(mission: str, folder: Path | None) -> MissionFile:
    """The mission of a run folder as it was flown, even if its file has changed since."""
    if folder is None:
        rule = "there is no flight to go on with"
        raise InputError("--resume", True, rule, "Give the run folder with --out.")
    if not (folder / "mission.toml").is_file():
        return read_mission(mission)
    refuse_older(folder)
    given, begun = None, read_mission(str(folder / "mission.toml"))
    with contextlib.suppress(InputError):
        given = read_mission(mission).name
    if given is not None and begun.name is not None and given != begun.name:
        rule = f"the flight in {folder} is of another mission, {begun.name!r}"
        raise InputError("MISSION", mission, rule, "Give that one, or a new folder with --out.")
    return begun


def _signing(file: Path | None) -> tuple[Signing | None, Callable[[], None]]:
    """What signs the link, if it is signed, and keeps its time stamp for the next flight."""
    if file is None:
        return None, lambda: None
    key = SigningKey(file)
    return key.signing, key.save


def _flown(
    session: Session,
    connect: str,
    folder_path: Path,
    mission: MissionFile,
    keep_time: Callable[[], None],
    recalled: ResumeData | None,
    shows: _Shows,
) -> FlightSummary:
    """Fly a session, record it, and show how it went.

    recalled: what there was of the flight that is gone on with; None: it is a new one.
    """
    console, began, lockstep = shows.console, datetime.now(UTC), session.context.lockstep
    text, beside = mission.files()
    with contextlib.ExitStack() as until_shown:
        with (
            open_link(connect) as link,
            RunFolder(
                folder_path,
                mission_toml=text,
                beside=beside,
                epoch_us=round(began.timestamp() * 1e6),
                resume=recalled is not None,
                durable=not lockstep,
            ) as folder,
            Progress(console, shows.output) as progress,
        ):
            stop_asked = until_shown.enter_context(stop_signals())
            person = None
            if not (session.context.go or session.context.shadow) and sys.stdin.isatty():
                say = partial(console.out, highlight=False)
                person = until_shown.enter_context(Terminal(sys.stdin, say))
            begun = FlightBegun(
                schema=SCHEMA,
                version=VERSION,
                mission=session.mission.name,
                run_folder=str(folder.path),
                profile=session.mission.task.settings.profile.name,
                seed=session.context.seed,
                lockstep=lockstep,
                shadow=session.context.shadow,
                companion=version("companion"),
            )
            shows.machine.say(begun)
            keys = ("mission", "seed", "profile", "lockstep")
            folder.header({name: getattr(begun, name) for name in keys})

            def show(flown: FlightSummary) -> None:
                status = flight_status(flown)
                progress.show(status)
                shows.machine.show(status)

            flown = fly(
                session,
                link,
                folder,
                on_progress=show,
                stop_asked=lambda: bool(stop_asked),
                person=person,
                in_flight=recalled is not None,
                persist=keep_time,
            )
            facts: dict[str, object] = {
                "companion": begun.companion,
                "began": began.isoformat(),
                "connect": connect,
                "machine": platform.platform(),
                "python": platform.python_version(),
                "wall_s": flown.elapsed_s,
                "times_real_time": flown.times_real_time,
                "planning_s": flown.plans_s,
            }
            folder.run_json(facts)
        shows.machine.say(flight_status(flown))
        shows.machine.end = flown.end
        flown.resumed = recalled is not None and recalled.resume is not None
        _show(flown, folder, console, draws=len(stop_asked) < 2)  # who asks twice will not wait
    return flown


# --- the end of a command


def _show(flown: FlightSummary, folder: RunFolder, console: Console, *, draws: bool) -> None:
    """The summary and the picture of a flight; on a full disk, or in haste, no picture."""
    lines, picture = [f"run folder: {folder.path}"], folder.path / "flight.png"
    if folder.failure is not None:
        lines.insert(0, f"recording stopped: {folder.failure}")
    console.print(flight_table(flown))
    try:
        if flown.heard and draws:
            from companion.views.figure import draw_flown  # slow to import

            with writing("picture", picture):
                draw_flown(flown, picture)
    except InputError as error:
        lines.insert(0, f"no picture: {error.rule}")
    for line in lines:
        console.out(line, highlight=False)


def _exit_as_it_ended(flown: FlightSummary, connect: str) -> None:
    end = flown.end
    assert end is not None  # as `fly` promises
    if end.outcome is Outcome.FAILED:
        reason, remedy = end.reason, end.remedy
        failed = flown.died or flown.session.state.reason is Reason.PLANNER_DIED
        if not (flown.heard or failed):
            reason, remedy = not_heard(flown.session)
            reason = f"--connect = {connect!r}: {reason}"
        raise (FlightInterrupted if flown.may_go_on else FlightFailed)(reason, remedy)
    if end.outcome is Outcome.STOPPED:
        raise typer.Exit(_INTERRUPTED)
