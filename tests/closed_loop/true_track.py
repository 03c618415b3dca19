"""An independent judge of a flown track: what the vehicle truly did, against the true world.

    python tests/closed_loop/true_track.py WORLD_TOML MISSION_TOML TRUTH_JSONL

It shares no code with the two programs that it judges. Everything happens in the local frame:
north, east, altitude AMSL in metres (`_nea_m`); velocities are differences of positions.

What is judged begins at the first sample that is in the band (no more than 5 % of the safety
distance below the floor) and moves at more than 1 m/s over the ground, or at the first sample
more than 100 m (horizontally) from the place of take-off, whichever comes first: a climb-out
that wanders off below the band is judged too. It goes on to the end of the file.

- Terrain: the track is resampled every 10 m. Each point's nearest place on the surface is looked up
  among surface samples 100 m apart and then searched on ever finer grids about it, down to
  decimetres. For the points that come out worst the whole disc in which a nearer place could lie is
  searched again with 20 m samples, so that a second mountainside cannot hide behind the first.
- Radars: the exact part of every straight piece of the track that lies within the sphere.
- Turns: between the chords of two consecutive windows of 1 s; exact for a circle.  Climbs and
  dives: the slope of the chord of 1 s.
"""

import argparse
import json
import math
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rasterio
import shapely
from numpy.typing import NDArray
from pyproj import Geod
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

FloatArray = NDArray[np.float64]

TOLERANCE = 0.05
"""The part of a bound by which it may be missed; for altitudes, of the safety distance."""
ARRIVED_M = 50.0
"""As far as the end may be from the last target, horizontally."""
RESAMPLE_M = 10.0
WINDOW_S = 1.0
SLOWEST_M_S = 20.0
"""Turns and slopes are judged above this ground speed only, or half of V if that is less."""


class Check(NamedTuple):
    """One figure of the track beside the bound that it had to keep."""

    name: str
    value: float
    unit: str
    relation: str = ""
    """">=" or "<=", or "" for a figure without a bound."""
    bound: float = math.nan
    """What the mission asks."""
    limit: float = math.nan
    """The bound with its tolerance: what is enforced."""
    t_s: float = math.nan
    """Vehicle time of the worst moment; NaN where there is none."""

    @property
    def ok(self) -> bool:
        """Whether the limit was kept."""
        if self.relation == ">=":
            return self.value >= self.limit
        return self.relation == "" or self.value <= self.limit

    def __str__(self) -> str:
        bound = f" {self.relation} {self.bound:.1f} (limit {self.limit:.1f})" * bool(self.relation)
        when = f" at {self.t_s:.1f} s" if math.isfinite(self.t_s) else ""
        return f"{self.name} [{self.unit}]: {self.value:.1f}{bound}{when}" + " VIOLATION" * (
            not self.ok
        )


class TrueTrack(dict[str, Check]):
    """What a flown track truly was: its checks by their names."""

    @property
    def violations(self) -> list[Check]:
        """The checks that failed."""
        return [check for check in self.values() if not check.ok]

    @property
    def ok(self) -> bool:
        """Whether every bound was kept."""
        return not self.violations


class Surface(NamedTuple):
    """The true terrain: mountains of eq. 1 on a plain."""

    peaks: FloatArray
    """(K, 5): north, east, height, spread north, spread east, in metres."""
    ground_amsl_m: float
    combine: str

    def height_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Height AMSL of the surface. (...), (...) -> (...)."""
        height = np.full(np.broadcast(north_m, east_m).shape, -np.inf)
        if self.combine == "sum":
            height = np.zeros_like(height)
        for n, e, h, spread_n, spread_e in self.peaks:
            peak = h * np.exp(-(((north_m - n) / spread_n) ** 2) - ((east_m - e) / spread_e) ** 2)
            height = height + peak if self.combine == "sum" else np.maximum(height, peak)
        surface: FloatArray = np.maximum(height, self.ground_amsl_m)
        return surface


class Elevations(NamedTuple):
    """The true terrain: points of an elevation file, bilinear between them."""

    heights_amsl_m: FloatArray
    """(rows, columns), the first row in the north."""
    north_west_deg: tuple[float, float]
    """Latitude and longitude of the first."""
    step_deg: tuple[float, float]
    """From row to row, to the south, and from column to column."""
    origin_deg: tuple[float, float]

    def height_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Height AMSL of the surface; NaN beyond the file. (...), (...) -> (...)."""
        shape = np.broadcast(north_m, east_m).shape
        north, east = (np.ravel(each) for each in np.broadcast_arrays(north_m, east_m))
        latitude, longitude = (np.full(north.shape, each) for each in self.origin_deg)
        azimuth, distance = np.degrees(np.arctan2(east, north)), np.hypot(north, east)
        longitude, latitude, _ = Geod(ellps="WGS84").fwd(longitude, latitude, azimuth, distance)
        row = (self.north_west_deg[0] - latitude) / self.step_deg[0]
        column = (longitude - self.north_west_deg[1]) / self.step_deg[1]
        heights = map_coordinates(self.heights_amsl_m, [row, column], order=1, cval=np.nan)
        return np.reshape(heights, shape)


def surface_of(world: dict[str, Any], folder: Path = Path()) -> Surface | Elevations:
    """Read the terrain of a parsed world.toml, which names files as seen from its folder."""
    terrain = world["terrain"]
    if "file" in terrain:
        return _elevations(folder / terrain["file"], world)
    keys = ("north_m", "east_m", "height_amsl_m", "spread_north_m", "spread_east_m")
    rows = [[float(peak[key]) for key in keys] for peak in terrain.get("peaks", [])]
    if terrain["combine"] not in ("maximum", "sum"):
        raise ValueError(f"terrain.combine = {terrain['combine']!r}: neither maximum nor sum")
    return Surface(
        peaks=np.array(rows, dtype=np.float64).reshape(-1, 5),
        ground_amsl_m=float(terrain["ground_amsl_m"]),
        combine=terrain["combine"],
    )


def _elevations(path: Path, world: dict[str, Any]) -> Elevations:
    nodata = world["terrain"].get("nodata", math.nan)
    with rasterio.open(path) as file:
        heights = file.read(1, masked=True).astype(np.float64)
        north, west = file.transform.f, file.transform.c
        down, right = -file.transform.e, file.transform.a
    return Elevations(
        heights_amsl_m=heights.filled(0.0 if nodata == "sea" else nodata),
        north_west_deg=(north - down / 2, west + right / 2),  # of the middle of the pixel
        step_deg=(down, right),
        origin_deg=(world["origin"]["latitude_deg"], world["origin"]["longitude_deg"]),
    )


def clearances_m(points_nea_m: FloatArray, surface: Surface | Elevations) -> FloatArray:
    """Euclidean distance of points to the surface, negative below it. (P, 3) -> (P,)."""
    north, east, altitude = points_nea_m.T
    above = altitude - surface.height_m(north, east)
    # Nothing nearer than the ground straight below can lie further away than it, sideways.
    reach = float(np.abs(above).max()) + 200.0
    axes = [np.arange(a.min() - reach, a.max() + reach + 100.0, 100.0) for a in (north, east)]
    n, e = (a.ravel() for a in np.meshgrid(*axes, indexing="ij"))
    samples = np.stack([n, e, surface.height_m(n, e)], axis=-1)
    _, nearest = cKDTree(samples, balanced_tree=False, compact_nodes=False).query(points_nea_m)
    distance = _refined_m(points_nea_m, samples[nearest, :2], 150.0, surface)
    distance = np.minimum(distance, _refined_m(points_nea_m, points_nea_m[:, :2], 150.0, surface))
    for worst in _spread_worst(distance, 10):
        around = np.arange(-distance[worst], distance[worst] + 20.0, 20.0)
        n, e = (a.ravel() for a in np.meshgrid(north[worst] + around, east[worst] + around))
        offsets = np.stack([n, e, surface.height_m(n, e)], axis=-1) - points_nea_m[worst]
        k = int(np.argmin(np.sum(offsets**2, axis=-1)))
        foot = np.array([[n[k], e[k]]])
        again = _refined_m(points_nea_m[worst : worst + 1], foot, 30.0, surface)[0]
        distance[worst] = min(distance[worst], again)
    return np.where(above < 0, -distance, distance)


def _refined_m(
    points_nea_m: FloatArray, feet_ne_m: FloatArray, half_m: float, surface: Surface | Elevations
) -> FloatArray:
    """Distance to the surface near given feet, by ever finer grids. (P, 3), (P, 2) -> (P,)."""
    grid = np.linspace(-1.0, 1.0, 7)
    step = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)  # (G, 2)
    rows = np.arange(len(points_nea_m))
    best = np.full(len(points_nea_m), np.inf)
    feet = feet_ne_m
    while half_m > 0.1:
        tried = feet[:, None, :] + half_m * step  # (P, G, 2)
        height = surface.height_m(tried[..., 0], tried[..., 1])
        ground = np.sum((tried - points_nea_m[:, None, :2]) ** 2, axis=-1)
        squared = ground + (height - points_nea_m[:, None, 2]) ** 2
        k = np.argmin(squared, axis=1)
        feet = tried[rows, k]
        best = np.minimum(best, np.sqrt(squared[rows, k]))
        half_m *= 0.45
    return best


def _spread_worst(distance_m: FloatArray, count: int) -> list[int]:
    """Indices of the least distances, no two within 20 samples of each other."""
    chosen: list[int] = []
    for i in np.argsort(distance_m):
        if all(abs(int(i) - j) > 20 for j in chosen):
            chosen.append(int(i))
        if len(chosen) == count:
            break
    return chosen


def seconds_inside(
    t_s: FloatArray, track_nea_m: FloatArray, centre_nea_m: FloatArray, range_m: float
) -> FloatArray:
    """Time that each straight piece of a track spends in a sphere. (N,), (N, 3) -> (N - 1,)."""
    start = track_nea_m[:-1] - centre_nea_m
    leg = np.diff(track_nea_m, axis=0)
    a, b = np.sum(leg**2, axis=-1), np.sum(start * leg, axis=-1)
    c = np.sum(start**2, axis=-1) - range_m**2
    moving = a > 1e-12
    root = np.sqrt(np.maximum(b**2 - a * c, 0.0))
    safe = np.where(moving, a, 1.0)
    enter, leave = np.clip((-b - root) / safe, 0, 1), np.clip((-b + root) / safe, 0, 1)
    part = np.where(moving, np.where(b**2 > a * c, leave - enter, 0.0), (c < 0).astype(float))
    inside_s: FloatArray = part * np.diff(t_s)
    return inside_s


def keep_out_distances_m(points_nea_m: FloatArray, keep_out: dict[str, Any]) -> FloatArray:
    """Horizontal distance to a circle or polygon, negative inside. (P, 3) -> (P,)."""
    places = shapely.points(points_nea_m[:, :2])
    if "radius_m" in keep_out:
        centre = shapely.Point(keep_out["north_m"], keep_out["east_m"])
        away_m: FloatArray = shapely.distance(places, centre) - keep_out["radius_m"]
        return away_m
    polygon = shapely.Polygon(keep_out["vertices_m"])
    edge_m = shapely.distance(places, polygon.exterior)
    return np.where(shapely.contains(polygon, places), -edge_m, edge_m)


def resampled(t_s: FloatArray, track_nea_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A track every 10 m of its length, its corners' ends kept. -> times (P,), points (P, 3)."""
    leg = np.linalg.norm(np.diff(track_nea_m, axis=0), axis=-1)
    moved = np.concatenate([[True], leg > 1e-9])
    length = np.concatenate([[0.0], np.cumsum(leg)])[moved]
    wanted = np.append(np.arange(0.0, length[-1], RESAMPLE_M), length[-1])
    kept = track_nea_m[moved]
    points = np.stack([np.interp(wanted, length, kept[:, k]) for k in range(3)], axis=-1)
    return np.interp(wanted, length, t_s[moved]), points


def turns_and_slopes(
    t_s: FloatArray, track_nea_m: FloatArray, slowest_m_s: float = SLOWEST_M_S
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Turn radius and slope about each sample. (N,), (N, 3) -> times, radii_m, slopes_rad (M,).

    The radius of the circle through two consecutive chords of 1 s whose headings differ by D is
    their mean length / (2 sin(D / 2)). Samples with a chord no faster than that are left out.
    """
    middle = t_s[(t_s >= t_s[0] + WINDOW_S) & (t_s <= t_s[-1] - WINDOW_S)]
    before, here, after = (
        np.stack([np.interp(middle + d, t_s, track_nea_m[:, k]) for k in range(3)], axis=-1)
        for d in (-WINDOW_S, 0.0, WINDOW_S)
    )
    first, second = here - before, after - here
    ground_1 = np.hypot(first[:, 0], first[:, 1])
    ground_2 = np.hypot(second[:, 0], second[:, 1])
    fast = np.minimum(ground_1, ground_2) > slowest_m_s * WINDOW_S
    cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    dot = first[:, 0] * second[:, 0] + first[:, 1] * second[:, 1]
    turn = np.abs(np.arctan2(cross, dot))[fast]
    chord = ((ground_1 + ground_2) / 2)[fast]
    radius = np.full_like(chord, np.inf)
    np.divide(chord, 2 * np.sin(turn / 2), out=radius, where=turn > 1e-9)
    slopes = np.stack([np.arctan2(first[:, 2], ground_1), np.arctan2(second[:, 2], ground_2)])
    steepest = np.take_along_axis(slopes, np.argmax(np.abs(slopes), axis=0)[None], axis=0)[0]
    return middle[fast], radius, steepest[fast]


def read_truth(path: Path) -> tuple[FloatArray, FloatArray]:
    """Read truth.jsonl: times (N,) and positions (N, 3)."""
    lines = path.read_text(encoding="utf-8").splitlines()[1:]  # the first is a header
    rows = [json.loads(line) for line in lines if line.strip()]
    keys = ("t_s", "north_m", "east_m", "altitude_amsl_m")
    table = np.array([[row[key] for key in keys] for row in rows], dtype=np.float64).reshape(-1, 4)
    if len(table) < 2 or not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0).any():
        raise ValueError(f"{path}: needs two or more samples, all finite, with rising t_s")
    return table[:, 0], table[:, 1:]


def crash_check(path: Path) -> Check:
    """Whether truth.jsonl tells of a crash anywhere, before or after what is judged: never one."""
    lines = path.read_text(encoding="utf-8").splitlines()
    crashes = (json.loads(line).get("crash") for line in lines if '"crash"' in line)
    crash = next(filter(None, crashes), {"speed_m_s": 0.0, "t_s": math.nan})
    return Check("speed of a crash", crash["speed_m_s"], "m/s", "<=", 0.0, 0.0, crash["t_s"])


def first_judged(t_s: FloatArray, track_nea_m: FloatArray, lowest_amsl_m: float) -> int:
    """Index of the sample at which the judged part of a track begins."""
    speed = np.hypot(*np.diff(track_nea_m[:, :2], axis=0).T) / np.diff(t_s)
    strayed = np.hypot(*(track_nea_m[:, :2] - track_nea_m[0, :2]).T)[:-1] > 100.0
    begun = ((speed > 1.0) & (track_nea_m[:-1, 2] >= lowest_amsl_m)) | strayed
    if not begun.any():
        raise ValueError("the vehicle never flew: no sample moves over the ground in the band")
    return int(np.argmax(begun))


def judge(
    world: dict[str, Any],
    mission: dict[str, Any],
    t_s: FloatArray,
    track_nea_m: FloatArray,
    folder: Path = Path(),
) -> TrueTrack:
    """Judge a track against the true world and the mission's bounds.

    world, mission : the parsed world.toml and mission.toml
    t_s : vehicle times (N,)
    track_nea_m : positions in the local frame, altitude AMSL (N, 3)
    folder : where the files are that the world names
    """
    if world["origin"] != mission["origin"]:
        raise ValueError("the world and the mission have different origins")
    vehicle, altitude = mission["vehicle"], mission["altitude"]
    safety = float(mission["planner"]["safety_distance_m"])
    floor, ceiling = float(altitude["floor_amsl_m"]), float(altitude["ceiling_amsl_m"])
    slack = TOLERANCE * safety
    first = first_judged(t_s, track_nea_m, floor - slack)
    t_s, track_nea_m = t_s[first:], track_nea_m[first:]
    point_t_s, points = resampled(t_s, track_nea_m)
    low, high, track = 1 - TOLERANCE, 1 + TOLERANCE, TrueTrack()

    def figure(name: str, value: float, unit: str, *bound: Any) -> None:
        track[name] = Check(name, float(value), unit, *bound)

    def least(name: str, values: FloatArray, times: FloatArray, bound: float, limit: float) -> None:
        worst = int(np.argmin(values)) if len(values) else -1
        value, at_s = (values[worst], times[worst]) if len(values) else (math.inf, math.nan)
        figure(name, value, "m", ">=", bound, limit, float(at_s))

    def most(name: str, values: FloatArray, times: FloatArray, unit: str, *bound: float) -> None:
        worst = int(np.argmax(values)) if len(values) else -1
        value, at_s = (values[worst], times[worst]) if len(values) else (0.0, math.nan)
        figure(name, value, unit, "<=", *bound, float(at_s))

    clearances = clearances_m(points, surface_of(world, folder))
    least("distance to terrain", clearances, point_t_s, safety, low * safety)
    total_s = 0.0
    for radar in world.get("radars", []):
        centre = np.array([radar["north_m"], radar["east_m"], radar["altitude_amsl_m"]])
        spent = seconds_inside(t_s, track_nea_m, centre, radar["range_m"])
        total_s += spent.sum()
        figure(f"time inside {radar['name']}", spent.sum(), "s", "<=", 0.0, 0.0)
    figure("time inside radars", total_s, "s", "<=", 0.0, 0.0)
    zones = [keep_out_distances_m(points, zone) for zone in mission.get("keep_outs", [])]
    nearest = np.min(zones, axis=0) if zones else np.empty(0)
    least("distance to keep-outs", nearest, point_t_s, safety, low * safety)
    slowest_m_s = min(SLOWEST_M_S, 0.5 * float(vehicle.get("speed_m_s", math.inf)))
    middle_s, radii, slopes = turns_and_slopes(t_s, track_nea_m, slowest_m_s)
    turn = float(vehicle["turn_radius_m"])
    least("turn radius", radii, middle_s, turn, low * turn)
    for what, sign in (("climb", 1.0), ("dive", -1.0)):
        steepest, degrees = float(vehicle[f"{what}_angle_deg"]), sign * np.degrees(slopes)
        bounds = steepest, high * steepest
        most(f"{what} angle", np.maximum(degrees, 0.0), middle_s, "deg", *bounds)
    heights = track_nea_m[:, 2]
    least("lowest altitude AMSL", heights, t_s, floor, floor - slack)
    most("highest altitude AMSL", heights, t_s, "m", ceiling, ceiling + slack)
    target, end = mission["targets"][-1], track_nea_m[-1]
    miss_m = math.dist(end[:2], (target["north_m"], target["east_m"]))
    figure("end to target", miss_m, "m", "<=", ARRIVED_M, ARRIVED_M, float(t_s[-1]))
    figure("length flown", np.linalg.norm(np.diff(track_nea_m, axis=0), axis=-1).sum(), "m")
    figure("begins", t_s[0], "s")
    figure("duration", t_s[-1] - t_s[0], "s")
    return track


def judge_files(world_toml: Path, mission_toml: Path, truth_jsonl: Path) -> TrueTrack:
    """Judge a flight by its three files."""
    world = tomllib.loads(world_toml.read_text(encoding="utf-8"))
    mission = tomllib.loads(mission_toml.read_text(encoding="utf-8"))
    track = judge(world, mission, *read_truth(truth_jsonl), world_toml.parent)
    crash = crash_check(truth_jsonl)
    return TrueTrack(track | {crash.name: crash})


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge a flight; 0 when every bound was kept, 1 on a violation."""
    parser = argparse.ArgumentParser(description="Judge a flown track against the true world.")
    for name in ("world_toml", "mission_toml", "truth_jsonl"):
        parser.add_argument(name, type=Path)
    given = parser.parse_args(arguments)
    track = judge_files(given.world_toml, given.mission_toml, given.truth_jsonl)
    sys.stdout.write("".join(f"{check}\n" for check in track.values()))
    return 0 if track.ok else 1


if __name__ == "__main__":
    sys.exit(main())
