"""vehicle-sim: the command line."""

import importlib.metadata
import importlib.util
import sys
from pathlib import Path
from typing import Annotated

import typer

from vehicle_sim.errors import InputError, SimulatorError
from vehicle_sim.server import Link, Server, Settings, stopping_on_signals, truth_file
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import World, read_world

HELP = """A simulated drone to test a companion computer with.

Flies a point-mass copter with an ArduPilot-like autopilot, GPS and terrain-scanning radar, and
speaks MAVLink 2 over UDP.  WORLD is the name of a bundled world, or the path of a world.toml.

Start it in one terminal and the companion in another:

\b
    vehicle-sim environment-1 --lockstep
    companion fly environment-1 --connect udpin:127.0.0.1:14540 --lockstep

With --lockstep both fly as fast as they can and every run is the same; without, the vehicle flies
in real time (or --speedup times that) whatever the companion does.  Ctrl-C ends it.
"""

app = typer.Typer(add_completion=False, rich_markup_mode=None)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(importlib.metadata.version("companion"))
        raise typer.Exit


@app.command(help=HELP)
def fly(
    world: Annotated[str, typer.Argument(metavar="WORLD", show_default=False)],
    connect: Annotated[
        str, typer.Option(help="Where the companion listens: udpout:HOST:PORT.")
    ] = "udpout:127.0.0.1:14540",
    speedup: Annotated[
        float | None, typer.Option(help="Times real time.", metavar="N", show_default="1")
    ] = None,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="Advance only when the companion has answered.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Of all that is random.", metavar="S")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(help="Write DIR/truth.jsonl: where it really was.", metavar="DIR"),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(help="End after S seconds of vehicle time.", metavar="S"),
    ] = None,
    version: Annotated[  # noqa: ARG001
        bool, typer.Option("--version", help="Say which version this is.", callback=_version)
    ] = False,
) -> None:
    """Parse, then fly."""
    settings = _settings(connect, speedup, lockstep=lockstep, duration_s=duration)
    if seed < 0:
        raise InputError("--seed", seed, "must not be negative", "Give 0 or more.")
    truth_world = read_world(_world_path(world))
    pace = "lockstep" if lockstep else f"{settings.speedup:g} x real time"
    with (
        stopping_on_signals() as stop,
        truth_file(out) as truth,
        Link(settings.host, settings.port) as link,
    ):
        typer.echo(_opening(truth_world, settings, pace))
        simulation = Simulation(truth_world, seed=seed)
        server = Server(simulation, link, settings, stop, truth=truth, say=typer.echo)
        wall_s = server.run()
    flown_s = simulation.now_us * 1e-6
    times = flown_s / wall_s if wall_s > 0.0 else 0.0
    typer.echo(
        f"{flown_s:.1f} s of vehicle time in {wall_s:.1f} s ({times:.1f} x real time); "
        f"{simulation.outcome()}"
    )


def _opening(world: World, settings: Settings, pace: str) -> str:
    vehicle = world.vehicle
    return (
        f"{world.name}: {vehicle.kind} with {vehicle.autopilot} as system {vehicle.system_id}, "
        f"to udp {settings.host}:{settings.port}, {pace}"
    )


def _settings(
    connect: str, speedup: float | None, *, lockstep: bool, duration_s: float | None
) -> Settings:
    """Options that have been checked."""
    if speedup is not None and lockstep:
        raise InputError(
            "--speedup", speedup, "lockstep sets its own pace", "Leave out one of the two."
        )
    if speedup is not None and not 0.01 <= speedup <= 1000.0:
        raise InputError("--speedup", speedup, "must be from 0.01 to 1000", "Try 10.")
    if duration_s is not None and not 0.0 < duration_s < 1e7:
        raise InputError("--duration", duration_s, "must be more than 0 s", "Try 600.")
    kind, _, address = connect.partition(":")
    host, _, port = address.rpartition(":")
    if kind != "udpout" or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError(
            "--connect", connect, "must be udpout:HOST:PORT", "Try udpout:127.0.0.1:14540."
        )
    return Settings(
        host=host.strip("[]"),
        port=int(port),
        lockstep=lockstep,
        speedup=1.0 if speedup is None else speedup,
        duration_s=duration_s,
    )


def bundled_worlds() -> dict[str, Path]:
    """The worlds that are installed beside the companion, found without running its code."""
    spec = importlib.util.find_spec("companion")
    folders = [] if spec is None else list(spec.submodule_search_locations or [])
    files = [f for folder in folders for f in Path(folder).glob("environments/*/world.toml")]
    return {f.parent.name: f for f in sorted(files)}


def _world_path(name: str) -> Path:
    bundled = bundled_worlds()
    if name in bundled:
        return bundled[name]
    if Path(name).is_file():
        return Path(name)
    known = ", ".join(bundled) or "(none is installed)"
    rule = "neither a bundled world nor a file"
    raise InputError(
        "WORLD", name, rule, f"Choose from: {known}; or give the path of a world.toml."
    )


def _wrong_options(error: Exception) -> str | None:
    """What is wrong with the options as such; None if the error is something else.

    Typer raises the parent class of its BadParameter, and has no name for it.
    """
    if not isinstance(error, typer.BadParameter.__bases__):
        return None
    return str(getattr(error, "format_message", error.__str__)())


def main() -> None:
    """Entry of the console script: errors are one line and an exit code."""
    try:
        code = app(standalone_mode=False)
    except SimulatorError as error:
        typer.echo(f"error: {error}", err=True)
        sys.exit(error.exit_code)
    except typer.Abort:
        sys.exit(0)
    except Exception as error:
        wrong = _wrong_options(error)
        if wrong is None:
            raise
        typer.echo(f"error: {wrong.rstrip('.')}. See vehicle-sim --help.", err=True)
        sys.exit(InputError.exit_code)
    sys.exit(code if isinstance(code, int) else 0)


if __name__ == "__main__":
    main()
