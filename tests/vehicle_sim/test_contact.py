"""What is near, what is hit and who survives it: one law for all vehicles and autopilots.

Distances and beams among near things against shapely, and woods against their law.
"""

import math
from typing import Any

import numpy as np
import pytest
import shapely
from harness import COPTER_HOME, Rig, placed, setpoint, world
from scipy.spatial import cKDTree

from vehicle_sim.dynamics.contact import Contact, Crash, is_crash
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.scene import Scene
from vehicle_sim.terrain import PeakTerrain
from vehicle_sim.world import Tree, World, parse_world

GROUND_M, BOTH = 500.0, ("ardupilot", "px4")
PEAK = {"north_m": 900.0, "east_m": 0.0, "height_amsl_m": GROUND_M + 700.0}
PEAK |= {"spread_north_m": 150.0, "spread_east_m": 1e5}
"""Above the plain as a wall of 45 degrees and more from 749 m to the north on."""


def under_way(*kind: Any, height_m: float = 15.0, north_m_s: float = 9.0, **told: Any) -> Rig:
    """Northwards over the plain; a plane flies so by itself, against a wind."""
    if kind == ("ardupilot", "plane"):
        told |= {"AIRSPEED_CRUISE": 12.0, "AIRSPEED_MIN": 10.0, "SIM_WIND_SPD": 3.0}
    elif kind == ("px4", "plane"):
        told |= {"FW_AIRSPD_TRIM": 11.0, "SIM_WIND_SPD": 2.0}
    flown = Rig(*kind, COPTER_HOME, SIM_WIND_DIR=0.0, **told).climb(height_m)
    if flown.kind == "copter":
        flown.streamed = setpoint(None, (north_m_s, 0.0, 0.0))
    return flown


CONTACTS = [  # velocity, slope, whether it rolls, lands, crashes
    ((0.0, 0.0, -2.9), 0.0, False, True, False),
    ((0.0, 0.0, -3.1), 0.0, False, True, True),
    ((2.0, -2.0, -1.5), 0.0, False, True, True),  # sideways counts
    ((20.0, 0.0, -1.0), 0.0, True, True, False),  # a runway
    ((20.0, 0.0, -3.1), 0.0, True, True, True),
    ((20.0, 0.0, -1.0), 0.05, True, True, False),
    ((20.0, 0.0, 4.0), 0.2, True, True, True),  # along a hillside is no runway
    ((0.0, 9.0, 0.0), 0.12j, True, True, True),
    ((9.0, 0.0, 0.0), 0.12, True, False, False),  # it rolls up a ramp
    ((9.0, 0.0, 0.0), 1.0, True, False, True),  # and into a wall
    ((9.0, 0.0, -9.0), -1.0, True, False, False),  # along the slope that it is on
]


def test_a_contact_is_judged_by_the_speed_in_all_axes() -> None:
    for velocity, slope, rolls, lands, crashes in CONTACTS:
        assert is_crash(velocity, slope, rolls=rolls, lands=lands) is crashes, (velocity, slope)


class Step(PeakTerrain):  # type: ignore[misc]
    """Level ground with a step up of 5 m at 10 m north."""

    def height_at_amsl_m(self, north_m: float, east_m: float) -> float:
        return 5.0 if north_m > 10.0 else 0.0 * east_m


@pytest.mark.parametrize(("from_m", "crashes"), [(9.0, True), (12.0, False)])
def test_a_step_up_is_hit_though_level_before_and_behind_it(from_m: float, crashes: bool) -> None:
    frame, hits = LocalFrame(latitude_deg=47.0, longitude_deg=8.0), list[Crash]()
    terrain = Step([], combine="maximum", ground_amsl_m=0.0)
    height_m = terrain.height_at_amsl_m(from_m, 0.0)
    plane = Plane(**placed((*frame.to_geographic(from_m, 0.0), height_m)))
    contact = Contact(plane, Scene(terrain, ()), frame, rolls=True, on_crash=hits.append)
    plane.velocity_m_s = 9.0 + 0j
    plane.latitude_deg, _ = frame.to_geographic(from_m + 2.0, 0.0)
    contact.prepare(200_000)
    contact.look(200_000)
    contact.settle(200_000, 0.2)
    assert [hit.into for hit in hits] == ["the ground"] * crashes


HOUSE = {"corners_ne_m": [[500, -99], [500, 99], [600, 99], [600, -99]], "height_m": 150.0}
TREE = {"north_m": 12.0, "east_m": 0.0, "radius_m": 0.05, "height_m": 50.0}
WALL = {"points_ne_m": [[12.0, -9.0], [12.0, 9.0]], "thickness_m": 0.1, "height_m": 50.0}
SLOPE_M = PEAK["north_m"] - PEAK["spread_north_m"] * math.sqrt(math.log(1200.0 / (GROUND_M + 15.0)))
"""Where the wall is 15 m high."""


@pytest.mark.parametrize(
    ("autopilot", "kind", "told", "at_north_m"),
    [
        *((each, "copter", {"peaks": [PEAK], "north_m": 690.0}, SLOPE_M) for each in BOTH),
        *((each, "plane", {"peaks": [PEAK]}, SLOPE_M) for each in BOTH),
        ("ardupilot", "copter", {"trees": [TREE]}, 12.0),
        ("px4", "copter", {"walls": [WALL]}, 12.0),
        ("px4", "plane", {"buildings": [HOUSE]}, 500.0),
    ],
)
def test_who_hits_a_slope_or_a_thing_however_thin_falls_there(
    autopilot: str, kind: str, told: Any, at_north_m: float
) -> None:
    """At 9 m/s."""
    flown = under_way(autopilot, kind, **told)
    simulation = flown.simulation
    assert simulation.crash is None
    flown.until(lambda: simulation.crash is not None, 150.0)
    crash: Any = simulation.crash
    into, within_m = "a tree, wall, building or wire", 0.3
    if "peaks" in told:
        into, within_m = "the ground", 4.0
        assert 7.5 < crash.speed_m_s < 12.0
    assert (crash.into, crash.north_m) == (into, pytest.approx(at_north_m, abs=within_m))
    flown.until(lambda: simulation.landed, 10.0)
    truth = flown.run(3.0).truth()
    assert simulation.crash is crash  # the first counts
    assert (truth[-1]["landed"], truth[-1]["armed"]) == (True, False)
    assert truth[-1]["crash"]["speed_m_s"] == pytest.approx(crash.speed_m_s, abs=1e-3)
    assert truth[-1]["north_m"] == pytest.approx(crash.north_m, abs=0.3)
    assert any(f"hits {into} at" in notice for notice in simulation.take_notices())
    assert f"it hit {into} at" in simulation.outcome()
    if "peaks" not in told:
        assert min(row["near_m"] for row in truth) == simulation.contact.nearest_m == 0.0


def test_who_passes_a_tree_has_the_least_distance_in_the_truth() -> None:
    tree = TREE | {"east_m": 3.0, "radius_m": 0.5}
    flown = under_way("ardupilot", "copter", height_m=5.0, north_m_s=4.0, trees=[tree]).run(9.0)
    truth = flown.truth()
    east_m = [row["east_m"] for row in truth if abs(row["north_m"] - 12.0) < 0.5]
    least_m = min(row["near_m"] for row in truth)
    assert least_m == pytest.approx(3.0 - 0.5 - sum(east_m) / len(east_m), abs=0.02)
    assert least_m == pytest.approx(flown.simulation.contact.nearest_m, abs=1e-3)


# --- what is near: a distance and a beam ----------------------------------------------------------

PLAIN_M = 100.0
Solid = tuple[Any, float]
"""A shapely geometry in north and east, from the ground up to a height."""


def around(**near: Any) -> World:
    return parse_world(world(place=(47.0, 8.0, PLAIN_M), **near))


HILL = {"north_m": 78.0, "east_m": 0.0, "height_amsl_m": PLAIN_M + 120.0}
HILL |= {"spread_north_m": 25.0, "spread_east_m": 40.0}
"""Beside all things."""


def drawn(seed: int) -> tuple[World, list[Solid]]:
    """Random things, and the same as shapely has them."""
    rng, solids = np.random.default_rng(seed), list[Solid]()
    trees, walls, buildings = [], [], []

    def height(shape: Any) -> dict[str, float]:
        """Of a thing of this shape."""
        height_m = float(rng.uniform(3.0, 20.0))
        solids.append((shape, PLAIN_M + height_m))
        return {"height_m": height_m}

    for _ in range(30):
        (n, e), radius_m = rng.uniform(-30, 30, 2).tolist(), float(rng.uniform(0.1, 2.0))
        round_m = shapely.Point(n, e).buffer(radius_m, quad_segs=128)
        trees.append({"north_m": n, "east_m": e, "radius_m": radius_m} | height(round_m))
    for _ in range(4):
        points, thick_m = rng.uniform(-30, 30, (3, 2)).tolist(), float(rng.uniform(0.2, 2))
        line = shapely.LineString(points).buffer(thick_m / 2, quad_segs=128)
        walls.append({"points_ne_m": points, "thickness_m": thick_m} | height(line))
    for _ in range(4):
        angles = np.sort(rng.uniform(0, math.tau, 6))
        rays = rng.uniform(2, 12, (6, 1)) * np.stack([np.cos(angles), np.sin(angles)], -1)
        corners = (rng.uniform(-30, 30, 2) + rays).tolist()
        if (shape := shapely.Polygon(corners)).is_valid:
            buildings.append({"corners_ne_m": corners} | height(shape))
    return around(peaks=[HILL], trees=trees, walls=walls, buildings=buildings), solids


@pytest.mark.parametrize("seed", range(4))
def test_distances_are_shapelys_and_beams_end_where_steps_first_are_inside(seed: int) -> None:
    """Of a thing, or of the hill."""
    made, solids = drawn(seed)
    rng = np.random.default_rng(seed + 100)
    points = rng.uniform([-60, -60, PLAIN_M], [60, 60, PLAIN_M + 40], (100, 3))
    flat = shapely.points(points[:, :2])
    away_m = [
        np.hypot(shapely.distance(shape, flat), np.maximum(points[:, 2] - top, 0.0))
        for shape, top in solids
    ]
    assert made.scene().distance_m(points) == pytest.approx(np.min(away_m, axis=0), abs=1e-4)
    ways = rng.normal(size=(12, 3)) * [1.0, 1.0, 0.4]
    ways[:3] = [(1.0, 0.0, 0.0), (1.0, 0.1, 0.02), (1.0, -0.1, -0.05)]  # at the hill
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    # above all roofs, so that beams come down on them; and among them, so that some pass above
    eye = np.array([0.0, 0.0, PLAIN_M + (22.0 if seed % 2 else 9.0)])
    found, steps = made.scene().ray_lengths_m(eye, ways, 60.0), np.arange(0.0, 60.0, 0.02)
    shapely.prepare([shape for shape, _ in solids])
    for way, length in zip(ways, found, strict=True):
        points = eye + steps[:, None] * way
        inside = points[:, 2] < made.truth().height_amsl_m(points[:, 0], points[:, 1])
        for shape, top in solids:
            inside |= (points[:, 2] <= top) & shapely.contains_xy(shape, *points[:, :2].T)
        first = steps[inside.argmax()] if inside.any() else math.inf
        assert min(length, 59.9) == pytest.approx(min(first, 59.9), abs=0.05)


def test_a_wire_is_touched_and_not_seen() -> None:
    made = around(wires=[{"ends_ne_m": [[10.0, -5.0], [10.0, 5.0]], "height_m": 8.0}]).scene()
    at = np.array([0.0, 0.0, PLAIN_M + 8.0])
    assert made.distance_m(at) == pytest.approx(9.99)
    assert made.distance_m(at + np.array([10.0, 0.0, 0.005])) == 0.0
    assert np.isinf(made.ray_lengths_m(at, np.array([[1.0, 0.0, 0.0]]), 40.0)).all()
    assert np.isinf(around().scene().distance_m(at)).all()  # without things nothing is near


# --- woods ----------------------------------------------------------------------------------------

WOOD: dict[str, Any] = {"seed": 7, "clearing_share": 0.1, "spacing_m": [4.0, 8.0]}
WOOD |= {"north_min_m": -20.0, "north_max_m": 180.0, "east_min_m": 0.0, "east_max_m": 150.0}
WOOD |= {"radius_m": [0.2, 0.5], "height_m": [10.0, 20.0]}
WOOD |= {"clearings": [{"north_m": 50.0, "east_m": 60.0, "radius_m": 15.0}]}


def trees_of(made: World | None = None, **changes: Any) -> list[Tree]:
    (wood,) = (made or around(woods=[WOOD | changes])).woods
    return list(wood.trees())


@pytest.mark.parametrize("seed", range(5))
def test_a_wood_is_its_seeds_and_keeps_spacing_and_clearings_and_is_in_the_scene(seed: int) -> None:
    made, trees = around(woods=[WOOD]).with_woods_of(seed), trees_of(seed=seed)
    assert trees_of(made) == trees != trees_of(seed=seed + 1)
    places = np.array([(t.north_m, t.east_m) for t in trees])
    assert (places >= [-20.0, 0.0]).all()
    assert (places <= [180.0, 150.0]).all()
    next_m = cKDTree(places).query(places, k=2)[0][:, 1]
    assert next_m.min() >= 4.0
    assert np.quantile(next_m, 0.1) < 5.5  # clumps
    assert np.quantile(next_m, 0.9) > 6.0
    assert np.hypot(*(places - [50.0, 60.0]).T).min() >= 15.0 + 0.2
    assert all(0.2 <= t.radius_m <= 0.5 and 10.0 <= t.height_m <= 20.0 for t in trees)
    counts = [len(trees_of(seed=seed, clearing_share=s, clearings=[])) for s in (0.0, 0.3, 0.6)]
    assert counts == sorted(counts, reverse=True)
    assert counts[2] < 0.6 * counts[0]
    beside = [[t.north_m + t.radius_m + 1.0, t.east_m, PLAIN_M + 5.0] for t in trees[::40]]
    assert (made.scene().distance_m(np.array(beside)) <= 1.0 + 1e-9).all()
