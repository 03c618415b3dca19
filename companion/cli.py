"""The command line: fly, plan, check, compare."""

import contextlib
import platform
import signal
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from enum import StrEnum
from functools import partial
from importlib.metadata import version
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer
from rich.console import Console

from companion.compare.command import compare_app
from companion.config import load_mission, load_world, mission_text
from companion.errors import CompanionError, FlightFailed, InputError
from companion.mission.events import Outcome
from companion.planner.offline import OfflineFlight, fly_offline
from companion.planner.plan import plan
from companion.runtime.compiler import Planner, load_kernel
from companion.runtime.link import UdpLink
from companion.runtime.loop import fly
from companion.session import Session
from companion.telemetry.flown import Flown
from companion.telemetry.run_folder import RunFolder
from companion.views.live import Progress
from companion.views.pictures import draw_flown, draw_offline
from companion.views.words import flight_table, mission_words, plans_table
from companion.world.known_map import empty_map
from companion.world.simulated_scan import true_map

_INTERRUPTED = 130
_LOADING = "loading the planner (compiled the first time, in some fifteen seconds)"
_USAGE_ERROR = typer.BadParameter.__bases__  # typer has no name for the class of all of them

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help=(
        "Plans a drone's path online, past mountains and radars that it knows only in part, "
        "and flies it over MAVLink.\n\n"
        "Start with **companion plan environment-1 environment-1**: no vehicle needed. "
        "Then fly it: start **vehicle-sim environment-1 --lockstep** in one terminal and "
        "**companion fly environment-1 --lockstep** in another."
    ),
)


app.add_typer(compare_app, name="compare")


class ProfileName(StrEnum):
    """How the planner takes the paper."""

    FLIGHT = "flight"
    PAPER = "paper"


MissionArgument = Annotated[
    str,
    typer.Argument(
        metavar="MISSION",
        help="A mission.toml, or a bundled name: environment-1, environment-2, valley.",
    ),
]
ProfileOption = Annotated[
    ProfileName | None,
    typer.Option(
        help="*flight*: made safe, checked before it is flown (the default). "
        "*paper*: literally as published, for comparison; not safe to fly."
    ),
]
SeedOption = Annotated[
    int, typer.Option(min=0, help="Seed of the search: the same seed plans the same path.")
]


@app.command("fly")
def fly_command(
    mission: MissionArgument,
    connect: Annotated[
        str,
        typer.Option(help="Where the vehicle is: udpin:HOST:PORT waits for it, udpout: calls it."),
    ] = "udpin:127.0.0.1:14540",
    lockstep: Annotated[
        bool,
        typer.Option(
            "--lockstep",
            help="Let a simulator that was started with --lockstep run as fast as both can.",
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(help="Run folder to write; by default runs/DATE-MISSION."),
    ] = None,
    seed: SeedOption = 1,
    profile: ProfileOption = None,
) -> None:
    """Fly a mission: wait for the vehicle, take off, plan and follow subpaths to the target.

    Writes a run folder with the telemetry log, the journal of all decisions and a picture.
    Exit code: 0 arrived, 1 the flight failed, 2 the input was wrong, 130 stopped by Ctrl-C.
    """
    console = Console()
    chosen = load_mission(mission, profile and profile.value)
    began = datetime.now(UTC)
    folder_path = out or Path("runs") / f"{began:%Y%m%d-%H%M%S}-{chosen.name}"
    session = Session(chosen, seed=seed, lockstep=lockstep)
    planner = Planner(lockstep=lockstep)
    if lockstep:  # in real time nothing waits for a compiler
        with console.status(_LOADING):
            planner.wait()
    with (
        UdpLink(connect) as link,
        RunFolder(
            folder_path, mission_toml=mission_text(mission), epoch_us=round(began.timestamp() * 1e6)
        ) as folder,
        Progress(console) as progress,
        _stop_signals() as stop_asked,
    ):
        profile_name = chosen.task.settings.profile.name
        folder.header(
            {"mission": chosen.name, "seed": seed, "profile": profile_name, "lockstep": lockstep}
        )
        flown = fly(
            session,
            link,
            folder,
            lockstep=lockstep,
            on_progress=progress.show,
            stop_asked=lambda: bool(stop_asked),
            planner=planner,
        )
        folder.run_json(_run_facts(flown, began, connect))
    _show(flown, folder, console)
    _exit_as_it_ended(flown, connect)


@app.command("plan")
def plan_command(
    world: Annotated[str, typer.Argument(metavar="WORLD", help="A world.toml or a bundled name.")],
    mission: MissionArgument,
    out: Annotated[Path, typer.Option(help="Picture to write.")] = Path("plan.png"),
    seed: SeedOption = 1,
    profile: ProfileOption = None,
) -> None:
    """Plan a mission without a vehicle: simulated scans of the world, perfect tracking.

    Writes a picture: the path in three dimensions, from above, and as a vertical profile.
    """
    console = Console()
    chosen, place = load_mission(mission, profile and profile.value), load_world(world)
    if place.origin_deg != (chosen.frame.latitude_deg, chosen.frame.longitude_deg):
        rule = f"the mission's origin differs from that of the world, {place.origin_deg}"
        raise InputError("MISSION", mission, rule, "Give the mission of this world.")
    task, limits = chosen.task, chosen.task.limits
    blank = empty_map(task.cell_m, limits.north_m, limits.east_m)
    truth = true_map(place.terrain, blank)
    with console.status(_LOADING):
        kernel = load_kernel()
    began_s = time.perf_counter()
    flight = fly_offline(
        task,
        blank=blank,
        truth=truth,
        start_nea_m=(*place.start_ne_m, chosen.take_off_amsl_m),
        targets_ne_m=chosen.targets_ne_m,
        seed=seed,
        planner=partial(plan, kernel=kernel),
    )
    took_s = time.perf_counter() - began_s
    console.print(plans_table(flight.plans))
    try:
        length_m = draw_offline(flight, chosen, truth, out)
    except (OSError, ValueError) as error:
        raise InputError("--out", str(out), f"no picture ({error})", "Give a .png file.") from error
    console.print(
        f"{len(flight.legs)} subpaths, {length_m / 1000:.1f} km, planned in {took_s:.1f} s; "
        f"picture: {out}",
        highlight=False,
        soft_wrap=True,
        markup=False,
    )
    _exit_as_planned(flight)


@app.command("check")
def check_command(mission: MissionArgument, profile: ProfileOption = None) -> None:
    """Check a mission file and say in words what the mission will do."""
    Console(soft_wrap=True).print(
        mission_words(load_mission(mission, profile and profile.value)),
        highlight=False,
        markup=False,
    )


def _print_version(wanted: bool) -> None:
    if wanted:
        Console().print(version("companion"), highlight=False)
        raise typer.Exit


@app.callback()
def _common(
    *,
    _version: Annotated[
        bool,
        typer.Option(
            "--version",
            is_eager=True,
            callback=_print_version,
            help="Print the version and exit.",
        ),
    ] = False,
) -> None:
    """Options that come before the command."""


def main() -> None:
    """Entry point: every expected failure is one line and an exit code."""
    try:
        code = app(standalone_mode=False)
    except CompanionError as error:
        sys.stderr.write(f"error: {error}\n")
        sys.exit(error.exit_code)
    except typer.Abort:
        sys.exit(_INTERRUPTED)
    except Exception as error:
        if not isinstance(error, _USAGE_ERROR):
            raise
        text = str(getattr(error, "format_message", error.__str__)())
        if text:  # without: the help has been shown
            sys.stderr.write(f"error: {text.rstrip('.')}. See companion --help.\n")
        sys.exit(InputError.exit_code)
    sys.exit(code if isinstance(code, int) else 0)


# --- the end of a command


def _show(flown: Flown, folder: RunFolder, console: Console) -> None:
    """The summary and the picture of a flight; without a terminal, or on a full disk, less."""
    lines = [f"run folder: {folder.path}"]
    if folder.failure is not None:
        lines.insert(0, f"recording stopped: {folder.failure}")
    with contextlib.suppress(OSError):
        console.print(flight_table(flown))
    try:
        if flown.heard:
            draw_flown(flown, folder.path / "flight.png")
    except OSError as error:
        lines.insert(0, f"no picture: {error}")
    with contextlib.suppress(OSError):
        for line in lines:
            console.print(line, soft_wrap=True, highlight=False, markup=False)


def _exit_as_it_ended(flown: Flown, connect: str) -> None:
    end = flown.end
    if end is None or end.outcome is Outcome.FAILED:
        reason = "the flight did not end" if end is None else end.reason
        remedy = "" if end is None else end.remedy
        if not flown.heard:
            reason = f"--connect = {connect!r}: no vehicle was heard within 10 s"
            remedy = "Start the vehicle, or give the address that it sends to."
            if others := sorted(flown.session.other_systems):
                wanted = flown.session.mission.system_id
                reason = f"vehicle.system_id = {wanted}: only system {others[0]} was heard"
                remedy = "Write the vehicle's own system id into the mission."
        raise FlightFailed(reason, remedy)
    if end.outcome is Outcome.STOPPED:
        raise typer.Exit(_INTERRUPTED)


def _exit_as_planned(flight: OfflineFlight) -> None:
    if flight.failure is not None:
        failure = flight.failure
        broken = f" (broken: {', '.join(failure.broken)})" if failure.broken else ""
        raise FlightFailed(f"{failure.refusal.value}{broken}", "")
    if not flight.legs[-1].reaches_target:
        raise FlightFailed("the target was not reached", "Look at the picture for a trap.")


@contextlib.contextmanager
def _stop_signals() -> Iterator[list[int]]:
    """Collect what would end the program: the vehicle has to be told first."""
    received: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        received.append(number)

    before = {
        each: signal.signal(each, note)
        for name in ("SIGINT", "SIGTERM", "SIGHUP")
        if (each := getattr(signal, name, None)) is not None
    }
    try:
        yield received
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


def _run_facts(flown: Flown, began: datetime, connect: str) -> dict[str, object]:
    return {
        "companion": version("companion"),
        "began": began.isoformat(),
        "connect": connect,
        "machine": platform.platform(),
        "python": platform.python_version(),
        "wall_s": flown.elapsed_s,
        "times_real_time": flown.times_real_time,
        "planning_s": flown.plans_s,
    }
