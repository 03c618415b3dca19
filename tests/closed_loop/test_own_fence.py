"""A stranger's vehicle, its own fence, and a ground station that draws on it in flight.

All four autopilots with the parameters that their own simulations come with.  What was true is
judged from truth.jsonl, in numbers that stand here.
"""

import math
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import pytest
from flights import NIGHTLY_AUTOPILOTS, ROOT, Flight, each, free_port, run, warm_up
from ground_station import Box, Circle, GroundStation

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
EACH = each(*CASES, nightly=NIGHTLY_AUTOPILOTS)


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
    file = ROOT / "companion" / "environments" / name / "mission.toml"
    return tomllib.loads(file.read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Flights to their end, each flown once for all tests that look at it."""
    flights: dict[str, Drawn] = {}
    started: list[Flight] = []

    def fly(name: str) -> Drawn:
        if name not in flights:
            folder = tmp_path_factory.mktemp(name) / "run"
            flights[name] = _fly(name, CASES[name], folder, started)
        return flights[name]

    yield fly
    for flight in started:
        flight.kill()


def _fly(name: str, case: Case, folder: Path, started: list[Flight]) -> Drawn:
    warm_up()
    port, others_port = free_port(), free_port()
    simulator = run(
        *("vehicle-sim", name, "--lockstep", "--out", folder),
        *("--connect", f"udpout:127.0.0.1:{port}", "--connect", f"udpin:127.0.0.1:{others_port}"),
    )
    assert simulator.stdout is not None
    simulator.stdout.readline()  # it listens now
    origin = mission(name)["origin"]
    station = GroundStation(others_port, (origin["latitude_deg"], origin["longitude_deg"]))
    station.draw(case.inside, [case.before])
    companion = run(
        *("companion", "fly", name, "--lockstep", "--out", folder),
        *("--connect", f"udpin:127.0.0.1:{port}"),
    )
    flight = Flight(folder=folder, companion=companion, simulator=simulator)
    started.append(flight)
    times: list[float] = []

    def draw_another() -> None:
        station.draw(case.inside, [case.before, case.later])
        times.append(station.vehicle_s)

    first = mission(name)["targets"][0]
    station.when_near((first["north_m"], first["east_m"]), case.near_m, draw_another)
    flight.wait()
    station.close()
    assert times, (station.error, flight.said)
    _, *at = min(
        (abs(row["t_s"] - times[0]), row["north_m"], row["east_m"]) for row in flight.truth
    )
    return Drawn(flight=flight, drawn_s=times[0], drawn_at_ne_m=(at[0], at[1]))


def outside_m(path: list[tuple[float, float, float]], circle: Circle) -> float:
    """Least distance of a track from a circle."""
    centre = circle.north_m, circle.east_m
    return min(math.dist(centre, place) for _, *place in path) - circle.radius_m


@EACH
def test_a_stranger_arrives_where_its_own_fence_leaves_a_way(drawn: Any, name: str) -> None:
    flight = drawn(name).flight
    assert flight.companion.returncode == 0, flight.said["companion"]
    assert flight.simulator.returncode == 0, flight.said["simulator"]
    assert flight.outcome == "arrived"
    assert sum(entry.get("text") == "target reached" for entry in flight.journal) == 3


@EACH
def test_the_true_track_keeps_away_from_what_was_drawn_before(drawn: Any, name: str) -> None:
    case, path = CASES[name], drawn(name).path
    safety_m = mission(name)["planner"]["safety_distance_m"]
    assert outside_m(path, case.before) >= safety_m
    box = case.inside
    for _, north, east in path:
        assert box.south_m <= north <= box.north_m
        assert box.west_m <= east <= box.east_m


@EACH
def test_what_is_drawn_in_flight_is_known_within_ten_seconds(drawn: Any, name: str) -> None:
    flown = drawn(name)
    known = [
        entry["t_s"]
        for entry in flown.flight.journal
        if entry.get("kind") == "fence" and len(entry["zones"]) == 3
    ]
    assert known
    assert known[0] - flown.drawn_s <= _ADOPTED_S + _LATEST_S


@EACH
def test_the_true_track_keeps_away_from_what_was_drawn_in_flight(drawn: Any, name: str) -> None:
    case, flown = CASES[name], drawn(name)
    safety_m = mission(name)["planner"]["safety_distance_m"]
    before_m = outside_m([(0.0, *flown.drawn_at_ne_m)], case.later)
    assert before_m > 2.0 * safety_m, "drawn too late for anybody"
    assert outside_m(flown.path, case.later) >= safety_m
