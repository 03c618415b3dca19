"""A companion that is killed with -9 again and again in one flight, and started again each time.

Real processes in lockstep.  What the autopilot was told is read from the telemetry log, which all
lives have written one after the other.
"""

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import tlog
from flights import Flight, each, kept, launch, run, short_mission
from pymavlink.dialects.v20 import all as wire
from pyproj import Geod

pytestmark = pytest.mark.closed_loop

LOOK_S = 0.01
"""How long it flies between two looks at what it has kept."""
JUMP_M, JUMP_M_S = 1.0, 1.0
FLIES_ON_S = {"sitl-arducopter": 3.0, "sitl-px4": 0.5}
"""How long the autopilot moves its target on by itself (ardupilot.md 3, px4.md 3)."""
GEOD = Geod(ellps="WGS84")
Values = dict[str, Any]
Moment = Callable[[Values], bool]
Place = tuple[float, float, float]
"""Degrees, and metres AMSL; or metres a second to the north, east and down."""


def before_first_leg(now: Values) -> bool:
    return now["phase"] in ("TAKING_OFF", "HOLDING", "FLYING") and now["leg"] is None


def in_leg(now: Values) -> bool:
    return now["phase"] == "FLYING" and now["leg"] is not None


def at_join(now: Values) -> bool:
    return now["phase"] == "FLYING" and now["legs_flown"] >= 2


def landing(now: Values) -> bool:
    return bool(now["phase"] == "LANDING")


MOMENTS: dict[str, tuple[Moment, ...]] = {
    "sitl-arducopter": (in_leg,),  # at any: `tests/mission/test_kinds.py`
    "sitl-px4": (before_first_leg, in_leg, at_join, landing),
    "sitl-arduplane": (in_leg, at_join),
    "sitl-px4-plane": (in_leg, at_join),
}


class Killed(NamedTuple):
    """A flight to its end, and where it was killed."""

    flight: Flight
    killed_at_s: list[float]


def killed(folder: Path, name: str) -> Killed:
    """Kill it at each of its moments, and start it again, as its service does."""
    mission = short_mission(name, folder.parent)
    it = Killed(launch(folder, name, mission, "--resume", "--system", 1), [])
    for is_now in MOMENTS[name]:

        def look(is_now: Moment = is_now) -> Values | None:
            values = kept(folder)
            return values if values is not None and is_now(values) else None

        companion = it.flight.companion
        it.killed_at_s.append(companion.until(look, every_s=LOOK_S)["t_s"])
        companion.kill()
        it.flight.companion = run(*map(str, companion.process.args))  # type: ignore[union-attr]
    it.flight.wait()
    return it


def only_arms(message: Any) -> bool:
    return bool(message.param1 == 1.0 and message.param2 == 0.0)


@each(
    *MOMENTS, nightly=["sitl-px4", "sitl-arduplane", "sitl-px4-plane"]
)  # planes: `replay/test_golden`
def test_it_arrives_however_often_it_was_killed_and_is_armed_once(flown: Any, name: str) -> None:
    """Journal and log hold all lives: in lockstep the vehicle waits for the next one."""
    flight, killed_at_s = flown(name, by=killed)
    flight.ended_well()
    last = flight.truth[-1]
    assert name not in FLIES_ON_S or (last["landed"] and not last["armed"])
    assert killed_at_s == sorted(killed_at_s)
    assert flight.says.count("target reached") >= 2
    heads = [k for k, entry in enumerate(flight.journal) if "schema" in entry]
    lives = [flight.journal[k].get("resumed", 0) for k in heads]
    assert lives == list(range(len(killed_at_s) + 1))
    assert "arm" not in [entry.get("kind") for entry in flight.journal[heads[1] :]]
    log = tlog.messages(flight.folder)
    times = [m.time_boot_ms * 1e-3 for m in log if m.get_type() == "GLOBAL_POSITION_INT"]
    gaps = [after - before for before, after in itertools.pairwise(times)]
    assert min(gaps) >= 0.0
    assert max(gaps) < 3.0
    arming = wire.MAV_CMD_COMPONENT_ARM_DISARM
    commands = [m for m in log if m.get_type() in ("COMMAND_LONG", "COMMAND_INT")]
    arms = [m for m in commands if m.command == arming and m.get_srcComponent() == 195]
    assert arms
    assert all(map(only_arms, arms))
    armed = [row["armed"] for row in flight.truth]
    changes = [after for before, after in itertools.pairwise(armed) if before != after]
    assert changes in ([True], [True, False])


def place_and_velocity(message: Any) -> tuple[Place, Place]:
    if message.get_type() == "GLOBAL_POSITION_INT":
        place = message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3
        return place, (message.vx * 1e-2, message.vy * 1e-2, message.vz * 1e-2)
    place = message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt
    return place, (message.vx, message.vy, message.vz)


def apart_m(one: Place, other: Place) -> float:
    _, _, level_m = GEOD.inv(one[1], one[0], other[1], other[0])
    return math.hypot(level_m, one[2] - other[2])


def moved(place: Place, velocity: Place, seconds: float) -> Place:
    north, east, down = (value * seconds for value in velocity)
    azimuth = math.degrees(math.atan2(east, north))
    longitude, latitude, _ = GEOD.fwd(place[1], place[0], azimuth, math.hypot(north, east))
    return latitude, longitude, place[2] - down


@each(*FLIES_ON_S, nightly=["sitl-px4"])
def test_no_setpoint_jumps(flown: Any, name: str) -> None:
    """Each is where the autopilot's own target is: where the one before has come to, or it."""
    before: Any = None
    vehicle: Any = None
    largest = [0.0, 0.0]
    for message in tlog.messages(flown(name, by=killed).flight.folder):
        if message.get_type() == "GLOBAL_POSITION_INT" and message.get_srcComponent() == 1:
            vehicle = message
        elif message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT":
            targets = [place_and_velocity(vehicle)]
            if before is not None:
                place, velocity = place_and_velocity(before)
                gap_s = (message.time_boot_ms - before.time_boot_ms) * 1e-3
                targets.append((moved(place, velocity, min(gap_s, FLIES_ON_S[name])), velocity))
            place, velocity = place_and_velocity(message)
            jumps = [(apart_m(place, at), math.dist(velocity, speed)) for at, speed in targets]
            largest = [max(pair) for pair in zip(largest, min(jumps, key=sum), strict=True)]
            before = message
    assert before is not None
    assert largest[0] <= JUMP_M, largest
    assert largest[1] <= JUMP_M_S, largest
