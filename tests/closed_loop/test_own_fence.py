"""A stranger's vehicle with a fence of its own, to which something is added in flight.

By upload: `tests/interop/test_mavproxy.py`, `tests/vehicle_sim/test_mission_protocol.py`.
"""

import math
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from flights import ENVIRONMENTS, NIGHTLY, flown_with
from pymavlink.dialects.v20 import all as wire

from companion.config import load_mission
from companion.session import Session
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world

pytestmark = pytest.mark.closed_loop
ADOPTED_S = 10.0
Circle = tuple[float, float, float]
"""North, east, radius, metres."""


class Fence(NamedTuple):
    box: tuple[float, float, float, float]
    """South, north, west and east of what is never left."""
    before: Circle
    """On the straight way to the first target."""
    later: Circle
    """On that to the second, drawn when the first is so many metres away."""
    near_m: float


CASES = {
    "sitl-px4": Fence(
        (-150.0, 800.0, -150.0, 900.0), (300.0, 50.0, 60.0), (540.0, 460.0, 50.0), 20.0
    ),
    "sitl-arduplane": Fence(
        (-1000.0, 2400.0, -1900.0, 1100.0), (1000.0, 250.0, 100.0), (900.0, -650.0, 80.0), 150.0
    ),
}


def outside_m(row: dict[str, Any], circle: Circle) -> float:
    """How far the true vehicle is from a circle."""
    return math.dist((row["north_m"], row["east_m"]), circle[:2]) - circle[2]


@pytest.mark.parametrize("name", ["sitl-px4", pytest.param("sitl-arduplane", marks=NIGHTLY)])
def test_the_true_track_keeps_away_from_what_is_drawn_before_and_in_flight(
    name: str, tmp_path: Path
) -> None:
    (south, north, west, east), before, later, near_m = CASES[name]
    mission = load_mission(name)
    safety_m = mission.task.settings.safety_distance_m
    session = Session(mission, seed=1, lockstep=True)
    vehicle = Simulation(read_world(ENVIRONMENTS / name / "world.toml"), seed=1)
    drawn_s: list[float] = []

    def draw(*circles: Circle) -> None:
        corner = wire.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
        circle = wire.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION
        box = [(south, west), (south, east), (north, east), (north, west)]
        shapes = [(corner, 4.0, place) for place in box]
        shapes += [(circle, each[2], each[:2]) for each in circles]
        items = []
        for command, size, place in shapes:
            x, y = (round(float(deg) * 1e7) for deg in mission.frame.to_geodetic_deg(*place))
            values = (size, 0.0, 0.0, 0.0)
            items.append(PlanItem(frame=0, command=command, parameters=values, x=x, y=y))
        vehicle.plans[PlanKind.FENCE] = tuple(items)

    def look() -> bool:
        here = session.state.vehicle.position_nea_m
        is_near = here is not None and math.dist(here[:2], mission.targets_ne_m[0]) < near_m
        if is_near and not drawn_s:
            drawn_s.append(vehicle.now_us * 1e-6)
            draw(before, later)
        return False

    draw(before)
    flight = flown_with(tmp_path, session, vehicle, stop_asked=look)
    assert flight.outcome == "arrived"
    assert flight.says.count("target reached") == 3
    [known_s] = [e["t_s"] for e in flight.journal if len(e.get("zones", ())) == 3][:1]
    assert known_s - drawn_s[0] <= ADOPTED_S
    at_once = min(flight.truth, key=lambda row: abs(row["t_s"] - drawn_s[0]))
    assert outside_m(at_once, later) > 2.0 * safety_m, "drawn too late for anybody"
    for row in flight.truth:
        assert outside_m(row, before) >= safety_m
        assert outside_m(row, later) >= safety_m
        assert south <= row["north_m"] <= north
        assert west <= row["east_m"] <= east
