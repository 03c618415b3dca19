"""A stranger's vehicle, its own fence, and a ground station that draws on it in flight.

All four autopilots with the parameters that their own simulations come with.  What was true is
judged from truth.jsonl, in numbers that stand here.
"""

import contextlib
import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import pytest
from flights import ENVIRONMENTS, Flight, companion, each, simulator
from ground_station import Box, Circle, GroundStation
from programs import free_port

pytestmark = pytest.mark.closed_loop

_ADOPTED_S = 10.0
_LATEST_S = 0.5
"""How old the ground station's idea of the vehicle's clock may be."""


@final
@dataclass(frozen=True, kw_only=True)
class Case:
    """What is drawn about a bundled mission."""

    inside: Box
    before: Circle
    """On the straight way to the first target, drawn before the flight."""
    later: Circle
    """On the straight way to the second one, drawn when the first is near."""
    near_m: float


COPTER = Case(
    inside=Box(south_m=-150.0, north_m=800.0, west_m=-150.0, east_m=900.0),
    before=Circle(north_m=300.0, east_m=50.0, radius_m=60.0),
    later=Circle(north_m=540.0, east_m=460.0, radius_m=50.0),
    near_m=20.0,
)
CASES = {
    "sitl-arducopter": COPTER,
    "sitl-px4": COPTER,
    "sitl-arduplane": Case(
        inside=Box(south_m=-1000.0, north_m=2400.0, west_m=-1900.0, east_m=1100.0),
        before=Circle(north_m=1000.0, east_m=250.0, radius_m=100.0),
        later=Circle(north_m=900.0, east_m=-650.0, radius_m=80.0),
        near_m=150.0,
    ),
    "sitl-px4-plane": Case(
        inside=Box(south_m=-800.0, north_m=1900.0, west_m=-1500.0, east_m=1000.0),
        before=Circle(north_m=950.0, east_m=219.0, radius_m=80.0),
        later=Circle(north_m=850.0, east_m=-375.0, radius_m=60.0),
        near_m=120.0,
    ),
}
EACH = each(*CASES, nightly=CASES)  # without sockets: `tests/benchmarks/test_events.py`


@final
@dataclass(frozen=True, kw_only=True)
class Drawn:
    """A flight, and when the second fence was taken by the vehicle, by its clock."""

    flight: Flight
    drawn_s: float
    drawn_at_ne_m: tuple[float, float]

    @property
    def path(self) -> list[tuple[float, float, float]]:
        """Time, north and east of the true vehicle."""
        return [(row["t_s"], row["north_m"], row["east_m"]) for row in self.flight.truth]


def mission(name: str) -> dict[str, Any]:
    return tomllib.loads((ENVIRONMENTS / name / "mission.toml").read_text(encoding="utf-8"))


def drawn(folder: Path, name: str) -> Drawn:
    """Fly it to its end, with a ground station that draws before and in flight."""
    case, port, others_port = CASES[name], free_port(), free_port()
    links = "--connect", f"udpout:127.0.0.1:{port}", "--connect", f"udpin:127.0.0.1:{others_port}"
    vehicle = simulator(name, folder, "--lockstep", *links)
    vehicle.expect("\n")  # it listens now
    origin, [first, *_] = mission(name)["origin"], mission(name)["targets"]
    station = GroundStation(others_port, (origin["latitude_deg"], origin["longitude_deg"]))
    with contextlib.closing(station):
        station.draw(case.inside, [case.before])
        us = companion(name, folder, f"udpin:127.0.0.1:{port}", "--lockstep")
        flight = Flight(folder=folder, companion=us, simulator=vehicle)
        times: list[float] = []

        def draw_another() -> None:
            station.draw(case.inside, [case.before, case.later])
            times.append(station.vehicle_s)

        station.when_near((first["north_m"], first["east_m"]), case.near_m, draw_another)
        flight.wait()
    assert times, (station.error, us.transcript)
    _, *at = min(
        (abs(row["t_s"] - times[0]), row["north_m"], row["east_m"]) for row in flight.truth
    )
    return Drawn(flight=flight, drawn_s=times[0], drawn_at_ne_m=(at[0], at[1]))


def outside_m(path: list[tuple[float, float, float]], circle: Circle) -> float:
    """Least distance of a track from a circle."""
    centre = circle.north_m, circle.east_m
    return min(math.dist(centre, place) for _, *place in path) - circle.radius_m


@EACH
def test_a_stranger_arrives_where_its_own_fence_leaves_a_way(flown: Any, name: str) -> None:
    flight = flown(name, by=drawn).flight
    flight.ended_well()
    assert sum(entry.get("text") == "target reached" for entry in flight.journal) == 3


@EACH
def test_the_true_track_keeps_away_from_what_was_drawn_before(flown: Any, name: str) -> None:
    case, path = CASES[name], flown(name, by=drawn).path
    safety_m = mission(name)["planner"]["safety_distance_m"]
    assert outside_m(path, case.before) >= safety_m
    box = case.inside
    for _, north, east in path:
        assert box.south_m <= north <= box.north_m
        assert box.west_m <= east <= box.east_m


@EACH
def test_what_is_drawn_in_flight_is_known_within_ten_seconds(flown: Any, name: str) -> None:
    it = flown(name, by=drawn)
    known = [
        entry["t_s"]
        for entry in it.flight.journal
        if entry.get("kind") == "fence" and len(entry["zones"]) == 3
    ]
    assert known
    assert known[0] - it.drawn_s <= _ADOPTED_S + _LATEST_S


@EACH
def test_the_true_track_keeps_away_from_what_was_drawn_in_flight(flown: Any, name: str) -> None:
    case, it = CASES[name], flown(name, by=drawn)
    safety_m = mission(name)["planner"]["safety_distance_m"]
    before_m = outside_m([(0.0, *it.drawn_at_ne_m)], case.later)
    assert before_m > 2.0 * safety_m, "drawn too late for anybody"
    assert outside_m(it.path, case.later) >= safety_m
