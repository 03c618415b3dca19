"""vehicle-sim: the command line.  What goes wrong is one line on stderr and an exit code."""

import errno
import importlib.metadata
import importlib.util
import json
import math
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from vehicle_sim.autopilot.factory import HIGHEST_ID, personality_of, with_own_id
from vehicle_sim.errors import InputError, SimulatorError
from vehicle_sim.faults import Timeline
from vehicle_sim.links import Link, open_link, parse_endpoint
from vehicle_sim.parameters import Firmware
from vehicle_sim.server import Server, stopping_on_signals, truth_file
from vehicle_sim.simulation import Simulation
from vehicle_sim.stations import Station, Stations
from vehicle_sim.world import VehicleKind, World, flat_world, read_world

HELP = """A simulated drone to test a companion computer with.

Flies a point-mass copter or plane with an autopilot like ArduPilot's or PX4's, GPS and a terrain
radar, and speaks MAVLink 2 over UDP or TCP.  WORLD is the name of a bundled world, or the path of a
world.toml; without it there is level ground at --home.

Start it in one terminal and the companion in another:

\b
    vehicle-sim environment-1 --lockstep
    companion fly environment-1 --connect udpin:127.0.0.1:14540 --lockstep

With --lockstep both fly as fast as they can and every run is the same; without, the vehicle flies
in real time (or --speedup times that) whatever the companion does.  Ctrl-C ends it.  More, and the
faults: docs/simulator.md.
"""

app = typer.Typer(add_completion=False, rich_markup_mode=None)
_CONNECT: Final = "udpout:127.0.0.1:14540"
_HOME: Final = "47.397742,8.545594,488,0"
_PX4_TIME_OUTS_S: Final = {"COM_OF_LOSS_T": 1.0, "COM_DL_LOSS_T": 10.0, "COM_OBC_LOSS_T": 5.0}
_ROW_M: Final = 10.0
"""Between vehicles of --count: they stand in a row to the east."""


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(importlib.metadata.version("companion"))
        raise typer.Exit


def _schema(wanted: bool) -> None:
    if wanted:
        typer.echo(json.dumps(World.model_json_schema(), indent=2))
        raise typer.Exit


def _option(about: str, metavar: str | None = None, default: str | bool = True) -> Any:
    return typer.Option(help=about, metavar=metavar, show_default=default)


def _flag(name: str, about: str, callback: Any = None) -> Any:
    return typer.Option(name, help=about, callback=callback)


_Endpoints = "udpout:HOST:PORT, udpin:HOST:PORT or tcpin:HOST:PORT; once for each link."
_Place = _option("Without WORLD.", "LAT,LON,ALT,HEADING", _HOME)
_Range = _option("Without WORLD: a terrain radar that sees so far.", "METRES")
_Params = _option("A parameter of the autopilot, or a SIM_ one.", "NAME=VALUE")
_Faults = _option("A timeline of faults, one a line.", "FILE")
_Lockstep = _flag("--lockstep", "Advance only when the companion has answered.")
_Step = _option("Between the vehicles' ports; 0: all on the same.", "K")
_Strict = _flag("--strict", "End with 1 at what the real one does not survive.")
_Schema = _flag("--schema", "Print the JSON schema of world.toml.", _schema)
_Out = _option("Write DIR/truth.jsonl: where it really was.", "DIR")


@app.command(help=HELP)
def fly(
    world: Annotated[str | None, typer.Argument(metavar="WORLD", show_default=False)] = None,
    connect: Annotated[list[str] | None, _option(_Endpoints, default=_CONNECT)] = None,
    autopilot: Annotated[Firmware | None, _option("Without WORLD.", default="ardupilot")] = None,
    vehicle: Annotated[VehicleKind | None, _option("Without WORLD.", default="copter")] = None,
    home: Annotated[str | None, _Place] = None,
    scan_range: Annotated[float | None, _Range] = None,
    param: Annotated[list[str] | None, _Params] = None,
    faults: Annotated[Path | None, _Faults] = None,
    speedup: Annotated[float | None, _option("Times real time.", "N", default="1")] = None,
    lockstep: Annotated[bool, _Lockstep] = False,
    count: Annotated[int, _option("So many vehicles, with rising system ids.", "N")] = 1,
    port_step: Annotated[int, _Step] = 0,
    strict: Annotated[bool, _Strict] = False,
    seed: Annotated[int, _option("Of all that is random.", "S")] = 0,
    out: Annotated[Path | None, _Out] = None,
    duration: Annotated[float | None, _option("End after S seconds of vehicle time.", "S")] = None,
    schema: Annotated[bool, _Schema] = False,  # noqa: ARG001
    version: Annotated[bool, _flag("--version", "Say which version this is.", _version)] = False,  # noqa: ARG001
) -> None:
    """Parse, then fly."""
    endpoints = [parse_endpoint(text) for text in connect or [_CONNECT]]
    if speedup is not None and lockstep:
        rule = "lockstep sets its own pace"
        raise InputError("--speedup", speedup, rule, "Leave out one of the two.")
    _must_lie("--speedup", speedup, 0.01, 1000.0)
    _must_lie("--duration", duration, 1e-3, 1e7)
    _must_lie("--seed", seed, 0, 2**63)
    _must_lie("--scan-range", scan_range, 1e-3, 1e6)
    _must_lie("--port-step", port_step, 0, 1000)
    if world is None:
        flown = _flat(autopilot or "ardupilot", vehicle or "copter", home or _HOME, scan_range)
    else:
        given = {"autopilot": autopilot, "vehicle": vehicle, "home": home, "scan-range": scan_range}
        for option, value in given.items():
            if value is not None:
                rule = "the world file says that itself"
                raise InputError(f"--{option}", value, rule, "Leave out one of the two.")
        flown = read_world(_world_path(world))
    worlds = _row(_with_parameters(flown, param or [], speedup or 1.0), count)
    timeline = "" if faults is None else _timeline(faults)
    byte_streams = {n for n, endpoint in enumerate(endpoints) if endpoint.kind == "tcpin"}
    with ExitStack() as stack:
        stop, stations, links = stack.enter_context(stopping_on_signals()), list[Station](), []
        for k, own_world in enumerate(worlds):
            shares = k > 0 and port_step == 0
            simulation = Simulation(
                own_world,
                seed=seed + k,
                links=len(endpoints),
                byte_streams=byte_streams,
                forwards_all=not shares,
                faults=timeline,
            )
            if k == 0:  # who is silent for seconds, because it compiles, is taken to be lost
                simulation.warm_up()
            name = f"truth-{k + 1}.jsonl" if k else "truth.jsonl"
            truth = stack.enter_context(truth_file(out, name))
            if not shares:
                links = [open_link(endpoint.shifted(k * port_step)) for endpoint in endpoints]
                for link in links:
                    stack.callback(link.close)
            stations.append(Station(simulation=simulation, links=links, truth=truth))
        pace = "lockstep" if lockstep else f"{speedup or 1.0:g} x real time"
        _say(f"{_opening(worlds, stations[0].links)}, {pace}")
        server = Server(
            stations=Stations(stations, stop),
            say=_say,
            lockstep=lockstep,
            speedup=speedup or 1.0,
            duration_s=duration or math.inf,
            strict=strict,
        )
        wall_s = server.run()
    simulations = [station.simulation for station in stations]
    flown_s = max(simulation.now_us for simulation in simulations) * 1e-6
    times = flown_s / wall_s if wall_s > 0.0 else 0.0
    ends = "; ".join(simulation.outcome() for simulation in simulations[:3])
    _say(f"{flown_s:.1f} s of vehicle time in {wall_s:.1f} s ({times:.1f} x real time); {ends}")


def _say(line: str) -> None:
    """Print and flush: the parent process waits for the port in the first line.

    A reader that has gone, or a full disk, does not end a flight.
    """
    try:
        typer.echo(line)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _opening(worlds: list[World], links: Sequence[Link]) -> str:
    vehicle, last = worlds[0].vehicle, worlds[-1].vehicle.system_id
    systems = f"system {vehicle.system_id}" + (f" to {last}" if len(worlds) > 1 else "")
    on = ", ".join(str(link.endpoint) for link in links)
    return f"{worlds[0].name}: {vehicle.kind} with {vehicle.autopilot} as {systems}, {on}"


# --- what the options say -------------------------------------------------------------------------


def _must_lie(option: str, value: float | None, least: float, most: float, why: str = "") -> None:
    if value is not None and not least <= value <= most:  # nor is NaN
        rule = f"must be from {least:g} to {most:g}{why}"
        raise InputError(option, value, rule, "Give another number.")


def _flat(firmware: Firmware, kind: VehicleKind, home: str, scan_range_m: float | None) -> World:
    """Level ground at the height of --home."""
    names = ("latitude_deg", "longitude_deg", "altitude_amsl_m", "heading_deg")
    try:
        place: dict[str, Any] = dict(zip(names, map(float, home.split(",")), strict=True))
        return flat_world(kind, firmware, scan_range_m=scan_range_m, **place)
    except ValueError:  # also pydantic's, of a place that is not on earth
        rule = "must be LAT,LON,ALT,HEADING within 85 deg, 180 deg, -1000 to 20000 m, 360 deg"
        raise InputError("--home", home, rule, f"Try {_HOME}.") from None


def _with_parameters(world: World, assignments: list[str], speedup: float) -> World:
    """The world, with these NAME=VALUE in place of what it says."""
    vehicle, added = world.vehicle, dict[str, float]()
    for text in assignments:
        name, _, value = text.partition("=")
        added[name] = math.nan
        with suppress(ValueError):
            added[name] = float(value)
        if not math.isfinite(added[name]):
            rule = "must be NAME=VALUE with a finite number"
            raise InputError("--param", text, rule, "Try GUID_TIMEOUT=1.")
    longer = dict[str, float]()
    if speedup != 1.0 and personality_of(vehicle).firmware.family == "px4":
        # as PX4's start script does it: a client's wall time counts
        longer = {name: math.ceil(speedup * seconds) for name, seconds in _PX4_TIME_OUTS_S.items()}
    parameters = longer | vehicle.parameters | added
    vehicle = with_own_id(vehicle.model_copy(update={"parameters": parameters}))
    return world.model_copy(update={"vehicle": vehicle})


def _row(world: World, count: int) -> list[World]:
    """The same world for each of so many vehicles, standing side by side."""
    vehicle, most = world.vehicle, HIGHEST_ID - world.vehicle.system_id + 1
    _must_lie("--count", count, 1, most, f": system ids end at {HIGHEST_ID}")
    vehicles = (
        {"system_id": vehicle.system_id + k, "east_m": vehicle.east_m + k * _ROW_M}
        for k in range(count)
    )
    return [
        world.model_copy(update={"vehicle": vehicle.model_copy(update=fields)})
        for fields in vehicles
    ]


def _timeline(file: Path) -> str:
    """The text of a file of faults, which has been read through once."""
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        rule = f"cannot be read ({getattr(error, 'strerror', None) or 'not a text file'})"
        raise InputError("--faults", str(file), rule, "Name a file with a fault a line.") from None
    Timeline(text, name=str(file))
    return text


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
    with suppress(OSError):  # of a name that is too long
        if Path(name).is_file():
            return Path(name)
    known = ", ".join(bundled) or "(none is installed)"
    remedy = f"Choose from: {known}; or give the path of a world.toml."
    raise InputError("WORLD", name, "neither a bundled world nor a file", remedy)


# --- how it ends ----------------------------------------------------------------------------------


_WRONG_OPTIONS: Final[tuple[Any, ...]] = typer.BadParameter.__bases__
"""Typer raises the parent class of its BadParameter, and has no name for it."""


def run(app: typer.Typer, program: str) -> None:
    """Run a command line and exit; `program` is how its help page is asked for."""
    code: object = 0
    try:
        code = app(standalone_mode=False)
    except SimulatorError as error:
        typer.echo(f"error: {error}", err=True)
        code = error.exit_code
    except typer.Abort:
        pass
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EPIPE, errno.EIO):
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # for what is not yet written
        sys.stderr.write(f"error: the output cannot be written ({error.strerror})\n")
        code = InputError.exit_code
    except _WRONG_OPTIONS as error:
        wrong = str(getattr(error, "format_message", error.__str__)()).rstrip(".")
        typer.echo(f"error: {wrong}. See {program} --help.", err=True)
        code = InputError.exit_code
    sys.exit(code if isinstance(code, int) else 0)


def main() -> None:
    """Entry of the console script."""
    run(app, "vehicle-sim")
