"""The bundled valley keeps its promises: real ground, a way that winds, a safe route along it.

An implementation of its own, on purpose: heights come from matplotlib's sample and not from the
file that was made of it, positions from geodesics, the route from Dijkstra on a 25 m grid and a
smoothing spline that is then measured against the ground and the keep-outs.
"""

import functools
import math
import tomllib
from pathlib import Path

import numpy as np
from matplotlib import cbook
from matplotlib.path import Path as Outline
from numpy.typing import NDArray
from pyproj import Geod
from scipy.interpolate import make_splprep
from scipy.ndimage import grey_dilation, map_coordinates
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

FOLDER = Path(__file__).parents[1] / "companion" / "environments" / "valley"
WORLD = tomllib.loads((FOLDER / "world.toml").read_text(encoding="utf-8"))
MISSION = tomllib.loads((FOLDER / "mission.toml").read_text(encoding="utf-8"))
WGS84 = Geod(ellps="WGS84")
CELL_M = 25.0
NORTH_M = np.arange(-5_000.0, 5_000.0 + CELL_M, CELL_M)
EAST_M = np.arange(-4_000.0, 3_500.0 + CELL_M, CELL_M)
START = (WORLD["vehicle"]["north_m"], WORLD["vehicle"]["east_m"])
TARGET = (MISSION["targets"][0]["north_m"], MISSION["targets"][0]["east_m"])
CEILING_M = MISSION["altitude"]["ceiling_amsl_m"]
FLOOR_M = MISSION["altitude"]["floor_amsl_m"]
CRUISE_M = CEILING_M - 20.0
MARGIN_M = 60.0  # d_s 40 m, tracking and navigation 5 m each, and 10 m to spare


@functools.cache
def sample() -> FloatArray:
    """Elevations, row 0 in the north: the Valley and Ridge lies south-east of the mountains."""
    elevation = cbook.get_sample_data("jacksboro_fault_dem.npz")["elevation"]
    return np.asarray(elevation, dtype=float)


def terrain_m(north_m: FloatArray, east_m: FloatArray) -> FloatArray:
    north, east = (x.ravel() for x in np.broadcast_arrays(north_m, east_m))
    ones = np.ones_like(north)
    longitude, latitude, _ = WGS84.fwd(
        WORLD["origin"]["longitude_deg"] * ones,
        WORLD["origin"]["latitude_deg"] * ones,
        np.degrees(np.arctan2(east, north)),
        np.hypot(north, east),
    )
    row, column = (36.73291667 - latitude) * 1200 - 0.5, (longitude + 84.41375) * 1200 - 0.5
    assert row.min() >= 0
    assert column.min() >= 0
    assert row.max() <= 343
    assert column.max() <= 402
    found: FloatArray = map_coordinates(sample(), [row, column], order=1)
    return found.reshape(np.broadcast(north_m, east_m).shape)


def keep_out_margins_m(north_m: FloatArray, east_m: FloatArray) -> FloatArray:
    """Distance to each keep-out's edge, negative inside.  (...) x2 -> (4, ...)."""
    points = np.stack([north_m, east_m], axis=-1)
    margins = []
    for zone in MISSION["keep_outs"]:
        if "radius_m" in zone:
            centre = (zone["north_m"], zone["east_m"])
            margins.append(np.linalg.norm(points - centre, axis=-1) - zone["radius_m"])
            continue
        corners = np.array(zone["vertices_m"])
        nearest = np.full(north_m.shape, math.inf)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            foot = a + share[..., None] * (b - a)
            nearest = np.minimum(nearest, np.linalg.norm(points - foot, axis=-1))
        inside = Outline(corners).contains_points(points.reshape(-1, 2)).reshape(north_m.shape)
        margins.append(np.where(inside, -nearest, nearest))
    return np.stack(margins)


@functools.cache
def grid() -> tuple[FloatArray, FloatArray]:
    """On the grid: the lowest altitude at which MARGIN_M is kept to its points; keep-outs."""
    north, east = np.meshgrid(NORTH_M, EAST_M, indexing="ij")
    reach = math.ceil(MARGIN_M / CELL_M)
    away = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1]) * CELL_M
    ball = np.where(away < MARGIN_M, np.sqrt(np.maximum(MARGIN_M**2 - away**2, 0.0)), -1e6)
    lowest = grey_dilation(terrain_m(north, east), footprint=ball > -1e6, structure=ball)
    return lowest, keep_out_margins_m(north, east).min(axis=0)


def shortest_route(free: BoolArray) -> tuple[float, FloatArray]:
    """Dijkstra from start to target over 16 directions -> length_m, (N, 2) positions."""
    cell = np.arange(free.size).reshape(free.shape)
    rows, columns = free.shape
    starts, ends, costs = [], [], []
    for i, j in ((1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2)):
        a = cell[: rows - i, max(0, -j) : columns - max(0, j)]
        b = cell[i:, max(0, j) : columns + min(0, j)]
        ok = free.flat[a] & free.flat[b]
        starts.append(a[ok])
        ends.append(b[ok])
        costs.append(np.full(int(ok.sum()), CELL_M * math.hypot(i, j)))
    ij = (np.concatenate(starts), np.concatenate(ends))
    graph = coo_array((np.concatenate(costs), ij), shape=(free.size, free.size)).tocsr()
    begin, end = (
        int(cell[np.abs(NORTH_M - p[0]).argmin(), np.abs(EAST_M - p[1]).argmin()])
        for p in (START, TARGET)
    )
    found = dijkstra(graph, directed=False, indices=np.array([begin]), return_predecessors=True)
    lengths, before = found[0][0], found[1][0]
    if not np.isfinite(lengths[end]):
        return math.inf, np.empty((0, 2))
    route = [end]
    while route[-1] != begin:
        route.append(int(before[route[-1]]))
    at = np.array(route[::-1])
    return float(lengths[end]), np.stack([NORTH_M[at // columns], EAST_M[at % columns]], axis=-1)


def test_world_and_mission_agree_on_the_frame_and_the_vehicle() -> None:
    assert WORLD["name"] == MISSION["name"] == "valley"
    assert WORLD["origin"] == MISSION["origin"]
    for key in ("north_min_m", "east_min_m"):
        assert WORLD["area"][key] <= MISSION["area"][key]
    for key in ("north_max_m", "east_max_m"):
        assert WORLD["area"][key] >= MISSION["area"][key]
    vehicle, limits = WORLD["vehicle"], MISSION["vehicle"]
    assert vehicle["speed_max_m_s"] > limits["speed_m_s"] == 8.0
    assert limits["speed_m_s"] ** 2 / limits["turn_radius_m"] < vehicle["acceleration_max_m_s2"]
    assert limits["speed_m_s"] * math.tan(math.radians(limits["climb_angle_deg"])) <= 2.5
    assert WORLD["scanner"]["range_m"] >= MISSION["planner"]["scan_range_m"] == 1_500.0
    assert MISSION["planner"]["safety_distance_m"] == 40.0


def test_there_are_four_keep_outs_two_of_them_circles_and_start_and_target_lie_outside() -> None:
    assert sum("radius_m" in zone for zone in MISSION["keep_outs"]) == 2
    assert sum("vertices_m" in zone for zone in MISSION["keep_outs"]) == 2
    for place in (START, TARGET):
        assert keep_out_margins_m(np.array([place[0]]), np.array([place[1]])).min() > 200.0


def test_the_ground_at_start_and_target_is_low_and_the_straight_way_between_is_barred() -> None:
    share = np.linspace(0.0, 1.0, 2_000)
    straight = [a + share * (b - a) for a, b in zip(START, TARGET, strict=True)]
    below = terrain_m(*straight)
    assert below[0] < FLOOR_M - 50.0
    assert below[-1] < FLOOR_M - 50.0
    assert below.max() > CEILING_M
    lowest, keep_out = grid()
    anyhow, _ = shortest_route(np.ones(lowest.shape, dtype=bool))
    length_m, _ = shortest_route((lowest <= CRUISE_M) & (keep_out >= MARGIN_M))
    assert length_m > 1.1 * anyhow


def test_each_keep_out_lies_in_the_natural_way() -> None:
    lowest, _ = grid()
    _, route = shortest_route(lowest <= CRUISE_M)
    margins = keep_out_margins_m(route[:, 0], route[:, 1])
    assert (margins.min(axis=1) < 0.0).all()


def test_a_smooth_route_with_all_margins_exists() -> None:
    lowest, keep_out = grid()
    length_m, route = shortest_route((lowest <= CRUISE_M - 25.0) & (keep_out >= MARGIN_M + 40.0))
    assert 8_000.0 <= length_m <= 9_500.0
    weight = np.ones(len(route))
    weight[[0, -1]] = 1e3  # the ends stay where they are
    spline, _ = make_splprep(list(route.T), w=weight, s=len(route) * 12.0**2, k=5)
    u = np.linspace(0.0, 1.0, 4_000)
    (north, east), (dn, de), (ddn, dde) = spline(u), spline(u, nu=1), spline(u, nu=2)
    speed = np.hypot(dn, de)
    assert (speed**3 / np.maximum(np.abs(dn * dde - de * ddn), 1e-9)).min() >= 50.0  # 2 x radius
    way_m = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(north), np.diff(east)))])
    altitude = np.minimum(FLOOR_M + 10.0 + 0.2 * way_m, CRUISE_M)  # an eleventh degree of climb
    assert keep_out_margins_m(north, east).min() >= MARGIN_M
    around = np.arange(-MARGIN_M, MARGIN_M + 1.0, 10.0)
    nearest = np.full(len(u), math.inf)
    for offset_n in around:
        for offset_e in around:
            height = np.maximum(altitude - terrain_m(north + offset_n, east + offset_e), 0.0)
            nearest = np.minimum(nearest, np.sqrt(offset_n**2 + offset_e**2 + height**2))
    assert nearest.min() >= 55.0
    assert north.min() >= -5_000.0 + MARGIN_M
    assert east.min() >= -4_000.0 + MARGIN_M
