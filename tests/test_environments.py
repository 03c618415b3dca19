"""The bundled worlds keep their promises: they are hard enough, and a safe route exists.

An implementation of its own, on purpose: it uses no planner, no terrain code, no file reader of the
product. The route is found by Dijkstra on a 250 m grid around inflated obstacles, smoothed by a
spline, and the spline is then measured against the true world.
"""

import functools
import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import make_splprep
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

ENVIRONMENTS = Path(__file__).parents[1] / "companion" / "environments"
NAMES = ("environment-1", "environment-2")
CELL_M = 250.0
AXIS_M = np.arange(-5_000.0, 105_000.0 + CELL_M, CELL_M)
FLIGHT_AMSL_M = 3_050.0
STRAIGHT_M = math.hypot(100_000.0, 100_000.0)
EVERY_NAME = pytest.mark.parametrize("name", NAMES)


@functools.cache
def read(name: str, file: str) -> dict[str, Any]:
    return tomllib.loads((ENVIRONMENTS / name / file).read_text(encoding="utf-8"))


def terrain_m(world: dict[str, Any], north_m: FloatArray, east_m: FloatArray) -> FloatArray:
    """Eq. 1, the highest of the mountains and the plain."""
    height = np.full(np.broadcast(north_m, east_m).shape, world["terrain"]["ground_amsl_m"])
    for p in world["terrain"]["peaks"]:
        x = (north_m - p["north_m"]) / p["spread_north_m"]
        y = (east_m - p["east_m"]) / p["spread_east_m"]
        height = np.maximum(height, p["height_amsl_m"] * np.exp(-x * x - y * y))
    return height


def radar_margin_m(world: dict[str, Any], north_m: FloatArray, east_m: FloatArray) -> FloatArray:
    """Horizontal distance to the nearest radar circle, negative inside."""
    margins: list[FloatArray] = [
        np.hypot(north_m - r["north_m"], east_m - r["east_m"]) - r["range_m"]
        for r in world["radars"]
    ]
    nearest: FloatArray = np.min(margins, axis=0)
    return nearest


def terrain_margin_m(
    world: dict[str, Any], north_m: FloatArray, east_m: FloatArray, reach_m: float, step_m: float
) -> FloatArray:
    """Euclidean distance at the flight altitude to the terrain, as far as reach_m.

    Points of the surface step_m apart: too great by at most about step_m^2 / reach_m.
    """
    around = np.arange(-reach_m, reach_m + step_m, step_m)
    nearest = np.full(north_m.shape, reach_m**2)
    for dn in around:
        for de in around[np.hypot(dn, around) <= reach_m]:
            below = FLIGHT_AMSL_M - terrain_m(world, north_m + dn, east_m + de)
            nearest = np.minimum(nearest, dn**2 + de**2 + np.maximum(below, 0.0) ** 2)
    return np.asarray(np.sqrt(nearest))


@functools.cache
def grid_terrain_margin_m(name: str) -> FloatArray:
    """Distance to the terrain on the grid, up to 3 km: the heights of the grid, shifted."""
    north, east = np.meshgrid(AXIS_M, AXIS_M, indexing="ij")
    below = np.maximum(FLIGHT_AMSL_M - terrain_m(read(name, "world.toml"), north, east), 0.0)
    far = round(3_000.0 / CELL_M)
    padded = np.pad(below, far, constant_values=FLIGHT_AMSL_M)
    size = len(AXIS_M)
    nearest = np.full_like(below, 3_000.0**2)
    for i in range(-far, far + 1):
        for j in range(-far, far + 1):
            shifted = padded[far + i : far + i + size, far + j : far + j + size]
            sideways = (i * i + j * j) * CELL_M**2
            np.minimum(nearest, sideways + shifted**2, out=nearest)
    return np.asarray(np.sqrt(nearest))


def free_cells(
    name: str, terrain_margin_wanted_m: float, radar_margin_wanted_m: float
) -> BoolArray:
    north, east = np.meshgrid(AXIS_M, AXIS_M, indexing="ij")
    radars = radar_margin_m(read(name, "world.toml"), north, east) >= radar_margin_wanted_m
    return radars & (grid_terrain_margin_m(name) >= terrain_margin_wanted_m)


def shortest_route(free: BoolArray) -> tuple[float, FloatArray]:
    """Dijkstra from start to target over 16 directions -> length_m, (N, 2) positions."""
    size = len(free)
    cell = np.arange(size * size).reshape(size, size)
    starts, ends, costs = [], [], []
    for i, j in ((1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2)):
        a = cell[: size - i, max(0, -j) : size - max(0, j)]
        b = cell[i:, max(0, j) : size + min(0, j)]
        ok = free.flat[a] & free.flat[b]
        starts.append(a[ok])
        ends.append(b[ok])
        costs.append(np.full(int(ok.sum()), CELL_M * math.hypot(i, j)))
    shape = (size * size, size * size)
    ij = (np.concatenate(starts), np.concatenate(ends))
    graph = coo_array((np.concatenate(costs), ij), shape=shape).tocsr()
    begin, end = (int(cell[(round((m + 5_000.0) / CELL_M),) * 2]) for m in (0.0, 100_000.0))
    found = dijkstra(graph, directed=False, indices=np.array([begin]), return_predecessors=True)
    lengths, before = found[0][0], found[1][0]
    if not np.isfinite(lengths[end]):
        return math.inf, np.empty((0, 2))
    route = [end]
    while route[-1] != begin:
        route.append(int(before[route[-1]]))
    cells = np.array(route[::-1])
    return float(lengths[end]), np.stack([AXIS_M[cells // size], AXIS_M[cells % size]], axis=-1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Corridor:
    """A smooth route and what was measured along it."""

    route_ne_m: FloatArray
    length_m: float
    radius_m: float
    terrain_margin_m: float
    radar_margin_m: float


def smoothed(name: str, route_ne_m: FloatArray, strayed_m: float) -> Corridor:
    """A quintic spline that strays from the route by about strayed_m."""
    weight = np.ones(len(route_ne_m))
    weight[[0, -1]] = 1e3  # the ends stay where they are
    spline, _ = make_splprep(list(route_ne_m.T), w=weight, s=len(route_ne_m) * strayed_m**2, k=5)
    u = np.linspace(0.0, 1.0, 3_000)
    north, east = spline(u)
    dn, de = spline(u, nu=1)
    ddn, dde = spline(u, nu=2)
    curvature = np.abs(dn * dde - de * ddn) / np.hypot(dn, de) ** 3
    world = read(name, "world.toml")
    return Corridor(
        route_ne_m=np.stack([north, east], axis=-1),
        length_m=float(np.hypot(np.diff(north), np.diff(east)).sum()),
        radius_m=float(1.0 / curvature.max()),
        terrain_margin_m=float(terrain_margin_m(world, north, east, 900.0, 60.0).min()),
        radar_margin_m=float(radar_margin_m(world, north, east).min()),
    )


@functools.cache
def corridor(name: str) -> Corridor:
    """The first smoothing of the route at which no turn is tighter than 3.5 km."""
    length, route = shortest_route(free_cells(name, 1_500.0, 1_300.0))
    assert math.isfinite(length), "no way through with 700 m to spare"
    for strayed_m in (50.0, 75.0, 100.0, 150.0, 200.0, 250.0, 300.0, 400.0):
        found = smoothed(name, route, strayed_m)
        if found.radius_m >= 3_500.0:
            return found
    pytest.fail("no smoothing keeps the turn radius")


@EVERY_NAME
def test_a_smooth_radar_free_route_with_all_margins_exists(name: str) -> None:
    found = corridor(name)
    assert found.radius_m >= 3_500.0
    assert found.terrain_margin_m >= 800.0 + 5.0  # 5 m: the samples of the surface
    assert found.radar_margin_m >= 600.0
    assert found.length_m <= 1.2 * STRAIGHT_M
    np.testing.assert_allclose(found.route_ne_m[0], [0.0, 0.0], atol=50.0)
    np.testing.assert_allclose(found.route_ne_m[-1], [100_000.0, 100_000.0], atol=50.0)
    assert found.route_ne_m.min() >= -5_000.0 + 600.0
    assert found.route_ne_m.max() <= 105_000.0 - 600.0


@EVERY_NAME
def test_the_gaps_on_the_way_are_four_kilometres_wide(name: str) -> None:
    length, _ = shortest_route(free_cells(name, 2_000.0, 2_000.0))
    assert length <= 1.2 * STRAIGHT_M


@EVERY_NAME
def test_the_straight_line_is_barred_by_terrain_and_by_a_radar(name: str) -> None:
    line = np.linspace(0.0, 100_000.0, 4_001)
    world = read(name, "world.toml")
    assert terrain_m(world, line, line).max() > 3_000.0
    assert radar_margin_m(world, line, line).min() < 0.0


def test_the_route_through_the_dense_world_weaves() -> None:
    route = corridor("environment-2").route_ne_m
    left_m = (route[:, 0] - route[:, 1]) / math.sqrt(2.0)  # of the straight line
    far = np.sign(left_m[np.abs(left_m) > 2_000.0])
    assert np.count_nonzero(np.diff(far)) >= 3


@EVERY_NAME
def test_start_and_target_are_low_and_out_of_sight(name: str) -> None:
    north, east = np.meshgrid(AXIS_M, AXIS_M, indexing="ij")
    world = read(name, "world.toml")
    height, margin = terrain_m(world, north, east), radar_margin_m(world, north, east)
    start, target = np.hypot(north, east), np.hypot(north - 100_000.0, east - 100_000.0)
    assert height[start <= 3_000.0].max() < 300.0
    assert height[target <= 5_000.0].max() < 2_000.0
    assert margin[np.minimum(start, target) <= 5_000.0].min() > 0.0


@pytest.mark.parametrize(
    ("name", "peaks", "radars", "ranges_m", "overlaps"),
    [
        ("environment-1", 4, 3, (9_000.0, 15_000.0), 0),
        ("environment-2", 12, 10, (6_000.0, 11_000.0), 4),
    ],
)
def test_each_world_holds_what_its_kind_promises(
    name: str, peaks: int, radars: int, ranges_m: tuple[float, float], overlaps: int
) -> None:
    world = read(name, "world.toml")
    heights = [p["height_amsl_m"] for p in world["terrain"]["peaks"]]
    assert len(heights) == peaks
    assert 3_400.0 <= min(heights) <= max(heights) <= 6_000.0
    assert len(world["radars"]) == radars
    assert all(ranges_m[0] <= r["range_m"] <= ranges_m[1] for r in world["radars"])
    pairs = [(a, b) for i, a in enumerate(world["radars"]) for b in world["radars"][:i]]
    apart = [math.dist((a["north_m"], a["east_m"]), (b["north_m"], b["east_m"])) for a, b in pairs]
    reach = [a["range_m"] + b["range_m"] for a, b in pairs]
    assert sum(d < r for d, r in zip(apart, reach, strict=True)) >= overlaps


@EVERY_NAME
def test_radars_stand_on_the_ground_and_are_the_same_in_both_files(name: str) -> None:
    world, mission = read(name, "world.toml"), read(name, "mission.toml")
    assert world["radars"] == mission["radars"]
    assert len({r["name"] for r in world["radars"]}) == len(world["radars"])
    for r in world["radars"]:
        ground = terrain_m(world, np.array(r["north_m"]), np.array(r["east_m"])).item()
        assert -1.0 <= r["altitude_amsl_m"] - ground <= 50.0


@EVERY_NAME
def test_world_and_mission_agree_on_the_frame_and_the_vehicle(name: str) -> None:
    world, mission = read(name, "world.toml"), read(name, "mission.toml")
    assert world["name"] == mission["name"] == name
    assert world["schema"] == mission["schema"] == 1
    assert world["origin"] == mission["origin"] == {"latitude_deg": 47.0, "longitude_deg": 8.0}
    assert mission["targets"] == [{"north_m": 100_000.0, "east_m": 100_000.0}]
    for key in ("kind", "autopilot"):
        assert world["vehicle"][key] == mission["vehicle"][key]
    assert world["vehicle"]["speed_max_m_s"] > mission["vehicle"]["speed_m_s"]
    assert world["vehicle"]["acceleration_max_m_s2"] > mission["vehicle"]["acceleration_m_s2"]
    assert world["scanner"]["range_m"] >= mission["planner"]["scan_range_m"]
    turn_m_s2 = mission["vehicle"]["speed_m_s"] ** 2 / mission["vehicle"]["turn_radius_m"]
    assert turn_m_s2 <= world["vehicle"]["acceleration_max_m_s2"]
