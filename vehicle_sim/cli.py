"""vehicle-sim: the command line."""

import dataclasses
import importlib.metadata
import importlib.util
import math
import os
import sys
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Annotated

import typer

from vehicle_sim.autopilots.factory import personality_of, with_own_ids
from vehicle_sim.errors import InputError
from vehicle_sim.faults import Timeline
from vehicle_sim.links import Endpoint, Link, open_link, parse_endpoint
from vehicle_sim.server import Server, Settings, Station, stopping_on_signals, truth_files
from vehicle_sim.simulation import Simulation
from vehicle_sim.terminal import run
from vehicle_sim.world import World, flat_world, read_world

HELP = """A simulated drone to test a companion computer with.

Flies a point-mass copter or plane with an autopilot like ArduPilot's or PX4's, GPS and a terrain
radar, and speaks MAVLink 2 over UDP or TCP.  WORLD is the name of a bundled world, or the path of a
world.toml; without it there is level ground at --home.

Start it in one terminal and the companion in another:

\b
    vehicle-sim environment-1 --lockstep
    companion fly environment-1 --connect udpin:127.0.0.1:14540 --lockstep

With --lockstep both fly as fast as they can and every run is the same; without, the vehicle flies
in real time (or --speedup times that) whatever the companion does.  Ctrl-C ends it.

\b
    vehicle-sim --autopilot px4 --vehicle plane --faults faults.txt
    vehicle-sim --connect tcpin:127.0.0.1:5760 --connect udpout:127.0.0.1:14550
    vehicle-sim --count 5 --port-step 10

Faults are one line each, such as "at 120 s for 30 s: gps_off": see docs/simulator.md.
"""

app = typer.Typer(add_completion=False, rich_markup_mode=None)
_HOME = "47.397742,8.545594,488,0"
_MAX_VEHICLES = 250
_PX4_TIME_OUTS_S = {
    "COM_OF_LOSS_T": 1.0,
    "COM_DL_LOSS_T": 10.0,
    "COM_OBC_LOSS_T": 5.0,
}
_MAX_SHOWN = 12
_MAX_SOCKETS = 500
_ROW_M = 10.0
"""Between vehicles of --count: they stand in a row to the east."""


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(importlib.metadata.version("companion"))
        raise typer.Exit


_Connect = Annotated[
    list[str] | None,
    typer.Option(
        help="udpout:HOST:PORT, udpin:HOST:PORT or tcpin:HOST:PORT; once for each link.",
        show_default="udpout:127.0.0.1:14540",
    ),
]
_Autopilot = Annotated[
    str | None, typer.Option(help="Without WORLD: ardupilot or px4.", show_default="ardupilot")
]
_Kind = Annotated[
    str | None, typer.Option(help="Without WORLD: copter or plane.", show_default="copter")
]
_Home = Annotated[
    str | None,
    typer.Option(help="Without WORLD.", metavar="LAT,LON,ALT,HEADING", show_default=_HOME),
]
_Scan = Annotated[
    float | None,
    typer.Option(help="Without WORLD: a terrain radar that sees so far.", metavar="METRES"),
]
_Param = Annotated[
    list[str] | None,
    typer.Option(help="A parameter of the autopilot, or a SIM_ one.", metavar="NAME=VALUE"),
]
_Faults = Annotated[
    Path | None, typer.Option(help="A timeline of faults, one a line.", metavar="FILE")
]
_Speedup = Annotated[
    float | None, typer.Option(help="Times real time.", metavar="N", show_default="1")
]
_Lockstep = Annotated[
    bool, typer.Option("--lockstep", help="Advance only when the companion has answered.")
]
_Count = Annotated[int, typer.Option(help="So many vehicles, with rising system ids.", metavar="N")]
_PortStep = Annotated[
    int, typer.Option(help="Between the vehicles' ports; 0: all on the same.", metavar="K")
]
_Strict = Annotated[
    bool, typer.Option("--strict", help="End with 1 at what the real one does not survive.")
]
_Seed = Annotated[int, typer.Option(help="Of all that is random.", metavar="S")]
_Out = Annotated[
    Path | None, typer.Option(help="Write DIR/truth.jsonl: where it really was.", metavar="DIR")
]
_Duration = Annotated[
    float | None, typer.Option(help="End after S seconds of vehicle time.", metavar="S")
]
_Version = Annotated[
    bool, typer.Option("--version", help="Say which version this is.", callback=_version)
]


@app.command(help=HELP)
def fly(
    world: Annotated[str | None, typer.Argument(metavar="WORLD", show_default=False)] = None,
    connect: _Connect = None,
    autopilot: _Autopilot = None,
    vehicle: _Kind = None,
    home: _Home = None,
    scan_range: _Scan = None,
    param: _Param = None,
    faults: _Faults = None,
    speedup: _Speedup = None,
    lockstep: _Lockstep = False,
    count: _Count = 1,
    port_step: _PortStep = 0,
    strict: _Strict = False,
    seed: _Seed = 0,
    out: _Out = None,
    duration: _Duration = None,
    version: _Version = False,  # noqa: ARG001
) -> None:
    """Parse, then fly."""
    endpoints = [parse_endpoint(each) for each in connect or ["udpout:127.0.0.1:14540"]]
    settings = _settings(speedup, lockstep=lockstep, duration_s=duration, strict=strict)
    if seed < 0:
        raise InputError("--seed", seed, "must not be negative", "Give 0 or more.")
    flown = _paced(_world(world, autopilot, vehicle, home, scan_range), settings)
    truth_world = _with_parameters(flown, param or [])
    worlds = _row(truth_world, count, port_step)
    timeline = "" if faults is None else _timeline(faults, truth_world)
    byte_streams = {n for n, endpoint in enumerate(endpoints) if endpoint.kind == "tcpin"}
    simulations = [
        Simulation(
            each,
            seed=seed + k,
            links=len(endpoints),
            byte_streams=byte_streams,
            forwards_all=k == 0 or port_step > 0,
            faults=timeline,
        )
        for k, each in enumerate(worlds)
    ]
    if port_step and count * len(endpoints) > _MAX_SOCKETS:
        rule = f"with {len(endpoints)} links each it would need more than {_MAX_SOCKETS} sockets"
        raise InputError("--count", count, rule, "Leave out --port-step, or take fewer.")
    names = ["truth.jsonl" if k == 0 else f"truth-{k + 1}.jsonl" for k in range(count)]
    with ExitStack() as stack:
        stop = stack.enter_context(stopping_on_signals())
        truths = stack.enter_context(truth_files(out, names))
        opened = [
            _open_all(stack, [each.shifted(k * port_step) for each in endpoints])
            for k in range(count if port_step else 1)
        ]
        used = [link.endpoint for links in opened for link in links]
        _say(_opening(worlds, used, settings))
        stations = [
            Station(simulation=each, links=opened[k if port_step else 0], truth=truths[k])
            for k, each in enumerate(simulations)
        ]
        wall_s = Server(stations, settings, stop, say=_say).run()
    _say(_ending(simulations, wall_s))


def _ending(simulations: list[Simulation], wall_s: float) -> str:
    flown_s = max(each.now_us for each in simulations) * 1e-6
    times = flown_s / wall_s if wall_s > 0.0 else 0.0
    outcomes = "; ".join(each.outcome() for each in simulations[:3])
    return (
        f"{flown_s:.1f} s of vehicle time in {wall_s:.1f} s ({times:.1f} x real time); {outcomes}"
    )


def _say(line: str) -> None:
    """Print and flush: the parent process waits for the port in the first line.

    A reader that has gone, or a full disk, does not end a flight.
    """
    try:
        typer.echo(line)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _open_all(stack: ExitStack, endpoints: list[Endpoint]) -> list[Link]:
    links = []
    for endpoint in endpoints:
        link = open_link(endpoint)
        stack.callback(link.close)
        links.append(link)
    return links


def _opening(worlds: list[World], endpoints: list[Endpoint], settings: Settings) -> str:
    vehicle = worlds[0].vehicle
    pace = "lockstep" if settings.lockstep else f"{settings.speedup:g} x real time"
    last = worlds[-1].vehicle.system_id
    systems = f"system {vehicle.system_id}" + (f" to {last}" if len(worlds) > 1 else "")
    on = ", ".join(map(str, endpoints[:_MAX_SHOWN]))
    on += f" and {len(endpoints) - _MAX_SHOWN} more" if len(endpoints) > _MAX_SHOWN else ""
    return f"{worlds[0].name}: {vehicle.kind} with {vehicle.autopilot} as {systems}, {on}, {pace}"


def _settings(
    speedup: float | None, *, lockstep: bool, duration_s: float | None, strict: bool
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
    return Settings(
        lockstep=lockstep,
        speedup=1.0 if speedup is None else speedup,
        duration_s=duration_s,
        strict=strict,
    )


def _world(
    name: str | None,
    autopilot: str | None,
    vehicle: str | None,
    home: str | None,
    scan_range_m: float | None,
) -> World:
    """The world of this name, or level ground."""
    given: dict[str, object] = {
        "--autopilot": autopilot,
        "--vehicle": vehicle,
        "--home": home,
        "--scan-range": scan_range_m,
    }
    if name is not None:
        for option, value in given.items():
            if value is not None:
                rule = "the world file says that itself"
                raise InputError(option, value, rule, "Leave out one of the two.")
        return read_world(_world_path(name))
    firmware, kind = autopilot or "ardupilot", vehicle or "copter"
    if firmware not in ("ardupilot", "px4"):
        raise InputError("--autopilot", firmware, "must be ardupilot or px4", "Choose one.")
    if kind not in ("copter", "plane"):
        raise InputError("--vehicle", kind, "must be copter or plane", "Choose one.")
    if scan_range_m is not None and not 0.0 < scan_range_m < 1e6:
        raise InputError("--scan-range", scan_range_m, "must be more than 0 m", "Try 2000.")
    latitude_deg, longitude_deg, altitude_m, heading_deg = _home(home or _HOME)
    return flat_world(
        kind,  # type: ignore[arg-type]
        firmware,  # type: ignore[arg-type]
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        altitude_amsl_m=altitude_m,
        heading_deg=heading_deg,
        scan_range_m=scan_range_m,
    )


def _home(text: str) -> tuple[float, float, float, float]:
    remedy = f"Try {_HOME}."
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 4 or not all(map(math.isfinite, values)):
        raise InputError("--home", text, "must be LAT,LON,ALT,HEADING in deg, m, deg", remedy)
    latitude_deg, longitude_deg, altitude_m, heading_deg = values
    in_range = abs(latitude_deg) <= 85.0 and abs(longitude_deg) <= 180.0
    if not in_range or not -1000.0 <= altitude_m <= 20000.0 or abs(heading_deg) > 360.0:
        rule = "must be within 85 deg, 180 deg, -1000 to 20000 m, 360 deg"
        raise InputError("--home", text, rule, remedy)
    return latitude_deg, longitude_deg, altitude_m, heading_deg


def _paced(world: World, settings: Settings) -> World:
    """PX4's start script lengthens its time-outs by the speed-up: a client's wall time counts."""
    if world.vehicle.autopilot != "px4" or settings.speedup == 1.0:
        return world
    longer = {name: settings.speedup * seconds for name, seconds in _PX4_TIME_OUTS_S.items()}
    vehicle = world.vehicle
    return dataclasses.replace(
        world, vehicle=dataclasses.replace(vehicle, parameters=longer | vehicle.parameters)
    )


def _with_parameters(world: World, assignments: list[str]) -> World:
    """The world, with these NAME=VALUE in place of what it says."""
    added = dict[str, float]()
    for text in assignments:
        name, _, value = text.partition("=")
        try:
            added[name] = float(value)
        except ValueError:
            rule = "must be NAME=VALUE with a number"
            raise InputError("--param", text, rule, "Try GUID_TIMEOUT=1.") from None
        if not math.isfinite(added[name]):
            raise InputError("--param", text, "must be a finite number", "Try GUID_TIMEOUT=1.")
    vehicle = world.vehicle
    parameters = vehicle.parameters | added
    vehicle = with_own_ids(dataclasses.replace(vehicle, parameters=parameters))
    return dataclasses.replace(world, vehicle=vehicle)


def _row(world: World, count: int, port_step: int) -> list[World]:
    """The same world for each of so many vehicles, standing side by side."""
    vehicle = world.vehicle
    highest = personality_of(vehicle).highest_id
    most = min(_MAX_VEHICLES, highest - vehicle.system_id + 1)
    if not 1 <= count <= most:
        rule = f"must be 1 to {most}: there are system ids from {vehicle.system_id} to {highest}"
        raise InputError("--count", count, rule, f"Try {min(most, 5)}.")
    if not 0 <= port_step <= 1000:
        raise InputError("--port-step", port_step, "must be from 0 to 1000", "Try 10.")
    return [
        dataclasses.replace(
            world,
            vehicle=dataclasses.replace(
                vehicle, system_id=vehicle.system_id + k, east_m=vehicle.east_m + k * _ROW_M
            ),
        )
        for k in range(count)
    ]


def _timeline(file: Path, world: World) -> str:
    """The text of a file of faults, which has been read through once."""
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a text file"
        rule = f"cannot be read ({reason})"
        raise InputError("--faults", str(file), rule, "Name a file with a fault a line.") from None
    Timeline.parse(text, name=str(file), firmware=world.vehicle.autopilot)
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
    rule = "neither a bundled world nor a file"
    raise InputError(
        "WORLD", name, rule, f"Choose from: {known}; or give the path of a world.toml."
    )


def main() -> None:
    """Entry of the console script."""
    run(app, "vehicle-sim")


if __name__ == "__main__":
    main()
