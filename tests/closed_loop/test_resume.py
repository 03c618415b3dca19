"""A companion that is killed with -9 again and again in one flight, and started again each time.

Real processes in lockstep.  What the autopilot was told is read from the telemetry log, which all
lives have written one after the other.
"""

import contextlib
import itertools
import json
import math
import signal
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, final

import pytest
from flights import NIGHTLY_AUTOPILOTS, ROOT, Flight, each, free_port, run, warm_up
from pymavlink.dialects.v20 import all as wire
from pyproj import Geod

pytestmark = pytest.mark.closed_loop

COMPANION = 195
PATIENCE_S = 120.0
LOOK_S = 0.002
"""How long it flies between two looks at what it has kept."""
JUMP_M, JUMP_M_S = 1.0, 1.0
FLIES_ON_S = {"sitl-arducopter": 3.0, "sitl-px4": 0.5}
"""How long the autopilot moves its target on by itself (ardupilot.md 3, px4.md 3)."""
_GEOD = Geod(ellps="WGS84")
Values = dict[str, Any]
Moment = tuple[str, Callable[[Values], bool]]


def _is_before_first_leg(now: Values) -> bool:
    return now["phase"] in ("TAKING_OFF", "HOLDING", "FLYING") and now["leg"] is None


def _is_in_leg(number: int) -> Callable[[Values], bool]:
    return lambda now: now["phase"] == "FLYING" and now["legs_flown"] >= number


PAUSED = "paused"
COPTER_MOMENTS: tuple[Moment, ...] = (
    ("before the first leg", _is_before_first_leg),
    ("in a leg", lambda now: now["phase"] == "FLYING" and now["leg"] is not None),
    ("at a join", _is_in_leg(2)),
    (PAUSED, lambda now: now["phase"] == "HOLDING" and now["standing"] == "PAUSED"),
)
LANDING: tuple[Moment, ...] = (("while landing", lambda now: now["phase"] == "LANDING"),)
PLANE_MOMENTS: tuple[Moment, ...] = (
    ("in a leg", lambda now: now["phase"] == "FLYING" and now["leg"] is not None),
    ("at a join", _is_in_leg(2)),
)


@final
@dataclass(kw_only=True)
class Killed:
    """A flight to its end, and where it was killed."""

    flight: Flight
    killed_at_s: list[float] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    """What each life has said."""


@final
class Person:
    """Somebody at a ground station, on a link of his own."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._address = ("127.0.0.1", port)
        self._codec = wire.MAVLink(None, srcSystem=255, srcComponent=190)

    def tells(self, *, goes_on: bool) -> None:
        """The companion to pause, or to go on."""
        command = wire.MAV_CMD_DO_PAUSE_CONTINUE
        message = wire.MAVLink_command_long_message(
            1, COMPANION, command, 0, float(goes_on), 0, 0, 0, 0, 0, 0
        )
        self._socket.sendto(message.pack(self._codec), self._address)

    def close(self) -> None:
        self._socket.close()


def kept(folder: Path) -> Values | None:
    """What the companion has kept of its flight by now."""
    try:
        values: Values = json.loads((folder / "resume.json").read_bytes())["values"]
    except (OSError, ValueError):
        return None
    return values


def _until(flight: Flight, is_now: Callable[[Values], bool], act: Callable[[], None]) -> Values:
    """Look at what is kept until it is so; act now and then meanwhile."""
    give_up_s, acts_s = time.monotonic() + PATIENCE_S, 0.0
    while time.monotonic() < give_up_s and flight.companion.poll() is None:
        if (values := kept(flight.folder)) is not None and is_now(values):
            return values
        if time.monotonic() > acts_s:
            acts_s = time.monotonic() + 0.1
            act()
        with contextlib.suppress(subprocess.TimeoutExpired):  # what it keeps is a file, which
            flight.companion.wait(LOOK_S)  # has no event to wait for; its end has one
    flight.companion.kill()
    said, _ = flight.companion.communicate()
    raise AssertionError(f"it never came to that: {kept(flight.folder)} {said[-2000:]}")


def mission_of(name: str, folder: Path) -> Path:
    """The bundled mission; of a copter shorter and in shorter stretches: some join in flight."""
    text = (ROOT / "companion" / "environments" / name / "mission.toml").read_text("utf-8")
    if name in FLIES_ON_S:
        assert text.count("scan_range_m = 800.0") == 1
        text = text.replace("scan_range_m = 800.0", "scan_range_m = 400.0")
        last = "[[targets]]\nnorth_m = 60.0\neast_m = 150.0\n"
        assert text.count(last) == 1
        text = text.replace(last, "")
    file = folder / f"{name}.toml"
    file.write_text(text + "\n[battery]\nreserve_percent = 2\n", encoding="utf-8")
    return file


def fly(name: str, moments: tuple[Moment, ...], folder: Path, started: list[Any]) -> Killed:
    warm_up()
    mission = mission_of(name, folder.parent)
    port, second = free_port(), free_port()
    simulator = run(
        *("vehicle-sim", name, "--lockstep", "--out", folder),
        *("--connect", f"udpout:127.0.0.1:{port}", "--connect", f"udpin:127.0.0.1:{second}"),
    )
    started.append(simulator)

    def companion() -> subprocess.Popen[str]:
        """As its service starts it, each time."""
        started.append(
            run(
                *("companion", "fly", mission, "--lockstep", "--out", folder, "--resume"),
                *("--connect", f"udpin:127.0.0.1:{port}", "--system", "1"),
            )
        )
        return started[-1]

    flight = Flight(folder=folder, companion=companion(), simulator=simulator)
    with contextlib.closing(Person(second)) as person:
        killed = _killed(flight, companion, person, moments)
    flight.wait()
    return killed


def _killed(
    flight: Flight,
    companion: Callable[[], subprocess.Popen[str]],
    person: Person,
    moments: tuple[Moment, ...],
) -> Killed:
    """Kill it at each of these moments, and start it again."""
    killed = Killed(flight=flight)
    for what, is_now in moments:
        pauses = what is PAUSED
        act = partial(person.tells, goes_on=False) if pauses else _nothing
        values = _until(flight, is_now, act)
        flight.companion.send_signal(signal.SIGKILL)
        killed.said.append(flight.companion.communicate()[0])
        killed.killed_at_s.append(values["t_s"])
        flight.companion = companion()
        if pauses:  # it goes on when it is told to, and not by itself
            go_on = partial(person.tells, goes_on=True)
            _until(flight, lambda now: now["phase"] == "FLYING", go_on)
    return killed


def _nothing() -> None:
    """What a person does most of the time."""


@pytest.fixture(scope="session")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Killed]]:
    """Flights to their end, each flown once for all tests that look at it."""
    flown: dict[tuple[str, tuple[Moment, ...]], Killed] = {}
    started: list[subprocess.Popen[str]] = []

    def flight(name: str, moments: tuple[Moment, ...] | None = None) -> Killed:
        moments = moments or (COPTER_MOMENTS if name in FLIES_ON_S else PLANE_MOMENTS)
        if (name, moments) not in flown:
            folder = tmp_path_factory.mktemp(name) / "run"
            flown[name, moments] = fly(name, moments, folder, started)
        return flown[name, moments]

    yield flight
    for process in started:
        if process.poll() is None:
            process.kill()
            process.communicate()


COPTERS = each("sitl-arducopter", "sitl-px4", nightly=NIGHTLY_AUTOPILOTS)
ALL = each(
    *("sitl-arducopter", "sitl-px4", "sitl-arduplane", "sitl-px4-plane"),
    nightly=NIGHTLY_AUTOPILOTS,
)


def logged(folder: Path) -> list[tuple[float, Any]]:
    """Every frame of the telemetry log, with its time; it must be whole to the last byte."""
    data = (folder / "flight.tlog").read_bytes()
    parser, at, found = wire.MAVLink(None), 0, []
    while at < len(data):
        (stamp_us,) = struct.unpack_from(">Q", data, at)
        assert data[at + 8] == wire.PROTOCOL_MARKER_V2
        size = 12 + data[at + 9]
        found.append((stamp_us * 1e-6, parser.decode(bytearray(data[at + 8 : at + 8 + size]))))
        at += 8 + size
    assert at == len(data)
    return found


@ALL
def test_it_arrives_however_often_it_was_killed(killed: Any, name: str) -> None:
    it = killed(name)
    assert it.flight.companion.returncode == 0, it.flight.said["companion"]
    assert it.flight.simulator.returncode == 0, it.flight.said["simulator"]
    assert it.flight.outcome == "arrived"
    assert it.killed_at_s == sorted(it.killed_at_s)
    texts = [entry.get("text") for entry in it.flight.journal]
    assert texts.count("target reached") >= 2


@COPTERS
def test_killed_while_it_lands(killed: Any, name: str) -> None:
    it = killed(name, LANDING)
    assert it.flight.companion.returncode == 0, it.flight.said["companion"]


@ALL
def test_journal_and_log_hold_all_lives(killed: Any, name: str) -> None:
    it = killed(name)
    heads = [entry for entry in it.flight.journal if "schema" in entry]
    assert [head.get("resumed", 0) for head in heads] == list(range(len(it.killed_at_s) + 1))
    times = [
        message.time_boot_ms * 1e-3
        for _, message in logged(it.flight.folder)
        if message.get_type() == "GLOBAL_POSITION_INT"
    ]
    gaps = [after - before for before, after in itertools.pairwise(times)]
    assert min(gaps) >= 0.0
    assert max(gaps) < 3.0  # no life is missing: in lockstep the vehicle waits for the next one


@ALL
def test_it_is_never_armed_again(killed: Any, name: str) -> None:
    it = killed(name)
    arms = [
        (time_s, message)
        for time_s, message in logged(it.flight.folder)
        if message.get_srcComponent() == COMPANION
        and message.get_type() in ("COMMAND_LONG", "COMMAND_INT")
        and message.command == wire.MAV_CMD_COMPONENT_ARM_DISARM
    ]
    assert arms
    assert all(message.param1 == 1.0 and message.param2 == 0.0 for _, message in arms)
    first_kill = [k for k, entry in enumerate(it.flight.journal) if "schema" in entry][1]
    later = [entry for entry in it.flight.journal[first_kill:] if entry.get("kind") == "arm"]
    assert later == []
    armed = [row["armed"] for row in it.flight.truth]
    changes = [after for before, after in itertools.pairwise(armed) if before != after]
    assert changes in ([True], [True, False])


def place_of(message: Any) -> tuple[float, float, float]:
    if message.get_type() == "GLOBAL_POSITION_INT":
        return message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3
    return message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt


def velocity_of(message: Any) -> tuple[float, float, float]:
    if message.get_type() == "GLOBAL_POSITION_INT":
        return message.vx * 1e-2, message.vy * 1e-2, message.vz * 1e-2
    return message.vx, message.vy, message.vz


def apart_m(one: tuple[float, float, float], other: tuple[float, float, float]) -> float:
    _, _, level_m = _GEOD.inv(one[1], one[0], other[1], other[0])
    return math.hypot(level_m, one[2] - other[2])


def moved(
    place: tuple[float, float, float], velocity: tuple[float, float, float], seconds: float
) -> tuple[float, float, float]:
    north, east, down = (value * seconds for value in velocity)
    azimuth = math.degrees(math.atan2(east, north))
    longitude, latitude, _ = _GEOD.fwd(place[1], place[0], azimuth, math.hypot(north, east))
    return latitude, longitude, place[2] - down


@COPTERS
def test_no_setpoint_jumps(killed: Any, name: str) -> None:
    """Each is where the autopilot's own target is: where the one before has come to, or it."""
    it = killed(name)
    before: Any = None
    vehicle: Any = None
    largest = [0.0, 0.0]
    for _, message in logged(it.flight.folder):
        if message.get_type() == "GLOBAL_POSITION_INT" and message.get_srcComponent() == 1:
            vehicle = message
        elif message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT":
            near = [(apart_m(place_of(message), place_of(vehicle)), velocity_of(vehicle))]
            if before is not None:
                gap_s = (message.time_boot_ms - before.time_boot_ms) * 1e-3
                flown_s = min(gap_s, FLIES_ON_S[name])
                target = moved(place_of(before), velocity_of(before), flown_s)
                near.append((apart_m(place_of(message), target), velocity_of(before)))
            metres, speed = min(
                ((metres, math.dist(velocity_of(message), velocity)) for metres, velocity in near),
                key=sum,
            )
            largest = [max(largest[0], metres), max(largest[1], speed)]
            before = message
    assert before is not None
    assert largest[0] <= JUMP_M, largest
    assert largest[1] <= JUMP_M_S, largest
