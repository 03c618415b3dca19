"""The judge of true tracks, against closed forms: it finds each kind of fault."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import true_track
from numpy.typing import NDArray
from pyproj import Geod

from companion.campaign.truth import terrain_distance_m
from companion.sources.files import toml_text
from companion.world.terrain import Peak, PeakTerrain

Track = tuple[NDArray[np.float64], NDArray[np.float64]]
ORIGIN = {"latitude_deg": 47.0, "longitude_deg": 8.0}
MISSION: dict[str, Any] = {
    "origin": ORIGIN,
    "altitude": {"floor_amsl_m": 3000.0, "ceiling_amsl_m": 5000.0},
    "targets": [{"north_m": 20_000.0, "east_m": 0.0}],
    "vehicle": {"turn_radius_m": 2500.0, "climb_angle_deg": 10.0, "dive_angle_deg": 10.0},
    "planner": {"safety_distance_m": 500.0},
}
PLACE = {"north_m": 10_000.0, "east_m": 0.0, "altitude_amsl_m": 0.0}


def world(ground_m: float = 0.0, combine: str = "maximum", **tables: Any) -> dict[str, Any]:
    peaks = tables.pop("peaks", [])
    terrain = {"combine": combine, "ground_amsl_m": ground_m, "peaks": peaks}
    return {"origin": ORIGIN, "terrain": terrain} | tables


def straight(altitude_m: float = 3500.0, length_m: float = 20_000.0) -> Track:
    """To the north at 150 m/s."""
    t_s = np.append(np.arange(0.0, length_m / 150.0, 0.1), length_m / 150.0)
    return t_s, np.stack([150.0 * t_s, 0 * t_s, 0 * t_s + altitude_m], axis=-1)


def helix(radius_m: float, speed_m_s: float, climb_deg: float = 0.0, end_s: float = 10.0) -> Track:
    t_s = np.arange(0.0, end_s, 0.1)
    angle = speed_m_s * t_s / radius_m
    up = speed_m_s * t_s * math.tan(math.radians(climb_deg))
    north, east = radius_m * np.cos(angle), radius_m * np.sin(angle)
    return t_s, np.stack([north, east, 4000.0 + up], axis=-1)


def test_clearance_is_that_to_the_nearest_of_many_mountainsides() -> None:
    """As campaigns judge it, which has a minimiser of its own: `tests/campaign/test_truth.py`."""
    rng = np.random.default_rng(3)
    low, high = (0, -4_000, 2_000, 800, 800), (12_000, 4_000, 3_200, 3_000, 3_000)
    rows = rng.uniform(low, high, (12, 5)).tolist()
    keys = ("north_m", "east_m", "height_amsl_m", "spread_north_m", "spread_east_m")
    peaks = [dict(zip(keys, row, strict=True)) for row in rows]
    height_m = true_track.heights_of(world(peaks=peaks))
    summed_m = true_track.heights_of(world(peaks=peaks, combine="sum"))
    places = rng.uniform((0, -2_000), (12_000, 2_000), (30, 2))
    for place in places:
        of_each = [  # eq. 1
            h * math.exp(-(((place[0] - n) / a) ** 2) - ((place[1] - e) / b) ** 2)
            for n, e, h, a, b in rows
        ]
        assert height_m(*place) == pytest.approx(max(of_each))
        assert summed_m(*place) == pytest.approx(sum(of_each))
    points = np.column_stack([places, height_m(*places.T) + rng.uniform(200, 900, 30)])
    terrain = PeakTerrain(peaks=tuple(Peak(*row) for row in rows), ground_amsl_m=0.0)
    for point, least_m in zip(points, terrain_distance_m(points, terrain, 1_000.0), strict=True):
        found_m = true_track.clearance_m(point[None], height_m, 1_000.0, 25.0)
        assert least_m - 0.1 <= found_m <= math.hypot(least_m, 40.0)  # slopes are steep
        below = point - [0.0, 0.0, 2e3]
        below_m = true_track.clearance_m(below[None], height_m, 1_000.0, 25.0)
        assert below_m == pytest.approx(below[2] - height_m(*below[:2]))


def test_an_elevation_file_has_its_heights_where_geodesics_find_its_points(tmp_path: Path) -> None:
    """Every pixel's middle is known; in between, the mean of neighbours; beyond it, nothing."""
    heights = np.arange(60.0).reshape(6, 10)
    with rasterio.open(
        tmp_path / "terrain.tif", "w", driver="GTiff", dtype="float32", count=1, height=6, width=10,
        crs="EPSG:4326", transform=rasterio.Affine(0.002, 0.0, 7.99, 0.0, -0.004, 47.01),
    ) as file:  # fmt: skip
        file.write(heights.astype("float32"), 1)
    height_m = true_track.heights_of(world() | {"terrain": {"file": "terrain.tif"}}, tmp_path)
    row, column = (each.ravel() for each in np.mgrid[1:5, 1:9])
    latitude, longitude = 47.01 - 0.004 * (row + 0.5), 7.99 + 0.002 * (column + 0.5)
    here = np.full(row.shape, 8.0), np.full(row.shape, 47.0)
    azimuth, _, away = Geod(ellps="WGS84").inv(*here, longitude, latitude)
    north, east = away * np.cos(np.radians(azimuth)), away * np.sin(np.radians(azimuth))
    np.testing.assert_allclose(height_m(north, east), heights[row, column], atol=1e-4)
    between, beyond = (north[:1] + north[9:10]) / 2, np.array([9_000.0])
    assert height_m(between, (east[:1] + east[9:10]) / 2) == pytest.approx(16.5, abs=0.01)
    assert np.isnan(height_m(beyond, 0.0 * beyond)).all()


T_S, LEVEL = straight()
DIP = T_S, LEVEL - np.outer(T_S[700] == T_S, [0.0, 0.0, 600.0])
CLIMB = np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, 3500.0], 36)
FROM_THE_GROUND = np.append(np.arange(36.0), 36.0 + T_S), np.vstack([CLIMB, LEVEL])
SLOW = {"vehicle": MISSION["vehicle"] | {"speed_m_s": 8.0, "turn_radius_m": 25.0}}
THROUGH, BELOW = (
    world(radars=[{"name": "radar 1", "range_m": range_m} | PLACE]) for range_m in (5e3, 3_400.0)
)


def keep_out(east_m: float, *, round_: bool = False) -> dict[str, Any]:
    corners = [[9e3, east_m], [11e3, east_m], [11e3, 9e3], [9e3, 9e3]]
    circle = {"north_m": 10_000.0, "east_m": 1_000.0 + east_m, "radius_m": 1_000.0}
    return {"keep_outs": [circle if round_ else {"vertices_m": corners}]}


@pytest.mark.parametrize(
    ("name", "margin", "track", "scene", "changes"),
    [
        ("turn radius, m", 25.0, helix(2_400.0, 150.0), {}, {}),
        ("turn radius, m", -25.0, helix(2_350.0, 150.0), {}, {}),
        ("turn radius, m", -1.75, helix(22.0, 8.0), {}, SLOW),
        ("turn radius, m", math.inf, helix(22.0, 8.0), {}, {}),  # too slow to be judged
        ("climb, deg", 0.1, helix(9_000.0, 25.0, 10.4), {}, {}),
        ("climb, deg", -0.1, helix(9_000.0, 25.0, 10.6), {}, {}),
        ("dive, deg", -0.1, helix(9_000.0, 25.0, -10.6), {}, {}),
        ("ceiling, m", -1.0, straight(5026.0), {}, {}),
        ("ceiling, m", 1525.0, DIP, {}, {}),
        ("floor, m", -975.0, straight(2000.0), {}, {}),  # never in the band
        ("floor, m", -75.0, DIP, {}, {}),
        ("floor, m", 525.0, FROM_THE_GROUND, {}, {}),  # the climb is not judged
        ("target, m", -1.0, straight(length_m=20_051.0), {}, {}),
        ("terrain, m", 5.0, straight(3480.0), world(3e3), {}),
        ("terrain, m", -5.0, straight(3470.0), world(3e3), {}),
        ("radar 1", -2000.0, straight(3000.0), THROUGH, {}),
        ("radar 1", 100.0, straight(3500.0), BELOW, {}),
        ("keep-out 0, m", -875.0, straight(), {}, keep_out(-400.0)),
        ("keep-out 0, m", 35.0, straight(), {}, keep_out(510.0)),
        ("keep-out 0, m", -875.0, straight(), {}, keep_out(-400.0, round_=True)),
        ("keep-out 0, m", 35.0, straight(), {}, keep_out(510.0, round_=True)),
    ],
)
def test_a_bound_may_be_missed_by_its_tolerance_and_no_more(
    name: str, margin: float, track: Track, scene: dict[str, Any], changes: dict[str, Any]
) -> None:
    margins = true_track.judge(scene or world(), MISSION | changes, *track)
    assert margins[name] == pytest.approx(margin, rel=0.1)


def test_a_crash_anywhere_is_found_and_what_is_no_truth_or_no_flight_is_refused(
    tmp_path: Path,
) -> None:
    files = [tmp_path / name for name in ("world.toml", "mission.toml", "truth.jsonl")]
    for file, table in zip(files, (world(), MISSION), strict=False):
        file.write_text(toml_text(table), encoding="utf-8")

    def judged(t_s: Any, track_nea_m: Any, **more: Any) -> true_track.Margins:
        rows: list[dict[str, Any]] = [{"schema": 1}]
        for at_s, (north, east, up) in zip(t_s, track_nea_m, strict=True):
            place = {"north_m": north, "east_m": east, "altitude_amsl_m": up}
            rows.append({"t_s": at_s, **place, **more})
        files[2].write_text("\n".join(map(json.dumps, rows)) + "\n")
        return true_track.judge_files(*files)

    assert min(judged(T_S, LEVEL).values()) == 0.0
    crash = {"t_s": 0.04, "speed_m_s": 9.1, "into": "the ground"}
    assert judged(T_S, LEVEL, crash=crash)["no crash, m/s"] == -9.1
    for bad in ((T_S[::-1], LEVEL), (T_S * math.nan, LEVEL), (T_S[:1], LEVEL[:1])):
        with pytest.raises(ValueError, match="rising t_s"):
            judged(*bad)
    with pytest.raises(ValueError, match="never flew"):
        judged(T_S, 0.0 * LEVEL)
