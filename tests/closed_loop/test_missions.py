"""Missions of all kinds, flown by both programs in one process: what truly comes of them.

A plane that is to land, a plan for a copter without a radar, a fence that is drawn in flight, and a
garden that nobody knows, by a lidar.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import documents
import numpy as np
import pytest
import shapely
from flights import ENVIRONMENTS, NIGHTLY, SOON, flown_here, flown_with, mission_file
from harness import item
from pymavlink.dialects.v20 import all as wire
from short_flight import replayed

from companion.config import load_mission
from companion.session import Session
from companion.sources.files import toml_text
from vehicle_sim.plans import PlanKind
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import flat_world, read_world

pytestmark = pytest.mark.closed_loop
VERTEX = wire.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
CIRCLE = wire.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("sitl-px4-plane", "lands on a circle: up to"),
        pytest.param("sitl-arduplane", "is not told to land: it circles", marks=NIGHTLY),
    ],
)
def test_a_plane_passes_its_target_and_ends_where_it_said_before_its_take_off(
    name: str, words: str, tmp_path: Path
) -> None:
    """Told to land, ArduPlane circles the target; PX4's comes down on a circle about it."""
    target = {"north_m": 1_000.0, "east_m": 250.0}
    tables: dict[str, Any] = {"targets": [target], "end": {"action": "land"}}
    if "ardu" in name:
        tables["vehicle"] = {"autopilot": None}  # to land so, a file that names it is refused
    mission = mission_file(name, tmp_path / "mission.toml", **tables)
    limits = load_mission(str(mission)).task.limits
    flight = flown_here(tmp_path / "run", ENVIRONMENTS / name / "world.toml", mission)
    place = target["north_m"], target["east_m"]
    away_m = [math.dist((row["north_m"], row["east_m"]), place) for row in flight.truth]
    assert min(away_m) <= limits.tracking_error_m
    assert flight.outcome == "arrived"
    assert away_m[-1] <= 1.5 * limits.loiter_radius_m
    assert words in flight.says[1]  # after the mission's name
    acknowledged = {entry["command"] for entry in flight.entries("acknowledged")}
    assert wire.MAV_CMD_DO_REPOSITION not in acknowledged  # one that is taken is not told of


STATED = f"""
plan = "x.plan"
vehicle = {{ scanner = false }}
terrain = {{ highest_amsl_m = 400.0 }}
planner = {{ evaluations = {SOON} }}
"""
HEIGHTS_M = (40.0, 60.0)
"""Above launch, of one waypoint to the north of the other."""


@pytest.mark.parametrize("autopilot", ["px4", pytest.param("ardupilot", marks=NIGHTLY)])
def test_a_plan_over_stated_ground_is_flown_at_its_altitudes(
    tmp_path: Path, autopilot: Any
) -> None:
    """Without a radar; where its ground is not stated either: `tests/mavlink/test_preflight.py`."""
    stops = [documents.waypoint(3e-5 * height_m, height_m) for height_m in HEIGHTS_M]
    home = documents.item(20, *[0] * 7, frame=2)
    documents.written(tmp_path, "plan", content=documents.plan(*stops, home, speed_m_s=8))
    (tmp_path / "mission.toml").write_text(STATED, encoding="utf-8")
    launch = {"latitude_deg": 47.0, "longitude_deg": 8.0, "heading_deg": 0.0}
    world = flat_world("copter", autopilot, altitude_amsl_m=400.0, **launch)
    session = Session(load_mission(str(tmp_path / "mission.toml")), seed=1, lockstep=True)
    flight = flown_with(tmp_path / "run", session, Simulation(world, seed=1))
    assert flight.outcome == "arrived"
    assert "mission x" in flight.says
    t_s, up_m = np.array([(row["t_s"], row["altitude_amsl_m"] - 400.0) for row in flight.truth]).T
    reached_s = [each["t_s"] for each in flight.entries("say") if each["text"] == "target reached"]
    assert np.interp(reached_s, t_s, up_m)[:2] == pytest.approx(HEIGHTS_M, abs=3.0)
    assert up_m.max() < 65.0
    assert up_m[-1] < 1.0


# --- a fence that is drawn in flight; by upload: `tests/interop`, `tests/vehicle_sim`

ADOPTED_S = 10.0
STAYED_IN = shapely.box(-150.0, -150.0, 450.0, 500.0)
"""North and east of what is never left."""
ENDS_NE_M = (300.0, 50.0), (250.0, 350.0)
BEFORE, LATER = (150.0, 25.0, 40.0), (275.0, 200.0, 40.0)
"""North, east and radius of what is kept out of, metres: on the straight ways to the first and to
the second target; that is drawn when the first is 20 m away."""


def test_the_true_track_keeps_away_from_what_a_fence_has_before_and_gets_in_flight(
    tmp_path: Path,
) -> None:
    """A plane: the golden flight `plane-meets-new-fence`."""
    mission = load_mission("sitl-px4", settings=[f"planner.evaluations={SOON}"])
    mission, drawn_s = replace(mission, targets_ne_m=ENDS_NE_M), list[float]()
    session = Session(mission, seed=1, lockstep=True)
    vehicle = Simulation(read_world(ENVIRONMENTS / "sitl-px4" / "world.toml"), seed=1)
    home_deg = mission.frame.latitude_deg, mission.frame.longitude_deg
    corners = STAYED_IN.exterior.coords[:4]
    box = [item(home_deg, VERTEX, north, east, 0.0, 4.0, frame=0) for north, east in corners]
    before, later = (
        item(home_deg, CIRCLE, north, east, 0.0, radius_m, frame=0)
        for north, east, radius_m in (BEFORE, LATER)
    )
    vehicle.plans[PlanKind.FENCE] = (*box, before)

    def look() -> bool:
        here = session.state.vehicle.position_nea_m
        is_near = here is not None and math.dist(here[:2], ENDS_NE_M[0]) < 20.0
        if is_near and not drawn_s:
            drawn_s.append(vehicle.now_us * 1e-6)
            vehicle.plans[PlanKind.FENCE] = (*box, before, later)
        return False

    flight = flown_with(tmp_path, session, vehicle, stop_asked=look)
    assert flight.outcome == "arrived"
    assert flight.says.count("target reached") == 2
    known_s = next(each["t_s"] for each in flight.journal if len(each.get("zones", ())) == 3)
    assert known_s - drawn_s[0] <= ADOPTED_S
    track = shapely.points([(row["north_m"], row["east_m"]) for row in flight.truth])
    assert shapely.contains(STAYED_IN, track).all()
    safety_m = mission.task.settings.safety_distance_m
    for *middle, radius_m in (BEFORE, LATER):
        away_m = shapely.distance(track, shapely.Point(middle)) - radius_m
        assert away_m.min() >= safety_m
    then = next(k for k, row in enumerate(flight.truth) if row["t_s"] >= drawn_s[0])
    assert away_m[then] > 2.0 * safety_m, "drawn too late for anybody"


# --- a garden that nobody knows: trees, and a wall with a gap

TREES_NE_M = (
    *((10.0, 1.5), (12.0, -6.0), (14.0, 6.0), (18.0, -1.0), (19.0, -12.0), (20.0, 10.0)),
    *((24.0, 3.0), (25.0, -14.0), (40.0, -5.0), (42.0, 6.0)),
)
TREE_M = 0.3
WALLS_NE_M = (((32.0, -30.0), (32.0, -8.0)), ((32.0, 0.0), (32.0, 30.0)))
WALL_M = 0.2  # half of its thickness
TARGET_NE_M = (40.0, 1.0)
GARDEN = {
    "schema": 1,
    "name": "garden",
    "origin": {"latitude_deg": 47.0, "longitude_deg": 8.0},
    "terrain": {"combine": "maximum", "ground_amsl_m": 400.0},
    "vehicle": {"kind": "copter", "autopilot": "ardupilot", "heading_deg": 0.0},
    "lidar": {"range_m": 16.0, "rate_hz": 10.0, "step_deg": 2.5, "noise_m": 0.1,
              "lost_share": 0.05, "latency_s": 0.06},
    "trees": [
        {"north_m": north, "east_m": east, "radius_m": TREE_M, "height_m": 15.0}
        for north, east in TREES_NE_M
    ],
    "walls": [
        {"points_ne_m": [*map(list, wall)], "thickness_m": 2.0 * WALL_M, "height_m": 15.0}
        for wall in WALLS_NE_M
    ],
}  # fmt: skip
AREA = {"north_min_m": -10.0, "north_max_m": 70.0, "east_min_m": -30.0, "east_max_m": 30.0}


def test_a_lidar_leads_clear_of_all_through_a_gap_and_learns_it_anew_after_a_kill(
    tmp_path: Path,
) -> None:
    """With noise and lost echoes.  Things move: what was known of them is not kept."""
    (tmp_path / "world.toml").write_text(toml_text(GARDEN), encoding="utf-8")
    target = dict(zip(("north_m", "east_m"), TARGET_NE_M, strict=True))
    mission = mission_file("forest", tmp_path / "mission.toml", area=AREA, targets=[target])
    killed = "at 60 s for 0.5 s: companion_off"  # between the trees, and started again
    flight = flown_here(tmp_path / "run", tmp_path / "world.toml", mission, killed)
    assert flight.outcome == "arrived"
    track = [(row["north_m"], row["east_m"]) for row in flight.truth if not row["landed"]]
    assert math.dist(track[-1], TARGET_NE_M) < 1.0
    safety_m = load_mission(str(mission)).task.settings.safety_distance_m
    trees, walls = shapely.points(TREES_NE_M), shapely.linestrings(WALLS_NE_M)
    for things, half_m in ((trees, TREE_M), (walls, WALL_M)):
        away_m = shapely.distance(shapely.points(track)[:, None], things)
        assert away_m.min() - half_m >= safety_m
    assert not (flight.folder / "known.npz").exists()
    [_, again] = [number for number, row in enumerate(flight.journal) if "schema" in row]
    lives = flight.journal[:again], flight.journal[again:]
    assert sum(row.get("kind") == "leg" for row in lives[0]) > 1
    seen, anew = ([r["cells_seen"] for r in life if r.get("kind") == "scan done"] for life in lives)
    assert anew[0] < max(seen)
    assert not any(row.get("kind") in ("arm", "take off") for row in lives[1])
    found = replayed(flight.folder, plans=False)
    assert found.is_identical, found
    assert found.unrecorded == 0
