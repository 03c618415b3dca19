"""A companion that is killed with -9 again and again in one flight, and started again each time.

Real processes in lockstep.  What the autopilot was told is read from the telemetry log, which all
lives have written one after the other.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, final

import pytest
import tlog
from flights import Flight, each, kept, launch, run, short_mission
from pymavlink.dialects.v20 import all as wire
from pyproj import Geod

pytestmark = pytest.mark.closed_loop

COMPANION = 195
LOOK_S = 0.01
"""How long it flies between two looks at what it has kept."""
JUMP_M, JUMP_M_S = 1.0, 1.0
FLIES_ON_S = {"sitl-arducopter": 3.0, "sitl-px4": 0.5}
"""How long the autopilot moves its target on by itself (ardupilot.md 3, px4.md 3)."""
_GEOD = Geod(ellps="WGS84")
Values = dict[str, Any]
Moment = tuple[str, Callable[[Values], bool]]


def _is_before_first_leg(now: Values) -> bool:
    return now["phase"] in ("TAKING_OFF", "HOLDING", "FLYING") and now["leg"] is None


def _is_in_leg(now: Values) -> bool:
    return now["phase"] == "FLYING" and now["leg"] is not None


PLANE_MOMENTS: tuple[Moment, ...] = (
    ("in a leg", _is_in_leg),
    ("at a join", lambda now: now["phase"] == "FLYING" and now["legs_flown"] >= 2),
)
MOMENTS: dict[str, tuple[Moment, ...]] = {
    "sitl-arducopter": PLANE_MOMENTS[:1],  # at any: `tests/mission/test_kinds.py`
    "sitl-px4": (
        ("before the first leg", _is_before_first_leg),
        *PLANE_MOMENTS,
        ("while landing", lambda now: now["phase"] == "LANDING"),
    ),
}


@final
@dataclass(kw_only=True)
class Killed:
    """A flight to its end, and where it was killed."""

    flight: Flight
    killed_at_s: list[float] = field(default_factory=list)


def killed(folder: Path, name: str) -> Killed:
    """Kill it at each of its moments, and start it again, as its service does."""
    mission = short_mission(name, folder.parent)
    flight = launch(folder, name, mission, "--resume", "--system", 1)
    it = Killed(flight=flight)
    for _, is_now in MOMENTS.get(name, PLANE_MOMENTS):

        def look(is_now: Callable[[Values], bool] = is_now) -> Values | None:
            values = kept(folder)
            return values if values is not None and is_now(values) else None

        it.killed_at_s.append(flight.companion.until(look, every_s=LOOK_S)["t_s"])
        flight.companion.kill()
        flight.companion = run(*map(str, flight.companion.process.args))  # type: ignore[union-attr]
    flight.wait()
    return it


COPTERS = each("sitl-arducopter", "sitl-px4", nightly=["sitl-px4"])
ALL = each(
    *("sitl-arducopter", "sitl-px4", "sitl-arduplane", "sitl-px4-plane"),
    nightly=["sitl-px4", "sitl-arduplane", "sitl-px4-plane"],  # planes: `test_planes`
)


@ALL
def test_it_arrives_however_often_it_was_killed(flown: Any, name: str) -> None:
    it = flown(name, by=killed)
    it.flight.ended_well()
    last = it.flight.truth[-1]
    assert name not in FLIES_ON_S or (last["landed"] and not last["armed"])
    assert it.killed_at_s == sorted(it.killed_at_s)
    texts = [entry.get("text") for entry in it.flight.journal]
    assert texts.count("target reached") >= 2


@ALL
def test_journal_and_log_hold_all_lives(flown: Any, name: str) -> None:
    it = flown(name, by=killed)
    heads = [entry for entry in it.flight.journal if "schema" in entry]
    assert [head.get("resumed", 0) for head in heads] == list(range(len(it.killed_at_s) + 1))
    times = [
        message.time_boot_ms * 1e-3
        for message in tlog.messages(it.flight.folder)
        if message.get_type() == "GLOBAL_POSITION_INT"
    ]
    gaps = [after - before for before, after in itertools.pairwise(times)]
    assert min(gaps) >= 0.0
    assert max(gaps) < 3.0  # no life is missing: in lockstep the vehicle waits for the next one


@ALL
def test_it_is_never_armed_again(flown: Any, name: str) -> None:
    it = flown(name, by=killed)
    arms = [
        message
        for message in tlog.messages(it.flight.folder)
        if message.get_srcComponent() == COMPANION
        and message.get_type() in ("COMMAND_LONG", "COMMAND_INT")
        and message.command == wire.MAV_CMD_COMPONENT_ARM_DISARM
    ]
    assert arms
    assert all(message.param1 == 1.0 and message.param2 == 0.0 for message in arms)
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
def test_no_setpoint_jumps(flown: Any, name: str) -> None:
    """Each is where the autopilot's own target is: where the one before has come to, or it."""
    it = flown(name, by=killed)
    before: Any = None
    vehicle: Any = None
    largest = [0.0, 0.0]
    for message in tlog.messages(it.flight.folder):
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
