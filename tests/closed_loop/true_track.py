"""An independent judge of a flown track: what the vehicle truly did, against the true world.

It shares no code with the two programs that it judges.  Everything happens in the local frame:
north, east, altitude AMSL in metres (`_nea_m`).  Each rule has a margin: by how much it was kept,
with a tolerance of 5 % of the bound (for altitudes, of the safety distance); negative: broken.

What is judged begins at the first sample that is in the band and moves at more than 1 m/s over the
ground, or that is more than 100 m away from the place of take-off: a climb-out that wanders off
below the band is judged too.
"""

import json
import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import shapely
from numpy.typing import NDArray
from pyproj import Geod
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

FloatArray = NDArray[np.float64]
Heights = Callable[[FloatArray, FloatArray], FloatArray]
"""North, east -> height AMSL of the ground there; NaN where it is not known."""
Margins = dict[str, float]

TOLERANCE = 0.05
ARRIVED_M = 50.0
"""As far as the end may be from the last target, horizontally."""
STEP = 0.05
"""Between samples of track and ground, of the safety distance: a distance is found as a quarter
of a per cent too long at most."""
WINDOW_S = 1.0
"""Turns and slopes are those of chords of so long."""
SLOWEST_M_S = 20.0
"""They are judged above this ground speed only, or half of V if that is less."""


def heights_of(world: dict[str, Any], folder: Path = Path()) -> Heights:
    """The terrain of a parsed world.toml, which names files as seen from its folder."""
    terrain = world["terrain"]
    if "file" in terrain:
        return _of_file(folder / terrain["file"], terrain.get("nodata", math.nan), world["origin"])
    together = {"maximum": np.maximum, "sum": np.add}[terrain["combine"]]

    def height_m(north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        up_m: Any = 0.0 if together is np.add else -math.inf
        for peak in terrain.get("peaks", ()):  # eq. 1 of the paper
            north = (north_m - peak["north_m"]) / peak["spread_north_m"]
            east = (east_m - peak["east_m"]) / peak["spread_east_m"]
            up_m = together(up_m, peak["height_amsl_m"] * np.exp(-(north**2) - east**2))
        return np.maximum(up_m, terrain["ground_amsl_m"] + 0.0 * (north_m + east_m))

    return height_m


def _of_file(path: Path, nodata: float | str, origin: dict[str, float]) -> Heights:
    """Of an elevation file, whose heights are those of the middles of its pixels."""
    with rasterio.open(path) as file:
        heights = file.read(1, masked=True).astype(np.float64)
        heights, at = heights.filled(0.0 if nodata == "sea" else nodata), file.transform

    def height_m(north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        north, east = np.broadcast_arrays(north_m, east_m)
        here = [np.full(north.shape, origin[key]) for key in ("longitude_deg", "latitude_deg")]
        azimuth_deg, away_m = np.degrees(np.arctan2(east, north)), np.hypot(north, east)
        longitude, latitude, _ = Geod(ellps="WGS84").fwd(*here, azimuth_deg, away_m)
        pixels = (latitude - at.f) / at.e - 0.5, (longitude - at.c) / at.a - 0.5
        return map_coordinates(heights, pixels, order=1, cval=math.nan)

    return height_m


def clearance_m(points_nea_m: FloatArray, height_m: Heights, near_m: float, step_m: float) -> float:
    """Least distance of points to samples of the ground; near_m if it is more.  (P, 3).

    Below the ground: by how much, negative.
    """
    north, east, up_m = points_nea_m.T
    least_m = min(near_m, float(np.nanmin(up_m - height_m(north, east))))
    tree = cKDTree(points_nea_m)
    # all that is near lies in the squares of the points or in those beside them
    squares = {(n, e) for n, e in np.round(points_nea_m[:, :2] / near_m).astype(int).tolist()}
    squares = {(n + i, e + k) for n, e in squares for i in (-1, 0, 1) for k in (-1, 0, 1)}
    inside_m = np.arange(-0.5 * near_m, 0.5 * near_m, step_m)
    for square in squares if least_m > 0.0 else ():
        n, e = np.meshgrid(*(number * near_m + inside_m for number in square))
        ground = np.stack([n, e, height_m(n, e)], axis=-1).reshape(-1, 3)
        ground = ground[ground[:, 2] > up_m.min() - least_m]
        found_m, _ = tree.query(ground, distance_upper_bound=least_m)
        least_m = min([least_m, *found_m[np.isfinite(found_m)]])
    return float(least_m)


def keep_out_m(points_nea_m: FloatArray, keep_out: dict[str, Any]) -> FloatArray:
    """Horizontal distance to a circle or polygon, negative inside.  (P, 3) -> (P,)."""
    places = shapely.points(points_nea_m[:, :2])
    if "radius_m" in keep_out:
        centre = shapely.Point(keep_out["north_m"], keep_out["east_m"])
        return shapely.distance(places, centre) - keep_out["radius_m"]
    polygon = shapely.Polygon(keep_out["vertices_m"])
    edge_m = shapely.distance(places, polygon.exterior)
    return np.where(shapely.contains(polygon, places), -edge_m, edge_m)


def turns_and_slopes(
    t_s: FloatArray, track_nea_m: FloatArray, slowest_m_s: float = SLOWEST_M_S
) -> tuple[FloatArray, FloatArray]:
    """Turn radius and slope about each sample.  (N,), (N, 3) -> radii_m (M,), slopes_rad (2, M).

    The radius of the circle through two consecutive chords of 1 s whose headings differ by D is
    their mean length / (2 sin(D / 2)).  Samples with a chord no faster than that are left out.
    """
    middle_s = t_s[(t_s >= t_s[0] + WINDOW_S) & (t_s <= t_s[-1] - WINDOW_S)]
    at = [
        np.stack([np.interp(middle_s + d, t_s, axis) for axis in track_nea_m.T], axis=-1)
        for d in (-WINDOW_S, 0.0, WINDOW_S)
    ]
    chords = np.diff(at, axis=0)  # (2, M, 3)
    flat = chords[..., 0] + 1j * chords[..., 1]
    fast = np.abs(flat).min(axis=0) > slowest_m_s * WINDOW_S
    flat = flat[:, fast]
    half_turn = 0.5 * np.abs(np.angle(flat[1] * flat[0].conj()))
    length_m = np.abs(flat).mean(axis=0)
    radii_m = np.full(length_m.shape, np.inf)
    np.divide(length_m, 2.0 * np.sin(half_turn), out=radii_m, where=half_turn > 1e-9)
    return radii_m, np.arctan2(chords[:, fast, 2], np.abs(flat))


def judge(
    world: dict[str, Any],
    mission: dict[str, Any],
    t_s: FloatArray,
    track_nea_m: FloatArray,
    folder: Path = Path(),
) -> Margins:
    """By how much a track has kept each bound of the mission in the true world.

    world, mission : the parsed world.toml and mission.toml
    t_s : vehicle times (N,)
    track_nea_m : positions in the local frame, altitude AMSL (N, 3)
    folder : where the files are that the world names
    """
    if world["origin"] != mission["origin"]:
        raise ValueError("the world and the mission have different origins")
    vehicle, band = mission["vehicle"], mission["altitude"]
    safety_m = mission["planner"]["safety_distance_m"]
    slack_m, low, high = TOLERANCE * safety_m, 1.0 - TOLERANCE, 1.0 + TOLERANCE
    first = _first_judged(t_s, track_nea_m, band["floor_amsl_m"] - slack_m)
    t_s, track_nea_m = t_s[first:], track_nea_m[first:]
    points, up_m = _resampled(track_nea_m, STEP * safety_m), track_nea_m[:, 2]
    slowest_m_s = min(SLOWEST_M_S, 0.5 * vehicle.get("speed_m_s", math.inf))
    radii_m, slopes = turns_and_slopes(t_s, track_nea_m, slowest_m_s)
    target = mission["targets"][-1]["north_m"], mission["targets"][-1]["east_m"]
    ground = heights_of(world, folder)
    margins = {
        "terrain, m": clearance_m(points, ground, 2.0 * safety_m, STEP * safety_m) - low * safety_m,
        "turn radius, m": np.min(radii_m, initial=math.inf) - low * vehicle["turn_radius_m"],
        "climb, deg": high * vehicle["climb_angle_deg"] - np.degrees(slopes.max(initial=0.0)),
        "dive, deg": high * vehicle["dive_angle_deg"] + np.degrees(slopes.min(initial=0.0)),
        "floor, m": up_m.min() - (band["floor_amsl_m"] - slack_m),
        "ceiling, m": band["ceiling_amsl_m"] + slack_m - up_m.max(),
        "target, m": ARRIVED_M - math.dist(track_nea_m[-1, :2], target),
    }
    for radar in world.get("radars", ()):
        centre = np.array([radar[key] for key in ("north_m", "east_m", "altitude_amsl_m")])
        margins[radar["name"]] = cKDTree(points).query(centre)[0] - radar["range_m"]
    for number, zone in enumerate(mission.get("keep_outs", ())):
        margins[f"keep-out {number}, m"] = keep_out_m(points, zone).min() - low * safety_m
    return {name: float(margin) for name, margin in margins.items()}


def _first_judged(t_s: FloatArray, track_nea_m: FloatArray, lowest_amsl_m: float) -> int:
    """Index of the sample at which the judged part of a track begins."""
    speed_m_s = np.hypot(*np.diff(track_nea_m[:, :2], axis=0).T) / np.diff(t_s)
    strayed = np.hypot(*(track_nea_m[:-1, :2] - track_nea_m[0, :2]).T) > 100.0
    begun = ((speed_m_s > 1.0) & (track_nea_m[:-1, 2] >= lowest_amsl_m)) | strayed
    if not begun.any():
        raise ValueError("the vehicle never flew: no sample moves over the ground in the band")
    return int(np.argmax(begun))


def _resampled(track_nea_m: FloatArray, step_m: float) -> FloatArray:
    """Points so far apart along a track, and its end.  (N, 3) -> (P, 3)."""
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(track_nea_m, axis=0), axis=-1)))
    wanted_m = np.append(np.arange(0.0, along_m[-1], step_m), along_m[-1])
    return np.stack([np.interp(wanted_m, along_m, axis) for axis in track_nea_m.T], axis=-1)


def judge_files(world_toml: Path, mission_toml: Path, truth_jsonl: Path) -> Margins:
    """Judge a flight by its three files; and a crash anywhere, which may be before all that."""
    world, mission = (tomllib.loads(path.read_text("utf-8")) for path in (world_toml, mission_toml))
    lines = truth_jsonl.read_text("utf-8").splitlines()[1:]  # the first is a header
    rows = [json.loads(line) for line in lines if line.strip()]
    keys = ("t_s", "north_m", "east_m", "altitude_amsl_m")
    table = np.array([[row[key] for key in keys] for row in rows], dtype=np.float64).reshape(-1, 4)
    if len(table) < 2 or not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0.0).any():
        raise ValueError(f"{truth_jsonl}: needs two or more samples, all finite, with rising t_s")
    margins = judge(world, mission, table[:, 0], table[:, 1:], world_toml.parent)
    crash_m_s = max(row["crash"]["speed_m_s"] if row.get("crash") else 0.0 for row in rows)
    return margins | {"no crash, m/s": -crash_m_s}
